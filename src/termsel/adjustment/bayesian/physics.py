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
    seen_by_frames,
    seen_by_radars,
    seen_by_scanners,
)
from termsel.adjustment.bayesian.posterior import SIZES, Posterior, believed_sizes, shares
from termsel.data.features import FloatArray
from termsel.data.fit_data import PARALLAX
from termsel.data.monomials import Exponents, monomials

Views: TypeAlias = Callable[[FloatArray, float, float], tuple[FloatArray, ...]]

Kind: TypeAlias = tuple[str, Views, float]
"""A kind of cameras, what they see (see `termsel.adjustment.bayesian.cameras`), and how likely each
of these views is beforehand, next to an image of which nothing is known."""

SCANNERS: Kind = ("a line scanner in orbit", seen_by_scanners, 1.0)

RADARS: tuple[Kind, ...] = tuple(
    ("a radar in orbit", partial(seen_by_radars, right=right), 0.125) for right in (True, False))
FRAMES: Kind = ("a frame camera", lambda places, azimuth, _: seen_by_frames(places, azimuth), 0.5)

WIDTHS = np.array([0.3, 1.0, 3.0, 10.0])
"""By what the deviations of the cameras from their mean are multiplied."""

NOISES = np.geomspace(0.15, 15.0, 14)
"""Standard deviations of a measurement [px]."""

NOISE, SPREAD = 1.0, 1.4
"""Median of the noise beforehand [px], and the standard deviation of its logarithm: from 0.25 px of
targets to 4 px of crossings in a coarse image, four times in five."""

FREE = 3
"""Columns of an axis that are free: 1, X and Y."""

AZIMUTHS = 0.5
"""Steps in which cameras turn [degrees], much less than what is unknown of it."""

PLACES, BOX = 60, 1.2
"""Places at which cameras look, in a box so much wider than that of the points."""

DEPARTURES = (0.01, 0.3, 1.0, 3.0)
"""Standard deviations of what no camera explains of a quadratic coefficient [px]: attitude that
changes in another way, or the interior of the camera. They are as likely."""

FALL, RELIEF = 0.1, 0.03
"""The same of cubic coefficients by quadratic ones, and of each power of Z."""


@dataclass(frozen=True, eq=False)
class Prior:
    """A normal prior of the coefficients that are not free, those of line before those of sample.
    """

    mean: FloatArray  # (c,)
    root: FloatArray  # (c, c): times its transpose it is the covariance
    share: float  # how likely it is beforehand
    kind: str


def of_cameras(kinds: Sequence[Kind], places: FloatArray, scaled: FloatArray,
               exponents: Exponents, latitude: float, slopes: FloatArray,
               pixel: float) -> list[Prior]:
    """Return priors by cameras that see places (m, 3) [m], which are scaled (m, 3), too.

    None of them if hardly any camera sees these. The slopes are those of line and of sample by
    metres to the east and to the north, (2, 2), in scaled units; `pixel` is that of a pixel.
    """
    azimuth = AZIMUTHS * round(np.degrees(float(np.arctan2(*slopes[0]))) / AZIMUTHS)
    return [prior for kind, views, share in kinds
            for seen in _seen(views, places.tobytes(), azimuth, latitude)
            for prior in _of_views(kind, seen, share, places, scaled, exponents, slopes, pixel)]


@lru_cache(maxsize=16)  # points held out hardly turn an image, and most do not narrow its extent
def _seen(views: Views, places: bytes, azimuth: float,
          latitude: float) -> tuple[FloatArray, ...]:
    return views(np.frombuffer(places).reshape(-1, 3), np.radians(azimuth), latitude)


def _of_views(kind: str, seen: FloatArray, share: float, places: FloatArray, scaled: FloatArray,
              exponents: Exponents, slopes: FloatArray, pixel: float) -> list[Prior]:
    """Return the priors by what one kind of cameras sees, (c, m, 2) (see `of_cameras`)."""
    if len(seen) < 2 * len(exponents):
        return []
    plane = np.column_stack([np.ones(len(places)), places[:, :2]])
    own = np.linalg.pinv(plane)[1:] @ seen                                           # (c, 2, 2)
    # Each camera has the pixels of the image, and counts samples in its direction.
    factor = np.linalg.norm(slopes, axis=1) / np.linalg.norm(own, axis=1)
    factor *= np.sign(np.einsum("cxa,ax->ca", own, slopes))
    found = np.linalg.pinv(monomials(scaled, exponents)) @ (seen * factor[:, None])  # (c, k, 2)
    rest = found[:, FREE:].swapaxes(1, 2).reshape(len(found), -1)
    mean = rest.mean(axis=0)
    powers = np.array(exponents[FREE:])
    # Roots by QR: a covariance of cameras that hardly differ has none by Cholesky.
    spread = np.linalg.qr((rest - mean) / np.sqrt(len(rest) - 1.0), mode="r")
    departure = np.tile(pixel * FALL ** np.maximum(powers.sum(axis=1) - 2.0, 0.0)
                        * RELIEF ** powers[:, 2], 2)
    believed = 1.0 / np.hypot(1.0, WIDTHS)
    believed *= share / (believed.sum() * len(DEPARTURES))
    return [Prior(mean, np.transpose(np.linalg.qr(np.vstack([
                width * spread, np.diag(size * departure)]), mode="r")), float(one), kind)
            for width, one in zip(WIDTHS, believed, strict=True) for size in DEPARTURES]


class Equations:
    """Weighted equations of a polynomial, without what free coefficients take.

    The columns (n, k) are monomials, free ones first, of which the image is (n, 2), and the weights
    are (n, 2). All is scaled.
    """

    def __init__(self, columns: FloatArray, image: FloatArray, weights: FloatArray) -> None:
        self.columns = columns
        self.image = image
        self.weights = weights
        lead = _stacked(columns[:, :FREE], weights)
        rest = _stacked(columns[:, FREE:], weights)
        q, r = np.linalg.qr(lead, mode="complete")
        self.lead = r[:2 * FREE]
        self.basis = q[:, 2 * FREE:]
        self.cross, self.rest = q[:, :2 * FREE].T @ rest, self.basis.T @ rest
        self.target = self.basis.T @ (image * weights).T.ravel()


class Solutions:
    """All solutions of equations with a prior, for all noises; `pixel` is a pixel, scaled."""

    def __init__(self, equations: Equations, prior: Prior, pixel: float) -> None:
        self._equations = equations
        self._prior = prior
        self.kind = prior.kind
        # Along U, what the prior lets vary has the variance S^2, to which comes that of the noise.
        varying = equations.rest @ prior.root
        u, values, self._vt = np.linalg.svd(varying,
                                            full_matrices=varying.shape[0] > varying.shape[1])
        self._strength = np.zeros(len(u))
        self._strength[:len(values)] = values
        self.noise = NOISES * pixel
        self._variance = self._strength**2 + self.noise[:, None] ** 2                   # (c, v)
        self._along = u.T @ (equations.target - equations.rest @ prior.mean)
        self._rows = equations.basis @ u
        self._logs = np.log(shares(-0.5 * (np.log(NOISES / NOISE) / SPREAD) ** 2)[0]) - 0.5 * (
            np.log(2 * np.pi * self._variance).sum(axis=1)
            + (self._along**2 / self._variance).sum(axis=1)) \
            - np.log(np.abs(np.diag(equations.lead))).sum() + np.log(prior.share)
        self.log = float(np.logaddexp.reduce(self._logs))
        self.share = np.exp(self._logs - self.log)

    @property
    def log_each(self) -> FloatArray:
        """The logarithm of the marginal likelihood without each point, shape (n,)."""
        return self._left_out[0]

    @property
    def errors(self) -> FloatArray:
        """Errors of each point left out, shape (n, 2)."""
        return self._left_out[1]

    @cached_property
    def _left_out(self) -> tuple[FloatArray, FloatArray]:
        # The errors of a point by all others: P^-1 P y of its two rows, P the inverse covariance.
        line, sample = np.split(self._rows, 2)
        each = 1.0 / self._variance
        inverse = np.stack([[each @ (a * b).T for b in (line, sample)] for a in (line, sample)])
        inverse = inverse.transpose(2, 3, 0, 1)                                       # (c, n, 2, 2)
        right = np.stack([(each * self._along) @ one.T for one in (line, sample)], axis=2)
        errors = np.linalg.solve(inverse, right[..., None])[..., 0]
        logs = self._logs[:, None] + 0.5 * (errors * right).sum(axis=2) + np.log(2 * np.pi) \
            - 0.5 * np.log(np.linalg.det(inverse))
        log_each = np.logaddexp.reduce(logs, axis=0)
        return log_each, np.einsum("cn,cna->na", np.exp(logs - log_each), errors) \
            / self._equations.weights

    @cached_property
    def coefficients(self) -> FloatArray:
        """The averaged coefficients, shape (k, 2)."""
        known = self.share @ (self._strength / self._variance * self._along)
        rank = min(len(known), len(self._vt))
        rest = self._prior.mean + self._prior.root @ (self._vt[:rank].T @ known[:rank])
        rest = rest.reshape(2, -1).T
        columns = self._equations.columns
        image = self._equations.image
        found = np.empty((columns.shape[1], 2))
        found[FREE:] = rest
        lead = columns[:, :FREE]
        for axis, w in enumerate(self._equations.weights.T):
            left = image[:, axis] - columns[:, FREE:] @ rest[:, axis]
            found[:FREE, axis] = np.linalg.lstsq(lead * w[:, None], left * w)[0]
        return found

    @property
    def effective(self) -> float:
        """Effective parameters of line and sample together."""
        return 2 * FREE + float(self.share @ (
            1.0 - self.noise[:, None] ** 2 / self._variance).sum(axis=1))

    def spread(self, columns: FloatArray) -> tuple[FloatArray, float]:
        """Return the variance of what is predicted at places (m, k), shape (m, 2), and the noise's.
        """
        variance = np.empty((len(columns), 2))
        noise = float(self.share @ self.noise**2)
        rank = min(len(self._strength), len(self._vt))
        for axis in (0, 1):
            lead, rest = (_stacked(part, np.ones((len(columns), 2)))[
                axis * len(columns):(axis + 1) * len(columns)]
                for part in (columns[:, :FREE], columns[:, FREE:]))
            q = np.linalg.solve(self._equations.lead.T, lead.T).T
            free = (rest - q @ self._equations.cross) @ self._prior.root
            along = (free @ self._vt.T)[:, :rank]
            gain = (self._strength / self._variance)[:, :rank]
            means = along @ (gain * self._along[:rank]).T                            # (m, c)
            own = (free**2).sum(axis=1, keepdims=True) \
                - along**2 @ (self._strength[:rank] * gain).T
            middle = means @ self.share
            variance[:, axis] = (q**2).sum(axis=1) * noise + (
                own + (means - middle[:, None]) ** 2) @ self.share
        return variance, noise


def marginal(found: Posterior, coefficients: FloatArray, variables: int, height: float,
             pixel: float) -> float:
    """Return the logarithm of the marginal likelihood of regularised polynomials.

    On the scale of `Solutions.log`. The coefficients (k, 2) are their average; `height` is what a
    scaled height of 1 moves on the ground, in scaled units of the image.
    """
    half = found.freedom / 2
    sizes = np.exp(believed_sizes())
    some = sizes[SIZES > 0.0].sum() ** 2 + sizes[0] ** 2
    # The integral over the noise of its density 1 / sigma; what the affine terms determine.
    log = found.cells.log - np.log(len(found.scales) * some) + lgamma(half) - np.log(2.0) \
        - half * np.log(np.pi) - sum(np.log(np.abs(np.diag(design.lead))).sum()
                                     for design in found.designs)
    noise = 0.5 * np.log(float(found.cells.share @ (found.square / found.freedom))) - np.log(pixel)
    log += _density(noise - np.log(NOISE), SPREAD)
    if variables == 3:
        log += sum(_density(one, PARALLAX * height) for one in coefficients[3])
    return float(log)


def _density(value: float, deviation: float) -> float:
    """Return the logarithm of a normal density."""
    return float(-0.5 * (value / deviation) ** 2 - np.log(deviation * np.sqrt(2 * np.pi)))


def _stacked(columns: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the rows of line, then those of sample, each with columns of its own."""
    (n, k) = columns.shape
    rows = np.zeros((2 * len(columns), 2 * columns.shape[1]))
    rows[:n, :k] = columns * weights[:, :1]
    rows[n:, k:] = columns * weights[:, 1:]
    return rows
