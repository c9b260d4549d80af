"""Public base of solvers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from termsel.core.isolation.arrays import difference_from_type
from termsel.core.isolation.calls import Check
from termsel.core.options import Configurable
from termsel.selection.problems.base import Evaluation, Problem, evaluation_fault
from termsel.selection.problems.segments import AnySegment, Bits, Genes

GIVEN = "given"
"""In the place of a solver's name: the genes were given to `termsel.assess`."""


@dataclass(frozen=True, eq=False)
class Generation:
    """A population and its evaluation.

    Parameters
    ----------
    index : int
        From 0, the initial population.
    genes : ndarray, shape (p, size)
        Of the p individuals of the population.
    evaluation : Evaluation
        Objectives and violations of the same individuals.
    details : mapping
        Further values for observers. ``empires``, int, shape (k,), the countries of each empire
        as the ICA counts them, also goes into the history.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> task = termsel.prepare("poly-terms")
    >>> solver = termsel.GeneticAlgorithm(population=20)
    >>> first = next(solver.generations(task.problem, np.random.default_rng(1)))
    >>> first.index, len(first.genes)
    (0, 20)
    """

    index: int
    genes: Genes
    evaluation: Evaluation
    details: Mapping[str, Any] = field(default_factory=dict)


def _generation_fault(_solver: Solver, value: Any, problem: Problem, *_args: Any) -> str | None:
    """Return how a generation is at fault, such as an index below 0; None if it is not.

    It is a clause that follows the name of the method.
    """
    fault = difference_from_type(value, Generation)
    if fault is not None:
        return fault.replace("returned", "yielded")
    if not isinstance(value.index, int) or isinstance(value.index, bool) or value.index < 0:
        return f"yielded the index {value.index!r:.100}; expected a whole number from 0"
    if not isinstance(value.details, Mapping):
        return "yielded details that are no mapping"
    if (counts := value.details.get("empires")) is not None and not (
            isinstance(counts, np.ndarray) and counts.ndim == 1 and counts.dtype.kind in "iu"
            and (counts >= 0).all()):
        return "yielded empires that are not an array of counts"
    # Genes first: an evaluation is held against them.
    if fault := problem.genome.fault(value.genes):
        return f"yielded {fault}"
    if not len(value.genes):
        return "yielded a generation of no individuals"
    return evaluation_fault(problem, value.evaluation, value.genes)


class Solver(Configurable, ABC):
    """A search. Subclasses yield generations; budgets and records are kept by the run.

    All solvers run alike: with the same most terms, the same default budget, and a local
    refinement only where the run declares one.

    Examples
    --------
    >>> import termsel
    >>> class Sampling(termsel.Solver):
    ...     "Random genes, fifty at a time."
    ...     name = "sampling-demo"
    ...     max_objectives = 1
    ...
    ...     def generations(self, problem, rng):
    ...         index = 0
    ...         while True:
    ...             genes = problem.genome.random(rng, 50)
    ...             yield termsel.Generation(index, genes, problem.evaluate(genes))
    ...             index += 1
    >>> result = termsel.run("poly-terms", solver=Sampling(), evaluations=200)
    >>> result.solver
    'sampling-demo'
    """

    kind = "solver"
    guards: ClassVar[Mapping[str, Check | None]] = {"generations": _generation_fault}

    min_objectives: ClassVar[int] = 1
    """Fewest objectives that it takes."""

    max_objectives: ClassVar[int] = 1
    """Most objectives that it takes."""

    segments: ClassVar[tuple[type[AnySegment], ...]] = (Bits,)
    """Types of segments it handles; a run refuses genomes with others."""

    ends_by_itself: ClassVar[bool] = False
    """Whether it needs no budget: without one it runs to its end."""

    can_resume: ClassVar[bool] = True
    """Whether a checkpoint lets its search go on: what takes its time are evaluations."""

    uses_all: ClassVar[bool] = False
    """Whether it uses all terms, so that the problem's limit on them (`max_share`) is none."""

    departures: ClassVar[tuple[str, ...]] = ()
    """In which points it departs from its paper, a sentence each."""

    uses_chance: ClassVar[bool] = True
    """Whether another seed may give another result. A study runs solvers without chance once."""

    @abstractmethod
    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield one generation after another, the initial population first.

        Parameters
        ----------
        problem : Problem
        rng : numpy.random.Generator
            The only source of chance.

        Yields
        ------
        Generation
            The run stops reading when its budget is spent.
        """
