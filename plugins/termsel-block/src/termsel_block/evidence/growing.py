"""Which images to try with more columns, by the residuals of their ties."""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc

from termsel_block.geometry.frame import FloatArray

MAX_P_VALUE = 1e-3
"""Probability by chance below which columns are tried; the whole block decides afterwards."""


def p_value_of_columns(columns: FloatArray, residuals: FloatArray, weight: FloatArray) -> float:
    """Return the probability that residuals follow columns so well by chance, by an F test.

    Parameters
    ----------
    columns : ndarray, shape (n, k)
        What each of k candidate parameters would move each tie by, in line and in sample alike.
    residuals : ndarray, shape (n, 2)
        Residuals of the ties of one image without these columns [px].
    weight : ndarray, shape (n,)
        Inverse variances, up to a common factor.

    Returns
    -------
    float
        1.0 where the ties are too few for a test or leave nothing to test.

    Notes
    -----
    The positions of ties have taken up about half of their measurements, so that each of n counts
    once, and not for line and for sample. The test only shows what is worth trying.
    """
    n = len(columns)
    n_parameters = 2 * columns.shape[1]
    if n <= n_parameters or not weight.any():
        return 1.0
    # Weighted least squares: the share of the squares that an orthogonal basis takes.
    root = np.sqrt(weight)[:, None]
    basis = np.linalg.qr(columns * root)[0]
    total = float(((root * residuals) ** 2).sum())
    explained = float(((basis.T @ (root * residuals)) ** 2).sum())
    if explained >= total:
        # Residuals that are zero, or explained but for rounding, leave no rest to test against.
        return 1.0
    # F = (explained / p) / (rest / (n - p)) of p parameters.
    return float(fdtrc(n_parameters, n - n_parameters,
                       explained / n_parameters / ((total - explained) / (n - n_parameters))))
