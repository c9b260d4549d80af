"""pymoo's algorithms by name, or one of a user's own, as solvers."""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from importlib import import_module
from math import comb
from typing import Any, ClassVar

import numpy as np
from pymoo.algorithms.soo.nonconvex.ga import FitnessSurvival
from pymoo.core.algorithm import Algorithm
from pymoo.util.ref_dirs import get_reference_directions

from termsel import Generation, Option, Problem, Solver, TermselError
from termsel.toolkit.searches import (
    OPTIONS,
    SEGMENTS,
    OwnChance,
    common_operators,
    population_size,
    step_algorithm,
)
from termsel_optimisers.survivals import RveaSurvival, with_safe_survival

PYMOO_ALGORITHMS = {
    "nsga2": "moo.nsga2:NSGA2", "nsga3": "moo.nsga3:NSGA3", "unsga3": "moo.unsga3:UNSGA3",
    "rvea": "moo.rvea:RVEA", "ctaea": "moo.ctaea:CTAEA", "age": "moo.age:AGEMOEA",
    "age2": "moo.age2:AGEMOEA2", "sms": "moo.sms:SMSEMOA", "spea2": "moo.spea2:SPEA2",
    "omni": "moo.omni:OmniOptimizer", "ga": "soo.nonconvex.ga:GA",
    "ga_niching": "soo.nonconvex.ga_niching:NicheGA"}
"""Algorithms of pymoo that take operators for bits, keep constraints, and evaluate a population
at once; where their classes are. Their names are those of pymoo's modules."""

SINGLE = frozenset({"ga", "ga_niching"})
"""Those for one objective."""

DIRECTED = frozenset({"nsga3", "unsga3", "rvea", "ctaea"})
"""Those with reference directions."""

_UNCONSTRAINED = "refuses constraints, so it would not keep infeasible selections out"
_NEEDS_POINTS = "requires reference points; make a solver of it with termsel_optimisers.from_pymoo"
_NUMBERS = "moves real numbers, not bits"
UNFIT = {
    **dict.fromkeys(("moead", "dnsga2", "kgb"), _UNCONSTRAINED),
    **dict.fromkeys(("rnsga2", "rnsga3"), _NEEDS_POINTS),
    "pinsga2": "asks a person after each few generations",
    "random_search": "is what termsel's own solver 'random' does",
    **dict.fromkeys(("brkga", "cmaes", "cmopso", "de", "direct", "es", "g3pcx", "gde3", "isres",
                     "mopso_cd", "nelder", "nrbo", "nsde", "nsder", "optuna", "pattern", "pso",
                     "pso_ep", "sres"), _NUMBERS)}
"""Other algorithms of pymoo 0.6, and why they are not offered."""


class Pymoo(Solver):
    """Any algorithm of pymoo that can handle bits, by its name in pymoo.

    Start, crossover, mutation and repair are those of ``nsga2``, which differs only in what
    survives. The violation is a constraint. ``ga`` and ``ga_niching`` are for one objective, the
    others for several. NSGA-III, U-NSGA-III, RVEA and C-TAEA get reference directions of Das and
    Dennis 1998, as many as the population allows. C-TAEA weighs the violation against the
    objectives as long as few are feasible: where good objectives lead away from what is feasible,
    it may find nothing feasible.

    Not offered are MOEA/D, D-NSGA-II and KGB-DMOEA, which refuse constraints, and algorithms for
    real numbers. R-NSGA-II and R-NSGA-III require reference points: make a solver of them with
    `termsel_optimisers.from_pymoo`.
    """

    name = "pymoo"
    max_objectives: ClassVar[int] = 8
    segments = SEGMENTS
    declared_options = (
        Option("algorithm", "nsga2", "The algorithm, as pymoo names its module.",
               choices=tuple(PYMOO_ALGORITHMS)),
        *OPTIONS,
        Option("horizon", None, "Generations over which rvea shifts its weight from convergence "
               "to spread; by default as many as the usual budget has.", int, 1,
               1_000_000),
    )

    def __init__(self, **options: Any) -> None:
        """Take the options.

        Raises TermselError for options that are not valid, for an algorithm that is not offered,
        and for a horizon that the algorithm does not use.
        """
        algorithm = options.get("algorithm")
        if isinstance(algorithm, str) and algorithm in UNFIT:
            raise TermselError(f"pymoo's algorithm {algorithm!r} {UNFIT[algorithm]}",
                               hint=f"Choose one of: {', '.join(PYMOO_ALGORITHMS)}.")
        super().__init__(**options)
        if self.options["horizon"] and self.options["algorithm"] != "rvea":
            raise TermselError("option 'horizon' is for algorithm=rvea, and the algorithm is "
                               f"{self.options['algorithm']}", hint="Leave it out.",
                               name="horizon")
        single = self.options["algorithm"] in SINGLE
        # pymoo's classes do not state how many objectives they take.
        for attribute, several in (("min_objectives", 2), ("max_objectives", 8)):
            setattr(self, attribute, 1 if single else several)

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield the generations of pymoo's algorithm without end (see `Solver.generations`).

        Raises TermselError if the population is smaller than the number of directions.
        """
        name = self.options["algorithm"]
        population = population_size(self.options["population"], problem)
        module, _, class_name = PYMOO_ALGORITHMS[name].partition(":")
        algorithm_class = getattr(import_module(f"pymoo.algorithms.{module}"), class_name)
        arguments = common_operators(problem.genome, self.options["mutation"], rng)
        # These algorithms require an individual for each direction.
        if name in DIRECTED:
            arguments["ref_dirs"] = reference_directions(len(problem.objectives), population)
            if len(arguments["ref_dirs"]) > population:
                raise TermselError(
                    f"algorithm={name} has a direction for each of {len(problem.objectives)} "
                    f"objectives, but a population of {population}",
                    hint=f"Set population={len(arguments['ref_dirs'])} or more.")
        # RVEA's own survival may fail by rounding; `with_safe_survival` replaces that of others.
        if name == "rvea":
            arguments["survival"] = RveaSurvival(arguments["ref_dirs"])
        if name in ("ctaea", "omni"):
            # Both go on until all individuals differ, which never is so if few selections exist.
            arguments["eliminate_duplicates"] = False
        # C-TAEA has an individual for each direction.
        if name != "ctaea":
            arguments["pop_size"] = population
        yield from step_algorithm(
            with_safe_survival(algorithm_class, **arguments), problem, rng, self.options["horizon"])


def reference_directions(
        objectives: int, max_directions: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return reference directions (n, objectives) of Das and Dennis 1998.

    They are as many as can be up to `max_directions`, but one for each objective at least.
    """
    # The directions are all points whose coordinates are multiples of 1 / partitions and add up to
    # 1, of which there are comb(partitions + objectives - 1, objectives - 1).
    partitions = 1
    while comb(partitions + objectives, objectives - 1) <= max_directions:
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
        Name of the solver; by default that of the algorithm's class.

    Returns
    -------
    type[Solver]
        For the argument ``solver`` of `termsel.run`, `termsel.search` and `termsel.compare`.

    Raises
    ------
    TermselError
        For what is no algorithm of pymoo, and one that refuses constraints, or moves real numbers.

    Examples
    --------
    >>> import termsel, termsel_optimisers
    >>> from pymoo.algorithms.soo.nonconvex.ga import GA
    >>> from pymoo.operators.crossover.ux import UX
    >>> from pymoo.operators.mutation.bitflip import BitflipMutation
    >>> from pymoo.operators.sampling.rnd import BinaryRandomSampling
    >>> mine = termsel_optimisers.from_pymoo(GA(pop_size=20, sampling=BinaryRandomSampling(),
    ...                              crossover=UX(), mutation=BitflipMutation()))
    >>> termsel.run("poly-terms", solver=mine, evaluations=200, options={"degree": 2}).solver
    'ga-pymoo'
    """
    if not isinstance(algorithm, Algorithm):
        raise TermselError(f"{algorithm!r:.100} is no algorithm of pymoo",
                           hint="Give an object, such as GA(pop_size=60, ...).")
    homes = [base_class.__module__ for base_class in type(algorithm).__mro__
             if base_class.__module__.startswith("pymoo.")]
    # A user's own class derives from one of pymoo, whose module tells the algorithm.
    for reason in (UNFIT.get(home.rpartition(".")[2]) for home in homes):
        if reason in (_UNCONSTRAINED, _NUMBERS):
            raise TermselError(f"pymoo's {type(algorithm).__name__} {reason}",
                               hint="Choose another algorithm, such as GA or NSGA2.")
    # MixedVariableGA is in no module of algorithms; its survival is for a single objective.
    single = (any(home.startswith("pymoo.algorithms.soo") for home in homes)
              or isinstance(getattr(algorithm, "survival", None), FitnessSurvival))
    several = any(home.startswith("pymoo.algorithms.moo") for home in homes)

    class FromPymoo(Solver):
        __doc__ = f"{type(algorithm).__name__} of pymoo, as a user set it up."
        min_objectives = 2 if several else 1
        max_objectives = 1 if single else 8
        segments = SEGMENTS

        def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
            """Yield the generations of a copy of the algorithm (see `Solver.generations`)."""
            # The generator itself is as that of `pymoo.optimize.minimize` with the same seed.
            yield from step_algorithm(
                deepcopy(algorithm), problem, rng, chance=OwnChance(rng.spawn(1)[0]))

    FromPymoo.name = name or f"{type(algorithm).__name__.lower()}-pymoo"
    return FromPymoo
