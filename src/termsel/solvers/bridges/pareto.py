"""Several objectives at once, with NSGA-II of pymoo."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.core.algorithm import Algorithm
from pymoo.core.crossover import Crossover
from pymoo.core.mutation import Mutation
from pymoo.core.problem import Problem as PymooProblem
from pymoo.core.repair import Repair
from pymoo.core.sampling import Sampling
from pymoo.operators.crossover.ux import UX
from pymoo.operators.mutation.bitflip import BitflipMutation

from termsel.options import Option
from termsel.problems.base import Problem
from termsel.problems.genome import Genome
from termsel.problems.segments import SEGMENTS, AnySegment, Genes
from termsel.solvers.base import Generation, Solver
from termsel.solvers.bridges.pymoo_problem import steps
from termsel.solvers.genetic.operators import crossover, mutation


class _Keep(Repair):
    """Forced genes and cardinality, after every operator."""

    def __init__(self, genome: Genome, rng: np.random.Generator) -> None:
        super().__init__()
        self.genome, self.rng = genome, rng

    def _do(self, problem: PymooProblem, X: Genes, **_: Any) -> Genes:
        return self.genome.repair(X.astype(self.genome.dtype), self.rng)


class _Start(Sampling):
    """The random population that all solvers start from."""

    def __init__(self, genome: Genome, rng: np.random.Generator) -> None:
        super().__init__()
        self.genome, self.rng = genome, rng

    def _do(self, problem: PymooProblem, n_samples: int, **_: Any) -> Genes:
        return self.genome.random(self.rng, n_samples)


class _Mate(Crossover):
    """Crossover of a genome that has other genes than bits."""

    def __init__(self, genome: Genome) -> None:
        super().__init__(2, 2)
        self.genome = genome

    def _do(self, problem: PymooProblem, X: Genes, *_: Any, random_state: np.random.Generator,
            **__: Any) -> Genes:
        # pymoo has (parent, mating, gene); `crossover` takes parents in turn.
        pairs = X.swapaxes(0, 1).reshape(-1, self.genome.size)
        children = crossover(pairs, self.genome, 1.0, random_state)
        return children.reshape(-1, 2, self.genome.size).swapaxes(0, 1)


class _Mutate(Mutation):
    """Mutation of a genome that has other genes than bits."""

    def __init__(self, genome: Genome, rate: float) -> None:
        super().__init__()
        self.genome, self.rate = genome, rate

    def _do(self, problem: PymooProblem, X: Genes, *_: Any, random_state: np.random.Generator,
            **__: Any) -> Genes:
        return mutation(X, self.genome, self.rate, random_state)


def operators(genome: Genome, rate: float | None, rng: np.random.Generator) -> dict[str, Any]:
    """Return the start, crossover, mutation and repair that all algorithms have.

    The rate, the chance that a gene changes, is by default 1 over the number of genes.
    """
    rate = 1.0 / genome.size if rate is None else rate
    bits = genome.dtype == np.bool_
    return {"sampling": _Start(genome, rng), "crossover": UX() if bits else _Mate(genome),
            "mutation": (BitflipMutation(prob=1.0, prob_var=rate) if bits
                         else _Mutate(genome, rate)),
            "repair": _Keep(genome, rng)}


OPTIONS = (
    # pymoo compares all pairs of twice as many.
    Option("population", 100, "Number of selections.", int, 4, 5000),
    Option("mutation", None, "Chance that a gene changes; by default 1 over the number of genes.",
           float, 0.0, 1.0))
"""Options of all algorithms of pymoo."""


class Nsga2(Solver):
    """NSGA-II: non-dominated sorting and crowding distance (Deb et al. 2002).

    Start, uniform crossover, bit flips and repair are those of all algorithms of pymoo here; genes
    that are not bits have operators of their own (`termsel.solvers.genetic.operators`). The
    violation is a constraint, so that feasible selections come first.
    """

    name = "nsga2"
    min_objectives: ClassVar[int] = 2
    max_objectives: ClassVar[int] = 8
    segments: ClassVar[tuple[type[AnySegment], ...]] = SEGMENTS
    declared_options = OPTIONS

    def algorithm(self, **arguments: Any) -> Algorithm:
        """Return pymoo's algorithm; those of subclasses differ in the survival."""
        return NSGA2(**arguments)

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield generations without end (see `Solver.generations`)."""
        yield from steps(self.algorithm(pop_size=self.options["population"], **operators(
            problem.genome, self.options["mutation"], rng)), problem, rng)
