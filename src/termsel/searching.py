"""One search: budget, observers, record of evaluations, interrupt."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from termsel.errors import TermselError
from termsel.features import BoolArray, FloatArray
from termsel.problems.base import EnumerablePart, Evaluation, Problem, Selection
from termsel.solvers.base import Generation, Solver
from termsel.solvers.local import climb, neighbours
from termsel.threads import one_blas_thread

POLISH_SHARE = 3
"""Most evaluations of a polish by those of the search before it: as many as let the embedded
problem of 21 terms an axis end at its proven optimum from most seeds (docs/solver-table.md)."""


@dataclass(frozen=True, eq=False)
class Progress:
    """What an observer sees after each generation.

    Parameters
    ----------
    generation : Generation
    evaluations : int
        Individuals evaluated so far.
    share : float or None
        Share of the budget that is spent, 0 to 1; None without a budget.
    best : float
        Best first objective so far.
    violation : float
        Its violation; 0 is feasible.
    genes : ndarray of bool, shape (size,)
        The best individual so far.
    """

    generation: Generation
    evaluations: int
    share: float | None
    best: float
    violation: float
    genes: BoolArray


Observer = Callable[[Progress], None]


@dataclass(frozen=True)
class Polish:
    """What the local search after a solver added.

    Parameters
    ----------
    found, polished : float
        First objective before and after.
    evaluations, lookups : int
        On top of those of the solver.
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
    genes : ndarray of bool, shape (size,)
        The best individual found.
    objectives : ndarray, shape (m,)
        Its objectives.
    violation : float
        Its violation; 0 is feasible.
    seed, evaluations, generations : int
        Of the solver, without those of the polish; generations after the first population.
    lookups : int
        How many of these evaluations were looked up, as the same individual had been
        evaluated before.
    seconds : float
    interrupted : bool
        True if the user stopped it.
    polish : Polish, optional
        None where the solver is not polished.
    certificate : mapping, optional
        What the solver proved, if anything.
    coefficients : ndarray, shape (k,), optional
        From a solver that finds coefficients, as ridge does, where others find genes alone.
    front : tuple of ndarray of bool
        With several objectives all feasible individuals evaluated that no other dominates,
        each point of the front once, by the first objective; with one, what the solver
        yields of the kind.
    notes : tuple of str
        What the reader of the result must know of the search.
    """

    genes: BoolArray
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
    front: tuple[BoolArray, ...] = ()
    coefficients: FloatArray | None = None
    notes: tuple[str, ...] = ()


class _BudgetSpent(Exception):
    """Ends a search from within an evaluation."""


class Ledger(Problem):
    """A problem that counts, looks up what it has seen, and remembers the best.

    Parameters
    ----------
    problem : Problem
    evaluations : int, optional
        Individuals that may be evaluated.
    deadline : float, optional
        Time, on the clock of `time.perf_counter`, after which nothing is evaluated.
    """

    def __init__(self, problem: Problem, *, evaluations: int | None = None,
                 deadline: float | None = None) -> None:
        self.problem = problem
        self.genome = problem.genome
        self.objectives = problem.objectives
        self.limit = evaluations
        self.deadline = deadline
        self.count = 0
        self.lookups = 0
        self.best: tuple[float, float] = (np.inf, np.inf)
        self.best_genes: BoolArray | None = None
        self.best_objectives = np.full(len(problem.objectives), np.inf)
        self._row_of: dict[bytes, int] = {}
        self._objectives: list[np.ndarray[tuple[int], np.dtype[np.float64]]] = []
        self._violation: list[float] = []

    def evaluate(self, genes: BoolArray) -> Evaluation:
        """Return the evaluation, computing only what was not seen before."""
        if self.deadline is not None and self.count and time.perf_counter() > self.deadline:
            raise _BudgetSpent
        allowed = len(genes) if self.limit is None else self.limit - self.count
        evaluation = self._look_up(genes[:allowed])
        if allowed < len(genes):
            raise _BudgetSpent
        return evaluation

    def decode(self, genes: BoolArray) -> Selection:
        """Return what one chromosome selects."""
        return self.problem.decode(genes)

    def parts(self) -> tuple[EnumerablePart, ...]:
        """Return the problem's own parts."""
        return self.problem.parts()

    def design(self) -> FloatArray:
        """Return the problem's own design matrix."""
        return self.problem.design()

    def progress(self, generation: Generation, share: float | None) -> Progress:
        """Return what an observer is told."""
        genes = generation.genes[0] if self.best_genes is None else self.best_genes
        return Progress(generation, self.count, share, self.best[1], self.best[0], genes)

    def front(self) -> list[BoolArray]:
        """Return the feasible individuals that none dominates, by first objective."""
        if not self._objectives:
            return []
        objectives = np.array(self._objectives)
        rows = np.flatnonzero(np.array(self._violation) == 0)
        rows = rows[np.lexsort(objectives[rows].T[::-1])]
        kept: list[int] = []
        for row in rows:
            # Sorted by the first objective: only an earlier one can dominate or equal.
            if not (objectives[kept] <= objectives[row]).all(axis=1).any():
                kept.append(int(row))
        keys = list(self._row_of)
        packed = np.array([np.frombuffer(keys[row], dtype=np.uint8) for row in kept])
        return [np.unpackbits(one, count=self.genome.size).astype(bool) for one in packed]

    def _look_up(self, genes: BoolArray) -> Evaluation:
        keys = _keys(genes)
        new: dict[bytes, int] = {}
        for i, key in enumerate(keys):
            if key not in self._row_of and key not in new:
                new[key] = i
        if new:
            rows = list(new.values())
            evaluation = self.problem.evaluate(genes[rows])
            self._check(evaluation, len(rows))
            for key in new:
                self._row_of[key] = len(self._row_of)
            self._objectives.extend(evaluation.objectives)
            self._violation.extend(evaluation.violation.tolist())
            self._remember(genes[rows], evaluation)
        self.count += len(genes)
        self.lookups += len(genes) - len(new)
        where = [self._row_of[key] for key in keys]
        return Evaluation(
            np.array([self._objectives[i] for i in where]).reshape(-1, len(self.objectives)),
            np.array([self._violation[i] for i in where]))

    def _check(self, evaluation: Evaluation, n: int) -> None:
        if (evaluation.objectives.shape != (n, len(self.objectives))
                or evaluation.violation.shape != (n,)
                or not np.isfinite(evaluation.objectives).all()
                or not np.isfinite(evaluation.violation).all()):
            raise TermselError(
                f"problem {type(self.problem).__name__!r} returned an evaluation that is not "
                f"finite numbers of shape ({n}, {len(self.objectives)}) and ({n},)",
                hint="Tell the author of the problem.")

    def _remember(self, genes: BoolArray, evaluation: Evaluation) -> None:
        first = int(evaluation.order()[0])
        found = (float(evaluation.violation[first]), float(evaluation.objectives[first, 0]))
        if found < self.best:
            self.best = found
            self.best_genes = genes[first].copy()
            self.best_objectives = evaluation.objectives[first].copy()


def _keys(genes: BoolArray) -> list[bytes]:
    packed = np.ascontiguousarray(np.packbits(genes, axis=1))
    return [row.tobytes() for row in packed]


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
        Budgets; the search ends with whichever is spent first. Without any budget the
        solver's default number of generations holds.
    seconds : float, optional
        Budget of time; the evaluation under way is finished.
    observers : iterable of callable
        Called with `Progress` after each generation.

    Returns
    -------
    Search
        Also when interrupted with Ctrl-C, once anything has been evaluated.

    Raises
    ------
    TermselError
        For a budget that is not positive, or a solver that cannot handle the objectives.
    """
    for name, value in (("generations", generations), ("evaluations", evaluations),
                        ("seconds", seconds)):
        if value is not None and not value > 0:
            raise TermselError(f"a budget of {value} {name} is not positive")
    require_able(problem, solver)
    if generations is None and evaluations is None and seconds is None:
        generations = solver.default_generations
    start = time.perf_counter()
    ledger = Ledger(problem, evaluations=evaluations,
                    deadline=None if seconds is None else start + seconds)
    budget = _Budget(generations, evaluations, seconds, start)
    generation: Generation | None = None
    polish = None
    interrupted = False
    rng = np.random.default_rng(seed)
    running = solver.generations(ledger, rng)
    try:
        for generation in _until_spent(running):
            progress = ledger.progress(generation, budget.share(generation, ledger))
            for observe in observers:
                observe(progress)
            if budget.spent(generation, ledger):
                break
        done, lookups = ledger.count, ledger.lookups
        if solver.options.get("polish"):
            polish = _polish(ledger, rng)
    except KeyboardInterrupt:
        if ledger.best_genes is None:
            raise
        done, lookups, interrupted = ledger.count, ledger.lookups, True
    if ledger.best_genes is None:
        raise TermselError(f"solver {solver.name!r} evaluated nothing", hint="Raise the budget.")
    return Search(ledger.best_genes, ledger.best_objectives, ledger.best[0], seed, done,
                  generation.index if generation else 0, lookups,
                  time.perf_counter() - start, interrupted, polish,
                  generation.details.get("certificate") if generation else None,
                  tuple(ledger.front() if len(problem.objectives) > 1
                        else generation.details.get("front", ()) if generation else ()),
                  generation.details.get("coefficients") if generation else None)


def require_able(problem: Problem, solver: Solver,
                 others: Iterable[type[Solver]] = ()) -> None:
    """Refuse a solver that is not for as many objectives as the problem has.

    Parameters
    ----------
    problem : Problem
    solver : Solver
    others : iterable of type[Solver]
        Solvers among which those that can are named.

    Raises
    ------
    TermselError
    """
    wanted = len(problem.objectives)
    if solver.min_objectives <= wanted <= solver.max_objectives:
        return
    able = [other.name for other in others
            if other.min_objectives <= wanted <= other.max_objectives]
    raise TermselError(
        f"solver {solver.name!r} is not for {wanted} objective{'s' if wanted > 1 else ''}: "
        f"{', '.join(problem.objectives)}",
        hint=f"Solvers that can: {', '.join(able)}." if able else None)


def _until_spent(running: Iterator[Generation]) -> Iterator[Generation]:
    try:
        yield from running
    except _BudgetSpent:
        return


def _polish(ledger: Ledger, rng: np.random.Generator) -> Polish | None:
    """Climb from the best individual, or look around all members of a front.

    The evaluations come on top of the solver's, up to POLISH_SHARE times as many; a budget of
    time holds for both. The first descent is always finished.
    """
    if ledger.best_genes is None:
        return None
    found, count, lookups = ledger.best[1], ledger.count, ledger.lookups
    ledger.limit = None
    most = (1 + POLISH_SHARE) * count
    try:
        if len(ledger.objectives) == 1:
            start = ledger.best_genes[None]
            for _ in climb(ledger, start, ledger.evaluate(start), rng):
                ledger.limit = most
                if ledger.count >= most:
                    break
        else:
            _widen(ledger, 2 * count)
    except _BudgetSpent:  # the limit above, or the deadline
        pass
    return Polish(found, ledger.best[1], ledger.count - count, ledger.lookups - lookups)


def _widen(ledger: Ledger, most: int) -> None:
    """Look at all neighbours of all members of the front until no member is new.

    A front of many objectives has no end of members, so this ends at `most` evaluations.
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


@dataclass(frozen=True)
class _Budget:
    generations: int | None
    evaluations: int | None
    seconds: float | None
    start: float

    def share(self, generation: Generation, ledger: Ledger) -> float | None:
        """Return the spent share of whichever budget is spent first."""
        elapsed = time.perf_counter() - self.start
        shares = [value / limit for value, limit in (
            (generation.index, self.generations), (ledger.count, self.evaluations),
            (elapsed, self.seconds)) if limit is not None]
        known = generation.details.get("share")
        return min(1.0, max(shares)) if shares else known

    def spent(self, generation: Generation, ledger: Ledger) -> bool:
        """Return True where no further generation may begin."""
        return ((self.generations is not None and generation.index >= self.generations)
                or (self.evaluations is not None and ledger.count >= self.evaluations)
                or (self.seconds is not None
                    and time.perf_counter() - self.start >= self.seconds))
