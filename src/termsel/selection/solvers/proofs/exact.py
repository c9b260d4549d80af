"""The proven optimum: every selection decided."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from termsel.core.errors import TermselError, amount_in_words
from termsel.core.isolation.parts import value_of_slot as part_of
from termsel.core.options import COUNT, Option
from termsel.core.remedies import Remedy
from termsel.selection.best_subsets import subsets
from termsel.selection.problems.base import EnumerablePart, Problem
from termsel.selection.problems.segments import AnySegment, Bits, Genes, Subset
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.heuristics.swap import neighbour_batches
from termsel.selection.solvers.proofs.exact_features import (
    duration_in_words,
    proof_generations,
    quick_optimum,
)
from termsel.selection.solvers.proofs.proof import (
    TIE,
    Proof,
    count,
    generation_of,
    limits_of,
    prove,
    space_of,
)

log = logging.getLogger(__name__)

QUICK = 1 << 22
"""Subsets that are enumerated for a heuristic's gap: less than a second."""

QUICK_ROWS = 1 << 23
"""Rows of all folds together of which systems are made for it: some have as many folds as rows."""

_REPORT_SHARE = 1 / 200
"""Share of the subsets between two reports. Each costs an evaluation, so no clock decides: the
same search has the same number of evaluations on any machine."""

_REPORT_STATES = 4
"""States between two reports at most: a budget of time ends at a report."""


def gap_to_optimum(problem: Problem, reached: float) -> dict[str, Any] | None:
    """Return the gap between a solution and the proven optimum, if that is known quickly.

    Given the first objective that is reached, it is a certificate with the optimum and the gap,
    relative to the optimum. Returns None if the space cannot be enumerated, has more than QUICK
    subsets or QUICK_ROWS rows, or has nothing feasible.
    """
    try:
        proven = _quick_optimum(problem)
    except TermselError:
        return None
    if proven is None:
        return None
    optimum, decided, space = proven
    if reached < optimum - TIE * abs(optimum):  # what was enumerated is not this criterion
        return None
    return {"optimal": reached <= optimum + TIE * abs(optimum), "subsets": decided, "of": decided,
            "space": space, **gap_of(reached, optimum)}


def _quick_optimum(problem: Problem) -> tuple[float, int, str] | None:
    """Return the least first objective, proven, the number of subsets, and their space in words.

    Returns None if there are too many subsets or equations for a quick proof, or if none is
    feasible.
    """
    systems = problem.row_systems()
    if systems is not None:
        return quick_optimum(problem, systems)
    # A fold has a system of its own, as large as the whole.
    rows = sum(len(subproblem.system.design) * max(1, len(subproblem.folds))
               for subproblem in problem.parts())
    if count(problem) > QUICK or rows > QUICK_ROWS:
        return None
    *_, proof = prove(problem)  # the last state, which is complete
    front = proof.front()
    if not front:
        return None
    evaluation = problem.evaluate(front[-1][None])
    if evaluation.violation[0] > 0:  # enumeration and evaluation differ at a tolerance
        return None
    return (float(evaluation.objectives[0, 0]), proof.decided,
            space_of(problem, proof.parts, None))


def gap_of(reached: float, optimum: float) -> dict[str, float | None]:
    """Return `optimum`, and `gap`: how far `reached` is above it, as a share; None if it is 0."""
    return {"optimum": optimum, "gap": max(0.0, reached / optimum - 1) if optimum > 0 else None}


class Exact(Solver):
    """Every selection enumerated or excluded: the optimum, the best of every size, a proof.

    Branch and bound over all term selections, line and sample separately where they are
    independent; or a walk over all selections of control features. It begins with a descent from
    several starts. At any time it has the best selection, a lower bound of all, and the gap.
    termsel's own formulation; see `termsel.selection.best_subsets.subsets` and
    `termsel.selection.best_subsets.features.walk`.
    """

    name = "exact"
    segments: ClassVar[tuple[type[AnySegment], ...]] = (Bits, Subset)
    uses_chance = False
    ends_by_itself = True
    can_resume = False
    declared_options = (
        Option("max_terms", None, "Most terms per coordinate; by default as many as the problem "
                                  "allows. The proof is of selections up to this size.", int,
               1, COUNT),
        Option("workers", None, "Threads; by default all cores. The result does not depend on "
               "it.", int, 1, 256),
        Option("certificate", False, "Whether the folder of the result (--out) gets the file "
               "certificate.json, the tree of the proof, which `termsel check` verifies; a package "
               "makes it.", bool, from_files=False),
    )

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield the best so far until all is decided (see `Solver.generations`).

        Of many states of a proof only some are reported. How much there is to decide, and how long
        it may take, is logged first. Raises TermselError for a problem that cannot be decided,
        for one that cannot have the certificate that is asked for, and where an evaluation
        contradicts the proof.
        """
        max_terms = self.options["max_terms"]
        workers = self.options["workers"] or os.cpu_count() or 1
        systems = problem.row_systems()
        certify = _certificate_maker(problem, max_terms) if self.options["certificate"] else None
        if systems is not None:
            yield from proof_generations(problem, systems, workers, max_terms)
            return
        subproblems = problem.parts()
        space = space_of(problem, subproblems, max_terms)
        log.info("exact: %s to enumerate or exclude by bounds (%s, %s)%s",
                 amount_in_words(count(problem, max_terms), "subset"), space,
                 amount_in_words(len(subproblems), "part"),
                 _estimate(problem, subproblems, max_terms, workers))
        index, reported, decided = 0, 0.0, 0
        placeholder = np.zeros((1, problem.genome.size), dtype=bool)
        proof: Proof | None = None
        for state, proof in enumerate(prove(problem, max_terms, workers)):
            share = proof.decided / proof.total
            descends = proof.decided == decided  # a step takes a while
            decided = proof.decided
            # Every state is reported at first, at the end, and in descents; of the proof itself one
            # in so many, or whenever enough has been decided.
            if (index and not descends and not proof.complete and state % _REPORT_STATES
                    and share - reported < _REPORT_SHARE):
                continue
            reported = share
            if proof.complete or proof.front():
                generation = generation_of(problem, proof, index, space, placeholder)
                if proof.complete and proof.front():
                    _require_unbeaten(problem, proof, generation, max_terms)
                    if certify is not None:
                        certificate = certify(generation.genes[-1])
                        generation = replace(generation, details={
                            **generation.details, "certificate_content": certificate})
                yield generation
                index += 1


def _certificate_maker(
        problem: Problem, max_terms: int | None) -> Callable[[Genes], dict[str, Any] | None]:
    """Return a function of the optimum's genes that returns its certificate, None without one.

    Raises TermselError where the package of certificates is not installed.
    """
    certifier = part_of("certificate", "a certificate requires")
    rooms = [limits_of(problem, subproblem, max_terms)[1] for subproblem in problem.parts()]
    certify: Callable[[Genes], dict[str, Any] | None] = certifier(problem, rooms)
    return certify


def _require_unbeaten(problem: Problem, proof: Proof, generation: Generation,
                      max_terms: int | None) -> None:
    """Raise TermselError for a proof that an evaluation contradicts.

    The enumeration decides by the criterion's `subset_score` and `subset_cost`, and a plugin's may
    not agree with its `score`. The best selection of every size and all neighbours of the optimum
    are evaluated as any solver's are.
    """
    front = generation.evaluation
    best = front.objectives[-1, 0]
    violation = front.violation[-1]
    if violation > 0:  # enumeration and evaluation differ at a tolerance: nothing is proven
        return
    # Of all sizes, and of the neighbours of the optimum, none may be better than the optimum.
    values = [front.objectives[front.violation == 0, 0]]
    for genes in neighbour_batches(generation.genes[-1], problem.genome):
        if max_terms is not None:  # larger ones are outside of the space that is proven
            sizes = [genes[:, subproblem.genes].sum(axis=1) for subproblem in proof.parts]
            genes = genes[np.all(np.array(sizes) <= max_terms, axis=0)]
        neighbour_evaluation = problem.evaluate(genes)
        values.append(neighbour_evaluation.objectives[neighbour_evaluation.violation == 0, 0])
    lowest = float(np.concatenate(values).min())
    if lowest < best - TIE * abs(best):
        raise TermselError(
            f"the enumeration ends at {best:.6g}, but a selection it passed over has {lowest:.6g}: "
            "the criterion's subset_score does not agree with its score",
            hint="Tell the author of the criterion, or choose another solver, such as "
                 f"{Remedy('solver', 'ga')}.")


def _estimate(problem: Problem, subproblems: tuple[EnumerablePart, ...], max_terms: int | None,
              workers: int) -> str:
    """Return the end of a sentence on how long a proof takes; "" where bounds make that unknown."""
    if any(subsets.is_bounded(subproblem.system, subproblem.score, subproblem.folds)
           for subproblem in subproblems):
        return ""
    seconds = sum(subsets.estimate_seconds(subproblem.system, subproblem.score,
                                           folds=subproblem.folds, workers=workers,
                                           max_terms=limits_of(problem, subproblem, max_terms)[1])
                  for subproblem in subproblems)
    return f"; about {duration_in_words(seconds)}"
