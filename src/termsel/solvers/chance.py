"""Libraries that draw from global random states, given states of their own."""

from __future__ import annotations

import random
from types import TracebackType
from typing import Any

import numpy as np


class OwnChance:
    """Random states of `random` and `numpy.random` that hold within ``with`` alone.

    On leaving, the global states are as they were on entering; the next entry goes on where this
    one ended. Within, `numpy.random.default_rng` without a seed gives a generator that has one, as
    pymoo makes new generators where it does not pass its own on.

    Parameters
    ----------
    rng : numpy.random.Generator
        Draws the first states.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        python, numpy = int(rng.integers(2**63)), int(rng.integers(2**32))
        self._own = (random.Random(python).getstate(),
                     np.random.RandomState(numpy).get_state())
        self._others = self._own
        self._generator = np.random.default_rng((python, numpy))
        self._default_rng = np.random.default_rng

    def __enter__(self) -> None:
        self._others = _exchanged(self._own)
        self._default_rng = np.random.default_rng
        np.random.default_rng = self._seeded

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        np.random.default_rng = self._default_rng
        self._own = _exchanged(self._others)

    def _seeded(self, seed: Any = None) -> np.random.Generator:
        return self._generator if seed is None else self._default_rng(seed)


def _exchanged(states: tuple[Any, Any]) -> tuple[Any, Any]:
    """Set the global states; return those there were."""
    before = random.getstate(), np.random.get_state()
    random.setstate(states[0])
    np.random.set_state(states[1])
    return before
