"""The time left that a batch states while it runs."""

from __future__ import annotations

import pytest

from termsel.studies.cells.journal import CellRecord
from termsel.studies.cells.table import LABELS
from termsel.studies.execution.progress import Tally


@pytest.mark.parametrize("workers", [1, 2])
def test_the_first_cell_of_each_process_takes_longer_and_says_less(workers: int) -> None:
    labels = {f"c{i}": dict.fromkeys(LABELS, "x") | {"data": f"{i}.csv"} for i in range(20)}
    tally = Tally(labels, workers, {})
    for i in range(8):
        seconds = 9.0 if i < workers else 2.0
        tally.count(CellRecord(
            cell=f"c{i}", state="done", reason="", figures={"seconds": seconds}, trace=[], front=[]))
        left = tally.progress().seconds_left
        assert left is not None
        # Before any other has ended, nothing else is known.
        usual = 9.0 if i < workers else 2.0
        assert left == pytest.approx(usual * (19 - i) / workers)
