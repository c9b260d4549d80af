"""An image made small, for a page."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np

from termsel.core.errors import TermselError
from termsel.data.features import FloatArray
from termsel.data.rasters import (
    open_raster,
    refuse_empty_giant,
    require_rasterio,
    tiff_bytes,
)

THUMBNAIL_SIDE = 1000
"""Pixels of the longer side."""


def make_thumbnail(path: Path | str, expected: tuple[int, int] | None = None,
                   ) -> tuple[str, tuple[int, int]]:
    """Return an image as a small grey JPEG in a data URL, and its lines and samples [px].

    The JPEG shows the first band, with `THUMBNAIL_SIDE` pixels along the longer side at most, and
    grey values stretched from the darkest to the brightest after 2 % at either end. Lines and
    samples are those of the whole image. Raises TermselError if they are not `expected`, if the
    file is no raster, or if it claims to be far larger than what it holds.
    """
    rasterio = require_rasterio()
    with open_raster(path) as raster:
        size = (int(raster.height), int(raster.width))
        if expected is not None and size != tuple(expected):
            raise TermselError(
                f"this image has {size[0]} lines and {size[1]} samples, and the points were "
                f"measured in one of {expected[0]} and {expected[1]}", file=path,
                hint="Give the image that the points were measured in.")
        refuse_empty_giant(raster)
        # GDAL reads at the lower resolution, from overviews where there are any.
        reduction = max(1.0, max(size) / THUMBNAIL_SIDE)
        shape = (max(1, round(size[0] / reduction)), max(1, round(size[1] / reduction)))
        # Indices of colours have no mean: the nearest pixel is taken, and its brightness.
        has_palette = raster.colorinterp[0] == rasterio.enums.ColorInterp.palette
        resampling = (rasterio.enums.Resampling.nearest if has_palette
                      else rasterio.enums.Resampling.average)
        band = raster.read(1, out_shape=shape, masked=True, resampling=resampling)
        if has_palette:
            band = np.ma.array(_palette_brightness(raster.colormap(1),
                                                   int(band.data.max()))[band.data],
                               mask=band.mask)
    values = np.ma.filled(band.astype(np.float64), np.nan)
    finite = values[np.isfinite(values)]
    # The darkest and the brightest 2 %, often borders and clouds, do not set the contrast.
    low, high = np.percentile(finite, [2, 98]) if finite.size else (0.0, 1.0)
    grey = np.clip((values - low) / max(high - low, 1e-12), 0, 1)
    # The picture is pale, so that arrows stand out, and white where there is nothing.
    pixels = np.nan_to_num(110 + 145 * grey, nan=255.0).astype(np.uint8)
    content = tiff_bytes(pixels[None], driver="JPEG", quality=80)
    return f"data:image/jpeg;base64,{base64.b64encode(content).decode()}", size


def _palette_brightness(table: dict[int, tuple[int, int, int, int]], largest: int) -> FloatArray:
    """Return the brightness of the colour of each index, 0 to 255, (colours,)."""
    colours = np.zeros((max(largest, *table) + 1, 3))
    for index, colour in table.items():
        colours[index] = colour[:3]
    return colours @ [0.299, 0.587, 0.114]  # of red, green and blue, by ITU-R BT.601
