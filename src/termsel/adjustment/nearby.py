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
    """Solve a population of systems whose features (p, n) differ little from a selection (n,).

    `features` and that selection, `start`, are masks. All terms are in use. Returns what
    `solve_many` does, but for rounding: the coefficients (p, k), and the number of terms that are
    not determined (p,).
    """
    rows = _padded_rows_of_features(equations.feature, len(start))
    reference = _reference_solution(equations, start) if rows.shape[1] <= MAX_FEATURE_ROWS else None
    if reference is None:
        return solve_many(equations, None, features)
    x, V, row_solutions, residuals = reference
    p, n = features.shape
    # The feature that each individual adds and drops; number n, without rows, for none.
    individual, changed_feature = np.divmod(np.flatnonzero(features != start), n)
    added, dropped = np.full((2, p), n)
    is_added = features[individual, changed_feature]
    added[individual[is_added]] = changed_feature[is_added]
    dropped[individual[~is_added]] = changed_feature[~is_added]
    changes = np.bincount(individual, minlength=p)
    # V_i V_i' of each feature. A correction is safe where there is no more than one feature added
    # and one dropped, and neither magnifies rounding too much.
    gram = V[rows] @ V[rows].transpose(0, 2, 1)
    largest = np.trace(gram, axis1=1, axis2=2)
    is_safe = ((np.where(added < n, 1, 0) + np.where(dropped < n, 1, 0) == changes)
               & (largest[added] <= SAFE_CONDITION)
               & (_least_remaining_shares(gram, start)[dropped] * SAFE_CONDITION >= 1.0))
    coefficients = np.empty((p, len(x)))
    undetermined = np.zeros(p, dtype=np.intp)
    if not is_safe.all():
        coefficients[~is_safe], undetermined[~is_safe] = solve_many(equations, None,
                                                                    features[~is_safe])
    added = added[is_safe]
    dropped = dropped[is_safe]
    width = rows.shape[1]
    mixed = np.matmul(V[rows[added]], V[rows[dropped]].transpose(0, 2, 1))
    # D + V_s V_s' of the rows added and dropped; rows of zeros keep the 1 and -1 of D.
    system = np.empty((len(added), 2 * width, 2 * width))
    system[:, :width, :width] = np.eye(width) + gram[added]
    system[:, width:, width:] = gram[dropped] - np.eye(width)
    system[:, :width, width:] = mixed
    system[:, width:, :width] = mixed.transpose(0, 2, 1)
    changed_rows = np.concatenate([rows[added], rows[dropped]], axis=1)
    factors = np.linalg.solve(system, residuals[changed_rows][..., None])
    # x' = x + (V_s R^-T)' times the factors
    corrections = np.matmul(factors.transpose(0, 2, 1), row_solutions[changed_rows])[:, 0]
    coefficients[is_safe] = x + corrections
    return coefficients, undetermined


def _padded_rows_of_features(feature: IntArray, n: int) -> IntArray:
    """Return the rows of each of n features, and of one more feature without rows, (n + 1, r).

    r is the largest number of rows that a feature has. A feature with fewer is filled up with m,
    the number after that of the last row. `feature` (m,) is the feature of each row.
    """
    row_counts = np.bincount(feature, minlength=n + 1)
    order = np.argsort(feature, kind="stable")
    is_row = np.arange(row_counts.max(initial=1)) < row_counts[:, None]
    rows = np.full(is_row.shape, len(feature))
    rows[is_row] = order
    return rows


def _reference_solution(
        equations: Equations, start: BoolArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None:
    """Return x (k,), V and V R^-T (m + 1, k), and r (m + 1,) of a selection of features (n,).

    R is the factor of the rows in use, V = A R^-1 and r = b - A x are those of all m rows, followed
    by a row of zeros. Returns None where the selection does not clearly determine x, or kernels are
    as fast.
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
    """Return how well a selection without each feature determines its rows, 0 to 1, (n + 1,).

    That is 1 less the largest eigenvalue of its leverage V_i V_i' (`gram`). It is 1 for features
    that are not in use, and for the last, which has no rows.
    """
    shares = np.ones(len(gram))
    shares[:-1][start] = 1.0 - np.linalg.eigvalsh(gram[:-1][start])[:, -1]
    return shares
