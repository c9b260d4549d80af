"""Local refinement after a search: a declared part of its budget, for any solver."""

from __future__ import annotations

import numpy as np

from termsel.core.errors import TermselError
from termsel.data.record.search import Polish
from termsel.selection.problems.base import Evaluation
from termsel.selection.solvers.base import Generation
from termsel.selection.solvers.heuristics.swap import climb, improving_moves
from termsel.selection.solvers.ledger import BudgetSpent, Ledger
from termsel.selection.solvers.observers import Observers

POLISH_SHARE = 3
"""Evaluations of the local refinement, relative to those of the search before it: enough for most
seeds to reach the proven optimum of the embedded problem with one mask of 21 terms.
See docs/evidence/solver-table.md."""

DESCENT = 100_000_000
"""Most genes that the first descent of the local refinement evaluates, in all its individuals,
where no budget of evaluations is given: of thousands of points, one look at all neighbours of a
selection would take hours."""


def refine(ledger: Ledger, rng: np.random.Generator, generation: Generation | None,
           evaluations: int | None, observers: Observers) -> Polish:
    """Climb from the best individual of a ledger, or search around all members of a front.

    Returns the first objective before and after that, and what it took.

    `generation` is the last that the solver yielded, `evaluations` the budget of search and
    refinement together. Without one the refinement takes up to POLISH_SHARE times as many as the
    search; its first descent may take more, up to DESCENT. An observer may end it. The ledger keeps
    the best that is found, and the limit and callback set here. Raises TermselError after a solver
    that found coefficients, which a changed selection would not fit.
    """
    assert ledger.best_genes is not None
    if generation is not None and "coefficients" in generation.details:
        raise TermselError("a local refinement changes the selection, and this solver found "
                           "coefficients for its own", hint="Leave out polish=true.")
    # A budget may be spent within the first generation.
    reached = generation or Generation(0, ledger.best_genes[None], Evaluation(
        ledger.best_objectives[None], np.array([ledger.best[0]])))
    found_objective = ledger.best[1]
    count = ledger.count
    lookups = ledger.lookups
    max_evaluations = (1 + POLISH_SHARE) * count if evaluations is None else evaluations
    ledger.limit = max_evaluations
    if evaluations is None:
        # One look at all neighbours is worth more than the share, however many they are.
        ledger.limit = max(max_evaluations, count + DESCENT // ledger.genome.size)

    def tell() -> None:
        share = min((ledger.count - count) / max(max_evaluations - count, 1), 1.0)
        progress = ledger.progress(reached, share, "local refinement")
        if observers.tell(progress):
            raise BudgetSpent

    ledger.after_evaluation = tell
    try:
        if len(ledger.objectives) == 1:
            start = ledger.best_genes[None]
            for _ in climb(ledger, start, ledger.evaluate(start), rng):
                ledger.limit = max_evaluations  # only the first descent may take more
                if ledger.count >= max_evaluations:
                    break
        else:
            _widen_front(ledger, min(2 * count, max_evaluations))
    except BudgetSpent:  # the limits above, or the deadline
        pass
    return Polish(found_objective, ledger.best[1], ledger.count - count, ledger.lookups - lookups)


def _widen_front(ledger: Ledger, max_evaluations: int) -> None:
    """Evaluate all neighbours of all members of the front until no member is new.

    A front of many objectives has very many members, so this ends at `max_evaluations` evaluations.
    """
    expanded: set[bytes] = set()
    while True:
        # Each member of the front is expanded once; those found meanwhile in the next round.
        new = [genes for genes in ledger.front() if genes.tobytes() not in expanded]
        if not new:
            return
        for genes in new:
            expanded.add(genes.tobytes())
            for around in improving_moves(genes, ledger):
                if ledger.count + len(around) > max_evaluations:
                    return
                ledger.evaluate(around)
