"""What every problem must do."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from termsel.runs.task import prepare
from termsel.selection.problems.base import Evaluation, Problem, Selection, evaluation_fault
from termsel.selection.problems.recipes import Recipe
from termsel.selection.solvers.heuristics.swap import neighbour_batches
from termsel.selection.solvers.heuristics.yardsticks import RandomSearch
from termsel.selection.solvers.search import search
from termsel.testing.cases import Case, Suite, check_declaration, require, through_pickle

Make = Callable[[], Problem]

BATCH_SIZE = 12
"""Individuals that are evaluated together."""


def declaration(problem: Problem) -> None:
    """It is a Problem with a genome and names of objectives."""
    require(isinstance(problem, Problem), f"it must be a Problem, not {type(problem).__name__}")
    names = problem.objectives
    require(isinstance(names, tuple) and names and all(isinstance(name, str) for name in names)
            and len(set(names)) == len(names),
            f"objectives must be a tuple of different names, not {names!r}")
    require(problem.genome.size > 0, "its genome has no genes")


def evaluation_holds(problem: Problem) -> None:
    """It evaluates one individual and many: finite objectives, and violations of at least 0."""
    genes = _valid_individuals(problem)
    # An evaluation of one individual is what the final check of a search asks for.
    for individuals in (genes, genes[:1]):
        evaluation = problem.evaluate(individuals)
        fault = evaluation_fault(problem, evaluation, individuals)
        require(fault is None, f"evaluate() {fault}")
        require((evaluation.violation >= 0).all(), "violations must be 0 or above")


def deterministic(problem: Problem) -> None:
    """The same genes get the same evaluation, here and in another process."""
    genes = _valid_individuals(problem)
    first = problem.evaluate(genes)
    for repeated in (problem.evaluate(genes), through_pickle(problem).evaluate(genes)):
        _require_equal(first, repeated, "evaluate() of the same genes differs from one call or "
                       "process to the next")


def one_by_one(problem: Problem) -> None:
    """An individual's evaluation does not depend on those evaluated with it."""
    genes = _valid_individuals(problem)
    # Searches keep figures of earlier generations and compare them with new ones.
    joint = problem.evaluate(genes)
    singles = [problem.evaluate(genes[i:i + 1]) for i in range(len(genes))]
    _require_equal(joint, Evaluation(
        np.concatenate([evaluation.objectives for evaluation in singles]),
        np.concatenate([evaluation.violation for evaluation in singles])),
        "an individual is evaluated otherwise alone than among others; a search keeps figures and "
        "compares them later")


def neighbours_alike(problem: Problem) -> None:
    """Neighbours of an individual have their own evaluation, but for rounding."""
    for start in _valid_individuals(problem)[:3]:
        # The first batch stands for all: each neighbour differs from the start by one step.
        neighbours = next(iter(neighbour_batches(start, problem.genome)), None)
        if neighbours is not None:
            _require_equal(problem.evaluate(neighbours), problem.evaluate_near(neighbours, start),
                           "evaluate_near() differs from evaluate()", 1e-6)


def inputs_unchanged(problem: Problem) -> None:
    """It does not change the genes it is given."""
    genes = _valid_individuals(problem)
    before = genes.copy()
    problem.evaluate(genes)
    problem.decode(genes[0])
    require(np.array_equal(genes, before), "evaluate() or decode() changes the genes; work on a "
                                           "copy")


def decodes(problem: Problem) -> None:
    """It shows what each individual selects, the same each time."""
    for individual in _valid_individuals(problem):
        selection = problem.decode(individual)
        require(isinstance(selection, Selection),
                f"decode() must return a Selection, not {type(selection).__name__}")
        for kind, names in (("terms", selection.terms), ("features", selection.features)):
            require(isinstance(names, tuple) and all(isinstance(name, str) for name in names),
                    f"decode() must give {kind} as a tuple of names, not {names!r:.200}")
            require(len(set(names)) == len(names), f"decode() names one of the {kind} twice")
        require(problem.decode(individual.copy()) == selection,
                "decode() of the same genes differs")


def searched(problem: Problem) -> None:
    """A random search of 300 evaluations finds something feasible, which can be decoded."""
    if len(problem.objectives) > RandomSearch.max_objectives:
        return
    # A cleverer solver could hide that genome.random or genome.repair miss a condition.
    best = search(problem, RandomSearch(), evaluations=300)
    require(best.violation == 0, "no individual of 300 random ones is feasible; let genome.random "
            "and genome.repair know the conditions")
    problem.decode(best.genes)


def cases(problem: Recipe | Problem | Make) -> list[Case]:
    """Return the problem of a recipe with its own data set, a problem, or what makes one."""
    if isinstance(problem, Recipe):
        return [Case(problem.name, partial(_problem_of_recipe, problem))]
    if isinstance(problem, Problem):
        return [Case(type(problem).__name__, lambda: problem)]
    return [Case(getattr(problem, "__name__", "problem"), problem)]


SUITE = Suite((declaration, evaluation_holds, deterministic, one_by_one, neighbours_alike,
               inputs_unchanged, decodes, searched), cases)


def _problem_of_recipe(recipe: Recipe) -> Problem:
    """Return the problem of a recipe with its own data."""
    check_declaration("problems", recipe)
    return prepare(recipe).problem


def _valid_individuals(problem: Problem) -> np.ndarray:
    """Return individuals that keep the conditions of the genome."""
    return problem.genome.random(np.random.default_rng(1), BATCH_SIZE)


def _require_equal(first: Evaluation, second: Evaluation, message: str, near: float = 1e-9) -> None:
    """Raise AssertionError unless two evaluations are equal but for rounding."""
    # Relatively, as costs may be of any size; rounding alone may differ.
    require(np.allclose(first.objectives, second.objectives, rtol=near, atol=1e-12)
            and np.allclose(first.violation, second.violation, rtol=near, atol=1e-12), message)
