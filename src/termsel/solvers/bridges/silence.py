"""Solvers of others that yield nothing for long: the progress says so, time ends them."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from termsel.guard.alarm import Alarm, TimeUp
from termsel.guard.faults import is_own, name_of
from termsel.solvers.base import Generation, Solver
from termsel.solvers.ledger import Ledger

log = logging.getLogger(__name__)

LONG = 10.0
"""Seconds without a generation and an evaluation after which a solver counts as silent."""

GRACE = 1.0
"""Seconds beyond the deadline that a solver has to yield, before it is ended."""

_EVERY = 0.5


@dataclass
class _Silence:
    solver: Solver
    ledger: Ledger
    tell: Callable[[str], None]
    since: float = 0.0
    count: int = 0
    inside: bool = False
    said: bool = False

    def begin(self) -> None:
        self.since, self.count, self.inside = time.perf_counter(), self.ledger.count, True

    def ring(self) -> None:
        """Say once in the log, and again and again in the progress, how long nothing happened."""
        if self.ledger.count != self.count or not self.inside:
            self.since, self.count = time.perf_counter(), self.ledger.count
        quiet = time.perf_counter() - self.since
        if quiet < LONG:
            return
        self.tell(f"{name_of(self.solver)} has yielded nothing for {quiet:.0f} s")
        if not self.said:
            self.said = True
            log.info("Note: %s has yielded nothing for %.0f s. %s", name_of(self.solver), quiet,
                     "Ctrl-C ends the run." if self.ledger.deadline is None
                     else "The budget of time will end it.")

    def due(self) -> bool:
        """Return whether the solver has no time left; an evaluation that runs is finished."""
        deadline = self.ledger.deadline
        return (self.inside and not self.ledger.busy and deadline is not None
                and time.perf_counter() > deadline + GRACE)


def heard(running: Iterator[Generation], solver: Solver, ledger: Ledger,
          tell: Callable[[str], None]) -> Iterator[Generation]:
    """Yield what a solver yields, and end one of others that is silent when its time is spent.

    Parameters
    ----------
    running : iterator of Generation
    solver : Solver
    ledger : Ledger
        Its deadline is that of the budget.
    tell : callable
        Takes what the progress shows; called in another thread.
    """
    if is_own(type(solver)) and not solver.runs_code_of_users:
        yield from running
        return
    silence = _Silence(solver, ledger, tell)
    try:
        with Alarm(_EVERY, silence.ring, silence.due):
            while True:
                silence.begin()
                generation = next(running, None)
                silence.inside = False
                if generation is None:
                    return
                yield generation
    except TimeUp:
        log.info("Note: %s yielded nothing until its time was spent.", name_of(solver))
