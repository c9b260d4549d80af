"""The average of few points in a plane: a similarity, what paper adds to it, and curvature.

A map is drawn to scale, so that its image is a similarity of the ground, but for paper that
stretches and shears by some per cent, for bends, and for errors of drawing and measuring. With F
(2n, 4) the equations of a similarity for line and sample of n points, and B (2n, 2) those of what
an affine map adds to it,

    y = F g + B b + h + e.

Nothing is believed of g beforehand. Both departures b are normal with the standard deviation
tau |a|, a being the scale of the similarity, and tau unknown, about STRETCH. The curvature h is
none, a cubic polynomial whose coefficients fall from order to order, or a thin-plate spline; its
size by the noise e is unknown, and the same in line and sample. The noise is normal, and its size
unknown. All solutions on a grid of tau, form, size and noise are averaged with their probabilities.

So where noise hides what paper does, b is shrunken and the similarity remains; where it does not,
the affine image does. Leaving a point out, each solution and its probability change in closed form,
so that the errors are those of the whole procedure repeated without the point.

With V = I + s^2 K the covariance of h + e by the variance of e, N an orthonormal basis of what F
leaves and M = N (N'V N)^-1 N', a solution without departures leaves M y, of the sum of squares
y'M y. With them and k = (tau |a| / sigma)^2, it is M - M B (I / k + B'M B)^-1 B'M instead.

References
----------
Lindley and Smith 1972, J. R. Stat. Soc. B 34(1), for priors of shrunken coefficients; Gelman 2006,
Bayesian Analysis 1(3), for the half-Cauchy prior of their size; Harville 1974, Biometrika 61(2),
for the likelihood without F; Hoeting et al. 1999, Statistical Science 14(4), for averaging. The
prior is termsel's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from termsel.adjustment.bayesian.field import GROUND_BATCH, NEGLIGIBLE_PROBABILITY
from termsel.adjustment.bayesian.kernels import SplineField, spline_field
from termsel.adjustment.bayesian.posterior import (
    FALLS,
    MAX_LOG_RATIO,
    NO_NOISE,
    PRIOR_SIZES,
    log_prior_of_sizes,
    normalise_probabilities,
)
from termsel.adjustment.bayesian.shrinkage import MIN_REDUNDANCY
from termsel.adjustment.equations import weights_of
from termsel.adjustment.solve import TOLERANCE
from termsel.data.features import FloatArray, IntArray, Points
from termsel.data.monomials import evaluate_monomials, graded_exponents
from termsel.data.view import Measurements

FEWEST_POINTS = 5
"""Points from which on an average is made: two more than determine an affine map."""

STRETCH = 0.01
"""Typical departure of maps from a similarity: paper stretches and shears by about one per cent."""

STRETCHES = 10.0 ** np.arange(-3.0, 0.0, 0.5)
"""Standard deviations of departures that are tried: from a tenth of a per cent to what only plans
have that are not to scale."""

CUBIC = graded_exponents(3, 2)
N_AFFINE, N_SIMILARITY, N_DEPARTURES = 3, 4, 2

PATTERNS = np.zeros((6, N_AFFINE, 2))
"""Affine coefficients of line and sample: two shifts, a turn and scale, and those mirrored.

X and Y have one unit. The first four are those of a similarity (see `Helmert2D`); a mirrored one
has the first two and the last two."""
PATTERNS[[0, 1], 0, [0, 1]] = 1.0
PATTERNS[2] = [[0.0, 0.0], [0.0, 1.0], [-1.0, 0.0]]
PATTERNS[3] = [[0.0, 0.0], [-1.0, 0.0], [0.0, -1.0]]
PATTERNS[4] = [[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]]
PATTERNS[5] = [[0.0, 0.0], [-1.0, 0.0], [0.0, 1.0]]
MIRRORED = PATTERNS[[0, 1, 4, 5, 2, 3]]

NOISE_STEPS = 32
FIRST_LOG_NOISE, LAST_LOG_NOISE = -1.2, 1.8
"""Natural logarithms of the standard deviations of the noise that are tried, by the root of the
mean square that a form leaves with free departures, and without any: others have probabilities of
about 0."""


@dataclass(frozen=True, eq=False)
class HeldOutErrors:
    """Errors of n points as the others predict them."""

    errors: FloatArray  # (n, 2): measured minus predicted, weighted
    spread: FloatArray  # (n, 2): variance of the errors by that of the noise


@dataclass(frozen=True, eq=False)
class Forms:
    """The c forms that the curvature may have, each with a size, before points are looked at."""

    kernel: IntArray  # (c,): number of the kernel; the first has no curvature
    size: FloatArray  # (c,)
    log_prior: FloatArray  # (c,)


@dataclass(frozen=True, eq=False)
class Cells:
    """The e likely ones of all combinations of a form, a stretch and a noise."""

    form: IntArray  # (e,)
    share: FloatArray  # (e,): probability
    ratio: FloatArray  # (e,): k, the variance of the departures by that of the noise
    noise: FloatArray  # (e,): variance of the noise


@dataclass(frozen=True, eq=False)
class PlaneAverage:
    """The average of few points in a plane.

    Rows of 2n are line and sample of the first point, then of the next, and so on.
    """

    points: Points  # scaled
    units: tuple[float, float]  # by which X and Y are multiplied to have one unit
    positions: FloatArray  # (n, 3): of the points, in these
    patterns: FloatArray  # (6, 3, 2): affine coefficients of the similarity and of departures
    rows: FloatArray  # (2n, 6): F and B, weighted
    covariances: FloatArray  # (j, 2n, 2n): K by each kernel, weighted
    basis: FloatArray  # (j, 2n, m): N times the eigenvectors of N'K N
    values: FloatArray  # (j, m): its eigenvalues

    @cached_property
    def target(self) -> FloatArray:
        """Weighted line and sample of the points, (2n,)."""
        return np.asarray((self.points.image * weights_of(self.points)).ravel())

    @cached_property
    def _kept(self) -> FloatArray:
        """What the size of each form keeps along each eigenvector, (c, m)."""
        return np.asarray(1.0 / (1.0 + _forms().size[:, None]**2 * self.values[_forms().kernel]))

    @cached_property
    def _left(self) -> FloatArray:
        """M of each form, (c, 2n, 2n)."""
        basis = self.basis[_forms().kernel]
        return np.asarray((basis * self._kept[:, None]) @ basis.swapaxes(1, 2))

    @cached_property
    def _departures(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Values (c, 2) of B'M B, M B along its eigenvectors, (c, 2n, 2), and these, (c, 2, 2)."""
        departures = self.rows[:, N_SIMILARITY:]
        left = self._left @ departures
        values, vectors = np.linalg.eigh(departures.T @ left)
        return values, left @ vectors, vectors

    @cached_property
    def _projections(self) -> FloatArray:
        """B'M y along the eigenvectors of each form, (c, 2)."""
        return np.asarray(np.einsum("crq,r->cq", self._departures[1], self.target))

    @cached_property
    def cells(self) -> Cells:
        """All combinations of a form, a stretch and a noise that matter, with probabilities."""
        values = self._departures[0]
        freedom = self.basis.shape[2]
        half_range = float(np.ptp(self.points.image, axis=0).max()) / 2.0
        no_noise = len(self.target) * (NO_NOISE * half_range)**2
        # The squares that departures explain if they are free, (B'M y)^2 / B'M B along each
        # eigenvector, and those that remain then: of residuals, as a difference would be rounding.
        explained = self._projections**2 / values
        free = np.einsum("cpq,cq->cp", self._departures[2], self._projections / values)
        residuals = self.target - free @ self.rows[:, N_SIMILARITY:].T
        along = np.einsum("crm,cr->cm", self.basis[_forms().kernel], residuals)
        least_squares = (self._kept * along**2).sum(axis=1) + no_noise
        squares = least_squares + explained.sum(axis=1)
        lowest = FIRST_LOG_NOISE + np.log(least_squares / freedom) / 2.0
        highest = LAST_LOG_NOISE + np.log(squares / freedom) / 2.0
        log_noises = np.linspace(lowest, highest, NOISE_STEPS, axis=-1)[:, None]      # (c, 1, g)
        variances = np.exp(2.0 * log_noises)
        ratios = (STRETCHES[:, None] * self._scale)**2 / variances                     # (c, t, g)
        enlarged = 1.0 + ratios[..., None] * values[:, None, None]
        # A prior leaves 1 / (1 + k B'M B) of what free departures explain.
        remaining = (least_squares[:, None, None]
                     + (explained[:, None, None] / enlarged).sum(axis=-1))
        logs = (_log_priors_of_stretches()[:, None]
                + (_forms().log_prior + np.log(self._kept).sum(axis=1) / 2.0
                   + np.log(highest - lowest))[:, None, None]
                - freedom * log_noises - remaining / variances / 2.0
                - np.log(enlarged).sum(axis=-1) / 2.0)
        likely = logs > logs.max() - MAX_LOG_RATIO
        form = np.nonzero(likely)[0]
        share = normalise_probabilities(logs[likely])[0]
        return Cells(form, share, ratios[likely], np.broadcast_to(variances, logs.shape)[likely])

    @cached_property
    def _scale(self) -> float:
        """The scale of the similarity by least squares."""
        coefficients = np.linalg.lstsq(self.rows[:, :N_SIMILARITY], self.target)[0]
        return float(np.hypot(*coefficients[2:]))

    @cached_property
    def _explained_shares(self) -> FloatArray:
        """What a departure's prior leaves of its estimate, k / (1 + k B'M B), of each cell, (e, 2).
        """
        ratio = self.cells.ratio[:, None]
        return np.asarray(ratio / (1.0 + ratio * self._departures[0][self.cells.form]))

    @cached_property
    def _moments(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of each form its probability, (c,), that times b, (c, 2), and that times b b', (c, 2, 2).

        The last has the variance of b within each solution, too.
        """
        cells = self.cells
        count = len(_forms().size)
        along = self._explained_shares * self._projections[cells.form]
        vectors = self._departures[2][cells.form]
        b = np.einsum("epq,eq->ep", vectors, along)
        second = np.einsum("epq,eq,erq->epr", vectors,
                           self._explained_shares * cells.noise[:, None], vectors)
        second += b[:, :, None] * b[:, None]
        share = np.zeros(count)
        mean_b = np.zeros((count, N_DEPARTURES))
        mean_second = np.zeros((count, N_DEPARTURES, N_DEPARTURES))
        np.add.at(share, cells.form, cells.share)
        np.add.at(mean_b, cells.form, cells.share[:, None] * b)
        np.add.at(mean_second, cells.form, cells.share[:, None, None] * second)
        return share, mean_b, mean_second

    @cached_property
    def effective(self) -> float:
        """Effective parameters of line and sample together: 2n less the trace of what is left."""
        cells = self.cells
        left = np.trace(self._left, axis1=1, axis2=2)[cells.form]
        squares = (self._departures[1]**2).sum(axis=1)[cells.form]
        left = left - (self._explained_shares * squares).sum(axis=1)
        return len(self.target) - float(cells.share @ left)

    @cached_property
    def held_out(self) -> HeldOutErrors:
        """The prediction of each point by all others, averaged over all cells."""
        cells = self.cells
        n = len(self.points)
        errors, spread = np.empty((2, n, 2))
        left_of_target = (self._left @ self.target).reshape(-1, n, 2)
        departures = self._departures[1].reshape(-1, n, 2, N_DEPARTURES)
        projections = (self._explained_shares * self._projections[cells.form])[:, None]
        for i in range(n):
            own = slice(2 * i, 2 * i + 2)
            along = departures[cells.form, i]                                        # (e, 2, 2)
            # The block of a point in M of each cell, and its part of M y.
            block = self._left[:, own, own][cells.form] - np.einsum(
                "eaq,eq,ebq->eab", along, self._explained_shares, along)
            rest = left_of_target[cells.form, i] - (along * projections).sum(axis=2)
            determinant = np.maximum(block[:, 0, 0] * block[:, 1, 1] - block[:, 0, 1]**2,
                                     MIN_REDUNDANCY**2)
            inverse = np.empty_like(block)
            inverse[:, 0, 0] = block[:, 1, 1] / determinant
            inverse[:, 1, 1] = block[:, 0, 0] / determinant
            inverse[:, 0, 1] = inverse[:, 1, 0] = -block[:, 0, 1] / determinant
            error = np.einsum("eab,eb->ea", inverse, rest)
            # A cell without the point is as likely as with it, by the density of the point in it.
            logs = (np.log(cells.share * cells.noise) - np.log(determinant) / 2.0
                    + (error * rest).sum(axis=1) / cells.noise / 2.0)
            share = normalise_probabilities(logs)[0]
            errors[i] = share @ error
            spread[i] = share @ np.diagonal(inverse, axis1=1, axis2=2)
        return HeldOutErrors(errors, spread)

    @property
    def errors(self) -> FloatArray:
        """Measured minus predicted of each point, by the other points, shape (n, 2)."""
        return self.held_out.errors / weights_of(self.points)

    @cached_property
    def _coefficients(self) -> tuple[FloatArray, FloatArray]:
        """Averaged coefficients of monomials, (10, 2), and of the spline's kernels, (n, 2)."""
        share, mean_b, _ = self._moments
        n = len(self.points)
        # What b leaves of the measurements, and what of that is curvature or noise, M (y - B b).
        targets = share[:, None] * self.target - mean_b @ self.rows[:, N_SIMILARITY:].T
        left = np.einsum("crs,cs->cr", self._left, targets)
        of_kernel = np.zeros((len(self.covariances), 2 * n))
        np.add.at(of_kernel, _forms().kernel, _forms().size[:, None]**2 * left)
        fitted = np.einsum("jrs,js->r", self.covariances, of_kernel) + left.sum(axis=0)
        similarity = np.linalg.lstsq(self.rows[:, :N_SIMILARITY], targets.sum(axis=0) - fitted)[0]
        affine = np.tensordot(np.append(similarity, mean_b.sum(axis=0)), self.patterns, 1)
        of_points = of_kernel.reshape(-1, n, 2) * weights_of(self.points)
        columns = evaluate_monomials(self.positions, CUBIC)[:, N_AFFINE:]
        curved = np.zeros((columns.shape[1], 2))
        for scales, of_fall in zip(_polynomial_scales(), of_points[1:-1], strict=True):
            curved += (scales**2)[:, None] * (columns.T @ of_fall)
        return np.concatenate([affine, curved]), of_points[-1]

    def predict(self, ground: FloatArray) -> FloatArray:
        """Return line and sample of places, shape (m, 2)."""
        monomials, of_spline = self._coefficients
        positions = _in_units(ground, self.units)
        return np.asarray(evaluate_monomials(positions, CUBIC) @ monomials
                          + self._spline.covariances(positions[:, :2]) @ of_spline)

    @property
    def _spline(self) -> SplineField:
        return spline_field(self.positions[:, :2])

    def spread(self, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the variance of the prediction at places (m, 3), (m, 2), and of the noise, (2,).

        By the law of total variance it is the mean of the variances under each form plus the
        variance of its predictions.
        """
        share, mean_b, mean_square_b = self._moments
        noise = np.zeros_like(share)
        np.add.at(noise, self.cells.form, self.cells.share * self.cells.noise)
        variance = np.zeros((len(ground), 2))
        for start in range(0, len(ground), GROUND_BATCH):
            batch = slice(start, start + GROUND_BATCH)
            predicted = self.predict(ground[batch])
            for form in np.flatnonzero(share > NEGLIGIBLE_PROBABILITY):
                without, effect, relative_variance = self._at_places(ground[batch], int(form))
                offsets = without - predicted
                variance[batch] += (
                    noise[form] * relative_variance + share[form] * offsets**2
                    + 2.0 * offsets * (effect @ mean_b[form])
                    + np.einsum("map,pq,maq->ma", effect, mean_square_b[form], effect))
        return np.maximum(variance, 0.0), np.full(2, noise.sum())

    def _at_places(self, ground: FloatArray,
                   form: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what a form predicts at m places without departures, and what these add to it.

        They are (m, 2), and (m, 2, 2) for a unit of both departures; and the variance of the error
        by that of the noise, (m, 2), if the departures are known.
        """
        positions = _in_units(ground, self.units)
        kernel = int(_forms().kernel[form])
        square = float(_forms().size[form])**2
        n = len(self.points)
        with_points, own = self._kernel_at(positions, kernel)
        # Rows of places, and their covariances with those of the points: each axis with itself.
        place_rows = _rows_of(positions, self.patterns)                               # (m, 2, 6)
        covariances = np.einsum("mi,ab,ib->maib", square * with_points, np.eye(2),
                                weights_of(self.points)).reshape(len(ground), 2, 2 * n)
        # By least squares a place is l'y; the rest of it is predicted by what that leaves.
        least_squares = place_rows[..., :N_SIMILARITY] @ np.linalg.pinv(
            self.rows[:, :N_SIMILARITY])
        of_least_squares = least_squares + square * (least_squares @ self.covariances[kernel])
        rest = covariances - of_least_squares
        rest_by_left = rest @ self._left[form]
        influence = least_squares + rest_by_left
        relative_variance = (square * own[:, None] - 2.0 * (least_squares * covariances).sum(axis=2)
                             + (least_squares * of_least_squares).sum(axis=2)
                             - (rest_by_left * rest).sum(axis=2))
        return (influence @ self.target,
                place_rows[..., N_SIMILARITY:] - influence @ self.rows[:, N_SIMILARITY:],
                relative_variance)

    def _kernel_at(self, positions: FloatArray, kernel: int) -> tuple[FloatArray, FloatArray]:
        """Return covariances of places with points, (m, n), and their variances, (m,), of size 1.
        """
        if kernel == 0:
            return np.zeros((len(positions), len(self.points))), np.zeros(len(positions))
        scales = _polynomial_scales()
        if kernel > len(scales):
            return (self._spline.covariances(positions[:, :2]),
                    self._spline.variances(positions[:, :2]))
        columns = evaluate_monomials(positions, CUBIC)[:, N_AFFINE:] * scales[kernel - 1]
        of_points = evaluate_monomials(self.positions, CUBIC)[:, N_AFFINE:] * scales[kernel - 1]
        return columns @ of_points.T, (columns**2).sum(axis=1)


def fit_plane_average(points: Points, units: tuple[float, float]) -> PlaneAverage | None:
    """Return the average of scaled control points, whose heights do not count.

    X and Y times the units have one unit. Returns None if the points without some one of them do
    not determine an affine model with redundancy.
    """
    return _cached_plane_average(Measurements.of(points), units)


@lru_cache(maxsize=4)  # a fit, its errors and its spread need it
def _cached_plane_average(measurements: Measurements,
                          units: tuple[float, float]) -> PlaneAverage | None:
    """Return the average of points in a plane (see `fit_plane_average`); cached by its arguments.

    None for too few points, for points on a line, and where one is indispensable.
    """
    points = measurements.points
    positions = _in_units(points.ground, units)
    affine = evaluate_monomials(positions, CUBIC)[:, :N_AFFINE]
    if len(points) < FEWEST_POINTS or np.linalg.matrix_rank(affine, TOLERANCE) < N_AFFINE:
        return None
    # A point of leverage 1 is indispensable.
    if (1.0 - (np.linalg.qr(affine)[0]**2).sum(axis=1)).min() < TOLERANCE:
        return None
    weights = weights_of(points)
    target = (points.image * weights).ravel()
    candidates = []
    for patterns in (PATTERNS, MIRRORED):
        rows = (_rows_of(positions, patterns) * weights[..., None]).reshape(2 * len(points), -1)
        similarity = rows[:, :N_SIMILARITY]
        residuals = target - similarity @ np.linalg.lstsq(similarity, target)[0]
        candidates.append((float(residuals @ residuals), patterns, rows))
    # Whether X and Y have the turning sense of the image is seen at once.
    _, patterns, rows = min(candidates, key=lambda candidate: candidate[0])
    covariances = np.array([np.kron(kernel, np.eye(2)) for kernel in _kernels(positions)])
    covariances *= np.outer(weights, weights)
    free = np.linalg.qr(rows[:, :N_SIMILARITY], mode="complete")[0][:, N_SIMILARITY:]
    values, vectors = np.linalg.eigh(free.T @ covariances @ free)
    return PlaneAverage(points, units, positions, patterns, rows, covariances, free @ vectors,
                        np.maximum(values, 0.0))


def _in_units(ground: FloatArray, units: tuple[float, float]) -> FloatArray:
    """Return places (m, 3) in one unit, without heights."""
    return ground * [*units, 0.0]


def _rows_of(positions: FloatArray, patterns: FloatArray) -> FloatArray:
    """Return what each of k patterns adds to line and sample of places, (m, 2, k)."""
    affine = evaluate_monomials(positions, CUBIC)[:, :N_AFFINE]
    return np.asarray(np.einsum("mf,kfa->mak", affine, patterns))


@lru_cache(maxsize=1)  # a prior is the same for all data
def _polynomial_scales() -> FloatArray:
    """Return standard deviations of curved coefficients for each fall, (falls, 7), for size 1."""
    order = np.array(CUBIC[N_AFFINE:]).sum(axis=1)
    return np.asarray(np.array(FALLS)[:, None] ** (order - 2.0))


def _kernels(positions: FloatArray) -> list[FloatArray]:
    """Return covariances of the curvature at n positions, (n, n), by each kernel for the size 1."""
    columns = evaluate_monomials(positions, CUBIC)[:, N_AFFINE:]
    polynomials = [(columns * scales**2) @ columns.T for scales in _polynomial_scales()]
    plan = positions[:, :2]
    return [np.zeros((len(positions),) * 2), *polynomials, spline_field(plan).covariances(plan)]


@lru_cache(maxsize=1)  # a prior is the same for all data
def _forms() -> Forms:
    """Return all forms: no curvature, a polynomial and a spline, each as likely beforehand."""
    sizes = PRIOR_SIZES[1:]
    log_sizes = _normalised(log_prior_of_sizes()[1:])
    # The falls of a polynomial share its probability.
    log_kernels = np.append(np.full(len(FALLS), -np.log(len(FALLS))), 0.0)
    kernels = np.arange(1, len(log_kernels) + 1)
    return Forms(kernel=np.append(0, np.repeat(kernels, len(sizes))),
                 size=np.append(0.0, np.tile(sizes, len(kernels))),
                 log_prior=np.append(0.0, np.add.outer(log_kernels, log_sizes)))


def _log_priors_of_stretches() -> FloatArray:
    """Return the logarithm of the prior of each of STRETCHES, that of a half-Cauchy distribution.
    """
    # Steps of the grid are equal in the logarithm, so that its density is multiplied by the value.
    return _normalised(np.log(STRETCHES) - np.log1p((STRETCHES / STRETCH)**2))


def _normalised(logarithms: FloatArray) -> FloatArray:
    """Return logarithms of probabilities that add up to 1, in the ratios of the given ones."""
    return np.asarray(np.log(normalise_probabilities(logarithms)[0]))
