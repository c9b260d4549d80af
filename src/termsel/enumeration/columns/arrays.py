"""Arrays for the enumeration of all subsets."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from termsel.measurements.features import FloatArray


class Levels(NamedTuple):
    """The vectors of f systems in lockstep at every depth; depth 0 is given, the rest is space.

    Column n, of infinite length and without a share, stands for no column.

    Parameters
    ----------
    top : ndarray, shape (depths, f, n + r, rows)
        Control rows, which span the inner products; columns, then targets.
    extra : ndarray, shape (depths, f, n + r, rows)
        Rows that take part. LINEAR: errors. RATIONAL: as many errors and denominators, these
        with a minus sign, -1 - denominator x. PRESS: such denominators of the control rows.
        RSS: none.
    square : ndarray, shape (depths, f, n + 1)
        Squared length of each column.
    share : ndarray, shape (depths, f, n + 1, r)
        Coefficient of each column in each target.
    floor : ndarray, shape (f, n + 1)
        A column whose squared length is at most this is dependent.
    leverage, cross : ndarray, shape (depths, rows)
        For PRESS: leverages of the rows, and their counterpart with the denominator.
    """

    top: FloatArray
    extra: FloatArray
    square: FloatArray
    share: FloatArray
    floor: FloatArray
    leverage: FloatArray
    cross: FloatArray


class Limits(NamedTuple):
    """Constants of a piece.

    Parameters
    ----------
    margin, tolerance : float
        Least denominator, least 1 - leverage.
    offset, slack : float
        Part of the score that no column can change, and rounding error of a residual sum of
        squares.
    size, room : int
        Size of the subset in use already, and most columns to add.
    """

    margin: float
    tolerance: float
    offset: float
    slack: float
    size: int
    room: int


class Records(NamedTuple):
    """Best subsets so far, and conditions on them.

    Parameters
    ----------
    best, masks : ndarray, shape (sizes,)
        Best score and mask of each size, updated in place. Of equal scores the smallest mask
        as a number is kept.
    bits : ndarray of uint64, shape (n + 1,)
        Mask of each column.
    some_of : ndarray of uint64, shape (1,)
        Columns of which a best subset has at least one; 0 for no such condition.
    parents : ndarray of uint64, shape (k,) or (0,)
        Mask of the columns that a best subset must have to have a column; none for no such
        condition.
    guard : ndarray, shape (n + 1, g)
        Minus the denominators at guard points, of columns and target.
    x, sums : ndarray, shape (depths,) and (g,)
        Space for coefficients and denominators.
    """

    best: FloatArray
    masks: Any
    bits: Any
    some_of: Any
    parents: Any
    guard: FloatArray
    x: FloatArray
    sums: FloatArray


class Space(NamedTuple):
    """Space for a bound of n columns and e rows of the score.

    Parameters
    ----------
    gram, triangle : ndarray, shape (n + 1, n + 1)
    rows : ndarray, shape (n + 1, e + 1)
    x : ndarray, shape (3, max(n, e) + 1)
    """

    gram: FloatArray
    triangle: FloatArray
    rows: FloatArray
    x: FloatArray


class Products(NamedTuple):
    """Inner products of few columns and the target, at every level of their elimination.

    Parameters
    ----------
    M : ndarray, shape (levels, n, n)
        Of the columns; only above the diagonal.
    own, f : ndarray, shape (levels, n)
        The diagonal, and the products with the target.
    total : ndarray, shape (levels,)
        Of the target with itself.
    """

    M: FloatArray
    own: FloatArray
    f: FloatArray
    total: FloatArray


class Blocks(NamedTuple):
    """What a block of subsets is decided from.

    Parameters
    ----------
    control, errors : Products
        In the control rows, and of the errors of the score.
    sums, whole : ndarray, shape (levels, n) and (levels,)
        Sums over the denominators' rows, with a minus sign for columns; for the target.
    inverse, a, u, row, weight : ndarray
        Inverse squared lengths before any elimination, (n,), and space: (n,) twice and
        (max(n, rows),) twice.
    share, cursor : ndarray, shape (levels,)
        Product of the shares of length that were left; columns in use.
    """

    control: Products
    errors: Products
    sums: FloatArray
    whole: FloatArray
    inverse: FloatArray
    a: FloatArray
    u: FloatArray
    row: FloatArray
    weight: FloatArray
    share: FloatArray
    cursor: Any


def levels_of(tops: list[FloatArray], extras: list[FloatArray], floor: FloatArray,
              leverage: FloatArray, cross: FloatArray, depths: int) -> Levels:
    """Return the vectors at depth 0, and room for the other depths."""
    n = floor.shape[1] - 1
    top, extra = (np.zeros((depths, len(blocks), blocks[0].shape[1], max(map(len, blocks))))
                  for blocks in (tops, extras))
    for room, blocks in ((top, tops), (extra, extras)):
        for f, block in enumerate(blocks):
            room[0, f, :, :len(block)] = block.T
    square = np.full((depths, *floor.shape), np.inf)
    square[0, :, :n] = (top[0, :, :n] ** 2).sum(axis=2)
    share = np.zeros((*square.shape, top.shape[2] - n))
    products = top[0, :, :n] @ top[0, :, n:].swapaxes(1, 2)
    np.divide(products, square[0, :, :n, None], out=share[0, :, :n],
              where=square[0, :, :n, None] > 0)
    grown = np.zeros((2, depths, len(leverage)))
    grown[:, 0] = leverage, cross
    return Levels(top, extra, square, share, floor, grown[0], grown[1])


def blocks_of(levels: int, n: int, e: int) -> Blocks:
    """Return space for blocks of n columns and e rows of the score."""
    def products() -> Products:
        own, f = np.empty((2, levels, n))
        return Products(np.empty((levels, n, n)), own, f, np.empty(levels))

    sums, whole = np.empty((levels, n)), np.empty(levels)
    inverse, a, u = np.empty((3, n))
    return Blocks(products(), products(), sums, whole, inverse, a, u, np.empty(max(n, e)),
                  np.empty(e), np.empty(levels), np.empty(levels, dtype=np.intp))
