"""What a plugin does to its process costs its own cells alone, with one worker too."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import termsel
from termsel import Generation, Solver
from termsel.studies.execution.executors import DIED

SOLVERS = '''
import ctypes, os
from termsel import Generation, Solver

class Plain(Solver):
    """Evaluate a few selections, and print."""
    name = "plain"
    def generations(self, problem, rng):
        print("on stdout")
        os.write(1, b"by the system")
        genes = problem.genome.random(rng, 4)
        yield Generation(0, genes, problem.evaluate(genes))

class Leaving(Plain):
    """End the process."""
    name = "leaving"
    def generations(self, problem, rng):
        os._exit(0)

class Crashing(Plain):
    """Read where nothing is."""
    name = "crashing"
    def generations(self, problem, rng):
        ctypes.string_at(0)
'''
FEW: dict[str, Any] = {"problems": ["poly-terms"], "seeds": 1, "budget": {"evaluations": 60},
                       "options": {"degree": 2}}


def test_a_cell_that_ends_its_process_fails_alone(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "crashing_solvers.py").write_text(SOLVERS)
    monkeypatch.syspath_prepend(tmp_path)
    import crashing_solvers as mine

    solvers = ["random", mine.Leaving, mine.Plain, mine.Crashing]
    study = termsel.compare(solvers=solvers, out=tmp_path / "out", **FEW)
    assert {row["solver"]: (row["state"], row["reason"]) for row in study.rows} == {
        "random": ("done", ""), "plain": ("done", ""), "leaving": ("failed", DIED),
        "crashing": ("failed", DIED)}
    out, err = capfd.readouterr()
    assert out == ""
    assert "on stdout" in err
    assert "by the system" in err


def test_what_no_other_process_can_import_runs_in_this_one() -> None:
    class Here(Solver):
        name = "here"

        def generations(self, problem: Any, rng: Any) -> Iterator[Generation]:
            ran.append(os.getpid())
            genes = problem.genome.random(rng, 4)
            yield Generation(0, genes, problem.evaluate(genes))

    ran: list[int] = []
    rows = termsel.compare(solvers=[Here], **FEW).rows
    assert [row["state"] for row in rows] == ["done"]
    assert ran == [os.getpid()]
