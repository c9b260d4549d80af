"""The page of a study: the same from its folder as from its run; each image with its residuals."""

from __future__ import annotations

import json
import re
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import termsel
from termsel.core.isolation.helper import Helper
from termsel.results import pictures
from termsel.studies.outputs import write_outputs

pytest.importorskip("altair")
pytest.importorskip("vl_convert")

HOSTILE = "</script><img src=x onerror=alert(1)> {{7*7}} ${x} \u202e\u0627\u0644"
Call = Callable[..., SimpleNamespace]


def scene(n: int, noise: float) -> termsel.FeatureSet:
    """Return control of an affine image."""
    rng = np.random.default_rng(n)
    ground = np.column_stack([rng.uniform(0, 4000, (n, 2)), np.zeros(n)])
    image = ground[:, :2] * [0.5, -0.5] + [10, 2010] + rng.normal(0, noise, (n, 2))
    return termsel.FeatureSet(termsel.Points([f"P{i}" for i in range(n)], image, ground),
                              crs="local", image_size=(2100, 2100))


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a study of three images, the second the worst, one without a result."""
    folder = tmp_path_factory.mktemp("images") / "study"
    alone = scene(9, 0.1)
    study = termsel.compare(
        data={"good": scene(9, 0.1), HOSTILE: scene(10, 5.0),
              "one point": alone.with_(points=alone.points.take([0]))},
        out=folder, title=HOSTILE)
    assert [row["state"] for row in study.rows] == ["failed", "done", "done"]
    write_outputs(study, folder)
    return folder


def test_the_page_of_the_folder_is_that_of_the_run(call: Call, images: Path,
                                                   tmp_path: Path) -> None:
    made = images / "report.html"
    again = call("report", images)
    assert again.exit_code == 0
    assert "There is a page already" in again.stdout
    assert call("report", images, "-o", tmp_path / "page.html").exit_code == 0
    assert (tmp_path / "page.html").read_text() == made.read_text()
    refused = call("report", images, "-o", tmp_path / "x.html", "--image", "scene.tif")
    assert refused.exit_code == 2
    assert "--image is for the page of one result" in refused.stderr


@pytest.mark.parametrize("name", ["plan.json", "journal.jsonl", "images/good/result.json"])
def test_a_page_replaces_no_file_of_its_study(call: Call, images: Path, name: str) -> None:
    before = (images / name).read_bytes()
    done = call("report", images, "-o", images / name, "--overwrite")
    assert done.exit_code == 2
    assert "would replace it" in done.stderr
    assert (images / name).read_bytes() == before


def test_a_picture_is_not_of_a_study_and_a_damaged_plan_is_named(
        call: Call, images: Path, tmp_path: Path) -> None:
    done = call("plot", images, "residuals", "-o", tmp_path / "x.svg")
    assert done.exit_code == 2
    assert "this is the folder of a study" in done.stderr
    folder = tmp_path / "damaged"
    folder.mkdir()
    (folder / "plan.json").write_text("{")
    done = call("report", folder)
    assert done.exit_code == 2
    assert f"{folder / 'plan.json'}, line 1: this is not JSON" in done.stderr
    plan = json.loads((images / "plan.json").read_text())
    labels = next(iter(plan["cells"].values()))
    for change in ({"workers": float("inf")}, {"cells": {"a": {**labels, "data": []}}},
                   {"cells": {"a": {**labels, "model": None}}}, {"cells": [1]}):
        (folder / "plan.json").write_text(json.dumps({**plan, **change}))
        done = call("report", folder)
        assert done.exit_code == 2
        assert f"{folder / 'plan.json'}: this is not the plan of a study" in done.stderr


def test_a_folder_with_neither_result_nor_study_is_named(call: Call, tmp_path: Path) -> None:
    done = call("report", tmp_path)
    assert done.exit_code == 2
    assert "there is neither a result nor a study in this folder" in done.stderr
    assert not list(tmp_path.iterdir())


def test_no_result_is_written_into_the_folder_of_a_study(call: Call, images: Path) -> None:
    before = sorted(images.iterdir())
    for more in ((), ("--overwrite",)):
        done = call("run", "--problem", "poly-terms", "--out", images, *more)
        assert done.exit_code == 2
        assert "this is the folder of a study" in done.stderr
    assert sorted(images.iterdir()) == before


def test_images_stand_worst_first_with_their_residuals(images: Path) -> None:
    text = (images / "report.html").read_text()
    body = text[:text.index("<script")]
    rows = re.findall(r'<tr><th scope="row">(.*?)</th><td class="picture">(.*?)</td>', body)
    assert ["one point" in rows[0][0], "good" in rows[2][0]] == [True, True]
    assert rows[0][1] == ""
    for (_, drawn), folder in zip(rows[1:], sorted(
            (images / "images").iterdir(), key=lambda one: one.name == "good"), strict=True):
        result = termsel.read_result(folder)
        largest = max(r.distance for r in result.residuals)
        assert f'aria-label="{len(result.residuals)} residuals, the largest {largest:.3g} px"' \
            in drawn


def test_hostile_names_of_images_are_text(images: Path) -> None:
    text = (images / "report.html").read_text()
    body = text[:text.index("<script")]
    assert "<img" not in body
    assert text.count("</script>") == 3
    assert body.count("&lt;img src=x onerror=alert(1)&gt; {{7*7}} ${x}") == 3  # title twice, row


def test_a_study_under_way_has_a_page(call: Call, images: Path, tmp_path: Path) -> None:
    folder = tmp_path / "half"
    shutil.copytree(images, folder)
    (folder / "report.html").unlink()
    journal = folder / "journal.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    for kept in (len(lines) - 3, len(lines) - 2):
        journal.write_text("".join(lines[:kept]))
        assert call("report", folder, "--overwrite").exit_code == 0
        assert f"{kept - len(lines) + 3} of 3 images finished" in (
            folder / "report.html").read_text()


def test_an_image_that_was_changed_says_so_in_its_place(call: Call, images: Path,
                                                        tmp_path: Path) -> None:
    folder = tmp_path / "changed"
    shutil.copytree(images, folder)
    record = folder / "images" / "good" / "result.json"
    record.write_text(record.read_text().replace('"seed": 1', '"seed": 2'))
    assert call("report", folder, "--overwrite").exit_code == 0
    text = (folder / "report.html").read_text()
    assert '<td class="picture">this file was changed after the run wrote it</td>' in text


def test_a_comparison_has_its_charts_again(call: Call, tmp_path: Path) -> None:
    study = termsel.compare(problems=["poly-terms"], solvers=["random", "swap"], seeds=2,
                            options={"degree": 2}, budget={"evaluations": 100}, out=tmp_path / "s")
    assert study.complete
    assert call("report", tmp_path / "s").exit_code == 0
    text = (tmp_path / "s" / "report.html").read_text()
    for name in ("ecdf-evaluations", "ecdf-cpu-seconds", "convergence"):
        assert f'data-chart="{name}"' in text


def test_rows_are_tables_and_images_a_map(images: Path) -> None:
    pytest.importorskip("pandas")
    study = termsel.read_study(images)
    table = study.rows.to_pandas()
    assert list(table.columns) == list(study.columns)
    assert list(table["data"]) == ["one point", HOSTILE, "good"]
    pytest.importorskip("geopandas")
    outlines = study.to_geopandas()
    assert list(outlines["data"]) == [HOSTILE, "good"]
    assert outlines.crs is None
    ground = scene(9, 0.1).points.ground
    assert outlines.geometry[1].bounds == pytest.approx(
        (*ground[:, :2].min(axis=0), *ground[:, :2].max(axis=0)))


@pytest.mark.slow
def test_a_map_of_images_is_in_longitude_and_latitude(tmp_path: Path) -> None:
    pytest.importorskip("geopandas")
    there = scene(6, 0.1)
    moved = replace(there.points, ground=np.add(there.points.ground, [500000.0, 3850000.0, 0]))
    study = termsel.compare(data={
        "placed": replace(there, points=moved, crs="EPSG:32639"), "local": there},
        out=tmp_path / "s")
    outlines = study.to_geopandas()
    assert list(outlines["data"]) == ["placed"]
    west, south, east, north = outlines.total_bounds
    assert 50.9 < west < east < 51.1
    assert 34.7 < south < north < 34.9
    with pytest.raises(termsel.TermselError, match="without a folder"):
        replace(study, folder=None).to_geopandas()


def test_a_study_shows_itself_on_a_screen(images: Path) -> None:
    study = termsel.read_study(images)
    assert repr(study).startswith("<Study of 3 runs: </script>")
    assert len(repr(study).splitlines()) <= 9
    assert "1 failed, 2 done" in repr(study)
    assert "<img" not in study._repr_html_()
    assert repr(study.rows) == f"<Rows: 3 of {len(study.columns)} columns>"


@pytest.mark.slow
def test_a_study_in_a_notebook_has_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[list[str]] = []

    class Line:
        def update(self, data: dict[str, str], **_: object) -> None:
            lines[-1].append(data["text/plain"])

    def display(data: dict[str, str], **_: object) -> Line:
        lines.append([data["text/plain"]])
        return Line()

    shell = SimpleNamespace(get_ipython=lambda: SimpleNamespace(kernel=True))
    monkeypatch.setitem(sys.modules, "IPython", shell)
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=display))
    termsel.compare(data={"one": scene(6, 0.1), "two": scene(7, 0.1)}, title="Scenes")
    assert len(lines) == 1
    assert lines[0][0] == "Scenes: ..."
    assert lines[0][-1] == "Scenes: 2 of 2 runs, finished"


def test_a_chart_that_cannot_be_drawn_takes_no_table_along(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    study = termsel.compare(problems=["poly-terms"], solvers=["random", "swap"], seeds=2,
                            budget={"evaluations": 60}, options={"degree": 2}, out=tmp_path)
    monkeypatch.setattr(pictures, "_drawing_helper", lambda: Helper("import os; os.abort()"))
    written = write_outputs(study, tmp_path)
    assert {path.name for path in written} >= {"study.csv", "summary.md", "report.html", "ioh"}
    assert not list((tmp_path / "figures").iterdir())
    assert "cannot draw this chart: a fault of compiled code" in caplog.text
