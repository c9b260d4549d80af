"""How far a local model may be from the truth, which may be rougher or smoother than its form.

A spline and a field of one smoothness state errors that are too small where the truth is rougher,
as where sheets were joined or drawn by hand, and too large where it is smoother. Here the image of
points in a plane is, in line and in sample,

    z = T b + g + e,    g ~ (ratio s)^2 K,  e ~ s^2,

with a trend T of places p in the image, as an affine map of the ground sees them, and a covariance
K of unknown smoothness, length and ratio, or without a field g. All are averaged with their
restricted likelihood, as in `termsel.fitting.misfit`. With c = (ratio^2 k, t) the covariances and
trend of a place and M = [[S, T], [T', 0]], S = I + ratio^2 K, a course has there (universal
kriging)

    the mean c' M^-1 (z, 0) and the variance s^2 (ratio^2 - c' M^-1 c).

The mean square error of any model at the place is this variance and the square of the distance of
the model from the mean, averaged over all courses.

Of more than 200 points, 200 that are spread over them tell it: more would lessen the errors
further, so that sigma is then too large, of 1000 points up to twice.

References
----------
Matheron 1969 for universal kriging; Stein 1999 for the smoothness of the Matern covariance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from termsel.data.features import FloatArray, Points
from termsel.fitting.misfit import (
    NEGLIGIBLE_SHARE,
    Course,
    NoisePrior,
    System,
    rows_of_field,
    trend_of,
)

LOCAL_MIN_POINTS = 20
"""Points below which nothing tells smoothness from length."""

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

FIELD_PROBABILITY = 0.5

NOISE_BY_TREND = np.geomspace(0.01, 2.0, 26)
"""Noises that are tried, by the scatter about the trend."""


@dataclass(frozen=True, eq=False)
class LocalCourses:
    """What points in a plane tell of the truth, in scaled coordinates."""

    to_image: FloatArray  # (3, 2): affine map of the ground
    positions: FloatArray  # (n, 2): of the control under that map
    courses: tuple[Course, ...]
    noise: float  # variance of a measurement of unit weight

    def squares(self, ground: FloatArray, image: FloatArray) -> FloatArray:
        """Return the mean square errors, (m, 2), of a model that sees places in the image."""
        positions = _affine(ground) @ self.to_image
        trend = trend_of(positions, len(self.positions))
        total = np.zeros((len(ground), 2))
        for course in self.courses:
            columns = course.columns(positions, self.positions, trend)
            total += course.squares(columns, image - positions)
        return total


def local_courses(points: Points, pixel: float) -> LocalCourses | None:
    """Return what scaled points in a plane tell; None of few, or of points in a row.

    A `pixel` is in scaled coordinates.
    """
    points = points.take(rows_of_field(len(points)))
    n = len(points)
    if n < LOCAL_MIN_POINTS:
        return None
    affine = _affine(points.ground)
    to_image = np.asarray(np.linalg.lstsq(affine, points.image)[0], dtype=np.float64)
    positions = affine @ to_image
    deviations = points.image - positions
    trend = trend_of(positions, n)
    if np.linalg.matrix_rank(trend) < trend.shape[1] or not deviations.any():
        return None
    smooth_part = trend @ np.linalg.lstsq(trend, deviations)[0]
    noises = NOISE_BY_TREND * np.sqrt(((deviations - smooth_part)**2).mean())
    prior = NoisePrior.of(pixel, points.sigma, with_heights=False)
    relative_variances = np.diag(prior.relative_variances(n))
    log_prior = prior.log_probability(noises)
    system = System(positions, relative_variances, trend, deviations, noises)
    logs = []
    grids = []
    for probability, lengths, smoothness, ratios in _priors():
        by_ratio = system.log_likelihoods(lengths, smoothness, ratios)              # (2, r, s)
        by_noise = np.logaddexp.reduce(by_ratio, axis=1)
        logs.append(np.log(probability) + log_prior + by_noise.sum(axis=0))
        grids.append((lengths, smoothness, ratios, np.exp(by_ratio - by_noise[:, None])))
    shares = np.exp(np.array(logs) - np.logaddexp.reduce(logs, axis=None))           # (c, s)
    if not np.isfinite(shares).all():
        return None
    courses = tuple(system.course(lengths, smoothness, ratios, share * by_ratio)
                    for share, (lengths, smoothness, ratios, by_ratio)
                    in zip(shares, grids, strict=True) if share.sum() > NEGLIGIBLE_SHARE)
    return LocalCourses(to_image, positions, courses, float(shares.sum(axis=0) @ noises**2))


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
