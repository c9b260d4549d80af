"""A result is whole when it is read again from its folder."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet, Points
from termsel.io.result_folder import read_result, write_result
from termsel.results.result import Result, checksum_of_record
from termsel.simulate import simulate_scene
from termsel.testing import example_results
from termsel_cameras import simulate_map


@pytest.fixture(scope="module")
def of_lines() -> Result:
    return termsel.run("owdis-lines", generations=2, options={"population": 30, "polish": False})


def _written(result: Result, folder: Path) -> Result:
    folder.mkdir(exist_ok=True)
    write_result(result, folder)
    return read_result(folder)


@pytest.mark.parametrize("which", [0, 1])
def test_read_again_it_is_the_same(which: int, tmp_path: Path) -> None:
    result = example_results()[which]
    again = _written(result, tmp_path)
    assert again.to_json() == result.to_json()
    assert again.residuals == result.residuals
    assert again._repr_html_() == result._repr_html_()
    ground = result.features.points.ground
    assert np.array_equal(again.project(ground), result.project(ground))


def test_read_again_with_lines(of_lines: Result, tmp_path: Path) -> None:
    again = _written(of_lines, tmp_path)
    assert again.to_json() == of_lines.to_json()
    assert again.residuals == of_lines.residuals
    assert len(again.features.lines) == 120
    assert len(again.residuals) == 2 * 120 + 24 + 26


@pytest.mark.slow
def test_a_random_field_that_auto_chose_is_read_again(tmp_path: Path) -> None:
    points = simulate_map(seed=0, n_points=40).points
    roles = ("control",) * 30 + ("independent",) * 10
    result = termsel.run("poly-terms", strategy="auto",
                         features=termsel.FeatureSet(replace(points, roles=roles)))
    assert result.strategy is not None
    assert result.strategy.chosen == "field"
    again = _written(result, tmp_path)
    assert again.to_json() == result.to_json()


@pytest.mark.slow_cases("{'strategy': 'auto'}")
@pytest.mark.parametrize("how", [
    {"strategy": "auto"}, {"solver": "ridge"}, {"solver": "nsga2", "generations": 3}], ids=str)
def test_read_again_whatever_found_it(how: dict[str, Any], tmp_path: Path) -> None:
    result = termsel.run("rfm-terms", dataset="irs1c-mashad", **how)
    again = _written(result, tmp_path)
    assert again.to_json() == result.to_json()
    assert again.residuals == result.residuals
    assert np.array_equal(again.project(result.features.points.ground),
                          result.project(result.features.points.ground))


@pytest.mark.slow
def test_lines_under_rational_functions(tmp_path: Path) -> None:
    result = termsel.run("owdis-lines", model="rfm", generations=1,
                         options={"order": 1, "population": 20, "polish": False})
    again = _written(result, tmp_path)
    assert again.to_json() == result.to_json()
    assert again.residuals == result.residuals


def test_blank_heights_and_roles_survive(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    ground = np.column_stack([rng.uniform(0.0, 1000.0, (30, 2)), np.full(30, np.nan)])
    image = 500.0 + 0.5 * ground[:, :2] + rng.normal(0.0, 0.2, (30, 2))
    points = Points(tuple(f"p{i}" for i in range(30)), image, ground,
                    roles=("off", "check", *[""] * 28))
    result = termsel.run("poly-terms", features=FeatureSet(points, image_size=(1000, 1001)),
                         solver="all-terms", model="poly2d", options={"degree": 1})
    again = _written(result, tmp_path)
    assert again.to_json() == result.to_json()
    assert again.features.points.roles == result.features.points.roles
    assert again.features.points.roles[:2] == ("off", "check")
    assert again.features.image_size == (1000, 1001)


def test_image_to_ground_and_back(tmp_path: Path) -> None:
    result = _written(termsel.run("rfm-terms", model="poly3d", solver="all-terms",
                                  dataset="irs1c-mashad"), tmp_path)
    ground = result.features.points.ground
    image = result.project(ground)
    assert np.abs(result.locate(image, ground[:, 2]) - ground).max() < 1e-8
    on_slope = result.locate(image, lambda xy: 1000.0 + 2000.0 * (xy[:, 0] - 59.6))
    assert np.abs(on_slope[:, 2] - 1000.0 - 2000.0 * (on_slope[:, 0] - 59.6)).max() < 1e-3
    assert np.abs(result.project(on_slope) - image).max() < 1e-5


@pytest.mark.slow
def test_places_without_coordinates_have_no_image() -> None:
    ground = np.array([[59.6, 36.3, 1000.0], [np.nan, 36.3, 1000.0], [59.6, np.inf, 1000.0],
                       [59.6, 36.3, np.nan]])
    for model, seen in (("poly3d", [True, False, False, False]),
                        ("poly2d", [True, False, False, True])):
        result = termsel.run("rfm-terms", model=model, solver="all-terms", dataset="irs1c-mashad",
                             options={"degree": 1})
        image = result.project(ground)
        assert np.isfinite(image).all(axis=1).tolist() == seen
        assert np.isnan(image).all(axis=1).tolist() == [not one for one in seen]
        with pytest.raises(TermselError, match=r"shape \(3,\), expected \(n, 3\)"):
            result.project(ground[0])


def test_residuals_are_a_table_for_pandas_and_features_for_geopandas() -> None:
    pandas = pytest.importorskip("pandas")
    result = example_results()[0]
    table = pandas.DataFrame(result.residuals)
    assert list(table.columns) == ["id", "kind", "role", "used", "line", "sample", "x", "y", "z",
                                   "distance", "blunder"]
    assert len(table) == 60
    independent = table[table.role == "independent"]
    assert np.sqrt((independent.distance**2).mean()) == pytest.approx(
        result.rmse["independent"].total)
    shapely = pytest.importorskip("shapely.geometry")
    collection = result.residuals.__geo_interface__
    first = collection["features"][0]
    assert shapely.shape(first["geometry"]).z == result.residuals[0].z
    assert first["properties"]["id"] == result.residuals[0].id


def test_notebook_shows_the_summary() -> None:
    assert example_results()[0]._repr_html_().startswith(
        "<div><strong>Result: rational function model, ")


@pytest.mark.slow
def test_a_result_shows_structure_points_blunders_and_accuracy() -> None:
    scene = simulate_scene("ikonos-hamedan", n_points=60, n_lines=0)
    moved = scene.points.image.copy()
    moved[0] += (0.0, 90.0)
    roles = [("control", "check", "independent")[i % 3] for i in range(60)]
    features = scene.with_(points=replace(scene.points, image=moved, roles=roles))
    shown = repr(termsel.run(features=features)).splitlines()
    assert shown[0].startswith("<Result: ")
    assert shown[2:4] == ["  fitted to: 39 points; exported: fitted to 59",
                          f"  blunders left out: {features.points.ids[0]}"]
    assert re.search(r"px / [\d.]+ m +RMSE at 20 independent check points", shown[4])


@pytest.mark.slow
def test_a_plane_model_takes_places_without_heights() -> None:
    scene = simulate_scene("ikonos-hamedan", n_points=30, n_lines=0)
    plane = termsel.run("poly-terms", features=scene, solver="all-terms")
    places = scene.points.ground
    assert np.array_equal(plane.project(places[:, :2]), plane.project(places))
    assert np.array_equal(plane.sigma(places[:, :2]), plane.sigma(places))
    with pytest.raises(TermselError, match=r"shape \(2,\), expected \(n, 3\)"):
        plane.project(places[0, :2])
    solid = termsel.run("rfm-terms", features=scene, solver="all-terms", model="affine")
    with pytest.raises(TermselError, match=r"expected \(n, 3\)"):
        solid.project(places[:, :2])


def _damaged(folder: Path, **change: object) -> None:
    """Change the record as someone would who knows how to seal it again."""
    path = folder / "result.json"
    record = json.loads(path.read_text())
    for key, value in change.items():
        merged = key in ("data", "coefficients") and isinstance(value, dict)
        record[key] = record[key] | value if merged else value
    record["checksums"]["record"] = checksum_of_record(record)
    path.write_text(json.dumps(record))


def _nested(depth: int) -> dict[str, Any]:
    return {"problem": _nested(depth - 1)} if depth else {}


@pytest.mark.parametrize(("change", "message"), [
    ({"schema": "termsel-result-0"},
     "its schema is 'termsel-result-0', expected 'termsel-result-1'"),
    ({"model": "rfn"}, "unknown model 'rfn'"),
    ({"scaling": {}}, "this result is damaged"),
    ({"coefficients": {"line.num:W": 1.0}}, "the installed model has no term 'line.num:W'"),
    ({"coefficients": {"line.num:1": None}}, "this result is damaged"),
    ({"coefficients": {"sample.num:Y": 1e306}}, "is not the one of the run"),
    ({"model": 5}, "this result is damaged"),
    ({"rmse": []}, "this result is damaged"),
    ({"data": None}, "this result is damaged"),
    ({"data": {"crs": "EPSG:1"}}, r"result\.json: CRS 'EPSG:1' does not exist"),
    ({"data": {"image_size": "ab"}},
     r"damaged: data.image_size is text, expected a list or null"),
    ({"rmse": {"check": {"total": 1.0, "n": 3}}}, r"damaged: rmse.check lacks 'line'"),
    ({"accuracy": {"image": {"n": 4, "line": 1.0, "sample": 1.0, "total": 1.0, "ce90": 1.0,
                             "maximum": float("inf")}}},
     r"damaged: accuracy.image.maximum is .*, expected a number"),
    # Python 3.13 and later goes deep enough to see the type.
    ({"lookups": 10**6}, "there are more lookups than evaluations"),
    ({"rmse": {role: {"line": 1.0, "sample": 1.0, "total": -2.0, "n": 3}
               for role in ("control", "check", "independent")}},
     r"damaged: rmse.control.total is not a number >= 0.0"),
    ({"options": _nested(600)},
     r"this result is damaged: (it is nested too deeply|options\.problem)"),
    ({"fit": {"estimator": "magic", "options": {}, "effective": None, "held_out": None,
              "features": None}}, "unknown estimator 'magic'"),
    ({"fit": {"estimator": "least-squares", "options": {"steps": 3}, "effective": None,
              "held_out": None, "features": None}}, "cannot be made with the options"),
    ({"fit": {"estimator": "averaging", "options": {}, "effective": 3.0, "held_out": [[0.0, 1.0]],
              "features": None}}, r"fit\.held_out: 1 errors, expected \d+"),
    ({"precision": 1.0}, r"damaged: the file has 'precision', which is not known"),
    ({"precision": 1.0, "versions": {"termsel": "0.1.0.dev7"}},
     r"damaged, or of development code \(0\.1\.0\.dev7\): the file has 'precision'")])
def test_damaged_records_are_refused(change: dict[str, object], message: str, tmp_path: Path,
                                     ) -> None:
    write_result(example_results()[0], tmp_path)
    _damaged(tmp_path, **change)
    with pytest.raises(TermselError, match=message):
        read_result(tmp_path)


@pytest.mark.parametrize("key", [
    ("rmse", "independent", "total"), ("selection", "terms"), ("data", "image_size"), ("seed",),
    ("judgement",), ("baselines",), ("options", "problem", "mask"), ("adjustment", "redundancy"),
    ("versions", "termsel"), ("checksums", "features"), ("checksums",)])
@pytest.mark.parametrize("value", [7.0, "edited", [], None])
def test_nothing_edited_by_hand_is_read(key: tuple[str, ...], value: object, tmp_path: Path,
                                        ) -> None:
    write_result(example_results()[0], tmp_path)
    path = tmp_path / "result.json"
    record = inner = json.loads(path.read_text())
    for one in key[:-1]:
        inner = inner[one]
    assert inner[key[-1]] != value
    inner[key[-1]] = value
    path.write_text(json.dumps(record))
    with pytest.raises(TermselError, match=r"(result\.json|points\.csv): .*(changed|damaged)"):
        read_result(tmp_path)


def test_another_layout_is_no_change_and_other_points_are(tmp_path: Path) -> None:
    write_result(example_results()[0], tmp_path)
    path = tmp_path / "result.json"
    path.write_text(json.dumps(json.loads(path.read_text()), sort_keys=True))
    assert read_result(tmp_path).to_dict() == example_results()[0].to_dict()
    points = tmp_path / "points.csv"
    rows = points.read_text().splitlines()
    at = rows.index(next(row for row in rows if ",check," in row))
    cells = rows[at].split(",")
    cells[2] = str(float(cells[2]) + 0.01)
    points.write_text("\n".join([*rows[:at], ",".join(cells), *rows[at + 1:]]) + "\n")
    with pytest.raises(TermselError, match=r"points\.csv: this file was changed after"):
        read_result(tmp_path)


def test_folders_that_lack_something_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TermselError, match=r"result\.json: there is no result here"):
        read_result(tmp_path)
    write_result(example_results()[0], tmp_path)
    whole = (tmp_path / "result.json").read_text()
    (tmp_path / "result.json").write_text(whole[:500])
    with pytest.raises(TermselError, match=r"result\.json, line \d+: this is not JSON"):
        read_result(tmp_path)
    (tmp_path / "result.json").write_text("[" * 100_000)
    with pytest.raises(TermselError, match="this JSON is nested too deeply"):
        read_result(tmp_path)
    (tmp_path / "result.json").write_text(whole)
    (tmp_path / "points.csv").unlink()
    with pytest.raises(TermselError, match=r"lacks its file points\.csv"):
        read_result(tmp_path)


def test_a_folder_is_used_again_by_a_result_without_lines(of_lines: Result, tmp_path: Path,
                                                          ) -> None:
    _written(of_lines, tmp_path)
    assert _written(example_results()[0], tmp_path).to_json() == example_results()[0].to_json()


def test_changed_lines_are_not_blamed_on_the_points(of_lines: Result, tmp_path: Path) -> None:
    _written(of_lines, tmp_path)
    lines = tmp_path / "lines.csv"
    x = str(float(of_lines.features.lines.ground[0, 0, 0]))
    changed = lines.read_text().replace(x, str(float(x) + 1e-6))
    assert changed != lines.read_text()
    lines.write_text(changed)
    with pytest.raises(TermselError, match=r"points\.csv or lines\.csv: this file was changed"):
        read_result(tmp_path)


@pytest.mark.parametrize("name", ["points.csv", "lines.csv"])
def test_measurements_in_the_folder_of_a_result_are_not_replaced(name: str, tmp_path: Path) -> None:
    own = tmp_path / name
    own.write_text("id,line,sample\n")
    with pytest.raises(TermselError, match="would replace this file"):
        termsel.run("rfm-terms", out=tmp_path)
    assert own.read_text() == "id,line,sample\n"


@pytest.mark.slow
def test_blanks_around_ids_are_no_part_of_them(of_lines: Result, tmp_path: Path) -> None:
    """Files do not hold them, so that the features would not be found again."""
    features = of_lines.features
    spaced = features.with_(
        points=replace(features.points, ids=tuple(f" {i}" for i in features.points.ids)),
        lines=replace(features.lines, ids=tuple(f"{i}\t" for i in features.lines.ids)))
    assert spaced.points.ids == features.points.ids
    assert spaced.lines.ids == features.lines.ids
    result = termsel.run("owdis-lines", features=spaced, generations=1,
                         options={"population": 30, "polish": False})
    assert _written(result, tmp_path).to_json() == result.to_json()
    with pytest.raises(TermselError, match="is used 2 times"):
        replace(features.points, ids=(" P", "P", *features.points.ids[2:]))


def test_a_folder_that_is_not_there_is_to_be_made(tmp_path: Path) -> None:
    result = next(iter(example_results()))
    with pytest.raises(TermselError, match=r"this folder does not exist. Make it before"):
        write_result(result, tmp_path / "none")
