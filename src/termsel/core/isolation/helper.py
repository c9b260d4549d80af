"""Work in another process of Python, which may die without taking this one along."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.context import BaseContext
from threading import Lock, Timer
from typing import Any

SAFE_PATH = "PYTHONSAFEPATH"
"""Variable that keeps Python from putting the current folder first on the path of modules."""


def safe_path() -> list[str]:
    """Return where another process looks for the modules of this one.

    The current folder, if this process looks there at all, comes last: it may have come with data,
    and a file there that is called json.py must not be taken for Python's own.
    """
    try:
        folder = os.path.realpath(os.getcwd())
    except FileNotFoundError:  # somebody has removed it
        folder = ""
    # An empty path stands for the current folder, too.
    other_folders = [path for path in sys.path if path and os.path.realpath(path) != folder]
    return [*other_folders,
            folder] if folder and len(other_folders) < len(sys.path) else other_folders


@contextmanager
def modules_here() -> Iterator[None]:
    """Let a block import modules of the current folder, too, after all others.

    Only a module that the user has named is imported so, and none of that folder takes the place
    of Python's own or of an installed one.
    """
    folder = os.getcwd()
    added = folder not in sys.path
    if added:
        sys.path.append(folder)
    try:
        yield
    finally:
        if added and folder in sys.path:
            sys.path.remove(folder)


@contextmanager
def safe_start() -> Iterator[None]:
    """Start processes by `multiprocessing` that look for modules as `safe_path` says."""
    # Path and variable belong to the whole process: they are put back whatever happens.
    path_before = sys.path[:]
    variable_before = os.environ.get(SAFE_PATH)
    sys.path[:] = safe_path()  # what a process that is spawned gets to know
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        sys.path[:] = path_before
        if variable_before is None:
            del os.environ[SAFE_PATH]
        else:
            os.environ[SAFE_PATH] = variable_before


_READ_ONCE = ("OMP_", "OPENBLAS_", "MKL_", "BLIS_", "NUMBA_")
"""How variables begin that libraries read as they are imported, numbers of threads among them."""

_settings_of_server: dict[str, str] | None = None  # as the process began that is forked


def context_of_workers(modules: Sequence[str]) -> BaseContext:
    """Return how the processes of a pool start: of their own, with modules imported.

    This process is not forked: its threads, those of numba and BLAS among them, would not survive.
    On Linux a process without any imports the modules once and is forked for each worker, which
    saves most of what a worker takes to start. Each imports for itself elsewhere, where there is
    no such process, and where settings have changed that it read as it imported the modules.
    """
    if sys.platform != "linux" or not _fork_server_is_ready(modules):
        return get_context("spawn")
    return get_context("forkserver")


def _fork_server_is_ready(modules: Sequence[str]) -> bool:
    """Start the process that workers are forked from, and return whether its settings are current.

    False also if it cannot be started. Settings are the variables that modules read once, as they
    are imported.
    """
    # Windows has no use for it, and commands without workers need not wait for it.
    from multiprocessing import forkserver

    global _settings_of_server
    settings = {name: value for name, value in os.environ.items() if name.startswith(_READ_ONCE)}
    # Without effect on a process that is running already, as that of an earlier pool.
    get_context("forkserver").set_forkserver_preload(list(modules))
    try:
        forkserver.ensure_running()
    except OSError:  # its socket is in TMPDIR, whose name may be too long for one
        return False
    if _settings_of_server is None:
        _settings_of_server = settings
    return settings == _settings_of_server


class ProcessEndedError(Exception):
    """The process ended before it answered."""


class Helper:
    """A process that answers one question after the other; after one that ends it, a new one does.

    Parameters
    ----------
    code : str
        What it runs. It reads questions, pickled, from stdin, writes an answer to each to stdout,
        and ends with stdin.
    environment : mapping, optional
        Of the process; by default that of this one.
    """

    # Not by multiprocessing: that imports the script of the user once more, and so does its work
    # again where it is not guarded by `if __name__ == "__main__":`.
    def __init__(self, code: str, environment: Mapping[str, str] | None = None) -> None:
        self._code = code
        self._lock = Lock()
        self._environment = environment
        self._child: subprocess.Popen[bytes] | None = None
        self._asks = 0  # the process that has started the child

    def ask(self, question: Any, seconds: float | None = None) -> Any:
        """Return the answer of the process, which is started if it is not running, to a question.

        A process that takes longer than `seconds` is ended. Raises ProcessEndedError where it ends
        before it has answered, whatever the reason.
        """
        with self._lock:
            if self._asks != os.getpid():  # after a fork the answers would go to either process
                self._asks = os.getpid()
                self._child = None
            child = self._child = self._child or self._start_if_needed()
            limit = None if seconds is None else Timer(seconds, child.kill)
            if limit is not None:
                limit.daemon = True
                limit.start()
            assert child.stdin is not None
            assert child.stdout is not None
            # A process that was interrupted between question and answer cannot be asked again: the
            # late answer would be taken for that to the next question.
            answered = False
            try:
                pickle.dump(question, child.stdin)
                child.stdin.flush()
                answer = pickle.load(child.stdout)
                answered = True
            # Half an answer is none.
            except (OSError, EOFError, pickle.UnpicklingError) as error:
                raise ProcessEndedError from error
            finally:
                if limit is not None:
                    limit.cancel()
                if not answered:
                    self.end()
            return answer

    def end(self) -> None:
        """End the process if it runs."""
        child = self._child
        self._child = None
        if child is not None:
            child.kill()
            child.communicate()

    def _start_if_needed(self) -> subprocess.Popen[bytes]:
        """Start the process, which asks for modules in no folder that a user did not name."""
        # Not by PYTHONPATH: Python itself would look for a sitecustomize.py there as it starts.
        first = f"import sys; sys.path[:] = {safe_path()!r}\n"
        return subprocess.Popen([sys.executable, "-P", "-c", first + self._code],
                                stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                env={**(self._environment or os.environ), SAFE_PATH: "1"})
