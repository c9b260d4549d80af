"""Public base of solvers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from termsel.guard.arrays import of_type
from termsel.guard.calls import Check
from termsel.options import Configurable, Option
from termsel.problems.base import Evaluation, Problem, evaluation_fault
from termsel.problems.segments import AnySegment, Bits, Genes

POLISH = Option("polish", True, "Local refinement after the search: add, drop and swap genes "
                "as long as that helps, from many starts. The result records what it added. Its "
                "evaluations are not part of the budget.",
                bool)
"""Declared by solvers after which the run does a local refinement."""


@dataclass(frozen=True, eq=False)
class Generation:
    """A population and its evaluation.

    Parameters
    ----------
    index : int
        From 0, the initial population.
    genes : ndarray, shape (p, size)
    evaluation : Evaluation
    details : mapping
        Further values for observers, such as the empires of the ICA.
    """

    index: int
    genes: Genes
    evaluation: Evaluation
    details: Mapping[str, Any] = field(default_factory=dict)


def _generation_fault(_solver: Solver, value: Any, problem: Problem, *_args: Any) -> str | None:
    """Return what is wrong with a generation, if anything."""
    what = of_type(value, Generation)
    if what is not None:
        return what.replace("returned", "yielded")
    if not isinstance(value.index, int) or isinstance(value.index, bool) or value.index < 0:
        return f"yielded the index {value.index!r:.100}; expected a whole number from 0"
    if not isinstance(value.details, Mapping):
        return "yielded details that are no mapping"
    if fault := problem.genome.fault(value.genes):
        return f"yielded {fault}"
    return evaluation_fault(problem, value.evaluation, value.genes)


class Solver(Configurable, ABC):
    """A search. Subclasses yield generations; budgets and records are kept by the run."""

    kind = "solver"
    guards: ClassVar[Mapping[str, Check | None]] = {"generations": _generation_fault}

    min_objectives: ClassVar[int] = 1
    max_objectives: ClassVar[int] = 1
    segments: ClassVar[tuple[type[AnySegment], ...]] = (Bits,)
    """Types of segments it handles; a run refuses genomes with others."""

    default_generations: ClassVar[int | None] = 100
    """Generations of a run without a budget; None for a solver that ends by itself."""

    as_published: ClassVar[bool] = False
    """Whether it is the method of a paper, or a yardstick: requested by name, it selects from all
    terms that are determined, while others keep to a fraction of the equations."""

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
