"""Entry of the command line, ``termsel`` or ``python -m termsel``."""

from __future__ import annotations

import gc
import io
import os
import sys
import warnings

try:
    from termsel.core.interrupts import (
        INTERRUPTED,
        end_at_once,
        end_program,
        leave,
        repeat_interrupts,
        take_pending_interrupt,
    )
except KeyboardInterrupt:
    raise SystemExit(130) from None  # as later, but without the words

TYPE_CHECKING = False  # see termsel.core.interrupts
if TYPE_CHECKING:
    from threading import Thread
    from types import TracebackType

PATIENCE = 2.0
"""Seconds that threads have to end after the command."""

ALLOCATIONS = 200_000
"""Objects made, and not freed, between searches for cycles. Python searches after 700, so that a
command searches its imports again and again."""

FAULT = """\
Error: termsel has failed: {what}. This is a bug in termsel or in a plugin, not your mistake.
Please report it with the command you typed, the version of termsel ({version}), and the output
of the same command with TERMSEL_DEBUG=1 set. TERMSEL_PLUGINS= (empty) runs without plugins."""


def report_fault(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """Report on stderr that termsel has failed; Python then exits with code 1.

    Arguments are those of `sys.excepthook`. An interrupt is no fault: it ends the program at once.
    """
    if issubclass(kind, KeyboardInterrupt):
        leave()
    from termsel.core.errors import cut, exception_in_words, make_printable
    from termsel.core.version import __version__

    if os.environ.get("TERMSEL_DEBUG") == "1":
        sys.__excepthook__(kind, error, trace)
    what = cut(exception_in_words(error).rstrip("."), 1000)
    print(make_printable(FAULT.format(what=what, version=__version__)), file=sys.stderr)


def open_streams() -> None:
    """Make stdout and stderr take any text, also where the shell has closed them.

    What stdout cannot show is escaped. A stdout that is closed refuses what is written to it, and
    no file that is opened later takes its place.
    """
    for number, mode in enumerate((os.O_RDONLY, os.O_RDONLY, os.O_WRONLY)):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, mode)  # takes the lowest number that is free
    if sys.stdout is None:
        sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115 - stays open
    if sys.stderr is None:
        sys.stderr = open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115 - stays open
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def end_threads(code: object) -> None:
    """End the program where a thread, as of a plugin, would not let it end.

    It ends with `code`, or 0 where that is no number, after a note on whose thread it is. Threads
    have `PATIENCE` to end by themselves; nothing happens where they do.
    """
    import threading

    # Python itself ends the threads of executors.
    open_threads = [thread for thread in threading.enumerate()
                    if not thread.daemon and thread is not threading.main_thread()
                    and _module_of(thread) != "concurrent"]
    for thread in open_threads:
        thread.join(PATIENCE / len(open_threads))
    going_on = {_module_of(thread) for thread in open_threads if thread.is_alive()}
    if not going_on:
        return
    from termsel.core.isolation.faults import distribution_of

    print(f"Note: a thread of {' and of '.join(sorted(map(distribution_of, going_on)))} does not "
          "end; termsel ends without it.", file=sys.stderr)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code if isinstance(code, int) else 0)


def _module_of(thread: Thread) -> str:
    """Return the top-level module whose code a thread runs."""
    runs = getattr(thread, "_target", None) or type(thread)
    return str(runs.__module__).partition(".")[0]


def prepare_process() -> None:
    """Set memory, variables, warnings and streams of this process and those that it starts."""
    from termsel.core.files.drivers import claim_process

    gc.set_threshold(ALLOCATIONS)
    # For all that is started: see termsel.core.isolation.helper.
    os.environ["PYTHONSAFEPATH"] = "1"
    silence_warnings()
    # Of the BLAS that NumPy and SciPy bring along: see termsel.core.threads.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    claim_process()
    open_streams()


def silence_warnings() -> None:
    """Show no warnings of Python here and in processes that are started: they are for programmers.

    Whoever asks for them gets them: ``python -W``, PYTHONWARNINGS or TERMSEL_DEBUG=1.
    """
    if not sys.warnoptions and os.environ.get("TERMSEL_DEBUG") != "1":
        warnings.simplefilter("ignore")
        os.environ["PYTHONWARNINGS"] = "ignore"


def end_if_interrupted(code: object) -> None:
    """End the program after a command that failed because of Ctrl-C; `code` is its exit code."""
    # A library may have made another error of the interrupt, such as "cannot be imported": then
    # nobody has been told, and leave() prints "Interrupted." before it ends the program.
    if take_pending_interrupt() and code not in (0, INTERRUPTED):
        leave()
    # The command has said what it kept, and how to go on: end_program() prints nothing more.
    if code == INTERRUPTED:
        end_program()


def main() -> None:
    """Run the command line.

    At the start and at the end, where there is nothing to finish, Ctrl-C ends the program at once.
    In between it raises KeyboardInterrupt, so that a command can keep what it has.
    """
    end_at_once()
    sys.excepthook = report_fault
    try:
        repeat_interrupts()
        prepare_process()
        from termsel.cli.main import cli

        cli.main(prog_name="termsel", gives_back=False)
    except KeyboardInterrupt:  # where no command answers it
        leave()
    except (Exception, SystemExit) as error:
        end_if_interrupted(getattr(error, "code", 1))
        if isinstance(error, SystemExit):
            end_threads(error.code)
        raise  # Python exits with the code, or reports the fault by its excepthook
    finally:
        end_at_once()


if __name__ == "__main__":
    main()
