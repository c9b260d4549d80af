"""Terms and features selected one after the other."""

from __future__ import annotations

from typing import Any

import numpy as np

from termsel.core.errors import TermselError
from termsel.core.isolation.faults import PluginFault
from termsel.data.features import BoolArray
from termsel.runs.task import Task
from termsel.selection.problems.base import Problem
from termsel.selection.problems.selection import SelectionProblem
from termsel.selection.solvers.base import Solver
from termsel.selection.solvers.budget import EVALUATIONS, require_limits
from termsel.selection.solvers.refinement import POLISH_SHARE
from termsel.selection.solvers.search import SearchResult, begin, search


def search_in_steps(task: Task, **how: Any) -> SearchResult:
    """Return the search of a task's problem in the steps that its option "steps" says.

    `how` are arguments of `termsel.search`.

    "joint" searches terms and features together. "terms-first" selects terms with all features in
    use, then features under these terms; "features-first" selects features under all terms, then
    terms. The pages of Yavari et al. 2018 that could be consulted combine both and give no
    sequence. The second step may have a solver of its own. The first step has half of the budget,
    the second what is left, so that two steps cost no more than one search. The search is that of
    the last step; evaluations, generations and seconds are those of both. Refuses two steps with
    several objectives or a solver that cannot take the second, and if the first finds nothing
    feasible.
    """
    problem = task.problem
    options = task.options["search"]
    order = task.options["problem"].get("steps", "joint")
    if order == "joint" or not isinstance(problem, SelectionProblem):
        return search(problem, task.solver, **options, **how)
    # A front has no single end from which a second step could go on.
    if len(problem.objectives) > 1:
        raise TermselError(f"steps={order} is for one objective, and there are "
                           f"{len(problem.objectives)}: {', '.join(problem.objectives)}",
                           hint="Choose --set steps=joint, or a solver for one objective.")
    # Of the two groups of genes, the later one is held while the first is searched.
    is_feature = np.zeros(len(problem.genome.labels), dtype=bool)
    is_feature[problem.genome.label_slices()["features"]] = True
    later = is_feature if order == "terms-first" else ~is_feature
    everything: BoolArray = problem.genome.on | ~problem.genome.off
    beginning = problem.frozen(everything, later)
    if task.then is not None:
        _require_beginning(problem.frozen(everything, ~later), task.then)
    require_limits(**{name: how.get(name) for name in _LIMITS})
    # Half of the budget for the first step; the second has what the first left.
    budget = _total_budget(task, how)
    first = search(beginning, task.solver, **options, **{**how, **{
        name: value / 2 if name == "seconds" else max(value // 2, 1)
        for name, value in budget.items()}})
    step = order.split("-")[0]
    # What the first step could not satisfy, the second cannot either.
    if first.violation:
        raise TermselError(
            f"no selection of {step} with everything else in use satisfies all conditions",
            hint="Choose --set steps=joint or the other order, or lower the order or degree of "
                 "the model.")
    if first.stopped:
        return first
    solver = task.then or task.solver
    # The second step searches the other genes with those of the first held.
    first_genes = beginning.genome.chosen(first.genes[None])[0]
    second = search(problem.frozen(first_genes, ~later), solver, **options, **{**how, **{
        name: max(value - getattr(first, name), _MIN_STEP_SECONDS if name == "seconds" else 1)
        for name, value in budget.items()}})
    by = [f" by {name}" if task.then else "" for name in (task.solver.name, solver.name)]
    note = (f"In two steps: {step} first{by[0]}, {problem.objectives[0]} "
            f"{first.objectives[0]:.4g} with {int(first_genes[~later].sum())} of "
            f"{int((~later).sum())} and everything else in use; then the rest{by[1]}, "
            f"{second.objectives[0]:.4g}.")
    return second.after(first, note)


_LIMITS = ("generations", "evaluations", "seconds")
"""Of a budget that two steps share."""

_MIN_STEP_SECONDS = 1e-3
"""Seconds of a second step for which the first left no time: enough for one population."""


def _total_budget(task: Task, how: dict[str, Any]) -> dict[str, float]:
    """Return the budget of both steps together: that given, or else that of every search."""
    limits = {name: how[name] for name in _LIMITS if how.get(name) is not None}
    if limits or how.get("patience") is not None or task.solver.ends_by_itself:
        return limits
    return {"evaluations": EVALUATIONS * (
        1 + POLISH_SHARE if task.options["search"]["polish"] else 1)}


def _require_beginning(problem: Problem, solver: Solver) -> None:
    """Raise TermselError for a solver that refuses the second step, before the first has run."""
    try:
        begin(problem, solver)
    except PluginFault:
        raise
    except TermselError as error:
        raise TermselError(
            f"solver {solver.name!r} cannot do the second step: {error.what}",
            # The option of the command line, or the argument of a call.
            hint=error.hint and error.hint.replace("--solver", "--then").replace(
                "solver=", "then=")) from None
