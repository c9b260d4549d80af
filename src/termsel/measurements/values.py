"""Coordinates and deviations that can be computed with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from termsel.errors import TermselError

FloatArray = NDArray[np.float64]

FARTHEST = 1e50
"""Coordinates from which on squares and products of some of them overflow."""


def check_finite(values: FloatArray, ids: Sequence[str], kind: str, what: str) -> None:
    """Refuse coordinates that are not finite, or too far."""
    bad = ~np.isfinite(values.reshape(len(ids), -1)).all(axis=1)
    if bad.any():
        name = ids[int(np.argmax(bad))]
        raise TermselError(f"{kind} {name!r} has {what} that are not finite numbers",
                           hint="Correct the values or remove the feature.", ids=[name])
    check_near(values, ids, kind, what)


def check_near(values: FloatArray, ids: Sequence[str], kind: str, what: str) -> None:
    """Refuse coordinates that are too far."""
    far = (np.abs(values) >= FARTHEST).reshape(len(ids), -1).any(axis=1)
    if far.any():
        name = ids[int(np.argmax(far))]
        raise TermselError(f"{kind} {name!r} has {what} of {FARTHEST:g} or more",
                           hint="Correct the values or remove the feature.", ids=[name])


def check_heights(z: FloatArray, ids: Sequence[str], kind: str) -> None:
    """Refuse infinite heights; blank heights are NaN and suit models without height."""
    bad = np.isinf(z.reshape(len(ids), -1)).any(axis=1)
    if bad.any():
        name = ids[int(np.argmax(bad))]
        raise TermselError(f"{kind} {name!r} has an infinite height", ids=[name])
    check_near(z, ids, kind, "a height")


def check_deviations(sigma: FloatArray, ids: Sequence[str], kind: str) -> None:
    """Refuse deviations that are not positive, or beyond what can be computed with."""
    # Their squares, and those of weights, must not overflow.
    bad = ~((sigma > 1 / FARTHEST) & (sigma < FARTHEST)).reshape(len(ids), -1).all(axis=1)
    if bad.any():
        name = ids[int(np.argmax(bad))]
        raise TermselError(f"{kind} {name!r} has a standard deviation that is not positive, "
                           "or beyond what can be computed with",
                           ids=[name])
