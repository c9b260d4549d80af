"""The guard of calls into plugins: whose fault it is, where, and what stays as it was."""

from __future__ import annotations

import logging
import os
import random
import re
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.errors import TermselError
from termsel.guard.calls import unguarded
from termsel.guard.faults import PluginFault
from termsel.guard.isolation import Isolated
from termsel.models.polynomial import Affine
from termsel.problems.base import Evaluation, Problem, Selection
from termsel.problems.genome import Genome
from termsel.problems.segments import Bits
from termsel.solvers.base import Generation, Solver
from termsel.solvers.bridges import silence
from termsel.solvers.heuristics.yardsticks import RandomSearch
from termsel.solvers.search import Search, search


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
    assert "tell its author" in str(fault.hint)


def test_what_is_wrong_with_a_value_comes_with_what_was_expected() -> None:
    class Short(Ones):
        def evaluate(self, genes: np.ndarray) -> Evaluation:
            return Evaluation(np.full((len(genes), 1), np.nan), np.zeros(len(genes)))

    with pytest.raises(PluginFault, match=r"evaluate\(\) returned as objectives \d+ numbers that "
                                          r"are not finite; expected finite ones") as caught:
        search(Short(), RandomSearch(population=20), generations=1)
    assert caught.value.line is not None


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


@pytest.mark.parametrize("end", [sys.exit, lambda: sys.exit(0), os._exit.__class__])
def test_a_plugin_cannot_leave_the_program(end: Callable[[], Any]) -> None:
    with pytest.raises(PluginFault, match=r"generations\(\): (SystemExit|TypeError)"):
        search(Ones(), _solver(end))


def _state() -> tuple[Any, ...]:
    name, keys, *rest = np.random.get_state()
    return (os.getcwd(), list(warnings.filters), np.geterr(), random.getstate(), name,
            np.asarray(keys).tobytes(), tuple(rest), sys.stdout)


def test_what_a_plugin_changes_of_the_process_is_put_back(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def change() -> None:
        os.chdir(tmp_path)
        warnings.simplefilter("error")
        np.seterr(all="raise")
        random.seed(5)
        np.random.seed(5)
        print("hello")

    seen: list[tuple[Any, ...]] = []
    problem = Ones()
    problem.change = lambda: seen.append(_state())  # type: ignore[method-assign]
    before = _state()
    search(problem, _solver(change))
    assert _state() == before
    # termsel's evaluation, which the solver calls, has the state from before as well.
    assert seen[0][:-1] == before[:-1]
    assert capsys.readouterr() == ("", "hello\n")


def test_two_plugins_in_two_threads_leave_the_process_as_it_was(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The first begins first and ends first, so that neither is within the other."""
    begun, both, ended = (threading.Event() for _ in range(3))

    def first() -> None:
        os.chdir(tmp_path)
        random.seed(5)
        begun.set()
        assert both.wait(10)

    def second() -> None:
        warnings.simplefilter("error")
        both.set()
        assert ended.wait(10)
        print("of a plugin")
        worker = threading.Thread(target=print, args=("of its thread",))
        worker.start()
        worker.join()

    before = _state()
    with ThreadPoolExecutor(2) as pool:
        one = pool.submit(search, Ones(), _solver(first))
        assert begun.wait(10)
        other = pool.submit(search, Ones(), _solver(second))
        one.result()
        print("of the program")
        ended.set()
        other.result()
    assert _state() == before
    assert capsys.readouterr() == ("of the program\n", "of a plugin\nof its thread\n")


def test_stdout_is_back_where_the_folder_is_gone(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    before = sys.stdout
    isolated = Isolated("tests")
    isolated.__enter__()
    os.chdir(tmp_path)
    gone.rmdir()
    with pytest.raises(FileNotFoundError):
        isolated.__exit__()
    assert sys.stdout is before
    with Isolated("tests"):
        assert sys.stdout is not before
    assert sys.stdout is before


def test_numbers_from_the_global_generator_are_not_spent() -> None:
    random.seed(3)
    expected = random.random()
    random.seed(3)
    search(Ones(), _solver(random.random))
    assert random.random() == expected


def test_classes_of_termsel_are_not_wrapped() -> None:
    for cls in (Affine, RandomSearch, termsel.SelectionProblem):
        assert not [name for name, value in vars(cls).items() if hasattr(value, "__wrapped__")]
    assert hasattr(Once.generations, "__wrapped__")


@pytest.mark.parametrize("wait", [lambda: time.sleep(60), lambda: _forever()],
                         ids=["sleeps", "computes"])
@pytest.mark.parametrize("in_thread", [False, True], ids=["main thread", "other thread"])
def test_a_silent_solver_ends_with_its_time(
        wait: Callable[[], None], in_thread: bool, monkeypatch: pytest.MonkeyPatch,
        caplog: pytest.LogCaptureFixture) -> None:
    if in_thread and "sleep" in wait.__code__.co_names:
        pytest.skip("only a signal ends a sleep, and signals reach the main thread alone")
    monkeypatch.setattr(silence, "LONG", 0.1)
    monkeypatch.setattr(silence, "GRACE", 0.2)
    monkeypatch.setattr(silence, "_EVERY", 0.1)
    seen: list[str] = []

    class Stuck(Once):
        name = "stuck"

        def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
            yield from super().generations(problem, rng)
            wait()
            seen.append("went on")

    def run() -> Search:
        return search(Ones(), Stuck(), seconds=0.5,
                      observers=[lambda progress: seen.append(progress.what)])

    with caplog.at_level(logging.INFO, "termsel"):
        if in_thread:
            with ThreadPoolExecutor(1) as pool:
                found = pool.submit(run).result()
        else:
            found = run()
    assert "went on" not in seen
    assert found.evaluations == 4
    assert any(re.match(r"solver 'stuck' of the module tests has yielded nothing for \d+ s$", what)
               for what in seen)
    assert "yielded nothing until its time was spent" in caplog.text


def _forever() -> None:
    while True:
        try:
            sum(range(100))
        except Exception:  # noqa: BLE001 - as careless code does
            continue


def test_conformance_suites_see_the_plugin_as_it_is() -> None:
    with unguarded(), pytest.raises(ZeroDivisionError):
        next(_solver(_divide).generations(Ones(), np.random.default_rng(1)))


def test_properties_are_guarded() -> None:
    class Twice(Affine):
        """The same names twice."""

        @property
        def terms(self) -> tuple[str, ...]:
            return ("line.num:X", "line.num:X")

    with pytest.raises(PluginFault, match=r"terms\(\) returned .* expected a tuple of different"):
        Twice().terms  # noqa: B018
