"""Observers of a search, any of which may end it."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from termsel.selection.solvers.ledger import Progress

Observer = Callable[[Progress], bool | None]
"""Takes the progress; True ends the search, and so does StopIteration."""


class Observers:
    """All observers of a search, and whether one of them has ended it."""

    def __init__(self, observers: Iterable[Observer]) -> None:
        self._observers = tuple(observers)
        self.ended = False

    def tell(self, progress: Progress) -> bool:
        """Give the progress to all observers; return whether one of them has ended the search.

        An observer ends it by returning True or raising StopIteration, now or in an earlier call.
        """
        for observe in self._observers:
            try:
                # Observers return all kinds of things, of which only True is an answer.
                self.ended |= observe(progress) is True
            except StopIteration:
                self.ended = True
        return self.ended
