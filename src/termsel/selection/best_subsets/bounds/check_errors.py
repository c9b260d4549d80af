"""Subsets scored at check points: the steps of `termsel.selection.best_subsets.bounds.branch`.

They have one system with one target. Small rests are enumerated from inner products.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from termsel.adjustment.compiled import compile_lazily
from termsel.data.features import FloatArray, IntArray
from termsel.selection.best_subsets.bounds.closed import first_closed_by_parts
from termsel.selection.best_subsets.columns.arrays import (
    BoundSpace,
    Limits,
    Records,
    SubsetBlock,
    Vectors,
)
from termsel.selection.best_subsets.columns.blocks import (
    SHARE,
    count_open_pairs,
    eliminate,
    is_single_column_pruned,
    prepare,
)
from termsel.selection.best_subsets.columns.kernels import (
    RATIONAL,
    arrays_at_depth,
    record,
    remove,
    score_of,
)

_compiled = partial(compile_lazily, _nrt=False, fastmath={"reassoc", "contract", "arcp", "nsz"})

BLOCK = 1 << 7  # subsets up to which inner products alone cost less than a bound


@_compiled
def score_with_column(kind: int, vectors: Vectors, depth: int, c: int, limits: Limits) -> float:
    """Return the score of the subset in use at a depth with column c in addition."""
    return score_of(kind, arrays_at_depth(vectors, depth), c, 1, 1, limits)


@_compiled
def first_closed_column(kind: int, vectors: Vectors, limits: Limits, depth: int, first: int,
                        worst: float, upper: FloatArray, space: BoundSpace) -> int:
    """Return the first column from which on no subset can improve any size that is still possible.

    Columns before `first` are not looked at; n, the number of columns, means that none is closed.
    `worst` is the largest of the best scores of these sizes. `upper` are upper limits of the
    denominators, as of `first_closed_by_parts`, which lowers them in place.
    """
    n = vectors.top.shape[2] - 1
    limit = _allowed_residuals(worst, limits)
    # Without a best score yet, as without a number (NaN), nothing can be ruled out.
    if not limit < np.inf:
        return int(n)
    if limit < 0.0:  # what no column can change is already more
        return first
    return int(first_closed_by_parts(vectors.top[depth, 0], vectors.extra[depth, 0], first, n=n,
                                     limit=limit,
                                     upper=upper, rational=kind == RATIONAL, space=space))


@_compiled
def descend(vectors: Vectors, depth: int, i: int, upper: FloatArray) -> None:
    """Remove column i from those to its right and the target, from one depth to the next."""
    for c in range(vectors.top.shape[2] - 1, i, -1):
        _remove_column(vectors, depth, i, c)
    for k in range(upper.shape[1]):  # limits of denominators hold for the subsets below, too
        upper[depth + 1, k] = upper[depth, k]


@_compiled
def _remove_column(vectors: Vectors, depth: int, i: int, c: int) -> None:
    """Remove column i from column c, or from the target, and keep what is left in the next depth.
    """
    remove(vectors, depth, 0, i=i, c=c, n=vectors.top.shape[2] - 1, r=1)


@_compiled
def _allowed_residuals(best: float, limits: Limits) -> float:
    """Return the sum of squares beyond which a score is certainly above the best."""
    return best * (1.0 + 1e-9) + limits.slack - limits.offset


@_compiled
def decide_block(kind: int, vectors: Vectors, limits: Limits, records: Records, depth: int,
                 first: int, cursor: IntArray, mask: Any, upper: FloatArray,
                 b: SubsetBlock) -> bool:
    """Decide all subsets that add some of the columns first, ..., n - 1, by their inner products.

    They are added to those in use at the `depth` of `vectors`, whose mask is `mask`. `upper` has
    the limits of the denominators at this depth. `b` and `cursor`, from `depth` on, are
    overwritten. The best subsets are in `records` then. Return False if inner products are too
    inaccurate, so that the vectors must decide on all of them again; what was recorded by then is
    correct.
    """
    n = vectors.top.shape[2] - 1
    count = n - first
    room_below = limits.room - depth
    best = records.best
    error_accuracy, sum_accuracy = prepare(vectors.top[depth, 0], vectors.extra[depth, 0], first,
                                           n=n, upper=upper, floor=vectors.floor[0], b=b)
    # A walk over the tree of the block: at each level the column that joined, its share of length
    # the product of those before it (see `columns.blocks`), which bounds the condition.
    level = 0
    b.share[0] = 1.0
    b.cursor[0] = -1
    while True:
        b.cursor[level] += 1
        i = b.cursor[level]
        if i >= count:
            if level == 0:
                return True
            level -= 1
            continue
        share = b.share[level] * b.control.diagonal[level, i] * b.inverse[i]
        if not share > SHARE:
            return False
        size = limits.size + depth + level + 1
        # What cannot be ruled out by inner products is scored from the vectors.
        if not is_single_column_pruned(i, level, _root_of_score(best[size], limits), error_accuracy,
                                       sum_accuracy,
                                       b):
            _score_exactly(kind, vectors, limits, records=records, depth=depth, first=first,
                           count=level + 1, cursor=cursor, mask=mask, b=b)
        if i == count - 1:
            continue
        # Nothing is below pairs: they need no elimination of their own.
        if room_below - level == 2:
            root_limit = _root_of_score(best[size + 1], limits)
            if count_open_pairs(i, level, count, share=share, root_limit=root_limit,
                                error_accuracy=error_accuracy, sum_accuracy=sum_accuracy, b=b):
                for c in range(i + 1, count):
                    if not b.row[c] > 0.0:  # NaN rules nothing out
                        b.cursor[level + 1] = c
                        _score_exactly(kind, vectors, limits, records=records, depth=depth,
                                       first=first,
                                       count=level + 2, cursor=cursor, mask=mask, b=b)
        else:
            eliminate(i, level, count, b)
            b.share[level + 1] = share
            b.cursor[level + 1] = i
            level += 1


@_compiled
def _root_of_score(best: float, limits: Limits) -> float:
    """Return the root of a score above which none is the best."""
    return float(np.sqrt(max(0.0, _allowed_residuals(best, limits))))


@_compiled
def _score_exactly(kind: int, vectors: Vectors, limits: Limits, records: Records, depth: int,
                   first: int, count: int, cursor: IntArray, mask: Any, b: SubsetBlock) -> None:
    """Score one subset of a block from the vectors, and record it if it is the best of its size.

    It adds `count` columns to the node at `depth`: those of `b.cursor`, counted from `first` on.
    `cursor` (depths,) and `mask` (uint64) have the columns of the node.
    """
    n = vectors.top.shape[2] - 1
    # Depths below the node are free while its block is decided. Only what the subset needs is
    # removed: its own later columns and the target.
    for level in range(count):
        i = first + b.cursor[level]
        cursor[depth + level] = i
        mask = mask | records.bits[i]
        if vectors.square[depth + level, 0, i] <= vectors.floor[0, i]:
            return  # dependent columns have no score
        if level < count - 1:
            _remove_column(vectors, depth + level, i, n)
            for later in range(level + 1, count):
                _remove_column(vectors, depth + level, i, first + b.cursor[later])
    last_depth = depth + count - 1
    subset_score = score_with_column(kind, vectors, last_depth, cursor[last_depth], limits)
    size = limits.size + last_depth + 1
    if subset_score <= records.best[size]:
        record(subset_score, size, mask, vectors=vectors, depth=last_depth, cursor=cursor,
               records=records, margin=limits.margin)
