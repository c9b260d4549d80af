"""Coordinates of a session: those of the ground, and those in which the map is shown.

The map is shown in a projected CRS, where shapes are as on the ground: that of the first map, or
Web Mercator where that has degrees. Ground coordinates are those that the control is written in.
"""

from __future__ import annotations

from contextlib import ExitStack
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from termsel import open_dem
from termsel.toolkit import FloatArray
from termsel.toolkit.coordinates import (
    LOCAL,
    horizontal_crs,
    is_geographic,
    plane_transformer,
)

MERCATOR = "EPSG:3857"
_LOCK = Lock()  # objects of pyproj belong to one thread at a time


def shown_crs(crs: str) -> str:
    """Return the CRS in which the page shows a CRS: Mercator for longitudes and latitudes."""
    return MERCATOR if crs != LOCAL and is_geographic(crs) else crs


@lru_cache  # PROJ takes milliseconds, and each move of the mouse on the map asks for one.
def transformer_between(source: str, target: str) -> Any:
    """Return the transformer of x and y from one CRS to another.

    None, for no transformation, if both are the same or one is "local".
    """
    from pyproj import CRS

    if LOCAL in (source, target) or source == target:
        return None
    ends = [CRS.from_user_input(crs).to_2d() for crs in (source, target)]
    return None if ends[0].equals(ends[1]) else plane_transformer(*ends)


def transform_places(transformer: Any, xy: Any, inverse: bool = False) -> FloatArray:
    """Return places (n, 2) transformed by a transformer; unchanged by None.

    They are infinite where the transformation has no value.
    """
    positions: FloatArray = np.asarray(xy, dtype=np.float64).reshape(-1, 2)
    if transformer is None:
        return positions
    with _LOCK:
        x, y = transformer.transform(positions[:, 0], positions[:, 1],
                                     direction="INVERSE" if inverse else "FORWARD")
    return np.column_stack([x, y])


class Places:
    """Where ground coordinates are shown, and the heights of the ground.

    Parameters
    ----------
    crs : str
        CRS of the ground coordinates.
    page_crs : str
        CRS in which the page shows the map, kept as `shown`.
    dem : pathlib.Path, optional
        Raster of heights, open until `close`.
    """

    def __init__(self, crs: str, page_crs: str, dem: Path | None = None) -> None:
        self.crs = crs
        self.shown = page_crs
        self._stack = ExitStack()
        self._lock = Lock()
        self._surface = None if dem is None else self._stack.enter_context(open_dem(dem, crs))

    def close(self) -> None:
        """Close the raster of heights."""
        with self._lock:
            self._surface = None
            self._stack.close()

    @property
    def plane(self) -> str:
        """The CRS of x and y of the ground, without heights."""
        return horizontal_crs(self.crs) or LOCAL

    def to_map(self, ground: Any) -> FloatArray:
        """Return where ground places (n, 2 or more) are on the map (n, 2)."""
        ground = np.asarray(ground, dtype=np.float64)
        return transform_places(transformer_between(self.plane, self.shown), ground[:, :2])

    def to_ground(self, xy: Any) -> FloatArray:
        """Return the ground coordinates (n, 3) of places on the map; NaN for unknown heights."""
        plane = transform_places(transformer_between(self.plane, self.shown), xy, inverse=True)
        return np.column_stack([plane, self.heights(plane)])

    @property
    def has_heights(self) -> bool:
        """Whether there is a raster of heights."""
        return self._surface is not None

    def heights(self, xy: FloatArray) -> FloatArray:
        """Return heights of ground places x and y (n, 2) from the DEM; NaN without one."""
        heights = np.full(len(xy), np.nan)
        finite = np.isfinite(xy).all(axis=1)
        with self._lock:
            if self._surface is not None and finite.any():
                heights[finite] = self._surface(xy[finite])
        return heights

    def highest(self, corners: FloatArray) -> float:
        """Return the greatest height of the DEM in the box around ground places (n, 2), or NaN."""
        with self._lock:
            return np.nan if self._surface is None else self._surface.highest(corners)

    def spacing(self) -> float:
        """Return the distance of neighbouring heights of the DEM, in ground units; NaN without."""
        with self._lock:
            return np.nan if self._surface is None else self._surface.spacing()
