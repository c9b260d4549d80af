"""How large denominators may become that must be positive at many points."""

from __future__ import annotations

import numpy as np

from termsel.data.features import FloatArray

_TOLERANCE = 1e-9  # of the linear programs
_MAXIMUM_ROUNDING = 1e-4  # of their maxima, relative: some 1e-6 where columns are nearly dependent


def largest_denominator_shares(
        denominators: FloatArray, guard: FloatArray, margin: float) -> FloatArray:
    """Return how large a denominator may be relative to the sum of all, and 1 relative to it.

    A denominator is 1 + d b, with the same coefficients b at all points. Where none of them is
    below the margin, none at the check points can be much larger than the others: its share of
    their sum is at most the maximum of a linear program in t = 1 / sum and t b.

    Parameters
    ----------
    denominators, guard : ndarray, shapes (c, k) and (g, k)
        Rows d at the check points, and at further points with the same condition.
    margin : float
        Least denominator; positive.

    Returns
    -------
    ndarray, shape (c + 1,)
        Largest share of each check point's denominator, then the largest t.
    """
    # Imported by need: only long proofs ask.
    from scipy.optimize import linprog

    c = len(denominators)
    columns = (denominators != 0.0).any(axis=0) | (guard != 0.0).any(axis=0)
    rows = np.column_stack([np.ones(c + len(guard)),
                            np.vstack([denominators, guard])[:, columns]])
    rows /= np.abs(rows).max(axis=0)  # the tolerances are absolute
    sums = rows[:c].sum(axis=0)
    lowest = rows.copy()
    lowest[:, 0] -= margin * (1.0 - _MAXIMUM_ROUNDING)
    largest = np.append(np.ones(c), 1.0 / (margin * c))
    # Of each check point, then t itself: the maximum over all b that keep every denominator at the
    # margin or above, where t times the sum of the check points' denominators is 1.
    for i, row in enumerate(np.vstack([rows[:c], np.eye(1, rows.shape[1])])):
        optimum = linprog(-row, A_ub=-lowest, b_ub=np.zeros(len(rows)), A_eq=sums[None], b_eq=[1.0],
                          bounds=(None, None), method="highs",
                          options={"primal_feasibility_tolerance": _TOLERANCE,
                                   "dual_feasibility_tolerance": _TOLERANCE})
        if optimum.status == 0:
            largest[i] = min(largest[i], -optimum.fun * (1.0 + _MAXIMUM_ROUNDING))
    return largest
