"""Several objectives at once, with NSGA-II of pymoo."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from termsel.core.options import Option
from termsel.selection.problems.base import Problem
from termsel.selection.problems.segments import SEGMENTS, AnySegment
from termsel.selection.solvers.base import Generation, Solver

if TYPE_CHECKING:
    from pymoo.core.algorithm import Algorithm

OPTIONS = (
    # pymoo compares all pairs of twice as many.
    Option("population", None, "Number of selections; by default a 160th of the budget of "
           "evaluations, 20 at least and 100 at most.", int, 4, 5000),
    Option("mutation", None, "Chance that a gene changes; by default 1 over the number of genes.",
           float, 0.0, 1.0))
"""Options of all algorithms of pymoo."""

SMALLEST, LARGEST, GENERATIONS = 20, 100, 160
"""Fewest and most selections, and the generations that the budget is enough for: with 8,000
evaluations 50 selections led to better fronts than 100 and 200."""


def population_size(given: int | None, problem: Problem) -> int:
    """Return the number of selections, which depends on the budget where it is not given."""
    if given is not None:
        return given
    if problem.budget is None:
        return LARGEST
    return min(max(problem.budget // GENERATIONS, SMALLEST), LARGEST)


class Nsga2(Solver):
    """NSGA-II: non-dominated sorting and crowding distance (Deb et al. 2002).

    Start, two-point crossover, bit flips and repair are those of all algorithms of pymoo here;
    genes that are not bits have operators of their own
    (`termsel.selection.solvers.genetic.operators`). The violation is a constraint, so that feasible
    selections come first.
    """

    name = "nsga2"
    min_objectives: ClassVar[int] = 2
    max_objectives: ClassVar[int] = 8
    segments: ClassVar[tuple[type[AnySegment], ...]] = SEGMENTS
    declared_options = OPTIONS

    def algorithm(self, **arguments: Any) -> Algorithm:
        """Return pymoo's algorithm; those of subclasses differ in the survival."""
        from pymoo.algorithms.moo.nsga2 import NSGA2

        return NSGA2(**arguments)

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield generations without end (see `Solver.generations`)."""
        # All that varies genes is termsel's; pymoo has the survival and the tournaments.
        # pymoo takes long to import, and those who search otherwise know this class, too.
        from termsel.selection.solvers.bridges.pymoo_operators import common_operators
        from termsel.selection.solvers.bridges.pymoo_problem import step_algorithm

        population = population_size(self.options["population"], problem)
        yield from step_algorithm(self.algorithm(pop_size=population, **common_operators(
            problem.genome, self.options["mutation"], rng)), problem, rng)
