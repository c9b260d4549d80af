"""One run from names to a result: ask, observe, choose or search, assess, record."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import convert

from termsel.auto.portfolio import Portfolio
from termsel.core.errors import TermselError
from termsel.core.files.names import CERTIFICATE
from termsel.core.threads import one_blas_thread
from termsel.data.control import Control
from termsel.data.datasets import DatasetSpec
from termsel.data.features import FeatureSet
from termsel.data.record.search import SearchLimits
from termsel.fitting.adjustment import kernels
from termsel.fitting.bayesian import held_out
from termsel.formats.rpc_files import with_rpc
from termsel.io.read import features_of
from termsel.io.result_folder import claimed, write_result
from termsel.io.spent import with_spent
from termsel.models.base import SensorModel
from termsel.models.rpc import Rpc
from termsel.plugins.registry import registry
from termsel.results.result import Result
from termsel.runs.auto.strategy import LEAST, choose_for, wanted
from termsel.runs.notebook import notebook_observer
from termsel.runs.task.blank_heights import to_leave_out
from termsel.runs.task.fit_crs import with_polar
from termsel.runs.task.given import all_candidates
from termsel.runs.task.request import Request, loaded
from termsel.runs.task.rpc_given import part_of_rpc, with_part
from termsel.runs.task.task import Task, observe, prepared, with_shares
from termsel.runs.task.verdict import judge_features
from termsel.selection.criteria import Criterion
from termsel.selection.problems.recipes import Recipe
from termsel.selection.solvers.base import Solver
from termsel.selection.solvers.heuristics.yardsticks import AllTerms
from termsel.selection.solvers.search import Observer

log = logging.getLogger(__name__)

FREED = 1 << 20
"""Numbers of an array that is freed at once, and never filled. The C library of Linux gives back
memory beyond twice what was freed in one piece, and asks the system for it at the next array."""

SEARCH_COMPILES, AUTO_COMPILES = 4, 2
"""Seconds that the first run of a search, and of the strategy auto, spends on compilation."""


@one_blas_thread
def run(
    problem: str | Recipe | Task | None = None,
    *,
    features: Any = None,
    crs: str | None = None,
    columns: str | Mapping[str, Any] | None = None,
    rpc: Rpc | Path | str | None = None,
    dataset: str | DatasetSpec | None = None,
    source: str | None = None,
    model: str | type[SensorModel] | SensorModel | None = None,
    solver: str | type[Solver] | Solver | None = None,
    criterion: str | type[Criterion] | Criterion | None = None,
    options: Mapping[str, Any] | None = None,
    strategy: str | None = None,
    seed: int = 1,
    generations: int | None = None,
    evaluations: int | None = None,
    seconds: float | None = None,
    patience: int | None = None,
    observers: Iterable[Observer] = (),
    out: Path | str | None = None,
    overwrite: bool = False,
) -> Result:
    """Search a problem and assess the selection.

    Parameters
    ----------
    problem : str, Recipe or Task, optional
        A recipe, its name, or what `prepare` made of it; by default that of `problem_for`.
    features : FeatureSet, path-like or table, optional
        Measured features; the name of a file, or a table such as a DataFrame, is read by
        `termsel.read`.
    crs, columns : optional
        As for `termsel.read`, where features are read.
    rpc : Rpc or path-like, optional
        The vendor's RPC of the image the features are of: the strategy "auto" corrects it, by one
        point or more.
    dataset, source, model, solver, criterion, options
        As for `prepare`; not for a task.
    strategy : {"auto", "as-asked"}, optional
        "auto" chooses the model itself, among plain and regularised ones, by what it predicts for
        points that took no part; "as-asked" runs the problem's solver. By default "auto" where
        the problem allows it and neither model, solver, criterion, budget nor any option but
        those of the data is given; for problems that select features only where none is named. A
        prepared task is always run as asked.
    seed : int
        Seed of the search.
    generations, evaluations : int, optional
        Budgets; see `termsel.search`.
    seconds : float, optional
        Budget of time.
    patience : int, optional
        End after so many generations without a gain above the option `tolerance`.
    observers : iterable of callable
        Called with `Progress` after each generation, or each candidate of the strategy "auto". In a
        notebook one more shows the progress.
    out : path, optional
        Folder for result.json, residuals.csv, summary.txt and the features.
    overwrite : bool
        Whether a result that is there may be replaced.

    Returns
    -------
    Result

    Raises
    ------
    TermselError
        As `prepare` and `termsel.search`; or if `out` cannot be written.

    Examples
    --------
    >>> import termsel
    >>> result = termsel.run("poly-terms", seed=1, generations=5)
    >>> round(result.rmse["independent"].total, 1) > 0
    True
    """
    np.empty(FREED)
    if features is not None:
        source = source or (str(features) if isinstance(features, str | Path) else None)
        features = features_of(features, crs, columns)
        features = features if rpc is None else with_rpc(features, rpc)
    elif crs is not None or columns is not None or rpc is not None:
        raise TermselError("crs, columns and rpc are for features that are given",
                           hint="Give features, such as the name of a file.")
    limits = {"generations": generations, "evaluations": evaluations, "seconds": seconds,
              "patience": patience}
    limited = any(limit is not None for limit in limits.values())
    task = problem if isinstance(problem, Task) else None
    request = Request(
        problem=None if isinstance(problem, Task) else problem, features=features,
        dataset=dataset, source=source, model=model, solver=solver, criterion=criterion,
        options=options)
    if problem is None:
        request = replace(request, problem=problem_for(features, dataset))
    shown = notebook_observer(task.recipe.name if task else str(problem or "auto"))
    observers = (*observers, *([] if shown is None else [shown]), *registry().observers())
    if task is None:
        if wanted(strategy, registry().taken("problems", request.problem),
                  [*request.method(), *["a budget"] * limited], unnamed=problem is None):
            return _chosen(request, seed, observers, out, overwrite)
        task = prepared(request.setup())
        if strategy is None and task.recipe.portfolio and problem is None:
            named = [*request.method(), *["a budget"] * limited]
            log.warning("Note: %s asks for a search by %s, which takes the place of the automatic "
                        "choice. Leave %s out to have the model chosen automatically.",
                        " and ".join(named), task.solver.name,
                        "it" if len(named) == 1 else "them")
        if task.features.rpc is not None and "rpc" not in task.model.options:
            log.warning("Warning: the model %s makes no use of the RPC. Leave model, solver and "
                        "criterion out to have it corrected.", task.model.name)
    elif request.named():
        raise TermselError(f"a prepared task takes no {', '.join(sorted(request.named()))}",
                           hint="Give them to termsel.prepare.")
    if not limited:
        limits |= {"generations": task.recipe.generations, "patience": task.recipe.patience}

    if task.solver.options.get("certificate") and out is None:
        raise TermselError("a certificate is a file of the folder of a result, and there is none",
                           hint="Add --out DIR, in Python out=.", name="certificate")

    def searched() -> Result:
        from termsel.runs.judgement.assess import assessed
        from termsel.runs.search.blunders_out import search_without_blunders  # not for auto

        verdict = judge_features(task.observations, Portfolio(), task.options["data"]["tested"])
        last, found = search_without_blunders(task, verdict, seed=seed, **limits,
                                              observers=observers)
        # As plain numbers, for the record.
        budget = convert({
            name: float(limit) if name == "seconds" else int(limit)
            for name, limit in limits.items() if limit is not None and math.isfinite(limit)},
            SearchLimits)
        return replace(assessed(last, found, verdict), budget=budget)

    return _written(searched, out, overwrite,
                    SEARCH_COMPILES if kernels.needs_compilation() else 0)


def problem_for(features: FeatureSet | None, dataset: str | DatasetSpec | None = None) -> str:
    """Return the problem that features, or else a data set, are for where none is named."""
    if features is None and dataset is not None:
        features = loaded(registry().taken("datasets", dataset))
    if features is None:
        raise TermselError("there is nothing to run",
                           hint="Give points or lines, or name a problem.")
    if len(features.lines):
        return "owdis-lines"
    plane = features.without_height() and not to_leave_out(features)
    return "poly-terms" if plane else "rfm-terms"


def _chosen(request: Request, seed: int, observers: Iterable[Observer], out: Path | str | None,
            overwrite: bool) -> Result:
    """Return the result of the strategy "auto", which builds no problem."""
    # It fits to check points as to control, and yet shows their figures; points go with lines.
    options = {"check_as": "judge", **(request.options or {})}
    if registry().taken("problems", request.problem).control == "lines":
        options["mixed"] = True
    setup = replace(request, criterion="press", solver=AllTerms, options=options).setup()
    if setup.recipe.search_first and setup.features.without_height():
        # The model of the search is not asked for, so that it asks for no heights.
        setup = replace(setup, model=registry().get("models", "poly2d")())
    setup = with_shares(setup, auto=True)
    least = _fewest(setup.features)
    observations = observe(setup, least)
    part = part_of_rpc(observations.together)
    if part is not None:
        setup = with_part(setup, part)
        observations = observe(setup, least)
    observations = with_polar(observations)
    # Whether a search of lines follows, which compiles more, is not known yet.
    compiles = held_out.needs_compilation(len(observations.together.points))
    return _written(lambda: choose_for(setup, observations, seed, observers), out, overwrite,
                    AUTO_COMPILES if compiles else 0)


def _fewest(features: FeatureSet) -> int:
    """Return the fewest features to choose by: one where something is known of the image."""
    if features.rpc is not None:
        return 1
    in_use = np.array([role not in ("independent", "off") for role in features.points.roles]
                      + [True] * len(features.lines.features), dtype=bool)
    if not 0 < in_use.sum() < LEAST:
        return LEAST
    return min(LEAST, all_candidates().least(Control.of(features.take(in_use))))


def _written(work: Callable[[], Result], out: Path | str | None, overwrite: bool, longer: int
             ) -> Result:
    """Do the work of a run, write its result where that is asked for, and tell the plugins.

    `longer` are the seconds that a run takes longer which compiles, if any.
    """
    with nullcontext() if out is None else claimed(Path(out), overwrite=overwrite):
        if longer:
            log.info("Compiling: the first run on this machine takes some %d s longer.", longer)
        result = work()
        if out is not None:
            result = with_spent(result, Path(out))
            write_result(result, Path(out))
            if CERTIFICATE not in result.files:  # that of the result it has replaced
                (Path(out) / CERTIFICATE).unlink(missing_ok=True)
    registry().notify_run_finished(result)
    return result
