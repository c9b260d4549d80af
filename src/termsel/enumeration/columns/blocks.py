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

With denominators the score is not below the sum of squared errors, each divided by an upper limit U
of its denominator relative to the sum of all of them, over that sum squared.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from termsel.adjustment.compiled import compiled
from termsel.enumeration.columns.arrays import Products, SubsetBlock
from termsel.measurements.features import FloatArray

_compiled = partial(compiled, _nrt=False, fastmath={"reassoc", "contract", "arcp", "nsz"})

SHARE = 1e-5
_ACCURACY = 1e-8  # 100 times 1e-15 e / SHARE
_SLACK = _ACCURACY * 1000.0  # of errors, relative to |r|: _ACCURACY (e / SHARE)^1/2, rounded up


@_compiled
def prepare(top: FloatArray, extra: FloatArray, first: int, n: int, upper: FloatArray,
            floor: FloatArray, b: SubsetBlock) -> tuple[float, float]:
    """Write the inner products of columns first, ..., n - 1, and sums of their denominators.

    The share of a column that depends on those in use, to the floor of its square, is zero. Return
    the accuracy of a root of a sum of squared errors, and of a sum of denominators.
    """
    height = len(upper) - 1
    for k in range(height):
        b.weight[k] = 1.0 / (upper[k] * upper[k])
    target = _products(top, top.shape[1], False, first, n, b.control, b)
    for i in range(n - first):
        own = b.control.own[0, i]
        b.inverse[i] = 1.0 / own if own > floor[first + i] else 0.0
    _products(extra, height, True, first, n, b.errors, b)
    errors, below = 0.0, 0.0
    for i in range(n + 1 - first):
        total = 0.0
        for k in range(height, extra.shape[1]):
            total -= extra[first + i, k]
        if i == n - first:
            b.whole[0] = total if extra.shape[1] > height else 1.0
        else:
            b.sums[0, i] = total
            below = max(below, total * total * b.inverse[i])
            errors = max(errors, b.errors.own[0, i] * b.inverse[i])
    return _SLACK * np.sqrt(errors * target), _SLACK * np.sqrt(below * target)


@_compiled
def _products(rows: FloatArray, height: int, weighted: bool, first: int, n: int, to: Products,
              b: SubsetBlock) -> float:
    """Write the inner products of columns at level 0; return the target's with itself."""
    count = n - first
    for i in range(count + 1):
        for k in range(height):
            b.row[k] = rows[first + i, k] * (b.weight[k] if weighted else 1.0)
        for j in range(i, count + 1):
            total = 0.0
            for k in range(height):
                total += b.row[k] * rows[first + j, k]
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
def eliminate(i: int, level: int, count: int, b: SubsetBlock) -> None:
    """Remove column i from those to its right and from the target, from one level to the next."""
    c, of, to = b.control, b.errors, level + 1
    inverse, own = 1.0 / c.own[level, i], of.own[level, i]
    share = c.f[level, i] * inverse
    # |e - s v|^2 = ee - s (2 ev - s vv): the share s leaves both sides of a product.
    left = of.f[level, i] - share * own
    of.total[to] = of.total[level] - share * (left + of.f[level, i])
    b.whole[to] = b.whole[level] - share * b.sums[level, i]
    for j in range(i + 1, count):
        # Column j loses a of column i; u is what then is left of its product with it.
        b.a[j] = c.M[level, i, j] * inverse
        b.u[j] = of.M[level, i, j] - b.a[j] * own
    for j in range(i + 1, count):
        a, product = b.a[j], of.M[level, i, j]
        c.f[to, j] = c.f[level, j] - a * c.f[level, i]
        c.own[to, j] = c.own[level, j] - a * c.M[level, i, j]
        of.f[to, j] = of.f[level, j] - a * left - share * product
        of.own[to, j] = of.own[level, j] - a * (b.u[j] + product)
        b.sums[to, j] = b.sums[level, j] - a * b.sums[level, i]
    # Only control products decide what is removed; those of errors follow.
    for j in range(i + 1, count - 1):
        a, product = b.a[j], of.M[level, i, j]
        for k in range(j + 1, count):
            c.M[to, j, k] = c.M[level, j, k] - a * c.M[level, i, k]
            of.M[to, j, k] = of.M[level, j, k] - a * b.u[k] - b.a[k] * product


@_compiled
def single(i: int, level: int, least: float, errors: float, below: float, b: SubsetBlock) -> bool:
    """Return whether with one more column the root of the score is certainly above `least`."""
    of = b.errors
    share = b.control.f[level, i] / b.control.own[level, i]
    squares = of.total[level] - share * (2.0 * of.f[level, i] - share * of.own[level, i])
    # The score is at least the squares over the squared sum of denominators, each as accurate as it
    # is known.
    root = least * (abs(b.whole[level] - share * b.sums[level, i]) + below) + errors
    return bool(squares > root * root)


@_compiled
def pairs(i: int, level: int, count: int, share: float, least: float, errors: float,
          below: float, b: SubsetBlock) -> int:
    """Return how many subsets with column i and one to its right may score `least` squared.

    Where b.row is positive the score is certainly higher.
    """
    c, of = b.control, b.errors
    gain, inverse, own = c.f[level, i], 1.0 / c.own[level, i], of.own[level, i]
    ratio = gain * inverse
    left = of.f[level, i] - ratio * own
    total = of.total[level] - ratio * (left + of.f[level, i])
    sum_i, whole = b.sums[level, i], b.whole[level] - ratio * b.sums[level, i]
    open_ = 0
    for k in range(i + 1, count):
        a, product = c.M[level, i, k] * inverse, of.M[level, i, k]
        length = c.own[level, k] - a * c.M[level, i, k]
        more = (c.f[level, k] - a * gain) / length
        squares = (total - 2.0 * more * (of.f[level, k] - a * left - ratio * product)
                   + more * more * (of.own[level, k] - a * (2.0 * product - a * own)))
        root = least * (abs(whole - more * (b.sums[level, k] - a * sum_i)) + below) + errors
        value = squares - root * root
        # Too badly conditioned for inner products: the vectors decide.
        value = value if length * b.inverse[k] * share > SHARE else -1.0
        b.row[k] = value
        open_ += not value > 0.0
    return open_
