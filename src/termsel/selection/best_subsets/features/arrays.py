"""Arrays for the walk over all selections of features."""

from __future__ import annotations

from typing import Any, NamedTuple

from termsel.data.features import FloatArray, IntArray


class FeatureRows(NamedTuple):
    """The rows of n features in each of several independent parts."""

    design: FloatArray  # (parts, rows, k)
    target: FloatArray  # (parts, rows)
    start: IntArray  # (parts, n + 1): where the rows of each feature begin
    columns: IntArray  # (parts,): unknowns of each part
    min_equations: IntArray  # (parts,): fewest equations of a selection
    single: Any  # (parts,) of bool: whether each feature has one row
    bits: Any  # (n, words) of uint64: mask of each feature


class WalkState(NamedTuple):
    """What is known of the selection at every depth; `normal` to `mask` are filled in at depth 0.

    Of h, q, e and g see `termsel.selection.best_subsets.features.kernels`.
    """

    normal: FloatArray  # (depths, parts, k, k): normal matrix, its lower triangle
    right: FloatArray  # (depths, parts, k)
    equations: IntArray  # (depths, parts): how many of features
    mask: Any  # (depths, words) of uint64
    cursor: IntArray  # (depths,): the feature that enters next
    status: IntArray  # (depths,): OPEN, UNKNOWN, SCORED or CARRIED
    h: FloatArray  # (depths, parts, rows, rows): upper triangle
    q: FloatArray  # (depths, parts, rows, rows): upper triangle
    diagonal_h: FloatArray  # (depths, parts, rows): the diagonal of h
    diagonal_q: FloatArray  # (depths, parts, rows): the diagonal of q
    e: FloatArray  # (depths, parts, rows): misfits
    g: FloatArray  # (depths, parts, rows)
    square: FloatArray  # (depths, parts): y'y


class SelectionLimits(NamedTuple):
    """Which selections remain."""

    min_size: int  # features of a selection
    max_size: int
    squares: FloatArray  # (n + 1,): y'y up to which selections of each size remain
    floor: float  # squared errors that no selection is below


class RemainingSelections(NamedTuple):
    """Selections that remain, with y'y; minus infinity where that is not known."""

    masks: Any  # (selections, words) of uint64
    scores: FloatArray  # (selections,)


class EntrySpace(NamedTuple):
    """Space for a feature that enters."""

    factor: FloatArray  # (parts, k, k)
    inverse: FloatArray  # (parts, k, k)
    y: FloatArray  # (parts, k)
    w: FloatArray  # (rows, k)
    rows: FloatArray  # (most rows of a feature, rows): products h of its rows
    share: FloatArray  # the same over 1 + h
    half: FloatArray  # the same shape: q less half of its change
    e: FloatArray  # (rows,)
    g: FloatArray  # (rows,)
    small_h: FloatArray  # (most rows of a feature, most rows of a feature)
    small_q: FloatArray
    small: FloatArray  # (4, most rows of a feature)
    totals: FloatArray  # (n,): y'y with each feature as the next
