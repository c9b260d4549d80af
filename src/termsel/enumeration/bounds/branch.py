"""The compiled branch and bound behind `termsel.enumeration.subsets`.

The tree is that of `columns.kernels.walk`. At every node a bound closes the columns from some point
on. Errors of check points and held-out errors have scores and bounds of their own, in
`bounds.check_errors` and `bounds.held_out`; the loop is one. It is compiled for each of both with
its steps alone, as the space of the other is None, which is a type of its own.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from termsel.adjustment.compiled import compiled
from termsel.enumeration.bounds import check_errors, held_out
from termsel.enumeration.columns.arrays import CheckSpace, Limits, Place, Records, Vectors
from termsel.enumeration.columns.kernels import record
from termsel.measurements.features import FloatArray

_compiled = partial(compiled, _nrt=False, fastmath={"reassoc", "contract", "arcp", "nsz"})


@_compiled
def branch(kind: int, vectors: Vectors, limits: Limits, records: Records, place: Place,
           check: CheckSpace | None, work: FloatArray | None) -> int:
    """Decide all subsets of n columns in addition to those in use already.

    For the errors of check points the kind is LINEAR or RATIONAL, of one system and one target,
    with `check`. For held-out errors it is PRESS without denominators, or LINEAR (see
    `bounds.held_out`), with the space `work` (n + r, rows). All else is as for
    `columns.kernels.walk`. Return the number of subsets that a bound ruled out.
    """
    systems, r = 1, 1
    if work is not None:
        systems, r = vectors.top.shape[1], vectors.share.shape[3]
    n = vectors.top.shape[2] - r
    size, most = limits.size, limits.room
    cursor, ends, mask, counts = place.cursor, place.ends, place.mask, place.counts
    pruned, depth, first = 0, 0, 0
    i, joined = n, mask[0]  # column n is none: first comes the subset in use already
    while True:
        score, new = np.inf, size + depth + (i < n)
        if work is not None:
            score = held_out.score(kind, vectors, depth, i, limits)
        if check is not None:
            score = check_errors.score(kind, vectors, depth, i, limits)
        if score <= records.best[new]:
            cursor[depth] = i
            record(score, new, joined, vectors, depth, cursor, records, limits.margin)
        entering = n > 0 and most > 0 and i == n
        if most - depth > 1 and i < n - 1:
            if work is not None:
                held_out.descend(kind, vectors, depth, i)
            if check is not None:
                check_errors.descend(vectors, depth, i, check.upper)
            mask[depth + 1] = joined
            depth += 1
            first = i + 1
            entering = True
        # On to the next column that is open and independent of those in use.
        while True:
            left = most - depth
            if entering:
                entering = False
                end, open_ = n, counts[n - first, left]
                # A bound has to be above the best of every size that is still possible.
                worst = 0.0
                for new in range(size + depth + 1, size + depth + min(left, n - first) + 1):
                    worst = max(worst, records.best[new])
                if work is not None and open_ > held_out.ENUMERATED and 0.0 < worst < np.inf:
                    end = held_out.first_closed(vectors.top[depth, 0], vectors.leverage[depth],
                                                first, n, worst, work)
                if check is not None and open_ > check_errors.BLOCK:
                    end = check_errors.closed_from(kind, vectors, limits, depth, first, worst,
                                                   check.upper[depth], check.bound)
                pruned += counts[n - end, left] - 1  # but for the node itself, without any of them
                if check is not None and left > 1 and open_ <= check_errors.BLOCK:
                    decided = check_errors.decide_block(
                        kind, vectors, limits, records, depth, first, cursor, mask[depth],
                        check.upper[depth], check.block)
                    end = first if decided else end
                ends[depth] = end
                cursor[depth] = first
            else:
                cursor[depth] += 1
            i = cursor[depth]
            if i >= ends[depth]:
                if depth == 0:
                    return pruned
                depth -= 1
                continue
            dependent = False
            for f in range(systems):
                dependent |= vectors.square[depth, f, i] <= vectors.floor[f, i]
            if not dependent:  # else all subsets below have no score
                break
        joined = mask[depth] | records.bits[i]
