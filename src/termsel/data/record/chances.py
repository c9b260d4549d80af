"""Chances and quantiles of the t, F and chi-squared distributions.

Those of scipy.special take 0.2 s to import, which runs of few points need for nothing else. They
are taken above `MAX_SUMMED_FREEDOM` degrees of freedom. References: Abramowitz and Stegun 1964,
Handbook of Mathematical Functions, 6.5.29 and 26.5.8.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import exp, lgamma, log, sqrt

import numpy as np
from numpy.typing import NDArray

MAX_SUMMED_FREEDOM = 1000
"""Most degrees of freedom of what is computed here."""

EPS, QUANTILE_STEP = 1e-16, 1e-12
"""Parts of a sum, and a step to a quantile, that change nothing."""

MAX_SECANTS = 60
"""Most secants to a quantile: rounding may keep the last ones from meeting `QUANTILE_STEP`."""


def quantile_of(values: NDArray[np.float64], share: float) -> NDArray[np.float64]:
    """Return the quantile of values along their last axis, (...), as `numpy.quantile` does.

    `share`, 0 to 1, of the values is below it; NaN if a value is. numpy's imports numpy.ma, which
    takes 0.01 s, and so does `numpy.median`.
    """
    ordered = np.sort(values)  # any NaN is last
    below = int(share * (values.shape[-1] - 1))
    # Linear between neighbours in order, as numpy's default method.
    fraction = share * (values.shape[-1] - 1) - below
    low = ordered[..., below]
    high = ordered[..., min(below + 1, values.shape[-1] - 1)]
    # Exact at both ends.
    between = (low + fraction * (high - low) if fraction < 0.5
               else high - (1 - fraction) * (high - low))
    return np.asarray(np.where(np.isnan(ordered[..., -1]), np.nan, between))


def median_of(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the median of values along their last axis, (...), as `numpy.median` does.

    It is NaN of no values, and if a value is.
    """
    ordered = np.sort(values)
    count = values.shape[-1]
    if not count:
        return np.full(values.shape[:-1], np.nan)
    middle = (ordered[..., (count - 1) // 2] + ordered[..., count // 2]) / 2
    return np.asarray(np.where(np.isnan(ordered[..., -1]), np.nan, middle))


def chi_squared_quantile(share: float, freedom: float) -> float:
    """Return the number that a chi-squared number is below with the chance `share`.

    `freedom` is its degrees of freedom.
    """
    if freedom > MAX_SUMMED_FREEDOM:
        from scipy.special import chdtri

        return float(chdtri(freedom, 1 - share))
    half = freedom / 2

    def below(x: float) -> float:
        """Return the chance that a chi-squared number is below x, by its power series."""
        # P(a, x) = x^a e^-x / Gamma(a + 1) (1 + x / (a + 1) + x^2 / ((a + 1)(a + 2)) + ...), with a
        # = freedom / 2 (6.5.29).
        total = 0.0
        term = 1.0
        n = half
        while term > EPS * total:
            total = total + term
            n = n + 1
            term *= x / 2 / n
        return total * exp(half * log(x / 2) - x / 2 - lgamma(half + 1))

    # Its third root is about normal (Wilson and Hilferty 1931).
    ninth = 2 / 9 / freedom
    start = max(1e-3, 1 - ninth + (2 * share - 1) * 1.8 * sqrt(ninth)) ** 3 * freedom
    return _argument_of(below, share, start)


@lru_cache(maxsize=256)  # many features ask for those of a few degrees of freedom
def t_quantile(share: float, freedom: float) -> float:
    """Return the number that a t distributed number is below with the chance `share`, above 1/2.

    `freedom` is its degrees of freedom.
    """
    if freedom > MAX_SUMMED_FREEDOM:
        from scipy.special import stdtrit

        return float(stdtrit(freedom, share))
    return _argument_of(lambda t: 1 - t_beyond(t, freedom) / 2, share, 1.0)


def t_beyond(t: float, freedom: float) -> float:
    """Return the chance of a larger |t|."""
    if freedom > MAX_SUMMED_FREEDOM:
        from scipy.special import stdtr

        return float(2 * stdtr(freedom, -t))
    # P(|T| > t) = I_x(freedom / 2, 1 / 2) (26.5.27).
    x = freedom / (freedom + t * t)
    return _incomplete_beta(x, 1 - x, freedom / 2, 0.5)


def chance_of_better_fit(share: float, freedom: float, unknowns: float) -> float:
    """Return the chance that needless unknowns leave at most a share of the squared residuals.

    Parameters
    ----------
    share : float
        The sum of squares of a model by that of a simpler one, which is true but for normal errors.
    freedom : float
        Degrees of freedom of the model, more than 0.
    unknowns : float
        How many more it has than the simpler one, more than 0.

    Examples
    --------
    >>> from termsel.data.record.chances import chance_of_better_fit
    >>> round(chance_of_better_fit(0.04, 2, 4), 4)
    0.0784
    """
    # F = (1 - share) / unknowns * freedom / share; P(F > f) = I_share(freedom / 2, unknowns / 2)
    # (26.6.2).
    share = min(share, 1.0)
    return _incomplete_beta(share, 1 - share, freedom / 2, unknowns / 2)


def _incomplete_beta(x: float, complement: float, a: float, b: float) -> float:
    """Return the incomplete beta function of x = 1 - `complement` by its continued fraction."""
    if x == 0.0 or complement == 0.0:
        return x
    # The fraction converges fast for such x, and that of the complement for others (26.5.8).
    if x > (a + 1) / (a + b + 2):
        return 1 - _incomplete_beta(complement, x, b, a)
    above = 1.0
    below = 1 / (1 - (a + b) * x / (a + 1))
    change = 0.0
    m = 0
    value = below / a * exp(
        a * log(x) + b * log(complement) + lgamma(a + b) - lgamma(a) - lgamma(b))
    while abs(change - 1) > QUANTILE_STEP:  # by the method of Lentz
        m += 1
        # The even and the odd coefficient of the continued fraction (26.5.8).
        for numerator in (m * (b - m) / (a + 2 * m - 1), -(a + m) * (a + b + m) / (a + 2 * m + 1)):
            numerator *= x / (a + 2 * m)
            above = 1 + numerator / above
            below = 1 / (1 + numerator * below)
            change = above * below
            value *= change
    return value


def _argument_of(rising: Callable[[float], float], value: float, x: float) -> float:
    """Return the x > 0 at which a rising function has a value, by secants that begin at x."""
    y = rising(x)
    after = 1.01 * x
    for _ in range(MAX_SECANTS):
        if abs(after - x) <= QUANTILE_STEP * x or (z := rising(after)) == y:
            break
        # The secant's zero; a positive number, so no step goes down to less than a tenth.
        secant = max(after + (value - z) * (after - x) / (z - y), after / 10)
        x = after
        y = z
        after = secant
    return after
