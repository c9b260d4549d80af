"""Angles that a table has in several columns: degrees, minutes and seconds, and their hemisphere.

They are put together as one cell, such as 47 deg 54' 56.6" S, which is read as any other.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping, Sequence
from itertools import product

from termsel.data.tables.columns import POINTS, columns_by_meaning

log = logging.getLogger(__name__)

_PART_OF_ANGLE = re.compile(
    r"(.*?)[\s_.(\[-]*(?:(d|deg|degrees?|grad|°)|(m|min|mins|minutes?|minuten|'|′)"
    r"|(s|sec|secs|seconds?|sek|sekunden|\"|″))[\s)\]]*", re.IGNORECASE)
_WHOLE = re.compile(r"([+-]?\d{1,3})(?:[.,]0*)?")
_SIXTIETHS = re.compile(r"[0-5]?\d(?:[.,]\d*)?")
_SIDE_WORDS = {"y": frozenset(("N", "S", "NORTH", "SOUTH")),
               "x": frozenset(("E", "W", "O", "EAST", "WEST"))}
_ALONG = {"y": frozenset(("N", "NORTH")), "x": frozenset(("E", "EAST"))}
_FROM_ZERO = 10.0
"""Degrees from the equator, from Greenwich or from 180, beyond which a scene has one side."""


def joined_angles(header: Sequence[str], rows: list[list[str]],
                  ) -> tuple[list[str], list[list[str]], list[str]]:
    """Return a table whose longitudes and latitudes are in one column each, and what was joined.

    Minutes and seconds are found by the names of their columns, as lat_d, lat_m and lat_s or lat,
    min and sec, beside whole degrees. Other tables are returned as they are.
    """
    names = list(header)
    joined = [list(row) for row in rows]
    said = []
    parts = [_PART_OF_ANGLE.fullmatch(name.strip()) for name in header]
    # Without minutes or seconds there is nothing to join.
    if not any(part and (part[3] or part[4]) for part in parts):
        return names, rows, []
    for axis in "xy":
        degrees = next((i for i in range(len(header)) if _is_degrees(header, i, axis)
                        and _are_all(_WHOLE, rows, i)), None)
        if degrees is None:
            continue
        match = parts[degrees]
        base = match[1] if match and match[2] else header[degrees].strip()
        further = []
        for group, column in product((3, 4), range(len(header))):
            part = parts[column]
            if part is None or not part[group] or not _are_all(_SIXTIETHS, rows, column):
                continue
            # Of this angle by its name, or without a name right after the degrees.
            if part[1].casefold() == base.casefold() or (
                    not part[1] and column == degrees + group - 2):
                further.append(column)
        if not further:
            continue
        for row in joined:
            row[degrees] = _angle_text(row, degrees, further)
        said.append(" and ".join(header[i].strip() for i in (degrees, *further)))
        names[degrees] = base
        for column, word in zip(further, ("minutes", "seconds"), strict=False):
            names[column] = f"{base} {word}"
    return (names, joined, said) if said else (list(header), rows, [])


def _angle_text(row: Sequence[str], degrees: int, further: Sequence[int]) -> str:
    """Return the cells of a row that are parts of an angle as one: 47 deg 54' 56.6"."""
    parts = [f"{row[degrees].strip().partition('.')[0].partition(',')[0]}°"]
    for column, sign in zip(further, "'\"", strict=False):
        parts.append(f"{row[column].strip()}{sign}")
    return " ".join(parts)


def _is_degrees(header: Sequence[str], column: int, axis: str) -> bool:
    """Return whether a column may hold the degrees of an axis, by its name without that part."""
    match = _PART_OF_ANGLE.fullmatch(header[column].strip())
    base = match[1] if match and match[2] else header[column].strip()
    # x and y, n and e stand for plane coordinates, too.
    return len(base) > 1 and bool(columns_by_meaning([base], POINTS)[axis])


def _are_all(pattern: re.Pattern[str], rows: Sequence[Sequence[str]], column: int) -> bool:
    """Return whether the cells of a column of all rows have a form."""
    return bool(rows) and all(len(row) > column and pattern.fullmatch(row[column].strip())
                              for row in rows)


def column_of_sides(axis: str, numbers: Sequence[str], others: Mapping[int, Sequence[str]],
                    near: int, header: Sequence[str]) -> int | None:
    """Return the column that says on which side of the equator or of Greenwich angles are.

    It holds N and S beside latitudes, E and W beside longitudes. `others` are the columns without
    a meaning by their places, of which the next after `near` counts. None where there is none, or
    where it turns no sign.
    """
    sizes = [_size(cell) for cell in numbers]
    # Eastings and northings have no side.
    if max(sizes, default=0.0) > 360.0:
        return None
    columns_of_sides = [place for place, cells in others.items()
                        if _are_sides(axis, cells, is_next=place == near + 1)]
    # On both sides are the points of one scene only near zero, or near 180 degrees.
    is_far = min(sizes, default=0.0) > _FROM_ZERO and max(sizes) < 180.0 - _FROM_ZERO
    for place in columns_of_sides if is_far else ():
        letters = sorted({cell.strip().upper()[0] for cell in others[place]})
        if len(letters) > 1:
            log.info("Note: %s holds %s, and is not taken for the side of %s: the points would be "
                     "far apart.", header[place].strip(), " and ".join(letters),
                     header[near].strip())
            columns_of_sides = [other for other in columns_of_sides if other != place]
    if not columns_of_sides:
        return None
    place = min(columns_of_sides, key=lambda i: (i < near, abs(i - near)))
    turns = any(cell.strip().upper() not in _ALONG[axis] for cell in others[place])
    return place if turns else None


def _are_sides(axis: str, cells: Sequence[str], *, is_next: bool) -> bool:
    """Return whether cells may say on which side of zero the angles of an axis are."""
    sides = {cell.strip().upper() for cell in cells}
    # O is west to some and east to others, which the reader of angles asks; or it says "ok".
    return bool(sides) and _SIDE_WORDS[axis].issuperset(sides) and (sides != {"O"} or is_next)


def _size(cell: str) -> float:
    """Return the size of a number; 0 of a cell that is none, as of degrees and minutes."""
    try:
        return abs(float(cell.replace(",", ".")))
    except ValueError:
        return 0.0


def with_side(cell: str, side: str) -> str:
    """Return a cell with its side, unless its own sign or letter says it already."""
    side = side.strip().upper()[:1]
    text = cell.strip()
    # A negative latitude of the south is south once.
    if not text or text[-1].isalpha() or text[0].isalpha() or (
            text.startswith("-") and side in "SW"):
        return cell
    return f"{text} {side}"
