"""Cells run by the workers of a dask scheduler."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from queue import Empty, Queue
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from termsel import FeatureSet, TermselError
from termsel.toolkit import registry
from termsel.toolkit.runs import package_versions
from termsel.toolkit.studies import AHEAD, DIED, Cell, Outcome, Stop, do, failed_outcome

if TYPE_CHECKING:
    from distributed import Client, Future

log = logging.getLogger(__name__)

PATIENCE = 60.0
"""Seconds to wait for a scheduler or for workers, at the beginning and when they are lost."""

_LOOK_SECONDS = 1.0
"""Seconds between looks at whether Ctrl-C was pressed and whether the scheduler is there."""

_MAX_LOSSES = 5
"""Times in a row that a scheduler may be lost before any further cell is finished."""


def run_on_cluster(cells: Sequence[Cell], features: Mapping[str, FeatureSet], stop: Stop,
                   address: str, plugins: Mapping[str, str]) -> Iterator[Outcome]:
    """Yield the outcomes of cells, run by the workers of a scheduler, as they end.

    `termsel.compare` calls it if ``scheduler`` is given.

    Parameters
    ----------
    cells : sequence of Cell
        The runs of a study.
    features : mapping of str to FeatureSet
        The features of all cells by the key of their data, `Cell.data.key`.
    stop : Stop
        Budget of each run.
    address : str
        Address of the scheduler, such as "tcp://host:8786".
    plugins : mapping of str to str
        Versions of the distributions that every worker needs, besides termsel and its packages.

    Yields
    ------
    Outcome
        One of each cell that ended; cells that had not begun when `stop` returned True have none.

    Raises
    ------
    TermselError
        If `address` is none, a worker lacks a package or has another version of it, no scheduler
        with workers answers within a minute, or it was lost five times in a row.

    Examples
    --------
    >>> import termsel
    >>> study = termsel.compare(problems=["poly-terms"], solvers=["random"], seeds=range(20),
    ...                         scheduler="tcp://host:8786")  # doctest: +SKIP
    """
    required = {**package_versions(), **plugins}
    waiting = deque(cells)
    fruitless = 0
    while waiting and not stop():
        before = len(waiting)
        client = _connect(address)
        running: dict[Future, Cell] = {}
        try:
            # Workers with other versions would compute something else, or nothing.
            for worker, versions_of_worker in sorted(
                client.run(installed_versions, tuple(required)).items()
            ):
                require_same_versions(required, versions_of_worker, worker)
            yield from _submit_cells(client, waiting, running, features, stop, required)
        except OSError as error:
            log.warning("The scheduler %s was lost: %s", address, error)
        finally:
            # A scheduler that is lost does not answer to the end of a client either.
            client.close(timeout=5)
        # A scheduler that is started again knows nothing of the cells that it was running.
        waiting.extendleft(running.values())
        # A scheduler that finishes some cells between its losses is tried again and again.
        fruitless = fruitless + 1 if len(waiting) == before else 0
        if fruitless == _MAX_LOSSES:
            raise TermselError(f"the scheduler {address} was lost {fruitless} times in a row",
                               hint="Look at its log. The finished runs are kept.")


def _connect(address: str) -> Client:
    """Return a client of the scheduler at an address, once it answers and has a worker.

    The first failed trial is told by a warning. Raises TermselError if the text is no address with
    a port, or after `PATIENCE` seconds without a worker.
    """
    from distributed import Client

    no_address = TermselError(f"{address!r} is no address of a scheduler",
                              hint="Write --scheduler tcp://host:8786.")
    # For an address without a port, a client of dask would wait, then fail in its own words.
    if not _has_port(address):
        raise no_address
    until = time.monotonic() + PATIENCE
    has_warned = False
    while True:
        try:
            client = Client(address, timeout=5, set_as_default=False)
            client.wait_for_workers(1, timeout=max(until - time.monotonic(), 1))
        except ValueError as error:
            raise no_address from error
        except (OSError, TimeoutError) as error:
            if time.monotonic() > until:
                raise TermselError(
                    f"the scheduler {address} does not answer or has no workers",
                    hint="Start it with `dask scheduler` and `dask worker ADDRESS`. The finished "
                         "runs are kept.") from error
            if not has_warned:
                log.warning("Waiting for the scheduler %s and its workers.", address)
                has_warned = True
            time.sleep(_LOOK_SECONDS)
        else:
            return client


def _has_port(address: str) -> bool:
    """Return whether an address states a port; False also for a text that is no address."""
    try:
        return urlsplit("//" + address.rpartition("://")[2]).port is not None
    except ValueError:
        return False


def require_same_versions(required: Mapping[str, str], installed: Mapping[str, str | None],
                          worker: str) -> None:
    """Raise TermselError unless a worker has each required package in exactly the required version.

    `required` and `installed` are versions by the name of the package, None for one that is not
    installed. `worker` is the address of the worker, for the message.
    """
    for name, version in required.items():
        if installed.get(name) is None:
            raise TermselError(f"the worker {worker} lacks {name}, which the study needs",
                               hint=f"Install {name} {version} there, then repeat the command.")
        if installed[name] != version:
            raise TermselError(
                f"the worker {worker} has {name} {installed[name]}, this machine {version}",
                hint="Install the same version on both: results may differ between versions.")


@cache  # The installation does not change while the process runs.
def installed_versions(names: tuple[str, ...]) -> dict[str, str | None]:
    """Return the versions of the named packages and plugins in this process, by their names.

    It is None for one that is not installed, and for one that is neither a package that termsel
    records nor a plugin of it.
    """
    packages: dict[str, Any] = package_versions()
    plugins = {plugin.distribution: plugin.version for plugin in registry().plugins}
    return {name: packages.get(name, plugins.get(name)) for name in names}


def _submit_cells(client: Client, waiting: deque[Cell], running: dict[Future, Cell],
                  features: Mapping[str, FeatureSet], stop: Stop, required: Mapping[str, str]
                  ) -> Iterator[Outcome]:
    """Yield the outcomes of cells as they end, of some only if the scheduler is lost.

    Cells move from `waiting` to `running`, and leave `running` as they end: after a loss, both hold
    what is to be run again. `stop` returns whether no further cell is to begin. Raises the
    TermselError of a worker whose versions differ from `required`.
    """
    from distributed.scheduler import KilledWorker

    # The features are tasks of their own, with their checksum as the key. So they travel once to
    # each worker that needs them, and the scheduler sends them again if such a worker is lost.
    data = {key: client.submit(_keep_on_workers, feature_set, key=f"termsel-features-{key}",
                               pure=True)
            for key, feature_set in features.items()}
    ended: Queue[Future] = Queue()
    while running or (waiting and not stop()):
        # A few cells for each thread wait at the scheduler, so that no worker is idle.
        ahead = AHEAD * max(sum(client.nthreads().values()), 1)
        while waiting and len(running) < ahead and not stop():
            cell = waiting.popleft()
            future = client.submit(_run_on_worker, cell, data[cell.data.key], dict(required),
                                   pure=False,
                                   key=f"termsel-cell-{cell.key}-{time.monotonic_ns()}")
            running[future] = cell
            future.add_done_callback(ended.put)
        try:
            future = ended.get(timeout=_LOOK_SECONDS)
        except Empty:
            continue
        # The scheduler was lost, and all other cells and the data with it.
        if future.status in ("cancelled", "lost"):
            return
        cell = running.pop(future)
        error = future.exception() if future.status == "error" else None
        if error is None:
            yield future.result()
        elif isinstance(error, KilledWorker):
            # Each of several workers ended as it ran the cell.
            yield failed_outcome(cell.key, DIED)
        # An error of termsel, such as other versions on a worker, ends the study.
        elif isinstance(error, TermselError):
            raise error
        else:
            yield failed_outcome(cell.key, f"{type(error).__name__}: {error}")


def _keep_on_workers(features: FeatureSet) -> FeatureSet:
    """Return the features unchanged: a task whose result dask keeps on the workers."""
    return features


def _run_on_worker(cell: Cell, features: FeatureSet, required: Mapping[str, str]) -> Outcome:
    """Return the outcome of a cell, run on this worker.

    Raises TermselError if the versions on the worker differ from those of `required`.
    """
    from distributed import get_worker

    require_same_versions(required, installed_versions(tuple(required)), get_worker().address)
    return do(cell, features)
