"""Errors of features as one figure, robust against blunders or not."""

from __future__ import annotations

import numpy as np

from termsel.core.options import Option
from termsel.data.features import BoolArray, FloatArray

SQUARES = "squares"
HUBER = "huber"
MEDIAN = "median"

LOSS = Option("loss", SQUARES, "Figure of the errors of features: squares, their RMSE; or huber or "
                               "median, which are robust against blunders.",
              choices=(SQUARES, HUBER, MEDIAN))
THRESHOLD = Option("threshold", 2.0, "With Huber's loss, the distance, relative to the median "
                                     "distance, beyond which errors count linearly.", float, 0.1,
                   1e6)

RMSE_BY_MEDIAN = float(1.0 / np.sqrt(np.log(2.0)))
"""Ratio of the RMSE of points to the median of their distances, for normal errors: sqrt(2) over
sqrt(2 ln 2)."""


def rmse_like_figure(distances: FloatArray, weights: FloatArray, loss: str = SQUARES,
                     threshold: float = 2.0) -> FloatArray:
    """Return the RMSE of errors, or a figure close to it for normal errors without blunders; (p,).

    The errors are `distances` [px] (p, n); `weights` (p, n) are how many errors each of them
    represents, 0 for a feature that is not in use. The figure is sqrt(mean(rho(d))) with
    rho(d) = d^2, or for "huber" d^2 up to c and 2 c d - c^2 beyond, c the threshold times the
    median distance; for "median" it is the median distance times 1 / sqrt(ln 2). It is infinite
    without a feature in use, and if the error of one in use is not finite.
    """
    used: BoolArray = weights > 0
    counted = np.asarray(used.any(axis=1) & ~(used & ~np.isfinite(distances)).any(axis=1))
    # Distances that do not count become 0, which no loss turns into NaN.
    d = np.where(used & counted[:, None], distances, 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        if loss == SQUARES:
            losses = d**2
        else:
            middle = _row_medians(d, used)
            if loss == MEDIAN:
                return np.where(counted, RMSE_BY_MEDIAN * middle, np.inf)
            # Huber's loss: squares of small distances, and beyond c straight lines that go on.
            c = threshold * middle[:, None]
            losses = np.where(d <= c, d**2, 2 * c * d - c**2)
        total = np.where(used, weights, 0.0).sum(axis=1)
        mean = (weights * losses).sum(axis=1) / np.where(counted, total, 1.0)
        return np.where(counted, np.sqrt(mean), np.inf)


def _row_medians(values: FloatArray, used: BoolArray) -> FloatArray:
    """Return the median of those in use of each row, shape (p,)."""
    rows = np.sort(np.where(used, values, np.inf), axis=1)
    count = np.maximum(used.sum(axis=1), 1)
    row = np.arange(len(rows))
    # The mean of both middle ones; of an odd number they are one.
    return np.asarray((rows[row, (count - 1) // 2] + rows[row, count // 2]) / 2)
