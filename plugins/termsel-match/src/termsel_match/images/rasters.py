"""Windows of rasters larger than memory, as brightness from 0 to 255."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from termsel import TermselError, open_raster
from termsel.toolkit import refuse_empty_giant

FloatArray = NDArray[np.float64]
Grey = NDArray[np.float32]
Mask = NDArray[np.bool_]

log = logging.getLogger("termsel.match")

_DARK_PERCENTILE, _BRIGHT_PERCENTILE = 1.0, 99.0
"""Percentiles of the brightness that become 0 and 255."""

_LOOKED_UP_SIDE = 200
"""Side of the reduced raster that shows where there are data [px]."""

_BLANK_SIDE = 15
"""Least side of a square of zeros that counts as without data [px]."""

_MIN_PIXELS = 16
"""Fewest known pixels whose brightness is stretched: fewer have no texture."""

_BANDS = 16
"""Most bands whose mean is taken: more need time to read, and change the mean little."""


@dataclass(frozen=True, eq=False)
class GreyRaster:
    """The brightness of a raster: the mean of its bands, or one of them.

    Parameters
    ----------
    path : pathlib.Path
        File of the raster.
    raster : rasterio.DatasetReader
        The open raster.
    bands : tuple of int
        Numbers of the bands, from 1.
    excluded : tuple of callable
        Functions that mask areas in which nothing is matched. Each takes first line and sample of a
        window [px], its lines and samples in steps, and the step [px]; it returns a mask (lines,
        samples).
    """

    path: Path
    raster: Any
    bands: tuple[int, ...]
    excluded: tuple[Callable[[int, int, tuple[int, int], int], Mask], ...] = ()

    @property
    def size(self) -> tuple[int, int]:
        """Number of lines and of samples."""
        return int(self.raster.height), int(self.raster.width)

    def read(self, first_line: int, first_sample: int, lines: int, samples: int, step: int = 1,
             ) -> tuple[Grey, Mask]:
        """Return the brightness of a window, and where it is known.

        Parameters
        ----------
        first_line, first_sample, lines, samples : int
            The window [px]; it may extend beyond the raster, where nothing is known.
        step : int
            Pixels along either side whose mean becomes one pixel of what is returned. GDAL reads
            overviews if the raster has them.

        Returns
        -------
        pixels : ndarray of float32, shape (lines // step, samples // step)
            0 where the brightness is not known.
        is_known : ndarray of bool, same shape
            False without data, in masked areas and beyond the raster.

        Raises
        ------
        TermselError
            If GDAL cannot read the raster.
        """
        from rasterio.enums import Resampling
        from rasterio.errors import RasterioIOError
        from rasterio.windows import Window

        # The part of the window that the raster has; the rest stays unknown.
        shape = lines // step, samples // step
        pixels = np.zeros(shape, dtype=np.float32)
        is_known = np.zeros(shape, dtype=bool)
        height, width = self.size
        # Whole steps, so that reduced pixels lie where they would without the edge.
        first = max(-(-max(-first_line, 0) // step), 0), max(-(-max(-first_sample, 0) // step), 0)
        last = (min(shape[0], (height - first_line) // step),
                min(shape[1], (width - first_sample) // step))
        if first[0] >= last[0] or first[1] >= last[1]:
            return pixels, is_known
        window = Window(first_sample + first[1] * step, first_line + first[0] * step,
                        (last[1] - first[1]) * step, (last[0] - first[0]) * step)
        part_inside = slice(first[0], last[0]), slice(first[1], last[1])
        with np.errstate(all="ignore"):
            try:
                grey = self.raster.read(
                    list(self.bands), window=window, masked=True, resampling=Resampling.average,
                    out_shape=(len(self.bands), last[0] - first[0], last[1] - first[1]))
            except RasterioIOError as error:
                raise TermselError(f"GDAL cannot read this raster: {error.__cause__ or error}",
                                   file=self.path, hint="Copy it again: it is damaged.") from error
            # The mean over bands is masked only where all of them are.
            values = grey.astype(np.float32).mean(axis=0)
            has_data = ~np.ma.getmaskarray(values) & np.isfinite(values.data)
        # If no value is stated for "no data", areas that are exactly 0 in all bands have none:
        # images are filled up with zeros.
        if self.raster.nodatavals[self.bands[0] - 1] is None:
            has_data &= ~_is_filled(grey.data)
        pixels[part_inside] = np.where(has_data, values.data, 0)
        is_known[part_inside] = has_data
        for excluded in self.excluded:
            is_known &= ~excluded(first_line, first_sample, shape, step)
        return pixels, is_known

    def known_at(self, positions: FloatArray) -> Mask:
        """Return which positions (n, 2) [px] have data, as the reduced raster shows it, (n,).

        False for positions outside the raster.
        """
        inside = np.all((positions >= 0) & (positions <= np.array(self.size) - 1), axis=1)
        if not inside.any():
            return np.asarray(inside)
        # One window around all positions is read, reduced to some 200 px.
        low = np.floor(positions[inside].min(axis=0))
        high = np.ceil(positions[inside].max(axis=0)) + 1
        step = int(max(1, (high - low).max() // _LOOKED_UP_SIDE))
        first_line, first_sample = low.astype(int).tolist()
        lines, samples = (np.ceil((high - low) / step).astype(int) * step).tolist()
        is_known = self.read(first_line, first_sample, lines, samples, step)[1]
        # The last row or column may be a part of a step, which is not read: the one before counts.
        at = np.minimum((positions[inside] - low) // step, np.array(is_known.shape) - 2).astype(int)
        inside[inside] = is_known[tuple(np.maximum(at, 0).T)]
        return np.asarray(inside)


def _is_filled(values: NDArray[Any]) -> Mask:
    """Return which pixels, (lines, samples), are in squares of 15 px where all bands are 0.

    `values` (c, lines, samples) are those of the bands.
    """
    zero = (values == 0).all(axis=0).astype(np.uint8)
    if not zero.any():
        return np.zeros(zero.shape, dtype=bool)
    import cv2  # which a command that matches nothing need not import

    # Opening leaves only areas of zeros, not single dark pixels.
    return np.asarray(cv2.morphologyEx(zero, cv2.MORPH_OPEN,
                                       np.ones((_BLANK_SIDE, _BLANK_SIDE), np.uint8))
                      > 0)


def spread_pixels(size: tuple[int, int], shape: tuple[int, ...]) -> FloatArray:
    """Return positions spread evenly over an image, row by row, (n, 2) [px].

    `size` has the lines and samples of the image, `shape` the number of positions along both. The
    first and the last line and sample are among them.
    """
    steps = (np.linspace(0, extent - 1, count) for extent, count in zip(size, shape, strict=True))
    return np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)


@contextmanager
def open_picture(path: Path | str, band: int | None = None) -> Iterator[GreyRaster]:
    """Open a raster, of which windows of brightness can be read.

    Parameters
    ----------
    path : path-like
        The raster.
    band : int, optional
        Number of a band, from 1. By default the brightness is the mean of all bands without those
        of transparency; of more than 16 bands, the mean of 16 that are evenly spaced, which is
        noted.

    Yields
    ------
    GreyRaster
        The brightness; the raster is closed on leaving.

    Raises
    ------
    TermselError
        If GDAL cannot read the raster, or it has no such band.
    """
    from rasterio.enums import ColorInterp

    with open_raster(path) as raster:
        if band is not None and not 1 <= band <= raster.count:
            raise TermselError(f"this raster has no band {band}", file=path,
                               hint=f"Give a band from 1 to {raster.count}."
                               if raster.count > 1 else "It has one band: leave --band out.")
        refuse_empty_giant(raster)
        visible = tuple(index for index, kind in zip(raster.indexes, raster.colorinterp,
                                                     strict=True) if kind != ColorInterp.alpha)
        if band is None and len(visible) > _BANDS:
            log.info("Note: the mean of %d of the %d bands of %s is taken, evenly spaced. Choose "
                     "one by its number (--band, --reference-band).", _BANDS, len(visible), path)
            # The k-th of 16 bands out of n is number floor(k n / 16).
            visible = tuple(visible[i * len(visible) // _BANDS] for i in range(_BANDS))
        yield GreyRaster(Path(path), raster, visible if band is None else (band,))


def crs_of(picture: GreyRaster) -> str:
    """Return the CRS of a georeferenced picture, as "EPSG:n" where it has a code, else as WKT.

    Raises
    ------
    TermselError
        If it has none, or no geotransform.
    """
    raster = picture.raster
    if raster.crs is None or raster.transform.is_identity:
        lacks = "CRS" if raster.crs is None else "geotransform"
        raise TermselError(f"the reference has no {lacks}", file=picture.path,
                           hint="Give an image on a map, such as an orthophoto as GeoTIFF.")
    code = raster.crs.to_epsg()
    return str(raster.crs.to_wkt()) if code is None else f"EPSG:{code}"


def stretch_to_bytes(pixels: Grey, is_known: Mask) -> NDArray[np.uint8] | None:
    """Return pixels (lines, samples) as bytes from dark to bright, 0 where they are not known.

    The percentiles 1 and 99 of the known pixels become 0 and 255, and what is beyond is cut off.
    None if fewer than 16 px are known, or nearly all have the same brightness.
    """
    values = pixels[is_known]
    if values.size < _MIN_PIXELS:
        return None
    # Percentiles, not extremes: a single bright pixel would darken all others.
    dark, bright = np.percentile(values, (_DARK_PERCENTILE, _BRIGHT_PERCENTILE))
    if not bright > dark:
        return None
    scaled = np.clip((pixels - dark) * (255 / (bright - dark)), 0, 255)
    return np.asarray(np.where(is_known, scaled, 0), dtype=np.uint8)
