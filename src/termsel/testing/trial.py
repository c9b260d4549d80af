"""Searches of the checks with a solver."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from termsel.core.errors import TermselError
from termsel.selection.problems.base import Problem
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.ledger import Progress
from termsel.selection.solvers.search import SearchResult, search
from termsel.testing.problems import Counted

GENERATIONS_CHECKED = 4
"""Generations checked if more would not show more."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A solver, and what makes the problem of most checks."""

    solver: Solver
    problem: Callable[[], Problem]

    @property
    def goes_on(self) -> bool:
        """True for a solver that continues until its budget is spent."""
        return not self.solver.ends_by_itself

    def posed(self, problem: Problem) -> Problem:
        """Return a problem with as many objectives as the solver needs."""
        # Solvers of several objectives get the number of genes as a further one.
        while len(problem.objectives) < self.solver.min_objectives:
            problem = Counted(problem)
        return problem

    def takes(self, problem: Problem) -> bool:
        """Return False if the solver refuses the problem."""
        try:
            next(self.few(problem), None)
        except TermselError:
            return False
        return True

    def few(self, problem: Problem, n: int = GENERATIONS_CHECKED) -> Iterator[Generation]:
        """Yield the first generations of a search."""
        yield from islice(
            self.solver.generations(self.posed(problem), np.random.default_rng(1)), n)

    def search(self, problem: Problem, *, seed: int = 1, **budget: Any) -> SearchResult:
        """Search as a run does."""
        return search(self.posed(problem), self.solver, seed=seed, **budget)

    def search_until(self, reached: Callable[[Progress], bool], problem: Problem, *,
                     seed: int = 1, evaluations: int) -> SearchResult:
        """Search as a run does, and end as after Ctrl-C once `reached` is true of the progress.

        The rest of the budget would show nothing more.
        """
        def end_if_reached(progress: Progress) -> None:
            if reached(progress):
                raise KeyboardInterrupt

        return self.search(problem, seed=seed, evaluations=evaluations,
                           observers=[end_if_reached])


def global_states() -> tuple[Any, ...]:
    """Return the states of `random` and `numpy.random`, to be compared.

    Returns
    -------
    tuple
        Equal to another one if neither generator was used between the two calls.

    Examples
    --------
    >>> import random
    >>> from termsel.testing import global_states
    >>> before = global_states()
    >>> global_states() == before
    True
    >>> number = random.random()
    >>> global_states() == before
    False
    """
    name, keys, *others_state = np.random.get_state()
    return random.getstate(), name, np.asarray(keys).tobytes(), tuple(others_state)


@contextmanager
def global_states_kept() -> Iterator[None]:
    """Put the states of `random` and `numpy.random` back afterwards."""
    python = random.getstate()
    numpy = np.random.get_state()
    try:
        yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)
