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

from termsel.adjustment.compiled import compile_lazily
from termsel.data.features import FloatArray
from termsel.selection.best_subsets.columns.arrays import Products, SubsetBlock

_compiled = partial(compile_lazily, _nrt=False, fastmath={"reassoc", "contract", "arcp", "nsz"})

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
    # No denominator is above U of their sum: an error weighs at least 1 / U^2 (module's text).
    for k in range(height):
        b.weight[k] = 1.0 / (upper[k] * upper[k])
    target = _write_products(top, top.shape[1], False, first=first, n=n, products=b.control, b=b)
    for i in range(n - first):
        # The inverse 0 makes the share of a dependent column 0: it is never ruled out here.
        square = b.control.diagonal[0, i]
        b.inverse[i] = 1.0 / square if square > floor[first + i] else 0.0
    _write_products(extra, height, True, first=first, n=n, products=b.errors, b=b)
    # Largest ratios of a column's squared length, and squared sum of denominators, to its squared
    # length in the control rows: they turn the accuracy of unit columns into that of the score.
    errors, below = 0.0, 0.0
    for i in range(n + 1 - first):
        total = 0.0
        for k in range(height, extra.shape[1]):
            total -= extra[first + i, k]
        if i == n - first:
            b.target_sum[0] = total if extra.shape[1] > height else 1.0
        else:
            b.sums[0, i] = total
            below = max(below, total * total * b.inverse[i])
            errors = max(errors, b.errors.diagonal[0, i] * b.inverse[i])
    return _SLACK * np.sqrt(errors * target), _SLACK * np.sqrt(below * target)


@_compiled
def _write_products(rows: FloatArray, height: int, weighted: bool, first: int, n: int,
                    products: Products, b: SubsetBlock) -> float:
    """Write the inner products of columns first, ..., n - 1 at level 0; return the target's square.

    `rows` (n + 1, .) are the columns and the target, of which the first `height` elements count,
    times the weights of `b` if `weighted`.
    """
    count = n - first
    # Column `count` is the target. Each product is needed once: the matrix is symmetric.
    for i in range(count + 1):
        for k in range(height):
            b.row[k] = rows[first + i, k] * (b.weight[k] if weighted else 1.0)
        for j in range(i, count + 1):
            total = 0.0
            for k in range(height):
                total += b.row[k] * rows[first + j, k]
            if i == count:
                products.total[0] = total
            elif j == count:
                products.f[0, i] = total
            elif j == i:
                products.diagonal[0, i] = total
            else:
                products.M[0, i, j] = total
    return float(products.total[0])


@_compiled
def eliminate(i: int, level: int, count: int, b: SubsetBlock) -> None:
    """Remove column i from those to its right and from the target, from one level to the next.

    Gram-Schmidt by products alone: with v = column i, each later column becomes x - (x'v / v'v) v,
    and so does the target, in the control, which decides, and likewise in the errors. No vector is
    touched, so that the cost does not depend on the number of points. `count` columns are left at
    the level.
    """
    control = b.control
    errors = b.errors
    below = level + 1
    inverse = 1.0 / control.diagonal[level, i]
    error_square = errors.diagonal[level, i]
    share = control.f[level, i] * inverse
    # |e - s v|^2 = ee - s (2 ev - s vv): the share s leaves both sides of a product.
    remaining_f = errors.f[level, i] - share * error_square
    errors.total[below] = errors.total[level] - share * (remaining_f + errors.f[level, i])
    b.target_sum[below] = b.target_sum[level] - share * b.sums[level, i]
    for j in range(i + 1, count):
        # Column j loses a of column i; u is what then is left of its product with it.
        b.a[j] = control.M[level, i, j] * inverse
        b.u[j] = errors.M[level, i, j] - b.a[j] * error_square
    for j in range(i + 1, count):
        a = b.a[j]
        product = errors.M[level, i, j]
        control.f[below, j] = control.f[level, j] - a * control.f[level, i]
        control.diagonal[below, j] = control.diagonal[level, j] - a * control.M[level, i, j]
        errors.f[below, j] = errors.f[level, j] - a * remaining_f - share * product
        errors.diagonal[below, j] = errors.diagonal[level, j] - a * (b.u[j] + product)
        b.sums[below, j] = b.sums[level, j] - a * b.sums[level, i]
    # Only control products decide what is removed; those of errors follow.
    for j in range(i + 1, count - 1):
        a = b.a[j]
        product = errors.M[level, i, j]
        for k in range(j + 1, count):
            control.M[below, j, k] = control.M[level, j, k] - a * control.M[level, i, k]
            errors.M[below, j, k] = errors.M[level, j, k] - a * b.u[k] - b.a[k] * product


@_compiled
def is_single_column_pruned(i: int, level: int, root_limit: float, error_accuracy: float,
                            sum_accuracy: float, b: SubsetBlock) -> bool:
    """Return whether with column i added the root of the score is certainly above `root_limit`.

    Column i is numbered within the block, whose columns in use so far are those eliminated at
    `level`. `error_accuracy` and `sum_accuracy` are how far rounding may have changed the root of
    the sum of squared errors, and the sum of denominators.
    """
    products = b.errors
    share = b.control.f[level, i] / b.control.diagonal[level, i]
    # |e - s v|^2 = e'e - s (2 e'v - s v'v)
    change = share * (2.0 * products.f[level, i] - share * products.diagonal[level, i])
    squares = products.total[level] - change
    # The score is at least the squares over the squared sum of denominators, each as accurate as it
    # is known.
    sum_of_denominators = abs(b.target_sum[level] - share * b.sums[level, i]) + sum_accuracy
    root = root_limit * sum_of_denominators + error_accuracy
    return bool(squares > root * root)


@_compiled
def count_open_pairs(i: int, level: int, count: int, share: float, root_limit: float,
                     error_accuracy: float, sum_accuracy: float, b: SubsetBlock) -> int:
    """Return how many subsets with column i and one to its right may score `root_limit` squared.

    `b.row` becomes positive for each column to the right with which the score is certainly higher.
    The other arguments are as for `is_single_column_pruned`.
    """
    control = b.control
    products = b.errors
    gain = control.f[level, i]
    inverse = 1.0 / control.diagonal[level, i]
    error_square = products.diagonal[level, i]
    ratio = gain * inverse
    remaining_f = products.f[level, i] - ratio * error_square
    total = products.total[level] - ratio * (remaining_f + products.f[level, i])
    sum_i = b.sums[level, i]
    target_sum = b.target_sum[level] - ratio * b.sums[level, i]
    not_ruled_out = 0
    for k in range(i + 1, count):
        # Column k less its part a along column i, then the target less its share of what remains.
        a = control.M[level, i, k] * inverse
        product = products.M[level, i, k]
        length = control.diagonal[level, k] - a * control.M[level, i, k]
        share_k = (control.f[level, k] - a * gain) / length
        # Products of the errors with the reduced column k, and of that column with itself.
        error_product = products.f[level, k] - a * remaining_f - ratio * product
        column_square = products.diagonal[level, k] - a * (2.0 * product - a * error_square)
        squares = total - 2.0 * share_k * error_product + share_k * share_k * column_square
        reduced_sum = b.sums[level, k] - a * sum_i
        root = (root_limit * (abs(target_sum - share_k * reduced_sum) + sum_accuracy)
                + error_accuracy)
        value = squares - root * root
        # Too badly conditioned for inner products: the vectors decide.
        value = value if length * b.inverse[k] * share > SHARE else -1.0
        b.row[k] = value
        not_ruled_out += not value > 0.0
    return not_ruled_out
