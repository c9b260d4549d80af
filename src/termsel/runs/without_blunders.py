"""A search without the features that the outlier test names.

A wrong control feature spoils the fits, and a wrong check point what every selection is judged by.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from termsel.auto.auto import Auto
from termsel.core.errors import TermselError
from termsel.data.features import select
from termsel.data.roles import leave_out
from termsel.runs.recommend import with_recommended_member
from termsel.runs.steps import search_in_steps
from termsel.runs.task import MIN_CONTROL, Task, require_enough, with_problem_built
from termsel.runs.verdict import Verdict, judge_features
from termsel.selection.problems.segments import Bits, Subset
from termsel.selection.problems.selection import SelectionProblem
from termsel.selection.solvers.search import SearchResult

FEATURES = "features"


def search_without_blunders(task: Task, auto: Auto, verdict: Verdict | None = None,
                            **how: Any) -> tuple[Task, SearchResult]:
    """Return the task that was searched, and its search with the recommended member selected.

    Where the task's option "blunders" says so, blunders can neither be selected, unless the user
    forces them on, nor judge. Where no selection without them satisfies all conditions, the search
    is made with them, unless it was stopped or has a limit of time. A note of the search says which
    it was. `verdict` is that of `judge_features`, which is asked if it is None; `how` are arguments
    of `termsel.search`.
    """
    remaining: Task | None = task
    if task.options["problem"].get("blunders") == "leave-out":
        verdict = verdict or judge_features(
            task.observations, auto, task.options["data"]["tested"])
        remaining = _task_without_blunders(task, verdict.blunders)
    if remaining is not None:
        searched = with_recommended_member(remaining, search_in_steps(remaining, **how))
        if remaining is task:
            return task, searched
        # A second search would have no time.
        if not searched.violation or searched.stopped or how.get("seconds") is not None:
            return remaining, replace(searched, notes=(*searched.notes, (
                "Outliers were removed before the search; --set blunders=keep keeps them.")))
    searched = with_recommended_member(task, search_in_steps(task, **how))
    return task, replace(searched, notes=(*searched.notes, (
        "Blunders are in use: without them no selection satisfies all conditions.")))


def _task_without_blunders(task: Task, blunders: frozenset[str]) -> Task | None:
    """Return the task without blunders; None if too few features are left.

    Points are left out of the observations. Lines stay in them, and can no longer be selected.
    Features that the user has forced on or off stay as they are. A task whose problem is no
    SelectionProblem is returned as it is.
    """
    problem = task.problem
    observations = task.observations
    if not isinstance(problem, SelectionProblem):
        return task
    # A problem may select among some of the control.
    names = problem.inputs.control.ids
    of_features = problem.genome.label_slices()[FEATURES]
    forced = select(names, problem.genome.on[of_features] | problem.genome.off[of_features])
    # Features that the user forces on or off stay as they are.
    left_out = blunders.difference(forced)
    points = left_out.intersection(observations.together.points.ids)
    # Points leave the observations, so that they neither serve as control nor judge.
    if points:
        fewer = leave_out(observations, points)
        try:
            require_enough(fewer, task.criterion, task.model, MIN_CONTROL)
            task = with_problem_built(Task(task.request, fewer))
        except TermselError:
            return None
        problem = task.problem
        assert isinstance(problem, SelectionProblem)
        names = problem.inputs.control.ids
        of_features = problem.genome.label_slices()[FEATURES]
    is_out = np.isin(names, list(left_out - points))
    # Lines stay on offer, their genes held off: each has its place in the chromosome.
    if not is_out.any():
        return task
    segment = problem.genome.segments[-1]
    assert isinstance(segment, Bits | Subset)  # the features
    if (~is_out & ~problem.genome.off[of_features]).sum() < segment.minimum:
        return None
    forbidden = np.zeros(len(problem.genome.labels), dtype=bool)
    forbidden[of_features] = is_out
    return replace(task, narrowed=problem.frozen(np.zeros_like(forbidden), forbidden))
