"""One run from names to a Result: prepare the problem, search it, assess what was found."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from termsel.adjustment.kernels import needs_compilation
from termsel.errors import TermselError
from termsel.plugins.registry import registry
from termsel.results.result import Result
from termsel.runs.assess import assess
from termsel.runs.auto import choose_for, wanted
from termsel.runs.recommend import recommended
from termsel.runs.steps import search_in_steps
from termsel.runs.task import DATA_OPTIONS, Task, prepare
from termsel.solvers.search import Observer
from termsel.threads import one_blas_thread

log = logging.getLogger(__name__)


AUTO: Mapping[str, Any] = {"criterion": "press", "solver": "all-terms"}
"""What a task is prepared with where the strategy "auto" takes its observations alone."""


@one_blas_thread
def run(
    problem: str | Task,
    *,
    seed: int = 1,
    generations: int | None = None,
    evaluations: int | None = None,
    seconds: float | None = None,
    observers: Iterable[Observer] = (),
    out: Path | str | None = None,
    strategy: str | None = None,
    **prepared: Any,
) -> Result:
    """Search a problem and assess the selection.

    Parameters
    ----------
    problem : str or Task
        A recipe's name, or what `prepare` made of it.
    seed : int
        Seed of the search.
    generations, evaluations : int, optional
        Budgets; see `termsel.search`.
    seconds : float, optional
        Budget of time.
    observers : iterable of callable
        Called after each generation.
    out : path, optional
        Folder for result.json, residuals.csv and summary.txt.
    strategy : {"auto", "as-asked"}, optional
        "auto" chooses the model itself, among plain and shrunken ones, by what it predicts for
        points that took no part; "as-asked" runs the problem's solver. By default "auto" where
        the problem allows it and neither model, solver, criterion, budget nor any option but
        those of the data is given. A prepared task is always run as asked.
    **prepared
        Arguments of `prepare`, where `problem` is a name.

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
    from termsel.io.result_folder import claim_folder, write_result

    auto = False
    if isinstance(problem, Task):
        if prepared:
            raise TermselError(f"a prepared task takes no {', '.join(sorted(prepared))}",
                               hint="Give them to termsel.prepare.")
        task = problem
    else:
        auto = wanted(strategy, registry().get("problems", problem), {
            **{key: prepared.get(key) for key in ("model", "solver", "criterion")},
            **{f"the option {key}": True for key in prepared.get("options") or ()
               if key not in {option.name for option in DATA_OPTIONS}},
            "a budget": any(b is not None for b in (generations, evaluations, seconds))})
        if auto:  # which uses check points as control and yet shows their figures
            prepared |= {**AUTO, "options": {"check_as": "judge",
                                             **(prepared.get("options") or {})}}
        task = prepare(problem, **prepared)
    if out is not None:
        claim_folder(Path(out))
    if needs_compilation():
        log.info("Compiling: the first run on this machine takes some 10 s longer.")
    if auto:
        result = choose_for(task, seed)
    else:
        found = search_in_steps(task, seed=seed, generations=generations,
                                evaluations=evaluations, seconds=seconds, observers=observers)
        result = assess(task, recommended(task, found))
    if out is not None:
        write_result(result, Path(out))
    registry().notify_run_finished(result)
    return result
