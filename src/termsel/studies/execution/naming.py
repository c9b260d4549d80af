"""Warnings about one image of many: they carry its name, and are kept for its notes."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from typing import Any

from termsel.core.errors import IMAGE

_image: ContextVar[str] = ContextVar("image", default="")  # under way in this thread

_MARKS = ("Warning: ", "Note: ")


@contextmanager
def name_image_in_log(image: str) -> Iterator[list[str]]:
    """Put the name of an image into messages of the log; yield a list of its warnings.

    In the list the warnings stand as they were logged, without a mark and the name.
    """
    _name_images()
    warnings: list[str] = []
    # Of warnings of this image alone: others may be read in other threads.
    keeper = _Keeper(warnings, image)
    before = _image.set(image)
    logger = logging.getLogger("termsel")
    logger.addHandler(keeper)
    try:
        yield warnings
    finally:
        logger.removeHandler(keeper)
        _image.reset(before)


class _Keeper(logging.Handler):
    """Keeps the warnings about one image."""

    def __init__(self, warnings: list[str], image: str) -> None:
        super().__init__(logging.WARNING)
        self._warnings = warnings
        self._image = image

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a warning, unless it is about another image of a thread at the same time."""
        if _image.get() != self._image:
            return
        text = record.getMessage()
        for mark in _MARKS:
            text = text.removeprefix(mark)
        text = text.removeprefix(f"{self._image}: ")
        self._warnings.append(f"{text[:1].upper()}{text[1:]}")


@cache  # done once for each process
def _name_images() -> None:
    """Put the name of the image at work into messages of the log from now on."""
    # The factory that others may have set is called first.
    before = logging.getLogRecordFactory()

    def with_name(*args: Any, **kwargs: Any) -> logging.LogRecord:
        """Return a record of the log that begins with the name of the image at work."""
        record = before(*args, **kwargs)
        image = _image.get()
        if image and record.name.startswith("termsel."):
            text = record.getMessage()
            mark = next((mark for mark in _MARKS if text.startswith(mark)), "")
            sentence = text.removeprefix(mark)
            # A reader names its file itself.
            record.msg = text if sentence.startswith(image) else f"{mark}{image}: {sentence}"
            record.args = ()
            setattr(record, IMAGE, image)
        return record

    logging.setLogRecordFactory(with_name)
