"""The majority under which all points are likeliest: its predictions, evidence and climbs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import termsel
from termsel.auto import likeliest_majority
from termsel.auto.contradictions import polynomial_of
from termsel.auto.likeliest_majority import Likelihoods, likelier_right
from termsel.data.features import BoolArray, FloatArray
from termsel.data.fit_data import FitData
from termsel.data.monomials import evaluate_monomials

EXPONENTS = polynomial_of(False, 3).exponents
POWERS = np.array(EXPONENTS).sum(axis=1)


def bent(n: int, wrong: int) -> Likelihoods:
    """Return points of a bent image, the first of which are wrong."""
    rng = np.random.default_rng(1)
    ground = np.column_stack([rng.uniform(-1, 1, (n, 2)), np.zeros(n)])
    design = evaluate_monomials(ground, EXPONENTS)
    image = ground[:, :2] + 0.02 * np.sin(3 * ground[:, 1::-1]) + rng.normal(0, 1e-3, (n, 2))
    image[:wrong] += rng.uniform(-0.1, 0.1, (wrong, 2))
    plain = design[:, POWERS <= 2]
    residuals = image - plain @ np.linalg.lstsq(plain, image)[0]
    return Likelihoods(design, POWERS, image, np.linalg.norm(residuals, axis=1))


def predicted(points: Likelihoods, used: BoolArray, place: int) -> tuple[FloatArray, float]:
    """Return what some points predict at the place of another, and with which variance."""
    [scales], [noise] = points.scales, points.noises
    covariance = (points.design * scales**2) @ points.design.T
    within = covariance[np.ix_(used, used)] + noise**2 * np.eye(used.sum())
    weights = np.linalg.solve(within, covariance[used, place])
    variance = covariance[place, place] - covariance[used, place] @ weights + noise**2
    return weights @ points.image[used], float(variance)


def test_each_point_is_predicted_by_the_others_of_the_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(likeliest_majority, "TERM_SCALES", ((0.1, 0.03),))
    monkeypatch.setattr(likeliest_majority, "NOISES", np.array([0.2]))
    points = bent(16, 4)
    used = np.arange(16) >= 3
    judged = points.judge(used[None])
    for place in range(16):
        others = used & (np.arange(16) != place)
        expected, variance = predicted(points, others, place)
        np.testing.assert_allclose(judged.errors[0, place], points.image[place] - expected,
                                   atol=1e-9)
        assert judged.variances[0, place] == pytest.approx(variance, rel=1e-6)


def test_scales_and_noise_have_the_largest_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    points = bent(16, 4)
    used = np.arange(16) >= 4

    def evidence(scales: FloatArray, noise: float) -> float:
        rows = points.design[used] * scales
        covariance = rows @ rows.T + noise**2 * np.eye(used.sum())
        # Line and sample each are normal with this covariance.
        image = points.image[used]
        quadratic_form = (image * np.linalg.solve(covariance, image)).sum()
        return float(-np.linalg.slogdet(covariance)[1] - quadratic_form / 2)

    values = np.array([[evidence(scales, noise) for noise in points.noises]
                       for scales in points.scales])
    scale, noise = np.unravel_index(values.argmax(), values.shape)
    chosen = points.judge(used[None])
    monkeypatch.setattr(likeliest_majority, "TERM_SCALES",
                        (likeliest_majority.TERM_SCALES[scale],))
    monkeypatch.setattr(likeliest_majority, "NOISES", likeliest_majority.NOISES[[noise]])
    alone = bent(16, 4).judge(used[None])
    np.testing.assert_allclose(alone.variances, chosen.variances, rtol=1e-9)


def test_a_climb_from_a_spoilt_set_ends_at_the_right_points() -> None:
    points = bent(40, 17)
    right = np.arange(40) >= 17
    start = right.copy()
    start[:4] = True
    start[-3:] = False
    likelihood, used = points.climb(start[None])[0]
    assert not used[:17].any()
    assert used.sum() >= 20
    assert likelihood > points.judge(start[None]).log_likelihood[0]
    assert points.is_contradicted(used)
    assert not points.is_contradicted(np.arange(40) >= 5)


def test_samples_without_wrong_points_are_among_the_best(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(likeliest_majority, "SAMPLES", 1000)
    points = bent(40, 17)
    sets = points.best_samples(np.random.default_rng(0))
    assert sets.shape == (36, 40)
    assert (sets.sum(axis=1) >= 20).all()
    assert sets[:, :17].sum(axis=1).min() <= 1


def test_at_least_half_of_the_points_are_right() -> None:
    np.testing.assert_array_equal(likelier_right(np.array([[-1.0, -3.0, -2.0, -4.0],
                                                           [5.0, 1.0, 2.0, -1.0]])),
                                  [[True, False, True, False], [True, True, True, False]])


@pytest.mark.parametrize(("scene", "count", "seed"), [
    ("spot-isfahan", 40, 12), ("irs1c-mashad", 40, 4), ("spot-isfahan", 60, 6)])
def test_relief_without_heights_is_no_blunder(scene: str, count: int, seed: int) -> None:
    """Hills move points along the direction of view: a third disagrees, and none is wrong."""
    features = termsel.simulate_scene(scene, seed=seed, roles=(count, 0, 0), n_lines=0)
    ground = features.points.ground.copy()
    ground[:, 2] = np.nan
    flat = features.with_(points=replace(features.points, ground=ground))
    assert likeliest_majority.likeliest_majority(FitData.of(flat), None) is None


@pytest.mark.parametrize("is_relief", [False, True])
def test_directions_of_relief_are_told_from_those_of_blunders(is_relief: bool) -> None:
    """About the nadir point of a camera, and along one direction of a scanner."""
    rng = np.random.default_rng(3)
    image = rng.uniform(-1, 1, (20, 2))
    for outwards in (image - [0.2, -0.4], np.ones((20, 2)) * [0.1, 1.0]):
        errors = rng.normal(0, 1, (20, 1)) * outwards if is_relief else rng.normal(0, 1, (20, 2))
        errors = errors + rng.normal(0, 0.02, (20, 2))
        assert likeliest_majority._may_be_relief(image, errors) is is_relief
