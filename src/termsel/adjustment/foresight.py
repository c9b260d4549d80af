"""What a posterior foresees at any place: line and sample, and how uncertain they are.

Under one solution on the grid, with q the free columns at a place reduced by their triangle and
w its shrunken columns less what those have in common with the free ones, the prediction has the
variance

    sigma^2 (q'q + size^2 (|D w|^2 - sum_i (v_i' D w)^2 s_i^2 size^2 / (1 + s_i^2 size^2))),

D the scales, s_i and v_i singular values and vectors. The variance over all solutions is the mean
of theirs and the variance of their predictions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from termsel.adjustment.posterior import SIZES, Posterior
from termsel.measurements.features import FloatArray

AT_ONCE = 2000
"""Places of which the variances under all solutions are held in memory."""


@dataclass(frozen=True, eq=False)
class Foresight:
    """What is foreseen at m places.

    Parameters
    ----------
    image : ndarray, shape (m, 2)
        Mean of line and sample.
    variance : ndarray, shape (m, 2)
        Of their errors, without the noise of a measurement there.
    noise : float
        Variance of a measurement of unit weight.
    """

    image: FloatArray
    variance: FloatArray
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
    more = np.zeros((len(found.scales), len(free))) if unspanned is None else unspanned
    # The expectation of the noise's variance, which is inverse gamma distributed.
    noise = found.square / (found.freedom - 2)
    image, variance = np.empty((2, len(free), 2))
    for start in range(0, len(free), AT_ONCE):
        part = slice(start, start + AT_ONCE)
        for axis in (0, 1):
            image[part, axis], variance[part, axis] = _of_axis(
                found, axis, noise, free[part], shrunken[part], more[:, part])
    return Foresight(image, variance, float(found.cells.share @ noise))


def _of_axis(found: Posterior, axis: int, noise: FloatArray, free: FloatArray,
             shrunken: FloatArray, more: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and variance at m places."""
    side, design, which = found.sides[axis], found.designs[axis], found.cells.which[axis]
    count = len(side.square)
    share = np.bincount(which, found.cells.share, count)
    weight = np.bincount(which, found.cells.share * noise, count)
    lead = linalg.solve_triangular(design.lead, free.T, trans="T")            # (f, m)
    rest = shrunken.T - design.cross.T @ lead                                 # (k, m)
    scaled = found.scales[:, :, None] * rest                                  # (g, k, m)
    along = (design.vt @ scaled) ** 2                                         # (g, p, m)
    never = np.maximum((scaled**2).sum(axis=1) - along.sum(axis=1), 0.0) + more  # (g, m)
    keep = 1.0 / (1.0 + (SIZES[:, None] * design.values[:, None, :]) ** 2)    # (g, s, p)
    spread = SIZES[:, None] ** 2 * (keep @ along + never[:, None, :])         # (g, s, m)
    image = side.free @ lead + side.coefficients @ rest                       # (g s, m)
    mean = share @ image
    return mean, (weight @ (spread.reshape(count, -1) + (lead**2).sum(axis=0))
                  + share @ (image - mean) ** 2)
