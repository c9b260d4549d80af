"""The time left that a batch states while it runs."""

from __future__ import annotations

import pytest

from termsel.studies.cells.journal import CellRecord
from termsel.studies.cells.table import LABELS
from termsel.studies.execution.progress import Tally


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return a list whose only number is the time that batches see."""
    now = [0.0]
    monkeypatch.setattr("termsel.studies.execution.progress.monotonic", lambda: now[0])
    return now


def batch(workers: int, seconds: list[float], clock: list[float], between: float = 0.0,
          ) -> list[float | None]:
    """Return the seconds left after each of the first cells of twenty, which take so long.

    Between the end of one and the start of the next some time passes.
    """
    labels = {f"c{i}": dict.fromkeys(LABELS, "x") | {"data": f"{i}.csv"} for i in range(20)}
    tally = Tally(labels, workers, {})
    left = []
    for i, duration in enumerate(seconds):
        clock[0] += (duration + between) / workers
        tally.count(CellRecord(cell=f"c{i}", state="done", reason="",
                               figures={"seconds": duration}, trace=[], front=[]))
        left.append(tally.progress().seconds_left)
    return left


@pytest.mark.parametrize("workers", [1, 2])
def test_the_first_cell_of_each_process_loads_and_says_nothing(
        workers: int, clock: list[float]) -> None:
    left = batch(workers, [9.0] * workers + [2.0] * 5, clock)
    assert left[:workers] == [None] * workers
    assert left[workers:] == pytest.approx(
        [2.0 * (19 - i) / workers for i in range(workers, workers + 5)])


def test_a_first_cell_of_minutes_tells_the_time_of_the_others(clock: list[float]) -> None:
    assert batch(1, [100.0, 120.0], clock) == [1900.0, 110.0 * 18]


def test_the_time_between_cells_counts(clock: list[float]) -> None:
    left = batch(2, [9.0, 9.0] + [2.0] * 6, clock, between=1.0)
    assert left[2:] == pytest.approx([3.0 * (19 - i) / 2 for i in range(2, 8)])
