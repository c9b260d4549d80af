"""Cells by the meaning of their columns, with the place of every bad cell."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from termsel.core.errors import TermselError, amount
from termsel.core.files.texts import unguarded
from termsel.data.features import ROLES, FeatureSet, FloatArray, Points
from termsel.data.tables.attributes import Attributes, rows_at
from termsel.data.tables.numbers import POINT, BadCell, read_numbers
from termsel.data.values import refused
from termsel.formats.base import located
from termsel.formats.repeated import averaged, is_averaging

_ENABLED = {"": True, "1": True, "true": True, "yes": True, "on": True,
            "0": False, "false": False, "no": False, "off": False}
_WHOLE = re.compile(r"([01])\.0*")

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
        return located(error, self.path, None if row is None else self.lines[row])

    def take(self, rows: Sequence[int]) -> Table:
        """Return the table of some rows."""
        columns = {}
        for meaning, cells in self.columns.items():
            columns[meaning] = [cells[row] for row in rows]
        return replace(self, lines=[self.lines[row] for row in rows], columns=columns,
                       attributes=rows_at(self.attributes, np.asarray(rows, dtype=np.intp)))

    def placed(self, error: TermselError) -> TermselError:
        """Return `error` with the line of the first feature it names, and the name of the column.

        The error has the meaning of a column, if any.
        """
        rows = [row for row, name in enumerate(self.ids()) if name in error.ids[:1]]
        # The error names the meaning, such as "x"; the user knows the column.
        error.column = self.names.get(str(error.column or ""))
        return self.at(error, rows[0] if len(rows) == 1 else None)

    def ids(self) -> list[str]:
        """Return the ids, P1, P2, ... where the format has none."""
        if "id" not in self.columns:
            return [f"P{number}" for number in (
                range(1, len(self.lines) + 1) if self.row_name == "line" else self.lines)]
        # Spreadsheets guard text against being read as a formula; that is taken off again.
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
            # Ids that the program made up cannot be twice.
            if first.setdefault(name, row) != row and "id" in self.names:
                raise self.error(f"id {name!r} is already used on {self.row_name} "
                                 f"{self.lines[first[name]]}", row, "id",
                                 "Give every point a different id.")
        attributes = self.attributes
        try:
            if is_averaging():
                first_rows, image, sigma = averaged(ids, image, ground, sigma, roles)
                ids = [ids[row] for row in first_rows]
                roles = [roles[row] for row in first_rows]
                ground = ground[first_rows]
                attributes = rows_at(attributes, first_rows)
            return Points(tuple(ids), image, ground, sigma, tuple(roles), attributes)
        except TermselError as error:
            raise self.placed(error) from error

    def roles(self) -> list[str]:
        """Return the role of each row, "off" where it is not enabled."""
        cells = self.columns.get("role", [""] * len(self.lines))
        role_of_cell = {cell: cell.strip().lower() for cell in set(cells)}  # few, whatever the rows
        for cell, role in role_of_cell.items():
            if role not in ("", *ROLES):
                raise self.error(f"unknown role {cell.strip()!r}", cells.index(cell), "role",
                                 f"Roles are {', '.join(ROLES)}, or blank.")
        flags = self.columns.get("enabled", ())
        enabled = {}
        for cell in set(flags):
            # Programs that keep numbers alone write 1.0 for 1.
            flag = cell.strip().lower()
            whole = _WHOLE.fullmatch(flag)
            enabled[cell] = _ENABLED.get(whole[1] if whole else flag)
        for cell, on in enabled.items():
            if on is None:
                raise self.error(f"{cell.strip()!r} is neither true nor false",
                                 flags.index(cell), "enabled", "Write 1 or 0.")
        roles = [role_of_cell[cell] for cell in cells]
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
            # A column of blanks is none.
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
        """Return the numbers of a column by its meaning; errors name line and column."""
        # A table without heights has none for any row.
        if meaning not in self.columns and meaning[0] == "z":
            return np.full(len(self.lines), np.nan)
        sign = self.signs.get(meaning, POINT)
        try:
            # x and y may be degrees, minutes and seconds.
            numbers = read_numbers(self.columns[meaning], sign, may_be_blank=may_be_blank,
                                   angle=meaning[0] if meaning[0] in "xy" else "")
        except BadCell as error:
            raise self.error(error.what, error.row, meaning, error.hint) from None
        if meaning[0] == "z":
            self._refuse_voids(numbers, meaning)
        return numbers

    def _refuse_voids(self, heights: FloatArray, meaning: str) -> None:
        """Raise a TermselError for what rasters of heights have where there is none."""
        voids = np.flatnonzero(np.isin(heights, VOID_HEIGHTS))
        if len(voids):
            further = f", as in {amount(len(voids), 'row')}" if len(voids) > 1 else ""
            raise self.error(f"{heights[voids[0]]:.0f} is no height, but what rasters have where "
                             f"there is none{further}", int(voids[0]), meaning,
                             "Leave these cells blank, or correct them.")


def points_of(table: Table, crs: str) -> FeatureSet:
    """Return the points of a table; errors name the place of what cannot be read."""
    image = table.stack("line", "sample")
    ground = table.stack("x", "y", "z")
    sigma = table.sigma("sigma_line", "sigma_sample")
    return FeatureSet(table.points(image, ground, sigma, table.roles()), crs=crs)
