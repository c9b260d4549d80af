"""Old maps from the command line to grids and maps; blunders on them; and the simulation itself."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel import FeatureSet, FitData, Points
from termsel.testing import invoke
from termsel.toolkit import FloatArray
from termsel.toolkit.models import Auto, find_blunders
from termsel_cameras import maps, simulate_map


def total(errors: FloatArray) -> float:
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def run(*words: str) -> str:
    done = invoke(*words)
    assert done.exit_code == 0, done.output
    return done.output


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run of auto on the embedded map."""
    out = tmp_path_factory.mktemp("map") / "out"
    run("run", "--problem", "poly-terms", "--dataset", "old-map", "--out", str(out), "--quiet")
    return out


def test_auto_takes_a_field_and_reads_it_back(folder: Path) -> None:
    record = json.loads((folder / "result.json").read_text())
    assert record["model"] == "field"
    assert record["strategy"]["chosen"] == "field"
    independent = record["rmse"]["independent"]["total"]
    others = {b["name"]: b["rmse"]["independent"]["total"] for b in record["baselines"]}
    assert independent < 0.8 * others["cubic"]
    assert independent < 1.05 * others["tps"]
    # The field of control and check together, whatever role the features have.
    result = termsel.read_result(folder)
    points = result.features.points
    mine = points.take(np.isin(points.roles, ["control", "check"]))
    fitted = termsel.fit(FeatureSet(replace(mine, roles=()), crs=result.features.crs), "field")
    np.testing.assert_allclose(result.fit.project(points.ground), fitted.project(points.ground),
                               atol=1e-6)
    np.testing.assert_allclose(result.fit.sigma(points.ground), fitted.sigma(points.ground),
                               rtol=1e-6)
    at_independent = points.take(np.array(points.roles) == "independent")
    assert total(result.fit.errors(at_independent)) == pytest.approx(independent)


def test_the_field_leaves_as_grids_and_refuses_what_cannot_hold_it(folder: Path,
                                                                   tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    for to in ("gcp-grid-vrt", "gcp-vrt", "qgis-points", "points-csv"):
        run("export", str(folder), "--to", to, "-o", str(tmp_path / to))
    with rasterio.open(tmp_path / "gcp-grid-vrt") as grid:
        gcps, _ = grid.gcps
    exported = termsel.read_result(folder).as_exported().fit
    assert len(exported.control) == 90  # the field of all points, independent ones included
    ground = np.array([[one.x, one.y, np.nan] for one in gcps])
    # GDAL counts from the corner of a pixel.
    image = np.array([[one.row, one.col] for one in gcps]) - 0.5
    np.testing.assert_allclose(exported.project(ground), image, atol=1e-3)
    refused = invoke("export", folder, "--to", "orthority-geojson", "-o",
                     tmp_path / "x.json")
    assert refused.exit_code == 2
    assert "cannot hold this result" in refused.output
    assert "geolocation-vrt" in refused.output


@pytest.mark.parametrize("model", ["tps", "field"])
def test_a_model_that_is_asked_for_needs_no_search(model: str, tmp_path: Path) -> None:
    said = run("run", "--problem", "poly-terms", "--dataset", "old-map", "--model", model, "--out",
               str(tmp_path / "out"), "--quiet", "--verbose")
    assert "solver all-terms" in said
    record = json.loads((tmp_path / "out" / "result.json").read_text())
    result = termsel.read_result(tmp_path / "out")
    left_out = result.fit.leave_one_out_rmse()
    assert left_out is not None
    assert record["rmse"]["leave-one-out"]["total"] == pytest.approx(left_out.total)
    independent = result.features.points.take(
        np.array(result.features.points.roles) == "independent")
    assert total(result.fit.errors(independent)) == pytest.approx(
        record["rmse"]["independent"]["total"])


def scattered(seed: int, n: int) -> tuple[Points, Points]:
    points = replace(simulate_map(seed=seed, n_points=n + 150, local=8.0).points, roles=())
    order = np.random.default_rng(seed).permutation(len(points))
    return points.take(order[:n]), points.take(order[n:])


@pytest.mark.parametrize("seed", range(3))
def test_local_deformation_is_no_blunder(seed: int) -> None:
    found = find_blunders(FitData.of(FeatureSet(scattered(seed, 60)[0]), False))
    assert found is not None
    assert found.blunders.mean() <= 0.02


@pytest.mark.slow_cases("1", "2")
@pytest.mark.parametrize("seed", range(3))
def test_no_spline_bends_to_a_blunder(seed: int) -> None:
    mine, others = scattered(seed, 60)
    clean = Auto().choose(FitData.of(FeatureSet(mine), False))
    image = mine.image.copy()
    bad = [7, 30]
    image[bad] += [[250.0, -180.0], [-150.0, 300.0]]
    spoilt = replace(mine, image=image)
    found = find_blunders(FitData.of(FeatureSet(spoilt), False))
    assert found is not None
    assert found.blunders[bad].all()
    assert found.blunders.sum() <= 3
    again = Auto().choose(FitData.of(FeatureSet(spoilt.take(~found.blunders)), False))
    assert clean is not None
    assert again is not None
    assert total(again.chosen.errors(others)) < 1.1 * total(clean.chosen.errors(others))


@pytest.mark.slow
def test_independent_points_of_a_map_take_no_part_in_the_choice() -> None:
    features = simulate_map(n_points=45, local=15.0)
    independent = np.array(features.points.roles) == "independent"
    moved = features.points.image + np.where(independent, 40.0, 0.0)[:, None]
    one, other = (termsel.run("poly-terms", features=f) for f in (
        features, features.with_(points=replace(features.points, image=moved))))
    assert one.strategy == other.strategy
    assert one.fit.project(features.points.ground).tolist() == other.fit.project(
        features.points.ground).tolist()


def test_local_deformation_has_the_size_asked_for() -> None:
    places = np.random.default_rng(0).uniform(0, maps.SIZE, (300, 2))
    shifts = [maps._random_shift(np.random.default_rng(seed), 5.0, places) for seed in range(40)]
    assert np.sqrt(np.mean(np.square(shifts))) == pytest.approx(5.0, rel=0.1)


def test_a_sheet_is_shifted_turned_and_scaled() -> None:
    places = np.random.default_rng(0).uniform(0, maps.SIZE, (200, 2))
    shift = maps._shift_by_sheet(np.random.default_rng(1), (2, 2), 6.0, places)
    first = (places < np.array(maps.SIZE) / 2).all(axis=1)
    design = np.column_stack([np.ones(first.sum()), places[first]])
    x, rest = np.linalg.lstsq(design, shift[first])[:2]
    assert rest == pytest.approx(0.0, abs=1e-9)
    assert x[1, 0] == pytest.approx(x[2, 1])
    assert x[1, 1] == pytest.approx(-x[2, 0])
    assert np.abs(x[1:]).min() > 1e-5


def test_the_simulated_map_has_the_parts_it_is_made_of() -> None:
    def left(model: str, **options: object) -> FloatArray:
        scan = simulate_map(seed=4, n_points=200, **options)  # type: ignore[arg-type]
        assert np.isnan(scan.points.ground[:, 2]).all()
        return np.asarray(termsel.fit(FeatureSet(replace(scan.points, roles=()), crs=scan.crs),
                                      model).errors(scan.points))

    flat = {"sheets": (1, 1), "local": 0.0}
    noise = left("poly2d", **flat)
    assert noise.std() == pytest.approx(1.5, rel=0.15)
    # Shrunken paper has two scales, which a similarity has not.
    assert left("helmert2d", **flat).std() > 3 * left("helmert2d", shrinkage=0.0, **flat).std()
    assert left("poly2d", sheets=(1, 1), local=8.0).std() > 1.5 * noise.std()
    assert left("poly2d", local=0.0, joints=10.0).std() > 1.5 * noise.std()
    assert not np.array_equal(simulate_map(seed=1).points.image, simulate_map().points.image)
    with pytest.raises(termsel.TermselError, match="noise = -1"):
        simulate_map(noise=-1.0)
    with pytest.raises(termsel.TermselError, match=r"sheets = \(0, 2\)"):
        simulate_map(sheets=(0, 2))


def test_a_blunder_smaller_than_the_error_of_any_polynomial_is_found() -> None:
    mine, _ = scattered(1, 100)
    polynomial = termsel.fit(FeatureSet(mine), "regularised-cubic").leave_one_out_rmse()
    assert polynomial is not None
    middle = int(np.argmin(np.linalg.norm(mine.image - [3000, 4000], axis=1)))
    image = mine.image.copy()
    image[middle] += 3 * polynomial.line
    found = find_blunders(FitData.of(FeatureSet(replace(mine, image=image)), False))
    assert found is not None
    assert found.blunders.tolist() == [i == middle for i in range(100)]
