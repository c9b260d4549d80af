"""Entry of the command line, ``termsel`` or ``python -m termsel``."""

from __future__ import annotations

import io
import os
import sys
from types import TracebackType
from typing import NoReturn

from termsel.interrupts import answered, watch
from termsel.version import __version__

FAULT = """\
Error: termsel has failed: {what}. This is a bug in termsel or in a plugin, not your mistake.
Please report it with the command you typed, the version of termsel ({version}), and the output
of the same command with TERMSEL_DEBUG=1 set. TERMSEL_PLUGINS= (empty) runs without plugins."""


def report_fault(
    kind: type[BaseException], error: BaseException, trace: TracebackType | None
) -> None:
    """Report on stderr that termsel has failed; Python then exits with code 1.

    Parameters
    ----------
    kind, error, trace
        As for `sys.excepthook`.
    """
    from termsel.errors import cut, printable

    if os.environ.get("TERMSEL_DEBUG") == "1":
        sys.__excepthook__(kind, error, trace)
    what = " ".join(f"{kind.__name__}: {error}".split()).rstrip(".: ")
    print(printable(FAULT.format(what=cut(what, 1000), version=__version__)), file=sys.stderr)


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


def main() -> None:
    """Run the command line."""
    watch()
    sys.excepthook = report_fault
    try:
        from termsel.cli.main import cli

        open_streams()
        cli.main(prog_name="termsel")
    except KeyboardInterrupt:  # before the command line answers
        _interrupted()
    except (Exception, SystemExit) as error:
        # A library may have made another error of it, such as "cannot be imported".
        if answered() and getattr(error, "code", 1) != 0:
            _interrupted()
        raise


def _interrupted() -> NoReturn:
    answered()
    print("Interrupted.", file=sys.stderr)
    sys.exit(130)


if __name__ == "__main__":
    main()
