"""Heights from a raster, for files without heights."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from termsel.errors import GIS, TermselError, first_of, printable, requires
from termsel.files.rasters import open_raster, positions
from termsel.measurements.coordinates.crs import LOCAL, vertical_datum
from termsel.measurements.coordinates.longitudes import nearest
from termsel.measurements.features import FeatureSet, FloatArray

log = logging.getLogger(__name__)

_TILE = 1024  # pixels read at once along either side
_METRES = frozenset({"", "m", "metre", "metres", "meter", "meters"})
_PLACED = "Give a raster in a geographic or projected CRS of the Earth."


@dataclass(frozen=True, eq=False)
class Dem:
    """Heights of the ground, in metres, by bilinear interpolation in an open raster.

    `to_raster` is a pyproj.Transformer from ground coordinates to the raster's; `datum` says what
    the heights refer to; `turns` whether the raster's x is a longitude, the same after a full turn.
    """

    path: Path
    raster: Any
    to_raster: Any
    datum: str
    turns: bool

    def __call__(self, xy: FloatArray) -> FloatArray:
        """Return heights, shape (n,), of x and y, shape (n, 2); NaN where there are none."""
        x, y = self.to_raster.transform(*np.asarray(xy, dtype=np.float64).T)
        if self.turns:
            x = nearest(np.asarray(x), (self.raster.bounds.left + self.raster.bounds.right) / 2)
        place = positions(self.raster, np.asarray(x), np.asarray(y))
        size = np.array(self.raster.shape)
        heights = np.full(len(place), np.nan)
        inside = np.flatnonzero(((place >= -0.5) & (place <= size - 0.5)).all(axis=1))
        # In the outer half of the outermost pixels, heights are constant across the edge.
        place = np.clip(place[inside], 0, size - 1)
        first = np.minimum(place.astype(np.intp), np.maximum(size - 2, 0))
        tiles, member = np.unique(first // _TILE, axis=0, return_inverse=True)
        for i, tile in enumerate(tiles):
            some = np.flatnonzero(member.ravel() == i)
            heights[inside[some]] = _bilinear(self._pixels(tile * _TILE), first[some]
                                              - tile * _TILE, place[some] - first[some])
        return heights

    def _pixels(self, start: Any) -> FloatArray:
        """Return the heights of a tile, the next row and column; NaN for none and infinite."""
        from rasterio.windows import Window

        row, column = (int(i) for i in start)
        window = Window(column, row, min(_TILE + 1, self.raster.width - column),
                        min(_TILE + 1, self.raster.height - row))
        with np.errstate(all="ignore"):  # of bytes that are no numbers, and numbers near the limit
            values = self.raster.read(1, window=window, masked=True).astype(np.float64)
            heights = values.filled(np.nan) * self.raster.scales[0] + self.raster.offsets[0]
        heights[np.isinf(heights)] = np.nan
        return np.asarray(heights)


def _bilinear(pixels: FloatArray, first: Any, share: FloatArray) -> FloatArray:
    """Interpolate between pixels; those without any weight may be nodata."""
    heights = np.zeros(len(first))
    for down in (0, 1):
        for right in (0, 1):
            weight = np.abs(1 - down - share[:, 0]) * np.abs(1 - right - share[:, 1])
            row, column = first[:, 0] + down * (weight > 0), first[:, 1] + right * (weight > 0)
            heights += np.where(weight > 0, weight * pixels[row, column], 0.0)
    return heights


@contextmanager
def open_dem(path: Path, crs: str) -> Iterator[Dem]:
    """Open a raster of heights for ground coordinates in a CRS.

    Parameters
    ----------
    path : pathlib.Path
    crs : str
        Of the ground coordinates. Only x and y are transformed; heights stay as they are.

    Raises
    ------
    TermselError
        If rasterio or pyproj is not installed; if the raster cannot be read, has no
        CRS, no geotransform, several bands or another unit than metres; if its vertical datum
        and that of `crs` are known and differ; if `crs` is "local".
    """
    if crs == LOCAL:
        raise TermselError("a raster gives heights only to ground coordinates with a "
                           "CRS", file=path,
                           hint="State the CRS of the ground coordinates instead of local.")
    with open_raster(path) as raster:
        with requires("heights require", "pyproj", GIS):
            from pyproj import CRS, Transformer
            from pyproj.exceptions import CRSError, ProjError
        if raster.crs is None or raster.transform.is_identity:
            raise TermselError("this raster is not georeferenced", file=path,
                               hint="Give a raster with a geotransform and a CRS.")
        unit = (raster.units[0] or "").lower()
        if raster.count != 1 or unit not in _METRES:
            what = f"has {raster.count} bands" if raster.count != 1 else f"is in {unit}"
            raise TermselError(f"this raster {what}, expected one band of heights in metres",
                               file=path, hint="Convert it, for example with gdal_translate.")
        try:
            own = CRS.from_user_input(raster.crs.to_wkt())
            to_raster = Transformer.from_crs(CRS.from_user_input(crs).to_2d(), own.to_2d(),
                                             always_xy=True)
        except (CRSError, ProjError) as error:  # of a building, or of the Moon
            raise TermselError(f"the CRS of this raster cannot be used: {error}", file=path,
                               hint=_PLACED) from error
        if not (own.is_geographic or own.is_projected):
            raise TermselError(f"the CRS of this raster, {own.name}, has no horizontal coordinates",
                               file=path, hint=_PLACED)
        datum, stated = vertical_datum(own), vertical_datum(CRS.from_user_input(crs))
        if datum and stated and datum != stated:
            raise TermselError(
                f"the heights of this raster are {datum}, those of the ground coordinates {stated}",
                file=path, hint="termsel does not convert heights. Give a raster with the same "
                                "heights, or run the selection with a CRS of the control without "
                                "a vertical datum, such as EPSG:4326.")
        yield Dem(path, raster, to_raster, datum or "not declared by the raster",
                  own.is_geographic)


def surface_of(dem: Path | str | None, crs: str, height: float,
               ) -> AbstractContextManager[Dem | float]:
    """Open a raster of heights for coordinates in a CRS, or give a constant height instead."""
    return nullcontext(height) if dem is None else open_dem(Path(dem), crs)


def with_heights(features: FeatureSet, dem: Path) -> FeatureSet:
    """Return the features with unknown heights [m] from a raster; `heights` says which datum."""
    ground = features.ground_vertices()
    unknown = np.isnan(ground[:, 2])
    with open_dem(dem, features.crs) as surface:
        ground[unknown, 2] = surface(ground[unknown, :2])
        datum = surface.datum
    gone = np.isnan(ground[:, 2])
    if gone.any():
        n = len(features.points)
        owner = features.points.ids + tuple(np.repeat(features.lines.ids, 2))
        names = list(dict.fromkeys(str(owner[i]) for i in np.flatnonzero(gone)))
        raise TermselError(f"{len(names)} of {len(features)} features are outside the raster or "
                           f"where it has no data: {first_of(names)}", file=dem, ids=names,
                           hint="Give a larger raster, fill its holes, or remove these features.")
    n = len(features.points)
    statement = (f"{unknown.sum()} of {len(ground)} heights from {printable(dem.name)}, bilinear; "
                 f"vertical datum: {datum}")
    log.info("Heights: %s.", statement)
    return replace(
        features, heights=statement,
        points=replace(features.points, ground=ground[:n]),
        lines=replace(features.lines, ground=ground[n:].reshape(-1, 2, 3)))
