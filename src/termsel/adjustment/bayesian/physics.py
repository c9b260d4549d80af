"""A cubic polynomial with the prior of known cameras, averaged with shrunken ones.

Cubic polynomials fitted to what plausible cameras see (see `termsel.adjustment.bayesian.cameras`)
have a mean and a covariance of all coefficients but those that are affine in X and Y, which are
free; line and sample go together. The prior is normal with that mean, and with the covariance times
the square of a width: wide, it forgets the physics by degrees. Kind of camera, width and noise are
not known, and averaged over a grid by marginal likelihood. Every solution on it is linear in the
measurements, so that those without each point, and their probabilities, are known in closed form.

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
from copy import copy
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache, partial
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
    normalise_probabilities,
)
from termsel.data.features import BoolArray, FloatArray, IntArray
from termsel.data.fit_data import PARALLAX
from termsel.data.monomials import Exponents, evaluate_monomials

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


@cache  # a prior is the same for all data
def view_points(variables: int) -> FloatArray:
    """Return scaled places at which cameras look, (m, 3): a prior is the same for all data."""
    rng = np.random.default_rng(0)
    scaled = rng.uniform(-VIEW_BOX, VIEW_BOX, (N_VIEW_POINTS, 3)) * [1.0, 1.0, variables == 3]
    scaled.setflags(write=False)
    return scaled


@dataclass(frozen=True, eq=False)
class CameraPriors:
    """Normal priors of the coefficients that are not free, those of line before those of sample.

    A stack of p priors, by v kinds of views. The covariance of a prior is that of its views, C,
    widened, with what no camera explains, D, of some size:

        covariance = width^2 C + size^2 D^2.
    """

    means: FloatArray  # (v, c)
    covariances: FloatArray  # (v, c, c): of the cameras of each kind of views
    departure: FloatArray  # (c,): the diagonal of D
    kinds: tuple[str, ...]  # (v,)
    view: IntArray  # (p,): which views
    width: FloatArray  # (p,)
    size: FloatArray  # (p,)
    share: FloatArray  # (p,): how likely each prior is beforehand

    def take(self, which: BoolArray) -> CameraPriors:
        """Return some of the priors."""
        return replace(self, view=self.view[which], width=self.width[which],
                       size=self.size[which], share=self.share[which])

    def covariance_times(self, vectors: FloatArray) -> FloatArray:
        """Return the covariance of each of the p priors times its row of `vectors`, both (p, c)."""
        # Cov v = w^2 C v + s^2 D^2 v, without the sum of the matrices.
        by_views = (self.covariances[self.view] @ vectors[..., None])[..., 0]
        return np.asarray(self.width[:, None] ** 2 * by_views
                          + self.size[:, None] ** 2 * self.departure**2 * vectors)


def camera_priors(kinds: Sequence[Kind], positions: FloatArray, scaled: FloatArray,
                  exponents: Exponents, latitude: float, slopes: FloatArray,
                  pixel: float) -> CameraPriors | None:
    """Return priors of the coefficients of a polynomial by cameras that see the places.

    `positions` (m, 3) of the places are in metres, `scaled` (m, 3) are the same as the polynomial
    of the `exponents` has them; `latitude` is in degrees, NaN if it is not known. The `slopes`
    (2, 2) are those of line and of sample by metres to the east and to the north, in scaled units;
    `pixel` is a pixel in these. Returns None if hardly any camera of the `kinds` sees the places.
    """
    # In steps, so that views of points held out are found again.
    azimuth = AZIMUTH_STEP * round(np.degrees(float(np.arctan2(*slopes[0]))) / AZIMUTH_STEP)
    means = []
    covariances = []
    names = []
    shares_of_views = []
    for kind, views, share in kinds:
        for own_slopes, coefficients in _cached_views(views, positions.tobytes(), scaled.tobytes(),
                                                      exponents, azimuth, latitude):
            # Each camera has the pixels of the image, and counts samples in its direction.
            factor = np.linalg.norm(slopes, axis=1) / np.linalg.norm(own_slopes, axis=1)
            factor *= np.sign((own_slopes * slopes.T).sum(axis=1))
            of_image = (coefficients * factor[:, :, None]).reshape(len(factor), -1)
            mean = of_image.mean(axis=0)
            deviations = of_image - mean
            means.append(mean)
            covariances.append(deviations.T @ deviations / (len(factor) - 1.0))
            names.append(kind)
            shares_of_views.append(share)
    if not means:
        return None
    powers = np.array(exponents[N_FREE:])
    departure = np.tile(pixel * DEPARTURE_FALL ** np.maximum(powers.sum(axis=1) - 2.0, 0.0)
                        * DEPARTURE_RELIEF ** powers[:, 2], 2)
    # Each of the views with all widths and sizes; the wider, the less likely.
    # Widths in proportion to 1 / sqrt(1 + w^2).
    width_shares = 1.0 / np.hypot(1.0, PRIOR_WIDTHS)
    width_shares /= width_shares.sum() * len(DEPARTURE_SIZES)
    view, width, size = (each.ravel() for each in np.meshgrid(
        np.arange(len(means)), np.arange(len(PRIOR_WIDTHS)), DEPARTURE_SIZES, indexing="ij"))
    return CameraPriors(np.array(means), np.array(covariances), departure, tuple(names), view,
                        PRIOR_WIDTHS[width], size,
                        np.array(shares_of_views)[view] * width_shares[width])


@lru_cache(maxsize=16)  # points held out hardly turn an image, and most do not narrow its extent
def _cached_views(views: Views, positions: bytes, scaled: bytes, exponents: Exponents,
                  azimuth: float, latitude: float) -> list[tuple[FloatArray, FloatArray]]:
    """Return slopes (c, 2, 2) and coefficients (c, 2, k - N_FREE) of the images of c cameras."""
    places = np.frombuffer(positions).reshape(-1, 3)
    plane = np.column_stack([np.ones(len(places)), places[:, :2]])
    to_slopes = np.linalg.pinv(plane)[1:]
    to_coefficients = np.linalg.pinv(
        evaluate_monomials(np.frombuffer(scaled).reshape(-1, 3), exponents))[N_FREE:]
    # Fewer cameras than coefficients have a covariance of too low a rank.
    return [(to_slopes @ seen, np.ascontiguousarray((to_coefficients @ seen).swapaxes(1, 2)))
            for seen in views(places, np.radians(azimuth), latitude)
            if len(seen) >= 2 * len(exponents)]


class CameraEquations:
    """Weighted equations of a polynomial, without what free coefficients take.

    The columns (n, k) are monomials, free ones first, of which the image is (n, 2), and the weights
    are (n, 2). All is scaled.
    """

    def __init__(self, columns: FloatArray, image: FloatArray, weights: FloatArray) -> None:
        """Rotate the equations, so that the free columns are in the first of them alone."""
        self.columns = columns
        self.image = image
        self.weights = weights
        lead = _stack_axes(columns[:, :N_FREE], weights)
        shrunken = _stack_axes(columns[:, N_FREE:], weights)
        # The complement of what free columns span: what remains does not depend on them.
        q, r = np.linalg.qr(lead, mode="complete")
        self.lead = r[:2 * N_FREE]
        self.basis = q[:, 2 * N_FREE:]
        self.free_projections = q[:, :2 * N_FREE].T @ shrunken
        self.shrunken = self.basis.T @ shrunken
        # Line first, then sample, as the rows of both axes are stacked.
        measured = (image * weights).T.ravel()
        self.target = self.basis.T @ measured
        self.free_target = q[:, :2 * N_FREE].T @ measured


class CameraSolutions:
    """The solutions of equations under each of p priors and each of a noises.

    With A the shrunken columns without the free ones (r, k - N_FREE), y what is measured along them
    (r,), and A covariance A' = U diag(s) U' for each prior, y - A mean is normal along U with the
    variances s + noise^2. `pixel` is the scaled length of a pixel.
    """

    def __init__(self, equations: CameraEquations, priors: CameraPriors, pixel: float) -> None:
        """Decompose the covariance of each prior, and find how likely each noise is under it."""
        self._equations = equations
        self.priors = priors
        self.noise = NOISE_GRID * pixel
        columns = equations.shrunken
        by_views = columns @ priors.covariances @ columns.T                             # (v, r, r)
        by_departure = (columns * priors.departure**2) @ columns.T
        # Eigenvectors of the prior's covariance of the observations make all noises diagonal.
        values, self._u = np.linalg.eigh(
            priors.width[:, None, None] ** 2 * by_views[priors.view]
            + priors.size[:, None, None] ** 2 * by_departure)
        noise = self.noise[:, None] ** 2
        # 1 / (lambda + sigma^2), by prior, noise and direction.
        self._precision = 1.0 / (np.maximum(values, 0.0)[:, None] + noise)           # (p, a, r)
        beyond_mean = (equations.target - priors.means @ columns.T)[priors.view]
        self._along = (beyond_mean[:, None] @ self._u)[:, 0]                            # (p, r)
        noise_share = normalise_probabilities(
            -0.5 * (np.log(NOISE_GRID / NOISE_MEDIAN) / NOISE_LOG_DEVIATION) ** 2)[0]
        squares = (self._precision @ self._along[..., None] ** 2)[..., 0]
        # log p = -(n log 2 pi + log det S + v' S^-1 v) / 2, less the determinant of the lead, with
        # the priors of the noise and of the views.
        deviance = len(columns) * np.log(2 * np.pi) - np.log(self._precision).sum(axis=2) + squares
        log_lead = np.log(np.abs(np.diag(equations.lead))).sum()
        self._logs = (np.log(noise_share) - 0.5 * deviance - log_lead
                      + np.log(priors.share)[:, None])
        # Of each prior: the logarithm of its marginal likelihood, and how likely each noise is.
        self.share, self.log_evidence = normalise_probabilities(self._logs.T)
        self.share = self.share.T                                                       # (p, a)

    def __len__(self) -> int:
        return len(self.log_evidence)

    def take(self, which: BoolArray) -> CameraSolutions:
        """Return the solutions with some of the priors."""
        fewer = copy(self)
        fewer.priors = self.priors.take(which)
        for name in ("_u", "_precision", "_along", "_logs", "share", "log_evidence"):
            setattr(fewer, name, getattr(self, name)[which])
        return fewer

    def left_out(self) -> tuple[FloatArray, FloatArray]:
        """Return what each prior makes of each point without it.

        These are the logarithm of the marginal likelihood of the other points, (p, n), and the
        point's error by them, (p, n, 2): P_ii^-1 (P y)_i of its two rows i, P being the inverse
        covariance of all rows.
        """
        rows = self._equations.basis @ self._u                                       # (p, 2n, r)
        n = len(self._equations.image)
        # Of the inverse S^-1, the 2 by 2 blocks of each point; the error without it is their
        # solution.
        line = rows[:, :n].swapaxes(1, 2)
        sample = rows[:, n:].swapaxes(1, 2)
        precision = self._precision
        weighted = precision * self._along[:, None]
        of_line = precision @ line**2                                                # (p, a, n)
        of_sample = precision @ sample**2
        of_both = precision @ (line * sample)
        right_line = weighted @ line
        right_sample = weighted @ sample
        # [[l, b], [b, s]]^-1 = [[s, -b], [-b, l]] / (l s - b^2), for the block of each point.
        determinant = of_line * of_sample - of_both**2
        errors = np.stack([of_sample * right_line - of_both * right_sample,
                           of_line * right_sample - of_both * right_line]) / determinant
        # log p(others) = log p(all) - log p(point | others). The latter is a normal density of the
        # error e with the precision P_ii: -log 2 pi + log|P_ii| / 2 - e' P_ii e / 2, where P_ii e
        # is (P y)_i.
        logs = (self._logs[..., None] + np.log(2 * np.pi) - 0.5 * np.log(determinant)
                + 0.5 * (errors[0] * right_line + errors[1] * right_sample))
        share, log_each = normalise_probabilities(logs.swapaxes(0, 1))
        mean = np.einsum("apn,xpan->pnx", share, errors)
        return log_each, mean / self._equations.weights

    @cached_property
    def coefficients(self) -> FloatArray:
        """The coefficients, averaged over the noises, shape (p, k, 2)."""
        equations = self._equations
        priors = self.priors
        # The mean of the prior, and what the residuals add to it: x = mu + C A' S^-1 v.
        weighted = (self.share[:, None] @ self._precision)[:, 0] * self._along          # (p, r)
        projected = (self._u @ weighted[..., None])[..., 0] @ equations.shrunken       # (p, c)
        shrunken = priors.means[priors.view] + priors.covariance_times(projected)      # (p, c)
        n_priors = len(shrunken)
        coefficients = np.empty((n_priors, equations.columns.shape[1], 2))
        coefficients[:, N_FREE:] = shrunken.reshape(n_priors, 2, -1).swapaxes(1, 2)
        # Free coefficients fit what the others leave: R x = Q'(y - A shrunken), with factors Q R.
        left_to_free = equations.free_target - shrunken @ equations.free_projections.T
        free = np.linalg.solve(equations.lead, left_to_free.T).T
        coefficients[:, :N_FREE] = free.reshape(-1, 2, N_FREE).swapaxes(1, 2)
        return coefficients

    @property
    def effective(self) -> FloatArray:
        """Effective parameters of line and sample together, (p,)."""
        explained = (1.0 - self.noise[:, None] ** 2 * self._precision).sum(axis=2)
        return np.asarray(2 * N_FREE + (self.share * explained).sum(axis=1))

    def spread(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the variance (p, m, 2) of the prediction at m places, and (p,) of the noise.

        `columns` (m, k) are the monomials at the places and p counts the priors. The free
        coefficients, of an affine image, have a variance by the noise alone; of the others the
        prior covariance is lessened by what the points explain of it. Noises of the grid are
        averaged, with the variance of their means.
        """
        equations = self._equations
        priors = self.priors
        noise = self.share @ self.noise**2
        variance = np.empty((len(self.share), len(columns), 2))
        count = len(columns)
        for axis in (0, 1):
            rows_of_axis = slice(axis * count, (axis + 1) * count)
            equal_weights = np.ones((count, 2))
            free_columns = _stack_axes(columns[:, :N_FREE], equal_weights)[rows_of_axis]
            shrunken_columns = _stack_axes(columns[:, N_FREE:], equal_weights)[rows_of_axis]
            # What free coefficients take of a place's columns, and what remains of the others.
            q = np.linalg.solve(equations.lead.T, free_columns.T).T
            remaining = shrunken_columns - q @ equations.free_projections              # (m, c)
            by_views = remaining @ priors.covariances                                # (v, m, c)
            for prior, share in enumerate(self.share):
                covariances = (priors.width[prior] ** 2 * by_views[priors.view[prior]]
                               + priors.size[prior] ** 2 * priors.departure**2 * remaining)
                along = covariances @ equations.shrunken.T @ self._u[prior]            # (m, r)
                precision = self._precision[prior].T                                   # (r, a)
                means = along @ (precision * self._along[prior, :, None])              # (m, a)
                # The prior variance less what the points explain of it, under each noise.
                variances = ((covariances * remaining).sum(axis=1, keepdims=True)
                             - along**2 @ precision)
                mean = means @ share
                variance[prior, :, axis] = (q**2).sum(axis=1) * noise[prior] + (
                    variances + (means - mean[:, None]) ** 2) @ share
        return variance, noise


def log_marginal_likelihood(posterior: Posterior, of_heights: FloatArray | None, height: float,
                            pixel: float) -> float:
    """Return the logarithm of the marginal likelihood of a regularised polynomial.

    It is on the scale of `CameraSolutions.log_evidence`. `of_heights` (2,) are the coefficients of
    Z in line and in sample, None if heights are not known; `height` is a scaled height of 1 as a
    distance on the ground, in scaled units of the image; `pixel` is a pixel in these units.
    """
    half = posterior.freedom / 2
    sizes = np.exp(log_prior_of_sizes())
    size_sum = sizes[PRIOR_SIZES > 0.0].sum() ** 2 + sizes[0] ** 2
    # The prior of scales and sizes, which the posterior has without its sum.
    log = posterior.cells.log_evidence - np.log(len(posterior.scales) * size_sum)
    # The integral over the noise, with the density 1 / sigma: Gamma(nu/2) / 2 pi^(nu/2).
    log = log + lgamma(half) - np.log(2.0) - half * np.log(np.pi)
    # What the affine terms determine: the determinant of the free columns is that of the triangle.
    log = log - sum(np.log(np.abs(np.diag(design.free_triangle))).sum()
                    for design in posterior.designs)
    mean_square = float(posterior.cells.share @ (posterior.square / posterior.freedom))
    log_noise = 0.5 * np.log(mean_square) - np.log(pixel)
    log += _log_normal_density(log_noise - np.log(NOISE_MEDIAN), NOISE_LOG_DEVIATION)
    if of_heights is not None:
        # A height has the effect of views from the air or space: PARALLAX of it, at most.
        log += sum(_log_normal_density(coefficient, PARALLAX * height)
                   for coefficient in of_heights)
    return float(log)


def _log_normal_density(value: float, deviation: float) -> float:
    """Return the logarithm of a normal density."""
    return float(-0.5 * (value / deviation) ** 2 - np.log(deviation * np.sqrt(2 * np.pi)))


def _stack_axes(columns: FloatArray, weights: FloatArray) -> FloatArray:
    """Return rows (2 n, 2 k) of line, then of sample, from columns (n, k) that both have.

    The rows of each axis have columns of their own, and are multiplied by its weights, (n, 2).
    """
    (n, k) = columns.shape
    rows = np.zeros((2 * len(columns), 2 * columns.shape[1]))
    # A block of each axis on the diagonal.
    rows[:n, :k] = columns * weights[:, :1]
    rows[n:, k:] = columns * weights[:, 1:]
    return rows
