"""Ctrl-C that is not lost: some libraries swallow it while they are imported or compile."""

from __future__ import annotations

import signal
import sys
from types import FrameType

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""

_AGAIN = 1.0  # s after which an interrupt that nobody answered is raised again


def watch() -> None:
    """Raise KeyboardInterrupt at Ctrl-C, and again and again until it is `answered`.

    For programs, not for libraries: it takes the signals SIGINT and, where there is one, SIGALRM.
    Nothing is changed where Ctrl-C is ignored, as by nohup.
    """
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return
    signal.signal(signal.SIGINT, _interrupt)
    if sys.platform != "win32":
        signal.signal(signal.SIGALRM, _interrupt)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    if sys.platform != "win32":
        signal.setitimer(signal.ITIMER_REAL, _AGAIN)
    raise KeyboardInterrupt


def answered() -> bool:
    """Return whether an interrupt was waiting for an answer, which it now has."""
    if sys.platform == "win32" or signal.getsignal(signal.SIGALRM) is not _interrupt:
        return False
    return signal.setitimer(signal.ITIMER_REAL, 0)[0] > 0
