"""Arrays for the enumeration of all subsets of columns."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from termsel.data.features import FloatArray


class Vectors(NamedTuple):
    """The vectors of f systems in lockstep at every depth; depth 0 is filled in, the rest is space.

    Of each system there are n columns, then r targets. Column n of `square` and `share`, of
    infinite length and without a share, stands for no column.
    """

    top: FloatArray  # (depths, f, n + r, rows): control rows, which span the inner products
    # (depths, f, n + r, rows): rows that take part. LINEAR: errors. RATIONAL: as many errors and
    # denominators, these with a minus sign, -1 - denominator x. PRESS: such denominators of the
    # control rows. RSS: none.
    extra: FloatArray
    square: FloatArray  # (depths, f, n + 1): squared length of each column
    share: FloatArray  # (depths, f, n + 1, r): coefficient of each column in each target
    floor: FloatArray  # (f, n + 1): a column whose squared length is at most this is dependent
    leverage: FloatArray  # (depths, rows): for PRESS, of the rows under the columns in use
    cross: FloatArray  # (depths, rows): for PRESS, its counterpart with the denominator


class Depth(NamedTuple):
    """One depth of `Vectors`."""

    top: FloatArray
    extra: FloatArray
    square: FloatArray
    share: FloatArray
    leverage: FloatArray
    cross: FloatArray


class Limits(NamedTuple):
    """Constants of a node."""

    margin: float  # least denominator
    tolerance: float  # least 1 - leverage
    offset: float  # part of the score that no column can change
    slack: float  # rounding error of a residual sum of squares
    size: int  # of the subset in use already
    room: int  # most columns to add


class WalkPosition(NamedTuple):
    """Where a walk over the tree is; `mask[0]` and `counts` are filled in, the rest is space."""

    cursor: Any  # (depths,) of int: the column at each depth, the next to join
    ends: Any  # (depths,) of int: bounds have closed the columns from here on
    mask: Any  # (depths,) of uint64: columns in use at each depth
    counts: Any  # (n + 1, room + 1) of int: subsets of so many columns, of at most so many members


class Records(NamedTuple):
    """Best subsets so far, and conditions on them."""

    best: FloatArray  # (sizes,): least score of each size, updated in place
    masks: Any  # (sizes,) of uint64: its subset; of equal scores the smallest number
    bits: Any  # (n + 1,) of uint64: mask of each column
    some_of: Any  # (1,) of uint64: a best subset has one of these columns; 0 for no such condition
    parents: Any  # (k,) or (0,) of uint64: columns that a best subset must have to have a column
    guard: FloatArray  # (n + 1, g): minus the denominators at guard points, of columns and target
    x: FloatArray  # (depths,): space for coefficients
    sums: FloatArray  # (g,): space for denominators


class Products(NamedTuple):
    """Inner products of few columns and the target, at every level of their elimination."""

    M: FloatArray  # (levels, n, n): of the columns; only above the diagonal
    diagonal: FloatArray  # (levels, n): of each column with itself
    f: FloatArray  # (levels, n): of the columns with the target
    total: FloatArray  # (levels,): of the target with itself


class SubsetBlock(NamedTuple):
    """What a block of subsets is decided from, n columns at most."""

    control: Products  # in the control rows
    errors: Products  # of the errors of the score
    sums: FloatArray  # (levels, n): minus the sums of a column over the denominators' rows
    target_sum: FloatArray  # (levels,): the same of the target: of the denominators themselves
    inverse: FloatArray  # (n,): inverse squared lengths before any elimination; 0 if dependent
    a: FloatArray  # (n,): space for shares of a column
    u: FloatArray  # (n,): space for products less a share
    row: FloatArray  # (max(n, rows),): space for one row of products, or of figures to compare
    weight: FloatArray  # (rows,): of the errors
    share: FloatArray  # (levels,): product of the shares of length that were left
    cursor: Any  # (levels,) of int: columns in use


class BoundSpace(NamedTuple):
    """Space for one bound of errors in e rows of the score, n columns at most."""

    gram: FloatArray  # (n + 1, n + 1): products in the control rows
    triangle: FloatArray  # (n + 1, n + 1): Cholesky's of the quadratic form
    rows: FloatArray  # (n + 1, e + 1): denominators, and t, in the basis of the triangle
    x: FloatArray  # (3, max(n, e) + 1)


class CheckSpace(NamedTuple):
    """Space for a walk by the errors in e rows of the score."""

    upper: FloatArray  # (depths, e + 1): U and tau of `bounds.closed`; filled in at depth 0
    bound: BoundSpace
    block: SubsetBlock


def vectors_of(tops: list[FloatArray], extras: list[FloatArray], floor: FloatArray,
               leverage: FloatArray, cross: FloatArray, depths: int) -> Vectors:
    """Return the vectors at depth 0, and room for the other depths.

    Of each of f systems `tops` (m, n + r) have the columns and targets in the control, `extras`
    those in the score. `floor` (f, n + 1) are the lengths below which a column counts as dependent,
    `leverage` and `cross` (m,) what columns in every subset add. Nothing is allocated while subsets
    are walked.
    """
    n = floor.shape[1] - 1
    # Systems of fewer rows are filled up with zeros, which change no inner product.
    top, extra = (np.zeros((depths, len(blocks), blocks[0].shape[1], max(map(len, blocks))))
                  for blocks in (tops, extras))
    # Rows become the last axis: the kernels run along it.
    for space, blocks in ((top, tops), (extra, extras)):
        for f, block in enumerate(blocks):
            space[0, f, :, :len(block)] = block.T
    square = np.full((depths, *floor.shape), np.inf)
    # Column n is none: of infinite length, its coefficient and its share are 0.
    square[0, :, :n] = (top[0, :, :n] ** 2).sum(axis=2)
    share = np.zeros((*square.shape, top.shape[2] - n))
    products = top[0, :, :n] @ top[0, :, n:].swapaxes(1, 2)
    # Column lengths may be 0: such a column has no share, and is dependent anyway.
    np.divide(products, square[0, :, :n, None], out=share[0, :, :n],
              where=square[0, :, :n, None] > 0)
    leverages = np.zeros((2, depths, len(leverage)))
    leverages[:, 0] = leverage, cross
    return Vectors(top=top, extra=extra, square=square, share=share, floor=floor,
                   leverage=leverages[0], cross=leverages[1])


def position_of(depths: int, used: np.uint64, counts: Any) -> WalkPosition:
    """Return the beginning of a walk from the columns in use."""
    cursor, ends = np.zeros((2, depths), dtype=np.intp)
    mask = np.zeros(depths, dtype=np.uint64)
    mask[0] = used
    return WalkPosition(cursor, ends, mask, counts)


def allocate_check_space(depths: int, n: int, largest: FloatArray) -> CheckSpace:
    """Return the arrays that a walk by check errors writes into, so that no step makes new ones.

    Parameters
    ----------
    depths : int
        Depths of the walk.
    n : int
        Columns at most.
    largest : ndarray, shape (e + 1,)
        U and tau of `bounds.closed` at depth 0, for e rows of the score. The rest is left
        unwritten.
    """
    e = len(largest) - 1

    def products() -> Products:
        diagonal, f = np.empty((2, depths, n))
        return Products(np.empty((depths, n, n)), diagonal, f, np.empty(depths))

    sums = np.empty((depths, n))
    target_sum = np.empty(depths)
    inverse, a, u = np.empty((3, n))
    block = SubsetBlock(control=products(), errors=products(), sums=sums, target_sum=target_sum,
                        inverse=inverse, a=a, u=u, row=np.empty(max(n, e)), weight=np.empty(e),
                        share=np.empty(depths), cursor=np.empty(depths, dtype=np.intp))
    gram, triangle = np.empty((2, n + 1, n + 1))
    upper = np.ones((depths, e + 1))
    upper[0] = largest
    bound = BoundSpace(gram, triangle, np.empty((n + 1, e + 1)), np.empty((3, max(n, e) + 1)))
    return CheckSpace(upper, bound, block)
