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
the variance at a place are then by the 200 that are nearest to its cell, of some 100 points.

References
----------
Matheron 1969 for universal kriging; Stein 1999 for the smoothness of the Matern covariance;
Zellner 1986 for the prior of a trend.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from termsel.data.features import FloatArray, IntArray, Points
from termsel.fitting.misfit import (
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
"""Most points of a cell."""

NOISE_BY_TREND = np.geomspace(0.01, 2.0, 26)
"""Noises that are tried, by the scatter about the trend."""


@dataclass(frozen=True, eq=False)
class Solutions:
    """How likely ratios and noises are under one covariance, `shares` (2, r, s) of all courses.

    Its trend has the first of all columns.
    """

    trend_columns: int
    lengths: tuple[float, float]
    smoothness: float
    ratios: tuple[float, ...]
    shares: FloatArray

    def course(self, system: System) -> Course:
        """Return the course of some control."""
        likely = self.shares.sum(axis=2).max(axis=0) > NEGLIGIBLE_SHARE
        ratios = tuple(np.array(self.ratios)[likely].tolist())
        system = replace(system, trend=system.trend[:, :self.trend_columns])
        return system.course(self.lengths, self.smoothness, ratios, self.shares[:, likely])


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
        trend = trend_of(positions, len(self.positions))[:, :course.trend_columns]
        return course.columns(positions, self.positions, trend)


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
        if len(positions) <= MISFIT_MAX_POINTS:
            return np.asarray(positions.mean(axis=0, keepdims=True))
        return np.array([positions[rows].mean(axis=0)
                         for rows in _halve_rows(positions, np.arange(len(positions)))])

    @cached_property
    def _cells(self) -> dict[int, Cell]:
        """The cells that were asked for, by number."""
        return {}

    def _cell_of(self, number: int) -> Cell:
        """Return the cell of a number, found from the points next to its centre; kept once found.
        """
        if len(self._centres) == 1:
            return self._spread_cell
        if number not in self._cells:
            squares = ((self.control.positions - self._centres[number])**2).sum(axis=1)
            nearest = np.argpartition(squares, MISFIT_MAX_POINTS)[:MISFIT_MAX_POINTS]
            self._cells[number] = self._cell(nearest)
        return self._cells[number]

    def _cell(self, rows: IntArray) -> Cell:
        system = self.control.take(rows)
        return Cell(system.positions,
                    tuple(solutions.course(system) for solutions in self.solutions))

    def squares(self, ground: FloatArray, image: FloatArray) -> FloatArray:
        """Return the mean square errors, (m, 2), of a model that sees places in the image."""
        positions = _affine(ground) @ self.to_image
        from scipy.spatial import cKDTree  # only now, as it takes long to import

        total = np.full((len(ground), 2), np.nan)
        finite = np.isfinite(positions).all(axis=1)
        number_of_cell = np.full(len(ground), -1)
        number_of_cell[finite] = cKDTree(self._centres).query(positions[finite])[1]
        for number in np.unique(number_of_cell[finite]):
            inside = number_of_cell == number
            total[inside] = self._cell_of(int(number)).squares(
                positions[inside], (image - positions)[inside])
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
        by_trend = _log_likelihoods(system, lengths, smoothness, ratios)             # (t, 2, r, s)
        for trend_columns, by_ratio in zip(TREND_COLUMNS, by_trend, strict=True):
            by_noise = np.logaddexp.reduce(by_ratio, axis=1)
            logs.append(np.log(probability / len(TREND_COLUMNS)) + log_prior
                        + by_noise.sum(axis=0))
            grids.append((trend_columns, lengths, smoothness, ratios,
                          np.exp(by_ratio - by_noise[:, None])))
    shares = np.exp(np.array(logs) - np.logaddexp.reduce(logs, axis=None))           # (c, s)
    if not np.isfinite(shares).all():
        return None
    solutions = tuple(Solutions(*grid[:-1], share * grid[-1])
                      for share, grid in zip(shares, grids, strict=True)
                      if share.sum() > NEGLIGIBLE_SHARE)
    return LocalCourses(to_image, control, solutions, float(shares.sum(axis=0) @ noises**2))


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


def _halve_rows(positions: FloatArray, rows: IntArray) -> list[IntArray]:
    """Return rows cut in halves, across their longer side, until each part has at most CELL_POINTS.
    """
    if len(rows) <= CELL_POINTS:
        return [rows]
    axis = int(np.argmax(np.ptp(positions[rows], axis=0)))
    order = rows[np.argsort(positions[rows, axis], kind="stable")]
    middle = len(order) // 2
    return _halve_rows(positions, order[:middle]) + _halve_rows(positions, order[middle:])


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
