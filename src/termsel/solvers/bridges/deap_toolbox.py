"""A problem as a DEAP toolbox: individuals, batch evaluation, operators by name."""

from __future__ import annotations

import ast
import inspect
import random
from collections.abc import Callable, Iterable
from copy import deepcopy
from typing import Any

import numpy as np
from deap import base, tools

from termsel.errors import TermselError, unknown_name
from termsel.problems.base import WORST, Problem
from termsel.problems.genome import Genome
from termsel.problems.segments import Genes
from termsel.solvers.genetic.operators import crossover, mutation


class Individual(list[Any]):
    """Genes, numbers or bools, as a list, with a DEAP fitness of their own.

    Objectives (m,) and violation are as evaluated; the fitness of an infeasible individual is
    penalised.
    """

    def __init__(self, genes: Iterable[Any], fitness: base.Fitness) -> None:
        super().__init__(genes)
        self.fitness = fitness
        self.objectives: Any = None
        self.violation = 0.0

    def __deepcopy__(self, memo: dict[int, Any]) -> Individual:
        copied = Individual(self, deepcopy(self.fitness))
        # Nobody changes an evaluation: it needs no copy.
        copied.objectives, copied.violation = self.objectives, self.violation
        return copied


def to_deap(problem: Problem) -> base.Toolbox:
    """Return a DEAP toolbox for a problem, for scripts of one's own.

    It has ``population(n)``, ``evaluate``, ``map``, ``clone``, and operators that may be replaced:
    ``select`` (tournaments of 3), ``mate`` (uniform crossover) and ``mutate`` (1 gene on average).
    ``map`` evaluates all individuals at once. Individuals keep forced genes and cardinality: they
    are repaired where they are evaluated. Infeasible ones have a penalised fitness
    (`deap.tools.DeltaPenalty`), the larger the violation the worse, and worse than all others.
    Chance comes from Python's `random`, as everywhere in DEAP.

    Parameters
    ----------
    problem : Problem
        Such as that of a task that `termsel.prepare` returns.

    Examples
    --------
    >>> import random, termsel
    >>> from deap import algorithms
    >>> random.seed(1)
    >>> task = termsel.prepare("poly-terms", options={"degree": 2})
    >>> box = termsel.to_deap(task.problem)
    >>> last, log = algorithms.eaSimple(box.population(n=20), box, 0.9, 0.2, 2, verbose=False)
    >>> len(last), log.select("gen")
    (20, [0, 1, 2])
    """
    genome = problem.genome
    fitness = type("Fitness", (base.Fitness,), {"weights": (-1.0,) * len(problem.objectives)})

    def population(n: int) -> list[Individual]:
        return [Individual(genes, fitness()) for genes in genome.random(_rng(), n).tolist()]

    # It decorates an evaluation; this one only returns what is known of the individual.
    objectives = tools.DeltaPenalty(
        lambda one: one.violation == 0, WORST, lambda one: one.violation)(
        lambda one: tuple(one.objectives.tolist()))

    def judged(individuals: list[Individual]) -> list[tuple[float, ...]]:
        if not individuals:
            return []
        genes = genome.repair(np.array(individuals, dtype=genome.dtype), _rng())
        evaluation = problem.evaluate(genes)
        for one, row, values, violation in zip(individuals, genes.tolist(), evaluation.objectives,
                                               evaluation.violation.tolist(), strict=True):
            # In place, as loops hold the individual: its genes are the repaired ones from now on.
            one[:], one.objectives, one.violation = row, values, violation
        return [objectives(one) for one in individuals]

    box = base.Toolbox()
    box.register("individual", lambda: population(1)[0])
    box.register("population", population)
    box.register("clone", deepcopy)
    box.register("evaluate", lambda one: judged([one])[0])
    alone = box.evaluate
    # What replaces or decorates `evaluate` is called for each individual.
    box.register("map", lambda function, individuals, *more:
                 judged(list(individuals)) if function is alone and not more
                 else map(function, individuals, *more))
    for role in ROLES:
        register(box, role, None, genome)
    return box


ROLES = {"select": ("sel", "selTournament:tournsize=3"), "mate": ("cx", "cxUniform:indpb=0.5"),
         "mutate": ("mut", "mutFlipBit")}
"""Operators of a toolbox: how their functions in `deap.tools` begin, and the default."""


def register(box: base.Toolbox, role: str, said: str | None, genome: Genome) -> None:
    """Register an operator, to select, mate or mutate, by its name in `deap.tools`.

    `said` is name and arguments, such as ``selTournament:tournsize=3``; without it one for the
    genome is taken. Where ``indpb`` of a mutation is not given, the mean number of flips is 1.
    Raises TermselError for an operator that there is not, or arguments that it does not take.
    """
    start, default = ROLES[role]
    if said is None and role != "select" and genome.dtype != np.bool_:
        box.register(role, _mated if role == "mate" else _mutated, genome=genome)
        return
    name, _, arguments = (said or default).partition(":")
    known = [one for one in dir(tools) if one.startswith(start) and one[len(start)].isupper()]
    if name not in known:
        raise unknown_name(f"operator of deap.tools to {role}", name, known)
    function: Callable[..., Any] = getattr(tools, name)
    keywords: dict[str, Any] = dict(map(_argument, filter(None, arguments.split(","))))
    takes = list(inspect.signature(function).parameters)
    if role == "mutate" and "indpb" in takes:
        keywords.setdefault("indpb", 1.0 / genome.size)
    # Individuals come first, and how many to select; the rest are arguments.
    free = {"select": 2, "mate": 2, "mutate": 1}[role]
    if not set(keywords) <= set(takes[free:]):
        wrong = min(set(keywords) - set(takes[free:]))
        raise TermselError(f"{name} of deap.tools takes no argument {wrong!r}",
                           hint=f"It takes {', '.join(takes[free:]) or 'none'}.")
    lacking = [key for key in takes[free:] if key not in keywords and
               inspect.signature(function).parameters[key].default is inspect.Parameter.empty]
    if lacking:
        raise TermselError(f"{name} of deap.tools requires {', '.join(lacking)}",
                           hint=f"For example --set {role}={name}:{lacking[0]}=0.5.")
    box.register(role, function, **keywords)


def _argument(text: str) -> tuple[str, Any]:
    key, _, value = text.partition("=")
    try:
        return key.strip(), ast.literal_eval(value.strip())
    except (SyntaxError, ValueError):
        raise TermselError(f"{text!r} is no argument of an operator",
                           hint="Write KEY=NUMBER, such as selTournament:tournsize=3.") from None


def _mated(one: Individual, other: Individual, genome: Genome) -> tuple[Individual, Individual]:
    """Cross two individuals in place, with the operators for their types of genes."""
    pair = np.array([one, other], dtype=genome.dtype)
    one[:], other[:] = crossover(pair, genome, 1.0, _rng()).tolist()
    return one, other


def _mutated(one: Individual, genome: Genome) -> tuple[Individual]:
    """Mutate an individual in place, with the operators for its types of genes."""
    genes: Genes = np.array([one], dtype=genome.dtype)
    one[:] = mutation(genes, genome, 1.0 / genome.size, _rng())[0].tolist()
    return (one,)


def _rng() -> np.random.Generator:
    """Return a generator that follows the state of Python's `random`, as DEAP's operators do."""
    return np.random.default_rng(random.getrandbits(128))
