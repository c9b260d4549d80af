"""Ctrl-C at any time: also where a library swallows it while it is imported or compiles."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")

RESTORED = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
"""Tests in the background of a script ignore Ctrl-C, and what they start would too."""

SWALLOWS = """
import os, signal, time
from contextlib import suppress
from termsel.interrupts import answered, watch

watch()
with suppress(KeyboardInterrupt):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(5)
start = time.monotonic()
try:
    time.sleep(10)
except KeyboardInterrupt:
    print("again", time.monotonic() - start < 5, answered(), answered())
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


def python(code: str, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True,
                          check=False, timeout=60, preexec_fn=RESTORED)


def test_an_interrupt_that_is_swallowed_comes_again_until_it_is_answered() -> None:
    done = python(SWALLOWS)
    assert done.stdout == "again True True False\nquiet\n", done.stderr


def test_an_error_that_a_library_makes_of_an_interrupt_is_an_interrupt() -> None:
    done = python(CONVERTS, "list", "models")
    assert done.returncode == 130
    assert done.stderr == "Interrupted.\n"


@pytest.mark.slow
@pytest.mark.parametrize("after", [0.15, 0.8, 1.4, 2.5])
def test_ctrl_c_ends_a_run_whenever_it_comes(after: float, tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "termsel", "run", "--problem", "poly-terms", "--solver", "random",
         "--seconds", "600", "--out", str(tmp_path / "out")], text=True, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, preexec_fn=RESTORED)
    time.sleep(after)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    # Python may end by the signal itself, which a shell calls 130 too.
    assert process.returncode in (130, -signal.SIGINT)
    # Before it has begun with termsel, it ends as any program does; once a selection is known, the
    # message says that this is the best so far.
    assert "Interrupted" in err or after < 1
    assert "Traceback" not in err or after < 1
