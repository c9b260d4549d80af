"""A bound that rules out many subsets at once, for the enumeration of all subsets.

Let I be the columns in use, and let all vectors have them removed: the columns T and the target r
in the control rows, V and e in the rows of the score, d and D for the denominators there. A subset
that adds columns S of F to I has coefficients b, zero outside S, and errors e - V b. Three facts
hold for each such subset, whatever S is:

1. T b is the projection of r on the columns S, so T b is orthogonal to r - T b:
   b'T'T b - b'T'r = 0. (The projections of r on all subspaces lie on one sphere.)
2. If the score is at most B, and no denominator D + d b is above U, then
   sum of ((e - V b) / U)^2 <= B.
3. Hence, for any positive weights a and w, a (b'T'T b - b'T'r) + w (sum ((e - V b) / U)^2 - B) is
   not positive. This is a convex quadratic q(b). If its minimum over all b is positive, no
   subset of F scores B or less. Otherwise all b with q(b) <= 0 lie in an ellipsoid, on which each
   D + d b has a largest value: a new U, to be used in turn. If one is below the margin, no
   subset has a score.

U is infinite at first and is handed down to the subsets below. While it is, no denominator exceeds
the root of the sum of all their squares, so fact 2 becomes
sum of (e - V b)^2 <= B sum of (D + d b)^2. The quadratic with that instead is used where it is
convex, else w = 0. Without denominators U = 1 and w q is least squares with a constraint.
termsel's own formulation; fact 1 is Thales'.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from termsel.adjustment.compiled import compiled
from termsel.adjustment.subset_arrays import Space
from termsel.measurements.features import FloatArray

_compiled = partial(compiled, _nrt=False, fastmath={"reassoc", "contract", "arcp", "nsz"})

_STEPS = 4  # of U; each costs as much as a test
_GAIN = 0.8  # a step that lowers no upper limit to this share is the last
_PIVOT = 1e-8  # least pivot of the quadratic, relative to its diagonal
_ROUNDING = 1e-6  # of the minimum, relative to what it is made of; errors are below 1e-14 / pivot


@_compiled
def first_closed(top: FloatArray, extra: FloatArray, first: int, n: int, limit: float,
                 upper: FloatArray, rational: bool, margin: float, space: Space) -> int:
    """Return a column from which on no subset scores `limit` or less.

    Parameters
    ----------
    top, extra : ndarray, shape (n + 1, rows) and (n + 1, e) or (n + 1, 2 e)
        One depth of `Levels`, without the columns in use.
    first, n : int
        F is first, ..., n - 1.
    limit : float
        B of the module's text.
    upper : ndarray, shape (e,)
        U, lowered in place; 1 for scores without denominators.
    rational : bool
        Whether there are denominators.
    margin : float
        Least denominator.
    space : Space

    Returns
    -------
    int
        c: all subsets that add some of c, ..., n - 1 alone score more. `first` if none of F need
        be looked at; n if nothing is known.

    Notes
    -----
    Columns are eliminated from the last to the first. The minimum over the coefficients of the
    last i columns alone is known after i steps, so one elimination tests every tail of F.
    """
    count, height = n - first, len(upper)
    gram, room, rows = space.gram, space.triangle, space.rows
    weight, h, y = space.x[0], space.x[1], space.x[2]
    square = 0.0
    for k in range(top.shape[1]):
        square += top[n, k] * top[n, k]
    if not square > 0.0:
        return n
    a, w = 2.0 / square, 0.5 / limit
    for i in range(count):
        for j in range(i + 1):
            total = 0.0
            for k in range(top.shape[1]):
                total += top[n - 1 - i, k] * top[n - 1 - j, k]
            gram[i, j] = a * total
        total = 0.0
        for k in range(top.shape[1]):
            total += top[n - 1 - i, k] * top[n, k]
        gram[count, i] = 0.5 * a * total
    closed, failed = 0, False
    for _ in range(_STEPS + 1):
        known = upper[0] < np.inf
        below = 0.0 if known or failed else 0.5  # weight of the denominators' squares
        constant, scale = 0.0, 0.5
        for k in range(height):
            weight[k] = w / (upper[k] * upper[k]) if known else 2.0 * below * w
            constant += weight[k] * extra[n, k] * extra[n, k]
        constant -= 0.5 * known
        if below > 0.0:
            for k in range(height):
                constant -= below * extra[n, height + k] * extra[n, height + k]
                scale += extra[n, height + k] * extra[n, height + k]
        scale += constant
        failed = False
        # Cholesky's triangle of the quadratic, and the minimum, column by column.
        for i in range(count):
            column = n - 1 - i
            for k in range(height):
                y[k] = weight[k] * extra[column, k]
            total = 0.0
            for k in range(height):
                total += y[k] * extra[n, k]
            if below > 0.0:
                for k in range(height, 2 * height):
                    total -= below * extra[column, k] * extra[n, k]
            h[i] = gram[count, i] + total
            own = 0.0
            if below > 0.0:
                for k in range(height, 2 * height):
                    own += extra[column, k] * extra[column, k]
            for j in range(i + 1):
                total = 0.0
                for k in range(height):
                    total += y[k] * extra[n - 1 - j, k]
                if below > 0.0:
                    for k in range(height, 2 * height):
                        total -= below * extra[column, k] * extra[n - 1 - j, k]
                room[i, j] = gram[i, j] + total
            pivot = room[i, i]
            least = _PIVOT * (pivot + own)
            for j in range(i):
                total = room[i, j]
                for k in range(j):
                    total -= room[i, k] * room[j, k]
                total /= room[j, j]
                room[i, j] = total
                pivot -= total * total
                h[i] -= total * h[j]
            if not pivot > least:
                failed = True
                break
            room[i, i] = np.sqrt(pivot)
            h[i] /= room[i, i]
            constant -= h[i] * h[i]
            if constant > _ROUNDING * scale and i >= closed:
                closed = i + 1
        if failed and below > 0.0:
            continue  # with the first fact alone
        if failed or closed == count or not rational:
            return n - closed
        if not _lowered(extra, n, count, upper, max(0.0, -constant), room, h, rows, weight, y):
            return n - closed
        for k in range(height):
            if upper[k] < margin * (1.0 - _ROUNDING):
                return first
    return n - closed


@_compiled
def _lowered(extra: FloatArray, n: int, count: int, upper: FloatArray, radius: float,
             triangle: FloatArray, h: FloatArray, rows: FloatArray, centre: FloatArray,
             length: FloatArray) -> bool:
    """Lower the upper limits of the denominators to their maxima on an ellipsoid.

    Its points are c + L'^-1 z with |z|^2 <= radius, where L is the triangle and L'c = h. The
    maximum of D + d b on it is D + d c + |L^-1 d| sqrt(radius).
    """
    height = len(upper)
    for k in range(height):
        centre[k] = -extra[n, height + k]
        length[k] = 0.0
    for i in range(count):
        for k in range(height):
            rows[i, k] = extra[n - 1 - i, height + k]
        for j in range(i):
            ratio = triangle[i, j]
            for k in range(height):
                rows[i, k] -= ratio * rows[j, k]
        ratio = 1.0 / triangle[i, i]
        for k in range(height):
            rows[i, k] *= ratio
        for k in range(height):
            centre[k] += rows[i, k] * h[i]
        for k in range(height):
            length[k] += rows[i, k] * rows[i, k]
    gained = False
    for k in range(height):
        largest = centre[k] + np.sqrt(radius * length[k]) * (1.0 + _ROUNDING) + _ROUNDING
        gained |= largest < _GAIN * upper[k]
        upper[k] = min(upper[k], largest)
    return gained
