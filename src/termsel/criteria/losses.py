"""Errors of features as one figure, which a few wrong ones upset or not."""

from __future__ import annotations

import numpy as np

from termsel.measurements.features import BoolArray, FloatArray
from termsel.options import Option

SQUARES, HUBER, MEDIAN = "squares", "huber", "median"

LOSS = Option("loss", SQUARES, "How the errors of features make one figure: squares, their RMSE; "
              "or huber or median, which wrongly measured features upset less.",
              choices=(SQUARES, HUBER, MEDIAN))
THRESHOLD = Option("threshold", 2.0, "With Huber's loss, the distance from which on errors count "
                   "linearly, by the median distance.", float, 0.1)

NORMAL = float(1.0 / np.sqrt(np.log(2.0)))
"""RMSE of points by the median of their distances, for normal errors: sqrt(2) by
sqrt(2 ln 2)."""


def figure(distances: FloatArray, weights: FloatArray, loss: str = SQUARES,
           threshold: float = 2.0) -> FloatArray:
    """Return the RMSE of errors, or what is close to it for normal ones without wrong ones.

    Parameters
    ----------
    distances : ndarray, shape (p, n)
        Error of each feature [px].
    weights : ndarray, shape (p, n)
        For how many errors each stands; 0 for a feature that is not in use.
    loss : {"squares", "huber", "median"}
        sqrt(mean(rho(d))) with rho(d) = d^2, or for "huber" d^2 up to c and 2 c d - c^2 beyond, c
        the threshold times the median distance; or the median distance times 1 / sqrt(ln 2).
    threshold : float

    Returns
    -------
    ndarray, shape (p,)
        Infinite without a feature in use, and where the error of one in use is not finite.
    """
    used: BoolArray = weights > 0
    counted = np.asarray(used.any(axis=1) & ~(used & ~np.isfinite(distances)).any(axis=1))
    d = np.where(used & counted[:, None], distances, 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        if loss == SQUARES:
            losses = d**2
        else:
            middle = _medians(d, used)
            if loss == MEDIAN:
                return np.where(counted, NORMAL * middle, np.inf)
            c = threshold * middle[:, None]
            losses = np.where(d <= c, d**2, 2 * c * d - c**2)
        total = np.where(used, weights, 0.0).sum(axis=1)
        mean = (weights * losses).sum(axis=1) / np.where(counted, total, 1.0)
        return np.where(counted, np.sqrt(mean), np.inf)


def _medians(values: FloatArray, used: BoolArray) -> FloatArray:
    """Return the median of those in use of each row, shape (p,)."""
    rows = np.sort(np.where(used, values, np.inf), axis=1)
    count = np.maximum(used.sum(axis=1), 1)
    each = np.arange(len(rows))
    return np.asarray((rows[each, (count - 1) // 2] + rows[each, count // 2]) / 2)
