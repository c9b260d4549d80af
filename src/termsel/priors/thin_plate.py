"""Thin-plate splines of line and sample over a plane, with their smoothing chosen.

For places x_i and one axis the spline is an affine function and sum w_i r_i^2 log r_i, r_i the
distance to x_i. With K the kernel between the points, T their affine columns and M the inverse of
K + smoothing I on what T leaves (M T = 0), w = M y. Leaving a point out, its error is w_i / M_ii,
and with it each criterion is that of the others alone, so that the errors without each point are
those of the whole procedure, the choice of the smoothing included.

Of more than KNOTS points only so many that are far apart, the knots, span the field. K is then
F F^T, of what the affine function through the knots leaves of the kernels, and M has the
eigenvalue 1 / smoothing on what neither T nor F spans. Memory and time are linear in the points.

References
----------
Duchon 1977; Wahba 1990, Spline Models for Observational Data, for both criteria; Craven and Wahba
1979 for generalised cross-validation; Wood 2011, J. R. Stat. Soc. B 73(1), for restricted maximum
likelihood (REML); Wood 2003, J. R. Stat. Soc. B 65(1), for splines of many points.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from termsel.adjustment.equations import weights_of
from termsel.adjustment.monomials import graded_exponents, monomials
from termsel.adjustment.solve import TOLERANCE
from termsel.measurements.features import FloatArray, Points

PLANE = graded_exponents(1, 2)

SMOOTHINGS = 10.0 ** np.arange(-8.0, 6.0, 0.1)
"""From where a spline interpolates to where it is an affine function; kernels are of places within
about [-1, 1]."""


AT_ONCE = 2000
"""Places whose kernels are held in memory."""

KNOTS, CELLS = 1000, 40_000_000
"""Most knots, and most numbers of the matrix of knots by points."""

JITTER = 1e-10
"""Part of the field's variance that is none: that of close points, or of affine functions."""

NEAR = 5
"""Smoothings to each side of the chosen one that a point may lead to, where there are more than
KNOTS: one of so many hardly moves the choice."""


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
        variance, noise = np.empty((len(ground), 2)), np.empty(2)
        lead = monomials(self.points.ground, PLANE)
        n, f = lead.shape
        columns, places = monomials(ground, PLANE), ground[:, :2] * self.units
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
        places, image = ground[:, :2] * self.units, np.empty((len(ground), 2))
        for start in range(0, len(ground), AT_ONCE):
            some = slice(start, start + AT_ONCE)
            image[some] = self.spans(places[some]) @ self._coefficients
        return image

    @cached_property
    def _affine(self) -> FloatArray:
        """Coefficients of the affine functions, shape (3, 2)."""
        columns, local = monomials(self.points.ground, PLANE), self._local(self.points.ground)
        coefficients = np.empty((len(PLANE), 2))
        for axis, (one, smoothing, w) in enumerate(zip(
                self.axes, self.smoothing, weights_of(self.points).T, strict=True)):
            # What kernels and smoothing leave of the measurements is affine.
            rest = w * (self.points.image[:, axis] - local[:, axis]) - smoothing * one.w
            coefficients[:, axis] = np.linalg.lstsq(columns * w[:, None], rest)[0]
        return coefficients


class Spans:
    """The columns that span a field: kernels around all points, or around knots among many."""

    def __init__(self, places: FloatArray, whole: bool) -> None:
        many = len(places) > KNOTS and not whole
        self.knots = spread_out(places, min(KNOTS, CELLS // len(places))) if many else places
        self.root = spline_root(self.knots) if many else None

    def __call__(self, places: FloatArray) -> FloatArray:
        """Return the columns at places, shape (m, k)."""
        if self.root is None:
            return kernel(places, self.knots)
        return left_by_affine(places, self.knots) @ self.root

    def coefficients(self, places: FloatArray, w: FloatArray) -> FloatArray:
        """Return the coefficients of the columns by the kernels' weights (n, 2) at the points."""
        return w if self.root is None else np.asarray(sum(
            self(places[start:start + AT_ONCE]).T @ w[start:start + AT_ONCE]
            for start in range(0, len(places), AT_ONCE)))

    def variance(self, there: FloatArray, columns: FloatArray, lead: FloatArray,
                 places: FloatArray, smoothing: float, w: FloatArray) -> FloatArray:
        """Return the variance at places (m, 2) by that of the field, shape (m,).

        The affine columns there are (m, 3), those of the points (n, 3); `w` are their weights.
        """
        (n, f), apart = lead.shape, self(there)
        if self.root is None:
            # Universal kriging: the kernel at distance 0, which is 0, less right' system^-1 right.
            system = np.zeros((n + f, n + f))
            system[:n, :n] = kernel(places, places) + np.diag(smoothing / w**2)
            system[:n, n:], system[n:, :n] = lead, lead.T
            right = np.concatenate([apart, columns], axis=1)
            return np.asarray(-(right * np.linalg.solve(system, right.T).T).sum(axis=1))
        rows = np.concatenate([columns, apart], axis=1)
        normal = np.diag(np.r_[np.zeros(f), np.full(apart.shape[1], smoothing)])
        for start in range(0, n, AT_ONCE):
            some = slice(start, start + AT_ONCE)
            one = np.concatenate([lead[some], self(places[some])], axis=1) * w[some, None]
            normal += one.T @ one
        beyond = own_variance(there, self.knots) - (apart**2).sum(axis=1)
        return np.asarray(smoothing * (rows * np.linalg.solve(normal, rows.T).T).sum(axis=1)
                          + np.maximum(beyond, 0.0))


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
    columns, places = monomials(points.ground, PLANE), points.ground[:, :2] * units
    spans = Spans(places, whole=smoothing == 0)
    spanned = np.concatenate([spans(places[start:start + AT_ONCE])
                              for start in range(0, len(places), AT_ONCE)])
    smoothings = SMOOTHINGS if smoothing is None else np.array([smoothing])
    weights = weights_of(points).T
    bases = [_basis(columns * weights[0][:, None], spanned, weights[0], spans)]
    bases.append(bases[0] if (weights[0] == weights[1]).all() else
                 _basis(columns * weights[1][:, None], spanned, weights[1], spans))
    if bases[0] is None or bases[1] is None:
        return None
    line, sample = (_axis(basis, target, smoothings, criterion) for basis, target in zip(
        bases, measured.T * weights, strict=True) if basis is not None)
    return ThinPlates(points, units, smoothings, (line, sample), spans)


@dataclass(frozen=True, eq=False)
class _Basis:
    """Eigenvectors of the kernels on what affine functions leave."""

    values: FloatArray  # (k,)
    u: FloatArray  # (n, k)
    q: FloatArray  # (n, f): an orthonormal basis of the affine functions

    @property
    def rest(self) -> int:
        """Dimensions in which the kernels are 0."""
        return int(len(self.u) - self.q.shape[1] - len(self.values))

    def left(self, some: slice) -> FloatArray | float:
        """Return the diagonal of the projection onto these."""
        if not self.rest:
            return 0.0
        spanned = (self.q[some]**2).sum(axis=1) + (self.u[some]**2).sum(axis=1)
        return np.asarray(np.maximum(1.0 - spanned, 0.0))


def _basis(lead: FloatArray, spanned: FloatArray, weights: FloatArray,
           spans: Spans) -> _Basis | None:
    """Return the eigenvectors, or None if the points do not determine an affine function."""
    n, f = lead.shape
    if n < f + 2:
        return None
    whole = spans.root is None
    every = np.linalg.qr(lead, mode="complete" if whole else "reduced")[0]
    q, rest = every[:, :f], every[:, f:]
    if np.linalg.matrix_rank(lead, TOLERANCE) < f or \
            (1.0 - (q**2).sum(axis=1)).min() < TOLERANCE:
        return None
    if whole:
        # The kernel is positive on what affine functions leave alone.
        values, u = np.linalg.eigh(rest.T @ (spanned * np.outer(weights, weights)) @ rest)
        # Rounding makes values of points at one place a little negative.
        return _Basis(np.maximum(values, TOLERANCE**2 * values.max(initial=0.0)), rest @ u, q)
    rows = spanned * weights[:, None]
    rows -= q @ (q.T @ rows)
    values, u = np.linalg.eigh(rows.T @ rows)
    some = values > JITTER * values.max()
    return _Basis(values[some], rows @ (u[:, some] / np.sqrt(values[some])), q)


def _axis(basis: _Basis, target: FloatArray, smoothings: FloatArray, criterion: str) -> Axis:
    values, u, q, n = basis.values, basis.u, basis.q, len(target)
    below = 1.0 / (values + smoothings[:, None])                                     # (s, k)
    along = u.T @ target
    # On what the kernels do not span, M is the identity by the smoothing.
    beyond = target - q @ (q.T @ target) - u @ along if basis.rest else np.zeros(n)
    apart = 1.0 / smoothings[:, None] if basis.rest else np.zeros((len(smoothings), 1))
    square = (below * along**2).sum(axis=1) + apart[:, 0] * float(beyond @ beyond)
    log = -np.log(below).sum(axis=1) - basis.rest * np.log(np.where(apart, apart, 1.0))[:, 0]
    trace = below.sum(axis=1) + basis.rest * apart[:, 0]
    freedom, tiny = n - q.shape[1], np.finfo(float).tiny
    if criterion == "reml":
        value = freedom * np.log(np.maximum(square, tiny)) + log
    else:  # n |M y|^2 / tr(M)^2
        value = n * (((below * along) ** 2).sum(axis=1)
                     + apart[:, 0] ** 2 * float(beyond @ beyond)) / trace**2
    best = int(value.argmin())
    near = slice(None) if n <= KNOTS else slice(max(best - NEAR, 0), best + NEAR + 1)
    below, apart, square, log, trace = (one[near] for one in (below, apart, square, log, trace))
    chosen = best - (near.start or 0)
    w, own, errors = np.empty(n), np.empty(n), np.empty(n)
    for start in range(0, n, AT_ONCE):
        some = slice(start, start + AT_ONCE)
        mine, left, far = u[some].T, basis.left(some), beyond[some]
        each, diagonal = (below * along) @ mine + apart * far, below @ mine**2 + apart * left
        if criterion == "reml":
            # Without point i, y'M y is lower by w_i^2 / M_ii, and |M| by the factor M_ii.
            others = np.maximum(square[:, None] - each**2 / diagonal, tiny)
            without = (freedom - 1) * np.log(others) + log[:, None] + np.log(diagonal)
        else:
            # M without a point is M less the product of its column by itself, over the diagonal.
            twice = below**2 @ mine**2 + apart**2 * left
            again, ratio = (below**2 * along) @ mine + apart**2 * far, each / diagonal
            whole = ((below * along) ** 2).sum(axis=1) + apart[:, 0] ** 2 * float(beyond @ beyond)
            others = np.maximum(whole[:, None] - 2 * ratio * again + ratio**2 * twice, 0.0)
            without = (n - 1) * others / (trace[:, None] - twice / diagonal) ** 2
        least, column = without.argmin(axis=0), np.arange(each.shape[1])
        w[some], own[some] = each[chosen], diagonal[chosen]
        errors[some] = each[least, column] / diagonal[least, column]
    return Axis(best, w, own, errors)


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


def left_by_affine(places: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the kernels around knots, less what an affine function fits at these, (m, k)."""
    there, here = (np.column_stack([np.ones(len(one)), one]) for one in (places, knots))
    return np.asarray(kernel(places, knots) - there @ (np.linalg.pinv(here) @ kernel(knots, knots)))


def own_variance(places: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the variance at places of what the affine function that fits the knots leaves."""
    there, here = (np.column_stack([np.ones(len(one)), one]) for one in (places, knots))
    fitted = there @ np.linalg.pinv(here)
    return np.asarray((fitted * (fitted @ kernel(knots, knots)
                                 - 2 * kernel(places, knots))).sum(axis=1))


def spline_root(knots: FloatArray) -> FloatArray:
    """Return what makes coefficients of the kernels uncorrelated, of one variance, shape (k, c)."""
    here = np.column_stack([np.ones(len(knots)), knots])
    rest = np.eye(len(knots)) - here @ np.linalg.pinv(here)
    values, vectors = np.linalg.eigh(rest @ kernel(knots, knots) @ rest)
    some = values > JITTER * values.max()  # what affine functions fit has no variance
    return np.asarray(rest @ (vectors[:, some] / np.sqrt(values[some])))


def spread_out(places: FloatArray, count: int) -> FloatArray:
    """Return the places, of more than a count that are far apart, whatever their order."""
    if len(places) <= count:
        return places
    # From the place nearest to the middle, always the place farthest from those taken.
    taken = [int(np.argmin(np.linalg.norm(places - places.mean(axis=0), axis=1)))]
    columns, apart = np.ascontiguousarray(places.T), np.full(len(places), np.inf)
    while len(taken) < count:
        line, sample = columns - columns[:, taken[-1:]]
        apart = np.minimum(apart, line * line + sample * sample)
        taken.append(int(apart.argmax()))
    return places[taken]
