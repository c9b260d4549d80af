"""Commands that termsel prints, as the next one or as a remedy, do what they say when typed."""

from __future__ import annotations

import csv
import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rasterio")
Call = Callable[..., SimpleNamespace]
Row = list[str]

_PRINTED = re.compile(
    r"(?:Next|Ready to run|Guess 1 of \d, to check|A guess, to check): termsel (.*?)(?:   \(.*)?$",
    re.MULTILINE)
"""A command after its label, without the remark that may follow in brackets."""
ID, LINE, SAMPLE, X, Y, Z = 0, 2, 3, 4, 5, 6


@pytest.fixture
def folder(example_files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the current folder, which has a blank in its name and files of the example."""
    files = tmp_path / "my files"
    files.mkdir()
    for name in ("gcps.csv", "noheader.txt", "roads.geojson", "roads.csv"):
        shutil.copy(example_files / name, files)
    monkeypatch.chdir(files)
    return files


def write_points(name: str, change: Callable[[int, Row], None] = lambda _number, _row: None,
                 count: int = 30, declared: bool = True) -> None:
    """Write control points of the example, each after a change; `declared` is whether with CRS."""
    with Path("gcps.csv").open() as file:
        first, header, *rows = list(csv.reader(file))
    for number, row in enumerate(rows):
        change(number, row)
    with Path(name).open("w", newline="") as file:
        csv.writer(file).writerows([*[first] * declared, header, *rows[:count]])


def printed_command(done: SimpleNamespace) -> list[str]:
    """Return the words of the first command that is printed."""
    found = _PRINTED.search(done.stdout + done.stderr)
    assert found is not None, done.stdout + done.stderr
    return shlex.split(found[1])


def exchange(first: int, second: int) -> Callable[[int, Row], None]:
    def change(_number: int, row: Row) -> None:
        row[first], row[second] = row[second], row[first]
    return change


def shift_one(number: int, row: Row) -> None:
    if number == 5:
        row[LINE] = f"{float(row[LINE]) + 90.0}"


SITUATIONS: dict[str, tuple[Callable[[], None], list[str]]] = {
    "x and y exchanged": (
        lambda: write_points("my points.csv", exchange(X, Y)),
        ["run", "--points", "my points.csv", "--out", "my result"]),
    "line and sample exchanged": (
        lambda: write_points("p.csv", exchange(LINE, SAMPLE)), ["run", "p.csv"]),
    "a blunder among independent points": (
        lambda: write_points("p.csv", shift_one),
        ["run", "p.csv", "--set", "role=C5=independent", "--off=C1", "--out", "result"]),
    "no CRS": (
        lambda: write_points("p.csv", declared=False), ["run", "p.csv", "--out", "new result"]),
    "all points fit": (lambda: write_points("p.csv"), ["run", "p.csv", "--out", "a result"]),
    "heights alone are in doubt": (
        lambda: write_points("p.csv"), ["run", "p.csv", "--crs", "WGS84"]),
    "no header": (
        lambda: None, ["run", "noheader.txt", "--crs", "EPSG:4979", "--out", "b"]),
    "lines by another property": (
        lambda: None, ["run", "--lines", "roads.geojson", "--image-lines", "roads.csv"]),
    "a saved run again": (
        lambda: write_points("p.csv", exchange(X, Y)),
        ["run", "p.csv", "--out=r", "--set=swapped=line-sample", "--overwrite"]),
    "no folder for a batch": (
        lambda: write_points("my points.csv"), ["compare", "--points", "my points.csv"]),
}


@pytest.mark.slow_cases(
    "a blunder among independent points", "lines by another property", "x and y exchanged")
@pytest.mark.parametrize("situation", SITUATIONS)
def test_a_printed_command_runs_as_it_is(situation: str, folder: Path, call: Call) -> None:
    prepare, words = SITUATIONS[situation]
    prepare()
    done = call(*words)
    command = printed_command(done)
    assert command != words
    again = call(*command)
    assert again.exit_code == 0, again.stderr
    # The command has mended what was wrong, and prints another.
    assert command not in ([], printed_command(again) if "Next: termsel" in again.stdout else None)


def test_a_block_in_place_of_a_study_has_its_command(folder: Path, call: Call) -> None:
    (folder / "block.toml").write_text('crs = "EPSG:4979"\n[[image]]\nname = "A"\n')
    done = call("compare", "block.toml", "--out", "study")
    assert done.exit_code == 2
    assert "block.toml: this describes a block of images, not a study" in done.stderr
    assert "termsel block block.toml --out adjusted" in done.stderr
