"""Standard deviations that points state count in the choice and in the predicted RMSE."""

from __future__ import annotations

import numpy as np
import pytest

import termsel
from termsel.data.features import FeatureSet, Points
from termsel.fitting.accuracy import weighted_rmse
from termsel.results.accuracy import accuracy_lines


def affine_points(sigmas: np.ndarray, seed: int = 5) -> FeatureSet:
    """Return points of an affine image in a plane, with errors as they state them (n, 2)."""
    rng = np.random.default_rng(seed)
    count = len(sigmas)
    ground = np.column_stack([rng.uniform(0, 4000, (count, 2)), np.full(count, np.nan)])
    image = ground[:, :2] @ np.array([[0.02, 0.21], [-0.2, 0.01]]) + 900.0
    ids = tuple(f"P{i}" for i in range(count))
    return FeatureSet(Points(ids, image + rng.normal(0.0, sigmas), ground, sigma=sigmas),
                      crs="local")


@pytest.fixture(scope="module")
def good_and_rough() -> termsel.Result:
    """Return the result of points of which half are measured within 0.2 px and half within 6 px."""
    return termsel.run(features=affine_points(np.tile([[0.2], [6.0]], (12, 2))))


def test_rough_points_that_say_so_do_not_spoil_the_figure(good_and_rough: termsel.Result) -> None:
    predicted = good_and_rough.predicted
    assert predicted.low < 0.2 * 2 < predicted.high
    assert predicted.rmse < 0.7


def test_the_figure_says_that_it_counts_by_the_stated_sigmas(
        good_and_rough: termsel.Result) -> None:
    assert "by the stated sigmas" in accuracy_lines(good_and_rough)[0]


def test_equal_sigmas_change_no_figure() -> None:
    errors = np.random.default_rng(1).normal(0.0, 1.0, (6, 2))
    points = affine_points(np.full((6, 2), 0.7)).points
    assert weighted_rmse(errors, points) == float(np.sqrt((errors**2).sum(axis=1).mean()))


def test_an_axis_that_is_measured_worse_counts_whole() -> None:
    errors = np.random.default_rng(1).normal(0.0, [0.2, 5.0], (6, 2))
    plain = float(np.sqrt((errors**2).sum(axis=1).mean()))
    alike = affine_points(np.tile([[0.2, 5.0]], (6, 1))).points
    assert weighted_rmse(errors, alike) == plain
    unlike = affine_points(np.array([[0.2, 5.0], [0.4, 10.0]] * 3)).points
    assert weighted_rmse(errors, unlike) > np.abs(errors[:, 1]).min()


def test_a_weighted_rmse_is_that_of_equally_good_points() -> None:
    sigmas = np.tile([[0.5], [2.0]], (3, 2))
    errors = np.ones((6, 2))
    # sum(e^2 / sigma^2) / sum(1 / sigma^2) of equal errors is their square, whatever the sigmas.
    assert weighted_rmse(errors, affine_points(sigmas).points) == pytest.approx(2**0.5)
    assert weighted_rmse(errors * sigmas, affine_points(sigmas).points) == pytest.approx(
        (2 * 2 / (1 / 0.25 + 1 / 4.0))**0.5)
