"""What a proof says of the best selection of each size, in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from termsel.errors import percent

TITLE = "best of its size"
COUNTS = {"n_terms": "terms", "n_features": "control features"}

_TIE = 1e-9  # criteria that differ relatively by less are equal

Sized = Mapping[str, Any]


def proven(one: Sized) -> str:
    """Return what is proven of an item of the record's `by_size`."""
    if one["optimal"]:
        return "proven"
    if one["gap"] is None:
        return "not proven"
    if one["gap"] > 1:
        return f"at most {1 + one['gap']:.3g} times as high"
    return f"at most {percent(one['gap'])} above it"


def others(by_size: Sequence[Sized], criterion: str) -> Iterator[str]:
    """Yield what is proven of the sizes that are no better than a smaller one.

    Parameters
    ----------
    by_size : sequence of mapping
        Of the record.
    criterion : str
        Name of its objective.
    """
    settled, open_, least = [], [], float("inf")
    words = counted_by(by_size)
    for one in by_size:
        size, value = one["objectives"][size_of(one)], one["objectives"][criterion]
        if one["better"]:
            least = value
        elif one["bound"] is not None and one["bound"] >= least - _TIE * abs(least):
            settled.append(size)
        else:
            open_.append(size)
    if settled:
        yield (f"Proven: the best selection of {_ranges(settled)} {words} is no better than "
               "that of fewer.")
    if open_:
        yield (f"Not proven: a selection of {_ranges(open_)} {words} may still be better "
               "than that of fewer.")


def size_of(one: Sized) -> str:
    """Return what a member of a front counts: "n_terms" or "n_features"."""
    return str(next(iter(one["objectives"])))


def counted_by(members: Sequence[Sized]) -> str:
    """Return what members count, in words."""
    return COUNTS.get(size_of(members[0]), size_of(members[0]))


def _ranges(sizes: Sequence[int]) -> str:
    """Return numbers as text, three or more in a row by their ends."""
    rows: list[list[int]] = []
    for size in sizes:
        if rows and size == rows[-1][-1] + 1:
            rows[-1].append(size)
        else:
            rows.append([size])
    words = [word for row in rows for word in (
        map(str, row) if len(row) < 3 else [f"{row[0]} to {row[-1]}"])]
    return " and ".join([", ".join(words[:-1]), words[-1]] if words[1:] else words)
