"""State of the process that code of a plugin may change and must not change for others."""

from __future__ import annotations

import os
import random
import sys
import threading
import warnings
from collections import Counter
from contextvars import ContextVar
from copy import copy
from typing import Any

import numpy as np


class State:
    """The working folder, filters of warnings, numpy's error handling and global random numbers, as
    they are when it is made."""

    __slots__ = ("errors", "filters", "folder", "numpy", "python")

    def __init__(self) -> None:
        self.folder = _folder()
        self.filters = list(warnings.filters)
        self.errors: Any = np.geterr()
        self.python = random.getstate()
        self.numpy: Any = np.random.get_state(legacy=False)

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

    def of_this_thread(self) -> State:
        """Return the same state with numpy's error handling, which each thread has for itself."""
        found = copy(self)
        found.errors = np.geterr()
        return found


_within: ContextVar[tuple[str, State] | None] = ContextVar("within", default=None)


class _Screen:
    """stdout while plugins run: what they print, in their own threads too, goes to stderr."""

    def __init__(self, stdout: Any) -> None:
        self.stdout = stdout

    def __getattr__(self, name: str) -> Any:
        thread = threading.get_ident()
        known = thread in _process.running or thread == threading.main_thread().ident
        return getattr(self.stdout if known and _within.get() is None else sys.stderr, name)


class _Process:
    """What the threads that run code of plugins have in common.

    Of several at once, each puts back what was there before the first of them: what another one
    changed meanwhile is not kept.
    """

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.running: Counter[int] = Counter()
        self.before: State | None = None
        self.screen = _Screen(None)

    def begin(self) -> State:
        """Note that this thread runs code of a plugin; return the state to put back after it."""
        thread = threading.get_ident()
        with self.lock:
            alone = self.running.total() == self.running[thread]
            before = State() if alone or self.before is None else self.before.of_this_thread()
            if not self.running:
                self.before, self.screen = before, _Screen(sys.stdout)
                sys.stdout = self.screen
            self.running[thread] += 1
        return before

    def end(self, before: State) -> None:
        """Put the state back; the last to end puts back stdout."""
        thread = threading.get_ident()
        with self.lock:
            try:
                before.put_back()  # fails where the folder is gone
            finally:
                self.running[thread] -= 1
                if not self.running[thread]:
                    del self.running[thread]
                sys.stdout = self.screen if self.running else self.screen.stdout


_process = _Process()


def inside() -> str | None:
    """Return the package whose code is being run in isolation, None outside any plugin."""
    found = _within.get()
    return found and found[0]


class Isolated:
    """Runs a block as the code of a package: what it changes of the process is put back.

    What it prints goes to stderr, as stdout belongs to results. Folder, filters of warnings and
    global random numbers are those of the whole process: until the block ends, other threads see
    what it changes of them.

    Parameters
    ----------
    package : str
        The top-level module.
    """

    __slots__ = ("before", "package", "token")

    def __init__(self, package: str) -> None:
        self.package = package

    def __enter__(self) -> None:
        self.before = _process.begin()
        self.token = _within.set((self.package, self.before))

    def __exit__(self, *error: object) -> None:
        _within.reset(self.token)
        _process.end(self.before)


class Returned:
    """Runs a block of termsel's own code that a plugin calls, with the state from before it.

    Exceptions that leave the block are marked as termsel's own, not the plugin's.
    """

    __slots__ = ("plugin", "stdout", "token")

    def __enter__(self) -> None:
        found = _within.get()
        self.plugin = None if found is None else State()
        if found is not None:
            self.token = _within.set(None)
            self.stdout = sys.stdout
            found[1].put_back()
            sys.stdout = _process.screen

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if self.plugin is None:
            return
        _within.reset(self.token)
        self.plugin.put_back()
        sys.stdout = self.stdout
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
