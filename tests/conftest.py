"""What all tests share."""

from __future__ import annotations

import os
import time
from itertools import count
from pathlib import Path

import pytest

HERE = Path(__file__).resolve()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let time pass by a millisecond whenever termsel looks, however busy the machine is."""
    looks = count()
    monkeypatch.setattr(time, "perf_counter", lambda: next(looks) / 1000)


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Real data that are not part of the project; tests that need them are skipped without."""
    folder = Path(os.environ.get("TERMSEL_DATA", HERE.parents[2] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("real data are not here; set TERMSEL_DATA to their folder")
    return folder
