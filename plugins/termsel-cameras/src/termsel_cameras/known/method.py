"""A photo with a known camera as a candidate of auto."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from termsel import (
    Adjustment,
    Estimator,
    Experience,
    FeatureSet,
    Fit,
    FitData,
    HeldOut,
    Method,
    Scaling,
    SensorModel,
    Spread,
    Undetermined,
)
from termsel.toolkit import BoolArray
from termsel.toolkit.models import Pinhole, camera_next_to, camera_of
from termsel_cameras.known.interior import FIXED_SPREAD, Interior, interior_of
from termsel_cameras.known.lens import FloatArray
from termsel_cameras.known.model import TAILS, KnownFrame

MIN_POINTS = 3
"""Points that determine the place and the turn of a camera."""

MAX_SIGMA = 25.0
"""Standard deviation of a measurement [px] beyond which the points are not those of the camera, or
`MAX_SIGMA_SHARE` of their half extent, if that is more."""

MAX_SIGMA_SHARE = 0.05

CONTRADICTION = 4.0
"""Standard deviations by which a focal length of the points alone contradicts the stated one."""

FAR_FROM_POSITION = 3.0
"""Standard deviations in plan or height by which points contradict a position in EXIF. They are
large enough for that: positions by satellites are seldom off by more than 30 m."""

CLEARLY_BETTER = 2.0
"""How many times as large the median error in leave-one-out is with the stated focal length, if a
free one predicts clearly better. Both limits together refuse none of 100 real photos."""

MIN_POINTS_TO_CONTRADICT = 6
"""Points from which on they contradict a focal length: of fewer, one blunder looks like another."""

FREE_FOCAL_SPREAD = 0.7
"""Standard deviation of the logarithm of a focal length that the points alone show."""

VAGUE_FOCAL = 0.1
"""Relative standard deviation from which on points do not show whether a focal length is right."""

FREE_REACH = 0.01
"""Scale of the prior of the principal point of such a camera, by its focal length."""

_DERIVATIVE_STEP = 1e-4


@dataclass(frozen=True)
class ByKnownCamera(Estimator):
    """The camera of a known interior by points with heavy-tailed errors."""

    name = "known-camera"

    def fit(self, model: Any, control: FeatureSet, scaling: Scaling, terms: BoolArray,
            used: BoolArray) -> Fit:
        """Fit a camera (see `Estimator.fit`) with all its terms."""
        ready = model.prepared(scaling, control.crs)
        in_use = control.take(used)
        return self._fit_of_camera(ready, ready.camera(scaling.features(in_use), control.noise),
                                   control, scaling, used)

    def refit(self, fitted: Fit, control: FeatureSet) -> Fit:
        """Return a fit to other control, whose camera is looked for next to that of a fit.

        `control` is not scaled. Raises Undetermined if the search leads to no camera that has all
        points in front.
        """
        model = fitted.model
        assert isinstance(model, KnownFrame)
        measured = model.measured(fitted.scaling.features(control), control.noise)
        near = camera_next_to(measured, _camera_of(fitted).camera)
        if near is None:
            raise Undetermined("no camera next to the one that was found has all points in front",
                               hint="Check the added points.")
        return self._fit_of_camera(model, near, control, fitted.scaling,
                                   np.ones(len(control), dtype=bool))

    def _fit_of_camera(self, model: KnownFrame, camera: Pinhole, control: FeatureSet,
                       scaling: Scaling, used: BoolArray) -> Fit:
        """Return a camera as a fit to the features in use, with the held-out errors of these.

        `used` (n,) marks them in `control`, which is not scaled.
        """
        in_use = control.take(used)
        values = model.values_of(camera.camera)
        n_equations = 2 * len(in_use)
        # An adjustment counts terms in whole numbers; the fit's trace is the number itself, to
        # which terms with a prior add less than one each.
        n_terms = round(camera.effective)
        errors = _errors_of(model, camera, scaling.features(in_use).points.image)
        # Coefficients have no variances of their own: the spread of positions is that of the
        # cameras under the prior, see `spread`.
        adjustment = Adjustment(values, np.full(len(values), np.nan), n_terms=n_terms,
                                n_equations=n_equations, rank=n_terms, condition=np.nan,
                                sigma0=camera.sigma, converged=True)
        return Fit(model, scaling, control, terms=np.ones(len(values), dtype=bool), used=used,
                   adjustment=adjustment, estimator=self, trace=camera.effective,
                   stored_held_out=HeldOut.of(errors * scaling.image_scale, in_use))

    def spread(self, fitted: Fit, ground: FloatArray) -> Spread:
        """Return the mean square errors of image positions at scaled ground positions (m, 3).

        They are of Student's distribution; see `Estimator.spread`.
        """
        model = fitted.model
        assert isinstance(model, KnownFrame)
        camera = _camera_of(fitted)
        design, _ = camera.measured.system(
            camera.camera, np.ones((1, len(camera.measured.image))), camera.sigma)
        # With D = Q R the covariance of the unknowns is (R' R)^-1, so that positions, of which the
        # derivatives are J, have the factors J R^-1.
        _, r = np.linalg.qr(design[0])
        slopes = _derivatives_through_lens(model, camera, model.local(ground))
        factors = np.linalg.solve(r.T, slopes.reshape(-1, r.shape[1]).T).T.reshape(slopes.shape)
        # Errors of Student's distribution with t degrees of freedom: a measurement has
        # (t + 2) / (t + 4) of the information of a normal one of that scale, and t / (t - 2) of
        # its variance.
        factors = factors * np.sqrt((TAILS + 4.0) / (TAILS + 2.0))
        noise = camera.sigma**2 * TAILS / (TAILS - 2.0)
        return Spread((factors**2).sum(axis=2), np.full(2, noise), factors)

    def experience(self, fitted: Fit) -> Experience:
        """Return how well points of photos are usually measured, as a prior of their noise."""
        measured = _camera_of(fitted).measured
        return Experience(measured.experience, measured.unknowns, measured.tails)


def _errors_of(model: KnownFrame, camera: Pinhole, image: FloatArray) -> FloatArray:
    """Return measured positions `image` (n, 2) minus those that the other points predict, scaled.
    """
    # A camera's errors are those of an ideal lens.
    ideal = camera.measured.image
    return np.asarray(image - model.with_lens(ideal - camera.errors))


def _derivatives_through_lens(model: KnownFrame, camera: Pinhole, ground: FloatArray) -> FloatArray:
    """Return the derivatives of image positions by the nine unknowns of a camera, (m, 2, 9).

    `ground` (m, 3) are positions as `KnownFrame.local` gives them; image positions are scaled, and
    those that the lens distorts.
    """
    slopes: FloatArray = camera.camera.slopes(ground)[0]
    if model.lens.is_ideal:
        return slopes
    # The chain rule: derivatives of the lens, by central differences, times those of the camera.
    ideal = camera.camera.image(ground)[0]
    lens_slopes = np.empty((len(ideal), 2, 2))
    for axis in range(2):
        step = _DERIVATIVE_STEP * np.eye(2)[axis]
        lens_slopes[:, :, axis] = (
            (model.with_lens(ideal + step) - model.with_lens(ideal - step))
            / (2 * _DERIVATIVE_STEP))
    return np.asarray(lens_slopes @ slopes)


def _camera_of(fitted: Fit) -> Pinhole:
    """Return the camera of a fit, estimated again by the features in use."""
    model = fitted.model
    assert isinstance(model, KnownFrame)
    in_use = fitted.control.take(fitted.used)
    return model.camera(fitted.scaling.features(in_use), in_use.noise)


@dataclass(frozen=True, eq=False)
class KnownCamera(Method):
    """The camera that columns of the points, options of reading or the image's EXIF show."""

    def declines(self, control: FitData) -> str | None:
        """Return why the method cannot fit a camera to the control; None if it can.

        Raises TermselError if the camera is stated wrongly, since the user meant to state one.
        """
        features = control.features
        interior = interior_of(features)
        if interior is None:
            return "the focal length of a camera is not stated"
        if len(features.lines) or len(features.points) < MIN_POINTS:
            return f"it is for {MIN_POINTS} control points or more, without lines"
        if features.without_height():
            return "it needs heights, as by --dem FILE"
        return None

    def fit(self, control: FitData) -> Fit:
        """Return the camera fitted to all features, with the position in the EXIF if that agrees.

        Raises Undetermined if the camera is not stated, or if the points are plainly not its own.
        """
        interior = _interior_of_points(control)
        free_fit = self._fit_without_exif_position(control, interior)
        if free_fit is not None and _contradicts_position(free_fit, interior):
            return free_fit
        try:
            return self._fit_of_interior(control, interior)
        except Undetermined:
            # A position that the user did not state must not spoil what was measured.
            if free_fit is not None:
                return free_fit
            raise

    def _fit_without_exif_position(self, control: FitData, interior: Interior) -> Fit | None:
        """Return the fit without the position in the EXIF.

        None if the EXIF has none, or if the points do not determine the camera without it.
        """
        if not interior.has_exif_position:
            return None
        try:
            return self._fit_of_interior(control, interior.without_position())
        except Undetermined:
            return None

    def _fit_of_interior(self, control: FitData, interior: Interior) -> Fit:
        """Return the camera of an interior fitted to all features.

        Raises Undetermined if the points do not determine it, leave residuals beyond `MAX_SIGMA`,
        or show another focal length.
        """
        model = KnownFrame.of(interior, mirrored=is_mirrored(control))
        fitted = self.estimator.fit(model, control.features, control.scaling,
                                    np.ones(len(model.terms), dtype=bool),
                                    np.ones(len(control), dtype=bool))
        sigma = fitted.adjustment.sigma0 * control.scaling.image_scale
        largest_sigma = max(MAX_SIGMA, MAX_SIGMA_SHARE * control.scaling.image_scale)
        if sigma > largest_sigma:
            raise Undetermined(
                f"the points are not those of {interior.source}: they leave {sigma:.0f} px, and "
                f"the most is {largest_sigma:.0f} px",
                hint="Check the focal length, the points and heights.")
        _refuse_contradicted(fitted, interior)
        return fitted

    def refit(self, fitted: Fit, data: FitData) -> Fit:
        """Return the camera of more points that is next to that of a fit."""
        assert isinstance(self.estimator, ByKnownCamera)
        return self.estimator.refit(fitted, data.features)

    def model(self, heights: bool) -> SensorModel | None:
        """Return None: the model depends on the camera."""
        return None

    def size(self, heights: bool) -> float:
        """Return 0: what is known comes before what is fitted."""
        return 0.0

    def describe(self, fitted: Fit) -> str:
        """Return sentences on the camera of a fit: its source, tilt, height and focal length.

        They say how well the focal length is known, and whether a position in the EXIF took part.
        """
        model = fitted.model
        assert isinstance(model, KnownFrame)
        interior = _interior_of_points(FitData.of(fitted.control))
        camera = model.camera_of(fitted.adjustment.coefficients[None])
        # The angle between the view and the vertical: cos = -R33 of the rotation from ground to
        # camera.
        tilt = np.degrees(np.arccos(np.clip(-camera.rotation[0, 2, 2], -1.0, 1.0)))
        scaled = fitted.scaling.features(fitted.control.take(fitted.used))
        ground = model.local(scaled.points.ground)
        height = model.unit * (camera.position[0, 2] - ground[:, 2].mean())
        focal = camera.focal[0] * fitted.scaling.image_scale
        return (f"The camera is known by {interior.source}. It looked {tilt:.0f} deg off the "
                f"vertical from {height:,.0f} m above the points, with a focal length of "
                f"{focal:,.1f} px. "
                f"{_focal_in_words(interior)}{_focal_of_points(fitted)}"
                f"{_exif_position_in_words(fitted, interior)}")

    def doubt(self, fitted: Fit) -> str:
        """Return a sentence on a position in the EXIF that is not used; "" if there is none."""
        interior = _interior_of_points(FitData.of(fitted.control))
        if not _leaves_exif_position_out(fitted, interior):
            return ""
        offset, _ = _offset_of_position(fitted, interior)
        return (f"The position in the EXIF is not used: the points show the camera "
                f"{np.hypot(*offset[:2]):,.0f} m away from it in plan and "
                f"{abs(offset[2]):,.0f} m in height. If the position is right, check the CRS of "
                "the points and their heights.")


def _leaves_exif_position_out(fitted: Fit, interior: Interior) -> bool:
    """Return whether the EXIF has a position, and the fit was made without one."""
    return interior.has_exif_position and not fitted.model.options["position"]


def _contradicts_position(free_fit: Fit, interior: Interior) -> bool:
    """Return whether a fit without the stated position has its camera too far from that."""
    offset, spread = _offset_of_position(free_fit, interior)
    east, north, up = offset / spread
    return bool(max(np.hypot(east, north), abs(up)) > FAR_FROM_POSITION)


def _offset_of_position(free_fit: Fit, interior: Interior) -> tuple[FloatArray, FloatArray]:
    """Return the offset of a fit's camera from the stated position, and its deviations, (3,) each.

    Both are east, north and up [m]. The fit was made without the position, so that the variances
    of the camera and of the position add.
    """
    model = free_fit.model
    assert isinstance(model, KnownFrame)
    camera = _camera_of(free_fit)
    stated = KnownFrame.of(interior, mirrored=bool(model.options["mirrored"])).prepared(
        free_fit.scaling, free_fit.control.crs)
    position, position_spread = stated.position_prior(camera.measured.ground)
    assert position is not None
    assert position_spread is not None
    design, _ = camera.measured.system(camera.camera, np.ones((1, len(camera.measured.image))),
                                       camera.sigma)
    # The covariance of the unknowns is P P' with P = D^+, and that of the position J P P' J'; the
    # first six unknowns are the turn and the shift, on which alone the position depends.
    factors = camera.camera.slopes_of_position[0] @ np.linalg.pinv(design[0])[:6]
    camera_spread = np.linalg.norm(factors, axis=1)
    return (model.unit * (camera.camera.position[0] - position),
            model.unit * np.hypot(camera_spread, position_spread))


def _refuse_contradicted(fitted: Fit, interior: Interior) -> None:
    """Raise Undetermined if the points show another focal length than the stated one.

    All points are compared, robustly, before any is rejected because of the stated camera: the
    focal length of a free camera differs beyond chance, and its median error in leave-one-out is
    much smaller.
    """
    stated = _camera_of(fitted)
    # A camera whose points fit as well as points usually do is not wrong by much.
    if len(fitted.control) < MIN_POINTS_TO_CONTRADICT or stated.sigma <= stated.measured.usual:
        return
    free = _free_camera(stated)
    if free is None:
        return
    spread = _focal_spread(free)
    deviation = float(np.log(free.camera.focal[0] / stated.measured.focal))
    limit = CONTRADICTION * np.hypot(spread, interior.focal_spread)
    if abs(deviation) <= limit or _median_error(stated) < CLEARLY_BETTER * _median_error(free):
        return
    scale = fitted.scaling.image_scale
    in_mm = ""
    # A number so far below the one in px is the focal length of the camera in mm.
    if interior.focal < _MOST_MM and free.camera.focal[0] * scale > _LEAST_RATIO * interior.focal:
        in_mm = f"; if {interior.focal:g} are mm: --set camera_focal={interior.focal:g}mm"
    raise Undetermined(
        f"the points show {free.camera.focal[0] * scale:,.0f} px, not {interior.focal:,.0f} px"
        f"{in_mm}",
        hint=f"Their focal length has a standard deviation of {100 * spread:.2g} %; the median "
             f"error in leave-one-out is {_median_error(free) * scale:.2g} px with it, and "
             f"{_median_error(stated) * scale:.2g} px with the stated one. Check the focal "
             "length and the size of a pixel.")


_MOST_MM = 1000.0
"""Focal length up to which a number may be in mm."""

_LEAST_RATIO = 5.0
"""Least number of pixels in a mm of film or sensor."""


def _free_camera(stated: Pinhole) -> Pinhole | None:
    """Return the camera of the same points with focal length and position free; None if none fits.
    """
    measured = stated.measured
    return camera_of(replace(
        measured, focal_spread=max(FREE_FOCAL_SPREAD, measured.focal_spread),
        reach=max(FREE_REACH * measured.focal, measured.reach), place=None, place_spread=None))


def _focal_spread(camera: Pinhole) -> float:
    """Return the relative standard deviation of the focal length of a camera."""
    design, _ = camera.measured.system(camera.camera, np.ones((1, len(camera.measured.image))),
                                       camera.sigma)
    # The covariance of the unknowns is (D' D)^-1; the seventh is log f.
    return float(np.linalg.norm(np.linalg.pinv(design[0])[6]))


def _median_error(camera: Pinhole) -> float:
    """Return the median distance of the points from where the other points predict them, scaled."""
    return float(np.median(np.linalg.norm(camera.errors, axis=1)))


def _focal_in_words(interior: Interior) -> str:
    """Return a sentence on the focal length that was stated, and how well it is known."""
    if interior.focal_spread <= FIXED_SPREAD:
        return "It is fixed, as stated."
    spread = interior.focal_spread * interior.focal
    stated = "in the EXIF" if interior.from_exif else "stated"
    return (f"{interior.focal:,.1f} px are {stated}, and taken to be known to "
            f"{100 * interior.focal_spread:.2g} % ({spread:.2g} px, one standard deviation); "
            "--set camera_focal_spread states another, or fixed.")


def _focal_of_points(fitted: Fit) -> str:
    """Return a sentence, after a space, if points do not show whether the focal length is right.

    "" if they do.
    """
    if fitted.used.sum() < MIN_POINTS_TO_CONTRADICT:
        return " So few points cannot show whether it is right."
    # What the points alone show is seen with a focal length that is hardly known beforehand.
    free = _free_camera(_camera_of(fitted))
    spread = np.inf if free is None else _focal_spread(free)
    if spread < VAGUE_FOCAL:
        return ""
    # Beyond half of its prior the figure would be the prior's rather than the points'.
    if spread < FREE_FOCAL_SPREAD / 2:
        known_to = f": alone they tell it to {100 * spread:.0f} %"
    else:
        known_to = ""
    return f" The points cannot show whether it is right{known_to}."


def _exif_position_in_words(fitted: Fit, interior: Interior) -> str:
    """Return a sentence on how the position in EXIF took part; "" if it did not."""
    if not interior.has_exif_position or _leaves_exif_position_out(fitted, interior):
        return ""
    return (f" The position of the camera in the EXIF took part as known to "
            f"{interior.position_spread:g} m in plan and {interior.position_height_spread:g} m in "
            "height (one standard deviation); --set camera_position=X,Y,Z,S,H states another.")


def _interior_of_points(control: FitData) -> Interior:
    """Return the interior that columns of the points state; raises Undetermined if they state none.
    """
    interior = interior_of(control.features)
    if interior is None:
        raise Undetermined("the focal length of the camera is not stated",
                           hint="State it: --set camera_focal=3131.8, in px.")
    return interior


def is_mirrored(control: FitData) -> bool:
    """Return whether the image is mirrored against the ground as seen from above."""
    points = control.features.points
    plan = control.scaled.points.ground[:, :2]
    columns = np.column_stack([np.ones(len(plan)), plan])
    slopes = np.linalg.lstsq(columns, points.image, rcond=None)[0][1:]
    # Scaled ground axes run east and north, lines downwards: the determinant of line and sample
    # by east and north is positive unless the image is mirrored.
    return bool(np.linalg.det(slopes) < 0.0)


KNOWN_CAMERA = KnownCamera("known-camera", "a frame camera of known focal length",
                           short="known camera", estimator=ByKnownCamera(), has_prior=True,
                           judges_blunders=True, from_one=True)
