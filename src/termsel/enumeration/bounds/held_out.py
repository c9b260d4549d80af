"""The compiled branch and bound for held-out errors without denominators.

Let I be the columns in use, and let T and r be the columns F still to come and the target, without
their parts along I. A subset S adds some of F to I. Its residuals are e = r - T x for some x. With
the projection H on the columns of S, the errors of rows f that are held out together are
(1 - H_ff)^-1 e_f (Allen 1974, Technometrics 16(1), for single rows).

Rows held out one by one (PRESS): H_ff is the leverage h of a row. It is not lower than that under
I, as the columns of S span those of I: h(I) <= h(S) < 1. Hence

    sum of (e_i / (1 - h_i(S)))^2 >= sum of (e_i / (1 - h_i(I)))^2
                                  >= minimum over x of sum of ((r - T x)_i / (1 - h_i(I)))^2,

a weighted least squares that does not depend on S any more, with weights that grow with I.

Folds (LINEAR, in several systems): the eigenvalues of H_ff are in [0, 1), so that those of
(1 - H_ff)^-1 are at least 1, and |(1 - H_ff)^-1 e_f| >= |e_f|. The sum over the folds is at least
the residual sum of squares as often as each row is held out, and the minimum of that over x.

If the minimum is above the best score of every size that S may have, no such S need be looked at.
With several targets the minima add up. termsel's own formulation.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from termsel.adjustment.compiled import compiled
from termsel.enumeration.columns.arrays import Levels, Limits, Records
from termsel.enumeration.columns.kernels import PRESS, dot, less, less_measured, record
from termsel.measurements.features import FloatArray, IntArray

_compiled = partial(compiled, _nrt=False, fastmath={"reassoc", "contract", "arcp", "nsz"})

_ENUMERATED = 1 << 6  # subsets that cost less than a bound
_ROUNDING = 1e-6  # of a minimum, relative


@_compiled
def branch_held_out(kind: int, levels: Levels, limits: Limits, records: Records, used: Any,
                    counts: IntArray, cursor: IntArray, ends: IntArray, mask: Any,
                    work: FloatArray) -> tuple[int, int]:
    """Decide all subsets of n columns in addition to those in use already.

    Parameters
    ----------
    kind : int
        PRESS without denominators, or LINEAR; then the rows of system 0 have all residuals of the
        adjustment, times the root of how often each row is held out, and leverages are 0.
    levels, limits, records, used, counts, cursor, mask
        As for `subset_kernels.walk`.
    ends : ndarray of int, shape (depths,)
        Space.
    work : ndarray, shape (n + r, rows)
        Space.

    Returns
    -------
    infeasible, pruned : int
        Number of subsets that were found to have no score, and of those that a bound ruled out.
    """
    r = levels.share.shape[3]
    n = levels.top.shape[2] - r
    size, most = limits.size, limits.room
    infeasible, pruned, depth, first = 0, 0, 0, 0
    entering = most > 0 and n > 0
    mask[0] = used
    score = _score(kind, levels, 0, n, limits)
    infeasible += not score < np.inf
    if score <= records.best[size]:
        cursor[0] = n
        record(score, size, used, levels, 0, cursor, records, limits.margin)
    if not entering:
        return infeasible, pruned
    while True:
        left = most - depth
        if entering:
            end = n
            if counts[n - first, left] > _ENUMERATED:
                limit = 0.0
                for new in range(size + depth + 1, size + depth + min(left, n - first) + 1):
                    limit = max(limit, records.best[new])
                if 0.0 < limit < np.inf:
                    end = first_closed(levels.top[depth, 0], levels.leverage[depth], first, n,
                                        limit, work)
                pruned += counts[n - end, left] - 1
            ends[depth] = end
            cursor[depth] = first
        else:
            cursor[depth] += 1
        i = cursor[depth]
        entering = False
        if i >= ends[depth]:
            if depth == 0:
                return infeasible, pruned
            depth -= 1
            continue
        dependent = False
        for f in range(levels.square.shape[1]):
            dependent |= levels.square[depth, f, i] <= levels.floor[f, i]
        if dependent:
            infeasible += counts[n - 1 - i, left - 1]
            continue
        score = _score(kind, levels, depth, i, limits)
        infeasible += not score < np.inf
        if score <= records.best[size + depth + 1]:
            record(score, size + depth + 1, mask[depth] | records.bits[i], levels, depth, cursor,
                   records, limits.margin)
        if left > 1 and i < n - 1:
            _descend(kind, levels, depth, i, n, r)
            mask[depth + 1] = mask[depth] | records.bits[i]
            depth += 1
            first = i + 1
            entering = True


@_compiled
def _score(kind: int, levels: Levels, depth: int, c: int, limits: Limits) -> float:
    """Return the sum of squared held-out errors with column c, or infinity without any."""
    n, r = levels.square.shape[2] - 1, levels.share.shape[3]
    total, bad = limits.offset, 0
    if kind != PRESS:
        for f in range(levels.share.shape[1]):
            for j in range(r):
                errors, ratio = levels.extra[depth, f, n + j], levels.share[depth, f, c, j]
                for row in range(len(errors)):
                    error = errors[row] - ratio * levels.extra[depth, f, c, row]
                    total += error * error
        return total
    v, leverage = levels.top[depth, 0, c], levels.leverage[depth]
    per_square = 1.0 / levels.square[depth, 0, c]
    for j in range(r):
        t, ratio = levels.top[depth, 0, n + j], levels.share[depth, 0, c, j]
        for row in range(len(t)):
            value = v[row] if c < n else 0.0
            rest = 1.0 - leverage[row] - per_square * value * value
            error = (t[row] - ratio * value) / rest
            bad += rest <= limits.tolerance
            total += error * error
    return np.inf if bad else total


@_compiled
def _descend(kind: int, levels: Levels, depth: int, i: int, n: int, r: int) -> None:
    """Remove column i from those to its right and the targets, from one depth to the next."""
    for f in range(levels.square.shape[1]):
        old, new = levels.top[depth, f], levels.top[depth + 1, f]
        before, after = levels.extra[depth, f], levels.extra[depth + 1, f]
        square = levels.square[depth, f, i]
        for j in range(r):
            less(new[n + j], old[n + j], old[i], levels.share[depth, f, i, j])
            if kind != PRESS:
                less(after[n + j], before[n + j], before[i], levels.share[depth, f, i, j])
        for c in range(i + 1, n):
            ratio = dot(old[i], old[c]) / square
            length, product = less_measured(new[c], old[c], old[i], ratio, new[n])
            levels.square[depth + 1, f, c] = length
            levels.share[depth + 1, f, c, 0] = product / length
            for j in range(1, r):
                levels.share[depth + 1, f, c, j] = dot(new[c], new[n + j]) / length
            if kind != PRESS:
                less(after[c], before[c], before[i], ratio)
    old = levels.top[depth, 0]
    for row in range(old.shape[1]):
        more = old[i, row] * old[i, row] / levels.square[depth, 0, i] if kind == PRESS else 0.0
        levels.leverage[depth + 1, row] = levels.leverage[depth, row] + more


@_compiled
def first_closed(top: FloatArray, leverage: FloatArray, first: int, n: int, limit: float,
                  work: FloatArray) -> int:
    """Return a column from which on no subset scores `limit` or less.

    The weighted columns are removed from the targets, from the last to the first: what is left
    after the last i is the minimum for these. Inner products would lose its digits where the
    targets are long; modified Gram-Schmidt keeps them, as in `subset_kernels`.
    """
    vectors, rows = top.shape
    for i in range(first, vectors):
        for k in range(rows):
            work[i, k] = top[i, k] / (1.0 - leverage[k])
    for i in range(n - 1, first - 1, -1):
        for later in range(n - 1, i, -1):
            less(work[i], work[i], work[later], dot(work[i], work[later]))
        length = np.sqrt(dot(work[i], work[i]))
        if length > 0.0:  # however short: one direction more leaves no more of the targets
            for k in range(rows):
                work[i, k] /= length
        total = 0.0
        for j in range(n, vectors):
            less(work[j], work[j], work[i], dot(work[j], work[i]))
            total += dot(work[j], work[j])
        if not total > limit * (1.0 + _ROUNDING):
            return i + 1
    return first


def least_held_out(levels: Levels) -> float:
    """Return a lower bound of the scores of all subsets of a piece."""
    rows, leverage = levels.top[0, 0].T, levels.leverage[0]
    r = levels.share.shape[3]
    rows = rows / (1.0 - np.minimum(leverage, 1.0 - 1e-9))[:, None]
    q, targets = np.linalg.qr(rows[:, :-r])[0], rows[:, -r:]
    return float(((targets - q @ (q.T @ targets)) ** 2).sum())
