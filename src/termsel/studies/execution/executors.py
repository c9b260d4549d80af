"""Cells run one after the other, or in processes of this machine; Ctrl-C lets them finish."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import parent_process
from types import FrameType

import numpy as np

from termsel.core.files.drivers import claim_process
from termsel.core.isolation.helper import context_of_workers, safe_start
from termsel.data.features import FeatureSet
from termsel.studies.cells.cell import Cell
from termsel.studies.execution.work import Outcome, do, failed_outcome

Stop = Callable[[], bool]
"""Whether no further cell is to begin."""

AHEAD = 2
"""Cells given to each worker at a time, so that none waits for the next one."""

DIED = "the process of this run ended: out of memory, killed, or a fault of compiled code"


@contextmanager
def defer_interrupts(say: Callable[[], None]) -> Iterator[Stop]:
    """Yield a function that shows whether Ctrl-C was pressed; the first one calls `say`.

    A second Ctrl-C interrupts.
    """
    pressed = False

    def note(_number: int, _frame: FrameType | None) -> None:
        """Note the first Ctrl-C, and say that it is heard; raise KeyboardInterrupt at the second.
        """
        nonlocal pressed
        # The second Ctrl-C ends at once.
        if pressed:
            raise KeyboardInterrupt
        pressed = True
        say()

    # Only the main thread gets signals, and what ignores Ctrl-C, as nohup does, goes on.
    if (threading.current_thread() is not threading.main_thread()
            or signal.getsignal(signal.SIGINT) == signal.SIG_IGN):
        yield lambda: False
        return
    before = signal.signal(signal.SIGINT, note)
    try:
        yield lambda: pressed
    finally:
        signal.signal(signal.SIGINT, before)


def run_serially(cells: Sequence[Cell], features: Mapping[str, FeatureSet], stop: Stop
                 ) -> Iterator[Outcome]:
    """Yield the outcomes of cells, run one after the other in this process."""
    for cell in cells:
        if stop():
            return
        yield do(cell, features[cell.data.key])


def run_in_processes(cells: Sequence[Cell], features: Mapping[str, FeatureSet], stop: Stop,
                     workers: int) -> Iterator[Outcome]:
    """Yield the outcomes of cells, run in `workers` processes of this machine, as they end.

    `features` are those of the data by the key that a cell names. Once `stop()` is true no further
    cell begins. A cell that makes its process die fails; the others are run again.
    """
    waiting = deque(cells)
    while waiting and not stop():
        suspects: list[Cell] = []
        yield from _run_in_pool(waiting, features, stop, workers, suspects)
        # A process that dies takes all others of its pool with it. What was under way is then
        # repeated one by one, so that the cell at fault is known by name and fails alone.
        for cell in suspects:
            if stop():
                return
            repeated: list[Cell] = []
            yield from _run_in_pool(deque([cell]), features, stop, 1, repeated)
            if repeated:
                yield failed_outcome(cell.key, DIED)


def _run_in_pool(waiting: deque[Cell], features: Mapping[str, FeatureSet], stop: Stop, workers: int,
                 suspects: list[Cell]) -> Iterator[Outcome]:
    """Yield the outcomes of cells as they end, until all are done or a process dies.

    Cells are taken from `waiting` as they begin. Those under way when a process died are appended
    to `suspects`.
    """
    running: dict[Future[Outcome], Cell] = {}
    with safe_start():  # its locks have a process of their own
        # The environment may have changed since the process that workers are forked from began;
        # what its libraries read as they were imported has not, or each worker imports for itself.
        executor = ProcessPoolExecutor(workers, context_of_workers(_MODULES),
                                       initializer=begin_worker,
                                       initargs=(dict(features), dict(os.environ)))
    with executor as pool:
        try:
            while running or (waiting and not stop()):
                with safe_start():  # the first submission starts the processes
                    while waiting and len(running) < workers * AHEAD and not stop():
                        cell = waiting.popleft()
                        running[pool.submit(_run_in_worker, cell)] = cell
                # As they end, so that the journal has each as soon as possible.
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    outcome = future.result()
                    del running[future]
                    yield outcome
        except BrokenProcessPool:
            suspects += running.values()


_MODULES = (__name__, "termsel.adjustment.dispatchers")
"""What every worker needs: termsel and numba."""

_features: Mapping[str, FeatureSet] = {}


def begin_worker(features: Mapping[str, FeatureSet], environment: Mapping[str, str]) -> None:
    """Make a new process ready: it gets features and environment of the study, and ignores Ctrl-C.
    """
    global _features
    _features = features
    os.environ.clear()
    os.environ.update(environment)
    np.random.seed()  # all that are forked from one process would draw the same
    claim_process()  # no driver of GDAL but termsel's, as on the command line
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the study decides when cells end
    sys.stdout = sys.stderr  # stdout is for the results of the command
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this process when the study is gone: a killed one cannot show its workers."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _run_in_worker(cell: Cell) -> Outcome:
    """Return the outcome of a cell, whose features this process has."""
    return do(cell, _features[cell.data.key])
