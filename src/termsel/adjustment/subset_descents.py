"""Good subsets of every size, found before any proof: bounds then rule out more."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from termsel.adjustment.subset_stack import Stack
from termsel.adjustment.subset_system import BITS, Masks, Piece, better
from termsel.measurements.features import FloatArray, IntArray

_RESTARTS = 8  # of the descent
_KICKS = 16  # restarts around the best that may fail in a row
_SWAPPED = 3  # columns before each of these


def descents(stack: Stack) -> Iterator[tuple[FloatArray, Masks]]:
    """Yield ever better subsets of every size, found by adding, dropping and swapping columns.

    Descents begin with no column, with random subsets, and then, until that has not helped for
    a while, with the best so far after some random swaps: the same on every machine.
    """
    rest, room = stack.everything.rest, stack.everything.room
    rng = np.random.default_rng(0)
    best, masks = _descent(stack, [rest[:0]])
    yield best, masks
    since = -_RESTARTS
    while since < _KICKS:
        if since < 0:
            starts = [rng.permutation(len(rest))[:rng.integers(1, room + 1)]]
        else:
            starts = [_kicked(stack, mask, rng) for mask in masks[masks > 0]]
        found, at = _descent(stack, [rest[start] for start in starts])
        since += 1
        if (found < best).any():
            best, masks = better(best, masks, found, at)
            since = min(since, 0)
        yield best, masks


def _kicked(stack: Stack, mask: np.uint64, rng: np.random.Generator) -> IntArray:
    """Return a subset, as indices of the rest, with some columns replaced by random ones."""
    inside = (BITS[stack.everything.rest] & mask) != 0
    mine, others = (rng.permutation(np.flatnonzero(part)) for part in (inside, ~inside))
    swapped = min(_SWAPPED, len(mine), len(others))
    return np.concatenate([mine[swapped:], others[:swapped]])


def _descent(stack: Stack, starts: list[IntArray]) -> tuple[FloatArray, Masks]:
    """Return the best subset of every size that single changes reach from some subsets.

    Every change of each best subset of a size is tried, until none helps.
    """
    around = [int(BITS[np.concatenate([stack.everything.used, start])].sum())
              for start in starts]
    best, masks = np.full(stack.k + 1, np.inf), np.zeros(stack.k + 1, dtype=np.uint64)
    seen = set(around)
    while around:
        for piece in (piece for mask in around for piece in _changes(stack, mask)):
            walked = stack.walk(piece, best, masks)
            best, masks = walked.best, walked.masks
        around = [mask for mask in masks.tolist() if mask and mask not in seen]
        seen.update(around)
    return best, masks


def _changes(stack: Stack, mask: int) -> list[Piece]:
    """Return the subsets with one more column than a subset, and with one or none instead."""
    used, rest, room = stack.everything.used, stack.everything.rest, stack.everything.room
    inside = (BITS[rest] & np.uint64(mask)) != 0
    mine, others = rest[inside], rest[~inside]
    pieces = [Piece(np.concatenate([used, mine]), others, min(1, room - len(mine)))]
    for i in range(len(mine)):
        kept = np.concatenate([used, np.delete(mine, i)])
        pieces.append(Piece(kept, others, 1))
    return pieces
