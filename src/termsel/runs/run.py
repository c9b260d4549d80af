"""One run from names to a result: ask, observe, choose or search, assess, record."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from termsel.adjustment import kernels
from termsel.adjustment.bayesian import held_out
from termsel.auto.auto import Auto
from termsel.auto.memory import Memory
from termsel.core.errors import TermselError
from termsel.core.files.names import CERTIFICATE
from termsel.core.threads import one_blas_thread
from termsel.data.datasets import DatasetSpec
from termsel.data.features import FeatureSet
from termsel.data.fit_data import FitData
from termsel.fitting.method import Method
from termsel.formats.rpc_files import with_rpc
from termsel.io.read import features_of
from termsel.io.result_folder import claimed, write_result
from termsel.io.spent import with_spent
from termsel.models.base import SensorModel
from termsel.models.rpc import Rpc
from termsel.plugins.registry import registry
from termsel.results.result import Result
from termsel.runs.blank_heights import to_leave_out
from termsel.runs.choosing import LEAST, choose_for, wanted
from termsel.runs.finding import result_of
from termsel.runs.fit_crs import with_polar
from termsel.runs.given import auto_of
from termsel.runs.notebook import notebook_observer
from termsel.runs.request import loaded, method_words, request_of
from termsel.runs.rpc_given import part_of_rpc, with_part
from termsel.runs.task import Task, observe, prepared, with_shares
from termsel.selection.criteria import Criterion
from termsel.selection.problems.recipes import Recipe
from termsel.selection.solvers.base import Solver
from termsel.selection.solvers.heuristics.yardsticks import AllTerms
from termsel.selection.solvers.search import Observer

log = logging.getLogger(__name__)

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
    method: str | Method | None = None,
    seed: int = 1,
    generations: int | None = None,
    evaluations: int | None = None,
    seconds: float | None = None,
    patience: int | None = None,
    observers: Iterable[Observer] = (),
    out: Path | str | None = None,
    overwrite: bool = False,
    memory: Memory | None = None,
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
    method : str or Method, optional
        A method that needs no search, in place of "auto", which chooses among them: its name, such
        as "shrunken-cubic", or a `Method` of your own.
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
    memory : Memory, optional
        What runs on the same features found: pass the same object to each of them.

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
    if features is not None:
        source = source or (str(features) if isinstance(features, str | Path) else None)
        features = features_of(features, crs, columns)
        features = features if rpc is None else with_rpc(features, rpc)
    elif crs is not None or columns is not None or rpc is not None:
        raise TermselError("crs, columns and rpc are for features that are given",
                           hint="Give features, such as the name of a file.")
    asked: dict[str, Any] = {"dataset": dataset, "source": source, "model": model, "solver": solver,
             "criterion": criterion, "options": options}
    limits = {"generations": generations, "evaluations": evaluations, "seconds": seconds,
              "patience": patience}
    is_limited = any(limit is not None for limit in limits.values())
    shown = notebook_observer(
        problem.recipe.name if isinstance(problem, Task) else str(problem or "auto"))
    observers = (*observers, *([] if shown is None else [shown]), *registry().observers())
    if isinstance(problem, Task):
        _refuse_named({"features": features, **asked})
        task = problem
    else:
        named = problem_for(features, dataset) if problem is None else problem
        words = [*method_words(model, solver, criterion, options), *["a budget"] * is_limited]
        if method is not None and strategy is not None:
            words.append("a strategy")
        recipe = registry().taken("problems", named)
        if method is not None or wanted(strategy, recipe, words, unnamed=problem is None):
            return _chosen(method, named, features, asked, words, seed, observers, out, overwrite,
                           memory)
        task = prepared(request_of(named, features=features, **asked))
        if strategy is None and task.recipe.portfolio and problem is None:
            log.warning("Note: %s asks for a search by %s, which takes the place of the automatic "
                        "choice. Leave %s out to have the model chosen automatically.",
                        " and ".join(words), task.solver.name,
                        "it" if len(words) == 1 else "them")
        if task.features.rpc is not None and "rpc" not in task.model.options:
            log.warning("Warning: the model %s makes no use of the RPC. Leave model, solver and "
                        "criterion out to have it corrected.", task.model.name)
    if not is_limited:
        limits |= {"generations": task.recipe.generations, "patience": task.recipe.patience}
    if task.solver.options.get("certificate") and out is None:
        raise TermselError("a certificate is a file of the folder of a result, and there is none",
                           hint="Add --out DIR, in Python out=.", name="certificate")

    def search() -> Result:
        from termsel.runs.assess import assess  # not for auto
        from termsel.runs.searching import Search

        searching = Search(limits={**limits, "seed": seed, "observers": observers})
        return assess(searching, task, memory=memory)

    return _written(search, out, overwrite, SEARCH_COMPILES if kernels.needs_compilation() else 0)


def _refuse_named(asked: Mapping[str, Any]) -> None:
    """Refuse what is asked for next to a task that has been prepared."""
    named = sorted(word for word, value in asked.items() if value is not None)
    if named:
        raise TermselError(f"a prepared task takes no {', '.join(named)}",
                           hint="Give them to termsel.prepare.")


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


def _chosen(method: str | Method | None, problem: str | Recipe, features: FeatureSet | None,
            asked: Mapping[str, Any], words: Sequence[str], seed: int,
            observers: Iterable[Observer], out: Path | str | None, overwrite: bool,
            memory: Memory | None) -> Result:
    """Return the result of a method that needs no problem: by default of "auto"."""
    if method is not None and words:
        raise TermselError(f"a method is asked for, and {words[0]}", hint="Leave one of them out.")
    auto = auto_of(method, memory)
    # It fits to check points as to control, and yet shows their figures; points go with lines.
    options = {"check_as": "judge", **(asked["options"] or {})}
    if registry().taken("problems", problem).control == "lines":
        options["mixed"] = True
    request = request_of(problem, features=features, **{
        **asked, "criterion": "press", "solver": AllTerms, "options": options})
    if request.recipe.search_first and request.features.without_height():
        # The model of the search is not asked for, so that it asks for no heights.
        request = replace(request, model=registry().get("models", "poly2d")())
    request = with_shares(request, auto=True)
    least = _fewest(request.features, auto)
    observations = observe(request, least)
    part = part_of_rpc(observations.together)
    if part is not None:
        request = with_part(request, part)
        observations = observe(request, least)
    observations = with_polar(observations)
    # Whether a search of lines follows, which compiles more, is not known yet.
    compiles = held_out.needs_compilation(len(observations.together.points))
    return _written(lambda: result_of(request, choose_for(
        request, observations, auto, seed, observers)), out, overwrite,
        AUTO_COMPILES if compiles else 0)


def _fewest(features: FeatureSet, auto: Auto) -> int:
    """Return the fewest features to choose by: one where something is known of the image."""
    if features.rpc is not None:
        return 1
    in_use = np.array([role not in ("independent", "off") for role in features.points.roles]
                      + [True] * len(features.lines.features), dtype=bool)
    if not 0 < in_use.sum() < LEAST:
        return LEAST
    return min(LEAST, auto.fewest(FitData.of(features.take(in_use))))


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
