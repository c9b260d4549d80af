"""Small blocks of subsets, scored from inner products alone.

A subset costs some nanoseconds where the vectors cost a hundred: with few columns left, inner
products are fewer than rows. They lose digits, so they only rule out; what they leave is scored
from the vectors.

Let the columns be scaled to length 1 in the control rows. Eliminating columns S in turn leaves
each a share p of its squared length, and the product of these shares is the determinant of their
Gram matrix. Its least eigenvalue is at least that product / e (the others add up to at most the
number of columns), so the product bounds the condition: below `SHARE` nothing is ruled out. Inner
products are accurate to 1e-15 times their number of rows. Coefficients b of unit columns are then
accurate to `_ACCURACY` |b|, |b| is at most |r| (e / `SHARE`)^1/2, and the errors V b inherit both
times the largest ratio of the lengths of a column in the rows of the score and of control.

With denominators the score is not below the sum of squared errors, each divided by an upper limit
of its denominator. Where none is known, one follows for each subset from the sum and the sum of
squares of its c denominators: none exceeds their mean by more than (c - 1)^1/2 times their standard
deviation (Samuelson 1968, J. Am. Stat. Assoc. 63).
"""

from __future__ import annotations

from functools import partial

import numpy as np

from termsel.adjustment.compiled import compiled
from termsel.adjustment.subset_arrays import Blocks, Products
from termsel.measurements.features import FloatArray

_compiled = partial(compiled, _nrt=False, fastmath={"reassoc", "contract", "arcp", "nsz"})

SHARE = 1e-5
_ACCURACY = 1e-8  # 100 times 1e-15 e / SHARE
_SLACK = _ACCURACY * 1000.0  # of errors, relative to |r|: _ACCURACY (e / SHARE)^1/2, rounded up


@_compiled
def prepare(top: FloatArray, extra: FloatArray, first: int, n: int, upper: FloatArray,
            b: Blocks) -> tuple[float, float]:
    """Write the inner products of columns first, ..., n - 1.

    Returns
    -------
    errors, below : float
        Accuracy of a root of a sum of squared errors, and of one of squared denominators.
    """
    height, wide = len(upper), upper[0] == np.inf
    for k in range(height):
        b.weight[k] = 1.0 if wide else 1.0 / (upper[k] * upper[k])
    target = _products(top, 0, top.shape[1], False, first, n, b.control, b)
    for i in range(n - first):
        b.inverse[i] = 1.0 / b.control.own[0, i] if b.control.own[0, i] > 0.0 else 0.0
    _products(extra, 0, height, True, first, n, b.errors, b)
    below = 0.0
    if wide:
        _products(extra, height, 2 * height, False, first, n, b.below, b)
        for i in range(n + 1 - first):
            total = 0.0
            for k in range(height, 2 * height):
                total += extra[first + i, k]
            b.sums[0, i] = total
        below = _largest_ratio(b.below, b.inverse, n - first)
    errors = _largest_ratio(b.errors, b.inverse, n - first)
    return _SLACK * np.sqrt(errors * target), _SLACK * np.sqrt(below * target)


@_compiled
def _products(rows: FloatArray, start: int, stop: int, weighted: bool, first: int, n: int,
              to: Products, b: Blocks) -> float:
    """Write the inner products of columns at level 0; return the target's with itself."""
    count = n - first
    for i in range(count + 1):
        for k in range(start, stop):
            b.row[k - start] = rows[first + i, k] * (b.weight[k - start] if weighted else 1.0)
        for j in range(i, count + 1):
            total = 0.0
            for k in range(start, stop):
                total += b.row[k - start] * rows[first + j, k]
            if i == count:
                to.total[0] = total
            elif j == count:
                to.f[0, i] = total
            elif j == i:
                to.own[0, i] = total
            else:
                to.M[0, i, j] = total
    return float(to.total[0])


@_compiled
def _largest_ratio(of: Products, inverse: FloatArray, count: int) -> float:
    ratio = 0.0
    for i in range(count):
        ratio = max(ratio, of.own[0, i] * inverse[i])
    return ratio


@_compiled
def eliminate(i: int, level: int, count: int, wide: bool, b: Blocks) -> None:
    """Remove column i from those to its right and from the target, from one level to the next."""
    c, below = b.control, level + 1
    length = c.own[level, i]
    share = c.f[level, i] / length
    for j in range(i + 1, count):
        b.a[j] = c.M[level, i, j] / length
    for j in range(i + 1, count):
        c.f[below, j] = c.f[level, j] - b.a[j] * c.f[level, i]
    for j in range(i + 1, count):
        c.own[below, j] = c.own[level, j] - b.a[j] * c.M[level, i, j]
    for j in range(i + 1, count - 1):
        for k in range(j + 1, count):
            c.M[below, j, k] = c.M[level, j, k] - b.a[j] * c.M[level, i, k]
    _eliminate_from(b.errors, i, level, count, share, b)
    if wide:
        _eliminate_from(b.below, i, level, count, share, b)
        for j in range(i + 1, count):
            b.sums[below, j] = b.sums[level, j] - b.a[j] * b.sums[level, i]
        b.sums[below, count] = b.sums[level, count] - share * b.sums[level, i]


@_compiled
def _eliminate_from(of: Products, i: int, level: int, count: int, share: float,
                    b: Blocks) -> None:
    below, own = level + 1, of.own[level, i]
    left = of.f[level, i] - share * own
    of.total[below] = of.total[level] - share * (left + of.f[level, i])
    for j in range(i + 1, count):
        b.u[j] = of.M[level, i, j] - b.a[j] * own
    for j in range(i + 1, count):
        of.f[below, j] = of.f[level, j] - b.a[j] * left - share * of.M[level, i, j]
    for j in range(i + 1, count):
        of.own[below, j] = of.own[level, j] - b.a[j] * (b.u[j] + of.M[level, i, j])
    for j in range(i + 1, count - 1):
        a, product = b.a[j], of.M[level, i, j]
        for k in range(j + 1, count):
            of.M[below, j, k] = of.M[level, j, k] - a * b.u[k] - b.a[k] * product


@_compiled
def single(i: int, level: int, count: int, wide: bool, accuracy: float, b: Blocks) -> float:
    """Return a lower bound of the score with one more column."""
    share = b.control.f[level, i] / b.control.own[level, i]
    score = _with(b.errors, i, level, share)
    if wide:
        total = b.sums[level, count] - share * b.sums[level, i]
        score /= _largest_square(_with(b.below, i, level, share), -total, len(b.weight), accuracy)
    return score


@_compiled
def _with(of: Products, i: int, level: int, share: float) -> float:
    return float(of.total[level] - share * (2.0 * of.f[level, i] - share * of.own[level, i]))


@_compiled
def _largest_square(squares: float, total: float, rows: int, accuracy: float) -> float:
    """Return an upper limit of the squared denominators, given their sum and sum of squares."""
    mean = total / rows
    spread = max(0.0, squares / rows - mean * mean) + 1e-12 * squares
    largest = abs(mean) + np.sqrt((rows - 1) * spread) + accuracy
    return float(largest * largest)


@_compiled
def pairs(i: int, level: int, count: int, share: float, wide: bool, accuracy: float,
          b: Blocks) -> float:
    """Write lower bounds of the scores with column i and each to its right; return their least.

    A bound of -1 says that nothing is known.
    """
    c = b.control
    gain, inverse = c.f[level, i], 1.0 / c.own[level, i]
    ratio = gain * inverse
    for k in range(i + 1, count):
        b.a[k] = c.M[level, i, k] * inverse
    for k in range(i + 1, count):
        b.row[k] = c.own[level, k] - b.a[k] * c.M[level, i, k]
    for k in range(i + 1, count):
        b.u[k] = (c.f[level, k] - b.a[k] * gain) / b.row[k]
    for k in range(i + 1, count):
        b.row[k] = 0.0 if b.row[k] * b.inverse[k] * share > SHARE else np.inf
    _pair_squares(b.errors, i, level, count, ratio, b, b.row)
    if wide:
        for k in range(i + 1, count):
            b.below_row[k] = 0.0
        for k in range(i + 1, count):
            b.sums[level + 1, k] = b.u[k] * (b.a[k] * b.sums[level, i] - b.sums[level, k])
        _pair_squares(b.below, i, level, count, ratio, b, b.below_row)
        total, rows = b.sums[level, count] - ratio * b.sums[level, i], len(b.weight)
        for k in range(i + 1, count):
            b.row[k] /= _largest_square(b.below_row[k], -total - b.sums[level + 1, k], rows,
                                        accuracy)
    least = np.inf
    for k in range(i + 1, count):
        b.row[k] = b.row[k] if b.row[k] < np.inf else -1.0
    for k in range(i + 1, count):
        least = min(least, b.row[k])
    return least


@_compiled
def _pair_squares(of: Products, i: int, level: int, count: int, ratio: float, b: Blocks,
                  to: FloatArray) -> None:
    own = of.own[level, i]
    left = of.f[level, i] - ratio * own
    total = of.total[level] - ratio * (left + of.f[level, i])
    for k in range(i + 1, count):
        product, a, share = of.M[level, i, k], b.a[k], b.u[k]
        to[k] += (total - 2.0 * share * (of.f[level, k] - a * left - ratio * product)
                  + share * share * (of.own[level, k] - a * (2.0 * product - a * own)))
