"""What arrays of plugins must be: shape, dtype, finiteness."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np


def of_shape(value: Any, shape: tuple[int, ...], *, finite: bool = True,
             what: str = "returned") -> str | None:
    """Return how an array of numbers differs from what is expected, None if it does not.

    In the shape -1 stands for any length. The message begins with `what`.
    """
    expected = f"expected an array of numbers of shape ({_listed(shape)})"
    if not isinstance(value, np.ndarray):
        return f"{what} an object of type {type(value).__name__}; {expected}"
    if value.dtype.kind not in "fiu":
        return f"{what} an array of {value.dtype}; {expected}"
    if len(value.shape) != len(shape) or any(
            wanted not in (-1, there) for wanted, there in zip(shape, value.shape, strict=True)):
        return f"{what} an array of shape ({_listed(value.shape)}); {expected}"
    if finite and not np.isfinite(value).all():
        return (f"{what} {np.count_nonzero(~np.isfinite(value))} numbers that are not finite; "
                "expected finite ones")
    return None


def _listed(shape: tuple[int, ...]) -> str:
    sizes = ["n" if size == -1 else str(size) for size in shape]
    return f"{sizes[0]}," if len(sizes) == 1 else ", ".join(sizes)


def returns(wanted: type) -> Callable[..., str | None]:
    """Return a check of methods, for `Guarded`, that must return an object of a type."""
    return lambda _own, value, *_args: of_type(value, wanted)


def of_type(value: Any, wanted: type) -> str | None:
    """Return how an object differs from the type expected, None if it does not."""
    if isinstance(value, wanted):
        return None
    shown = "nothing" if value is None else f"an object of type {type(value).__name__}"
    return f"returned {shown}; expected {wanted.__name__}"
