"""Root mean square errors of features."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel.measurements.features import FloatArray


@dataclass(frozen=True)
class Rmse:
    """Root mean square errors [px] over n features.

    `total` is sqrt(mean(dl^2 + ds^2)) over points. For control lines the error is the
    distance of each projected ground vertex from the image line, taken along its normal.
    """

    line: float
    sample: float
    total: float
    n: int


def rmse_of(errors: FloatArray, n: int) -> Rmse | None:
    """Return the RMSE of errors, shape (..., 2), of n features; None without any."""
    if not n:
        return None
    with np.errstate(over="ignore"):  # beyond all numbers is infinite
        line, sample = np.sqrt((errors**2).mean(axis=0)).tolist()
    return Rmse(line, sample, float(np.hypot(line, sample)), n)
