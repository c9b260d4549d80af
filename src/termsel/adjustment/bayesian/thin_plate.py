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

from termsel.adjustment.bayesian.kernels import JITTER, Spans, parts
from termsel.adjustment.equations import weights_of
from termsel.adjustment.solve import TOLERANCE
from termsel.data.features import FloatArray, Points
from termsel.data.monomials import graded_exponents, monomials

PLANE = graded_exponents(1, 2)

SMOOTHINGS = 10.0 ** np.arange(-8.0, 6.0, 0.1)
"""From where a spline interpolates to where it is an affine function; kernels are of places within
about [-1, 1]."""

NEAR = 5
"""Smoothings to each side of the chosen one that a point may lead to, where there are knots:
one of so many hardly moves the choice."""


@dataclass(frozen=True, eq=False)
class Axis:
    """The spline of one axis, and the errors of those without each point."""

    best: int  # which smoothing is chosen
    w: FloatArray  # (n,): the kernels' weights
    own: FloatArray  # (n,): the diagonal of M
    errors: FloatArray  # (n,): weighted, of each point by the others


@dataclass(frozen=True, eq=False)
class ThinPlates:
    """The splines of line and sample."""

    points: Points  # scaled
    units: tuple[float, float]  # by which X and Y are multiplied before distances are taken
    smoothings: FloatArray  # (s,): to choose from
    axes: tuple[Axis, Axis]  # of line and of sample
    spans: Spans

    @property
    def smoothing(self) -> tuple[float, float]:
        """Smoothing of line and of sample."""
        line, sample = (float(self.smoothings[axis.best]) for axis in self.axes)
        return line, sample

    @property
    def errors(self) -> FloatArray:
        """Measured minus predicted of each point by the others, shape (n, 2)."""
        return np.stack([axis.errors for axis in self.axes], axis=1) / weights_of(self.points)

    @property
    def effective(self) -> float:
        """Effective parameters of line and sample together."""
        return float(sum((1.0 - smoothing * axis.own).sum() for smoothing, axis in zip(
            self.smoothing, self.axes, strict=True)))

    def predict(self, ground: FloatArray) -> FloatArray:
        """Return line and sample of places, shape (m, 2)."""
        return np.asarray(monomials(ground, PLANE) @ self._affine + self._local(ground))

    def spread(self, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the variance of the prediction, shape (m, 2), and that of the noise, (2,).

        That of the random field whose best prediction the spline is.
        """
        variance = np.empty((len(ground), 2))
        noise = np.empty(2)
        lead = monomials(self.points.ground, PLANE)
        n, f = lead.shape
        columns = monomials(ground, PLANE)
        places = ground[:, :2] * self.units
        for axis, (smoothing, one, w) in enumerate(zip(
                self.smoothing, self.axes, weights_of(self.points).T, strict=True)):
            fields = float(one.w @ (self.points.image[:, axis] * w)) / (n - f)
            known = self.spans.variance(places, columns, lead, self._places, smoothing, w)
            variance[:, axis] = fields * known
            noise[axis] = fields * smoothing
        return np.maximum(variance, 0.0), noise

    @cached_property
    def _places(self) -> FloatArray:
        return np.asarray(self.points.ground[:, :2] * self.units)

    @cached_property
    def _coefficients(self) -> FloatArray:
        """Coefficients of the columns that span the field, shape (k, 2)."""
        w = np.stack([axis.w for axis in self.axes], axis=1) * weights_of(self.points)
        return self.spans.coefficients(self._places, w)

    def _local(self, ground: FloatArray) -> FloatArray:
        """Return the field at places, shape (m, 2)."""
        places = ground[:, :2] * self.units
        image = np.empty((len(ground), 2))
        for some in parts(len(ground)):
            image[some] = self.spans(places[some]) @ self._coefficients
        return image

    @cached_property
    def _affine(self) -> FloatArray:
        """Coefficients of the affine functions, shape (3, 2)."""
        columns = monomials(self.points.ground, PLANE)
        local = self._local(self.points.ground)
        coefficients = np.empty((len(PLANE), 2))
        for axis, (one, smoothing, w) in enumerate(zip(
                self.axes, self.smoothing, weights_of(self.points).T, strict=True)):
            # What kernels and smoothing leave of the measurements is affine.
            rest = w * (self.points.image[:, axis] - local[:, axis]) - smoothing * one.w
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
    lead = monomials(points.ground, PLANE)
    places = points.ground[:, :2] * units
    spans = Spans(places, whole=smoothing == 0)
    smoothings = SMOOTHINGS if smoothing is None else np.array([smoothing])
    weights = weights_of(points)
    alike = bool((weights[:, 0] == weights[:, 1]).all())
    axes: list[Axis] = []
    for columns in (slice(0, 2),) if alike else (slice(0, 1), slice(1, 2)):
        w = weights[:, columns.start]
        basis = _basis(lead * w[:, None], places, w, spans)
        if basis is None:
            return None
        axes += _axes(basis, measured[:, columns] * w[:, None], smoothings, criterion)
    return ThinPlates(points, units, smoothings, (axes[0], axes[1]), spans)


@dataclass(frozen=True, eq=False)
class _Basis:
    """Eigenvectors of the kernels on what affine functions leave."""

    values: FloatArray  # (k,)
    q: FloatArray  # (n, f): an orthonormal basis of the affine functions
    rows: Callable[[slice], FloatArray]  # (m, c): what spans the eigenvectors, at some points
    turn: FloatArray | None  # (c, k): of these to the eigenvectors, None where they are these

    @property
    def rest(self) -> int:
        """Dimensions in which the kernels are 0."""
        return int(len(self.q) - self.q.shape[1] - len(self.values))

    def u(self, some: slice) -> FloatArray:
        """Return the eigenvectors at some points, (m, k)."""
        return self.rows(some) if self.turn is None else np.asarray(self.rows(some) @ self.turn)

    def along(self, free: FloatArray) -> FloatArray:
        """Return what vectors (n, a) that no affine function fits are along the eigenvectors."""
        sums = sum(self.rows(some).T @ free[some] for some in parts(len(free)))
        return np.asarray(sums if self.turn is None else self.turn.T @ sums)


def _basis(lead: FloatArray, places: FloatArray, weights: FloatArray,
           spans: Spans) -> _Basis | None:
    """Return the eigenvectors, or None if the points do not determine an affine function."""
    n, f = lead.shape
    if n < f + 2:
        return None
    whole = spans.root is None
    every = np.linalg.qr(lead, mode="complete" if whole else "reduced")[0]
    q = every[:, :f]
    rest = every[:, f:]
    if np.linalg.matrix_rank(lead, TOLERANCE) < f or \
            (1.0 - (q**2).sum(axis=1)).min() < TOLERANCE:
        return None
    if whole:
        # The kernel is positive on what affine functions leave alone.
        values, u = np.linalg.eigh(rest.T @ (spans(places) * np.outer(weights, weights)) @ rest)
        u = rest @ u
        # Rounding makes values of points at one place a little negative.
        return _Basis(np.maximum(values, TOLERANCE**2 * values.max(initial=0.0)), q,
                      lambda some: np.asarray(u[some]), None)

    def weighted(some: slice) -> FloatArray:
        return np.asarray(spans(places[some]) * weights[some, None])

    affine = np.asarray(sum(q[some].T @ weighted(some) for some in parts(n)))

    def rows(some: slice) -> FloatArray:
        return np.asarray(weighted(some) - q[some] @ affine)

    products = np.zeros((affine.shape[1],) * 2)
    for some in parts(n):
        mine = rows(some)
        products += mine.T @ mine
    values, vectors = np.linalg.eigh(products)
    large = values > JITTER * values.max()
    return _Basis(values[large], q, rows, vectors[:, large] / np.sqrt(values[large]))


def _axes(basis: _Basis, targets: FloatArray, smoothings: FloatArray,
          criterion: str) -> list[Axis]:
    """Return the splines of so many axes with the same weights, whose targets are (n, a)."""
    free = targets - basis.q @ (basis.q.T @ targets)
    along = basis.along(free)
    # What neither affine functions nor kernels span; there M is the identity by the smoothing.
    over = np.maximum((free**2).sum(axis=0) - (along**2).sum(axis=0), 0.0) * bool(basis.rest)
    choices = [_choice(basis, *one, smoothings, criterion)
               for one in zip(along.T, over.tolist(), strict=True)]
    n = len(targets)
    axes = [Axis(choice.best, np.empty(n), np.empty(n), np.empty(n)) for choice in choices]
    for some in parts(n):
        mine = basis.u(some)
        left = np.maximum(1.0 - (basis.q[some]**2).sum(axis=1) - (mine**2).sum(axis=1), 0.0)
        beyond = free[some] - mine @ along
        for axis, one, far in zip(axes, choices, beyond.T, strict=True):
            w, own, without = one.at(mine.T, left, far, n)
            least = without.argmin(axis=0)
            column = np.arange(len(mine))
            axis.w[some] = w[one.chosen]
            axis.own[some] = own[one.chosen]
            axis.errors[some] = w[least, column] / own[least, column]
    return axes


@dataclass(frozen=True, eq=False)
class _Choice:
    """The smoothing of one axis, and those that it may be without a point."""

    best: int  # of all smoothings
    chosen: int  # of these here
    below: FloatArray  # (s, k): the eigenvalues of M
    along: FloatArray  # (k,)
    apart: FloatArray  # (s, 1): the eigenvalue of M that kernels leave; 0 where they leave nothing
    square: FloatArray  # (s,): y' M y, or |M y|^2 for generalised cross-validation
    log: FloatArray  # (s,): the logarithm of 1 / |M|
    trace: FloatArray  # (s,)
    freedom: int
    reml: bool

    def at(self, mine: FloatArray, left: FloatArray, far: FloatArray, n: int,
           ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return w, the diagonal of M and the criterion without each of some points, (s, m)."""
        w = (self.below * self.along) @ mine + self.apart * far
        own = self.below @ mine**2 + self.apart * left
        if self.reml:
            # Without point i, y'M y is lower by w_i^2 / M_ii, and |M| by the factor M_ii.
            others = np.maximum(self.square[:, None] - w**2 / own, np.finfo(float).tiny)
            return w, own, (self.freedom - 1) * np.log(others) + self.log[:, None] + np.log(own)
        # M without a point is M less the product of its column by itself, over the diagonal.
        twice = self.below**2 @ mine**2 + self.apart**2 * left
        again = (self.below**2 * self.along) @ mine + self.apart**2 * far
        ratio = w / own
        others = np.maximum(self.square[:, None] - 2 * ratio * again + ratio**2 * twice, 0.0)
        return w, own, (n - 1) * others / (self.trace[:, None] - twice / own) ** 2


def _choice(basis: _Basis, along: FloatArray, over: float, smoothings: FloatArray,
            criterion: str) -> _Choice:
    """Return the smoothing by the criterion, where |y|^2 is `over` beyond the kernels."""
    n, f = basis.q.shape
    below = 1.0 / (basis.values + smoothings[:, None])                               # (s, k)
    apart = 1.0 / smoothings[:, None] if basis.rest else np.zeros((len(smoothings), 1))
    log = -np.log(below).sum(axis=1) + (
        basis.rest * np.log(smoothings) if basis.rest else 0.0)
    trace = below.sum(axis=1) + basis.rest * apart[:, 0]
    if criterion == "reml":
        square = (below * along**2).sum(axis=1) + apart[:, 0] * over
        value = (n - f) * np.log(np.maximum(square, np.finfo(float).tiny)) + log
    else:  # n |M y|^2 / tr(M)^2
        square = ((below * along) ** 2).sum(axis=1) + apart[:, 0] ** 2 * over
        value = n * square / trace**2
    best = int(value.argmin())
    first = max(best - NEAR, 0) if basis.rest else 0
    near = slice(first, best + NEAR + 1 if basis.rest else None)
    return _Choice(best, best - first, below[near], along, apart[near], square[near], log[near],
                   trace[near], n - f, criterion == "reml")
