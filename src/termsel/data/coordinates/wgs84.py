"""The WGS84 ellipsoid: constants, and geographical and Earth-fixed coordinates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# NGA.STND.0036: metres, metres^3/s^2, radians/s.
SEMI_MAJOR = 6378137.0
FLATTENING = 1 / 298.257223563
GRAVITY_CONSTANT = 3.986004418e14
EARTH_ROTATION = 7.292115e-5
SEMI_MINOR = SEMI_MAJOR * (1 - FLATTENING)

ECCENTRICITY = FLATTENING * (2 - FLATTENING)  # squared


def to_ecef(ground: FloatArray) -> FloatArray:
    """Return Earth-fixed x, y, z (n, 3) [m] of WGS84 lon, lat [deg] and height [m], (n, 3)."""
    lon = np.radians(ground[:, 0])
    lat = np.radians(ground[:, 1])
    n = SEMI_MAJOR / np.sqrt(1 - ECCENTRICITY * np.sin(lat) ** 2)
    across = (n + ground[:, 2]) * np.cos(lat)
    return np.stack([across * np.cos(lon), across * np.sin(lon),
                     (n * (1 - ECCENTRICITY) + ground[:, 2]) * np.sin(lat)], axis=-1)


def from_ecef(position: FloatArray) -> FloatArray:
    """Return WGS84 lon, lat [deg] and height [m], (n, 3), of Earth-fixed x, y, z (n, 3) [m]."""
    x, y, z = position.T
    p = np.hypot(x, y)
    reduced = np.arctan2(z, p * (1 - FLATTENING))
    # B. R. Bowring, "Transformation from spatial to geographical coordinates", Survey Review 23
    # (1976) 323-327, iterated twice: exact to rounding anywhere near the surface.
    for _ in range(2):
        lat = np.arctan2(z + ECCENTRICITY / (1 - ECCENTRICITY) * SEMI_MINOR * np.sin(reduced) ** 3,
                         p - ECCENTRICITY * SEMI_MAJOR * np.cos(reduced) ** 3)
        reduced = np.arctan2((1 - FLATTENING) * np.sin(lat), np.cos(lat))
    n = SEMI_MAJOR / np.sqrt(1 - ECCENTRICITY * np.sin(lat) ** 2)
    height = p * np.cos(lat) + z * np.sin(lat) - SEMI_MAJOR**2 / n
    return np.stack([np.degrees(np.arctan2(y, x)), np.degrees(lat), height], axis=-1)


def vertical_directions(ground: FloatArray) -> FloatArray:
    """Return Earth-fixed unit normals (n, 3) of the ellipsoid at lon, lat [deg] in `ground`."""
    lon = np.radians(ground[:, 0])
    lat = np.radians(ground[:, 1])
    return np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)
