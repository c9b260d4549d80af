"""One search: budget, observers, record of evaluations, interrupt."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np

from termsel.errors import TermselError
from termsel.interrupts import answered
from termsel.measurements.features import FloatArray
from termsel.problems.base import Evaluation, Problem
from termsel.problems.segments import Genes
from termsel.solvers.base import Generation, Solver
from termsel.solvers.budget import Budget
from termsel.solvers.ledger import BudgetSpent, Ledger, Progress
from termsel.solvers.silence import heard
from termsel.solvers.swap import climb, neighbours
from termsel.threads import one_blas_thread

POLISH_SHARE = 3
"""Most evaluations of the local refinement, relative to those of the search: enough for most
seeds to reach the proven optimum of the embedded problem with 21 terms per axis.
See docs/evidence/solver-table.md."""

DESCENT = 100_000_000
"""Most genes that the first descent of the local refinement evaluates, in all its individuals: of
thousands of points, one look at all neighbours of a selection would take hours."""

NONE = Evaluation(np.full((1, 1), np.inf), np.zeros(1))
"""Of an individual, before a solver has evaluated any."""

Observer = Callable[[Progress], None]


@dataclass(frozen=True)
class Polish:
    """What the local refinement after a solver added.

    Parameters
    ----------
    found, polished : float
        First objective before and after.
    evaluations, lookups : int
        In addition to those of the solver.
    """

    found: float
    polished: float
    evaluations: int
    lookups: int


@dataclass(frozen=True, eq=False)
class Search:
    """A finished or interrupted search.

    Parameters
    ----------
    genes : ndarray, shape (size,)
        The best individual found.
    objectives : ndarray, shape (m,)
        Its objectives.
    violation : float
        Its violation; 0 is feasible.
    seed, evaluations, generations : int
        Of the solver, without the local refinement; generations after the first population.
    lookups : int
        How many of these evaluations were looked up, as the same individual was already
        evaluated.
    seconds : float
    interrupted : bool
        True if the user stopped it.
    polish : Polish, optional
        None if there is no local refinement after the solver.
    certificate : mapping, optional
        What the solver proved, if anything.
    coefficients : ndarray, shape (k,), optional
        From a solver that finds coefficients, as ridge does; others find only genes.
    front : tuple of ndarray
        With several objectives all feasible, non-dominated individuals evaluated, each point of
        the front once, by the first objective; with one objective, the front that the solver
        yields, if any.
    notes : tuple of str
        What a reader of the result must know about the search.
    """

    genes: Genes
    objectives: np.ndarray[tuple[int], np.dtype[np.float64]]
    violation: float
    seed: int
    evaluations: int
    generations: int
    lookups: int
    seconds: float
    interrupted: bool
    polish: Polish | None = None
    certificate: Mapping[str, Any] | None = None
    front: tuple[Genes, ...] = ()
    coefficients: FloatArray | None = None
    notes: tuple[str, ...] = ()


@one_blas_thread
def search(
    problem: Problem,
    solver: Solver,
    *,
    seed: int = 1,
    generations: int | None = None,
    evaluations: int | None = None,
    seconds: float | None = None,
    observers: Iterable[Observer] = (),
) -> Search:
    """Search a problem with a solver.

    Parameters
    ----------
    problem : Problem
    solver : Solver
    seed : int
        Seed of the one random generator of the search.
    generations, evaluations : int, optional
        Budgets; the search ends when the first is spent. Without any budget the solver's
        default number of generations applies.
    seconds : float, optional
        Budget of time; the current evaluation is finished.
    observers : iterable of callable
        Called with `Progress` after each generation, and in the local refinement; in another thread
        while a solver of a plugin yields nothing for 10 s.

    Returns
    -------
    Search
        Also when interrupted with Ctrl-C, if anything was evaluated.

    Raises
    ------
    TermselError
        For a budget that is not positive, or a solver that cannot handle the objectives.
    """
    for name, value in (("generations", generations), ("evaluations", evaluations),
                        ("seconds", seconds)):
        if value is not None and not value > 0:
            raise TermselError(f"the budget of {value} {name} is not positive")
    _require_names(problem)
    require_able(problem, solver)
    if generations is None and evaluations is None and seconds is None:
        generations = solver.default_generations
    start = time.perf_counter()
    ledger = Ledger(problem, evaluations=evaluations,
                    deadline=None if seconds is None else start + seconds,
                    solver=solver)
    budget = Budget(generations, evaluations, seconds, start)
    generation: Generation | None = None
    polish = None
    interrupted = False
    rng = np.random.default_rng(seed)

    def tell(what: str) -> None:
        reached = generation or Generation(0, np.zeros((1, problem.genome.size), dtype=bool), NONE)
        for observe in observers:
            observe(ledger.progress(reached, budget.share(reached, ledger), what))

    running = heard(solver.generations(ledger, rng), solver, ledger, tell)
    try:
        with closing(_until_spent(running)) as yielded:
            for generation in yielded:
                progress = ledger.progress(generation, budget.share(generation, ledger))
                for observe in observers:
                    observe(progress)
                if budget.spent(generation, ledger):
                    break
        done, lookups = ledger.count, ledger.lookups
        if solver.options.get("polish"):
            polish = _polish(ledger, rng, generation, observers)
    except KeyboardInterrupt:
        if ledger.best_genes is None:
            raise
        answered()
        done, lookups, interrupted = ledger.count, ledger.lookups, True
    if ledger.best_genes is None:
        raise TermselError(f"solver {solver.name!r} evaluated nothing", hint="Increase the budget.")
    return Search(ledger.best_genes, ledger.best_objectives, ledger.best[0], seed, done,
                  generation.index if generation else 0, lookups,
                  time.perf_counter() - start, interrupted, polish,
                  generation.details.get("certificate") if generation else None,
                  tuple(ledger.front() if len(problem.objectives) > 1
                        else generation.details.get("front", ()) if generation else ()),
                  generation.details.get("coefficients") if generation else None)


def require_able(problem: Problem, solver: Solver,
                 others: Iterable[type[Solver]] = ()) -> None:
    """Refuse a solver that cannot handle the objectives or the genes of the problem.

    Parameters
    ----------
    problem : Problem
    solver : Solver
    others : iterable of type[Solver]
        Solvers; the error names those that can.

    Raises
    ------
    TermselError
    """
    wanted = len(problem.objectives)
    types = {type(segment) for segment in problem.genome.segments}
    many = solver.min_objectives <= wanted <= solver.max_objectives
    if many and types <= set(solver.segments):
        return
    able = [other.name for other in others
            if other.min_objectives <= wanted <= other.max_objectives
            and types <= set(other.segments)]
    others_hint = f"Choose one of: {', '.join(able)}." if able else None
    if not many:
        raise TermselError(
            f"solver {solver.name!r} cannot handle {wanted} objective{'s' if wanted > 1 else ''}: "
            f"{', '.join(problem.objectives)}", hint=others_hint)
    segment = next(s for s in problem.genome.segments if type(s) not in solver.segments)
    handled = ", ".join(one.__name__ for one in solver.segments)
    raise TermselError(
        f"solver {solver.name!r} handles genes of the type {handled}; those of {segment.name!r} "
        f"are {type(segment).__name__}", hint=others_hint)


def _require_names(problem: Problem) -> None:
    """Refuse objectives that are not named one by one: the letters of a str would be taken."""
    names = problem.objectives
    if isinstance(names, str) or not names or not all(isinstance(name, str) for name in names):
        raise TermselError(
            f"the objectives of problem {type(problem).__name__!r} are {names!r}, not a tuple of "
            "names", hint="This is a bug in the problem: tell its author.")


def _until_spent(running: Iterator[Generation]) -> Generator[Generation]:
    try:
        yield from running
    except BudgetSpent:
        return


def _polish(ledger: Ledger, rng: np.random.Generator, generation: Generation | None,
            observers: Iterable[Observer]) -> Polish | None:
    """Climb from the best individual, or search around all members of a front.

    The evaluations are additional to the solver's, up to POLISH_SHARE times as many; a budget of
    time applies to both. The first descent may take more, up to DESCENT.
    """
    if ledger.best_genes is None:
        return None
    # A budget may be spent within the first generation.
    reached = generation or Generation(0, ledger.best_genes[None], Evaluation(
        ledger.best_objectives[None], np.array([ledger.best[0]])))
    found, count, lookups = ledger.best[1], ledger.count, ledger.lookups
    most = (1 + POLISH_SHARE) * count
    ledger.limit = max(most, count + DESCENT // ledger.genome.size)

    def tell() -> None:
        share = min((ledger.count - count) / (most - count), 1.0)
        progress = ledger.progress(reached, share, "local refinement")
        for observe in observers:
            observe(progress)

    ledger.after_evaluation = tell
    try:
        if len(ledger.objectives) == 1:
            start = ledger.best_genes[None]
            for _ in climb(ledger, start, ledger.evaluate(start), rng):
                ledger.limit = most
                if ledger.count >= most:
                    break
        else:
            _widen(ledger, 2 * count)
    except BudgetSpent:  # the limits above, or the deadline
        pass
    return Polish(found, ledger.best[1], ledger.count - count, ledger.lookups - lookups)


def _widen(ledger: Ledger, most: int) -> None:
    """Evaluate all neighbours of all members of the front until no member is new.

    A front of many objectives has very many members, so this ends at `most` evaluations.
    """
    seen: set[bytes] = set()
    while True:
        new = [genes for genes in ledger.front() if genes.tobytes() not in seen]
        if not new:
            return
        for genes in new:
            seen.add(genes.tobytes())
            for around in neighbours(genes, ledger.genome):
                if ledger.count + len(around) > most:
                    return
                ledger.evaluate(around)
