"""Many adjustments next to a known one: with a feature more, one less, or one for another.

The neighbours of a selection of features differ from it by few rows, so that its solution x can be
corrected (Hager 1989, Updating the inverse of a matrix, SIAM Review 31(2)). With A = V R, where V
is orthonormal over the rows of the selection, and its residuals r = b - A x,

    x' = x + R^-1 V_s' (D + V_s V_s')^-1 r_s,

where s are the rows that are added, with 1 on the diagonal of D, and dropped, with -1. As in
`termsel.adjustment.blocks` A is never squared, and neighbours whose correction magnifies
rounding by more than `SAFE_CONDITION` are left to the kernels.
"""

from __future__ import annotations

import numpy as np

from termsel.adjustment.blocks import SAFE_CONDITION
from termsel.adjustment.equations import Equations
from termsel.adjustment.kernels import solve_many
from termsel.data.features import BoolArray, FloatArray, IntArray

MAX_FEATURE_ROWS = 4
"""Most rows of a feature; the time that a correction takes grows with their square."""

MIN_WORK = 3_000
"""Rows of a selection, times the square of its terms, from which a correction is faster."""

_DETERMINED = 1e-5  # least part of a column that those before it leave; else kernels decide


def solve_near(equations: Equations, start: BoolArray, features: BoolArray,
               ) -> tuple[FloatArray, IntArray]:
    """Solve for features (p, n) next to a selection (n,), with all terms (see `solve_many`).

    The solutions are those of `solve_many`, but for rounding.
    """
    rows = _rows_of(equations.feature, len(start))
    reference = _reference_solution(equations, start) if rows.shape[1] <= MAX_FEATURE_ROWS else None
    if reference is None:
        return solve_many(equations, None, features)
    x, V, row_solutions, residuals = reference
    p, n = features.shape
    # The feature that each one adds and drops; number n, without rows, for none.
    individual, changed_feature = np.divmod(np.flatnonzero(features != start), n)
    added, dropped = np.full((2, p), n)
    on = features[individual, changed_feature]
    added[individual[on]] = changed_feature[on]
    dropped[individual[~on]] = changed_feature[~on]
    changes = np.bincount(individual, minlength=p)
    # What rows of a feature have of the selection, and without it if they are of it.
    gram = V[rows] @ V[rows].transpose(0, 2, 1)
    largest = np.trace(gram, axis1=1, axis2=2)
    safe = ((np.where(added < n, 1, 0) + np.where(dropped < n, 1, 0) == changes)
            & (largest[added] <= SAFE_CONDITION) &
            (_least_remaining_shares(gram, start)[dropped] * SAFE_CONDITION >= 1.0))
    coefficients = np.empty((p, len(x)))
    violation = np.zeros(p, dtype=np.intp)
    if not safe.all():
        coefficients[~safe], violation[~safe] = solve_many(equations, None, features[~safe])
    added = added[safe]
    dropped = dropped[safe]
    width = rows.shape[1]
    mixed = np.matmul(V[rows[added]], V[rows[dropped]].transpose(0, 2, 1))
    # D + V_s V_s' of the rows added and dropped; rows of zeros keep the 1 and -1 of D.
    system = np.empty((len(added), 2 * width, 2 * width))
    system[:, :width, :width] = np.eye(width) + gram[added]
    system[:, width:, width:] = gram[dropped] - np.eye(width)
    system[:, :width, width:] = mixed
    system[:, width:, :width] = mixed.transpose(0, 2, 1)
    changed = np.concatenate([rows[added], rows[dropped]], axis=1)
    factors = np.linalg.solve(system, residuals[changed][..., None])
    # x' = x + (V_s R^-T)' times the factors
    coefficients[safe] = x + np.matmul(factors.transpose(0, 2, 1), row_solutions[changed])[:, 0]
    return coefficients, violation


def _rows_of(feature: IntArray, n: int) -> IntArray:
    """Return the rows of each of n features, and of one without any, shape (n + 1, r).

    r is the most rows of a feature; the others are filled up with the number m, one past the last
    row.
    """
    number = np.bincount(feature, minlength=n + 1)
    order = np.argsort(feature, kind="stable")
    filled = np.arange(number.max(initial=1)) < number[:, None]
    rows = np.full(filled.shape, len(feature))
    rows[filled] = order
    return rows


def _reference_solution(
        equations: Equations, start: BoolArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None:
    """Return x, V, V R^-T and r of a selection, of all rows and a last one of zeros.

    V = A R^-1 and r = b - A x, for the factor R of the rows in use. None where the selection does
    not clearly determine x, or kernels are as fast.
    """
    A, b = equations.with_prior()
    used = np.ones(len(b), dtype=bool)
    used[:len(equations.feature)] = start[equations.feature]
    m = int(used.sum())
    k = A.shape[1]
    if m < k or m * k * k < MIN_WORK:
        return None
    q, r = np.linalg.qr(A[used])
    if (np.abs(np.diag(r)) <= _DETERMINED * np.linalg.norm(A, axis=0)).any():
        return None
    x = np.linalg.solve(r, q.T @ b[used])
    # The last row, of zeros, stands for the rows that features of fewer rows lack.
    A = np.concatenate([equations.A, np.zeros((1, k))])
    b = np.append(equations.b, 0.0)
    V = np.linalg.solve(r.T, A.T)
    return x, V.T, np.linalg.solve(r, V).T, b - A @ x


def _least_remaining_shares(gram: FloatArray, start: BoolArray) -> FloatArray:
    """Return the least share of its rows' weight that a feature leaves to others, (n + 1,).

    It is 1 for features that are not in use, and for the last, which has no rows.
    """
    shares = np.ones(len(gram))
    shares[:-1][start] = 1.0 - np.linalg.eigvalsh(gram[:-1][start])[:, -1]
    return shares
