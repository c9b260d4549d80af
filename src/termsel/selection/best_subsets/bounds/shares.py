"""How large denominators may become that must be positive at many points."""

from __future__ import annotations

import numpy as np

from termsel.data.features import FloatArray

_TOLERANCE = 1e-9  # of the linear programs
_MAXIMUM_ROUNDING = 1e-4  # of their maxima, relative: some 1e-6 where columns are nearly dependent


def largest_denominator_shares(
        denominators: FloatArray, guard: FloatArray, margin: float) -> FloatArray:
    """Return upper limits of each check point's denominator divided by the sum of all of these.

    A denominator is 1 + d b, with the same coefficients b at all points. Where no denominator is
    below the margin, none at a check point can be much larger than those at the others: its share
    of their sum is at most the maximum of a linear program in t = 1 / sum and t b.

    Parameters
    ----------
    denominators, guard : ndarray, shapes (c, k) and (g, k)
        Rows d at the check points, and at further points with the same condition.
    margin : float
        Least denominator; positive.

    Returns
    -------
    ndarray, shape (c + 1,)
        Largest share of each check point's denominator, then the largest t. Where a program cannot
        be solved, these are the limits that are true of any b: 1, and 1 / (c margin).
    """
    # Imported by need: only long proofs ask.
    from scipy.optimize import linprog

    c = len(denominators)
    in_denominators = (denominators != 0.0).any(axis=0) | (guard != 0.0).any(axis=0)
    rows = np.column_stack([np.ones(c + len(guard)),
                            np.vstack([denominators, guard])[:, in_denominators]])
    rows /= np.abs(rows).max(axis=0)  # the tolerances are absolute
    sums = rows[:c].sum(axis=0)
    above_margin = rows.copy()
    above_margin[:, 0] -= margin * (1.0 - _MAXIMUM_ROUNDING)
    # All shares are positive and their sum is 1; the sum itself is c margins or more.
    largest = np.append(np.ones(c), 1.0 / (margin * c))
    # Of each check point, then t itself: the maximum over all b that keep every denominator at the
    # margin or above, where t times the sum of the check points' denominators is 1.
    for i, row in enumerate(np.vstack([rows[:c], np.eye(1, rows.shape[1])])):
        optimum = linprog(-row, A_ub=-above_margin, b_ub=np.zeros(len(rows)), A_eq=sums[None],
                          b_eq=[1.0],
                          bounds=(None, None), method="highs",
                          options={"primal_feasibility_tolerance": _TOLERANCE,
                                   "dual_feasibility_tolerance": _TOLERANCE})
        if optimum.status == 0:  # solved; else what is true of any b stays
            largest[i] = min(largest[i], -optimum.fun * (1.0 + _MAXIMUM_ROUNDING))
    return largest
