"""Kernels of thin-plate splines, around all points or around knots among many."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from termsel.data.features import FloatArray

GROUND_BATCH = 200
"""Places whose kernels are worked on together: what is read again stays in a cache."""

PRODUCTS_BATCH = 1000
"""Places whose columns are multiplied by each other together: the sum of products, which is large,
is then read few times."""

SPLINE_KNOTS = 1000
"""Most points that have a kernel each, and knots of more. As many for some of the points as for
all, lest what some predict look better than what all do."""

EIGENVALUE_JITTER = 1e-10
"""Part of the field's variance that is none: that of close points, or of affine functions."""


N_AFFINE = 3
"""Columns of an affine function in the plane."""


@dataclass(frozen=True, eq=False)
class Reflections:
    """The complete orthogonal matrix Q of a QR factorisation, as I - V T V'.

    That is the product of f Householder reflections I - tau v v' (Schreiber and Van Loan 1989). A
    product of Q and a matrix (n, n) takes n^2 f operations instead of n^3.
    """

    vectors: FloatArray  # (n, f): V
    triangle: FloatArray  # (f, f): T, upper triangular

    @classmethod
    def of(cls, columns: FloatArray) -> Reflections:
        """Return the orthogonal Q (n, n) of the QR decomposition of some columns (n, f)."""
        packed, factors = np.linalg.qr(columns, mode="raw")
        vectors = np.triu(packed, 1).T
        np.fill_diagonal(vectors, 1.0)
        triangle = np.diag(factors)
        for i in range(1, len(factors)):
            triangle[:i, i] = -factors[i] * (triangle[:i, :i] @ (vectors[:, :i].T @ vectors[:, i]))
        return cls(vectors, triangle)

    def __call__(self, matrix: FloatArray) -> FloatArray:
        """Return Q times a matrix (n, m)."""
        return np.asarray(matrix - self.vectors @ (self.triangle @ (self.vectors.T @ matrix)))

    def transposed(self, matrix: FloatArray) -> FloatArray:
        """Return Q' M of a matrix M (n, m), shape (n, m)."""
        return np.asarray(matrix - self.vectors @ (self.triangle.T @ (self.vectors.T @ matrix)))

    def from_right(self, matrix: FloatArray) -> FloatArray:
        """Return M Q of a matrix M (m, n), shape (m, n)."""
        return np.asarray(matrix - matrix @ self.vectors @ self.triangle @ self.vectors.T)


class SplineColumns:
    """The columns that span a field: kernels around all points, or around knots among many."""

    def __init__(self, positions: FloatArray, all_knots: bool) -> None:
        """Choose the knots: the points at `positions` (n, 2), or with many SPLINE_KNOTS of them.

        With `all_knots` every point is a knot, however many there are.
        """
        reduced = len(positions) > SPLINE_KNOTS and not all_knots
        self.knots = farthest_points(positions, SPLINE_KNOTS) if reduced else positions
        self._triangle = _inverse_triangle(self.knots) if reduced else None
        self.root: FloatArray | None = None  # B (k, c), see `spline_root`
        if self._triangle is not None:
            self.root = self._triangle.root
        elif reduced:
            self.root = spline_root(self.knots)
        # What an affine function fits of each column, which the columns then lack.
        self._affine_fit = np.zeros((3, 0))
        if self.root is not None:
            self._affine_fit = np.linalg.pinv(_affine_columns(self.knots)) @ (
                spline_kernel(self.knots, self.knots) @ self.root)

    def __call__(self, positions: FloatArray) -> FloatArray:
        """Return the columns (m, k) at places (m, 2)."""
        if self.root is None:
            return spline_kernel(positions, self.knots)
        # K B - P P_knots^+ K_knots B: kernels around the knots, without their affine part there.
        affine = _affine_columns(positions)
        kernels = spline_kernel(positions, self.knots)
        columns = kernels @ self.root if self._triangle is None else self._triangle.times(kernels)
        return np.asarray(columns - affine @ self._affine_fit)

    def times(self, positions: FloatArray, coefficients: FloatArray) -> FloatArray:
        """Return the columns at places times coefficients (k, a), shape (m, a)."""
        return self.combined(coefficients)(positions)

    def combined(self, coefficients: FloatArray) -> Callable[[FloatArray], FloatArray]:
        """Return a function from m places to their columns times `coefficients` (k, a), (m, a).

        Around knots they are first turned into coefficients of the kernels and of the affine
        functions that the columns lack: fewer operations than the columns of many places.
        """
        # The columns are K R - P F, with the kernels K around knots and the affine functions P, so
        # that times c they are K (R c) - P (F c).
        kernel_coefficients = coefficients
        affine_coefficients = np.zeros((N_AFFINE, coefficients.shape[1]))
        if self.root is not None:
            kernel_coefficients = self.root @ coefficients
            affine_coefficients = self._affine_fit @ coefficients

        def at(positions: FloatArray) -> FloatArray:
            values = np.empty((len(positions), coefficients.shape[1]))
            for batch in batches_of(len(positions)):
                values[batch] = spline_kernel(positions[batch], self.knots) @ kernel_coefficients
                values[batch] -= _affine_columns(positions[batch]) @ affine_coefficients
            return values

        return at

    def sums(self, positions: FloatArray, factors: FloatArray) -> FloatArray:
        """Return the transposed columns at places times factors (m, a) of them, shape (k, a)."""
        kernel_sums = np.zeros((len(self.knots), factors.shape[1]))
        for batch in batches_of(len(positions)):
            kernel_sums += spline_kernel(positions[batch], self.knots).T @ factors[batch]
        if self.root is None:
            return kernel_sums
        affine_sums = _affine_columns(positions).T @ factors
        return np.asarray(self.root.T @ kernel_sums - self._affine_fit.T @ affine_sums)

    def coefficients(self, positions: FloatArray, w: FloatArray) -> FloatArray:
        """Return the coefficients of the columns by the kernels' weights (n, 2) at the points."""
        return w if self.root is None else self.sums(positions, w)

    def variance(self, ground: FloatArray, columns: FloatArray, point_columns: FloatArray,
                 positions: FloatArray, smoothing: float, w: FloatArray) -> FloatArray:
        """Return the variance of the prediction, divided by the field's, at places (m, 2): (m,).

        `columns` (m, 3) are the affine columns at the places, `point_columns` (n, 3) those at the
        points, whose `positions` are (n, 2) and whose weights are `w` (n,). `smoothing` is the
        variance of the noise divided by the field's.
        """
        (n, f) = point_columns.shape
        field = self(ground)
        if self.root is None:
            # Universal kriging: the kernel at distance 0, which is 0, less right' system^-1 right.
            system = np.zeros((n + f, n + f))
            system[:n, :n] = spline_kernel(positions, positions) + np.diag(smoothing / w**2)
            system[:n, n:] = point_columns
            system[n:, :n] = point_columns.T
            right = np.concatenate([field, columns], axis=1)
            return np.asarray(-(right * np.linalg.solve(system, right.T).T).sum(axis=1))
        rows = np.concatenate([columns, field], axis=1)
        normal = np.diag(np.r_[np.zeros(f), np.full(field.shape[1], smoothing)])
        for batch in batches_of(n):
            rows_of_points = np.concatenate(
                [point_columns[batch], self(positions[batch])], axis=1) * w[batch, None]
            normal += rows_of_points.T @ rows_of_points
        # Between the knots the field has a variance that their kernels do not span.
        unspanned = residual_variance(ground, self.knots) - (field**2).sum(axis=1)
        return np.asarray(smoothing * (rows * np.linalg.solve(normal, rows.T).T).sum(axis=1)
                          + np.maximum(unspanned, 0.0))


def batches_of(n: int, size: int = GROUND_BATCH) -> list[slice]:
    """Return slices that cover n places, of at most `size` each; none if n is 0."""
    return [slice(start, start + size) for start in range(0, n, size)]


def _affine_columns(positions: FloatArray) -> FloatArray:
    """Return the columns of an affine function in the plane, 1, x and y, shape (n, 3)."""
    return np.column_stack([np.ones(len(positions)), positions])


def spline_kernel(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return r^2 log r of the distances r between places, shape (len(a), len(b))."""
    squares = squared_distances(a, b)
    # In place, as these are the largest arrays; 0 log 0 is 0.
    logs = np.where(squares > 0.0, squares, 1.0)
    np.log(logs, out=logs)
    squares *= logs
    squares /= 2
    return squares


def squared_distances(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the squared distances between places in the plane, shape (len(a), len(b))."""
    # That of scipy.spatial would be the only part of it that most runs import.
    square, across = (np.subtract.outer(a[:, i], b[:, i]) for i in range(2))
    square *= square
    square += np.square(across, out=across)
    return square


@dataclass(frozen=True, eq=False)
class SplineField:
    """The random field whose best prediction a spline is, of mean variance 1 at the knots.

    What an affine function explains of the field at the knots is taken out.
    """

    knots: FloatArray  # (k, 2)
    to_affine: FloatArray  # (3, k): from values at the knots to the affine function that fits them
    residual_maker: FloatArray  # (k, k): what that leaves of the values
    kernels: FloatArray  # (k, k): between the knots
    unit: float  # mean variance at the knots

    def covariances(self, positions: FloatArray) -> FloatArray:
        """Return covariances of places with the knots, shape (m, k)."""
        affine = _affine_columns(positions)
        residuals = spline_kernel(positions, self.knots) - affine @ (self.to_affine @ self.kernels)
        return np.asarray(residuals @ self.residual_maker / self.unit)

    def variances(self, positions: FloatArray) -> FloatArray:
        """Return variances of places, shape (m,)."""
        return residual_variance(positions, self.knots) / self.unit


def spline_field(knots: FloatArray) -> SplineField:
    """Return the field around knots (k, 2)."""
    return _cached_spline_field(knots.tobytes())


@lru_cache(maxsize=2)  # a field is asked for its covariances several times
def _cached_spline_field(coordinates: bytes) -> SplineField:
    """Return the field of knots, (k, 2), whose bytes are given, so that they can be a key."""
    knots = np.frombuffer(coordinates).reshape(-1, 2)
    affine = _affine_columns(knots)
    to_affine = np.asarray(np.linalg.pinv(affine), dtype=np.float64)
    # A spline has no variance of affine functions: they are projected out of its kernel.
    residual_maker = np.eye(len(knots)) - affine @ to_affine
    kernels = spline_kernel(knots, knots)
    unit = float(np.trace(residual_maker @ kernels) / len(knots))
    return SplineField(knots, to_affine, residual_maker, kernels, unit)


def residual_variance(positions: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the variance at places (n, 2) of the field less its affine fit at the knots, (n,)."""
    affine, knot_affine = (_affine_columns(one) for one in (positions, knots))
    fitted = affine @ np.linalg.pinv(knot_affine)
    return np.asarray((fitted * (fitted @ spline_kernel(knots, knots)
                                 - 2 * spline_kernel(positions, knots))).sum(axis=1))


@dataclass(frozen=True, eq=False)
class _InverseTriangle:
    """A root B = Q L'^-1 of the inverse of what affine functions leave of kernels around knots.

    Q (k, k - 3) is orthonormal, nothing affine is in it, and L L' = Q' K Q. A product of kernels
    (m, k) and B takes half the operations that it takes if B is any matrix.
    """

    reflections: Reflections
    inverse: FloatArray  # (c, c): L^-1, lower triangular
    root: FloatArray  # (k, c): B

    def times(self, kernels: FloatArray) -> FloatArray:
        """Return kernels (m, k) times B, shape (m, c)."""
        from scipy.linalg import blas  # which splines of fewer points need not import

        free = self.reflections.from_right(kernels)[:, N_AFFINE:]
        return np.asarray(blas.dtrmm(1.0, self.inverse, free.T, lower=1)).T


def _inverse_triangle(knots: FloatArray) -> _InverseTriangle | None:
    """Return a root of the inverse of what affine functions leave of the kernels around knots.

    It comes from Cholesky's factor (see `_InverseTriangle`). Returns None where rounding would
    show, as where some of the knots (k, 2) are close together.
    """
    kernels = spline_kernel(knots, knots)
    reflections = Reflections.of(_affine_columns(knots))
    free = reflections.from_right(reflections.transposed(kernels))[N_AFFINE:, N_AFFINE:]
    try:
        inverse = np.linalg.inv(np.linalg.cholesky(free))
    except np.linalg.LinAlgError:
        return None
    # No eigenvalue of what is left of the kernels is less than 1 / |L^-1|^2, the sum of squares.
    largest = max(float(np.linalg.norm(free)), float(np.abs(kernels).max()))
    if EIGENVALUE_JITTER * largest * (inverse**2).sum() >= 1.0:
        return None
    inverse = np.tril(inverse)
    rows = np.vstack([np.zeros((N_AFFINE, len(inverse))), inverse.T])
    return _InverseTriangle(reflections, np.asfortranarray(inverse), reflections(rows))


def spline_root(knots: FloatArray) -> FloatArray:
    """Return B (k, c): the kernels' coefficients B u have the spline's covariance if u is white."""
    affine = _affine_columns(knots)
    residual_maker = np.eye(len(knots)) - affine @ np.linalg.pinv(affine)
    kernels = spline_kernel(knots, knots)
    values, vectors = np.linalg.eigh(residual_maker @ kernels @ residual_maker)
    # What affine functions fit has no variance but rounding.
    spanned = values > EIGENVALUE_JITTER * max(values.max(), np.abs(kernels).max())
    return np.asarray(residual_maker @ (vectors[:, spanned] / np.sqrt(values[spanned])))


def farthest_points(positions: FloatArray, count: int) -> FloatArray:
    """Return `count` of the positions (n, 2), far apart, whatever their order; all of fewer."""
    if len(positions) <= count:
        return positions
    # From the place nearest to the middle, always the place farthest from those taken.
    chosen_indices = [int(np.argmin(np.linalg.norm(positions - positions.mean(axis=0), axis=1)))]
    columns = np.ascontiguousarray(positions.T)
    distances = np.full(len(positions), np.inf)
    while len(chosen_indices) < count:
        line, sample = columns - columns[:, chosen_indices[-1:]]
        distances = np.minimum(distances, line * line + sample * sample)
        chosen_indices.append(int(distances.argmax()))
    return positions[chosen_indices]
