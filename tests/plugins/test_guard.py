"""The guard of calls into plugins: whose fault it is, and where."""

from __future__ import annotations

import logging
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.core.isolation.calls import without_guards
from termsel.core.isolation.faults import PluginFault
from termsel.models.polynomial import Affine
from termsel.selection.problems.base import Evaluation, Problem, Selection
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.segments import Bits
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.bridges import silence
from termsel.selection.solvers.heuristics.yardsticks import RandomSearch
from termsel.selection.solvers.ledger import Progress
from termsel.selection.solvers.search import search


class Ones(Problem):
    """As many genes on as possible."""

    objectives = ("off",)
    genome = Genome([Bits("s", tuple("abcdef"))])
    change: Callable[[], Any] = staticmethod(lambda: None)

    def evaluate(self, genes: np.ndarray) -> Evaluation:
        self.change()
        return Evaluation((~genes).sum(axis=1)[:, None].astype(float), np.zeros(len(genes)))

    def decode(self, genes: np.ndarray) -> Selection:
        return Selection((), ())


class Own(Problem):
    """A problem that stands for one of termsel's own."""

    objectives = ("off",)
    genome = Ones.genome

    def evaluate(self, genes: np.ndarray) -> Evaluation:
        raise ArithmeticError("a bug of termsel")

    decode = Ones.decode


Own.__module__ = "termsel.own"
Own.evaluate = Own.evaluate.__wrapped__  # type: ignore[attr-defined]


class Once(Solver):
    """Evaluates one population, after what `begin` does."""

    name = "once"
    begin: Callable[[], Any] = staticmethod(lambda: None)

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        self.begin()
        genes = problem.genome.random(rng, 4)
        yield Generation(0, genes, problem.evaluate(genes))


def _solver(begin: Callable[[], Any]) -> Once:
    solver = Once()
    solver.begin = begin  # type: ignore[method-assign]
    return solver


def _line(text: str) -> int:
    source = Path(__file__).read_text().splitlines()
    return next(i for i, line in enumerate(source, 1) if text in line)


def _divide() -> float:
    return 1 / 0  # the line at fault


def test_a_fault_names_the_thing_the_file_and_the_line() -> None:
    with pytest.raises(PluginFault) as caught:
        search(Ones(), _solver(_divide))
    fault = caught.value
    assert fault.what == ("solver 'once' of the module tests failed in generations(): "
                          "ZeroDivisionError: division by zero")
    assert (Path(str(fault.file)).name, fault.line) == ("test_guard.py", _line("# the line at"))
    assert "report it to its author" in str(fault.hint)


def test_what_is_wrong_with_a_value_comes_with_what_was_expected() -> None:
    class Short(Ones):
        def evaluate(self, genes: np.ndarray) -> Evaluation:
            return Evaluation(np.full((len(genes), 1), np.nan), np.zeros(len(genes)))

    with pytest.raises(PluginFault, match=r"evaluate\(\) returned as objectives \d+ numbers that "
                                          r"are not finite; expected finite ones") as caught:
        search(Short(), RandomSearch(population=20), generations=1)
    assert caught.value.line is not None


def test_neighbours_are_guarded_however_they_are_called() -> None:
    class Long(Ones):
        def evaluate_near(self, genes: np.ndarray, near: np.ndarray) -> Evaluation:
            return self.evaluate(np.concatenate([genes, near[None]]))

    class Near(Ones):
        def evaluate_near(self, genes: np.ndarray, near: np.ndarray) -> Evaluation:
            return self.evaluate(genes)

    genes = np.eye(6, dtype=bool)
    for problem in (Near(), Ones()):
        found = problem.evaluate_near(genes, near=genes[0])
        np.testing.assert_array_equal(found.objectives, problem.evaluate(genes=genes).objectives)
    with pytest.raises(PluginFault, match=r"evaluate_near\(\) returned as objectives an array of"):
        Long().evaluate_near(genes=genes, near=genes[0])


def test_errors_of_the_user_and_ctrl_c_pass() -> None:
    def refuse() -> None:
        raise TermselError("too few points", file="a.csv", line=3)

    def stop() -> None:
        raise KeyboardInterrupt

    with pytest.raises(TermselError, match=r"a\.csv, line 3: too few points"):
        search(Ones(), _solver(refuse))
    with pytest.raises(KeyboardInterrupt):
        search(Ones(), _solver(stop))


def test_a_fault_of_termsel_stays_one_within_a_plugin() -> None:
    with pytest.raises(ArithmeticError, match="a bug of termsel"):
        search(Own(), Once())


class _Leaves(BaseException):
    """An exception of a plugin that no `except Exception` stops."""


class _Wordless(BaseException):
    """An exception of a plugin that has no message."""

    def __str__(self) -> str:
        raise ValueError


def _leave(error: BaseException) -> None:
    raise error


@pytest.mark.parametrize(("error", "shown"), [
    (SystemExit(), "SystemExit"), (SystemExit(0), "SystemExit: 0"),
    (_Leaves("away"), "_Leaves: away"), (_Wordless(), "_Wordless: <exception str() failed>"),
    (GeneratorExit(), "GeneratorExit")])
def test_a_plugin_cannot_leave_the_program(error: BaseException, shown: str) -> None:
    with pytest.raises(PluginFault, match=re.escape(f"generations(): {shown}")):
        search(Ones(), _solver(lambda: _leave(error)))


PRINTING = """
import sys, threading
import termsel
from termsel.selection.criteria import CheckRmse

class Mine(CheckRmse):
    name = "mine"
    def score(self, fits):
        return super().score(fits)

def beat():
    while True:
        print("alive")

threading.Thread(target=beat, daemon=True).start()
termsel.run("poly-terms", criterion=Mine, solver="ga", generations=20)
print("done", file=sys.stderr)
"""


@pytest.mark.slow
def test_a_thread_may_print_while_a_plugin_runs() -> None:
    """It ended in a segmentation fault while stdout was exchanged for each call."""
    done = subprocess.run([sys.executable, "-c", PRINTING], stdout=subprocess.DEVNULL,
                          stderr=subprocess.PIPE, text=True, check=False, timeout=300)
    assert (done.returncode, done.stderr.splitlines()[-1]) == (0, "done")


def test_stdout_is_the_same_while_a_plugin_runs() -> None:
    seen: list[Any] = []
    before = sys.stdout
    search(Ones(), _solver(lambda: seen.append(sys.stdout)))
    assert seen == [before]


def test_a_silent_solver_is_named_and_ended_by_ctrl_c(
        monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(silence, "SILENT_SECONDS", 0.1)
    monkeypatch.setattr(silence, "_LOOK_SECONDS", 0.05)
    told = threading.Event()

    class Stuck(Once):
        name = "stuck"

        def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
            yield from super().generations(problem, rng)
            assert told.wait(60)
            raise KeyboardInterrupt

    def observe(progress: Progress) -> None:
        if "solver 'stuck' of the module tests has yielded nothing for" in progress.what:
            told.set()

    with caplog.at_level(logging.INFO, "termsel"):
        found = search(Ones(), Stuck(), observers=[observe])
    assert (found.evaluations, found.interrupted) == (4, True)
    assert caplog.text.count("Ctrl-C ends the run with the best so far.") == 1


def test_a_slow_observer_is_no_silence_of_the_solver(
        monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(silence, "SILENT_SECONDS", 0.1)
    monkeypatch.setattr(silence, "_LOOK_SECONDS", 0.02)
    with caplog.at_level(logging.INFO, "termsel"):
        search(Ones(), Once(), observers=[lambda _progress: time.sleep(0.5)])
    assert "has yielded nothing" not in caplog.text


def test_classes_of_termsel_are_not_wrapped() -> None:
    for cls in (Affine, RandomSearch, termsel.SelectionProblem):
        assert not [name for name, value in vars(cls).items() if hasattr(value, "__wrapped__")]
    assert hasattr(Once.generations, "__wrapped__")


def test_conformance_suites_see_the_plugin_as_it_is() -> None:
    with without_guards(), pytest.raises(ZeroDivisionError):
        next(_solver(_divide).generations(Ones(), np.random.default_rng(1)))


def test_properties_are_guarded() -> None:
    class Twice(Affine):
        """The same names twice."""

        @property
        def terms(self) -> tuple[str, ...]:
            return ("line.num:X", "line.num:X")

    with pytest.raises(PluginFault, match=r"terms\(\) returned .* expected a tuple of different"):
        Twice().terms  # noqa: B018
