"""Columns of a table that termsel gives no meaning: attributes of its features."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from termsel.formats.readers.formulas import unguarded
from termsel.measurements.tables.attributes import is_free

_COMMA = re.compile(r"[+-]?\d+,\d+")


def further(header: Sequence[str], found: Iterable[int]) -> dict[str, int]:
    """Return the places of the columns that are attributes, by name.

    Those whose names tables use otherwise are left out; of several alike the first is taken.

    Parameters
    ----------
    header : sequence of str
    found : iterable of int
        Places of the columns with a meaning.
    """
    columns: dict[str, int] = {}
    for i in sorted(set(range(len(header))) - set(found)):
        name = unguarded(header[i].strip())
        if is_free(name) and name.casefold() not in map(str.casefold, columns):
            columns[name] = i
    return columns


def as_text(cell: str, *, decimal_comma: bool) -> str:
    """Return a cell of attributes; a number with a decimal point."""
    text = unguarded(cell.strip())
    return text.replace(",", ".") if decimal_comma and _COMMA.fullmatch(text) else text
