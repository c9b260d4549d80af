"""An evolutionary algorithm of one parent, for few evaluations."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from termsel.core.options import COUNT, Option
from termsel.selection.problems.base import Problem
from termsel.selection.problems.segments import SEGMENTS, AnySegment
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.genetic.operators import mutate_genes


class FastMutation(Solver):
    """(1 + 1) evolutionary algorithm with mutations of all sizes, for a few hundred evaluations.

    The parent is the best of some random selections. Each child has every gene of its parent
    changed with a chance of r / n, where r is drawn anew from a power law, and takes the place of
    its parent if it is no worse (Doerr, Le, Makhmara, Nguyen 2017, *Fast genetic algorithms*,
    GECCO). Most children differ by a gene or two, some by many.
    """

    name = "fast-ea"
    segments: ClassVar[tuple[type[AnySegment], ...]] = SEGMENTS
    declared_options: ClassVar[tuple[Option, ...]] = (
        Option("start", 20, "Random selections, the best of which is the first parent.", int, 1,
               COUNT),
        Option("power", 1.5, "Exponent of the power law that the strength of a mutation is drawn "
               "from.", float, 1.0, 10.0),
    )

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield generations without end (see `Solver.generations`)."""
        n = problem.genome.size
        strengths = np.arange(1, max(n // 2, 1) + 1)
        chances = strengths ** -self.options["power"]
        chances /= chances.sum()
        first = problem.genome.random(rng, self.options["start"])
        evaluation = problem.evaluate(first)
        yield Generation(0, first, evaluation)
        best = evaluation.order()[:1]
        parent = first[best]
        parent_evaluation = evaluation.take(best)
        for index in itertools.count(1):
            rate = float(rng.choice(strengths, p=chances)) / n
            child = problem.genome.repair(mutate_genes(parent, problem.genome, rate, rng), rng)
            child_evaluation = problem.evaluate(child)
            if (child_evaluation.violation[0], child_evaluation.objectives[0, 0]) <= (
                    parent_evaluation.violation[0], parent_evaluation.objectives[0, 0]):
                parent = child
                parent_evaluation = child_evaluation
            yield Generation(index, child, child_evaluation)
