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

import numpy as np

from termsel.adjustment.bayesian.posterior import SIZES, Posterior
from termsel.data.features import FloatArray


@dataclass(frozen=True, eq=False)
class Foresight:
    """What is foreseen at m places."""

    image: FloatArray  # (m, 2): mean of line and sample
    variance: FloatArray  # (m, 2): of their errors, without the noise of a measurement there
    # (m, 2, d): their products are the covariances of the errors as far as columns span them: those
    # of a line and of a sample are independent.
    factors: FloatArray
    noise: float  # variance of a measurement of unit weight


def foresee(posterior: Posterior, free: FloatArray, shrunken: FloatArray,
            unspanned: FloatArray | None = None) -> Foresight:
    """Return what a posterior foresees at m places.

    The columns there are (m, f) of those that are not shrunken, and (m, k) of the others. Of what
    no column spans comes the variance for size 1, (g, m), for each group of scales.
    """
    # The expectation of the noise's variance, which is inverse gamma distributed.
    noises = posterior.square / (posterior.freedom - 2)
    noise = float(posterior.cells.share @ noises)
    count = free.shape[1] + shrunken.shape[1]
    image, variance = np.zeros((2, len(free), 2))
    factors = np.zeros((len(free), 2, 2 * count))
    for axis in (0, 1):
        side = posterior.sides[axis]
        design = posterior.designs[axis]
        lead = np.linalg.solve(design.lead.T, free.T).T
        rest = shrunken - lead @ design.cross  # w; `lead` is q
        weight = _weights(posterior, axis, noises)
        mean, root = _shrunken(posterior, axis, weight)
        image[:, axis] = lead @ side.free + rest @ mean
        factors[:, axis, axis * count:(axis + 1) * count] = np.concatenate(
            [lead * np.sqrt(noise), rest @ root], axis=1)
        if unspanned is not None:
            variance[:, axis] = weight @ SIZES**2 @ unspanned
    return Foresight(image, variance + (factors**2).sum(axis=2), factors, noise)


def _weights(posterior: Posterior, axis: int, noises: FloatArray) -> FloatArray:
    """Return the noise of each solution of an axis by its probability, shape (g, s)."""
    which = posterior.cells.which[axis]
    count = len(posterior.odds[axis].square)
    return np.asarray(np.bincount(which, posterior.cells.share * noises, count), dtype=np.float64
                      ).reshape(len(posterior.scales), -1)


def _shrunken(posterior: Posterior, axis: int, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and root of the covariance of the shrunken coefficients, (k,) and (k, k)."""
    side = posterior.sides[axis]
    design = posterior.designs[axis]
    k = posterior.scales.shape[1]
    share = np.bincount(side.cell, posterior.cells.share, len(side.coefficients))
    mean = share @ side.coefficients
    # Between solutions their coefficients differ; within one they are uncertain.
    apart = side.coefficients - mean
    covariance = (apart * share[:, None]).T @ apart
    groups = np.flatnonzero(weight.any(axis=1))  # the others are not decomposed for this
    _, values, vt = design.decomposed(groups)
    keep = SIZES[:, None] ** 2 / (1.0 + (SIZES[:, None] * values[:, None, :]) ** 2)
    own = np.einsum("gs,gsp->gp", weight[groups], keep)
    never = weight @ SIZES**2
    for g, along, one in zip(groups, vt, own, strict=True):
        scaled = along * posterior.scales[g]
        covariance += (scaled * one[:, None]).T @ scaled
        if len(scaled) < k:  # what no point reaches
            covariance += never[g] * (np.diag(posterior.scales[g] ** 2) - scaled.T @ scaled)
    # Cholesky's method would fail where coefficients are known but for rounding.
    spread, vectors = np.linalg.eigh(covariance)
    return mean, vectors * np.sqrt(np.maximum(spread, 0.0))
