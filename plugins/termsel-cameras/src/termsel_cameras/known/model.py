"""The collinearity equations of a camera whose interior is known."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from termsel import (
    Equations,
    FeatureSet,
    Option,
    SensorModel,
    TermselError,
    Undetermined,
    image_equations,
)
from termsel.toolkit.coordinates import LOCAL, to_ecef
from termsel.toolkit.models import (
    Cameras,
    Measured,
    Pinhole,
    SensorFigure,
    camera_figures,
    camera_of,
    cameras_of,
    exterior_orientation,
    rotation_matrices,
)
from termsel_cameras.known.interior import STATED_REACH, Interior, interior_of_file
from termsel_cameras.known.lens import FloatArray, Lens
from termsel_cameras.known.turns import vector_of

TAILS = 4.0
"""Degrees of freedom of measurements: few are wild, but more than normal errors are (Lange, Little
and Taylor 1989)."""

USUAL_SIGMA, EXPERIENCE = 2.0, 2.0
"""Standard deviation of a measurement as it usually is [px], and the degrees of freedom that this
counts as next to residuals."""

STATED_EXPERIENCE = 8.0
"""The same where the points state it."""

MIN_SIGMA = 0.1
"""Least standard deviation of a measurement [px]."""

TILT = 0.1
"""Scale of the prior of the sine of a camera's tilt, with long tails. Most photos for maps are
vertical, within 3 deg (Manual of Photogrammetry), those of the war and of small aircraft within 6;
but some are oblique."""

UNKNOWN_REACH = 0.3
"""Scale of the prior of the principal point about the middle of the control, by its half extent,
where nothing shows it."""

UNKNOWNS = 6
"""Number of unknowns of a camera whose interior is known: position and rotation."""

UNKNOWNS_OF_PRINCIPAL = 2
"""Number of unknowns of a principal point that nothing shows: the points alone determine it."""

MIN_SEPARATION = 0.05
"""Part of its distance by which two places of a camera differ, if they are two."""

MAX_COST_DIFFERENCE = 6.0
"""Twice the logarithm of the likelihood by which two cameras must differ, if points show them."""

CAMERA_FILE = Option("camera", None, "A camera file NAME.json: focal, principal point and "
                                     "distortion; options that are given come before it.")

_LENS_STEP = 1e-5

KNOWN_FRAME_TERMS = ("turn-line", "turn-sample", "turn-view", "shift-line", "shift-sample",
                     "shift-view",
                     "focal", "middle-line", "middle-sample")


def options_of_camera(path: str) -> dict[str, Any]:
    """Return the options of `KnownFrame` that a camera file states; `line` only if it has one.

    Raises TermselError for a file that cannot be read or states no focal length.
    """
    known = interior_of_file(path)
    options: dict[str, Any] = {"focal": known.focal, "focal_spread": known.focal_spread,
                               "distortion": ",".join(map(repr, known.distortion))}
    if np.isfinite(known.line):
        options |= {"line": known.line, "sample": known.sample,
                    "reach": STATED_REACH * known.focal}
    return options


class KnownFrame(SensorModel):
    """Frame camera with a known interior: collinearity equations with the lens of a calibration.

    Terms are the turn of the camera against one that looks straight down with lines to the south,
    as a vector, the place of the middle of the control in its axes, the logarithm of the focal
    length by the known one, and the principal point by the known one. The last three have priors.

    References
    ----------
    Brown 1971, Photogrammetric Engineering 37(8), for the distortion; Kraus 2007, Photogrammetry,
    for the collinearity equations. The priors are termsel's own.
    """

    name = "known-frame"
    declared_options = (
        CAMERA_FILE,
        Option("focal", 1.0, "Focal length [px].", float, 1e-6, 1e9),
        Option("focal_spread", 0.01, "Relative standard deviation of it.", float, 1e-9, 10.0),
        Option("line", None, "Line of the principal point [px].", float, -1e9, 1e9),
        Option("sample", None, "Sample of the principal point [px].", float, -1e9, 1e9),
        Option("reach", None, "Scale of the prior of the principal point [px].", float, 0.0, 1e9),
        Option("distortion", "0,0,0,0,0", "k1, k2, p1, p2 and k3 of the lens."),
        Option("position", "", "Rough position of the camera in the CRS of the points."),
        Option("position_spread", 50.0, "Its standard deviation [m].", float, 1e-9, 1e9),
        Option("position_height_spread", None, "That of its height [m], if it is another one.",
               float, 1e-9, 1e9),
        Option("height", None, "Rough flying height above the ground [m].", float, 0.0, 1e9),
        Option("height_spread", 0.1, "Relative standard deviation of it.", float, 1e-9, 10.0),
        Option("mirrored", False, "Whether the scan is mirrored, as of a negative.", bool))

    @classmethod
    def of(cls, interior: Interior, *, mirrored: bool) -> KnownFrame:
        """Return the model of a camera with an interior orientation.

        Its options state what the interior has; what is NaN there stays at its default.
        `mirrored` says whether the scan is mirrored, as of a negative.
        """
        def text(numbers: tuple[float, ...]) -> str:
            """Return numbers as an option's text, with commas between."""
            return ",".join(map(repr, numbers))

        def number(value: float) -> float | None:
            """Return a number as an option's value; None if it is not stated."""
            return float(value) if np.isfinite(value) else None

        return cls(focal=float(interior.focal), focal_spread=float(interior.focal_spread),
                   line=number(interior.line), sample=number(interior.sample),
                   reach=number(interior.reach), distortion=text(interior.distortion),
                   position=text(interior.position) if np.isfinite(interior.position).all() else "",
                   position_spread=float(interior.position_spread),
                   position_height_spread=number(interior.position_height_spread),
                   height=number(interior.height), mirrored=mirrored)

    def __init__(self, camera: str | None = None, **options: Any) -> None:
        # What the file says is recorded, not its name: it may be elsewhere later.
        of_file = {} if camera is None else options_of_camera(CAMERA_FILE.parse(camera))
        super().__init__(**{**of_file, **options})
        self.lens = Lens(*map(float, self.options["distortion"].split(",")))

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms."""
        return KNOWN_FRAME_TERMS

    # Coordinates: metres of a tangent plane on the ground, scaled ones of an ideal lens in the
    # image.

    def local(self, ground: FloatArray) -> FloatArray:
        """Return scaled ground positions (n, 3) as east, north and up of the middle, over `unit`.

        Raises TermselError if the model is not prepared.
        """
        if self.scaling is None:
            raise TermselError("the model is not prepared: its position on Earth is not known",
                               hint="Fit it, or call its method prepared first.")
        return self._to_metres(ground) / self.unit

    @cached_property
    def unit(self) -> float:
        """Metres that one unit of `local` has: the half extent of the control."""
        edges = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 1.0, 0.0]])
        west, east, south, north = self._to_metres(edges)
        return float(max(np.linalg.norm(east - west), np.linalg.norm(north - south))) / 2.0

    def _to_metres(self, ground: FloatArray) -> FloatArray:
        """Return scaled ground positions (n, 3) in metres east, north and up of the middle."""
        assert self.scaling is not None
        # Without a CRS of the Earth the axes are taken to be a plane's.
        if self.crs in ("", LOCAL):
            return np.asarray(ground * np.array(self.scaling.ground_scale))
        origin, axes = self._frame
        return np.asarray((to_ecef(self.geographic(ground)) - origin) @ axes.T)

    @cached_property
    def _frame(self) -> tuple[FloatArray, FloatArray]:
        """Middle of the control, Earth-fixed (3,), and east, north and up there, rows of (3, 3)."""
        middle = self.geographic(np.zeros((1, 3)))
        lon, lat = np.radians(middle[0, :2])
        east = np.array([-np.sin(lon), np.cos(lon), 0.0])
        up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
        return to_ecef(middle)[0], np.stack([east, np.cross(up, east), up])

    @cached_property
    def principal(self) -> FloatArray:
        """Principal point [px]; the middle of the control where nothing shows it."""
        assert self.scaling is not None
        stated = self.options["line"], self.options["sample"]
        return np.array(self.scaling.image_offset if None in stated else stated)

    @property
    def reach(self) -> float:
        """Scale of the prior of the principal point, scaled."""
        assert self.scaling is not None
        stated = self.options["reach"]
        return UNKNOWN_REACH if stated is None else stated / self.scaling.image_scale

    @property
    def _unknowns(self) -> int:
        """How many numbers the points determine."""
        return UNKNOWNS if self.options["reach"] is not None else UNKNOWNS + UNKNOWNS_OF_PRINCIPAL

    @property
    def focal(self) -> float:
        """Focal length that is known, scaled."""
        assert self.scaling is not None
        return float(self.options["focal"]) / self.scaling.image_scale

    def without_lens(self, image: FloatArray) -> FloatArray:
        """Return scaled image positions (..., 2) as an ideal lens would have them."""
        return self._apply_lens(image, self.lens.ideal)

    def with_lens(self, image: FloatArray) -> FloatArray:
        """Return scaled image positions (..., 2) of an ideal lens as this one has them."""
        return self._apply_lens(image, self.lens.distorted)

    def _apply_lens(self, image: FloatArray,
                    lens_map: Callable[[FloatArray], FloatArray]) -> FloatArray:
        """Return scaled image positions (..., 2) after the lens or its inverse, `lens_map`.

        `lens_map` takes and returns x and y (..., 2) from the principal point, divided by the focal
        length.
        """
        if self.lens.is_ideal:
            return image
        assert self.scaling is not None
        offsets = (self.scaling.pixels(image) - self.principal) / self.options["focal"]
        # The lens has x, along samples, first; here lines are first.
        mapped = lens_map(offsets[..., ::-1])[..., ::-1]
        return self.scaling.image(self.principal + self.options["focal"] * mapped)

    # The camera by points.

    def measured(self, features: FeatureSet, noise: float | None) -> Measured:
        """Return the measurements of scaled control points, and all that is known of the camera.

        Image positions are freed of the lens's distortion. Weights (n, 2) are the median standard
        deviation of the points over each of theirs, or 1. `noise` [px] is the standard deviation of
        a measurement that the file states, None if it states none; those of the points come before
        it. Without either a usual one is assumed, which the points may soon correct.
        """
        assert self.scaling is not None
        points = features.points
        scale = self.scaling.image_scale
        sigma = points.sigma
        weights = np.ones((len(points), 2)) if sigma is None else np.median(sigma) / sigma
        # Features are scaled, and so are their deviations: `scale` turns them into px.
        stated = noise if sigma is None else float(np.median(sigma)) * scale
        ground = self.local(points.ground)
        position, spread = self.position_prior(ground)
        return Measured(
            ground, self.without_lens(points.image), weights,
            self.scaling.image(self.principal), self.reach, self.focal, np.ones(3),
            MIN_SIGMA / scale, focal_spread=float(self.options["focal_spread"]), place=position,
            place_spread=spread, tilt=TILT, tails=TAILS, unknowns=self._unknowns,
            usual=(USUAL_SIGMA if stated is None else stated) / scale,
            experience=EXPERIENCE if stated is None else STATED_EXPERIENCE)

    def position_prior(self, ground: FloatArray) -> tuple[FloatArray | None, FloatArray | None]:
        """Return the stated position of the camera and its standard deviations, (3,) each.

        Both are east, north and up of the middle, divided by `unit`, and NaN for coordinates that
        are not stated; two None if none is. `ground` (n, 3) are the control points in the same
        units: the option `height` counts from their mean height. Of a height of the position and
        one by `height`, that of the smaller standard deviation is returned.
        """
        position = np.full(3, np.nan)
        spread = np.full(3, np.nan)
        # Lengths are divided by `unit`, as the equations of the camera have them.
        if self.options["position"]:
            assert self.scaling is not None
            coordinates = [float(number) for number in self.options["position"].split(",")]
            position = self.local(self.scaling.ground(np.array([coordinates])))[0]
            spread = np.full(3, self.options["position_spread"] / self.unit)
            if self.options["position_height_spread"] is not None:
                spread[2] = self.options["position_height_spread"] / self.unit
        height = self.options["height"]
        if height is not None:
            height_spread = self.options["height_spread"] * height / self.unit
            height_is_stated = bool(np.isfinite(spread[2]))
            if not height_is_stated or height_spread < spread[2]:
                position[2] = ground[:, 2].mean() + height / self.unit
                spread[2] = height_spread
        return (position, spread) if np.isfinite(position).any() else (None, None)

    def camera(self, features: FeatureSet, noise: float | None) -> Pinhole:
        """Return the robust estimate of the camera by scaled control points.

        `noise` is as in `measured`.

        Raises
        ------
        Undetermined
            If no camera has all points in front, or if there are three points, and two cameras
            see them alike.
        """
        measured = self.measured(features, noise)
        camera = camera_of(measured)
        # A focal length in mm taken for px is too short by a factor of some hundred.
        if camera is None:
            raise Undetermined("no camera of this focal length can see all control points",
                               hint="Check the focal length (in px; in mm write 35mm) and the "
                                    "heights.")
        if len(features.points) == 3:
            return self._camera_of_three_points(measured, camera)
        return camera

    def _camera_of_three_points(self, measured: Measured, camera: Pinhole) -> Pinhole:
        """Return `camera`, the best of three points, if no other one explains them as well.

        Raises Undetermined if another one, elsewhere, costs nearly the same: up to four cameras
        see three points alike (Grunert 1841).
        """
        # The first of the cameras is the best one.
        cameras = cameras_of(measured)
        rows = np.ones((len(cameras), 3))
        costs = measured.costs(cameras, rows, camera.sigma)
        distance_to_ground = np.linalg.norm(cameras.position[0])
        separations = np.linalg.norm(cameras.position - cameras.position[0], axis=1)
        elsewhere = separations > MIN_SEPARATION * distance_to_ground
        as_good = costs < costs[0] + MAX_COST_DIFFERENCE
        if not (as_good & elsewhere)[1:].any():
            return camera
        raise Undetermined("two cameras see the three control points alike",
                           hint="State a rough flying height, --set camera_height=1500, or measure "
                                "a fourth point.")

    def values_of(self, camera: Cameras) -> FloatArray:
        """Return the values of the terms (9,), as in `KNOWN_FRAME_TERMS`, of the first camera."""
        turn = vector_of(camera.rotation[0] @ self._downwards.T)
        middle = camera.middle[0] - self._middle
        return np.array([*turn, *camera.shift[0], np.log(camera.focal[0] / self.focal), *middle])

    def camera_of(self, values: FloatArray) -> Cameras:
        """Return the s cameras that have these values of the terms, (s, 9)."""
        rotation = rotation_matrices(values[:, :3]) @ self._downwards
        return Cameras(rotation, values[:, 3:6], self.focal * np.exp(values[:, 6]),
                       self._middle + values[:, 7:])

    @property
    def _downwards(self) -> FloatArray:
        """Axes of a camera that looks straight down: lines to the south, samples to the east.

        Rows of (3, 3) are line, sample and view. In a mirrored image samples run to the west.
        """
        sample_direction = -1.0 if self.options["mirrored"] else 1.0
        return np.array([[0.0, -1.0, 0.0], [sample_direction, 0.0, 0.0], [0.0, 0.0, -1.0]])

    @property
    def _middle(self) -> FloatArray:
        """Principal point in scaled image positions (2,)."""
        assert self.scaling is not None
        return np.asarray(self.scaling.image(self.principal))

    # What a sensor model does.

    def sensor_figures(self, coefficients: FloatArray) -> tuple[SensorFigure, ...]:
        """Return the figures of a camera: position, angles, focal length and principal point."""
        assert self.scaling is not None
        camera = self.camera_of(np.asarray(coefficients)[None])
        focal = float(camera.focal[0]) * self.scaling.image_scale
        orientation = exterior_orientation(camera.rotation[0], camera.position[0], self.local,
                                           self.scaling, self.crs)
        return camera_figures(orientation, focal, self.scaling.pixels(camera.middle)[0])

    def project(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        """Return image positions of ground points, shape (..., n, 2); NaN behind the camera."""
        values = np.reshape(coefficients, (-1, len(KNOWN_FRAME_TERMS)))
        ideal = self.camera_of(values).image(self.local(ground))
        return self.with_lens(ideal).reshape(*np.shape(coefficients)[:-1], len(ground), 2)

    def denominators(self, coefficients: FloatArray, ground: FloatArray) -> FloatArray:
        """Return the depths of ground points along the view, which both axes share, (..., n, 2)."""
        values = np.reshape(coefficients, (-1, len(KNOWN_FRAME_TERMS)))
        depths = self.camera_of(values).in_camera_axes(self.local(ground))[..., 2]
        return np.stack([depths, depths], axis=-1).reshape(
            *np.shape(coefficients)[:-1], len(ground), 2)

    def start(self, features: FeatureSet) -> FloatArray:
        """Return the values of terms (9,) of the robust solution."""
        return self.values_of(self.camera(features, None).camera)

    def equations(self, features: FeatureSet) -> Equations:
        """Return the equations about the start."""
        return self.linearised(features, self.start(features))

    def linearised(self, features: FeatureSet, coefficients: FloatArray) -> Equations:
        """Return the equations of scaled points and lines, linearised about a solution (9,).

        The last three terms have priors: the logarithm of the focal length with the standard
        deviation `focal_spread`, and the principal point with `reach` in each axis.
        """
        assert self.scaling is not None
        derivatives = []
        constants = []
        for ground in (features.points.ground, features.lines.ground.reshape(-1, 3)):
            # Central differences: image(x) is about image(x0) + J (x - x0), so that the constant
            # of the linear model is image(x0) - J x0.
            steps = _LENS_STEP * np.eye(len(KNOWN_FRAME_TERMS))
            shifted = self.project(np.concatenate([coefficients + steps, coefficients - steps]),
                                   ground)
            jacobian = np.moveaxis(shifted[:len(KNOWN_FRAME_TERMS)]
                                   - shifted[len(KNOWN_FRAME_TERMS):], 0, -1) / (2 * _LENS_STEP)
            derivatives.append(jacobian)
            constants.append(self.project(coefficients, ground) - jacobian @ coefficients)
        equations = image_equations(features, *derivatives, *constants)
        # An equation of a prior weighs by the noise, taken to be usual, over the prior's deviation.
        noise = USUAL_SIGMA / self.scaling.image_scale
        prior = np.zeros(len(KNOWN_FRAME_TERMS))
        prior[6] = noise / self.options["focal_spread"]
        prior[7:] = noise / self.reach
        return Equations(equations.A, equations.b, equations.feature, prior)
