"""Ctrl-C that is not lost: some libraries swallow it while they are imported or compile."""

from __future__ import annotations

import os
import signal
import sys

# As in typing, whose import takes longer than all that comes before Ctrl-C is watched.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import FrameType
    from typing import NoReturn

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""

_AGAIN = 1.0  # s after which an interrupt that nobody answered is raised again


def end_at_once() -> None:
    """Let Ctrl-C end the program at once, with the exit code `INTERRUPTED` and no traceback.

    For programs, while they have nothing to finish: at their start and at their end. Nothing is
    changed where Ctrl-C is ignored, as by nohup.
    """
    if signal.getsignal(signal.SIGINT) in (signal.default_int_handler, _note_interrupt):
        signal.signal(signal.SIGINT, leave)
    take_pending_interrupt()


def leave(_number: int = signal.SIGINT, _frame: FrameType | None = None) -> NoReturn:
    """Print "Interrupted." on stderr and end the program at once, with the code `INTERRUPTED`.

    It is the handler of a signal, which gets the signal's number and the frame that it stopped.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    take_pending_interrupt()
    try:
        os.write(2, b"Interrupted.\n")
    finally:
        # Not even Python may do more: the signal may have come in the middle of anything.
        os._exit(INTERRUPTED)


def end_program() -> NoReturn:
    """End the program with the exit code `INTERRUPTED`; its output so far is written first."""
    from contextlib import suppress

    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # a full disk, or closed
            stream.flush()
    # Python itself would end by the signal, whatever the exit code, if the interrupt passed through
    # code that was executed from text, such as that of a dataclass.
    os._exit(INTERRUPTED)


def repeat_interrupts() -> None:
    """From now on raise KeyboardInterrupt at Ctrl-C and, but for Windows, each second until taken.

    `take_pending_interrupt` takes it. For programs, not for libraries: this sets the handlers of
    SIGINT and SIGALRM, and `sys.unraisablehook`, which no longer prints interrupts. Nothing is
    changed where Ctrl-C is ignored, as by nohup, or has a handler of somebody else.
    """
    # Only Python's own handler and the one of `end_at_once` are replaced.
    if signal.getsignal(signal.SIGINT) not in (signal.default_int_handler, leave):
        return
    signal.signal(signal.SIGINT, _note_interrupt)
    if sys.platform != "win32":
        signal.signal(signal.SIGALRM, _note_interrupt)
    sys.unraisablehook = _print_unraisable


def _note_interrupt(_number: int, _frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt on Ctrl-C and, but for Windows, again and again until it is taken."""
    if sys.platform != "win32":
        signal.setitimer(signal.ITIMER_REAL, _AGAIN)
    raise KeyboardInterrupt


def _print_unraisable(unraisable: sys.UnraisableHookArgs) -> None:
    """Print an error that Python cannot raise, except an interrupt, which comes again."""
    if unraisable.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(unraisable)


def take_pending_interrupt() -> bool:
    """Return whether Ctrl-C came and nothing has handled it yet; asking handles it."""
    if sys.platform == "win32" or signal.getsignal(signal.SIGALRM) is not _note_interrupt:
        return False
    return signal.setitimer(signal.ITIMER_REAL, 0)[0] > 0
