"""The time left that a batch states while it runs."""

from __future__ import annotations

import pytest

from termsel.studies.cells.journal import CellRecord
from termsel.studies.cells.table import LABELS
from termsel.studies.execution.progress import Tally


def batch(workers: int, seconds: list[float]) -> list[float | None]:
    """Return the seconds left after each of the first cells of twenty, which take so long."""
    labels = {f"c{i}": dict.fromkeys(LABELS, "x") | {"data": f"{i}.csv"} for i in range(20)}
    tally = Tally(labels, workers, {})
    left = []
    for i, duration in enumerate(seconds):
        tally.count(CellRecord(cell=f"c{i}", state="done", reason="",
                               figures={"seconds": duration}, trace=[], front=[]))
        left.append(tally.progress().seconds_left)
    return left


@pytest.mark.parametrize("workers", [1, 2])
def test_the_first_cell_of_each_process_loads_and_says_nothing(workers: int) -> None:
    left = batch(workers, [9.0] * workers + [2.0] * 5)
    assert left[:workers] == [None] * workers
    assert left[workers:] == pytest.approx(
        [2.0 * (19 - i) / workers for i in range(workers, workers + 5)])


def test_a_first_cell_of_minutes_tells_the_time_of_the_others() -> None:
    assert batch(1, [100.0, 120.0]) == [1900.0, 110.0 * 18]
