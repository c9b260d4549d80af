"""A least-squares system whose columns are to be selected, prepared for the enumeration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import comb

import numpy as np
from numpy.typing import NDArray

from termsel.core.errors import TermselError
from termsel.data.features import BoolArray, FloatArray, IntArray

SCORES = ("check", "rss", "press", "kfold")
MAX_COLUMNS = 62

Masks = NDArray[np.uint64]

# Bit j of a mask is column j.
BITS: Masks = np.uint64(1) << np.arange(MAX_COLUMNS, dtype=np.uint64)


@dataclass(frozen=True, eq=False)
class SubsetSystem:
    """A least-squares system whose columns are to be selected.

    The error is (target - design x) / (1 + denominator x), or its numerator without a denominator.
    A quotient n a / (1 + d b) = l that was multiplied out has the rows design = [n, -l d], target =
    l, denominator = [0, d].

    Parameters
    ----------
    design : ndarray, shape (m, k)
        Rows of control; k is at most 62.
    target : ndarray, shape (m, r)
        One column, or two (line and sample) that share the selection.
    check_design, check_target : ndarray, shapes (c, k) and (c, r), optional
        The same at check points.
    denominator, check_denominator : ndarray, shapes (m, k) and (c, k), optional
        Linear forms of the denominator, for r = 1.
    guard_denominator : ndarray, shape (g, k), optional
        At further ground points; tested only if a subset would become the best of its size.
    margin : float
        A subset with a denominator below this is infeasible.
    forced, forbidden : ndarray of bool, shape (k,), optional
        Columns in every subset, and in none.
    some_of : ndarray of bool, shape (k,), optional
        A best subset has at least one of these columns.
    parents : ndarray of bool, shape (k, k), optional
        A best subset has column i only if it has all columns j with ``parents[i, j]``.

    Raises
    ------
    TermselError
        For more than 62 columns.
    ValueError
        For arrays whose shapes do not fit or whose values are not finite.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> rng = np.random.default_rng(1)
    >>> design = rng.normal(size=(20, 6))
    >>> system = termsel.SubsetSystem(design, design[:, :2].sum(axis=1, keepdims=True))
    >>> system.design.shape
    (20, 6)
    """

    design: FloatArray
    target: FloatArray
    check_design: FloatArray | None = None
    check_target: FloatArray | None = None
    denominator: FloatArray | None = None
    check_denominator: FloatArray | None = None
    guard_denominator: FloatArray | None = None
    margin: float = 0.1
    forced: BoolArray | None = None
    forbidden: BoolArray | None = None
    some_of: BoolArray | None = None
    parents: BoolArray | None = None

    def __post_init__(self) -> None:
        """Check shapes and values; raises TermselError and ValueError as the class says."""
        m, k = self.design.shape
        r = self.target.shape[1]
        c = 0 if self.check_design is None else len(self.check_design)
        g = 0 if self.guard_denominator is None else len(self.guard_denominator)
        if k > MAX_COLUMNS:
            raise TermselError(f"subsets of {k} terms cannot be enumerated",
                               hint=f"Allow at most {MAX_COLUMNS}, or search with a heuristic.")
        # Rows of m control equations, c check equations and g guard points; k columns, r targets.
        for name, shape in (
            ("target", (m, r)), ("check_design", (c, k)), ("check_target", (c, r)),
            ("denominator", (m, k)), ("check_denominator", (c, k)),
            ("guard_denominator", (g, k)), ("forced", (k,)), ("forbidden", (k,)),
            ("some_of", (k,)), ("parents", (k, k)),
        ):
            array = getattr(self, name)
            if array is not None and array.shape != shape:
                raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
            if array is not None and not np.isfinite(array).all():
                raise ValueError(f"{name} is not finite")
            if r != 1 and array is not None and name.endswith("denominator"):
                raise ValueError(f"{name} requires a single right-hand side")
        if (self.check_design is None) != (self.check_target is None):
            raise ValueError("check_design and check_target must be given together")
        if not np.isfinite(self.design).all():
            raise ValueError("design is not finite")


def count_subsets(columns: int, max_terms: int | None = None) -> int:
    """Return the number of subsets of a number of columns, with at most `max_terms` members."""
    max_size = columns if max_terms is None else min(columns, max_terms)
    return sum(comb(columns, size) for size in range(max_size + 1))


@dataclass(frozen=True, eq=False)
class SubtreeNode:
    """Subsets that are decided together."""

    used: IntArray  # columns that all of them hold
    candidates: IntArray  # columns that they may hold, in the order of the tree
    room: int  # how many of these at most
    lower_bound: float = 0.0  # none that is still to be decided scores less

    def halves(self) -> list[SubtreeNode]:
        """Return the subsets without the first candidate, and those with it."""
        first = self.candidates[:1]
        later = self.candidates[1:]
        # The bound of a node holds for all its subsets, and so for each half.
        return [SubtreeNode(self.used, later, self.room, self.lower_bound),
                SubtreeNode(np.concatenate([self.used, first]), later, self.room - 1,
                            self.lower_bound)]

    @cached_property
    def count(self) -> int:
        """Number of subsets; 0 if the room is negative."""
        return count_subsets(len(self.candidates), self.room)


@dataclass(frozen=True, eq=False)
class NodeResult:
    """Result of a node, as in `SubsetResult`."""

    best: FloatArray
    masks: Masks
    pruned: int


def better_of_each_size(best: FloatArray, masks: Masks, other_best: FloatArray,
                        other_masks: Masks) -> tuple[FloatArray, Masks]:
    """Return the better subset of each size: its score and its mask, both (k + 1,).

    Of equal scores it is the smallest mask.
    """
    # The order of nodes must not matter, so that ties have to be broken by the subset itself.
    wins = (other_best < best) | ((other_best == best) & (other_masks < masks))
    return np.where(wins, other_best, best), np.where(wins, other_masks, masks)
