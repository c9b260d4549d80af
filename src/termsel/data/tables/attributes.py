"""Attributes of features: further columns of their file, such as source or date, as text."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
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

LONGEST = 10_000
"""Characters of a text; Python's reader of tables takes no cells of more than 131,072."""


def is_free(name: str) -> bool:
    """Return whether a column of attributes can have this name."""
    return (isinstance(name, str) and bool(name) and name == name.strip() and is_printable(name)
            and len(name) <= 200 and name.casefold() not in TAKEN)


def as_attributes(given: Mapping[str, Iterable[Any]], n: int, *taken: str,
                  ) -> Attributes:
    """Return columns of n rows as features have them: stripped text that cannot be changed.

    None, NaN and the like of pandas stand for what is not known; no column can have a name that is
    `taken`. Raises TermselError for such a name or one used twice, or a column of another length.
    """
    columns: dict[str, TextArray] = {}
    for name, values in given.items():
        if not is_free(name) or name.casefold() in taken:
            raise TermselError(f"a column of attributes cannot have the name {name!r}",
                               hint="Tables use it otherwise, or it is no short printable text.")
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
    return cut(printable(str(value).replace("\r\n", "\n")).strip(), LONGEST)


def rows_at(attributes: Attributes, index: NDArray[Any] | slice) -> Attributes:
    """Return the rows at an index, which cannot be written to."""
    rows = {name: cells[index] for name, cells in attributes.items()}
    for cells in rows.values():
        cells.setflags(write=False)
    return MappingProxyType(rows)


def joined(first: Attributes, n: int, second: Attributes, m: int) -> dict[str, TextArray]:
    """Return the rows of both, n and m of them, with "" where one has no such column."""
    return {name: np.concatenate([_column(part, name, rows)
                                  for part, rows in ((first, n), (second, m))])
            for name in distinct([*first, *second])}


def distinct(names: Iterable[str]) -> list[str]:
    """Return names, of those alike the first: upper and lower case count as the same."""
    found: dict[str, str] = {}
    for name in names:
        found.setdefault(name.casefold(), name)
    return list(found.values())


def _column(part: Attributes, name: str, rows: int) -> TextArray:
    """Return a column, "" in each row if there is none."""
    return next((cells for key, cells in part.items() if key.casefold() == name.casefold()),
                np.full(rows, "", dtype=object))


def alike(rows: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """Return what parts of one feature have in common, by column: "" where their text differs."""
    return {name: value if all(row.get(name, "") == value for row in rows) else ""
            for name, value in rows[0].items()} if rows else {}


def columns_of(rows: Sequence[Mapping[str, str]]) -> dict[str, TextArray]:
    """Return attributes by column, "" where a row has none; of names alike the first."""
    return {name: text_array([row.get(name, "") for row in rows])
            for name in distinct(name for row in rows for name in row)}


def all_rows(parts: Sequence[Attributes], rows: Sequence[int], name: str) -> TextArray:
    """Return a column of several tables one after another, with so many rows of each."""
    known = distinct(key for part in parts for key in part)
    if name.casefold() not in map(str.casefold, known):
        raise unknown_name("column of attributes", name, known,
                           "It is a further column of the file of the features.")
    return np.concatenate([_column(part, name, n) for part, n in zip(parts, rows, strict=True)])


def as_numbers(cells: TextArray, ids: Sequence[str], name: str) -> FloatArray:
    """Return text as numbers, NaN where it is blank; `ids` are for the message."""
    found = np.empty(len(cells))
    for row, cell in enumerate(cells):
        try:
            found[row] = float(cell or "nan")
        except ValueError:
            found[row] = math.inf
        if cell and ("_" in cell or not math.isfinite(found[row])):
            raise TermselError(f"{ids[row]!r} has {cell!r} in this column, expected a number",
                               column=name, ids=[ids[row]],
                               hint="Correct the cell, or leave it blank.")
    return found
