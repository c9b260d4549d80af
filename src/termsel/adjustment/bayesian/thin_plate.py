"""Thin-plate splines of line and sample over a plane, with their smoothing chosen.

For places x_i and one axis the spline is an affine function and sum w_i r_i^2 log r_i, r_i the
distance to x_i. With K the kernel between the points, T their affine columns and M the inverse of
K + smoothing I on what T leaves (M T = 0), w = M y. Leaving a point out, its error is w_i / M_ii,
and with it each criterion is that of the others alone, so that the errors without each point are
those of the whole procedure, the choice of the smoothing included.

Of more than `kernels.KNOTS` points only so many that are far apart, the knots, span the field. K is
then F F^T, of what the affine function through the knots leaves of the kernels, and M has the
eigenvalue 1 / smoothing on what neither T nor F spans. Time is linear in the points.

References
----------
Duchon 1977; Wahba 1990, Spline Models for Observational Data, for both criteria; Craven and Wahba
1979 for generalised cross-validation; Wood 2011, J. R. Stat. Soc. B 73(1), for restricted maximum
likelihood (REML); Wood 2003, J. R. Stat. Soc. B 65(1), for splines of many points.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from termsel.adjustment.bayesian.kernels import (
    EIGENVALUE_JITTER,
    PRODUCTS_BATCH,
    Reflections,
    SplineColumns,
    batches_of,
)
from termsel.adjustment.equations import weights_of
from termsel.adjustment.solve import TOLERANCE
from termsel.data.features import FloatArray, Points
from termsel.data.monomials import evaluate_monomials, graded_exponents
from termsel.data.view import Measurements

AFFINE_EXPONENTS = graded_exponents(1, 2)

SMOOTHINGS = 10.0 ** np.arange(-8.0, 6.0, 0.1)
"""From where a spline interpolates to where it is an affine function; kernels are of places within
about [-1, 1]."""

NEARBY_SMOOTHINGS = 5
"""Smoothings to each side of the chosen one that a point may lead to, where there are knots:
one of so many hardly moves the choice."""


@dataclass(frozen=True, eq=False)
class AxisSpline:
    """The spline of one axis, and the errors of the splines without each point."""

    best: int  # which smoothing is chosen
    weights: FloatArray  # (n,): the kernels' weights
    diagonal: FloatArray  # (n,): the diagonal of M
    errors: FloatArray  # (n,): weighted, of each point by the others


@dataclass(frozen=True, eq=False)
class ThinPlates:
    """The splines of line and sample."""

    points: Points  # scaled
    units: tuple[float, float]  # by which X and Y are multiplied before distances are taken
    smoothings: FloatArray  # (s,): to choose from
    splines: tuple[AxisSpline, AxisSpline]  # of line and of sample
    field_columns: SplineColumns

    @property
    def smoothing(self) -> tuple[float, float]:
        """Smoothing of line and of sample."""
        line, sample = (float(self.smoothings[axis.best]) for axis in self.splines)
        return line, sample

    @property
    def errors(self) -> FloatArray:
        """Measured minus predicted of each point, by the other points, shape (n, 2)."""
        return np.stack([axis.errors for axis in self.splines], axis=1) / weights_of(self.points)

    @property
    def effective(self) -> float:
        """Effective parameters of line and sample together."""
        # The trace of I - smoothing M, which turns measurements into fitted values.
        total = 0.0
        for smoothing, spline in zip(self.smoothing, self.splines, strict=True):
            total += (1.0 - smoothing * spline.diagonal).sum()
        return float(total)

    def predict(self, ground: FloatArray) -> FloatArray:
        """Return line and sample of places, shape (m, 2)."""
        affine = evaluate_monomials(ground, AFFINE_EXPONENTS) @ self._affine_coefficients
        return np.asarray(affine + self._field_at(ground))

    def spread(self, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the variance (m, 2) of the prediction at places (m, 3), and (2,) of the noise.

        They are those of the random field whose best prediction the spline is.
        """
        variance = np.empty((len(ground), 2))
        noise = np.empty(2)
        point_columns = evaluate_monomials(self.points.ground, AFFINE_EXPONENTS)
        n, f = point_columns.shape
        columns = evaluate_monomials(ground, AFFINE_EXPONENTS)
        positions = ground[:, :2] * self.units
        for axis, (smoothing, spline, w) in enumerate(zip(
                self.smoothing, self.splines, weights_of(self.points).T, strict=True)):
            # y'M y / (n - f), with M the inverse covariance without what is affine: M y are the
            # weights of the kernels.
            field_variance = float(spline.weights @ (self.points.image[:, axis] * w)) / (n - f)
            relative_variance = self.field_columns.variance(
                positions, columns, point_columns, self._positions, smoothing, w
            )
            variance[:, axis] = field_variance * relative_variance
            noise[axis] = field_variance * smoothing
        return np.maximum(variance, 0.0), noise

    @cached_property
    def _positions(self) -> FloatArray:
        return np.asarray(self.points.ground[:, :2] * self.units)

    @cached_property
    def _coefficients(self) -> FloatArray:
        """Coefficients of the columns that span the field, shape (k, 2)."""
        w = np.stack([axis.weights for axis in self.splines], axis=1) * weights_of(self.points)
        return self.field_columns.coefficients(self._positions, w)

    def _field_at(self, ground: FloatArray) -> FloatArray:
        """Return the field at places, shape (m, 2)."""
        return self.field_columns.times(ground[:, :2] * self.units, self._coefficients)

    @cached_property
    def _affine_coefficients(self) -> FloatArray:
        """Coefficients of the affine functions, shape (3, 2)."""
        columns = evaluate_monomials(self.points.ground, AFFINE_EXPONENTS)
        local = self._field_at(self.points.ground)
        coefficients = np.empty((len(AFFINE_EXPONENTS), 2))
        for axis, (spline, smoothing, w) in enumerate(zip(
                self.splines, self.smoothing, weights_of(self.points).T, strict=True)):
            # What kernels and smoothing leave of the measurements is affine.
            residuals = w * (self.points.image[:, axis] - local[:, axis])
            residuals = residuals - smoothing * spline.weights
            coefficients[:, axis] = np.linalg.lstsq(columns * w[:, None], residuals)[0]
        return coefficients


def thin_plates(points: Points, units: tuple[float, float], smoothing: float | None,
                criterion: str) -> ThinPlates | None:
    """Return the thin-plate splines of control points, scaled.

    X and Y are multiplied by the units before distances are taken; of points with the same X and Y
    the spline takes a mean. Without a smoothing it is chosen for each axis by the criterion, "reml"
    or "gcv". Returns None if the points without some one of them do not determine an affine model
    with redundancy.
    """
    return _cached_splines(Measurements.of(points), units, smoothing, criterion)


@lru_cache(maxsize=4)  # a fit, its errors and its spread need them
def _cached_splines(measurements: Measurements, units: tuple[float, float],
                    smoothing: float | None, criterion: str) -> ThinPlates | None:
    """Return the splines of points, None as for `thin_plates`, whose other arguments these are.

    They are cached, since one fit asks for them many times.
    """
    points = measurements.points
    affine_columns = evaluate_monomials(points.ground, AFFINE_EXPONENTS)
    positions = points.ground[:, :2] * units
    field_columns = SplineColumns(positions, all_knots=smoothing == 0)
    smoothings = SMOOTHINGS if smoothing is None else np.array([smoothing])
    weights = weights_of(points)
    equal_weights = bool((weights[:, 0] == weights[:, 1]).all())
    axes: list[AxisSpline] = []
    # If line and sample have equal weights, one factorisation serves both; else each has its own.
    for columns in (slice(0, 2),) if equal_weights else (slice(0, 1), slice(1, 2)):
        w = weights[:, columns.start]
        basis = _eigenvectors_of_splines(affine_columns * w[:, None], positions, w, field_columns)
        if basis is None:
            return None
        axes += _axis_splines(basis, points.image[:, columns] * w[:, None], smoothings, criterion)
    return ThinPlates(points, units, smoothings, (axes[0], axes[1]), field_columns)


@dataclass(frozen=True, eq=False)
class _Basis:
    """Eigenvectors of the kernels on what affine functions leave."""

    values: FloatArray  # (k,)
    q: FloatArray  # (n, f): an orthonormal basis of the affine functions
    eigenvectors: Callable[[slice], FloatArray]  # (m, k): at some points
    # From vectors (n, a) that no affine function fits to what they are along the eigenvectors.
    along: Callable[[FloatArray], FloatArray]

    @property
    def n_null(self) -> int:
        """Dimensions in which the kernels are 0."""
        return int(len(self.q) - self.q.shape[1] - len(self.values))


def _eigenvectors_of_splines(lead: FloatArray, positions: FloatArray, weights: FloatArray,
                             field_columns: SplineColumns) -> _Basis | None:
    """Return the eigenvectors, or None if the points do not determine an affine function.

    `lead` (n, f) are the weighted affine columns of the points, at `positions` (n, 2) in units of
    the splines; `weights` (n,).
    """
    n, f = lead.shape
    if n < f + 2:
        return None
    q = np.linalg.qr(lead)[0]
    # A point of leverage 1 - the row of q has the length 1 - is indispensable.
    if (np.linalg.matrix_rank(lead, TOLERANCE) < f
            or (1.0 - (q**2).sum(axis=1)).min() < TOLERANCE):
        return None
    if field_columns.root is None:
        return _basis_of_all(lead, q, field_columns(positions) * np.outer(weights, weights))
    return _basis_of_knots(q, positions, weights, field_columns)


def _basis_of_all(lead: FloatArray, q: FloatArray, kernels: FloatArray) -> _Basis:
    """Return the eigenvectors where every point has a kernel (n, n)."""
    n, f = lead.shape
    # On what affine functions leave the kernels are positive: that is what the last n - f rows and
    # columns of Q' K Q are, of the complete Q.
    reflections = Reflections.of(lead)
    free = reflections.transposed(reflections.transposed(kernels).T)[f:, f:]
    values, vectors = np.linalg.eigh(free)
    u = reflections(np.vstack([np.zeros((f, n - f)), vectors]))
    # Rounding makes values of points at one place a little negative.
    positive_values = np.maximum(values, TOLERANCE**2 * values.max(initial=0.0))
    return _Basis(positive_values, q, lambda batch: np.asarray(u[batch]),
                  lambda vectors: np.asarray(u.T @ vectors))


def _basis_of_knots(q: FloatArray, positions: FloatArray, weights: FloatArray,
                    field_columns: SplineColumns) -> _Basis:
    """Return the eigenvectors where the columns around knots span the field.

    With F = W C - q q' W C, of the columns C and the weights W, they are F V / sqrt(values) of the
    eigenvectors V of F' F. What has few columns is never multiplied by C itself: its kernels take
    the coefficients (see `SplineColumns.combined`).
    """
    affine = field_columns.sums(positions, q * weights[:, None]).T  # q' W C, (f, c)
    products = np.zeros((affine.shape[1],) * 2)
    for batch in batches_of(len(q), PRODUCTS_BATCH):
        rows = field_columns(positions[batch]) * weights[batch, None] - q[batch] @ affine
        products += rows.T @ rows
    values, vectors = np.linalg.eigh(products)
    # The others are rounding, and would be divided by nearly 0.
    large = values > EIGENVALUE_JITTER * values.max()
    to_eigenvectors = vectors[:, large] / np.sqrt(values[large])

    columns_along = field_columns.combined(to_eigenvectors)
    affine_along = affine @ to_eigenvectors

    def eigenvectors(batch: slice) -> FloatArray:
        columns = columns_along(positions[batch]) * weights[batch, None]
        return np.asarray(columns - q[batch] @ affine_along)

    def along(free: FloatArray) -> FloatArray:
        return np.asarray(
            to_eigenvectors.T @ field_columns.sums(positions, free * weights[:, None]))

    return _Basis(values[large], q, eigenvectors, along)


def _axis_splines(basis: _Basis, targets: FloatArray, smoothings: FloatArray,
                  criterion: str) -> list[AxisSpline]:
    """Return the splines of several axes with the same weights, from weighted targets (n, axes).

    Of `smoothings` (s,) the one is taken that is best by `criterion`, for each axis.
    """
    free = targets - basis.q @ (basis.q.T @ targets)
    projections = basis.along(free)
    # What neither affine functions nor kernels span; there M is the identity by the smoothing.
    null_squares = np.zeros(targets.shape[1])
    if basis.n_null:
        null_squares = np.maximum((free**2).sum(axis=0) - (projections**2).sum(axis=0), 0.0)
    choices = []
    for along_axis, null_square in zip(projections.T, null_squares.tolist(), strict=True):
        choices.append(_choose_smoothing(basis, along_axis, null_square, smoothings, criterion))
    n = len(targets)
    axes = [AxisSpline(choice.best, np.empty(n), np.empty(n), np.empty(n)) for choice in choices]
    for batch in batches_of(n):
        eigenvectors = basis.eigenvectors(batch)
        null_diagonal = np.maximum(
            1.0 - (basis.q[batch]**2).sum(axis=1) - (eigenvectors**2).sum(axis=1), 0.0)
        null_part = free[batch] - eigenvectors @ projections
        for axis, choice, null_target in zip(axes, choices, null_part.T, strict=True):
            w, diagonal, criterion_without = choice.at(eigenvectors.T, null_diagonal, null_target,
                                                       n)
            best_without = criterion_without.argmin(axis=0)
            column = np.arange(len(eigenvectors))
            axis.weights[batch] = w[choice.index]
            axis.diagonal[batch] = diagonal[choice.index]
            axis.errors[batch] = w[best_without, column] / diagonal[best_without, column]
    return axes


@dataclass(frozen=True, eq=False)
class _Choice:
    """The smoothing of one axis, and those that it may be without a point."""

    best: int  # of all smoothings
    index: int  # of these here
    eigenvalues: FloatArray  # (s, k): the eigenvalues of M
    projections: FloatArray  # (k,): the measurements along the eigenvectors
    # (s, 1): the eigenvalue of M where kernels and affine functions are 0; 0 without such ones.
    null_eigenvalue: FloatArray
    square: FloatArray  # (s,): y' M y, or |M y|^2 for generalised cross-validation
    log: FloatArray  # (s,): the logarithm of 1 / |M|
    trace: FloatArray  # (s,)
    freedom: int
    reml: bool

    def at(self, eigenvectors: FloatArray, null_diagonal: FloatArray, null_target: FloatArray,
           n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return w, the diagonal of M and the criterion without each of some points, (s, m).

        Points are given by their rows of the eigenvectors (k, m) and what the null space adds: a
        diagonal (m,) and a target (m,). w_i / M_ii is the error of point i without it. The
        criterion, restricted likelihood or generalised cross-validation, is that of the smoothing s
        without the point, so that its own measurement does not choose how it is predicted.
        """
        w = ((self.eigenvalues * self.projections) @ eigenvectors
             + self.null_eigenvalue * null_target)
        diagonal = self.eigenvalues @ eigenvectors**2 + self.null_eigenvalue * null_diagonal
        if self.reml:
            # Without point i, y'M y is lower by w_i^2 / M_ii, and |M| by the factor M_ii.
            other_squares = np.maximum(self.square[:, None] - w**2 / diagonal,
                                       np.finfo(float).tiny)
            criterion = ((self.freedom - 1) * np.log(other_squares) + self.log[:, None]
                         + np.log(diagonal))
            return w, diagonal, criterion
        # M without a point is M less the product of its column by itself, over the diagonal.
        squared_diagonal = (self.eigenvalues**2 @ eigenvectors**2
                            + self.null_eigenvalue**2 * null_diagonal)
        squared_target = ((self.eigenvalues**2 * self.projections) @ eigenvectors
                          + self.null_eigenvalue**2 * null_target)
        ratio = w / diagonal
        other_squares = np.maximum(
            self.square[:, None] - 2 * ratio * squared_target + ratio**2 * squared_diagonal, 0.0)
        other_traces = self.trace[:, None] - squared_diagonal / diagonal
        return w, diagonal, (n - 1) * other_squares / other_traces**2


def _choose_smoothing(basis: _Basis, projections: FloatArray, null_squares: float,
                      smoothings: FloatArray, criterion: str) -> _Choice:
    """Return the best of `smoothings` (s,) by the criterion, "reml" or "gcv".

    `projections` (k,) are the target along the eigenvectors, and `null_squares` is the square of
    the remaining part of the target, which neither kernels nor affine functions span.
    """
    n, f = basis.q.shape
    eigenvalues = 1.0 / (basis.values + smoothings[:, None])                               # (s, k)
    null_eigenvalue = 1.0 / smoothings[:, None] if basis.n_null else np.zeros((len(smoothings), 1))
    log = -np.log(eigenvalues).sum(axis=1) + (
        basis.n_null * np.log(smoothings) if basis.n_null else 0.0)
    trace = eigenvalues.sum(axis=1) + basis.n_null * null_eigenvalue[:, 0]
    if criterion == "reml":
        square = (eigenvalues * projections**2).sum(axis=1) + null_eigenvalue[:, 0] * null_squares
        value = (n - f) * np.log(np.maximum(square, np.finfo(float).tiny)) + log
    else:  # n |M y|^2 / tr(M)^2
        square = ((eigenvalues * projections) ** 2).sum(axis=1)
        square = square + null_eigenvalue[:, 0] ** 2 * null_squares
        value = n * square / trace**2
    best = int(value.argmin())
    first = max(best - NEARBY_SMOOTHINGS, 0) if basis.n_null else 0
    nearby = slice(first, best + NEARBY_SMOOTHINGS + 1 if basis.n_null else None)
    return _Choice(best=best, index=best - first, eigenvalues=eigenvalues[nearby],
                   projections=projections, null_eigenvalue=null_eigenvalue[nearby],
                   square=square[nearby], log=log[nearby], trace=trace[nearby], freedom=n - f,
                   reml=criterion == "reml")
