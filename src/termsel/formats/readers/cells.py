"""Rows of cells of a file: text between separators in any usual encoding, or a sheet."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from termsel.core.errors import TermselError, count_in_words, require_import
from termsel.core.files.apart import call_apart
from termsel.core.files.names import is_there
from termsel.data.coordinates.crs import begins_as_crs, normalise
from termsel.data.tables.columns import USE, Aliases, columns_by_meaning, find_declared_columns
from termsel.formats.base import read_data
from termsel.formats.encodings import BadText, decode, decode_file

_DELIMITERS = (",", ";", "\t", "|", "")
"""The last stands for spaces."""

_FEWEST_NAMES = 3  # of a header
_HEADER_WITHIN = 4_000  # characters in which a header is looked for among comments
_PLAIN_COMMA = re.compile(r"(?<!\d),|,(?!\d)")  # not between digits
_XML_OR_JSON = re.compile(r"\s*(<|\{|\[\s*\{)")
_SEARCHED = 20  # rows in which a header may be found, below a title
WIDEST = 1_000  # columns
_SHEETS = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1")  # zip of .xlsx and .ods; .xls


@dataclass(frozen=True)
class Cells:
    """Rows of a table before their meaning is known, without blank ones and comments.

    Each row begins on one of `lines` of the file, or has that number; `row_name` is what a row is
    called: "line", or "feature" or "row" of a table without lines. `comments` are by line.
    `delimiter` separates cells of text, "" for spaces and for tables without text. `fixed` are
    columns whose meaning is known whatever their names say, `notes` what was decided in reading.
    """

    rows: list[list[str]]
    lines: list[int]
    comments: Mapping[int, str] = field(default_factory=dict)
    delimiter: str = ""
    row_name: str = "line"
    fixed: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def as_cell(value: Any) -> str:
    """Return a value as the text of a cell, "" for one of pandas that is missing.

    Whole numbers have no decimal point, as readers of spreadsheets give an id 17 as 17.0.
    """
    # NaN differs from itself; NaT and <NA> are those of pandas, masked cells those of numpy.
    if value is None or value is np.ma.masked or value != value or str(value) in ("NaT", "<NA>"):
        return ""
    if isinstance(value, float | np.floating):
        number = float(value)
        return str(int(number)) if number.is_integer() and abs(number) < 1e15 else repr(number)
    return str(value)


def count_meanings(header: Sequence[str], aliases: Aliases, stated: Mapping[str, str]) -> int:
    """Return how many meanings of numbers a header names."""
    header = header[:WIDEST]  # a wider one is refused when it is read
    named = find_declared_columns(header, stated).keys() | {
        meaning for meaning, columns in columns_by_meaning(header, aliases).items() if columns}
    # Roles and ids say nothing of which table it is.
    return len((named & aliases.keys()) - USE.keys())


def header_row(rows: Sequence[Sequence[str]], aliases: Aliases, stated: Mapping[str, str]) -> int:
    """Return the row that names most columns, among the first ones; 0 where none names three."""
    counts = [count_meanings(row, aliases, stated) for row in rows[:_SEARCHED]]
    best = max(counts, default=0)
    return counts.index(best) if best >= _FEWEST_NAMES else 0


def read_cells(path: Path, aliases: Aliases, stated: Mapping[str, str], layer: str | None = None,
               ) -> Cells:
    """Return the rows of a file; `aliases` and `stated` choose its separator, or its sheet.

    Raises
    ------
    TermselError
        If the file cannot be read, or is a text and a layer is asked for.
    """
    data = read_data(path)
    # Spreadsheets are known by their first bytes, whatever their name.
    if data.startswith(_SHEETS):
        return _choose_sheet(path, aliases, stated, layer)
    if layer is not None:
        raise TermselError("a text table has no layers or sheets, and layer "
                           f"{layer!r} is asked for", file=path, hint="Leave the option layer out.")
    text = _with_header(decode_file(data, path), aliases, stated)
    _refuse_wide(path, text)
    return _without_crs_line(_rows_of_text(path, text, _best_delimiter(text, aliases, stated)))


def first_rows(path: Path, head: bytes, aliases: Aliases,
               stated: Mapping[str, str]) -> list[list[str]]:
    """Return the first rows of a file that begins with `head`; none where it is no table.

    Of a spreadsheet these are all rows of the sheet that would be read.
    """
    if head.startswith(_SHEETS):
        try:
            return _choose_sheet(path, aliases, stated, None).rows if is_there(path) else []
        except TermselError:
            return []
    try:
        text, _ = decode(head, path, final=False)
    except TermselError:
        return []
    # Other readers take or refuse XML and JSON.
    if _XML_OR_JSON.match(text):
        return []
    text = _with_header(text, aliases, stated)
    delimiter = _best_delimiter(text, aliases, stated)
    return [_split_line(line, delimiter) for line in _first_lines(text)]


def _refuse_wide(path: Path, text: str) -> None:
    """Raise BadText for an endless first row.

    Comparing a million names with those that are known would take minutes.
    """
    first = next(_first_lines(text), "")
    cells = max(len(_split_line(first, delimiter)) for delimiter in _DELIMITERS)
    if cells > WIDEST:
        raise BadText(f"the first row has {cells:,} cells, more than {WIDEST:,}", file=path,
                      line=text[:text.index(first)].count("\n") + 1,
                      hint="Give a table with a row per point.")


def _first_lines(text: str) -> Iterator[str]:
    """Yield the first lines that are neither blank nor comments, of ENVI either."""
    lines = (line for line in io.StringIO(text, newline="")
             if line.strip() and line[0] != "#" and not line.startswith("; "))
    for line, _ in zip(lines, range(_SEARCHED), strict=False):
        yield line


def _with_header(text: str, aliases: Aliases, stated: Mapping[str, str]) -> str:
    """Return the text of a table with its header as a plain line, where it was a comment.

    NumPy writes such a header. It stands right above the first row and has as many cells: other
    comments explain formats. Any other text comes back as it is.
    """
    lines = text[:_HEADER_WITHIN].splitlines(keepends=True)
    first_row = next((i for i, line in enumerate(lines) if line.strip() and line[0] != "#"), 0)
    if not first_row or not lines[first_row - 1].startswith("#"):
        return text
    header = lines[first_row - 1].lstrip("# ")
    for delimiter in _delimiters_of(header):
        cells = _split_line(header, delimiter)
        if (count_meanings(cells, aliases, stated) >= _FEWEST_NAMES
                and len(_split_line(lines[first_row], delimiter)) == len(cells)
                and not any(_names_in(line, aliases, stated) >= _FEWEST_NAMES
                            for line in _first_lines(text))):
            return text.replace(lines[first_row - 1], header, 1)
    return text


def _names_in(line: str, aliases: Aliases, stated: Mapping[str, str]) -> int:
    """Return how many meanings a line names, with the separator with which it names most."""
    return max(count_meanings(_split_line(line, delimiter), aliases, stated)
               for delimiter in _delimiters_of(line))


def _delimiters_of(line: str) -> tuple[str, ...]:
    """Return the separators that a line may have: next to tabs, spaces are within cells.

    Next to three commas that are not decimal they are, too.
    """
    has_separators = re.search(r"[;\t|]", line.strip()) or len(_PLAIN_COMMA.findall(line)) > 2
    return _DELIMITERS[:-1] if has_separators else _DELIMITERS


def _split_line(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line; [] if it cannot be a row, as with an open quotation mark."""
    if not delimiter:
        return line.split()
    try:
        return next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:
        return []


def _best_delimiter(text: str, aliases: Aliases, stated: Mapping[str, str]) -> str:
    """Return the separator of a text: the one with which one of its first lines names most columns.

    Where none names enough columns, the last of these lines decides: by the sign that it has most
    of, or by its words.
    """
    return _delimiter_of_lines(tuple(_first_lines(text)), tuple(
        (meaning, tuple(names)) for meaning, names in aliases.items()),
                               tuple(stated.items()))


@lru_cache(64)  # several readers ask about a file, some of them several times
def _delimiter_of_lines(lines: tuple[str, ...], items: tuple[tuple[str, tuple[str, ...]], ...],
                        stated_items: tuple[tuple[str, str], ...]) -> str:
    """Return the separator of a text with these first lines, as `_best_delimiter` finds it.

    It is "" where blanks separate the columns.
    `items` and `stated_items` are the items of its mappings, as a cache takes no mappings.
    """
    aliases = dict(items)
    stated = dict(stated_items)
    candidates = [(0, 0, 0, ",")]
    for i, line in enumerate(lines):
        for delimiter in _delimiters_of(line):
            cells = _split_line(line, delimiter)
            # Most columns named, then the earliest line, then most cells.
            width = len(cells) if delimiter else 0
            candidates.append((count_meanings(cells, aliases, stated), -i, width, delimiter))
    names, _, _, best_delimiter = max(candidates)
    if names >= _FEWEST_NAMES:
        return best_delimiter
    # A title may stand above the last of the lines, but not below it.
    last_line = lines[-1] if lines else ""
    # Commas between digits may be decimal, where anything else separates cells.
    without_decimals = re.sub(r"(?<=\d),(?=\d)", "", last_line)
    most_frequent = max(",;\t|", key=without_decimals.count)
    if most_frequent in without_decimals:
        return most_frequent
    return "" if len(last_line.split()) > 2 else ","


def _rows_of_text(path: Path, text: str, delimiter: str) -> Cells:
    """Return the rows of a text with the lines they begin on, and its comments.

    A row may go over several lines within quotation marks, so that its number is that of the line
    it begins on. Lines that begin with # between rows are comments, which may declare the CRS.
    Without a `delimiter` cells are separated by any number of blanks.

    Raises TermselError, with the line, for a row that cannot be read, as of an open quotation mark.
    """
    rows: list[list[str]] = []
    lines: list[int] = []
    comments: dict[int, str] = {}
    end = 0

    def without_comments() -> Iterator[str]:
        """Yield the lines of the text; a comment between rows is blank, and kept apart."""
        for number, line in enumerate(io.StringIO(text, newline=""), 1):
            # `end` is the last line of the row before. A line within quotation marks, whose "#" is
            # part of a cell, is not the one that follows it.
            if line[0] == "#" and number == end + 1:
                comments[number] = line
                line = "\n"
            yield line if delimiter else " ".join(line.split()) + "\n"

    reader = csv.reader(without_comments(), delimiter=delimiter or " ", strict=True)
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
    return Cells(rows, lines, comments, delimiter)


def _without_crs_line(cells: Cells) -> Cells:
    """Return the cells with a first line that is a CRS turned into a comment that states the CRS.

    Lists of OpenDroneMap begin so, and tables made from them. Other cells come back as they are.
    """
    if not cells.rows:
        return cells
    # The line as it stood in the file: a CRS in WKT has commas, and was cut into cells there.
    text = (cells.delimiter or " ").join(cells.rows[0])
    if not begins_as_crs(text):
        return cells
    try:
        crs = normalise(text)
    except TermselError:
        return cells
    return replace(cells, rows=cells.rows[1:], lines=cells.lines[1:],
                   comments={**cells.comments, cells.lines[0]: f"# crs: {crs}"})


def _choose_sheet(path: Path, aliases: Aliases, stated: Mapping[str, str],
                  layer: str | None) -> Cells:
    """Return the rows of a sheet of a spreadsheet: the first visible one that names columns.

    The sheet `layer`, if any, is chosen instead. Raises TermselError where there is no such sheet,
    or none that is visible.
    """
    with require_import("spreadsheets require", "python-calamine", '"termsel[tables]"', path):
        import python_calamine  # noqa: F401 (what the other process imports)
    # In a process of its own: a small file can claim billions of cells.
    names, sheets = call_apart(_visible_sheets, path, layer)
    if not sheets:
        raise TermselError(f"the file has no sheet {layer!r}" if layer else "no sheet is visible",
                           file=path, hint=f"It has {', '.join(names) or 'hidden sheets alone'}.")
    with_header = []
    for name, (rows, _) in sheets.items():
        counts = [count_meanings(row, aliases, stated) for row in rows[:_SEARCHED]]
        if max(counts, default=0) >= 3:
            with_header.append(name)
    sheet = (with_header or list(sheets))[0]
    notes = () if len(with_header) < 2 else (
        f"{path} has tables in the sheets {', '.join(with_header)}; {sheet} is read, and --set "
        "layer=NAME chooses another",)
    return Cells(*sheets[sheet], notes=notes)


def _visible_sheets(path: Path, layer: str | None,
                    ) -> tuple[list[str], dict[str, tuple[list[list[str]], list[int]]]]:
    """Return the names of the visible sheets, and the rows of sheets with their numbers, by name.

    The rows are of the sheet that `layer` names, even a hidden one, or of all visible sheets. A
    sheet of a kilobyte can say that it has 17 billion cells: see `termsel.core.files.apart`.

    Raises TermselError for a spreadsheet that cannot be read.
    """
    from python_calamine import CalamineError, CalamineWorkbook, SheetVisibleEnum

    try:
        with CalamineWorkbook.from_path(str(path)) as book:
            # Hidden sheets are often old versions, and are read only by name.
            names = [sheet.name for sheet in book.sheets_metadata
                     if sheet.visible == SheetVisibleEnum.Visible or sheet.name == layer]
            rows_by_name = {}
            for name in names:
                if layer in (None, name):
                    rows = book.get_sheet_by_name(name).to_python(skip_empty_area=False)
                    rows_by_name[name] = _nonempty_rows(rows)
            return names, rows_by_name
    except (CalamineError, OSError, ValueError) as error:
        reason = "it is damaged, or no spreadsheet" if "zip" in str(error).lower() else error
        raise TermselError(f"this spreadsheet cannot be read: {reason}", file=path,
                           hint="Save it again, or as CSV.") from None


def _nonempty_rows(values: Sequence[Sequence[Any]]) -> tuple[list[list[str]], list[int]]:
    """Return the rows of a sheet that are not empty, and their numbers in it, from 1.

    All are as wide as the last column that any of them uses.
    """
    rows = [list(map(as_cell, row)) for row in values]
    lines = [number for number, row in enumerate(rows, 1) if any(map(str.strip, row))]
    rows = [rows[number - 1] for number in lines]
    widths = [max((i + 1 for i, cell in enumerate(row) if cell.strip()), default=0)
              for row in rows]
    width = max(widths, default=0)
    return [row[:width] for row in rows], lines


def rows_of_records(records: Sequence[Mapping[str, Any]], row_name: str,
                    fixed: Mapping[str, str], numbers: Sequence[int] = ()) -> Cells:
    """Return records, such as the properties of features, as rows below a header.

    Values that are lists or objects are left out. `row_name` is what messages call a record,
    `numbers` are their numbers there, by default from 1. `fixed` are names of records by the
    meaning that they are known to have.
    """
    texts = []
    for record in records:
        texts.append({name: as_cell(value) for name, value in record.items()
                      if not isinstance(value, list | dict)})
    # Every name that occurs, in the order in which they first do: records may lack some.
    names = list(dict.fromkeys(chain.from_iterable(texts)))
    rows = [[record.get(name, "") for name in names] for record in texts]
    columns = {meaning: names.index(name) for meaning, name in fixed.items() if name in names}
    return Cells([list(map(str, names)), *rows], [0, *(numbers or range(1, len(rows) + 1))],
                 row_name=row_name, fixed=columns)


def counts_columns(row: Sequence[str]) -> bool:
    """Return whether a row counts columns, from 0 as pandas heads those without names, or years."""
    numbers = [cell.strip() for cell in row]
    # The column of the index has no name.
    numbers = numbers[1:] if numbers and not numbers[0] else numbers
    if len(numbers) <= 3 or not all(cell.isdecimal() for cell in numbers):
        return False
    first = int(numbers[0])
    return numbers == [str(first + i) for i in range(len(numbers))]


def without_header(cells: Cells, stated: Mapping[str, str]) -> Cells:
    """Return a table that has no header with the numbers of its columns as a header.

    A table has no header where columns are declared by number, and the first row holds numbers in
    these. Rows above that, whose cells are too few or count the columns, are left out as a title.
    Any other table is returned as it is.
    """
    largest = max((int(name) for name in stated.values() if name.isdecimal()), default=0)
    # The first row that has all declared columns, and does not merely count columns.
    n_titles = next((i for i, row in enumerate(cells.rows[:_SEARCHED])
                     if len(row) >= largest and not counts_columns(row)), 0)
    first_row = cells.rows[n_titles] if cells.rows else []
    columns = find_declared_columns(first_row, stated)
    names = {name.strip().casefold() for name in first_row}
    by_number = [i for meaning, i in columns.items()
                 if meaning not in USE and stated[meaning].casefold() not in names]
    # Words in the declared columns of the first row make it a header.
    if not by_number or not all(any(map(str.isdigit, first_row[i])) for i in by_number):
        return cells
    header = [str(i + 1) for i in range(len(first_row))]
    notes = cells.notes
    if n_titles:
        title = " ".join(chain.from_iterable(cells.rows[:n_titles]))
        notes = (*notes, f"{count_in_words(n_titles, cells.row_name)} above the points left out as "
                         f"a title: {title}")
    return replace(cells, rows=[header, *cells.rows[n_titles:]],
                   lines=[0, *cells.lines[n_titles:]], notes=notes)
