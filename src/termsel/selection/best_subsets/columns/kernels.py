"""The compiled enumeration of subsets behind `termsel.selection.best_subsets.subsets`.

A piece of work is a set of n columns and r targets, as vectors from which the columns in use
already are removed. At each depth of the tree one more column is in use, and lies removed from
the columns to its right and from the targets, whose rows thereby are residuals and errors. A
subset is a column at a depth: the columns in use there, and itself.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from termsel.adjustment.compiled import compile_lazily
from termsel.data.features import FloatArray, IntArray
from termsel.selection.best_subsets.columns.arrays import (
    Depth,
    Limits,
    Records,
    Vectors,
    WalkPosition,
)

LINEAR, RATIONAL, PRESS, RSS = range(4)
"""Kinds of score: squares of errors, or of quotients of errors and denominators, or of
leave-one-out errors, or of residuals."""

# Sums may be taken in any order (SIMD), yet infinities and NaN keep their meaning. A subset costs
# as much as two atomic operations on a reference count or the passing of some arrays, so slices
# are not counted (_nrt=False: nothing may be allocated here) and calls are inlined.
_compiled = partial(compile_lazily, _nrt=False, forceinline=True,
                    fastmath={"reassoc", "contract", "arcp", "nsz"})


@_compiled
def dot_product(a: FloatArray, b: FloatArray) -> float:
    """Return a'b."""
    total = 0.0
    for row in range(len(a)):
        total += a[row] * b[row]
    return total


@_compiled
def subtract(difference: FloatArray, a: FloatArray, b: FloatArray, ratio: float) -> None:
    """Write a - ratio b, also over a or b themselves."""
    for row in range(len(difference)):
        difference[row] = a[row] - ratio * b[row]


@_compiled
def subtract_measured(difference: FloatArray, a: FloatArray, b: FloatArray, ratio: float,
                      t: FloatArray) -> tuple[float, float]:
    """Write a - ratio b to `difference`; return its squared length and its product with t."""
    square = 0.0
    product = 0.0
    for row in range(len(difference)):
        value = a[row] - ratio * b[row]
        difference[row] = value
        square += value * value
        product += value * t[row]
    return square, product


@_compiled
def squared_remainder(t: FloatArray, v: FloatArray, ratio: float) -> float:
    """Return the squared length of t - ratio v."""
    total = 0.0
    for row in range(len(t)):
        error = t[row] - ratio * v[row]
        total += error * error
    return total


@_compiled
def _rational_squares(t: FloatArray, v: FloatArray, t_below: FloatArray, v_below: FloatArray,
                      ratio: float, margin: float) -> float:
    """Return the sum of squared quotients, infinity if a denominator is below the margin.

    Their numerators are t - ratio v; of the denominators only the sign is turned,
    ratio v_below - t_below, as `t_below` is what remains of 0 less them.
    """
    total = 0.0
    poles = 0
    for row in range(len(t)):
        denominator = ratio * v_below[row] - t_below[row]
        error = (t[row] - ratio * v[row]) / denominator
        poles += denominator < margin  # counted, as a branch would keep the loop from SIMD
        total += error * error
    return np.inf if poles else total


@_compiled
def _press_squares(level: Depth, n: int, c: int, j: int, limits: Limits) -> float:
    """Return the sum of squared leave-one-out errors; infinite if one is not determined.

    The errors are those of target j, after column c has joined those in use; n is the number of
    vectors before the targets. With residual e, leverage h and the denominator's cross-leverage g,
    a row's leave-one-out error is e / (1 - h), and its denominator is lower by g e / (1 - h).
    """
    t = level.top[0, n + j]
    v = level.top[0, c]
    t_below = level.extra[0, n + j]
    v_below = level.extra[0, c]
    ratio = level.share[0, c, j]
    per_square = 1.0 / level.square[0, c]
    total = 0.0
    without_error = 0
    for row in range(len(t)):
        residual = t[row] - ratio * v[row]
        # The column's own part of h and g is added here; the depth holds that of those in use.
        redundancy = 1.0 - level.leverage[row] - per_square * v[row] * v[row]
        # Error and denominator are both taken times 1 - h, which may be 0.
        denominator = ((ratio * v_below[row] - t_below[row]) * redundancy
                       - (level.cross[row] + per_square * v[row] * v_below[row]) * residual)
        error = residual / denominator
        too_small = denominator < limits.margin * redundancy
        without_error += (redundancy <= limits.tolerance) | too_small
        total += error * error
    return np.inf if without_error else total


@_compiled
def arrays_at_depth(vectors: Vectors, depth: int) -> Depth:
    """Return views of the arrays at a depth."""
    return Depth(vectors.top[depth], vectors.extra[depth], vectors.square[depth],
                 vectors.share[depth], vectors.leverage[depth], vectors.cross[depth])


@_compiled
def score_of(kind: int, level: Depth, c: int, systems: int, r: int, limits: Limits) -> float:
    """Return the score of one depth's column c, by any kind but PRESS.

    It is the sum over all systems, which are folds, and over the r targets of each.
    """
    # The column takes its share s of the target: what is left of the target is t - s v.
    n = level.top.shape[1] - r
    half = level.extra.shape[2] // 2
    total = limits.offset
    for f in range(systems):
        for j in range(r):
            if kind == LINEAR:
                total += squared_remainder(
                    level.extra[f, n + j], level.extra[f, c], level.share[f, c, j])
            elif kind == RSS:
                total += squared_remainder(
                    level.top[f, n + j], level.top[f, c], level.share[f, c, j])
            else:
                total += _rational_squares(level.extra[f, n + j, :half], level.extra[f, c, :half],
                                           level.extra[f, n + j, half:], level.extra[f, c, half:],
                                           level.share[f, c, j], limits.margin)
    return total


@_compiled
def _keeps_guard(vectors: Vectors, depth: int, cursor: IntArray, records: Records,
                 margin: float) -> bool:
    """Return whether all denominators at the guard points are at least `margin`.

    The coefficients of the subset are solved for and left in `records.x`. Column cursor[q] joined
    at depth q; it is still there as it was then, so that the triangular system is found row by row.
    """
    guard = records.guard
    x = records.x
    sums = records.sums
    n = len(guard) - 1
    for i in range(len(sums)):
        sums[i] = -guard[n, i]
    for q in range(depth, -1, -1):
        # Back substitution: v_q is orthogonal to all columns that joined before it, so that
        # v_q'y = |v_q|^2 x_q + sum over later s of (v_q'a_s) x_s.
        v = vectors.top[q, 0, cursor[q]]
        product = dot_product(v, vectors.top[q, 0, n])
        for s in range(q + 1, depth + 1):
            product -= dot_product(v, vectors.top[q, 0, cursor[s]]) * x[s]
        # No column, n, is of infinite length: its coefficient is 0.
        x[q] = product / vectors.square[q, 0, cursor[q]]
        subtract(sums, sums, guard[cursor[q]], -x[q])
    poles = 0
    for i in range(len(sums)):
        poles += not sums[i] >= margin  # NaN is a pole, too
    return poles == 0


@_compiled
def _has_parents(mask: Any, parents: Any) -> bool:
    """Return whether every column in `mask` (uint64, bit j: column j) has its parents in it, too.

    `parents` (k,) has a mask for each column.
    """
    lowest_bit = np.uint64(1)
    for j in range(len(parents)):
        if (mask >> np.uint64(j)) & lowest_bit != 0 and (parents[j] & ~mask) != 0:
            return False
    return True


@_compiled
def record(score: float, size: int, mask: Any, vectors: Vectors, depth: int, cursor: IntArray,
           records: Records, margin: float) -> None:
    """Write a subset to the records if it is the best of its size; in a tie the smaller mask is.

    A subset counts only if it has one of the columns `some_of`, if there are any, the parents of
    each of its columns, and denominators of at least `margin` at the guard points. `mask` is its
    columns in bits, and `cursor` (depths,) the column that joined at each depth.
    """
    best = records.best
    masks = records.masks
    some_of = records.some_of[0]
    # The guard costs most and comes last: few subsets are that good.
    if (
        (score < best[size] or (score == best[size] and mask < masks[size]))
        and (some_of == 0 or (mask & some_of) != 0)
        and _has_parents(mask, records.parents)
        and _keeps_guard(vectors, depth, cursor, records, margin)
    ):
        best[size] = score
        masks[size] = mask


@_compiled
def remove(vectors: Vectors, depth: int, f: int, i: int, c: int, n: int, r: int) -> None:
    """Remove column i from vector c of system f, from one depth to the next; the target n first.

    That is v_c - (v_i'v_c / v_i'v_i) v_i (Gram-Schmidt), in the control and in the score alike. `n`
    columns and `r` targets have one numbering; the length of the new vector and its share of the
    targets are computed on the way.
    """
    # v_c - (v_i'v_c / v_i'v_i) v_i; of a target that ratio is the share, which is known already.
    top = vectors.top
    extra = vectors.extra
    if c >= n:
        ratio = vectors.share[depth, f, i, c - n]
        subtract(top[depth + 1, f, c], top[depth, f, c], top[depth, f, i], ratio)
    else:
        ratio = dot_product(top[depth, f, i], top[depth, f, c]) / vectors.square[depth, f, i]
        length, product = subtract_measured(top[depth + 1, f, c], top[depth, f, c],
                                            top[depth, f, i], ratio, top[depth + 1, f, n])
        vectors.square[depth + 1, f, c] = length
        vectors.share[depth + 1, f, c, 0] = product / length
        for j in range(1, r):
            vectors.share[depth + 1, f, c, j] = dot_product(
                top[depth + 1, f, c], top[depth + 1, f, n + j]) / length
    subtract(extra[depth + 1, f, c], extra[depth, f, c], extra[depth, f, i], ratio)


@_compiled
def _open_leverage(vectors: Vectors, depth: int, i: int) -> None:
    """Write the leverages of the rows at the next depth: those here and the part of column i."""
    # Orthogonal columns add up: h = sum v^2 / v'v, and with the denominator's rows w, g = sum v w /
    # v'v.
    v = vectors.top[depth, 0, i]
    w = vectors.extra[depth, 0, i]
    square = vectors.square[depth, 0, i]
    leverage = vectors.leverage
    cross = vectors.cross
    for row in range(len(v)):
        coefficient = v[row] / square
        leverage[depth + 1, row] = leverage[depth, row] + coefficient * v[row]
        cross[depth + 1, row] = cross[depth, row] + coefficient * w[row]


@_compiled
def enumerate_subsets(kind: int, vectors: Vectors, limits: Limits, records: Records,
                      position: WalkPosition, single: bool | None, press: bool | None) -> None:
    """Enumerate all subsets of n columns in addition to those in use already.

    The kind is LINEAR, RATIONAL, PRESS or RSS. If f = r = 1, `single` is None: a type of its own,
    for which faster code is compiled. `press` is None unless the kind is PRESS: no other compiles
    that part. The vectors at depth 0 are given, those below are overwritten. The best subsets,
    the one in use already among them, are in `records` then.
    """
    if single is None:
        systems, r = 1, 1
    else:
        systems = vectors.top.shape[1]
        r = vectors.share.shape[3]
    n = vectors.top.shape[2] - r
    size = limits.size
    room = limits.room
    cursor = position.cursor
    mask = position.mask
    depth = 0
    # At depth 0 column n is scored as well, which is none: the subset in use already.
    first = 0 if room > 0 else n
    last = n + 1
    while True:
        level = arrays_at_depth(vectors, depth)
        level_above = arrays_at_depth(vectors, max(depth - 1, 0))
        i = first - 1  # the column that joined last
        if depth > 0:
            for f in range(systems):
                for j in range(r):
                    # Targets first: each column below needs its product with the new residuals.
                    subtract(level.top[f, n + j], level_above.top[f, n + j], level_above.top[f, i],
                             level_above.share[f, i, j])
                    subtract(level.extra[f, n + j], level_above.extra[f, n + j],
                             level_above.extra[f, i], level_above.share[f, i, j])
        # Each column is freed of the one that joined and scored at once, while it is in the cache.
        for c in range(first, last):
            dependent = False
            for f in range(systems):
                if depth > 0:
                    # v_c - (v_i'v_c / v_i'v_i) v_i: one step of modified Gram-Schmidt.
                    product = dot_product(level_above.top[f, i], level_above.top[f, c])
                    ratio = product / level_above.square[f, i]
                    length, product = subtract_measured(
                        level.top[f, c], level_above.top[f, c], level_above.top[f, i], ratio,
                        level.top[f, n])
                    subtract(level.extra[f, c], level_above.extra[f, c], level_above.extra[f, i],
                             ratio)
                    level.square[f, c] = length
                    level.share[f, c, 0] = product / length
                    for j in range(1, r):
                        level.share[
                            f, c, j] = dot_product(level.top[f, c], level.top[f, n + j]) / length
                dependent |= level.square[f, c] <= vectors.floor[f, c]
            if dependent:
                level.square[0, c] = 0.0  # a mark not to descend
                continue
            if press is None:
                score = score_of(kind, level, c, systems, r, limits)
            else:  # of one system
                score = limits.offset
                for j in range(r):
                    score += _press_squares(level, n, c, j, limits)
            new_size = size + depth + (c < n)  # column n adds none
            if score <= records.best[new_size]:
                cursor[depth] = c
                record(score, new_size, mask[depth] | records.bits[c], vectors=vectors, depth=depth,
                       cursor=cursor, records=records, margin=limits.margin)
        cursor[depth] = first
        # Column n, the subset in use itself, was scored above: below depth 0 it comes no more.
        last = n
        # On to the next column with others to its right, upwards where a depth has no further one.
        while True:
            i = cursor[depth]
            if i >= n - 1 or depth + 1 >= room:
                if depth == 0:
                    return
                depth -= 1
            elif vectors.square[depth, 0, i] > 0.0:
                break
            cursor[depth] += 1
        if press is not None:
            _open_leverage(vectors, depth, i)
        mask[depth + 1] = mask[depth] | records.bits[i]
        depth += 1
        first = i + 1
