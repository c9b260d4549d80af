"""Terms and features selected one after the other."""

from __future__ import annotations

from typing import Any

import numpy as np

from termsel.errors import TermselError
from termsel.measurements.features import BoolArray
from termsel.problems.selection import SelectionProblem
from termsel.runs.task import Task
from termsel.solvers.search import Search, search


def search_in_steps(task: Task, **how: Any) -> Search:
    """Search a task's problem as its option "steps" says.

    "joint" searches terms and features together. "terms-first" selects terms with all features
    in use, then features under these terms; "features-first" selects features under all terms,
    then terms. The pages of Yavari et al. 2018 that could be consulted combine both and give no
    sequence. The second step may have a solver of its own. Each step has the whole budget.

    Parameters
    ----------
    task : Task
    **how
        Arguments of `termsel.search`.

    Returns
    -------
    Search
        Of the last step; evaluations, generations and seconds are those of both.

    Raises
    ------
    TermselError
        For two steps with several objectives, or if the first step finds nothing feasible.
    """
    problem = task.problem
    order = task.options["problem"].get("steps", "joint")
    if order == "joint" or not isinstance(problem, SelectionProblem):
        return search(problem, task.solver, **task.options["search"], **how)
    if len(problem.objectives) > 1:
        raise TermselError(f"steps={order} is for one objective, and there are "
                           f"{len(problem.objectives)}: {', '.join(problem.objectives)}",
                           hint="Choose --set steps=joint, or a solver for one objective.")
    is_feature = np.zeros(len(problem.genome.labels), dtype=bool)
    is_feature[problem.genome.label_slices()["features"]] = True
    later = is_feature if order == "terms-first" else ~is_feature
    everything: BoolArray = problem.genome.on | ~problem.genome.off
    beginning = problem.frozen(everything, later)
    first = search(beginning, task.solver, **task.options["search"], **how)
    word = order.split("-")[0]
    if first.violation:
        raise TermselError(
            f"no selection of {word} with everything else in use satisfies all conditions",
            hint="Choose --set steps=joint or the other order, or lower the order or degree of "
                 "the model.")
    if first.interrupted:
        return first
    solver = task.then or task.solver
    chosen = beginning.genome.chosen(first.genes[None])[0]
    second = search(problem.frozen(chosen, ~later), solver, **task.options["search"], **how)
    by = [f" by {each.name}" if task.then else "" for each in (task.solver, solver)]
    note = (f"In two steps: {word} first{by[0]}, {problem.objectives[0]} "
            f"{first.objectives[0]:.4g} with {int(chosen[~later].sum())} of "
            f"{int((~later).sum())} and everything else in use; then the rest{by[1]}, "
            f"{second.objectives[0]:.4g}.")
    return second.after(first, note)
