"""Studies of many images: a row and a folder each, whatever the image."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import termsel
from termsel import TermselError
from termsel.formats.readers.csv_tables import write_lines_csv, write_points_csv
from termsel.studies import compare
from termsel.studies.cells.images import IMAGES, folders_of
from termsel.studies.cells.table import TIMES

Call = Callable[..., SimpleNamespace]


def rows_of(folder: Path) -> list[dict[str, str]]:
    """Return the rows of study.csv without what differs from run to run."""
    with (folder / "study.csv").open(newline="") as file:
        return [{key: value for key, value in row.items() if key not in TIMES}
                for row in csv.DictReader(file)]


@pytest.mark.slow
def test_an_image_that_cannot_be_is_a_row_whatever_its_problem(call: Call, tmp_path: Path) -> None:
    _images(tmp_path, 1)
    (tmp_path / "image9.csv").unlink()
    lines = termsel.prepare("owdis-lines").features.lines
    assert lines is not None
    write_lines_csv(lines.take(np.arange(1)), tmp_path / "lines.csv", crs="local")
    study = termsel.compare(data=[{"points": str(tmp_path / "image0.csv"), "crs": "local"},
                                  {"lines": str(tmp_path / "lines.csv"), "crs": "local"}])
    assert [row["state"] for row in study.rows] == ["failed", "done"]
    assert "1 is control; at least 2 control lines are needed" in study.rows[0]["reason"]
    done = call("compare", "--lines", tmp_path / "lines.csv", "--crs", "local", "--out",
                tmp_path / "out")
    assert done.exit_code == 2
    assert "1 is control" in done.stderr
    assert not (tmp_path / "out").exists()


def _images(folder: Path, number: int) -> None:
    """Write points of several images, the last of them with a blunder and an unreadable file."""
    points = termsel.prepare("poly-terms").features.points
    for i in range(number):
        rng = np.random.default_rng(i)
        chosen = points.take(np.sort(rng.permutation(len(points))[:30]))
        write_points_csv(chosen, folder / f"image{i}.csv", crs="local")
    (folder / "image9.csv").write_text("id,line,sample,x,y\nP1,1,2,abc,4\n")


@pytest.mark.slow
def test_a_collection_has_a_row_and_a_folder_an_image_the_worst_first(
        call: Call, tmp_path: Path) -> None:
    _images(tmp_path, 3)
    done = call("compare", "--points", tmp_path / "image*.csv", "--crs", "local", "--out",
                tmp_path / "out", "--problem", "poly-terms")
    assert done.exit_code == 0, done.stderr
    rows = rows_of(tmp_path / "out")
    assert rows[0]["state"] == "failed"
    assert "abc" in rows[0]["reason"]
    predicted = [float(row["predicted"]) for row in rows[1:]]
    assert predicted == sorted(predicted, reverse=True)
    for row in rows[1:]:
        folder = next(path for path in (tmp_path / "out" / IMAGES).iterdir()
                      if Path(row["data"]).name in path.name)
        record = json.loads((folder / "result.json").read_text())
        assert record["predicted"]["rmse"] == float(row["predicted"])
        assert termsel.read_result(folder).selection.terms


def test_a_file_that_cannot_be_read_is_a_row_and_one_named_twice_is_read_once(
        tmp_path: Path) -> None:
    _images(tmp_path, 1)
    study = termsel.compare(problems=["poly-terms"], solvers=["random"], budget={"evaluations": 50},
                            data=[{"crs": "local", "points": [str(tmp_path / "image*.csv"),
                                                              str(tmp_path / "image0.csv")]}])
    assert [row["state"] for row in study.rows] == ["done", "failed"]
    assert "abc" in study.rows[1]["reason"]


def test_the_table_of_an_earlier_study_is_no_image(tmp_path: Path,
                                                   caplog: pytest.LogCaptureFixture) -> None:
    _images(tmp_path, 1)
    (tmp_path / "image9.csv").unlink()
    (tmp_path / "study.csv").write_text("data,state\nimage0.csv,done\n")
    caplog.set_level("INFO", "termsel")
    spec, folder = compare.requested_study(None, {
        "problems": ["poly-terms"], "solvers": ["random"],
        "data": [{"crs": "local", "points": [str(tmp_path / "*.csv")]}]})
    cells = compare.plan_cells(spec, folder, frozenset([(tmp_path / "study.csv").resolve()]))
    assert [Path(cell.labels["data"]).name for cell in cells] == ["image0.csv"]
    assert "study.csv in the folder of --out" in caplog.text


def test_no_two_images_share_a_folder() -> None:
    labels = {"data": "a/x.csv", "split": 0, "problem": "rfm-terms", "strategy": "auto"}
    assert folders_of({"1": labels, "2": {**labels, "split": 3},
                       "3": {**labels, "data": "y.csv"}}) == {
        "1": "x", "2": "x-split-3", "3": "y"}
    assert folders_of({"1": labels, "2": {**labels, "problem": "poly-terms"}}) == {
        "1": "x-rfm-terms", "2": "x-poly-terms"}
    assert folders_of({"1": labels, "2": {**labels, "data": "b/x.csv"}}) == {
        "1": "a_x.csv", "2": "b_x.csv"}
    with pytest.raises(TermselError, match="the same folder"):
        folders_of({"1": labels, "2": {**labels, "data": "A/x.csv"}})


def test_a_folder_with_files_of_other_things_is_refused(call: Call, tmp_path: Path) -> None:
    _images(tmp_path, 1)
    points = tmp_path / "image0.csv"
    own = points.rename(tmp_path / "study.csv")
    before = own.read_bytes()
    done = call("compare", "--points", own, "--crs", "local", "--problem", "poly-terms", "--solver",
                "random", "--evaluations", "50", "--out", tmp_path)
    assert done.exit_code == 2
    assert "study.csv" in done.stderr
    assert own.read_bytes() == before
