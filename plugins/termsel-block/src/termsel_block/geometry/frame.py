"""A Cartesian frame of metres over a block, in which all adjustment is done."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from termsel.toolkit.coordinates import (
    LOCAL,
    from_ecef,
    height_unit,
    to_ecef,
    to_wgs84,
    transformation_between,
)

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Frame:
    """East, north and up of a place: what a camera sees is simplest where axes are straight.

    In longitude and latitude meridians converge and the ground is flat, so that every image would
    have the same quadratic terms, which ties cannot distinguish from a bent ground.

    Parameters
    ----------
    crs : str
        CRS of ground coordinates; those in "local" stay as they are, less the origin.
    origin : ndarray, shape (3,)
        Earth-fixed [m].
    axes : ndarray, shape (3, 3)
        Rows are east, north and up.
    """

    crs: str
    origin: FloatArray
    axes: FloatArray

    @classmethod
    def at(cls, ground: FloatArray, crs: str) -> Self:
        """Return the frame at the medians of ground coordinates (n, 3) of a CRS."""
        middle = np.median(ground, axis=0)
        if crs == LOCAL:
            return cls(crs, middle, np.eye(3))
        # East, north and up at the middle, in Earth-fixed coordinates.
        geodetic = to_wgs84(crs)(middle[None])
        lon, lat = np.radians(geodetic[0, :2])
        east = [-np.sin(lon), np.cos(lon), 0.0]
        up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
        return cls(crs, to_ecef(geodetic)[0], np.array([east, np.cross(up, east), up]))

    def local(self, ground: FloatArray) -> FloatArray:
        """Return metres of ground coordinates, shape (n, 3)."""
        if self.crs == LOCAL:
            return np.asarray(ground - self.origin)
        return self.from_geodetic(to_wgs84(self.crs)(ground))

    def ground(self, local: FloatArray) -> FloatArray:
        """Return ground coordinates of metres, shape (n, 3)."""
        if self.crs == LOCAL:
            return np.asarray(local + self.origin)
        return np.asarray(transformation_between("EPSG:4979", self.crs)(self.geodetic(local)))

    def heights(self, ground: FloatArray) -> FloatArray:
        """Return the heights (n,) [m] of ground coordinates (n, 3), above what their CRS says."""
        return np.asarray(ground[:, 2] * height_unit(self.crs))

    def geodetic(self, local: FloatArray) -> FloatArray:
        """Return WGS84 longitude, latitude [deg] and ellipsoidal height [m] of metres (..., 3)."""
        return np.asarray(from_ecef(local @ self.axes + self.origin))

    def from_geodetic(self, geodetic: FloatArray) -> FloatArray:
        """Return metres (..., 3) of WGS84 longitude, latitude [deg] and ellipsoidal height [m]."""
        return np.asarray((to_ecef(geodetic) - self.origin) @ self.axes.T)
