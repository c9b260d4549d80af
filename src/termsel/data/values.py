"""Ids, coordinates and deviations that every reader, plugin and program takes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from termsel.core.errors import TermselError, cut, is_printable

FloatArray = NDArray[np.float64]

FARTHEST = 1e50
"""Coordinates from which on squares and products of some of them overflow."""

MAX_ID = 200
"""Characters of an id."""

_MAX_NAMED = 8
"""Places that a message names."""
_MAX_IN_PLACE = 3
"""Points of one place that a message names."""

_CORRECT = "Correct the values or remove the feature."


def frozen(values: ArrayLike, shape: tuple[int, ...], content: str) -> FloatArray:
    """Return values as an array that cannot be written to; refuse another shape."""
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise TermselError(f"{content} has shape {array.shape}, expected {shape}")
    array.setflags(write=False)
    return array


def check_finite(values: FloatArray, ids: Sequence[str], kind: str, content: str) -> None:
    """Refuse coordinates that are not finite, or too far."""
    _refuse(~np.isfinite(values), ids, kind, f"{content} that are not finite numbers", _CORRECT)
    check_near(values, ids, kind, content)


def check_near(values: FloatArray, ids: Sequence[str], kind: str, content: str) -> None:
    """Refuse coordinates that are too far."""
    _refuse(np.abs(values) >= FARTHEST, ids, kind, f"{content} of {FARTHEST:g} or more", _CORRECT)


def check_heights(z: FloatArray, ids: Sequence[str], kind: str) -> None:
    """Refuse infinite heights; blank heights are NaN and suit models without height."""
    _refuse(np.isinf(z), ids, kind, "an infinite height")
    check_near(z, ids, kind, "a height")


def check_deviations(sigma: FloatArray, ids: Sequence[str], kind: str) -> None:
    """Refuse deviations that are not positive, or beyond what can be computed with."""
    # Their squares, and those of weights, must not overflow.
    is_bad = ~((sigma > 1 / FARTHEST) & (sigma < FARTHEST))
    if not is_bad.any():
        return
    value = sigma[is_bad][0]
    fault = "beyond what can be computed with" if value > 0 else "not positive"
    axes = np.argwhere(is_bad)[0, 1:]  # none of a line
    name = ("sigma_line", "sigma_sample")[axes[0]] if len(axes) else "sigma"
    _refuse(is_bad, ids, kind, f"{name} {value:g}, a standard deviation that is {fault}",
            "Correct it, or leave the columns of standard deviations out.")


def _refuse(is_bad: NDArray[np.bool_], ids: Sequence[str], kind: str, problem: str,
            hint: str | None = None) -> None:
    """Refuse the first feature with a bad value, given which are bad, shape (n, ...)."""
    features = is_bad.reshape(len(ids), -1).any(axis=1)
    if features.any():
        name = ids[int(np.argmax(features))]
        raise TermselError(f"{kind} {name!r} has {problem}", hint=hint, ids=[name])


def check_places(ground: FloatArray, ids: Sequence[str]) -> None:
    """Refuse points at one place on the ground, naming all of them."""
    # One image position with several ground points is a line of sight through several
    # heights; one ground point cannot be seen at two image positions.
    repeated = repeated_places(ground)
    if repeated:
        is_pair = len(repeated) == 1 and len(repeated[0]) == 2
        surplus = "one of them" if is_pair else "all but one of each"
        earlier, later, *_ = repeated[0]
        raise TermselError(places_in_words(ids, repeated), ids=[ids[later], ids[earlier]],
                           hint=f"Remove {surplus}, or average their image coordinates: --set "
                                "repeated=average.")


def repeated_places(ground: FloatArray, *, with_single: bool = False) -> list[list[int]]:
    """Return the rows of each place (n, 3) on the ground that has several points.

    `with_single` adds the places that have one.
    """
    _, labels = np.unique(np.nan_to_num(ground, nan=0.0), axis=0, return_inverse=True)
    rows: dict[int, list[int]] = {}
    for row, number in enumerate(labels.ravel().tolist()):
        rows.setdefault(number, []).append(row)
    return [group for group in rows.values() if with_single or len(group) > 1]


def places_in_words(ids: Sequence[str], groups: Sequence[Sequence[int]]) -> str:
    """Return which points have the same ground coordinates, given the rows of each place."""
    named = []
    for rows in groups[:_MAX_NAMED]:
        # Three of a place show which it is.
        listed = [repr(ids[row]) for row in rows[:_MAX_IN_PLACE]]
        surplus = [f"{len(rows) - _MAX_IN_PLACE} more"] if len(rows) > _MAX_IN_PLACE else []
        *first, last = [*listed, *surplus]
        named.append(f"{', '.join(first)} and {last}")
    unnamed = f"; and those of {len(groups) - _MAX_NAMED} more positions" \
        if len(groups) > _MAX_NAMED else ""
    each_group = " each" if len(groups) > 1 else ""
    return f"points {'; '.join(named)}{unnamed}{each_group} have the same ground coordinates"


def check_segments(ground: FloatArray, ids: Sequence[str]) -> None:
    """Refuse two lines with the same ground vertices."""
    ends = np.nan_to_num(ground, nan=0.0)
    # One order of the ends, by X, then Y, then Z, so that a reversed line is found too.
    # The first coordinate in which the two ends differ says which of them comes first.
    differs = ends[:, 0] != ends[:, 1]
    first_difference = np.argmax(differs, axis=1)
    index = np.arange(len(ends))
    swap = ends[index, 0, first_difference] > ends[index, 1, first_difference]
    ends[swap] = ends[swap][:, ::-1]
    pair = _repeated(ends.reshape(len(ids), -1))
    if pair:
        first, second = (ids[i] for i in pair)
        raise TermselError(f"lines {first!r} and {second!r} have the same ground vertices",
                           hint="Remove one of them.", ids=[second, first])


def _repeated(rows: FloatArray) -> tuple[int, int] | None:
    """Return the first row that repeats an earlier one, after that one."""
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    earlier = first[inverse.ravel()]
    repeated = np.flatnonzero(earlier != np.arange(len(rows)))
    return (int(earlier[repeated[0]]), int(repeated[0])) if repeated.size else None


def refused(name: str) -> str:
    """Return what is wrong with an id, "" if nothing."""
    # So that tables keep it, and a terminal shows it.
    if not name:
        return "is blank"
    if len(name) > MAX_ID:
        return f"has {len(name):,} characters, more than {MAX_ID}"
    return "" if is_printable(name) else "has a line break or a character that cannot be printed"


def check_ids(ids: Sequence[str], kind: str, *, unique: bool) -> None:
    """Refuse ids of points or lines, a `kind`, that break the rule, or are not `unique`."""
    for name in ids:
        if wrong := refused(name):
            raise TermselError(f"the id {cut(name, 40)!r} of a {kind} {wrong}", ids=[name],
                               hint="Give every feature a short id of letters, digits and signs.")
    twice = [name for name, count in Counter(ids).items() if count > 1] if unique else []
    if twice:
        raise TermselError(f"{kind} id {twice[0]!r} is used {Counter(ids)[twice[0]]} times",
                           hint="Give every feature a different id.", ids=twice[:1])
