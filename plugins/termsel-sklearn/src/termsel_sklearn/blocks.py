"""Groups of points by place, for cross-validation that does not flatter neighbours."""

from __future__ import annotations

from numbers import Integral
from typing import Any

import numpy as np

from termsel_sklearn.arrays import FloatArray, IntArray


def spatial_blocks(X: Any, across: int = 3) -> IntArray:
    """Return the block of each point, as `groups` of `GroupKFold` and other splitters.

    Points near each other predict each other too well; whole blocks are held out instead.

    Parameters
    ----------
    X : array_like, shape (n, 2) or (n, 3)
        Ground coordinates.
    across : int
        Blocks in x, and in y; each has about as many points as the others.

    Returns
    -------
    ndarray of int, shape (n,)
        From 0 to across**2 - 1.

    Raises
    ------
    ValueError
        If `across` is below 2, or X has too few columns.
    TypeError
        If `across` is no whole number.

    Examples
    --------
    >>> from termsel_sklearn import spatial_blocks
    >>> spatial_blocks([[0, 0], [0, 9], [9, 0], [9, 9]], across=2).tolist()
    [0, 1, 2, 3]
    """
    if not isinstance(across, Integral):
        raise TypeError(f"across is {across!r:.60}, expected a whole number of blocks in x, and in "
                        "y: across=3 makes 9")
    positions = np.asarray(X, dtype=np.float64)
    if positions.ndim != 2 or positions.shape[1] < 2 or across < 2:
        raise ValueError("blocks need x and y of each point, and at least 2 blocks each way")
    # Columns first, then rows within each of them: all blocks have about as many points.
    column = _strip_numbers(positions[:, 0], across)
    row = np.zeros(len(positions), dtype=np.intp)
    for number in range(across):
        row[column == number] = _strip_numbers(positions[column == number, 1], across)
    return column * across + row


def _strip_numbers(values: FloatArray, count: int) -> IntArray:
    """Return the strip of each value, 0 to count - 1, shape (n,).

    The strips follow the order of the values, and have as many values each, to within one.
    """
    strips = np.zeros(len(values), dtype=np.intp)
    # Strips of one width would be empty between clusters of points.
    # The divisor is 1 for no values, which have no strips.
    strips[np.argsort(values, kind="stable")] = np.arange(len(values)) * count // max(
        len(values), 1)
    return strips
