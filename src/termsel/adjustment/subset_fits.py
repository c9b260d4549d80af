"""Least-squares fits of many sets of the same points: their squared distances from each fit.

Of a set with the design A and the image b, both of its rows alone, the normal equations
A'A x = A'b are solved by Cholesky's method, and once more for the residuals of the solution:
A'A dx = A'(b - A x). So they are as exact as those of an orthogonal factorisation, but for sets
that all but leave a coefficient free (Björck 1987, corrected seminormal equations): these, which
the pivots show, are left to `numpy.linalg.lstsq`.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from termsel.adjustment.compiled import compile_lazily
from termsel.data.features import BoolArray, FloatArray

LEAST_PIVOT = 1e-9
"""Part of a column's sum of squares that is without the columns before it, below which normal
equations are not solved: about the square of the sine of its angle to them."""

# Nothing is allocated, and sums are taken in the order in which they are written.
_compiled = partial(compile_lazily, _nrt=False)


def squared_distances_from_fits(design: FloatArray, image: FloatArray,
                                sets: BoolArray) -> FloatArray:
    """Return the squared distances of n points from the fit of each of m sets of them, (m, n).

    The design (n, k) and the image (n, 2) are those of all points; the sets are masks (m, n).
    """
    n, k = design.shape
    squares = np.empty(sets.shape)
    pivots = np.empty(len(sets))
    _fill_squares(np.ascontiguousarray(design), np.ascontiguousarray(image), sets,
                  np.empty((k, k)), np.empty((2, k)), np.empty((2, k)), np.empty((n, 2)), squares,
                  pivots)
    # Normal equations square the condition: sets that are nearly dependent are solved by SVD.
    for number in np.flatnonzero(~(pivots > LEAST_PIVOT)):
        used = sets[number]
        coefficients = np.linalg.lstsq(design[used], image[used])[0]
        squares[number] = ((image - design @ coefficients)**2).sum(axis=1)
    return squares


@_compiled
def _fill_squares(design: FloatArray, image: FloatArray, sets: BoolArray, triangle: FloatArray,
                  right: FloatArray, solution: FloatArray, residuals: FloatArray,
                  squares: FloatArray, pivots: FloatArray) -> None:
    """Fill in `squares` (m, n) of `squared_distances_from_fits`, and the least pivots (m,).

    `design` (n, k) and `image` (n, 2) are those of all points; `sets` (m, n) are masks of the
    points that each fit uses. Scratch are `triangle` (k, k), `right` and `solution` (2, k), and
    `residuals` (n, 2).
    """
    n, k = design.shape
    for number in range(len(sets)):
        used = sets[number]
        # The lower triangle of the normal equations A'A of the points in the set.
        triangle[:] = 0.0
        for p in range(n):
            if used[p]:
                for i in range(k):
                    for j in range(i + 1):
                        triangle[i, j] += design[p, i] * design[p, j]
        pivots[number] = _factor_by_cholesky(triangle)
        solution[:] = 0.0
        for p in range(n):
            for axis in range(2):
                residuals[p, axis] = image[p, axis]
        for _ in range(2):  # the solution, then its correction
            right[:] = 0.0
            for p in range(n):
                if used[p]:
                    for axis in range(2):
                        for i in range(k):
                            right[axis, i] += design[p, i] * residuals[p, axis]
            for axis in range(2):
                _solve_by_factor(triangle, right[axis])
                for i in range(k):
                    solution[axis, i] += right[axis, i]
            for p in range(n):
                for axis in range(2):
                    predicted = 0.0
                    for i in range(k):
                        predicted += design[p, i] * solution[axis, i]
                    residuals[p, axis] = image[p, axis] - predicted
        for p in range(n):
            line = residuals[p, 0]
            sample = residuals[p, 1]
            squares[number, p] = line * line + sample * sample


@_compiled
def _factor_by_cholesky(matrix: FloatArray) -> float:
    """Replace the lower triangle of a matrix (k, k) by Cholesky's factor L; return the least pivot.

    A pivot is the square of a diagonal entry of L, divided by the entry of the matrix there.
    """
    least = np.inf
    for i in range(len(matrix)):
        diagonal = matrix[i, i]
        # L_ij = (a_ij - sum over h < j of L_ih L_jh) / L_jj
        for j in range(i + 1):
            entry = matrix[i, j]
            for h in range(j):
                entry -= matrix[i, h] * matrix[j, h]
            if j < i:
                matrix[i, j] = entry / matrix[j, j]
            else:
                # Negated, so that NaN, the root of a negative pivot, is taken as well.
                least = entry / diagonal if not entry / diagonal >= least else least
                matrix[i, i] = np.sqrt(entry)
    return least


@_compiled
def _solve_by_factor(triangle: FloatArray, right: FloatArray) -> None:
    """Solve L L'x = `right` (k,), which x takes the place of."""
    k = len(right)
    for i in range(k):
        for j in range(i):
            right[i] -= triangle[i, j] * right[j]
        right[i] /= triangle[i, i]
    for i in range(k - 1, -1, -1):
        for j in range(i + 1, k):
            right[i] -= triangle[j, i] * right[j]
        right[i] /= triangle[i, i]
