"""What a model does not fit: a smooth field that its residuals have in common.

Sheets shrink, scanners shake, lenses distort: a parametric model leaves a part that is alike at
neighbouring places. It is no noise, so it is part of the error of a prediction. The residuals r of
the control, reduced by a trend T that stands for what the model has taken up already, are in line
and in sample

    r = T b + g + e,    g ~ (ratio s)^2 Matern,  e ~ s^2,

with places in the image, a Matern covariance of smoothness 3/2 and unknown length, ratio and noise
s. All are averaged with their restricted likelihood, and with them that there is no field: with S
the covariance of the residuals by s^2, P = S^-1 - S^-1 T (T' S^-1 T)^-1 T' S^-1 and m = n - rank T,

    p(r | length, ratio, s) ~ |S|^-1/2 |T' S^-1 T|^-1/2 s^-m exp(-r' P r / 2 s^2).

Length and noise are those of line and sample together, the ratio is of each alone: a scanner may
shake along one. What the model misses at a place is the field and the trend T b there: a smooth
field has a trend of its own, which b takes back. With c = (ratio^2 k, t) the covariances to the
control, by s^2, and the trend of a place, and M = [[S, T], [T', 0]], it has under one solution
(universal kriging)

    the mean c' M^-1 (r, 0) and the variance s^2 (ratio^2 - c' M^-1 c),

of which s^2 t' (T' T)^-1 t would be there without a field, and is part of the model's own variance
already. The field is bounded, so that its trend ends with the control: t is that of the nearest
place in the box of the control. Averaged over all solutions, the square of the one and the other
are what the model misses: close to control it is seen, and far away it is as large as it can be.

Few residuals do not show a field of short length from noise. Then their scatter is divided by what
is known beforehand: a measurement in an image is good to about half a pixel, and a scatter of
several pixels is rather what the model does not fit, in images of cameras more so than on maps that
somebody has drawn. No camera is without any misfit: where matches are good to a tenth of a pixel,
the few hundredths that films, lenses and attitudes leave are a large part of the error, and few
residuals do not show them. So what is no field of any size is beforehand a small one, of which the
size in px is known, not that by the noise.

Of a local model, which fits fields itself, r are its errors of points held out, of the size of the
noise that it sees; from 20 points on it and polynomials are judged by
`termsel.fitting.local_courses` and, with heights, `termsel.fitting.camera_courses` instead.

References
----------
Patterson and Thompson 1971 for the restricted likelihood; Moritz 1980 for collocation of
residuals; Matheron 1969 for universal kriging; Stein 1999 for the Matern covariance. The prior is
termsel's own.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import erf

import numpy as np

from termsel.adjustment.bayesian.bidiagonal import sweep
from termsel.data.features import FloatArray, IntArray

MISFIT_LENGTHS = ((0.07, 0.07), (0.2, 0.2), (0.4, 0.4), (0.8, 0.8),
                  (0.15, 2.0), (2.0, 0.15), (0.05, 2.0), (2.0, 0.05), (0.015, 2.0), (2.0, 0.015))
"""Lengths of line and sample, by the half-range of the image; the last six are those of scanners
that shake and of strips. The shortest are shorter than the distances of most control: what changes
so fast is known from noise by pairs of points that are near, or share a line, and else by its
size."""

MISFIT_SMOOTHNESS = 1.5

MISFIT_RATIOS = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8)
"""Standard deviations of the field by that of the noise, all as likely beforehand."""

LARGER_RATIOS = (51.2, 204.8, 819.2)
"""The same of fields about a trend that is no model of the image, as where a fisheye is seen by a
polynomial: all together as likely as one of the others. A field that could be no larger would have
its noise overstated instead. Steps are wide, as the noise hardly matters."""

MISFIT_PROBABILITY = 0.36
"""Probability of a field of these sizes before the residuals are looked at. What is less than a
tenth of the noise counts as none."""

SMALL_MISFIT, SMALL_MISFIT_LOG_DEVIATION = 0.03, 0.7
"""Median [px] of what any camera's model leaves, and the standard deviation of its logarithm."""

NOISE_MEDIAN = 0.5
"""Median of the noise beforehand [px]."""

NOISE_LOG_DEVIATION = 1.0
"""Standard deviation of its logarithm where heights do not count: from a fourteenth of a pixel, of
matches, to 3.6 px, of points in old maps, with a probability of 95 %."""

CAMERA_NOISE_LOG_DEVIATION = 0.5
"""The same above the median where heights count: noise is below 1.3 px. What a camera shows nobody
has drawn, so that a scatter of several pixels is not that of measurements."""

NOISE_BY_RESIDUALS = np.geomspace(0.03, 3.0, 24)
"""Noises that are tried, by the scatter of the residuals."""

MISFIT_MAX_POINTS = 200
"""Points by which the field is found; of more, such as are spread over the image."""

MISFIT_BATCH = 2000
"""Places whose covariances to the points are held in memory."""

MISFIT_MIN_POINTS = 6
"""Points below which nothing shows a field."""

TREND_COLUMNS = 3, 6, 10
"""Of an affine, a quadratic and a cubic trend."""

QUADRATIC_TREND_POINTS, CUBIC_TREND_POINTS = 20, 40
"""Points from which on the trend is quadratic, and from which on it is cubic under a model of as
many parameters; else it is affine. Under a trend of fewer columns than the model has taken up,
residuals look more like noise than they are."""

NEGLIGIBLE_SHARE = 1e-4
"""Probability of a solution that is left out."""


@dataclass(frozen=True, eq=False)
class NoisePrior:
    """What is known of the noise of measurements before residuals are looked at.

    Attributes
    ----------
    pixel : float
        In scaled coordinates.
    sigma : ndarray, shape (n, 2), or None
        Standard deviations of the measurements, scaled, if known.
    log_deviation : float
        Standard deviation of the logarithm of the noise where it is above its median.
    small_misfit : float
        Median of what any model leaves, scaled; 0 where it may leave nothing.
    """

    pixel: float
    sigma: FloatArray | None
    log_deviation: float
    small_misfit: float

    @classmethod
    def of(cls, pixel: float, sigma: FloatArray | None, *, with_heights: bool) -> NoisePrior:
        """Return the prior of the noise of an image, another one if heights count."""
        if with_heights:
            return cls(pixel, sigma, CAMERA_NOISE_LOG_DEVIATION, SMALL_MISFIT * pixel)
        return cls(pixel, sigma, NOISE_LOG_DEVIATION, 0.0)

    def log_probability(self, noises: FloatArray) -> FloatArray:
        """Return logarithms of how likely noises (s,) are; the probabilities add up to one."""
        median = NOISE_MEDIAN * self.pixel if self.sigma is None else float(np.median(self.sigma))
        excess = np.log(noises / median)
        deviation = np.where(excess > 0.0, self.log_deviation, NOISE_LOG_DEVIATION)
        logs = -0.5 * (excess / deviation) ** 2
        return np.asarray(logs - np.logaddexp.reduce(logs))

    def field_size_probabilities(self, noises: FloatArray,
                                 field_probability: float = MISFIT_PROBABILITY,
                                 ratios: tuple[float, ...] = MISFIT_RATIOS) -> FloatArray:
        """Return the probabilities of fields of some ratios under noises (s,), shape (r, s).

        The sum of a column is the probability of a field under that noise; the rest is that of
        none. With f the probability of a field of these sizes, w that of a ratio q among them, and
        F the distribution of a small misfit, that of q by noise s is

            w f + (1 - f) (F(b s) - F(a s)),

        where a and b are half-way to the ratios next to q, and for the last one b is infinite.
        """
        of_ratios = field_probability * ratio_probabilities(ratios)
        probabilities = np.repeat(of_ratios[:, None], len(noises), axis=1)
        if self.small_misfit == 0.0:
            return probabilities
        # Half-way by their logarithms; below the first one half an octave away.
        between = np.sqrt(np.multiply(ratios[:-1], ratios[1:]))
        edges = np.concatenate([[ratios[0] / np.sqrt(2.0)], between, [np.inf]])
        below = self._small_misfit_distribution(np.multiply.outer(edges, noises))
        return np.asarray(probabilities + (1.0 - field_probability) * np.diff(below, axis=0))

    def _small_misfit_distribution(self, sizes: FloatArray) -> FloatArray:
        """Return the probability that a small misfit, which is log-normal, is below sizes."""
        beyond = np.log(sizes / self.small_misfit) / SMALL_MISFIT_LOG_DEVIATION
        return np.asarray(0.5 + 0.5 * np.vectorize(erf)(beyond / np.sqrt(2.0)))

    def relative_variances(self, n: int) -> FloatArray:
        """Return the variances of n measurements by that of a usual one, (n,)."""
        if self.sigma is None:
            return np.ones(n)
        return np.asarray((self.sigma**2).mean(axis=1) / np.median(self.sigma**2))


@dataclass(frozen=True, eq=False)
class Course:
    """All solutions of one covariance, with the shares that they have of all courses.

    With w the probability of a ratio on an axis and s^2 the expected noise under it, `variance`
    (2,) is the sum of w s^2 ratio^2, and `explained` (2, n + f, n + f) that of w s^2 C M^-1 C,
    where C holds ratio^2 for the n points and 1 for the f columns of the trend. `weights` (2, r)
    are the w, and `means` (r, n + f, 2) are C M^-1 (r, 0). `share` is the probability of the
    covariance.
    """

    share: float
    lengths: tuple[float, float]
    smoothness: float
    variance: FloatArray
    explained: FloatArray
    weights: FloatArray
    means: FloatArray
    trend_columns: int

    def columns(self, places: FloatArray, positions: FloatArray, trend: FloatArray) -> FloatArray:
        """Return the covariances of places (m, 2) to those of the control, and their trend."""
        return np.column_stack(
            [matern_correlations(places, positions, self.lengths, self.smoothness), trend])

    def squares(self, columns: FloatArray, deviations: FloatArray | float) -> FloatArray:
        """Return the mean squares of field and trend less deviations, times the share, (m, 2).

        The columns (m, n + f) are those of the places.
        """
        squares = np.zeros((len(columns), 2))
        for axis in (0, 1):
            explained = ((columns @ self.explained[axis]) * columns).sum(axis=1)
            means = columns @ self.means[:, :, axis].T                                  # (m, r)
            distances = means - np.broadcast_to(deviations, squares.shape)[:, axis, None]
            squares[:, axis] = (np.maximum(self.variance[axis] - explained, 0.0)
                                + distances**2 @ self.weights[axis])
        return squares

    def second_moments(self, places: FloatArray, columns: FloatArray, axis: int,
                       deviations: FloatArray | float) -> FloatArray:
        """Return E[(f - d) (f - d)'] times the share, (m, m), on one axis.

        f are field and trend at `places` (m, 2), whose `columns` (m, n + f) these are, and d the
        `deviations` (m,). The diagonal is that of `squares`, but that variances are not clipped
        at 0.
        """
        means = columns @ self.means[:, :, axis].T                                      # (m, r)
        distances = means - np.broadcast_to(deviations, len(columns))[:, None]
        # Prior less explained covariance, and the sum over ratios of w (mean - d) (mean - d)'.
        return np.asarray(
            self.variance[axis] * matern_correlations(places, places, self.lengths, self.smoothness)
            - columns @ self.explained[axis] @ columns.T
            + (distances * self.weights[axis]) @ distances.T)


@dataclass(frozen=True, eq=False)
class Spectrum:
    """A field's correlation K and the variances N of measurements, both diagonal in V.

    V'N V = I and V'K V = `values`, so that S = N + ratio^2 K has the inverse V v^-1 V', with
    v = 1 + ratio^2 `values`: one decomposition serves all ratios.
    """

    lengths: tuple[float, float]
    smoothness: float
    values: FloatArray  # (n,)
    vectors: FloatArray  # (n, n): V

    @classmethod
    def of(cls, correlations: FloatArray, relative_variances: FloatArray,
           lengths: tuple[float, float], smoothness: float) -> Spectrum:
        """Return the spectrum of correlations (n, n) and relative variances (n,)."""
        scale = 1.0 / np.sqrt(relative_variances)
        values, vectors = np.linalg.eigh(correlations * np.outer(scale, scale))
        return cls(lengths, smoothness, np.maximum(values, 0.0), scale[:, None] * vectors)

    def variances(self, ratios: tuple[float, ...]) -> FloatArray:
        """Return v = 1 + ratio^2 `values` for each of r ratios, (r, n)."""
        return 1.0 + np.multiply.outer(np.square(ratios), self.values)


@dataclass(frozen=True, eq=False)
class Whitened:
    """A trend F and deviations z of the control as c fields see them, of some ratios to noise.

    `along` (c, n, f + 2) are F and z in the V of each spectrum, where the covariances
    S = N + ratio^2 K are diagonal, the `variances` (c, r, n); `products` (c, r, f + 2, f + 2) are
    (F, z)' S^-1 (F, z). One decomposition of K serves all ratios, and all there is to know of a
    field.
    """

    spectra: tuple[Spectrum, ...]
    ratios: tuple[float, ...]
    variances: FloatArray
    along: FloatArray
    products: FloatArray

    @classmethod
    def of(cls, spectra: Iterable[Spectrum], ratios: tuple[float, ...], trend: FloatArray,
           deviations: FloatArray) -> Whitened:
        """Return the trend (n, f) and the deviations (n, 2), whitened for each of r ratios."""
        spectra = tuple(spectra)
        variances = np.array([spectrum.variances(ratios) for spectrum in spectra])
        columns = np.concatenate([trend, deviations], axis=1)
        along = np.array([spectrum.vectors.T @ columns for spectrum in spectra])
        whitened = along[:, None] / np.sqrt(variances)[..., None]            # (c, r, n, f + 2)
        return cls(spectra, ratios, variances, along, whitened.swapaxes(2, 3) @ whitened)

    def courses(self, likely: Sequence[LikelySolutions]) -> list[Course]:
        """Return the courses of some fields, each by all of its solutions that are likely.

        With the diagonal D of the precisions, A = F' S^-1 F + D.
        """
        f = self.along.shape[2] - 2
        # Lower triangles of [[A, .], [z' S^-1 F, .]], row by row, of all w solutions side by side.
        rows, columns = np.tril_indices(f + 2)
        entry = np.empty((f + 2, f + 2), dtype=np.intp)
        entry[rows, columns] = entry[columns, rows] = np.arange(len(rows))
        products = np.ascontiguousarray(np.moveaxis(self.products[..., rows, columns], 2, 1))
        courses = []
        for some in likely:
            systems = products[some.field].take(some.ratio, axis=1)          # (p, w)
            systems[np.diag(entry)[:f]] += some.precisions.T
            sweep(systems, f, np.empty((f + 2, len(some.ratio))))
            courses.append(self._course(some, systems[entry[:f, f:]], -systems, entry[:f, :f]))
        return courses

    def _course(self, likely: LikelySolutions, coefficients: FloatArray, inverse: FloatArray,
                entry: IntArray) -> Course:
        """Return the course of a field, from A^-1 F' S^-1 z (f, 2, w) and A^-1 of its solutions.

        `inverse` (p, w) holds A^-1 where `entry` (f, f) says. With M = [[S, F], [F', -D]] and
        B = S^-1 F, the inverse of M has the blocks S^-1 - B A^-1 B', B A^-1 and -A^-1.
        """
        spectrum = self.spectra[likely.field]
        vectors = spectrum.vectors
        trend = self.along[likely.field, :, :-2]
        deviations = self.along[likely.field, :, -2:]
        n, f = trend.shape
        squared_ratios = np.square(self.ratios)
        # S^-1 is diagonal in V: there B is F divided by the variances, which are those of the noise
        # for a ratio of 0.
        factors = squared_ratios[:, None] / self.variances[likely.field]     # (r, n)
        left = deviations[..., None] - (trend @ coefficients.reshape(f, -1)).reshape(n, 2, -1)
        left *= factors.T[:, None, likely.ratio]
        at_points = (vectors @ left.reshape(n, -1)).reshape(left.shape)      # (n, 2, w)
        # All else is linear in A^-1, of which the sum over the solutions of a ratio is enough.
        of_ratios = np.zeros((2, len(squared_ratios), len(likely.ratio)))    # (2, r, w)
        of_ratios[:, likely.ratio, np.arange(len(likely.ratio))] = likely.noise
        inverses = (of_ratios @ inverse.T)[..., entry]                       # (2, r, f, f)
        scaled = factors.T[..., None] * trend[:, None]                       # (n, r, f)
        gains = np.empty((2, *scaled.shape))
        np.matmul(np.moveaxis(scaled, 1, 0), inverses, out=np.moveaxis(gains, 2, 1))
        along = -gains.reshape(2, n, -1) @ scaled.reshape(n, -1).T           # (2, n, n)
        noise_of_ratios = of_ratios.sum(axis=2)                              # (2, r)
        np.einsum("aii->ai", along)[...] += noise_of_ratios * squared_ratios @ factors
        explained = np.empty((2, n + f, n + f))
        explained[:, :n, :n] = vectors @ along @ vectors.T
        explained[:, :n, n:] = vectors @ gains.sum(axis=2)
        explained[:, n:, :n] = explained[:, :n, n:].swapaxes(1, 2)
        explained[:, n:, n:] = -inverses.sum(axis=1)
        means = np.concatenate([at_points, coefficients])                    # (n + f, 2, w)
        return Course(likely.share, spectrum.lengths, spectrum.smoothness,
                      noise_of_ratios @ squared_ratios, explained, likely.weights,
                      means.transpose(2, 0, 1), f)


@dataclass(frozen=True, eq=False)
class LikelySolutions:
    """The w solutions of a field that are not negligible: each has a ratio and a trend.

    `field` is the number of the field among those that are seen, `ratio` (w,) are the numbers of
    the solutions' ratios, and `precisions` (w, f) are those of the trend's coefficients beforehand,
    1 / variance by that of the noise, infinite where there is no such column. By line and sample,
    (2, w), `weights` are the solutions' probabilities, and `noise` these times the expected
    variance of the noise. `share` is the probability of all together.
    """

    field: int
    share: float
    ratio: IntArray
    precisions: FloatArray
    weights: FloatArray
    noise: FloatArray


@dataclass(frozen=True, eq=False)
class System:
    """What all covariances are tried on."""

    positions: FloatArray  # (n, 2): of the control, in the image
    relative_variances: FloatArray  # (n,): of measurements by that of a usual one
    trend: FloatArray  # (n, f)
    residuals: FloatArray  # (n, 2)
    noises: FloatArray  # (s,)

    def take(self, rows: IntArray) -> System:
        """Return the system of some rows of the control."""
        return replace(self, positions=self.positions[rows],
                       relative_variances=self.relative_variances[rows], trend=self.trend[rows],
                       residuals=self.residuals[rows])

    def spectra(self, lengths: Sequence[tuple[float, float]], smoothness: float) -> list[Spectrum]:
        """Return the spectrum of a field's correlations for each pair of lengths."""
        weights = 1.0 / np.sqrt(self.relative_variances)
        positions = self.positions
        correlations = np.array([matern_correlations(positions, positions, pair, smoothness)
                                 for pair in lengths])
        values, u = np.linalg.eigh(weights[:, None] * correlations * weights)
        return [Spectrum(pair, smoothness, *factors) for pair, *factors in zip(
            lengths, values, weights[:, None] * u, strict=True)]

    def log_likelihoods(self, spectra: Sequence[Spectrum],
                        ratios: tuple[float, ...]) -> FloatArray:
        """Return log p(residuals | lengths, ratio, s) for each axis, (l, 2, r, s).

        There are l spectra, each of a pair of lengths, r ratios of the field to the noise, and s
        noises.
        """
        variances = np.array([spectrum.variances(ratios) for spectrum in spectra])  # (l, r, n)
        vectors = np.array([spectrum.vectors for spectrum in spectra])
        f = self.trend.shape[1]
        # In V the covariance is diagonal: by its roots all is white.
        along = vectors.swapaxes(1, 2) @ np.column_stack([self.trend, self.residuals])
        whitened = along[:, None] / np.sqrt(variances)[..., None]             # (l, r, n, f + 2)
        q, triangle = np.linalg.qr(whitened[..., :f])
        targets = whitened[..., f:]
        squares = ((targets - q @ (q.swapaxes(2, 3) @ targets))**2).sum(axis=2)  # (l, r, 2)
        # |S|^1/2, that of the variances of measurements included, and |T' S^-1 T|^1/2.
        determinants = (0.5 * (np.log(variances).sum(axis=2)
                               + np.log(self.relative_variances).sum())
                        + np.log(np.abs(np.diagonal(triangle, axis1=2, axis2=3))).sum(axis=2))
        freedom = len(self.residuals) - f
        return np.asarray(-freedom * np.log(self.noises)
                          - 0.5 * squares.swapaxes(1, 2)[..., None] / self.noises**2
                          - determinants[:, None, :, None])

    def course(self, spectrum: Spectrum, ratios: tuple[float, ...], shares: FloatArray) -> Course:
        """Return the solutions of one covariance; `shares` (2, r, s) are of ratios and noises.

        M^-1 has the blocks S^-1 - B G B', B G and -G, with B = S^-1 T and G = (T' B)^-1.
        """
        noise = shares @ self.noises**2                                             # (2, r)
        n, f = self.trend.shape
        explained = np.zeros((2, n + f, n + f))
        means = np.empty((len(ratios), n + f, 2))
        vectors = spectrum.vectors
        variances = spectrum.variances(ratios)                                      # (r, n)
        trend_along = vectors.T @ self.trend
        residuals_along = vectors.T @ self.residuals
        for i, ratio in enumerate(ratios):
            # B and G from the triangle R of the whitened trend: T' S^-1 T = R' R.
            whitened = trend_along / np.sqrt(variances[i])[:, None]
            inverse = np.linalg.inv(np.linalg.qr(whitened, mode="r"))
            G = inverse @ inverse.T
            B = vectors @ (trend_along / variances[i][:, None])
            BG = B @ G
            weighted = vectors @ (residuals_along / variances[i][:, None])             # S^-1 r
            means[i, :n] = ratio**2 * (weighted - BG @ (self.trend.T @ weighted))
            means[i, n:] = BG.T @ self.residuals
            for axis, weight in enumerate(noise[:, i]):
                explained[axis, :n, :n] -= weight * ratio**4 * (BG @ B.T)
                explained[axis, :n, n:] += weight * ratio**2 * BG
                explained[axis, n:, n:] -= weight * G
        # The sum of all S^-1 is diagonal in V, too.
        inverse_variances = noise * np.power(ratios, 4) @ (1.0 / variances)         # (2, n)
        for axis in (0, 1):
            explained[axis, :n, :n] += (vectors * inverse_variances[axis]) @ vectors.T
            explained[axis, n:, :n] = explained[axis, :n, n:].T
        return Course(float(shares[0].sum()), spectrum.lengths, spectrum.smoothness,
                      noise @ np.square(ratios), explained, shares.sum(axis=2), means, f)

    def without_noise_of_trend(self, course: Course, shares: FloatArray) -> Course:
        """Return a course without the part of the trend's uncertainty that noise alone makes.

        That part is s^2 t' (T' N^-1 T)^-1 t, where N has the relative variances.
        """
        f = self.trend.shape[1]
        noise = (shares @ self.noises**2).sum(axis=1)                               # (2,)
        weighted = self.trend / self.relative_variances[:, None]
        explained = course.explained.copy()
        explained[:, -f:, -f:] += noise[:, None, None] * np.linalg.inv(self.trend.T @ weighted)
        return replace(course, explained=explained)


@dataclass(frozen=True, eq=False)
class Misfit:
    """What a model does not fit, in scaled coordinates: courses with a field."""

    positions: FloatArray  # (n, 2): of the control, in the image
    courses: tuple[Course, ...]

    @property
    def probability(self) -> float:
        """Probability of a field."""
        return float(sum(course.share for course in self.courses))

    def squares(self, image: FloatArray) -> FloatArray:
        """Return the mean square of the model's own error at places (m, 2) in the image, (m, 2)."""
        total = np.zeros((len(image), 2))
        trend = self._trend_at(image)
        for course in self.courses:
            columns = course.columns(image, self.positions, trend[:, :course.trend_columns])
            total += course.squares(columns, 0.0)
        return total

    def covariance(self, image: FloatArray, axis: int) -> FloatArray:
        """Return the mean products of the model's own error among places in the image, (m, m)."""
        total = np.zeros((len(image), len(image)))
        trend = self._trend_at(image)
        for course in self.courses:
            columns = course.columns(image, self.positions, trend[:, :course.trend_columns])
            total += course.second_moments(image, columns, axis, 0.0)
        return total

    def _trend_at(self, image: FloatArray) -> FloatArray:
        """Return the columns (m, 10) of a cubic trend at places (m, 2) in the image.

        A place beyond the control has the trend of the nearest place in the box of the control.
        """
        nearest = np.clip(image, self.positions.min(axis=0), self.positions.max(axis=0))
        return trend_of(nearest, TREND_COLUMNS[-1])


def misfit_of(image: FloatArray, residuals: FloatArray, noise: NoisePrior,
              effective: float | None) -> Misfit | None:
    """Return the model's own error, as the residuals of its control (n, 2) show it.

    The image (n, 2) is where the model sees the control, all scaled; `effective` are the parameters
    of both axes together, None where the residuals are not smaller for them. Returns None for too
    few points, for points on a line of the image, and where all residuals are zero.
    """
    if len(image) > MISFIT_MAX_POINTS:
        rows = rows_of_field(len(image))
        effective = None if effective is None else effective * MISFIT_MAX_POINTS / len(image)
        image = image[rows]
        residuals = residuals[rows]
        noise = noise if noise.sigma is None else replace(noise, sigma=noise.sigma[rows])
    n = len(image)
    trend = determined_trend(image, np.arange(n), _trend_columns(n, effective))
    if trend is None:  # seen on one line of the image
        return None
    freedom = n - trend.shape[1]
    effective = 2.0 * trend.shape[1] if effective is None else effective
    if n < MISFIT_MIN_POINTS or 2 * n - effective < 2.0 or freedom < 2 or not residuals.any():
        return None
    # The model has taken up more than the trend alone would, so that its residuals are too small.
    residuals = residuals * np.sqrt(2 * freedom / (2 * n - effective))
    noises = NOISE_BY_RESIDUALS * np.sqrt((residuals**2).mean())
    log_prior = noise.log_probability(noises)
    relative_variances = noise.relative_variances(n)
    system = System(image, relative_variances, trend, residuals, noises)
    # Logarithms of the likelihoods: without a field, then of l pairs of lengths with each ratio,
    # and over all ratios.
    log_without_field = restricted_likelihood(np.diag(relative_variances), trend, residuals,
                                              noises)                                 # (2, s)
    spectra = system.spectra(MISFIT_LENGTHS, MISFIT_SMOOTHNESS)
    size_probabilities = noise.field_size_probabilities(noises)                       # (r, s)
    field_probability = size_probabilities.sum(axis=0)
    log_by_ratio = (system.log_likelihoods(spectra, MISFIT_RATIOS)
                    + np.log(size_probabilities / field_probability))             # (l, 2, r, s)
    log_by_noise = np.logaddexp.reduce(log_by_ratio, axis=2)                          # (l, 2, s)
    no_field_probability = np.maximum(1.0 - field_probability, np.finfo(float).tiny)
    logs = np.concatenate([
        [np.log(no_field_probability) + log_prior + log_without_field.sum(axis=0)],
        np.log(field_probability / len(MISFIT_LENGTHS)) + log_prior + log_by_noise.sum(axis=1)])
    if not np.isfinite(logs).all():  # seen on one line of the image: no trend is determined
        return None
    shares = np.exp(logs - np.logaddexp.reduce(logs, axis=None))                 # (1 + l, s)
    ratio_shares = np.exp(log_by_ratio - log_by_noise[:, :, None])
    courses = []
    for share, spectrum, ratio_share in zip(shares[1:], spectra, ratio_shares, strict=True):
        if share.sum() > NEGLIGIBLE_SHARE:
            course = system.course(spectrum, MISFIT_RATIOS, share * ratio_share)
            courses.append(system.without_noise_of_trend(course, share * ratio_share))
    return Misfit(image, tuple(courses))


def ratio_probabilities(ratios: tuple[float, ...]) -> FloatArray:
    """Return how likely each of r ratios is among fields, (r,).

    All are alike, but that the LARGER_RATIOS share the probability of one.
    """
    weights = np.where(np.isin(ratios, LARGER_RATIOS), 1.0 / len(LARGER_RATIOS), 1.0)
    return np.asarray(weights / weights.sum())


def rows_of_field(n: int) -> IntArray:
    """Return the rows (r,) by which a field is found: all n, or MISFIT_MAX_POINTS spread evenly."""
    return np.linspace(0, n - 1, min(n, MISFIT_MAX_POINTS)).round().astype(np.intp)


def mixed_misfit(misfits: Sequence[tuple[float, Misfit]]) -> Misfit | None:
    """Return the mixture of misfits of the same control, each with its chance.

    Returns None if there are no misfits.
    """
    if not misfits:
        return None
    # Sums over all courses are linear in a course's share, so that the chance multiplies its terms.
    courses = []
    for chance, misfit in misfits:
        if chance > 0.0:
            courses += [replace(course, share=chance * course.share,
                                variance=chance * course.variance,
                                explained=chance * course.explained,
                                weights=chance * course.weights) for course in misfit.courses]
    return Misfit(misfits[0][1].positions, tuple(courses))


def restricted_likelihood(covariance: FloatArray, trend: FloatArray, residuals: FloatArray,
                          noises: FloatArray) -> FloatArray:
    """Return the restricted log likelihood of line and sample for each noise, (2, s).

    Restricted (REML) means that it is the likelihood of what is left of the residuals (n, 2) once
    their part along the f columns of the trend (n, f) is taken out. `covariance` (n, n) is in units
    of the squared noise.
    """
    # With the covariance s^2 C, C = L L', and Q R = L^-1 F of the trend F, it is
    # -(n - f) log s - |(I - Q Q') L^-1 r|^2 / 2 s^2 - log |L| - log |R|.
    lower = np.linalg.cholesky(covariance)
    whitened = np.linalg.solve(lower, np.column_stack([trend, residuals]))
    f = trend.shape[1]
    q, r = np.linalg.qr(whitened[:, :f])
    targets = whitened[:, f:]
    squares = ((targets - q @ (q.T @ targets))**2).sum(axis=0)
    freedom = len(residuals) - f
    log = -freedom * np.log(noises) - 0.5 * squares[:, None] / noises**2
    return np.asarray(log - np.log(np.diag(lower)).sum() - np.log(np.abs(np.diag(r))).sum())


def _trend_columns(n_points: int, effective: float | None) -> int:
    """Return how many columns the trend has in place of a model of `effective` parameters.

    These are the parameters of both axes together.
    """
    affine, quadratic, cubic = TREND_COLUMNS
    if n_points < QUADRATIC_TREND_POINTS:
        return affine
    is_cubic = n_points >= CUBIC_TREND_POINTS and effective is not None and effective >= 2 * cubic
    return cubic if is_cubic else quadratic


def determined_trend(positions: FloatArray, rows: IntArray,
                     most: int = TREND_COLUMNS[-1]) -> FloatArray | None:
    """Return the trend of the highest degree that some rows of positions (n, 2) determine, (n, f).

    It has at most `most` columns. Returns None where not even an affine trend is determined.
    """
    for columns in reversed(TREND_COLUMNS):
        trend = trend_of(positions, columns)
        if columns <= most and np.linalg.matrix_rank(trend[rows]) == columns:
            return trend
    return None


def trend_of(positions: FloatArray, columns: int) -> FloatArray:
    """Return the first columns of a cubic trend at positions (m, 2), in the order of degree.
    """
    line, sample = positions.T
    cubic = np.column_stack([np.ones(len(positions)), line, sample,
                             line**2, line * sample, sample**2,
                             line**3, line**2 * sample, line * sample**2, sample**3])
    return cubic[:, :columns]


def matern_correlations(a: FloatArray, b: FloatArray, lengths: tuple[float, float],
                        smoothness: float = 1.5) -> FloatArray:
    """Return the correlations between places `a` (n, 2) and `b` (m, 2), shape (n, m).

    Matern's family has, at the distance d, the correlation exp(-d) for the smoothness 1/2,
    (1 + sqrt(3) d) exp(-sqrt(3) d) for 3/2, and exp(-d^2 / 2) for infinity. Distances are in units
    of the lengths of line and sample.
    """
    line, sample = (np.subtract.outer(a[:, axis] / length, b[:, axis] / length)
                    for axis, length in enumerate(lengths))
    squares = line * line + sample * sample
    if smoothness == np.inf:
        return np.asarray(np.exp(-0.5 * squares))
    if smoothness == 0.5:
        return np.asarray(np.exp(-np.sqrt(squares)))
    r = np.sqrt(3.0 * squares)
    return np.asarray((1.0 + r) * np.exp(-r))
