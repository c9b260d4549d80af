"""Tables of text: cells by the meaning of their columns, with the place of every bad cell.

Comment lines begin with ``#``; ``# crs: EPSG:4979`` declares the CRS and ``# units: degrees``
or ``# units: metres`` the units of the ground coordinates.
"""

from __future__ import annotations

import logging
import re
from abc import abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

from termsel.core.errors import TermselError
from termsel.core.files.texts import unguarded
from termsel.core.options import Option
from termsel.data.coordinates.crs import normalise
from termsel.data.features import FeatureSet
from termsel.data.tables.attributes import is_free, text_array
from termsel.data.tables.columns import (
    OPTIONAL,
    TAKEN,
    USE,
    Aliases,
    declared,
    matches,
    parse_columns,
)
from termsel.data.tables.numbers import COMMA, POINT, BadCell, decimal_signs
from termsel.formats.base import Reader, located
from termsel.formats.readers.advice import with_advice
from termsel.formats.readers.cells import (
    Cells,
    found_in,
    header_row,
    read_cells,
    sniffed,
    without_header,
)
from termsel.formats.readers.table import Table

log = logging.getLogger(__name__)

COLUMNS: tuple[Option, ...] = (
    Option("columns", "", "Which column is which, as meaning=name or meaning=number, such as "
                          "x=Rechtswert,line=4 (--columns)."),
    Option("decimal", None, "Decimal sign, if 1,234 or 1.234 may be one thousand.",
           choices=("comma", "point")),
    Option("layer", None, "Layer of a GIS file, or sheet of a spreadsheet; by default the first "
                          "that fits."),
)
"""The options of readers of tables."""

_DECLARATION = re.compile(r"#\s*(crs|units?)\s*[:=](.*)", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+")
_UNITS = re.compile(r"(deg|degrees?|m|met(re|er)s?)", re.IGNORECASE)


def sniff_table(path: Path, head: bytes, aliases: Aliases, columns: str = "",
                needed: Sequence[str] = ()) -> bool:
    """Return True if a header names at least three columns of numbers, and all `needed`."""
    own = parse_columns(columns)
    rows = sniffed(path, head, aliases, own)
    if not rows:
        return False
    header = rows[header_row(rows, aliases, own)]
    there = declared(header, own)
    by_name = matches(header, aliases)
    return (found_in(header, aliases, own) >= 3
            and all(meaning in there or by_name[meaning] for meaning in needed))


def _columns(path: Path | None, line: int | None, header: Sequence[str], rows: list[list[str]],
             aliases: Aliases, chosen: Mapping[str, int], fixed: Collection[int], *,
             flat: bool) -> dict[str, int]:
    """Return the column of each meaning; of heights none if `flat` and all are missing."""
    here = f"The columns here are: {', '.join(cell.strip() for cell in header)}."
    found: dict[str, int] = {}
    by_name = matches(header, aliases)
    sigma = any(by_name.get(meaning) or meaning in chosen for meaning in ("sigma_line",
                                                                          "sigma_sample"))
    heights = [meaning for meaning in aliases if meaning[0] == "z"]
    for meaning in aliases:
        places = [i for i in by_name[meaning] if i not in chosen.values()]
        if meaning in chosen:
            found[meaning] = chosen[meaning]
        elif len(places) > 1 and meaning != "id" and not _complement(rows, places):
            named = " and ".join(repr(header[i].strip()) for i in places)
            raise with_advice(
                TermselError(f"columns {named} both mean {meaning}", file=path, line=line,
                             column=header[places[1]].strip(),
                             hint="Rename or remove all but one of them."),
                header, rows, {**found, meaning: places[0]}, aliases, fixed)
        elif places:
            found[meaning] = places[0]
        elif not ((meaning in OPTIONAL and not (sigma and meaning.startswith("sigma")))
                  or (meaning[0] == "z" and flat and not any(by_name[one] for one in heights))):
            blank = " Its cells may be blank." if meaning[0] == "z" else ""
            names = [name for name in aliases[meaning] if name in TAKEN] or aliases[meaning]
            raise with_advice(
                TermselError(f"there is no column for {meaning}", file=path, line=line,
                             column=meaning, hint=f"{here} Accepted names: {', '.join(names)}, "
                                                  f"and others.{blank}"),
                header, rows, {**{one: columns[-1] for one, columns in by_name.items() if columns},
                               **chosen}, aliases, fixed)
    # Said once the table can be read: the columns of one that cannot are looked for again.
    if flat and not any(by_name[meaning] or meaning in chosen for meaning in heights):
        log.info("Note: %s has no column for %s, so its heights are unknown. Accepted names: %s.",
                 path or "the table", " and ".join(heights), ", ".join(aliases[heights[0]]))
    return found


def _complement(rows: list[list[str]], places: Sequence[int]) -> bool:
    """Put cells of several columns into the first of them, if no row has two; say whether."""
    if not rows or min(map(len, rows)) <= max(places) or any(
            sum(bool(row[i].strip()) for i in places) > 1 for row in rows):
        return False
    for row in rows:
        row[places[0]] = "".join(row[i] for i in places)
    return True


def _declared_crs(path: Path | None, comments: Mapping[int, str]) -> str:
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


def read_table(path: Path, aliases: Aliases, *, columns: str = "", decimal: str | None = None,
               layer: str | None = None, flat: bool = False) -> Table:
    """Return the table of a file whose header names the columns, as `columns`, too, may say.

    `aliases` has the names of the columns by meaning. Numbers other than deviations are required;
    if `flat`, the heights, meanings that begin with z, may all be missing: they are then blank,
    and a note says so. Raises TermselError if the file is not such a table.
    """
    own = parse_columns(columns)
    return table_of(path, read_cells(path, aliases, own, layer), aliases, own, decimal, flat=flat)


def table_of(path: Path | None, cells: Cells, aliases: Aliases, own: Mapping[str, str],
             decimal: str | None = None, *, flat: bool = False) -> Table:
    """Return the table of rows of cells, as `read_table`; `path` is for messages.

    `own` has names or numbers of columns by meaning, as the user says.
    """
    for note in cells.notes:
        log.info("Note: %s.", note)
    crs = _declared_crs(path, cells.comments)
    if not cells.rows:
        raise TermselError("the file has no table", file=path,
                           hint="It must begin with a header that names the columns.")
    own = {meaning: name for meaning, name in own.items() if meaning in aliases}
    cells = without_header(cells, own)
    first = 0 if cells.part != "line" else header_row(cells.rows, aliases, own)
    header, rows, lines = cells.rows[first], cells.rows[first + 1:], cells.lines[first + 1:]
    line = cells.lines[first] or None
    if first:
        log.info("Note: the header of %s is taken from line %s, below a title.", path, line)
    chosen = {**cells.fixed, **declared(header, own)}
    for meaning in own.keys() - declared(header, own).keys():
        raise TermselError(f"there is no column {own[meaning]!r} for {meaning}", file=path,
                           line=line, hint=f"The columns here are: {', '.join(header)}.")
    found = _columns(path, line, header, rows, aliases, chosen,
                     cells.fixed.values(), flat=flat)
    width = len(header)
    if rows and set(map(len, rows)) != {width}:
        # Spreadsheets leave separators after the last cell.
        rows = [row if "".join(row[width:]).strip() else row[:width] for row in rows]
        i = next((i for i, row in enumerate(rows) if len(row) != width), None)
        comma = " Decimal commas require semicolons between columns." \
            if cells.delimiter == "," else ""
        if i is not None:
            raise TermselError(f"the row has {len(rows[i])} cells, but the header has {width}",
                               file=path, line=lines[i],
                               hint=f"Every row needs one cell for each column.{comma}")
    numbers = [i for meaning, i in found.items() if meaning not in USE]
    if rows and not any(any(map(str.isdigit, rows[0][i])) for i in numbers) \
            and any(rows[0][i].strip() for i in numbers) and len(rows) > 1:
        log.info("Note: line %s of %s, below the header, holds no numbers and is left out: %s.",
                 lines[0], path or "the table", " ".join(filter(None, rows[0])))
        rows, lines = rows[1:], lines[1:]
    if not rows:
        raise TermselError("there are no rows below the header", file=path, line=line,
                           hint="Add one row per feature.")
    table = Table(path, crs, {meaning: header[i].strip() for meaning, i in found.items()},
                  {meaning: [row[i] for row in rows] for meaning, i in found.items()}, lines,
                  part=cells.part)
    signs = _signs(table, decimal, points_only=cells.delimiter == ",")
    if "id" in aliases and "id" not in found:
        log.info("Note: %s has no column of ids, so its rows are called P1, P2, ... in order.",
                 path or "the table")
    more = {name: [unguarded(row[i].strip()) for row in rows]
            for name, i in _further(header, {*found.values(), *cells.fixed.values()}).items()}
    if COMMA in signs.values():
        more = {name: [text.replace(COMMA, POINT) if _DECIMAL_COMMA.fullmatch(text) else text
                       for text in texts] for name, texts in more.items()}
    return replace(table, signs=signs,
                   more={name: text_array(texts) for name, texts in more.items()})


def _further(header: Sequence[str], used: Collection[int]) -> dict[str, int]:
    """Return the places of the columns that are attributes, by name; of several alike the first."""
    columns: dict[str, int] = {}
    for i, cell in enumerate(header):
        name = unguarded(cell.strip())
        if i not in used and is_free(name) and name.casefold() not in map(str.casefold, columns):
            columns[name] = i
    return columns


def _signs(table: Table, decimal: str | None, *, points_only: bool) -> dict[str, str]:
    """Return the decimal sign of each column of numbers, and say what was decided."""
    columns = {meaning: cells for meaning, cells in table.columns.items() if meaning not in USE}
    asked = {"comma": COMMA, "point": POINT}.get(decimal or "", "")
    try:
        signs, resolved = decimal_signs(columns, asked, points_only=points_only)
    except BadCell as error:
        raise table.error(error.what, error.row, error.column, error.hint) from None
    for meaning, sign in signs.items():
        if not sign:
            row = next(i for i, cell in enumerate(columns[meaning])
                       if COMMA in cell or POINT in cell)
            raise table.error(
                f"{columns[meaning][row].strip()!r} may be above one thousand or not, and no "
                "other column decides it", row, meaning, "State the decimal sign: --set "
                                                         "decimal=comma or decimal=point.")
    if resolved:
        word = "comma" if signs[resolved[0]] == COMMA else "point"
        log.info("Note: the decimal sign of %s is taken to be a %s, as %s; the other sign "
                 "separates thousands in the columns %s.", table.path or "the table", word,
                 "you say" if asked else "in its other columns",
                 ", ".join(table.names[meaning] for meaning in resolved))
    return signs


class TableReader(Reader):
    """Base of the readers of tables, which name the columns they know by meaning.

    One group of the meanings in `needed` must be there; if `flat`, the heights may all be missing.
    """

    known: ClassVar[Aliases]
    needed: ClassVar[tuple[tuple[str, ...], ...]] = ((),)
    flat: ClassVar[bool] = True
    declared_options: ClassVar[tuple[Option, ...]] = COLUMNS

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True if a header names at least three columns of the format."""
        return any(sniff_table(path, head, self.known, self.options.get("columns", ""), group)
                   for group in self.needed)

    def read(self, path: Path) -> FeatureSet:
        """Return the features of a table; errors name file, line and column."""
        return self.features(self.table(path))

    def table(self, path: Path) -> Table:
        """Return the cells of a file by their meaning."""
        return read_table(path, self.known, flat=self.flat, **{
            option.name: self.options[option.name] for option in COLUMNS
            if option.name in self.options})

    @abstractmethod
    def features(self, table: Table) -> FeatureSet:
        """Return the features of a table."""

    def placed(self, error: TermselError, path: Path) -> TermselError:
        """Return the error with line and column."""
        return self.table(path).placed(error)
