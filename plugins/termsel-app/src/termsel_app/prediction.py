"""Where a place of one pane is in the other, and how well that is known."""

from __future__ import annotations

from collections.abc import Sequence
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
_TURN = np.linspace(0.0, 2.0 * np.pi, 33)


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
        fit = self.result.exported if isinstance(self.result, termsel.Result) else self.result
        control: FeatureSet = fit.control
        return control

    def height(self) -> float:
        """Return the median height of the control; 0 where heights are not known."""
        heights = self._control.ground_vertices()[:, 2]
        return float(np.median(heights[np.isfinite(heights)])) if np.isfinite(heights).any() \
            else 0.0

    def ground(self, xy: Any) -> FloatArray:
        """Return the places that the model takes (n, 3) for places on the map (n, 2)."""
        if self.in_map:
            xy = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
            return np.column_stack([xy, np.zeros(len(xy))])
        ground = self.places.to_ground(xy)
        ground[:, 2] = np.where(np.isfinite(ground[:, 2]), ground[:, 2], self.height())
        return ground

    def to_image(self, xy: Any) -> FloatArray:
        """Return line and sample (n, 2) of places on the map; NaN where the model sees none."""
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
        surface = self._surface if self.places.has_heights and not self.in_map else self.height()
        ground = self.result.locate(image, surface)
        finite = np.isfinite(ground[:, :2]).all(axis=1)
        on_map = np.full((len(image), 2), np.nan)
        if finite.any():
            on_map[finite] = ground[finite, :2] if self.in_map \
                else self.places.to_map(ground[finite])
        return on_map

    def _surface(self, xy: FloatArray) -> FloatArray:
        heights = self.places.heights(np.asarray(xy, dtype=np.float64))
        return np.where(np.isfinite(heights), heights, self.height())

    def sigma(self, xy: Any) -> FloatArray:
        """Return standard deviations of line and sample [px] (n, 2) of places on the map."""
        sigma: FloatArray = self.result.sigma(self.ground(xy), measured=True)
        return sigma

    def in_image(self, xy: Sequence[float]) -> dict[str, Any] | None:
        """Return where a place of the map is in the image, and the ellipse that nine in ten hold.
        """
        position = self.to_image([xy])[0]
        if not np.isfinite(position).all():
            return None
        return {"place": position.tolist(), "ring": _finite(_ring(position, self.sigma([xy])[0])),
                "sigma": _known(self.sigma([xy])[0])}

    def on_map(self, image: Sequence[float]) -> dict[str, Any] | None:
        """Return where a place of the image is on the map, likewise."""
        position = self.to_map([image])[0]
        if not np.isfinite(position).all():
            return None
        sigma = self.sigma([position])[0]
        ring = _ring(np.asarray(image, dtype=np.float64), sigma)
        return {"place": position.tolist(), "sigma": _known(sigma),
                "ring": _finite(self.to_map(ring)) if np.isfinite(ring).all() else []}


def _ring(centre: FloatArray, sigma: FloatArray) -> FloatArray:
    # Errors of both axes are independent and normal: nine in ten lie within sqrt(2 ln 10) = 2.15
    # standard deviations.
    radius = NINE_IN_TEN * sigma
    circle = np.column_stack([np.sin(_TURN), np.cos(_TURN)])
    ring: FloatArray = centre + radius * circle
    return ring


def _finite(ring: FloatArray) -> list[list[float]]:
    return ring.tolist() if np.isfinite(ring).all() else []


def _known(sigma: FloatArray) -> float | None:
    value = float(np.hypot(*sigma))
    return value if np.isfinite(value) else None


def prediction_of(result: Result, features: FeatureSet, places: Places) -> Prediction:
    """Return the prediction by a result, or by a similarity of the map where it knows no errors.

    Three points determine an affine polynomial without any redundancy; the four parameters of a
    similarity leave two equations, which show how far the points are from one.
    """
    points = features.points
    if len(points) >= 3 and not np.isfinite(result.sigma(points.ground[:1])).all():
        used = points.take([role != "off" for role in points.roles])
        plane = places.to_map(used.ground)
        ground = np.column_stack([plane, np.full(len(used), np.nan)])
        flat = termsel.Points(used.ids, used.image, ground)
        try:
            return Prediction(termsel.fit(replace(features, points=flat, crs="local", rpc=None),
                                          "helmert2d"), places, in_map=True)
        except TermselError:  # a mirrored image is no similarity of the map
            return Prediction(result, places)
    return Prediction(result, places)
