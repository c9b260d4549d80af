"""Every selection of features, each of which has rows of a least-squares system.

The walk of `termsel.enumeration.features.kernels` scores a selection by its squared errors at the
check points, to rounding. It does not have the last word: what is within a margin of the best of
its size remains, and so does what is too badly conditioned to be scored; the caller evaluates
these.

Error of a score: with u = 1.1e-16 and the condition of N at most 1e5 where products begin to
be carried, h has an absolute error of about 1e5 k u and q of 1e10 k u, in units in which N is that
of the check points; y'y begins below 1e6 times the least possible squared error. That makes some
1e-5 of it. Rows only enter, so nothing grows from there. Of a score by Cholesky the relative
error is about k u times the condition, which is at most 1e9. `MARGIN` is above both.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import comb
from typing import Any

import numpy as np

from termsel.adjustment.compiled import is_compiled
from termsel.enumeration.features.arrays import Carried, EntrySpace, FeatureRows, Kept, Wanted
from termsel.enumeration.features.kernels import walk
from termsel.errors import TermselError
from termsel.measurements.features import BoolArray, FloatArray, IntArray

_WORD = 64
_WORDS = 2  # of which a mask consists

MOST = _WORD * _WORDS
"""Features of a walk."""

MARGIN = 1e-4
"""Of squared errors: selections that much above the best of their size remain."""

_PIECE = 1 << 17  # selections walked between two checks for interruption: some milliseconds
_EVALUATED = 1 << 12  # the same, where each is evaluated
_DETERMINED = 1e-6  # least ratio of the check points' singular values for scores to be trusted


@dataclass(frozen=True, eq=False)
class RowSystem:
    """Rows of features and of check points for some unknowns."""

    design: FloatArray  # (m, k)
    target: FloatArray  # (m,)
    feature: IntArray  # (m,): of each row, ascending; -1 for rows that are in every selection
    # The errors of the check points are check_target - check_design x.
    check_design: FloatArray  # (c, k)
    check_target: FloatArray  # (c,)
    needed: int = 0  # fewest rows of features in a selection; 0 for as many as unknowns

    @property
    def determined(self) -> bool:
        """True if the check points alone determine the unknowns well."""
        if len(self.check_design) < self.check_design.shape[1]:
            return False
        values = np.linalg.svd(self.check_design, compute_uv=False)
        return bool(values[-1] > _DETERMINED * values[0])


@dataclass(frozen=True, eq=False)
class Branch:
    """All selections that have the features `used` and any of the free ones from `first` on."""

    used: tuple[int, ...]
    first: int


@dataclass(frozen=True, eq=False)
class Selections:
    """All selections of least to most of n features; refused with more than 128 that are free."""

    n: int
    least: int
    most: int
    on: BoolArray  # (n,): features in every selection
    off: BoolArray  # (n,): features in none
    # Independent parts, whose squared errors add up. Without any, no selection is scored.
    systems: tuple[RowSystem, ...] = ()

    def __post_init__(self) -> None:
        if len(self.free) > MOST:
            raise TermselError(f"the selections of {len(self.free)} features cannot be enumerated",
                               hint=f"Give at most {MOST}, fix some with --set force_on or "
                                    "force_off, or choose another solver, such as --solver ga.")

    @cached_property
    def free(self) -> IntArray:
        """Features that may be selected or not, shape (f,)."""
        return np.flatnonzero(~self.on & ~self.off)

    @property
    def root(self) -> Branch:
        """Everything."""
        return Branch((), 0)

    @property
    def largest(self) -> int:
        """Most selections of a branch that is walked at once."""
        return _PIECE if self.systems else _EVALUATED

    def count(self, branch: Branch) -> int:
        """Return the number of selections of a branch."""
        rest, chosen = len(self.free) - branch.first, int(self.on.sum()) + len(branch.used)
        return sum(comb(rest, size) for size in range(max(self.least - chosen, 0),
                                                      min(self.most - chosen, rest) + 1))

    def halves(self, branch: Branch) -> tuple[Branch, Branch]:
        """Return the selections without the first of the free features, and those with it."""
        return (Branch(branch.used, branch.first + 1),
                Branch((*branch.used, branch.first), branch.first + 1))

    @cached_property
    def floor(self) -> float:
        """Squared errors of the check points that no solution is below; 0 without systems."""
        return sum(part.least for part in self._parts)

    @property
    def needs_compilation(self) -> bool:
        """True if the first walk will spend some seconds on compilation."""
        return bool(self.systems) and not is_compiled(walk)

    def reach(self, squares: FloatArray) -> FloatArray:
        """Return the scores up to which squared errors may be below these, given rounding."""
        rounding = 1e-13 * sum(float(system.check_target @ system.check_target)
                               for system in self.systems)
        return np.asarray(squares * (1.0 + MARGIN) + rounding)

    def walk(self, branch: Branch, limits: FloatArray) -> tuple[BoolArray, FloatArray]:
        """Return the selections of a branch that may have at most so large squared errors, (r, n).

        The limits (n + 1,) are squared errors of the check points, for selections of 0 to n
        features. With the selections come their squared errors (r,); minus infinity where they are
        not known.
        """
        if not self.systems:
            chosen = self._every(branch)
            return chosen, np.full(len(chosen), -np.inf)
        size = self.count(branch)
        if not size:
            return np.zeros((0, self.n), dtype=bool), np.zeros(0)
        kept = Kept(np.empty((size, _WORDS), dtype=np.uint64), np.empty(size))
        carried, space = self._carried(branch)
        free, fixed = len(self.free), int(self.on.sum())
        of_free = (self.reach(limits) - self.floor)[fixed:fixed + free + 1]
        wanted = Wanted(max(self.least - fixed, 0), min(self.most - fixed, free),
                        np.ascontiguousarray(of_free), self.floor)
        count = walk(self._rows, carried, space, branch.first, len(branch.used), wanted, kept)
        chosen = np.tile(self.on, (count, 1))
        chosen[:, self.free] = (kept.masks[:count, None] & self._rows.bits != 0).any(axis=2)
        return chosen, kept.scores[:count] + self.floor

    def _every(self, branch: Branch) -> BoolArray:
        fixed, used = int(self.on.sum()), len(branch.used)
        rest = range(branch.first, len(self.free))
        members = [(*branch.used, *more)
                   for size in range(max(self.least - fixed - used, 0),
                                     min(self.most - fixed - used, len(rest)) + 1)
                   for more in combinations(rest, size)]
        chosen = np.tile(self.on, (len(members), 1))
        for row, free in zip(chosen, members, strict=True):
            row[self.free[list(free)]] = True
        return chosen

    @cached_property
    def _parts(self) -> tuple[_InErrorUnits, ...]:
        return tuple(_InErrorUnits.of(system, self.free, self.on) for system in self.systems)

    @cached_property
    def _rows(self) -> FeatureRows:
        height = max(len(part.target) for part in self._parts)
        width = max(part.design.shape[1] for part in self._parts)
        design = np.zeros((len(self._parts), height, width))
        target = np.zeros((len(self._parts), height))
        # Parts of fewer rows or unknowns are filled up with zeros that nothing reads.
        for p, part in enumerate(self._parts):
            design[p, :len(part.target), :part.design.shape[1]] = part.design
            target[p, :len(part.target)] = part.target
        start = np.array([part.start for part in self._parts], dtype=np.intp)
        return FeatureRows(design, target, start,
                    np.array([part.design.shape[1] for part in self._parts], dtype=np.intp),
                    np.array([part.needed for part in self._parts], dtype=np.intp),
                    (np.diff(start, axis=1) == 1).all(axis=1),
                    _bits(len(self.free)))

    def _carried(self, branch: Branch) -> tuple[Carried, EntrySpace]:
        """Return the arrays of a walk, with the normal equations of its first selection."""
        rows = self._rows
        parts, height, width = rows.design.shape
        depths = max(min(self.most - int(self.on.sum()), len(self.free)) - len(branch.used), 0) + 1
        wide = int(np.diff(rows.start, axis=1).max(initial=1))
        shape = depths, parts
        square, flat = (*shape, height, height), (*shape, height)
        mask = np.zeros((depths, _WORDS), dtype=np.uint64)
        mask[0] = np.bitwise_or.reduce(rows.bits[list(branch.used)], axis=0)
        carried = Carried(np.zeros((*shape, width, width)), np.zeros((*shape, width)),
                          np.zeros(shape, dtype=np.intp), mask, np.zeros(depths, dtype=np.intp),
                          np.zeros(depths, dtype=np.intp), np.empty(square), np.empty(square),
                          np.empty(flat), np.empty(flat), np.empty(flat), np.empty(flat),
                          np.zeros(shape))
        for p, part in enumerate(self._parts):
            k = part.design.shape[1]
            A, b = part.always
            for i in branch.used:
                here = slice(part.start[i], part.start[i + 1])
                A = np.concatenate([A, part.design[here]])
                b = np.concatenate([b, part.target[here]])
            carried.normal[0, p, :k, :k], carried.right[0, p, :k] = A.T @ A, A.T @ b
            carried.equations[0, p] = part.of_features + len(b) - len(part.always[1])
        of_part, of_feature = (parts, width, width), (wide, height)
        space = EntrySpace(np.empty(of_part), np.empty(of_part), np.empty((parts, width)),
                           np.empty((height, width)), np.empty(of_feature), np.empty(of_feature),
                           np.empty(of_feature), np.empty(height), np.empty(height),
                           np.empty((wide, wide)), np.empty((wide, wide)), np.empty((4, wide)),
                           np.empty(len(self.free)))
        return carried, space


@dataclass(frozen=True, eq=False)
class _InErrorUnits:
    """A system in the unknowns y, of which the check points' squared errors are least + y'y."""

    design: FloatArray  # (m, k): rows of the free features
    target: FloatArray  # (m,)
    start: IntArray  # (f + 1,): where the rows of each begin
    always: tuple[FloatArray, FloatArray]  # (a, k) and (a,): rows of every selection
    of_features: int  # how many of these are of features
    needed: int  # fewest rows of features in a selection
    least: float

    @classmethod
    def of(cls, system: RowSystem, free: IntArray, on: BoolArray) -> _InErrorUnits:
        k = system.design.shape[1]
        # With C = Q R of the check points and y = R x - Q'c, errors are a constant part and -Q y.
        q, r = np.linalg.qr(system.check_design)
        along = q.T @ system.check_target
        rest = system.check_target - q @ along
        design = np.linalg.solve(r.T, system.design.T).T
        target = system.target - design @ along
        # A feature of many rows needs no more than there are unknowns.
        blocks = [_condensed(design[system.feature == i], target[system.feature == i], k)
                  for i in free]
        # Forced features are in every selection, as rows of none are.
        kept = (system.feature < 0) | np.isin(system.feature, np.flatnonzero(on))
        heights = [len(b) for _, b in blocks]
        return cls(np.concatenate([np.zeros((0, k)), *(A for A, _ in blocks)]),
                   np.concatenate([np.zeros(0), *(b for _, b in blocks)]),
                   np.concatenate([[0], np.cumsum(heights)]).astype(np.intp),
                   (design[kept], target[kept]), int((system.feature[kept] >= 0).sum()),
                   system.needed or k - int((system.feature < 0).sum()), float(rest @ rest))


def _bits(n: int) -> Any:
    """Return the mask of each of n features, ndarray of uint64, shape (n, words)."""
    bits = np.zeros((n, _WORDS), dtype=np.uint64)
    each = np.arange(n)
    bits[each, each // _WORD] = np.uint64(1) << (each % _WORD).astype(np.uint64)
    return bits


def _condensed(A: FloatArray, b: FloatArray, k: int) -> tuple[FloatArray, FloatArray]:
    """Return at most k rows with the same normal equations."""
    if len(b) <= k:
        return A, b
    q, r = np.linalg.qr(A)
    return r, q.T @ b

