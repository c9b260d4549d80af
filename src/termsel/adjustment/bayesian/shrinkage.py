"""Solutions of least squares with shrunken columns, for many scales and sizes at once.

With the free columns taken out, and the others multiplied by their scales, M is what remains. The
solution of a size s leaves (I + s^2 M M')^-1 of what is measured. A group is one set of scales, a
solution a group and a size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from termsel.adjustment.bayesian.bidiagonal import Bidiagonal, BidiagonalSolutions, bidiagonal_forms
from termsel.adjustment.compiled import compile_lazily
from termsel.adjustment.solve import TOLERANCE
from termsel.data.features import FloatArray, IntArray

# Nothing is allocated, and sums are taken in the order in which they are written.
_compiled = partial(compile_lazily, _nrt=False)

# Orthogonal columns of tall matrices.

MIN_ROWS_PER_COLUMN, MIN_COLUMNS = 4, 64
"""Rows for each column, and columns, from which products of matrices are faster."""

MANY_ROWS = 4096
"""Rows from which on they are faster whatever the number of columns."""

CORRECTABLE = 1e-2
"""How far the products of orthogonal columns may be from 0 and 1 for one correction to reach
rounding error: it squares this distance to begin with, and is exact by its own Cholesky factor."""


def orthogonal_factors(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Q and R of a matrix, as `numpy.linalg.qr` does, up to signs.

    Of tall matrices by Cholesky's method, twice: the first Q has an error of the square of the
    condition, which the second factor takes away (Yamamoto, Nakatsukasa, Yanagisawa and Fukaya
    2015, Electron. Trans. Numer. Anal. 44). Where the first is not nearly orthogonal, by
    Householder's method. The columns (n, k) may have any rank; Q is (n, min(n, k)), R (min(n, k),
    k).
    """
    n, k = columns.shape
    # The product of both triangles is that of the columns; the second Q is orthogonal to rounding.
    if n >= MIN_ROWS_PER_COLUMN * k and (k >= MIN_COLUMNS or n >= MANY_ROWS):
        first = _qr_by_cholesky(columns)
        if first is not None:
            q, r, _ = first
            second = _qr_by_cholesky(q)
            if second is not None and second[2] <= CORRECTABLE:
                return second[0], second[1] @ r
    q, r = np.linalg.qr(columns)
    return q, r


def _qr_by_cholesky(columns: FloatArray) -> tuple[FloatArray, FloatArray, float] | None:
    """Return Q and R, and the largest entry of |A'A - I|; None without an R that has an inverse.

    A are the columns (m, k). Q has their shape, and R is (k, k).
    """
    gram = columns.T @ columns
    departure = float(np.abs(gram - np.eye(len(gram))).max())
    try:
        r = np.asarray(np.linalg.cholesky(gram).T, dtype=np.float64)
        # A'A = R'R, and so Q = A R^-1 is orthogonal. SciPy's products of triangles take no less
        # time, and 0.2 s to import.
        return columns @ np.linalg.inv(r), r, departure
    except np.linalg.LinAlgError:
        return None


PointSelection = slice | IntArray
"""Which points."""

MIN_REDUNDANCY = 1e-14
"""What is left of 1 by rounding error."""

CANCELLATION = 1e-8
"""What remains of a number where rounding errors of a difference matter."""

@dataclass(frozen=True, eq=False)
class Design:
    """The design matrix of one axis of n points: f columns that are free, k that are shrunken.

    The shrunken columns stand in an orthonormal basis of m directions that no free column explains,
    so that free coefficients take no part in what follows. A group is one of g sets of scales.
    """

    basis: FloatArray  # (n, m): what some column, and no free one, explains
    # (n, l): what the columns explain, free ones with them; the rest is left by every solution.
    explained: FloatArray
    shrunken: FloatArray  # (m, k): the shrunken columns in the basis
    scales: FloatArray  # (g, k): of their coefficients for size 1
    free_triangle: FloatArray  # (f, f): R of the free columns, Q R
    free_projections: FloatArray  # (f, k): what the shrunken columns have in common with them
    n_own: int  # shrunken columns after which all have one scale in each group
    # U, shape (m, m), and S, shape (m,), of all shrunken columns but the first few, bare; U is
    # complete: the few columns are not within the span of the others. None where there are none.
    shared_decomposition: tuple[FloatArray, FloatArray] | None = None

    @cached_property
    def unexplained_share(self) -> FloatArray:
        """The share of each point that no column explains, 0 to 1, shape (n,)."""
        if self.explained.shape[1] == len(self.explained):
            return np.zeros(len(self.explained))
        return np.asarray(np.maximum(1.0 - (self.explained**2).sum(axis=1), 0.0))

    @cached_property
    def forms(self) -> Bidiagonal:
        """The bidiagonal forms of the shrunken columns under the scales of each group."""
        return bidiagonal_forms(self.shrunken, self.scales)

    def unexplained_part(self, target: FloatArray) -> FloatArray:
        """Return the part of a target (n,) that no column explains, (n,).

        It is computed apart, so that nothing cancels where noise tends to 0.
        """
        if self.explained.shape[1] == len(target):
            return np.zeros_like(target)
        return np.asarray(target - self.explained @ (self.explained.T @ target))


def designs_of(free_columns: FloatArray, shrunken: FloatArray, scales: FloatArray,
               n_own: int) -> list[Design] | None:
    """Return designs; None if the rows without some one of them do not determine the free columns.

    The designs have the same free columns (n, f), which are not shrunken, and each has its own
    shrunken columns, (d, n, k); the scales are (g, k). After the first `n_own` shrunken columns all
    have one scale in each group; `n_own` is k if no columns share a scale.
    """
    n, f = free_columns.shape
    k = shrunken.shape[2]
    # Without one row the others must still determine the free columns.
    if n <= f:
        return None
    if n <= f + k:  # all of space is explained, whatever the shrunken columns
        q, r = np.linalg.qr(free_columns, mode="complete")
        factors = [(q, r[:f], projections) for projections in q.T @ shrunken]
    else:  # free columns first: q of the others is then without them
        factors = []
        for columns in shrunken:
            q, r = orthogonal_factors(np.concatenate([free_columns, columns], axis=1))
            factors.append((q, r[:f, :f], r[:, f:]))
    q, triangle, _ = factors[0]
    if ((np.abs(np.diag(triangle)) <= TOLERANCE * np.linalg.norm(free_columns, axis=0)).any()
            or (1.0 - (q[:, :f]**2).sum(axis=1)).min() < TOLERANCE):
        return None
    in_basis = np.array([projections[f:] for *_, projections in factors])
    # Left singular vectors U and singular values S of the shared columns C: C C' = U S^2 U'.
    decompositions: list[tuple[FloatArray, FloatArray] | None] = [None] * len(factors)
    if n_own != k:
        shared = in_basis[:, :, n_own:]
        squares, u = np.linalg.eigh(shared @ shared.swapaxes(1, 2))
        decompositions = list(zip(u, np.sqrt(np.maximum(squares, 0.0)), strict=True))
    return [Design(q[:, f:], q, columns, scales, triangle, projections[:f], n_own, decomposition)
            for (q, triangle, projections), columns, decomposition in zip(
                factors, in_basis, decompositions, strict=True)]


@dataclass(frozen=True, eq=False)
class AxisSolutions:
    """The u solutions of one axis: each the coefficients by one group of scales and one size.

    Coefficients are in scaled image units by scaled ground units; residuals are weighted.
    """

    solution_of_cell: IntArray  # (c,): that of each cell of the posterior
    effective: FloatArray  # (u,): effective parameters
    coefficients: FloatArray  # (u, k): the shrunken ones
    free: FloatArray  # (f,): what is measured along the free columns
    # Of some of the points, 1 minus the leverage and what the fit leaves, (u, m) each: solutions
    # are hundreds, which times all points may be more than the memory holds.
    redundancies: Callable[[PointSelection], FloatArray]
    errors: Callable[[PointSelection], FloatArray]


class Shrinkage:
    """What solutions do, whatever is measured, by one bidiagonal form for each group.

    Group and size (u,) are numbers, of each solution, in order; `sizes` are all there are.
    """

    def __init__(self, design: Design, group: IntArray, size: IntArray, sizes: FloatArray) -> None:
        self._design = design
        squared_sizes = sizes[size] ** 2
        self._solutions = BidiagonalSolutions(design.forms, group, squared_sizes)
        # With the scales D and M = C D the coefficients are s^2 D M' (I + s^2 M M')^-1 y.
        self._squared_scales = squared_sizes[:, None] * design.scales[group] ** 2

    def redundancies(self, points: PointSelection) -> FloatArray:
        """Return 1 minus the leverage of points, shape (u, n)."""
        design = self._design
        directions = np.ascontiguousarray(design.basis[points].T)
        redundancies = self._solutions.redundancies(directions)
        redundancies += design.unexplained_share[points]
        return np.maximum(redundancies, MIN_REDUNDANCY, out=redundancies)

    def solutions(self, target: FloatArray, solution_of_cell: IntArray) -> AxisSolutions:
        """Return the solutions for the measurements of one axis, `target` (n,).

        `solution_of_cell` (c,) is the solution of each cell of the posterior.
        """
        design = self._design
        residuals = self._solutions.residuals(design.basis.T @ target)
        unexplained = design.unexplained_part(target)
        # x = T X'v, with the residuals v and the prior covariance T of the coefficients, relative
        # to the variance of the noise.
        coefficients = (residuals @ design.shrunken) * self._squared_scales
        return AxisSolutions(
            solution_of_cell, design.explained.shape[1] - self._solutions.traces, coefficients,
            design.explained[:, :len(design.free_triangle)].T @ target, self.redundancies,
            lambda points: np.asarray(residuals @ design.basis[points].T + unexplained[points]))


class SharedShrinkage:
    """What `Shrinkage` is, by one decomposition for all groups: that of the columns of one scale.

    With W what a size leaves along it, and the few other columns C by their scales, a solution
    leaves W - W C (I + C'W C)^-1 C'W of what is measured.

    It takes what `Shrinkage` takes; the design has few columns of scales of their own.
    """

    def __init__(self, design: Design, group: IntArray, size: IntArray, sizes: FloatArray) -> None:
        """Compute W and the factors of I + C'W C, for u solutions of a group and a size each."""
        n_own = design.n_own
        self._design = design
        self._column_scales = sizes[size, None] * design.scales[group]
        assert design.shared_decomposition is not None
        u, values = design.shared_decomposition
        self._shared_vt = u.T @ design.shrunken[:, n_own:]                              # S V'
        # In what follows solutions stand side by side, last: each step is one for all of them.
        # W, (m, u).
        self._shrink = 1.0 / (
            1.0 + np.multiply.outer(values, self._column_scales[:, n_own]) ** 2)
        own_columns = np.ascontiguousarray(design.shrunken[:, :n_own].T @ u)              # (f, m)
        count = len(group)
        # L and L^-1 C'W, of I + C'W C = L L'.
        self._triangle = np.empty((n_own, n_own, count))
        self._correction = np.empty((*own_columns.shape, count))
        _factor_own_columns(own_columns, np.ascontiguousarray(self._column_scales[:, :n_own].T),
                            self._shrink, self._triangle, self._correction)
        self._directions = u.T @ design.basis.T                                           # (m, n)

    @cached_property
    def all_redundancies(self) -> FloatArray | None:
        """1 minus the leverage of each point, shape (u, n); None where rounding errors matter."""
        # Diagonal of W less that of W C (I + C'W C)^-1 C'W, of which hardly anything may remain.
        shared_part = (self._directions**2).T @ self._shrink
        shared_part += self._design.unexplained_share[:, None]
        correction = self._directions.T @ self._correction                            # (f, n, u)
        correction *= correction
        redundancies = shared_part - correction.sum(axis=0)
        if (redundancies <= CANCELLATION * shared_part).any():
            return None
        return np.asarray(np.maximum(redundancies.T, MIN_REDUNDANCY, order="C"))

    def solutions(self, target: FloatArray, solution_of_cell: IntArray) -> AxisSolutions:
        """Return the solutions for the measurements of one axis, `target` (n,).

        They are those of `Shrinkage.solutions`, by the equation of the class: W y less W C (I + C'W
        C)^-1 C'W y, with the inverse from its Cholesky factor. All solutions are computed at once.
        """
        design = self._design
        redundancies = self.all_redundancies
        assert redundancies is not None
        n_own = design.n_own
        # In the directions of the decomposition W is diagonal: W y, less what C explains of it.
        projections = self._directions @ target
        mixed = projections @ self._correction                                           # (f, u)
        shrunken_projections = (self._shrink * projections[:, None] - np.einsum(
            "fu,fmu->mu", mixed, self._correction)).T
        _solve_transposed(self._triangle, mixed)
        coefficients = self._column_scales.copy()
        coefficients[:, :n_own] *= mixed.T
        coefficients[:, n_own:] *= self._column_scales[:, n_own:n_own + 1] * (
            shrunken_projections @ self._shared_vt)
        effective = (design.explained.shape[1] - self._shrink.sum(axis=0)
                     + np.einsum("fmu,fmu->u", self._correction, self._correction))
        errors = shrunken_projections @ self._directions + design.unexplained_part(target)
        return AxisSolutions(solution_of_cell, effective, coefficients,
                             design.explained[:, :len(design.free_triangle)].T @ target,
                             lambda points: redundancies[:, points],
                             lambda points: errors[:, points])


@_compiled
def _factor_own_columns(columns: FloatArray, scales: FloatArray, shrink: FloatArray,
                        triangle: FloatArray, correction: FloatArray) -> None:
    """Fill in L, `triangle` (f, f, u), and L^-1 C'W, `correction` (f, m, u), of u solutions.

    L L' = I + C'W C. The columns of C are those of `columns` (f, m) by `scales` (f, u); W is the
    diagonal `shrink` (m, u).
    """
    f, m = columns.shape
    lanes = scales.shape[1]
    # Row i of C'W first, then Cholesky's row i of I + C'W C.
    for i in range(f):
        for j in range(m):
            for u in range(lanes):
                correction[i, j, u] = scales[i, u] * columns[i, j] * shrink[j, u]
        for k in range(i + 1):
            entry = triangle[i, k]
            entry[:] = 0.0
            for j in range(m):
                for u in range(lanes):
                    entry[u] += correction[i, j, u] * columns[k, j]
            for u in range(lanes):
                entry[u] = entry[u] * scales[k, u] + (1.0 if i == k else 0.0)
            for j in range(k):
                for u in range(lanes):
                    entry[u] -= triangle[i, j, u] * triangle[k, j, u]
            for u in range(lanes):
                entry[u] = np.sqrt(entry[u]) if i == k else entry[u] / triangle[k, k, u]
    # L^-1 C'W: a row of C'W less what the rows above have in common with it.
    for i in range(f):
        for k in range(i):
            for j in range(m):
                for u in range(lanes):
                    correction[i, j, u] -= triangle[i, k, u] * correction[k, j, u]
        for j in range(m):
            for u in range(lanes):
                correction[i, j, u] /= triangle[i, i, u]


@_compiled
def _solve_transposed(triangle: FloatArray, right: FloatArray) -> None:
    """Solve L'x = `right` (f, u), which x takes the place of; L is `triangle` (f, f, u)."""
    f, lanes = right.shape
    for i in range(f - 1, -1, -1):
        for j in range(i + 1, f):
            for u in range(lanes):
                right[i, u] -= triangle[j, i, u] * right[j, u]
        for u in range(lanes):
            right[i, u] /= triangle[i, i, u]


def shrinkage_of(design: Design, group: IntArray, size: IntArray,
                 sizes: FloatArray) -> Shrinkage | SharedShrinkage:
    """Return the shrunken solutions of a design; the arguments are those of `Shrinkage`.

    All groups share one decomposition where the design and rounding errors allow it, which is fast.
    """
    if design.shared_decomposition is not None:
        shared = SharedShrinkage(design, group, size, sizes)
        if shared.all_redundancies is not None:
            return shared
    return Shrinkage(design, group, size, sizes)
