"""What arrays of plugins must be: shape, dtype, finiteness."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np


def difference_from_shape(value: Any, shape: tuple[int, ...], *, finite: bool = True,
                          verb: str = "returned") -> str | None:
    """Return how a value differs from an array of numbers of a shape; None if it does not.

    A length of -1 in the shape stands for any. `finite` says whether the numbers must be finite,
    and `verb`, such as "returned", begins the message.
    """
    sizes_fit = isinstance(value, np.ndarray) and len(value.shape) == len(shape) and all(
        expected_size in (-1, size)
        for expected_size, size in zip(shape, value.shape, strict=True))
    # Real and whole numbers; bool and complex are not.
    if sizes_fit and value.dtype.kind in "fiu" and (not finite or np.isfinite(value).all()):
        return None
    expected = f"expected an array of numbers of shape ({_list_in_words(shape)})"
    if not isinstance(value, np.ndarray):
        return f"{verb} an object of type {type(value).__name__}; {expected}"
    if value.dtype.kind not in "fiu":
        return f"{verb} an array of {value.dtype}; {expected}"
    if not sizes_fit:
        return f"{verb} an array of shape ({_list_in_words(value.shape)}); {expected}"
    return (f"{verb} {np.count_nonzero(~np.isfinite(value))} numbers that are not finite; "
            "expected finite ones")


def _list_in_words(shape: tuple[int, ...]) -> str:
    """Return a shape as numpy prints it, with n for a size that may be any."""
    sizes = ["n" if size == -1 else str(size) for size in shape]
    return f"{sizes[0]}," if len(sizes) == 1 else ", ".join(sizes)


def returns_type(expected: type) -> Callable[..., str | None]:
    """Return a check, for `Guarded`, that a method returns an object of a type."""
    return lambda _object, value, *_args: difference_from_type(value, expected)


def difference_from_type(value: Any, expected: type) -> str | None:
    """Return how an object differs from the type expected, None if it does not."""
    if isinstance(value, expected):
        return None
    got = "nothing" if value is None else f"an object of type {type(value).__name__}"
    return f"returned {got}; expected {expected.__name__}"
