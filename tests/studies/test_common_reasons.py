"""A reason that many images or runs of a study have is said once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("termsel_studies")

Call = Callable[..., SimpleNamespace]


@pytest.fixture
def lone_points(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with three tables of a single point, where the test works."""
    for i in range(3):
        (tmp_path / f"{i}.csv").write_text(
            f"# crs: EPSG:32633\nid,line,sample,x,y,z\nP,{i},5,500{i},{i},7\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_images_that_fail_alike_share_one_reason(lone_points: Path, call: Call) -> None:
    (lone_points / "good.csv").write_text("# crs: EPSG:32633\nid,line,sample,x,y,z\n" + "".join(
        f"P{i},{100 * (i % 4)},{100 * (i // 4)},{1000 * (i // 4)},{-1000 * (i % 4)},5\n"
        for i in range(16)))
    done = call("compare", "--points", "*.csv", "--out", "batch")
    assert "0.csv and 2 more: only 1 control point" in done.stdout
    assert done.stdout.count("only 1 control point") == 1
    summary = (lone_points / "batch/summary.txt").read_text()
    assert "0.csv, 1.csv, 2.csv: only 1 control point" in summary
    assert "<h1>Batch of images</h1>" in (lone_points / "batch/report.html").read_text()


def test_seeds_that_fail_alike_share_one_row(lone_points: Path, call: Call) -> None:
    (lone_points / "study.toml").write_text(
        'problems = [{name = "poly-terms", degree = 2}]\nsolvers = ["random"]\nseeds = 7\n'
        'data = [{points = "0.csv"}, {dataset = "ikonos-hamedan"}]\n[budget]\nevaluations = 5\n')
    done = call("compare", "study.toml", "--out", "study", "--quiet")
    assert "0.csv, poly2d, random, seed 1, 2, 3, 4, 5 and 2 more" in done.stdout
    assert done.stdout.count("only 1 control point") == 1
