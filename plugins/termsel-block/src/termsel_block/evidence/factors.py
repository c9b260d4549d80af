"""The evidence for parameters over that for zeros."""

from __future__ import annotations

import numpy as np

from termsel_block.geometry.frame import FloatArray


def log_bayes_factor(mean: FloatArray, covariance: FloatArray, prior: FloatArray) -> float:
    """Return the logarithm of the evidence for parameters over that for zeros.

    Parameters
    ----------
    mean, covariance : ndarray, shapes (k,) and (k, k)
        Mean and covariance of the posterior.
    prior : ndarray, shape (k,)
        Variances of the prior, whose mean is 0.

    Notes
    -----
    The ratio of Savage and Dickey: density of the prior at zero over that of the posterior.
    """
    # log p(0) of the prior less log p(0) of the posterior; both have the same (2 pi)^k.
    sign, logarithm = np.linalg.slogdet(covariance)
    # No evidence either way where the covariance is numerically singular.
    if sign <= 0:
        return 0.0
    quadratic = float(mean @ np.linalg.solve(covariance, mean))
    return 0.5 * (quadratic + float(logarithm) - float(np.log(prior).sum()))


