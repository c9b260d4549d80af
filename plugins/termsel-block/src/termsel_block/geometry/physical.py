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
from termsel.toolkit import scaling_of
from termsel_block.geometry.cameras import Camera
from termsel_block.geometry.frame import BoolArray, FloatArray, Frame

LEAST = 3
"""Control points from which such a model begins."""

ABSURD = 0.01
"""Error over the extent of an image from which on a model is not that of its points, and ties are
no measurements."""

MODELS = ("An image without an RPC takes auto, or a model whose terms have priors, such as "
          "scanner, frame or panoramic of termsel-scanner.")

_STEP = 1e-4
"""Change of a term, in its standard deviations, by which places are differentiated."""

_BENT = 2
"""Corrections of a step, which is bent."""

_LOOSE = 0.01
"""Weight of the step as it was, in terms, next to what is seen [px2]."""

_FREE = 10.0
"""Standard deviation of a term without a prior: half images, of a place in the image."""

_TOLD = 0.1
"""Share of a prior's variance that measurements take, from which on they tell of the term."""

_NAMED = 3.0
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

    Parameters are the model's terms in twos, as if one were of the line and one of the sample; all
    of them are of both. They are kept, and their priors stay what the model says: the heaviest is
    taken for a standard deviation of 1, as terms of termsel-scanner have.

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
    """

    def __init__(self, model: SensorModel, control: FeatureSet, frame: Frame) -> None:
        self.scaling = scaling_of(control)
        self.frame = frame
        self.model = model.prepared(self.scaling, control.crs)
        scaled = self.scaling.features(control)
        values = self.model.start(scaled)
        about = None if values is None else self.model.linearised(scaled, values)
        prior = None if about is None else about.prior
        if values is None or prior is None or not np.any(prior):
            raise TermselError(f"the terms of the model {self.model.name!r} have no priors, which "
                               "few points need", hint=MODELS)
        # Parameters are terms in their standard deviations.
        self.has_prior = prior > 0
        self.scale = np.where(self.has_prior, prior.max() / np.maximum(prior, 1e-300), _FREE)
        half = -(-len(prior) // 2)
        self.first = np.pad(values / self.scale, (0, 2 * half - len(prior))).reshape(half, 2)
        self.groups = (self.model.name,) * half
        self.spread = (1.0,) * half
        self.min_spread = (1e-4,) * half
        self.permanent = self.wide = frozenset({self.model.name})
        self.stated = {f"{self.model.name} {term}": k % 2 * half + k // 2
                       for k, term in enumerate(self.model.terms) if self.has_prior[k]}
        self.looser = np.ones(2 * half)
        local = frame.local(control.points.ground)
        low = local.min(axis=0)
        high = local.max(axis=0)
        self._area = (low + high) / 2, np.maximum((high - low)[:2] / 2, 1.0)

    def only(self, keep: BoolArray) -> PhysicalCamera:
        """Return the camera: none of its terms is dropped."""
        return self

    def first_order(self, local: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return zeros: nothing of it is linear."""
        return np.zeros((len(local), 2)), np.zeros((len(local), len(self.groups)))

    def perspective(self, parameters: FloatArray, local: FloatArray) -> FloatArray | float:
        """Return line and sample (n, 2) [px] of places with parameters (m, 2)."""
        values = self._terms(parameters)
        return np.asarray(self._seen(values[None], local)[0])

    def rows(self, parameters: FloatArray, local: FloatArray, columns: FloatArray) -> FloatArray:
        """Return the derivatives by all parameters (see `Camera.rows`)."""
        values = self._terms(parameters)
        steps = _STEP * np.diag(self.scale)
        both = self._seen(np.concatenate([values + steps, values - steps]), local)
        found = np.zeros((len(local), 2, parameters.size))
        k = len(values)
        found[:, :, :k] = np.moveaxis(both[:k] - both[k:], 0, -1) / (2 * _STEP)
        return found.reshape(len(local), 2, len(self.groups), 2).swapaxes(2, 3).reshape(found.shape)

    def followed(self, parameters: FloatArray, step: FloatArray, aim: FloatArray,
                 local: FloatArray) -> FloatArray:
        """Return parameters after a step (see `Camera.followed`).

        Altitude, pixel and period together hardly show. A step along them is bent back to where it
        has to be seen, else only small ones would make things better.
        """
        found = there = super().followed(parameters, step, aim, local)
        for _ in range(_BENT if len(local) else 0):
            image, columns = self.first_order(local)
            rows = self.rows(found, local, columns).reshape(-1, found.size)
            missed = (aim - image - self.perspective(found, local)).ravel()
            right = rows.T @ missed + _LOOSE * (there - found).T.ravel()
            back = np.linalg.solve(rows.T @ rows + _LOOSE * np.eye(found.size), right)
            found = np.asarray(found + back.reshape(2, -1).T)
        return found

    def loosened(self, of_terms: Mapping[str, float], parameters: FloatArray,
                 ) -> tuple[PhysicalCamera, FloatArray]:
        """Return the camera with other standard deviations, and its parameters (m, 2) by them.

        Parameters
        ----------
        of_terms : mapping
            What the standard deviation of each stated term is times that of the model.
        """
        other = copy(self)
        other.looser = np.ones(parameters.size)
        for name, at in self.stated.items():
            other.looser[at] = of_terms[name]
        ratio = (other.looser / self.looser).reshape(2, -1).T
        other.scale = self.scale * ratio.ravel()[:len(self.scale)]
        other.first = self.first / ratio
        return other, np.asarray(parameters / ratio)

    def area(self) -> tuple[FloatArray, FloatArray]:
        """Return middle and half widths of the ground that the start knows."""
        return self._area

    def contradicted(self, parameters: FloatArray, covariance: FloatArray) -> Contradiction:
        """Return how far parameters (m, 2) are from the model's priors.

        Parameters
        ----------
        covariance : ndarray, shape (2m, 2m)
            Of their posterior, by image axis, then column.

        Notes
        -----
        Where the priors are true, a posterior mean has the variance of the prior less that of the
        posterior. What measurements do not tell has neither, and is left out.
        """
        at = np.arange(parameters.size).reshape(2, -1).T.ravel()[:len(self.scale)][self.has_prior]
        mean = parameters.T.ravel()[at]
        values, vectors = np.linalg.eigh(np.eye(len(at)) - covariance[np.ix_(at, at)])
        told = values > _TOLD
        square = float(((vectors[:, told].T @ mean) ** 2 / values[told]).sum())
        names = np.array(self.model.terms)[self.has_prior]
        order = np.argsort(-np.abs(mean))[:3]
        named = [f"{names[k]} by {abs(mean[k]):.1f}" for k in order if abs(mean[k]) > _NAMED]
        return Contradiction(float(chdtrc(max(told.sum(), 1), square)),
                             square / max(int(told.sum()), 1), tuple(named))

    def _terms(self, parameters: FloatArray) -> FloatArray:
        """Return the model's terms (k,)."""
        return np.asarray(parameters.ravel()[:len(self.scale)] * self.scale)

    def _seen(self, values: FloatArray, local: FloatArray) -> FloatArray:
        """Return line and sample (p, n, 2) by values (p, k)."""
        # A step to no camera at all is made shorter.
        with np.errstate(all="ignore"):
            scaled = self.model.project(values, self.scaling.ground(self.frame.ground(local)))
        return np.asarray(self.scaling.pixels(scaled))


def in_a_block(hint: str | None) -> str:
    """Return a hint for the commands of one image as one for the file of a block."""
    hint = hint or ""
    if "--rpc" in hint:
        return ("Name the RPC as rpc of the image, control as points, and a correction as model, "
                "such as affine.")
    return re.sub(r"--set (\w+)=(\w+)", r'options = { \1 = "\2" }', hint)


@dataclass(frozen=True)
class PhysicalModel:
    """The name of a model and its options."""

    name: str
    options: Mapping[str, Any]

    def fitted(self, frame: Frame, local: FloatArray, image: FloatArray,
               of: str) -> PhysicalCamera:
        """Return the camera fitted to places (n, 3) that are seen at (n, 2) in an image."""
        points = Points(tuple(map(str, range(len(local)))), image, frame.ground(local))
        try:
            camera = PhysicalCamera(get("models", self.name)(**self.options),
                                    FeatureSet(points, crs=frame.crs), frame)
        except TermselError as error:
            raise TermselError(f"image {of!r}: {error.what}",
                               hint=in_a_block(error.hint)) from error
        missed = float(np.median(np.hypot(*(image - camera.project(camera.first, local)).T)))
        if not missed <= ABSURD * float(np.ptp(image, axis=0).max()):
            raise TermselError(f"image {of!r}: model {self.name!r} misses half of its points by "
                               f"{missed:.3g} px or more",
                               hint="Check the options of the model, above all the sensor, and "
                                    "the points.")
        return camera
