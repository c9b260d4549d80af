"""A problem as a DEAP toolbox: individuals, batch evaluation, operators by name."""

from __future__ import annotations

import ast
import inspect
import random
from collections.abc import Callable, Iterable, Sequence
from copy import deepcopy
from typing import Any
from zlib import crc32

import numpy as np
from deap import base, tools
from numpy.typing import NDArray

from termsel import Genome, Problem, TermselError
from termsel.toolkit import unknown_name_error
from termsel.toolkit.searches import WORST, cross_pairs, mutate_genes


class Fitness(base.Fitness):
    """The objectives, all minimised, of an individual; penalised where it is infeasible.

    DEAP makes a class for every number of objectives, which no other process can import.
    """

    def __init__(self, objectives: int, owner: Individual | None = None) -> None:
        self.weights = (-1.0,) * objectives
        self.owner = owner
        super().__init__()

    def _set(self, values: Sequence[float]) -> None:
        """Set the values; if they have an evaluation, the owner gets its genes and figures, too."""
        super().setValues(values)
        if isinstance(values, EvaluatedValues) and self.owner is not None:
            # The values are of the repaired genes, which another process may have repaired.
            self.owner[:] = values.genes
            self.owner.objectives = values.objectives
            self.owner.violation = values.violation

    values = property(base.Fitness.getValues, _set, base.Fitness.delValues)


class EvaluatedValues(tuple[float, ...]):
    """The values of a fitness, with the genes that were evaluated and their evaluation."""

    genes: list[Any]
    objectives: NDArray[np.float64]
    violation: float

    def __new__(cls, genes: list[Any], objectives: NDArray[np.float64],
                violation: float) -> EvaluatedValues:
        """Return the values of an individual, by its objectives (m,) and its violation.

        With a violation they are penalised, as by `deap.tools.DeltaPenalty`.
        """
        # WORST is above every objective, so that feasible individuals are better than all others.
        values = super().__new__(cls, [WORST + violation] * len(objectives) if violation
                                 else objectives.tolist())
        values.genes = genes
        values.objectives = objectives
        values.violation = violation
        return values

    def __reduce__(self) -> tuple[Any, ...]:
        return EvaluatedValues, (self.genes, self.objectives, self.violation)


class Individual(list[Any]):
    """Genes, numbers or bools, as a list, with a DEAP fitness of their own.

    Objectives (m,) and violation are as evaluated; the fitness of an infeasible individual is
    penalised.
    """

    def __init__(self, genes: Iterable[Any], objectives: int) -> None:
        super().__init__(genes)
        self.fitness = Fitness(objectives, self)
        self.objectives: Any = None
        self.violation = 0.0

    def __deepcopy__(self, memo: dict[int, Any]) -> Individual:
        copied = Individual(self, len(self.fitness.weights))
        copied.fitness.wvalues = self.fitness.wvalues
        # Objectives are never changed in place, so that both may have the same array.
        copied.objectives = self.objectives
        copied.violation = self.violation
        return copied


class _ProblemTools:
    """What a toolbox does with a problem; other processes can have it, as they can a toolbox."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    def population(self, n: int) -> list[Individual]:
        """Return n random individuals, without a fitness."""
        genes = self.problem.genome.random(_generator_like_random(), n).tolist()
        return [Individual(chromosome, len(self.problem.objectives)) for chromosome in genes]

    def individual(self) -> Individual:
        return self.population(1)[0]

    def evaluate(self, individual: Individual) -> EvaluatedValues:
        return self.evaluated([individual])[0]

    def evaluated(self, individuals: list[Individual]) -> list[EvaluatedValues]:
        """Return the values of individuals, whose genes are first repaired as the genome demands.

        They are in the order of `individuals`; [] if there are none.
        """
        if not individuals:
            return []
        genome = self.problem.genome
        proposed: NDArray[Any] = np.array(individuals)
        if genome.dtype == np.bool_ and proposed.dtype != np.bool_:
            # Of the reals that operators of one's own give, all but 0 would be on as bool.
            proposed = proposed.astype(float) > 0.5
        proposed = proposed.astype(genome.dtype)
        genes = genome.repair(proposed, np.random.default_rng(0))
        # Genes that had to be repaired are repaired again, each with a generator that depends on
        # them alone, so that the outcome is the same in every process and order.
        for i in np.flatnonzero((genes != proposed).any(axis=1)):
            genes[i] = genome.repair(proposed[i:i + 1],
                                     np.random.default_rng(crc32(proposed[i].tobytes())))[0]
        evaluation = self.problem.evaluate(genes)
        return list(map(EvaluatedValues, genes.tolist(), evaluation.objectives,
                        evaluation.violation.tolist()))

    def map(self, function: Callable[..., Any], individuals: Iterable[Any], *iterables: Any
            ) -> Iterable[Any]:
        """Call a function for each individual; `evaluate` is called once, for all of them together.

        A function that replaces or decorates `evaluate` is called for each individual.
        """
        if getattr(function, "func", None) == self.evaluate and not iterables:
            return self.evaluated(list(individuals))
        return map(function, individuals, *iterables)


def to_deap(problem: Problem) -> base.Toolbox:
    """Return a DEAP toolbox for a problem, for scripts of one's own.

    It has ``population(n)``, ``evaluate``, ``map``, ``clone``, and operators that may be replaced:
    ``select`` (tournaments of 3), ``mate`` (uniform crossover) and ``mutate`` (1 gene on average).
    ``map`` evaluates all individuals at once; ``register("map", pool.map)`` spreads them over
    processes, with the same outcome. Individuals keep forced genes and cardinality: what is
    evaluated is repaired, and the genes follow when the fitness is set. Infeasible ones have a
    penalised fitness, as by `deap.tools.DeltaPenalty`: the larger the violation the worse, and
    worse than all others. Chance comes from Python's `random`, as everywhere in DEAP.

    Parameters
    ----------
    problem : Problem
        Such as that of a task that `termsel.prepare` returns.

    Returns
    -------
    deap.base.Toolbox
        With the functions above, for the loops of `deap.algorithms`.

    Examples
    --------
    >>> import random, termsel, termsel_optimisers
    >>> from deap import algorithms
    >>> random.seed(1)
    >>> task = termsel.prepare("poly-terms", options={"degree": 2})
    >>> box = termsel_optimisers.to_deap(task.problem)
    >>> last, log = algorithms.eaSimple(box.population(n=20), box, 0.9, 0.2, 2, verbose=False)
    >>> len(last), log.select("gen")
    (20, [0, 1, 2])
    """
    judge = _ProblemTools(problem)
    box = base.Toolbox()
    for alias in ("individual", "population", "evaluate", "map"):
        box.register(alias, getattr(judge, alias))
    box.register("clone", deepcopy)
    for role in OPERATORS:
        register(box, role, None, problem.genome)
    return box


OPERATORS = {"select": ("sel", "selTournament:tournsize=3"), "mate": ("cx", "cxUniform:indpb=0.5"),
             "mutate": ("mut", "mutFlipBit")}
"""Operators of a toolbox: how their functions in `deap.tools` begin, and the default."""


def register(box: base.Toolbox, role: str, declaration: str | None, genome: Genome) -> None:
    """Register an operator, to select, mate or mutate, by its name in `deap.tools`.

    `declaration` is name and arguments, such as ``selTournament:tournsize=3``. If it is None, the
    operator is that of `OPERATORS`, or one for the genome if its genes are not bits. A mutation
    without ``indpb`` flips one gene on average. Raises TermselError for an unknown operator, and
    for arguments that it does not take or that are missing.
    """
    start, default = OPERATORS[role]
    if declaration is None and role != "select" and genome.dtype != np.bool_:
        box.register(role, _mate if role == "mate" else _mutate, genome=genome)
        return
    name, _, arguments = (declaration or default).partition(":")
    # Such as selTournament: the role, then a word that begins with a capital.
    operators = [operator for operator in dir(tools)
                 if operator.startswith(start) and operator[len(start)].isupper()]
    if name not in operators:
        raise unknown_name_error(f"operator of deap.tools to {role}", name, operators)
    function: Callable[..., Any] = getattr(tools, name)
    # Arguments are Python literals: numbers, text, lists.
    keywords: dict[str, Any] = dict(map(_parse_argument, filter(None, arguments.split(","))))
    parameters = inspect.signature(function).parameters
    if role == "mutate" and "indpb" in parameters:
        keywords.setdefault("indpb", 1.0 / genome.size)
    # The first parameters are the individuals and, to select, their number.
    n_individuals = {"select": 2, "mate": 2, "mutate": 1}[role]
    arguments_taken = list(parameters)[n_individuals:]
    if not set(keywords) <= set(arguments_taken):
        unknown = min(set(keywords) - set(arguments_taken))
        raise TermselError(f"{name} of deap.tools takes no argument {unknown!r}",
                           hint=f"It takes {', '.join(arguments_taken) or 'none'}.")
    missing = [key for key in arguments_taken if key not in keywords
               and parameters[key].default is inspect.Parameter.empty]
    if missing:
        raise TermselError(f"{name} of deap.tools requires {', '.join(missing)}",
                           hint=f"For example --set {role}={name}:{missing[0]}=0.5.")
    box.register(role, function, **keywords)


def _parse_argument(text: str) -> tuple[str, Any]:
    """Return name and value of an operator's argument KEY=VALUE, a literal of Python.

    Raises TermselError if the text is no such argument.
    """
    key, _, value = text.partition("=")
    try:
        return key.strip(), ast.literal_eval(value.strip())
    except (SyntaxError, ValueError):
        raise TermselError(f"{text!r} is no argument of an operator",
                           hint="Write KEY=NUMBER, such as selTournament:tournsize=3.") from None


def _mate(individual_1: Individual, individual_2: Individual,
          genome: Genome) -> tuple[Individual, Individual]:
    """Cross two individuals in place, with the operators for their types of genes; return both."""
    pair = np.array([individual_1, individual_2], dtype=genome.dtype)
    crossed = cross_pairs(pair, genome, 1.0, _generator_like_random()).tolist()
    individual_1[:] = crossed[0]
    individual_2[:] = crossed[1]
    return individual_1, individual_2


def _mutate(individual: Individual, genome: Genome) -> tuple[Individual]:
    """Mutate an individual in place, by its types of genes; return it in a tuple."""
    genes = np.array([individual], dtype=genome.dtype)
    individual[:] = mutate_genes(genes, genome, 1.0 / genome.size,
                                 _generator_like_random())[0].tolist()
    return (individual,)


def _generator_like_random() -> np.random.Generator:
    """Return a generator that follows the state of Python's `random`, as DEAP's operators do."""
    return np.random.default_rng(random.getrandbits(128))
