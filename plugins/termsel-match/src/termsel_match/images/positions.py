"""Where images, maps and vectors are, in words for messages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from termsel import TermselError, open_raster
from termsel_match.images.rasters import FloatArray
from termsel_match.images.starts import transform_plane

_WGS84 = "EPSG:4326"
_GRID_LINES = 21
"""Number of positions along each side of a raster by which its area is compared."""


def middle_in_words(plane: FloatArray, crs: str) -> str:
    """Return the middle of positions (n, 2) in a CRS as latitude and longitude, in words.

    It is "an unknown place" if the CRS cannot be transformed to degrees.

    Examples
    --------
    >>> import numpy as np
    >>> middle_in_words(np.array([[48.5, 34.8], [48.6, 34.8]]), "EPSG:4326")
    '34.800 N, 48.550 E'
    """
    degrees = _to_degrees(plane, crs)
    if degrees is None:
        return "an unknown place"
    lon, lat = (np.nanmin(degrees, axis=0) + np.nanmax(degrees, axis=0)).tolist()
    lon, lat = lon / 2, lat / 2
    return f"{abs(lat):.3f} {'N' if lat >= 0 else 'S'}, {abs(lon):.3f} {'E' if lon >= 0 else 'W'}"


def require_same_area(references: Sequence[Path], dem: Path | str | None) -> None:
    """Raise TermselError if a DEM overlaps none of the references.

    Without a DEM, or if the position of one of the rasters is not known, nothing is raised.
    """
    if dem is None:
        return
    dem_grid = _grid_in_degrees(Path(dem))
    grids = [grid for grid in map(_grid_in_degrees, references) if grid is not None]
    if dem_grid is None or len(grids) < len(references):
        return
    # References may be tiles, of which a DEM need not cover each.
    if any(_boxes_overlap(grid, dem_grid) for grid in grids):
        return
    raise TermselError(
        f"the reference {references[0].name} ({middle_in_words(grids[0], _WGS84)}) and "
        f"the DEM {Path(dem).name} ({middle_in_words(dem_grid, _WGS84)}) do not overlap",
        hint="Give a reference and a DEM of the area of the image.")


def _boxes_overlap(first: FloatArray, second: FloatArray) -> bool:
    """Return whether the boxes around two sets of longitudes and latitudes (n, 2) overlap.

    As longitudes may count from -180 or from 0 degrees, one box is also shifted by a turn each way.
    """
    low, high = second.min(axis=0), second.max(axis=0)
    return any(bool((first.max(axis=0) + shift >= low).all()
                    and (first.min(axis=0) + shift <= high).all())
               for shift in ((-360.0, 0.0), (0.0, 0.0), (360.0, 0.0)))


def _grid_in_degrees(path: Path) -> FloatArray | None:
    """Return longitudes and latitudes, (n, 2) [deg], of a grid over a raster.

    None if the raster has no position, or its CRS cannot be transformed to degrees.
    """
    # The corners alone would not show a pole in the middle, nor edges that bulge.
    with open_raster(path) as raster:
        if raster.crs is None or raster.transform.is_identity:
            return None
        places = [raster.transform @ (sample, line)
                  for line in np.linspace(0, raster.height, _GRID_LINES).tolist()
                  for sample in np.linspace(0, raster.width, _GRID_LINES).tolist()]
        return _to_degrees(np.array(places, dtype=float), raster.crs.to_wkt())


def _to_degrees(plane: FloatArray, crs: str) -> FloatArray | None:
    """Return positions (n, 2) as longitudes and latitudes, without those that have none.

    None if the CRS cannot be transformed to degrees, or none of the positions can.
    """
    from pyproj.exceptions import ProjError

    try:
        degrees = transform_plane(plane, crs, _WGS84)
    except (ProjError, TermselError):
        return None
    degrees = degrees[np.isfinite(degrees).all(axis=1)]
    return degrees if len(degrees) else None
