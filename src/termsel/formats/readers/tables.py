"""Tables of text: cells by the meaning of their columns, with the place of every bad cell.

Comment lines begin with ``#``; ``# crs: EPSG:4979`` declares the CRS and ``# units: degrees``
or ``# units: metres`` the units of the ground coordinates.
"""

from __future__ import annotations

import csv
import io
import logging
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path

import numpy as np

from termsel.errors import TermselError, unknown_name
from termsel.formats.base import located, read_text
from termsel.formats.readers.formulas import unguarded
from termsel.formats.readers.further import as_text, further
from termsel.measurements.coordinates.crs import normalise
from termsel.measurements.features import ROLES, FloatArray, Points
from termsel.measurements.tables.attributes import Attributes, rows_at, text_array
from termsel.measurements.tables.columns import OPTIONAL, USE
from termsel.measurements.tables.ids import refused
from termsel.options import Option

log = logging.getLogger(__name__)

Aliases = Mapping[str, tuple[str, ...]]
"""Names of the columns that hold each meaning, in lower case."""

COLUMNS = Option("columns", "", "Columns with other names, as meaning:name, such as "
                                "x:Rechtswert,y:Hochwert.")
"""The option of readers of tables that `declared` takes."""

_ENABLED = {"": True, "1": True, "true": True, "yes": True, "on": True,
            "0": False, "false": False, "no": False, "off": False}
_DECLARATION = re.compile(r"#\s*(crs|units?)\s*[:=](.*)", re.IGNORECASE)
_UNITS = re.compile(r"(deg|degrees?|m|met(re|er)s?)", re.IGNORECASE)


@dataclass(frozen=True)
class Table:
    """The cells of a file, by the meaning of their columns.

    `names` holds the header's text for each meaning, `lines` the line of the file each row
    begins on, `more` the cells of the columns without a meaning.
    """

    path: Path
    crs: str
    names: Mapping[str, str]
    columns: Mapping[str, Sequence[str]]
    lines: Sequence[int]
    decimal_comma: bool
    more: Attributes = field(default_factory=dict)

    def error(self, what: str, row: int, meaning: str, hint: str | None = None) -> TermselError:
        return TermselError(what, hint=hint, file=self.path, line=self.lines[row],
                            column=self.names[meaning])

    def take(self, rows: Sequence[int]) -> Table:
        """Return the table of some rows."""
        return replace(self, lines=[self.lines[row] for row in rows],
                       columns={meaning: [cells[row] for row in rows]
                                for meaning, cells in self.columns.items()},
                       more=rows_at(self.more, np.asarray(rows, dtype=np.intp)))

    def placed(self, error: TermselError) -> TermselError:
        """Return `error` with the line of the first feature it names, and the name of the column.

        The error has the meaning of a column, if any.
        """
        rows = [row for row, name in enumerate(self.ids()) if name in error.ids[:1]]
        error.column = self.names.get(str(error.column or ""))
        return located(error, self.path, self.lines[rows[0]] if len(rows) == 1 else None)

    def ids(self) -> list[str]:
        """Return the ids, P1, P2, ... where the format has none."""
        if "id" not in self.columns:
            return [f"P{row + 1}" for row in range(len(self.lines))]
        names = [unguarded(cell.strip()) for cell in self.columns["id"]]
        for row, name in enumerate(names):
            if wrong := refused(name):
                raise self.error(f"the id {wrong}", row, "id", "Give every feature a short id of "
                                                               "letters, digits and signs.")
        return names

    def points(self, image: FloatArray, ground: FloatArray, sigma: FloatArray | None,
               roles: Sequence[str]) -> Points:
        """Return the points; errors name the line they are on."""
        ids = self.ids()
        first: dict[str, int] = {}
        for row, name in enumerate(ids):
            if first.setdefault(name, row) != row:
                raise self.error(f"id {name!r} is already used on line {self.lines[first[name]]}",
                                 row, "id", "Give every point an id of its own.")
        try:
            return Points(tuple(ids), image, ground, sigma, tuple(roles), self.more)
        except TermselError as error:
            raise self.placed(error) from error

    def roles(self) -> list[str]:
        """Return the role of each row, "off" where it is not enabled."""
        cells = self.columns.get("role", [""] * len(self.lines))
        known = {cell: cell.strip().lower() for cell in set(cells)}  # few, whatever the rows
        for cell, role in known.items():
            if role not in ("", *ROLES):
                raise self.error(f"unknown role {cell.strip()!r}", cells.index(cell), "role",
                                 f"Roles are {', '.join(ROLES)}, or blank.")
        flags = self.columns.get("enabled", ())
        enabled = {cell: _ENABLED.get(cell.strip().lower()) for cell in set(flags)}
        for cell, on in enabled.items():
            if on is None:
                raise self.error(f"{cell.strip()!r} is neither true nor false",
                                 flags.index(cell), "enabled", "Write 1 or 0.")
        roles = [known[cell] for cell in cells]
        for row, cell in enumerate(flags):
            if not enabled[cell]:
                roles[row] = "off"
        return roles

    def sigma(self, *meanings: str) -> FloatArray | None:
        """Return columns of standard deviations, None if there are none."""
        if meanings[0] not in self.columns:
            return None
        sigma = self.stack(*meanings, may_be_blank=True)
        blank = np.isnan(sigma)
        if blank.all():
            return None
        if blank.any():
            row, axis = (int(i) for i in np.argwhere(blank)[0])
            raise self.error("the standard deviation is blank here but not in all rows", row,
                             meanings[axis],
                             "Fill it in for every row, or remove the columns.")
        return sigma

    def stack(self, *meanings: str, may_be_blank: bool = False) -> FloatArray:
        """Return columns of numbers side by side; heights may always be blank."""
        return np.column_stack([self._numbers(meaning, may_be_blank or meaning[0] == "z")
                                for meaning in meanings])

    def _numbers(self, meaning: str, may_be_blank: bool) -> FloatArray:
        if meaning not in self.columns and meaning[0] == "z":
            return np.full(len(self.lines), np.nan)
        # Whole columns at C speed; single cells are checked only to find the bad one.
        cells = self.columns[meaning]
        joined = "".join(cells)
        texts = [cell.replace(",", ".") for cell in cells] if self.decimal_comma else cells
        blank = np.zeros(len(cells), dtype=bool)
        if may_be_blank:
            blank = np.array([not cell or cell.isspace() for cell in cells])
            texts = ["nan" if gone else text for text, gone in zip(texts, blank, strict=True)]
        try:
            values = np.fromiter(map(float, texts), np.float64, len(texts))
        except ValueError:
            raise self._bad_number(meaning, may_be_blank) from None
        # float() reads 1_000, inf and nan; a decimal comma makes a point a thousands separator.
        if ("_" in joined or (self.decimal_comma and "." in joined)
                or not np.isfinite(values[~blank]).all()):
            raise self._bad_number(meaning, may_be_blank)
        return values

    def _bad_number(self, meaning: str, may_be_blank: bool) -> TermselError:
        for row, cell in enumerate(self.columns[meaning]):
            text = cell.strip()
            if not text and may_be_blank:
                continue
            if not text:
                return self.error("the cell is blank, expected a number", row, meaning,
                                  "Fill it in or remove the row.")
            if self.decimal_comma and "." in text:
                return self.error(f"{text!r} has a decimal point, other cells a decimal comma",
                                  row, meaning, "Use one of them, without thousands separators.")
            try:
                value = float(cell.replace(",", ".") if self.decimal_comma else cell)
            except ValueError:
                return self.error(f"{text!r} is not a number", row, meaning,
                                  "Write a plain number such as 12.5.")
            if not isfinite(value):
                return self.error(f"{text!r} is not a finite number", row, meaning,
                                  "Leave the cell blank if the value is unknown."
                                  if may_be_blank else "Correct it or remove the row.")
            if "_" in text:
                return self.error(f"{text!r} is not a plain number", row, meaning,
                                  "Write it without underscores.")
        raise AssertionError(f"no bad number in column {meaning!r}")


def _header(text: str) -> tuple[str, str]:
    """Return the first line that is neither blank nor a comment, and the delimiter."""
    lines = io.StringIO(text, newline="")
    line = next((line for line in lines if line.strip() and line[0] != "#"), "")
    return line, max(",;\t", key=line.count)


def _matches(header: Sequence[str],
             aliases: Aliases) -> dict[str, list[int]]:
    """Return the columns that could hold each meaning."""
    folded = [cell.strip().casefold() for cell in header]
    return {meaning: [i for i, cell in enumerate(folded) if cell in names]
            for meaning, names in aliases.items()}


def sniff_table(head: bytes, aliases: Aliases, needed: Sequence[str] = ()) -> bool:
    """Return True if a header names at least three columns of numbers, and all `needed`."""
    # Another encoding is recognised too, so that read() can say what is wrong with it.
    text = head.decode("utf-8-sig", errors="replace")
    if "\0" in text:
        return False
    line, delimiter = _header(text)
    matches = _matches(next(csv.reader([line], delimiter=delimiter), []), aliases)
    return all(matches[meaning] for meaning in needed) and sum(
        bool(columns) for meaning, columns in matches.items() if meaning not in USE) >= 3


def _columns(path: Path, line: int, header: Sequence[str],
             aliases: Aliases, *, flat: bool) -> dict[str, int]:
    """Return the one column of each meaning, refusing missing and ambiguous ones.

    If `flat`, all columns of heights may be missing together.
    """
    here = f"The columns here are: {', '.join(cell.strip() for cell in header)}."
    found: dict[str, int] = {}
    matches = _matches(header, aliases)
    sigma = bool(matches.get("sigma_line") or matches.get("sigma_sample"))
    heights = [meaning for meaning in aliases if meaning[0] == "z"]
    if flat and not any(matches[meaning] for meaning in heights):
        log.info("Note: %s has no column for %s, so its heights are unknown. Accepted names: %s.",
                 path, " and ".join(heights), ", ".join(aliases[heights[0]]))
        matches = {meaning: columns for meaning, columns in matches.items()
                   if meaning not in heights}
    for meaning, columns in matches.items():
        if len(columns) > 1:
            named = " and ".join(repr(header[i].strip()) for i in columns)
            raise TermselError(f"columns {named} both mean {meaning}", file=path, line=line,
                               column=header[columns[1]].strip(),
                               hint="Rename or remove all but one of them.")
        if columns:
            found[meaning] = columns[0]
        elif meaning not in OPTIONAL or (sigma and meaning.startswith("sigma")):
            blank = " Its cells may be blank." if meaning[0] == "z" else ""
            raise TermselError(f"there is no column for {meaning}", file=path, line=line,
                               column=meaning, hint=f"{here} Accepted names: "
                                                    f"{', '.join(aliases[meaning])}.{blank}")
    return found


def _declared_crs(path: Path, comments: Mapping[int, str]) -> str:
    """Return the CRS the comments declare, "" for none, and check the units."""
    crs = ""
    for line, comment in comments.items():
        declared = _DECLARATION.match(comment)
        key, value = (declared[1].lower(), declared[2].strip()) if declared else ("", "")
        if not value:
            continue
        if key == "crs":
            try:
                name = normalise(value)
            except TermselError as error:
                raise located(error, path, line) from error
            if crs not in ("", name):
                raise TermselError(f"the CRS is {name} here, but {crs} in an earlier comment",
                                   file=path, line=line, hint="Remove one of them.")
            crs = name
        elif not all(_UNITS.fullmatch(unit.strip()) for unit in value.split(",")):
            raise TermselError(f"units {value!r} are not supported", file=path, line=line,
                               hint="Convert the ground coordinates to degrees or metres.")
    return crs


def _rows(path: Path, text: str, delimiter: str,
          ) -> tuple[list[list[str]], list[int], dict[int, str]]:
    """Return the rows that are not blank, the line each begins on, and the comments by line."""
    rows: list[list[str]] = []
    lines: list[int] = []
    comments: dict[int, str] = {}
    end = 0

    def without_comments() -> Iterator[str]:
        # The reader asks for the next line of a row before it gives the row, so that a line
        # within quotation marks is not the one after the end of the last row.
        for number, line in enumerate(io.StringIO(text, newline=""), 1):
            if line[0] == "#" and number == end + 1:
                comments[number] = line
                line = "\n"
            yield line

    reader = csv.reader(without_comments(), delimiter=delimiter, strict=True)
    try:
        for row in reader:
            if any(map(str.strip, row)):  # spreadsheets leave empty cells after the data
                rows.append(row)
                lines.append(end + 1)
            end = reader.line_num
    except csv.Error as error:
        raise TermselError(f"the row that begins here cannot be read: {error}", file=path,
                           line=end + 1, hint='Look for a quotation mark (") that is not closed.'
                           ) from error
    return rows, lines, comments


def declared(aliases: Aliases, columns: str) -> Aliases:
    """Return the aliases with the columns the user names.

    Parameters
    ----------
    aliases : mapping
    columns : str
        Pairs meaning:name, separated by commas; "" for none.

    Raises
    ------
    TermselError
        For text that is not such a pair, or an unknown meaning.
    """
    own = {}
    for pair in filter(None, map(str.strip, columns.split(","))):
        meaning, colon, name = (part.strip() for part in pair.partition(":"))
        if not colon or not name:
            raise TermselError(f"{pair!r} does not declare a column",
                               hint="Write meaning:name, such as --set columns=x:Rechtswert.")
        if meaning not in aliases:
            raise unknown_name("meaning of a column", meaning, aliases)
        own[meaning] = (name.casefold(),)
    return {**aliases, **own}


def read_table(path: Path, aliases: Aliases, *, flat: bool = False) -> Table:
    """Return the table of a file whose header names the columns.

    Parameters
    ----------
    path : pathlib.Path
    aliases : mapping
        Names of the columns by meaning. Numbers other than deviations are required,
        and so are ids if they are among the meanings.
    flat : bool
        Whether the heights, meanings that begin with z, may all be missing. They are then blank,
        and a note says so.

    Raises
    ------
    TermselError
        If the file is not such a table.
    """
    text = read_text(path)
    _, delimiter = _header(text)
    rows, lines, comments = _rows(path, text, delimiter)
    crs = _declared_crs(path, comments)
    if not rows:
        raise TermselError("the file has no table", file=path,
                           hint="It must begin with a header that names the columns.")
    header, header_line = rows.pop(0), lines.pop(0)
    found = _columns(path, header_line, header, aliases, flat=flat)
    if not rows:
        raise TermselError("there are no rows below the header", file=path, line=header_line,
                           hint="Add one row per feature.")
    width = len(header)
    if set(map(len, rows)) != {width}:
        i = next(i for i, row in enumerate(rows) if len(row) != width)
        comma = " Decimal commas require semicolons between columns." if delimiter == "," else ""
        raise TermselError(f"the row has {len(rows[i])} cells, but the header has {width}",
                           file=path, line=lines[i],
                           hint=f"Every row needs one cell for each column.{comma}")
    columns = {meaning: [row[i] for row in rows] for meaning, i in found.items()}
    decimal_comma = delimiter != "," and any(
        "," in "".join(columns[meaning]) for meaning in columns.keys() - USE.keys())
    return Table(path, crs, {meaning: header[i].strip() for meaning, i in found.items()},
                  columns, lines, decimal_comma,
                  {name: text_array([as_text(row[i], decimal_comma=decimal_comma) for row in rows])
                   for name, i in further(header, found.values()).items()})
