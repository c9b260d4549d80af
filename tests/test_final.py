"""The fit to all points, which is exported, and the fit without the independent ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import termsel
from termsel.cli.main import cli
from termsel.measurements.features import FeatureSet
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


@pytest.mark.slow
def test_final_fit_is_of_all_points_and_nearer_to_the_truth() -> None:
    gains = []
    for seed in range(4):
        found = termsel.run("rfm-terms", features=_features(seed))
        assert found.final is not None
        assert set(found.final.control.ids) == set(found.features.points.ids)
        gains.append(_error(found.as_exported(), seed) / _error(found, seed))
    assert np.mean(gains) < 0.95


def test_figures_are_of_the_fit_without_independent_points(result: Result) -> None:
    points = result.features.points
    independent = points.take([role == "independent" for role in points.roles])
    assert result.rmse["independent"] == result.fit.rmse(independent)
    assert result.as_exported().rmse["independent"] == result.rmse["independent"]


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
    with pytest.raises(termsel.TermselError, match="no final fit"):
        found.as_exported(True)


def test_without_independent_points_there_is_one_fit() -> None:
    features = _features(n=20)
    points = replace(features.points, roles=("control",) * 20)
    found = termsel.run("rfm-terms", features=features.with_(points=points))
    assert found.final is None
    assert found.to_dict()["final"] is None


@pytest.mark.parametrize(("option", "words"), [
    ((), "all 42 points"), (("--final",), "all 42 points"), (("--no-final",), "without")])
def test_export_and_project_take_the_same_fit_and_say_which(
        result: Result, folder: Path, tmp_path: Path, option: tuple[str, ...],
        words: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "termsel")
    expected = result if option == ("--no-final",) else result.as_exported()
    rpc, runner = tmp_path / "a_RPC.TXT", CliRunner()
    done = runner.invoke(cli, ["export", str(folder), "--to", "rpc-txt", "-o", str(rpc), *option])
    assert done.exit_code == 0
    ground = result.features.points.ground
    np.testing.assert_allclose(termsel.read_rpc(rpc).project(ground), expected.project(ground),
                               atol=1e-3)
    table = tmp_path / "t.csv"
    done = runner.invoke(cli, ["project", str(folder), "--points", str(folder / "points.csv"),
                                "-o", str(table), *option])
    assert done.exit_code == 0
    rows = [line.split(",") for line in table.read_text().splitlines()[2:]]
    np.testing.assert_allclose(np.array([[float(cell) for cell in row[1:3]] for row in rows]),
                               expected.project(ground), rtol=1e-12)
    assert caplog.text.count(words) >= 2


def test_summary_says_what_is_exported(result: Result) -> None:
    assert "Exported: the same structure fitted to all 42 points; --no-final" in result.summary()
    assert "Exported" not in result.as_exported(final=True).summary()
