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
from scipy import linalg

from termsel.measurements.features import FloatArray
from termsel.priors.posterior import SIZES, Posterior


@dataclass(frozen=True, eq=False)
class Foresight:
    """What is foreseen at m places.

    Parameters
    ----------
    image : ndarray, shape (m, 2)
        Mean of line and sample.
    variance : ndarray, shape (m, 2)
        Of their errors, without the noise of a measurement there.
    factors : ndarray, shape (m, 2, d)
        Their products are the covariances of the errors as far as columns span them: those of a
        line and of a sample are independent.
    noise : float
        Variance of a measurement of unit weight.
    """

    image: FloatArray
    variance: FloatArray
    factors: FloatArray
    noise: float


def foresee(found: Posterior, free: FloatArray, shrunken: FloatArray,
            unspanned: FloatArray | None = None) -> Foresight:
    """Return what a posterior foresees.

    Parameters
    ----------
    found : Posterior
    free : ndarray, shape (m, f)
        Columns that are not shrunken, at the places.
    shrunken : ndarray, shape (m, k)
        The others.
    unspanned : ndarray, shape (g, m), optional
        Variance for size 1 of what no column spans at the places, of each group of scales.
    """
    # The expectation of the noise's variance, which is inverse gamma distributed.
    noises = found.square / (found.freedom - 2)
    noise = float(found.cells.share @ noises)
    count = free.shape[1] + shrunken.shape[1]
    image, variance = np.zeros((2, len(free), 2))
    factors = np.zeros((len(free), 2, 2 * count))
    for axis in (0, 1):
        side, design = found.sides[axis], found.designs[axis]
        lead = linalg.solve_triangular(design.lead, free.T, trans="T").T
        rest = shrunken - lead @ design.cross
        weight = _weights(found, axis, noises)
        mean, root = _shrunken(found, axis, weight)
        image[:, axis] = lead @ side.free + rest @ mean
        factors[:, axis, axis * count:(axis + 1) * count] = np.concatenate(
            [lead * np.sqrt(noise), rest @ root], axis=1)
        if unspanned is not None:
            variance[:, axis] = weight @ SIZES**2 @ unspanned
    return Foresight(image, variance + (factors**2).sum(axis=2), factors, noise)


def _weights(found: Posterior, axis: int, noises: FloatArray) -> FloatArray:
    """Return the noise of each solution of an axis by its probability, shape (g, s)."""
    which, count = found.cells.which[axis], len(found.odds[axis].square)
    return np.asarray(np.bincount(which, found.cells.share * noises, count), dtype=np.float64
                      ).reshape(len(found.scales), -1)


def _shrunken(found: Posterior, axis: int, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and root of the covariance of the shrunken coefficients, (k,) and (k, k)."""
    side, design = found.sides[axis], found.designs[axis]
    k = found.scales.shape[1]
    share = np.bincount(side.cell, found.cells.share, len(side.coefficients))
    mean = share @ side.coefficients
    apart = side.coefficients - mean
    covariance = (apart * share[:, None]).T @ apart
    groups = np.flatnonzero(weight.any(axis=1))
    _, values, vt = design.decomposed(groups)
    keep = SIZES[:, None] ** 2 / (1.0 + (SIZES[:, None] * values[:, None, :]) ** 2)
    own = np.einsum("gs,gsp->gp", weight[groups], keep)
    never = weight @ SIZES**2
    for g, along, one in zip(groups, vt, own, strict=True):
        scaled = along * found.scales[g]
        covariance += (scaled * one[:, None]).T @ scaled
        if len(scaled) < k:  # what no point reaches
            covariance += never[g] * (np.diag(found.scales[g] ** 2) - scaled.T @ scaled)
    spread, vectors = np.linalg.eigh(covariance)
    return mean, vectors * np.sqrt(np.maximum(spread, 0.0))
