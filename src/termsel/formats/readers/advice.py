"""What --columns could say of a table whose header does not tell which column is which."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from termsel.core.errors import TermselError
from termsel.data.features import FloatArray
from termsel.data.tables.columns import POINTS, Aliases, declared, matches, parse_columns
from termsel.data.tables.numbers import COMMA, POINT, BadCell, decimal_signs, read_numbers
from termsel.formats.readers.cells import WIDEST, BadText, read_cells

_ROWS = 200
_SPREADSHEETS = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")


def with_advice(error: TermselError, header: Sequence[str], rows: Sequence[Sequence[str]],
                found: Mapping[str, int], aliases: Aliases,
                fixed: Collection[int] = ()) -> TermselError:
    """Return an error with the text of --columns that declares all columns, as far as it is known.

    `found` is the column of each meaning that is known; the others are guessed, of points only.
    Nobody can declare the columns `fixed`, such as those of a geometry.
    """
    if "line" not in aliases or "x" not in aliases:
        return error
    columns = {**_guessed(rows, len(header), found), **found}
    names = [name.strip() for name in header]
    pairs = []
    for meaning in aliases:
        i = columns.get(meaning)
        if i is not None and i not in fixed:
            plain = names.count(names[i]) == 1 and names[i] and "," not in names[i] \
                and not names[i].isdecimal()
            pairs.append(f"{meaning}={names[i] if plain else i + 1}")
        elif i is None and meaning in ("line", "sample", "x", "y"):
            pairs.append(f"{meaning}=?")
    text = ",".join(pairs)
    error.options["--columns"] = text
    doubt = " Put the column for each ?." if "?" in text else \
        " This column mapping is a guess: check it." if columns.keys() - found else ""
    error.hint = f"{error.hint or ''} Declare the columns: --columns {text!r}.{doubt}"
    return error


def unknown_table(path: Path, expected: str, columns: str) -> TermselError | None:
    """Return the error for a file without a reader, None unless it is a table of numbers."""
    own = parse_columns(columns)
    try:
        cells = read_cells(path, POINTS, own)
    except TermselError as error:
        known = isinstance(error, BadText) or path.suffix.lower() in _SPREADSHEETS
        return error if known else None
    rows = [row for row in cells.rows[:_ROWS] if len(row) == len(cells.rows[-1]) <= WIDEST]
    values = _numbers(rows[1:])
    if len(rows) < 3 or len(values) < 4:
        return None if path.suffix.lower() not in _SPREADSHEETS else TermselError(
            "no visible sheet has a table of points", file=path, hint=expected)
    bare = any(i in _numbers(rows[:1]) for i in values)
    header = [str(i + 1) for i in range(len(rows[0]))] if bare else rows[0]
    found = {meaning: places[0] for meaning, places in matches(header, POINTS).items() if places}
    what = "this table has no header that names its columns" if bare else \
        f"the header names too few columns that are known: {', '.join(map(str.strip, header))}"
    return with_advice(TermselError(what, file=path, hint=expected), header,
                       rows if bare else rows[1:], {**found, **declared(header, own)}, POINTS)


def _numbers(rows: Sequence[Sequence[str]]) -> dict[int, FloatArray]:
    """Return the columns that hold numbers alone."""
    found = {}
    for i, cells in enumerate(zip(*rows, strict=True)):
        try:
            signs, _ = decimal_signs({"": cells})
            sign = signs[""] or (POINT if POINT in "".join(cells) else COMMA)
            values = read_numbers(cells, sign, may_be_blank=True, angle="x")
        except BadCell:
            continue
        if not np.isnan(values).all():
            found[i] = values
    return found


def _guessed(rows: Sequence[Sequence[str]], width: int,
             found: Mapping[str, int]) -> dict[str, int]:
    """Return what columns of numbers could be, by their order and by what depends on what."""
    rows = [row for row in rows[:_ROWS] if len(row) == width]
    values = {i: column for i, column in _numbers(rows).items() if i not in found.values()}
    guess: dict[str, int] = {}
    others = [i for i in range(width) if i not in values and i not in found.values()]
    first = next(iter(values), None)
    if "id" not in found:
        counted = first is not None and np.array_equal(values[first] - values[first][0],
                                                       np.arange(len(rows)))
        if counted and len(values) > 4:
            guess["id"] = first or 0
            values.pop(first or 0)
        elif others:
            guess["id"] = others[0]
    known = {meaning: _numbers([[row[i]] for row in rows]).get(0) for meaning, i in found.items()
             if meaning in ("line", "sample", "x", "y", "z")}
    free = list(values)
    if not known and len(free) in (4, 5):
        # Ground before image unless the numbers say otherwise: degrees are small, metres large.
        # Image and ground determine each other, a height is nearly free of both.
        z_last = len(free) == 5 and _explained(values, free[2]) > _explained(values, free[4])
        ground_last = z_last or (len(free) == 4 and _is_ground(values, free[2:])
                                 and not _is_ground(values, free[:2]))
        image = free[:2] if ground_last else free[-2:]
        ground = free[2:] if ground_last else free[:-2]
        guess |= dict(zip("xyz", ground, strict=False))
        # Seen from above, an image is no mirror image of the ground, which tells line from sample.
        turn = np.linalg.lstsq(
            np.column_stack([values[i] for i in ground[:2]] + [np.ones(len(rows))]),
            np.column_stack([values[i] for i in image]), rcond=None)[0][:2] \
            if not any(np.isnan(values[i]).any() for i in (*ground[:2], *image)) else -np.eye(2)
        names = ("line", "sample") if np.linalg.det(turn) > 0 else ("sample", "line")
        return guess | dict(zip(names, image, strict=True))
    missing = [name for name in ("x", "y", "z", "sample", "line") if name not in found]
    if len(free) == len(missing):
        guess |= dict(zip(missing, free, strict=True))
    return guess


def _is_ground(values: Mapping[int, FloatArray], pair: Sequence[int]) -> bool:
    """Return whether two columns look like degrees within a place, or like metres of a map."""
    size = max(np.nanmax(np.abs(values[i])) for i in pair)
    return bool(size > 1e5 or (size <= 180 and max(np.ptp(values[i]) for i in pair) < 10))


def _explained(values: Mapping[int, FloatArray], i: int) -> float:
    """Return the share of a column's variance that a linear function of the others explains."""
    table = np.column_stack([column for j, column in values.items() if j != i])
    good = ~np.isnan(np.column_stack([table, values[i]])).any(axis=1)
    y = values[i][good] - values[i][good].mean()
    a = table[good] - table[good].mean(axis=0)
    a = a / np.maximum(np.abs(a).max(axis=0), 1e-300)
    rest = y - a @ np.linalg.lstsq(a, y, rcond=None)[0]
    return float(1 - rest @ rest / max(y @ y, 1e-300))
