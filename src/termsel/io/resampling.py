"""Pixels of a map by interpolation between those of an image, at positions that are known.

The kernels are those of GDAL's warper: triangle, cubic convolution (Keys 1981, IEEE Trans. ASSP 29,
1153-1160, a = -1/2), cubic B-spline, Lanczos' windowed sinc, and the mean over a pixel of the map.
Where a pixel of the map is larger than that of the image, they are widened by as much, so that no
pixel of the image is left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from termsel.adjustment.compiled import compile_lazily
from termsel.data.features import BoolArray, FloatArray

Values = NDArray[Any]

KERNELS = {"nearest": 0, "bilinear": 1, "cubic": 2, "cubic_spline": 3, "lanczos": 4, "average": 5}
"""Resamplings by name, with the numbers that the compiled code has for them."""

RADII = (0.5, 1.0, 2.0, 2.0, 3.0, 0.5)
"""Distance at which each kernel ends [px]."""

ALIKE_PIXEL_RATIO = 1.05
"""Pixels of the map by those of the image, up to which they count as alike."""

_MIN_WEIGHT_SUM = 1e-5  # sum of weights of pixels with data, below which there is nothing to show


@dataclass(frozen=True, eq=False)
class ImageWindow:
    """A part of an image: values (bands, lines, samples), and which of them are data.

    `line` and `sample` are those of its first pixel.
    """

    values: Values
    has_data: BoolArray  # (bands, lines, samples)
    line: int
    sample: int


def resample_pixels(window: ImageWindow, positions: FloatArray, resampling: str,
                    size: tuple[int, int], empty: Values) -> tuple[Values, BoolArray]:
    """Return pixels of a map at positions in an image, and where they show something.

    Parameters
    ----------
    window : ImageWindow
        As much of the image as the positions need.
    positions : ndarray, shape (lines, samples, 2)
        Line and sample of the image [px]; NaN where there is none.
    resampling : str
        One of `KERNELS`.
    size : tuple of int
        Lines and samples of the whole image: outside of it nothing is shown.
    empty : ndarray, shape (bands,)
        What a band has where it has no data.

    Returns
    -------
    values : ndarray, shape (bands, lines, samples)
        Of the type of the image; those of `empty` where nothing shows.
    visible : ndarray of bool, shape (bands, lines, samples)
        Whether a value is one of the image.
    """
    kernel = KERNELS[resampling]
    bands = len(window.values)
    values = np.empty((bands, *positions.shape[:2]), dtype=window.values.dtype)
    values[:] = empty.astype(window.values.dtype)[:, None, None]
    visible = np.zeros(values.shape, dtype=bool)
    # Means of whole numbers are rounded; a value outside the range of the type would wrap around.
    is_integral = window.values.dtype.kind in "iu"
    low = -np.inf
    high = np.inf
    if is_integral:
        low = float(np.iinfo(window.values.dtype).min)
        high = float(np.iinfo(window.values.dtype).max)
    # Where pixels of the map are larger than those of the image, kernels are widened by as much.
    stretch = np.maximum(_stretch(positions), 1.0)
    # A few per cent of difference are no reason to blur the map.
    stretch[stretch <= ALIKE_PIXEL_RATIO] = 1.0
    if kernel == KERNELS["nearest"]:
        stretch[:] = 1.0
    fill = _fill_complex if window.values.dtype.kind == "c" else _fill
    fill(window.values, window.has_data, window.line, window.sample,
         np.ascontiguousarray(positions), kernel, RADII[kernel], stretch[0], stretch[1],
         size[0], size[1], is_integral, low, high, values, visible)
    return values, visible


def reach(resampling: str, positions: FloatArray) -> FloatArray:
    """Return the reach of a kernel around positions, along lines and samples [px], (2,)."""
    # One pixel more, as positions lie between pixels.
    return RADII[KERNELS[resampling]] * np.maximum(_stretch(positions), 1.0) + 1.0


def extent_of_positions(
        positions: FloatArray, lines: int, samples: int) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest line and sample of positions inside an image, (2,) each.

    The largest are below the least where there are none.
    """
    bounds = np.array([np.inf, np.inf, -np.inf, -np.inf])
    _widen_bounds(positions, lines, samples, bounds)
    return bounds[:2], bounds[2:]


def _widen_bounds(positions: Any, lines: int, samples: int, bounds: Any) -> None:
    """Widen `bounds` in place to all positions (n, m, 2), line and sample, inside an image.

    `bounds` (4,) are the least line and sample, then the largest. Arrays are `Any`, as the function
    is compiled.
    """
    for i in range(positions.shape[0]):
        for j in range(positions.shape[1]):
            line = positions[i, j, 0]
            sample = positions[i, j, 1]
            # From the outer edge of the first pixel to that of the last.
            if -0.5 <= line < lines - 0.5 and -0.5 <= sample < samples - 0.5:
                bounds[0] = min(bounds[0], line)
                bounds[1] = min(bounds[1], sample)
                bounds[2] = max(bounds[2], line)
                bounds[3] = max(bounds[3], sample)


_widen_bounds = compile_lazily(_widen_bounds)


def _stretch(positions: FloatArray) -> FloatArray:
    """Return how many pixels of the image a step of one pixel on the map covers, (2,).

    Along lines and along samples of the image: the root of the sum of squares over both directions
    of the map. 0 where no neighbouring positions (n, m, 2) are known.
    """
    squares = np.zeros(2)
    for axis in (0, 1):
        # Every eighth position is enough: neighbouring tiles are alike.
        steps = np.diff(positions[::8, ::8], axis=axis) / 8.0
        finite = np.isfinite(steps).all(axis=-1)
        if finite.any():
            squares += np.median(steps[finite] ** 2, axis=0)
    return np.asarray(np.sqrt(squares))


def _kernel_weight(distance: float, kernel: int, stretch: float) -> float:
    """Return the weight of a pixel at a distance from a position [px].

    `kernel` is the number of a resampling: 1 triangle, 2 cubic, 3 B-spline, 4 Lanczos, 5 mean over
    the area. `stretch` is how many pixels of the image one of the map covers, by which the kernel
    is widened so that nothing is skipped.
    """
    # The part of the pixel that lies in an interval of `stretch` pixels.
    if kernel == 5:
        half_interval = 0.5 * stretch
        return max(min(distance + 0.5, half_interval) - max(distance - 0.5, -half_interval), 0.0)
    x = abs(distance) / stretch
    # Triangle: 1 - |x|.
    if kernel == 1:
        return max(1.0 - x, 0.0)
    # Keys (1981), equation 15, with a = -1/2.
    if kernel == 2:
        if x < 1.0:
            return (1.5 * x - 2.5) * x * x + 1.0
        return ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0 if x < 2.0 else 0.0
    # The B-spline of degree 3, which does not go through the pixels.
    if kernel == 3:
        if x < 1.0:
            return (0.5 * x - 1.0) * x * x + 2.0 / 3.0
        return (2.0 - x) ** 3 / 6.0 if x < 2.0 else 0.0
    if x >= 3.0:
        return 0.0
    if x < 1e-9:
        return 1.0
    # Lanczos: sinc(x) sinc(x / 3).
    turn = np.pi * x
    return float(3.0 * np.sin(turn) * np.sin(turn / 3.0) / (turn * turn))


_kernel_weight = compile_lazily(_kernel_weight)


def _fill_pixels(pixels: Any, has_data: Any, first_line: int, first_sample: int, positions: Any,
                 kernel: int, radius: float, stretch_line: float, stretch_sample: float, lines: int,
                 samples: int, integral: bool, low: float, high: float, values: Any,
                 visible: Any) -> None:
    """Fill a tile of the map, pixel by pixel, with weighted means of pixels of the image.

    A value is sum(w p) / sum(w) over the pixels below the kernel that have data, so that holes do
    not darken their surroundings. The weight is a product of one along lines and one along samples.

    Parameters
    ----------
    pixels, has_data : window of the image (bands, rows, columns), which begins at first_line and
        first_sample
    positions : of the map's pixels in the image (m, n, 2), NaN for none
    kernel, radius : number of the resampling in `KERNELS`, and its reach [px], which is widened by
        stretch_line and stretch_sample
    lines, samples : size of the whole image
    integral, low, high : whether values are rounded, and their range
    values, visible : receive the tile (bands, m, n), and where it shows the image
    """
    bands, rows, columns = pixels.shape
    reach_line = radius * stretch_line
    reach_sample = radius * stretch_sample
    if kernel == 5:  # of pixels that an interval touches
        reach_line = reach_line + 0.5
        reach_sample = reach_sample + 0.5
    longest = int(2.0 * max(reach_line, reach_sample)) + 3
    of_line = np.empty(longest)
    of_sample = np.empty(longest)
    for i in range(positions.shape[0]):
        for j in range(positions.shape[1]):
            line = positions[i, j, 0]
            sample = positions[i, j, 1]
            # Nothing is shown outside the outermost pixels; NaN is not inside either.
            if not (-0.5 <= line < lines - 0.5 and -0.5 <= sample < samples - 0.5):
                continue
            line = line - first_line
            sample = sample - first_sample
            row = min(max(int(np.floor(line + 0.5)), 0), rows - 1)
            column = min(max(int(np.floor(sample + 0.5)), 0), columns - 1)
            if kernel == 0:
                for band in range(bands):
                    if has_data[band, row, column]:
                        values[band, i, j] = pixels[band, row, column]
                        visible[band, i, j] = True
                continue
            # Weights are products of one along lines and one along samples: each is computed once.
            top = max(int(np.ceil(line - reach_line)), 0)
            bottom = min(int(np.floor(line + reach_line)), rows - 1)
            leftmost = max(int(np.ceil(sample - reach_sample)), 0)
            rightmost = min(int(np.floor(sample + reach_sample)), columns - 1)
            for r in range(top, bottom + 1):
                of_line[r - top] = _kernel_weight(r - line, kernel, stretch_line)
            for c in range(leftmost, rightmost + 1):
                of_sample[c - leftmost] = _kernel_weight(c - sample, kernel, stretch_sample)
            for band in range(bands):
                # A pixel of the map shows what its own place in the image shows.
                if not has_data[band, row, column]:
                    continue
                # The weighted mean of those pixels that have data.
                total = 0.0
                weights = 0.0
                for r in range(top, bottom + 1):
                    for c in range(leftmost, rightmost + 1):
                        if has_data[band, r, c]:
                            weight = of_line[r - top] * of_sample[c - leftmost]
                            weights += weight
                            total += weight * pixels[band, r, c]
                # At an edge the kernel may have almost no pixels below it.
                if weights > _MIN_WEIGHT_SUM:
                    value = total / weights
                    if integral:
                        value = min(max(np.floor(value + 0.5), low), high)
                    values[band, i, j] = value
                    visible[band, i, j] = True


_fill = compile_lazily(_fill_pixels)


def _filled_complex(pixels: Any, has_data: Any, first_line: int, first_sample: int, positions: Any,
                    kernel: int, radius: float, stretch_line: float, stretch_sample: float,
                    lines: int, samples: int, integral: bool, low: float, high: float, values: Any,
                    visible: Any) -> None:
    """Fill a tile of complex pixels: real and imaginary parts each as `_fill_pixels` does."""
    # A sum of pixels times real weights has the sums of both parts as its parts.
    for component in range(2):
        component_pixels = pixels.real.copy() if component == 0 else pixels.imag.copy()
        component_values = np.zeros(values.shape, dtype=component_pixels.dtype)
        _fill(component_pixels, has_data, first_line, first_sample, positions, kernel, radius,
              stretch_line, stretch_sample, lines, samples, integral, low, high,
              component_values, visible)
        if component == 0:
            values.real[visible] = component_values[visible]
        else:
            values.imag[visible] = component_values[visible]


_fill_complex = _filled_complex
