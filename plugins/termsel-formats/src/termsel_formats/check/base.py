"""What a program makes of a file, and how programs are asked."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from termsel import TermselError
from termsel.toolkit import FloatArray
from termsel.toolkit.files import program_environment

Places = Callable[[FloatArray, FloatArray], FloatArray]
"""From line and sample (n, 2) and heights (n,) to x and y (n, 2), NaN where there are none."""

# Time that a program has for an answer [s].
_MAX_SECONDS = 120.0


NONE = "none: no georeferencing"
"""What a program takes from a file without any."""


@dataclass(frozen=True, eq=False)
class Taken:
    """The transformation that a program takes from a file.

    Parameters
    ----------
    program : str
        Name of the program, with its version.
    transformation : str
        What it takes, in words.
    crs : str
        CRS of the ground, a code or WKT; "" where the file states none.
    places : callable, optional
        From line and sample, shape (n, 2), and heights, shape (n,), to x and y, shape (n, 2).
        None where the program takes no transformation, so that no georeferencing.
    by_default : bool
        Whether the program takes it without being told.
    """

    program: str
    transformation: str
    crs: str = ""
    places: Places | None = None
    by_default: bool = True


class NoAnswer(TermselError):
    """A program that ended with an error, or not in time."""


def find_program(name: str) -> str | None:
    """Return the absolute path of an installed program; None if it is not installed.

    A program in the current folder does not count as installed.
    """
    # Windows looks in the current folder first, and a program there may have come with the data.
    path = shutil.which(name)
    if path is None or not os.path.isabs(path):
        return None
    return None if os.path.samefile(os.path.dirname(path), os.curdir) else path


def answer(command: Sequence[str], text: str = "",
           environment: Mapping[str, str] | None = None) -> str:
    """Return what a program prints when it is given `text` as its input.

    `environment` is that of this process by default, with the language C. In both cases
    `program_environment` changes it so that the program reads files as termsel does.

    Raises
    ------
    NoAnswer
        If it ends with an error, cannot be started, or takes longer than two minutes.
    """
    try:
        finished = subprocess.run(
            list(command), input=text, capture_output=True, text=True, errors="replace",
            timeout=_MAX_SECONDS, check=False,
            env=program_environment(environment or {**os.environ, "LC_ALL": "C.UTF-8"}))
    except subprocess.TimeoutExpired:
        raise NoAnswer(f"{Path(command[0]).name} gave no answer in {_MAX_SECONDS:g} s") from None
    except OSError as error:
        raise NoAnswer(f"{Path(command[0]).name} cannot be started: {error.strerror}") from error
    if finished.returncode:
        # The last line names the error; those before it are warnings or usage.
        messages = (finished.stderr or finished.stdout).strip().splitlines()
        raise NoAnswer(f"{Path(command[0]).name}: {messages[-1] if messages else 'failed'}")
    return finished.stdout
