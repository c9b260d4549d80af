"""What a model does not fit: a smooth field that its residuals have in common.

Sheets shrink, scanners shake, lenses distort: a parametric model leaves a part that is alike at
neighbouring places. It is no noise, so it is part of the error of a prediction. The residuals r of
the control, reduced by a trend T that stands for what the model has taken up already, are

    r = T b + g + e,    g ~ (ratio s)^2 Matern,  e ~ s^2,

with places in the image, a Matern covariance of smoothness 3/2 and unknown length, ratio and s. All
are averaged with their restricted likelihood, and with them that there is no field. Under one
solution, with S the covariance of the residuals and P = S^-1 - S^-1 T (T' S^-1 T)^-1 T' S^-1, the
field at a place with covariances k to the control has the mean k' P r and the variance
(ratio s)^2 - k' P k. Both squared are what the model misses there: close to control it is seen, and
far away it is as large as it can be.

References
----------
Patterson and Thompson 1971 for the restricted likelihood; Moritz 1980 for collocation of
residuals; Stein 1999 for the Matern covariance. The prior is termsel's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel.data.features import FloatArray

MISFIT_LENGTHS = ((0.2, 0.2), (0.4, 0.4), (0.8, 0.8), (0.15, 2.0), (2.0, 0.15))
"""Lengths of line and sample, by the half-range of the image; the last two are those of scanners
that shake and of strips."""

MISFIT_RATIOS = (0.4, 0.8, 1.6)
"""Standard deviations of the field by that of the noise."""

MISFIT_PROBABILITY = 0.12
"""Probability of a field before the residuals are looked at. Few residuals do not tell a field of
short length from noise, so that this is what they add then: tuned on simulated sheets, photos and
scanners (docs/explanation/judgement.md)."""

MISFIT_MAX_POINTS = 200
"""Points by which the field is found; of more, such as are spread over the image."""

MISFIT_MIN_POINTS = 6
"""Points below which nothing tells a field."""

QUADRATIC_TREND_POINTS = 20
"""Points from which on the trend is quadratic; else it is affine."""

NEGLIGIBLE_SHARE = 1e-4
"""Probability of a solution that is left out."""


@dataclass(frozen=True, eq=False)
class Solution:
    """A field of one pair of lengths and one ratio.

    `share` is its probability; `weights` (n, 2) are P r of line and sample, `projection` (n, n) is
    s^2 P for noise of unit variance, and `noise` (2,) the variance s^2.
    """

    share: float
    lengths: tuple[float, float]
    ratio: float
    weights: FloatArray
    projection: FloatArray
    noise: FloatArray


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
            # (m, n)
            covariances = solution.ratio**2 * matern(image, self.positions, solution.lengths)
            mean = covariances @ solution.weights
            explained = np.einsum("mn,nk,mk->m", covariances, solution.projection, covariances)
            unexplained = np.maximum(solution.ratio**2 - explained, 0.0)[:, None] * solution.noise
            total += solution.share * (unexplained + mean**2)
        return total

    def covariance(self, image: FloatArray, axis: int) -> FloatArray:
        """Return the covariance of what the model misses among places in the image, (m, m)."""
        total = np.zeros((len(image), len(image)))
        for solution in self.solutions:
            covariances = solution.ratio**2 * matern(image, self.positions, solution.lengths)
            prior = solution.ratio**2 * matern(image, image, solution.lengths)
            total += solution.share * solution.noise[axis] * (
                prior - covariances @ solution.projection @ covariances.T)
        return total


def misfit_of(image: FloatArray, residuals: FloatArray, sigma: FloatArray | None,
              effective: float) -> Misfit | None:
    """Return what a model does not fit, from the residuals of its control (n, 2); None if few.

    The image (n, 2) is where the model sees the control, all scaled; `sigma` (n, 2) are standard
    deviations of the measurements, if known, and `effective` the parameters of both axes together.
    """
    if len(image) > MISFIT_MAX_POINTS:
        rows = np.linspace(0, len(image) - 1, MISFIT_MAX_POINTS).round().astype(int)
        effective *= MISFIT_MAX_POINTS / len(image)
        image = image[rows]
        residuals = residuals[rows]
        sigma = None if sigma is None else sigma[rows]
    n = len(image)
    trend = _trend(image)
    freedom = n - trend.shape[1]
    if n < MISFIT_MIN_POINTS or 2 * n - effective < 2.0 or freedom < 2 or not residuals.any():
        return None
    # The model has taken up more than the trend: as much larger its residuals would be else.
    residuals = residuals * np.sqrt(2 * freedom / (2 * n - effective))
    noise = np.ones(n) if sigma is None else (sigma**2).mean(axis=1) / np.median(sigma**2)
    logs = [
        _restricted_likelihood(np.diag(noise), trend, residuals)[0]
        + np.log(1.0 - MISFIT_PROBABILITY)
    ]
    fields = []
    prior_probability = MISFIT_PROBABILITY / len(MISFIT_LENGTHS) / len(MISFIT_RATIOS)
    for lengths in MISFIT_LENGTHS:
        correlation = matern(image, image, lengths)
        for ratio in MISFIT_RATIOS:
            log, projection, square = _restricted_likelihood(
                np.diag(noise) + ratio**2 * correlation, trend, residuals)
            logs.append(log + np.log(prior_probability))
            fields.append((lengths, ratio, projection, square))
    if not np.isfinite(logs).all():  # seen on one line of the image: no trend is determined
        return None
    shares = np.exp(np.array(logs) - np.logaddexp.reduce(logs))
    return Misfit(image, tuple(
        Solution(float(share), lengths, ratio, projection @ residuals, projection,
                 square / max(freedom - 2, 1))
        for share, (lengths, ratio, projection, square) in zip(shares[1:], fields, strict=True)
        if share > NEGLIGIBLE_SHARE))


def _restricted_likelihood(covariance: FloatArray, trend: FloatArray,
                           residuals: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Return the restricted log likelihood, P, and r' P r of line and sample (2,).

    The variance s^2 of each axis is integrated out.
    """
    lower = np.linalg.cholesky(covariance)
    inverse = np.linalg.inv(lower)
    whitened_trend = inverse @ trend
    q, r = np.linalg.qr(whitened_trend)
    root = inverse - q @ (q.T @ inverse)
    projection = root.T @ root
    square = np.maximum((residuals * (projection @ residuals)).sum(axis=0), np.finfo(float).tiny)
    freedom = len(residuals) - trend.shape[1]
    log = -2 * (np.log(np.diag(lower)).sum() + np.log(np.abs(np.diag(r))).sum()) \
        - freedom / 2 * np.log(square).sum()
    return float(log), projection, square


def _trend(image: FloatArray) -> FloatArray:
    line, sample = image.T
    columns = [np.ones(len(image)), line, sample]
    if len(image) >= QUADRATIC_TREND_POINTS:
        columns += [line**2, line * sample, sample**2]
    return np.column_stack(columns)


def matern(a: FloatArray, b: FloatArray, lengths: tuple[float, float]) -> FloatArray:
    """Return the correlations between places, shape (len(a), len(b))."""
    scale = np.sqrt(3.0) / np.array(lengths)
    differences = (a * scale)[:, None] - (b * scale)[None]
    r = np.sqrt((differences**2).sum(axis=2))
    return np.asarray((1.0 + r) * np.exp(-r))
