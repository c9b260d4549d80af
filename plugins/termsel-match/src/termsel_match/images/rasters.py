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

# Percentiles that become 0 and 255.
_DARK_PERCENTILE, _BRIGHT_PERCENTILE = 1.0, 99.0
# Px along either side of a raster that is reduced to see where it has data.
_LOOKED_UP_SIDE = 200
# Px along either side of an area of zeros that are no data.
_BLANK_SIDE = 15
# Distinct pixels; fewer have no texture.
_MIN_PIXELS = 16
# Of which the mean is taken: more take their time, and change it little.
_BANDS = 16


@dataclass(frozen=True, eq=False)
class GreyRaster:
    """The brightness of a raster: the mean of its bands, or one of them.

    Parameters
    ----------
    path : pathlib.Path
    raster : rasterio.DatasetReader
        Open.
    bands : tuple of int
        Counted from 1.
    excluded : tuple of callable
        Each takes line and sample of a window, its shape reduced, and the reduction; and returns
        where it has nothing to be matched.
    """

    path: Path
    raster: Any
    bands: tuple[int, ...]
    excluded: tuple[Callable[[int, int, tuple[int, int], int], Mask], ...] = ()

    @property
    def size(self) -> tuple[int, int]:
        """Lines and samples [px]."""
        return int(self.raster.height), int(self.raster.width)

    def read(self, first_line: int, first_sample: int, lines: int, samples: int, step: int = 1,
             ) -> tuple[Grey, Mask]:
        """Return the pixels of a window and where it has data.

        Parameters
        ----------
        first_line, first_sample, lines, samples : int
            The window [px]; it may extend beyond the raster, where there are no data.
        step : int
            Grey along either side of those returned, each of which is a mean; GDAL reads
            overviews where the raster has them.

        Returns
        -------
        pixels : ndarray of float32, shape (lines // step, samples // step)
        is_known : ndarray of bool, same shape

        Raises
        ------
        TermselError
            If GDAL cannot read it.
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
                # Of this file, whichever others are open.
                raise TermselError(f"GDAL cannot read this raster: {error.__cause__ or error}",
                                   file=self.path, hint="Copy it again: it is damaged.") from error
            # The mean over bands is masked only where all of them are.
            values = grey.astype(np.float32).mean(axis=0)
            has_data = ~np.ma.getmaskarray(values) & np.isfinite(values.data)
        # Without a stated value, areas that are exactly 0 in all bands are where an image was
        # filled up.
        if self.raster.nodatavals[self.bands[0] - 1] is None:
            has_data &= ~_is_filled(grey.data)
        pixels[part_inside] = np.where(has_data, values.data, 0)
        is_known[part_inside] = has_data
        for excluded in self.excluded:
            is_known &= ~excluded(first_line, first_sample, shape, step)
        return pixels, is_known

    def known_at(self, positions: FloatArray) -> Mask:
        """Return which places (n, 2) [px] have data near them, as a reduced raster shows it.

        False outside the raster.
        """
        inside = np.all((positions >= 0) & (positions <= np.array(self.size) - 1), axis=1)
        if not inside.any():
            return np.asarray(inside)
        # One window around all positions, reduced to some 200 px, says whether there are data near.
        low = np.floor(positions[inside].min(axis=0))
        high = np.ceil(positions[inside].max(axis=0)) + 1
        step = int(max(1, (high - low).max() // _LOOKED_UP_SIDE))
        (first_line, first_sample) = low.astype(int).tolist()
        (lines, samples) = (
            np.ceil((high - low) / step).astype(int) * step).tolist()
        is_known = self.read(first_line, first_sample, lines, samples, step)[1]
        # Its last row or column may be of a part of a step, which is not read.
        at = np.minimum((positions[inside] - low) // step, np.array(is_known.shape) - 2).astype(int)
        inside[inside] = is_known[tuple(np.maximum(at, 0).T)]
        return np.asarray(inside)


def _is_filled(values: NDArray[Any]) -> Mask:
    """Return where all bands (c, lines, samples) are 0 over an area, as images are filled up."""
    zero = (values == 0).all(axis=0).astype(np.uint8)
    if not zero.any():
        return np.zeros(zero.shape, dtype=bool)
    import cv2  # which a command that matches nothing need not import

    # Opening leaves only areas of zeros, not dark pixels by themselves.
    return np.asarray(cv2.morphologyEx(zero, cv2.MORPH_OPEN,
                                       np.ones((_BLANK_SIDE, _BLANK_SIDE), np.uint8))
                      > 0)


def spread_pixels(size: tuple[int, int], shape: tuple[int, ...]) -> FloatArray:
    """Return places spread evenly over an image, row by row, shape (n, 2) [px]."""
    # Both ends are part of the image: its first and its last line and sample.
    steps = (np.linspace(0, extent - 1, count) for extent, count in zip(size, shape, strict=True))
    return np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)


@contextmanager
def open_picture(path: Path | str, band: int | None = None) -> Iterator[GreyRaster]:
    """Open a raster for its brightness.

    Parameters
    ----------
    path : path-like
    band : int, optional
        Counted from 1; by default the mean of all bands but those of transparency, or of some,
        evenly spaced, where there are many.

    Raises
    ------
    TermselError
        If GDAL cannot read it, or it has no such band.
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
            # Evenly spaced numbers of bands.
            visible = tuple(visible[i * len(visible) // _BANDS] for i in range(_BANDS))
        yield GreyRaster(Path(path), raster, visible if band is None else (band,))


def stretch_to_bytes(pixels: Grey, is_known: Mask) -> NDArray[np.uint8] | None:
    """Return pixels as bytes, dark to bright, 0 where unknown; None if they have no texture."""
    values = pixels[is_known]
    if values.size < _MIN_PIXELS:
        return None
    # Percentiles and not extremes: single bright pixels do not darken all others.
    dark, bright = np.percentile(values, (_DARK_PERCENTILE, _BRIGHT_PERCENTILE))
    if not bright > dark:
        return None
    scaled = np.clip((pixels - dark) * (255 / (bright - dark)), 0, 255)
    return np.asarray(np.where(is_known, scaled, 0), dtype=np.uint8)
