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
_DEGREE_GROUP, _MINUTE_GROUP, _SECOND_GROUP = 2, 3, 4
"""Groups of the pattern that hold the unit; the first group holds the name of the angle."""

_WHOLE = re.compile(r"([+-]?\d{1,3})(?:[.,]0*)?")
_SIXTIETHS = re.compile(r"[0-5]?\d(?:[.,]\d*)?")
_SIDE_WORDS = {"y": frozenset(("N", "S", "NORTH", "SOUTH")),
               "x": frozenset(("E", "W", "O", "EAST", "WEST"))}
_ALONG = {"y": frozenset(("N", "NORTH")), "x": frozenset(("E", "EAST"))}
_FROM_ZERO = 10.0
"""Degrees from the equator, from Greenwich or from 180, beyond which a scene has one side."""


def joined_angles(header: Sequence[str], rows: list[list[str]],
                  ) -> tuple[list[str], list[list[str]], list[str]]:
    """Return a header and rows with each longitude and latitude in one column.

    Minutes and seconds are found by the names of their columns, as lat_d, lat_m and lat_s or lat,
    min and sec, beside whole degrees. The column of the degrees then has the whole angle. Last come
    the names of the columns that were joined, a text for each angle; a table without such columns
    comes back as it is.
    """
    names = list(header)
    joined = [list(row) for row in rows]
    joined_in_words: list[str] = []
    matches = [_PART_OF_ANGLE.fullmatch(name.strip()) for name in header]
    # Without minutes or seconds there is nothing to join.
    if not any(match and (match[_MINUTE_GROUP] or match[_SECOND_GROUP]) for match in matches):
        return names, rows, []
    for axis in "xy":
        degrees = next((i for i in range(len(header)) if _is_degrees(header, i, axis)
                        and _are_all(_WHOLE, rows, i)), None)
        if degrees is None:
            continue
        match = matches[degrees]
        angle_name = match[1] if match and match[_DEGREE_GROUP] else header[degrees].strip()
        sixtieths = []  # columns of minutes, then of seconds
        for group, column in product((_MINUTE_GROUP, _SECOND_GROUP), range(len(header))):
            match = matches[column]
            if match is None or not match[group] or not _are_all(_SIXTIETHS, rows, column):
                continue
            # Either the name says of which angle they are, or they stand right after the degrees.
            if match[1].casefold() == angle_name.casefold() or (
                    not match[1] and column == degrees + group - _DEGREE_GROUP):
                sixtieths.append(column)
        if not sixtieths:
            continue
        for row in joined:
            row[degrees] = _angle_text(row, degrees, sixtieths)
        joined_in_words.append(" and ".join(header[i].strip() for i in (degrees, *sixtieths)))
        names[degrees] = angle_name
        for column, word in zip(sixtieths, ("minutes", "seconds"), strict=False):
            names[column] = f"{angle_name} {word}"
    if not joined_in_words:
        return list(header), rows, []
    return names, joined, joined_in_words


def _angle_text(row: Sequence[str], degrees: int, sixtieths: Sequence[int]) -> str:
    """Return the angle of a row as one text, such as 47 deg 54' 56.6".

    `degrees` is its column of degrees, `sixtieths` are those of minutes and of seconds.
    """
    parts_in_words = [f"{row[degrees].strip().partition('.')[0].partition(',')[0]}°"]
    for column, sign in zip(sixtieths, "'\"", strict=False):
        parts_in_words.append(f"{row[column].strip()}{sign}")
    return " ".join(parts_in_words)


def _is_degrees(header: Sequence[str], column: int, axis: str) -> bool:
    """Return whether a column may hold the degrees of an axis, by its name without the unit."""
    match = _PART_OF_ANGLE.fullmatch(header[column].strip())
    angle_name = match[1] if match and match[_DEGREE_GROUP] else header[column].strip()
    # x and y, n and e stand for plane coordinates, too.
    return len(angle_name) > 1 and bool(columns_by_meaning([angle_name], POINTS)[axis])


def _are_all(pattern: re.Pattern[str], rows: Sequence[Sequence[str]], column: int) -> bool:
    """Return whether all cells of a column match a pattern; False without rows."""
    return bool(rows) and all(len(row) > column and pattern.fullmatch(row[column].strip())
                              for row in rows)


def column_of_sides(axis: str, numbers: Sequence[str], unused: Mapping[int, Sequence[str]],
                    angle_column: int, header: Sequence[str]) -> int | None:
    """Return the column that says on which side of the equator or of Greenwich angles are.

    It holds N and S beside latitudes, E and W beside longitudes. `numbers` are the cells of the
    angles, in `angle_column`; `unused` are the cells of columns without a meaning, by their index.
    Of several columns of sides the nearest after that of the angles counts, else the nearest before
    it. One by which the points would be far apart is none, and is noted. Returns None where there
    is none, or where it changes no sign.
    """
    sizes = [_size(cell) for cell in numbers]
    # Eastings and northings have no side.
    if max(sizes, default=0.0) > 360.0:
        return None
    columns_of_sides = [i for i, cells in unused.items()
                        if _are_sides(axis, cells, is_next=i == angle_column + 1)]
    # The points of one scene are on both sides only near zero, or near 180 degrees.
    if min(sizes, default=0.0) > _FROM_ZERO and max(sizes) < 180.0 - _FROM_ZERO:
        for column in list(columns_of_sides):
            letters = sorted({cell.strip().upper()[0] for cell in unused[column]})
            if len(letters) > 1:
                log.info("Note: %s holds %s, and is not taken for the side of %s: the points would "
                         "be far apart.", header[column].strip(), " and ".join(letters),
                         header[angle_column].strip())
                columns_of_sides.remove(column)
    if not columns_of_sides:
        return None
    nearest = min(columns_of_sides, key=lambda i: (i < angle_column, abs(i - angle_column)))
    changes_sign = any(cell.strip().upper() not in _ALONG[axis] for cell in unused[nearest])
    return nearest if changes_sign else None


def _are_sides(axis: str, cells: Sequence[str], *, is_next: bool) -> bool:
    """Return whether cells may say on which side of zero the angles of an axis are."""
    sides = {cell.strip().upper() for cell in cells}
    # O is west to some and east to others, which the reader of angles asks; or it says "ok".
    return bool(sides) and _SIDE_WORDS[axis].issuperset(sides) and (sides != {"O"} or is_next)


def _size(cell: str) -> float:
    """Return the size of the number in a cell; 0 if it is no number, as degrees and minutes are."""
    try:
        return abs(float(cell.replace(",", ".")))
    except ValueError:
        return 0.0


def with_side(cell: str, side: str) -> str:
    """Return a cell with its side, such as "47.5 N", unless it is blank or has a letter already.

    A negative number that is said to be south or west stays as it is, too: the minus says it.
    """
    side = side.strip().upper()[:1]
    text = cell.strip()
    if not text or text[-1].isalpha() or text[0].isalpha() or (
            text.startswith("-") and side in "SW"):
        return cell
    return f"{text} {side}"
