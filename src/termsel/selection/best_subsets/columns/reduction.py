"""Fewer rows with the same inner products, and columns in an order that suits bounds."""

from __future__ import annotations

import numpy as np

from termsel.adjustment.solve import TOLERANCE
from termsel.data.features import BoolArray, FloatArray, IntArray


def triangle_of(rows: FloatArray, n: int) -> tuple[FloatArray, float]:
    """Return n rows with the same inner products of the n columns with all vectors, (n, n + t).

    The part of the t targets that is orthogonal to all columns is lost; its sum of squares is
    returned.
    """
    triangle = np.asarray(np.linalg.qr(rows, mode="r")) if len(rows) > n else rows
    # Below row n of the triangle there are targets alone.
    return triangle[:n], float((triangle[n:, n:] ** 2).sum())


def fewer_rows(rows: FloatArray) -> FloatArray:
    """Return rows (m, k) as at most k rows with the same inner products of their columns."""
    return np.asarray(np.linalg.qr(rows, mode="r")) if len(rows) > rows.shape[1] else rows


def order_by_gain(control: FloatArray, forced: IntArray, free: IntArray, k: int) -> IntArray:
    """Return the free columns, (f,), by how much each explains in addition to those before it.

    Forced columns come before all free ones. The first k columns of `control` are the design, the
    further ones are targets. Subsets that lack the first of the free columns then have a high
    bound.
    """
    remainders = control
    # A column that depends on those before it explains nothing, whatever rounding leaves of it.
    least_squares = (TOLERANCE * np.linalg.norm(control, axis=0)) ** 2
    for j in forced:
        remainders = _orthogonal_to(remainders, j)
    unordered = free.tolist()
    order: list[int] = []
    while unordered:
        squares = (remainders[:, unordered] ** 2).sum(axis=0)
        # With the column a and the residuals r the sum of squares falls by (a'r)^2 / a'a.
        gains = ((remainders[:, unordered].T @ remainders[:, k:]) ** 2).sum(axis=1)
        gains = np.divide(gains, squares, out=np.zeros_like(gains), where=squares
                          > least_squares[unordered])
        order.append(unordered.pop(int(gains.argmax())))
        remainders = _orthogonal_to(remainders, order[-1])
    return np.array(order, dtype=np.intp)


def order_by_halves(free: IntArray, below: BoolArray) -> IntArray:
    """Return columns of a quotient: half of each side, then the rest, the denominator's last.

    Models list terms of low degree first. Terms of high degree in the denominator change little, so
    that a bound soon closes them, whatever is in use. `below` (k,) shows columns of the
    denominator.
    """
    above = free[~below[free]]
    below_ = free[below[free]]
    a = len(above) // 2
    b = len(below_) // 2
    return np.concatenate([above[:a], below_[:b], above[a:], below_[b:]])


def _orthogonal_to(rows: FloatArray, j: int) -> FloatArray:
    """Return rows (m, k) less the part of each column along column j, which becomes 0."""
    square = rows[:, j] @ rows[:, j]
    if square == 0.0:
        return rows
    return np.asarray(rows - np.outer(rows[:, j], rows[:, j] @ rows / square))
