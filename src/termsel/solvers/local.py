"""Local search by adding, dropping and swapping genes; also the polish of other solvers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from termsel.features import BoolArray
from termsel.options import Option
from termsel.problems.base import Evaluation, Genome, Problem
from termsel.solvers.base import Generation, Solver


def neighbours(genes: BoolArray, genome: Genome) -> BoolArray:
    """Return all selections one step away.

    A step adds a gene, drops one, or swaps one that is on for one of the same segment that
    is off. Forced genes stay and each segment keeps its cardinality.

    Parameters
    ----------
    genes : ndarray of bool, shape (size,)
    genome : Genome

    Returns
    -------
    ndarray of bool, shape (n, size)
    """
    steps: list[tuple[int, ...]] = []
    for segment, where in zip(genome.segments, genome.slices().values(), strict=True):
        most = len(segment.labels) if segment.maximum is None else segment.maximum
        count = int(genes[where].sum())
        free = np.flatnonzero(genome.free[where]) + where.start
        on, off = free[genes[free]], free[~genes[free]]
        if count < most:
            steps += [(i,) for i in off]
        if count > segment.minimum:
            steps += [(i,) for i in on]
        steps += [(i, j) for i in on for j in off]
    around = np.repeat(genes[None], len(steps), axis=0)
    for row, step in zip(around, steps, strict=True):
        row[list(step)] ^= True
    return around


def descend(problem: Problem, genes: BoolArray, evaluation: Evaluation, index: int = 0,
            ) -> Iterator[Generation]:
    """Step to the best neighbour until none is better.

    Parameters
    ----------
    problem : Problem
    genes : ndarray of bool, shape (1, size)
        Where to start.
    evaluation : Evaluation
        Of the start.
    index : int
        Number of the first generation.

    Yields
    ------
    Generation
        One a step, the place reached; the start first.
    """
    yield Generation(index, genes, evaluation)
    while True:
        around = neighbours(genes[0], problem.genome)
        if not len(around):
            return
        judged = problem.evaluate(around)
        best = judged.order()[:1]
        if _rank(judged.take(best)) >= _rank(evaluation):
            return
        genes, evaluation = around[best], judged.take(best)
        index += 1
        yield Generation(index, genes, evaluation)


def _rank(one: Evaluation) -> tuple[float, float]:
    return float(one.violation[0]), float(one.objectives[0, 0])


class Swap(Solver):
    """Add, drop and swap genes as long as that helps, from many random starts.

    termsel's own formulation: steepest descent over all single additions, omissions and
    exchanges. The same descent is the polish that heuristics are followed by.
    """

    name = "swap"
    default_generations = None
    declared_options = (Option("starts", 20, "Random selections to start from.", int, 1),)

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield one generation a step of each descent (see `Solver.generations`)."""
        index = 0
        for _ in range(self.options["starts"]):
            genes = problem.genome.random(rng, 1)
            for generation in descend(problem, genes, problem.evaluate(genes), index):
                yield generation
                index = generation.index + 1
