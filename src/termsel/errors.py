"""Errors a user can correct: what is wrong, where, and what to do about it."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class TermselError(Exception):
    """Something the user can correct; the command line shows it and exits with code 2.

    Parameters
    ----------
    what : str
        What is wrong, as one sentence without a full stop.
    hint : str, optional
        What to do about it.
    file, line, column : optional
        Where: the file's name, the line counted from 1, the column's name.
    ids : iterable of str, optional
        The features concerned, from which a reader finds the line of its file.
    """

    def __init__(
        self,
        what: str,
        *,
        hint: str | None = None,
        file: object = None,
        line: int | None = None,
        column: str | None = None,
        ids: Iterable[str] = (),
    ) -> None:
        super().__init__(what)
        self.what = what
        self.hint = hint
        self.file = file
        self.line = line
        self.column = column
        self.ids = tuple(ids)

    def __str__(self) -> str:
        where = [
            str(self.file) if self.file is not None else "",
            f"line {self.line}" if self.line is not None else "",
            f"column {self.column!r}" if self.column is not None else "",
        ]
        place = ", ".join(part for part in where if part)
        text = f"{place}: {self.what}" if place else self.what
        return f"{text}. {self.hint}" if self.hint else text


MOST_NAMED = 40
"""Names a message lists before it stops."""


def unknown_name(kind: str, name: str, known: Iterable[str], hint: str = "") -> TermselError:
    """Return the error for a name that is not known, with the nearest known ones.

    Parameters
    ----------
    kind : str
        What the name names: "model", "option" ...
    name : str
        The name as given.
    known : iterable of str
        The names that would have been accepted.
    hint : str
        A further sentence for the user.
    """
    names = sorted(set(known))
    near = get_close_matches(name, names, n=1, cutoff=0.6)
    guess = f"Did you mean {near[0]!r}? " if near else ""
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    listed = (f"Known: {', '.join(names[:MOST_NAMED])}{more}." if names
              else f"No {kind} is known here.")
    return TermselError(f"unknown {kind} {name!r}", hint=f"{guess}{listed} {hint}".strip())


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, which takes an s unless the number is 1.

    Parameters
    ----------
    number : int
    noun : str
        In the singular: "check point", "generation" ...
    """
    return f"{number} {noun}{'s' * (number != 1)}"
