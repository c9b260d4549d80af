"""The fit to all points, which is exported, and the fit without the independent ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import termsel
from termsel.cli.main import cli
from termsel.data.coordinates.crs import to_wgs84
from termsel.data.features import FeatureSet
from termsel.io.accuracy_tags import prediction_of
from termsel.results.result import Result
from termsel.simulate import scene_truth, simulate_scene


def _features(seed: int = 0, n: int = 42) -> FeatureSet:
    points = simulate_scene("irs1c-mashad", seed=seed, n_points=n).points
    return FeatureSet(points, crs="EPSG:4979", image_size=(4000, 4000), noise=0.5)


@pytest.fixture(scope="module")
def result() -> Result:
    return termsel.run("rfm-terms", features=_features())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("final") / "r"
    termsel.run("rfm-terms", features=_features(), out=path)
    return path


def _error(result: Result, seed: int) -> float:
    """Return the RMSE against the true sensor."""
    ground = simulate_scene("irs1c-mashad", seed=99, n_points=200).points.ground
    truth = scene_truth("irs1c-mashad", seed=seed).sensor.project(ground)
    return float(np.sqrt(((result.project(ground) - truth) ** 2).sum(axis=1).mean()))


def test_what_is_predicted_of_the_final_fit_is_stated_of_the_points_it_was_found_from(
        result: Result) -> None:
    exported = result.as_exported()
    assert result.final_fit is not None
    assert exported.predicted == result.final_fit.predicted
    stated = [prediction_of(either) for either in (result, exported)]
    count = len(result.data.roles.control) + len(result.data.roles.check)
    assert len(result.fit.control.points) < count < len(exported.fit.control.points)
    for prediction in stated:
        assert prediction is not None
        assert f"without some of the {count} control points" in prediction.method
        assert prediction.rmse == result.final_fit.predicted.rmse


@pytest.mark.slow
def test_final_fit_is_of_all_points_and_nearer_to_the_truth() -> None:
    gains = []
    for seed in range(4):
        found = termsel.run("rfm-terms", features=_features(seed))
        assert found.final is not None
        assert set(found.final.control.ids) == set(found.features.points.ids)
        gains.append(_error(found, seed) / _error(found.as_exported(False), seed))
    assert np.mean(gains) < 0.95


def test_figures_are_of_the_fit_without_independent_points(result: Result) -> None:
    points = result.features.points
    independent = points.take([role == "independent" for role in points.roles])
    assert result.rmse["independent"] == result.fit.rmse(independent)
    assert result.as_exported().rmse["independent"] == result.rmse["independent"]


@pytest.mark.slow
def test_independent_points_change_the_final_fit_alone(result: Result) -> None:
    features = _features()
    is_independent = np.array([role == "independent" for role in features.points.roles])
    image = features.points.image + 0.8 * is_independent[:, None]
    moved = termsel.run("rfm-terms", features=features.with_(
        points=replace(features.points, image=image)))
    assert moved.fit.coefficients == result.fit.coefficients
    assert moved.final is not None
    assert result.final is not None
    assert moved.final.coefficients != result.final.coefficients


@pytest.mark.slow
def test_an_independent_blunder_stays_out_of_the_final_fit() -> None:
    features = _features()
    wrong = features.points.roles.index("independent")
    image = features.points.image.copy()
    image[wrong] += 80
    found = termsel.run("rfm-terms", features=features.with_(
        points=replace(features.points, image=image)))
    assert [one.id for one in found.outliers] == [features.points.ids[wrong]]
    assert found.final is not None
    assert features.points.ids[wrong] not in found.final.control.ids
    assert len(found.final.control) == len(features.points) - 1
    # Exports write points in use as control for other programs.
    unused = {one.id for one in found.as_exported().residuals if not one.used}
    assert unused == {features.points.ids[wrong]}


def test_read_back_it_is_the_same(result: Result, folder: Path) -> None:
    back = termsel.read_result(folder)
    assert result.to_dict()["exported"] == back.to_dict()["exported"] == "final"
    assert back.to_dict()["final"] == result.to_dict()["final"]
    ground = result.features.points.ground[:6]
    for one, other in ((result.as_exported(), back.as_exported()), (result, back)):
        np.testing.assert_allclose(other.project(ground), one.project(ground), rtol=1e-12)
        np.testing.assert_allclose(other.sigma(ground), one.sigma(ground), rtol=1e-4)


def test_a_search_has_no_final_fit() -> None:
    found = termsel.run("rfm-terms", features=_features(), solver="all-terms", model="affine",
                        criterion="press")
    assert found.final is None
    assert found.to_dict()["exported"] == "selection"
    assert found.as_exported() is found
    with pytest.raises(termsel.TermselError, match="no fit to all points"):
        found.as_exported(True)


@pytest.mark.slow
def test_without_independent_points_there_is_one_fit() -> None:
    features = _features(n=20)
    points = replace(features.points, roles=("control",) * 20)
    found = termsel.run("rfm-terms", features=features.with_(points=points))
    assert found.final is None
    assert found.to_dict()["final"] is None


@pytest.fixture(scope="module")
def plane(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    """Return a result of an image whose values are its lines and samples, and its folder.

    Its independent points are measured 2 px off, so that the two fits are far apart.
    """
    import rasterio

    folder = tmp_path_factory.mktemp("plane")
    rng, size = np.random.default_rng(5), (240, 200)
    with rasterio.open(folder / "s.tif", "w", driver="GTiff", width=size[1], height=size[0],
                       count=2, dtype="float32") as raster:
        raster.write(np.indices(size).astype("float32"))
    image = rng.uniform(4, [size[0] - 5, size[1] - 5], (40, 2))
    ground = np.column_stack([250000 + 10 * image[:, 1], 3850000 - 10 * image[:, 0], [0.0] * 40])
    role = ("control", "control", "independent", "independent")
    shift = np.array([name == "independent" for name in role * 10])[:, None] * [1.6, 1.2]
    points = termsel.Points(tuple(map(str, range(40))),
                            image + shift + rng.normal(0, 0.3, (40, 2)), ground, roles=role * 10)
    features = FeatureSet(points, crs="EPSG:32639", image_size=size)
    return termsel.run("poly-terms", features=features, out=folder / "r"), folder


@pytest.mark.parametrize(("option", "final", "words"), [
    ((), None, "all 40 points"), (("--final",), True, "all 40 points"),
    (("--no-final",), False, "without the independent check points")])
def test_all_that_uses_a_result_takes_the_same_fit_and_says_which(
        plane: tuple[Result, Path], tmp_path: Path, option: tuple[str, ...], final: bool | None,
        words: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "termsel")
    result, folder = plane

    def call(name: str, *words: str) -> Path:
        target = tmp_path / words[-1]
        done = CliRunner().invoke(
            cli, [name, str(folder / "r"), *words[:-1], "-o", str(target), *option])
        assert done.exit_code == 0, done.output
        return target

    def columns(table: Path, *names: str) -> np.ndarray:
        header, *rows = [one.split(",") for one in table.read_text().splitlines()[1:]]
        return np.array([[float(row[header.index(name)]) for name in names] for row in rows])

    ground, image = result.features.points.ground, result.features.points.image
    used = result.as_exported(final)
    assert result.final is not None
    fitted = result.fit if final is False else result.final
    assert np.abs(result.fit.project(ground) - result.final.project(ground)).mean() > 0.3
    expected, degrees = fitted.project(ground), to_wgs84("EPSG:32639")(ground)
    there = call("project", "--points", str(folder / "r/points.csv"), "t.csv")
    back = call("project", "--inverse", "--points", str(folder / "r/points.csv"), "b.csv")
    rpc = termsel.read_rpc(call("export", "--to", "rpc-txt", "a_RPC.TXT"))
    for found, wanted, within in (
            (used.project(ground), expected, 0),
            (used.sigma(ground), fitted.sigma(ground), 0),
            (used.locate(image, 0.0), fitted.locate(image, 0.0), 0),
            (used.to_rpc().project(degrees), expected, 0.01),
            (rpc.project(degrees), expected, 0.01),
            (columns(there, "line", "sample"), expected, 1e-6),
            (columns(back, "x", "y"), fitted.locate(image, 0.0)[:, :2], 1e-3)):
        np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=within)
    if final is not False:
        np.testing.assert_array_equal(result.project(ground), expected)
    map_ = call("rectify", str(folder / "s.tif"), "--res", "10", "--resampling", "bilinear",
                "m.tif")
    import rasterio

    with rasterio.open(map_) as raster:
        centres = np.array([raster.xy(*raster.index(x, y)) for x, y, _ in ground.tolist()])
        seen = np.array(list(raster.sample(centres)))
    centres = np.column_stack([centres, ground[:, 2]])
    np.testing.assert_allclose(seen, fitted.project(centres), atol=0.15)
    assert caplog.text.count(words) == 4  # project twice, export, rectify


def test_summary_says_what_is_exported(result: Result) -> None:
    assert "Exported: the refit to all 42 points." in result.summary(verbose=True)
    assert "Exported" not in result.as_exported(final=True).summary(verbose=True)
