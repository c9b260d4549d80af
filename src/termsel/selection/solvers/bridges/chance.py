"""Libraries that draw from global random states, given states of their own."""

from __future__ import annotations

import random
from typing import Any

import numpy as np


class OwnChance:
    """Random states of `random` and `numpy.random` that hold within ``with`` alone.

    A generator draws the first states. On leaving, the global states are as they were on entering;
    the next entry goes on where this one ended.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        python = int(rng.integers(2**63))
        numpy = int(rng.integers(2**32))
        self._own = (random.Random(python).getstate(),
                     np.random.RandomState(numpy).get_state())
        self._others = self._own

    def __enter__(self) -> None:
        self._others = _exchange_states(self._own)

    def __exit__(self, *_error: object) -> None:
        self._own = _exchange_states(self._others)


def _exchange_states(states: tuple[Any, Any]) -> tuple[Any, Any]:
    """Set the global states; return those there were."""
    # Both libraries are taken as a pair: some operators of pymoo and DEAP draw from both.
    before = random.getstate(), np.random.get_state()
    random.setstate(states[0])
    np.random.set_state(states[1])
    return before
