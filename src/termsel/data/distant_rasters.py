"""Rasters that are open in another process, whose GDAL has only the drivers of the list.

A program or notebook of a user keeps all drivers of its GDAL, and a raster that consists of several
files lets GDAL open each of them with any driver: sources of virtual rasters, overviews, masks.
Nothing in such a process can turn drivers off for these files alone. So they are opened in a
process of termsel, and what stands for them here asks that process.
"""

from __future__ import annotations

import atexit
import os
import pickle
import signal
import sys
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import count
from pathlib import Path
from typing import Any, TypeVar

from termsel.core.errors import TermselError
from termsel.core.files.drivers import (
    allow_driver,
    allow_remote,
    allowed_drivers,
    claim_process,
    program_environment,
    remote_allowed,
)
from termsel.core.isolation.helper import Helper, ProcessEndedError

_CHILD = "from termsel.data.distant_rasters import serve; serve({drivers!r}, {remote!r})"

Answer = TypeVar("Answer")

HELPERS: list[Helper] = []
"""Processes that were started."""

_numbers = count()
"""Of the rasters of this process, each of which has a number of its own."""


@dataclass(frozen=True)
class _Question:
    """What the other process is to do with which raster.

    `folder` is that in which the raster was opened, and `settings` are those of `rasterio.Env`.
    """

    number: int
    folder: str
    settings: Mapping[str, Any]
    work: Callable[..., Any]
    values: tuple[Any, ...] = ()
    named: Mapping[str, Any] = field(default_factory=dict)


class DistantRaster:
    """A raster that is open in another process: the attributes and methods of a DatasetReader.

    Functions of rasterio that take a dataset itself need the real one: see `with_dataset`.
    """

    def __init__(self, path: Path | str, helper: Helper) -> None:
        self._path = path
        self._helper = helper
        self._question = partial(_Question, next(_numbers), os.getcwd(), _settings())

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        is_method, value = self._ask(_value_of, name)
        if is_method:
            value = partial(self._ask, _result_of, name)
        setattr(self, name, value)  # a raster open for reading does not change
        return value

    def _ask(self, work: Callable[..., Any], *values: Any, **named: Any) -> Any:
        """Return what a function of a module makes of the dataset and further values."""
        try:
            answer, cause = self._helper.ask(pickle.dumps(self._question(work, values, named)))
        except ProcessEndedError as error:
            raise TermselError("GDAL has ended while it read this raster", file=self._path,
                               hint="Is it complete, and an image? Is there enough memory?"
                               ) from error
        if isinstance(answer, Exception):
            raise answer from cause
        return answer


def with_dataset(raster: Any, work: Callable[..., Answer], *values: Any) -> Answer:
    """Return what a function makes of the dataset itself and further values, where it is open.

    Parameters
    ----------
    raster : rasterio.DatasetReader or DistantRaster
        As `termsel.open_raster` yields it.
    work : callable
        A function of a module, for example one that calls ``rasterio.warp.reproject``. It, the
        values and what it returns travel between processes, so pickle must take them.
    *values : object
    """
    if isinstance(raster, DistantRaster):
        return raster._ask(work, *values)
    return work(raster, *values)


@contextmanager
def open_distant(path: Path | str) -> Iterator[DistantRaster]:
    """Open a raster in another process; it raises the errors of `termsel.open_raster`."""
    raster = DistantRaster(path, _helper(allowed_drivers(), remote_allowed()))
    raster._ask(_opened, path)
    try:
        yield raster
    finally:
        raster._ask(_closed)


def _settings() -> dict[str, Any]:
    """Return the options of the surrounding `rasterio.Env`, such as who asks a server."""
    from rasterio.env import getenv, hasenv

    options = getenv() if hasenv() else {}
    return {key: value for key, value in options.items()
            if isinstance(value, str | int | float | bool)}


@cache
def _helper(drivers: tuple[str, ...], remote: bool) -> Helper:
    with ExitStack() as stack:
        if remote:
            stack.enter_context(allow_remote())
        helper = Helper(_CHILD.format(drivers=drivers, remote=remote),
                        program_environment(os.environ))
    atexit.register(helper.end)
    HELPERS.append(helper)
    return helper


_open_here: dict[int, tuple[Any, ExitStack]] = {}
"""In the other process: the rasters that are open."""


def serve(drivers: tuple[str, ...], remote: bool) -> None:
    """Answer the questions that come on stdin, in a new process."""
    from termsel.data.rasters import require_rasterio

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    claim_process()
    with os.fdopen(os.dup(1), "wb") as answers, ExitStack() as stack:
        # What libraries print is no answer.
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        stack.enter_context(allow_driver(*drivers))
        if remote:
            stack.enter_context(allow_remote())
        stack.enter_context(require_rasterio().Env())
        while True:
            try:
                question = pickle.load(sys.stdin.buffer)
            except EOFError:
                return
            answers.write(_pickled(_answered(question)))
            answers.flush()


def _pickled(answer: tuple[Any, BaseException | None]) -> bytes:
    try:
        return pickle.dumps(answer, protocol=pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        return pickle.dumps((TypeError(f"this cannot leave the process of the raster: {error}"),
                             None))


def _answered(asked: bytes) -> tuple[Any, BaseException | None]:
    """Return the answer to a question, or the error and its cause, which pickle would leave out."""
    from rasterio import Env

    try:
        question = pickle.loads(asked)  # may name a function that this process cannot import
        # Names within a raster count from the folder in which it was opened.
        os.chdir(question.folder)
        with Env(**question.settings):
            subject = question.number if question.work in (_opened, _closed) else \
                _dataset(question.number)
            answer = question.work(subject, *question.values, **question.named)
            return (list(answer) if isinstance(answer, Generator) else answer), None
    except Exception as error:  # noqa: BLE001 - raised again in the process that asked
        return error, error.__cause__


def _dataset(number: int) -> Any:
    from rasterio.errors import RasterioIOError

    if number not in _open_here:
        raise RasterioIOError("the raster is closed")
    return _open_here[number][0]


def _opened(number: int, path: Path | str) -> None:
    from termsel.data.rasters import open_raster

    with ExitStack() as stack:
        raster = stack.enter_context(open_raster(path))
        _open_here[number] = (raster, stack.pop_all())


def _closed(number: int) -> None:
    _, stack = _open_here.pop(number, (None, ExitStack()))
    stack.close()


def _value_of(dataset: Any, name: str) -> tuple[bool, Any]:
    """Return whether an attribute is a method, and its value if it is none."""
    value = getattr(dataset, name)
    return (True, None) if callable(value) else (False, value)


def _result_of(dataset: Any, name: str, *values: Any, **named: Any) -> Any:
    """Return what a method returns."""
    return getattr(dataset, name)(*values, **named)
