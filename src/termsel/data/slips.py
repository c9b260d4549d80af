"""Slips of the pen: what one value may have been before it was copied wrongly."""

from __future__ import annotations

from collections.abc import Iterator
from decimal import Decimal
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from termsel.data.features import FloatArray

VALUES_OF_POINT = ("line", "sample", "x", "y", "z")
"""Values of a point, in the order of its row."""

_LONGEST = 17
"""Digits of a value of double precision: exchanged ones further on are no longer what was typed."""


class Slip(NamedTuple):
    """One way in which a row may have been copied wrongly, and the row without it."""

    columns: tuple[str, ...]
    reason: str
    row: FloatArray  # (5,): line, sample, x, y, z


def slips_of_row(row: FloatArray) -> Iterator[Slip]:
    """Yield the slips that one row (5,) of line, sample, x, y and z may have.

    They are two values of a row exchanged, a sign turned, the decimal point moved, and two
    neighbouring digits exchanged.
    """
    for first, second in ((0, 1), (2, 3)):
        if row[first] != row[second]:
            exchanged = row.copy()
            exchanged[[first, second]] = row[[second, first]]
            columns = (VALUES_OF_POINT[first], VALUES_OF_POINT[second])
            yield Slip(columns, f"{' and '.join(columns)} exchanged", exchanged)
    for index, column in enumerate(VALUES_OF_POINT):
        for value, reason in slips_of_value(float(row[index])):
            corrected = row.copy()
            corrected[index] = value
            yield Slip((column,), reason, corrected)


def slips_of_value(value: float) -> Iterator[tuple[float, str]]:
    """Yield what a value may have been, and the slip that made it of that; none for 0 and NaN."""
    if not np.isfinite(value) or value == 0.0:
        return
    yield -value, "the sign turned"
    for factor in (10, 100, 1000):
        # Of decimals, so that 485.08 / 10 has the digits of what was typed.
        yield float(Decimal(repr(value)) / factor), "the decimal point moved"
        yield float(Decimal(repr(value)) * factor), "the decimal point moved"
    digits = format(abs(Decimal(repr(value))), "f")
    places = [place for place, char in enumerate(digits) if char.isdigit()][:_LONGEST]
    for left, right in pairwise(places):
        if digits[left] != digits[right]:
            typed = list(digits)
            typed[left], typed[right] = digits[right], digits[left]
            yield float(np.copysign(float("".join(typed)), value)), "two digits exchanged"


def slip_among(value: float, others: FloatArray) -> tuple[float, str] | None:
    """Return the one slip by which a value is outside the range of others (n,), or None.

    It is None, too, where several slips would explain it, or the others are fewer than three.
    """
    others = others[np.isfinite(others)]
    if len(others) < 3:
        return None
    low, high = float(others.min()), float(others.max())
    possible = [slip for slip in slips_of_value(value) if low <= slip[0] <= high]
    return possible[0] if len({likely for likely, _ in possible}) == 1 else None
