"""Arrays for the branch and bound of residual sums of squares, and Gram-Schmidt on their rows."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from termsel.adjustment.compiled import compile_lazily
from termsel.adjustment.solve import TOLERANCE
from termsel.data.features import FloatArray

_compiled = partial(compile_lazily, fastmath={"reassoc", "contract", "arcp", "nsz"})

DEPENDENT = 1e-7  # part of its length that a column keeps, below which weights are left at zero
BOUND_ROUNDING = 1e-6  # of bounds, relative; they are accurate to 1e-16 / DEPENDENT
_POINTS = 12  # guard points with a weight at once, at most


class Tree(NamedTuple):
    """The branch and bound of residual sums of squares, at every depth."""

    # Filled in at depth 0. Of a child at depth + 1 `bounds.residuals` writes them.
    triangle: FloatArray  # (depths, k, k): factor R of the columns left, of length 1 at depth 0
    target: FloatArray  # (depths, r, k): Q'y
    rss: FloatArray  # (depths,): residuals of all columns left
    column: Any  # (depths, k) of int: the columns left
    fixed: Any  # (depths, k) of bool: whether they are in use for good
    count: Any  # (depths,) of int: how many are left
    used: Any  # (depths,) of int: how many of these are in use
    # Of the node at each depth.
    child: Any  # (depths,) of int: the next child
    largest: Any  # (depths,) of int: largest open size of its children
    weights: Any  # (depths,) of int: guard points with a weight; -1 for dependent columns
    point: Any  # (depths, a) of int: those guard points
    weight: FloatArray  # (depths, a): their weights u
    order: Any  # (depths, k + 1) of int: columns not in use, that of the highest bound first
    bound: FloatArray  # (depths, k + 1): of the subsets without each of these
    ceiling: FloatArray  # (depths, k + 1): largest score of interest of each size and above
    # Of the whole tree.
    guard: FloatArray  # (k, g): G'
    required: FloatArray  # (g,): h
    floors: FloatArray  # (1, k + 1): a column whose squared length is at most this is dependent
    # Space.
    W: FloatArray  # (a, k): R^-T G' of the guard points with a weight
    square: FloatArray  # (a,): squared lengths of these
    shifted: FloatArray  # (k,): q + W u
    b: FloatArray  # (k,)
    below: FloatArray  # (g,): G b - h
    inverse: FloatArray  # (k, k): R^-1
    work: FloatArray  # (k + r, k + 1)
    eliminated: FloatArray  # (k + 1, g)
    last: FloatArray  # (r,)
    cursor: Any  # (k + 1,) of int
    mask: Any  # (k + 1,) of uint64


def tree_of(control: FloatArray, guard: FloatArray, lengths: FloatArray, margin: float,
            used: int) -> tuple[Tree, FloatArray]:
    """Return a tree at its root, and the guard's denominators of its columns.

    The rows of `control` (m, k + r) have the k columns and the r targets. Those of `guard`
    (g, k + 1) have what each column adds to the denominator at a guard point, and last minus the
    denominator without any column. Columns are divided by their `lengths` (k,). `margin` is the
    least denominator; the first `used` columns are in every subset.
    """
    k = guard.shape[1] - 1
    g = len(guard)
    r = control.shape[1] - k
    depths = k + 1
    lengths = np.append(np.where(lengths > 0.0, lengths, 1.0), np.ones(r))
    # Scaled columns have scaled coefficients: their denominators are scaled with them.
    guard = np.ascontiguousarray((guard / lengths[:k + 1]).T)
    factor = np.linalg.qr(control / lengths, mode="r")
    triangle = np.zeros((k + r, k + r))
    triangle[:len(factor)] = factor
    R = np.zeros((depths, k, k))
    target = np.zeros((depths, r, k))
    R[0] = triangle[:k, :k]
    target[0] = triangle[:k, k:].T
    rss = np.full(depths, (triangle[k:, k:] ** 2).sum())
    count, in_use, child, largest, weights = np.zeros((5, depths), dtype=np.intp)
    column = np.tile(np.arange(k), (depths, 1))
    fixed = np.tile(np.arange(k) < used, (depths, 1))
    count[0] = k
    in_use[0] = used
    floors = np.full((1, k + 1), TOLERANCE**2)
    required = margin + guard[k]
    # Those that a rounding error keeps out may pass.
    required -= BOUND_ROUNDING * (1.0 + abs(required))
    point, order = (np.zeros((depths, n), dtype=np.intp) for n in (_POINTS, k + 1))
    bound, ceiling = np.zeros((2, depths, k + 1))
    shifted, b = np.zeros((2, k))
    tree = Tree(triangle=R, target=target, rss=rss, column=column, fixed=fixed, count=count,
                used=in_use, child=child, largest=largest, weights=weights, point=point,
                weight=np.zeros((depths, _POINTS)), order=order, bound=bound, ceiling=ceiling,
                guard=guard[:k].copy(), required=required, floors=floors, W=np.zeros((_POINTS, k)),
                square=np.zeros(_POINTS), shifted=shifted, b=b, below=np.zeros(g),
                inverse=np.zeros((k, k)), work=np.zeros((k + r, k + 1)),
                eliminated=np.zeros((k + 1, g)), last=np.zeros(r),
                cursor=np.zeros(k + 1, dtype=np.intp), mask=np.zeros(k + 1, dtype=np.uint64))
    return tree, guard


@_compiled
def write(tree: Tree, d: int, all_in_use: bool) -> None:
    """Write the columns at depth `d` to the rows of `tree.work`, those in use first, then targets.

    `tree.cursor` becomes the order of the columns; with `all_in_use` all of them are.
    """
    n = tree.count[d]
    written = 0
    # Two passes keep the order within those in use, and within the others.
    for fixed in (True, False):
        for i in range(n):
            if (all_in_use or tree.fixed[d, i]) == fixed:
                for t in range(n):
                    tree.work[written, t] = tree.triangle[d, t, i] if t <= i else 0.0
                tree.cursor[written] = i
                written += 1
    for j in range(tree.target.shape[1]):
        for t in range(n):
            tree.work[n + j, t] = tree.target[d, j, t]


@_compiled
def eliminate(work: FloatArray, i: int, stop: int, n: int, square: float) -> None:
    """Remove row i of `work` from the rows below it, up to `stop`, by Gram-Schmidt.

    Rows have n entries; the share of row i in each goes to its column n. `square` is the squared
    length of row i.
    """
    for j in range(i + 1, stop):
        ratio = 0.0
        for t in range(n):
            ratio += work[i, t] * work[j, t]
        ratio /= square
        for t in range(n):
            work[j, t] -= ratio * work[i, t]
        work[j, n] = ratio


@_compiled
def squared_length(work: FloatArray, i: int, n: int) -> float:
    """Return the squared length of a row."""
    total = 0.0
    for t in range(n):
        total += work[i, t] * work[i, t]
    return total
