"""Leave-one-out solutions, from a single orthogonal factorisation each.

With A = Q R the solution that holds out feature i, whose rows are A_i and b_i, is

    x_(i) = x - R^-1 Q_i' (I - Q_i Q_i')^-1 (b_i - A_i x),

and all features together cost about as much as a second factorisation. The leverages
Q_i Q_i' come from Householder's Q, whose columns are orthogonal to rounding error whatever
the condition of A.

References
----------
Allen 1974, Technometrics 16(1): the prediction sum of squares. Cook and Weisberg 1982, Residuals
and Influence in Regression, ch. 2: solutions that hold out one row, or several together.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from termsel.adjustment.compiled import compile_lazily
from termsel.adjustment.equations import Equations, row_axes
from termsel.adjustment.kernels import solve_many
from termsel.adjustment.nearby import solve_near
from termsel.adjustment.reflections import LANES, apply_one
from termsel.adjustment.solve import TOLERANCE
from termsel.data.features import BoolArray, FloatArray, IntArray

KERNEL_MIN_ROWS = 1000
"""Rows of a single system up to which its kernel is not worth its compilation."""

Reflections = tuple[FloatArray, FloatArray, FloatArray]
"""Of the reflections: vectors, factors, and space that single reflections do not need."""

# Without _nrt=False every slice would cost two atomic operations; hence nothing may be allocated.
# Sums are taken in one order, whatever the width of the machine's registers.
_compiled = partial(compile_lazily, _nrt=False)


@_compiled
def _triangularise(panels: FloatArray, q: FloatArray, n: int, m: int, reflections: Reflections,
                   tolerance: float) -> bool:
    """Triangularise n columns of A, and b after them, in place; False if they are dependent.

    Columns lie in panels, m rows each. `q` becomes the same panels of [Q, b - A x]. A column is
    dependent if at most `tolerance` of its length is orthogonal to the columns before it.
    """
    vectors, beta, _ = reflections
    last = n // LANES
    for j in range(n):
        column = panels[j // LANES, :m, j % LANES]
        v = vectors[j, j:m]
        square = 0.0
        for i in range(len(v)):
            v[i] = column[j + i]
            square += v[i] ** 2
        norm = np.sqrt(square)
        # Reflections preserve a column's length, so that it is still known.
        for i in range(j):
            square += column[i] ** 2
        if norm <= tolerance * np.sqrt(square):
            return False
        # Away from v[0], so that nothing cancels.
        if v[0] > 0.0:
            norm = -norm
        v[0] -= norm
        beta[j] = -1.0 / (norm * v[0])
        for c in range(j // LANES, last + 1):
            apply_one(panels, reflections, c, j, m)
        column[j] = norm
    for c in range(last + 1):
        for i in range(m):
            for lane in range(LANES):
                q[c, i, lane] = 1.0 if LANES * c + lane == i else 0.0
    # Q'b without its first n entries, turned back by Q, is b - A x.
    for i in range(m):
        q[last, i, n % LANES] = panels[last, i, n % LANES] if i >= n else 0.0
    # Q = H_1 ... H_n of the identity, the last one first: reflection j does not reach the columns
    # of the identity before j.
    for j in range(n - 1, -1, -1):
        for c in range(j // LANES, last + 1):
            apply_one(q, reflections, c, j, m)
    return True


@_compiled
def _errors_without_feature(q: FloatArray, n: int, start: int, stop: int, block: FloatArray,
                            tolerance: float) -> bool:
    """Multiply a feature's errors b_i - A_i x by (I - Q_i Q_i')^-1; return whether that exists.

    `q` (k + 1, m) has the columns of Q, and in row n the errors; the feature has its columns from
    `start` to `stop`, and its errors are replaced. The matrix is factored by Cholesky's method in
    `block`.
    """
    # Row i of L in I - Q_i Q_i' = L L', and of L y = errors along with it.
    for i in range(start, stop):
        for j in range(start, i + 1):
            value = 1.0 if i == j else 0.0
            for s in range(n):
                value -= q[s, i] * q[s, j]
            for s in range(j - start):
                value -= block[i - start, s] * block[j - start, s]
            if i > j:
                block[i - start, j - start] = value / block[j - start, j - start]
                q[n, i] -= block[i - start, j - start] * q[n, j]
            elif value <= tolerance:  # the others do not determine the terms
                return False
            else:
                block[i - start, i - start] = np.sqrt(value)
        q[n, i] /= block[i - start, i - start]
    # L'x = y, backwards.
    for i in range(stop - 1, start - 1, -1):
        for j in range(i + 1, stop):
            q[n, i] -= block[j - start, i - start] * q[n, j]
        q[n, i] /= block[i - start, i - start]
    return True


@_compiled
def _leave_out(
    source: FloatArray, first: IntArray, terms: BoolArray, features: BoolArray, tolerance: float,
    panels: tuple[FloatArray, FloatArray], reflections: Reflections, space: tuple[FloatArray, ...],
    index: tuple[IntArray, IntArray, IntArray], solutions: FloatArray, determined: BoolArray,
) -> None:
    """Solve a population of systems, each with every one of its features left out in turn.

    Feature i has the rows A_i of A = Q R, and Q_i are its rows of Q. Without it the solution is x -
    R^-1 Q_i' (I - Q_i Q_i')^-1 (b_i - A_i x), so that one factorisation of all rows gives the n
    solutions. `_errors_without_feature` replaces columns and residuals of a feature by their
    products with the inverse's factor.

    Parameters
    ----------
    source : [A, b] of all features and terms, shape (rows, k + 1)
    first : the rows of feature f begin at first[f]
    terms, features : those in use, (p, k) and (p, n)
    tolerance : pivots below it, relative to the column, show that terms are not determined
    panels, reflections, space, index : work space, so that nothing is allocated in the loop
    solutions : receives x without each feature, (n, p, k)
    determined : receives whether the terms are determined without any feature, (p,)
    """
    columns, right, block = space
    selected_terms, selected_features, start = index
    r, q = panels
    k = terms.shape[1]
    for individual in range(len(terms)):
        n, m, count = 0, 0, 0
        for c in range(k):
            if terms[individual, c]:
                selected_terms[n] = c
                n += 1
        selected_terms[n] = k
        for f in range(features.shape[1]):
            if features[individual, f]:
                selected_features[count] = f
                start[count] = m
                for i in range(first[f], first[f + 1]):
                    for s in range(n + 1):
                        r[s // LANES, m, s % LANES] = source[i, selected_terms[s]]
                    m += 1
                count += 1
        start[count] = m
        # The last feature may be that of pseudo-observations, which is never held out.
        if count and selected_features[count - 1] == len(solutions):
            count -= 1
        determined[individual] = n < m and _triangularise(r, q, n, m, reflections, tolerance)
        if not determined[individual]:
            continue
        for s in range(n + 1):  # one column after the other
            for i in range(m):
                columns[s, i] = q[s // LANES, i, s % LANES]
        for g in range(count):
            determined[individual] = determined[individual] and _errors_without_feature(
                columns, n, start[g], start[g + 1], block, tolerance)
        if not determined[individual]:
            continue
        # Right-hand sides of the triangle: one per feature, and at the end that of the solution.
        for s in range(n - 1, -1, -1):
            for g in range(count):  # Q_i' (I - Q_i Q_i')^-1 (b_i - A_i x)
                total = 0.0
                for i in range(start[g], start[g + 1]):
                    total += columns[s, i] * columns[n, i]
                right[s, g] = total
            right[s, count] = r[n // LANES, s, n % LANES]
            # Back substitution of all right-hand sides at once.
            for t in range(s + 1, n):
                entry = r[t // LANES, s, t % LANES]
                for g in range(count + 1):
                    right[s, g] -= entry * right[t, g]
            for g in range(count + 1):
                right[s, g] /= r[s // LANES, s, s % LANES]
        for g in range(count):
            for s in range(n):
                # x less the change by the feature, which went through the same triangle.
                held_out = right[s, count] - right[s, g]
                solutions[selected_features[g], individual, selected_terms[s]] = held_out


def leave_one_out(equations: Equations, terms: BoolArray, features: BoolArray,
                  ) -> tuple[FloatArray, BoolArray]:
    """Solve a population of masked least-squares systems, holding out one feature at a time.

    Terms (p, k) and features (p, n) are masks of what is selected. Returns the coefficients with
    each of the n features held out, (n, p, k), 0 where a term or that feature is not selected; and
    which individuals are determined, (p,). Others have dependent terms or an indispensable feature:
    I - Q_i Q_i' then has a pivot of `termsel.adjustment.solve.TOLERANCE` or less. Their solutions
    must not be used.
    """
    order = np.argsort(equations.feature, kind="stable")
    n = features.shape[1]
    # Where the rows of each feature begin, and after the last one where they end.
    first = np.searchsorted(equations.feature[order], np.arange(n + 1)).astype(np.intp)
    tallest = int(np.diff(first).max())
    A, b = equations.with_prior()
    m, k = A.shape
    # Pseudo-observations belong to one further feature, which is never held out.
    order = np.concatenate([order, np.arange(len(order), m)])
    source = np.ascontiguousarray(np.column_stack([A, b])[order])
    if m > len(equations.b):
        first = np.append(first, m)
        features = np.concatenate([features, np.ones((len(features), 1), dtype=bool)], axis=1)
    if len(terms) == 1 and m <= KERNEL_MIN_ROWS:
        return _leave_out_of_one(source, first, terms[0], features[0], n)
    panels = np.empty((2, k // LANES + 1, m, LANES))
    reflections = np.empty((k, m)), np.empty(k), np.empty(k)
    space = np.empty((k + 1, m)), np.empty((k, n + 1)), np.empty((tallest, tallest))
    index = np.empty(k + 1, np.intp), np.empty(n + 1, np.intp), np.empty(n + 2, np.intp)
    solutions = np.zeros((n, *terms.shape))
    determined = np.empty(len(terms), dtype=bool)
    _leave_out(source, first, np.ascontiguousarray(terms), features=np.ascontiguousarray(features),
               tolerance=TOLERANCE, panels=(panels[0], panels[1]), reflections=reflections,
               space=space, index=index, solutions=solutions, determined=determined)
    return solutions, determined


def _leave_out_of_one(source: FloatArray, first: IntArray, terms: BoolArray, features: BoolArray,
                      n: int) -> tuple[FloatArray, BoolArray]:
    """Solve one system with each of its features left out in turn, through LAPACK.

    For a single system it is faster than `_leave_out`, whose equations it has, and needs no
    compilation. `source` (rows, k + 1) is [A, b], `first` the first row of each feature, `terms`
    (k,) and `features` those in use; features from `n` on are pseudo-observations, which are never
    left out.

    Returns the solutions (n, 1, k), and whether the terms are determined without any feature, (1,).
    """
    selected_terms = np.flatnonzero(terms)
    selected_features = np.flatnonzero(features[:n])
    solutions = np.zeros((n, len(terms)))
    rows = np.flatnonzero(np.repeat(features, np.diff(first)))
    A = source[np.ix_(rows, selected_terms)]
    b = source[rows, -1]
    if_undetermined = solutions[:, None], np.zeros(1, dtype=bool)
    if len(selected_terms) >= len(rows):
        return if_undetermined
    q, r = np.linalg.qr(A)
    if (np.abs(np.diag(r)) <= TOLERANCE * np.linalg.norm(A, axis=0)).any():
        return if_undetermined
    projections = q.T @ b
    errors = b - q @ projections
    errors -= q @ (q.T @ errors)  # what rounding left along the columns
    row_counts = np.diff(first)[selected_features]
    starts = np.cumsum(row_counts) - row_counts
    right = np.zeros((len(selected_terms), len(row_counts)))
    for row_count in set(row_counts.tolist()):  # all features with so many rows at once
        same_count = np.flatnonzero(row_counts == row_count)
        feature_rows = starts[same_count, None] + np.arange(row_count)
        q_rows = q[feature_rows]
        redundancy = np.eye(row_count) - q_rows @ q_rows.swapaxes(1, 2)  # I - Q_i Q_i'
        # Pivots of an elimination without exchanges are those of Cholesky's method, squared.
        pivots = redundancy.copy()
        for j in range(row_count):
            # The other features then do not determine the terms.
            if (pivots[:, j, j] <= TOLERANCE).any():
                return if_undetermined
            pivots[:, j + 1:, j + 1:] -= (pivots[:, j + 1:, j, None] * pivots[:, None, j, j + 1:]
                                          / pivots[:, j, j, None, None])
        weighed = np.linalg.solve(redundancy, errors[feature_rows][..., None])
        right[:, same_count] = (q_rows.swapaxes(1, 2) @ weighed)[..., 0].T
    # x = R^-1 Q'b, and of each feature its change, which is added to x.
    change = np.linalg.solve(r, np.column_stack([projections, -right]))
    change[:, 1:] += change[:, :1]
    solutions[np.ix_(selected_features, selected_terms)] = change[:, 1:].T
    return solutions[:, None], np.ones(1, dtype=bool)


# Independent parts of a system: line and sample, unless an equation contains both.

@dataclass(frozen=True, eq=False)
class IndependentPart:
    """Terms that are determined together, apart from all others."""

    columns: BoolArray  # (k,): terms of the part
    equations: Equations  # over these terms alone


def independent_parts(equations: Equations, axis: IntArray) -> tuple[IndependentPart, ...]:
    """Return the parts of a system for line and for sample, or the system as one part.

    It is one part where a row or a term belongs to both axes. The axis of each term (k,) is 0 for
    line, 1 for sample, 2 for both.
    """
    # A control line has equations of both axes, and a shared denominator is a term of both.
    rows = row_axes(equations.A, axis)
    if (rows == 2).any() or (axis == 2).any():
        return (IndependentPart(np.ones(len(axis), dtype=bool), equations),)
    parts = []
    for image_axis in (0, 1):  # line, sample
        columns = axis == image_axis
        parts.append(IndependentPart(columns, equations.take(rows == image_axis, columns)))
    return tuple(parts)


def solve_parts(parts: tuple[IndependentPart, ...], terms: BoolArray, features: BoolArray | None,
                near: BoolArray | None = None) -> tuple[FloatArray, FloatArray]:
    """Solve each part for p individuals with their own terms (p, k) and features (p, n).

    `features` is None where all individuals use all of them. `near` (n,) is a selection of features
    from which each individual differs in few: its solution is corrected, instead of solving anew.
    All terms must be selected then, and `terms` is not read.

    Returns the coefficients (p, k), 0 where a term is not selected, and how many of the selected
    terms are not determined (p,).
    """
    coefficients = np.zeros(terms.shape)
    undetermined_terms = np.zeros(len(terms))
    # Parts share no coefficient: each is an adjustment of its own.
    for part in parts:
        if near is None or features is None:
            solution, undetermined = solve_many(part.equations, terms[:, part.columns], features)
        else:
            solution, undetermined = solve_near(part.equations, near, features)
        coefficients[:, part.columns] = solution
        undetermined_terms += undetermined
    return coefficients, undetermined_terms
