"""Libraries that draw from global random states, given states of their own."""

from __future__ import annotations

import random
from threading import Lock, get_ident
from typing import Any

import numpy as np

_inside: dict[int, np.random.Generator] = {}
"""Generators of the threads that are within an `OwnChance`."""

_lock = Lock()
_others_rng = np.random.default_rng


class OwnChance:
    """Random states of `random` and `numpy.random` that hold within ``with`` alone.

    A generator draws the first states. On leaving, the global states are as they were on entering;
    the next entry goes on where this one ended. Within, and in this thread alone,
    `numpy.random.default_rng` without a seed gives a generator that has one, as pymoo makes new
    generators where it does not pass its own on.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        python, numpy = int(rng.integers(2**63)), int(rng.integers(2**32))
        self._own = (random.Random(python).getstate(),
                     np.random.RandomState(numpy).get_state())
        self._others = self._own
        self._generator = np.random.default_rng((python, numpy))
        self._outer: np.random.Generator | None = None

    def __enter__(self) -> None:
        self._others = _exchanged(self._own)
        self._outer = _taken(self._generator)

    def __exit__(self, *_error: object) -> None:
        _taken(self._outer)
        self._own = _exchanged(self._others)


def _taken(generator: np.random.Generator | None) -> np.random.Generator | None:
    """Set the generator of this thread, None for that of numpy; return the one there was."""
    global _others_rng
    with _lock:
        # The first thread that enters replaces numpy's function, the last one to leave restores it.
        before = _inside.pop(get_ident(), None)
        if generator is not None:
            if not _inside and np.random.default_rng is not _of_this_thread:
                _others_rng, np.random.default_rng = np.random.default_rng, _of_this_thread
            _inside[get_ident()] = generator
        elif not _inside:
            np.random.default_rng = _others_rng
        return before


def _of_this_thread(seed: Any = None) -> np.random.Generator:
    own = _inside.get(get_ident()) if seed is None else None
    return _others_rng(seed) if own is None else own


def _exchanged(states: tuple[Any, Any]) -> tuple[Any, Any]:
    """Set the global states; return those there were."""
    before = random.getstate(), np.random.get_state()
    random.setstate(states[0])
    np.random.set_state(states[1])
    return before
