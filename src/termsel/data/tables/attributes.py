"""Attributes of features: further columns of their file, such as source or date, as text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from termsel.core.errors import TermselError, cut, is_printable, printable, unknown_name
from termsel.data.tables.columns import TAKEN

TextArray = NDArray[np.object_]
FloatArray = NDArray[np.float64]
Attributes = Mapping[str, TextArray]
"""Text by the name of the column, one for each row, "" where it is not known."""

_UNKNOWN = frozenset({"None", "nan", "NaT", "<NA>"})
"""How Python, numpy and pandas write what is not known."""

MAX_TEXT = 10_000
"""Characters of a text; Python's reader of tables takes no cells of more than 131,072."""


def is_free(name: str) -> bool:
    """Return whether a column of attributes can have this name."""
    return (isinstance(name, str) and bool(name) and name == name.strip() and is_printable(name)
            and len(name) <= 200 and name.casefold() not in TAKEN)


def as_attributes(attributes: Mapping[str, Iterable[Any]], n: int, *reserved: str,
                  ) -> Attributes:
    """Return columns of n rows as features have them: stripped text that cannot be changed.

    None, NaN and the like of pandas stand for what is not known; no column can have a name that is
    `taken`. Raises TermselError for such a name or one used twice, or a column of another length.
    """
    columns: dict[str, TextArray] = {}
    for name, values in attributes.items():
        if not is_free(name) or name.casefold() in reserved:
            raise TermselError(f"a column of attributes cannot have the name {name!r}",
                               hint="Tables use it otherwise, or it is no short printable text.")
        # Files of other programs write names with other capitals.
        if name.casefold() in map(str.casefold, columns):
            raise TermselError(f"two columns of attributes have the name {name!r}",
                               hint="Upper and lower case count as the same.")
        rows = [] if isinstance(values, str) or not isinstance(values, Iterable) \
            else list(map(_cell, values))
        if len(rows) != n:
            raise TermselError(f"the attributes {name!r} have {len(rows)} values for {n} rows",
                               hint="Give a list with a value for each.")
        cells = text_array(rows)
        cells.setflags(write=False)
        columns[name] = cells
    return MappingProxyType(columns)


def text_array(cells: Sequence[str]) -> TextArray:
    """Return text as an array, whatever its length: one long cell makes the others no longer."""
    array = np.empty(len(cells), dtype=object)
    array[:] = cells
    return array


def _cell(value: Any) -> str:
    if not isinstance(value, str) and str(value) in _UNKNOWN:
        return ""
    return cut(printable(str(value).replace("\r\n", "\n")).strip(), MAX_TEXT)


def rows_at(attributes: Attributes, index: NDArray[Any] | slice) -> Attributes:
    """Return the rows at an index, which cannot be written to."""
    rows = {name: cells[index] for name, cells in attributes.items()}
    for cells in rows.values():
        cells.setflags(write=False)
    return MappingProxyType(rows)


def joined(first: Attributes, n: int, second: Attributes, m: int) -> dict[str, TextArray]:
    """Return the rows of both, n and m of them, with "" where one has no such column."""
    return {name: np.concatenate([_column(first, name, n), _column(second, name, m)])
            for name in distinct([*first, *second])}


def distinct(names: Iterable[str]) -> list[str]:
    """Return names, of those alike the first: upper and lower case count as the same."""
    first_spelling: dict[str, str] = {}
    for name in names:
        first_spelling.setdefault(name.casefold(), name)
    return list(first_spelling.values())


def _column(table: Attributes, name: str, rows: int) -> TextArray:
    """Return a column, "" in each row if there is none."""
    return next((cells for key, cells in table.items() if key.casefold() == name.casefold()),
                np.full(rows, "", dtype=object))


def alike(rows: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """Return what parts of one feature have in common, by column: "" where their text differs."""
    common = dict(rows[0]) if rows else {}
    for row in rows:
        common = {name: value if row.get(name, "") == value else ""
                  for name, value in common.items()}
    return common


def columns_of(rows: Sequence[Mapping[str, str]]) -> dict[str, TextArray]:
    """Return attributes by column, "" where a row has none; of names alike the first."""
    columns = {}
    for name in distinct(chain.from_iterable(rows)):
        columns[name] = text_array([row.get(name, "") for row in rows])
    return columns


def all_rows(tables: Sequence[Attributes], rows: Sequence[int], name: str) -> TextArray:
    """Return a column of several tables one after another, with so many rows of each."""
    names = distinct(chain.from_iterable(tables))
    if name.casefold() not in map(str.casefold, names):
        raise unknown_name("column of attributes", name, names,
                           "It is a further column of the file of the features.")
    return np.concatenate([_column(table, name, n) for table, n in zip(tables, rows, strict=True)])


def as_numbers(cells: TextArray, ids: Sequence[str], name: str) -> FloatArray:
    """Return text as numbers, NaN where it is blank; `ids` are for the message."""
    numbers = np.empty(len(cells))
    for row, cell in enumerate(cells):
        try:
            numbers[row] = float(cell or "nan")
        except ValueError:
            numbers[row] = math.inf
        if cell and ("_" in cell or not math.isfinite(numbers[row])):
            raise TermselError(f"{ids[row]!r} has {cell!r} in this column, expected a number",
                               column=name, ids=[ids[row]],
                               hint="Correct the cell, or leave it blank.")
    return numbers
