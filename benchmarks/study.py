"""Many runs of one problem: solvers compared over many seeds."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import Any

from termsel.runs.assess import fit_of
from termsel.runs.recommend import recommended
from termsel.runs.task import prepare
from termsel.solvers.exact import TIE
from termsel.solvers.search import search


@dataclass(frozen=True)
class Trial:
    """One search.

    Parameters
    ----------
    solver : str
    seed : int
    fitness : float
        First objective; infinite where nothing feasible was found.
    independent : float
        RMSE of the selection on independent points [px].
    evaluations : int
        Those of solver and local refinement together.
    seconds : float
        CPU time of the search.
    """

    solver: str
    seed: int
    fitness: float
    independent: float
    evaluations: int
    seconds: float


@dataclass(frozen=True)
class Standing:
    """Figures of a solver over all seeds.

    Parameters
    ----------
    solver : str
    best, median, worst : float
        Fitness over the seeds.
    reached : float or None
        Share of seeds that reached the optimum, if it is known.
    evaluations, seconds, independent : float
        Medians over the seeds.
    """

    solver: str
    best: float
    median: float
    worst: float
    reached: float | None
    evaluations: float
    seconds: float
    independent: float


def trials(
    problem: str,
    solvers: Iterable[str],
    seeds: Iterable[int],
    *,
    evaluations: int,
    polish: bool = False,
    options: Mapping[str, Any] | None = None,
    solver_options: Mapping[str, Mapping[str, Any]] | None = None,
    processes: int = 1,
    **prepared: Any,
) -> Iterator[Trial]:
    """Run solvers on a problem, once for every seed.

    Parameters
    ----------
    problem : str
        Name of a recipe.
    solvers : iterable of str
    seeds : iterable of int
    evaluations : int
        Budget of each search, that of a local refinement included.
    polish : bool
        Whether a local refinement follows.
    options : mapping, optional
        Options for all, as in `termsel.prepare`.
    solver_options : mapping, optional
        Further options by name of the solver.
    processes : int
        Searches at a time. The trials do not depend on it, but for their seconds.
    **prepared
        Further arguments of `termsel.prepare`.

    Yields
    ------
    Trial
        In the order of solvers, then seeds.
    """
    jobs = [(solver, seed, {**(options or {}), **(solver_options or {}).get(solver, {})})
            for solver in solvers for seed in seeds]
    one = partial(_trial, problem, evaluations, polish, prepared)
    if processes == 1:
        yield from map(one, jobs)
        return
    with ProcessPoolExecutor(processes) as pool:
        yield from pool.map(one, jobs)


def _trial(problem: str, evaluations: int, polish: bool, prepared: Mapping[str, Any],
           job: tuple[str, int, Mapping[str, Any]]) -> Trial:
    solver, seed, options = job
    task = prepare(problem, solver=solver, options=options, **prepared)
    start = time.process_time()
    found = search(task.problem, task.solver, seed=seed, evaluations=evaluations, polish=polish)
    seconds = time.process_time() - start
    found = recommended(task, found)
    accuracy = fit_of(task, task.problem.decode(found.genes)).rmse(task.observations.independent)
    return Trial(
        solver, seed, float(found.objectives[0]) if found.violation == 0 else float("inf"),
        float("nan") if accuracy is None else accuracy.total,
        found.evaluations, seconds)


def standings(done: Iterable[Trial], optimum: float | None = None) -> list[Standing]:
    """Return the figures of each solver, in the order in which they first appear.

    Parameters
    ----------
    done : iterable of Trial
    optimum : float, optional
        The proven least fitness.
    """
    by_solver: dict[str, list[Trial]] = {}
    for trial in done:
        by_solver.setdefault(trial.solver, []).append(trial)
    rows = []
    for solver, mine in by_solver.items():
        fitness = [trial.fitness for trial in mine]
        reached = None if optimum is None else \
            sum(value <= optimum * (1 + TIE) for value in fitness) / len(mine)
        rows.append(Standing(
            solver, min(fitness), median(fitness), max(fitness), reached,
            median(trial.evaluations for trial in mine), median(trial.seconds for trial in mine),
            median(trial.independent for trial in mine)))
    return rows
