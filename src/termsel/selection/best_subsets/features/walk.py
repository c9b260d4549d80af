"""Every selection of features, each of which has rows of a least-squares system.

The walk of `termsel.selection.best_subsets.features.kernels` scores a selection by its squared
errors at the check points, to rounding. It does not have the last word: what is within a margin of
the best of its size remains, and so does what is too badly conditioned to be scored; the caller
evaluates these.

Error of a score: with u = 1.1e-16 and the condition of N at most 1e5 where products begin to
be carried, h has an absolute error of about 1e5 k u and q of 1e10 k u, in units in which N is that
of the check points; y'y begins below 1e6 times the least possible squared error. That makes some
1e-5 of it. Rows only enter, so nothing grows from there. Of a score by Cholesky the relative
error is about k u times the condition, which is at most 1e9. `SQUARES_MARGIN` is above both.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from math import comb
from typing import Any

import numpy as np

from termsel.adjustment.compiled import is_compiled
from termsel.core.errors import TermselError
from termsel.data.features import BoolArray, FloatArray, IntArray
from termsel.selection.best_subsets.features.arrays import (
    EntrySpace,
    FeatureRows,
    RemainingSelections,
    SelectionLimits,
    WalkState,
)
from termsel.selection.best_subsets.features.kernels import enumerate_selections

_WORD = 64
_MASK_WORDS = 2  # of which a mask consists

MAX_WALK_FEATURES = _WORD * _MASK_WORDS
"""Features of a walk."""

SQUARES_MARGIN = 1e-4
"""Of squared errors: selections that much above the best of their size remain."""

_PIECE = 1 << 17  # selections walked between two checks for interruption: some milliseconds
_EVALUATED = 1 << 12  # the same, where each is evaluated
_MIN_SINGULAR_RATIO = 1e-6  # of the check points' singular values, for scores to be trusted


@dataclass(frozen=True, eq=False)
class RowSystem:
    """Rows of features and of check points for some unknowns."""

    design: FloatArray  # (m, k)
    target: FloatArray  # (m,)
    feature: IntArray  # (m,): of each row, ascending; -1 for rows that are in every selection
    # The errors of the check points are check_target - check_design x.
    check_design: FloatArray  # (c, k)
    check_target: FloatArray  # (c,)
    min_equations: int = 0  # fewest rows of features in a selection; 0 for as many as unknowns

    @property
    def determined(self) -> bool:
        """True if the check points alone determine the unknowns well."""
        if len(self.check_design) < self.check_design.shape[1]:
            return False
        values = np.linalg.svd(self.check_design, compute_uv=False)
        return bool(values[-1] > _MIN_SINGULAR_RATIO * values[0])


@dataclass(frozen=True, eq=False)
class Branch:
    """All selections that have the features `used` and any of the free ones from `first` on."""

    used: tuple[int, ...]
    first: int


@dataclass(frozen=True, eq=False)
class Selections:
    """All selections of least to most of n features; refused with more than 128 that are free."""

    n: int
    min_size: int
    max_size: int
    on: BoolArray  # (n,): features in every selection
    off: BoolArray  # (n,): features in none
    # Independent parts, whose squared errors add up. Without any, no selection is scored.
    systems: tuple[RowSystem, ...] = ()

    def __post_init__(self) -> None:
        """Raise TermselError for more free features than can be enumerated."""
        if len(self.free) > MAX_WALK_FEATURES:
            raise TermselError(f"the selections of {len(self.free)} features cannot be enumerated",
                               hint=f"Give at most {MAX_WALK_FEATURES}, fix some with --set "
                                    "force_on or force_off, or choose another solver, such as "
                                    "--solver ga.")

    @cached_property
    def free(self) -> IntArray:
        """Features that may be selected or not, shape (f,)."""
        return np.flatnonzero(~self.on & ~self.off)

    @property
    def root(self) -> Branch:
        """The branch with all selections."""
        return Branch((), 0)

    @property
    def largest(self) -> int:
        """Most selections of a branch that is walked at once."""
        return _PIECE if self.systems else _EVALUATED

    def count(self, branch: Branch) -> int:
        """Return the number of selections of a branch."""
        candidates = len(self.free) - branch.first
        used = int(self.on.sum()) + len(branch.used)
        smallest = max(self.min_size - used, 0)
        largest = min(self.max_size - used, candidates)
        return sum(comb(candidates, size) for size in range(smallest, largest + 1))

    def halves(self, branch: Branch) -> tuple[Branch, Branch]:
        """Return the selections without the first of the free features, and those with it."""
        return (Branch(branch.used, branch.first + 1),
                Branch((*branch.used, branch.first), branch.first + 1))

    @cached_property
    def floor(self) -> float:
        """Squared errors of the check points that no solution is below; 0 without systems."""
        return sum(system.floor for system in self._row_systems)

    @property
    def needs_compilation(self) -> bool:
        """True if the first walk will spend some seconds on compilation."""
        return bool(self.systems) and not is_compiled(enumerate_selections)

    def reach(self, squares: FloatArray) -> FloatArray:
        """Return limits of computed squared errors, of the shape of `squares`, raised by rounding.

        A selection whose computed square is above its limit certainly has more than `squares`.
        """
        rounding = 1e-13 * sum(float(system.check_target @ system.check_target)
                               for system in self.systems)
        return np.asarray(squares * (1.0 + SQUARES_MARGIN) + rounding)

    def walk(self, branch: Branch, limits: FloatArray) -> tuple[BoolArray, FloatArray]:
        """Return the selections of a branch whose squared errors may be within the limits, (r, n).

        The limits (n + 1,) are squared errors of the check points, for selections of 0 to n
        features. With the selections come their squared errors (r,), minus infinity where they are
        not known.
        """
        if not self.systems:
            selections = self._list_all_selections(branch)
            return selections, np.full(len(selections), -np.inf)
        size = self.count(branch)
        if not size:
            return np.zeros((0, self.n), dtype=bool), np.zeros(0)
        masks = np.empty((size, _MASK_WORDS), dtype=np.uint64)
        remaining = RemainingSelections(masks, np.empty(size))
        state, space = self._walk_state(branch)
        free = len(self.free)
        fixed = int(self.on.sum())
        # Limits of y'y alone, for the sizes that are possible with the features fixed.
        squares_of_sizes = (self.reach(limits) - self.floor)[fixed:fixed + free + 1]
        walk_limits = SelectionLimits(max(self.min_size - fixed, 0),
                                      min(self.max_size - fixed, free),
                                      np.ascontiguousarray(squares_of_sizes), self.floor)
        count = enumerate_selections(self._padded_rows, state, space, first=branch.first,
                                     size=len(branch.used),
                                     limits=walk_limits, remaining=remaining)
        selections = np.tile(self.on, (count, 1))
        in_mask = (remaining.masks[:count, None] & self._padded_rows.bits) != 0
        selections[:, self.free] = in_mask.any(axis=2)  # over the words of a mask
        return selections, remaining.scores[:count] + self.floor

    def _list_all_selections(self, branch: Branch) -> BoolArray:
        """Return masks (s, n) of all selections of a branch, where none is scored."""
        # Features that are fixed or in use count towards the sizes that are allowed.
        fixed = int(self.on.sum())
        used = len(branch.used)
        candidates = range(branch.first, len(self.free))
        smallest = max(self.min_size - fixed - used, 0)
        largest = min(self.max_size - fixed - used, len(candidates))
        members: list[tuple[int, ...]] = []
        for size in range(smallest, largest + 1):
            members += [(*branch.used, *added) for added in combinations(candidates, size)]
        selections = np.tile(self.on, (len(members), 1))
        for row, free in zip(selections, members, strict=True):
            row[self.free[list(free)]] = True
        return selections

    @cached_property
    def _row_systems(self) -> tuple[_InErrorUnits, ...]:
        """The systems in the unknowns whose square is the check points' error."""
        return tuple(_InErrorUnits.of(system, self.free, self.on) for system in self.systems)

    @cached_property
    def _padded_rows(self) -> FeatureRows:
        """The rows of all systems, made equally many and equally wide, as the kernels take them."""
        height = max(len(system.target) for system in self._row_systems)
        width = max(system.design.shape[1] for system in self._row_systems)
        design = np.zeros((len(self._row_systems), height, width))
        target = np.zeros((len(self._row_systems), height))
        # Parts of fewer rows or unknowns are filled up with zeros that nothing reads.
        for p, system in enumerate(self._row_systems):
            design[p, :len(system.target), :system.design.shape[1]] = system.design
            target[p, :len(system.target)] = system.target
        start = np.array([system.start for system in self._row_systems], dtype=np.intp)
        columns = np.array([system.design.shape[1] for system in self._row_systems], dtype=np.intp)
        min_equations = np.array([system.min_equations for system in self._row_systems],
                                 dtype=np.intp)
        single = (np.diff(start, axis=1) == 1).all(axis=1)
        return FeatureRows(design=design, target=target, start=start, columns=columns,
                           min_equations=min_equations, single=single,
                           bits=_feature_masks(len(self.free)))

    def _walk_state(self, branch: Branch) -> tuple[WalkState, EntrySpace]:
        """Return the state of a walk at its first selection, and the space that its kernel needs.

        The first selection has the features that `branch` has in use; depth 0 of the state holds
        its normal equations. All deeper levels are allocated here, as the kernel allocates nothing.
        Rows of systems with fewer terms are padded, so that one array holds several systems.
        """
        rows = self._padded_rows
        n_systems, height, width = rows.design.shape
        room = min(self.max_size - int(self.on.sum()), len(self.free)) - len(branch.used)
        depths = max(room, 0) + 1
        most_rows = int(np.diff(rows.start, axis=1).max(initial=1))
        per_system = depths, n_systems
        per_pair = (*per_system, height, height)
        per_row = (*per_system, height)
        mask = np.zeros((depths, _MASK_WORDS), dtype=np.uint64)
        mask[0] = np.bitwise_or.reduce(rows.bits[list(branch.used)], axis=0)
        state = WalkState(normal=np.zeros((*per_system, width, width)),
                          right=np.zeros((*per_system, width)),
                          equations=np.zeros(per_system, dtype=np.intp),
                          mask=mask, cursor=np.zeros(depths, dtype=np.intp),
                          status=np.zeros(depths, dtype=np.intp), h=np.empty(per_pair),
                          q=np.empty(per_pair), diagonal_h=np.empty(per_row),
                          diagonal_q=np.empty(per_row),
                          e=np.empty(per_row), g=np.empty(per_row), square=np.zeros(per_system))
        for p, system in enumerate(self._row_systems):
            k = system.design.shape[1]
            A, b = system.always
            for i in branch.used:
                feature_rows = slice(system.start[i], system.start[i + 1])
                A = np.concatenate([A, system.design[feature_rows]])
                b = np.concatenate([b, system.target[feature_rows]])
            # Normal equations of the first selection: rows of all, and of the features in use.
            state.normal[0, p, :k, :k] = A.T @ A
            state.right[0, p, :k] = A.T @ b
            state.equations[0, p] = system.of_features + len(b) - len(system.always[1])
        # Of space for one step nothing is kept for the next depth.
        of_part = (n_systems, width, width)
        of_feature = (most_rows, height)
        space = EntrySpace(factor=np.empty(of_part), inverse=np.empty(of_part),
                           y=np.empty((n_systems, width)), w=np.empty((height, width)),
                           rows=np.empty(of_feature), share=np.empty(of_feature),
                           half=np.empty(of_feature), e=np.empty(height), g=np.empty(height),
                           small_h=np.empty((most_rows, most_rows)),
                           small_q=np.empty((most_rows, most_rows)), small=np.empty((4, most_rows)),
                           totals=np.empty(len(self.free)))
        return state, space


@dataclass(frozen=True, eq=False)
class _InErrorUnits:
    """A system in the unknowns y, of which the check points' squared errors are floor + y'y."""

    design: FloatArray  # (m, k): rows of the free features
    target: FloatArray  # (m,)
    start: IntArray  # (f + 1,): where the rows of each begin
    always: tuple[FloatArray, FloatArray]  # (a, k) and (a,): rows of every selection
    of_features: int  # how many of these are of features
    min_equations: int  # fewest rows of features in a selection
    floor: float  # least squared errors of the check points

    @classmethod
    def of(cls, system: RowSystem, free: IntArray, on: BoolArray) -> _InErrorUnits:
        """Return a system in the unknowns y, whose squared length is that of the errors.

        With C = Q R of the check points and y = R x - Q'c, the errors are a constant part e0 and
        -Q y, orthogonal to each other. So the sum of their squares is |e0|^2 + |y|^2, whatever is
        selected. `free` (f,) are the features that may be selected, `on` (n,) marks those that
        always are.
        """
        k = system.design.shape[1]
        q, r = np.linalg.qr(system.check_design)
        explained = q.T @ system.check_target
        residuals = system.check_target - q @ explained
        design = np.linalg.solve(r.T, system.design.T).T
        target = system.target - design @ explained
        # A feature of many rows needs no more than there are unknowns.
        blocks = [_condense_rows(design[system.feature == i], target[system.feature == i], k)
                  for i in free]
        # Forced features are in every selection, as rows of none are.
        in_every_selection = (system.feature < 0) | np.isin(system.feature, np.flatnonzero(on))
        heights = [len(b) for _, b in blocks]
        # As many equations as unknowns, where nothing else is asked; rows of no feature count.
        min_equations = system.min_equations or k - int((system.feature < 0).sum())
        return cls(design=np.concatenate([np.zeros((0, k)), *(A for A, _ in blocks)]),
                   target=np.concatenate([np.zeros(0), *(b for _, b in blocks)]),
                   start=np.concatenate([[0], np.cumsum(heights)]).astype(np.intp),
                   always=(design[in_every_selection], target[in_every_selection]),
                   of_features=int((system.feature[in_every_selection] >= 0).sum()),
                   min_equations=min_equations, floor=float(residuals @ residuals))


def _feature_masks(n: int) -> Any:
    """Return the mask of each of n features, ndarray of uint64, shape (n, words)."""
    bits = np.zeros((n, _MASK_WORDS), dtype=np.uint64)
    features = np.arange(n)
    bits[features, features // _WORD] = np.uint64(1) << (features % _WORD).astype(np.uint64)
    return bits


def _condense_rows(A: FloatArray, b: FloatArray, k: int) -> tuple[FloatArray, FloatArray]:
    """Return at most k rows with the same normal equations as A and b: R and Q'b, with A = Q R."""
    if len(b) <= k:
        return A, b
    q, r = np.linalg.qr(A)
    return r, q.T @ b

