"""What all tests share, those of the plugins too: commands run in this process, BLAS in one thread,
and which cases of a test are slow.

Matrices are small here, and the tests run in several processes. Threads of BLAS beyond the first
wait for each other in busy loops, which on busy cores took twenty times the processor time of the
test itself. It is set before anything imports numpy, and what tests start inherits it.
"""

from __future__ import annotations

import gc
import logging
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import wraps
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
# Modules are compiled once, as those of an installed termsel, and not by each process that a test
# starts.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

MEMORY = pytest.StashKey[Any]()
"""Of the process: what was found of the features of its tests."""


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Let garbage collection wait for the tests, and leave what they are made of out of it.

    Half a million objects stay until the end, which it would count again and again.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.set_threshold(20_000, 20, 20)  # tests leave little, and are many
        gc.enable()


@pytest.hookimpl(tryfirst=True)  # before pytest takes out what `-m` leaves out
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the cases that `slow_cases` lists as slow; an id that no case has is an error."""
    cases: dict[str, set[str]] = {}
    for item in items:
        test, _, case = item.nodeid.partition("[")
        cases.setdefault(test, set()).add(case.removesuffix("]"))
    for item in items:
        test, _, case = item.nodeid.partition("[")
        for mark in item.iter_markers("slow_cases"):
            # One case alone was asked for where only one is there.
            if len(cases[test]) > 1 and (unknown := set(mark.args) - cases[test]):
                raise pytest.UsageError(f"{test}: slow_cases names no case: {sorted(unknown)}")
            if case.removesuffix("]") in mark.args:
                item.add_marker("slow")


@pytest.fixture(autouse=True)
def _remember_between_tests(request: pytest.FixtureRequest) -> Iterator[None]:
    """Let runs share what they found of features, as tests ask for the same few scenes.

    Each run has a memory of its own; a test that replaces code finds everything itself.
    """
    module = sys.modules.get("termsel.auto.memory")
    if module is None:
        yield
        return
    patch = (request.getfixturevalue("monkeypatch") if "monkeypatch" in request.fixturenames
             else None)
    shared = request.config.stash.setdefault(MEMORY, module.Memory(max_answers=500))
    recall = module.Memory.recall

    def changes_code() -> bool:
        """Return whether the test has replaced more than variables and the current folder."""
        return patch is not None and bool(patch._setattr or any(
            mapping is not os.environ for mapping, *_ in patch._setitem))

    @wraps(recall)
    def recall_shared(memory: Any, *args: Any) -> Any:
        shares = memory.max_answers == module.MAX_ANSWERS and not changes_code()
        return recall(shared if shares else memory, *args)

    module.Memory.recall = recall_shared
    yield
    module.Memory.recall = recall


@pytest.fixture(scope="session")
def example_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the files of `termsel example`; whoever writes there takes a copy.

    They take two seconds to make, so that the processes of a run of tests share them.
    """
    from termsel.io.example import write_example  # only now, as it imports numpy

    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "files of example"
    if not shared.exists():
        made = tmp_path_factory.mktemp("example") / "files"
        write_example(made)
        with suppress(OSError):  # another process was first
            made.rename(shared)
    return shared


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Iterator[Callable[..., SimpleNamespace]]:
    """Return a function that runs a command line in this process, as a new one takes a second."""
    from termsel.cli.main import cli  # only now, as it imports numpy

    def run(*words: object) -> SimpleNamespace:
        with pytest.raises(SystemExit) as stop:
            cli.main([str(word) for word in words], prog_name="termsel")
        out, err = capsys.readouterr()
        return SimpleNamespace(exit_code=stop.value.code, stdout=out, stderr=err)

    # A handler left by another test would write to what that one captured. This changes nothing of
    # what is found of features, unlike the fixture monkeypatch.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(logging.getLogger("termsel"), "handlers", [])
        yield run
