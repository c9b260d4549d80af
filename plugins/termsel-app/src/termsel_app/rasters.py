"""Rasters of any size as coloured tiles: windows, overviews, colour tables and stretches.

What a tile shows is read at about its own resolution. A large raster without overviews gets one,
read once and kept in memory, so that all of it can be looked at.
"""

from __future__ import annotations

from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any

import numpy as np
from numpy.typing import NDArray

from termsel import allow_remote, open_raster
from termsel.toolkit import refuse_empty_giant, require_rasterio

Pixels = NDArray[np.uint8]
"""Red, green, blue and opacity, shape (lines, samples, 4)."""

TILE = 256
"""Pixels along either side of a tile."""
LARGE = 4096
"""Pixels of the longer side from which a raster without overviews gets one."""
OVERVIEW = 2048
"""About how many pixels an overview has along the longer side."""
_STRIP = 2**25
"""Pixels that are read at once for an overview."""
_SAMPLES = 512
"""Pixels along either side of what a stretch is taken from."""
_TAILS = (1.0, 99.0)
"""Percentiles of the pixels that become black and white."""


class Raster:
    """A raster that is open for as long as the page is; its methods may be called by any thread.

    Parameters
    ----------
    path : path-like
    remote : bool
        Whether it may be on a server.
    """

    def __init__(self, path: Path | str, remote: bool = False) -> None:
        """Open the raster, find how it is shown, and begin an overview if it is large without one.

        Raises TermselError if it cannot be opened or read; it is closed then.
        """
        self.path = path
        self.name = Path(path).name
        self._stack = ExitStack()
        if remote:
            self._stack.enter_context(allow_remote())
        self.dataset: Any = self._stack.enter_context(open_raster(path))
        # GDAL reads a dataset in one thread at a time.
        self.lock = Lock()
        self._closed = Event()
        self.height, self.width = self.dataset.shape
        try:
            self.colours = _colour_table(self.dataset)
            self.bands = _shown_bands(self.dataset, self.colours is not None)
            self._alpha = _alpha_band(self.dataset)
            self._step = 1
            self._overview: Pixels | None = None
            self.share_read = 1.0
            self.limits = self._stretch()
            # Without an overview, every tile of a coarse level would read the whole raster.
            if max(self.height, self.width) > LARGE and not self.dataset.overviews(1):
                self._begin_overview()
        except BaseException:
            self._stack.close()
            raise

    def close(self) -> None:
        """Close the file."""
        # This ends the thread that reads an overview.
        self._closed.set()
        with self.lock:
            self._stack.close()

    def _stretch(self) -> list[tuple[float, float]] | None:
        """Return the values that become black and white, for each band that is shown.

        None if the values are bytes, which are shown as they are.
        """
        # Bytes are colours already, and mostly stretched by whoever made the raster.
        if self.dataset.dtypes[self.bands[0] - 1] == "uint8":
            return None
        values = np.concatenate(self._sample_values(), axis=1)
        limits = []
        for band in values:
            finite = band[np.isfinite(band)]
            # With the extremes in place of percentiles, a few bright pixels would make all others
            # black.
            low, high = np.percentile(finite, _TAILS) if finite.size else (0.0, 1.0)
            limits.append((float(low), float(high if high > low else low + 1.0)))
        return limits

    def _sample_values(self) -> list[Any]:
        """Return values of the bands shown from all over the raster, in arrays (bands, n).

        There is one array of a raster that is small or has overviews, else one of each of sixteen
        blocks. Values without data are NaN.
        """
        from rasterio.windows import Window

        if self.dataset.overviews(1) or self.height * self.width <= LARGE**2:
            shape = (len(self.bands), min(self.height, _SAMPLES), min(self.width, _SAMPLES))
            windows = [(Window(0, 0, self.width, self.height), shape)]
        else:
            length = _SAMPLES // 4
            # Blocks are read, as single pixels all over the raster would cost a read each.
            windows = [(Window(int(x), int(y), length, length), (len(self.bands), length, length))
                       for y in np.linspace(0, self.height - length, 4)
                       for x in np.linspace(0, self.width - length, 4)]
        return [self.dataset.read(self.bands, window=window, out_shape=shape, masked=True)
                .astype(np.float64).filled(np.nan).reshape(len(self.bands), -1)
                for window, shape in windows]

    def _begin_overview(self) -> None:
        """Start a thread that reads a reduced copy of the raster, which tiles are then made from.
        """
        self._step = int(np.ceil(max(self.height, self.width) / OVERVIEW))
        shape = (-(-self.height // self._step), -(-self.width // self._step))
        self._overview = np.zeros((*shape, 4), dtype=np.uint8)
        self.share_read = 0.0
        Thread(target=self._read_overview, daemon=True).start()

    def _read_overview(self) -> None:
        """Fill the overview strip by strip from the top, until it is whole or the raster is closed.

        `share_read` says how much of it there is, from 0 to 1. It runs in a thread of its own.
        """
        overview = self._overview
        assert overview is not None
        step = self._step
        block = self.dataset.block_shapes[0][0]
        lines = max(_STRIP // self.width // block, 1) * block
        # A row of the overview is the line in the middle of its step. Strips end between blocks,
        # and have the rows whose lines they hold, so that no block is read twice.
        middles = np.minimum(np.arange(len(overview)) * step + step // 2, self.height - 1)
        for top in range(0, self.height, lines):
            if self._closed.is_set():
                return
            first, end = np.searchsorted(middles, [top, top + lines]).tolist()
            # A step may reach over several blocks of a line each.
            if first < end:
                count = min(end * step, self.height) - first * step
                overview[first:end] = self._read((first * step, 0, count, self.width),
                                                 (end - first, overview.shape[1]), average=False)
            self.share_read = min(top + lines, self.height) / self.height

    def _read(self, box: tuple[float, float, float, float], shape: tuple[int, int],
              average: bool) -> Pixels:
        """Return the colours of a box inside the raster in a shape, (*shape, 4).

        The box is top, left, height and width [px]. With `average`, colours of several pixels are
        averaged, else the nearest pixel counts. All is transparent once the raster is closed.
        """
        from rasterio.enums import Resampling
        from rasterio.windows import Window

        first_line, first_sample, height, width = box
        window = Window(first_sample, first_line, width, height)
        # The mean of two indices of a palette is the index of a third colour.
        is_averaged = average and self.colours is None
        resampling = Resampling.average if is_averaged else Resampling.nearest
        with self.lock:
            if self._closed.is_set():
                return np.zeros((*shape, 4), dtype=np.uint8)
            values = self.dataset.read(self.bands, window=window, resampling=resampling,
                                       out_shape=(len(self.bands), *shape))
            mask = self._read_opacity(window, shape)
        return self.coloured(values, mask)

    def _read_opacity(self, window: Any, shape: tuple[int, int]) -> NDArray[np.uint8] | None:
        """Return the opacity of a window, 0 to 255, reduced to `shape` (lines, samples).

        It is that of the band of opacity, else of the mask that GDAL states. None for a raster that
        is opaque.
        """
        from rasterio.enums import MaskFlags

        flags = self.dataset.mask_flag_enums[0]
        # Reading a mask that hides nothing would double the time.
        if self._alpha is None and MaskFlags.all_valid in flags:
            return None
        if self._alpha is not None:
            alpha = self.dataset.read(self._alpha, window=window, out_shape=shape)
            return np.asarray(alpha if alpha.dtype == np.uint8 else (alpha > 0) * 255,
                              dtype=np.uint8)
        return np.asarray(self.dataset.read_masks(1, window=window, out_shape=shape))

    def coloured(self, values: Any, mask: NDArray[np.uint8] | None) -> Pixels:
        """Return values of the bands shown (bands, lines, samples) as colours (lines, samples, 4).

        `mask` is their opacity, None for opaque.
        """
        shape = values.shape[1:]
        pixels = np.empty((*shape, 4), dtype=np.uint8)
        pixels[..., 3] = 255 if mask is None else mask
        if self.colours is not None:
            colours = self.colours[np.clip(values[0], 0, len(self.colours) - 1).astype(np.intp)]
            pixels[..., :3] = colours[..., :3]
            pixels[..., 3] = np.minimum(pixels[..., 3], colours[..., 3])
            return pixels
        # One band is shown as grey: three times the same.
        for band in range(3):
            source = min(band, len(values) - 1)
            pixels[..., band] = self._as_bytes(values[source], source)
        # NaN is no value, though some masks have it as valid.
        if values.dtype.kind in "fc":
            pixels[..., 3][~np.isfinite(values).all(axis=0)] = 0
        return pixels

    def _as_bytes(self, values: Any, band: int) -> Any:
        """Return values of a band as bytes, from black, 0, to white, 255; bytes stay as they are.

        `band` counts the bands shown from 0. NaN becomes as dark as 0.
        """
        if self.limits is None:
            return values
        low, high = self.limits[band]
        scaled = (np.nan_to_num(np.real(values).astype(np.float32)) - low) * (255 / (high - low))
        return np.clip(scaled, 0, 255).astype(np.uint8)

    def pixels(self, box: tuple[float, float, float, float], shape: tuple[int, int]) -> Pixels:
        """Return the colours of a box in a shape, (*shape, 4), transparent outside the raster.

        Parameters
        ----------
        box : tuple of float
            Top, left, height and width [px], from the outer corner of the upper-left pixel.
        shape : tuple of int
            Lines and samples to return.
        """
        first_line, first_sample, height, width = box
        steps = np.array([height / shape[0], width / shape[1]])
        result = np.zeros((*shape, 4), dtype=np.uint8)
        first = []
        last = []
        # From the first to the last pixel of the answer, along either axis, centres are inside.
        for start, step, count, size in zip((first_line, first_sample), steps, shape,
                                            (self.height, self.width), strict=True):
            first.append(max(int(np.ceil(-start / step - 0.5)), 0))
            last.append(min(int(np.floor((size - start) / step + 0.5)), count))
        if first[0] >= last[0] or first[1] >= last[1]:
            return result
        visible = (slice(first[0], last[0]), slice(first[1], last[1]))
        overview = self._overview
        # An overview in memory answers at once, by the pixel nearest to each centre.
        if overview is not None and steps.min() >= self._step:
            centres = [np.clip((start + (np.arange(low, high) + 0.5) * step) / self._step, 0,
                               count - 1).astype(np.intp)
                       for start, low, high, step, count in zip(
                           (first_line, first_sample), first, last, steps, overview.shape[:2],
                           strict=True)]
            result[visible] = overview[np.ix_(*centres)]
            return result
        # Rounding may leave the box a little outside the raster, where nothing can be read.
        inside = (np.clip(first_line + first[0] * steps[0], 0, self.height),
                  np.clip(first_sample + first[1] * steps[1], 0, self.width))
        inner = (min((last[0] - first[0]) * steps[0], self.height - inside[0]),
                 min((last[1] - first[1]) * steps[1], self.width - inside[1]))
        result[visible] = self._read((*inside, *inner), (last[0] - first[0], last[1] - first[1]),
                                     average=bool(1 < steps.max() <= 16
                                                  or self.dataset.overviews(1)))
        return result


def _colour_table(dataset: Any) -> Pixels | None:
    """Return the colours of a palette (n, 4) by index; None if the raster has no palette."""
    try:
        table = dataset.colormap(1)
    except ValueError:
        return None
    # A palette may have gaps, whose indices stay transparent.
    colours = np.zeros((max(table) + 1, 4), dtype=np.uint8)
    for index, colour in table.items():
        colours[index] = colour
    return colours


def _shown_bands(dataset: Any, indexed: bool) -> list[int]:
    """Return the numbers, from 1, of the three bands that are shown, or of the only one.

    They are red, green and blue, or else the first three bands but for opacity; of fewer the first.
    `indexed` says whether values are indices of a palette, which has one band.
    """
    from rasterio.enums import ColorInterp

    if indexed:
        return [1]
    kinds = list(dataset.colorinterp)
    colours = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
    if all(colour in kinds for colour in colours):
        return [kinds.index(colour) + 1 for colour in colours]
    # GDAL and QGIS take bands without names of colours in their order too.
    visible = [i + 1 for i, kind in enumerate(kinds) if kind != ColorInterp.alpha] or [1]
    return visible[:3] if len(visible) >= 3 else visible[:1]


def _alpha_band(dataset: Any) -> int | None:
    """Return the number of the band of opacity, from 1; None if there is none."""
    from rasterio.enums import ColorInterp

    kinds = list(dataset.colorinterp)
    return kinds.index(ColorInterp.alpha) + 1 if ColorInterp.alpha in kinds else None


def encode_png(pixels: Pixels) -> bytes:
    """Return pixels (lines, samples, 4) as the content of a PNG file."""
    from PIL import Image

    file = BytesIO()
    Image.fromarray(pixels).save(file, "PNG", compress_level=1)
    return file.getvalue()


def refuse_giant(path: Path | str) -> None:
    """Raise TermselError for a small file that states a huge raster, as `termsel rectify` does."""
    require_rasterio()
    with open_raster(path) as dataset:
        refuse_empty_giant(dataset)
