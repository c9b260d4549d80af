"""The process in which rasters of several files are open for a program of the user.

See `termsel.data.distant_rasters`, which asks it.
"""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Generator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from termsel.core.files.apart import answer_channel
from termsel.core.files.drivers import claim_process
from termsel.data.distant_rasters import CLOSE_RASTER, OPEN_RASTER, Question
from termsel.data.rasters import open_raster, require_rasterio

_open_here: dict[int, tuple[Any, ExitStack]] = {}
"""In the other process: the rasters that are open."""


def serve(drivers: tuple[str, ...], remote: bool) -> None:
    """Answer the questions that come on stdin until it ends; a new process runs this."""
    claim_process()
    with answer_channel(drivers, remote) as answers, require_rasterio().Env():
        while True:
            try:
                question = pickle.load(sys.stdin.buffer)
            except EOFError:
                return
            answers.write(_pickle_answer(_answer(question)))
            answers.flush()


def _pickle_answer(answer: tuple[Any, BaseException | None]) -> bytes:
    """Return an answer and its error as bytes; a TypeError in place of one pickle refuses."""
    try:
        return pickle.dumps(answer, protocol=pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        return pickle.dumps((TypeError(f"this cannot leave the process of the raster: {error}"),
                             None))


def _answer(asked: bytes) -> tuple[Any, BaseException | None]:
    """Return the answer to a question and None, or the error and its cause.

    The cause is apart, as pickle leaves it out of an error.
    """
    from rasterio import Env

    try:
        # This fails if the question names a function that this process cannot import.
        question = pickle.loads(asked)
        # Relative names of files count from the folder of the process that asks.
        os.chdir(question.folder)
        with Env(**question.settings):
            answer = _answer_of_dataset(question)
            return (list(answer) if isinstance(answer, Generator) else answer), None
    except Exception as error:  # noqa: BLE001 - raised again in the process that asked
        return error, error.__cause__


def _answer_of_dataset(question: Question) -> Any:
    """Return the result of opening or closing a raster, or of a function of its dataset."""
    if question.work == OPEN_RASTER:
        return _open(question.number, *question.values)
    if question.work == CLOSE_RASTER:
        return _close(question.number)
    assert not isinstance(question.work, str)
    return question.work(_open_dataset_of(question.number), *question.values, **question.named)


def _open_dataset_of(number: int) -> Any:
    """Return the open dataset of a number; raises RasterioIOError if it is closed."""
    from rasterio.errors import RasterioIOError

    if number not in _open_here:
        raise RasterioIOError("the raster is closed")
    return _open_here[number][0]


def _open(number: int, path: Path | str) -> None:
    with ExitStack() as stack:
        raster = stack.enter_context(open_raster(path))
        _open_here[number] = (raster, stack.pop_all())


def _close(number: int) -> None:
    _, stack = _open_here.pop(number, (None, ExitStack()))
    stack.close()
