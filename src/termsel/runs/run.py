"""One run from names to a result: ask, observe, choose or search, assess, record."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from termsel.adjustment import kernels
from termsel.adjustment.bayesian import held_out
from termsel.auto.auto import Auto
from termsel.auto.memory import Memory
from termsel.core.arguments import explains_arguments
from termsel.core.errors import TermselError
from termsel.core.files.names import CERTIFICATE
from termsel.core.options import whole_seed
from termsel.core.remedies import Remedy
from termsel.core.threads import one_blas_thread
from termsel.data.coordinates.crs import CrsLike
from termsel.data.datasets import DatasetSpec
from termsel.data.features import FeatureSet
from termsel.data.roles import asked_roles
from termsel.data.rpc import Rpc
from termsel.fitting.method import Method
from termsel.io.result_folder import lock_output_folder, write_result
from termsel.io.spent import with_spent
from termsel.models.base import SensorModel
from termsel.plugins.registry import registry
from termsel.results.result import Result
from termsel.runs.arguments import argument_meant, files_by_name
from termsel.runs.choosing import choose_for, uses_auto
from termsel.runs.finding import result_of
from termsel.runs.notebook import notebook_observer
from termsel.runs.request import (
    auto_of,
    is_model_alone,
    method_of_model,
    method_words,
    problem_for,
    request_of,
)
from termsel.runs.task import (
    Task,
    find_features,
    request_of_method,
    require_alone,
    task_of,
    task_of_method,
)
from termsel.runs.task_method import TaskMethod
from termsel.selection.criteria import Criterion
from termsel.selection.problems.recipes import Recipe
from termsel.selection.solvers.base import Solver
from termsel.selection.solvers.budget import require_limits
from termsel.selection.solvers.checkpoint import Checkpoint, digest_of_data, require_resumable
from termsel.selection.solvers.observers import Observer

log = logging.getLogger(__name__)

SEARCH_COMPILES, AUTO_COMPILES = 4, 5
"""Seconds that the first run of a search, and of the strategy auto, spends on compilation."""


@explains_arguments(argument_meant, files_by_name,
                    ("problem", "seed", "generations", "evaluations", "seconds", "patience"))
@one_blas_thread
def run(
    problem: str | Recipe | Task | None = None,
    *,
    features: Any = None,
    crs: CrsLike | None = None,
    columns: str | Mapping[str, Any] | None = None,
    rpc: Rpc | Path | str | None = None,
    dataset: str | DatasetSpec | None = None,
    source: str | None = None,
    model: str | type[SensorModel] | SensorModel | None = None,
    solver: str | type[Solver] | Solver | None = None,
    criterion: str | type[Criterion] | Criterion | None = None,
    options: Mapping[str, Any] | None = None,
    strategy: str | None = None,
    method: str | Method | Callable[[FeatureSet], Any] | None = None,
    seed: int = 1,
    generations: int | None = None,
    evaluations: int | None = None,
    seconds: float | None = None,
    patience: int | None = None,
    observers: Iterable[Observer] = (),
    out: Path | str | None = None,
    overwrite: bool = False,
    memory: Memory | None = None,
    checkpoint: Path | str | None = None,
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
        model alone, without a problem, is fitted with all its terms to all control. A prepared task
        is always run as asked.
    method : str, Method or callable, optional
        A method in place of "auto", which chooses among them: its name, such as
        "regularised-cubic"; a `Method`, such as `Search` with a problem of its own; or a function,
        as for `FunctionMethod`.
    seed : int
        Seed of the search.
    generations, evaluations : int, optional
        Budgets; see `termsel.search`.
    seconds : float, optional
        Budget of time.
    patience : int, optional
        End after so many generations without a gain above the option `tolerance`.
    observers : iterable of callable
        Called with `Progress` after each generation, or each candidate of the strategy "auto". One
        that returns True, or raises StopIteration, ends a search, whose result is kept. In a
        notebook one more shows the progress.
    out : path, optional
        Folder for result.json, residuals.csv, summary.txt and the features.
    overwrite : bool
        Whether a result that is there may be replaced.
    memory : Memory, optional
        What runs on the same features found: pass the same object to each of them.
    checkpoint : path-like, optional
        File from which a stopped search goes on, in another process too; see `termsel.search`.

    Returns
    -------
    Result
        What was found and how accurate it is; it is what result.json holds.

    Raises
    ------
    TermselError
        As `prepare` and `termsel.search`; or if `out` cannot be written.

    Examples
    --------
    >>> import termsel
    >>> result = termsel.run("poly-terms", seed=1, generations=5)
    >>> round(result.rmse["independent"].total, 1)  # px
    3.1
    """
    if problem is not None:
        _refuse_features_as_problem(problem)
    # What is wrong with an argument is said before the data are read, and before hours of work.
    seed = whole_seed(seed)
    limits = {"generations": generations, "evaluations": evaluations, "seconds": seconds,
              "patience": patience}
    require_limits(**limits)
    features, source = find_features(features, source, crs, columns, rpc)
    arguments: dict[str, Any] = {
        "features": features, "dataset": dataset, "source": source, "model": model,
        "solver": solver, "criterion": criterion, "options": options}
    # A limit asks for a search, as a solver does: the choice among methods has none.
    is_limited = any(limit is not None for limit in limits.values())
    notebook = notebook_observer(
        problem.recipe.name if isinstance(problem, Task) else str(problem or "auto"))
    # Those of the user come first, then the notebook, then those of plugins.
    observers = (*observers, *filter(None, [notebook]), *registry().observers())
    beside = ["a budget"] if is_limited else []
    if checkpoint is not None:
        beside.append("a checkpoint")
    task, sole_method = _task_and_method(problem, arguments, strategy=strategy, method=method,
                                         memory=memory, beside=beside)
    # The limits of a problem are those of its paper, where the user gives none.
    if not is_limited:
        limits |= {"generations": task.recipe.generations, "patience": task.recipe.patience}
    # Said before the search, which may take hours.
    if task.solver.options.get("certificate") and out is None:
        raise TermselError("a certificate is a file of the folder of a result, and there is none",
                           hint=f"Add {Remedy('out', 'DIR')}.", name="certificate")
    if checkpoint is not None:
        require_resumable(task.solver)

    def result_of_run() -> Result:
        """Return the result of the method, or of the search."""
        if sole_method is not None:
            return assess(sole_method, task, seed=seed, observers=observers, memory=memory)
        from termsel.runs.searching import Search  # not for auto

        saved_search = None
        if checkpoint is not None:
            observations = task.observations
            saved_search = Checkpoint(checkpoint, digest_of_data(
                observations.control, observations.check))
        searching = Search(limits={**limits, "seed": seed, "observers": observers,
                                   "checkpoint": saved_search})
        return assess(searching, task, memory=memory)

    return _run_and_write(result_of_run, out, overwrite, _seconds_of_compilation(task, sole_method))


def _task_and_method(
        problem: str | Recipe | Task | None, arguments: dict[str, Any], *, strategy: str | None,
        method: str | Method | Callable[[FeatureSet], Any] | None, memory: Memory | None,
        beside: list[str]) -> tuple[Task, Auto | TaskMethod | None]:
    """Return the task of a run, and the method that is fitted to it; None where it is searched.

    A prepared task is searched as it is. Without one the method is the one asked for, else the
    automatic choice where nothing asks for a search, else the fit of a model that is named alone.

    Parameters
    ----------
    problem, strategy, method, memory
        As for `run`.
    arguments : dict
        Those of `request_of`, by name.
    beside : list of str
        What else asks for a search, in words, such as "a budget".

    Raises
    ------
    TermselError
        As `prepare`; for arguments beside a prepared task, and parts of a search beside a method.
    """
    if isinstance(problem, Task):
        _refuse_next_to_task(arguments)
        return problem, None
    features, model, options = (arguments[name] for name in ("features", "model", "options"))
    recipe_or_name = problem_for(features, arguments["dataset"]) if problem is None else problem
    # What asks for a search, in words: the automatic choice would decide it itself.
    words = [*method_words(model, arguments["solver"], arguments["criterion"], options), *beside]
    of_data = {name: arguments[name] for name in ("features", "dataset", "source", "options")}
    recipe = registry().resolve("problems", recipe_or_name)
    sole_method: Auto | TaskMethod | None = None
    if method is not None or uses_auto(strategy, recipe, words, unnamed=problem is None):
        if method is not None:
            require_alone(words if strategy is None else [*words, "a strategy"])
        # A search judges by selection points; any other method takes them as control.
        if isinstance(method, TaskMethod):
            sole_method = method
            task = task_of(request_of(recipe_or_name, **of_data))
        else:
            # The choice among all methods, or among one.
            sole_method = auto_of(method, memory)
            task = task_of_method(request_of_method(recipe_or_name, **of_data), sole_method)
    elif (problem is None and strategy is None and recipe.for_methods
          and is_model_alone(words, model, options)):
        request = request_of_method(recipe_or_name, **of_data, model=model)
        sole_method = auto_of(method_of_model(request), memory)
        task = task_of_method(request, sole_method)
    else:
        task = task_of(request_of(recipe_or_name, **arguments))
        _warn_of_search(task, words, is_in_place_of_auto=strategy is None and problem is None)
    if task.request.options["data"]["role"]:
        _warn_of_check_alone(task)
    return task, sole_method


def _refuse_features_as_problem(problem: object) -> None:
    """Raise TermselError for features, or the name of their file, in place of the problem."""
    if isinstance(problem, str | Path):
        # A problem is one whatever files lie about; other names with an ending are those of files.
        is_problem = (isinstance(problem, str)
                      and registry().known("problems", problem) is not None)
        if not is_problem and (Path(problem).suffix or Path(problem).is_file()
                               or isinstance(problem, Path)):
            raise TermselError(f"{str(problem)!r} is a file, and the first argument is a problem",
                               hint=f"termsel.run(features={str(problem)!r}) fits it.")
    elif (isinstance(problem, FeatureSet | list | dict)
          or hasattr(problem, "columns") or hasattr(problem, "shape")):
        raise TermselError("the first argument is a problem, not features",
                           hint="termsel.run(features=...) fits them.")


def _warn_of_search(task: Task, words: Sequence[str], *, is_in_place_of_auto: bool) -> None:
    """Say where a search takes the place of the automatic choice, and where an RPC is not used."""
    if is_in_place_of_auto and task.recipe.for_methods:
        asks, them = ("asks", "it") if len(words) == 1 else ("ask", "them")
        or_fit = "; a model alone is fitted with all its terms" if "model" in words else ""
        log.warning("Note: %s %s for a search by %s, which takes the place of the automatic "
                    "choice. Leave %s out to have the model chosen automatically%s.",
                    " and ".join(words), asks, task.solver.name, them, or_fit)
    if task.features.rpc is not None and "rpc" not in task.model.options:
        log.warning("Warning: the model %s makes no use of the RPC. Leave model, solver and "
                    "criterion out to have it corrected.", task.model.name)


def _warn_of_check_alone(task: Task) -> None:
    """Say what check means where it is the only role asked for and nothing tests the result."""
    # Surveyors say check point and mean one that tests the result.
    asked = asked_roles(None, task.request.options["data"]["role"])
    if set(asked.values()) == {"check"} and not len(task.observations.independent):
        log.warning("Note: --role ID=check makes a selection point, which takes part in the "
                    "choice. For a point that tests the result write --role %s=independent.",
                    next(iter(asked)))


def _seconds_of_compilation(task: Task, sole_method: Method | None) -> int:
    """Return how many seconds longer a run takes as it compiles; 0 if nothing is compiled."""
    if not isinstance(sole_method, Auto):
        return SEARCH_COMPILES if kernels.needs_compilation() else 0
    # Whether a search of lines follows, which compiles more, is not known yet.
    points = len(task.observations.together.points)
    return AUTO_COMPILES if held_out.needs_compilation(points) else 0


def _refuse_next_to_task(arguments: Mapping[str, Any]) -> None:
    """Raise TermselError for arguments given next to a prepared task, which has them already."""
    named = sorted(name for name, value in arguments.items() if value is not None)
    if named:
        raise TermselError(f"a prepared task takes no {', '.join(named)}",
                           hint="Give them to termsel.prepare.")


def _run_and_write(work: Callable[[], Result], out: Path | str | None, overwrite: bool,
                   longer: int) -> Result:
    """Do the work of a run, write its result into the folder `out`, if any, and notify the plugins.

    A certificate of an earlier result in the folder is removed. `longer` are the seconds [s] that a
    run takes longer which compiles, 0 if none; they are logged. Raises TermselError for a folder
    that another run writes, that may not be replaced or cannot be written.
    """
    with nullcontext() if out is None else lock_output_folder(Path(out), overwrite=overwrite):
        if longer:
            log.info("Compiling: the first run on this machine takes some %d s longer.", longer)
        # The folder is claimed before the work, so that two runs never share it.
        result = work()
        if out is not None:
            result = with_spent(result, Path(out))
            write_result(result, Path(out))
            if CERTIFICATE not in result.files:  # that of the result it has replaced
                (Path(out) / CERTIFICATE).unlink(missing_ok=True)
    registry().notify_run_finished(result)
    return result


# One road from a method and prepared data to a result.

@explains_arguments(checked_within=("seed",))
def assess(method: Method, task: Task, *, seed: int = 1, observers: Iterable[Observer] = (),
           memory: Memory | None = None) -> Result:
    """Return the result of a method on prepared data.

    Blunders are looked for, the method is fitted, its errors at held-out features are found by
    repeating the whole of it, it is compared with conventional models, and independent points are
    looked at, once, at the end: the same for every method.

    Parameters
    ----------
    method : Method
        `Auto` chooses among methods; `Search` searches the task's problem, or one of its own with
        the task's features; `GivenGenes` takes what an optimiser of one's own has found; any other
        is fitted alone.
    task : Task
        As `termsel.prepare` returns it.
    seed : int
        Of the search by OWDIS, where there are points and lines.
    observers : iterable of callable
        Called with `Progress` after each method that is tried.
    memory : Memory, optional
        What was found of the same features before.

    Returns
    -------
    Result
        The fit of the method, its accuracy, and the conventional models beside it.

    Raises
    ------
    TermselError
        If the features do not determine the method, or genes are of another dtype or shape, or out
        of bounds.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> task = termsel.prepare("poly-terms", options={"degree": 2})
    >>> genes = task.problem.genome.random(np.random.default_rng(1), 100)
    >>> order = task.problem.evaluate(genes).order()
    >>> result = termsel.assess(termsel.GivenGenes(genes[order[0]]), task)
    >>> result.solver
    'given'
    """
    seed = whole_seed(seed)
    memory = memory or Memory()
    if isinstance(method, TaskMethod):
        return result_of(*method.find(task, memory))
    # One method is a choice among one: held out, compared and reported alike.
    auto = method if isinstance(method, Auto) else Auto(methods=(method,), memory=memory)
    return result_of(task.request, choose_for(
        task.request, task.observations, auto, seed, observers, task.note_on_projection))
