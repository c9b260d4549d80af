"""Yardsticks: solvers that search at random or not at all."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from termsel.core.options import Option
from termsel.selection.problems.base import Problem
from termsel.selection.problems.segments import SEGMENTS
from termsel.selection.solvers.base import Generation, Solver


class RandomSearch(Solver):
    """Random selections: what any search must beat at the same number of evaluations."""

    name = "random"
    segments = SEGMENTS
    declared_options = (
        Option("population", 200, "Selections drawn at a time.", int, 1, 100_000),)

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield fresh random populations without end."""
        for index in itertools.count():
            genes = problem.genome.random(rng, self.options["population"])
            yield Generation(index, genes, problem.evaluate(genes))


class AllTerms(Solver):
    """The conventional approach: every term and every feature in use, no search."""

    name = "all-terms"
    uses_chance = False
    ends_by_itself = True
    uses_all = True

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield the one full selection."""
        genes = problem.genome.repair(np.ones((1, problem.genome.size), dtype=bool), rng)
        yield Generation(0, genes, problem.evaluate(genes))
