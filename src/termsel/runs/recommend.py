"""Which member of a front is the selection."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from termsel.runs.task import Task
from termsel.selection.criteria import Ebic
from termsel.selection.problems.selection import SelectionProblem
from termsel.selection.solvers.proofs.exact import gap_of
from termsel.selection.solvers.search import SearchResult


def with_recommended_member(task: Task, search: SearchResult) -> SearchResult:
    """Return the search with the recommended member of its front as its selection.

    The rule is the problem's option "recommend": best, one-standard-error, knee or ebic. With a
    single objective the number of genes is the second one. A search without a front keeps its
    selection; with a single objective a note says that the rule could not be followed.
    """
    rule = task.options["problem"].get("recommend", "best")
    has_one_objective = len(task.problem.objectives) < 2
    if has_one_objective and rule == "best":
        return search
    if not search.front:
        note = f"This search has no front from which to recommend by the rule {rule}."
        return replace(search, notes=(*search.notes, note)) if has_one_objective else search
    genes = np.array(search.front)
    evaluation = task.problem.evaluate(genes)
    # The criterion, and the second objective or else the number of genes in use.
    first = evaluation.objectives[:, 0]
    second = (task.problem.genome.chosen(genes).sum(axis=1).astype(float) if has_one_objective
              else evaluation.objectives[:, 1])
    index = int(np.argmin(first))
    if rule == "one-standard-error":
        # That of an RMSE of normal errors, RMSE / sqrt(2 f), f = 2 n for n points or lines.
        judges = (task.observations.check if task.criterion.needs_check
                  else task.observations.control)
        bound = first[index] * (1 + 1 / np.sqrt(4 * len(judges)))
        within_bound = np.flatnonzero(first <= bound)
        index = int(within_bound[np.lexsort((first[within_bound], second[within_bound]))[0]])
    elif rule == "knee" and np.ptp(first) > 0 and np.ptp(second) > 0:
        # Farthest below the straight line between the front's ends, both objectives scaled to
        # [0, 1]; the criterion in logarithms, as it spans orders of magnitude.
        height = np.log(first) if first.min() > 0 else first
        below = (height - height.min()) / np.ptp(height) + (second - second.min()) / np.ptp(second)
        index = int(np.argmin(below))
    elif rule == "ebic" and isinstance(task.problem, SelectionProblem):
        # Where no member has one, the best criterion.
        by_ebic = task.problem.judged_by(Ebic()).evaluate(genes)
        index = int(np.lexsort((first, by_ebic.objectives[:, 0], by_ebic.violation))[0])
    return replace(search, genes=search.front[index], objectives=evaluation.objectives[index],
                   violation=float(evaluation.violation[index]),
                   certificate=_proof_of_member(search.certificate, first[index], first.min()))


def _proof_of_member(certificate: Mapping[str, Any] | None, value: float,
                     optimum: float) -> Mapping[str, Any] | None:
    """Return the certificate of a member, given that of the front's best; None without that."""
    if certificate is None or not certificate["optimal"] or value == optimum:
        return certificate
    return {**certificate, "optimal": False, **gap_of(value, optimum)}
