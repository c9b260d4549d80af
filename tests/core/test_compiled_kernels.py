"""Where compiled code is kept, and what happens where it cannot be."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from termsel.adjustment import dispatchers
from termsel.adjustment.compiled import is_compiled

NO_PLACE = """
from numba.core import caching
caching.CacheImpl._locator_classes = []  # as with a read-only home and a read-only package
import numpy as np
from termsel.adjustment.kernels import needs_compilation
assert needs_compilation()
"""

CALL = """
import numpy as np
from termsel.selection.problems.coverage import hull_areas
print(hull_areas(np.eye(3, 2), np.ones((1, 3), dtype=bool)))
"""


def _with(folder: Path) -> str:
    """Return a search path that begins with a folder."""
    return os.pathsep.join([str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])


def _python(code: str, **more: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True,
                          check=False, timeout=300, env={**os.environ, **more})


@pytest.mark.slow
def test_without_a_place_nothing_is_kept_and_the_user_is_told_once() -> None:
    done = _python(NO_PLACE)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("compiled code cannot be kept here") == 1
    assert "NUMBA_CACHE_DIR" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.0, 0.5, 0.95])
def test_damaged_code_is_compiled_again(share: float, tmp_path: Path) -> None:
    whole = _python(CALL, NUMBA_CACHE_DIR=str(tmp_path))
    assert whole.returncode == 0, whole.stderr
    for kind in ("nbi", "nbc"):
        files = list(tmp_path.rglob(f"*.{kind}"))
        assert files
        sizes = {path: path.stat().st_size for path in files}
        for path in files:
            path.write_bytes(path.read_bytes()[:int(share * sizes[path])])
        again = _python(CALL, NUMBA_CACHE_DIR=str(tmp_path))
        assert again.returncode == 0, again.stderr
        assert again.stdout == whole.stdout
        assert all(path.stat().st_size >= 0.9 * size for path, size in sizes.items())


TELL = """
from own import kernel
from termsel.adjustment.compiled import is_compiled
told = is_compiled(kernel)
kernel(1.0)
print(told, bool(kernel.dispatcher.stats.cache_hits))
"""


@pytest.mark.slow
def test_a_compilation_is_foretold_where_there_will_be_one(tmp_path: Path) -> None:
    source = tmp_path / "own.py"
    source.write_text("from termsel.adjustment.compiled import compile_lazily\n\n\n"
                      "@compile_lazily\ndef kernel(x):\n    return x + 1.0\n")

    def told() -> str:
        return _python(TELL, PYTHONPATH=_with(tmp_path)).stdout.strip()

    assert [told(), told()] == ["False False", "True True"]
    os.utime(source)  # installed again, with the date of today
    assert told() in ("True True", "False False")
    source.write_text(source.read_text().replace("1.0", "2.0"))
    assert [told(), told()] == ["False False", "True True"]


PAIR = """
from typing import NamedTuple
from termsel.adjustment.compiled import compile_lazily


class Pair(NamedTuple):
    x: float


@compile_lazily
def kernel(pair):
    return pair.x
"""


@pytest.mark.slow
def test_code_kept_for_a_class_of_another_name_is_compiled_again(tmp_path: Path) -> None:
    source = tmp_path / "own.py"
    for name in ("Pair", "Twins"):
        source.write_text(PAIR.replace("Pair", name))
        done = _python(f"import own; print(own.kernel(own.{name}(1.0)))",
                       PYTHONPATH=_with(tmp_path))
        assert done.stdout == "1.0\n", done.stderr


COUNTS = """
from termsel.adjustment.compiled import compile_lazily


@compile_lazily
def more(n, by):
    return n + by


@compile_lazily
def counts(m):
    n = 0
    for _ in range(m):
        n = more(n, 2)
    return n
"""


def test_a_counter_that_begins_with_a_constant_is_any_integer(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "counting.py").write_text(COUNTS)
    monkeypatch.syspath_prepend(tmp_path)
    counting = importlib.import_module("counting")
    assert counting.counts(3) == 6
    assert len(counting.more.inner_dispatcher.signatures) == 1


def test_a_part_of_kernels_is_compiled_again_where_python_calls_it(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "parts.py").write_text(COUNTS)
    monkeypatch.syspath_prepend(tmp_path)
    parts = importlib.import_module("parts")
    assert parts.counts(3) == 6
    assert not is_compiled(parts.more)
    assert parts.more(1, 2) == 3
    assert is_compiled(parts.more)


def test_what_others_compile_is_optimised_as_they_ask(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "levels.py").write_text(COUNTS)
    monkeypatch.syspath_prepend(tmp_path)
    levels, asked, seen = importlib.import_module("levels"), numba.config.OPT, set[int]()
    monkeypatch.setattr(dispatchers._Cache, "save_overload",
                        lambda self, sig, data: seen.add(int(numba.config.OPT)))
    assert levels.counts(3) == 6
    assert seen == {min(int(asked), dispatchers.LEVEL)}
    assert numba.config.OPT is asked
    with pytest.raises(numba.TypingError):
        levels.counts("three")
    assert numba.config.OPT is asked


@pytest.mark.slow
def test_a_run_that_may_compile_nothing_says_so() -> None:
    code = ("from termsel.cli.main import cli; cli.main(['run', '--problem', 'poly-terms', "
            "'--strategy', 'as-asked', '--generations', '1'])")
    done = _python(code, NUMBA_DISABLE_JIT="1")
    assert done.returncode == 2, done.stderr
    assert "Error: NUMBA_DISABLE_JIT is set" in done.stderr
    assert "bug" not in done.stderr


READY = """
import sys
from own import kernel
print("ready", flush=True)
sys.stdin.readline()
kernel(1.0)
print(bool(kernel.dispatcher.stats.cache_hits))
"""

LONG = """
import time
from numba.extending import overload
from termsel.adjustment.compiled import compile_lazily


def shift(x):
    pass


@overload(shift)
def _shift(x):
    time.sleep(1.0)  # as long as other code takes to be compiled
    return lambda x: x + 1.0


@compile_lazily
def kernel(x):
    return shift(x)
"""


def test_processes_that_begin_together_compile_once(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(LONG)
    both = [subprocess.Popen(
        [sys.executable, "-c", READY], text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": _with(tmp_path)}) for _ in range(2)]
    for one in both:
        assert one.stdout is not None
        assert one.stdout.readline() == "ready\n"
    for one in both:
        assert one.stdin is not None
        one.stdin.write("go\n")
        one.stdin.flush()
    assert sorted(one.communicate(timeout=300)[0] for one in both) == ["False\n", "True\n"]
    assert not list(tmp_path.rglob("*.lock"))
