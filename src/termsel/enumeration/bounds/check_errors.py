"""The compiled branch and bound behind `termsel.enumeration.subsets`.

The tree is that of `subset_kernels.walk`, for one system with one target. At every node a bound
closes the columns from some point on; small rests are enumerated from inner products.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from termsel.adjustment.compiled import compiled
from termsel.enumeration.bounds.closed import first_closed
from termsel.enumeration.columns.arrays import Blocks, Levels, Limits, Records, Space
from termsel.enumeration.columns.blocks import SHARE, eliminate, pairs, prepare, single
from termsel.enumeration.columns.kernels import (
    RATIONAL,
    dot,
    less,
    less_measured,
    record,
    score_of,
)
from termsel.measurements.features import FloatArray, IntArray

_compiled = partial(compiled, _nrt=False, fastmath={"reassoc", "contract", "arcp", "nsz"})

_BLOCK = 1 << 7  # subsets up to which inner products alone cost less than a bound


@_compiled
def branch(kind: int, levels: Levels, limits: Limits, records: Records, used: Any,
           counts: IntArray, cursor: IntArray, ends: IntArray, mask: Any, upper: FloatArray,
           space: Space, blocks: Blocks) -> tuple[int, int]:
    """Decide all subsets of n columns in addition to those in use already.

    Parameters
    ----------
    kind : int
        LINEAR or RATIONAL.
    levels, limits, records, used, counts, cursor, mask
        As for `subset_kernels.walk`; one system, one target.
    ends : ndarray of int, shape (depths,)
        Space.
    upper : ndarray, shape (depths, e + 1)
        Space for the limits of `first_closed`.
    space, blocks : Space and Blocks

    Returns
    -------
    infeasible, pruned : int
        Number of subsets that were found to have no score, and of those that a bound ruled out.
    """
    n = levels.top.shape[2] - 1
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
    for k in range(upper.shape[1]):
        upper[0, k] = 1.0
    if kind == RATIONAL:
        upper[0, -1] /= limits.margin * (upper.shape[1] - 1)
    while True:
        left = most - depth
        if entering:
            end, open_ = n, counts[n - first, left]
            limit = 0.0
            for new in range(size + depth + 1, size + depth + min(left, n - first) + 1):
                limit = max(limit, records.best[new])
            limit = limit * (1.0 + 1e-9) + limits.slack - limits.offset
            if open_ > _BLOCK and limit < np.inf:
                end = first if limit < 0.0 else first_closed(
                    levels.top[depth, 0], levels.extra[depth, 0], first, n, limit, upper[depth],
                    kind == RATIONAL, space)
                pruned += counts[n - end, left] - 1
            ends[depth] = end
            if first < end and left > 1 and open_ <= _BLOCK:
                lost = _block(kind, levels, limits, records, depth, first, end, cursor, mask[depth],
                              upper[depth], blocks)
                if lost >= 0:
                    infeasible += lost
                    ends[depth] = first
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
        if levels.square[depth, 0, i] <= levels.floor[0, i]:
            infeasible += counts[n - 1 - i, left - 1]
            continue
        score = _score(kind, levels, depth, i, limits)
        infeasible += not score < np.inf
        if score <= records.best[size + depth + 1]:
            record(score, size + depth + 1, mask[depth] | records.bits[i], levels, depth, cursor,
                   records, limits.margin)
        if left > 1 and i < n - 1:
            for c in range(n, i, -1):
                _remove(levels, depth, i, c, n)
            mask[depth + 1] = mask[depth] | records.bits[i]
            for k in range(upper.shape[1]):
                upper[depth + 1, k] = upper[depth, k]
            depth += 1
            first = i + 1
            entering = True


@_compiled
def _remove(levels: Levels, depth: int, i: int, c: int, n: int) -> None:
    """Remove column i from column c (or from the target, c = n), from one depth to the next.

    The target must be the first.
    """
    top, extra = levels.top, levels.extra
    if c == n:
        ratio = levels.share[depth, 0, i, 0]
        less(top[depth + 1, 0, n], top[depth, 0, n], top[depth, 0, i], ratio)
    else:
        ratio = dot(top[depth, 0, i], top[depth, 0, c]) / levels.square[depth, 0, i]
        length, product = less_measured(top[depth + 1, 0, c], top[depth, 0, c], top[depth, 0, i],
                                        ratio, top[depth + 1, 0, n])
        levels.square[depth + 1, 0, c] = length
        levels.share[depth + 1, 0, c, 0] = product / length
    less(extra[depth + 1, 0, c], extra[depth, 0, c], extra[depth, 0, i], ratio)


@_compiled
def _score(kind: int, levels: Levels, depth: int, c: int, limits: Limits) -> float:
    return score_of(kind, levels.top[depth], levels.extra[depth], levels.square[depth],
                    levels.share[depth], levels.leverage[depth], levels.cross[depth], c, 1, 1,
                    limits)


@_compiled
def _block(kind: int, levels: Levels, limits: Limits, records: Records, depth: int, first: int,
           end: int, cursor: IntArray, mask: Any, upper: FloatArray, b: Blocks) -> int:
    """Decide all subsets that add columns, the first of them first, ..., end - 1.

    Returns
    -------
    int
        Number of subsets that were found to have no score; -1 if inner products are too
        inaccurate, so that the vectors must decide.
    """
    n = levels.top.shape[2] - 1
    count, left, best = n - first, limits.room - depth, records.best
    lost, below = prepare(levels.top[depth, 0], levels.extra[depth, 0], first, n, upper,
                          levels.floor[0], b)
    infeasible, level = 0, 0
    b.share[0] = 1.0
    b.cursor[0] = -1
    while True:
        b.cursor[level] += 1
        i = b.cursor[level]
        if i >= (end - first if level == 0 else count):
            if level == 0:
                return infeasible
            level -= 1
            continue
        share = b.share[level] * b.control.own[level, i] * b.inverse[i]
        if not share > SHARE:
            return -1
        new = limits.size + depth + level + 1
        if not single(i, level, _root(best[new], limits), lost, below, b):
            infeasible += _exactly(kind, levels, limits, records, depth, first, level + 1, cursor,
                                   mask, b)
        if i == count - 1:
            continue
        if left - level == 2:
            least = _root(best[new + 1], limits)
            if pairs(i, level, count, share, least, lost, below, b):
                for c in range(i + 1, count):
                    if not b.row[c] > 0.0:
                        b.cursor[level + 1] = c
                        infeasible += _exactly(kind, levels, limits, records, depth, first,
                                               level + 2, cursor, mask, b)
        else:
            eliminate(i, level, count, b)
            b.share[level + 1] = share
            b.cursor[level + 1] = i
            level += 1


@_compiled
def _root(best: float, limits: Limits) -> float:
    """Return the root of a score above which none is the best."""
    return float(np.sqrt(max(0.0, best * (1.0 + 1e-9) + limits.slack - limits.offset)))


@_compiled
def _exactly(kind: int, levels: Levels, limits: Limits, records: Records, depth: int, first: int,
             count: int, cursor: IntArray, mask: Any, b: Blocks) -> int:
    """Score one subset of a block from the vectors; return 1 if it has no score."""
    n = levels.top.shape[2] - 1
    for level in range(count):
        i = first + b.cursor[level]
        cursor[depth + level] = i
        mask = mask | records.bits[i]
        if levels.square[depth + level, 0, i] <= levels.floor[0, i]:
            return 1
        if level < count - 1:
            _remove(levels, depth + level, i, n, n)
            for later in range(level + 1, count):
                _remove(levels, depth + level, i, first + b.cursor[later], n)
    at = depth + count - 1
    score = _score(kind, levels, at, cursor[at], limits)
    new = limits.size + at + 1
    if score <= records.best[new]:
        record(score, new, mask, levels, at, cursor, records, limits.margin)
    return int(not score < np.inf)
