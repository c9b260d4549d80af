"""Small distances on the ground in metres, whatever the CRS."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from termsel.data.coordinates.crs import (
    ellipsoid_of,
    is_geocentric,
    is_geographic,
    metres_per_height,
    metres_per_unit,
)
from termsel.data.features import FloatArray


def in_metres(crs: str, positions: FloatArray, offsets: FloatArray) -> FloatArray | None:
    """Return offsets (n, 2) to east and north of positions in metres; None if the unit is unknown.
    """
    if _kind(crs)[0]:
        # Radii of curvature: N = a / W along the parallel, M = a (1 - e^2) / W^3 along the
        # meridian, with W^2 = 1 - e^2 sin^2 (latitude).
        major, eccentricity = ellipsoid_of(crs)
        latitude = np.radians(positions[:, 1])
        w_squared = 1.0 - eccentricity * np.sin(latitude) ** 2
        normal_radius = major / np.sqrt(w_squared)
        meridian_radius = normal_radius * (1.0 - eccentricity) / w_squared
        # Longitudes may differ by a turn.
        x = (offsets[:, 0] + 180.0) % 360.0 - 180.0
        return np.column_stack([np.radians(x) * normal_radius * np.cos(latitude),
                                np.radians(offsets[:, 1]) * meridian_radius])
    unit = _kind(crs)[2]
    return None if unit is None else offsets * unit


def is_in_degrees(crs: str) -> bool:
    """Return whether x and y are longitude and latitude."""
    return _kind(crs)[0]


def plan_of(crs: str, ground: FloatArray) -> FloatArray | None:
    """Return positions (n, 3) from their middle, to the east and to the north (n, 2), in metres.

    In the units of x and y where nobody knows these. None for geocentric coordinates, in which a
    scene may be seen from its side.
    """
    if crs and _kind(crs)[1]:
        return None
    plan = ground[:, :2] - ground[:, :2].mean(axis=0)
    metres = in_metres(crs, ground, plan) if crs else None
    return plan if metres is None else metres


def height_unit(crs: str) -> float:
    """Return the unit of heights [m]; 1 where nobody knows it."""
    return _kind(crs)[3] if crs else 1.0


@lru_cache
def _kind(crs: str) -> tuple[bool, bool, float | None, float]:
    """Return whether a CRS is geographic, whether it is geocentric, and its units in metres.

    It is asked at every fit, and pyproj takes its time.
    """
    return is_geographic(crs), is_geocentric(crs), metres_per_unit(crs), metres_per_height(crs)
