"""The features that models are fitted to, with their scaling and their relief.

Heights serve where the control shows what a metre of height does better than physics alone does:
the view of a camera from the air or from space is inclined by some 27 degrees, so that a metre of
height moves an image by about half as much as a metre on the ground. Heights are flat where all
that they could do is less than what can be measured. They are so, too, where only one or two
features are off a plane: such a feature has the leverage 1, so that what its height does cannot be
told from an error, and no other feature predicts it. Of two such features each has the other alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from termsel.data.coordinates.metres import height_unit, plan_of
from termsel.data.coordinates.places import Lattice, lattice_of
from termsel.data.features import BoolArray, FeatureSet, FloatArray, IntArray, Points
from termsel.data.scaling import Scaling, make_scaling, metres_of, to_fit_crs
from termsel.data.view import view_of

FLAT = 1e-8
"""Scaled distance from a plane up to which heights are taken to lie on it: rounding."""

PARALLAX = 0.5
"""Standard deviation of what a metre of height does in an image, by a metre on the ground: the
tangent of the angle of view. That of a satellite is seldom above 0.6, of a photo or of radar 1."""

MEASURED = 0.5
"""Standard deviation of a measurement in an image [px], or MEASURED_PART of its half-range."""

MEASURED_PART = 1e-3

OTHER = 1.5
"""How many times as far off a plane other places are whose heights are not those of the control."""

MANY = 12
BEST = 5 / 6
"""Number of points from which on they show how well they are measured, and the part by which."""

RELIEF_FEATURES = 8
"""Number of features from which on two of them may carry the relief. Without two of fewer, hardly
anything is left that could be off a plane."""


@dataclass(frozen=True, eq=False)
class FitData:
    """Features that models are fitted to, whatever the roles of the points.

    Parameters
    ----------
    features : FeatureSet
    scaling : Scaling
        That of these features.
    heights : bool
        Whether models with heights are fitted; else plane ones.

    Examples
    --------
    >>> import termsel
    >>> data = termsel.FitData.of(termsel.simulate_scene("spot-isfahan"))
    >>> len(data), data.heights
    (35, True)
    """

    features: FeatureSet
    scaling: Scaling
    heights: bool

    @classmethod
    def of(cls, features: FeatureSet, heights: bool | None = None) -> Self:
        """Return features with their scaling; by default with heights where these differ."""
        control = cls(features, make_scaling(features), bool(heights))
        if heights is not None:
            return control
        return replace(control, heights=heights_differ(control))

    def __len__(self) -> int:
        return len(self.features)

    @property
    def lattice(self) -> Lattice | None:
        """The lattice that the points form, as a processor computes them; None if they form none.
        """
        return lattice_of(self.features)

    @property
    def scaled(self) -> FeatureSet:
        """The features in scaled coordinates."""
        return self.scaling.features(self.features)

    def take(self, mask: BoolArray) -> Self:
        """Return some of the features, with a scaling of their own; the same object if all are."""
        return self if mask.all() else self.of(self.features.take(mask), self.heights)


def heights_differ(control: FitData) -> bool:
    """Return whether all features have heights, and these differ enough to show their effect."""
    if control.features.without_height():
        return False
    plane, z, _ = _plane_columns(control)
    off_plane_heights = _distances_about_plane(plane, z)[0]
    if not _do_heights_differ(off_plane_heights):
        return False
    return _show_effect(off_plane_heights, *_effects_and_noise(control))


def errors_hide_heights(control: FitData) -> bool:
    """Return whether heights show no effect only because the errors of the points are large.

    They would show it if the points were measured as well as usual. Rows of a table that are
    shifted, for example, make such large errors.
    """
    plane, z, _ = _plane_columns(control)
    off_plane_heights = _distances_about_plane(plane, z)[0]
    effects, noise = _effects_and_noise(control)
    return (_show_effect(off_plane_heights, effects, _usual_noise(control))
            and not _show_effect(off_plane_heights, effects, noise))


def relief_carriers(control: FitData, limit: int = 2) -> tuple[str, ...]:
    """Return the ids of the one or two features that make all relief; () if more features do.

    All ids are returned if the heights show no effect even with all features. Heights must be
    known. `limit`, 1 or 2, is the largest number of features that is tried; among fewer than
    `RELIEF_FEATURES` it is 1.
    """
    limit = limit if len(control) >= RELIEF_FEATURES else 1
    plane, z, feature_of_vertex = _plane_columns(control)
    off_plane_heights, free = _distances_about_plane(plane, z)
    if not _do_heights_differ(off_plane_heights):
        return control.features.ids
    effects, noise = _effects_and_noise(control)
    if not _show_effect(off_plane_heights, effects, noise):
        return control.features.ids
    # One feature after another is removed, each time the one without which the heights are
    # closest to a plane.
    carriers: list[int] = []
    remains = np.ones(len(z), dtype=bool)
    while len(carriers) < limit:
        # Without a vertex the sum of squares falls by its squared residual over 1 - leverage.
        decrease = np.bincount(feature_of_vertex[remains], off_plane_heights**2 / free,
                               minlength=len(control))
        carriers.append(int(np.argmax(decrease)))
        remains &= feature_of_vertex != carriers[-1]
        off_plane_heights, free = _distances_about_plane(plane[remains], z[remains])
        if not (_do_heights_differ(off_plane_heights)
                and _show_effect(off_plane_heights, effects[remains], noise)):
            if len(carriers) == 2 and _view_confirms_heights(control, noise):
                return ()
            return tuple(control.features.ids[i] for i in carriers)
    return ()


def _view_confirms_heights(control: FitData, noise: float) -> bool:
    """Return whether points are seen, but for noise [px], as a camera with square pixels does.

    Two points off a plane have four image coordinates for the three unknowns by which heights enter
    a view. Square pixels are two conditions more. So the height of each point is tested by the
    other. False is returned with lines, and if the unit of the ground is unknown.
    """
    metres = metres_of(control.features, control.scaling)
    if len(control.features.lines) or metres is None:
        return False
    view = view_of(control.scaled.points)
    return (view is not None and view.matrix.shape[1] == 4
            and view.sigma * control.scaling.image_scale <= noise
            and view.has_square_pixels(metres))


def distance_off_plane(control: FitData, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far places (m, 3) are off the plane of the control's heights, and the effect.

    The distances (m,) are in units of height, the effect (m,) is the standard deviation of what
    they do to the image [px]. Both are 0 for a place without a height, and for all places if a
    height of the control is unknown, or if the control shows what heights do to the image. Features
    that alone make the relief have no influence on the plane.
    """
    zeros = np.zeros(len(ground))
    carriers = () if control.features.without_height() else relief_carriers(control)
    if not carriers or not np.isfinite(_effect_of_height(control)):
        return zeros, zeros
    (plane, z, feature_of_vertex) = _plane_columns(control)
    scaled = control.scaling.ground(ground)
    # If all features are carriers, the plane is fitted to all.
    ids_of_vertices = np.array(control.features.ids)[feature_of_vertex]
    in_plane = ~np.isin(ids_of_vertices, carriers) | (len(carriers) == len(control))
    plane_heights = _plane_columns_at(scaled) @ np.linalg.lstsq(plane[in_plane], z[in_plane])[0]
    distances = np.where(np.isnan(ground[:, 2]), 0.0, np.abs(scaled[:, 2] - plane_heights))
    return (distances * control.scaling.ground_scale[2],
            distances * _effects_of_height(control, scaled))


def with_usual_heights(control: FitData, ground: FloatArray) -> FloatArray:
    """Return places (m, 3) with heights as far off a plane as the control's are, in mean squares.

    The same array is returned, unchanged, if its heights are at most `OTHER` times as far off, if a
    height of the control is unknown, and in a geocentric CRS.
    """
    if control.features.without_height() or not np.isfinite(_effect_of_height(control)):
        return ground
    (plane, z, _) = _plane_columns(control)
    scaled = control.scaling.ground(ground)
    coefficients = np.linalg.lstsq(plane, z)[0]
    # Places without a height count as if on the plane.
    distances = np.nan_to_num(scaled[:, 2] - _plane_columns_at(scaled) @ coefficients)
    usual_rms = np.linalg.norm(z - plane @ coefficients) / np.sqrt(max(len(z) - plane.shape[1], 1))
    rms = np.linalg.norm(distances) / np.sqrt(max(len(distances), 1))
    if rms <= max(OTHER * usual_rms, FLAT):
        return ground
    # Heights go towards the plane, so that their root mean square about it becomes the usual one.
    distances *= (1.0 - usual_rms / rms) * control.scaling.ground_scale[2]
    return ground - np.pad(distances[:, None], ((0, 0), (2, 0)))


def is_off_plane(points: Points) -> bool:
    """Return whether scaled points with heights lie on no plane, but for rounding."""
    plane = _plane_columns_at(points.ground)
    return _do_heights_differ(_distances_about_plane(plane, points.ground[:, 2])[0])


def _do_heights_differ(off_plane_heights: FloatArray) -> bool:
    """Return whether scaled heights are off a plane, but for rounding."""
    return bool(np.abs(off_plane_heights).max(initial=0.0) > FLAT)


def _show_effect(off_plane_heights: FloatArray, effects: FloatArray, noise: float) -> bool:
    """Return whether scaled heights off a plane, (n,), do more than the noise of a measurement.

    `effects` (n,) are what a scaled height of 1 does to the image at each of them [px]; `noise` is
    in px, too.
    """
    return bool(np.linalg.norm(off_plane_heights * effects) > noise)


def _effects_and_noise(control: FitData) -> tuple[FloatArray, float]:
    """Return the effect of a scaled height of 1 at each vertex [px], (n,), and the noise [px]."""
    scaled = control.scaling.ground(control.features.ground_vertices())
    return _effects_of_height(control, scaled), _noise_of_measurement(control)


def _usual_noise(control: FitData) -> float:
    """Return the standard deviation of a measurement as usual [px]."""
    return min(MEASURED, MEASURED_PART * control.scaling.image_scale)


def _noise_of_measurement(control: FitData) -> float:
    """Return the standard deviation of a measurement [px]: the usual one, or a larger one shown.

    `MANY` points show it, without lines, by the residuals of a quadratic polynomial or of a view,
    whichever are smaller. The points that fit worst are left out, as blunders would hide what
    heights do.
    """
    usual_noise = _usual_noise(control)
    points = control.scaled.points
    if len(control.features.lines) or len(points) < MANY:
        return usual_noise
    x, y, z = points.ground.T
    columns = np.stack([x**0, x, y, z, x * x, x * y, y * y], axis=1)
    image = points.image
    for count in (len(points), round(BEST * len(points))):
        # Each residual is divided by 1 - leverage, so that a point that bends the polynomial to
        # itself is not taken for a good one.
        q = np.linalg.qr(columns)[0]
        residuals = image - q @ (q.T @ image)
        free = np.maximum(1.0 - (q**2).sum(axis=1), np.finfo(float).eps)
        best = np.argsort(np.linalg.norm(residuals, axis=1) / free)[:round(BEST * count)]
        square = (residuals**2).sum() / (len(image) - columns.shape[1]) / 2
        columns = columns[best]
        image = image[best]
    # A quadratic polynomial does not describe an oblique view: the residuals of the projection
    # show how well its points are measured.
    view = view_of(points)
    noise = float(np.sqrt(square))
    if view is not None:
        noise = min(noise, view.noise)
    return max(usual_noise, noise * control.scaling.image_scale)


def _effects_of_height(control: FitData, scaled: FloatArray) -> FloatArray:
    """Return the standard deviation of what a scaled height of 1 does at scaled places [px], (n,).

    In an oblique view it is larger the nearer a place is to the camera.
    """
    view = view_of(control.scaled.points)
    effect = _effect_of_height(control)
    if view is None or not np.isfinite(effect):
        return np.full(len(scaled), effect)
    # The larger of the scales along X and Y is the one across the direction of view.
    metres = metres_of(control.features, control.scaling)
    assert metres is not None
    px_per_metre = view.magnification(scaled) * control.scaling.image_scale / metres[:2]
    return np.asarray(PARALLAX * metres[2] * px_per_metre.max(axis=1))


def _effect_of_height(control: FitData) -> float:
    """Return the standard deviation of what a scaled height of 1 does to the image [px].

    It is infinite for geocentric coordinates, whose Z is no height, and if all features are at one
    place.
    """
    features = control.features
    plan = plan_of(features.fit_crs or features.crs, to_fit_crs(
        features.ground_vertices(), features.crs, features.fit_crs))
    if plan is None:
        return np.inf
    # The scale of the image is taken as the ratio of the scatter in the image to that on the
    # ground.
    extent_in_metres = np.sqrt(plan.var(axis=0).sum())
    extent_in_image = np.sqrt(features.image_vertices().var(axis=0).sum())
    metres = control.scaling.ground_scale[2] * height_unit(features.fit_crs or features.crs)
    if not extent_in_metres:
        return np.inf
    return float(PARALLAX * metres * extent_in_image / extent_in_metres)


def _plane_columns(control: FitData) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return, of the v vertices, columns of a plane (v, 3), scaled heights (v,) and feature (v,).
    """
    scaled = control.scaling.ground(control.features.ground_vertices())
    return _plane_columns_at(scaled), scaled[:, 2], control.features.vertex_feature


def _plane_columns_at(scaled: FloatArray) -> FloatArray:
    """Return 1, X and Y of scaled places, (v, 3)."""
    return np.column_stack([np.ones(len(scaled)), scaled[:, :2]])


def _distances_about_plane(plane: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far heights (v,) are off the closest plane, (v,), and 1 - leverage of each, (v,).
    """
    q = np.linalg.qr(plane)[0]
    return z - q @ (q.T @ z), np.maximum(1.0 - (q**2).sum(axis=1), np.finfo(float).eps)
