"""An alarm next to code that may never return, and the end of that code."""

from __future__ import annotations

import ctypes
import signal
import sys
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any, Self


class TimeUp(BaseException):
    """Ends code that takes too long; no `except Exception` stops it."""


class Alarm:
    """Calls a function at regular intervals while a block runs, and may end the block.

    In the main thread a signal ends what waits for something too, such as `time.sleep`; elsewhere,
    and on Windows, code ends with the next instruction of Python.

    Parameters
    ----------
    every : float
        Seconds between calls.
    ring : callable
        Called in a thread of its own.
    due : callable
        Returns whether the block must end, with `TimeUp`.
    """

    def __init__(self, every: float, ring: Callable[[], None], due: Callable[[], bool]) -> None:
        self._every, self._ring, self._due = every, ring, due
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._ident = threading.get_ident()
        self._signals = (sys.platform != "win32"
                         and threading.current_thread() is threading.main_thread())
        self._before: Any = None

    def __enter__(self) -> Self:
        if self._signals:
            self._before = signal.signal(signal.SIGURG, self._end)
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._thread.join()
        if self._signals:
            signal.signal(signal.SIGURG, self._before)
        else:
            self._set_pending(None)

    def _watch(self) -> None:
        while not self._over.wait(self._every):
            self._ring()
            if not self._due():
                continue
            if self._signals:
                signal.pthread_kill(self._ident, signal.SIGURG)
            else:
                self._set_pending(TimeUp)

    def _set_pending(self, error: type[TimeUp] | None) -> None:
        ctypes.pythonapi.PyThreadState_SetAsyncExc(
            ctypes.c_ulong(self._ident), None if error is None else ctypes.py_object(error))

    def _end(self, _number: int, _frame: FrameType | None) -> None:
        if not self._over.is_set() and self._due():
            raise TimeUp
