"""The compiled branch and bound for held-out errors without denominators.

Let I be the columns in use, and let T and r be the columns F still to come and the target, without
their parts along I. A subset S adds some of F to I. Its residuals are e = r - T x for some x. With
the projection H on the columns of S, the errors of rows f that are held out together are
(1 - H_ff)^-1 e_f (Allen 1974, Technometrics 16(1), for single rows).

Rows held out one by one (PRESS): H_ff is the leverage h of a row. It is not lower than that under
I, as the columns of S span those of I: h(I) <= h(S) < 1. Hence

    sum of (e_i / (1 - h_i(S)))^2 >= sum of (e_i / (1 - h_i(I)))^2
                                  >= minimum over x of sum of ((r - T x)_i / (1 - h_i(I)))^2,

a weighted least squares that does not depend on S any more, with weights that grow with I.

Folds (LINEAR, in several systems): the eigenvalues of H_ff are in [0, 1), so that those of
(1 - H_ff)^-1 are at least 1, and |(1 - H_ff)^-1 e_f| >= |e_f|. The sum over the folds is at least
the residual sum of squares as often as each row is held out, and the minimum of that over x.

If the minimum is above the best score of every size that S may have, no such S need be looked at.
With several targets the minima add up. termsel's own formulation.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from termsel.adjustment.compiled import compile_lazily
from termsel.data.features import FloatArray
from termsel.selection.best_subsets.columns.arrays import Limits, Vectors
from termsel.selection.best_subsets.columns.kernels import (
    PRESS,
    dot_product,
    remove,
    squared_remainder,
    subtract,
)

_compiled = partial(compile_lazily, _nrt=False, fastmath={"reassoc", "contract", "arcp", "nsz"})

# A step of the loop has one place to be called from.
_inlined = partial(_compiled, forceinline=True)

ENUMERATED = 1 << 6  # subsets that cost less than a bound
_ROUNDED_MINIMUM = 1e-6  # of a minimum, relative


@_inlined
def held_out_score(kind: int, vectors: Vectors, depth: int, c: int, limits: Limits) -> float:
    """Return the sum of squared held-out errors with column c, or infinity without any.

    `vectors` hold the orthogonal columns of each fold at a `depth` of the tree. For PRESS, the
    error of row i without it is e_i / (1 - h_i), with the leverage h_i, to which column c adds
    v_i^2 / |v|^2. For folds it is the remainder of the vectors of the held-out rows. A row that the
    other rows do not determine has no error, which makes the score infinite.
    """
    n = vectors.square.shape[2] - 1
    r = vectors.share.shape[3]
    total = limits.offset
    without_error = 0
    # Folds have the remainders of their held-out rows in `extra`, one system for each fold.
    if kind != PRESS:
        for f in range(vectors.share.shape[1]):
            for j in range(r):
                total += squared_remainder(vectors.extra[depth, f, n + j],
                                           vectors.extra[depth, f, c],
                                           vectors.share[depth, f, c, j])
        return total
    v = vectors.top[depth, 0, c]
    leverage = vectors.leverage[depth]
    per_square = 1.0 / vectors.square[depth, 0, c]
    for j in range(r):
        t = vectors.top[depth, 0, n + j]
        ratio = vectors.share[depth, 0, c, j]
        for row in range(len(t)):
            value = v[row] if c < n else 0.0
            # Leverages of orthogonal columns add up.
            redundancy = 1.0 - leverage[row] - per_square * value * value
            error = (t[row] - ratio * value) / redundancy
            without_error += redundancy <= limits.tolerance
            total += error * error
    return np.inf if without_error else total


@_inlined
def descend(kind: int, vectors: Vectors, depth: int, i: int) -> None:
    """Remove column i from those to its right and the targets, from one depth to the next.

    What is removed is the part along column i. The vectors at `depth` stay, those at `depth` + 1
    are overwritten; for PRESS the leverages of the rows grow by those of the column.
    """
    n = vectors.square.shape[2] - 1
    r = vectors.share.shape[3]
    for f in range(vectors.square.shape[1]):
        for c in range(n + r - 1, i, -1):  # targets first: columns need their products with them
            remove(vectors, depth, f, i=i, c=c, n=n, r=r)
    if kind == PRESS:
        # An orthogonal column v adds v_i^2 / v'v to the leverage of row i.
        v = vectors.top[depth, 0, i]
        square = vectors.square[depth, 0, i]
        for row in range(len(v)):
            vectors.leverage[depth + 1, row] = (vectors.leverage[depth, row]
                                                + v[row] * v[row] / square)


@_compiled
def first_prunable_column(top: FloatArray, leverage: FloatArray, first: int, n: int, limit: float,
                          work: FloatArray) -> int:
    """Return the least i for which all subsets that add only columns i, ..., n - 1 are pruned.

    Their bound is above `limit`, by more than its rounding. It is `first` if that is so of all of
    first, ..., n - 1, and n if of none. `top` (n + r, rows) are the columns and the r targets
    without the columns in use, `leverage` (rows,) that of the columns in use; `work` is scratch of
    the shape of `top`.

    Weighted columns are removed from the weighted targets, from the last to the first: the squares
    that remain of the targets after column i are the least that columns i, ..., n - 1 allow. Normal
    equations would lose the digits of that minimum where targets are long; modified Gram-Schmidt
    keeps them.
    """
    vectors, rows = top.shape
    for i in range(first, vectors):
        for k in range(rows):
            work[i, k] = top[i, k] / (1.0 - leverage[k])  # the weights of the bound
    # From the last column up: after column i the targets lack all of i, ..., n - 1.
    for i in range(n - 1, first - 1, -1):
        for later in range(n - 1, i, -1):
            subtract(work[i], work[i], work[later], dot_product(work[i], work[later]))
        length = np.sqrt(dot_product(work[i], work[i]))
        if length > 0.0:  # however short: one direction more leaves no more of the targets
            for k in range(rows):
                work[i, k] /= length
        least_squares = 0.0
        for j in range(n, vectors):
            subtract(work[j], work[j], work[i], dot_product(work[j], work[i]))
            least_squares += dot_product(work[j], work[j])
        if not least_squares > limit * (1.0 + _ROUNDED_MINIMUM):
            return i + 1
    return first


def held_out_lower_bound(vectors: Vectors) -> float:
    """Return a lower bound of the held-out errors' sum of squares, for all subsets of a node.

    It is what all of the node's columns together leave of the targets, with each row divided by 1
    less its leverage under the columns in use.
    """
    rows = vectors.top[0, 0].T
    leverage = vectors.leverage[0]
    r = vectors.share.shape[3]
    # A leverage of 1 has no weight: a lower one gives a bound as well.
    rows = rows / (1.0 - np.minimum(leverage, 1.0 - 1e-9))[:, None]
    # What all columns leave of the weighted targets: |(1 - Q Q') y|^2.
    q = np.linalg.qr(rows[:, :-r])[0]
    targets = rows[:, -r:]
    return float(((targets - q @ (q.T @ targets)) ** 2).sum())
