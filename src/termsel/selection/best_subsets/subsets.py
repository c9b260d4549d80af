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
`termsel.selection.best_subsets.bounds.closed`, for the score "check" of one target, of
`termsel.selection.best_subsets.bounds.held_out`, for "press" and "kfold" without denominators, and
of `termsel.selection.best_subsets.bounds.residuals`, for "rss" where poles keep subsets out.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from termsel.data.features import BoolArray, FloatArray, IntArray
from termsel.selection.best_subsets.columns.kernels import RSS
from termsel.selection.best_subsets.columns.system import (
    Masks,
    NodeResult,
    SubsetSystem,
    SubtreeNode,
    better_of_each_size,
)
from termsel.selection.best_subsets.descents import descend_through_subsets
from termsel.selection.best_subsets.rising_bound import raise_bound
from termsel.selection.best_subsets.score_systems import ScoreSystems, score_systems

log = logging.getLogger(__name__)

Cost = Callable[[FloatArray], FloatArray]
"""Turns the scores of all sizes (k + 1,) into figures to compare, each rising with its score."""

_NODE_SUBSETS = 1 << 16  # subsets enumerated between two checks for interruption: some milliseconds
_BOUNDED_SUBSETS = 1 << 25  # the same, where bounds rule out most of them: a fraction of a second
_LOOSER = 8  # times fewer of them for held-out errors, whose bounds rule out less
_DESCEND_FROM = 1 << 24  # subsets from which good ones are sought before any proof
_SMALL_SIZES = 1 << 27  # subsets up to which those of few columns are decided before all others
_BISECTIONS = 60  # of the logarithm of 1e30, to all digits
_NODES_IN_PROGRESS = 16  # at once, whatever the number of workers


@dataclass(frozen=True, eq=False)
class SubsetResult:
    """The best subset of every size, 0 to k columns, among those decided so far.

    Scores are sums of squares in squared scaled image units.
    """

    # (k + 1,): least score of the subsets of each size, forced columns included; infinite without.
    best: FloatArray
    # (k + 1,) of uint64: the subset itself: bit j is column j. Of exactly equal scores it is the
    # smallest number; 0 where none is feasible.
    masks: Masks
    subsets: int  # subsets enumerated
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
    cost: Cost | None = None,
) -> Iterator[SubsetResult]:
    """Decide every subset of the columns, node by node.

    The score is a sum of squares: "check" of the errors of the check points, "rss" of the residuals
    of the control rows, "press" of their leave-one-out errors, "kfold" of the errors of the rows of
    each fold under the solution from all other rows. Folds are the control rows held out together.
    At most `max_terms` columns are in a subset, forced ones included.

    A cost turns the scores of all sizes into figures to compare, each rising with its score. If
    given, and subsets are many, "rss" proves the best subset of each size that has a lower figure
    than all smaller sizes, the optimum included. Of other sizes it proves that they have not: their
    best may stay unknown.

    Yielded is the state after each node; the last one is complete. To stop early close the
    iterator, or let KeyboardInterrupt pass: the last state holds. Workers are threads; neither the
    result depends on them, nor the memory on the number of subsets.

    A subset is infeasible if one of its columns keeps no more than `solve.TOLERANCE` of its length
    orthogonal to the columns of the subset before it. `solve` pivots instead; they differ at most
    if a column is within a small factor of the tolerance. Raises TermselError for an unknown score,
    columns both forced and forbidden, or more forced columns than `max_terms`; ValueError for a
    score whose rows the system lacks. That code is compiled first is logged.
    """
    systems = score_systems(system, score, folds, max_terms)
    if systems.needs_compilation:
        log.info("Compiling: the first proof on this machine takes some 15 s longer.")
    root = systems.everything
    # A search of hours begins with good subsets: the better they are, the more bounds rule out.
    long_search = root.count > _DESCEND_FROM
    incumbents = _Incumbents(systems)
    if long_search:
        yield from _improve_by_descents(incumbents)
    for node in systems.starts:
        incumbents.replace(systems.walk(node, incumbents.best, incumbents.masks))
    node_subsets = _NODE_SUBSETS
    if systems.branches:
        tight = score in ("check", "rss")
        node_subsets = _BOUNDED_SUBSETS if tight else _BOUNDED_SUBSETS // _LOOSER
    if long_search and score == "check":
        for best, masks, lower_bound in raise_bound(
                systems, incumbents.best, incumbents.masks, node_subsets, workers):
            incumbents.best = best
            incumbents.masks = masks
            root = replace(systems.everything, lower_bound=lower_bound)
            yield incumbents.result([root])
    if not (long_search and score == "rss"):
        cost = None  # every size is proven
    yield from _branch_and_bound(incumbents, root, cost, node_subsets, workers)


class _Incumbents:
    """The best subset of each size so far, and how many subsets are decided."""

    def __init__(self, systems: ScoreSystems) -> None:
        self.systems = systems
        # (k + 1,) each: the least score of a size, and its columns (bit j: column j).
        self.best, self.masks = _undecided_subsets(systems.k)
        self.closed_sizes = 0  # all subsets with fewer columns are decided
        self.scored = 0  # subsets that are decided by their scores
        self.pruned = 0  # subsets that are decided by a bound

    def replace(self, result: NodeResult) -> None:
        """Take the best subsets of a walk that started from these, and so are no worse."""
        self.best = result.best
        self.masks = result.masks

    def result(self, open_nodes: Sequence[SubtreeNode],
               limits: FloatArray | float = np.inf) -> SubsetResult:
        """Return the state with these nodes still to be decided."""
        # What is decided was either scored or ruled out by a bound.
        lower_bounds = _lower_bounds(self.best, open_nodes, self.closed_sizes, limits)
        return SubsetResult(self.best, self.masks, self.scored + self.pruned,
                            self.systems.everything.count, self.pruned, lower_bounds)


def _improve_by_descents(incumbents: _Incumbents) -> Iterator[SubsetResult]:
    """Improve the incumbents by descents, and decide the sizes of few columns."""
    systems = incumbents.systems
    for descent, (best, masks) in enumerate(descend_through_subsets(systems)):
        incumbents.best, incumbents.masks = better_of_each_size(
            incumbents.best, incumbents.masks, best, masks)
        yield incumbents.result([systems.everything])
        # Those of few columns take a second. Descents by residuals take a tenth, others several,
        # and all subsets hours.
        if descent == 0 and systems.kind != RSS:
            yield from _decide_small_sizes(incumbents)
    if systems.kind == RSS:
        yield from _decide_small_sizes(incumbents)


def _decide_small_sizes(incumbents: _Incumbents) -> Iterator[SubsetResult]:
    """Decide the sizes of few columns."""
    systems = incumbents.systems
    for node in _small_sizes(systems):
        incumbents.replace(systems.walk(node, incumbents.best, incumbents.masks))
        incumbents.closed_sizes = len(node.used) + node.room + 1
        yield incumbents.result([systems.everything])


def _branch_and_bound(incumbents: _Incumbents, root: SubtreeNode, cost: Cost | None,
                      node_subsets: int, workers: int) -> Iterator[SubsetResult]:
    """Split the tree into nodes of at most `node_subsets`, bound each, and decide it by a worker.

    Results are taken in the order in which nodes were given out, and at fixed points of it. A
    node thus starts from the same incumbents, and a bound spares the same work, with any number
    of workers.
    """
    systems = incumbents.systems
    limits = _score_limits(cost, incumbents.best, systems.largest, incumbents.closed_sizes)
    open_nodes = [root]
    in_progress: deque[tuple[SubtreeNode, Future[NodeResult]]] = deque()
    pool = ThreadPoolExecutor(workers)
    try:
        while open_nodes or in_progress:
            if open_nodes and len(in_progress) < _NODES_IN_PROGRESS:
                whole_node = open_nodes.pop()
                node = systems.trimmed(whole_node, limits)
                incumbents.pruned += whole_node.count - node.count
                if node.count > node_subsets:
                    # No bound is asked for of sizes that are decided.
                    open_limits = np.where(limits > 0.0, limits, np.inf)
                    open_nodes += [systems.bounded(half, open_limits) for half in node.halves()]
                elif node.count:
                    # A limit below the best of its size is the score of no subset.
                    masks = np.where(limits < incumbents.best, np.uint64(0), incumbents.masks)
                    in_progress.append((node, pool.submit(systems.walk, node, limits, masks)))
                if node.count == whole_node.count:  # nothing is decided yet
                    continue
            else:
                node, future = in_progress.popleft()
                if _take_improvement(incumbents, node, future.result()):
                    limits = _score_limits(cost, incumbents.best, systems.largest,
                                           incumbents.closed_sizes)
            yield incumbents.result([*open_nodes, *(node for node, _ in in_progress)], limits)
    finally:
        pool.shutdown(cancel_futures=True)


def _take_improvement(incumbents: _Incumbents, node: SubtreeNode, result: NodeResult) -> bool:
    """Count the subsets of a decided node, and keep those that are better than the incumbents.

    Returns whether there are any such subsets.
    """
    # A limit that no subset reached is no subset's score. The empty subset has the mask 0 too.
    scores = np.where(result.masks > 0, result.best, np.inf)
    scores[0] = result.best[0]
    scores[:incumbents.closed_sizes] = np.inf
    improved = bool((scores < incumbents.best).any())
    incumbents.best, incumbents.masks = better_of_each_size(
        incumbents.best, incumbents.masks, scores, result.masks
    )
    incumbents.scored += node.count - result.pruned
    incumbents.pruned += result.pruned
    return improved


def is_bounded(system: SubsetSystem, score: str, folds: Sequence[IntArray] = ()) -> bool:
    """Return whether bounds rule subsets out, so that no time can be estimated."""
    return score_systems(system, score, folds, None).branches


def estimate_seconds(
    system: SubsetSystem,
    score: str,
    *,
    folds: Sequence[IntArray] = (),
    max_terms: int | None = None,
    workers: int = 1,
) -> float:
    """Return the time [s] that `search` would take with the same arguments.

    It is estimated from the time of one node, as if no bound ruled subsets out: where bounds do
    (`is_bounded`), the search is faster.
    """
    systems = score_systems(system, score, folds, max_terms)
    node = systems.everything
    # Without one of its candidates a node has down to half as many subsets.
    while node.count > _NODE_SUBSETS:
        node = replace(node, candidates=node.candidates[1:])
    seconds = []
    for _ in range(2):  # the first may have to compile
        start = time.perf_counter()
        systems.walk(node, *_undecided_subsets(systems.k))
        seconds.append(time.perf_counter() - start)
    return min(seconds) / node.count * systems.everything.count / workers


def _small_sizes(systems: ScoreSystems) -> Iterator[SubtreeNode]:
    """Yield the subsets of at most 1, 2 and so on columns, as long as they are few."""
    for room in range(1, systems.everything.room):
        node = replace(systems.everything, room=room)
        if node.count > (_SMALL_SIZES if systems.branches else _NODE_SUBSETS):
            return
        yield node


def _lower_bounds(best: FloatArray, open_nodes: Sequence[SubtreeNode], closed_sizes: int,
                  limits: FloatArray | float) -> FloatArray:
    """Return lower bounds of the scores of every size, (k + 1,), given the nodes yet to be decided.

    All subsets with less than `closed_sizes` columns are decided; others only below the limits.
    """
    # A subset that was ruled out scores no less than the limit or the best of its size.
    lower_bounds = np.minimum(best, limits)
    lower_bounds[:closed_sizes] = best[:closed_sizes]
    for node in open_nodes:
        smallest = max(len(node.used), closed_sizes)
        largest = len(node.used) + min(node.room, len(node.candidates))
        sizes = slice(smallest, largest + 1)
        np.minimum(lower_bounds[sizes], node.lower_bound, out=lower_bounds[sizes])
    return lower_bounds


def _score_limits(cost: Cost | None, best: FloatArray, largest: float,
                  closed_sizes: int) -> FloatArray:
    """Return the score of each size, (k + 1,), above which no subset is of interest.

    Below, it may have a lower figure than all smaller sizes, or be the best of its size. No score
    is above `largest`. Sizes below `closed_sizes` are decided, and theirs is 0: their best are many
    times worse, and bounds that need not rule those out close more.
    """
    limits = best.copy() if cost is None else _competitive_scores(cost, best, largest)
    limits[:closed_sizes] = 0.0
    return limits


def _competitive_scores(cost: Cost, best: FloatArray, largest: float) -> FloatArray:
    """Return the scores (k + 1,) up to which a subset of each size would have the lowest figure.

    That is the largest score, at most `largest`, whose figure is no higher than the lowest figure
    of all sizes up to it. A size that has this lowest figure itself keeps its best score. `cost`
    turns scores into figures, each of which rises with the score of its size, so that bisection
    finds the score.
    """
    figures = cost(best)
    # NaN where no subset is feasible.
    lowest_figures = np.minimum.accumulate(np.where(np.isnan(figures), np.inf, figures))
    low = np.full_like(best, largest * 1e-30)
    high = np.minimum(best, largest)
    for _ in range(_BISECTIONS):
        middle = np.sqrt(low * high)  # half of the interval in logarithms
        is_too_high = cost(middle) > lowest_figures
        low = np.where(is_too_high, low, middle)
        high = np.where(is_too_high, middle, high)
    return np.where(figures > lowest_figures, high, best)


def _undecided_subsets(k: int) -> tuple[FloatArray, Masks]:
    """Return scores and masks, (k + 1,), before anything is decided: infinite, and empty."""
    return np.full(k + 1, np.inf), np.zeros(k + 1, dtype=np.uint64)
