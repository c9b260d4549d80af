"""Cells with code that is not termsel's, run one after the other in a process that may die."""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from queue import SimpleQueue
from typing import IO

from termsel.core.files.drivers import claim_process
from termsel.core.isolation.helper import Helper, ProcessEndedError
from termsel.data.features import FeatureSet
from termsel.plugins.loading import run_plugin_code
from termsel.studies.cells.cell import Cell
from termsel.studies.execution.executors import DIED, Stop
from termsel.studies.execution.work import Outcome, do, failed_outcome

_SERVE_CELLS = "from termsel.studies.execution.contained import serve_cells; serve_cells()"


def run_contained(cells: Sequence[Cell], features: Mapping[str, FeatureSet], stop: Stop
                  ) -> Iterator[Outcome]:
    """Yield the outcomes of cells; one that ends the process fails, and the next has a new one.

    Cells with what no other process can import, as classes of a script, run in this one.
    """
    helper = Helper(_SERVE_CELLS)
    try:
        for cell in cells:
            if stop():
                return
            # Bytes are made here, so that what cannot be sent is known before the process is asked.
            sent = _pickle_cell(cell, features[cell.data.key])
            try:
                outcome = None if sent is None else helper.ask(sent)
            except ProcessEndedError:
                outcome = failed_outcome(cell.key, DIED)
            yield outcome or do(cell, features[cell.data.key])
    finally:
        helper.end()


def _pickle_cell(cell: Cell, features: FeatureSet) -> bytes | None:
    """Return a cell and its features as bytes; None where no other process can read them."""
    try:
        sent = pickle.dumps((cell, features))
    except (pickle.PicklingError, AttributeError, TypeError):  # local classes, open files, locks
        return None
    return None if b"__main__" in sent else sent


def serve_cells() -> None:
    """Run the cells that come on stdin, and write their outcomes to stdout, in a new process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the study decides when cells end
    claim_process()  # no driver of GDAL but termsel's, as on the command line
    # What plugins print goes to stderr, as in the process of the study.
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)
        waiting: SimpleQueue[bytes] = SimpleQueue()
        threading.Thread(target=_receive, args=(sys.stdin.buffer, waiting), daemon=True).start()
        while True:
            received, _ = run_plugin_code(partial(pickle.loads, waiting.get()))
            pickle.dump(None if received is None else do(*received), answers)
            answers.flush()


def _receive(source: IO[bytes], waiting: SimpleQueue[bytes]) -> None:
    """Put each object that comes into a queue; end this process when the study's is gone."""
    try:
        while True:
            waiting.put(pickle.load(source))
    finally:
        os._exit(0)
