"""State of the process that code of a plugin may change and must not change for others."""

from __future__ import annotations

import os
import random
import sys
import warnings
from contextvars import ContextVar
from typing import Any

import numpy as np


class State:
    """The working folder, filters of warnings, numpy's error handling, global random numbers and
    stdout, as they are when it is made."""

    __slots__ = ("errors", "filters", "folder", "numpy", "python", "stdout")

    def __init__(self) -> None:
        self.folder = _folder()
        self.filters = list(warnings.filters)
        self.errors: Any = np.geterr()
        self.python = random.getstate()
        self.numpy: Any = np.random.get_state(legacy=False)
        self.stdout = sys.stdout

    def put_back(self) -> None:
        """Make the process as it was."""
        if self.folder is not None and _folder() != self.folder:
            os.chdir(self.folder)
        if warnings.filters != self.filters:
            warnings.resetwarnings()  # tells Python that they changed
            warnings.filters[:] = self.filters  # type: ignore[index]
        np.seterr(**self.errors)
        random.setstate(self.python)
        np.random.set_state(self.numpy)
        sys.stdout = self.stdout


_within: ContextVar[tuple[str, State] | None] = ContextVar("within", default=None)


def inside() -> str | None:
    """Return the package whose code is being run in isolation, None outside any plugin."""
    found = _within.get()
    return found and found[0]


class Isolated:
    """Runs a block as the code of a package: what it changes of the process is put back.

    What it prints goes to stderr, as stdout belongs to results.

    Parameters
    ----------
    package : str
        The top-level module.
    """

    __slots__ = ("before", "package", "token")

    def __init__(self, package: str) -> None:
        self.package = package

    def __enter__(self) -> None:
        self.before = State()
        self.token = _within.set((self.package, self.before))
        sys.stdout = sys.stderr

    def __exit__(self, *error: object) -> None:
        _within.reset(self.token)
        self.before.put_back()


class Returned:
    """Runs a block of termsel's own code that a plugin calls, with the state from before it.

    Exceptions that leave the block are marked as termsel's own, not the plugin's.
    """

    __slots__ = ("plugin", "token")

    def __enter__(self) -> None:
        found = _within.get()
        self.plugin = None if found is None else State()
        if found is not None:
            self.token = _within.set(None)
            found[1].put_back()

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if self.plugin is None:
            return
        _within.reset(self.token)
        self.plugin.put_back()
        if error is not None:
            error.of_termsel = True  # type: ignore[attr-defined]


def is_marked(error: BaseException) -> bool:
    """Return True for an exception that left a block of `Returned`."""
    return getattr(error, "of_termsel", False)


def _folder() -> str | None:
    try:
        return os.getcwd()
    except OSError:  # it was deleted
        return None
