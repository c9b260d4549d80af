"""How far a model with heights may be from the truth, which may be rougher or smoother than it.

An image of a camera is, in line and in sample of places (X, Y, Z),

    z = F b + g + e,    g ~ (ratio s)^2 K,  e ~ s^2,

with the monomials F of the place up to cubic ones, and a field g of where it lies in the image.
Affine coefficients b may be anything, those of higher degree are N(0, (size rule_k s)^2): they are
shrunken as `termsel.auto.shrunken` says. The covariance K has an unknown smoothness and length.
Half of all fields are those of a scanner, which shakes in time: all along a line, or a column, is
displaced alike. Sizes, ratios and the noise s are unknown, too, and all are averaged with their
restricted likelihood. With S = I + ratio^2 K, the diagonal D of 1 / (size rule_k)^2, 0 for the a
affine columns, and A = F' S^-1 F + D, it is

    p(z | ...) ~ |S|^-1/2 |A|^-1/2 |D|^1/2 s^-(n - a) exp(-z' P z / 2 s^2),
    P = S^-1 - S^-1 F A^-1 F' S^-1,

|D| of the shrunken columns alone. With c = (ratio^2 k, f) the covariances to the control and the
monomials of a place, and M = [[S, F], [F', -D]], a solution has there

    the mean c' M^-1 (z, 0) and the variance s^2 (ratio^2 - c' M^-1 c).

The mean square error of any model at the place is this variance and the square of the distance of
the model from the mean, averaged over all solutions. Of more than 200 points those count that are
spread over them, and up to 400 points the less the more there are. In a plane
`termsel.fitting.local_courses` does the same.

References
----------
Matheron 1969 for universal kriging; Stein 1999 for the smoothness of the Matern covariance. The
prior is termsel's own.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from termsel.adjustment.bayesian.bidiagonal import eliminate
from termsel.core.threads import one_blas_thread
from termsel.data.features import FloatArray, Points
from termsel.data.monomials import evaluate_monomials, graded_exponents
from termsel.fitting.local_courses import LENGTHS, LOCAL_MIN_POINTS, SMOOTHNESSES
from termsel.fitting.misfit import (
    LARGER_RATIOS,
    MISFIT_BATCH,
    MISFIT_MAX_POINTS,
    MISFIT_RATIOS,
    NEGLIGIBLE_SHARE,
    Course,
    LikelySolutions,
    NoisePrior,
    Spectrum,
    Whitened,
    matern_correlations,
    rows_of_field,
)

EXPONENTS = graded_exponents(3, 3)
AFFINE_COLUMNS = 4

LOWER_TRIANGLE = np.tril_indices(len(EXPONENTS) - AFFINE_COLUMNS + 2)
"""Rows and columns of the products of curved columns and both deviations."""

CAMERA_RATIOS = MISFIT_RATIOS + LARGER_RATIOS
"""Standard deviations of the field by that of the noise."""

CAMERA_FIELD_PROBABILITY = 0.5
"""Probability of a field of any of these ratios, as in the model of a field with heights."""

TIME_PROBABILITY = 0.5
"""Probability among fields that a camera shakes in time."""

TIME_LENGTHS = tuple(pair for length in (0.015, 0.05, 0.1, 0.2, 0.4, 0.8)
                     for pair in ((length, 20.0), (20.0, length)))
"""Lengths of line and sample, by the half-range of the image, of what shakes in time."""

SIZES = (1e-6, 1.0, 3.2, 10.0, 32.0, 100.0, 1000.0)
"""Standard deviations of quadratic coefficients by that of the noise; the first is affine."""

AFFINE_PROBABILITY = 0.25
TYPICAL_SIZE = 10.0
"""Of sizes beyond the typical one larger ones are ever less likely, in proportion."""

FALLS, RELIEFS = (0.03, 0.3), (0.1, 1.0)
"""Cubic coefficients by quadratic ones, and those of one power of Z more: each with each."""

LEAST_NOISE, LARGE_NOISE = 1e-4, 2.0
"""Noise that counts as none, and what is tried in any case [px]."""

NOISE_STEP = 0.2
"""Distance of noises that are tried, in natural logarithms."""


@dataclass(frozen=True, eq=False)
class CameraCourses:
    """What points with heights show of the truth, in scaled coordinates."""

    to_image: FloatArray  # (4, 2): affine map of the ground
    positions: FloatArray  # (n, 2): of the control, as this map sees it
    courses: tuple[Course, ...]
    noise: float  # variance of a measurement of unit weight

    @one_blas_thread
    def squares(self, ground: FloatArray, image: FloatArray) -> FloatArray:
        """Return the mean square errors, (m, 2), of a model that sees places in the image.

        `ground` (m, 3) are the places and `image` (m, 2) where the model sees them, both scaled.
        """
        total = np.full((len(ground), 2), np.nan)
        finite = np.flatnonzero(np.isfinite(ground).all(axis=1) & np.isfinite(image).all(axis=1))
        # In batches, as covariances between all places would fill the memory.
        for batch in np.array_split(finite, len(finite) // MISFIT_BATCH + 1):
            monomials, positions = self._seen(ground[batch])
            total[batch] = 0.0
            for course in self.courses:
                columns = course.columns(positions, self.positions, monomials)
                total[batch] += course.squares(columns, image[batch] - positions)
        return total

    def covariance(self, ground: FloatArray, image: FloatArray, axis: int) -> FloatArray:
        """Return the mean products of the errors of `squares` at m places, (m, m), on one axis."""
        monomials, positions = self._seen(ground)
        total = np.zeros((len(ground), len(ground)))
        for course in self.courses:
            columns = course.columns(positions, self.positions, monomials)
            total += course.second_moments(positions, columns, axis, (image - positions)[:, axis])
        return total

    def _seen(self, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the monomials of places, (m, f), and where the affine map sees them, (m, 2)."""
        monomials = evaluate_monomials(ground, EXPONENTS)
        return monomials, monomials[:, :AFFINE_COLUMNS] @ self.to_image


@dataclass(frozen=True, eq=False)
class Field:
    """A field's lengths of line and sample, and its smoothness."""

    probability: float  # of it among fields
    lengths: tuple[float, float]
    smoothness: float


@dataclass(frozen=True, eq=False)
class Shrinkages:
    """How far monomials are shrunken: q rules, each with z sizes."""

    precisions: FloatArray  # (q, z, f): 1 / variance by that of the noise, 0 of affine columns
    log_probabilities: FloatArray  # (q, z): those of a rule add up to one

    @classmethod
    def of_all(cls) -> Shrinkages:
        """Return every rule of FALLS and RELIEFS with every one of SIZES."""
        exponents = np.array(EXPONENTS[AFFINE_COLUMNS:])
        order = exponents.sum(axis=1)
        rules = np.array([fall**(order - 2.0) * relief**exponents[:, 2]
                          for fall in FALLS for relief in RELIEFS])
        sizes = np.array(SIZES)
        precisions = np.zeros((len(rules), len(sizes), len(EXPONENTS)))
        precisions[:, :, AFFINE_COLUMNS:] = 1.0 / np.multiply.outer(sizes, rules).swapaxes(0, 1)**2
        # The tail of a half-Cauchy distribution.
        curved = 1.0 / np.sqrt(1.0 + (sizes[1:] / TYPICAL_SIZE)**2)
        logs = np.log(np.append(AFFINE_PROBABILITY,
                                (1.0 - AFFINE_PROBABILITY) * curved / curved.sum()))
        return cls(precisions, np.broadcast_to(logs, precisions.shape[:2]))

    def log_determinants(self) -> FloatArray:
        """Return the logarithms of |D|^1/2, of the shrunken columns, (q, z)."""
        return np.asarray(0.5 * np.log(self.precisions[:, :, AFFINE_COLUMNS:]).sum(axis=2))


@dataclass(frozen=True, eq=False)
class Control:
    """Control points, and what is tried on them, in scaled coordinates."""

    monomials: FloatArray  # (n, f)
    to_image: FloatArray  # (4, 2)
    positions: FloatArray  # (n, 2)
    deviations: FloatArray  # (n, 2): from the positions
    relative_variances: FloatArray  # (n,): of measurements by that of a usual one
    noises: FloatArray  # (s,)
    shrinkages: Shrinkages

    @classmethod
    def of(cls, points: Points, pixel: float, prior: NoisePrior) -> Control | None:
        """Return the control that scaled points are; None if they determine no affine map.

        `pixel` is the scaled length of a pixel.
        """
        monomials = evaluate_monomials(points.ground, EXPONENTS)
        affine = monomials[:, :AFFINE_COLUMNS]
        if np.linalg.matrix_rank(affine) < AFFINE_COLUMNS:
            return None
        # The position of a point is where the affine map sees it: fields are over positions.
        to_image = np.asarray(np.linalg.lstsq(affine, points.image)[0])
        positions = affine @ to_image
        deviations = points.image - positions
        least = deviations - monomials @ np.linalg.lstsq(monomials, deviations)[0]
        # Noises from far below the residuals of a full polynomial to all that is not affine.
        low = np.clip(0.03 * np.sqrt((least**2).mean()), LEAST_NOISE * pixel, 0.02 * pixel)
        high = max(LARGE_NOISE * pixel, float(np.sqrt((deviations**2).mean())))
        count = int(np.ceil(np.log(high / low) / NOISE_STEP)) + 1
        return cls(monomials, to_image, positions, deviations,
                   prior.relative_variances(len(points)), np.geomspace(low, high, count),
                   Shrinkages.of_all())

    def seen_by(self, fields: Iterable[Field], ratios: tuple[float, ...]) -> Whitened:
        """Return monomials and deviations of the points, whitened by the covariances of c fields.

        There is one covariance N + ratio^2 K for each of the `ratios` (r,), with the relative
        variances N of the points and the correlations K of the field.
        """
        spectra = []
        for field in fields:
            correlations = matern_correlations(self.positions, self.positions, field.lengths,
                                               field.smoothness)
            spectra.append(Spectrum.of(correlations, self.relative_variances, field.lengths,
                                       field.smoothness))
        return Whitened.of(spectra, ratios, self.monomials, self.deviations)

    def log_likelihoods(self, seen: Whitened) -> FloatArray:
        """Return log p(z, size | rule, ratio, s) of c fields for both axes, (c, q, z, r, 2, s).

        Axes are the fields, the rules and sizes of the camera's prior, (q, z), the ratios (r,) of
        field and noise, line and sample, and the noises (s,). Deviations of the points are normal
        with the covariance s^2 (N + ratio^2 K) about monomials that shrink towards the prior.
        """
        n, f = self.monomials.shape
        # What affine columns, which nothing shrinks, leave of the others and of the deviations.
        affine = seen.products[..., :AFFINE_COLUMNS, :AFFINE_COLUMNS]
        across = seen.products[..., :AFFINE_COLUMNS, AFFINE_COLUMNS:]
        products = (seen.products[..., AFFINE_COLUMNS:, AFFINE_COLUMNS:]
                    - across.swapaxes(2, 3) @ np.linalg.solve(affine, across))
        # Of [[A, t], [t', u]], t and u of both axes, the elimination of A leaves the pivots of A
        # and u - t' A^-1 t, which is what no monomial explains. Lower triangles, row by row, of all
        # systems of a field side by side: (p, q, z, r).
        curved = f - AFFINE_COLUMNS
        rows, columns = LOWER_TRIANGLE
        diagonal = np.flatnonzero(rows == columns)
        precisions = self.shrinkages.precisions[:, :, AFFINE_COLUMNS:]
        of_fields = np.moveaxis(products[..., rows, columns], 2, 1)          # (c, p, r)
        systems = np.empty((len(rows), *precisions.shape[:2], of_fields.shape[2]))
        pivots = np.empty((len(of_fields), len(diagonal), *systems.shape[1:]))
        for field, triangles in enumerate(of_fields):
            systems[...] = triangles[:, None, None]
            systems[diagonal[:curved]] += np.moveaxis(precisions, 2, 0)[..., None]
            eliminate(systems.reshape(len(rows), -1), curved)
            pivots[field] = systems[diagonal]
        squares = np.moveaxis(np.maximum(pivots[:, curved:], 0.0), 1, 4)     # (c, q, z, r, 2)
        # |S|^1/2, but for what all have in common, and |A|^1/2.
        of_field = np.log(seen.variances).sum(axis=2) + np.log(np.linalg.det(affine))  # (c, r)
        determinants = 0.5 * (of_field[:, None, None]                        # (c, q, z, r)
                              + np.log(pivots[:, :curved]).sum(axis=1))
        of_prior = self.shrinkages.log_determinants() + self.shrinkages.log_probabilities
        by_solution = of_prior[..., None] - determinants
        by_noise = by_solution[..., None] - (n - AFFINE_COLUMNS) * np.log(self.noises)
        logs = squares[..., None] * (-0.5 / self.noises**2)
        logs += by_noise[..., None, :]
        return np.asarray(logs)

    def courses(self, seen: Whitened, shares: FloatArray, relative: FloatArray) -> list[Course]:
        """Return the solutions of fields, averaged where they are likely.

        The probabilities of all combinations, as of `log_likelihoods`, are those of rules and
        noises, `shares` (c, q, s), times those of sizes and ratios with them, `relative`
        (c, q, z, r, 2, s). Combinations without a share are skipped.
        """
        # Sums over the noises of probabilities, and of these times the variance of the noise.
        # Ratios first: their solutions stand next to each other.
        by_noise = np.stack([shares, shares * self.noises**2], axis=3)       # (c, q, s, 2)
        sums = (relative.reshape(*shares.shape[:2], -1, len(self.noises)) @ by_noise).reshape(
            *relative.shape[:5], 2)
        probabilities, noise = np.moveaxis(sums, (5, 3), (0, 2))             # (c, r, q, z, 2) each
        is_likely = probabilities.max(axis=4) > NEGLIGIBLE_SHARE             # (c, r, q, z)
        is_likely[shares.sum(axis=(1, 2)) <= NEGLIGIBLE_SHARE] = False
        likely = []
        for field in np.flatnonzero(is_likely.any(axis=(1, 2, 3))).tolist():
            ratio, rule, size = np.nonzero(is_likely[field])                 # (w,) each
            likely.append(LikelySolutions(
                field, float(probabilities[field, ..., 0].sum()), ratio,
                self.shrinkages.precisions[rule, size],
                probabilities[field, is_likely[field]].T, noise[field, is_likely[field]].T))
        return seen.courses(likely) if likely else []


def share_of_courses(n: int) -> float:
    """Return how much the courses count of the mean square error of a model of n points.

    All up to MISFIT_MAX_POINTS, nothing from twice as many on: of more points they see a part only,
    and one point more must not change what is said of the same image.
    """
    return float(np.clip(2.0 - n / MISFIT_MAX_POINTS, 0.0, 1.0))


def camera_courses(points: Points, pixel: float) -> CameraCourses | None:
    """Return the courses of the error between scaled points with heights, as the points show them.

    A `pixel` is in scaled coordinates. Of many points those count that are spread over them. None
    with few points or very many, and where their heights lie in a plane.
    """
    if len(points) < LOCAL_MIN_POINTS or share_of_courses(len(points)) == 0.0:
        return None
    is_spread = np.zeros(len(points), dtype=bool)
    is_spread[rows_of_field(len(points))] = True
    points = points.take(is_spread)
    prior = NoisePrior.of(pixel, points.sigma, with_heights=True)
    control = Control.of(points, pixel, prior)
    if control is None:
        return None
    # Of each ratio and noise, and of no field at all.
    by_ratio = prior.field_size_probabilities(                                           # (r, s)
        control.noises, CAMERA_FIELD_PROBABILITY, CAMERA_RATIOS)
    without = np.maximum(1.0 - by_ratio.sum(axis=0, keepdims=True), np.finfo(float).tiny)
    logs = []
    grids = []
    for fields, ratios, probabilities in [
            ([Field(1.0, LENGTHS[0], SMOOTHNESSES[0])], (0.0,), without),
            *((_fields(smoothness), CAMERA_RATIOS, by_ratio) for smoothness in SMOOTHNESSES)]:
        # The noise is that of both axes, and so is whether there is a field.
        of_all_ratios = probabilities.sum(axis=0)
        seen = control.seen_by(fields, ratios)
        relative = control.log_likelihoods(seen)
        relative += np.log(probabilities / of_all_ratios)[:, None]
        largest = relative.max(axis=(2, 3), keepdims=True)
        relative -= largest
        np.exp(relative, out=relative)
        sums = relative.sum(axis=(2, 3))                                            # (c, q, 2, s)
        by_noise = np.log(sums) + largest[:, :, 0, 0]
        of_fields = np.multiply.outer([field.probability for field in fields], of_all_ratios)
        logs.append(np.log(of_fields / by_noise.shape[1])[:, None]
                    + prior.log_probability(control.noises) + by_noise.sum(axis=2))
        relative /= sums[:, :, None, None]
        grids.append((seen, relative))
    all_logs = np.concatenate(logs)                                                    # (., q, s)
    shares = np.exp(all_logs - np.logaddexp.reduce(all_logs, axis=None))
    if not np.isfinite(shares).all():
        return None
    courses: list[Course] = []
    ends = np.cumsum([len(of_stack) for of_stack in logs])[:-1]
    for share, (seen, relative) in zip(np.split(shares, ends), grids, strict=True):
        courses += control.courses(seen, share, relative)
    return CameraCourses(control.to_image, control.positions, tuple(courses),
                         float(shares.sum(axis=(0, 1)) @ control.noises**2))


def _fields(smoothness: float) -> list[Field]:
    """Return all fields of a smoothness: of what shakes in time, and is alike in both axes."""
    fields = []
    for probability, lengths in ((TIME_PROBABILITY, TIME_LENGTHS),
                                 (1.0 - TIME_PROBABILITY, LENGTHS)):
        each = probability / (len(lengths) * len(SMOOTHNESSES))
        fields += [Field(each, pair, smoothness) for pair in lengths]
    return fields
