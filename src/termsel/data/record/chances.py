"""Chances and quantiles of the t, F and chi-squared distributions.

Those of scipy.special take 0.4 s to import, which most runs need for nothing else. They are taken
above `MAX_SUMMED_FREEDOM` degrees of freedom. References: Abramowitz and Stegun 1964,
Handbook of Mathematical Functions, 6.5.29 and 26.5.8.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import exp, lgamma, log, sqrt

import numpy as np
from numpy.typing import NDArray

MAX_SUMMED_FREEDOM = 1e6
"""Most degrees of freedom of what is computed here."""

MAX_FIRST_STEP = 0.01
"""Largest first step to a quantile, as a part of where it begins."""

EPS, QUANTILE_STEP = 1e-16, 1e-12
"""Parts of a sum, and a step to a quantile, that change nothing."""

MAX_SECANTS = 60
"""Most secants to a quantile: rounding may keep the last ones from meeting `QUANTILE_STEP`."""


def quantile_of(values: NDArray[np.float64], share: float) -> NDArray[np.float64]:
    """Return the quantile of values along their last axis, (...), as `numpy.quantile` does.

    A `share`, 0 to 1, of the values is below it; it is NaN if a value is. numpy's own function, and
    `numpy.median`, import numpy.ma, which takes 0.01 s.
    """
    ordered = np.sort(values)  # any NaN is last
    below = int(share * (values.shape[-1] - 1))
    # It is interpolated linearly between the neighbours in order, as by numpy's default method.
    fraction = share * (values.shape[-1] - 1) - below
    low = ordered[..., below]
    high = ordered[..., min(below + 1, values.shape[-1] - 1)]
    # Two forms of the same interpolation, each exact at its end.
    between = (low + fraction * (high - low) if fraction < 0.5
               else high - (1 - fraction) * (high - low))
    return np.asarray(np.where(np.isnan(ordered[..., -1]), np.nan, between))


def median_of(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the median of values along their last axis, (...), as `numpy.median` does.

    It is NaN if there are no values, or if one is NaN.
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
    half_freedom = freedom / 2

    def chance_below(x: float) -> float:
        """Return the chance that a chi-squared number is below x, by its power series."""
        # With a = freedom / 2 it is P(a, x / 2), and P(a, y) = y^a e^-y / Gamma(a + 1)
        # (1 + y / (a + 1) + y^2 / ((a + 1)(a + 2)) + ...) (6.5.29).
        total = 0.0
        term = 1.0
        n = half_freedom
        while term > EPS * total:
            total = total + term
            n = n + 1
            term *= x / 2 / n
        return total * exp(half_freedom * log(x / 2) - x / 2 - lgamma(half_freedom + 1))

    # The third root of chi^2 / freedom is about normal with the variance 2 / (9 freedom) and the
    # mean 1 less that (Wilson and Hilferty 1931). The search starts roughly at its quantile.
    variance = 2 / 9 / freedom
    start = max(1e-3, 1 - variance + (2 * share - 1) * 1.8 * sqrt(variance)) ** 3 * freedom
    # A quarter of the standard deviation: far beyond it all chances are 1.
    return _argument_of(chance_below, share, start,
                        min(MAX_FIRST_STEP, 0.25 * sqrt(2 / freedom)))


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
    """Return the chance that a t distributed number is above t or below -t, for t >= 0.

    `freedom` is its degrees of freedom.
    """
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
    """Return the incomplete beta function I_x(a, b) by its continued fraction.

    `complement` is 1 - x.
    """
    if x == 0.0 or complement == 0.0:
        return x
    # The fraction converges slowly for larger x, where that of the complement is fast (26.5.8).
    if x > (a + 1) / (a + b + 2):
        return 1 - _incomplete_beta(complement, x, b, a)
    # In the method of Lentz each step multiplies the value by ratios of successive numerators and,
    # inverted, of successive denominators of the convergents.
    numerator_ratio = 1.0
    denominator_ratio = 1 / (1 - (a + b) * x / (a + 1))
    change = 0.0
    m = 0
    value = denominator_ratio / a * exp(
        a * log(x) + b * log(complement) + lgamma(a + b) - lgamma(a) - lgamma(b))
    while abs(change - 1) > QUANTILE_STEP:
        m += 1
        # The even and the odd coefficient of the continued fraction (26.5.8).
        for factor in (m * (b - m) / (a + 2 * m - 1), -(a + m) * (a + b + m) / (a + 2 * m + 1)):
            coefficient = factor * (x / (a + 2 * m))
            numerator_ratio = 1 + coefficient / numerator_ratio
            denominator_ratio = 1 / (1 + coefficient * denominator_ratio)
            change = numerator_ratio * denominator_ratio
            value *= change
    return value


def _argument_of(rising: Callable[[float], float], value: float, x: float,
                 first_step: float = MAX_FIRST_STEP) -> float:
    """Return the x > 0 at which a rising function has a value, by secants that begin at x.

    The first secant is through x and a step up of its part `first_step`. After MAX_SECANTS steps
    the last x is returned, whatever its function value.
    """
    y = rising(x)
    next_x = (1.0 + first_step) * x
    for _ in range(MAX_SECANTS):
        if abs(next_x - x) <= QUANTILE_STEP * x or (next_y := rising(next_x)) == y:
            break
        # A step that would end at less than a tenth of x is shortened, so that x stays positive.
        secant = max(next_x + (value - next_y) * (next_x - x) / (next_y - y), next_x / 10)
        x = next_x
        y = next_y
        next_x = secant
    return next_x
