"""Work in another process of Python, which may die without taking this one along."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from threading import Lock
from typing import Any


class ProcessEndedError(Exception):
    """The process ended before it answered."""


class Helper:
    """A process that answers one question after the other; after one that ends it, a new one does.

    Parameters
    ----------
    code : str
        What it runs. It reads questions, pickled, from stdin, writes an answer to each to stdout,
        and ends with stdin.
    """

    # Not by multiprocessing: that imports the script of the user once more, and so does its work
    # again where it is not guarded by `if __name__ == "__main__":`.
    def __init__(self, code: str) -> None:
        self._code, self._lock = code, Lock()
        self._child: subprocess.Popen[bytes] | None = None

    def ask(self, question: Any) -> Any:
        """Return the answer to a question. Raises ProcessEndedError where there is none."""
        with self._lock:
            child = self._child = self._child or self._begun()
            assert child.stdin is not None
            assert child.stdout is not None
            answered = False
            try:
                pickle.dump(question, child.stdin)
                child.stdin.flush()
                answer = pickle.load(child.stdout)
                answered = True
            except (OSError, EOFError, pickle.UnpicklingError) as error:  # half an answer is none
                raise ProcessEndedError from error
            finally:
                if not answered:  # nor is one that comes after Ctrl-C
                    self.end()
            return answer

    def end(self) -> None:
        """End the process, if there is one."""
        child, self._child = self._child, None
        if child is not None:
            child.kill()
            child.communicate()

    def _begun(self) -> subprocess.Popen[bytes]:
        path = os.pathsep.join(place or os.getcwd() for place in sys.path)
        return subprocess.Popen([sys.executable, "-c", self._code], stdin=subprocess.PIPE,
                                stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": path})
