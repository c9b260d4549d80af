"""Where images, maps and vectors are, in words for messages."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from termsel import TermselError, open_raster
from termsel_match.images.rasters import FloatArray
from termsel_match.images.starts import turned

_DEGREES = "EPSG:4326"


def in_words(plane: FloatArray, crs: str) -> str:
    """Return the middle of places (n, 2) of a CRS as latitude and longitude.

    It is "an unknown place" where the CRS cannot be transformed to degrees.

    Examples
    --------
    >>> import numpy as np
    >>> in_words(np.array([[48.5, 34.8], [48.6, 34.8]]), "EPSG:4326")
    '34.800 N, 48.550 E'
    """
    degrees = _in_degrees(plane, crs)
    if degrees is None:
        return "an unknown place"
    lon, lat = (np.nanmin(degrees, axis=0) + np.nanmax(degrees, axis=0)).tolist()
    lon, lat = lon / 2, lat / 2
    return f"{abs(lat):.3f} {'N' if lat >= 0 else 'S'}, {abs(lon):.3f} {'E' if lon >= 0 else 'W'}"


def require_same_area(references: Sequence[Path], dem: Path | str | None) -> None:
    """Raise TermselError if a DEM and every reference show different places of the Earth."""
    if dem is None:
        return
    of_dem = _corners(Path(dem))
    of_references = [corners for corners in map(_corners, references) if corners is not None]
    if of_dem is None or len(of_references) < len(references):
        return
    low, high = of_dem.min(axis=0), of_dem.max(axis=0)
    for corners in of_references:
        if (corners.max(axis=0) >= low).all() and (corners.min(axis=0) <= high).all():
            return
    raise TermselError(
        f"the reference {references[0].name} ({in_words(of_references[0], _DEGREES)}) and the DEM "
        f"{Path(dem).name} ({in_words(of_dem, _DEGREES)}) do not overlap",
        hint="Give a reference and a DEM of the area of the image.")


def _corners(path: Path) -> FloatArray | None:
    """Return the corners (4, 2) of a raster as longitudes and latitudes; None if not known."""
    with open_raster(path) as raster:
        if raster.crs is None or raster.transform.is_identity:
            return None
        corners = [raster.transform @ (sample, line) for line in (0, raster.height)
                   for sample in (0, raster.width)]
        return _in_degrees(np.array(corners, dtype=float), raster.crs.to_wkt())


def _in_degrees(plane: FloatArray, crs: str) -> FloatArray | None:
    """Return places (n, 2) as longitudes and latitudes; None if the CRS has none, or all are lost.
    """
    from pyproj.exceptions import ProjError

    try:
        degrees = turned(plane, crs, _DEGREES)
    except (ProjError, TermselError):
        return None
    degrees = degrees[np.isfinite(degrees).all(axis=1)]
    return degrees if len(degrees) else None
