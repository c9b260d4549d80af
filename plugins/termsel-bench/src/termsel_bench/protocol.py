"""One protocol for all methods: a set each, judged by independent points that no method sees."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from termsel import TermselError
from termsel.toolkit import FloatArray, one_blas_thread, quiet_logger, require_import, safe_start
from termsel_bench.methods.base import Method
from termsel_bench.scenes.base import BenchSet
from termsel_bench.scenes.catalogue import simulated_set
from termsel_bench.scenes.measured import MEASURED, MeasuredSet, read_measured_set
from termsel_bench.scenes.real import real_set

SEED = 1
"""Seed of every method."""

_RESAMPLES = 400
_CONFIDENCE = 0.95


@dataclass(frozen=True)
class Score:
    """What a method is worth on a set.

    Parameters
    ----------
    method : Method
    set_name, kind : str
    control, independent : int
        Numbers of points: control and check points together, and those that judge.
    rmse, low, high : float
        RMSE of the independent points [px], of a measured set the median of their distances, and
        its interval of 95 % by resampling the points; infinite without a result.
    seconds : float
        Processor time.
    why : str
        Why there is no result, or "".
    """

    method: Method
    set_name: str
    kind: str
    control: int
    independent: int
    rmse: float = math.inf
    low: float = math.inf
    high: float = math.inf
    seconds: float = 0.0
    why: str = ""


@dataclass(frozen=True)
class Work:
    """A method on a set; `real` is the folder of a real set."""

    method: Method
    set_name: str
    real: Path | None = None


def set_of(work: Work) -> BenchSet:
    """Return the set of some work: simulated, or of a folder."""
    return simulated_set(work.set_name) if work.real is None else _read_real_set(work.real)


@lru_cache(maxsize=2)  # each method of a benchmark asks for the same set
def _read_real_set(folder: Path) -> BenchSet:
    """Return the real set in a folder."""
    return real_set(folder)


@one_blas_thread
def score_work(work: Work) -> Score:
    """Return the score of a method on a set; if the method fails, `why` has its message.

    Raises
    ------
    TermselError
        If the set is not the frozen one, or its files are not those it declares.
    """
    if work.real is None and work.set_name.startswith(MEASURED):
        return _score_of_measured(work.method, read_measured_set(work.set_name))
    return score_set(work.method, set_of(work))


@one_blas_thread
def score_set(method: Method, bench_set: BenchSet) -> Score:
    """Return the score of a method on a set; if the method fails, `why` has its message."""
    common = (method, bench_set.name, bench_set.kind, len(bench_set.features.points),
              len(bench_set.independent))
    start = time.process_time()
    try:
        with quiet_logger("termsel", logging.CRITICAL):
            positions = method.positions(bench_set.features, bench_set.independent, SEED)
    except TermselError as error:
        return Score(*common, seconds=time.process_time() - start, why=str(error).split("\n")[0])
    seconds = time.process_time() - start
    squares = ((positions - bench_set.independent.image) ** 2).sum(axis=1)
    # The interval of the mean square is that of the RMSE, squared.
    low, high = np.sqrt(_bootstrap_interval(squares, np.mean))
    return Score(*common, float(np.sqrt(squares.mean())), low, high, seconds)


def _score_of_measured(method: Method, measured_set: MeasuredSet) -> Score:
    """Return the score of a method on a measured set: the median error of the hidden points.

    If the method fails in any fold, the error is infinite, and `why` has its message.
    """
    n = len(measured_set.features.points)
    trials = [measured_set.trial(fold) for fold in range(measured_set.trials)]
    control = min(len(seen.points) for seen, _ in trials)
    common = (method, measured_set.name, measured_set.kind, control, n)
    start = time.process_time()
    distances: list[float] = []
    # A point is hidden in one fold or, in sets of which a trial sees one fold, in all but one.
    try:
        with quiet_logger("termsel", logging.CRITICAL):
            for seen, hidden in trials:
                errors = method.positions(seen, hidden, SEED) - hidden.image
                distances += np.hypot(*errors.T).tolist()
    except TermselError as error:
        return Score(*common, seconds=time.process_time() - start, why=str(error).split("\n")[0])
    seconds = time.process_time() - start
    low, high = _bootstrap_interval(np.array(distances), np.median)
    return Score(*common, float(np.median(distances)), low, high, seconds)


def _bootstrap_interval(
        values: FloatArray, figure: Callable[[FloatArray], Any]) -> tuple[float, float]:
    """Return the interval of 95 % of a figure of values (n, ...), by drawing them with replacement.
    """
    rng = np.random.default_rng(SEED)
    figures = [figure(values[rng.integers(len(values), size=len(values))])
               for _ in range(_RESAMPLES)]
    low, high = np.quantile(figures, [(1 - _CONFIDENCE) / 2, (1 + _CONFIDENCE) / 2])
    return float(low), float(high)


def score_all(methods: Sequence[Method], sets: Iterable[str], real: Sequence[Path] = (), *,
              processes: int = 1, scheduler: str = "") -> Iterator[Score]:
    """Yield the scores of all methods, set by set, as they end.

    Parameters
    ----------
    methods : sequence of Method
    sets : iterable of str
        Names of simulated and measured sets.
    real : sequence of Path
        Folders of real sets.
    processes : int
        On this machine.
    scheduler : str
        Address of a dask scheduler, whose workers have the same packages; "" for none.

    Raises
    ------
    TermselError
        As `score_work`; for an unknown method; if the scheduler does not answer.
    """
    for method in methods:
        method.require()
    works: list[tuple[str, Path | None]] = [(name, None) for name in sets] + [
        (folder.name, folder) for folder in real
    ]
    work = [Work(method, name, folder) for (name, folder), method in product(works, methods)]
    if scheduler:
        yield from _scores_on_cluster(work, scheduler)
    elif processes == 1:
        yield from map(score_work, work)
    else:
        # Processes are not forked, as threads of numba and BLAS do not survive it. The executor
        # starts a process for its locks, and `map` those that compute.
        with safe_start():
            executor = ProcessPoolExecutor(processes, get_context("spawn"))
        with executor as pool:
            with safe_start():
                # All methods of a set go to one process, which then simulates it once.
                scored = pool.map(score_work, work, chunksize=len(methods))
            yield from scored


def _scores_on_cluster(work: Sequence[Work], scheduler: str) -> Iterator[Score]:
    """Yield the scores that the workers of a dask scheduler compute, in the order of the work.

    Raises TermselError if dask is not installed, or the scheduler does not answer in 10 s.
    """
    with require_import("--scheduler requires", "distributed", "distributed"):
        from distributed import Client
    try:
        client = Client(scheduler, timeout=10, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise TermselError(f"the scheduler {scheduler} does not answer",
                           hint="Start it with `dask scheduler` and `dask worker ADDRESS`.",
                           ) from error
    with client:
        for future in client.map(score_work, work, pure=False):
            yield future.result()
