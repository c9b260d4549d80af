"""One search in a paper's set-up, and how its figures are printed."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from termsel import FeatureSet, prepare
from termsel.runs.searching import fit_of
from termsel.runs.steps import search_in_steps


@dataclass(frozen=True)
class Trial:
    """What one search found.

    Parameters
    ----------
    control, check, independent : float
        RMSE of the selection [px]; infinite where nothing feasible was found.
    evaluations : int
    converged : int
        Generation of the last gain.
    seconds : float
        CPU time of the search.
    terms, features : tuple of str
        The selection.
    """

    control: float
    check: float
    independent: float
    evaluations: int
    converged: int
    seconds: float
    terms: tuple[str, ...]
    features: tuple[str, ...]


def trial(problem: str, seed: int, *, features: FeatureSet | None = None,
          dataset: str | None = None, solver: str | None = None, model: str | None = None,
          **options: Any) -> Trial:
    """Search once, with the paper's budget and without local refinement."""
    task = prepare(problem, features=features, dataset=dataset, solver=solver, model=model,
                   options={**options, "polish": False})
    start = time.process_time()
    found = search_in_steps(task, seed=seed, generations=task.recipe.generations,
                            patience=task.recipe.patience)
    seconds = time.process_time() - start
    selection = task.problem.decode(found.genes)
    if found.violation:
        rmse = [np.inf] * 3
    else:
        fitted = fit_of(task, selection)
        rmse = [one.total if one else np.nan for one in (
            fitted.control_rmse(), fitted.rmse(task.observations.check),
            fitted.rmse(task.observations.independent))]
    best = [np.inf if one.best is None else one.best for one in found.history]
    gains = np.flatnonzero(np.diff(best) < -1e-4 * np.abs(best[1:]))
    return Trial(*rmse, found.evaluations, int(gains[-1]) + 1 if len(gains) else 0, seconds,
                 selection.terms, selection.features)


def px(value: float, digits: int = 2) -> str:
    """Return a figure for a table; nothing for NaN."""
    if np.isnan(value):
        return ""
    return f"{value:.{digits}f}" if value < 100 else f"{value:.0f}"
