"""The proven optimum of a selection of control features."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from termsel.core.errors import TermselError, amount_in_words
from termsel.data.features import BoolArray, FloatArray
from termsel.selection.best_subsets.features.walk import Branch, Selections
from termsel.selection.problems.segments import Bits, Genes, Subset
from termsel.selection.solvers.base import Generation
from termsel.selection.solvers.heuristics.swap import descend
from termsel.selection.solvers.proofs.proof import FeatureProof, generation_of

if TYPE_CHECKING:
    from termsel.selection.best_subsets.features.walk import RowSystem
    from termsel.selection.problems.base import Evaluation, Problem

log = logging.getLogger(__name__)

QUICK = 1 << 20
"""Selections that are walked for a heuristic's gap: less than a second."""

_STARTS = 4  # descents before anything is decided
_AHEAD = 16  # branches in progress at once, whatever the number of workers
_BATCH = 64  # selections evaluated at first; more where these are not feasible
_LARGEST = 4096
_REPORTS = 4  # so many reports, then as many with a further branch between them, and so on
_TIMED = 1 << 16  # selections of which the time of all is estimated


def _feature_segment(problem: Problem) -> Bits | Subset:
    """Return the only segment of a problem of features."""
    segment, = problem.genome.segments
    assert isinstance(segment, Bits | Subset)  # of features
    return segment


def selections_of(problem: Problem, systems: tuple[RowSystem, ...]) -> Selections:
    """Return all selections of a problem that selects features alone; refuse too many features."""
    genome = problem.genome
    segment = _feature_segment(problem)
    n = len(segment.labels)
    return Selections(n, segment.minimum, segment.most, genome.on, genome.off, systems)


def space_of(selections: Selections) -> str:
    """Return the selections that a proof decides, in words."""
    n = selections.n
    fewest = selections.min_size
    largest = selections.max_size
    if fewest == largest:
        return f"all selections of {largest} of {n} features"
    if fewest > 1:
        return f"all selections of {fewest} to {largest} of {n} features"
    return "all selections" + (f" of up to {largest} of {n} features" if largest < n else "")


def estimate_seconds(selections: Selections, workers: int) -> float:
    """Return the estimated time of a proof [s], without that of evaluations."""
    branch = selections.root
    with_first = False
    # Every second feature is in use, as in the selections of which there are most.
    while selections.count(branch) > _TIMED:
        halves = [half for half in selections.halves(branch) if selections.count(half)]
        branch = halves[-1 if with_first else 0]
        with_first = not with_first
    seconds = []
    for _ in range(2):  # the first may have to compile
        start = time.perf_counter()
        selections.walk(branch, np.zeros(selections.n + 1))
        seconds.append(time.perf_counter() - start)
    return min(seconds) / selections.count(branch) * selections.count(selections.root) / workers


def prove_features(problem: Problem, selections: Selections,
                   workers: int = 1) -> Iterator[FeatureProof]:
    """Decide every selection of features, yielding intermediate states; the last one is complete.

    Scores of the walk only rule selections out; what remains is evaluated as any solver's genes
    are, so that all conditions of the problem hold and the optimum is one of the evaluation. The
    result does not depend on the number of workers, which are threads.
    """
    records = _Records(problem, selections)
    total = selections.count(selections.root)
    decided = 0
    starts = problem.genome.random(np.random.default_rng(0), _STARTS)
    evaluation = problem.evaluate(starts)
    records.take(starts, evaluation)
    yield records.state(0, total)
    if selections.systems and total > _LARGEST:
        for i in range(_STARTS):
            for step in descend(problem, starts[i:i + 1], evaluation.take(np.array([i]))):
                records.take(step.genes, step.evaluation)
        yield records.state(0, total)
    open_branches = [selections.root]
    in_progress: deque[tuple[Branch, Future[tuple[BoolArray, FloatArray]]]] = deque()
    pool = ThreadPoolExecutor(workers)
    try:
        while open_branches or in_progress:
            # Results are taken in order and at fixed points of it, so that the same selections
            # are evaluated with any number of workers.
            if open_branches and len(in_progress) < _AHEAD:
                branch = open_branches.pop()
                size = selections.count(branch)
                if size > selections.largest:
                    open_branches += selections.halves(branch)
                elif size:
                    in_progress.append(
                        (branch, pool.submit(selections.walk, branch, records.limits()))
                    )
            else:
                branch, future = in_progress.popleft()
                records.decide(*future.result())
                decided += selections.count(branch)
                yield records.state(decided, total)
    finally:
        pool.shutdown(cancel_futures=True)


def proof_generations(problem: Problem, systems: tuple[RowSystem, ...], workers: int,
                      max_terms: int | None) -> Iterator[Generation]:
    """Yield the best so far, with what is proven of it, until every selection is decided.

    How many selections there are, and how long it may take, is logged first. Raises TermselError
    for too many features, and for `max_terms`, which limits nothing here.
    """
    if max_terms is not None:
        raise TermselError("max_terms limits terms, and this problem selects features",
                           hint="Limit these with --set max_features=N.")
    selections = selections_of(problem, systems)
    space = space_of(selections)
    total = selections.count(selections.root)
    if selections.needs_compilation:
        log.info("Compiling: the first proof on this machine takes some 6 s longer.")
    outlook = (f"; about {duration_in_words(estimate_seconds(selections, workers))}" if systems
               else "; each is evaluated, as the criterion or the model allows no other way")
    log.info("exact: %s to enumerate or exclude by bounds (%s)%s", amount_in_words(total, "subset"),
             space, outlook)
    index, last = 0, 0
    placeholder = problem.genome.random(np.random.default_rng(0), 1)
    for state, proof in enumerate(prove_features(problem, selections, workers)):
        # Reports become rarer as the proof goes on, as each costs an evaluation.
        too_early = state - last <= index // _REPORTS
        if index and not proof.complete and (too_early or not proof.front()):
            continue
        yield generation_of(problem, proof, index, space, placeholder)
        index += 1
        last = state


def quick_optimum(problem: Problem,
                  systems: tuple[RowSystem, ...]) -> tuple[float, int, str] | None:
    """Return the least objective, proven, the number of selections, and their space in words.

    Returns None if there are too many selections for a quick proof, or if none is feasible. Raises
    TermselError for too many features.
    """
    selections = selections_of(problem, systems)
    total = selections.count(selections.root)
    if not systems or total > QUICK:
        return None
    *_, proof = prove_features(problem, selections)
    optimum = float(proof.best.min())
    return (optimum, total, space_of(selections)) if np.isfinite(optimum) else None


def duration_in_words(seconds: float) -> str:
    """Return a time [s] in words, rounded, such as "20 min"."""
    years = seconds / 31_557_600
    if years > 1:
        return f"{years:,.0f} years" if years < 1e6 else "more than a million years"
    if seconds > 5400:
        return f"{seconds / 3600:,.0f} h"
    return f"{seconds / 60:.0f} min" if seconds > 90 else f"{max(seconds, 0.1):.1f} s"


class _Records:
    """The best selection of every size."""

    def __init__(self, problem: Problem, selections: Selections) -> None:
        """Begin without any selection known; the floor is a bound of all of them."""
        self.problem = problem
        self.selections = selections
        self.segment = _feature_segment(problem)
        self.best = np.full(selections.n + 1, np.inf)
        self.genes: dict[int, Genes] = {}
        # An RMSE is (squared errors / points)^1/2.
        # The squared errors of a system are of one axis, or of both: a point has two.
        self.points = sum(len(system.check_target) for system in selections.systems) / 2
        self.floor = float(np.sqrt(selections.floor / self.points)) if selections.systems else 0.0

    def state(self, decided: int, total: int) -> FeatureProof:
        """Return the state as a copy, which later steps do not change."""
        return FeatureProof(self.best.copy(), dict(self.genes), decided, total, self.floor)

    def limits(self) -> FloatArray:
        """Return squared errors, by size (n + 1,), above which no selection is better."""
        if not self.selections.systems:
            return np.full(len(self.best), np.inf)
        return np.asarray(self.best**2 * self.points)

    def decide(self, masks: BoolArray, scores: FloatArray) -> None:
        """Evaluate all selections that may be better than the best of their size.

        `masks` (s, n) are the selections and `scores` (s,) their bounds, to rounding. Those of a
        size are evaluated in the order of their bounds, in growing batches, until the next bound is
        beyond what has been found.
        """
        sizes = masks.sum(axis=1)
        for size in np.unique(sizes):
            of_size = np.flatnonzero(sizes == size)
            of_size = of_size[np.argsort(scores[of_size], kind="stable")]
            start = 0
            batch = _BATCH
            while start < len(of_size):
                evaluated = of_size[start:start + batch]
                start += len(evaluated)
                batch = min(2 * batch, _LARGEST)
                genes = self.segment.members(masks[evaluated])
                self.take(genes, self.problem.evaluate(genes))
                # They are in the order of their scores: those beyond the limit are no better.
                limit = self.selections.reach(self.limits()[size])
                within_limit = int(np.searchsorted(scores[of_size], limit, "right"))
                of_size = of_size[:max(start, within_limit)]

    def take(self, genes: Genes, evaluation: Evaluation) -> None:
        """Record the feasible individuals that are better than the best of their size so far.

        `genes` (p, size) are those that `evaluation` is of.
        """
        sizes = self.problem.genome.chosen(genes).sum(axis=1)
        # From the best on: of each size only the first can be better than what is known.
        feasible = np.flatnonzero(evaluation.violation == 0)
        for row in feasible[np.argsort(evaluation.objectives[feasible, 0], kind="stable")]:
            size = int(sizes[row])
            value = float(evaluation.objectives[row, 0])
            # Of equal ones, such as those that leave rounding alone, whatever comes first.
            if value < self.best[size] or (value == self.best[size]
                                           and genes[row].tobytes() > self.genes[size].tobytes()):
                self.best[size] = value
                self.genes[size] = genes[row].copy()
