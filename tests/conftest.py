"""What all tests share."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from termsel.cli.main import cli

HERE = Path(__file__).resolve()


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Real data that are not part of the project; tests that need them are skipped without."""
    folder = Path(os.environ.get("TERMSEL_DATA", HERE.parents[2] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("real data are not here; set TERMSEL_DATA to their folder")
    return folder


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str],
         monkeypatch: pytest.MonkeyPatch) -> Callable[..., SimpleNamespace]:
    """Return a function that runs a command line in this process, as a new one takes a second."""
    # A handler left by another test would write to what that one captured.
    monkeypatch.setattr(logging.getLogger("termsel"), "handlers", [])

    def run(*words: object) -> SimpleNamespace:
        with pytest.raises(SystemExit) as stop:
            cli.main([str(word) for word in words], prog_name="termsel")
        out, err = capsys.readouterr()
        return SimpleNamespace(exit_code=stop.value.code, stdout=out, stderr=err)

    return run
