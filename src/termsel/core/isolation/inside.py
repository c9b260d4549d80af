"""Whose code is running: a plugin's calls of its own code are not guarded again."""

from __future__ import annotations

import os
import threading
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from typing import TypeVar

T = TypeVar("T")

_package: ContextVar[str | None] = ContextVar("package", default=None)


def inside() -> str | None:
    """Return the package whose code is being run, None outside any plugin."""
    return _package.get()


@contextmanager
def code_of(package: str) -> Iterator[None]:
    """Run a block as the code of a package, a top-level module."""
    token = _package.set(package)
    try:
        yield
    finally:
        _package.reset(token)


@contextmanager
def own_code() -> Iterator[None]:
    """Run a block of termsel's own that a plugin calls, and mark what it raises as termsel's."""
    caller = _package.get()
    token = _package.set(None)
    try:
        yield
    except BaseException as error:
        if caller is not None:
            error.of_termsel = True  # type: ignore[attr-defined]
        raise
    finally:
        _package.reset(token)


def is_marked(error: BaseException) -> bool:
    """Return True for an exception of termsel's own code that a plugin called."""
    return getattr(error, "of_termsel", False)


@contextmanager
def surroundings_kept() -> Iterator[None]:
    """Put the working folder and the filters of warnings back after a block."""
    folder = _folder()
    filters = list(warnings.filters)
    try:
        yield
    finally:
        # Else an import that changes them would send the files of a result elsewhere, or turn
        # warnings of termsel into errors.
        if folder is not None and _folder() != folder:
            os.chdir(folder)
        if warnings.filters != filters:
            warnings.resetwarnings()  # tells Python that they changed
            warnings.filters[:] = filters  # type: ignore[index]


def _folder() -> str | None:
    try:
        return os.getcwd()
    except OSError:  # it was deleted
        return None


class TooSlow(Exception):
    """Code was not done in its time; its thread goes on until the program ends."""


def within(seconds: float, call: Callable[[], T], *, soon: float = 0.0,
           tell: Callable[[], None] = lambda: None) -> T:
    """Return what a call returns, which is made in a thread of its own; else raise TooSlow.

    Ctrl-C ends the waiting. After `soon` seconds `tell` is called once.
    """
    done: Future[T] = Future()

    def work() -> None:
        """Call, and hand the value or the error over to the thread that waits."""
        try:
            value = call()
        except BaseException as error:  # noqa: BLE001 - raised again in the thread that waits
            done.set_exception(error)
        else:
            done.set_result(value)

    threading.Thread(target=copy_context().run, args=(work,), daemon=True).start()
    # Two waits, the first until something is told.
    first = min(soon, seconds)
    if first and not wait([done], first).done:
        tell()
    if not wait([done], seconds - first).done:
        raise TooSlow
    return done.result()
