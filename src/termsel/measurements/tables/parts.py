"""Parts of tables of features, and the same features in other units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from termsel.errors import TermselError

_Table = TypeVar("_Table", bound=Any)


def rows_of(ids: Sequence[str], index: ArrayLike) -> NDArray[np.intp]:
    """Return the rows that an index of integers or a mask names, each once.

    Raises TermselError for a row that is asked for twice.
    """
    array = np.asarray(index)
    rows = np.arange(len(ids))[array if array.size else np.zeros(0, dtype=np.intp)]
    times = np.bincount(rows, minlength=1)
    if times.max() > 1:
        raise TermselError(f"{ids[int(times.argmax())]!r} is asked for {times.max()} times",
                           hint="Give the index of every point and line once.")
    return np.asarray(rows)


def names_at(names: Sequence[str], rows: NDArray[np.intp]) -> tuple[str, ...]:
    """Return the names of rows; of a thousand points they are asked for many times."""
    return tuple(map(names.__getitem__, rows.tolist()))


def unchecked(whole: _Table, **changes: Any) -> _Table:
    """Return points or lines with some fields changed, without the checks of new ones.

    What was checked once holds for a part of them, and in other units. Fits make so many of these
    that the checks took a quarter of their time.
    """
    made = object.__new__(type(whole))
    for one in fields(whole):
        value = changes.get(one.name, getattr(whole, one.name))
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
        object.__setattr__(made, one.name, value)
    return made
