"""Variances that nobody knows: the posterior over them, and steps that come to an end."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("termsel_block", reason="termsel-block is not installed: "
                    "pip install -e plugins/termsel-block")

from termsel_block.accuracy import independent_points, rms_length
from termsel_block.evidence.integrating import Integrated, integrate
from termsel_block.evidence.variances import OWN_WEIGHT, TAIL, loosening_factors
from termsel_block.geometry.frame import FloatArray
from termsel_block.joint import adjust
from termsel_block.simulated import Hills, simulate_block

IMAGES, GUESS = 6, 5.0
SLICES = [slice(2 * i, 2 * i + 2) for i in range(IMAGES + 1)]  # the last one is of heights


def observed(truth: FloatArray, noise: FloatArray, rng: np.random.Generator,
             ) -> tuple[Integrated, FloatArray]:
    """Return the posterior of a shift of each image, and the one measurement of each."""
    precision = np.append(np.repeat(noise**-2, 2), [1.0, 1.0])
    measured = np.append(truth.ravel() + np.repeat(noise, 2) * rng.standard_normal(2 * IMAGES),
                         [0.0, 0.0])
    prior = np.append(np.full(2 * IMAGES, GUESS**-2), [0.0, 0.0])
    camera = SimpleNamespace(groups=("shift",) * 2, scales=("shift",) * 2, prior_sigma=(GUESS,) * 2,
                             min_sigma=(1e-4,) * 2, fixed_variance=frozenset())
    cameras = [camera] * IMAGES
    return integrate(np.diag(precision + prior), precision * measured / (precision + prior),
                     cameras, [np.zeros(2)] * IMAGES, SLICES), measured  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_posterior_over_variances_is_true_where_its_prior_is() -> None:
    """Truths are drawn as the prior says: intervals then hold what they say, on average."""
    rng, inside, squares = np.random.default_rng(3), [], []
    for _ in range(30):
        shared = GUESS * abs(rng.standard_t(TAIL))
        own = shared * np.sqrt(OWN_WEIGHT / rng.chisquare(OWN_WEIGHT, IMAGES))
        truth = own[:, None] * rng.standard_normal((IMAGES, 2))
        found, _ = observed(truth, rng.uniform(1.0, 15.0, IMAGES), rng)
        away = truth.ravel() - found.mean[:-2]
        low, high = np.quantile(found.draws[:, :-2], [0.05, 0.95], axis=0)
        inside.append((low <= away) & (away <= high))
        squares.append(away**2 / np.diag(found.covariance)[:-2])
    assert 0.86 < np.mean(inside) < 0.94
    assert 0.8 < np.mean(squares) < 1.2


def test_draws_and_variances_are_those_of_the_posterior() -> None:
    rng = np.random.default_rng(5)
    found, measured = observed(rng.normal(0, 3, (IMAGES, 2)), np.full(IMAGES, 2.0), rng)
    np.testing.assert_allclose(np.std(found.draws, axis=0), np.sqrt(np.diag(found.covariance)),
                               rtol=0.15)
    # As known variances they have the same mean.
    np.testing.assert_allclose(found.mean, measured * 0.25 / (
        0.25 + np.nan_to_num(found.precision)), atol=1e-9)


def test_columns_that_are_unlike_scatter_unlike() -> None:
    """Of two columns of a group one is large in all images: its prior must not be that of both."""
    large, precision = np.array([40.0, -30.0, 35.0, -45.0, 50.0, 38.0]), []
    normal = np.diag(np.append(np.full(4 * IMAGES, 0.04 + GUESS**-2), [1.0, 1.0]))
    right = np.zeros(len(normal))
    right[0:4 * IMAGES:4] = right[2:4 * IMAGES:4] = 0.04 * large
    slices = [slice(4 * i, 4 * i + 4) for i in range(IMAGES)] + [slice(4 * IMAGES, len(normal))]
    for scales in (("degree 2", "degree 2"), ("x2", "y2")):
        camera = SimpleNamespace(groups=("degree 2",) * 4, scales=scales * 2,
                                 prior_sigma=(GUESS,) * 4, min_sigma=(1e-4,) * 4,
                                 fixed_variance=frozenset())
        cameras: list[Any] = [camera] * IMAGES
        found = integrate(normal, right / np.diag(normal), cameras,
                          [np.zeros(4)] * IMAGES, slices)
        precision.append(found.precision[:4])
        error = large - found.mean[0:4 * IMAGES:4]
        assert (np.abs(error) < (15.0 if scales[0] == scales[1] else 3.0)).all()
    one, each = precision
    assert one[1] < 3 * one[0]  # small columns are taken to scatter nearly as the large ones
    assert each[1] > 20 * each[0]


def test_terms_of_sensors_scatter_as_the_images_say() -> None:
    """What three images have in common counts; what they do not tell stays as it is stated."""
    camera = SimpleNamespace(stated_terms={"rate": 0, "yaw": 1}, sigma_factors=np.ones(2))
    parameters = [np.array([value, 0.0]) for value in (4.0, -5.0, 3.0)]
    covariances = [np.diag([0.01, 1.0])] * 3
    found = loosening_factors([camera] * 3, parameters, covariances)  # type: ignore[list-item]
    assert found["rate"] == pytest.approx(np.sqrt((50 + OWN_WEIGHT) / (3 + OWN_WEIGHT)), rel=1e-3)
    assert found["yaw"] == pytest.approx(1.0)


@pytest.mark.slow
def test_steps_that_were_shortened_come_to_an_end() -> None:
    """With derivatives of where it began the block stops at 16 px: each step is a thirtieth."""
    rng = np.random.default_rng([3009, 7])
    phases = rng.uniform(0, 2 * np.pi, 4).tolist()
    simulated = simulate_block(3, n_ties=200, control=(6, 6, 0), noise=0.4, seed=3009,
                               independent=160, hills=Hills(1.0, tuple(phases)))
    result = adjust(simulated.block)
    assert result.adjusted.converged
    assert 0.9 < result.adjusted.state.sigma_ties / 0.4 < 1.1
    points = independent_points(result, 0)
    assert points is not None
    assert rms_length(points.image - result.project(0, points.ground)) < 7.0
