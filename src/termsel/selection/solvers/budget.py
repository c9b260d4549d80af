"""The budget of a search."""

from __future__ import annotations

import time
from dataclasses import dataclass
from numbers import Real

import numpy as np

from termsel.core.errors import TermselError
from termsel.core.options import Option
from termsel.selection.solvers.base import Generation
from termsel.selection.solvers.ledger import Ledger

EVALUATIONS = 16_040
"""Budget of a search that has none, whatever its solver: 80 generations of the genetic algorithm
after its first population."""

IDLE = 1000
"""Generations in a row without an evaluation that end a search, such as those of a loop that breeds
nothing."""

MIN_GAIN = 1e-4
"""Least gain that counts for `Patience`, relative to the objective."""

SEARCH_OPTIONS = (
    Option("polish", None, "Local refinement after any solver, with three quarters of the budget: "
           "genes are added, dropped and swapped as long as that helps. By default on where a "
           "problem runs with its own solver, off where --solver names one.", bool),
    Option("tolerance", MIN_GAIN, "Least gain that counts for --patience, relative to the "
           "objective.", float, 0.0, 1.0),
)
"""Options of every search, whatever its solver."""


def require_limits(*, generations: float | None = None, evaluations: float | None = None,
                   seconds: float | None = None, patience: float | None = None) -> None:
    """Raise TermselError for a limit of a search that is not a positive number.

    All but `seconds` must be whole numbers. None is no limit.
    """
    for name, value in (("generations", generations), ("evaluations", evaluations),
                        ("seconds", seconds), ("generations of patience", patience)):
        if value is not None and (isinstance(value, bool) or not isinstance(value, Real)):
            raise TermselError(f"the budget of {name} is {value!r}, not a number",
                               hint=f"Give a number, or leave {name} out for no limit.")
        if value is not None and not value > 0:
            raise TermselError(f"the budget of {value} {name} is not positive",
                               hint="Give a positive number, or leave it out for no limit.")
        if value is not None and name != "seconds" and value % 1 != 0:
            raise TermselError(f"the budget of {value} {name} is not a whole number",
                               hint="Give a whole number, or leave it out for no limit.")


@dataclass(frozen=True)
class Budget:
    generations: int | None
    evaluations: int | None
    seconds: float | None
    start: float

    @property
    def deadline(self) -> float | None:
        """Time by `time.perf_counter` at which the budget of time is spent; None without one."""
        return None if self.seconds is None else self.start + self.seconds

    def share(self, generation: Generation, ledger: Ledger) -> float | None:
        """Return the spent fraction of the budget that is spent first, 0 to 1.

        Without a budget it is what the solver says, None if it says nothing.
        """
        elapsed = time.perf_counter() - self.start
        shares = [value / limit for value, limit in (
            (generation.index, self.generations), (ledger.count, self.evaluations),
            (elapsed, self.seconds)) if limit is not None]
        # Without limits a solver that ends by itself may say how far it is.
        solver_share = generation.details.get("share")
        return min(1.0, max(shares)) if shares else solver_share

    def spent(self, generation: Generation, ledger: Ledger) -> bool:
        """Return True if no further generation may begin."""
        return ((self.generations is not None and generation.index >= self.generations)
                or (self.evaluations is not None and ledger.count >= self.evaluations)
                or (self.seconds is not None and not ledger.is_replaying
                    and time.perf_counter() - self.start >= self.seconds))


class Patience:
    """Whether a search has converged: so many generations, if any are asked for, without a gain.

    A gain is an objective whose least value among feasible individuals falls by more than a
    tolerance, relative to it; as long as none is feasible, a smaller violation.
    """

    def __init__(self, generations: int | None, tolerance: float) -> None:
        self.generations = generations
        self.tolerance = tolerance
        self.idle = 0
        self.violation = np.inf
        self.least: np.ndarray[tuple[int], np.dtype[np.float64]] | None = None

    def lost(self, ledger: Ledger) -> bool:
        """Count the generation that has just ended; return whether it is the last to wait for.

        A smaller violation or a better objective begins the count again. Without `generations`
        there is no last one.
        """
        if self.generations is None:
            return False
        # A smaller violation, or a better objective, begins the waiting again.
        if self.least is None or ledger.best[0] < self.violation or self._has_gained(ledger):
            self.violation = ledger.best[0]
            self.least = ledger.least.copy()
            self.idle = 0
        else:
            self.idle += 1
        return self.idle >= self.generations

    def _has_gained(self, ledger: Ledger) -> bool:
        """Return whether any objective fell by more than the tolerance since `least`."""
        assert self.least is not None
        # Infinite until an individual is feasible: the first such one is a gain, whatever it has.
        reached = np.isfinite(self.least)
        margin = self.tolerance * np.abs(np.where(reached, self.least, 0.0))
        return bool((ledger.least < self.least - margin).any())
