"""Cloud-optimised GeoTIFFs, written tile by tile."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from termsel.core.errors import TermselError
from termsel.core.files.atomic import atomic_path
from termsel.core.files.names import utf8_folder
from termsel.core.files.reasons import reason_of
from termsel.data.rasters import require_rasterio

TILE = 1024
"""Size of the tiles that are computed at once [px]."""

_OTHERS = (".png", ".jpg", ".jpeg", ".jp2", ".bmp", ".gif", ".webp", ".pdf", ".img", ".ecw", ".sid",
           ".vrt", ".nc", ".asc")
"""Endings of names of other formats."""
_NO_RASTERS = (".csv", ".txt", ".json", ".geojson", ".gpkg", ".shp", ".xlsx", ".ods", ".html",
               ".svg", ".xml", ".md")
"""Endings of names of what is no raster."""


def require_tiff_name(path: Path) -> None:
    """Refuse a map's file name that says another format than TIFF.

    Callers do so before long work, not only when the map is written.

    Raises
    ------
    TermselError
        If the suffix is one of another raster format, or of a file that is no raster.
    """
    suffix = path.suffix.lower()
    if suffix in _OTHERS or suffix in _NO_RASTERS:
        converted = "; gdal_translate converts it to other formats" if suffix in _OTHERS else ""
        raise TermselError(f"a map is written as GeoTIFF, not as {path.suffix}", file=path,
                           hint=f"Name it {path.with_suffix('.tif').name}{converted}.")


def _arrange_tile(pixels: Any) -> tuple[Any, Any]:
    """Return pixels in the order of memory, and where they show something, if that is said."""
    values, valid = pixels if isinstance(pixels, tuple) else (pixels, None)
    return np.ascontiguousarray(values), valid


def write_cog(
    path: Path,
    profile: dict[str, Any],
    pixels: Callable[[Any, Any], Any],
    *,
    describe: Callable[[Any], None],
    across: int = TILE,
    statistics: bool = False,
    masked: bool = False,
    nearest: bool = False,
    bits: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Write a cloud-optimised GeoTIFF, completely or not at all, and read it back.

    Parameters
    ----------
    path : pathlib.Path
        The file to write. An existing one is replaced.
    profile : dict
        Height, width, count, dtype, crs, transform and nodata, as rasterio.open takes them.
    pixels : callable
        Takes a rasterio Window of the map and its affine.Affine. Returns the pixels (bands, lines,
        samples), alone or with a mask (lines, samples) that is True where they show something. The
        mask is ignored unless `masked`.
    describe : callable
        Called with the open dataset before the first tile, to set tags, colours and names of bands.
    across : int
        Width of the tiles [px].
    statistics : bool
        Whether to keep minimum, maximum, mean and standard deviation of each band in the file.
    masked : bool
        Whether the file has a mask.
    nearest : bool
        Whether overviews keep single pixels of the map, instead of means of several.
    bits : int, optional
        The bits of each pixel, if they are fewer than 8.
    progress : callable, optional
        Called with the fraction that is done, 0 to 1.

    Raises
    ------
    TermselError
        If rasterio is not installed, the name says another format, GDAL fails, or the file cannot
        be written.
    """
    require_tiff_name(path)
    rasterio = require_rasterio()
    from rasterio._err import CPLE_BaseError
    from rasterio.shutil import copy
    from rasterio.windows import Window

    lines = profile["height"]
    samples = profile["width"]
    # Tiles go row by row; those at the right and the lower edge are as small as what remains.
    tiles = [Window(column, row, min(across, samples - column), min(TILE, lines - row))
             for row, column in product(range(0, lines, TILE), range(0, samples, across))]
    # GDAL's driver for cloud-optimised files, which makes the overviews, takes these options.
    options: dict[str, Any] = {"STATISTICS": "YES"} if statistics else {}
    # GDAL reduces no complex pixels by its usual cubic convolution.
    if nearest or str(profile["dtype"]).startswith("complex"):
        options["OVERVIEW_RESAMPLING"] = "NEAREST"
    if bits is not None:
        options["NBITS"] = profile["nbits"] = bits
    # Those of the tiles as they were computed are compared with those of the finished file.
    checksums = []

    def checksum(raster: Any, window: Window) -> int:
        values = crc32(raster.read(window=window).data)
        return crc32(raster.read_masks(1, window=window).data, values) if masked else values

    try:
        with (atomic_path(path) as temporary,
              utf8_folder(temporary.parent) as folder,
              warnings.catch_warnings(),
              rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True)):
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            tiled_file = folder / "tiles.tif"
            cog_file = folder / "made.tif"
            # This file is read only once, by the copy below, so that quick packing is enough.
            with rasterio.open(tiled_file, "w", driver="GTiff", tiled=True, compress="deflate",
                               zlevel=1, bigtiff="if_safer", **profile) as raster:
                describe(raster)
                for done, window in enumerate(tiles):
                    values, valid = _arrange_tile(pixels(window, raster.window_transform(window)))
                    raster.write(values, window=window)
                    written = crc32(values.data)
                    if masked:
                        mask = np.where(valid, np.uint8(255), np.uint8(0))
                        raster.write_mask(mask, window=window)
                        written = crc32(mask.data, written)
                    checksums.append(written)
                    if progress is not None:
                        progress((done + 1) / len(tiles))
            copy(tiled_file, cog_file, driver="COG", compress="deflate", bigtiff="if_safer",
                 **options)
            # GDAL does not report that a disk is full when it closes a file.
            with rasterio.open(cog_file) as raster:
                if [checksum(raster, window) for window in tiles] != checksums:
                    raise TermselError("the map that is read back is not the one that was written",
                                       file=path, hint="Check the free space on the disk.")
            cog_file.replace(folder / temporary.name)
    except (rasterio.errors.RasterioError, CPLE_BaseError) as error:
        raise TermselError(f"GDAL cannot make this map: {reason_of(error, path)}", file=path,
                           hint="Check the image, the raster of heights, and the free space on the "
                                "disk.") from error
