"""Thin-plate splines of line and sample over a plane, with their smoothing chosen.

For places x_i and one axis the spline is an affine function and sum w_i r_i^2 log r_i, r_i the
distance to x_i. With K the kernel between the points, T their affine columns and M the inverse of
K + smoothing I on what T leaves (M T = 0), w = M y. Leaving a point out, its error is w_i / M_ii,
and with it each criterion is that of the others alone, so that the errors without each point are
those of the whole procedure, the choice of the smoothing included.

References
----------
Duchon 1977; Wahba 1990, Spline Models for Observational Data, for both criteria; Craven and Wahba
1979 for generalised cross-validation; Wood 2011, J. R. Stat. Soc. B 73(1), for restricted maximum
likelihood (REML).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from termsel.adjustment.equations import weights_of
from termsel.adjustment.monomials import graded_exponents, monomials
from termsel.adjustment.solve import TOLERANCE
from termsel.measurements.features import FloatArray, IntArray, Points

PLANE = graded_exponents(1, 2)

SMOOTHINGS = 10.0 ** np.arange(-8.0, 6.0, 0.1)
"""From where a spline interpolates to where it is an affine function; kernels are of places within
about [-1, 1]."""


AT_ONCE = 2000
"""Places whose kernels are held in memory."""


@dataclass(frozen=True, eq=False)
class Axis:
    """The splines of one axis for each of s smoothings."""

    w: FloatArray  # (s, n): the kernels' weights
    own: FloatArray  # (s, n): the diagonal of M
    criterion: FloatArray  # (s,): of all points
    without: FloatArray  # (s, n): of all but each


@dataclass(frozen=True, eq=False)
class ThinPlates:
    """The splines of line and sample."""

    points: Points  # scaled
    units: tuple[float, float]  # by which X and Y are multiplied before distances are taken
    smoothings: FloatArray  # (s,): to choose from
    axes: tuple[Axis, Axis]  # of line and of sample

    @cached_property
    def chosen(self) -> IntArray:
        """Which smoothing line and sample have."""
        return np.array([axis.criterion.argmin() for axis in self.axes])

    @property
    def smoothing(self) -> tuple[float, float]:
        """Smoothing of line and of sample."""
        line, sample = self.smoothings[self.chosen].tolist()
        return line, sample

    @property
    def errors(self) -> FloatArray:
        """Measured minus predicted of each point by the others, shape (n, 2)."""
        each = np.arange(len(self.points))
        errors = []
        for axis in self.axes:
            best = axis.without.argmin(axis=0)
            errors.append(axis.w[best, each] / axis.own[best, each])
        return np.stack(errors, axis=1) / weights_of(self.points)

    @property
    def effective(self) -> float:
        """Effective parameters of line and sample together."""
        return float(sum((1.0 - smoothing * axis.own[best]).sum() for smoothing, axis, best in zip(
            self.smoothing, self.axes, self.chosen, strict=True)))

    def predict(self, ground: FloatArray) -> FloatArray:
        """Return line and sample of places, shape (m, 2)."""
        columns = monomials(ground, PLANE)
        image = columns @ self._affine
        weights = np.stack([one.w[best] for one, best in zip(self.axes, self.chosen, strict=True)],
                           axis=1) * weights_of(self.points)
        for start in range(0, len(ground), AT_ONCE):
            some = slice(start, start + AT_ONCE)
            image[some] += kernel(ground[some, :2] * self.units, self._places) @ weights
        return np.asarray(image)

    def spread(self, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the variance of the prediction, shape (m, 2), and that of the noise, (2,).

        That of the random field whose best prediction the spline is.
        """
        columns = monomials(ground, PLANE)
        kernels = kernel(ground[:, :2] * self.units, self._places)
        variance, noise = np.empty((len(ground), 2)), np.empty(2)
        lead = monomials(self.points.ground, PLANE)
        n, f = lead.shape
        for axis, (best, w) in enumerate(zip(self.chosen, weights_of(self.points).T,
                                             strict=True)):
            smoothing, one = self.smoothings[best], self.axes[axis]
            # Universal kriging: the kernel at distance 0, which is 0, less right' system^-1 right.
            system = np.zeros((n + f, n + f))
            system[:n, :n] = kernel(self._places, self._places) + np.diag(smoothing / w**2)
            system[:n, n:], system[n:, :n] = lead, lead.T
            right = np.concatenate([kernels, columns], axis=1)
            fields = float(one.w[best] @ (self.points.image[:, axis] * w)) / (n - f)
            variance[:, axis] = -fields * (right * np.linalg.solve(system, right.T).T).sum(axis=1)
            noise[axis] = fields * smoothing
        return np.maximum(variance, 0.0), noise

    @cached_property
    def _places(self) -> FloatArray:
        return np.asarray(self.points.ground[:, :2] * self.units)

    @cached_property
    def _affine(self) -> FloatArray:
        """Coefficients of the affine functions, shape (3, 2)."""
        columns, kernels = monomials(self.points.ground, PLANE), kernel(self._places, self._places)
        coefficients = np.empty((len(PLANE), 2))
        for axis, (one, best, smoothing, w) in enumerate(zip(
                self.axes, self.chosen, self.smoothing, weights_of(self.points).T, strict=True)):
            # What kernels and smoothing leave of the measurements is affine.
            rest = w * (self.points.image[:, axis] - kernels @ (w * one.w[best])) \
                - smoothing * one.w[best]
            coefficients[:, axis] = np.linalg.lstsq(columns * w[:, None], rest)[0]
        return coefficients


def thin_plates(points: Points, units: tuple[float, float], smoothing: float | None,
                criterion: str) -> ThinPlates | None:
    """Return the thin-plate splines of control points, scaled.

    X and Y are multiplied by the units before distances are taken; of points with the same X and Y
    the spline takes a mean. Without a smoothing it is chosen for each axis by the criterion, "reml"
    or "gcv". None if all points but any one do not determine an affine model with redundancy.
    """
    image, ground, sigma = (None if one is None else np.ascontiguousarray(one).tobytes()
                            for one in (points.image, points.ground, points.sigma))
    return _splines(image, ground, sigma, units, smoothing, criterion)


@lru_cache(maxsize=4)
def _splines(image: bytes, ground: bytes, sigma: bytes | None, units: tuple[float, float],
             smoothing: float | None, criterion: str) -> ThinPlates | None:
    """Return the splines of points; a fit asks for the same ones many times."""
    measured = np.frombuffer(image).reshape(-1, 2)
    points = Points(tuple(map(str, range(len(measured)))), measured,
                    np.frombuffer(ground).reshape(-1, 3),
                    None if sigma is None else np.frombuffer(sigma).reshape(-1, 2))
    columns = monomials(points.ground, PLANE)
    places = points.ground[:, :2] * units
    kernels = kernel(places, places)
    smoothings = SMOOTHINGS if smoothing is None else np.array([smoothing])
    weights = weights_of(points).T
    of_line = _basis(columns * weights[0][:, None], kernels * np.outer(weights[0], weights[0]))
    of_sample = of_line if (weights[0] == weights[1]).all() else _basis(
        columns * weights[1][:, None], kernels * np.outer(weights[1], weights[1]))
    if of_line is None or of_sample is None:
        return None
    line, sample = (_axis(basis, target, smoothings, criterion) for basis, target in zip(
        (of_line, of_sample), measured.T * weights, strict=True))
    return ThinPlates(points, units, smoothings, (line, sample))


def _basis(lead: FloatArray, kernels: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return eigenvalues and vectors of the kernels on what affine functions leave, or None."""
    n, f = lead.shape
    if n < f + 2:
        return None
    q = np.linalg.qr(lead, mode="complete")[0]
    if np.linalg.matrix_rank(lead, TOLERANCE) < f or \
            (1.0 - (q[:, :f] ** 2).sum(axis=1)).min() < TOLERANCE:
        return None
    rest = q[:, f:]  # what affine functions leave: the kernel is positive there alone
    values, u = np.linalg.eigh(rest.T @ kernels @ rest)
    u = rest @ u
    # Rounding makes values of points at one place a little negative.
    return np.maximum(values, TOLERANCE**2 * values.max(initial=0.0)), u


def _axis(basis: tuple[FloatArray, FloatArray], target: FloatArray, smoothings: FloatArray,
          criterion: str) -> Axis:
    (values, u), n = basis, len(target)
    below = 1.0 / (values + smoothings[:, None])                              # (s, n - f)
    along = u.T @ target
    w, own = (below * along) @ u.T, below @ (u**2).T
    freedom = len(values)
    if criterion == "reml":
        # Without point i, y'M y is lower by w_i^2 / M_ii, and |M| by the factor M_ii.
        square, log = (below * along**2).sum(axis=1), -np.log(below).sum(axis=1)
        others = np.maximum(square[:, None] - w**2 / own, np.finfo(float).tiny)
        return Axis(w, own, freedom * np.log(np.maximum(square, np.finfo(float).tiny)) + log,
                    (freedom - 1) * np.log(others) + log[:, None] + np.log(own))
    # n |M y|^2 / tr(M)^2
    square, trace = (w**2).sum(axis=1), below.sum(axis=1)
    # M without a point is M less the product of its column by itself, over the diagonal.
    twice, again = below**2 @ (u**2).T, (below**2 * along) @ u.T
    ratio = w / own
    others = np.maximum(square[:, None] - 2 * ratio * again + ratio**2 * twice, 0.0)
    return Axis(w, own, n * square / trace**2,
                (n - 1) * others / (trace[:, None] - twice / own) ** 2)


def kernel(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return r^2 log r of the distances r between places, shape (len(a), len(b))."""
    square = squared_distances(a, b)
    return np.asarray(square * np.log(np.where(square > 0.0, square, 1.0)) / 2)


def squared_distances(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the squared distances between places in the plane, shape (len(a), len(b))."""
    # That of scipy.spatial would be the only part of it that most runs import.
    square, across = (np.subtract.outer(a[:, i], b[:, i]) for i in range(2))
    square *= square
    square += np.square(across, out=across)
    return square
