"""A pinhole camera as a candidate, where few points support an oblique view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel.adjustment.solve import Adjustment
from termsel.data.features import BoolArray, FeatureSet, FloatArray, Points
from termsel.data.fit_data import is_off_plane
from termsel.data.monomials import monomials
from termsel.data.scaling import Scaling
from termsel.data.view import CLEARER, CentralView, view_of
from termsel.fitting.fit import Estimator, Fit, HeldOut, Undetermined
from termsel.fitting.pinhole import PINHOLE_MIN_POINTS, Pinhole, pinhole_near, pinhole_of
from termsel.fitting.uncertainty import Spread
from termsel.models.base import SensorModel
from termsel.models.projective import Projective

PINHOLE_MAX_POINTS = 20
"""Points up to which a camera is tried: a DLT of more tells as much, and takes up more of a lens.
"""

OBLIQUE_DEPTH = 0.8
"""Distance of the nearest point by that of the middle, along the view, below which a view is
oblique: points of a photo from above are at about the same distance."""

BENT_DEVIATION = 0.01
"""Standard deviation of what affine polynomials leave, by the half extent of the image, below which
few points show no oblique view."""

EXACT_AFFINE_POINTS = 4
"""Points that an affine polynomial with heights fits exactly."""

PINHOLE_MIN_DLT_POINTS = 8
"""Points below which a view is not told by a DLT, which leaves them hardly an equation."""


@dataclass(frozen=True)
class PinholeCamera(Estimator):
    """The camera of 7 unknowns that points support, written as the projection it is."""

    name = "pinhole"

    def fit(self, model: SensorModel, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit a projection (see `Estimator.fit`) with all its terms."""
        assert isinstance(model, Projective)
        in_use = control.take(used)
        return self._written(pinhole_of(scaling.features(in_use), scaling), model, control,
                             scaling, used)

    def refit(self, fitted: Fit, control: FeatureSet) -> Fit:
        """Return the camera of other control points that is next to that of a fit."""
        assert isinstance(fitted.model, Projective)
        camera = pinhole_near(_camera_of(fitted), fitted.scaling.features(control), fitted.scaling)
        return self._written(camera, fitted.model, control, fitted.scaling,
                             np.ones(len(control), dtype=bool))

    def _written(self, camera: Pinhole | None, model: Projective, control: FeatureSet,
                 scaling: Scaling, used: BoolArray) -> Fit:
        """Return the fit that a camera is of the points in use."""
        if camera is None:
            raise Undetermined("no camera in front of all control points was found",
                               hint="Choose another model, such as dlt or projective.")
        coefficients = _coefficients(camera, model)
        count = round(camera.effective)
        in_use = control.take(used)
        equations = 2 * len(in_use)
        sigma0 = camera.sigma if equations > count else np.nan
        unknown = np.full(len(coefficients), np.nan)
        return Fit(model, scaling, control, np.ones(len(coefficients), dtype=bool), used,
                   Adjustment(coefficients, unknown, count, equations, count, np.nan, sigma0),
                   self, camera.effective,
                   HeldOut.of(camera.errors * scaling.image_scale, in_use))

    def spread(self, fitted: Fit, ground: FloatArray) -> Spread:
        """Return the mean square errors of a fit at scaled places (see `Estimator.spread`)."""
        assert isinstance(fitted.model, Projective)
        camera = _camera_of(fitted)
        factors = camera.factors(_with_heights(camera, fitted.model, ground))
        return Spread((factors**2).sum(axis=2), np.full(2, camera.sigma**2), factors)

    def view(self, features: FeatureSet, scaling: Scaling) -> CentralView | None:
        """Return the camera as the view of scaled features."""
        camera = pinhole_of(features, scaling)
        return super().view(features, scaling) if camera is None else camera.view


def may_be_oblique(features: FeatureSet) -> bool:
    """Return whether scaled points may be of an oblique view, as quickly as it can be said."""
    points = features.points
    if len(features.lines) or not PINHOLE_MIN_POINTS <= len(points) <= PINHOLE_MAX_POINTS:
        return False
    if len(points) >= PINHOLE_MIN_DLT_POINTS:
        view = view_of(points)
        return view is not None and view.depth < OBLIQUE_DEPTH
    return _affine_deviation(points, heights=False) > BENT_DEVIATION


def call_for_camera(features: FeatureSet, scaling: Scaling) -> bool:
    """Return whether scaled points support an oblique view by a camera without distortion."""
    if not may_be_oblique(features):
        return False
    if len(features.points) == EXACT_AFFINE_POINTS and not is_off_plane(features.points):
        return False  # a projective transformation sees four points of a plane as they are
    camera = pinhole_of(features, scaling)
    if camera is None or not 0.0 < camera.view.depth < OBLIQUE_DEPTH:
        return False
    # Affine polynomials with heights fit four points exactly.
    deviation = _affine_deviation(features.points,
                                  heights=len(features.points) > EXACT_AFFINE_POINTS)
    return camera.sigma < CLEARER * deviation


def _affine_deviation(points: Points, *, heights: bool) -> float:
    """Return the standard deviation of what an affine polynomial leaves of scaled points."""
    ground = points.ground[:, :3 if heights else 2]
    columns = np.column_stack([np.ones(len(points)), ground])
    coefficients, _, rank, _ = np.linalg.lstsq(columns, points.image)
    freedom = points.image.size - 2 * int(rank)
    residuals = points.image - columns @ coefficients
    return float(np.sqrt((residuals**2).sum() / freedom)) if freedom > 0 else 0.0


def _camera_of(fitted: Fit) -> Pinhole:
    """Return the camera that a fit was made of."""
    camera = pinhole_of(fitted.scaling.features(fitted.control.take(fitted.used)), fitted.scaling)
    assert camera is not None
    return camera


def _coefficients(camera: Pinhole, model: Projective) -> FloatArray:
    """Return the coefficients of a projection that sees as a camera does, (k,).

    Of a plane model the height is that of the plane through the points: Z = z0 + a X + b Y.
    """
    matrix = camera.matrix
    if not model.uses_height:
        plane = np.concatenate([np.eye(3), _plane(camera)[None]])
        matrix = matrix @ plane
    # The denominator is in units of its value in the middle of the points' box.
    scaled = matrix / matrix[2, 0]
    if not matrix[2, 0] > 0.0:
        raise Undetermined("the middle of the points lies behind the camera",
                           hint="Choose another model, such as shrunken-cubic.")
    return np.concatenate([scaled[0], scaled[1], scaled[2, 1:]])


def _plane(camera: Pinhole) -> FloatArray:
    """Return the plane through the control: its scaled height by 1, X and Y, (3,)."""
    ground = camera.view.ground
    return np.asarray(np.linalg.lstsq(monomials(ground, ((0, 0, 0), (1, 0, 0), (0, 1, 0))),
                                      ground[:, 2])[0])


def _with_heights(camera: Pinhole, model: Projective, ground: FloatArray) -> FloatArray:
    """Return scaled places with the heights that a projection gives them, (m, 3)."""
    if model.uses_height:
        return ground
    plane = np.column_stack([np.ones(len(ground)), ground[:, :2]])
    return np.column_stack([ground[:, :2], plane @ _plane(camera)])
