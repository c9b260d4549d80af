"""Offsets and half-ranges that bring control features to [-1, 1], in the CRS of the fit."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from termsel.data.coordinates.crs import transformation_between
from termsel.data.coordinates.longitudes import turn_of, unwrap_longitudes, within_turn
from termsel.data.coordinates.metres import height_unit, plan_of
from termsel.data.features import FeatureSet, FloatArray, Lines, Points
from termsel.data.record.record import ScalingNumbers
from termsel.data.tables.tabular import replace_unchecked

_Table = TypeVar("_Table", Points, Lines)

_NO_PLACE = 1e6
"""Scaled coordinate of places that have none in the CRS of the fit."""

SHALLOW = 0.03
"""Least scale of heights, in metres as those of X and Y are. Relief is shallow next to a scene, and
heights that hardly differ must not become large numbers at other places."""


@dataclass(frozen=True)
class Scaling:
    """Ground and image offsets and scales.

    Line and sample share one scale, so that a residual in scaled units is the same in px
    along both axes and the normal of an image line keeps unit length.

    Parameters
    ----------
    ground_offset, ground_scale : tuple of 3 floats
        Mid-range and half-range of X, Y, Z, in the CRS of the fit.
    image_offset : tuple of 2 floats
        Mid-range of line and sample [px].
    image_scale : float
        The larger half-range of line and sample [px].
    crs, fit_crs : str
        CRS of the ground coordinates and CRS of the fit, if these differ; else both are
        empty.
    x_turn : float
        What a full turn around the Earth adds to X, after which a place is the same: 360 where X
        is a longitude [deg], the circumference in cylindrical projections; else 0.
    x_start : float, optional
        X at which a map of more than half of the world begins: places are moved by whole turns to
        lie within one from there. Without it they are moved next to the control.

    Examples
    --------
    >>> import termsel
    >>> scaling = termsel.FitData.of(termsel.simulate_scene("spot-isfahan")).scaling
    >>> scaling.ground([scaling.ground_offset])  # the middle of the control
    array([[0., 0., 0.]])
    """

    ground_offset: tuple[float, float, float]
    ground_scale: tuple[float, float, float]
    image_offset: tuple[float, float]
    image_scale: float
    crs: str = ""
    fit_crs: str = ""
    x_turn: float = 0.0
    x_start: float | None = None

    def ground(self, ground: ArrayLike) -> FloatArray:
        """Return scaled ground coordinates, (..., 3); unknown heights become 0.

        Longitudes, or x that repeats around the Earth, are first moved by whole turns to those
        nearest to the control, or on the map of the world. Places that have no coordinates in the
        CRS of the fit become very far ones, so that no model puts them into the image.
        """
        fitted = to_fit_crs(np.asarray(ground, dtype=np.float64), self.crs, self.fit_crs)
        if self.x_turn and self.x_start is not None:
            fitted = fitted.copy()
            fitted[..., 0] = within_turn(fitted[..., 0], self.x_start, self.x_turn)
        from_offset = fitted - self.ground_offset
        if self.x_turn and self.x_start is None:
            # Control that spans more than a turn keeps its places. The margin is for rounding,
            # which must not move places that are half a turn away.
            reach = max(self.x_turn / 2, self.ground_scale[0]) * (1 + 1e-9)
            x = from_offset[..., 0]
            # No turn brings an infinite x nearer.
            is_moved = (np.abs(x) > reach) & np.isfinite(x)
            x -= self.x_turn * np.round(np.where(is_moved, x, 0.0) / self.x_turn)
        scaled = from_offset / self.ground_scale
        return scaled if np.isfinite(scaled).all() else np.nan_to_num(
            scaled, nan=0.0, posinf=_NO_PLACE, neginf=-_NO_PLACE)

    def unscaled(self, ground: ArrayLike) -> FloatArray:
        """Return ground coordinates from scaled ones, (..., 3)."""
        fitted = np.asarray(ground) * self.ground_scale + self.ground_offset
        return to_fit_crs(fitted, self.fit_crs, self.crs)

    def image(self, image: ArrayLike) -> FloatArray:
        """Return scaled image coordinates, (..., 2)."""
        return np.asarray((np.asarray(image) - self.image_offset) / self.image_scale)

    def pixels(self, scaled: ArrayLike) -> FloatArray:
        """Return image coordinates [px] from scaled ones, (..., 2)."""
        return np.asarray(np.asarray(scaled) * self.image_scale + self.image_offset)

    def points(self, points: _Table) -> _Table:
        """Return points, or lines, in scaled coordinates."""
        sigma = None if points.sigma is None else points.sigma / self.image_scale
        return replace_unchecked(points, image=self.image(points.image),
                                 ground=self.ground(points.ground), sigma=sigma)

    @lru_cache(maxsize=8)  # noqa: B019 - a scaling is a value: many models are fitted to one control
    def features(self, features: FeatureSet) -> FeatureSet:
        """Return the features in scaled coordinates; cached."""
        return replace_unchecked(features, points=self.points(features.points),
                                 lines=self.points(features.lines))

    def numbers(self) -> ScalingNumbers:
        """Return the scaling as the record of a run holds it."""
        x_offset, y_offset, z_offset = self.ground_offset
        x_scale, y_scale, z_scale = self.ground_scale
        return ScalingNumbers(
            line_offset=self.image_offset[0], line_scale=self.image_scale,
            sample_offset=self.image_offset[1], sample_scale=self.image_scale,
            x_offset=x_offset, y_offset=y_offset, z_offset=z_offset,
            x_scale=x_scale, y_scale=y_scale, z_scale=z_scale,
            crs=self.crs if self.fit_crs else "", fit_crs=self.fit_crs, x_turn=self.x_turn,
            x_start=self.x_start)

    @classmethod
    def from_numbers(cls, numbers: ScalingNumbers) -> Scaling:
        """Return the scaling that `numbers` returned these for."""
        return cls(ground_offset=(numbers.x_offset, numbers.y_offset, numbers.z_offset),
                   ground_scale=(numbers.x_scale, numbers.y_scale, numbers.z_scale),
                   image_offset=(numbers.line_offset, numbers.sample_offset),
                   image_scale=numbers.line_scale, crs=numbers.crs, fit_crs=numbers.fit_crs,
                   x_turn=numbers.x_turn, x_start=numbers.x_start)


def to_fit_crs(ground: FloatArray, crs: str, fit_crs: str) -> FloatArray:
    """Return ground coordinates (..., 3) in the CRS in which a model is fitted.

    They are the same array if `fit_crs` is "". NaN stays NaN. Places outside that CRS become
    infinite instead of an error, as maps may have corners there.
    """
    if not (crs and fit_crs):
        return ground
    rows = ground.reshape(-1, 3)
    fitted = np.array(transformation_between(crs, fit_crs, strict=False, for_fit=True)(rows))
    fitted[np.isnan(rows)] = np.nan
    return fitted.reshape(ground.shape)


def make_scaling(features: FeatureSet) -> Scaling:
    """Return the scaling that brings these control features to [-1, 1].

    Each axis of the ground is shifted to the middle of the features and divided by half of its
    extent, so that the powers of all terms are of one size. Line and sample have one scale, as a
    pixel is a pixel in both. Longitudes are continued beyond 180 degrees first. Heights are divided
    by at least `SHALLOW` of the plane's half extent, so that errors of flat ground do not become
    terms of full size; blank heights count as 0, and their axis as 1. If features have a `fit_crs`,
    the scaling is that of their coordinates in it.
    """
    crs_pair = (features.crs, features.fit_crs) if features.fit_crs else ("", "")
    ground = to_fit_crs(features.ground_vertices(), *crs_pair)
    image = features.image_vertices()
    turn = turn_of(features.fit_crs or features.crs)
    start = None
    if turn and features.x_start is not None:
        start = _start_of_turn(features, features.x_start, turn)
        ground = np.column_stack([within_turn(ground[:, 0], start, turn), ground[:, 1:]])
    elif turn:
        ground = np.column_stack([unwrap_longitudes(ground[:, 0], turn), ground[:, 1:]])
    finite = np.where(np.isnan(ground), np.nanmin(ground[:, :2]), ground)
    has_blank_height = bool(np.isnan(ground[:, 2]).any())
    # One blank height makes all 0: no model of these features uses heights.
    if has_blank_height:
        finite[:, 2] = 0.0
    low = finite.min(axis=0)
    high = finite.max(axis=0)
    half_extents = (high - low) / 2
    plan = None if has_blank_height else plan_of(features.fit_crs or features.crs, finite)
    if plan is not None:
        half_extents[2] = max(half_extents[2], SHALLOW * np.ptp(plan, axis=0).max() / 2)
    image_middle = (image.max(axis=0) + image.min(axis=0)) / 2
    image_scale = float((np.ptp(image, axis=0) / 2).max())
    # An axis in which all features are at one place has the scale 1.
    x_offset, y_offset, z_offset = ((low + high) / 2).tolist()
    x_scale, y_scale, z_scale = np.where(half_extents > 0, half_extents, 1.0).tolist()
    return Scaling((x_offset, y_offset, z_offset), (x_scale, y_scale, z_scale),
                   (float(image_middle[0]), float(image_middle[1])),
                   image_scale if image_scale > 0 else 1.0, *crs_pair, turn, start)


def _start_of_turn(features: FeatureSet, x_start: float, turn: float) -> float:
    """Return the X, in the CRS of the fit, at which a map of more than half of the world begins.

    `x_start` is the X in the CRS of the features, and `turn` what a full turn adds to X in that of
    the fit.
    """
    if not features.fit_crs:
        return x_start
    # The middle of the map is the same place in both; X is proportional to the longitude.
    middle = np.array([[x_start + turn_of(features.crs) / 2, 0.0, 0.0]])
    return float(to_fit_crs(middle, features.crs, features.fit_crs)[0, 0]) - turn / 2


def metres_of(features: FeatureSet, scaling: Scaling) -> FloatArray | None:
    """Return the metres of a scaled step along X, Y and Z, (3,); None for geocentric coordinates.

    If the unit of X and Y is unknown, their steps are in this unit.
    """
    crs = features.fit_crs or features.crs
    # The ends of one scaled step along each axis, from the middle of the box.
    step_ends = np.array(scaling.ground_offset) + np.diag(scaling.ground_scale)
    plan = plan_of(crs, np.concatenate([[scaling.ground_offset], step_ends]))
    if plan is None:
        return None
    steps = np.linalg.norm(plan[1:3] - plan[0], axis=1)
    return np.array([*steps, scaling.ground_scale[2] * height_unit(crs)])
