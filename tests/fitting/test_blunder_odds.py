"""Which points are likelier blunders than right, by what all others predict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp

from termsel import FeatureSet, Lines, Points
from termsel.adjustment.bayesian.field import (
    BLUNDER_SIZES,
    FIELD_VARIANCE_FACTOR,
    blunder_odds,
)
from termsel.adjustment.bayesian.posterior import Posterior, solve_posterior
from termsel.auto.blunders import find_blunders
from termsel.data.features import FloatArray, empty_lines
from termsel.data.fit_data import FitData
from termsel.data.monomials import evaluate_monomials, graded_exponents

PLANE = graded_exponents(2, 2)
N = 12
SCALES = np.array([[1.0, 0.5, 1.0], [0.3, 1.0, 0.1]])


def measured() -> tuple[FloatArray, FloatArray]:
    """Points of a bent plane with noise; the last is off by 30 times the noise."""
    rng = np.random.default_rng(3)
    columns = evaluate_monomials(np.column_stack([rng.uniform(-1, 1, (N, 2)), np.zeros(N)]), PLANE)
    image = columns @ rng.standard_normal((6, 2)) + 0.01 * rng.standard_normal((N, 2))
    image[8] += [0.2, -0.3]
    return columns, image


def solved(columns: FloatArray, image: FloatArray, weights: FloatArray) -> Posterior:
    found = solve_posterior(
        columns, image, np.array(PLANE).sum(axis=1), weights, SCALES, len(image))
    assert found is not None
    return found


def test_the_odds_are_those_of_the_evidence_with_larger_errors_of_the_point() -> None:
    """A point with a known larger error has a smaller weight, and the evidence is that of all."""
    columns, image = measured()

    def evidence(point: int, size: float) -> float:
        weights = np.ones((N, 2))
        weights[point] = 1 / size
        lead = np.linalg.qr(columns[:, :3] * weights[:, :1])[1]
        # The evidence is up to the volume of the free terms and the unit of the measurements.
        return float(solved(columns, image, weights).cells.log_evidence - 2 * np.log(size)
                     - 2 * np.log(np.abs(np.diag(lead))).sum())

    expected = [logsumexp([evidence(point, size) for size in BLUNDER_SIZES])
                - np.log(len(BLUNDER_SIZES))
                - evidence(point, 1.0) for point in range(N)]
    found = blunder_odds([(1.0, solved(columns, image, np.ones((N, 2))), False)], np.arange(N))
    assert found == pytest.approx(expected, abs=1e-5)  # unlikely solutions are left out
    assert found.argmax() == 8


def test_parts_count_by_their_probabilities_and_fields_predict_less_certainly() -> None:
    columns, image = measured()
    one, every = solved(columns, image, np.ones((N, 2))), np.arange(N)
    plain = blunder_odds([(1.0, one, False)], every)
    local = blunder_odds([(1.0, one, True)], every)
    assert local[8] < plain[8]
    both = blunder_odds([(0.25, one, False), (0.75, one, True)], every)
    assert (both > np.minimum(plain, local) - 1e-9).all()
    assert (both < np.maximum(plain, local) + 1e-9).all()
    assert FIELD_VARIANCE_FACTOR > 1


def far_point(shift: float) -> FeatureSet:
    """Nothing is near the corner, so the others hardly determine the model there."""
    rng = np.random.default_rng(4)
    ground = np.column_stack([rng.uniform(0, 400, (24, 2)), rng.uniform(0, 100, 24)])
    ground[0] = 1000.0, 1000.0, 50.0
    image = ground[:, 1::-1] * 2 + 0.5 * rng.standard_normal((24, 2))
    image[0] += shift
    return FeatureSet(Points(tuple(map(str, range(24))), image, ground), empty_lines(), "local")


@pytest.mark.parametrize(("shift", "blunder", "probable"), [
    (12.0, False, False), (60.0, True, True), (200.0, True, False)])
def test_a_far_point_alone_is_left_out_once_it_is_likelier_a_blunder(
        shift: float, blunder: bool, probable: bool) -> None:
    found = find_blunders(FitData.of(far_point(shift), True))
    assert found is not None
    assert (found.blunders[0], found.probable[0]) == (blunder, probable)
    assert not found.blunders[1:].any()
    assert found.limits[0] == found.limits.max() > 40.0


def test_what_is_below_the_error_found_for_certain_is_called_probable() -> None:
    """Next to another blunder the forward search alone leaves it out."""
    features = far_point(60.0)
    image = features.points.image.copy()
    image[7] += 25.0
    features = features.with_(points=replace(features.points, image=image))
    without = ~np.isin(np.arange(24), [2, 3, 4, 9, 13, 14, 15, 16])
    found = find_blunders(FitData.of(features.take(without), True))
    assert found is not None
    assert np.flatnonzero(found.blunders).tolist() == [0, 4]
    assert found.probable.tolist() == (found.blunders & (found.errors < found.limits)).tolist()
    assert found.probable[0]


def test_among_few_points_it_is_named_and_stays() -> None:
    found = find_blunders(FitData.of(far_point(60.0).take(np.arange(24) < 20), True))
    assert found is not None
    assert not found.blunders.any()
    assert np.flatnonzero(found.undecided).tolist() == [0]


def test_with_lines_it_is_named_and_stays() -> None:
    rng = np.random.default_rng(4)
    features = far_point(60.0)
    ground = np.concatenate([rng.uniform(0, 400, (6, 2, 2)), rng.uniform(0, 100, (6, 2, 1))], 2)
    image = ground[..., 1::-1] * 2 + 0.5 * rng.standard_normal((6, 2, 2))
    both = features.with_(lines=Lines(tuple("ABCDEF"), image, ground))
    found = find_blunders(FitData.of(both, True))
    assert found is not None
    assert found.undecided.tolist() == [True, *[False] * 29]
    assert not found.blunders.any()
