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
shake along one. Under one solution the field at a place with covariances k to the control, by s^2,
has the mean k' P r and the variance s^2 (ratio^2 - k' P k). Averaged over all solutions, the square
of the one and the other are what the model misses there: close to control it is seen, and far away
it is as large as it can be.

Few residuals do not tell a field of short length from noise. Then their scatter is divided by what
is known beforehand: a measurement in an image is good to about half a pixel, and a scatter of
several pixels is rather what the model does not fit, in images of cameras more so than on maps that
somebody has drawn. Of a local model, which fits fields itself, r are its errors of points held out,
of the size of the noise that it sees; in a plane, from 20 points on, it is judged by
`termsel.fitting.local_courses` instead.

References
----------
Patterson and Thompson 1971 for the restricted likelihood; Moritz 1980 for collocation of
residuals; Stein 1999 for the Matern covariance. The prior is termsel's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from termsel.data.features import FloatArray

MISFIT_LENGTHS = ((0.07, 0.07), (0.2, 0.2), (0.4, 0.4), (0.8, 0.8),
                  (0.15, 2.0), (2.0, 0.15), (0.05, 2.0), (2.0, 0.05), (0.015, 2.0), (2.0, 0.015))
"""Lengths of line and sample, by the half-range of the image; the last six are those of scanners
that shake and of strips. The shortest are shorter than the distances of most control: what changes
so fast is known from noise by pairs of points that are near, or share a line, and else by its
size."""

MISFIT_RATIOS = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8)
"""Standard deviations of the field by that of the noise, all as likely beforehand."""

MISFIT_PROBABILITY = 0.3
"""Probability of a field of these sizes before the residuals are looked at. What is less than a
tenth of the noise counts as none."""

NOISE_MEDIAN = 0.5
"""Median of the noise beforehand [px]."""

NOISE_LOG_DEVIATION = 1.0
"""Standard deviation of its logarithm where heights do not count: from a fourteenth of a pixel, of
matches, to 3.6 px, of points in old maps, with a probability of 95 %."""

CAMERA_NOISE_LOG_DEVIATION = 0.5
"""The same above the median where heights count: noise is below 1.3 px. What a camera shows nobody
has drawn, so that a scatter of several pixels is not that of measurements."""

NOISE_BY_SCATTER = np.geomspace(0.03, 3.0, 24)
"""Noises that are tried, by the scatter of the residuals."""

MISFIT_MAX_POINTS = 200
"""Points by which the field is found; of more, such as are spread over the image."""

MISFIT_MIN_POINTS = 6
"""Points below which nothing tells a field."""

QUADRATIC_TREND_POINTS = 20
"""Points from which on the trend is quadratic; else it is affine."""

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
    """

    pixel: float
    sigma: FloatArray | None
    log_deviation: float

    @classmethod
    def of(cls, pixel: float, sigma: FloatArray | None, *, with_heights: bool) -> NoisePrior:
        """Return what is known of the noise of an image whose heights count, or do not."""
        return cls(pixel, sigma,
                   CAMERA_NOISE_LOG_DEVIATION if with_heights else NOISE_LOG_DEVIATION)

    def log_probability(self, noises: FloatArray) -> FloatArray:
        """Return logarithms of how likely noises (s,) are; the probabilities add up to one."""
        median = NOISE_MEDIAN * self.pixel if self.sigma is None else float(np.median(self.sigma))
        excess = np.log(noises / median)
        deviation = np.where(excess > 0.0, self.log_deviation, NOISE_LOG_DEVIATION)
        logs = -0.5 * (excess / deviation) ** 2
        return np.asarray(logs - np.logaddexp.reduce(logs))

    def relative_variances(self, n: int) -> FloatArray:
        """Return the variances of n measurements by that of a usual one, (n,)."""
        if self.sigma is None:
            return np.ones(n)
        return np.asarray((self.sigma**2).mean(axis=1) / np.median(self.sigma**2))


@dataclass(frozen=True, eq=False)
class Solution:
    """The fields of one pair of lengths, averaged over ratios and noises.

    With w the probability of a ratio on an axis, and s^2 the expected noise under it: `variance`
    (2,) is the sum of w s^2 ratio^2, `explained` (2, n, n) that of w s^2 ratio^4 P, `weights`
    (2, r) are the probabilities and `means` (r, n, 2) ratio^2 P r, of line and sample. `share` is
    the probability of the lengths.
    """

    share: float
    lengths: tuple[float, float]
    variance: FloatArray
    explained: FloatArray
    weights: FloatArray
    means: FloatArray


@dataclass(frozen=True, eq=False)
class Misfit:
    """What a model does not fit, in scaled coordinates: solutions with a field."""

    positions: FloatArray  # (n, 2): of the control, in the image
    solutions: tuple[Solution, ...]

    @property
    def probability(self) -> float:
        """Probability of a field."""
        return float(sum(solution.share for solution in self.solutions))

    def squares(self, image: FloatArray) -> FloatArray:
        """Return the mean square of what the model misses at places in the image, (m, 2)."""
        total = np.zeros((len(image), 2))
        for solution in self.solutions:
            correlations = matern(image, self.positions, solution.lengths)             # (m, n)
            for axis in (0, 1):
                explained = ((correlations @ solution.explained[axis]) * correlations).sum(axis=1)
                means = correlations @ solution.means[:, :, axis].T                     # (m, r)
                total[:, axis] += np.maximum(solution.variance[axis] - explained, 0.0) \
                    + means**2 @ solution.weights[axis]
        return total

    def covariance(self, image: FloatArray, axis: int) -> FloatArray:
        """Return the covariance of what the model misses among places in the image, (m, m)."""
        total = np.zeros((len(image), len(image)))
        for solution in self.solutions:
            correlations = matern(image, self.positions, solution.lengths)
            total += solution.variance[axis] * matern(image, image, solution.lengths) \
                - correlations @ solution.explained[axis] @ correlations.T
        return total


def misfit_of(image: FloatArray, residuals: FloatArray, noise: NoisePrior,
              effective: float | None) -> Misfit | None:
    """Return what a model does not fit, from the residuals of its control (n, 2); None if few.

    The image (n, 2) is where the model sees the control, all scaled; `effective` are the parameters
    of both axes together, None where the residuals are not less for them.
    """
    if len(image) > MISFIT_MAX_POINTS:
        rows = np.linspace(0, len(image) - 1, MISFIT_MAX_POINTS).round().astype(int)
        effective = None if effective is None else effective * MISFIT_MAX_POINTS / len(image)
        image = image[rows]
        residuals = residuals[rows]
        noise = noise if noise.sigma is None else replace(noise, sigma=noise.sigma[rows])
    n = len(image)
    trend = trend_of(image, len(image))
    freedom = n - trend.shape[1]
    effective = 2.0 * trend.shape[1] if effective is None else effective
    if n < MISFIT_MIN_POINTS or 2 * n - effective < 2.0 or freedom < 2 or not residuals.any():
        return None
    # The model has taken up more than the trend: as much larger its residuals would be else.
    residuals = residuals * np.sqrt(2 * freedom / (2 * n - effective))
    precise = noise.relative_variances(n)
    noises = NOISE_BY_SCATTER * np.sqrt((residuals**2).mean())
    log_prior = noise.log_probability(noises)
    logs = [np.log(1.0 - MISFIT_PROBABILITY) + log_prior
            + restricted_likelihood(np.diag(precise), trend, residuals, noises)[0].sum(axis=0)]
    fields = []
    for lengths in MISFIT_LENGTHS:
        ratio_logs, projections = _by_ratios(lengths, image, np.diag(precise), trend, residuals,
                                             noises)
        by_noise = np.logaddexp.reduce(ratio_logs, axis=1)                             # (2, s)
        logs.append(np.log(MISFIT_PROBABILITY / len(MISFIT_LENGTHS)) + log_prior
                    + by_noise.sum(axis=0))
        fields.append((lengths, np.exp(ratio_logs - by_noise[:, None]), projections))
    if not np.isfinite(logs).all():  # seen on one line of the image: no trend is determined
        return None
    shares = np.exp(np.array(logs) - np.logaddexp.reduce(logs, axis=None))             # (l, s)
    solutions = [_solution(lengths, share * by_ratio, projections, residuals, noises)
                 for share, (lengths, by_ratio, projections) in zip(shares[1:], fields, strict=True)
                 if share.sum() > NEGLIGIBLE_SHARE]
    return Misfit(image, tuple(solutions))


def mixed_misfit(misfits: Sequence[tuple[float, Misfit]]) -> Misfit | None:
    """Return what is missed where each holds with a chance, of the same control; None of none."""
    if not misfits:
        return None
    solutions = [replace(solution, share=chance * solution.share,
                         variance=chance * solution.variance,
                         explained=chance * solution.explained, weights=chance * solution.weights)
                 for chance, misfit in misfits for solution in misfit.solutions if chance > 0.0]
    return Misfit(misfits[0][1].positions, tuple(solutions))


def _by_ratios(lengths: tuple[float, float], image: FloatArray, precise: FloatArray,
               trend: FloatArray, residuals: FloatArray,
               noises: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return logarithms of p(r, ratio | length, s) for each axis, (2, r, s), and P, (r, n, n)."""
    correlation = matern(image, image, lengths)
    logs = []
    projections = []
    for ratio in MISFIT_RATIOS:
        log, projection = restricted_likelihood(precise + ratio**2 * correlation, trend, residuals,
                                                 noises)
        logs.append(log - np.log(len(MISFIT_RATIOS)))
        projections.append(projection)
    return np.stack(logs, axis=1), np.array(projections)


def _solution(lengths: tuple[float, float], shares: FloatArray, projections: FloatArray,
              residuals: FloatArray, noises: FloatArray) -> Solution:
    """Return the fields of one pair of lengths; `shares` (2, r, s) are of ratios and noises."""
    squared_ratios = np.square(MISFIT_RATIOS)
    noise = shares @ noises**2                                  # (2, r): w s^2
    means = squared_ratios[:, None, None] * (projections @ residuals)
    return Solution(float(shares[0].sum()), lengths, noise @ squared_ratios,
                    np.einsum("ar,rnm->anm", noise * squared_ratios**2, projections),
                    shares.sum(axis=2), means)


def restricted_likelihood(covariance: FloatArray, trend: FloatArray, residuals: FloatArray,
                          noises: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the restricted log likelihood of line and sample for each noise, (2, s), and P."""
    lower = np.linalg.cholesky(covariance)
    inverse = np.linalg.inv(lower)
    whitened_trend = inverse @ trend
    q, r = np.linalg.qr(whitened_trend)
    root = inverse - q @ (q.T @ inverse)
    projection = root.T @ root
    squares = (residuals * (projection @ residuals)).sum(axis=0)
    freedom = len(residuals) - trend.shape[1]
    log = -freedom * np.log(noises) - 0.5 * squares[:, None] / noises**2
    return log - np.log(np.diag(lower)).sum() - np.log(np.abs(np.diag(r))).sum(), projection


def trend_of(image: FloatArray, n_points: int) -> FloatArray:
    """Return the columns at places (m, 2) of the trend that so many points determine."""
    line, sample = image.T
    columns = [np.ones(len(image)), line, sample]
    if n_points >= QUADRATIC_TREND_POINTS:
        columns += [line**2, line * sample, sample**2]
    return np.column_stack(columns)


def matern(a: FloatArray, b: FloatArray, lengths: tuple[float, float],
           smoothness: float = 1.5) -> FloatArray:
    """Return the correlations between places, shape (len(a), len(b)).

    The smoothness is 1/2, 3/2 or infinite.
    """
    differences = (a / np.array(lengths))[:, None] - (b / np.array(lengths))[None]
    squares = (differences**2).sum(axis=2)
    if smoothness == np.inf:
        return np.asarray(np.exp(-0.5 * squares))
    if smoothness == 0.5:
        return np.asarray(np.exp(-np.sqrt(squares)))
    r = np.sqrt(3.0 * squares)
    return np.asarray((1.0 + r) * np.exp(-r))
