"""Values at one glance, tables for pandas, and the notebook of the documentation."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.core.display import Glance

NOTEBOOK = Path(__file__).parents[2] / "docs/how-to/notebook.ipynb"


@pytest.fixture(scope="module")
def features() -> termsel.FeatureSet:
    return termsel.simulate_scene("ikonos-hamedan")


@pytest.fixture(scope="module")
def result() -> termsel.Result:
    return termsel.run("poly-terms", solver="random", evaluations=100)


def test_every_value_fits_on_a_screen(features: termsel.FeatureSet,
                                      result: termsel.Result) -> None:
    task = termsel.prepare("owdis-lines")
    shown = (features, features.points, features.lines, result, result.fit, result.residuals, task,
             task.model, task.solver, task.criterion)
    for value in shown:
        assert len(repr(value).splitlines()) <= 12
        assert len(repr(value)) < 1000
        assert repr(value).startswith("<")
    for value in shown:
        if value is not result.residuals:
            assert value._repr_html_().startswith("<div><strong>")  # type: ignore[attr-defined]
    assert "RMSE" in repr(result)
    assert f"{len(features.points)} points" in repr(features)


def test_a_long_value_loses_its_middle() -> None:
    class Long(Glance):
        def _glance(self) -> tuple[str, dict[str, str]]:
            return "T" * 500, {"row": "v" * 500}

    title, row = repr(Long()).splitlines()
    assert 100 < len(title) < 200
    assert 100 < len(row) < 200
    assert len(Long()._repr_html_()) < 600


def test_what_files_brought_is_text_in_a_notebook() -> None:
    points = termsel.Points(["<img src=x onerror=alert(1)>", "b", "c"], np.eye(3, 2),
                            np.eye(3))
    assert "<img" not in points._repr_html_()
    assert "&lt;img" in points._repr_html_()


def test_tables_hold_what_the_features_hold(features: termsel.FeatureSet,
                                            result: termsel.Result) -> None:
    points, lines = features.points.to_pandas(), features.lines.to_pandas()
    assert list(points["id"]) == list(features.points.ids)
    np.testing.assert_array_equal(points[["line", "sample"]], features.points.image)
    np.testing.assert_array_equal(points[["x", "y", "z"]], features.points.ground)
    np.testing.assert_array_equal(lines[["line2", "sample2"]], features.lines.image[:, 1])
    np.testing.assert_array_equal(lines[["x1", "y1", "z1"]], features.lines.ground[:, 0])
    residuals = result.residuals.to_pandas()
    np.testing.assert_allclose(residuals["distance"], np.hypot(
        residuals["line"], residuals["sample"]))


def test_maps_have_the_crs_of_the_features(features: termsel.FeatureSet,
                                           result: termsel.Result) -> None:
    pytest.importorskip("geopandas")
    points = features.points.to_geopandas(features.crs)
    assert points.crs.to_epsg() == 4326
    np.testing.assert_array_equal(points.geometry.x, features.points.ground[:, 0])
    lines = features.lines.to_geopandas(features.crs)
    assert lines.geometry.iloc[0].coords[1] == tuple(features.lines.ground[0, 1])
    assert result.residuals.to_geopandas().crs == points.crs
    assert result.residuals.to_geopandas("local").crs is None
    flat = features.points.ground.copy()
    flat[:, 2] = np.nan
    without = termsel.Points(features.points.ids, features.points.image, flat)
    assert not without.to_geopandas(features.crs).has_z.any()


@pytest.mark.parametrize(("missing", "verb"), [("pandas", "to_pandas"),
                                               ("geopandas", "to_geopandas")])
def test_a_missing_library_is_named(features: termsel.FeatureSet, monkeypatch: pytest.MonkeyPatch,
                                    missing: str, verb: str) -> None:
    monkeypatch.setitem(__import__("sys").modules, missing, None)
    with pytest.raises(termsel.TermselError, match=f"pip install {missing}"):
        getattr(features.points, verb)()


@pytest.mark.slow
def test_the_cells_of_the_notebook_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for package in ("altair", "vl_convert", "pandas", "geopandas"):
        pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    scope: dict[str, Any] = {}
    shown = []
    for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            body = ast.parse("".join(cell["source"])).body
            last = body.pop() if isinstance(body[-1], ast.Expr) else None
            exec(compile(ast.Module(body, []), "cell", "exec"), scope)
            if isinstance(last, ast.Expr):
                shown.append(eval(compile(ast.Expression(last.value), "cell", "eval"), scope))
    assert len(shown) == 9
    assert all(hasattr(value, "_repr_html_") or hasattr(value, "_repr_mimebundle_")
               for value in shown if value is not None)
    assert (tmp_path / "report.html").exists()


@pytest.mark.slow
def test_the_notebook_runs(tmp_path: Path) -> None:
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    pytest.importorskip("altair")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3",
                            resources={"metadata": {"path": tmp_path}}).execute()
    kinds = [kind for cell in notebook.cells if cell.cell_type == "code"
             for output in cell.outputs for kind in output.get("data", ())]
    assert kinds.count("text/html") == 8  # three values, two charts, three tables
    said = [output["data"]["text/plain"] for cell in notebook.cells if cell.cell_type == "code"
            for output in cell.outputs if output.output_type == "display_data"]
    assert any("evaluations" in text for text in said)  # the line of progress
    assert (tmp_path / "report.html").exists()
