"""How much likelier each point is as a blunder than as a right one, given all others.

A right point has the noise of all. A blunder has, in line and in sample, a normal error some SIZES
as large, each as likely. Under one solution on the grid (see
`termsel.adjustment.bayesian.posterior`) the
errors e of a point that the others predict are t distributed: with their variances v by that of the
noise, and S' the sum of squares of the others, their density is proportional to

    (v_line v_sample)^-1/2 (S' + e_line^2 / v_line + e_sample^2 / v_sample)^-nu/2,

nu the degrees of freedom with the point. Without a point each solution is as likely as with it, by
the density that it gives to the point. So one posterior, of all points, is enough: the density of a
point given the others is the mean, over its solutions, of a density by that one.

The covariance of a random field is only a form, and what it predicts is less certain than it says:
where it is part of a solution, what v exceeds 1 by is enlarged by FORM.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from termsel.adjustment.bayesian.posterior import Posterior
from termsel.adjustment.bayesian.shrinkage import TINY
from termsel.data.features import FloatArray, IntArray

SIZES = np.array([10.0, 18.0, 32.0, 56.0, 100.0])
"""Standard deviations of blunders by that of the noise: from what spoils a fit to what anyone
sees."""

FORM = 2.0
"""Variance of what a random field predicts, by what follows from its covariance."""


def blunder_odds(parts: Iterable[tuple[float, Posterior, bool]], points: IntArray) -> FloatArray:
    """Return how much likelier points are as blunders, all others being right, shape (m,).

    It is the natural logarithm of the density of each as a blunder by that as a right point. The
    parts are solutions for all points, with their probability, and whether a random field is part
    of them; points (m,) are the numbers of those to judge.
    """
    wrong = []
    right = []
    for probability, posterior, local in parts:
        share = np.log(probability * posterior.cells.share)
        form = FORM if local else 1.0
        wrong.append(share + _log_density(posterior, points, form, SIZES))
        right.append(share + _log_density(posterior, points, form, np.ones(1)))
    return np.asarray(_total(wrong) - _total(right))


def _log_density(posterior: Posterior, points: IntArray, form: float,
                 sizes: FloatArray) -> FloatArray:
    """Return the logarithm of how likely errors of some sizes, each as likely, are at each point.

    By what each solution says of the point itself, shape (m, c).
    """
    left, errors = (np.stack([getattr(side, name).T.take(side.cell, axis=1)
                              for side in posterior.at(points)]) for name in ("left", "errors"))
    # The error without the point is e / l, of the variance 1 / l by that of the noise.
    squares = (errors / left) ** 2
    here = (squares * left).sum(axis=0)  # e^2 / l, what the point adds to the sum of squares
    others = np.maximum(posterior.square - here, posterior.noise + TINY * posterior.square)
    each = []
    for size in sizes:
        variance = size**2 + form * (1.0 / left - 1.0)
        # By the density of the point as measured, which the solution's probability contains.
        nearer = np.log((others + here) / (others + (squares / variance).sum(axis=0)))
        each.append((posterior.freedom * nearer - np.log(left * variance).sum(axis=0)) / 2)
    return np.asarray(np.logaddexp.reduce(each) - np.log(len(sizes)))


def _total(logs: list[FloatArray]) -> FloatArray:
    return np.asarray(np.logaddexp.reduce(np.concatenate(logs, axis=1), axis=1))
