"""Libraries that draw from global random states, given states of their own."""

from __future__ import annotations

import random
from types import TracebackType
from typing import Any

import numpy as np


class OwnChance:
    """Random states of `random` and `numpy.random` that hold within ``with`` alone.

    On leaving, the global states are as they were on entering; the next entry goes on where this
    one ended.

    Parameters
    ----------
    rng : numpy.random.Generator
        Draws the first states.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._own = (random.Random(int(rng.integers(2**63))).getstate(),
                     np.random.RandomState(int(rng.integers(2**32))).get_state())
        self._others = self._own

    def __enter__(self) -> None:
        self._others = _exchanged(self._own)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._own = _exchanged(self._others)


def _exchanged(states: tuple[Any, Any]) -> tuple[Any, Any]:
    """Set the global states; return those there were."""
    before = random.getstate(), np.random.get_state()
    random.setstate(states[0])
    np.random.set_state(states[1])
    return before
