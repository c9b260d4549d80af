"""Frame and panoramic cameras of the textbooks, with priors for what nobody wrote down."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from termsel import (
    FeatureSet,
    Fit,
    FitData,
    Method,
    Option,
    Scaling,
    SensorModel,
    Undetermined,
)
from termsel.toolkit.coordinates import to_wgs84
from termsel.toolkit.models import (
    SensorFigure,
    camera_figures,
    exterior_orientation,
    pinhole_of,
    view_of,
)
from termsel_cameras.scanners.candidate import sensor_of
from termsel_cameras.scanners.orbit import axes_at, to_geocentric
from termsel_cameras.scanners.physical import FloatArray, Physical, RobustFit, require_scaling

TURN, SCALE = 3.0, 1.0
"""Standard deviations of the turn about the vertical [rad] and of the logarithm of the scale, about
those of an affine transformation: as good as nothing is known."""

TILT = 0.1
"""Standard deviation of the camera's tilts [rad]: vertical photos are tilted by 3 deg at most
(Manual of Photogrammetry), those of the war and of small aircraft by more."""

OBLIQUE_TILT = 1.0
"""The same of oblique photos, whose tilt is not known beforehand."""

OBLIQUE = 0.6
"""Distance of the nearest point from the camera, by that of the middle, up to which a view is
oblique."""

FOCAL_PRIOR, FOCAL_SPREAD = 2.0, 0.6
"""Focal length by the half extent of the control in the image, and the standard deviation of its
logarithm: film of 23 cm went with 88 to 305 mm, or 0.8 to 2.7, and with 610 mm."""

MIDDLE = 0.3
"""Standard deviation of the principal point, by the half extent of the control: the control need
not be in the middle of the image."""

RADIAL = 3.0
"""Standard deviation of the distortion at the half extent [px]."""

FILM = 1e-3
"""Standard deviation of affinity and shear of film and scan."""

MOTION = 0.02
"""Standard deviation of the image motion that is compensated while the slit swings, by the focal
length."""

RELIEF = 2e-3
"""Heights off a plane (root of the sum of squares) by the spread of the control, up to which they
show nothing: half of it, by the spread in the image, is as much as can be measured."""

MIN_PHOTO_POINTS, MAX_PHOTO_POINTS = 6, 20
"""Numbers of points for which the candidates are: more show as much as the physics."""

MAX_MISFIT = 2.0
"""Misfit of points and priors together, by what it is expected to be, beyond which a camera is not
of this kind: it is at most about 1.2 where it is, and seldom below 3 where it is not."""


class Photo(Physical):
    """A camera that looks down from one place; see `FrameCamera` and `Panoramic`."""

    free = 2
    declared_options = (
        Option("mirrored", False, "Whether the scan is mirrored, as of a negative.", bool),
        Option("oblique", False, "Whether the camera looks towards the horizon rather than down.",
               bool))

    @property
    def tilt(self) -> float:
        """Standard deviation of the camera's tilts [rad]."""
        return OBLIQUE_TILT if self.options["oblique"] else TILT

    def local(self, ground: FloatArray) -> FloatArray:
        """Return scaled places in metres east, north and up of the control's middle, (n, 3)."""
        return _to_local(ground, require_scaling(self.scaling), self.crs)

    def starts(self, features: FeatureSet) -> FloatArray:
        """Return the values of terms (s, k) from which fits to scaled points begin.

        One start is the pinhole camera of an oblique view; if there is none, or the option
        `oblique` is off, there are three of the affine map of the points.
        """
        slopes = self.slopes_of(features)
        # The direction of north in the image shows the turn, the area of a unit square the scale.
        turn = np.arctan2(slopes[1, 1], slopes[0, 1])
        starts = np.zeros((3, len(self.terms)))
        starts[:, self.terms.index("turn")] = turn / TURN
        starts[:, self.terms.index("scale")] = np.log(
            np.sqrt(np.abs(np.linalg.det(slopes)) + 1e-12) * self._ground_extent()) / SCALE
        # Short, usual and long focal lengths may lead to minima of their own.
        starts[:, self.terms.index("focal")] = (-1.0, 0.0, 1.0)
        view_starts = self.starts_of_view(features) if self.options["oblique"] else starts[:0]
        return view_starts if len(view_starts) else starts

    def starts_of_view(self, features: FeatureSet) -> FloatArray:
        """Return the values of terms (1, k) of the pinhole camera of scaled points.

        (0, k) if they have none, or if it has their middle behind it.
        """
        points = features.points
        pinhole = pinhole_of(FeatureSet(points, crs=self.crs), require_scaling(self.scaling))
        # The entry of the matrix is the depth of the middle of the points; NaN is no depth either.
        if pinhole is None or not pinhole.matrix[2, 0] > 0.0:
            return np.zeros((0, len(self.terms)))
        # Without the principal point the rows are f q1, f q2 and q3, of 1, X, Y and Z.
        principal = np.append(pinhole.camera.middle[0], 0.0)
        matrix = pinhole.matrix - np.outer(principal, pinhole.matrix[2])
        steps = self.local(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]]))[:, :2]
        # Derivatives by scaled X and Y become those by metres to the east and to the north.
        plane = matrix[:, 1:3] @ np.linalg.inv((steps[:2] - steps[2]).T)
        focal = float(pinhole.camera.focal[0])
        return np.array([
            self._terms_of_view(plane, matrix[:, 0], focal, pinhole.camera.middle[0])])

    def _terms_of_view(self, plane: FloatArray, middle: FloatArray, focal: float,
                       principal: FloatArray) -> list[float]:
        """Return the values of terms of a pinhole camera with a scaled focal length.

        `plane` (3, 2) has the columns of its matrix for east and north [1/m], `middle` (3,) that of
        the middle of the ground; both are about `principal`, the principal point (2,).
        """
        # Divided by the focal length, the columns are those of a rotation times a scale.
        columns = plane / np.array([[focal], [focal], [1.0]])
        size = float(np.linalg.norm(columns, axis=0).mean())
        turn, tilts = _turn_and_tilts(columns, mirrored=bool(self.options["mirrored"]))
        # The image position of the middle of the ground, from the principal point and scaled.
        offset = middle[:2] / middle[2]
        line, sample = principal + offset
        values = dict.fromkeys(self.terms, 0.0) | {
            "line": line, "sample": sample, "turn": turn / TURN,
            "scale": np.log(focal * size / middle[2] * self._ground_extent()) / SCALE,
            "focal": np.log(focal / FOCAL_PRIOR) / FOCAL_SPREAD,
            "tilt-line": tilts[0] / self.tilt, "tilt-sample": tilts[1] / self.tilt,
            "middle-line": offset[0] / MIDDLE, "middle-sample": offset[1] / MIDDLE}
        return [values[name] for name in self.terms]

    def slopes_of(self, features: FeatureSet) -> FloatArray:
        """Return the slopes of scaled image positions by metres east and north, (2, 2).

        Rows are east and north, columns line and sample. The determinant is positive unless the
        image is mirrored.
        """
        # Heights are left out: as a further column they would take up what the tilt does.
        plan = self.local(features.points.ground)[:, :2]
        return np.asarray(np.linalg.lstsq(np.column_stack([np.ones(len(plan)), plan]),
                                          features.points.image)[0][1:])

    def _ground_extent(self) -> float:
        """Return how far the eastern edge of the control is from its middle [m]."""
        return _ground_extent_of(require_scaling(self.scaling), self.crs)

    def in_camera_axes(self, x: dict[str, FloatArray], ground: FloatArray,
                       ray: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return ground points in the axes of p cameras (p, n, 3), and focal lengths (p, 1).

        The axes are along lines, samples and the view, and lengths are divided by the depth of the
        control's middle. `x` has the values (p,) of terms by name, `ground` (n, 3) is scaled, and
        `ray` (p, 3) leads from the camera to the middle of the control.
        """
        focal = FOCAL_PRIOR * np.exp(FOCAL_SPREAD * x["focal"])
        scale = np.exp(SCALE * x["scale"]) / self._ground_extent()
        from_middle = self.local(ground) @ self.rotation_of(x).transpose(0, 2, 1)
        # A metre of ground is `scale` in the image, and so scale / focal of the depth.
        return (np.asarray(from_middle * (scale / focal)[:, None, None] + ray[:, None, :]),
                focal[:, None])

    def rotation_of(self, x: dict[str, FloatArray]) -> FloatArray:
        """Return the rotations from the ground to the axes of p cameras, (p, 3, 3).

        Their rows are the directions of lines, samples and the view, in east, north and up. `x` has
        the values (p,) of the terms turn, tilt-line and tilt-sample by name.
        """
        sine = np.sin(TURN * x["turn"])
        cosine = np.cos(TURN * x["turn"])
        zeros = np.zeros_like(sine)
        # Axes of a level camera: line to the south, sample to the east, view downwards; then they
        # are turned about the vertical. In a mirrored image lines run the other way.
        line_sign = -1.0 if self.options["mirrored"] else 1.0
        level = np.stack([np.stack([line_sign * sine, -line_sign * cosine, zeros], axis=1),
                          np.stack([cosine, sine, zeros], axis=1),
                          np.stack([zeros, zeros, zeros - 1.0], axis=1)], axis=1)
        turned = level
        # Each tilt turns an axis of the image and the view in their plane.
        for i, name in enumerate(("tilt-line", "tilt-sample")):
            s = np.sin(self.tilt * x[name])[:, None]
            c = np.cos(self.tilt * x[name])[:, None]
            image_axis = turned[:, i]
            view = turned[:, 2]
            turned = turned.copy()
            turned[:, i] = c * image_axis - s * view
            turned[:, 2] = s * image_axis + c * view
        return np.asarray(turned)

    def image_of(self, values: FloatArray, ground: FloatArray) -> FloatArray:
        """Return scaled image positions (p, n, 2) by values of terms (p, k)."""
        x = dict(zip(self.terms, values.T, strict=True))
        shift = np.stack([x["line"], x["sample"]], axis=1)
        with np.errstate(all="ignore"):
            return np.asarray(self.film(x, ground) + shift[:, None])

    def film(self, x: dict[str, FloatArray], ground: FloatArray) -> FloatArray:
        """Return scaled positions on the film (p, n, 2), about where the middle is seen.

        `x` has the values (p,) of terms by name; `ground` (n, 3) are scaled ground positions.
        """
        raise NotImplementedError


def _to_local(ground: FloatArray, scaling: Scaling, crs: str) -> FloatArray:
    """Return scaled ground positions (n, 3) in metres east, north and up of the control's middle.
    """
    # Without a CRS of the Earth coordinates are those of a plane already.
    if crs in ("", "local"):
        return np.asarray(ground * scaling.ground_scale)
    # Others go by Earth-fixed coordinates, as the Earth bends by metres within a photo.
    middle, axes = _middle_and_axes(scaling, crs)
    return np.asarray((to_geocentric(_geographic(ground, scaling, crs)) - middle) @ axes.T)


def _geographic(ground: FloatArray, scaling: Scaling, crs: str) -> FloatArray:
    """Return longitude, latitude [deg] and height [m], (n, 3), of scaled ground positions."""
    return to_wgs84(crs)(scaling.unscaled(ground))


@lru_cache(maxsize=32)  # a photo is asked for with each set of parameters
def _middle_and_axes(scaling: Scaling, crs: str) -> tuple[FloatArray, FloatArray]:
    """Return the middle of the control, Earth-fixed (1, 3), and its east, north and up (3, 3)."""
    middle = _geographic(np.zeros((1, 3)), scaling, crs)
    return to_geocentric(middle), axes_at(*middle[0, :2])


@lru_cache(maxsize=32)  # a photo is asked for with each set of parameters
def _ground_extent_of(scaling: Scaling, crs: str) -> float:
    """Return how far the eastern edge of the control is from its middle [m]."""
    return float(np.linalg.norm(_to_local(np.array([[1.0, 0.0, 0.0]]), scaling, crs)))


def _turn_and_tilts(columns: FloatArray, *, mirrored: bool) -> tuple[float, tuple[float, float]]:
    """Return the turn and the two tilts [rad] by which `Photo.rotation_of` gives a camera's axes.

    `columns` (3, 2) are about east and north in these axes, times a scale.
    """
    # The nearest matrix with orthonormal columns (Procrustes).
    u, _, v = np.linalg.svd(columns, full_matrices=False)
    east, north = (u @ v).T
    up = np.cross(east, north) * (1.0 if mirrored else -1.0)
    line, sample, view = np.column_stack([east, north, up])
    # A camera looks down; one that looks up sees a plane in the same image.
    if view[2] > 0.0:
        line, sample, view = (axis * [1.0, 1.0, -1.0] for axis in (line, sample, view))
    # `rotation_of` tilts the line first and then the sample, which is undone first.
    second = float(np.arctan(-sample[2] / min(view[2], -1e-9)))
    level = np.cos(second) * sample + np.sin(second) * view
    between = np.cos(second) * view - np.sin(second) * sample
    first = float(np.arctan(-line[2] / min(between[2], -1e-9)))
    return float(np.arctan2(level[1], level[0])), (first, second)


_COMMON = ("line", "sample", "turn", "scale", "focal", "tilt-line", "tilt-sample", "middle-line",
           "middle-sample")


class FrameCamera(Photo):
    """Frame camera: collinearity equations with radial distortion and deformed film.

    Terms are in standard deviations of what is known beforehand, which is little; ``line`` and
    ``sample`` are the place where the middle of the control is seen. There are 12: turn, scale,
    focal length, tilts, principal point, radial distortion, affinity and shear.

    References
    ----------
    Brown 1971, Photogrammetric Engineering 37(8), for the distortion; Kraus 2007, Photogrammetry,
    for the collinearity equations. The priors are termsel's own.
    """

    name = "frame"
    terms_ = (*_COMMON, "radial", "affinity", "shear")

    def film(self, x: dict[str, FloatArray], ground: FloatArray) -> FloatArray:
        """Return scaled positions on the film (p, n, 2), about where the middle is seen."""
        middle = MIDDLE * np.stack([x["middle-line"], x["middle-sample"]], axis=1)
        focal = FOCAL_PRIOR * np.exp(FOCAL_SPREAD * x["focal"])
        # The middle of the control need not be seen at the principal point.
        ray = np.column_stack([middle / focal[:, None], np.ones(len(focal))])
        in_camera, focal = self.in_camera_axes(x, ground, ray)
        # Central projection: NaN behind the camera.
        ideal = focal[..., None] * in_camera[..., :2] / np.where(
            in_camera[..., 2:] > 0, in_camera[..., 2:], np.nan)
        squared_radius = (ideal**2).sum(axis=2, keepdims=True)
        # Radial distortion is a factor 1 + k r^2, and so grows with the third power of r.
        distortion = RADIAL / require_scaling(
            self.scaling).image_scale * x["radial"][:, None, None] * squared_radius
        line, sample = np.moveaxis(ideal * (1.0 + distortion), -1, 0)
        affinity = FILM * x["affinity"][:, None]
        shear = FILM * x["shear"][:, None]
        return (np.stack([line * (1.0 + affinity) + shear * sample, sample], axis=-1)
                - middle[:, None])

    def sensor_figures(self, coefficients: FloatArray) -> tuple[SensorFigure, ...]:
        """Return the figures of the camera: position, angles, focal length and principal point.

        `coefficients` (k,) are the values of the terms. Each figure has its name and unit.
        """
        scaling = require_scaling(self.scaling)
        x = dict(zip(self.terms, np.asarray(coefficients)[:, None], strict=True))
        offset = MIDDLE * np.array([x["middle-line"][0], x["middle-sample"][0]])
        focal = float(FOCAL_PRIOR * np.exp(FOCAL_SPREAD * x["focal"][0]))
        scale = float(np.exp(SCALE * x["scale"][0])) / self._ground_extent()
        rotation = self.rotation_of(x)[0]
        # In the camera's axes a point X is R X scale / focal + ray, which is 0 at the camera.
        centre = -np.append(offset / focal, 1.0) * focal / scale @ rotation
        principal = np.array([[x["line"][0], x["sample"][0]]]) - offset
        orientation = exterior_orientation(rotation, centre, self.local, scaling, self.crs)
        return camera_figures(orientation, focal * scaling.image_scale,
                              scaling.pixels(principal)[0])


class Panoramic(Photo):
    """Panoramic camera: a slit swings across the track over film on a cylinder.

    Terms are in standard deviations of what is known beforehand, which is little; ``line`` and
    ``sample`` are the place where the middle of the control is seen. There are 10: turn, scale,
    focal length, tilts, the angle and the place on the slit that the middle is seen at, and the
    motion of the image while the slit swings. It swings along samples.

    References
    ----------
    Case 1967, Photogrammetric Engineering 33(1), for the equations. The priors are termsel's own.
    """

    name = "panoramic"
    terms_ = (*_COMMON, "motion")

    def film(self, x: dict[str, FloatArray], ground: FloatArray) -> FloatArray:
        """Return scaled positions on the film (p, n, 2), about where the middle is seen."""
        focal = FOCAL_PRIOR * np.exp(FOCAL_SPREAD * x["focal"])
        slit, angle = (MIDDLE * x[name] / focal for name in ("middle-line", "middle-sample"))
        in_camera, focal = self.in_camera_axes(x, ground, np.stack(
            [slit, np.sin(angle), np.cos(angle)], axis=1))
        # The film is a cylinder: across the track angles are lengths.
        across = np.arctan2(in_camera[..., 1], in_camera[..., 2])
        along_track = in_camera[..., 0] / np.hypot(in_camera[..., 1], in_camera[..., 2])
        # The compensation moves the film by the sine of the angle of the slit.
        moved = MOTION * x["motion"][:, None]
        return np.asarray(focal[..., None] * np.stack([
            along_track - slit[:, None] + moved * (np.sin(across) - np.sin(angle)[:, None]),
            across - angle[:, None]], axis=-1))


@dataclass(frozen=True, eq=False)
class FewOfPhoto(Method):
    """A camera of which nothing is known, for few points."""

    camera: type[Photo] = FrameCamera

    def declines(self, control: FitData) -> str | None:
        """Return why a camera cannot be fitted to the control, as a clause; None if it can.

        Reasons are lines, too few points, and heights that are missing or all on a plane.
        """
        features = control.features
        if len(features.lines) or len(features.points) < MIN_PHOTO_POINTS:
            return (f"it is for {MIN_PHOTO_POINTS} to {MAX_PHOTO_POINTS} control points, without "
                    "lines")
        if features.without_height():
            return "it needs heights"
        # Without relief tilt and focal length are not distinguished.
        if not control.heights and not self._has_relief(control):
            return "it needs heights that are not all on a plane"
        return None

    def _has_relief(self, control: FitData) -> bool:
        """Return whether heights differ enough from a plane to show in the image of a photo."""
        points = control.scaled.points
        model = self.camera().prepared(control.scaling, control.features.crs)
        assert isinstance(model, Photo)
        *plan, up = model.local(points.ground).T
        columns = np.column_stack([np.ones(len(up)), *plan])
        # A plane seen at a slant does not distinguish tilt from focal length, either.
        off_plane = up - columns @ np.linalg.lstsq(columns, up)[0]
        return bool(np.linalg.norm(off_plane) > RELIEF * np.sqrt(np.var(plan, axis=1).sum()))

    def tried(self, data: FitData) -> bool:
        """Return whether the points name this kind of camera as their sensor."""
        # With these cameras on every image auto would take several times as long.
        return sensor_of(data) == self.camera.name

    @staticmethod
    def _is_oblique(control: FitData) -> bool:
        """Return whether the nearest point is much closer to the camera than the middle is.

        False if the points support no view at all.
        """
        view = view_of(control.scaled.points)
        return view is not None and view.depth < OBLIQUE

    def fit(self, control: FitData) -> Fit:
        """Return the camera fitted to all features.

        Raises Undetermined if the fit does not converge, or its misfit is beyond `MAX_MISFIT`.
        """
        model = self.camera().prepared(control.scaling, control.features.crs)
        assert isinstance(model, Photo)
        # A negative determinant shows that the image is mirrored.
        model = self.camera(mirrored=bool(np.linalg.det(model.slopes_of(control.scaled)) < 0),
                            oblique=self._is_oblique(control))
        fitted = self.estimator.fit(model, control.features, control.scaling,
                                    np.ones(len(model.terms), dtype=bool),
                                    np.ones(len(control), dtype=bool))
        camera = fitted.model
        assert isinstance(camera, Photo)
        # Line, sample, turn and scale are free, and k - 4 of the k terms have priors: 2 n + k - 4
        # equations less k terms leave a cost of 2 n - 4 to be expected.
        misfit = camera.cost(control.scaled, fitted.adjustment.coefficients)[0] / (
            2 * len(control) - 4)
        if misfit > MAX_MISFIT:
            raise Undetermined(f"the points are not those of {self.title}: the misfit is "
                               f"{misfit:.1f} times what is expected, and the most is "
                               f"{MAX_MISFIT:g}",
                               hint="Check the points and heights, or choose another model.")
        return fitted

    def model(self, heights: bool) -> SensorModel | None:
        """Return the camera; None without heights."""
        return self.camera() if heights else None

    def size(self, heights: bool) -> float:
        """Return infinity, which puts the camera after all models that the features determine."""
        return np.inf

    def describe(self, fitted: Fit) -> str:
        """Return sentences on the camera of the fit: its steps, its focal length and its tilt."""
        values: dict[str, Any] = fitted.coefficients
        focal = FOCAL_PRIOR * np.exp(FOCAL_SPREAD * values["focal"])
        assert isinstance(fitted.model, Photo)
        tilt = np.degrees(np.arccos(np.prod(np.cos(fitted.model.tilt * np.array(
            [values["tilt-line"], values["tilt-sample"]])))))
        return (f"The points support {self.title}. The fit converged in "
                f"{fitted.adjustment.steps} steps, with a focal length of {focal:.1f} half "
                f"extents of the control and a tilt of {tilt:.1f} deg.")


PHOTO_METHODS = (
    FewOfPhoto("frame-camera", "a frame camera", short="frame camera", estimator=RobustFit(),
               has_prior=True, max_features=MAX_PHOTO_POINTS, camera=FrameCamera),
    FewOfPhoto("panoramic-camera", "a panoramic camera", short="panoramic camera",
               estimator=RobustFit(), has_prior=True, max_features=MAX_PHOTO_POINTS,
               camera=Panoramic))
"""Cameras of which nothing is known."""
