"""Files in TOML that people write: studies and blocks."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from termsel.core.errors import TermselError
from termsel.formats.base import read_text

_BOMB = re.compile(r"\.(?:[\"'\w \t-]{0,80}\.){100}")  # dotted keys cost the square of their parts
_TWICE = re.compile(r"Cannot (?:overwrite|declare) \('(\w+)'")
_IN_WORDS = {
    "Invalid value": "this is no value; text needs quotes, such as key = \"text\"",
    "Expected newline or end of document after a statement":
        "a value ends here, and more follows on the same line",
    "Expected '=' after a key in a key/value pair": "a key stands here without = and a value",
    "Invalid statement": "this line is neither [a table] nor key = value",
    "Unclosed inline table": "the table that begins here has no closing brace",
    "Illegal character '\\n'": "the text that begins on this line has no closing quote",
    "Unterminated string": "the text that begins here has no closing quote",
    "Expected ']' at the end of a table declaration": "the name of this table has no closing ]",
    "Expected ']]' at the end of an array declaration": "the name of this table has no closing ]]",
}
"""What a user reads for what tomllib says."""

_DEEPEST = 100
"""Tables or lists within each other at most."""

_INTEGER_LIMIT = 2**63
"""Whole numbers of TOML have 64 bits."""


def read_toml(file: Path, kind: str, hint: str) -> tuple[dict[str, Any], str]:
    """Return the table of a file in TOML, and its text.

    Parameters
    ----------
    file : Path
        The file to read.
    kind : str
        What the file should be, such as "a study file".
    hint : str
        What to do where it is not.

    Raises
    ------
    TermselError
        For a file that is not TOML, with line and column, and for one with keys or values that are
        nested without end, numbers of more than 64 bits, or text with a NUL character.
    """
    text = read_text(file)
    endless = TermselError(f"this is not {kind}: its keys or numbers have no end", file=file,
                           hint=hint)
    # Before it is parsed, as the time grows with the square of the dots.
    if _BOMB.search(text):
        raise endless
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        if file.suffix.lower() != ".toml":
            raise TermselError(f"this is not {kind}, which is TOML", file=file,
                               hint=f"{hint} Tables of points are given by --points FILE, to "
                                    "termsel run or termsel compare.") from error
        # tomllib gives the position in the text of its message alone.
        reason, _, position = str(error).rpartition(" (at ")
        numbers = list(map(int, re.findall(r"\d+", position)))
        line, column = numbers if len(numbers) == 2 else (text.count("\n") + 1, None)
        # tomllib reports a list that never ends at the end of the file; the user looks for its
        # beginning.
        if reason == "Unclosed array":
            line, column = _opening_line(text), None
            reason = "the list that begins here has no closing bracket"
        reason = _IN_WORDS.get(reason, reason)
        twice = _TWICE.match(reason)
        if twice:
            reason = (f"the key {twice[1]!r} is stated twice, or [{twice[1]}] stands where "
                      f"[[{twice[1]}]] should")
        raise TermselError(f"this is not TOML: {reason or position}", file=file, line=line,
                           column=column, hint=hint) from error
    except (RecursionError, ValueError) as error:  # lists in lists, numbers of 20,000 digits
        raise endless from error
    for key, value in _values_of_table(table, endless):
        if isinstance(value, str) and "\0" in value:
            raise TermselError(f"this is not {kind}: the text of {key!r:.60} has a NUL character",
                               file=file, hint=hint)
        if isinstance(value, int) and abs(value) > _INTEGER_LIMIT:
            raise TermselError(f"this is not {kind}: the number of {key!r:.60} has more than 64 "
                               "bits", file=file, hint=hint)
    return table, text


def _opening_line(text: str) -> int:
    """Return the last line, from 1, that opens more brackets than it closes."""
    lines = text.splitlines()
    unclosed = [number for number, line in enumerate(lines, 1)
                if line.count("[") > line.count("]")]
    return unclosed[-1] if unclosed else len(lines)


def _values_of_table(table: Mapping[str, Any], endless: TermselError) -> Iterator[tuple[str, Any]]:
    """Yield the keys and values at any depth of a table, each with the key that it is under.

    A key is yielded under itself. Raises `endless` for a table more than `_DEEPEST` levels deep.
    """
    # A stack, as a file could exhaust recursion.
    pending: list[tuple[str, Any, int]] = [("", table, 0)]
    while pending:
        key, value, depth = pending.pop()
        if depth > _DEEPEST:
            raise endless
        if isinstance(value, Mapping):
            yield from ((name, name) for name in value)
            pending += [(name, item, depth + 1) for name, item in value.items()]
        elif isinstance(value, list):
            pending += [(key, item, depth + 1) for item in value]
        else:
            yield key, value
