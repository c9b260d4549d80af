"""Cells with code that is not termsel's, run one after the other in a process that may die."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from queue import SimpleQueue
from typing import IO

from termsel.measurements.features import FeatureSet
from termsel.plugins.loading import attempt
from termsel.studies.cells.cell import Cell
from termsel.studies.execution.executors import DIED, Stop
from termsel.studies.execution.work import Outcome, do, failed

# Not by multiprocessing: that imports the script of the user once more, and so runs a study in it
# again that is not guarded by `if __name__ == "__main__":`.
_CHILD = "from termsel.studies.execution.contained import work; work()"


def contained(cells: Sequence[Cell], features: Mapping[str, FeatureSet], stop: Stop
              ) -> Iterator[Outcome]:
    """Yield the outcomes of cells; one that ends the process fails, and the next has a new one.

    Cells with what no other process can import, as classes of a script, run in this one.
    """
    child: subprocess.Popen[bytes] | None = None
    try:
        for cell in cells:
            if stop():
                return
            sent = _sent(cell, features[cell.data.key])
            if sent is None:
                yield do(cell, features[cell.data.key])
                continue
            child = child or _begun()
            try:
                outcome = _answer(child, sent)
            except (OSError, EOFError, pickle.UnpicklingError):  # half an answer is none
                _end(child)
                child, outcome = None, failed(cell.key, DIED)
            yield outcome or do(cell, features[cell.data.key])
    finally:
        if child is not None:
            _end(child)


def _sent(cell: Cell, features: FeatureSet) -> bytes | None:
    """Return a cell and its features as bytes; None where no other process can read them."""
    try:
        sent = pickle.dumps((cell, features))
    except (pickle.PicklingError, AttributeError, TypeError):  # local classes, open files, locks
        return None
    return None if b"__main__" in sent else sent


def _begun() -> subprocess.Popen[bytes]:
    path = os.pathsep.join(place or os.getcwd() for place in sys.path)
    return subprocess.Popen([sys.executable, "-c", _CHILD], stdin=subprocess.PIPE,
                            stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": path})


def _answer(child: subprocess.Popen[bytes], sent: bytes) -> Outcome | None:
    """Return the outcome of a cell in a process; None where that cannot read the cell."""
    assert child.stdin is not None
    assert child.stdout is not None
    pickle.dump(sent, child.stdin)
    child.stdin.flush()
    outcome: Outcome | None = pickle.load(child.stdout)
    return outcome


def _end(child: subprocess.Popen[bytes]) -> None:
    child.kill()
    child.communicate()


def work() -> None:
    """Run the cells that come on stdin, and write their outcomes to stdout, in a new process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the study decides when cells end
    # What plugins print goes to stderr, as in the process of the study.
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)
        waiting: SimpleQueue[bytes] = SimpleQueue()
        threading.Thread(target=_receive, args=(sys.stdin.buffer, waiting), daemon=True).start()
        while True:
            given, _ = attempt(partial(pickle.loads, waiting.get()))
            pickle.dump(None if given is None else do(*given), answers)
            answers.flush()


def _receive(source: IO[bytes], waiting: SimpleQueue[bytes]) -> None:
    """Put what comes into a queue; end this process when that of the study is gone."""
    try:
        while True:
            waiting.put(pickle.load(source))
    finally:
        os._exit(0)
