"""What commands say: all text goes to the terminal through `echo`, log messages through stderr."""

from __future__ import annotations

import logging
import sys

import click

from termsel.errors import printable


def echo(text: str = "", *, err: bool = False, nl: bool = True) -> None:
    """Print text, printable whatever names and files brought.

    Parameters
    ----------
    text : str
    err : bool
        On stderr.
    nl : bool
        Whether a line end follows.
    """
    click.echo(printable(text), err=err, nl=nl)


class _OnStderr(logging.Handler):
    """Writes to what is stderr at the time: a progress bar puts itself in its place."""

    def emit(self, record: logging.LogRecord) -> None:
        print(printable(self.format(record)), file=sys.stderr)


def show_messages() -> None:
    """Print the log messages of termsel, such as the plan of an enumeration, on stderr."""
    logger = logging.getLogger("termsel")
    if not logger.handlers:
        logger.addHandler(_OnStderr())
        logger.setLevel(logging.INFO)
