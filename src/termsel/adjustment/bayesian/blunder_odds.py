"""How much likelier each point is as a blunder than as a right one, given all others.

A right point has the noise of all. A blunder has, in line and in sample, a normal error that is
one of BLUNDER_SIZES as large, each as likely. Under one solution on the grid (see
`termsel.adjustment.bayesian.posterior`) the errors e of a point that the others predict are t
distributed: with their variances v by that of the noise, and S' the sum of squares of the others,
their density is proportional to

    (v_line v_sample)^-1/2 (S' + e_line^2 / v_line + e_sample^2 / v_sample)^-nu/2,

nu the degrees of freedom with the point. Without a point each solution is as likely as with it, by
the density that it gives to the point. So one posterior, of all points, is enough: the density of a
point given the others is the mean, over its solutions, of a density by that one.

The covariance of a random field is only a form, and what it predicts is less certain than it says:
where it is part of a solution, what v exceeds 1 by is enlarged by FIELD_VARIANCE_FACTOR.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from termsel.adjustment.bayesian.posterior import Posterior
from termsel.adjustment.bayesian.shrinkage import MIN_REDUNDANCY
from termsel.data.features import FloatArray, IntArray

BLUNDER_SIZES = np.array([10.0, 18.0, 32.0, 56.0, 100.0])
"""Standard deviations of blunders by that of the noise: from what spoils a fit to what anyone
sees."""

FIELD_VARIANCE_FACTOR = 2.0
"""Variance of what a random field predicts, by what follows from its covariance."""


def blunder_odds(solutions: Iterable[tuple[float, Posterior, bool]],
                 points: IntArray) -> FloatArray:
    """Return how much likelier points are as blunders, all others being right, shape (m,).

    It is the natural logarithm of the density of each as a blunder by that as a right point: above
    0 a blunder explains the error better, at ln 19 it does so 19 times as well. The solutions are
    for all points, with their probability, and whether a random field is part of them; points (m,)
    are the numbers of those to judge.
    """
    wrong = []
    right = []
    for probability, solution, has_field in solutions:
        log_share = np.log(probability * solution.cells.share)
        factor = FIELD_VARIANCE_FACTOR if has_field else 1.0
        wrong.append(log_share + _log_density(solution, points, factor, BLUNDER_SIZES))
        right.append(log_share + _log_density(solution, points, factor, np.ones(1)))
    return np.asarray(_log_sum(wrong) - _log_sum(right))


def _log_density(posterior: Posterior, points: IntArray, factor: float,
                 sizes: FloatArray) -> FloatArray:
    """Return the logarithm of how likely errors of some sizes, each as likely, are at each point.

    By what each solution says of the point itself, shape (m, c). What the variance of a prediction
    exceeds that of the noise by is multiplied by the factor.
    """
    axes = posterior.errors_of(points)
    # Of line and sample, m points and the c cells, each with the solution of its axis.
    redundancies = np.stack([axis.redundancies.T.take(axis.solution_of_cell, axis=1)
                             for axis in axes])
    errors = np.stack([axis.errors.T.take(axis.solution_of_cell, axis=1) for axis in axes])
    # The error without the point is e / l, of the variance 1 / l by that of the noise.
    squares = (errors / redundancies) ** 2
    point_squares = (squares * redundancies).sum(axis=0)  # e^2 / l: what it adds to the sum S
    other_squares = np.maximum(posterior.square - point_squares,
                               posterior.noise + MIN_REDUNDANCY * posterior.square)
    log_densities = []
    for size in sizes:
        variance = size**2 + factor * (1.0 / redundancies - 1.0)
        # By the density of the point as measured, which the solution's probability contains.
        gain = np.log((other_squares + point_squares)
                      / (other_squares + (squares / variance).sum(axis=0)))
        log_densities.append(
            (posterior.freedom * gain - np.log(redundancies * variance).sum(axis=0)) / 2)
    return np.asarray(np.logaddexp.reduce(log_densities) - np.log(len(sizes)))


def _log_sum(logs: list[FloatArray]) -> FloatArray:
    """Return the logarithm of the sum over all solutions, of logarithms (m, c) of each."""
    return np.asarray(np.logaddexp.reduce(np.concatenate(logs, axis=1), axis=1))
