"""Good subsets of every size, found before any proof: bounds then rule out more."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count

import numpy as np

from termsel.enumeration.columns.kernels import RSS
from termsel.enumeration.columns.system import BITS, Masks, Piece, better
from termsel.enumeration.stack import Stack
from termsel.measurements.features import FloatArray, IntArray

_RESTARTS = 8  # of the descent
_KICKS = 16  # restarts around the best that may fail in a row
_SWAPPED = (2, 5)  # columns before each of these, at least and at most
_WORTH = 1 << 15  # subsets that branch and bound decides in the time of one piece of a descent
_ROUNDING = 1e-9  # a subset reached in another order differs by less


def descents(stack: Stack) -> Iterator[tuple[FloatArray, Masks]]:
    """Yield ever better subsets of every size, found by adding, dropping and swapping columns.

    Descents begin with no column, with random subsets, and then with the best of every size after
    some random swaps, until that has not helped the size for a while, or until they have cost as
    much as the proof without them: the same on every machine.
    """
    rest, room = stack.everything.rest, stack.everything.room
    rng = np.random.default_rng(0)  # the same on every machine, as the proof is
    best, masks, pieces = _descent(stack, [rest[:0]])
    yield best, masks
    failed = np.zeros(stack.k + 1, dtype=np.intp)  # kicks of each size since its best was found
    for restart in count():
        if pieces * _WORTH > stack.everything.count:
            return
        if restart >= _RESTARTS and stack.kind == RSS:
            return  # the proof finds the rest as fast
        if restart < _RESTARTS:
            starts = [rng.permutation(len(rest))[:rng.integers(1, room + 1)]]
        else:
            kicked = np.flatnonzero((masks > 0) & (failed < _KICKS))
            if not len(kicked):
                return
            starts = [_kicked(stack, masks[size], rng) for size in kicked]
            failed[kicked] += 1
        reached, at, walked = _descent(stack, [rest[start] for start in starts])
        pieces += walked
        failed[reached < (1.0 - _ROUNDING) * best] = 0
        best, masks = better(best, masks, reached, at)
        yield best, masks


def _kicked(stack: Stack, mask: np.uint64, rng: np.random.Generator) -> IntArray:
    """Return a subset, as indices of the rest, with some columns replaced by random ones."""
    inside = (BITS[stack.everything.rest] & mask) != 0
    mine, others = (rng.permutation(np.flatnonzero(part)) for part in (inside, ~inside))
    swapped = min(int(rng.integers(*_SWAPPED, endpoint=True)), len(mine), len(others))
    return np.concatenate([mine[swapped:], others[:swapped]])


def _descent(stack: Stack, starts: list[IntArray]) -> tuple[FloatArray, Masks, int]:
    """Return the best subset of every size that single changes reach from some subsets.

    Every change of each best subset of a size is tried, until none helps. The last value is the
    number of pieces that this took.
    """
    around = [int(BITS[np.concatenate([stack.everything.used, start])].sum())
              for start in starts]
    best, masks = np.full(stack.k + 1, np.inf), np.zeros(stack.k + 1, dtype=np.uint64)
    seen, pieces = set(around), 0
    while around:
        # Each neighbourhood is walked with the best so far, and thus bounded.
        for piece in (piece for mask in around for piece in _changes(stack, mask)):
            walked = stack.walk(piece, best, masks)
            best, masks, pieces = walked.best, walked.masks, pieces + 1
        around = [mask for mask in masks.tolist() if mask and mask not in seen]
        seen.update(around)
    return best, masks, pieces


def _changes(stack: Stack, mask: int) -> list[Piece]:
    """Return the subsets with one more column than a subset, and with one or none instead."""
    used, rest, room = stack.everything.used, stack.everything.rest, stack.everything.room
    inside = (BITS[rest] & np.uint64(mask)) != 0
    mine, others = rest[inside], rest[~inside]
    pieces = [Piece(np.concatenate([used, mine]), others, min(1, room - len(mine)))]
    # Without column i: with none of the others instead, or one.
    for i in range(len(mine)):
        kept = np.concatenate([used, np.delete(mine, i)])
        pieces.append(Piece(kept, others, 1))
    return pieces
