"""The compiled enumeration of subsets behind `termsel.enumeration.subsets`.

A piece of work is a set of n columns and r targets, as vectors from which the columns in use
already are removed. At each depth of the tree one more column is in use, and lies removed from
the columns to its right and from the targets, whose rows thereby are residuals and errors. A
subset is a column at a depth: the columns in use there, and itself.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from termsel.adjustment.compiled import compiled
from termsel.enumeration.columns.arrays import Levels, Limits, Records
from termsel.measurements.features import FloatArray, IntArray

LINEAR, RATIONAL, PRESS, RSS = range(4)
"""Kinds of score: squares of errors, or of quotients of errors and denominators, or of
leave-one-out errors, or of residuals."""

# Sums may be taken in any order (SIMD), yet infinities and NaN keep their meaning. A subset costs
# as much as two atomic operations on a reference count or the passing of some arrays, so slices
# are not counted (_nrt=False: nothing may be allocated here) and calls are inlined.
_compiled = partial(compiled, _nrt=False, forceinline=True,
                    fastmath={"reassoc", "contract", "arcp", "nsz"})


@_compiled
def dot(a: FloatArray, b: FloatArray) -> float:
    total = 0.0
    for row in range(len(a)):
        total += a[row] * b[row]
    return total


@_compiled
def less(out: FloatArray, a: FloatArray, b: FloatArray, ratio: float) -> None:
    """Write a - ratio b."""
    for row in range(len(out)):
        out[row] = a[row] - ratio * b[row]


@_compiled
def less_measured(out: FloatArray, a: FloatArray, b: FloatArray, ratio: float,
                   t: FloatArray) -> tuple[float, float]:
    """Write a - ratio b; return its squared length and its product with t."""
    square = 0.0
    product = 0.0
    for row in range(len(out)):
        value = a[row] - ratio * b[row]
        out[row] = value
        square += value * value
        product += value * t[row]
    return square, product


@_compiled
def _squares(t: FloatArray, v: FloatArray, ratio: float) -> float:
    total = 0.0
    for row in range(len(t)):
        error = t[row] - ratio * v[row]
        total += error * error
    return total


@_compiled
def _rational_squares(t: FloatArray, v: FloatArray, t_below: FloatArray, v_below: FloatArray,
                      ratio: float, margin: float) -> float:
    """Return the sum of squared quotients, or infinity below the margin."""
    total = 0.0
    poles = 0
    for row in range(len(t)):
        denominator = ratio * v_below[row] - t_below[row]
        error = (t[row] - ratio * v[row]) / denominator
        poles += denominator < margin
        total += error * error
    return np.inf if poles else total


@_compiled
def _press_squares(t: FloatArray, v: FloatArray, t_below: FloatArray, v_below: FloatArray,
                   ratio: float, per_square: float, leverage: FloatArray, cross: FloatArray,
                   limits: Limits) -> float:
    """Return the sum of squared leave-one-out errors, or infinity if there is none.

    With residual e, leverage h and the denominator's cross-leverage g, a row's leave-one-out
    error is e / (1 - h), and its denominator is lower by g e / (1 - h).
    """
    total = 0.0
    bad = 0
    for row in range(len(t)):
        residual = t[row] - ratio * v[row]
        rest = 1.0 - leverage[row] - per_square * v[row] * v[row]
        denominator = ((ratio * v_below[row] - t_below[row]) * rest
                       - (cross[row] + per_square * v[row] * v_below[row]) * residual)
        error = residual / denominator
        bad += (rest <= limits.tolerance) | (denominator < limits.margin * rest)
        total += error * error
    return np.inf if bad else total


@_compiled
def score_of(kind: int, top: FloatArray, extra: FloatArray, square: FloatArray, share: FloatArray,
           leverage: FloatArray, cross: FloatArray, c: int, systems: int, r: int,
           limits: Limits) -> float:
    """Return the score of one depth's column c."""
    n = top.shape[1] - r
    half = extra.shape[2] // 2
    total = limits.offset
    for f in range(systems):
        for j in range(r):
            if kind == LINEAR:
                total += _squares(extra[f, n + j], extra[f, c], share[f, c, j])
            elif kind == RSS:
                total += _squares(top[f, n + j], top[f, c], share[f, c, j])
            elif kind == RATIONAL:
                total += _rational_squares(
                    extra[f, n + j, :half], extra[f, c, :half], extra[f, n + j, half:],
                    extra[f, c, half:], share[f, c, j], limits.margin)
            else:
                total += _press_squares(
                    top[f, n + j], top[f, c], extra[f, n + j], extra[f, c], share[f, c, j],
                    1.0 / square[f, c], leverage, cross, limits)
    return total


@_compiled
def _keeps_guard(levels: Levels, depth: int, cursor: IntArray, records: Records,
                 margin: float) -> bool:
    """Solve for the coefficients of the subset and test the guard points' denominators.

    Column cursor[q] joined at depth q; it is still there as it was then, so that the
    triangular system is found row by row.
    """
    guard, x, sums = records.guard, records.x, records.sums
    n = len(guard) - 1
    for i in range(len(sums)):
        sums[i] = -guard[n, i]
    for q in range(depth, -1, -1):
        v = levels.top[q, 0, cursor[q]]
        product = dot(v, levels.top[q, 0, n])
        for s in range(q + 1, depth + 1):
            product -= dot(v, levels.top[q, 0, cursor[s]]) * x[s]
        x[q] = product / levels.square[q, 0, cursor[q]]
        less(sums, sums, guard[cursor[q]], -x[q])
    poles = 0
    for i in range(len(sums)):
        poles += not sums[i] >= margin
    return poles == 0


@_compiled
def _has_parents(mask: Any, parents: Any) -> bool:
    """Return whether a subset has the parents of all its columns."""
    one = np.uint64(1)
    for j in range(len(parents)):
        if (mask >> np.uint64(j)) & one != 0 and (parents[j] & ~mask) != 0:
            return False
    return True


@_compiled
def record(score: float, size: int, mask: Any, levels: Levels, depth: int, cursor: IntArray,
            records: Records, margin: float) -> None:
    """Keep a subset that is the best of its size; in a tie the smaller mask."""
    best, masks, some_of = records.best, records.masks, records.some_of[0]
    if (
        (score < best[size] or (score == best[size] and mask < masks[size]))
        and (some_of == 0 or (mask & some_of) != 0)
        and _has_parents(mask, records.parents)
        and _keeps_guard(levels, depth, cursor, records, margin)
    ):
        best[size] = score
        masks[size] = mask


@_compiled
def _open_leverage(v: FloatArray, w: FloatArray, square: float, leverage: FloatArray,
                   cross: FloatArray, depth: int) -> None:
    """Add the column's part to the leverages, from one depth to the next."""
    for row in range(len(v)):
        part = v[row] / square
        leverage[depth + 1, row] = leverage[depth, row] + part * v[row]
        cross[depth + 1, row] = cross[depth, row] + part * w[row]


@_compiled
def walk(kind: int, levels: Levels, limits: Limits, records: Records, used: Any,
         counts: IntArray, cursor: IntArray, mask: Any, single: bool | None) -> int:
    """Enumerate all subsets of n columns in addition to those in use already.

    Parameters
    ----------
    kind : int
        LINEAR, RATIONAL, PRESS or RSS.
    levels : Levels
    limits : Limits
    records : Records
    used : uint64
        Mask of the subset in use already.
    counts : ndarray of int, shape (n + 1, room + 1)
        Number of subsets of so many columns with at most so many members.
    cursor, mask
        Space for integers (depths,) and uint64 (depths,).
    single : bool, optional
        None if f = r = 1: a type of its own, for which faster code is compiled.

    Returns
    -------
    int
        Number of subsets without a score.
    """
    if single is None:
        systems, r = 1, 1
    else:
        systems, r = levels.top.shape[1], levels.share.shape[3]
    n = levels.top.shape[2] - r
    size, room = limits.size, limits.room
    infeasible, depth = 0, 0
    mask[0] = used
    first, last = 0 if room > 0 else n, n + 1
    while True:
        top, extra = levels.top[depth], levels.extra[depth]
        square, share = levels.square[depth], levels.share[depth]
        leverage, cross = levels.leverage[depth], levels.cross[depth]
        before = max(depth - 1, 0)
        top0, extra0 = levels.top[before], levels.extra[before]
        square0, share0 = levels.square[before], levels.share[before]
        i = first - 1
        if depth > 0:
            for f in range(systems):
                for j in range(r):
                    less(top[f, n + j], top0[f, n + j], top0[f, i], share0[f, i, j])
                    less(extra[f, n + j], extra0[f, n + j], extra0[f, i], share0[f, i, j])
        for c in range(first, last):
            dependent = False
            for f in range(systems):
                if depth > 0:
                    ratio = dot(top0[f, i], top0[f, c]) / square0[f, i]
                    length, product = less_measured(top[f, c], top0[f, c], top0[f, i], ratio,
                                                     top[f, n])
                    less(extra[f, c], extra0[f, c], extra0[f, i], ratio)
                    square[f, c] = length
                    share[f, c, 0] = product / length
                    for j in range(1, r):
                        share[f, c, j] = dot(top[f, c], top[f, n + j]) / length
                dependent |= square[f, c] <= levels.floor[f, c]
            if dependent:
                square[0, c] = 0.0
                infeasible += counts[n - 1 - c, room - depth - 1]
                continue
            score = score_of(kind, top, extra, square, share, leverage, cross, c, systems, r,
                             limits)
            infeasible += not score < np.inf
            new = size + depth + (c < n)
            if score <= records.best[new]:
                cursor[depth] = c
                record(score, new, mask[depth] | records.bits[c], levels, depth, cursor, records,
                        limits.margin)
        cursor[depth] = first
        last = n
        while True:
            i = cursor[depth]
            if i >= n - 1 or depth + 1 >= room:
                if depth == 0:
                    return infeasible
                depth -= 1
            elif levels.square[depth, 0, i] > 0.0:
                break
            cursor[depth] += 1
        if kind == PRESS:
            _open_leverage(levels.top[depth, 0, i], levels.extra[depth, 0, i],
                           levels.square[depth, 0, i], levels.leverage, levels.cross, depth)
        mask[depth + 1] = mask[depth] | records.bits[i]
        depth += 1
        first = i + 1
