"""Few points in a plane: the average over a similarity, what paper adds to it, and curvature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import termsel
from termsel.adjustment.bayesian.field import fit_gaussian_process
from termsel.auto.methods import named
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.data.fit_data import FitData
from termsel.fitting.fit import Fit

PLACES = 60


def sheet(n: int, seed: int, *, stretch: float = 0.01, bend: float = 0.0, noise: float = 3.0,
          ) -> tuple[FeatureSet, FloatArray, FloatArray]:
    """Points of a sheet, and further places with where they are seen, without noise."""
    rng = np.random.default_rng([n, seed])
    plan = rng.uniform(0.0, 5000.0, (n + PLACES, 2))
    ground = np.column_stack([plan, np.full(n + PLACES, np.nan)])
    turn = rng.uniform(-0.3, 0.3)
    turned = 0.5 * plan @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    turned *= 1.0 + rng.normal(0.0, stretch, 2)
    turned[:, 0] += bend * (plan[:, 0] / 2500.0 - 1.0)**2
    image = np.column_stack([2500.0 - turned[:, 1], turned[:, 0]])
    measured = image[:n] + rng.normal(0.0, noise, (n, 2))
    points = Points(tuple(f"P{i}" for i in range(n)), measured, ground[:n])
    return FeatureSet(points, crs="local"), ground[n:], image[n:]


def average(features: FeatureSet) -> Fit:
    return named("field").fit(FitData.of(features))


def rms(errors: FloatArray) -> float:
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def collocation(features: FeatureSet, ground: FloatArray) -> FloatArray:
    """Return what is predicted by a field that knows of no similarity."""
    data = FitData.of(features)
    process = fit_gaussian_process(data.scaled.points, 2)
    assert process is not None
    return data.scaling.pixels(process.predict(data.scaling.ground(ground)))


@pytest.mark.parametrize(("stretch", "noise", "limit"), [(0.0, 20.0, 0.95), (0.02, 0.5, 1.03)])
def test_it_gains_where_noise_hides_what_paper_does_and_loses_nothing_elsewhere(
        stretch: float, noise: float, limit: float) -> None:
    ratios = []
    for seed in range(16):
        features, ground, image = sheet(7, seed, stretch=stretch, noise=noise)
        ratios.append(rms(average(features).project(ground) - image)
                      / rms(collocation(features, ground) - image))
    assert np.exp(np.mean(np.log(ratios))) < limit


def test_a_bend_that_few_points_show_is_followed() -> None:
    features, ground, image = sheet(11, 3, bend=60.0, noise=0.5)
    by_average = rms(average(features).project(ground) - image)
    assert by_average < 0.3 * rms(named("affine").fit(FitData.of(features)).project(ground) - image)


def test_errors_held_out_are_those_of_fits_without_each_point() -> None:
    features, _, _ = sheet(12, 1, bend=20.0)
    points = features.points
    held_out = np.sqrt(average(features).held_out().squares)
    alone = np.empty(len(points))
    for i in range(len(points)):
        others = features.take(np.arange(len(points)) != i)
        error = average(others).errors(points.take(np.arange(len(points)) == i))
        alone[i] = np.hypot(*error[0])
    # The scaling changes without a point on the edge, and so does what a spline bends about.
    assert rms((held_out - alone)[:, None]) < 0.15 * rms(alone[:, None])


def test_it_turns_and_mirrors_with_the_image() -> None:
    features, ground, _ = sheet(8, 5, bend=20.0)
    points = features.points
    seen = average(features).project(ground)
    quarter_turn = features.with_(points=replace(points, image=points.image[:, ::-1] * [-1.0, 1.0]))
    assert average(quarter_turn).project(ground) == pytest.approx(seen[:, ::-1] * [-1.0, 1.0])
    mirrored = features.with_(points=replace(points, image=points.image * [1.0, -1.0]))
    assert average(mirrored).project(ground) == pytest.approx(seen * [1.0, -1.0])


def test_a_point_measured_far_worse_hardly_counts() -> None:
    features, ground, _ = sheet(9, 2)
    points = features.points
    sigma = np.ones((9, 2))
    sigma[4] = [1.0, 1e4]
    moved = points.image.copy()
    moved[4, 1] += 300.0
    rough = features.with_(points=replace(points, image=moved, sigma=sigma))
    fine = features.with_(points=replace(points, sigma=sigma))
    difference = average(rough).project(ground) - average(fine).project(ground)
    assert rms(difference) < 1.0


@pytest.mark.parametrize("n", [5, 7, 10])
def test_its_own_spread_is_that_of_its_errors(n: int) -> None:
    inside = []
    for seed in range(30):
        features, ground, image = sheet(n, seed, stretch=0.007)
        fitted = average(features)
        spread = fitted.estimator.spread(fitted, fitted.scaling.ground(ground))
        bound = 1.645 * np.sqrt(spread.variance) * fitted.scaling.image_scale
        inside.append(np.abs(fitted.project(ground) - image) < bound)
    assert 0.82 < np.mean(inside) < 0.99


def test_points_in_a_row_determine_none() -> None:
    features, _, _ = sheet(6, 1)
    points = features.points
    row = points.ground.copy()
    row[:, 1] = 2.0 * row[:, 0]
    with pytest.raises(termsel.TermselError, match="too few, or lie in a row"):
        average(features.with_(points=replace(points, ground=row)))


def test_exact_points_are_met() -> None:
    features, ground, image = sheet(8, 4, noise=0.0)
    assert rms(average(features).project(ground) - image) < 1e-3
