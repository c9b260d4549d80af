"""Numbers as people write them: decimal commas, separators of thousands, degrees and minutes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from math import isfinite

import numpy as np
from numpy.typing import NDArray

POINT, COMMA = ".", ","
_THREE = "three"
"""All cells have three digits after a point: decimals, unless other columns tell otherwise."""
_PARTED = re.compile(r"(?<=\d)[\s'’](?=\d{3}(?!\d))")
_ONE_GROUP = {sign: re.compile(rf"[+-]?[1-9]\d{{0,2}}\{sign}\d{{3}}") for sign in (POINT, COMMA)}
_GROUPS = {sign: re.compile(rf"[+-]?\d{{1,3}}(\{sign}\d{{3}})+(\{other}\d*)?")
           for sign, other in ((POINT, COMMA), (COMMA, POINT))}
_SIDES = {"N": 1, "S": -1, "E": 1, "W": -1, "北": 1, "南": -1, "东": 1, "東": 1, "西": -1}
_LATITUDE = frozenset("NS北南")
_ANGLE = re.compile(
    r"([NSEWO北南东東西]?)[经經纬緯]?\s*([+-]?\d+(?:[.,]\d+)?)\s*[°º˚d:度\s-]?\s*"
    r"(?:(\d+(?:[.,]\d+)?)\s*['′’´m:分\s-]?\s*)?"
    r"(?:(\d+(?:[.,]\d+)?)\s*(?:[\"″”秒]|(?-i:s)|''|′′|’’)?)?\s*([NSEWO]?)", re.IGNORECASE)
_MARKS = re.compile("[°º˚d度'′’´m分:]", re.IGNORECASE)


class BadCell(ValueError):
    """A cell that is no number, in a row from 0, and a column where several are read."""

    def __init__(self, row: int, problem: str, hint: str, column: str = "") -> None:
        super().__init__(problem)
        self.row = row
        self.what = problem
        self.hint = hint
        self.column = column


def decimal_signs(columns: Mapping[str, Sequence[str]], stated: str = "", *,
                  points_only: bool = False) -> tuple[dict[str, str], list[str]]:
    """Return the decimal sign of each column of numbers, by the evidence of all its rows.

    1,234 alone may be one thousand or little more than one. A column where that is open takes the
    sign of the columns where it is not, if they agree, or the sign `stated`; else its sign is "".
    With `points_only` commas separate the columns, so that points without commas are decimal. The
    open columns that others, or the user, decided come second. Raises BadCell if cells of one
    column contradict each other.
    """
    # "." or "," where cells tell, "three" or "" where they leave it open, None without any sign.
    evidence = {name: _sign(name, cells, points_only) for name, cells in columns.items()}
    certain = {sign for sign in evidence.values() if sign in (POINT, COMMA)}
    open_sign = stated or (certain.pop() if len(certain) == 1 else "")
    signs = {name: sign if sign in (POINT, COMMA) else POINT if sign is None else
             open_sign or (POINT if sign == _THREE else "") for name, sign in evidence.items()}
    return signs, [name for name, sign in evidence.items()
                   if (open_sign and sign == "") or (open_sign == COMMA and sign == _THREE)]


def _sign(name: str, cells: Sequence[str], points_only: bool) -> str | None:
    """Return the decimal sign of a column, or how open it is; None where it has no such sign."""
    joined = "".join(cells)
    commas = COMMA in joined
    if not commas and (points_only or POINT not in joined):
        return POINT if POINT in joined else None
    first_row: dict[str, int] = {}
    whole_numbers = 0
    for row, cell in enumerate(cells):
        text = _PARTED.sub("", cell.strip())
        # The sign further right is the decimal one, unless it occurs twice or is followed by three
        # digits alone.
        last = max(COMMA, POINT, key=text.rfind)
        other_sign = POINT if last == COMMA else COMMA
        if last not in text:
            whole_numbers += bool(text)
        elif text.count(last) > 1:
            first_row.setdefault(other_sign, row)
        elif other_sign in text or not _ONE_GROUP[last].fullmatch(text):
            first_row.setdefault(last, row)
    if len(first_row) > 1:
        (_, _), (sign, row) = sorted(first_row.items(), key=lambda item: item[1])
        sign_word, other_word = ("comma", "point") if sign == COMMA else ("point", "comma")
        raise BadCell(row, f"{cells[row].strip()!r} has a decimal {sign_word}, other cells a "
                           f"decimal {other_word}", "Use one of them in the whole column.", name)
    if first_row:
        return next(iter(first_row))
    # Points with three digits in each row are decimal; if only the large numbers have one, not.
    return "" if commas or whole_numbers else _THREE


def read_numbers(cells: Sequence[str], sign: str, *, may_be_blank: bool, angle: str = "",
                 ) -> NDArray[np.float64]:
    """Return cells as numbers, NaN for blank ones; raises BadCell for the first that is none.

    The sign other than the decimal `sign` separates thousands. `angle` is "x" or "y" where cells
    may be longitudes or latitudes in degrees, minutes and seconds.
    """
    # Whole columns at C speed; single cells are read only where that fails.
    joined = "".join(cells)
    if "_" not in joined and (sign == POINT or POINT not in joined):
        blank = np.array([may_be_blank and (not cell or cell.isspace()) for cell in cells])
        texts = ["nan" if is_blank else cell.replace(COMMA, POINT) if sign == COMMA else cell
                 for cell, is_blank in zip(cells, blank, strict=True)]
        with suppress(ValueError):
            values = np.fromiter(map(float, texts), np.float64, len(cells))
            if np.isfinite(values[~blank]).all():
                return values
    return np.array([_number(row, cell, sign, may_be_blank, angle)
                     for row, cell in enumerate(cells)])


def _number(row: int, cell: str, sign: str, may_be_blank: bool, angle: str) -> float:
    """Return the number of a cell; raises BadCell, with the row, for what is none."""
    text = cell.strip()
    if not text:
        if may_be_blank:
            return float("nan")
        raise BadCell(row, "the cell is blank, expected a number", "Fill it in or remove the row.")
    # Spaces and apostrophes between groups of three, and the minus sign of typography.
    digits = _PARTED.sub("", cell).replace("−", "-")
    separator = COMMA if sign == POINT else POINT
    if separator in digits and _GROUPS[separator].fullmatch(digits.strip()):
        digits = digits.replace(separator, "")
    try:
        value = float(digits.replace(COMMA, POINT) if sign == COMMA else digits)
    except ValueError:
        if angle and (degrees := _degrees(row, text, angle)) is not None:
            return degrees
        raise BadCell(row, f"{text!r} is not a number", "Write a plain number such as 12.5."
                      ) from None
    if not isfinite(value):
        raise BadCell(row, f"{text!r} is not a finite number",
                      "Leave the cell blank if the value is unknown." if may_be_blank
                      else "Correct it or remove the row.")
    if "_" in text:
        raise BadCell(row, f"{text!r} is not a plain number", "Write it without underscores.")
    return value


def _degrees(row: int, text: str, angle: str) -> float | None:
    """Return an angle in degrees, such as of 10°59'28.7"E; None where the text is none."""
    match = _ANGLE.fullmatch(text)
    if match is None:
        return None
    before, *numbers, after = (number or "" for number in match.groups())
    numbers = [number.replace(COMMA, POINT) for number in numbers if number]
    hemisphere = (before or after).upper()
    values = [abs(float(number)) for number in numbers]
    if (before and after) or any(POINT in number for number in numbers[:-1]) or values[0] > 360 \
            or not (hemisphere or len(numbers) == 3 or _MARKS.search(text)):
        return None
    if any(value >= 60 for value in values[1:]):
        raise BadCell(row, f"{text!r} has 60 or more minutes or seconds", "Correct the angle.")
    if hemisphere == "O":
        raise BadCell(row, f"the O in {text!r} is east in German and west in Romance languages",
                      "Write E or W.")
    if hemisphere and (hemisphere in _LATITUDE) != (angle == "y"):
        kind = "latitude" if hemisphere in _LATITUDE else "longitude"
        raise BadCell(row, f"{text!r} is a {kind} in the column of {angle}",
                      "x is the longitude and y the latitude: are the columns swapped?")
    if hemisphere and numbers[0][0] in "+-":
        raise BadCell(row, f"{text!r} has a sign and a hemisphere", "Give one of them.")
    # degrees + minutes / 60 + seconds / 3600.
    size = sum(value / 60.0**power for power, value in enumerate(values))
    return -size if numbers[0][0] == "-" else size * _SIDES.get(hemisphere, 1)
