"""A cubic polynomial with the prior of known cameras, averaged with shrunken ones.

Cubic polynomials fitted to what plausible cameras see (see `termsel.adjustment.bayesian.cameras`)
have a mean
and a covariance of all coefficients but those that are affine in X and Y, which are free; line and
sample go together. The prior is normal with that mean, and with the covariance times the square of
a width: wide, it forgets the physics by degrees. Kind of camera, width and noise are not known, and
averaged over a grid by marginal likelihood. Every solution on it is linear in the measurements, so
that those without each point, and their probabilities, are known in closed form.

The regularised polynomials of any image are the other parts of the average, by their own marginal
likelihood. In it Z has no prior. So that both compare, what a height does gets that of views from
the air or space (`PARALLAX`), as a density at its estimate, and the noise its own, likewise.

References
----------
Hoeting et al. 1999, Statistical Science 14(4), for averaging; Rasmussen and Williams 2006, Gaussian
Processes for Machine Learning, sections 2.7 and 5.4, for free columns and leaving out. The prior
from an ensemble of cameras is termsel's own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from math import lgamma
from typing import TypeAlias

import numpy as np

from termsel.adjustment.bayesian.cameras import (
    frame_views,
    radar_views,
    scanner_views,
)
from termsel.adjustment.bayesian.posterior import (
    PRIOR_SIZES,
    Posterior,
    log_prior_of_sizes,
    normalized,
)
from termsel.data.features import FloatArray
from termsel.data.fit_data import PARALLAX
from termsel.data.monomials import Exponents, monomials

Views: TypeAlias = Callable[[FloatArray, float, float], tuple[FloatArray, ...]]

Kind: TypeAlias = tuple[str, Views, float]
"""A kind of cameras, what they see (see `termsel.adjustment.bayesian.cameras`), and how likely each
of these views is beforehand, next to an image of which nothing is known."""

SCANNERS: Kind = ("a line scanner in orbit", scanner_views, 1.0)

RADARS: tuple[Kind, ...] = tuple(
    ("a radar in orbit", partial(radar_views, right=right), 0.125) for right in (True, False))
FRAMES: Kind = ("a frame camera",
                lambda positions, azimuth, _: frame_views(positions, azimuth), 0.5)

PRIOR_WIDTHS = np.array([0.3, 1.0, 3.0, 10.0])
"""By what the deviations of the cameras from their mean are multiplied."""

NOISE_GRID = np.geomspace(0.15, 15.0, 14)
"""Standard deviations of a measurement [px]."""

NOISE_MEDIAN = 1.0
"""Median of the noise beforehand [px]."""

NOISE_LOG_DEVIATION = 1.4
"""Standard deviation of its logarithm: four times in five it is from 0.25 px, of targets, to 4 px,
of crossings in a coarse image."""

N_FREE = 3
"""Columns of an axis that are free: 1, X and Y."""

AZIMUTH_STEP = 0.5
"""Steps in which cameras turn [degrees], much less than what is unknown of it."""

N_VIEW_POINTS = 60
"""Places at which cameras look."""

VIEW_BOX = 1.2
"""Size of the box of these places by that of the points."""

DEPARTURE_SIZES = (0.01, 0.3, 1.0, 3.0)
"""Standard deviations of what no camera explains of a quadratic coefficient [px]: attitude that
changes in another way, or the interior of the camera. They are as likely."""

DEPARTURE_FALL = 0.1
"""The same of cubic coefficients, by that of quadratic ones."""

DEPARTURE_RELIEF = 0.03
"""The same of a further power of Z, by that without it."""


@dataclass(frozen=True, eq=False)
class CameraPrior:
    """A normal prior of the coefficients that are not free, those of line before those of sample.
    """

    mean: FloatArray  # (c,)
    root: FloatArray  # (c, c): times its transpose it is the covariance
    share: float  # how likely it is beforehand
    kind: str


def camera_priors(kinds: Sequence[Kind], positions: FloatArray, scaled: FloatArray,
                  exponents: Exponents, latitude: float, slopes: FloatArray,
                  pixel: float) -> list[CameraPrior]:
    """Return priors by cameras that see places (m, 3) [m], which are scaled (m, 3), too.

    None of them if hardly any camera sees these. The slopes are those of line and of sample by
    metres to the east and to the north, (2, 2), in scaled units; `pixel` is that of a pixel.
    """
    azimuth = AZIMUTH_STEP * round(np.degrees(float(np.arctan2(*slopes[0]))) / AZIMUTH_STEP)
    view_points = ViewPoints(positions, scaled, exponents, slopes, pixel)
    priors = []
    for kind, views, share in kinds:
        for image in _cached_views(views, positions.tobytes(), azimuth, latitude):
            priors += _priors_of_views(kind, image, share, view_points)
    return priors


@dataclass(frozen=True, eq=False)
class ViewPoints:
    """Positions at which cameras look, and what the points say of the image there.

    As for `camera_priors`.
    """

    positions: FloatArray  # (m, 3) [m]
    scaled: FloatArray  # (m, 3)
    exponents: Exponents
    slopes: FloatArray  # (2, 2)
    pixel: float


@lru_cache(maxsize=16)  # points held out hardly turn an image, and most do not narrow its extent
def _cached_views(views: Views, positions: bytes, azimuth: float,
                  latitude: float) -> tuple[FloatArray, ...]:
    return views(np.frombuffer(positions).reshape(-1, 3), np.radians(azimuth), latitude)


def _priors_of_views(kind: str, views: FloatArray, share: float,
                     view_points: ViewPoints) -> list[CameraPrior]:
    """Return the priors by what one kind of cameras sees, (c, m, 2) (see `camera_priors`)."""
    exponents = view_points.exponents
    if len(views) < 2 * len(exponents):
        return []
    positions = view_points.positions
    plane = np.column_stack([np.ones(len(positions)), positions[:, :2]])
    view_slopes = np.linalg.pinv(plane)[1:] @ views                                  # (c, 2, 2)
    # Each camera has the pixels of the image, and counts samples in its direction.
    factor = np.linalg.norm(view_points.slopes, axis=1) / np.linalg.norm(view_slopes, axis=1)
    factor *= np.sign(np.einsum("cxa,ax->ca", view_slopes, view_points.slopes))
    columns = monomials(view_points.scaled, exponents)
    coefficients = np.linalg.pinv(columns) @ (views * factor[:, None])               # (c, k, 2)
    shrunken = coefficients[:, N_FREE:].swapaxes(1, 2).reshape(len(coefficients), -1)
    mean = shrunken.mean(axis=0)
    powers = np.array(exponents[N_FREE:])
    # Roots by QR: a covariance of cameras that hardly differ has none by Cholesky.
    spread = np.linalg.qr((shrunken - mean) / np.sqrt(len(shrunken) - 1.0), mode="r")
    departure = np.tile(view_points.pixel
                        * DEPARTURE_FALL ** np.maximum(powers.sum(axis=1) - 2.0, 0.0)
                        * DEPARTURE_RELIEF ** powers[:, 2], 2)
    width_shares = 1.0 / np.hypot(1.0, PRIOR_WIDTHS)
    width_shares *= share / (width_shares.sum() * len(DEPARTURE_SIZES))
    priors = []
    for width, width_share in zip(PRIOR_WIDTHS, width_shares, strict=True):
        for size in DEPARTURE_SIZES:
            # The root of the sum of both covariances: R of their roots, one above the other.
            root = np.linalg.qr(np.vstack([width * spread, np.diag(size * departure)]), mode="r")
            priors.append(CameraPrior(mean, np.transpose(root), float(width_share), kind))
    return priors


class CameraEquations:
    """Weighted equations of a polynomial, without what free coefficients take.

    The columns (n, k) are monomials, free ones first, of which the image is (n, 2), and the weights
    are (n, 2). All is scaled.
    """

    def __init__(self, columns: FloatArray, image: FloatArray, weights: FloatArray) -> None:
        self.columns = columns
        self.image = image
        self.weights = weights
        lead = _both_axes(columns[:, :N_FREE], weights)
        shrunken = _both_axes(columns[:, N_FREE:], weights)
        q, r = np.linalg.qr(lead, mode="complete")
        self.lead = r[:2 * N_FREE]
        self.basis = q[:, 2 * N_FREE:]
        self.free_projections = q[:, :2 * N_FREE].T @ shrunken
        self.shrunken = self.basis.T @ shrunken
        self.target = self.basis.T @ (image * weights).T.ravel()


class CameraSolutions:
    """All solutions of equations with a prior, for all noises; `pixel` is a pixel, scaled."""

    def __init__(self, equations: CameraEquations, prior: CameraPrior, pixel: float) -> None:
        self._equations = equations
        self._prior = prior
        self.kind = prior.kind
        # Along U, what the prior lets vary has the variance S^2, to which comes that of the noise.
        varying = equations.shrunken @ prior.root
        u, values, self._vt = np.linalg.svd(varying,
                                            full_matrices=varying.shape[0] > varying.shape[1])
        self._strength = np.zeros(len(u))
        self._strength[:len(values)] = values
        self.noise = NOISE_GRID * pixel
        self._variance = self._strength**2 + self.noise[:, None] ** 2                   # (c, v)
        self._projections = u.T @ (equations.target - equations.shrunken @ prior.mean)
        self._rows = equations.basis @ u
        # The noise is log-normal beforehand; given it, the projections are normal.
        standardised_noise = np.log(NOISE_GRID / NOISE_MEDIAN) / NOISE_LOG_DEVIATION
        log_prior = np.log(normalized(-0.5 * standardised_noise**2)[0])
        minus_twice_log_density = (np.log(2 * np.pi * self._variance).sum(axis=1)
                                   + (self._projections**2 / self._variance).sum(axis=1))
        self._logs = (log_prior - 0.5 * minus_twice_log_density
                      - np.log(np.abs(np.diag(equations.lead))).sum() + np.log(prior.share))
        self.log_evidence = float(np.logaddexp.reduce(self._logs))
        self.share = np.exp(self._logs - self.log_evidence)

    @property
    def log_evidence_without(self) -> FloatArray:
        """The logarithm of the marginal likelihood without each point, shape (n,)."""
        return self._held_out[0]

    @property
    def errors(self) -> FloatArray:
        """Errors of each point left out, shape (n, 2)."""
        return self._held_out[1]

    @cached_property
    def _held_out(self) -> tuple[FloatArray, FloatArray]:
        """Log evidence without each point, (n,), and its errors by the others, (n, 2)."""
        # The errors of a point by all others: P^-1 P y of its two rows, P the inverse covariance.
        rows_of_axes = np.split(self._rows, 2)
        precision = 1.0 / self._variance
        n_noises = len(precision)
        n = len(rows_of_axes[0])
        inverse = np.empty((n_noises, n, 2, 2))
        right = np.empty((n_noises, n, 2))
        for a, rows in enumerate(rows_of_axes):
            right[:, :, a] = (precision * self._projections) @ rows.T
            for b, other_rows in enumerate(rows_of_axes):
                inverse[:, :, a, b] = precision @ (rows * other_rows).T
        errors = np.linalg.solve(inverse, right[..., None])[..., 0]
        # The density of the point given the others is taken from that of all: it is normal with
        # these errors, and the inverse covariance of its two rows.
        logs = (self._logs[:, None] + 0.5 * (errors * right).sum(axis=2) + np.log(2 * np.pi)
                - 0.5 * np.log(np.linalg.det(inverse)))
        log_evidence = np.logaddexp.reduce(logs, axis=0)
        shares = np.exp(logs - log_evidence)
        return log_evidence, np.einsum("cn,cna->na", shares, errors) / self._equations.weights

    @cached_property
    def coefficients(self) -> FloatArray:
        """The averaged coefficients, shape (k, 2)."""
        # Along each direction V a solution has S / (S^2 + noise^2) of what is measured.
        projections = self.share @ (self._strength / self._variance * self._projections)
        rank = min(len(projections), len(self._vt))
        deviation = self._prior.root @ (self._vt[:rank].T @ projections[:rank])
        shrunken = (self._prior.mean + deviation).reshape(2, -1).T
        columns = self._equations.columns
        image = self._equations.image
        coefficients = np.empty((columns.shape[1], 2))
        coefficients[N_FREE:] = shrunken
        lead = columns[:, :N_FREE]
        for axis, w in enumerate(self._equations.weights.T):
            residuals = image[:, axis] - columns[:, N_FREE:] @ shrunken[:, axis]
            coefficients[:N_FREE, axis] = np.linalg.lstsq(lead * w[:, None], residuals * w)[0]
        return coefficients

    @property
    def effective(self) -> float:
        """Effective parameters of line and sample together."""
        return 2 * N_FREE + float(self.share @ (
            1.0 - self.noise[:, None] ** 2 / self._variance).sum(axis=1))

    def spread(self, columns: FloatArray) -> tuple[FloatArray, float]:
        """Return the variance of what is predicted at places (m, k), shape (m, 2), and the noise's.
        """
        count = len(columns)
        variance = np.empty((count, 2))
        noise = float(self.share @ self.noise**2)
        rank = min(len(self._strength), len(self._vt))
        free_rows = _both_axes(columns[:, :N_FREE], np.ones((count, 2)))
        shrunken_rows = _both_axes(columns[:, N_FREE:], np.ones((count, 2)))
        gain = (self._strength / self._variance)[:, :rank]
        for axis in (0, 1):
            rows = slice(axis * count, (axis + 1) * count)
            q = np.linalg.solve(self._equations.lead.T, free_rows[rows].T).T
            varying = (shrunken_rows[rows] - q @ self._equations.free_projections) \
                @ self._prior.root
            projections = (varying @ self._vt.T)[:, :rank]
            means = projections @ (gain * self._projections[:rank]).T                # (m, c)
            # The variance of the prior, less what the measurements tell of it.
            unexplained = (varying**2).sum(axis=1, keepdims=True) \
                - projections**2 @ (self._strength[:rank] * gain).T
            mean = means @ self.share
            variance[:, axis] = (q**2).sum(axis=1) * noise + (
                unexplained + (means - mean[:, None]) ** 2) @ self.share
        return variance, noise


def log_marginal_likelihood(posterior: Posterior, coefficients: FloatArray, variables: int,
                            height: float, pixel: float) -> float:
    """Return the logarithm of the marginal likelihood of regularised polynomials.

    On the scale of `CameraSolutions.log_evidence`. The coefficients (k, 2) are their average;
    `height` is what a scaled height of 1 moves on the ground, in scaled units of the image.
    """
    half = posterior.freedom / 2
    sizes = np.exp(log_prior_of_sizes())
    size_sum = sizes[PRIOR_SIZES > 0.0].sum() ** 2 + sizes[0] ** 2
    # The prior of scales and sizes, which the posterior has without its sum.
    log = posterior.cells.log_evidence - np.log(len(posterior.scales) * size_sum)
    # The integral over the noise of its density 1 / sigma: Gamma(nu/2) / 2 pi^(nu/2).
    log = log + lgamma(half) - np.log(2.0) - half * np.log(np.pi)
    # What the affine terms determine.
    log = log - sum(np.log(np.abs(np.diag(design.lead))).sum() for design in posterior.designs)
    mean_square = float(posterior.cells.share @ (posterior.square / posterior.freedom))
    log_noise = 0.5 * np.log(mean_square) - np.log(pixel)
    log += _density(log_noise - np.log(NOISE_MEDIAN), NOISE_LOG_DEVIATION)
    if variables == 3:
        # A height has the effect of views from the air or space: PARALLAX of it, at most.
        log += sum(_density(coefficient, PARALLAX * height) for coefficient in coefficients[3])
    return float(log)


def _density(value: float, deviation: float) -> float:
    """Return the logarithm of a normal density."""
    return float(-0.5 * (value / deviation) ** 2 - np.log(deviation * np.sqrt(2 * np.pi)))


def _both_axes(columns: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the rows of line, then those of sample, each with columns of its own."""
    (n, k) = columns.shape
    rows = np.zeros((2 * len(columns), 2 * columns.shape[1]))
    rows[:n, :k] = columns * weights[:, :1]
    rows[n:, k:] = columns * weights[:, 1:]
    return rows
