"""How far a model of a plane may be from the truth, which may be rougher or smoother than its form.

A spline and a field of one smoothness state errors that are too small where the truth is rougher,
as where sheets were joined or drawn by hand, and too large where it is smoother; a polynomial that
was chosen as no field showed states none. Here the image of points in a plane is, in line and in
sample,

    z = T b + g + e,    g ~ (ratio s)^2 K,  e ~ s^2,

with an affine or quadratic trend T of places in the image, as an affine map of the ground sees
them, and a covariance K of unknown smoothness, length and ratio, or without a field g. All are
averaged with their restricted likelihood, as in `termsel.fitting.misfit`. With c = (ratio^2 k, t)
the covariances and trend of a place and M = [[S, T], [T', 0]], S = I + ratio^2 K, a course has
there (universal kriging)

    the mean c' M^-1 (z, 0) and the variance s^2 (ratio^2 - c' M^-1 c).

The mean square error of any model at the place is this variance and the square of the distance of
the model from the mean, averaged over all courses.

Of more than 200 points, 200 that are spread over them show how likely each course is. The mean and
the variance at a place are then by 60 that are far apart, which hold the trend even where those
near by lie in a row, and by the 140 others that are nearest to its cell, of some 100 points. There
are at most 16 cells: of more than 1600 points they are larger, and only some of the points around
them are taken. The errors that are stated are then those of a model that had no more points, too
large rather than too small.

References
----------
Matheron 1969 for universal kriging; Stein 1999 for the smoothness of the Matern covariance;
Zellner 1986 for the prior of a trend.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from termsel.core.threads import one_blas_thread
from termsel.data.features import FloatArray, IntArray, Points
from termsel.fitting.misfit import (
    MISFIT_BATCH,
    MISFIT_MAX_POINTS,
    NEGLIGIBLE_SHARE,
    Course,
    NoisePrior,
    System,
    matern,
    rows_of_field,
    trend_of,
)

LOCAL_MIN_POINTS = 20
"""Points below which nothing distinguishes smoothness from length."""

LENGTHS = tuple((length, length) for length in (0.1, 0.2, 0.4, 0.8, 1.6))
"""Lengths of fields that are alike in line and sample, by the half-range of the image."""

SMOOTHNESSES = (0.5, 1.5, np.inf)
"""Of Matern covariances: of what jumps or bends sharply, of what has a slope, and of what has all
derivatives."""

UNEQUAL_LENGTHS = ((0.15, 2.0), (2.0, 0.15), (0.05, 2.0), (2.0, 0.05))
UNEQUAL_PROBABILITY = 0.1
"""Lengths of what differs along lines and samples, of smoothness 3/2, and their probability among
fields."""

RATIOS = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6)
"""Standard deviations of the field by that of the noise, all as likely beforehand."""

FIELD_PROBABILITY = 0.8
"""Probability of a field: hardly a sheet is a plane to a tenth of its noise."""

TREND_COLUMNS = 3, 6
"""Of an affine and of a quadratic trend, both as likely beforehand."""

CELL_POINTS = 100
"""Most points of a cell, where that does not make more than MAX_CELLS."""

MAX_CELLS = 16
"""A power of two. Each takes 0.05 to 0.1 s."""

APART_POINTS = 60
"""Points of each cell's courses that lie far apart over all control."""

REACH = 1.4
"""Points from which those near a cell are taken, by the points of the cell."""

NOISE_BY_TREND = np.geomspace(0.01, 2.0, 26)
"""Noises that are tried, by the scatter about the trend."""


@dataclass(frozen=True, eq=False)
class Solutions:
    """How likely trends, ratios and noises are under one covariance.

    `shares` (t, 2, r, s) are those of all courses.
    """

    lengths: tuple[float, float]
    smoothness: float
    ratios: tuple[float, ...]
    shares: FloatArray

    def course(self, system: System) -> Course:
        """Return the course of some control: all ratios with an affine and a quadratic trend."""
        likely = self.shares.sum(axis=3).max(axis=1) > NEGLIGIBLE_SHARE                # (t, r)
        shares = self.shares * likely[:, None, :, None]
        noise = shares @ system.noises**2                                              # (t, 2, r)
        correlation = matern(system.positions, system.positions, self.lengths, self.smoothness)
        variances = np.diag(system.relative_variances)
        n, f = system.trend.shape
        explained = np.zeros((2, n + f, n + f))
        means = np.zeros((*likely.shape, n + f, 2))
        for i in np.flatnonzero(likely.any(axis=0)):
            squared_ratio = self.ratios[i]**2
            inverse = np.asarray(np.linalg.inv(variances + squared_ratio * correlation))
            for j in np.flatnonzero(likely[:, i]):
                columns = TREND_COLUMNS[j]
                scale = np.concatenate([np.full(n, squared_ratio), np.ones(columns)])
                scaled = scale[:, None] * _with_trend(inverse, system.trend[:, :columns])
                means[j, i, :n + columns] = scaled[:, :n] @ system.residuals
                scaled *= scale
                for axis in (0, 1):
                    explained[axis, :n + columns, :n + columns] += noise[j, axis, i] * scaled
        weights = np.moveaxis(shares.sum(axis=3), 1, 0)                                # (2, t, r)
        return Course(float(shares[:, 0].sum()), self.lengths, self.smoothness,
                      noise.sum(axis=0) @ np.square(self.ratios), explained,
                      weights[:, likely], means[likely], f)


def _with_trend(inverse: FloatArray, trend: FloatArray) -> FloatArray:
    """Return [[S, T], [T', 0]]^-1, (n + f, n + f), from S^-1 and the trend T (n, f)."""
    toward = inverse @ trend
    of_trend = np.linalg.inv(trend.T @ toward)
    gain = toward @ of_trend
    return np.block([[inverse - gain @ toward.T, gain], [gain.T, -of_trend]])


@dataclass(frozen=True, eq=False)
class Cell:
    """A part of the control, and what it shows of places near by."""

    positions: FloatArray  # (n, 2): of control in the cell and around it
    courses: tuple[Course, ...]

    def squares(self, positions: FloatArray, deviations: FloatArray) -> FloatArray:
        """Return the mean square errors, (m, 2), of a model with such deviations at positions."""
        total = np.zeros((len(positions), 2))
        for course in self.courses:
            total += course.squares(self.columns(course, positions), deviations)
        return total

    def columns(self, course: Course, positions: FloatArray) -> FloatArray:
        """Return the columns at positions (m, 2) from which a course has its mean and variance."""
        return course.columns(positions, self.positions,
                              trend_of(positions, len(self.positions)))


@dataclass(frozen=True, eq=False)
class LocalCourses:
    """What points in a plane show of the truth, in scaled coordinates."""

    to_image: FloatArray  # (3, 2): affine map of the ground
    control: System
    solutions: tuple[Solutions, ...]
    noise: float  # variance of a measurement of unit weight

    @cached_property
    def _spread_cell(self) -> Cell:
        """All of few points, or those that are spread over them."""
        return self._cell(rows_of_field(len(self.control.positions)))

    @cached_property
    def _centres(self) -> FloatArray:
        """The middles of all cells, (c, 2)."""
        positions = self.control.positions
        n = len(positions)
        if n <= MISFIT_MAX_POINTS:
            return np.asarray(positions.mean(axis=0, keepdims=True))
        most = max(CELL_POINTS, -(-n // MAX_CELLS))
        return np.array([positions[rows].mean(axis=0)
                         for rows in _halve_rows(positions, np.arange(n), most)])

    @cached_property
    def _apart(self) -> IntArray:
        """Rows of control that is far apart."""
        return _rows_far_apart(self.control.positions, APART_POINTS)

    def _cell_of(self, number: int) -> Cell:
        """Return the cell of a number, by the points next to its centre and those far apart."""
        if len(self._centres) == 1:
            return self._spread_cell
        positions = self.control.positions
        squares = ((positions - self._centres[number])**2).sum(axis=1)
        squares[self._apart] = np.inf
        count = MISFIT_MAX_POINTS - len(self._apart)
        reach = max(count, int(REACH * len(positions) / len(self._centres)))
        near = np.argsort(squares)[np.linspace(0, reach - 1, count).round().astype(np.intp)]
        rows = np.concatenate([self._apart, near])
        trend = self.control.trend[rows]
        if np.linalg.matrix_rank(trend) < trend.shape[1]:
            return self._spread_cell
        return self._cell(rows)

    def _cell(self, rows: IntArray) -> Cell:
        system = self.control.take(rows)
        return Cell(system.positions,
                    tuple(solutions.course(system) for solutions in self.solutions))

    @one_blas_thread
    def squares(self, ground: FloatArray, image: FloatArray) -> FloatArray:
        """Return the mean square errors, (m, 2), of a model that sees places in the image.

        Of many points each call finds the cells of its places anew, as they would fill the memory:
        all places should be in one call.
        """
        positions = _affine(ground) @ self.to_image
        from scipy.spatial import cKDTree  # only now, as it takes long to import

        total = np.full((len(ground), 2), np.nan)
        finite = np.isfinite(positions).all(axis=1)
        number_of_cell = np.full(len(ground), -1)
        number_of_cell[finite] = cKDTree(self._centres).query(positions[finite])[1]
        for number in np.unique(number_of_cell[finite]):
            inside = np.flatnonzero(number_of_cell == number)
            cell = self._cell_of(int(number))
            # In batches, as covariances between all places would fill the memory.
            for batch in np.array_split(inside, len(inside) // MISFIT_BATCH + 1):
                total[batch] = cell.squares(positions[batch], image[batch] - positions[batch])
        return total

    def covariance(self, ground: FloatArray, image: FloatArray, axis: int) -> FloatArray:
        """Return the mean products of such errors among places, (m, m), on one axis.

        Of many points they are by those that are spread over them.
        """
        positions = _affine(ground) @ self.to_image
        cell = self._spread_cell
        total = np.zeros((len(ground), len(ground)))
        for course in cell.courses:
            columns = cell.columns(course, positions)
            total += course.covariance(positions, columns, axis, (image - positions)[:, axis])
        return total


def local_courses(points: Points, pixel: float) -> LocalCourses | None:
    """Return the courses of the error between scaled points in a plane, as the points show them.

    A `pixel` is in scaled coordinates. None with few points, or points in a row.
    """
    spread = rows_of_field(len(points))
    n = len(spread)
    if n < LOCAL_MIN_POINTS:
        return None
    affine = _affine(points.ground)
    to_image = np.asarray(np.linalg.lstsq(affine[spread], points.image[spread])[0],
                          dtype=np.float64)
    positions = affine @ to_image
    deviations = points.image - positions
    trend = trend_of(positions, n)
    if np.linalg.matrix_rank(trend[spread]) < trend.shape[1] or not deviations[spread].any():
        return None
    smooth_part = trend[spread] @ np.linalg.lstsq(trend[spread], deviations[spread])[0]
    noises = NOISE_BY_TREND * np.sqrt(((deviations[spread] - smooth_part)**2).mean())
    prior = NoisePrior.of(pixel, points.sigma, with_heights=False)
    log_prior = prior.log_probability(noises)
    control = System(positions, prior.relative_variances(len(points)), trend, deviations, noises)
    system = control.take(spread)
    logs = []
    grids = []
    for probability, lengths, smoothness, ratios in _priors():
        by_ratio = _log_likelihoods(system, lengths, smoothness, ratios)             # (t, 2, r, s)
        by_noise = np.logaddexp.reduce(by_ratio, axis=2)                               # (t, 2, s)
        logs.append(np.log(probability / len(TREND_COLUMNS)) + log_prior + by_noise.sum(axis=1))
        grids.append((lengths, smoothness, ratios, np.exp(by_ratio - by_noise[:, :, None])))
    shares = np.exp(np.array(logs) - np.logaddexp.reduce(logs, axis=None))           # (c, t, s)
    if not np.isfinite(shares).all():
        return None
    solutions = tuple(Solutions(*grid[:-1], share[:, None, None] * grid[-1])
                      for share, grid in zip(shares, grids, strict=True)
                      if share.sum() > NEGLIGIBLE_SHARE)
    return LocalCourses(to_image, control, solutions,
                        float(shares.sum(axis=(0, 1)) @ noises**2))


def _log_likelihoods(system: System, lengths: tuple[float, float], smoothness: float,
                     ratios: tuple[float, ...]) -> FloatArray:
    """Return log p(z, ratio | trend, length, s) of both trends and axes, (2, 2, r, s).

    The affine part of the trend may be anything. That of higher degree has beforehand the
    information of one point (Zellner 1986, with g = n): the likelihood is that of the affine trend,
    and what the columns explain beyond it.
    """
    correlation = matern(system.positions, system.positions, lengths, smoothness)
    variances = np.diag(system.relative_variances)
    n, f = system.trend.shape
    affine_columns = TREND_COLUMNS[0]
    logs = np.empty((len(TREND_COLUMNS), 2, len(ratios), len(system.noises)))
    for i, ratio in enumerate(ratios):
        lower = np.linalg.cholesky(variances + ratio**2 * correlation)
        whitened = np.linalg.solve(lower, np.column_stack([system.trend, system.residuals]))
        q, r = np.linalg.qr(whitened[:, :f])
        along = q.T @ whitened[:, f:]                                                  # (f, 2)
        explained = (along[affine_columns:]**2).sum(axis=0)[:, None] / system.noises**2
        squares = (whitened[:, f:]**2).sum(axis=0) - (along[:affine_columns]**2).sum(axis=0)
        determinant = np.log(np.diag(lower)).sum() \
            + np.log(np.abs(np.diag(r)[:affine_columns])).sum()
        affine = -(n - affine_columns) * np.log(system.noises) \
            - 0.5 * squares[:, None] / system.noises**2 - determinant
        logs[0, :, i] = affine
        logs[1, :, i] = affine + 0.5 * explained * n / (n + 1.0) \
            - 0.5 * (f - affine_columns) * np.log(n + 1.0)
    return np.asarray(logs - np.log(len(ratios)))


def _halve_rows(positions: FloatArray, rows: IntArray, most: int) -> list[IntArray]:
    """Return rows cut in halves, across their longer side, until each part has at most `most`."""
    if len(rows) <= most:
        return [rows]
    axis = int(np.argmax(np.ptp(positions[rows], axis=0)))
    order = rows[np.argsort(positions[rows, axis], kind="stable")]
    middle = len(order) // 2
    return _halve_rows(positions, order[:middle], most) \
        + _halve_rows(positions, order[middle:], most)


def _rows_far_apart(positions: FloatArray, count: int) -> IntArray:
    """Return rows, each the farthest from those before it, the first from the middle, (count,)."""
    squares = ((positions - positions.mean(axis=0))**2).sum(axis=1)
    rows = [int(np.argmax(squares))]
    squares[:] = np.inf
    while len(rows) < count:
        squares = np.minimum(squares, ((positions - positions[rows[-1]])**2).sum(axis=1))
        squares[rows] = -1.0  # so that none comes twice, even of equal positions
        rows.append(int(np.argmax(squares)))
    return np.array(rows, dtype=np.intp)


def _priors() -> Iterator[tuple[float, tuple[float, float], float, tuple[float, ...]]]:
    """Return probability, lengths, smoothness and ratios of all covariances, at first of none."""
    yield 1.0 - FIELD_PROBABILITY, LENGTHS[0], SMOOTHNESSES[0], (0.0,)
    equal = FIELD_PROBABILITY * (1.0 - UNEQUAL_PROBABILITY) / len(LENGTHS) / len(SMOOTHNESSES)
    for smoothness in SMOOTHNESSES:
        for lengths in LENGTHS:
            yield equal, lengths, smoothness, RATIOS
    for lengths in UNEQUAL_LENGTHS:
        yield FIELD_PROBABILITY * UNEQUAL_PROBABILITY / len(UNEQUAL_LENGTHS), lengths, 1.5, RATIOS


def _affine(ground: FloatArray) -> FloatArray:
    return np.column_stack([np.ones(len(ground)), ground[:, :2]])
