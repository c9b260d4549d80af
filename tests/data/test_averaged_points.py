"""Points measured more than once: all are named at once, or their mean is taken on demand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import termsel
from termsel.cli.main import cli
from termsel.core.errors import TermselError

HEAD = "# crs: EPSG:32633\nid,role,line,sample,x,y,z,sigma_line,sigma_sample\n"
ROWS = """a,control,100,100,500100,5000900,0,1,1
b,control,102,101,500100,5000900,0,1,1
c,check,500,120,500120,5000500,0,1,1
d,check,502,121,500120,5000500,0,1,1
e,check,504,122,500120,5000500,0,1,1
f,control,130,870,500870,5000870,0,1,1
g,control,400,400,500400,5000600,0,1,1
h,off,401,401,500400,5000600,0,1,1
"""


def file(folder: Path, rows: str = ROWS) -> Path:
    path = folder / "points.csv"
    path.write_text(HEAD + rows)
    return path


def test_all_points_at_one_place_are_named_at_once(tmp_path: Path) -> None:
    with pytest.raises(TermselError) as caught:
        termsel.read(file(tmp_path))
    assert caught.value.what == ("points 'a' and 'b'; 'c', 'd' and 'e' each have the same "
                                 "ground coordinates")
    assert caught.value.line == 4
    assert "repeated='average'" in (caught.value.hint or "")


def test_no_mean_is_offered_of_points_at_zero(tmp_path: Path) -> None:
    """It would keep a false point; these zeros are places that are not known."""
    zeros = "".join(f"{name},control,{line},40,0,0,{z},1,1\n"
                    for name, line, z in (("m", 50, 0), ("n", 60, 0), ("o", 70, 5)))
    with pytest.raises(TermselError, match="points 'm' and 'n' have the same ground coordinates, "
                                           "x = 0 and y = 0") as caught:
        termsel.read(file(tmp_path, ROWS + zeros))
    assert "repeated=average" not in str(caught.value)
    assert "remove these points" in (caught.value.hint or "")


def test_very_many_are_counted(tmp_path: Path) -> None:
    rows = "".join(f"p{i},control,{i},{i % 7},{500000 + i // 2},5000000,0,1,1\n"
                   for i in range(60))
    with pytest.raises(TermselError, match="and those of 22 more positions each have"):
        termsel.read(file(tmp_path, rows))


def test_their_mean_may_be_taken(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    points = termsel.read(file(tmp_path), repeated="average").points
    # What is off takes no part, and stays as it is.
    assert points.ids == ("a", "c", "f", "g", "h")
    np.testing.assert_allclose(points.image, [[101, 100.5], [502, 121], [130, 870], [400, 400],
                                              [401, 401]])
    assert points.roles == ("control", "check", "control", "control", "off")
    assert points.sigma is not None
    np.testing.assert_allclose(points.sigma[:, 0], [2**-0.5, 3**-0.5, 1, 1, 1])
    assert caplog.messages == [
        "Note: 2 points measured more than once are averaged: a, b; c, d, e. They are up to 2.24 "
        "px from their means."]


@pytest.mark.parametrize("repeated", [None, "average"])
@pytest.mark.parametrize("switched_off", [{"off": "b,d,e"}, {"role": "b=off,d=off,e=off"}])
def test_points_that_are_switched_off_clash_with_none(
        tmp_path: Path, repeated: str | None, switched_off: dict[str, str]) -> None:
    points = termsel.read(file(tmp_path), repeated=repeated, **switched_off).points
    assert points.ids == tuple("abcdefgh")
    off = [name for name, role in zip(points.ids, points.roles, strict=True) if role == "off"]
    assert off == ["b", "d", "e", "h"]
    np.testing.assert_array_equal(points.image[0], [100, 100])


def test_without_repeated_points_nothing_changes(tmp_path: Path) -> None:
    rows = "\n".join(row for row in ROWS.splitlines() if row[0] in "acfg") + "\n"
    path = file(tmp_path, rows)
    one, other = termsel.read(path).points, termsel.read(path, repeated="average").points
    assert one.ids == other.ids
    np.testing.assert_array_equal(one.image, other.image)


def test_different_roles_have_no_mean(tmp_path: Path) -> None:
    rows = ROWS.replace("b,control", "b,independent")
    with pytest.raises(TermselError, match="'a' and 'b' have the same ground coordinates and "
                                           "different roles"):
        termsel.read(file(tmp_path, rows), repeated="average")


def test_an_unknown_choice_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TermselError, match="repeated"):
        termsel.read(file(tmp_path), repeated="mean")


def test_a_run_and_a_batch_take_the_option(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    file(tmp_path)
    run = CliRunner().invoke(cli, ["run", "--points", "points.csv", "--set", "repeated=average",
                                    "--quiet", "--json"])
    assert run.exit_code == 0, run.output
    batch = CliRunner().invoke(cli, ["compare", "--points", "points.csv", "--set",
                                      "repeated=average", "--out", "out", "--quiet"])
    assert batch.exit_code == 0, batch.output
    table = (tmp_path / "out" / "study.csv").read_text()
    assert "measured more than once are averaged" in table
