"""How far a model of a plane may be from the truth, which may be rougher or smoother than its form.

A spline and a field of one smoothness state errors that are too small where the truth is rougher,
as where sheets were joined or drawn by hand, and too large where it is smoother; a polynomial that
was chosen as no field showed states none. Here the image of points in a plane is, in line and in
sample,

    z = T b + g + e,    g ~ (ratio s)^2 K,  e ~ s^2,

with an affine, quadratic or cubic trend T, all as likely beforehand, of places in the image, as an
affine map of the ground sees them, and a covariance K of unknown smoothness, length and ratio, or
without a field g. All are averaged with their restricted likelihood, as in
`termsel.fitting.misfit`. With c = (ratio^2 k, t) the covariances and trend of a place,
S = I + ratio^2 K, the diagonal D of s^2 / t^2 for coefficients beyond the affine ones, which are
some t at most as deviations from the affine map show, and M = [[S, T], [T', -D]], a course has
there (universal kriging)

    the mean c' M^-1 (z, 0) and the variance s^2 (ratio^2 - c' M^-1 c).

The mean square error of any model at the place is this variance and the square of the distance of
the model from the mean, averaged over all courses.

More than 200 points are cut in halves again and again into 200 groups, each of which counts as one
point, its mean. With m points and the mean correlation c of two of them, the mean of a group has

    the noise s^2 / m and the variance of the field ratio^2 s^2 (1/m + (1 - 1/m) c),

and the points of a group vary about it by s^2 (1 + ratio^2 (1 - c)). Means and scatter together say
how likely each course is: 200 points alone do not tell a rough field from a smooth one that is
hardly larger than their noise. For the mean and the variance at a place the groups are the smaller
the nearer they are to its cell, and next to it points, unless there are very many. What separates
the mean of the field in a group from the field in its middle, which it is taken for, is noise.

References
----------
Matheron 1969 for universal kriging; Stein 1999 for the smoothness of the Matern covariance;
Zellner 1986 for the prior of a trend.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np

from termsel.core.threads import one_blas_thread
from termsel.data.coordinates.nearest import nearest_points
from termsel.data.features import FloatArray, IntArray, Points
from termsel.fitting.misfit import (
    LARGER_RATIOS,
    MISFIT_BATCH,
    MISFIT_MAX_POINTS,
    NEGLIGIBLE_SHARE,
    TREND_COLUMNS,
    Course,
    LikelySolutions,
    NoisePrior,
    Spectrum,
    System,
    Whitened,
    determined_trend,
    matern_correlations,
    ratio_probabilities,
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
UNEQUAL_SMOOTHNESSES = (0.5, 1.5)
"""Lengths and smoothnesses of what differs along lines and samples, as where a scanner shakes."""

SWATH_LENGTHS = ((0.4, 20.0), (20.0, 0.4), (0.1, 20.0), (20.0, 0.1))
SWATH_SMOOTHNESS = 0.5
"""The same of what jumps from swath to swath of a scan, and is alike all along each."""

UNEQUAL_PROBABILITY = 0.1
"""Probability of both among fields."""

RATIOS = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6, *LARGER_RATIOS)
"""Standard deviations of the field by that of the noise."""

FINE_RATIOS = (*np.geomspace(0.1, 25.6, 17).tolist(), *LARGER_RATIOS)
"""The same where many points show it to a few per cent."""

TREND_SIZES = np.repeat((3.3, 6.6), np.diff(TREND_COLUMNS))
"""Standard deviations beforehand of a trend's quadratic and cubic coefficients, by the root mean
square of all deviations from the affine map: over [-1, 1] a square differs from its mean by 1 / 3.3
in the mean, a cube from its line by 1 / 6.6. Points on two lines leave a square across them open,
which nothing else would bound."""

FIELD_PROBABILITY = 0.8
"""Probability of a field: hardly a sheet is a plane to a tenth of its noise."""

CELL_POINTS = 100
"""Most points of a cell, where that does not make more than MAX_CELLS."""

MAX_CELLS = 16
"""A power of two. Each takes 0.05 to 0.1 s."""

KEPT_CELLS = 4
"""Cells that are kept for further places, of all fits together; each has some 10 MB."""

NOISE_BY_TREND = np.geomspace(0.001, 2.0, 37)
"""Noises that are tried, by the scatter about the trend."""

FINE_NOISE_BY_TREND = np.geomspace(0.001, 1.3, 500)
FINE_FREEDOM = 100
"""The same where the scatter in groups has so many degrees of freedom, or more, and shows it to a
few per cent."""

MEMBERS = 12
"""Most points of a group by which the mean correlation in it is known."""


@dataclass(frozen=True, eq=False)
class Solutions:
    """How likely trends, ratios and noises are under one covariance.

    `shares` (t, 2, r, s) are those of all courses.
    """

    lengths: tuple[float, float]
    smoothness: float
    ratios: tuple[float, ...]
    shares: FloatArray

    def course(self, system: System, discrepancies: FloatArray | float = 0.0) -> Course:
        """Return the course of some control, over all ratios and trends that are not negligible.

        The control may show a mean of the field about its position. `discrepancies` (n,) are the
        variances of that mean less the field at the position, divided by the field's variance.
        """
        probabilities = self.shares.sum(axis=3)                                        # (t, 2, r)
        noise = self.shares @ system.noises**2                                         # (t, 2, r)
        degree, ratio = np.nonzero(probabilities.max(axis=1) > NEGLIGIBLE_SHARE)       # (w,) each
        weights = probabilities[degree, :, ratio].T                                    # (2, w)
        noise_of_likely = noise[degree, :, ratio].T
        # The noise by the variance of a coefficient beforehand: of the affine ones it is 0.
        trend_variances = TREND_SIZES**2 * (system.residuals**2).mean()
        columns = np.arange(system.trend.shape[1])
        curved = columns >= TREND_COLUMNS[0]
        precisions = np.zeros((len(ratio), len(columns)))
        precisions[:, curved] = np.divide.outer(
            noise_of_likely.sum(axis=0) / weights.sum(axis=0), trend_variances[:curved.sum()])
        precisions[columns >= np.array(TREND_COLUMNS)[degree, None]] = np.inf
        correlations = matern_correlations(
            system.positions, system.positions, self.lengths, self.smoothness)
        correlations[np.diag_indices_from(correlations)] += discrepancies
        spectrum = Spectrum.of(correlations, system.relative_variances, self.lengths,
                               self.smoothness)
        seen = Whitened.of([spectrum], self.ratios, system.trend, system.residuals)
        return seen.courses([LikelySolutions(
            0, float(probabilities[:, 0].sum()), ratio, precisions, weights, noise_of_likely)])[0]


@dataclass(frozen=True, eq=False)
class Groups:
    """How points of groups vary about their means, in scaled coordinates."""

    sizes: FloatArray  # (g,)
    counts: FloatArray  # (g,): members that stand for a group
    from_middle: FloatArray  # (p, 2): of members, along lines and samples
    group_of_member: IntArray  # (p,)
    apart: FloatArray  # (q, 2): of pairs of members
    group_of_pair: IntArray  # (q,)
    squares: FloatArray  # (2,): of the points about their means, by relative variances

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the squares on each axis."""
        return float((self.sizes - 1.0).sum())

    def correlations(self, lengths: tuple[float, float], smoothness: float) -> FloatArray:
        """Return the mean correlation of two points of each group, (g,); 1 for a single point."""
        return self._mean_correlations(self.apart, self.group_of_pair, lengths, smoothness)

    def discrepancies(self, lengths: tuple[float, float], smoothness: float) -> FloatArray:
        """Return how far the mean of a field in each group is from the field in its middle, (g,).

        It is the variance of mean minus middle, divided by the variance of the field.
        """
        # Var(mean - middle) = 1 - 2 Cov(mean, middle) + Var(mean).
        variance_of_mean = (1.0 / self.counts
                            + (1.0 - 1.0 / self.counts) * self.correlations(lengths, smoothness))
        covariance = self._mean_correlations(
            self.from_middle, self.group_of_member, lengths, smoothness)
        return np.maximum(1.0 - 2.0 * covariance + variance_of_mean, 0.0)

    def _mean_correlations(self, distances: FloatArray, group_of: IntArray,
                           lengths: tuple[float, float],
                           smoothness: float) -> FloatArray:
        """Return the mean correlation over the distances (p, 2) of each group, (g,).

        `group_of` (p,) is the number of each distance's group. The mean is 1 for a group without
        distances.
        """
        correlations = matern_correlations(distances, np.zeros((1, 2)), lengths, smoothness)[:, 0]
        counts = np.bincount(group_of, minlength=len(self.sizes))
        sums = np.bincount(group_of, correlations, len(self.sizes))
        return np.where(counts > 0, sums / np.maximum(counts, 1), 1.0)

    def log_likelihoods(self, increases: FloatArray, noises: FloatArray) -> FloatArray:
        """Return the log likelihoods of the squares for each noise, (2, r, s).

        A field within the groups multiplies the variance of the noise by an increase (r,).
        """
        variances = np.multiply.outer(increases, noises**2)                            # (r, s)
        return np.asarray(-0.5 * (self.freedom * np.log(variances)
                                  + self.squares[:, None, None] / variances))


@dataclass(frozen=True, eq=False)
class CourseCell:
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
                              trend_of(positions, course.trend_columns))


@dataclass(frozen=True, eq=False)
class LocalCourses:
    """What points in a plane show of the truth, in scaled coordinates."""

    to_image: FloatArray  # (3, 2): affine map of the ground
    control: System
    solutions: tuple[Solutions, ...]
    noise: float  # variance of a measurement of unit weight

    @cached_property
    def _spread_cell(self) -> CourseCell:
        """A cell of all points, or of many of those that are spread evenly over them."""
        system = self.control.take(rows_of_field(len(self.control.positions)))
        return CourseCell(system.positions,
                          tuple(solutions.course(system) for solutions in self.solutions))

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

    def cell_of(self, number: int) -> CourseCell:
        """Return the cell of a number: the courses near its centre.

        The control is in groups, which are the smaller, the nearer they are to the centre; each
        counts as one point.
        """
        if len(self._centres) == 1:
            return self._spread_cell
        squares = ((self._centres - self._centres[number])**2).sum(axis=1)
        squares[number] = np.inf
        # The cell reaches to the next centre: groups within that are small.
        groups = _groups_around(self.control.positions, self._centres[number],
                                float(np.sqrt(squares.min())))
        system = _means_of(self.control, groups)
        if np.linalg.matrix_rank(system.trend) < system.trend.shape[1]:
            return self._spread_cell
        within = _variation_within_groups(self.control.positions, self.control.residuals,
                                          self.control.relative_variances, groups)
        return CourseCell(system.positions, tuple(
            solutions.course(system, within.discrepancies(solutions.lengths, solutions.smoothness))
            for solutions in self.solutions))

    @one_blas_thread
    def squares(self, ground: FloatArray, image: FloatArray) -> FloatArray:
        """Return the mean square errors, (m, 2), of a model that sees places in the image.

        Of many points only the last cells are kept, as they would fill the memory: many places
        should be in one call.
        """
        positions = _affine_columns(ground) @ self.to_image
        total = np.full((len(ground), 2), np.nan)
        finite = np.isfinite(positions).all(axis=1)
        number_of_cell = np.full(len(ground), -1)
        number_of_cell[finite] = nearest_points(self._centres, positions[finite])[1][:, 0]
        for number in np.unique(number_of_cell[finite]):
            inside = np.flatnonzero(number_of_cell == number)
            cell = _kept_cell(self, int(number))
            # In batches, as covariances between all places would fill the memory.
            for batch in np.array_split(inside, len(inside) // MISFIT_BATCH + 1):
                total[batch] = cell.squares(positions[batch], image[batch] - positions[batch])
        return total

    def covariance(self, ground: FloatArray, image: FloatArray, axis: int) -> FloatArray:
        """Return the mean products of a model's errors at m places, (m, m), on one axis.

        The model sees the ground (m, 3) at `image` (m, 2). Many control points are represented by
        those that are spread evenly over them.
        """
        positions = _affine_columns(ground) @ self.to_image
        cell = self._spread_cell
        total = np.zeros((len(ground), len(ground)))
        for course in cell.courses:
            columns = cell.columns(course, positions)
            total += course.second_moments(positions, columns, axis,
                                           (image - positions)[:, axis])
        return total


@lru_cache(maxsize=KEPT_CELLS)  # places are asked for one by one, as by clicks on a map
def _kept_cell(courses: LocalCourses, number: int) -> CourseCell:
    """Return a cell, kept for places that are asked for one by one, as by clicks on a map."""
    return courses.cell_of(number)


def local_courses(points: Points, pixel: float) -> LocalCourses | None:
    """Return the courses of the error between scaled points in a plane, as the points show them.

    `pixel` is the size of a pixel in scaled coordinates. Returns None for few points, for points
    that do not determine a quadratic trend, as in a row, and for points without any deviation.
    """
    spread_rows = rows_of_field(len(points))
    if len(spread_rows) < LOCAL_MIN_POINTS:
        return None
    affine = _affine_columns(points.ground)
    to_image = np.asarray(np.linalg.lstsq(affine[spread_rows], points.image[spread_rows])[0],
                          dtype=np.float64)
    positions = affine @ to_image
    deviations = points.image - positions
    trend = determined_trend(positions, spread_rows)
    if trend is None or trend.shape[1] < TREND_COLUMNS[1] or not deviations[spread_rows].any():
        return None
    trend_fit = np.linalg.lstsq(trend[spread_rows], deviations[spread_rows])[0]
    from_trend = deviations - trend @ trend_fit
    groups = _groups_around(positions, positions.mean(axis=0), np.inf)
    prior = NoisePrior.of(pixel, points.sigma, with_heights=False)
    relative_variances = prior.relative_variances(len(points))
    within = _variation_within_groups(positions, from_trend, relative_variances, groups)
    is_fine = within.freedom >= FINE_FREEDOM
    noises = ((FINE_NOISE_BY_TREND if is_fine else NOISE_BY_TREND)
              * np.sqrt((from_trend[spread_rows]**2).mean()))
    log_prior = prior.log_probability(noises)
    control = System(positions, relative_variances, trend, deviations, noises)
    system = _means_of(control, groups)
    logs = []
    grids = []
    for covariance in _prior_covariances(FINE_RATIOS if is_fine else RATIOS):
        probability, lengths, smoothness, ratios = covariance
        by_ratio = _log_likelihoods(system, within, covariance)                      # (t, 2, r, s)
        by_noise = np.logaddexp.reduce(by_ratio, axis=2)                               # (t, 2, s)
        # All trends are as likely beforehand.
        logs.append(np.log(probability / len(by_ratio)) + log_prior + by_noise.sum(axis=1))
        grids.append((lengths, smoothness, ratios, np.exp(by_ratio - by_noise[:, :, None])))
    shares = np.exp(np.array(logs) - np.logaddexp.reduce(logs, axis=None))           # (c, t, s)
    if not np.isfinite(shares).all():
        return None
    solutions = tuple(Solutions(*grid[:-1], share[:, None, None] * grid[-1])
                      for share, grid in zip(shares, grids, strict=True)
                      if share.sum() > NEGLIGIBLE_SHARE)
    return LocalCourses(to_image, control, solutions,
                        float(shares.sum(axis=(0, 1)) @ noises**2))


def _log_likelihoods(system: System, within: Groups, covariance: Covariance) -> FloatArray:
    """Return log p(z, ratio | trend, length, s) of all trends and both axes, (t, 2, r, s).

    The affine part of the trend may be anything. The part of higher degree has beforehand the
    information of one point (Zellner 1986, with g = n): so the likelihood is that of the affine
    trend, times a factor for what the columns of higher degree explain.
    """
    _, lengths, smoothness, ratios = covariance
    in_groups = within.correlations(lengths, smoothness)
    correlation = matern_correlations(system.positions, system.positions, lengths, smoothness)
    np.fill_diagonal(correlation, 1.0 / within.sizes + (1.0 - 1.0 / within.sizes) * in_groups)
    # What two points of a group do not have in common, by the degrees of freedom of the groups.
    share_apart = float((within.sizes - 1.0) @ (1.0 - in_groups)) / max(within.freedom, 1.0)
    n, f = system.trend.shape
    affine_columns = TREND_COLUMNS[0]
    trends = [columns for columns in TREND_COLUMNS if columns <= f]
    # With V^-1/2 K V^-1/2 = Q diag(values) Q', S = V + ratio^2 K is whitened for any ratio.
    scale = 1.0 / np.sqrt(system.relative_variances)
    values, vectors = np.linalg.eigh(correlation * np.outer(scale, scale))
    values = np.maximum(values, 0.0)
    turned = vectors.T @ (scale[:, None] * np.column_stack([system.trend, system.residuals]))
    squared_ratios = np.square(ratios)
    variances = 1.0 + np.multiply.outer(squared_ratios, values)                        # (r, n)
    whitened = turned / np.sqrt(variances)[..., None]                                  # (r, n, .)
    # Of the triangle of trend and residuals the last columns are the residuals along the trend.
    triangle = np.asarray(np.linalg.qr(whitened, mode="r"))
    along_squared = triangle[:, :f, f:]**2                                             # (r, f, 2)
    squares = ((whitened[..., f:]**2).sum(axis=1)
               - along_squared[:, :affine_columns].sum(axis=1))                        # (r, 2)
    diagonal = np.diagonal(triangle, axis1=1, axis2=2)[:, :affine_columns]
    determinants = (0.5 * np.log(variances).sum(axis=1) - np.log(scale).sum()
                    + np.log(np.abs(diagonal)).sum(axis=1))                            # (r,)
    affine = (-(n - affine_columns) * np.log(system.noises)
              - 0.5 * squares.T[..., None] / system.noises**2 - determinants[:, None])
    affine += within.log_likelihoods(1.0 + squared_ratios * share_apart, system.noises)
    logs = np.empty((len(trends), *affine.shape))                                # (t, 2, r, s)
    for j, columns in enumerate(trends):
        explained = along_squared[:, affine_columns:columns].sum(axis=1)               # (r, 2)
        logs[j] = (affine + explained.T[..., None] / system.noises**2 * (0.5 * n / (n + 1.0))
                   - 0.5 * (columns - affine_columns) * np.log(n + 1.0))
    return np.asarray(logs + np.log(ratio_probabilities(ratios))[:, None])


def _halve_rows(positions: FloatArray, rows: IntArray, most: int) -> list[IntArray]:
    """Return rows cut in halves, across their longer side, until each part has at most `most`.

    `positions` (n, 2) are those of all, and `rows` the indices of those that are cut.
    """
    if len(rows) <= most:
        return [rows]
    axis = int(np.argmax(np.ptp(positions[rows], axis=0)))
    order = rows[np.argsort(positions[rows, axis], kind="stable")]
    middle = len(order) // 2
    return (_halve_rows(positions, order[:middle], most)
            + _halve_rows(positions, order[middle:], most))


def _groups_around(positions: FloatArray, centre: FloatArray, reach: float) -> list[IntArray]:
    """Return rows in MISFIT_MAX_POINTS groups, cut in halves the finer the nearer to a centre.

    A group lists the indices of its rows among the `positions` (n, 2). The next group to be cut is
    the one that is seen under the largest angle from the centre. Within the `reach` of the centre
    distances do not count, and the largest group is cut: everywhere, if the reach is infinite.
    """
    def entry(rows: IntArray) -> tuple[float, int, IntArray]:
        extent = float(np.ptp(positions[rows], axis=0).max())
        distance = float(np.linalg.norm(positions[rows].mean(axis=0) - centre))
        return -extent / max(distance / reach, 1.0), int(rows[0]), rows

    # A heap whose first entry is the next to be cut: its key is the negative angle.
    groups = [entry(np.arange(len(positions)))]
    while len(groups) < MISFIT_MAX_POINTS and groups[0][0] < 0.0:
        rows = heappop(groups)[2]
        for half in _halve_rows(positions, rows, -(-len(rows) // 2)):
            heappush(groups, entry(half))
    return [rows for _, _, rows in groups]


def _variation_within_groups(positions: FloatArray, deviations: FloatArray,
                             relative_variances: FloatArray,
                             groups: list[IntArray]) -> Groups:
    """Return how the points of groups vary about their means.

    `positions` (n, 2) and `deviations` (n, 2) are of points, `relative_variances` (n,) of their
    errors; a group is an array of rows. Of large groups some members stand for all, as pairs grow
    with the square. The sum of squares about the weighted means, one for either axis, estimates the
    noise without what neighbours have in common.
    """
    squares = np.zeros(2)
    from_middle = [np.empty((0, 2))]
    apart = [np.empty((0, 2))]
    counts = np.ones(len(groups), dtype=np.intp)
    pair_counts = np.zeros(len(groups), dtype=np.intp)
    for number, rows in enumerate(groups):
        if len(rows) < 2:
            from_middle.append(np.zeros((1, 2)))
            continue
        # Neighbours share the model's error, so that about their mean only noise remains.
        weights = 1.0 / relative_variances[rows]
        mean = weights @ deviations[rows] / weights.sum()
        squares += weights @ (deviations[rows] - mean)**2
        # Every k-th, k = ceil(n / MEMBERS), so that the members spread over the group.
        members = positions[rows[:: -(-len(rows) // MEMBERS)]]
        first_of_pair, second_of_pair = np.triu_indices(len(members), 1)
        from_middle.append(members - members.mean(axis=0))
        apart.append(members[first_of_pair] - members[second_of_pair])
        counts[number] = len(members)
        pair_counts[number] = len(first_of_pair)
    numbers = np.arange(len(groups))
    return Groups(np.array([float(len(rows)) for rows in groups]), counts.astype(np.float64),
                  np.concatenate(from_middle), np.repeat(numbers, counts),
                  np.concatenate(apart), np.repeat(numbers, pair_counts), squares)


def _means_of(control: System, groups: list[IntArray]) -> System:
    """Return the control with each group as one point: the weighted mean of its measurements.

    A group lists the indices of its rows. The relative variance of a mean is 1 over the sum of the
    weights, the inverse relative variances of its rows.
    """
    group_of = np.empty(len(control.positions), dtype=np.intp)
    for number, rows in enumerate(groups):
        group_of[rows] = number
    weights = 1.0 / control.relative_variances
    sums = np.bincount(group_of, weights, len(groups))

    def mean(values: FloatArray) -> FloatArray:
        return np.stack([np.bincount(group_of, weights * column, len(groups)) / sums
                         for column in values.T], axis=1)

    return replace(control, positions=mean(control.positions), relative_variances=1.0 / sums,
                   trend=mean(control.trend), residuals=mean(control.residuals))


class Covariance(NamedTuple):
    """The form of a field's covariance, and how probable it is beforehand."""

    probability: float
    lengths: tuple[float, float]  # along lines and samples, scaled
    smoothness: float
    ratios: tuple[float, ...]  # standard deviations of the field by that of the noise


def _prior_covariances(field_ratios: tuple[float, ...]) -> Iterator[Covariance]:
    """Yield the covariances of the prior; their probabilities sum to 1.

    The first stands for no field: its only ratio is 0. It is followed by fields that are alike
    along lines and samples, then by those that differ along them. Each field may have any of the
    `field_ratios`, its standard deviations by that of the noise.
    """
    yield Covariance(1.0 - FIELD_PROBABILITY, LENGTHS[0], SMOOTHNESSES[0], (0.0,))
    # Of the probability of a field, 1 - UNEQUAL_PROBABILITY goes evenly to all pairs of LENGTHS and
    # SMOOTHNESSES, and the rest evenly to all fields that differ, swaths among them.
    equal = FIELD_PROBABILITY * (1.0 - UNEQUAL_PROBABILITY) / len(LENGTHS) / len(SMOOTHNESSES)
    for smoothness in SMOOTHNESSES:
        for lengths in LENGTHS:
            yield Covariance(equal, lengths, smoothness, field_ratios)
    unequal = (FIELD_PROBABILITY * UNEQUAL_PROBABILITY
               / (len(UNEQUAL_LENGTHS) * len(UNEQUAL_SMOOTHNESSES) + len(SWATH_LENGTHS)))
    for smoothness in UNEQUAL_SMOOTHNESSES:
        for lengths in UNEQUAL_LENGTHS:
            yield Covariance(unequal, lengths, smoothness, field_ratios)
    for lengths in SWATH_LENGTHS:
        yield Covariance(unequal, lengths, SWATH_SMOOTHNESS, field_ratios)


def _affine_columns(ground: FloatArray) -> FloatArray:
    """Return 1, X and Y of places, (n, 3)."""
    return np.column_stack([np.ones(len(ground)), ground[:, :2]])
