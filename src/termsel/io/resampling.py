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

from termsel.adjustment.compiled import compiled
from termsel.data.features import BoolArray, FloatArray

Values = NDArray[Any]

KERNELS = {"nearest": 0, "bilinear": 1, "cubic": 2, "cubic_spline": 3, "lanczos": 4, "average": 5}
"""Resamplings by name, with the numbers that the compiled code has for them."""

RADII = (0.5, 1.0, 2.0, 2.0, 3.0, 0.5)
"""Distance at which each kernel ends [px]."""

ALIKE = 1.05
"""Pixels of the map by those of the image, up to which they count as alike."""

_LEAST = 1e-5  # sum of weights of pixels with data, below which there is nothing to show


@dataclass(frozen=True, eq=False)
class Part:
    """A part of an image: values (bands, lines, samples), and which of them are data.

    `line` and `sample` are those of its first pixel.
    """

    values: Values
    known: BoolArray  # (bands, lines, samples)
    line: int
    sample: int


def resampled(part: Part, positions: FloatArray, resampling: str, size: tuple[int, int],
              empty: Values) -> tuple[Values, BoolArray]:
    """Return pixels of a map at positions in an image, and where they show something.

    Parameters
    ----------
    part : Part
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
    shown : ndarray of bool, shape (bands, lines, samples)
    """
    kernel = KERNELS[resampling]
    bands = len(part.values)
    values = np.empty((bands, *positions.shape[:2]), dtype=part.values.dtype)
    values[:] = empty.astype(part.values.dtype)[:, None, None]
    shown = np.zeros(values.shape, dtype=bool)
    # Sums of whole numbers are rounded, and kept in the range of their type.
    whole = part.values.dtype.kind in "iu"
    low, high = (float(np.iinfo(part.values.dtype).min), float(np.iinfo(part.values.dtype).max)) \
        if whole else (-np.inf, np.inf)
    stretch = np.maximum(_stretch(positions), 1.0)
    stretch[stretch <= ALIKE] = 1.0
    if kernel == KERNELS["nearest"]:
        stretch[:] = 1.0
    fill = _fill_complex if part.values.dtype.kind == "c" else _fill
    fill(part.values, part.known, part.line, part.sample, np.ascontiguousarray(positions), kernel,
         RADII[kernel], stretch[0], stretch[1], size[0], size[1], whole, low, high, values, shown)
    return values, shown


def reach(resampling: str, positions: FloatArray) -> FloatArray:
    """Return how far kernels reach around positions, along lines and samples [px]."""
    return RADII[KERNELS[resampling]] * np.maximum(_stretch(positions), 1.0) + 1.0


def extent(positions: FloatArray, lines: int, samples: int) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest line and sample of positions inside an image, (2,) each.

    The largest are below the least where there are none.
    """
    bounds = np.array([np.inf, np.inf, -np.inf, -np.inf])
    _bounds(positions, lines, samples, bounds)
    return bounds[:2], bounds[2:]


def _bounds_inside(positions: Any, lines: int, samples: int, bounds: Any) -> None:
    """Widen `bounds` (4,) to all positions (n, m, 2) inside an image."""
    for i in range(positions.shape[0]):
        for j in range(positions.shape[1]):
            line = positions[i, j, 0]
            sample = positions[i, j, 1]
            if -0.5 <= line < lines - 0.5 and -0.5 <= sample < samples - 0.5:
                bounds[0] = min(bounds[0], line)
                bounds[1] = min(bounds[1], sample)
                bounds[2] = max(bounds[2], line)
                bounds[3] = max(bounds[3], sample)


_bounds = compiled(_bounds_inside)


def _stretch(positions: FloatArray) -> FloatArray:
    """Return how many pixels of the image a step on the map takes, along lines and samples."""
    squares = np.zeros(2)
    for axis in (0, 1):
        steps = np.diff(positions[::8, ::8], axis=axis) / 8.0
        known = np.isfinite(steps).all(axis=-1)
        if known.any():
            squares += np.median(steps[known] ** 2, axis=0)
    return np.asarray(np.sqrt(squares))


def _weight(distance: float, kernel: int, stretch: float) -> float:
    """Return the weight of a pixel at a distance from a position [px]."""
    if kernel == 5:  # the part of the pixel that lies in the interval
        half = 0.5 * stretch
        return max(min(distance + 0.5, half) - max(distance - 0.5, -half), 0.0)
    x = abs(distance) / stretch
    if kernel == 1:
        return max(1.0 - x, 0.0)
    if kernel == 2:
        if x < 1.0:
            return (1.5 * x - 2.5) * x * x + 1.0
        return ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0 if x < 2.0 else 0.0
    if kernel == 3:
        if x < 1.0:
            return (0.5 * x - 1.0) * x * x + 2.0 / 3.0
        return (2.0 - x) ** 3 / 6.0 if x < 2.0 else 0.0
    if x >= 3.0:
        return 0.0
    if x < 1e-9:
        return 1.0
    turn = np.pi * x
    return float(3.0 * np.sin(turn) * np.sin(turn / 3.0) / (turn * turn))


_weight = compiled(_weight)


def _filled(pixels: Any, known: Any, first_line: int, first_sample: int, positions: Any,
            kernel: int, radius: float, stretch_line: float, stretch_sample: float, lines: int,
            samples: int, whole: bool, low: float, high: float, values: Any, shown: Any) -> None:
    """Fill `values` and `shown` (bands, lines, samples), pixel by pixel of the map."""
    bands, rows, columns = pixels.shape
    reach_line = radius * stretch_line
    reach_sample = radius * stretch_sample
    if kernel == 5:  # of pixels that an interval touches
        reach_line = reach_line + 0.5
        reach_sample = reach_sample + 0.5
    most = int(2.0 * max(reach_line, reach_sample)) + 3
    of_line = np.empty(most)
    of_sample = np.empty(most)
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
                    if known[band, row, column]:
                        values[band, i, j] = pixels[band, row, column]
                        shown[band, i, j] = True
                continue
            top = max(int(np.ceil(line - reach_line)), 0)
            bottom = min(int(np.floor(line + reach_line)), rows - 1)
            left = max(int(np.ceil(sample - reach_sample)), 0)
            right = min(int(np.floor(sample + reach_sample)), columns - 1)
            for r in range(top, bottom + 1):
                of_line[r - top] = _weight(r - line, kernel, stretch_line)
            for c in range(left, right + 1):
                of_sample[c - left] = _weight(c - sample, kernel, stretch_sample)
            for band in range(bands):
                # A pixel of the map shows what its own place in the image shows.
                if not known[band, row, column]:
                    continue
                total = 0.0
                weights = 0.0
                for r in range(top, bottom + 1):
                    for c in range(left, right + 1):
                        if known[band, r, c]:
                            weight = of_line[r - top] * of_sample[c - left]
                            weights += weight
                            total += weight * pixels[band, r, c]
                if weights > _LEAST:
                    value = total / weights
                    if whole:
                        value = min(max(np.floor(value + 0.5), low), high)
                    values[band, i, j] = value
                    shown[band, i, j] = True


_fill = compiled(_filled)


def _filled_complex(pixels: Any, known: Any, first_line: int, first_sample: int, positions: Any,
                    kernel: int, radius: float, stretch_line: float, stretch_sample: float,
                    lines: int, samples: int, whole: bool, low: float, high: float, values: Any,
                    shown: Any) -> None:
    """Fill both parts of complex pixels."""
    for part in range(2):
        some = pixels.real.copy() if part == 0 else pixels.imag.copy()
        made = np.zeros(values.shape, dtype=some.dtype)
        _fill(some, known, first_line, first_sample, positions, kernel, radius, stretch_line,
              stretch_sample, lines, samples, whole, low, high, made, shown)
        if part == 0:
            values.real[shown] = made[shown]
        else:
            values.imag[shown] = made[shown]


_fill_complex = _filled_complex
