"""Small distances on the ground in metres, whatever the CRS."""

from __future__ import annotations

import numpy as np

from termsel.measurements.coordinates.crs import is_geographic, metres_per_unit
from termsel.measurements.features import FloatArray

SEMI_MAJOR, ECCENTRICITY = 6378137.0, 0.00669437999014
"""Of WGS84: the semi-major axis [m], and the square of the first eccentricity. Of other ellipsoids
small distances differ by less than 0.02 %."""


def in_metres(crs: str, places: FloatArray, offsets: FloatArray) -> FloatArray | None:
    """Return offsets (n, 2) to east and north of places in metres; None if the unit is unknown."""
    if is_geographic(crs):
        latitude = np.radians(places[:, 1])
        short = 1.0 - ECCENTRICITY * np.sin(latitude) ** 2
        across = SEMI_MAJOR / np.sqrt(short)
        along = across * (1.0 - ECCENTRICITY) / short
        # Longitudes may differ by a turn.
        x = (offsets[:, 0] + 180.0) % 360.0 - 180.0
        return np.column_stack([np.radians(x) * across * np.cos(latitude),
                                np.radians(offsets[:, 1]) * along])
    unit = metres_per_unit(crs)
    return None if unit is None else offsets * unit
