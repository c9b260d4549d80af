"""Every subset of the columns of a least-squares system, with the best of each size proven.

The subsets form a tree: below a subset are those with one further column to the right of its
last. The columns still to come are kept orthogonal to those in use (modified Gram-Schmidt). The
equations of the check points take part in every step, so that their errors are known without
solving for a coefficient. Half of the subsets have no column to their right and a
quarter have one: on average a subset costs about one such step.

References
----------
Furnival and Wilson 1974, Technometrics 16(4): the tree, and the bound for residual sums of
squares. Bjorck 1967, BIT 7(1): the accuracy of modified Gram-Schmidt. That check points, folds
and leave-one-out errors take part is termsel's own formulation, and so are the bounds of
`termsel.enumeration.bounds.closed`, for the score "check" of one target, of
`termsel.enumeration.bounds.held_out`, for "press" and "kfold" without denominators, and of
`termsel.enumeration.bounds.residuals`, for "rss" where poles keep subsets out.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from termsel.enumeration.columns.system import Masks, Piece, SubsetSystem, Walked, better
from termsel.enumeration.descents import descents
from termsel.enumeration.rungs import rungs
from termsel.enumeration.stack import Stack, stack
from termsel.measurements.features import BoolArray, FloatArray, IntArray

log = logging.getLogger(__name__)

_PIECE = 1 << 16  # subsets enumerated between two checks for interruption: some milliseconds
_BRANCH = 1 << 25  # the same, where bounds rule out most of them: a fraction of a second
_LOOSER = 8  # times fewer of them for held-out errors, whose bounds rule out less
_DESCEND_FROM = 1 << 24  # subsets from which good ones are sought before any proof
_SMALL = 1 << 27  # subsets up to which those of few columns are decided before all others
_BISECTIONS = 60  # of the logarithm of 1e30, to all digits
_AHEAD = 16  # pieces in progress at once, whatever the number of workers


@dataclass(frozen=True, eq=False)
class SubsetResult:
    """The best subset of every size among those decided so far."""

    # (k + 1,): least score of the subsets of each size, forced columns included; infinite without.
    best: FloatArray
    # (k + 1,) of uint64: the subset itself: bit j is column j. Of exactly equal scores it is the
    # smallest number; 0 where none is feasible.
    masks: Masks
    subsets: int  # subsets decided
    total: int  # subsets to be decided
    pruned: int  # those among the decided that a lower bound ruled out
    # (k + 1,): no subset of a size scores less; the best score once every subset is decided.
    floor: FloatArray

    @property
    def complete(self) -> bool:
        """True if every subset is decided, so that `best` is proven."""
        return self.subsets == self.total

    def columns(self, size: int) -> BoolArray:
        """Return the best subset of a size as a mask, shape (k,)."""
        bits = np.arange(len(self.best) - 1, dtype=np.uint64)
        return np.asarray(self.masks[size] >> bits & np.uint64(1), dtype=bool)


def search(
    system: SubsetSystem,
    score: str,
    *,
    folds: Sequence[IntArray] = (),
    max_terms: int | None = None,
    workers: int = 1,
    cost: Callable[[FloatArray], FloatArray] | None = None,
) -> Iterator[SubsetResult]:
    """Decide every subset of the columns, piece by piece.

    The score is a sum of squares: "check" of the errors of the check points, "rss" of the residuals
    of the control rows, "press" of their leave-one-out errors, "kfold" of the errors of the rows of
    each fold under the solution from all other rows. Folds are the control rows held out together.
    At most `max_terms` columns are in a subset, forced ones included.

    A cost turns the scores of all sizes into figures to compare, each rising with its score. If
    given, and subsets are many, "rss" proves the best subset of each size that has a lower figure
    than all smaller sizes, the optimum included. Of other sizes it proves that they have not: their
    best may stay unknown.

    Yielded is the state after each piece of about 65,000 subsets; the last one is complete. To stop
    early close the iterator, or let KeyboardInterrupt pass: the last state holds. Workers are
    threads; neither the result depends on them, nor the memory on the number of subsets.

    A subset is infeasible if one of its columns keeps no more than `solve.TOLERANCE` of its length
    orthogonal to the columns of the subset before it. `solve` pivots instead; they differ at most
    if a column is within a small factor of the tolerance. Raises TermselError for an unknown score,
    or more forced columns than `max_terms`; ValueError for a score whose rows the system lacks.
    """
    systems = stack(system, score, folds, max_terms)
    if systems.needs_compilation:
        log.info("Compiling: the first proof on this machine takes some 15 s longer.")
    total = systems.everything.count
    best, masks = _nothing(systems.k)
    settled = 0
    if total > _DESCEND_FROM:
        for i, at in enumerate(descents(systems)):
            best, masks = better(best, masks, *at)
            yield SubsetResult(best, masks, 0, total, 0,
                               _floor(best, [systems.everything], settled))
            # Those of few columns take a second, the descents several, and all of them hours.
            for piece in () if i else _small(systems):
                walked = systems.walk(piece, best, masks)
                best, masks, settled = walked.best, walked.masks, len(piece.used) + piece.room + 1
                yield SubsetResult(best, masks, 0, total, 0,
                                   _floor(best, [systems.everything], settled))
    for start in systems.starts:
        walked = systems.walk(start, best, masks)
        best, masks = walked.best, walked.masks
    scored = pruned = 0
    branch = _BRANCH if score in ("check", "rss") else _BRANCH // _LOOSER
    largest = branch if systems.branches else _PIECE
    if score != "rss" or total <= _DESCEND_FROM:
        cost = None
    todo = [systems.everything]
    climbs = score == "check" and total > _DESCEND_FROM
    for rung in rungs(systems, best, masks, largest, workers) if climbs else ():
        best, masks, least = rung
        todo = [replace(systems.everything, least=least)]
        yield SubsetResult(best, masks, 0, total, 0, _floor(best, todo, settled))
    limits = _limits(cost, best, systems.largest, settled)
    waiting: deque[tuple[Piece, Future[Walked]]] = deque()
    pool = ThreadPoolExecutor(workers)
    try:
        while todo or waiting:
            # Results are taken in order and at fixed points of it. A piece thus starts from the
            # same best subsets, and a bound spares the same work, with any number of workers.
            if todo and len(waiting) < _AHEAD:
                whole = todo.pop()
                piece = systems.trimmed(whole, limits)
                pruned += whole.count - piece.count
                if piece.count > largest:
                    # No bound is asked for of sizes that are decided.
                    open_sizes = np.where(limits > 0.0, limits, np.inf)
                    todo += [systems.bounded(half, open_sizes) for half in piece.halves()]
                elif piece.count:
                    known = np.where(limits < best, np.uint64(0), masks)
                    waiting.append((piece, pool.submit(systems.walk, piece, limits, known)))
                if piece.count == whole.count:  # nothing is decided yet
                    continue
            else:
                piece, future = waiting.popleft()
                walked = future.result()
                # A limit that no subset reached is none's score.
                scores = np.where(walked.masks > 0, walked.best, np.inf)
                scores[0] = walked.best[0]
                scores[:settled] = np.inf
                improves = bool((scores < best).any())
                best, masks = better(best, masks, scores, walked.masks)
                if improves:
                    limits = _limits(cost, best, systems.largest, settled)
                scored += piece.count - walked.pruned
                pruned += walked.pruned
            open_ = (*todo, *(piece for piece, _ in waiting))
            yield SubsetResult(best, masks, scored + pruned, total, pruned,
                               _floor(best, open_, settled, limits))
    finally:
        pool.shutdown(cancel_futures=True)


def is_bounded(system: SubsetSystem, score: str, folds: Sequence[IntArray] = ()) -> bool:
    """Return whether bounds rule subsets out, so that no time can be estimated."""
    return stack(system, score, folds, None).branches


def estimate_seconds(
    system: SubsetSystem,
    score: str,
    *,
    folds: Sequence[IntArray] = (),
    max_terms: int | None = None,
    workers: int = 1,
) -> float:
    """Return the estimated time of `search` [s], which takes the same, from the time of one piece.

    Where bounds rule subsets out (`is_bounded`), this is the time without them.
    """
    systems = stack(system, score, folds, max_terms)
    piece = systems.everything
    while piece.count > _PIECE:
        piece = replace(piece, rest=piece.rest[1:])
    seconds = []
    for _ in range(2):  # the first may have to compile
        start = time.perf_counter()
        systems.walk(piece, *_nothing(systems.k))
        seconds.append(time.perf_counter() - start)
    return min(seconds) / piece.count * systems.everything.count / workers


def _small(systems: Stack) -> Iterator[Piece]:
    """Yield the subsets of at most 1, 2 and so on columns, as long as they are few."""
    for room in range(1, systems.everything.room):
        piece = replace(systems.everything, room=room)
        if piece.count > (_SMALL if systems.branches else _PIECE):
            return
        yield piece


def _floor(best: FloatArray, pieces: Sequence[Piece], settled: int,
           limits: FloatArray | float = np.inf) -> FloatArray:
    """Return lower bounds of the scores of every size, given the pieces still to be decided.

    All subsets with less than `settled` columns are decided; others only below the limits.
    """
    # A subset that was ruled out scores no less than the limit or the best of its size.
    floor = np.minimum(best, limits)
    floor[:settled] = best[:settled]
    for piece in pieces:
        sizes = slice(max(len(piece.used), settled),
                      len(piece.used) + min(piece.room, len(piece.rest)) + 1)
        np.minimum(floor[sizes], piece.least, out=floor[sizes])
    return floor


def _limits(cost: Callable[[FloatArray], FloatArray] | None, best: FloatArray,
            largest: float, settled: int) -> FloatArray:
    """Return the score of each size above which no subset is of interest.

    Below, it may have a lower figure than all smaller sizes, or be the best of its size. No score
    is above `largest`. Sizes below `settled` are decided, and theirs is 0: their best are many
    times worse, and bounds that need not rule those out close more.
    """
    limits = best.copy() if cost is None else _of_interest(cost, best, largest)
    limits[:settled] = 0.0
    return limits


def _of_interest(cost: Callable[[FloatArray], FloatArray], best: FloatArray,
                 largest: float) -> FloatArray:
    """Return the score that each size needs for the lowest figure, or its best if it has that."""
    known = cost(best)
    # The lowest figure up to each size; NaN where no subset is feasible.
    least = np.minimum.accumulate(np.where(np.isnan(known), np.inf, known))
    low, high = np.full_like(best, largest * 1e-30), np.minimum(best, largest)
    for _ in range(_BISECTIONS):
        middle = np.sqrt(low * high)  # half of the interval in logarithms
        above = cost(middle) > least
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return np.where(known > least, high, best)


def _nothing(k: int) -> tuple[FloatArray, Masks]:
    """Return the best of every size before anything is decided."""
    return np.full(k + 1, np.inf), np.zeros(k + 1, dtype=np.uint64)
