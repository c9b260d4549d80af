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
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import count
from pathlib import Path
from typing import Any, TypeVar

from termsel.core.errors import TermselError
from termsel.core.files.drivers import (
    allow_remote,
    allowed_drivers,
    program_environment,
    remote_allowed,
)
from termsel.core.isolation.helper import Helper, ProcessEndedError

_SERVE_RASTERS = "from termsel.data.raster_server import serve; serve({drivers!r}, {remote!r})"

OPEN_RASTER = "open"
CLOSE_RASTER = "close"

Answer = TypeVar("Answer")

HELPERS: list[Helper] = []
"""Processes that were started."""

_numbers = count()
"""Of the rasters of this process, each of which has a number of its own."""


@dataclass(frozen=True)
class Question:
    """What the other process is to do with which raster.

    `work` is a function of the dataset, or `OPEN_RASTER` or `CLOSE_RASTER`. `folder` is that in
    which the raster was opened, and `settings` are those of `rasterio.Env`.
    """

    number: int
    folder: str
    settings: Mapping[str, Any]
    work: Callable[..., Any] | str
    values: tuple[Any, ...] = ()
    named: Mapping[str, Any] = field(default_factory=dict)


class DistantRaster:
    """A raster that is open in another process: the attributes and methods of a DatasetReader.

    Functions of rasterio that take a dataset itself need the real one: see `with_dataset`.
    """

    def __init__(self, path: Path | str, helper: Helper) -> None:
        self._path = path
        self._helper = helper
        # The folder and the options go with each question: both may differ in the other process.
        self._question = partial(Question, next(_numbers), os.getcwd(), _request_settings())

    def __getattr__(self, name: str) -> Any:
        """Return the attribute or method of the raster that has this name.

        Raises AttributeError for a name that begins with "_": copying and pickling ask for such
        names before there is a helper process.
        """
        if name.startswith("_"):
            raise AttributeError(name)
        is_method, value = self._ask(_value_of, name)
        # A method cannot be sent by the helper: each call sends its name instead.
        if is_method:
            value = partial(self._ask, _result_of, name)
        setattr(self, name, value)  # a raster open for reading does not change
        return value

    def _ask(self, work: Callable[..., Any] | str, *values: Any, **named: Any) -> Any:
        """Return the result of a function or method for the dataset and further values.

        The helper process, in which the dataset is open, calls it. An error there is raised here
        again; TermselError is raised if the process has ended.
        """
        try:
            answer, cause = self._helper.ask(pickle.dumps(self._question(work, values, named)))
        except ProcessEndedError as error:
            raise TermselError("GDAL has ended while it read this raster", file=self._path,
                               hint="Copy it again; it is damaged, or larger than the memory."
                               ) from error
        if isinstance(answer, Exception):
            # The cause, which pickle would lose, is what GDAL said.
            raise answer from cause
        return answer


def with_dataset(raster: Any, work: Callable[..., Answer], *values: Any) -> Answer:
    """Return the result of a function of the dataset and further values.

    It is called in the process in which the dataset is open: one call instead of a question for
    each attribute that the function reads.

    Parameters
    ----------
    raster : rasterio.DatasetReader or DistantRaster
        As `termsel.open_raster` yields it.
    work : callable
        A function of a module, for example one that calls ``rasterio.warp.reproject``. It, the
        values and what it returns travel between processes, so pickle must take them.
    *values : object
        Further arguments of `work`, after the dataset.
    """
    if isinstance(raster, DistantRaster):
        return raster._ask(work, *values)  # type: ignore[no-any-return]
    return work(raster, *values)


@contextmanager
def open_distant(path: Path | str) -> Iterator[DistantRaster]:
    """Yield a raster that is open in another process; raises what `termsel.open_raster` raises."""
    raster = DistantRaster(path, _raster_helper(allowed_drivers(), remote_allowed()))
    # Errors of opening are raised before the body runs.
    raster._ask(OPEN_RASTER, path)
    try:
        yield raster
    finally:
        raster._ask(CLOSE_RASTER)


def _request_settings() -> dict[str, Any]:
    """Return the options of the surrounding `rasterio.Env`, such as who asks a server."""
    from rasterio.env import getenv, hasenv

    options = getenv() if hasenv() else {}
    return {key: value for key, value in options.items()
            if isinstance(value, str | int | float | bool)}


@cache  # one process for each set of drivers, ended with this one
def _raster_helper(drivers: tuple[str, ...], remote: bool) -> Helper:
    """Return a new process that reads rasters with such drivers, from servers, too, if `remote`.

    It is cached, and ends with this process.
    """
    with ExitStack() as stack:
        # The helper inherits the permission, which is a state of this process.
        if remote:
            stack.enter_context(allow_remote())
        helper = Helper(_SERVE_RASTERS.format(drivers=drivers, remote=remote),
                        program_environment(os.environ))
    # A helper without its parent would wait for questions for ever.
    atexit.register(helper.end)
    HELPERS.append(helper)
    return helper


def _value_of(dataset: Any, name: str) -> tuple[bool, Any]:
    """Return whether an attribute is a method, and its value if it is none."""
    value = getattr(dataset, name)
    return (True, None) if callable(value) else (False, value)


def _result_of(dataset: Any, name: str, *values: Any, **named: Any) -> Any:
    """Return the result of a method of a dataset."""
    return getattr(dataset, name)(*values, **named)
