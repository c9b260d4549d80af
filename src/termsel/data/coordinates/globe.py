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
    places = _degrees(ground, normalise(crs))
    extent = np.ptp(places[:, :2], axis=0).max(initial=0.0)
    if not 0.0 < extent < np.inf:
        return places
    # By digits, so that an extent which differs by its rounding rounds alike.
    digits = -int(np.floor(np.log10(FINEST * extent)))
    places[:, :2] = np.round(places[:, :2], digits)
    return places


def _degrees(ground: FloatArray, crs: str) -> FloatArray:
    places = ground.copy()
    try:
        if is_geocentric(crs):
            places[:, :2] = transformation(crs, geodetic_of(crs))(ground)[:, :2]
        elif not is_geographic(crs):
            geodetic = horizontal(geodetic_of(crs))
            turn = transformation(horizontal(crs), geodetic, strict=False)
            places[:, :2] = turn(np.nan_to_num(ground))[:, :2]
    except TermselError:  # without a CRS or without pyproj nothing tells
        return ground.copy()
    if not np.isfinite(places[:, :2]).all():
        return ground.copy()
    places[:, 0] = continuous(places[:, 0])
    return places
