"""Where the keys and values of a TOML text are, which the parser does not show."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

from termsel.core.errors import TermselError, unknown_name_error

Path = tuple[str | int, ...]
"""Keys and positions in lists that lead to a value."""

_TOKEN = re.compile(
    r'(?P<skip>[ \t\r]+|\#[^\n]*)|(?P<line>\n)|(?P<mark>[\[\]{},=.])'
    r'|(?P<long>"""(?:\\.|[^\\])*?"{3,5}|\'\'\'.*?\'{3,5})'
    r'|(?P<text>"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\')|(?P<bare>[^\s\[\]{},="\'.#]+)', re.DOTALL)


@dataclass(frozen=True)
class Places:
    """The file that a study was read from, and where each of its values is."""

    file: object = None  # None for what is given by options or in Python
    # line and column, from 1, by path
    known: dict[Path, tuple[int, int]] = field(default_factory=dict)

    def error(self, path: Path, problem: str, hint: str | None = None) -> TermselError:
        """Return an error that names the place of a value, or of the list or table that holds it.
        """
        # From the value up to what holds it, until a place is known.
        while path and path not in self.known:
            path = path[:-1]
        line, column = self.known.get(path, (None, None))
        return TermselError(problem, hint=hint, file=self.file, line=line, column=column)

    def unknown(self, path: Path, kind: str, names: Any, hint: str = "") -> TermselError:
        """Return the error for a name that is not known."""
        unknown = unknown_name_error(kind, str(path[-1]), names, hint)
        return self.error(path, unknown.what, unknown.hint)


def places_of(text: str, file: object) -> Places:
    """Return the places of all keys and list items of a valid text; `file` is for messages."""
    reader = _Reader(text)
    reader.read_document()
    return Places(file, reader.known)


class _Reader:
    """Walks through the tokens of valid TOML and notes where each key and item begins."""

    def __init__(self, text: str) -> None:
        """Divide the text of the file into tokens, each with its line and column."""
        # Offsets at which lines begin, to turn an offset into line and column.
        starts = [0, *(match.end() for match in re.finditer("\n", text))]
        self._tokens: list[tuple[str, str, tuple[int, int]]] = []
        line = 0
        for match in _TOKEN.finditer(text):
            while line + 1 < len(starts) and starts[line + 1] <= match.start():
                line += 1
            # Blanks and comments have no place to be named.
            if match.lastgroup != "skip":
                self._tokens.append((str(match.lastgroup), match[0],
                                     (line + 1, match.start() - starts[line] + 1)))
        self._tokens.append(("line", "\n", (line + 1, 1)))
        self._at = 0
        self._counts: dict[Path, int] = {}
        self.known: dict[Path, tuple[int, int]] = {}

    def read_document(self) -> None:
        """Note the lines of all keys of a TOML document."""
        table: Path = ()
        # Each pair belongs to the last header above it.
        while self._at < len(self._tokens) - 1:
            kind, text, _ = self._tokens[self._at]
            if kind == "line":
                self._at += 1
            elif text == "[":
                table = self._read_header()
            else:
                self._read_pair(table)

    def _read_header(self) -> Path:
        """Pass the tokens of ``[table]`` or ``[[list]]``; keep its place, and return its path.

        The path has names of tables, and for a list of tables the number of the latest one, as TOML
        has it.
        """
        self._at += 1
        # "[[" begins a further table of a list.
        several = self._tokens[self._at][1] == "["
        self._at += several
        position = self._tokens[self._at][2]
        path: Path = ()
        for name in self._read_key():
            path = (*path, name)
            # A name of a list of tables stands for its latest table.
            if path in self._counts:
                path = (*path, self._counts[path] - 1)
        if several:
            if path and isinstance(path[-1], int):
                path = path[:-1]
            self._counts[path] = self._counts.get(path, 0) + 1
            path = (*path, self._counts[path] - 1)
        self.known[path] = position
        self._at += 1 + several
        return path

    def _read_key(self) -> list[str]:
        """Pass the tokens of a key, which may have dots, and return its parts."""
        names = [""]
        # Until the sign that ends a key, or a header.
        while (text := self._tokens[self._at][1]) not in ("=", "]"):
            if text == ".":
                names.append("")
            else:
                names[-1] = text.strip("\"'")
            self._at += 1
        return names

    def _read_pair(self, table: Path) -> None:
        """Note the place of a key in a table, and of its value, and move past them."""
        position = self._tokens[self._at][2]
        path = (*table, *self._read_key())
        self.known[path] = position
        self._at += 1
        self._read_value(path)

    def _read_value(self, path: Path) -> None:
        """Note the lines of a value's items, and move past it.

        Items of lists and inline tables get places of their own, so that an error can name the line
        of one in a list over several lines.
        """
        self._pass_lines()
        text = self._tokens[self._at][1]
        if text in ("[", "{"):
            self._at += 1
            item = 0
            while self._next_character() not in ("]", "}"):
                if text == "{":
                    self._read_pair(path)
                else:
                    self.known[(*path, item)] = self._tokens[self._at][2]
                    self._read_value((*path, item))
                    item += 1
                if self._next_character() == ",":
                    self._at += 1
            self._at += 1
            return
        # A plain value is passed until what comes after it.
        while self._tokens[self._at][1] not in (",", "]", "}", "\n"):
            self._at += 1

    def _next_character(self) -> str:
        """Return the next token that is no end of a line."""
        self._pass_lines()
        return self._tokens[self._at][1]

    def _pass_lines(self) -> None:
        """Move past the ends of lines, but not past the last token."""
        while self._tokens[self._at][0] == "line" and self._at < len(self._tokens) - 1:
            self._at += 1
