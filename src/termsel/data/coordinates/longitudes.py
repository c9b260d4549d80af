"""Longitudes without a jump at the 180 degree meridian."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from termsel.core.errors import TermselError
from termsel.data.coordinates.crs import (
    geodetic_of,
    horizontal_crs,
    is_geocentric,
    is_geographic,
    normalise,
    transformation_between,
)
from termsel.data.features import BoolArray, FeatureSet, FloatArray

TURN = 360.0
"""A full turn [deg]."""


def unwrap_longitudes(lon: FloatArray) -> FloatArray:
    """Return longitudes [deg] (n,) that go on beyond 180 degrees where they would jump."""
    # They stay as they are unless they span more than half a turn and need not.
    if np.ptp(lon) <= TURN / 2:
        return lon
    # On the circle: the scene is all but the widest gap, if that is more than half of it.
    turned = np.sort(lon % TURN)
    gaps = np.diff(turned, append=turned[0] + TURN)
    widest = int(np.argmax(gaps))
    if gaps[widest] < TURN / 2:
        return lon
    # The scene begins after the gap; its middle is half of what the gap leaves further on.
    first = turned[(widest + 1) % len(turned)]
    return nearest_longitudes(lon, first + (TURN - gaps[widest]) / 2)


def nearest_longitudes(lon: FloatArray, middle: float) -> FloatArray:
    """Return longitudes [deg], (n,), each turned by whole turns to be the nearest to a middle."""
    return np.asarray(lon - TURN * np.round((lon - middle) / TURN))


def has_longitude_jump(features: FeatureSet) -> bool:
    """Return whether longitudes jump between control and check features at 180 degrees."""
    lon = features.ground_vertices()[_deciding_vertices(features), 0]
    return bool(len(lon)) and is_geographic(features.crs) and (unwrap_longitudes(lon) != lon).any()


def without_jump(features: FeatureSet) -> FeatureSet:
    """Return features whose longitudes go on beyond 180 degrees; the same object if none jump."""
    points = features.points
    lines = features.lines
    all_longitudes = features.ground_vertices()[:, 0]
    decides = _deciding_vertices(features)
    if not decides.any() or not is_geographic(features.crs):
        return features
    # Control and check points say where the scene is; the others follow, by whole turns.
    lon = unwrap_longitudes(all_longitudes[decides])
    if np.ptp(lon) > TURN:
        return features
    moved = nearest_longitudes(all_longitudes, float(lon.min() + lon.max()) / 2)
    if (moved == all_longitudes).all():
        return features
    of_points = points.ground.copy()
    of_lines = lines.ground.copy()
    of_points[:, 0] = moved[:len(points)]
    of_lines[..., 0] = moved[len(points):].reshape(-1, 2)
    return features.with_(points=replace(points, ground=of_points),
                          lines=replace(lines, ground=of_lines))


def _deciding_vertices(features: FeatureSet) -> BoolArray:
    """Return the ground vertices whose longitudes decide, (v,): independent points do not."""
    is_set_aside = np.isin(np.array(features.points.roles, dtype=object), ("independent", "off"))
    return np.concatenate([~is_set_aside, np.ones(2 * len(features.lines), dtype=bool)])


# Places of points that are the same in every CRS.

FINEST = 1e-5
"""Part of their extent to which places are rounded: coordinates are written with few digits, and
places on one meridian must stay on one."""


def to_globe(ground: FloatArray, crs: str) -> FloatArray:
    """Return longitude and latitude [deg], rounded, and height of places (n, 3) in any CRS.

    Places without a CRS, or whose CRS is not known without pyproj, are rounded as they are.
    """
    if not len(ground):
        return ground
    geodetic = _to_degrees(ground, normalise(crs))
    extent = np.ptp(geodetic[:, :2], axis=0).max(initial=0.0)
    # A single place has no extent to round by.
    if not 0.0 < extent < np.inf:
        return geodetic
    # By digits, so that an extent which differs by its rounding rounds alike.
    digits = -int(np.floor(np.log10(FINEST * extent)))
    geodetic[:, :2] = np.round(geodetic[:, :2], digits)
    return geodetic


def _to_degrees(ground: FloatArray, crs: str) -> FloatArray:
    """Return longitude, latitude [deg] and height of positions (n, 3), (n, 3).

    It is a copy of the positions where their CRS does not show degrees.
    """
    positions = ground.copy()
    try:
        if is_geocentric(crs):
            positions[:, :2] = transformation_between(crs, geodetic_of(crs))(ground)[:, :2]
        elif not is_geographic(crs):
            geodetic = horizontal_crs(geodetic_of(crs))
            turn = transformation_between(horizontal_crs(crs), geodetic, strict=False)
            # Heights are of no account in the plane, and may be unknown.
            positions[:, :2] = turn(np.nan_to_num(ground))[:, :2]
    except TermselError:  # without a CRS or without pyproj nothing shows
        return ground.copy()
    if not np.isfinite(positions[:, :2]).all():
        return ground.copy()
    positions[:, 0] = unwrap_longitudes(positions[:, 0])
    return positions
