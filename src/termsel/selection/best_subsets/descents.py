"""Good subsets of every size, found before any proof: bounds then rule out more."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count

import numpy as np

from termsel.data.features import FloatArray, IntArray
from termsel.selection.best_subsets.columns.kernels import RSS
from termsel.selection.best_subsets.columns.system import (
    BITS,
    Masks,
    SubtreeNode,
    better_of_each_size,
)
from termsel.selection.best_subsets.score_systems import ScoreSystems
from termsel.selection.best_subsets.splicing import find_best_by_splicing, tells_changes

_RESTARTS = 8  # of the descent
_KICKS = 16  # restarts around the best that may fail in a row
_SWAPPED = (2, 5)  # columns before each of these, at least and at most
_WORTH = 1 << 15  # subsets that branch and bound decides in the time of one node of a descent
_ORDER_ROUNDING = 1e-9  # a subset reached in another order differs by less


def descend_through_subsets(systems: ScoreSystems) -> Iterator[tuple[FloatArray, Masks]]:
    """Yield scores and masks, (k + 1,), of ever better subsets of every size.

    Descents add, drop and swap columns. They begin with no column, with random subsets, and then
    with the best of every size after some random swaps, except for the score rss. They end when
    swapping has helped no size for a while, or when they have cost as much as the proof without
    them. All of it is the same on every machine.
    """
    candidates = systems.everything.candidates
    room = systems.everything.room
    rng = np.random.default_rng(0)  # the same on every machine, as the proof is
    best, masks, nodes = _descend_from(systems, [candidates[:0]])
    yield best, masks
    # Kicks of each size since its best was found.
    failures = np.zeros(systems.k + 1, dtype=np.intp)
    for restart in count():
        if nodes * _WORTH > systems.everything.count:
            return
        if restart >= _RESTARTS and systems.kind == RSS:
            return  # the proof finds better ones as fast
        if restart < _RESTARTS:
            starts = [rng.permutation(len(candidates))[:rng.integers(1, room + 1)]]
        else:
            kicked = np.flatnonzero((masks > 0) & (failures < _KICKS))
            if not len(kicked):
                return
            starts = [_perturb_subset(systems, masks[size], rng) for size in kicked]
            failures[kicked] += 1
        start_columns = [candidates[start] for start in starts]
        reached, reached_masks, walked_nodes = _descend_from(systems, start_columns)
        nodes += walked_nodes
        failures[reached < (1.0 - _ORDER_ROUNDING) * best] = 0
        best, masks = better_of_each_size(best, masks, reached, reached_masks)
        yield best, masks


def _perturb_subset(systems: ScoreSystems, mask: np.uint64, rng: np.random.Generator) -> IntArray:
    """Return a subset with some columns replaced by random ones, as indices of the candidates."""
    inside = (BITS[systems.everything.candidates] & mask) != 0
    members = rng.permutation(np.flatnonzero(inside))
    outsiders = rng.permutation(np.flatnonzero(~inside))
    swapped = min(int(rng.integers(*_SWAPPED, endpoint=True)), len(members), len(outsiders))
    return np.concatenate([members[swapped:], outsiders[:swapped]])


def _descend_from(systems: ScoreSystems, starts: list[IntArray]) -> tuple[FloatArray, Masks, int]:
    """Return the best subset of every size that single changes reach from some subsets.

    `starts` are subsets, the indices of their columns without the forced ones. Every change of each
    best subset of a size is tried, until none helps. Returned are scores and masks, (k + 1,), and
    the number of nodes that this took.
    """
    centres = [int(BITS[np.concatenate([systems.everything.used, start])].sum())
               for start in starts]
    best = np.full(systems.k + 1, np.inf)
    masks = np.zeros(systems.k + 1, dtype=np.uint64)
    visited = set(centres)
    infeasible: set[bytes] = set()
    nodes = 0
    while centres:
        # Each neighbourhood is walked with the best so far, and thus bounded.
        for mask in centres:
            changes = _single_changes(systems, mask)
            nodes += len(changes)
            improved = None
            if tells_changes(systems):
                improved = find_best_by_splicing(systems, mask, best, masks, infeasible)
            if improved is not None:
                best, masks = improved
                continue
            for node in changes:
                result = systems.walk(node, best, masks)
                best = result.best
                masks = result.masks
        centres = [mask for mask in masks.tolist() if mask and mask not in visited]
        visited.update(centres)
    return best, masks, nodes


def _single_changes(systems: ScoreSystems, mask: int) -> list[SubtreeNode]:
    """Return the subsets with one more column than a subset, and with one or none instead."""
    used = systems.everything.used
    candidates = systems.everything.candidates
    room = systems.everything.room
    inside = (BITS[candidates] & np.uint64(mask)) != 0
    members = candidates[inside]
    outsiders = candidates[~inside]
    nodes = [SubtreeNode(np.concatenate([used, members]), outsiders, min(1, room - len(members)))]
    # Without column i: with none of the others instead, or one.
    for i in range(len(members)):
        without_member = np.concatenate([used, np.delete(members, i)])
        nodes.append(SubtreeNode(without_member, outsiders, 1))
    return nodes
