"""The ledger of a search: counts evaluations, looks up known ones, remembers the best."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from termsel.adjustment.solve import round_to_nine_digits
from termsel.core.errors import TermselError
from termsel.core.isolation.faults import fault_of_method, mark_own_errors
from termsel.data.features import FloatArray
from termsel.data.record.chances import median_of
from termsel.data.record.search import HistoryRow
from termsel.selection.problems.base import Evaluation, Problem, ProblemAround, evaluation_fault
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.segments import Genes
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.checkpoint import Stage

_KNOWN = 1_000_000  # individuals remembered at most, unless a front is made of them: some 300 MB


@dataclass(frozen=True, eq=False)
class Progress:
    """State of a search, as observers get it after each generation and in the local refinement."""

    generation: Generation
    evaluations: int  # individuals evaluated so far
    share: float | None  # of the budget that is spent, 0 to 1; None without a budget
    best: float  # best first objective so far
    violation: float  # its violation; 0 is feasible
    genes: Genes  # (size,): the best individual so far
    # What is being done, where it is no generation of the solver: the local refinement, or a step
    # of the strategy "auto". There each candidate of each fold counts as an evaluation and as a
    # generation, none of which has genes.
    what: str = ""


class BudgetSpent(Exception):
    """Ends a search from within an evaluation."""


class Ledger(ProblemAround):
    """A problem that counts evaluations, looks up known ones, and remembers the best.

    At most `evaluations` individuals are evaluated, and none after the `deadline`, a time by
    `time.perf_counter`. `solver` is the one that asks for them. Evaluations that are in the `stage`
    of a checkpoint are not computed again.
    """

    def __init__(self, problem: Problem, *, evaluations: int | None = None,
                 deadline: float | None = None, solver: Solver | None = None,
                 stage: Stage | None = None) -> None:
        """Begin to count; the arguments are as the class says, None for no limit."""
        super().__init__(problem)
        self.solver = solver
        self.stage = stage
        self.limit = evaluations
        self.budget = evaluations
        self.deadline = deadline
        self.after_evaluation: Callable[[], None] = lambda: None
        self.count = 0
        self.lookups = 0
        self.best: tuple[float, float] = (np.inf, np.inf)
        self._best_compared = self.best
        self.best_genes: Genes | None = None
        self.best_objectives = np.full(len(problem.objectives), np.inf)
        self.least = np.full(len(problem.objectives), np.inf)
        # Evaluation at which each new best was found, from 1, and its first objective.
        self.gains: list[tuple[int, float]] = []
        self._least_noted = np.inf
        self._row_of: dict[bytes, int] = {}
        # Objectives and violation by row, and space for more.
        self._values = np.empty((1024, len(problem.objectives) + 1))

    def __getstate__(self) -> None:
        """Refuse to go to another process, where nobody would count what is evaluated."""
        raise TermselError(
            "the problem that a solver gets counts evaluations in its own process, so no other one "
            "can have it", hint="Evaluate whole populations in this process. To spread a script of "
            "your own over processes, use the problem of termsel.prepare.")

    def evaluate(self, genes: Genes) -> Evaluation:
        """Return the evaluation of genes (n, size); genes evaluated before are looked up.

        Raises BudgetSpent when the budget ends.
        """
        with mark_own_errors():
            return self._evaluate(genes)

    def evaluate_near(self, genes: Genes, near: Genes) -> Evaluation:
        """Return the evaluation of neighbours of `near`, as `evaluate` does.

        See `Problem.evaluate_near`.
        """
        with mark_own_errors():
            return self._evaluate(genes, near)

    def _evaluate(self, genes: Genes, near: Genes | None = None) -> Evaluation:
        """Return the evaluation of genes (n, size), neighbours of `near` if that is given.

        Genes beyond the budget are not evaluated; then BudgetSpent is raised, which ends the
        search.
        """
        may_end = self.count > 0 and not self.is_replaying
        if self.deadline is not None and may_end and time.perf_counter() > self.deadline:
            raise BudgetSpent
        if fault := self.genome.fault(genes):
            raise fault_of_method(self.solver or type(self), "generations",
                                  f"asks for an evaluation of {fault}")
        # A population that exceeds the budget is evaluated as far as it goes, then the search ends.
        allowed = len(genes) if self.limit is None else self.limit - self.count
        evaluation = self._look_up(genes[:allowed], near)
        self.after_evaluation()
        if allowed < len(genes):
            raise BudgetSpent
        return evaluation

    @property
    def is_replaying(self) -> bool:
        """Whether the evaluations of a checkpoint are being taken, which costs no budget of time.
        """
        return self.stage is not None and self.stage.is_replaying

    def progress(self, generation: Generation, share: float | None, what: str = "") -> Progress:
        """Return the state for observers."""
        genes = generation.genes[0] if self.best_genes is None else self.best_genes
        return Progress(generation=generation, evaluations=self.count, share=share,
                        best=self.best[1], violation=self.best[0], genes=genes, what=what)

    def tally(self, generation: Generation) -> HistoryRow:
        """Return the generation's entry in the history."""
        feasible = generation.evaluation.violation == 0
        scores = generation.evaluation.objectives[feasible, 0]
        return HistoryRow(self.count, None if self.best[0] else self.best[1],
                          float(median_of(scores)) if len(scores) else None, float(feasible.mean()),
                          tuple(map(int, generation.details.get("empires", ()))))

    def front(self) -> list[Genes]:
        """Return the genes (size,) of each feasible individual that no other one dominates.

        They are sorted by the first objective. Of individuals with equal objectives one is given.
        """
        values = self._values[:len(self._row_of)]
        objectives = values[:, :-1]
        rows = np.flatnonzero(values[:, -1] == 0)
        rows = rows[np.lexsort(objectives[rows].T[::-1])]
        front_rows: list[int] = []
        for row in rows:
            # Sorted by the first objective: only an earlier one can dominate or equal.
            if not (objectives[front_rows] <= objectives[row]).all(axis=1).any():
                front_rows.append(int(row))
        keys = list(self._row_of)
        return [_genes_of_key(keys[row], self.genome) for row in front_rows]

    def _look_up(self, genes: Genes, near: Genes | None) -> Evaluation:
        """Evaluate individuals that are not known yet, and return the evaluation of all.

        A solver may ask for the same individual many times; each is evaluated once, twins within a
        population included, and counts each time, so that budgets mean the same for all solvers.
        The table of known individuals is emptied when it is full. Raises PluginFault where a
        problem returns anything but finite values of the right shape.
        """
        # A front is made of all individuals; with one objective only the best is needed, which is
        # remembered apart.
        if len(self.objectives) == 1 and len(self._row_of) > _KNOWN:
            self._row_of = {}
        keys = _keys_of_individuals(genes)
        start = len(self._row_of)
        # Twins within the population are evaluated once.
        unknown_keys = dict.fromkeys(key for key in keys if key not in self._row_of)
        end = start + len(unknown_keys)
        if unknown_keys:
            # The first of equal individuals stands for all of them: of equal keys, the one that
            # comes last in the reversed order stays.
            unknown_genes = genes
            if len(unknown_keys) < len(genes):
                row_of_key = dict(zip(reversed(keys), range(len(keys) - 1, -1, -1), strict=True))
                unknown_genes = genes[[row_of_key[key] for key in unknown_keys]]
            evaluation = self._evaluation_of(list(unknown_keys), unknown_genes, near)
            if fault := evaluation_fault(self.inner, evaluation, unknown_genes):
                raise fault_of_method(self.inner, "evaluate", fault)
            # The table is at least doubled: so each row is copied about once in a search.
            if end > len(self._values):
                space = np.empty((max(len(self._values), len(unknown_keys)), self._values.shape[1]))
                self._values = np.concatenate([self._values, space])
            compared = self._evaluation_for_solver(evaluation)
            self._values[start:end, :-1] = compared.objectives
            self._values[start:end, -1] = compared.violation
            self._row_of.update(zip(unknown_keys, range(start, end), strict=True))
            self._remember(unknown_genes, compared, evaluation.objectives)
            self._note_gains(keys, list(unknown_keys), compared, evaluation.objectives)
        self.count += len(genes)
        self.lookups += len(genes) - len(unknown_keys)
        rows = np.fromiter(map(self._row_of.__getitem__, keys), np.intp, len(keys))
        return Evaluation(self._values[rows, :-1], self._values[rows, -1])

    def _evaluation_of(self, keys: list[bytes], genes: Genes, near: Genes | None) -> Evaluation:
        """Return the evaluation of genes (n, size) by the checkpoint, or else by the problem.

        The latter is added to the checkpoint, if there is one. `keys` are those of the individuals;
        `near` (size,) are genes that all of these differ little from, None if there are none.
        """
        stored = None if self.stage is None else self.stage.replay_next(keys, self.inner, genes)
        if stored is not None:
            return stored
        evaluation = (self.inner.evaluate(genes) if near is None
                      else self.inner.evaluate_near(genes, near))
        # A faulty evaluation is refused by the caller, and never kept.
        if self.stage is not None and evaluation_fault(self.inner, evaluation, genes) is None:
            self.stage.add(keys, evaluation)
        return evaluation

    def _note_gains(self, keys: list[bytes], unknown_keys: list[bytes], compared: Evaluation,
                    objectives: FloatArray) -> None:
        """Note which evaluations of a population found a better feasible individual than before.

        The individuals of a population are evaluated in their order. They are compared as the
        solver compares them; what is noted are the objectives (k, m) as they were computed.
        """
        values = np.where(compared.violation == 0, compared.objectives[:, 0], np.inf)
        best_before = np.minimum.accumulate(np.concatenate([[self._least_noted], values[:-1]]))
        for i in np.flatnonzero(values < best_before):
            self._least_noted = float(values[i])
            self.gains.append((self.count + keys.index(unknown_keys[i]) + 1,
                               float(objectives[i, 0])))

    def _evaluation_for_solver(self, evaluation: Evaluation) -> Evaluation:
        """Return the evaluation of a population as the solver gets it.

        A search that draws lots compares individuals; those that differ by rounding must be equal
        to it, or each processor would go another way. A proof needs all digits.
        """
        if self.solver is not None and not self.solver.uses_chance:
            return evaluation
        return Evaluation(round_to_nine_digits(evaluation.objectives),
                          round_to_nine_digits(evaluation.violation))

    def _remember(self, genes: Genes, compared: Evaluation, objectives: FloatArray) -> None:
        """Keep the best individual, and the least feasible value of each objective.

        Individuals (k, size) are compared as the solver compares them, by `compared`; the best is
        kept with its `objectives` (k, m) as they were computed.
        """
        # The least feasible value of each objective, of whichever individual, is for `Patience`.
        feasible = compared.objectives[compared.violation == 0]
        self.least = np.minimum(self.least, feasible.min(axis=0, initial=np.inf))
        best_row = int(compared.order()[0])
        # The violation comes first: any feasible individual is better than an infeasible one.
        rank = (float(compared.violation[best_row]), float(compared.objectives[best_row, 0]))
        if rank < self._best_compared:
            self._best_compared = rank
            self.best = (rank[0], float(objectives[best_row, 0]))
            self.best_genes = genes[best_row].copy()
            self.best_objectives = objectives[best_row].copy()


def _keys_of_individuals(genes: Genes) -> list[bytes]:
    """Return a key for each individual; equal individuals alone have equal keys."""
    # Eight bits a byte; numbers byte by byte, of which 0 and -0 are the same number.
    rows = np.ascontiguousarray(np.packbits(genes, axis=1) if genes.dtype == np.bool_
                                else genes + genes.dtype.type(0))  # no negative zero
    if not rows.size:
        return [b""] * len(rows)
    keys: list[bytes] = rows.view(f"V{rows.shape[1] * rows.itemsize}")[:, 0].tolist()
    return keys


def _genes_of_key(key: bytes, genome: Genome) -> Genes:
    """Return the individual that has a key."""
    if genome.dtype == np.bool_:
        packed = np.frombuffer(key, dtype=np.uint8)
        return np.unpackbits(packed, count=genome.size).astype(bool)
    return np.frombuffer(key, dtype=genome.dtype).copy()
