"""Whose code is running: a plugin's calls of its own code are not guarded again."""

from __future__ import annotations

import os
import threading
import warnings
from collections.abc import Callable
from concurrent.futures import Future, wait
from contextvars import ContextVar, Token, copy_context
from typing import TypeVar

T = TypeVar("T")

_package: ContextVar[str | None] = ContextVar("package", default=None)


def inside() -> str | None:
    """Return the package whose code is being run, None outside any plugin."""
    return _package.get()


class Inside:
    """Runs a block as the code of a package, a top-level module."""

    __slots__ = ("package", "token")

    def __init__(self, package: str) -> None:
        self.package = package

    def __enter__(self) -> None:
        self.token = _package.set(self.package)

    def __exit__(self, *error: object) -> None:
        _package.reset(self.token)


class Returned:
    """Runs a block of termsel's own code that a plugin calls.

    Exceptions that leave the block are marked as termsel's own, not the plugin's.
    """

    __slots__ = ("token",)

    def __enter__(self) -> None:
        self.token: Token[str | None] = _package.set(None)

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        called_by_plugin = self.token.old_value not in (None, Token.MISSING)
        _package.reset(self.token)
        if error is not None and called_by_plugin:
            error.of_termsel = True  # type: ignore[attr-defined]


def is_marked(error: BaseException) -> bool:
    """Return True for an exception that left a block of `Returned`."""
    return getattr(error, "of_termsel", False)


class Surroundings:
    """Puts the working folder and the filters of warnings back after a block."""

    def __enter__(self) -> None:
        self.folder = _folder()
        self.filters = list(warnings.filters)

    def __exit__(self, *error: object) -> None:
        # Else an import that changes them would send the files of a result elsewhere, or turn
        # warnings of termsel into errors.
        if self.folder is not None and _folder() != self.folder:
            os.chdir(self.folder)
        if warnings.filters != self.filters:
            warnings.resetwarnings()  # tells Python that they changed
            warnings.filters[:] = self.filters  # type: ignore[index]


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
        try:
            value = call()
        except BaseException as error:  # noqa: BLE001 - raised again in the thread that waits
            done.set_exception(error)
        else:
            done.set_result(value)

    threading.Thread(target=copy_context().run, args=(work,), daemon=True).start()
    first = min(soon, seconds)
    if first and not wait([done], first).done:
        tell()
    if not wait([done], seconds - first).done:
        raise TooSlow
    return done.result()
