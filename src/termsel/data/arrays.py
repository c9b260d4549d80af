"""Types of the arrays that all rooms pass to each other, and how those of users become them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]


def numbers_or_nan(values: ArrayLike) -> FloatArray:
    """Return values as an array of the same shape, with NaN where a masked array masks them.

    The number below a mask is no measurement: in a hole of a DEM it is -9999, say.
    """
    if np.ma.isMaskedArray(values):
        return np.asarray(np.ma.filled(np.ma.asarray(values, dtype=np.float64), np.nan))
    return np.asarray(values, dtype=np.float64)
