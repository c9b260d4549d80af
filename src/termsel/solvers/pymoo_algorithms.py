"""pymoo's algorithms by name, or one of a user's own, as solvers."""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from importlib import import_module
from math import comb
from typing import Any, ClassVar

import numpy as np
from pymoo.core.algorithm import Algorithm
from pymoo.util.ref_dirs import get_reference_directions

from termsel.options import Option
from termsel.problems.base import Problem
from termsel.problems.segments import SEGMENTS, AnySegment
from termsel.solvers.base import Generation, Solver
from termsel.solvers.pareto import SURVIVALS, operators
from termsel.solvers.pymoo_problem import steps

ALGORITHMS = {
    "ga": "soo.nonconvex.ga:GA", "nsga2": "moo.nsga2:NSGA2", "ctaea": "moo.ctaea:CTAEA",
    "age": "moo.age:AGEMOEA", "age2": "moo.age2:AGEMOEA2", "sms": "moo.sms:SMSEMOA",
    "spea2": "moo.spea2:SPEA2"}
"""Algorithms of pymoo that take operators for bits, keep constraints, and evaluate a population
at once; where their classes are. NSGA-III and U-NSGA-III of pymoo 0.6 draw from a generator that no
seed sets, so that no run could be repeated."""


class Pymoo(Solver):
    """Any algorithm of pymoo that can handle bits, by its name in pymoo.

    Start, crossover, mutation and repair are those of ``nsga2``, which differs only in what
    survives. The violation is a constraint. C-TAEA gets reference directions of Das and Dennis
    1998, as many as the population allows. ``ga`` is for one objective, the others are for several.
    NSGA-III is not among them: pymoo 0.6 does not let its seed be set.
    """

    name = "pymoo"
    max_objectives: ClassVar[int] = 8
    segments: ClassVar[tuple[type[AnySegment], ...]] = SEGMENTS
    declared_options = (
        Option("algorithm", "nsga2", "The algorithm, as pymoo names it.",
               choices=tuple(ALGORITHMS)),
        Option("population", 100, "Number of selections.", int, 4, 5000),
        Option("mutation", None, "Chance that a gene changes; by default 1 over the number of "
               "genes.", float, 0.0, 1.0),
    )

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        _limit(self, one=self.options["algorithm"] == "ga")

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield generations without end (see `Solver.generations`)."""
        name, population = self.options["algorithm"], self.options["population"]
        module, _, of = ALGORITHMS[name].partition(":")
        algorithm = getattr(import_module(f"pymoo.algorithms.{module}"), of)
        given = operators(problem.genome, self.options["mutation"], rng)
        if name == "ctaea":
            given["ref_dirs"] = directions(len(problem.objectives), population)
            # Its population is as large as there are directions. It never ends where fewer
            # individuals than directions are left, as without duplicates.
            given["eliminate_duplicates"] = False
        else:
            given["pop_size"] = population
        made = algorithm(**given)
        if name in SURVIVALS:
            made.survival = SURVIVALS[name]()
        yield from steps(made, problem, rng)


def _limit(solver: Solver, *, one: bool) -> None:
    """Set how many objectives an algorithm can handle, which its class does not tell."""
    for word, count in (("min_objectives", 1 if one else 2), ("max_objectives", 1 if one else 8)):
        setattr(solver, word, count)


def directions(objectives: int, most: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return reference directions of Das and Dennis 1998, shape (n, objectives).

    Parameters
    ----------
    objectives, most : int
        Number of objectives, and of directions at most.
    """
    partitions = 1
    while comb(partitions + objectives, objectives - 1) <= most:
        partitions += 1
    return np.asarray(get_reference_directions("das-dennis", objectives, n_partitions=partitions))


def from_pymoo(algorithm: Algorithm, *, name: str | None = None) -> type[Solver]:
    """Return a solver made of a pymoo algorithm.

    Parameters
    ----------
    algorithm : pymoo.core.algorithm.Algorithm
        Such as ``GA(pop_size=60, sampling=BinaryRandomSampling(), ...)``. Every search has a copy
        of it. Forced genes and cardinality are kept by repairing what it asks for.
    name : str, optional
        Of the solver; by default that of the algorithm's class.

    Returns
    -------
    type[Solver]

    Examples
    --------
    >>> import termsel
    >>> from pymoo.algorithms.soo.nonconvex.ga import GA
    >>> from pymoo.operators.crossover.ux import UX
    >>> from pymoo.operators.mutation.bitflip import BitflipMutation
    >>> from pymoo.operators.sampling.rnd import BinaryRandomSampling
    >>> mine = termsel.from_pymoo(GA(pop_size=20, sampling=BinaryRandomSampling(),
    ...                              crossover=UX(), mutation=BitflipMutation()))
    >>> termsel.run("poly-terms", solver=mine, evaluations=200, options={"degree": 2}).solver
    'ga-pymoo'
    """
    homes = [one.__module__ for one in type(algorithm).__mro__]
    single = any(home.startswith("pymoo.algorithms.soo") for home in homes)
    several = any(home.startswith("pymoo.algorithms.moo") for home in homes)

    class FromPymoo(Solver):
        __doc__ = f"{type(algorithm).__name__} of pymoo, as a user set it up."
        min_objectives = 2 if several else 1
        max_objectives = 1 if single else 8

        def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
            yield from steps(deepcopy(algorithm), problem, rng)

    FromPymoo.name = name or f"{type(algorithm).__name__.lower()}-pymoo"
    return FromPymoo
