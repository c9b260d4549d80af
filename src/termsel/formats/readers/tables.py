"""Tables of text: cells by the meaning of their columns, with the place of every bad cell.

Comment lines begin with ``#``; ``# crs: EPSG:4979`` declares the CRS and ``# units: degrees``
or ``# units: metres`` the units of the ground coordinates.
"""

from __future__ import annotations

import logging
import re
from abc import abstractmethod
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from termsel.core.errors import (
    ON_SUCCESS,
    PENDING,
    TermselError,
    amount_in_words,
    count_in_words,
    cut,
    first_names_in_words,
)
from termsel.core.files.texts import unguard_cell
from termsel.core.options import Option
from termsel.core.remedies import Remedy
from termsel.data.coordinates.crs import normalise
from termsel.data.features import ROLES, FeatureSet, FloatArray, Points
from termsel.data.roles import FIELD_ROLES
from termsel.data.tables.columns import (
    COMMA,
    COORDINATES,
    OPTIONAL,
    POINT,
    TAKEN,
    USE,
    Aliases,
    BadCell,
    columns_by_meaning,
    coordinate_in_brackets,
    decimal_signs,
    find_declared_columns,
    fold_name,
    parse_columns,
    read_numbers,
)
from termsel.data.tables.tabular import (
    Attributes,
    is_free,
    reason_to_refuse_id,
    rows_at,
    text_array,
)
from termsel.data.tables.unit_names import (
    ANGLES,
    FACTORS,
    UNIT_WORDS,
    counts_against_axis,
    unit_in_name,
    unit_of_image_in_name,
    unit_of_text,
    unknown_remark,
)
from termsel.formats.base import Reader, error_in_file
from termsel.formats.readers.advice import EXPECTED, with_advice, with_both_readings
from termsel.formats.readers.angles import column_of_sides, joined_angles, with_side
from termsel.formats.readers.cells import (
    Cells,
    count_meanings,
    first_rows,
    header_row,
    read_cells,
    without_header,
)
from termsel.formats.readers.flags import find_flags, remarks_on_unread, truth_of
from termsel.formats.repeated import average_repeated, is_averaging
from termsel.formats.stated_roles import ids_stated_off, ids_with_stated_roles

# Cells by the meaning of their columns, with the place of every bad cell.

VOID_HEIGHTS = (-9999.0, -32768.0, -32767.0)
"""What rasters of heights have where there is none, and people sample from them."""


@dataclass(frozen=True)
class Table:
    """The cells of a file, by the meaning of their columns.

    `names` holds the header's text for each meaning, `lines` the line of the file each row
    begins on or, where `row_name` is another word, its number; `attributes` the cells of the
    columns without a meaning; `signs` the decimal sign of each column; `image_size` lines and
    samples of the image, where the file declares them.
    """

    path: Path | None
    crs: str
    names: Mapping[str, str]
    columns: Mapping[str, Sequence[str]]
    lines: Sequence[int]
    attributes: Attributes = field(default_factory=dict)
    row_name: str = "line"
    signs: Mapping[str, str] = field(default_factory=dict)
    image_size: tuple[int, int] | None = None

    def error(self, message: str, row: int, meaning: str, hint: str | None = None) -> TermselError:
        """Return an error with the place of a cell."""
        return self.at(TermselError(message, hint=hint, column=self.names[meaning]), row)

    def at(self, error: TermselError, row: int | None) -> TermselError:
        """Return an error with the place of a row."""
        # Records have no line in a file, so that the message counts them.
        if row is not None and self.row_name != "line":
            error.what = f"{self.row_name} {self.lines[row]}: {error.what}"
            row = None
        return error_in_file(error, self.path, None if row is None else self.lines[row])

    def take(self, rows: Sequence[int]) -> Table:
        """Return the table of some rows."""
        columns = {}
        for meaning, cells in self.columns.items():
            columns[meaning] = [cells[row] for row in rows]
        return replace(self, lines=[self.lines[row] for row in rows], columns=columns,
                       attributes=rows_at(self.attributes, np.asarray(rows, dtype=np.intp)))

    def placed(self, error: TermselError) -> TermselError:
        """Return an error with the line of the first feature it names, and its column as headed.

        The error comes with the meaning of a column, such as "x", if it is about one. A feature
        whose id occurs in several rows has no line.
        """
        rows = [row for row, name in enumerate(self.ids()) if name in error.ids[:1]]
        error.column = self.names.get(str(error.column or ""))
        return self.at(error, rows[0] if len(rows) == 1 else None)

    def ids(self) -> list[str]:
        """Return the ids, P1, P2, ... where the format has none.

        Raises
        ------
        TermselError
            For an id that is not allowed, with its line and column.
        """
        numbers = range(1, len(self.lines) + 1) if self.row_name == "line" else self.lines
        by_number = [f"P{number}" for number in numbers]
        if "id" not in self.columns:
            return by_number
        # Spreadsheets guard text against being read as a formula; that is taken off again.
        names = [unguard_cell(cell.strip()) for cell in self.columns["id"]]
        if self.may_lack_names():
            names = [name or number for name, number in zip(names, by_number, strict=True)]
        for row, name in enumerate(names):
            if wrong := reason_to_refuse_id(name):
                raise self.error(f"the id {wrong}", row, "id", "Give every point or line a short "
                                                               "id of letters, digits and signs.")
        return names

    def may_lack_names(self) -> bool:
        """Return whether blank ids are no mistake: all are blank, or the column is one of names.

        Points of MapWarper have a name where somebody gave them one.
        """
        return not any(map(str.strip, self.columns["id"])) or self.names["id"].casefold() != "id"

    def points(self, image: FloatArray, ground: FloatArray, sigma: FloatArray | None,
               roles: Sequence[str]) -> Points:
        """Return the points of all rows, with these coordinates and roles.

        `image` (n, 2), `ground` (n, 3) and `sigma` (n, 2) are those of the n rows. Repeated points
        become one where they are to be averaged.

        Raises TermselError, with its line, for an id that is used twice, and for what `Points`
        refuses.
        """
        ids = self.ids()
        first_row_of: dict[str, int] = {}
        for row, name in enumerate(ids):
            first_row = first_row_of.setdefault(name, row)
            # Ids that were made up from the numbers of rows are not repeated.
            if first_row != row and "id" in self.names:
                if self._row(row) == self._row(first_row):
                    raise self._repeated_row(row, first_row)
                raise self.error(f"id {name!r} is already used on {self.row_name} "
                                 f"{self.lines[first_row]}", row, "id",
                                 "Give every point a different id.")
        attributes = self.attributes
        # Before places are compared: a point that is switched off may share that of another.
        ids_off = ids_stated_off()
        # Formats without roles hand over none.
        roles = ["off" if name in ids_off else role
                 for name, role in zip(ids, roles or [""] * len(ids), strict=True)]
        try:
            if is_averaging():
                first_rows, image, sigma = average_repeated(ids, image, ground, sigma, roles)
                ids = [ids[row] for row in first_rows]
                roles = [roles[row] for row in first_rows]
                ground = ground[first_rows]
                attributes = rows_at(attributes, first_rows)
            return Points(tuple(ids), image, ground, sigma, tuple(roles), attributes)
        except TermselError as error:
            raise self.placed(error) from error

    def _row(self, row: int) -> tuple[str, ...]:
        """Return the cells of a row, of the columns that are known."""
        return tuple(cells[row].strip() for cells in self.columns.values())

    def _repeated_row(self, row: int, first_row: int) -> TermselError:
        """Return the error for a row that is a copy of an earlier one.

        It says how many further rows are copies.
        """
        rows = [self._row(i) for i in range(len(self.lines))]
        further = len(rows) - len(set(rows)) - 1
        more = ""
        if further:
            verb = "repeats" if further == 1 else "repeat"
            more = f", and {count_in_words(further, 'more row')} {verb} others"
        return self.error(f"this row repeats {self.row_name} {self.lines[first_row]}{more}", row,
                          "id", "Delete the copies: a point that is there twice would weigh twice.")

    def roles(self) -> list[str]:
        """Return the role of each row, in their order; "" where a blank cell leaves it open.

        A table of QGIS has a column `enabled` in place of roles: rows that are not enabled are
        "off". Where the command states the role of an id, its cell counts as blank, whatever is in
        it.

        Raises TermselError, at line and column, for a role or flag that is unknown.
        """
        cells = list(self.columns.get("role", [""] * len(self.lines)))
        ids_of_command = ids_with_stated_roles()
        if ids_of_command:
            cells = ["" if name in ids_of_command else cell
                     for name, cell in zip(self.ids(), cells, strict=True)]
        # There are few distinct cells, however many rows.
        role_of_cell = {cell: cell.strip().lower() for cell in dict.fromkeys(cells)}
        unknown = [cell for cell, role in role_of_cell.items() if role not in ("", *ROLES)]
        if unknown:
            raise self._unknown_roles_error(cells, unknown)
        roles = [role_of_cell[cell] for cell in cells]
        # A row that is not enabled is off, whatever role it has.
        is_enabled = self._enabled_by_cell()
        for row, cell in enumerate(self.columns.get("enabled", ())):
            if not is_enabled[cell]:
                roles[row] = "off"
        return roles

    def _enabled_by_cell(self) -> dict[str, bool]:
        """Return whether each distinct cell of the column `enabled` stands for true.

        Raises TermselError, at line and column, for a cell that stands for neither true nor false.
        """
        flags = self.columns.get("enabled", ())
        is_enabled = {}
        for cell in dict.fromkeys(flags):
            # A blank cell leaves its row in use.
            meaning = truth_of(cell) if cell.strip() else True
            if meaning is None:
                raise self.error(f"{cell.strip()!r} is neither true nor false",
                                 flags.index(cell), "enabled", "Write 1 or 0.")
            is_enabled[cell] = meaning
        return is_enabled

    def _unknown_roles_error(self, cells: Sequence[str], unknown: Sequence[str]) -> TermselError:
        """Return the error for `unknown`, the distinct cells that name no role, at the first row.

        It says in how many rows each of them is, and what words of the field stand for.
        """
        rows_with = Counter(cells)
        first_unknown = unknown[0]
        if len(unknown) > 1:
            in_words = [f"{cell.strip()!r} ({count_in_words(rows_with[cell], 'row')})"
                        for cell in unknown]
            message = f"unknown roles {first_names_in_words(in_words)}"
        else:
            message = f"unknown role {first_unknown.strip()!r}"
            if rows_with[first_unknown] > 1:
                message += f" in {rows_with[first_unknown]} rows"
        folded_names = [fold_name(cell) for cell in unknown]
        explanations = [FIELD_ROLES[name] for name in folded_names if name in FIELD_ROLES]
        explained = " ".join(dict.fromkeys(explanations)) or (
            "A GCP is control; a point that tests the result is independent; check points choose "
            "the model.")
        return self.error(message, cells.index(first_unknown), "role",
                          f"Roles are {', '.join(ROLES)}, or blank. {explained}")

    def sigma(self, *meanings: str) -> FloatArray | None:
        """Return columns of standard deviations, (n, k); None without them, or if all are blank.

        Raises TermselError if only some cells are blank.
        """
        if meanings[0] not in self.columns:
            return None
        sigma = self.stack(*meanings, may_be_blank=True)
        is_blank = np.isnan(sigma)
        if is_blank.all():
            return None
        if is_blank.any():
            row, axis = (int(i) for i in np.argwhere(is_blank)[0])
            raise self.error("the standard deviation is blank here but not in all rows", row,
                             meanings[axis],
                             "Fill it in for every row, or remove the columns.")
        return sigma

    def stack(self, *meanings: str, may_be_blank: bool = False) -> FloatArray:
        """Return columns of numbers side by side, (n, k); heights may always be blank."""
        return np.column_stack([self._column_numbers(meaning, may_be_blank or meaning[0] == "z")
                                for meaning in meanings])

    def _column_numbers(self, meaning: str, may_be_blank: bool) -> FloatArray:
        """Return the numbers of a column by its meaning, (n,); errors name line and column.

        In this order: the unit of the image must be pixels; numbers are read with the decimal sign
        of the column, angles in degrees, minutes and seconds; -9999 and the like are no heights;
        numbers that count west or south change their sign, or else units in the name, such as km,
        become metres. The last two are noted. A blank cell is NaN where it `may_be_blank`. A table
        without a column of heights has NaN for all.

        Raises TermselError for a cell that is no number, for a height that stands for none, and for
        positions in the image that are no pixels.
        """
        if meaning not in self.columns and meaning[0] == "z":
            return np.full(len(self.lines), np.nan)
        self._require_pixels(meaning)
        sign = self.signs.get(meaning, POINT)
        try:
            # x and y may be degrees, minutes and seconds.
            numbers = read_numbers(self.columns[meaning], sign, may_be_blank=may_be_blank,
                                   angle=meaning[0] if meaning[0] in "xy" else "")
        except BadCell as error:
            raise self.error(error.what, error.row, meaning, error.hint) from None
        # A program that sampled a raster has written its mark for no data as a height.
        void_rows = np.flatnonzero((meaning[0] == "z") & np.isin(numbers, VOID_HEIGHTS))
        if len(void_rows):
            further = ""
            if len(void_rows) > 1:
                further = f", as in {amount_in_words(len(void_rows), 'row')}"
            raise self.error(f"{numbers[void_rows[0]]:.0f} is no height, but what rasters have "
                             f"where there is none{further}", int(void_rows[0]), meaning,
                             "Leave these cells blank, or correct them.")
        if meaning[0] in "xy" and counts_against_axis(self.names[meaning], meaning[0]):
            return self._with_sign_of_axis(numbers, meaning)
        factor = FACTORS.get(self.named_units().get(meaning[0], ""))
        if factor is None:
            return numbers
        log.info("Note: %s is in %s by its name, and is multiplied by %s.",
                 self.names[meaning].strip(), UNIT_WORDS[self.named_units()[meaning[0]]],
                 f"{factor:,.6g}")
        return numbers * factor

    def _require_pixels(self, meaning: str) -> None:
        """Raise TermselError for a column of the image that is in another unit by its name."""
        if not meaning.startswith(("line", "sample")):
            return
        name = self.names[meaning].strip()
        if unit := unit_of_image_in_name(name):
            raise self.error(f"{name} is in {unit} by its name, and image coordinates are pixels",
                             0, meaning, "Divide by the size of a pixel, from the centre of the "
                                         "upper-left pixel to the right and downwards. If they "
                                         "are pixels, leave the unit out of the name.")

    def _with_sign_of_axis(self, numbers: FloatArray, meaning: str) -> FloatArray:
        """Return the angles (n,) of a column that counts west or south, with a minus sign.

        That it does so is in the name of the column, whose `meaning` is one of x or of y; the
        change is noted. Angles that are all negative already stay as they are, and so do all
        numbers if one is beyond 360: they are plane coordinates. Raises TermselError where only
        some angles are negative.
        """
        negative_rows = np.flatnonzero(numbers < 0.0)
        if len(negative_rows) == len(numbers) or np.abs(numbers).max(initial=0.0) > 360.0:
            return numbers
        name = self.names[meaning].strip()
        direction = "west" if meaning[0] == "x" else "south"
        if len(negative_rows):
            raise self.error(f"a number is negative here, and not in other rows, and {name} counts "
                             f"{direction} by its name", int(negative_rows[0]), meaning,
                             "Write all angles with their sign, and leave the direction out of "
                             "the name.")
        log.info("Note: %s counts %s by its name, so that its numbers are taken as negative.",
                 name, direction)
        return -numbers

    def named_units(self) -> dict[str, str]:
        """Return the units of x, y and z that names of columns state; see `unit_in_name`."""
        units = {meaning[0]: unit_in_name(name) for meaning, name in self.names.items()
                 if meaning[0] in "xyz"}
        return {axis: unit for axis, unit in units.items()
                if unit and (axis != "z" or unit not in ANGLES)}


def points_of(table: Table, crs: str) -> FeatureSet:
    """Return the points of a table; raises TermselError, with the cell, for one that is no number.
    """
    image = table.stack("line", "sample")
    ground = table.stack("x", "y", "z")
    sigma = table.sigma("sigma_line", "sigma_sample")
    return FeatureSet(table.points(image, ground, sigma, table.roles()), crs=crs,
                      named_units=table.named_units())


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
_IMAGE_SIZE = re.compile(r"#\s*image_size\s*[:=]\s*(\d{1,7})\s*,\s*(\d{1,7})\s*", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+")
_GROUND_UNIT = re.compile(r"(deg|degrees?|m|met(re|er)s?)", re.IGNORECASE)


def sniff_table(path: Path, head: bytes, aliases: Aliases, columns: str = "",
                required: Sequence[str] = ()) -> bool:
    """Return whether a file is a table whose header names three columns of numbers or more.

    `head` are the first bytes of the file and `columns` what the user says of the headings. The
    header must name all meanings that are `required`, too.
    """
    stated = parse_columns(columns)
    rows = first_rows(path, head, aliases, stated)
    if not rows:
        return False
    header = rows[header_row(rows, aliases, stated)]
    stated_columns = find_declared_columns(header, stated)
    by_name = columns_by_meaning(header, aliases)
    # Two columns could be named x and y in any table; three are hardly a coincidence.
    return (count_meanings(header, aliases, stated) >= 3
            and all(meaning in stated_columns or by_name[meaning] for meaning in required))


def _column_by_meaning(path: Path | None, line: int | None, header: Sequence[str],
                       rows: list[list[str]], aliases: Aliases, stated: Mapping[str, int],
                       fixed: Collection[int], *, flat: bool) -> dict[str, int]:
    """Return the number of each meaning's column, from 0; optional ones that are missing have none.

    `line` is the line of the header, for errors. `stated` are the columns that the user declared,
    by meaning; `fixed` are columns that nobody can declare, such as those of a geometry. If `flat`,
    all columns of heights may be missing. Where several columns have one meaning and never a value
    in the same row, their cells are put together in the first of them, in place.

    Raises TermselError for a meaning whose column is missing, ambiguous, or declared to be another.
    """
    _refuse_one_for_two(path, line, header, stated)
    columns: dict[str, int] = {}
    by_name = columns_by_meaning(header, aliases)

    def is_there(meaning: str) -> bool:
        return bool(by_name.get(meaning)) or meaning in stated

    has_sigma = is_there("sigma_line") or is_there("sigma_sample")
    # A point has one height, a line two.
    heights = [meaning for meaning in aliases if meaning[0] == "z"]
    without_heights = flat and not any(by_name[meaning] for meaning in heights)
    for meaning in aliases:
        candidates = [i for i in by_name[meaning] if i not in stated.values()]
        needs_other_sigma = has_sigma and meaning.startswith("sigma")
        may_be_missing = ((meaning in OPTIONAL and not needs_other_sigma)
                          or (meaning in heights and without_heights))
        # What the user says goes before what the header says.
        if meaning in stated:
            columns[meaning] = stated[meaning]
        elif candidates:
            # Of two columns of ids any will do.
            if len(candidates) > 1 and meaning != "id":
                if not _exclude_each_other(rows, candidates):
                    error = _ambiguous_columns_error(path, line, header, meaning, candidates)
                    stated_or_named = {name: [stated[name]] if name in stated else indices
                                       for name, indices in by_name.items()}
                    raise with_both_readings(error, header, rows, stated_or_named, aliases, fixed)
                _merge_into_first(rows, candidates)
            columns[meaning] = candidates[0]
        elif not may_be_missing:
            _refuse_if_column_taken(path, line, header, meaning, by_name[meaning], stated)
            # A column of deviations that the table lacks cannot be declared: it has to be added.
            if needs_other_sigma:
                present = {"sigma_line": "sigma_sample", "sigma_sample": "sigma_line"}[meaning]
                raise TermselError(f"{present} needs the column {meaning} beside it", file=path,
                                   line=line, column=meaning,
                                   hint=f"Add {meaning}, or remove {present}.")
            missing = [name for name in aliases if not is_there(name) and name not in OPTIONAL
                       and not (name in heights and without_heights)]
            error = _missing_column_error(path, line, header, missing, aliases)
            # Advice needs what is known, though some of it may be ambiguous.
            last_by_name = {name: indices[-1] for name, indices in by_name.items() if indices}
            error = with_advice(error, header, rows, {**last_by_name, **stated}, aliases, fixed)
            if error.code == "column-missing" and not error.options:
                error.hint = f"{error.hint} {_remedy_for_missing(missing)}"
            raise error
    # Logged if the command succeeds: the columns of a table that fails are looked for again.
    if flat and not any(is_there(meaning) for meaning in heights):
        log.info("Note: %s has no column for %s, so its heights are unknown. Accepted names: %s.",
                 path or "the table", " and ".join(heights), ", ".join(aliases[heights[0]]),
                 extra={PENDING: ON_SUCCESS})
    return columns


def _refuse_one_for_two(path: Path | None, line: int | None, header: Sequence[str],
                        stated: Mapping[str, int]) -> None:
    """Raise TermselError where --columns names one column for two meanings."""
    meanings: dict[int, str] = {}
    for meaning, column in stated.items():
        if column in meanings:
            raise TermselError(
                f"--columns takes this column for both {meanings[column]} and {meaning}",
                file=path, line=line, column=header[column].strip(),
                hint="Name a column for each. The columns here are: "
                     f"{', '.join(name.strip() for name in header)}.")
        meanings[column] = meaning


def _refuse_if_column_taken(path: Path | None, line: int | None, header: Sequence[str],
                            meaning: str, named_columns: Sequence[int],
                            stated: Mapping[str, int]) -> None:
    """Raise TermselError where --columns gives another meaning to a column headed as this one.

    `named_columns` are the columns whose heading means `meaning`, `stated` the columns that
    --columns declares, by meaning.
    """
    for stated_meaning, column in stated.items():
        if column in named_columns:
            name = header[column].strip()
            raise TermselError(
                f"--columns takes column {name!r} for {stated_meaning}, so that none is left for "
                f"{meaning}",
                file=path, line=line, column=name,
                hint=f"Name the column of {meaning} as well: --columns {stated_meaning}={name},"
                     f"{meaning}=NAME. To exchange two columns name both.")


def _ambiguous_columns_error(path: Path | None, line: int | None, header: Sequence[str],
                             meaning: str,
                             candidates: Sequence[int]) -> TermselError:
    """Return the error for several columns of one meaning."""
    names = " and ".join(repr(header[i].strip()) for i in candidates)
    return TermselError(f"columns {names} both mean {meaning}", file=path, line=line,
                        column=header[candidates[1]].strip(),
                        hint="Rename or remove all but one of them.")


def _require_stated(path: Path | None, line: int | None, header: Sequence[str],
                    stated: Mapping[str, str], aliases: Aliases) -> None:
    """Raise TermselError for columns that --columns names and the header does not have.

    `stated` are the names or numbers of columns by meaning, as --columns has them.
    """
    declared = find_declared_columns(header, stated)
    absent = {meaning: name for meaning, name in stated.items() if meaning not in declared}
    if not absent:
        return
    absent_in_words = " and ".join(f"{name!r} for {meaning}" for meaning, name in absent.items())
    verb = "is no column" if len(absent) == 1 else "are no columns"
    # Who reads the table without --columns gets all of these by their names.
    by_name = columns_by_meaning(header, aliases)
    remedy = ""
    if all(len(by_name.get(meaning, ())) == 1 for meaning in stated):
        remedy = " They have their usual names: leave --columns out."
    raise TermselError(f"there {verb} {absent_in_words}", file=path, line=line,
                       hint=f"The columns here are: {_list_header(header)}.{remedy}")


def _list_header(header: Sequence[str]) -> str:
    """Return the names of a header for a message, without the middle of a long list."""
    return cut(", ".join(cell.strip() for cell in header), _LONGEST_LIST)


_LONGEST_LIST = 400
"""Characters of a list of columns in a message."""


def _ragged_row_error(path: Path | None, line: int, header: Sequence[str], row: Sequence[str],
                      delimiter: str | None) -> TermselError:
    """Return the error for a row with fewer or more cells than the header."""
    if len(row) < len(header):
        missing = [cell.strip() for cell in header[len(row):]]
        return TermselError(f"the row ends after {len(row)} of {len(header)} cells, before "
                            f"{first_names_in_words(missing, 4)}", file=path, line=line,
                            hint="Complete it, or delete it.")
    # 1,5 in a file that commas separate makes one cell too many.
    if delimiter == ",":
        comma = " If numbers have decimal commas, separate the columns by semicolons."
    else:
        comma = ""
    return TermselError(f"the row has {len(row)} cells, but the header has {len(header)}",
                        file=path, line=line,
                        hint=f"Every row needs one cell for each column.{comma}")


def _missing_column_error(path: Path | None, line: int | None, header: Sequence[str],
                          missing: Sequence[str], aliases: Aliases) -> TermselError:
    """Return the error for the `missing` meanings, which no column has.

    It tells apart lines without ground coordinates, and a first line of numbers.
    """
    meaning = missing[0]
    if meaning == "x1" and "line1" in {cell.strip().casefold() for cell in header}:
        return TermselError(
            "this table has lines in the image alone, without their ground coordinates", file=path,
            line=line, column=meaning,
            hint="Add the columns x1, y1, z1, x2, y2, z2. Or give the ground lines of a GIS, and "
                 "this table as their image lines: --lines GROUND.geojson --image-lines "
                 f"{path or 'FILE'}.")
    numbers = sum(_is_number(cell) for cell in header)
    if numbers > len(header) / 2 and path is None:
        return TermselError(
            "the columns of the table have numbers for names",
            hint=f"Name them, such as {','.join(COORDINATES)}; if the table is transposed, give "
                 "TABLE.T.")
    if numbers > len(header) / 2:
        return TermselError(
            "the first line has numbers where the columns should be named", file=path, line=line,
            hint=f"Put a line of names above it, such as {','.join(aliases)}.")
    # Names of termsel itself; there are hundreds in other languages and of other programs.
    accepted = "; ".join(
        ", ".join([name for name in aliases[absent] if name in TAKEN] or aliases[absent])
        for absent in missing)
    may_be_blank = ""
    if missing[-1][0] == "z":
        may_be_blank = f" The cells of {missing[-1]} may be blank."
    if len(missing) == 1:
        message = f"there is no column for {meaning}"
    else:
        message = f"there are no columns for {', '.join(missing[:-1])} and {missing[-1]}"
    return TermselError(
        message, file=path, line=line, column=meaning,
        code="column-missing",
        hint=f"The columns here are: {_list_header(header)}. "
             f"Accepted names: {accepted}, and others.{may_be_blank}")


def _remedy_for_missing(missing: Sequence[str]) -> str:
    """Return what helps where nothing shows which columns have the `missing` meanings."""
    it = "it" if len(missing) == 1 else "them"
    columns = ",".join(f"{meaning}=NAME" for meaning in missing)
    return f"Add {it}, or name what holds {it}: {Remedy('columns', columns)}."


def _is_number(cell: str) -> bool:
    """Return whether a cell is a number as Python reads it."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _exclude_each_other(rows: Sequence[Sequence[str]], columns: Sequence[int]) -> bool:
    """Return whether no row has values in two of the columns."""
    # Ragged rows are refused later, with their line.
    if not rows or min(map(len, rows)) <= max(columns):
        return False
    return all(sum(bool(row[i].strip()) for i in columns) <= 1 for row in rows)


def _merge_into_first(rows: list[list[str]], columns: Sequence[int]) -> None:
    """Put the cells of several columns, of which one a row has a value, into the first of them."""
    for row in rows:
        row[columns[0]] = "".join(row[i] for i in columns)


def _declared_crs(path: Path | None, comments: Mapping[int, str]) -> str:
    """Return the CRS the comments declare, "" for none, and check the units.

    Comments such as "# crs: EPSG:4979" and "# units: m" stand above the header. Raises
    TermselError, with its line, for a CRS that is unknown or contradicts an earlier one, and for
    units other than degrees and metres.
    """
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
                raise error_in_file(error, path, line) from error
            # The same CRS twice is no contradiction, as where tables were joined.
            if crs not in ("", name):
                raise TermselError(f"the CRS is {name} here, but {crs} in an earlier comment",
                                   file=path, line=line, hint="Remove one of them.")
            crs = name
        elif not all(_GROUND_UNIT.fullmatch(unit.strip()) for unit in value.split(",")):
            raise TermselError(f"units {value!r} are not supported", file=path, line=line,
                               hint="Convert the ground coordinates to degrees or metres.")
    return crs


def _declared_size(comments: Mapping[int, str]) -> tuple[int, int] | None:
    """Return lines and samples of the image, if a comment declares them; else None."""
    for comment in comments.values():
        declared = _IMAGE_SIZE.fullmatch(comment.strip())
        if declared and int(declared[1]) and int(declared[2]):
            return int(declared[1]), int(declared[2])
    return None


def read_table(path: Path, aliases: Aliases, *, columns: str = "", decimal: str | None = None,
               layer: str | None = None, flat: bool = False) -> Table:
    """Return the table of a file whose columns are named by its header, or by `columns`.

    `aliases` has the names of the columns by meaning. Columns of numbers other than deviations are
    required. If `flat`, the heights, which are meanings that begin with z, may all be missing: they
    are then blank, and a note says so. Raises TermselError if the file is not such a table.
    """
    stated = parse_columns(columns)
    cells = read_cells(path, aliases, stated, layer)
    return table_of(path, cells, aliases, stated, decimal, flat=flat)


def table_of(path: Path | None, cells: Cells, aliases: Aliases, stated: Mapping[str, str],
             decimal: str | None = None, *, flat: bool = False) -> Table:
    """Return the table of rows of cells (see `read_table`); `path` is for messages.

    `stated` has the names or numbers of columns by meaning that the user declares. Raises
    TermselError without a header or a row below it, for a row of more or fewer cells than the
    header, and for columns that are declared or needed and not there.
    """
    crs = _declared_crs(path, cells.comments)
    if not cells.rows:
        raise TermselError("the file has no table", file=path,
                           hint="It must begin with a header that names the columns.")
    # One --columns may serve several files, of points and of lines.
    stated = {meaning: name for meaning, name in stated.items() if meaning in aliases}
    cells = without_header(cells, stated)
    for note in cells.notes:
        log.info("Note: %s.", note)
    cells = _without_title(path, cells, aliases, stated)
    header, *rows = cells.rows
    header_line, *lines = cells.lines
    line = header_line or None
    # A column that the user declares is taken as it stands.
    if not {"x", "y"} & stated.keys() and "x" in aliases:
        header, rows, joined = joined_angles(header, rows)
        for columns_in_words in joined:
            log.info("Note: %s are read as one angle.", columns_in_words)
    given_columns = {**cells.fixed, **find_declared_columns(header, stated)}
    _require_stated(path, line, header, stated, aliases)
    column_of = _column_by_meaning(path, line, header, rows, aliases, given_columns,
                                   cells.fixed.values(), flat=flat)
    rows = _rows_of_width(path, header, rows, lines, cells.delimiter)
    number_columns = [i for meaning, i in column_of.items() if meaning not in USE]
    if len(rows) > 1 and _is_row_of_units(rows[0], number_columns):
        log.info("Note: line %s of %s, below the header, holds no numbers and is left out: %s.",
                 lines[0], path or "the table", " ".join(filter(None, rows[0])))
        header = _with_units_of_row(header, rows[0])
        rows = rows[1:]
        lines = lines[1:]
    if not rows:
        raise TermselError("there is a header and no row below it", file=path,
                           hint="Add a row for each point or line.")
    # Messages name a column as the file does, not by its meaning.
    column_names = {meaning: header[i].strip() for meaning, i in column_of.items()}
    columns = {}
    for meaning, i in column_of.items():
        columns[meaning] = [row[i] for row in rows]
    if "enabled" in aliases:
        _read_flags(header, rows, column_of, column_names, columns)
    _join_sides(columns, column_of, header, rows)
    _say_remarks(column_names)
    table = Table(path, crs, column_names, columns, lines, row_name=cells.row_name,
                  image_size=_declared_size(cells.comments))
    signs = _decimal_signs(table, decimal, points_only=cells.delimiter == ",")
    if "id" in aliases and "id" not in column_of:
        log.info("Note: %s has no column of ids, so its rows are called P1, P2, ... in order.",
                 path or "the table", extra={PENDING: ON_SUCCESS})
    elif "id" in aliases and not all(map(str.strip, columns["id"])) and table.may_lack_names():
        log.info("Note: where column %r of %s is blank, points are called P1, P2, ... by their "
                 "rows.", column_names["id"], path or "the table", extra={PENDING: ON_SUCCESS})
    # Columns without a meaning are kept as texts.
    attributes = {}
    for name, i in _attribute_columns(header, {*column_of.values(), *cells.fixed.values()}).items():
        texts = [unguard_cell(row[i].strip()) for row in rows]
        # In a file with decimal commas 1,5 is a number here, too.
        if COMMA in signs.values():
            texts = [text.replace(COMMA, POINT) if _DECIMAL_COMMA.fullmatch(text) else text
                     for text in texts]
        attributes[name] = text_array(texts)
    return replace(table, signs=signs, attributes=attributes)


def _read_flags(header: Sequence[str], rows: Sequence[Sequence[str]], column_of: dict[str, int],
                column_names: dict[str, str], columns: dict[str, list[str]]) -> None:
    """Add a column `enabled` to the columns of a table, if one of another name says the same.

    A note says which column it is. Further notes name columns that look like roles or flags, and
    are not read.
    """
    flags = None if "enabled" in column_of else find_flags(header, rows, column_of.values())
    if flags is not None:
        found, in_use = flags
        # Messages name the first of the columns; the cells are what all of them say together.
        column_of["enabled"] = found[0]
        column_names["enabled"] = header[found[0]].strip()
        columns["enabled"] = ["1" if is_in_use else "0" for is_in_use in in_use]
        names = " and ".join(repr(header[i].strip()) for i in found)
        n_off = in_use.count(False)
        log.warning("Note: by column %s, %d of %d rows %s not used.", names, n_off, len(rows),
                    "is" if n_off == 1 else "are")
    if "role" not in column_of:
        for remark in remarks_on_unread(header, rows, column_of.values()):
            log.warning("Note: %s.", remark)


def _without_title(path: Path | None, cells: Cells, aliases: Aliases,
                   stated: Mapping[str, str]) -> Cells:
    """Return cells whose first row is the header, without the title that may stand above it.

    Only text and sheets may have a title; records have keys. A note says which row is the header.
    Raises TermselError where no row of as many cells is below a title.
    """
    first = header_row(cells.rows, aliases, stated) if cells.row_name == "line" else 0
    if first == 0:
        return cells
    line = cells.lines[first] or None
    _require_rows_below(path, cells.rows[first], cells.rows[first + 1:], line)
    log.info("Note: the header of %s is taken from line %s, below a title.", path, line)
    return replace(cells, rows=cells.rows[first:], lines=cells.lines[first:])


def _rows_of_width(path: Path | None, header: Sequence[str], rows: list[list[str]],
                   lines: Sequence[int], delimiter: str | None) -> list[list[str]]:
    """Return rows with as many cells as the header; blank cells after these are left out.

    Raises TermselError for the first row with fewer or more cells.
    """
    width = len(header)
    if set(map(len, rows)) <= {width}:
        return rows
    # Spreadsheets leave separators after the last cell.
    rows = [row if "".join(row[width:]).strip() else row[:width] for row in rows]
    for row, line in zip(rows, lines, strict=True):
        if len(row) != width:
            raise _ragged_row_error(path, line, header, row, delimiter)
    return rows


def _is_row_of_units(row: Sequence[str], number_columns: Sequence[int]) -> bool:
    """Return whether a row has texts without any digit where a table has numbers."""
    cells = [row[i] for i in number_columns]
    return any(map(str.strip, cells)) and not any(map(str.isdigit, "".join(cells)))


def _with_units_of_row(header: Sequence[str], units: Sequence[str]) -> list[str]:
    """Return the names of columns with the units that a row below them states."""
    return [f"{name.strip()} [{unit.strip()}]" if unit_of_text(unit) else name
            for name, unit in zip(header, units, strict=True)]


def _join_sides(columns: dict[str, list[str]], column_of: Mapping[str, int],
                header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Give angles the side of the equator, or of Greenwich, that a further column says (in place).

    Parameters
    ----------
    columns : dict of list of str
        Cells by meaning; those of "x" and "y" are replaced, where a column of N and S or E and W
        belongs to them, and the user is told.
    column_of : mapping
        The position of each meaning's column in the header.
    header, rows : sequence
        Those of the whole table.
    """
    unused_columns = {i: [row[i] for row in rows] for i in range(len(header))
                      if i not in column_of.values()}
    if not unused_columns:
        return
    for axis in ("x", "y"):
        if axis not in columns:
            continue
        index = column_of_sides(axis, columns[axis], unused_columns, column_of[axis], header)
        if index is None:
            continue
        columns[axis] = [with_side(cell, side)
                         for cell, side in zip(columns[axis], unused_columns[index], strict=True)]
        log.info("Note: %s says on which side the angles in %s are, and gives them their sign.",
                 header[index].strip(), header[column_of[axis]].strip())


def _say_remarks(names: Mapping[str, str]) -> None:
    """Log what stands in brackets in names of coordinates and is not known, such as (x 1000)."""
    for meaning, name in names.items():
        remark = unknown_remark(name) if meaning in COORDINATES else ""
        if remark and not coordinate_in_brackets(name):
            log.info("Note: what %s says in the name %s is not known: its numbers are taken as "
                     "they are.", repr(remark), name)


def _require_rows_below(path: Path | None, header: Sequence[str], rows: Sequence[Sequence[str]],
                        line: int | None) -> None:
    """Raise TermselError for a text whose words name columns in passing, as a README does.

    Below a header there is a row with as many cells and a digit.
    """
    if not any(len(row) >= len(header) and any(any(map(str.isdigit, cell)) for cell in row)
               for row in rows):
        raise TermselError("this is text, not a table of points: the words of this line could "
                           f"name columns, but no row of {len(header)} cells follows", file=path,
                           line=line, hint=EXPECTED)


def _attribute_columns(header: Sequence[str], used: Collection[int]) -> dict[str, int]:
    """Return the indices of the columns that are attributes, by name.

    These are the columns that are not `used` and have a name; of several with one name the first.
    """
    columns: dict[str, int] = {}
    for i, cell in enumerate(header):
        name = unguard_cell(cell.strip())
        # Names that differ in case alone would be one column in a GeoPackage.
        if i not in used and is_free(name) and name.casefold() not in map(str.casefold, columns):
            columns[name] = i
    return columns


def _decimal_signs(table: Table, decimal: str | None, *, points_only: bool) -> dict[str, str]:
    """Return the decimal sign of each column of numbers; log how an open one was decided.

    Raises TermselError where nothing decides it.
    """
    columns = {meaning: cells for meaning, cells in table.columns.items() if meaning not in USE}
    stated_sign = {"comma": COMMA, "point": POINT}.get(decimal or "", "")
    try:
        signs, resolved = decimal_signs(columns, stated_sign, points_only=points_only)
    except BadCell as error:
        raise table.error(error.what, error.row, error.column, error.hint) from None
    for meaning, sign in signs.items():
        # 1.234 may be 1234 where the sign is open: no default may guess that.
        if not sign:
            row = next(i for i, cell in enumerate(columns[meaning])
                       if COMMA in cell or POINT in cell)
            raise table.error(
                f"{columns[meaning][row].strip()!r} may be above one thousand or not, and no "
                "other column decides it", row, meaning, "State the decimal sign: --set "
                                                         "decimal=comma or --set decimal=point.")
    if resolved:
        # The user must know: a wrong sign changes numbers by a factor of a thousand.
        sign_name = "comma" if signs[resolved[0]] == COMMA else "point"
        log.info("Note: the decimal sign of %s is taken to be a %s, as %s; the other sign "
                 "separates thousands in the columns %s.", table.path or "the table", sign_name,
                 "you say" if stated_sign else "in its other columns",
                 ", ".join(table.names[meaning] for meaning in resolved))
    return signs


class TableReader(Reader):
    """Base of the readers of tables, which name the columns they know by meaning.

    One group of the meanings in `needed` must be there; if `flat`, the heights may all be missing.
    """

    aliases: ClassVar[Aliases]
    required: ClassVar[tuple[tuple[str, ...], ...]] = ((),)
    flat: ClassVar[bool] = True
    declared_options: ClassVar[tuple[Option, ...]] = COLUMNS

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True if a header names at least three columns of the format."""
        return any(sniff_table(path, head, self.aliases, self.options.get("columns", ""), group)
                   for group in self.required)

    def read(self, path: Path) -> FeatureSet:
        """Return the features of a table; errors name file, line and column."""
        return self.features(self.table(path))

    def table(self, path: Path) -> Table:
        """Return the cells of a file by their meaning."""
        return read_table(path, self.aliases, flat=self.flat, **{
            option.name: self.options[option.name] for option in COLUMNS
            if option.name in self.options})

    @abstractmethod
    def features(self, table: Table) -> FeatureSet:
        """Return the features of a table."""

    def placed(self, error: TermselError, path: Path) -> TermselError:
        """Return the error with line and column."""
        return self.table(path).placed(error)
