"""What a message tells to give: an option of the command line, or an argument in Python.

Whoever raises an error or logs a note writes ``f"State it: {Remedy('crs', 'EPSG:4979')}."``. It
reads ``--crs EPSG:4979`` for whoever typed a command, and ``crs='EPSG:4979'`` for a caller in
Python.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

_called: ContextVar[Call | None] = ContextVar("called", default=None)
"""The function of termsel that a caller in Python has called; None on the command line."""

_PLACEHOLDER = re.compile(r"[A-Z][A-Z0-9]*")
_ARGUMENTS = {"res": ("resolution",), "points": ("points", "features", "result"),
              "output": ("output", "path", "out"), "out": ("out", "folder")}
"""Arguments that options are called otherwise in Python, the likeliest first."""
_OF_READING = ("dem", "rpc")
"""Options that in Python belong to the reading of points, but for functions that have them too."""
_FLAGS = {"overwrite": "overwrite=True", "no-final": "final=False", "final": "final=True",
          "verbose": "verbose=True", "quiet": "quiet=True"}


@dataclass(frozen=True)
class Call:
    """A function that was called in Python, and the names of its arguments."""

    function: str
    arguments: Collection[str]


@contextmanager
def called_in_python(function: str, arguments: Collection[str]) -> Iterator[None]:
    """Let messages within a block name arguments of a function in place of options."""
    token = _called.set(Call(function, arguments))
    try:
        yield
    finally:
        _called.reset(token)


@dataclass(frozen=True)
class Remedy:
    """An option of the command line without its dashes, with the value to give it, if any."""

    name: str
    value: str = ""

    def __str__(self) -> str:
        """Return the option, or the argument, as whoever asked types it."""
        if (call := _called.get()) is not None:
            return _as_argument(self.name, self.value, call.arguments)
        return f"--{self.name} {self.value}" if self.value else f"--{self.name}"


@dataclass(frozen=True)
class ReadRemedy:
    """An option of reading a file: ``--set name=value``, or an argument of `termsel.read`."""

    name: str
    value: str

    def __str__(self) -> str:
        """Return what whoever asked types."""
        call = _called.get()
        if call is None:
            return f"--set {self.name}={self.value}"
        argument = f"{self.name}={_literal(self.value)}"
        return argument if call.function == "read" else f"termsel.read(FILE, {argument})"


_COMMAND = re.compile(r"(?:\btermsel [a-z]|\bgdal|\bogr2ogr |\bpip ).*?(?=[.;:,)](?:\s|$)|   |$)")
"""A command for a shell, which stays as it is in a message: up to the end of the clause."""

_OPTION = re.compile(
    r"--(?P<name>[a-z][a-z-]*)"
    r"(?:[ =](?P<value>'[^']*'|\"[^\"]*\"|[A-Z][A-Z0-9]*(?:[:=,][^\s.;)]*[^\s.,;)])?(?![a-z])"
    r"|[a-z_]\w*=[^\s.;)]*[^\s.,;)]|[\w/~.+-]*[\d/](?:[\w/.,+:-]*\w)?|auto\b|local\b))?")
"""An option, with its value where one follows: in quotation marks, a placeholder, a name with a
digit or of a file, or one of few words."""


def in_python(text: str, arguments: Collection[str]) -> str:
    """Return a message with the arguments of a function in place of options in its text.

    `arguments` are the names that the function takes. Whole commands stay, as they are typed in a
    shell whoever reads them.
    """
    pieces = []
    end = 0
    for command in _COMMAND.finditer(text):
        pieces += [_with_arguments(text[end:command.start()], arguments), command[0]]
        end = command.end()
    return "".join([*pieces, _with_arguments(text[end:], arguments)])


def _with_arguments(text: str, arguments: Collection[str]) -> str:
    """Return a text that has no command with arguments in place of options."""
    return _OPTION.sub(lambda option: _as_argument(
        option["name"], option["value"] or "", arguments), text)


def _as_argument(name: str, value: str, arguments: Collection[str]) -> str:
    """Return an option of the command line as an argument in Python."""
    if name in _FLAGS and not value:
        return _FLAGS[name]
    if name == "set":
        # Whether a function takes it so, or among its options, the function says itself.
        name, _, value = (value or "options").strip("'").partition("=")
    else:
        name = next((known for known in _ARGUMENTS.get(name, ()) if known in arguments),
                    name.replace("-", "_"))
    argument = f"{name}={_literal(value)}" if value else name
    if value and name in _OF_READING and name not in arguments:
        return f"termsel.read(TABLE, {argument})"
    return argument


def _literal(value: str) -> str:
    """Return a value as Python writes it; a placeholder and a number stay as they are."""
    bare = value[1:-1] if value[0] in "'\"" else value
    if _PLACEHOLDER.fullmatch(bare) or re.fullmatch(r"-?\d+(\.\d+)?", bare):
        return bare
    return repr(bare)
