"""The compiled branch and bound behind `termsel.selection.best_subsets.subsets`.

The tree is that of `columns.kernels.enumerate_subsets`. At every node a bound closes the columns
from some point on. Errors of check points and held-out errors have scores and bounds of their own,
in `bounds.check_errors` and `bounds.held_out`; the loop is one. It is compiled for each of both
with its steps alone, as the space of the other is None, which is a type of its own.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from termsel.adjustment.compiled import compile_lazily
from termsel.data.features import FloatArray
from termsel.selection.best_subsets.bounds import check_errors, held_out
from termsel.selection.best_subsets.columns.arrays import (
    CheckSpace,
    Limits,
    Records,
    Vectors,
    WalkPosition,
)
from termsel.selection.best_subsets.columns.kernels import record

_compiled = partial(compile_lazily, _nrt=False, fastmath={"reassoc", "contract", "arcp", "nsz"})


@_compiled
def decide_branch(kind: int, vectors: Vectors, limits: Limits, records: Records,
                  position: WalkPosition, check: CheckSpace | None, work: FloatArray | None) -> int:
    """Decide all subsets of n columns in addition to those in use already.

    For the errors of check points the kind is LINEAR or RATIONAL, of one system and one target,
    with `check`. For held-out errors it is PRESS without denominators, or LINEAR (see
    `bounds.held_out`), with the space `work` (n + r, rows). One of `check` and `work` is None. All
    else is as for `columns.kernels.enumerate_subsets`. The best subsets are in `records` then.
    Return the number of subsets that were ruled out with others, by the bound of a node; those of
    a block count as looked at.
    """
    systems, r = 1, 1
    if work is not None:
        systems = vectors.top.shape[1]
        r = vectors.share.shape[3]
    n = vectors.top.shape[2] - r
    size = limits.size
    room = limits.room
    cursor = position.cursor
    ends = position.ends
    mask = position.mask
    counts = position.counts
    pruned, depth, first = 0, 0, 0
    joining = n  # column n is none: first comes the subset in use already
    joined_mask = mask[0]
    while True:
        # The subset with the joining column is scored before anything below it is looked at.
        score = np.inf
        new = size + depth + (joining < n)
        if work is not None:
            score = held_out.held_out_score(kind, vectors, depth, joining, limits)
        if check is not None:
            score = check_errors.score_with_column(kind, vectors, depth, joining, limits)
        if score <= records.best[new]:
            cursor[depth] = joining
            record(score, new, joined_mask, vectors=vectors, depth=depth, cursor=cursor,
                   records=records, margin=limits.margin)
        entering = n > 0 and room > 0 and joining == n
        # Below it are subsets with further columns to the right, if there is room for one.
        if room - depth > 1 and joining < n - 1:
            if work is not None:
                held_out.descend(kind, vectors, depth, joining)
            if check is not None:
                check_errors.descend(vectors, depth, joining, check.upper)
            mask[depth + 1] = joined_mask
            depth += 1
            first = joining + 1
            entering = True
        # On to the next column that is open and independent of those in use.
        while True:
            room_below = room - depth
            if entering:
                entering = False
                end = n
                open_subsets = counts[n - first, room_below]
                # A bound has to be above the best of every size that is still possible.
                worst = 0.0
                for new in range(size + depth + 1, size + depth + min(room_below, n - first) + 1):
                    worst = max(worst, records.best[new])
                if work is not None and open_subsets > held_out.ENUMERATED and 0.0 < worst < np.inf:
                    end = held_out.first_prunable_column(
                        vectors.top[depth, 0], vectors.leverage[depth], first, n, worst, work)
                if check is not None and open_subsets > check_errors.BLOCK:
                    end = check_errors.first_closed_column(
                        kind,
                        vectors,
                        limits,
                        depth=depth,
                        first=first,
                        worst=worst,
                        upper=check.upper[depth],
                        space=check.bound,
                    )
                # All subsets of closed columns alone, but for the node itself, without any of them.
                pruned += counts[n - end, room_below] - 1
                if check is not None and room_below > 1 and open_subsets <= check_errors.BLOCK:
                    decided = check_errors.decide_block(
                        kind,
                        vectors,
                        limits,
                        records=records,
                        depth=depth,
                        first=first,
                        cursor=cursor,
                        mask=mask[depth],
                        upper=check.upper[depth],
                        b=check.block,
                    )
                    end = first if decided else end
                ends[depth] = end
                cursor[depth] = first
            else:
                cursor[depth] += 1
            joining = cursor[depth]
            if joining >= ends[depth]:
                if depth == 0:
                    return pruned
                depth -= 1
                continue
            dependent = False
            for f in range(systems):
                dependent |= vectors.square[depth, f, joining] <= vectors.floor[f, joining]
            if not dependent:  # else all subsets below have no score
                break
        joined_mask = mask[depth] | records.bits[joining]
