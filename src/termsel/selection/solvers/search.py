"""One search: budget, observers, record of evaluations, interrupt."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import structs

from termsel.core.arguments import explains_arguments
from termsel.core.errors import TermselError
from termsel.core.interrupts import take_pending_interrupt
from termsel.core.options import whole_seed
from termsel.core.threads import one_blas_thread
from termsel.data.features import FloatArray
from termsel.data.record.search import HistoryRow, Polish
from termsel.selection.problems.base import Evaluation, Problem
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.segments import Genes
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.bridges.silence import warn_of_silence
from termsel.selection.solvers.budget import (
    EVALUATIONS,
    IDLE,
    MIN_GAIN,
    Budget,
    Patience,
    require_limits,
)
from termsel.selection.solvers.checkpoint import Checkpoint, require_resumable
from termsel.selection.solvers.ledger import BudgetSpent, Ledger
from termsel.selection.solvers.observers import Observer, Observers
from termsel.selection.solvers.refinement import POLISH_SHARE, refine

if TYPE_CHECKING:
    from termsel.selection.solvers.proofs.proof import FeatureProof, Proof

NONE = Evaluation(np.full((1, 1), np.inf), np.zeros(1))
"""Of an individual, before a solver has evaluated any."""

@dataclass(frozen=True, eq=False)
class SearchResult:
    """A finished or interrupted search.

    Parameters
    ----------
    genes : ndarray, shape (size,)
        The best individual found.
    objectives : ndarray, shape (m,)
        Its objectives.
    violation : float
        Its violation; 0 is feasible.
    seed : int
        Of the random generator of the search.
    evaluations : int
        Individuals evaluated, those of the local refinement included.
    generations : int
        Of the solver, after the first population.
    lookups : int
        How many of these evaluations were looked up, as the same individual was already
        evaluated.
    seconds : float
        How long it took, in all processes [s].
    interrupted : bool
        True if the user stopped it.
    ended_by_observer : bool
        True if an observer ended it.
    gains : tuple of (int, float)
        Evaluation at which each new best was found, from 1, and its first objective.
    polish : Polish, optional
        None if no local refinement was asked for.
    certificate : mapping, optional
        What the solver proved, if anything.
    certificate_content : mapping, optional
        Of the file certificate.json, where the solver made one.
    proof : Proof or FeatureProof, optional
        From `exact`: what it proved of the selections of each size.
    coefficients : ndarray, shape (k,), optional
        From a solver that finds coefficients, as ridge does; others find only genes.
    front : tuple of ndarray
        With several objectives all feasible, non-dominated individuals evaluated, each point of
        the front once, by the first objective; with one objective, the front that the solver
        yields, if any.
    notes : tuple of str
        What a reader of the result must know about the search.
    history : tuple of HistoryRow
        One for each generation.

    Examples
    --------
    >>> import termsel
    >>> problem = termsel.prepare("poly-terms").problem
    >>> found = termsel.search(problem, termsel.GeneticAlgorithm(), seed=1, generations=2)
    >>> found.generations, len(found.genes)
    (2, 30)
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
    history: tuple[HistoryRow, ...] = ()
    proof: Proof | FeatureProof | None = None
    certificate_content: Mapping[str, Any] | None = None
    ended_by_observer: bool = False
    gains: tuple[tuple[int, float], ...] = ()

    @property
    def stopped(self) -> bool:
        """Whether it was to go no further: by the user or by an observer."""
        return self.interrupted or self.ended_by_observer

    def after(self, earlier: SearchResult, *notes: str) -> SearchResult:
        """Return this search as the second step after an `earlier` one, with further notes.

        Evaluations, generations, lookups, seconds and history are those of both.
        """
        later = tuple(structs.replace(row, evaluations=row.evaluations + earlier.evaluations)
                      for row in self.history)
        return replace(self, evaluations=earlier.evaluations + self.evaluations,
                       generations=earlier.generations + self.generations,
                       lookups=earlier.lookups + self.lookups,
                       seconds=earlier.seconds + self.seconds,
                       history=earlier.history + later, notes=(*self.notes, *notes),
                       # What was found in the first step is of another problem.
                       gains=tuple((evaluation + earlier.evaluations, value)
                                   for evaluation, value in self.gains))


@one_blas_thread
@explains_arguments(checked_within=("seed", "generations", "evaluations", "seconds", "patience"))
def search(
    problem: Problem,
    solver: Solver,
    *,
    seed: int = 1,
    generations: int | None = None,
    evaluations: int | None = None,
    seconds: float | None = None,
    patience: int | None = None,
    tolerance: float = MIN_GAIN,
    polish: bool = False,
    observers: Iterable[Observer] = (),
    checkpoint: Checkpoint | Path | str | None = None,
) -> SearchResult:
    """Search a problem with a solver.

    Every solver that does not end by itself has the same budget by default. A local refinement
    (`polish`) may follow any solver: it is part of the budget, and has three quarters of it.

    Parameters
    ----------
    problem : Problem
    solver : Solver
    seed : int
        Seed of the one random generator of the search.
    generations, evaluations : int, optional
        Budgets; the search ends when the first is spent. Without these, seconds and patience, a
        solver that does not end by itself has 16,040 evaluations. A local refinement takes part of
        `evaluations`, or up to three times as many as the search before it.
    seconds : float, optional
        Budget of time; the current evaluation is finished.
    patience : int, optional
        The search ends after so many generations without a gain.
    tolerance : float
        Gains of an objective that are smaller do not count; relative to it.
    polish : bool
        Whether a local refinement follows: genes are added, dropped and swapped as long as that
        helps, from many starts. It is left out if an observer ended the search.
    observers : iterable of callable
        Called with `Progress` after each generation, and in the local refinement; in another thread
        while a solver of a plugin yields nothing for 10 s. One that returns True, or raises
        StopIteration, ends the search; its result is kept.
    checkpoint : path-like, optional
        File with all that was evaluated, written as the search goes on. If it is there, the search
        goes on from it, to the end that it would have reached without a stop. A budget of time
        counts all processes.

    Returns
    -------
    SearchResult
        Also when interrupted with Ctrl-C, if anything was evaluated. Its notes say if an observer
        ended the search, or a solver that evaluated nothing for many generations.

    Raises
    ------
    TermselError
        For a budget that is no positive, or no whole, number, or what is no seed; a solver that
        cannot handle the objectives or the genes, evaluates nothing, or cannot go on from a
        checkpoint; a checkpoint of another search; or a local refinement after a solver of
        coefficients.
    KeyboardInterrupt
        When interrupted before anything was evaluated.

    Examples
    --------
    >>> import termsel
    >>> task = termsel.prepare("poly-terms", options={"degree": 2})
    >>> found = termsel.search(task.problem, task.solver, observers=[lambda now: now.best < 30])
    >>> found.ended_by_observer, round(float(found.objectives[0]), 1)  # px
    (True, 10.8)
    """
    seed = whole_seed(seed)
    require_limits(generations=generations, evaluations=evaluations, seconds=seconds,
                   patience=patience)
    evaluations = None if evaluations is None else int(evaluations)
    _require_declared(problem)
    require_able(problem, solver)
    shares = 1 + POLISH_SHARE if polish else 1
    # A refinement has three quarters; the solver gets the rest.
    solver_evaluations = None if evaluations is None else max(evaluations // shares, 1)
    if not solver.ends_by_itself and not any((generations, evaluations, seconds, patience)):
        solver_evaluations = EVALUATIONS
    start = time.perf_counter()
    stage = refinement_stage = None
    if checkpoint is not None:
        require_resumable(solver)
        checkpoint = checkpoint if isinstance(checkpoint, Checkpoint) else Checkpoint(checkpoint)
        # What earlier processes took is spent.
        start -= checkpoint.seconds
        stage, refinement_stage = checkpoint.next_search(start)
    budget = Budget(generations, solver_evaluations, None if seconds is None else seconds / shares,
                    start)
    # What the solver gets is the ledger: it counts, looks up what is known, and ends the search.
    ledger = Ledger(problem, evaluations=solver_evaluations, deadline=budget.deadline,
                    solver=solver, stage=stage)
    told = Observers(observers)
    running = _Running(solver, ledger, budget, Patience(patience, tolerance), told)
    refined = None
    interrupted = False
    rng = np.random.default_rng(seed)
    yielded = solver.generations(ledger, rng)
    try:
        running.follow(yielded)
        # The refinement has what is left of the whole budget of time.
        if polish and ledger.best_genes is not None and not told.ended:
            ledger.deadline = None if seconds is None else start + seconds
            _write_checkpoint(ledger)
            ledger.stage = refinement_stage
            refined = refine(ledger, rng, running.generation, evaluations, told)
    except KeyboardInterrupt:  # what is known by now is the result
        if ledger.best_genes is None:
            raise
        take_pending_interrupt()
        interrupted = True
    finally:
        _write_checkpoint(ledger)
    if ledger.best_genes is None:
        raise _error_without_evaluation(solver, running.generation)
    if told.ended:
        running.notes.append("An observer ended the search.")
    generation = running.generation
    details = generation.details if generation else {}
    # With several objectives the front is made of all that was evaluated, whatever the solver says.
    front = ledger.front() if len(problem.objectives) > 1 else details.get("front", ())
    return SearchResult(
        genes=ledger.best_genes, objectives=ledger.best_objectives, violation=ledger.best[0],
        seed=seed, evaluations=ledger.count, lookups=ledger.lookups,
        generations=generation.index if generation else 0, seconds=time.perf_counter() - start,
        interrupted=interrupted, ended_by_observer=told.ended, polish=refined,
        notes=tuple(running.notes), history=tuple(running.history), gains=tuple(ledger.gains),
        front=tuple(front), certificate=details.get("certificate"), proof=details.get("proof"),
        certificate_content=details.get("certificate_content"),
        coefficients=details.get("coefficients"))


@dataclass
class _Running:
    """A solver at work, until its budget, its convergence or an observer ends it.

    `generation` is the last one that it yielded, `history` has a row for each, and `notes` say why
    it was ended early. They hold what is known so far where Ctrl-C interrupts it.
    """

    solver: Solver
    ledger: Ledger
    budget: Budget
    convergence: Patience
    observers: Observers
    generation: Generation | None = None
    history: list[HistoryRow] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def follow(self, generations: Iterator[Generation]) -> None:
        """Take the solver's generations, tell the observers of each, and end in time."""
        idle = 0
        watched = warn_of_silence(generations, self.solver, self.ledger, self._tell_activity)
        # Closing lets a solver that is not run to its end free what it holds.
        with closing(_until_spent(watched)) as yielded:
            for generation in yielded:
                self.generation = generation
                # Without evaluations a budget of these would never be spent.
                has_evaluated = (not self.history
                                 or self.ledger.count > self.history[-1].evaluations)
                idle = 0 if has_evaluated else idle + 1
                share = self.budget.share(generation, self.ledger)
                progress = self.ledger.progress(generation, share)
                self.history.append(self.ledger.tally(generation))
                if (self.observers.tell(progress) or self.budget.spent(generation, self.ledger)
                        or self.convergence.lost(self.ledger)):
                    return
                if idle >= IDLE and not self.solver.ends_by_itself:
                    self.notes.append(f"The search ended after {IDLE:,} generations in which "
                                      f"solver {self.solver.name!r} evaluated nothing.")
                    return

    def _tell_activity(self, activity: str) -> None:
        """Tell the observers what the solver does while it yields nothing."""
        genome = self.ledger.genome
        reached = self.generation or Generation(0, np.zeros((1, genome.size), dtype=bool), NONE)
        share = self.budget.share(reached, self.ledger)
        self.observers.tell(self.ledger.progress(reached, share, activity))


def _write_checkpoint(ledger: Ledger) -> None:
    """Write the lines of a search's stage that its checkpoint lacks, if it has a checkpoint."""
    if ledger.stage is not None:
        ledger.stage.write()


def _error_without_evaluation(solver: Solver, generation: Generation | None) -> TermselError:
    """Return the error for a search without an evaluation."""
    if generation is None:
        return TermselError(f"solver {solver.name!r} ended without a generation, and evaluated "
                            "nothing", hint="It must call evaluate() of the problem that it got, "
                                            "and yield generations. A built-in one may need a "
                                            "larger budget.")
    return TermselError(
        f"solver {solver.name!r} yields generations, but evaluated nothing with the problem that "
        "it got", hint="Call evaluate() of that problem: it counts, and remembers the best.")


def begin(problem: Problem, solver: Solver) -> None:
    """Begin a search and end it before anything is evaluated, so that a solver may refuse it."""
    # With no evaluation left the ledger ends the search at the first one.
    unevaluated = Ledger(problem, evaluations=0, solver=solver)
    with closing(_until_spent(solver.generations(unevaluated, np.random.default_rng(0)))) as begun:
        next(begun, None)


def require_able(problem: Problem, solver: Solver,
                 other_solvers: Callable[[], Iterable[type[Solver]]] = tuple) -> None:
    """Raise TermselError for a solver that cannot handle the objectives or genes of a problem.

    The error names those of the `other_solvers` that can. A problem that declares neither is
    refused, too.
    """
    _require_declared(problem)
    n_objectives = len(problem.objectives)
    # Both must fit: how many objectives there are, and every type of gene.
    types = {type(segment) for segment in problem.genome.segments}
    objectives_fit = solver.min_objectives <= n_objectives <= solver.max_objectives
    if objectives_fit and _can_handle(solver, types):
        return
    able = [alternative.name for alternative in other_solvers()
            if alternative.min_objectives <= n_objectives <= alternative.max_objectives
            and _can_handle(alternative, types)]
    hints = []
    others = [name for name in able if name != solver.name]
    if others:
        hints.append(f"Choose one of: {', '.join(others)}.")
    # A solver whose class can handle them may do so with other options.
    if solver.name in able:
        hints.append(f"Or set its options otherwise (termsel describe {solver.name}).")
    advice = " ".join(hints) or None
    if not objectives_fit:
        usual = "nsga2" if n_objectives > 1 else "ga, ica or exact"
        raise TermselError(
            f"solver {solver.name!r} cannot handle {n_objectives} "
            f"objective{'s' if n_objectives > 1 else ''}: {', '.join(problem.objectives)}",
            hint=advice or f"Choose one that can, such as {usual}.")
    segment = next(s for s in problem.genome.segments if not isinstance(s, tuple(solver.segments)))
    handled = ", ".join(segment_type.__name__ for segment_type in solver.segments)
    raise TermselError(
        f"solver {solver.name!r} handles genes of the type {handled}; those of {segment.name!r} "
        f"are {type(segment).__name__}", hint=advice)


def _can_handle(solver: Solver | type[Solver], types: Iterable[type]) -> bool:
    """Return whether a solver can handle segments of these types."""
    return all(issubclass(segment_type, tuple(solver.segments)) for segment_type in types)


def _require_declared(problem: Problem) -> None:
    """Raise TermselError unless the genome is a Genome, and the objectives are a tuple of names.

    A str is refused, too: its letters would be taken for names.
    """
    genome = getattr(problem, "genome", None)
    names = getattr(problem, "objectives", None)
    fault = ""
    if not isinstance(genome, Genome):
        fault = f"genome of problem {type(problem).__name__!r} is {genome!r:.200}, not a Genome"
    elif (not isinstance(names, tuple | list) or not names
            or not all(isinstance(name, str) for name in names)):
        fault = (f"objectives of problem {type(problem).__name__!r} are {names!r:.200}, "
                 "not a tuple of names")
    if fault:
        raise TermselError(f"the {fault}", hint="This is a bug in the problem: tell its author.")


def _until_spent(running: Iterator[Generation]) -> Generator[Generation]:
    """Yield generations until the budget is spent."""
    try:
        yield from running
    except BudgetSpent:
        return
