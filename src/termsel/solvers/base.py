"""Public base of solvers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from termsel.measurements.features import BoolArray
from termsel.options import Configurable, Option
from termsel.problems.base import Evaluation, Problem

POLISH = Option("polish", True, "Follow the search by adding, dropping and swapping genes as "
                "long as that helps, again and again from elsewhere. The result says what the "
                "solver found and what this added; its evaluations come on top of the budget.",
                bool)
"""Declared by solvers whose find is to be polished by the run."""


@dataclass(frozen=True, eq=False)
class Generation:
    """A population and how good it is.

    Parameters
    ----------
    index : int
        From 0, the initial population.
    genes : ndarray of bool, shape (p, size)
    evaluation : Evaluation
    details : mapping
        What else an observer may want to draw, such as the empires of the ICA.
    """

    index: int
    genes: BoolArray
    evaluation: Evaluation
    details: Mapping[str, Any] = field(default_factory=dict)


class Solver(Configurable, ABC):
    """A search. Subclasses yield generations; budgets and records are kept by the run."""

    min_objectives: ClassVar[int] = 1
    max_objectives: ClassVar[int] = 1
    default_generations: ClassVar[int | None] = 100
    """Generations of a run without a budget; None for a solver that ends by itself."""

    as_published: ClassVar[bool] = False
    """Whether it is the method of a paper, or a yardstick: asked for by name, it selects from as
    many terms as are determined, where others keep to a share of the equations."""

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
