"""How far a study is, and how long the rest takes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from time import monotonic
from typing import Any

from termsel.studies.cells.cell import kind_of
from termsel.studies.cells.journal import CellRecord
from termsel.studies.cells.table import LABELS, WAITING
from termsel.studies.execution.work import STATES

LONG_BESIDE_LOADING = 20.0
"""Seconds of a cell from which on what its process loads first counts little."""


MOST_SLOWNESS = 3.0
"""Largest ratio of the time between cells and their own that is taken for usual: a computer may
have slept."""


@dataclass(frozen=True)
class StudyProgress:
    """State of a study."""

    total: int
    states: Mapping[str, int]  # number of cells by state; "waiting" are those not finished
    seconds_left: float | None = None  # None before a cell tells it
    worst: str = ""  # the worst result so far, if any

    @property
    def finished(self) -> int:
        """The number of cells that are finished, in whatever state."""
        return self.total - self.states.get(WAITING, 0)

    def time_left(self) -> str:
        """Return the time left in words."""
        if self.finished == self.total:
            return "finished"
        if self.seconds_left is None:
            return "time left unknown"
        return f"about {duration_in_words(self.seconds_left)} left"

    def text(self) -> str:
        """Return the states in words."""
        return ", ".join(f"{self.states[state]} {state}" for state in (*STATES, WAITING)
                         if self.states.get(state))


def duration_in_words(seconds: float) -> str:
    """Return a time in words, to the nearest second, minute or tenth of an hour."""
    if seconds < 90:
        return f"{max(seconds, 1):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


class Tally:
    """Counts cells of a study as they end; `cells` are the labels of all, by key."""

    def __init__(self, cells: Mapping[str, Mapping[str, Any]], workers: int,
                 finished: Mapping[str, CellRecord]) -> None:
        """Count the cells that have `finished` before, by key; `workers` run the others."""
        self.cells = cells
        self.workers = workers
        self._states = Counter[str]()
        self._left = Counter(map(kind_of, cells.values()))
        self._times: dict[Any, tuple[int, float]] = {}
        self._worst = (0.0, "")
        # A cell is called by what distinguishes it from the others.
        self._telling = []
        for name in LABELS:
            if len({labels[name] for labels in cells.values()}) > 1:
                self._telling.append(name)
        self._telling = self._telling or ["data"]
        for record in finished.values():
            self._count(record, loads=False)
        # The first cell of each process also loads what it needs, which others find there.
        self._first_left = workers
        self._clock: _Clock | None = None

    def count(self, record: CellRecord) -> None:
        """Count the record of a cell of the study that has ended just now."""
        seconds = record.figures.get("seconds")
        self._count(record, loads=self._first_left > 0)
        if seconds is None:
            return
        if self._clock is not None:
            self._clock.cells += seconds
        self._first_left = max(self._first_left - 1, 0)
        if not self._first_left and self._clock is None:
            self._clock = _Clock(monotonic())

    def _count(self, record: CellRecord, *, loads: bool) -> None:
        """Count the record of a cell that has ended: its state, its time and its accuracy.

        The time of a cell that `loads` what its process needs says little of others, and counts
        only if it is long.
        """
        labels = self.cells[record.cell]
        figures = record.figures
        kind = kind_of(labels)
        self._states[record.state] += 1
        self._left[kind] -= 1
        if "seconds" in figures and (not loads or figures["seconds"] >= LONG_BESIDE_LOADING):
            count, total = self._times.get(kind, (0, 0.0))
            self._times[kind] = (count + 1, total + figures["seconds"])
        # The figure that says most about the accuracy of the result.
        value = next((figures[name] for name in ("predicted", "independent", "check")
                      if figures.get(name) is not None), None)
        if value is not None and value > self._worst[0]:
            name = ", ".join(f"{name} {labels[name]}" if name in ("split", "seed")
                             else str(labels[name]) for name in self._telling)
            self._worst = (value, f"{name}: {value:.3g} px")

    def progress(self) -> StudyProgress:
        """Return the state of the study."""
        waiting = sum(self._left.values())
        return StudyProgress(len(self.cells), {**self._states, WAITING: waiting},
                             self._seconds_left(), self._worst[1])

    def _seconds_left(self) -> float | None:
        """Return the time of cells yet to run [s], of each kind by its own mean, or by that of all.

        None before any cell tells it.
        """
        means = {kind: total / count for kind, (count, total) in self._times.items()}
        if not means:
            return None
        # Kinds without a finished cell are taken to be like the others.
        usual = sum(means.values()) / len(means)
        cells = sum(number * means.get(kind, usual) for kind, number in self._left.items())
        return cells / self.workers * (self._clock.slowness(self.workers) if self._clock else 1.0)


@dataclass
class _Clock:
    """Time since all processes are at work [s], and what the cells that ended since say they took.
    """

    started: float
    cells: float = 0.0

    def slowness(self, workers: int) -> float:
        """Return by what cells take longer than they say: results are sent, kept and shown."""
        if not self.cells:
            return 1.0
        passed = (monotonic() - self.started) * workers
        return min(max(passed / self.cells, 1.0), MOST_SLOWNESS)
