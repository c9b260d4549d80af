"""What commands say: all text goes to the terminal through `echo`, log messages through stderr."""

from __future__ import annotations

import logging
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from copy import copy
from pathlib import Path
from textwrap import shorten
from typing import TextIO

import click

from termsel.core.errors import (
    DOUBT,
    IMAGE,
    ONCE,
    PENDING,
    TermselError,
    count_in_words,
    make_printable,
)

_results: TextIO | None = None
"""What stdout was before `take_stdout`."""


def take_stdout() -> None:
    """Keep stdout for `echo`: all else, such as a plugin, prints on stderr from here on."""
    # Once for a command and not for each call into a plugin, as other threads may be printing.
    global _results
    if _results is None:
        _results = sys.stdout
        sys.stdout = sys.stderr


def give_back_stdout() -> None:
    """Undo `take_stdout`."""
    global _results
    if _results is not None:
        sys.stdout = _results
        _results = None


def stream_of_results() -> TextIO:
    """Return where the results of a command go."""
    return _results or sys.stdout


_pending: list[logging.LogRecord] = []
"""Messages that wait until it shows whether they are needed; see `say_pending`."""


def say_pending() -> None:
    """Print the messages that waited for a result, which is about to be printed."""
    for record in take_pending():
        echo(record.getMessage(), err=True)


def take_pending() -> list[logging.LogRecord]:
    """Return the messages that wait, which then wait no longer."""
    records = [*_pending]
    _pending.clear()
    return records


def say_doubts(error: TermselError) -> None:
    """Print the doubts of the data that wait, before an error, unless it says the same itself."""
    for record in take_pending():
        if getattr(record, PENDING) == DOUBT and "look swapped" not in str(error):
            echo(record.getMessage(), err=True)


def echo(text: str = "", *, err: bool = False, nl: bool = True) -> None:
    """Print text, made printable, with a line end unless `nl` is False.

    It goes to stdout, after doubts that are pending, or to stderr if `err`. An error of stderr,
    such as a full disk, is ignored; one of stdout is raised, as the user must learn that a result
    was not written.
    """
    if not err and _pending:
        say_pending()
    with suppress(OSError) if err else nullcontext():
        click.echo(make_printable(text), file=sys.stderr if err else stream_of_results(), nl=nl)


def stdout_has(text: str) -> bool:
    """Return True if the encoding of stdout has all characters of a text."""
    try:
        # Some streams, as of tests, have no encoding.
        text.encode(getattr(stream_of_results(), "encoding", None) or "utf-8")
    except UnicodeEncodeError:
        return False
    return True


def echo_table(text: str) -> None:
    """Print a table for other programs, unchanged.

    Raises TermselError if the encoding of stdout lacks one of its characters.
    """
    if not stdout_has(text):
        raise TermselError(f"the encoding of stdout, {stream_of_results().encoding}, does not "
                           "have all "
                           "characters of the table",
                           hint="Write to a file with --output, or set PYTHONIOENCODING=utf-8.")
    echo(text, nl=False)


def say_written(files: Iterable[object]) -> None:
    """Say on stderr which files were written."""
    say_pending()
    echo(f"Written: {', '.join(map(str, files))}", err=True)


def refuse_stdout(output: Path) -> None:
    """Raise a TermselError for ``-`` as the name of a file."""
    if str(output) == "-":
        raise TermselError("this command cannot write to stdout", hint="Give --output FILE.")


class _OnStderr(logging.Handler):
    """Writes to what is stderr at the time: a progress bar puts itself in its place."""
    # A library does not print; its messages are shown by the program alone.

    def emit(self, record: logging.LogRecord) -> None:
        if hasattr(record, PENDING):
            _pending.append(record)
            return
        with suppress(OSError):
            print(make_printable(self.format(record)), file=sys.stderr)


@contextmanager
def say_once(noun: str = "image") -> Iterator[None]:
    """Show only the first of many messages of a kind, and at the end how many more there were.

    Messages have their kind as the attribute ONCE, such as a doubt about a DEM that all images of a
    batch share. Notes on images are of a kind if they differ in the name of the image alone; others
    are all shown. Nobody reads the same sentence a hundred times. `noun` is what the images are
    called, such as sheet.
    """
    heard: dict[str, list[logging.LogRecord]] = {}

    def is_first(record: logging.LogRecord) -> bool:
        """Return whether a message is the first of its kind, or has no kind."""
        kind = _kind_of(record)
        if not kind:
            return True
        alike = heard.setdefault(kind, [])
        # A file that is looked at twice is one image.
        images = [getattr(other, IMAGE, "") for other in alike]
        if not (image := getattr(record, IMAGE, "")) or image not in images:
            alike.append(record)
        return record is alike[0]

    # At the handlers: a filter of the logger itself would miss messages of loggers below it.
    handlers = logging.getLogger("termsel").handlers
    for handler in handlers:
        handler.addFilter(is_first)
    try:
        yield
    finally:
        for handler in handlers:
            handler.removeFilter(is_first)
        for first, *others in heard.values():
            if others:
                remark = _remark_on(first, count_in_words(len(others), f"further {noun}"))
                for handler in handlers:
                    handler.handle(remark)


def _kind_of(record: logging.LogRecord) -> str:
    """Return what all messages share of which the first is shown; "" for a message of no kind."""
    image = getattr(record, IMAGE, "")
    text = record.getMessage()
    if hasattr(record, ONCE) or not image or not text.startswith(_NOTE):
        return str(getattr(record, ONCE, ""))
    names = "|".join(re.escape(name) for name in (image, Path(image).name))
    return re.sub(rf"(?<!\w)({names})(?!\w)", "", text)


def _remark_on(first: logging.LogRecord, others: str) -> logging.LogRecord:
    """Return the remark that the first message of a kind is true of others, too.

    It is a record like the first, so that it waits, is printed and is dropped wherever that is.
    """
    remark = copy(first)
    remark.args = ()
    if kind := getattr(first, ONCE, ""):
        remark.msg = f"Note: that on {kind} concerns {others} as well."
        return remark
    image = getattr(first, IMAGE)
    sentence = first.getMessage().removeprefix(_NOTE).removeprefix(f"{image}: ")
    remark.msg = (f"Note: as in {image}, so in {others}: "
                  f"{shorten(sentence.rstrip('.'), _LONGEST_REMINDER, placeholder=' ...')}")
    return remark


_NOTE = "Note: "

_LONGEST_REMINDER = 60
"""Characters of a note that tell which one it is."""


def show_messages() -> None:
    """Print the log messages of termsel, such as the plan of an enumeration, on stderr."""
    logger = logging.getLogger("termsel")
    _pending.clear()  # of an earlier command of this process, as in tests
    if not logger.handlers:
        logger.addHandler(_OnStderr())
        logger.setLevel(logging.INFO)
