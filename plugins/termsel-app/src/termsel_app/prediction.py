"""Where a place of one pane is in the other, and how well that is known."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

import termsel
from termsel import TermselError

if TYPE_CHECKING:
    from termsel import FeatureSet, Result
    from termsel.toolkit import FloatArray
    from termsel_app.places import Places

NINE_IN_TEN = float(np.sqrt(2.0 * np.log(10.0)))
"""Radius of the circle with nine in ten of normal errors, in standard deviations of an axis."""
_ANGLES = np.linspace(0.0, 2.0 * np.pi, 33)


@dataclass(frozen=True)
class _FilledHeights:
    """Heights of the ground by the DEM of `places`, and one height where it has none."""

    places: Places
    height: float

    def __call__(self, xy: FloatArray) -> FloatArray:
        """Return the heights of ground places x and y (n, 2), shape (n,); all are finite."""
        heights = self.places.heights(np.asarray(xy, dtype=np.float64))
        return np.where(np.isfinite(heights), heights, self.height)

    def highest(self, corners: FloatArray) -> float:
        """Return the greatest height in the box around ground places (n, 2)."""
        return float(np.fmax(self.places.highest(corners), self.height))

    def spacing(self) -> float:
        """Return the distance of neighbouring heights of the DEM."""
        return self.places.spacing()


@dataclass(frozen=True)
class Prediction:
    """A fitted model between image and map.

    Parameters
    ----------
    result : termsel.Result or termsel.Fit
    places : Places
    in_map : bool
        Whether the model is of coordinates of the map rather than of the ground.
    """

    result: Any
    places: Places
    in_map: bool = False

    @property
    def _control(self) -> FeatureSet:
        """The control that the model is fitted to."""
        fit = self.result.exported if isinstance(self.result, termsel.Result) else self.result
        control: FeatureSet = fit.control
        return control

    def height(self) -> float:
        """Return the median height of the control [m]; 0 where no height is known."""
        heights = self._control.ground_vertices()[:, 2]
        if np.isfinite(heights).any():
            return float(np.median(heights[np.isfinite(heights)]))
        return 0.0

    def ground(self, xy: Any) -> FloatArray:
        """Return the ground coordinates (n, 3) that the model takes for places on the map (n, 2).

        Heights are those of the DEM, or the median of the control where it has none. For a model
        of the map they are 0, and x and y those of the map.
        """
        if self.in_map:
            xy = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
            return np.column_stack([xy, np.zeros(len(xy))])
        ground = self.places.to_ground(xy)
        ground[:, 2] = np.where(np.isfinite(ground[:, 2]), ground[:, 2], self.height())
        return ground

    def to_image(self, xy: Any) -> FloatArray:
        """Return line and sample (n, 2) of places on the map (n, 2).

        They are NaN where the place has no ground coordinates or the model does not see it.
        """
        ground = self.ground(xy)
        finite = np.isfinite(ground).all(axis=1)
        image = np.full((len(ground), 2), np.nan)
        if finite.any():
            image[finite] = self.result.project(ground[finite])
        return image

    def to_map(self, image: Any) -> FloatArray:
        """Return the places on the map (n, 2) of line and sample (n, 2); NaN where there are none.
        """
        image = np.asarray(image, dtype=np.float64).reshape(-1, 2)
        surface: _FilledHeights | float = self.height()
        if self.places.has_heights and not self.in_map:
            surface = _FilledHeights(self.places, self.height())
        ground = self.result.locate(image, surface)
        finite = np.isfinite(ground[:, :2]).all(axis=1)
        xy = np.full((len(image), 2), np.nan)
        if finite.any():
            if self.in_map:
                xy[finite] = ground[finite, :2]
            else:
                xy[finite] = self.places.to_map(ground[finite])
        return xy

    def sigma(self, xy: Any) -> FloatArray:
        """Return standard deviations of line and sample [px] (n, 2) of places on the map."""
        sigma: FloatArray = self.result.sigma(self.ground(xy), measured=True)
        return sigma

    def in_image(self, xy: Sequence[float]) -> dict[str, Any] | None:
        """Return where a place of the map (x, y) lies in the image; None where the model sees none.

        `place` is its line and sample, `sigma` the standard deviation of both together [px], None
        if it is not known, and `ring` the ellipse (lines and samples) within which nine in ten true
        places lie; empty if sigma is not known.
        """
        position = self.to_image([xy])[0]
        if not np.isfinite(position).all():
            return None
        return {"place": position.tolist(),
                "ring": _finite_ring(_error_ellipse(position, self.sigma([xy])[0])),
                "sigma": _length_if_finite(self.sigma([xy])[0])}

    def on_map(self, image: Sequence[float]) -> dict[str, Any] | None:
        """Return where a place of the image (line, sample) lies on the map; None if nowhere.

        `place` is its x and y, `sigma` the standard deviation of line and sample together [px, in
        the image], None if it is not known, and `ring` the ellipse of the image within which nine
        in ten true places lie, carried to the map; empty if sigma is not known or the ellipse
        leaves the map.
        """
        position = self.to_map([image])[0]
        if not np.isfinite(position).all():
            return None
        sigma = self.sigma([position])[0]
        ring = _error_ellipse(np.asarray(image, dtype=np.float64), sigma)
        return {"place": position.tolist(), "sigma": _length_if_finite(sigma),
                "ring": _finite_ring(self.to_map(ring)) if np.isfinite(ring).all() else []}


def _error_ellipse(centre: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return the ellipse (m, 2) around a place that holds nine in ten errors of `sigma` (2,).

    Errors of both axes are taken as independent and normal.
    """
    radius = NINE_IN_TEN * sigma
    circle = np.column_stack([np.sin(_ANGLES), np.cos(_ANGLES)])
    ring: FloatArray = centre + radius * circle
    return ring


def _finite_ring(ring: FloatArray) -> list[list[float]]:
    """Return a ring as lists; an empty one if any vertex is not finite."""
    return ring.tolist() if np.isfinite(ring).all() else []


def _length_if_finite(sigma: FloatArray) -> float | None:
    """Return the standard deviation of both coordinates together; None if it is not finite."""
    value = float(np.hypot(*sigma))
    return value if np.isfinite(value) else None


def prediction_of(result: Result, features: FeatureSet, places: Places) -> Prediction:
    """Return the prediction by a result, or by a similarity if the result has no deviations.

    A result has no standard deviations (its sigma is NaN) if its equations have no redundancy, such
    as those of three points and an affine polynomial. Then the similarity `helmert2d`, fitted to
    the points in map coordinates, takes its place: its four parameters leave two of six equations,
    which show errors. The result itself is used if it has fewer than three points, or if that fit
    fails.
    """
    points = features.points
    if len(points) >= 3 and not np.isfinite(result.sigma(points.ground[:1])).all():
        used = points.take([role != "off" for role in points.roles])
        plane = places.to_map(used.ground)
        ground = np.column_stack([plane, np.full(len(used), np.nan)])
        points_on_map = termsel.Points(used.ids, used.image, ground)
        # The fit fails for a mirrored image, which is no similarity of the map.
        with suppress(TermselError):
            similarity = termsel.fit(replace(features, points=points_on_map, crs="local", rpc=None),
                                     "helmert2d")
            return Prediction(similarity, places, in_map=True)
    return Prediction(result, places)
