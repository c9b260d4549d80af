"""Local search by adding, dropping and swapping genes; also the polish of other solvers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from termsel.features import BoolArray, IntArray
from termsel.options import Option
from termsel.problems.base import Evaluation, Genome, Problem
from termsel.solvers.base import Generation, Solver


def neighbours(genes: BoolArray, genome: Genome) -> Iterator[BoolArray]:
    """Yield all selections one step away, in batches of one kind.

    First come the selections with a gene more or less, then, for each gene that is on, those
    in which another of its segment takes its place. Forced genes stay and each segment keeps
    its cardinality.

    Parameters
    ----------
    genes : ndarray of bool, shape (size,)
    genome : Genome

    Yields
    ------
    ndarray of bool, shape (n, size)
    """
    flips: list[int] = []
    swaps: list[tuple[int, IntArray]] = []
    for segment, where in zip(genome.segments, genome.slices().values(), strict=True):
        most = len(segment.labels) if segment.maximum is None else segment.maximum
        count = int(genes[where].sum())
        free = np.flatnonzero(genome.free[where]) + where.start
        on, off = free[genes[free]], free[~genes[free]]
        flips += off.tolist() if count < most else []
        flips += on.tolist() if count > segment.minimum else []
        swaps += [(int(i), off) for i in on if len(off)]
    if flips:
        around = np.repeat(genes[None], len(flips), axis=0)
        around[np.arange(len(flips)), flips] ^= True
        yield around
    for gone, off in swaps:
        around = np.repeat(genes[None], len(off), axis=0)
        around[:, gone] = False
        around[np.arange(len(off)), off] = True
        yield around


def descend(problem: Problem, genes: BoolArray, evaluation: Evaluation, index: int = 0,
            ) -> Iterator[Generation]:
    """Step to better neighbours until there is none.

    A step goes to the best of the first batch of `neighbours` that holds a better one: most
    steps then cost a handful of evaluations, and where the descent ends no neighbour at all
    is better.

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
    better = True
    while better:
        yield Generation(index, genes, evaluation)
        index += 1
        better = False
        for around in neighbours(genes[0], problem.genome):
            judged = problem.evaluate(around)
            best = judged.order()[:1]
            if _rank(judged.take(best)) < _rank(evaluation):
                genes, evaluation, better = around[best], judged.take(best), True
                break


def _rank(one: Evaluation) -> tuple[float, float]:
    return float(one.violation[0]), float(one.objectives[0, 0])


class Swap(Solver):
    """Add, drop and swap genes as long as that helps, from many random starts.

    termsel's own formulation; see `descend`. The same descent is the polish that heuristics
    are followed by.
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
