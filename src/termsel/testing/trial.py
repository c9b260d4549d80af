"""A solver on trial: how the checks let it search."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from termsel.errors import TermselError
from termsel.problems.base import Problem
from termsel.searching import Search, search
from termsel.solvers.base import Generation, Solver

FEW = 4
"""Generations looked at where more would show no more."""

@dataclass(frozen=True, eq=False)
class Trial:
    """A solver, and the problem most checks give it.

    Parameters
    ----------
    solver : Solver
    problem : callable
        Makes the problem.
    """

    solver: Solver
    problem: Callable[[], Problem]

    @property
    def goes_on(self) -> bool:
        """True for a solver that goes on until its budget is spent."""
        return self.solver.default_generations is not None

    def takes(self, problem: Problem) -> bool:
        """Return False if the solver refuses the problem."""
        try:
            next(self.few(problem), None)
        except TermselError:
            return False
        return True

    def few(self, problem: Problem, n: int = FEW) -> Iterator[Generation]:
        """Yield the first generations of a search."""
        yield from islice(self.solver.generations(problem, np.random.default_rng(1)), n)

    def search(self, problem: Problem, *, seed: int = 1, **budget: Any) -> Search:
        """Search as a run does."""
        return search(problem, self.solver, seed=seed, **budget)


def global_states() -> tuple[Any, ...]:
    """Return the states of `random` and `numpy.random`, to be compared."""
    name, keys, *rest = np.random.get_state()
    return random.getstate(), name, np.asarray(keys).tobytes(), tuple(rest)


@contextmanager
def global_states_kept() -> Iterator[None]:
    """Put the states of `random` and `numpy.random` back afterwards."""
    python, numpy = random.getstate(), np.random.get_state()
    try:
        yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)
