"""Places of points that are the same in every CRS."""

from __future__ import annotations

import numpy as np

from termsel.core.errors import TermselError
from termsel.data.coordinates.crs import (
    geodetic_of,
    horizontal,
    is_geocentric,
    is_geographic,
    normalise,
    transformation,
)
from termsel.data.coordinates.longitudes import continuous
from termsel.data.features import FloatArray

FINEST = 1e-5
"""Part of their extent to which places are rounded: coordinates are written with few digits, and
places on one meridian must stay on one."""


def on_globe(ground: FloatArray, crs: str) -> FloatArray:
    """Return longitude and latitude [deg], rounded, and height of places (n, 3) in any CRS.

    Places without a CRS, or whose CRS is not known without pyproj, are rounded as they are.
    """
    if not len(ground):
        return ground
    geodetic = _degrees(ground, normalise(crs))
    extent = np.ptp(geodetic[:, :2], axis=0).max(initial=0.0)
    # A single place has no extent to round by.
    if not 0.0 < extent < np.inf:
        return geodetic
    # By digits, so that an extent which differs by its rounding rounds alike.
    digits = -int(np.floor(np.log10(FINEST * extent)))
    geodetic[:, :2] = np.round(geodetic[:, :2], digits)
    return geodetic


def _degrees(ground: FloatArray, crs: str) -> FloatArray:
    """Return longitude, latitude [deg] and height of positions; a copy where nothing tells them."""
    positions = ground.copy()
    try:
        if is_geocentric(crs):
            positions[:, :2] = transformation(crs, geodetic_of(crs))(ground)[:, :2]
        elif not is_geographic(crs):
            geodetic = horizontal(geodetic_of(crs))
            turn = transformation(horizontal(crs), geodetic, strict=False)
            # Heights are of no account in the plane, and may be unknown.
            positions[:, :2] = turn(np.nan_to_num(ground))[:, :2]
    except TermselError:  # without a CRS or without pyproj nothing tells
        return ground.copy()
    if not np.isfinite(positions[:, :2]).all():
        return ground.copy()
    positions[:, 0] = continuous(positions[:, 0])
    return positions
