"""Models whose terms have priors of their own, such as a scanner in orbit or a photo."""

from __future__ import annotations

import re
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc

from termsel import FeatureSet, Points, SensorModel, TermselError, get
from termsel.toolkit import make_scaling
from termsel_block.geometry.cameras import Camera, Fixed
from termsel_block.geometry.frame import BoolArray, FloatArray, Frame

MIN_CONTROL_POINTS = 3
"""Control points from which such a model begins."""

MAX_MISFIT_SHARE = 0.01
"""Error over the extent of an image from which on a model is not that of its points, and ties are
no measurements."""

MODELS = ("An image without an RPC takes auto, or a model whose terms have priors, such as "
          "scanner, frame or panoramic of termsel-cameras.")

_TERM_STEP = 1e-4
"""Change of a term, in its standard deviations, by which places are differentiated."""

_CORRECTIONS = 2
"""Corrections of a step, which is bent."""

_STEP_WEIGHT = 0.01
"""Weight of the step as it was, in terms, next to what is seen [px2]."""

_FREE_SIGMA = 10.0
"""Standard deviation of a term without a prior: half images, of a place in the image."""

_MEASURED_SHARE = 0.1
"""Share of a prior's variance that measurements take, from which on they show of the term."""

_MIN_NAMED_SIGMAS = 3.0
"""Standard deviations beyond which a term is named."""


@dataclass(frozen=True)
class Contradiction:
    """How little the terms of a model are what is known of them.

    Parameters
    ----------
    chance : float
        Probability of terms so far from what is known, if that is true.
    severity : float
        Sum of squares over their number.
    terms : tuple of str
        The farthest.
    """

    chance: float
    severity: float
    terms: tuple[str, ...]


class PhysicalCamera(Camera):
    """A camera by the equations of a model with priors, linearised at each step.

    Parameters are the model's terms in the standard deviations of their priors, which stay what the
    model says: the heaviest is taken for a standard deviation of 1, as terms of termsel-cameras
    have. None of them is dropped.

    Parameters
    ----------
    model : SensorModel
    control : FeatureSet
        Points with known places, by which it begins.
    frame : Frame

    Raises
    ------
    TermselError
        If the terms of the model have no priors, or no camera sees the points.

    Attributes
    ----------
    start : ndarray, shape (p,)
        Parameters by the points with known places.
    scale : ndarray, shape (p,)
        Standard deviation of each term, its unit as a parameter.
    """

    def __init__(self, model: SensorModel, control: FeatureSet, frame: Frame) -> None:
        self.scaling = make_scaling(control)
        self.frame = frame
        self.model = model.prepared(self.scaling, control.crs)
        scaled = self.scaling.features(control)
        terms = self.model.start(scaled)
        linearised = None if terms is None else self.model.linearised(scaled, terms)
        inverse_sigma = None if linearised is None else linearised.prior
        if terms is None or inverse_sigma is None or not np.any(inverse_sigma):
            raise TermselError(f"the terms of the model {self.model.name!r} have no priors, which "
                               "few points need", hint=MODELS)
        self.has_prior = inverse_sigma > 0
        # The smallest standard deviation is taken for 1.
        relative = inverse_sigma.max() / np.maximum(inverse_sigma, 1e-300)
        self.scale = np.where(self.has_prior, relative, _FREE_SIGMA)
        self.start = terms / self.scale
        self.groups = (self.model.name,) * len(terms)
        self.prior_sigma = (1.0,) * len(terms)
        self.min_sigma = (1e-4,) * len(terms)
        self.permanent = frozenset({self.model.name})
        self.fixed_variance = self.permanent
        self.stated_terms = {f"{self.model.name} {term}": k
                             for k, term in enumerate(self.model.terms) if self.has_prior[k]}
        self.sigma_factors = np.ones(len(terms))
        local = frame.local(control.points.ground)
        low = local.min(axis=0)
        high = local.max(axis=0)
        self._area = (low + high) / 2, np.maximum((high - low)[:2] / 2, 1.0)

    def with_parameters(self, keep: BoolArray) -> PhysicalCamera:
        """Return the camera: none of its terms is dropped."""
        return self

    def project(self, parameters: FloatArray, local: FloatArray, fixed: Fixed = None) -> FloatArray:
        """Return line and sample (n, 2) [px] of positions (n, 3) by the model's equations."""
        return np.asarray(self._project_with_terms((parameters * self.scale)[None], local)[0])

    def jacobian(self, parameters: FloatArray, local: FloatArray, fixed: Fixed = None,
                 ) -> FloatArray:
        """Return the derivatives (n, 2, p) of line and sample by the parameters."""
        return self._jacobian_and_image(parameters, local)[0]

    def _jacobian_and_image(self, parameters: FloatArray,
                            local: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the derivatives of line and sample by the parameters, and line and sample.

        They have the shapes (n, 2, p) and (n, 2) [px]; all come from one call of the model.
        """
        # Central differences of all terms; the last set of terms is the parameters themselves.
        terms = parameters * self.scale
        steps = _TERM_STEP * np.diag(self.scale)
        images = self._project_with_terms(
            np.concatenate([terms + steps, terms - steps, terms[None]]), local)
        p = len(terms)
        slopes = np.moveaxis(images[:p] - images[p:-1], 0, -1) / (2 * _TERM_STEP)
        return np.asarray(slopes), np.asarray(images[-1])

    def parameters_after_step(self, parameters: FloatArray, step: FloatArray, aim: FloatArray,
                              local: FloatArray) -> FloatArray:
        """Return parameters (p,) near those after a step, whose images are nearly at the aim.

        See `Camera.parameters_after_step`. Without positions it is the step alone.
        """
        # Altitude, pixel and period together hardly change the image, so that a step along them is
        # long, and to second order leaves its aim. Without correction only short steps would help.
        stepped = super().parameters_after_step(parameters, step, aim, local)
        corrected = stepped
        for _ in range(_CORRECTIONS if len(local) else 0):
            slopes, image = self._jacobian_and_image(corrected, local)
            rows = slopes.reshape(-1, corrected.size)
            residuals = (aim - image).ravel()
            # (J^T J + w I) d = J^T r + w (stepped - corrected): least squares of the residuals,
            # which keeps what they do not show near the step.
            right = rows.T @ residuals + _STEP_WEIGHT * (stepped - corrected)
            corrected = np.asarray(corrected + np.linalg.solve(
                rows.T @ rows + _STEP_WEIGHT * np.eye(corrected.size), right))
        return corrected

    def with_priors(self, factors: Mapping[str, float], parameters: FloatArray,
                    ) -> tuple[PhysicalCamera, FloatArray]:
        """Return the camera with other standard deviations, and its parameters (p,) in these units.

        Parameters
        ----------
        factors : mapping
            Standard deviation of each stated term, divided by that of the model.
        parameters : ndarray, shape (p,)
            Parameters in the units of this camera.
        """
        other_camera = copy(self)
        other_camera.sigma_factors = np.ones(parameters.size)
        for name, index in self.stated_terms.items():
            other_camera.sigma_factors[index] = factors[name]
        # The terms do not change, so that a larger unit makes smaller parameters.
        ratio = other_camera.sigma_factors / self.sigma_factors
        other_camera.scale = self.scale * ratio
        other_camera.start = self.start / ratio
        return other_camera, np.asarray(parameters / ratio)

    def area(self) -> tuple[FloatArray, FloatArray]:
        """Return the middle (3,) and half widths (2,) [m] of the ground of the points at the start.
        """
        return self._area

    def contradicted(self, parameters: FloatArray, covariance: FloatArray) -> Contradiction:
        """Return how much parameters contradict the model's priors.

        Parameters
        ----------
        parameters : ndarray, shape (p,)
            Posterior means in units of the prior standard deviations.
        covariance : ndarray, shape (p, p)
            Covariance of their posterior.

        Returns
        -------
        Contradiction
            The probability of so large a sum of squares, its mean, and the terms that are farthest
            from their priors, in words.

        Notes
        -----
        If the priors are true, a posterior mean has the variance of the prior less that of the
        posterior. Directions in which measurements show nothing are left out.
        """
        with_prior = np.flatnonzero(self.has_prior)
        mean = parameters[with_prior]
        # The covariance of a posterior mean by true priors is I - C.
        values, vectors = np.linalg.eigh(
            np.eye(len(with_prior)) - covariance[np.ix_(with_prior, with_prior)])
        is_measured = values > _MEASURED_SHARE
        # m' (I - C)^+ m is chi-squared, with as many degrees of freedom as measured directions.
        square = float(((vectors[:, is_measured].T @ mean) ** 2 / values[is_measured]).sum())
        freedom = max(int(is_measured.sum()), 1)
        names = np.array(self.model.terms)[with_prior]
        farthest = np.argsort(-np.abs(mean))[:3]
        named = [f"{names[k]} by {abs(mean[k]):.1f}" for k in farthest
                 if abs(mean[k]) > _MIN_NAMED_SIGMAS]
        return Contradiction(float(chdtrc(freedom, square)), square / freedom, tuple(named))

    def _project_with_terms(self, terms: FloatArray, local: FloatArray) -> FloatArray:
        """Return line and sample (q, n, 2) [px] of positions (n, 3) by each of q sets of terms.

        They are NaN for terms (q, p) by which the positions are not seen.
        """
        # A step too far leads there, which the cost shows.
        with np.errstate(all="ignore"):
            scaled = self.model.project(terms, self.scaling.ground(self.frame.ground(local)))
        return np.asarray(self.scaling.pixels(scaled))


def hint_for_block(hint: str | None) -> str:
    """Return a hint for the commands of one image in the words of the file of a block; "" of None.
    """
    hint = hint or ""
    if "--rpc" in hint:
        return ("Name the RPC as rpc of the image, control as points, and a correction as model, "
                "such as affine.")
    hint = hint.replace("Leave --crs out, or correct the file", "Correct one of them")
    # The unit of heights is the block's, options of a model are the image's.
    hint = re.sub(r"--set z_unit=([\w-]+)", r'z_unit = "\1"', hint)
    return re.sub(r"--set (\w+)=(\w+)", r'options = { \1 = "\2" }', hint)


@dataclass(frozen=True)
class PhysicalModel:
    """The name of a model and its options."""

    name: str
    options: Mapping[str, Any]

    def fitted(self, frame: Frame, local: FloatArray, image: FloatArray, of: str) -> PhysicalCamera:
        """Return the camera fitted to points of an image called `of`.

        `local` (n, 3) are their positions in the frame [m], `image` (n, 2) their lines and samples.
        Raises TermselError if it cannot be fitted, or if the median of its residuals is beyond
        `MAX_MISFIT_SHARE` of the extent of the points.
        """
        points = Points(tuple(map(str, range(len(local)))), image, frame.ground(local))
        try:
            camera = PhysicalCamera(get("models", self.name)(**self.options),
                                    FeatureSet(points, crs=frame.crs), frame)
        except TermselError as error:
            raise TermselError(f"image {of!r}: {error.what}",
                               hint=hint_for_block(error.hint)) from error
        # Up to half of the points may be blunders. The median is NaN if so many are not seen.
        median = float(np.median(np.hypot(*(image - camera.project(camera.start, local)).T)))
        fits = median <= MAX_MISFIT_SHARE * float(np.ptp(image, axis=0).max())
        if not fits:
            raise TermselError(f"image {of!r}: model {self.name!r} misses half of its points by "
                               f"{median:,.0f} px or more",
                               hint="Check the options of the model, above all the sensor, and "
                                    "the points.")
        return camera
