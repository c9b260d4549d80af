"""Solvers of others that yield nothing for long: the progress and the log say so."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from threading import Event, Thread

from termsel.core.isolation.faults import is_own, name_of
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.ledger import Ledger

log = logging.getLogger(__name__)

SILENT_SECONDS = 10.0
"""Seconds without a generation and an evaluation after which a solver counts as silent."""

_LOOK_SECONDS = 0.5  # seconds between two looks


class _Silence:
    """Says how long a solver has neither yielded nor evaluated, from a thread of its own."""

    def __init__(self, solver: Solver, ledger: Ledger, tell: Callable[[str], None]) -> None:
        self.solver = solver
        self.ledger = ledger
        self.tell = tell
        self.over = Event()
        self.running = True
        self.heard()

    def heard(self) -> None:
        """Note that something has happened."""
        self.since = time.perf_counter()
        self.count = self.ledger.count

    def watch(self) -> None:
        """Watch until the search is over, and say when the solver has yielded nothing for long.

        It is said once in the log, and again and again in the progress.
        """
        logged = False
        while not self.over.wait(_LOOK_SECONDS):
            # Evaluations are a sign of life, too, even where nothing is yielded.
            if self.ledger.count != self.count or not self.running:
                self.heard()
            if (quiet := time.perf_counter() - self.since) < SILENT_SECONDS:
                continue
            message = f"{name_of(self.solver)} has yielded nothing for {quiet:.0f} s"
            if not logged:
                logged = True
                log.info("Note: %s. Ctrl-C ends the run with the best so far.", message)
            self.tell(message)


def warn_of_silence(running: Iterator[Generation], solver: Solver, ledger: Ledger,
                    tell: Callable[[str], None]) -> Iterator[Generation]:
    """Yield what a solver yields, and say when it has yielded nothing for long.

    Nothing but Ctrl-C ends code that neither yields nor evaluates. The ledger counts evaluations;
    `tell` takes what the progress shows, and is called in another thread.
    """
    if is_own(type(solver)):
        yield from running
        return
    silence = _Silence(solver, ledger, tell)
    Thread(target=silence.watch, daemon=True).start()
    try:
        for generation in running:
            silence.running = False  # what takes long now is not the solver
            yield generation
            silence.heard()
            silence.running = True
    finally:
        silence.over.set()
