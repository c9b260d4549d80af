"""Arrays for the branch and bound of residual sums of squares."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from termsel.adjustment.solve import TOLERANCE
from termsel.measurements.features import FloatArray

DEPENDENT = 1e-7  # part of its length that a column keeps, below which weights are left at zero
ROUNDING = 1e-6  # of bounds, relative; they are accurate to 1e-16 / DEPENDENT
_POINTS = 12  # guard points with a weight at once, at most


class Tree(NamedTuple):
    """The branch and bound of residual sums of squares, at every depth.

    Parameters
    ----------
    triangle, target : ndarray, shape (depths, k, k) and (depths, r, k)
        Triangular factor R of the columns left, of length 1 at depth 0, and Q'y.
    rss : ndarray, shape (depths,)
        Residuals of all columns left.
    column, fixed : ndarray of int and bool, shape (depths, k)
        The columns left, and whether they are in use for good.
    state : ndarray of int, shape (depths, 5)
        Number of columns left, and in use; next child, largest open size; number of guard points
        with a weight, -1 for dependent columns.
    point, weight : ndarray, shape (depths, a)
        Those guard points and weights.
    order, bound, ceiling : ndarray, shape (depths, k + 1)
        Columns not in use, the highest bound without one of them first; the largest score of
        interest of each size and above.
    guard, least : ndarray, shape (k, g) and (g,)
        G' and h.
    floor, floors : ndarray, shape (1,) and (1, k + 1)
        A column whose squared length is at most this is dependent.
    W, square, shifted, b, below, inverse, work, eliminated, last, cursor, mask : ndarray
        Space: (a, k), (a,), (k,), (k,), (g,), (k, k), (k + r, k + 1), (k + 1, g), (r,), and of
        integers (k + 1,) and of uint64 (k + 1,).
    """

    triangle: FloatArray
    target: FloatArray
    rss: FloatArray
    column: Any
    fixed: Any
    state: Any
    point: Any
    weight: FloatArray
    order: Any
    bound: FloatArray
    ceiling: FloatArray
    guard: FloatArray
    least: FloatArray
    floor: FloatArray
    floors: FloatArray
    W: FloatArray
    square: FloatArray
    shifted: FloatArray
    b: FloatArray
    below: FloatArray
    inverse: FloatArray
    work: FloatArray
    eliminated: FloatArray
    last: FloatArray
    cursor: Any
    mask: Any


def tree_of(control: FloatArray, guard: FloatArray, lengths: FloatArray, margin: float,
            used: int) -> tuple[Tree, FloatArray]:
    """Return a tree at its root, and the guard's denominators of its columns.

    Parameters
    ----------
    control : ndarray, shape (m, k + r)
        Columns and targets.
    guard : ndarray, shape (g, k + 1)
        Denominators at guard points, of the columns, and minus what they are without any.
    lengths : ndarray, shape (k,)
        Of the columns, which are made 1.
    margin : float
        Least denominator.
    used : int
        How many columns, the first ones, are in use for good.
    """
    k, g = guard.shape[1] - 1, len(guard)
    r, depths = control.shape[1] - k, k + 1
    lengths = np.append(np.where(lengths > 0.0, lengths, 1.0), np.ones(r))
    guard = np.ascontiguousarray((guard / lengths[:k + 1]).T)
    factor, triangle = np.linalg.qr(control / lengths, mode="r"), np.zeros((k + r, k + r))
    triangle[:len(factor)] = factor
    R, target = np.zeros((depths, k, k)), np.zeros((depths, r, k))
    R[0], target[0] = triangle[:k, :k], triangle[:k, k:].T
    rss = np.full(depths, (triangle[k:, k:] ** 2).sum())
    state = np.zeros((depths, 5), dtype=np.intp)
    column, fixed = np.tile(np.arange(k), (depths, 1)), np.tile(np.arange(k) < used, (depths, 1))
    state[0, :2] = k, used
    floors = np.full((1, k + 1), TOLERANCE**2)
    least = margin + guard[k]
    least -= ROUNDING * (1.0 + abs(least))  # those that a rounding error keeps out may pass
    point, order = (np.zeros((depths, n), dtype=np.intp) for n in (_POINTS, k + 1))
    bound, ceiling = np.zeros((2, depths, k + 1))
    shifted, b = np.zeros((2, k))
    tree = Tree(
        R, target, rss, column, fixed, state, point, np.zeros((depths, _POINTS)), order, bound,
        ceiling, guard[:k].copy(), least, floors[0, :1], floors, np.zeros((_POINTS, k)),
        np.zeros(_POINTS), shifted, b, np.zeros(g), np.zeros((k, k)), np.zeros((k + r, k + 1)),
        np.zeros((k + 1, g)), np.zeros(r), np.zeros(k + 1, dtype=np.intp),
        np.zeros(k + 1, dtype=np.uint64))
    return tree, guard
