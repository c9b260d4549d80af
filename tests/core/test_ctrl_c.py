"""Ctrl-C at any time: also where a library swallows it while it is imported or compiles.

``python tests/core/test_ctrl_c.py 300 3`` interrupts 300 runs, each at a random moment of its
first 3 s.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from functools import partial
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

import pytest

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")

RESTORED = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
"""Tests in the background of a script ignore Ctrl-C, and what they start would too."""

SWALLOWS = """
import os, signal, time
from contextlib import suppress
from termsel.core.interrupts import repeat_interrupts, take_pending_interrupt

repeat_interrupts()
with suppress(KeyboardInterrupt):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(5)
try:
    time.sleep(10)
    print("slept")
except KeyboardInterrupt:
    print("again", take_pending_interrupt(), take_pending_interrupt())
time.sleep(1.5)
print("quiet")
"""

CONVERTS = """
import sys, types
import termsel.plugins.commands as commands
from termsel.__main__ import main

class Finder:
    def find_spec(self, name, path, target=None):
        if name == "bad_library":
            import os, signal
            try:
                os.kill(os.getpid(), signal.SIGINT)
            except KeyboardInterrupt:
                raise ImportError("bad_library failed to import") from None

sys.meta_path.insert(0, Finder())
commands.COMMANDS["list"] = ("bad_library:command", "")
main()
"""

UNRAISABLE = """
import os, signal, sys, time
from termsel.core.interrupts import repeat_interrupts

class Cleans:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.1)

repeat_interrupts()
try:
    Cleans()
    time.sleep(10)
except KeyboardInterrupt:
    print("again", file=sys.stderr)
"""

UNCAUGHT = """
import os, signal
import termsel.__main__ as entry
from termsel.cli.main import cli

def late(**_):
    try:
        raise SystemExit(0)
    finally:
        os.kill(os.getpid(), signal.SIGINT)

cli.main = late
entry.main()
"""

AT_THE_END = """
import atexit, os, signal, sys
from termsel.__main__ import main

atexit.register(lambda: os.kill(os.getpid(), signal.SIGINT))
sys.argv[1:] = ["--version"]
main()
"""


UNCAUGHT_BY_MAIN = """
import sys
import termsel.__main__ as entry

sys.excepthook = entry.report_fault
raise KeyboardInterrupt
"""

AFTER_ITS_WORDS = """
import atexit
import termsel.__main__ as entry
from termsel.cli.main import cli

def answers(**_):
    print("all that it has")
    raise SystemExit(130)

cli.main = answers
atexit.register(print, "more")
entry.main()
"""


def python(code: str, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True,
                          check=False, timeout=60, preexec_fn=RESTORED)


@pytest.mark.slow
def test_an_interrupt_that_is_swallowed_comes_again_until_it_is_answered() -> None:
    done = python(SWALLOWS)
    assert done.stdout == "again True False\nquiet\n", done.stderr


def test_an_error_that_a_library_makes_of_an_interrupt_is_an_interrupt() -> None:
    done = python(CONVERTS, "list", "models")
    assert done.returncode == 130
    assert done.stderr == "Interrupted.\n"


def test_an_interrupt_that_python_cannot_raise_comes_again_without_a_word() -> None:
    assert python(UNRAISABLE).stderr == "again\n"


FROM_TEXT = """
import os, signal, sys
import termsel.plugins.commands as commands
from termsel.__main__ import main

class Finder:
    def find_spec(self, name, path, target=None):
        if name == "executes":
            exec("os.kill(os.getpid(), signal.SIGINT)")

sys.meta_path.insert(0, Finder())
commands.COMMANDS["list"] = ("executes:command", "")
sys.argv[1:] = ["list"]
main()
"""


@pytest.mark.parametrize("code", [UNCAUGHT, AT_THE_END, FROM_TEXT, UNCAUGHT_BY_MAIN])
def test_ctrl_c_where_nobody_catches_it_has_the_same_exit_code(code: str) -> None:
    done = python(code)
    assert (done.returncode, done.stderr.strip()) == (130, "Interrupted.")


def test_after_ctrl_c_python_does_no_more_than_to_print() -> None:
    done = python(AFTER_ITS_WORDS)
    assert (done.returncode, done.stdout) == (130, "all that it has\n")


def test_ctrl_c_that_is_ignored_stays_so() -> None:
    done = python("import os, signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
                  + AT_THE_END.replace("main()", "os.kill(os.getpid(), signal.SIGINT); main()"))
    assert (done.returncode, done.stderr) == (0, "")


def ended_by_ctrl_c(after: float, out: Path) -> tuple[str, str]:
    """Return how a run ends that is interrupted after some seconds, and what is on stderr."""
    process = subprocess.Popen(
        [sys.executable, "-m", "termsel", "run", "--problem", "poly-terms", "--solver", "random",
         "--seconds", "0.5", "--out", str(out)], text=True, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, preexec_fn=RESTORED)
    time.sleep(after)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    if process.returncode == 0:
        return "done before", err
    if "termsel/" not in err and "Interrupted" not in err:
        return "before termsel", err  # Python itself starts, and ends as any program of it
    return ("interrupted" if process.returncode == 130 and "Traceback" not in err else
            f"exit code {process.returncode}"), err


@pytest.mark.slow
@pytest.mark.parametrize("after", [0.1, 0.3, 0.6, 1.0, 1.5, 2.5])
def test_ctrl_c_ends_a_run_whenever_it_comes(after: float, tmp_path: Path) -> None:
    how, err = ended_by_ctrl_c(after, tmp_path / "out")
    assert how in ("interrupted", "done before", "before termsel"), err


def main(moments: int, longest: float) -> int:
    """Interrupt runs at random moments, and print how they ended; return how many ended badly."""
    random, found = Random(1), Counter[str]()
    with TemporaryDirectory() as folder:
        for number in range(moments):
            after = random.uniform(0.0, longest)
            how, err = ended_by_ctrl_c(after, Path(folder) / str(number))
            found[how] += 1
            if how.startswith("exit"):
                print(f"after {after:.3f} s: {how}\n{err}", flush=True)
    print(dict(found))
    return sum(count for how, count in found.items() if how.startswith("exit"))


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), float(sys.argv[2])) > 0)
