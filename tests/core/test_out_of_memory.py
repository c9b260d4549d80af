"""Too little memory is no bug: what was too large is said, and what would fit."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from termsel.cli.main import cli
from termsel.core.isolation import memory
from termsel.core.isolation.faults import attribute_errors_to
from termsel.core.isolation.memory import out_of_memory


def _error() -> MemoryError:
    try:
        np.zeros((10**7, 10**7))
    except MemoryError as error:
        return error
    raise AssertionError("this machine has a petabyte")


def test_what_was_too_large_and_what_would_fit_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "_free_bytes", lambda: 4.0 * 2**30)
    error = out_of_memory(_error())
    assert "10,000,000 x 10,000,000" in error.what
    assert "4.0 GiB are free" in error.what
    side = int(str(error.hint).split()[1].replace(",", ""))
    assert 0.75 * 4 * 2**30 < 8 * side**2 < 4 * 2**30
    assert "in place of 10,000,000 would fit" in str(error.hint)


def test_an_error_without_figures_still_says_what_to_do() -> None:
    error = out_of_memory(MemoryError())
    assert "not enough memory" in error.what
    assert "fewer points" in str(error.hint)


def test_a_command_ends_with_code_2(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(*_: object, **__: object) -> None:
        raise _error()

    monkeypatch.setattr("termsel.runs.run.problem_for", failing)
    done = CliRunner().invoke(cli, ["run", "--dataset", "spot-isfahan"])
    assert done.exit_code == 2
    assert "10,000,000 x 10,000,000" in done.output
    assert "bug" not in done.output


def test_a_plugin_is_not_blamed_for_it() -> None:
    class Foreign:
        __module__ = "foreign"

    with pytest.raises(MemoryError), attribute_errors_to(Foreign(), "fit"):
        raise MemoryError


@pytest.mark.skipif(sys.platform != "linux", reason="limits of address space are those of Linux")
def test_a_limit_of_address_space_is_told(tmp_path: Path) -> None:
    script = ("import resource, numpy as np\n"
              "from termsel.core.isolation.memory import out_of_memory\n"
              "resource.setrlimit(resource.RLIMIT_AS, (3 * 2**30, 3 * 2**30))\n"
              "try:\n    np.ones((40_000, 40_000))\n"
              "except MemoryError as error:\n    print(out_of_memory(error))")
    text = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True,
                          check=True, cwd=tmp_path).stdout
    assert "40,000 x 40,000: 11.9 GiB" in text
    free = float(text.split("; ")[1].split()[0])
    assert 0 < free < 3
