"""An evolutionary algorithm of one parent, for few evaluations."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from termsel.core.options import COUNT, Option
from termsel.selection.problems.base import Problem
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.segments import SEGMENTS, AnySegment, Genes
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.genetic.operators import mutate_genes

FALL = 1.54468
"""Genes that change after t evaluations, by n ln(t) / t: of n weighted genes, an unknown number of
which counts, a (1 + 1) algorithm is fastest so (Einarsson et al. 2018)."""

TRIES = 20
"""Most mutations of a parent until a child differs from it: small spaces have no other."""


class FastMutation(Solver):
    """(1 + 1) evolutionary algorithm with ever smaller mutations, for a few hundred evaluations.

    The parent is the best of some random selections. A child takes the place of its parent if it is
    no worse. After t evaluations every gene of n changes with a chance of 1.54 ln(t) / t, and 1 / n
    at least: many genes at first, later one (Einarsson et al. 2018, *The linear hidden subset
    problem for the (1+1) EA with scheduled and adaptive mutation rates*, GECCO); nevergrad chooses
    such an algorithm for such a problem. With `power` the chance is r / n instead, where r is drawn
    anew each time from a power law (Doerr, Le, Makhmara, Nguyen 2017, *Fast genetic algorithms*,
    GECCO).
    """

    name = "fast-ea"
    segments: ClassVar[tuple[type[AnySegment], ...]] = SEGMENTS
    declared_options: ClassVar[tuple[Option, ...]] = (
        Option("start", 10, "Random selections, the best of which is the first parent.", int, 1,
               COUNT),
        Option("power", None, "Exponent of the power law that the strength of a mutation is drawn "
               "from, such as 1.5; by default mutations become smaller with each evaluation.",
               float, 1.0, 10.0),
    )

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield generations without end (see `Solver.generations`)."""
        first = problem.genome.random(rng, self.options["start"])
        evaluation = problem.evaluate(first)
        yield Generation(0, first, evaluation)
        best = evaluation.order()[:1]
        parent = first[best]
        parent_evaluation = evaluation.take(best)
        chances = self._chances(problem.genome.size, rng)
        for index, chance in enumerate(chances, 1):
            child = _child_of(parent, problem.genome, chance, rng)
            child_evaluation = problem.evaluate(child)
            if (child_evaluation.violation[0], child_evaluation.objectives[0, 0]) <= (
                    parent_evaluation.violation[0], parent_evaluation.objectives[0, 0]):
                parent = child
                parent_evaluation = child_evaluation
            yield Generation(index, child, child_evaluation)

    def _chances(self, n: int, rng: np.random.Generator) -> Iterator[float]:
        """Yield without end the chance that a gene of n changes, for one child after another."""
        power = self.options["power"]
        if power is None:
            for evaluations in itertools.count(self.options["start"] + 1):
                yield max(1.0, n * FALL * math.log(evaluations) / evaluations) / n
        strengths = np.arange(1, max(n // 2, 1) + 1)
        shares = strengths**-power / (strengths**-power).sum()
        while True:
            yield float(rng.choice(strengths, p=shares)) / n


def _child_of(parent: Genes, genome: Genome, chance: float, rng: np.random.Generator) -> Genes:
    """Return a child (1, size) that differs from its parent, where one is found soon."""
    for _ in range(TRIES):
        child = genome.repair(mutate_genes(parent, genome, chance, rng), rng)
        if (child != parent).any():
            break
    return child
