"""Orthogonal columns of tall matrices."""

from __future__ import annotations

import numpy as np

from termsel.data.features import FloatArray

MIN_ROWS_PER_COLUMN, MIN_COLUMNS = 4, 64
"""Rows for each column, and columns, from which products of matrices are faster."""

CORRECTABLE = 1e-2
"""How far the products of orthogonal columns may be from 0 and 1 for one correction to reach
rounding error: it squares this distance to begin with, and is exact by its own Cholesky factor."""


def orthogonal(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Q and R of a matrix, as `numpy.linalg.qr` does, up to signs.

    Of tall matrices by Cholesky's method, twice: the first Q has an error of the square of the
    condition, which the second factor takes away (Yamamoto, Nakatsukasa, Yanagisawa and Fukaya
    2015, Electron. Trans. Numer. Anal. 44). Where the first is not nearly orthogonal, by
    Householder's method. The columns (n, k) may have any rank; Q is (n, min(n, k)), R (min(n, k),
    k).
    """
    n, k = columns.shape
    # The product of both triangles is that of the columns; the second Q is orthogonal to rounding.
    if n >= MIN_ROWS_PER_COLUMN * k and k >= MIN_COLUMNS:
        first = _step(columns)
        if first is not None:
            q, r, _ = first
            second = _step(q)
            if second is not None and second[2] <= CORRECTABLE:
                return second[0], second[1] @ r
    q, r = np.linalg.qr(columns)
    return q, r


def _step(columns: FloatArray) -> tuple[FloatArray, FloatArray, float] | None:
    """Return Q, R and how far the columns were from orthogonal ones; None if R is not found."""
    from scipy.linalg import blas, lapack  # which fewer columns need not import

    gram = columns.T @ columns
    departure = float(np.abs(gram - np.eye(len(gram))).max())
    try:
        r = np.asarray(np.linalg.cholesky(gram).T, dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    inverse, fault = lapack.dtrtri(r)
    # In the order of Fortran the columns are the rows of a matrix.
    return None if fault else (blas.dtrmm(1.0, inverse, columns.T, trans_a=1).T, r, departure)
