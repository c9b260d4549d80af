"""The test of normality by Shapiro and Wilk: that of SciPy takes half a second to import.

References
----------
Shapiro, Wilk 1965: An analysis of variance test for normality. Biometrika 52, 591-611.
Royston 1995: Remark AS R94. Applied Statistics 44, 547-551: the coefficients for any number.
"""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

from termsel.data.features import FloatArray

NUMBERS = range(8, 5001)  # fewer errors show nothing, and for more the test has no table


def chances_if_normal(errors: FloatArray) -> tuple[float, float] | None:
    """Return the chance that normal errors look so little normal, for each column of (n, 2).

    None for a number that is not one of NUMBERS, and where the errors of a column are equal.
    """
    n = len(errors)
    if n not in NUMBERS or not np.ptp(errors, axis=0).all():
        return None
    normal = NormalDist()
    expected = np.array([normal.inv_cdf((i - 0.375) / (n + 0.25)) for i in range(1, n + 1)])
    u = n**-0.5
    inner = expected[2:-2]
    ends = expected[-2:] / np.sqrt(expected @ expected) + (
        np.polyval([-3.582633, 5.682633, -1.752461, -0.293762, 0.042981, 0.0], u),
        np.polyval([-2.706056, 4.434685, -2.071190, -0.147981, 0.221157, 0.0], u))
    inner = inner * np.sqrt((1 - 2 * ends @ ends) / (inner @ inner))
    central = np.sort(errors, axis=0) - errors.mean(axis=0)
    log_unexplained = np.log1p(-(np.concatenate([-ends[::-1], inner, ends]) @ central) ** 2
                               / (central**2).sum(axis=0))
    if n < 12:
        statistic = -np.log(0.459 * n - 2.273 - log_unexplained)
        mean = np.polyval([-6.714e-4, 0.025054, -0.39978, 0.5440], n)
        deviation = np.exp(np.polyval([-0.0020322, 0.062767, -0.77857, 1.3822], n))
    else:
        statistic = log_unexplained
        log = np.log(n)
        mean = np.polyval([0.0038915, -0.083751, -0.31082, -1.5861], log)
        deviation = np.exp(np.polyval([0.0030302, -0.082676, -0.4803], log))
    first, second = map(normal.cdf, ((mean - statistic) / deviation).tolist())
    return first, second
