"""Where an image lies on the Earth."""

from __future__ import annotations

from typing import Any

import numpy as np

from termsel import Fit, Result
from termsel.toolkit import FloatArray
from termsel.toolkit.coordinates import to_wgs84
from termsel.toolkit.models import ground_where_held, image_places

_N_PER_SIDE = 9
"""Number of positions along either side of the image, both corners included."""

_TURN = 360.0
"""A full turn [deg]."""


def outline_of(result: Result) -> FloatArray:
    """Return the outline of an image on the ground: longitude and latitude, shape (n, 2) [deg].

    It is counter-clockwise, its last position is its first, and its height is the middle one of the
    control. If the size of the image is not known, the rectangle around the features in it is taken
    for the image. If the model does not hold all along the borders of the image, as in an oblique
    view, the outline goes around the ground where it holds. If some of these positions have no
    ground, it is the rectangle around the features on the ground. Longitudes go on beyond 180
    degrees, either way, where the image does; around a pole the outline goes once around the Earth,
    and over the pole.
    """
    features = result.features
    fitted = result.exported
    measured = features.image_vertices()
    low = measured.min(axis=0)
    high = measured.max(axis=0)
    if features.image_size is not None:
        low = np.zeros(2)
        high = np.array(features.image_size) - 1.0
    # In shares of the image: down the first samples, along the last lines, and back.
    share_of_side = np.linspace(0.0, 1.0, _N_PER_SIDE)[:-1]
    zero = np.zeros(_N_PER_SIDE - 1)
    end = np.ones(_N_PER_SIDE - 1)
    places_around = np.concatenate([np.column_stack(pair) for pair in (
        (zero, share_of_side), (share_of_side, end), (end, 1 - share_of_side),
        (1 - share_of_side, zero))])
    height = float(fitted.ground_box()[0][2])
    ground = fitted.locate(low + places_around * (high - low), np.full(len(places_around), height))
    if fitted.view is not None and not fitted.holds(ground).all():
        ground = _hull_of_valid_ground(fitted, height)
    lonlat = to_wgs84(features.crs)(ground)[:, :2]
    # Beyond the horizon there is no ground, so the features stand for the image.
    if not np.isfinite(lonlat).all():
        control_lonlat = to_wgs84(features.crs)(np.nan_to_num(result.residuals.ground))[:, :2]
        control_lonlat[:, 0] = _around_their_mean(control_lonlat[:, 0])
        low_corner = control_lonlat.min(axis=0)
        high_corner = control_lonlat.max(axis=0)
        lonlat = np.array([low_corner, [high_corner[0], low_corner[1]], high_corner,
                           [low_corner[0], high_corner[1]]])
    lonlat = _without_jump(lonlat)
    x, y = lonlat.T
    # By the shoelace formula the area of a clockwise outline is negative.
    if x @ np.roll(y, -1) - y @ np.roll(x, -1) < 0:
        lonlat = lonlat[::-1]
    return np.asarray(np.round(np.concatenate([lonlat, lonlat[:1]]), 9))


def _around_their_mean(lon: FloatArray) -> FloatArray:
    """Return longitudes (n,) [deg] within half a turn of their mean direction."""
    mean = np.degrees(np.angle(np.exp(1j * np.radians(lon)).mean()))
    return np.asarray(mean + (lon - mean + _TURN / 2) % _TURN - _TURN / 2)


def _without_jump(lonlat: FloatArray) -> FloatArray:
    """Return the outline (n, 2) with longitudes that go on from each position to the next.

    Around a pole they end a full turn from where they began: then two positions at the pole follow.
    """
    # A step of more than half a turn is taken for one across 180 degrees.
    lon = np.unwrap(lonlat[:, 0], period=_TURN)
    lat = lonlat[:, 1]
    # From the last position back to the first, the short way.
    turned = lon[-1] + (lon[0] - lon[-1] + _TURN / 2) % _TURN - _TURN / 2 - lon[0]
    if abs(turned) > _TURN / 2:
        pole = np.copysign(90.0, lat.mean())
        lon = np.append(lon, [lon[0] + turned, lon[0] + turned, lon[0]])
        lat = np.append(lat, [lat[0], pole, pole])
    return np.column_stack([lon - _TURN * np.round(np.median(lon) / _TURN), lat])


def bounds_of(outline: FloatArray) -> tuple[float, float, float, float]:
    """Return west, south, east and north of an outline (n, 2) [deg].

    The west is a larger longitude than the east where the outline crosses 180 degrees, as RFC 7946
    (section 5.2) has it. An outline around the whole Earth goes from -180 to 180.
    """
    (west, south), (east, north) = outline.min(axis=0).tolist(), outline.max(axis=0).tolist()
    if east - west >= _TURN:
        return -180.0, south, 180.0, north
    return _within_half_turn(west, -1.0), south, _within_half_turn(east, 1.0), north


def _within_half_turn(longitude: float, at_limit: float) -> float:
    """Return a longitude between -180 and 180; `at_limit` is the sign of 180 itself."""
    turned = (longitude + _TURN / 2) % _TURN - _TURN / 2
    return at_limit * _TURN / 2 if abs(turned) == _TURN / 2 else round(turned, 9)


def geometry_of(outline: FloatArray) -> dict[str, Any]:
    """Return an outline (n, 2), longitude and latitude [deg], as a GeoJSON geometry.

    It is a Polygon, or a MultiPolygon where the outline crosses 180 degrees: it is cut there, as
    RFC 7946 (section 3.1.9) has it.
    """
    if np.abs(outline[:, 0]).max() <= _TURN / 2:
        return {"type": "Polygon", "coordinates": [outline.tolist()]}
    import shapely
    from shapely.geometry.polygon import orient

    parts = []
    # What lies beyond 180 degrees is within them after a full turn either way. An outline over a
    # pole touches itself there, which `make_valid` corrects.
    for turns in (-1.0, 0.0, 1.0):
        moved = shapely.make_valid(shapely.Polygon(outline - [turns * _TURN, 0.0]))
        part = shapely.intersection(moved, shapely.box(-180.0, -90.0, 180.0, 90.0))
        parts += [orient(polygon) for polygon in shapely.get_parts(part)
                  if polygon.geom_type == "Polygon" and polygon.area > 0]
    rings = [[np.round(shapely.get_coordinates(polygon), 9).tolist()] for polygon in parts]
    if len(rings) == 1:
        return {"type": "Polygon", "coordinates": rings[0]}
    return {"type": "MultiPolygon", "coordinates": rings}


def _hull_of_valid_ground(fitted: Fit, height: float) -> FloatArray:
    """Return the convex hull, (n, 3), of the ground at a height [m] on which a model holds.

    Pixels beyond the horizon have no ground, and are left out.
    """
    from scipy.spatial import ConvexHull  # takes long to import

    ground = ground_where_held(fitted, image_places(fitted), height)
    ground = ground[np.isfinite(ground).all(axis=1)]
    return np.asarray(ground[ConvexHull(ground[:, :2]).vertices])
