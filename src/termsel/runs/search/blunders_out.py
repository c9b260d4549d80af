"""Features that a selection uses and its own model contradicts: left out, and the search repeated.

OWDIS leaves out most blunders by its fitness. One that lies where it hardly moves the check points
may stay. That a search is repeated without what its result names is termsel's own. A fit without
them, of features selected with them, is worse.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from termsel.errors import counted
from termsel.fits.diagnosis import doubts
from termsel.measurements.features import BoolArray
from termsel.problems.segments import Bits, Subset
from termsel.problems.selection import SelectionProblem
from termsel.runs.judgement.assess import fit_of
from termsel.runs.search.recommend import recommended
from termsel.runs.search.steps import search_in_steps
from termsel.runs.task.task import Task
from termsel.solvers.search import Search

FEATURES = "features"


def search_without_blunders(task: Task, **how: Any) -> Search:
    """Search a task's problem, and again without the probable blunders that its result uses.

    The search is repeated until the selection uses no feature that its own model names as a
    probable blunder (see `termsel.fits.diagnosis.doubts`). Features that the user forces on stay.
    Each search has the whole budget of generations and evaluations; they share that of time. `how`
    are arguments of `termsel.search`.

    The last search is returned, its recommended member selected; evaluations, generations and
    seconds are those of all.
    """
    found = recommended(task, search_in_steps(task, **how))
    problem = task.problem
    if not isinstance(problem, SelectionProblem) \
            or task.options["problem"].get("blunders") != "leave-out":
        return found
    names = problem.inputs.control.ids  # a problem may select among some of the control
    where = problem.genome.label_slices()[FEATURES]
    forced = problem.genome.on[where]
    out = np.zeros(len(names), dtype=bool)
    while not (found.violation or found.interrupted):
        named = doubts(fit_of(task, problem.decode(found.genes)))
        if named is None or not _among(names, named.in_use)[~forced].any():
            break
        in_use = f"Probable blunders are in use: {', '.join(named.in_use)}. "
        if (seconds := how.get("seconds")) is not None and found.seconds >= seconds:
            return replace(found, notes=(*found.notes, in_use + "There was no time to search "
                                         "without them; raise --seconds."))
        more = out | (_among(names, named.wrong) & ~forced)
        again = _without(task, problem, more, where, **{
            **how, "seconds": None if seconds is None else seconds - found.seconds})
        if again is None or again.violation:
            return replace(found, notes=(*found.notes, in_use + "Without them no selection "
                                         "satisfies all conditions."))
        out = more
        found = again.after(found)
    if out.any():
        left = ", ".join(name for name, gone in zip(names, out, strict=True) if gone)
        found = replace(found, notes=(*found.notes, (
            f"The search was repeated without {counted(int(out.sum()), 'feature')} that its result "
            f"named as probable blunders: {left}. Each search had the whole budget, "
            f"{found.evaluations:,} evaluations in all. --set blunders=keep prevents this.")))
    return found


def _among(names: tuple[str, ...], wanted: Any) -> BoolArray:
    return np.array([name in wanted for name in names], dtype=bool)


def _without(task: Task, problem: SelectionProblem, out: BoolArray, where: slice,
             **how: Any) -> Search | None:
    """Return a search without some features; None if too few are left to select."""
    segment = problem.genome.segments[-1]
    assert isinstance(segment, Bits | Subset)  # the features
    if (~out & ~problem.genome.off[where]).sum() < segment.minimum:
        return None
    which = np.zeros(len(problem.genome.labels), dtype=bool)
    which[where] = out
    less = replace(task, problem=problem.frozen(np.zeros_like(which), which))
    return recommended(less, search_in_steps(less, **how))
