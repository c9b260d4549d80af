"""The predicted RMSE and its interval, and the accuracy in px, in metres and by standards."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from scipy import stats

import termsel
from termsel.adjustment.bayesian.posterior import PRIOR_SIZES, solve_posterior
from termsel.auto.auto import Auto
from termsel.data.coordinates.metres import offsets_in_metres
from termsel.data.features import FeatureSet, Points
from termsel.data.fit_data import FitData
from termsel.data.monomials import evaluate_monomials, graded_exponents
from termsel.data.record.figures import InImage, OnGround, rmse_interval
from termsel.data.scaling import make_scaling
from termsel.fitting.accuracy import (
    accuracy_of,
    asprs_rmse,
    distance_figures,
    nssda_accuracy,
    predict_rmse,
    predict_rmse_of_fit,
)
from termsel.fitting.residuals import freedom_of, rmse_of
from termsel.fitting.uncertainty import _Belief, shared_variance
from termsel.models.polynomial import Polynomial3D
from termsel.simulate import simulate_scene


def _all_points(name: str = "irs1c-mashad", independent: int = 26, **changes: int) -> FeatureSet:
    points = simulate_scene(name, n_points=40 + independent, **changes).points
    roles = ("control",) * 40 + ("independent",) * independent
    return FeatureSet(replace(points, roles=roles), crs="EPSG:4979", image_size=(4000, 4000))


def _errors(n: int, effective: float, rng: np.random.Generator) -> tuple[float, float, float]:
    """Return ends of an interval, and the RMSE of points to come, for independent errors."""
    found = predict_rmse(rng.standard_normal((n, 2)), effective, 15)
    to_come = (rng.standard_normal((15, 2)) ** 2).sum(axis=1)
    return found.low, float(np.sqrt(to_come.mean())), found.high


def test_interval_of_errors_without_a_fit_holds_nine_in_ten() -> None:
    rng = np.random.default_rng(0)
    held = [low <= rmse <= high for low, rmse, high in (_errors(20, 0.0, rng) for _ in range(600))]
    assert 0.85 <= np.mean(held) <= 0.95


def test_interval_is_wider_for_fewer_points_more_parameters_and_heavier_tails() -> None:
    rng = np.random.default_rng(1)
    errors = rng.standard_normal((40, 2))

    def width(errors: np.ndarray, effective: float, points: int,
              shared: float | None = None) -> float:
        found = predict_rmse(errors, effective, points, shared)
        return found.high / found.low

    usual = width(errors, 12.0, 100)
    assert width(errors[:20], 12.0, 100) > 1.3 * usual
    assert width(errors, 60.0, 100) > 1.3 * usual
    assert width(errors, 12.0, 100, shared=0.2) > 1.3 * usual
    assert width(errors, 12.0, 8) > 1.3 * usual
    assert width(errors * np.where(np.arange(40) % 8, 1.0, 6.0)[:, None], 12.0, 100) > 1.3 * usual
    assert width(errors, 12.0, 0) < usual


@pytest.mark.parametrize("effective", [60.0, 78.0, 79.9, 300.0])
def test_interval_of_a_field_near_interpolation_holds_the_predicted_rmse(effective: float) -> None:
    errors = np.random.default_rng(2).standard_normal((40, 2))
    before, found = predict_rmse(errors, 40.0, 24), predict_rmse(errors, effective, 24)
    assert found.low < before.low < found.rmse < before.high < found.high


def _scaled(features: FeatureSet) -> FeatureSet:
    return make_scaling(features).features(features)


def test_interval_without_parameters_is_that_of_normal_errors() -> None:
    """Those of 40 points have chi-squared distributed squares."""
    errors = np.ones((40, 2)) / np.sqrt(2)  # alike, so that normal ones are more spread
    found = predict_rmse(errors, 0.0, 0)
    low, high = rmse_interval(1.0, 80)
    assert found.low == pytest.approx(low, rel=0.04)
    assert found.high == pytest.approx(high, rel=0.04)


def test_an_interval_that_nothing_bounds_ends_where_the_quantile_does() -> None:
    # The largest factor between prediction and upper end is exp(q^2 / 2).
    errors = np.random.default_rng(4).standard_normal((3, 2))
    found = predict_rmse(errors, 5.9, 1, shared=1e6)
    quantile = float(stats.t.ppf(0.95, 2.0))
    assert found.rmse == pytest.approx(np.sqrt((errors**2).sum(axis=1).mean()))
    assert found.high == pytest.approx(found.rmse * np.exp(quantile**2 / 2))
    assert found.low == pytest.approx(found.rmse * np.exp(-1.5 * quantile**2))


def test_what_places_have_in_common_falls_with_points_and_is_unknown_with_lines() -> None:
    shared = []
    for count in (10, 20, 60):
        points = simulate_scene("spot-isfahan", n_points=count).points
        shared.append(shared_variance(Polynomial3D(degree=3), _scaled(FeatureSet(points))))
    assert shared[0] > 2 * shared[1] > 4 * shared[2] > 0
    lines = simulate_scene("ikonos-hamedan", n_lines=6)
    assert shared_variance(Polynomial3D(degree=3), _scaled(lines)) is None


def test_solutions_that_differ_in_their_errors_contest_each_other() -> None:
    """By the hat matrices of ridge regressions, one for each size of line and of sample."""
    rng = np.random.default_rng(0)
    columns = evaluate_monomials(
        np.column_stack([rng.uniform(-1, 1, (9, 2)), np.zeros(9)]), graded_exponents(2, 2))
    image = columns @ rng.standard_normal((6, 2)) + 0.3 * rng.standard_normal((9, 2))
    weights, scales = rng.uniform(0.5, 2, (9, 2)), np.array([[1.0, 0.3, 2.0]])
    found = solve_posterior(columns, image, np.array([0, 1, 1, 2, 2, 2]), weights, scales, 9)
    assert found is not None

    def figures(axis: int, size: float) -> tuple[float, float]:
        rows = columns * weights[:, axis, None]
        prior = np.diag(np.concatenate([np.zeros(3), 1 / (size * scales[0]) ** 2]))
        left = np.eye(9) - rows @ np.linalg.solve(rows.T @ rows + prior, rows.T)
        target = image[:, axis] * weights[:, axis]
        return target @ left @ target, float(np.mean(
            1 / np.diag(left) / weights[:, axis] ** 2))

    known = [[figures(axis, size) for size in PRIOR_SIZES[1:]] for axis in (0, 1)]
    logs = np.array([np.log((known[0][i - 1][0] + known[1][j - 1][0])
                            * (known[0][i - 1][1] + known[1][j - 1][1]))
                     for i, j in zip(*found.cells.solutions, strict=True)])
    mean = np.average(logs, weights=found.cells.share)
    expected = np.average((logs - mean) ** 2, weights=found.cells.share)
    assert expected > 1e-3
    assert _Belief(found, 2, 2).contest(weights) == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
def test_interval_of_simulated_scenes_holds_the_independent_rmse() -> None:
    """Fewer than 9 of 12 would have a chance of 3 % if the true share is 90 %."""
    held = 0
    for seed in range(12):
        points = simulate_scene("spot-isfahan", seed=200 + seed, n_points=112).points
        order = np.random.default_rng(seed).permutation(112)
        control = FeatureSet(points.take(order[:12]))
        data = FitData.of(control, True)
        choice = Auto().choose(data)
        errors = Auto().repeated(data)
        assert choice is not None
        assert errors is not None
        fitted = choice.chosen
        found = predict_rmse_of_fit(fitted, errors, 100)
        independent = fitted.rmse(points.take(order[12:]))
        assert independent is not None
        held += found.low <= independent.total <= found.high
    assert 9 <= held <= 12


@pytest.mark.slow
def test_interval_does_not_look_at_what_independent_points_measure() -> None:
    features = _all_points()
    image = features.points.image.copy()
    image[40:] += np.random.default_rng(0).normal(0, 50, (26, 2))
    moved = features.with_(points=replace(features.points, image=image))
    one, other = (termsel.run("rfm-terms", features=part) for part in (features, moved))
    assert one.predicted == other.predicted
    assert one.accuracy != other.accuracy


@pytest.mark.slow
def test_record_and_folder_hold_prediction_and_accuracy(tmp_path: Path) -> None:
    result = termsel.run("rfm-terms", features=_all_points(), out=tmp_path / "r")
    record = result.to_dict()
    assert set(record["predicted"]) == {"rmse", "low", "high", "level", "points"}
    assert record["predicted"]["rmse"] == record["strategy"]["predicted"]
    assert record["accuracy"]["image"]["total"] == record["rmse"]["independent"]["total"]
    back = termsel.read_result(tmp_path / "r")
    assert back.predicted == result.predicted
    assert back.accuracy == result.accuracy
    text = result.summary(verbose=True)
    assert "90 % interval" in text
    assert "Predicted RMSE at 26 independent check points" in text


@pytest.mark.slow
def test_without_independent_points_the_interval_is_for_the_true_accuracy() -> None:
    features = _all_points(independent=0)
    result = termsel.run("rfm-terms", features=features)
    assert result.accuracy is None
    assert result.predicted is not None
    assert result.predicted.points is None
    assert "Predicted RMSE of new points within the control area" in result.summary(verbose=True)


def test_a_search_has_accuracy_and_no_prediction() -> None:
    result = termsel.run("rfm-terms", features=_all_points(), solver="all-terms", model="affine",
                         criterion="press")
    assert result.predicted is None
    assert result.accuracy is not None


@pytest.mark.parametrize("n", [8, 11, 12, 40, 5000])
def test_mean_errors_and_normality_are_those_of_scipy(n: int) -> None:
    rng = np.random.default_rng(3)
    errors = np.stack([rng.standard_normal(n) + 0.5, rng.standard_cauchy(n)], axis=1)
    found = distance_figures(InImage, errors)
    assert found.mean == pytest.approx(errors.mean(axis=0))
    assert found.normal == pytest.approx([stats.shapiro(column).pvalue for column in errors.T],
                                         rel=1e-4)
    assert found.normal is not None
    assert found.normal[1] < 0.01 < found.normal[0] or n < 40


@pytest.mark.parametrize("errors", [np.random.default_rng(1).standard_normal((7, 2)),
                                    np.ones((20, 2)), np.zeros((20, 2))])
def test_few_or_equal_errors_have_no_test_of_normality(errors: np.ndarray) -> None:
    assert distance_figures(InImage, errors).normal is None


def test_the_summary_tells_a_mean_error_and_errors_that_are_not_normal() -> None:
    result = termsel.run("poly-terms", solver="all-terms", options={"degree": 2})
    assert result.accuracy is not None

    def said(**image: tuple[float, float]) -> str:
        accuracy = structs.replace(result.accuracy, image=structs.replace(
            result.accuracy.image, line=1.0, sample=1.0, **image))
        return " ".join(result.with_(accuracy=accuracy).summary(verbose=True).split())

    usual = said(mean=(0.1, -0.1), normal=(0.4, 0.3))
    assert "is significant" not in usual
    assert "not normal" not in usual
    assert "The bias of sample is significant." in said(mean=(0.1, -0.9), normal=(0.4, 0.3))
    # As many digits as the RMSE above it.
    assert "Mean error: line +0.10 px, sample -0.90 px." in said(
        mean=(0.1, -0.9), normal=(0.4, 0.3))
    assert "errors are not normal" in said(mean=(0.1, 0.1), normal=(0.4, 0.001))


def test_figures_of_known_errors() -> None:
    errors = np.array([[3.0, 4.0]] + [[0.0, 1.0]] * 9)
    found = distance_figures(InImage, errors)
    assert found.n == 10
    assert found.line == pytest.approx(np.sqrt(0.9))
    assert found.sample == pytest.approx(np.sqrt(2.5))
    assert found.total == pytest.approx(np.sqrt(3.4))
    assert found.maximum == 5.0
    assert found.ce90 == termsel.ce90(errors) == pytest.approx(1.4)


@pytest.mark.slow
def test_accuracy_on_the_ground_is_that_in_the_image_by_the_size_of_a_pixel() -> None:
    features = _all_points()  # 5.8 m, seen at 15 degrees from the vertical
    result = termsel.run("rfm-terms", features=features)
    assert result.accuracy is not None
    assert result.accuracy.ground is not None
    assert 5.3 < result.accuracy.ground.total / result.accuracy.image.total < 6.6


def test_metres_of_degrees_of_feet_and_of_nothing() -> None:
    pytest.importorskip("pyproj")
    geod = __import__("pyproj").Geod(ellps="WGS84")
    place = np.array([[59.6, 36.3, 1000.0]])
    azimuth, _, distance = geod.inv(59.6, 36.3, 59.601, 36.3005)
    expected = distance * np.array([np.sin(np.radians(azimuth)), np.cos(np.radians(azimuth))])
    found = offsets_in_metres("EPSG:4979", place, np.array([[0.001, 0.0005]]))
    assert found is not None
    np.testing.assert_allclose(found[0], expected, rtol=1e-4)
    turned = offsets_in_metres("EPSG:4979", place, np.array([[0.001 - 360, 0.0005]]))
    np.testing.assert_allclose(turned, found, rtol=1e-6)
    feet = offsets_in_metres("EPSG:2229", place, np.array([[1.0, 0.0]]))
    assert feet is not None
    assert feet[0, 0] == pytest.approx(0.3048, rel=1e-4)
    assert offsets_in_metres("local", place, np.array([[1.0, 0.0]])) is None
    assert offsets_in_metres("EPSG:4978", place, np.array([[1.0, 0.0]])) is None


def _of(x: float, y: float) -> OnGround:
    return OnGround(x=x, y=y, n=30, total=float(np.hypot(x, y)), maximum=3 * x, ce90=2 * x)


def test_standards_have_figures_only_where_their_rules_hold() -> None:
    assert nssda_accuracy(
        20, _of(2.0, 2.0)).value == pytest.approx(1.7308 * np.hypot(2.0, 2.0), rel=1e-4)
    assert nssda_accuracy(20, _of(1.5, 2.0)).value == pytest.approx(2.4477 * 1.75)
    assert asprs_rmse(30, _of(1.5, 2.0)).value == pytest.approx(2.5)
    for found, words in ((nssda_accuracy(19, _of(2.0, 2.0)), "at least 20"),
                         (asprs_rmse(29, _of(2.0, 2.0)), "at least 30"),
                         (nssda_accuracy(25, None), "metres"), (asprs_rmse(30, None), "metres"),
                         (nssda_accuracy(25, _of(1.0, 2.0)), "one axis is below 0.6")):
        assert found.value is None
        assert words in (found.reason or "")


@pytest.mark.slow
def test_the_summary_says_why_a_standard_has_no_figure() -> None:
    text = termsel.run("rfm-terms", features=_all_points(independent=10)).summary(verbose=True)
    assert "NSSDA: no figure (10 independent check points, at least 20 needed)" in text
    assert "ASPRS 2024: no figure (10 independent check points, at least 30 needed" in text


@pytest.mark.slow
def test_local_coordinates_have_no_metres() -> None:
    features = _all_points()
    result = termsel.run("rfm-terms", features=replace(features, crs="local"))
    assert result.accuracy is not None
    assert result.accuracy.ground is None
    assert "NSSDA: no figure (the errors on the ground are not known in metres)" \
        in result.summary(verbose=True)


def test_a_plane_model_is_judged_on_the_ground_too() -> None:
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(5e5, 5.1e5, (40, 2)), np.full(40, np.nan)])
    ground[:, 1] += 4e6
    image = (ground[:, 1::-1] - [4.5e6, 5e5]) / [-5.0, 5.0] + rng.normal(0, 0.5, (40, 2))
    roles = ("control",) * 20 + ("independent",) * 20
    features = FeatureSet(Points(tuple(f"P{i}" for i in range(40)), image, ground, None, roles),
                          crs="EPSG:32631")
    fitted = termsel.fit(features, "poly2d", degree=1)
    found = accuracy_of(fitted, features.points.take(np.arange(40) >= 20))
    assert found is not None
    assert found.ground is not None
    assert found.ground.total == pytest.approx(5 * found.image.total, rel=0.05)


def test_figures_of_standards_are_written_as_all_distances() -> None:
    rng = np.random.default_rng(4)
    ground = np.column_stack([rng.uniform(0, 60000, (60, 2)), np.zeros(60)])
    image = ground[:, [1, 0]] + rng.normal(0, 2000, (60, 2))
    features = FeatureSet(Points(
        tuple(f"P{i}" for i in range(60)), image, ground + np.array([4e5, 5e6, 0.0]),
        roles=("control",) * 28 + ("independent",) * 32), crs="EPSG:32631")
    text = termsel.run("poly-terms", features=features, model="affine", solver="all-terms",
                       criterion="press").summary(verbose=True)
    assert re.search(r"NSSDA: \d,\d{3} m, ", text)
    assert re.search(r"ASPRS 2024: \d,\d{3} m, ", text)


def test_the_interval_of_an_rmse_is_that_of_chi_squared() -> None:
    low, high = rmse_interval(2.0, 30)
    assert low == pytest.approx(2 * np.sqrt(30 / stats.chi2.ppf(0.95, 30)))
    assert high == pytest.approx(2 * np.sqrt(30 / stats.chi2.ppf(0.05, 30)))


@pytest.mark.parametrize("kind", ["alike", "one axis", "heavy tails", "equal axes"])
def test_the_interval_covers_the_rmse_as_often_as_it_says(kind: str) -> None:
    rng = np.random.default_rng(1)
    errors = rng.normal(size=(2000, 26, 2))
    if kind == "one axis":
        errors *= [1.0, 4.0]
    elif kind == "heavy tails":
        errors *= np.sqrt(rng.exponential(size=(2000, 26, 1)))
    elif kind == "equal axes":
        errors[..., 1] = errors[..., 0]
    truth, inside = np.sqrt((errors**2).sum(axis=2).mean()), []
    for some in errors:
        found = rmse_of(some, len(some))
        assert found is not None
        assert found.freedom is not None
        low, high = rmse_interval(found.total, found.freedom)
        inside.append(low <= truth <= high)
    assert 0.85 <= np.mean(inside) <= 0.94


@pytest.mark.parametrize(("errors", "freedom"), [
    ([[3.0, 4.0]], 25.0**2 / (9.0**2 + 16.0**2)),        # one point: by its axes
    ([[1.0, 1.0], [1.0, 1.0]], 4.0),                      # two of each
    ([[0.0, 2.0], [0.0, 2.0]], 2.0),                      # one axis alone
    ([[2.0, 2.0], [0.0, 0.0]], 2 * 4.0**2 / (8.0**2 / 4)),  # squared distances of 8 and 0
    ([[0.0, 0.0]], None), ([[np.inf, 0.0]], None), ([[1e200, 0.0]], None),
    ([[1e80, 1e80], [1e80, 1e80]], 4.0), ([[1e-100, 0.0]], 1.0)])
def test_degrees_of_freedom_by_hand(errors: list[list[float]], freedom: float | None) -> None:
    assert freedom_of(np.array(errors)) == (
        None if freedom is None else pytest.approx(freedom))
