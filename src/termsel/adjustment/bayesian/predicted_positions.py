"""What a posterior foresees at any place: line and sample, and how uncertain they are.

A prediction is linear in q, the free columns at a place reduced by their triangle, and in w, its
shrunken columns less what those have in common with the free ones. Under one solution on the grid
its variance is

    sigma^2 (q'q + size^2 w'D (I - sum_i v_i v_i' s_i^2 size^2 / (1 + s_i^2 size^2)) D w),

D the scales, s_i and v_i singular values and vectors. Over all solutions it is the mean of these
and the variance of the predictions: a quadratic form in q and w again.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from termsel.adjustment.bayesian.posterior import PRIOR_SIZES, Posterior
from termsel.data.features import FloatArray


@dataclass(frozen=True, eq=False)
class PredictedPositions:
    """What is foreseen at m places."""

    image: FloatArray  # (m, 2): mean of line and sample
    variance: FloatArray  # (m, 2): of their errors, without the noise of a measurement there
    # (m, 2, d): their products are the covariances of the errors as far as columns span them: those
    # of a line and of a sample are independent.
    factors: FloatArray
    noise: float  # variance of a measurement of unit weight


def predict_positions(posterior: Posterior, free: FloatArray, shrunken: FloatArray,
                      unspanned: FloatArray | None = None) -> PredictedPositions:
    """Return what a posterior foresees at m places.

    The columns there are (m, f) of those that are not shrunken, and (m, k) of the others. Of what
    no column spans comes the variance for size 1, (g, m), for each group of scales.
    """
    noise = float(posterior.cells.share @ _noises(posterior))
    count = free.shape[1] + shrunken.shape[1]
    image, variance = np.zeros((2, len(free), 2))
    factors = np.zeros((len(free), 2, 2 * count))
    for axis in (0, 1):
        solutions = posterior.solutions[axis]
        design = posterior.designs[axis]
        free_reduced = np.linalg.solve(design.lead.T, free.T).T
        # W; `free_reduced` is q.
        shrunken_reduced = shrunken - free_reduced @ design.free_projections
        weight, mean, root = _coefficient_moments(posterior, axis)
        image[:, axis] = free_reduced @ solutions.free + shrunken_reduced @ mean
        factors[:, axis, axis * count:(axis + 1) * count] = np.concatenate(
            [free_reduced * np.sqrt(noise), shrunken_reduced @ root], axis=1)
        if unspanned is not None:
            variance[:, axis] = weight @ PRIOR_SIZES**2 @ unspanned
    return PredictedPositions(image, variance + (factors**2).sum(axis=2), factors, noise)


def _noises(posterior: Posterior) -> FloatArray:
    """Return the expected variance of the noise, which is inverse gamma distributed, (c,)."""
    return np.asarray(posterior.square / (posterior.freedom - 2))


def _noise_of_solutions(posterior: Posterior, axis: int) -> FloatArray:
    """Return the noise of each solution of an axis by its probability, shape (g, s)."""
    noises = _noises(posterior)
    solution_of_cell = posterior.cells.solutions[axis]
    count = len(posterior.evidence[axis].square)
    return np.asarray(np.bincount(solution_of_cell, posterior.cells.share * noises, count),
                      dtype=np.float64).reshape(len(posterior.scales), -1)


@lru_cache(maxsize=32)  # places come in batches
def _coefficient_moments(posterior: Posterior,
                         axis: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return moments of the shrunken coefficients of an axis.

    The noise of each solution by its probability, (g, s), and mean and root of the covariance of
    the coefficients, (k,) and (k, k).
    """
    weight = _noise_of_solutions(posterior, axis)
    solutions = posterior.solutions[axis]
    design = posterior.designs[axis]
    k = posterior.scales.shape[1]
    share = np.bincount(solutions.solution_of_cell, posterior.cells.share,
                        len(solutions.coefficients))
    mean = share @ solutions.coefficients
    # Between solutions their coefficients differ; within one they are uncertain.
    deviations = solutions.coefficients - mean
    covariance = (deviations * share[:, None]).T @ deviations
    groups = np.flatnonzero(weight.any(axis=1))  # the others are not decomposed for this
    values, vt = design.decomposed(groups)
    shrink = PRIOR_SIZES[:, None] ** 2 / (1.0 + (PRIOR_SIZES[:, None] * values[:, None, :]) ** 2)
    explained_weight = np.einsum("gs,gsp->gp", weight[groups], shrink)
    prior_weight = weight @ PRIOR_SIZES**2
    for g, directions, direction_weight in zip(groups, vt, explained_weight, strict=True):
        scaled = directions * posterior.scales[g]
        covariance += (scaled * direction_weight[:, None]).T @ scaled
        if len(scaled) < k:  # what no point reaches
            covariance += prior_weight[g] * (np.diag(posterior.scales[g] ** 2) - scaled.T @ scaled)
    # Cholesky's method would fail where coefficients are known but for rounding.
    spread, vectors = np.linalg.eigh(covariance)
    return weight, mean, vectors * np.sqrt(np.maximum(spread, 0.0))
