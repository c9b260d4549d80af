"""A search among candidates, without the comparisons of a whole run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import termsel
from termsel import FeatureSet


def features_by_search(problem: str, features: FeatureSet, model: str, options: Mapping[str, Any],
                       *, seed: int, criterion: str | None = None) -> tuple[str, ...]:
    """Return the ids of the control features that a search selects.

    It is the search of `termsel run` with the same arguments, without the fit, its assessment and
    the comparisons with other solvers that follow there.
    """
    # Prepared as for `termsel run`, so that options and defaults are the same.
    task = termsel.prepare(problem, features=features, model=model, criterion=criterion,
                           options=dict(options))
    best = termsel.search(task.problem, task.solver, seed=seed,
                          generations=task.recipe.generations, patience=task.recipe.patience,
                          **task.options["search"])
    return task.problem.decode(best.genes).features
