"""Where the pixels of a map are in an image, by any fitted model, relief included.

A model is asked at nodes of a coarse grid on the map, at a few heights. Between nodes positions are
bilinear in the plane, between heights quadratic, and every pixel has the height of the ground at
its own place. The grid is made finer until positions at random pixels are within `CLOSE_PX` of the
model's own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from termsel.adjustment.compiled import compile_lazily
from termsel.data.coordinates.crs import horizontal_crs, plane_transformer
from termsel.data.coordinates.longitudes import nearest_longitudes, turn_of
from termsel.data.features import FloatArray
from termsel.fitting.fit import Fit
from termsel.formats.heights import Dem

CLOSE_PX = 0.03
"""Largest error of interpolated positions at pixels that are tried [px]: others are seldom above
0.05."""

COARSEST, FINEST = 64, 4
"""Pixels of the map between nodes."""

TRIED = 150
"""Pixels of a tile at which positions are compared with the model's own."""

LEVELS = 3
"""Heights at which a model is asked: it is quadratic between them."""

HEIGHT_MARGIN = 1.0
"""What the lowest and highest of these heights are beyond those of the ground."""

AT_ONCE = 20_000
"""Places at which a model is asked at once."""

LARGEST_DEM = 1 << 24
"""Pixels of a raster of heights that are read for a tile at once; of more, each place is looked up.
"""

_NODE_MARGIN = 0.1  # of the image's extent on the ground, in which nodes still count
_COARSER_SHARE = 0.125  # part of `CLOSE_PX`, below which the next tile is tried with a coarser grid


@dataclass(eq=False)
class MapPositions:
    """Positions in an image of the pixels of a map, tile by tile.

    Parameters
    ----------
    fitted : Fit
    crs : str
        Of the map.
    surface : Dem or float
        The ground.
    footprint : ndarray, shape (n, 3)
        Places on the ground of the image's edges and inside, in the CRS of the control.
    """

    fitted: Fit
    crs: str
    surface: Dem | float
    footprint: FloatArray
    _step: int = field(default=COARSEST, init=False)
    _rng: Any = field(default_factory=lambda: np.random.default_rng(0), init=False)

    def of_tile(self, shape: tuple[int, int], transform: Any) -> FloatArray:
        """Return line and sample in the image of the pixels of a tile, (lines, samples, 2).

        Returns NaN for pixels that the image does not show, or whose height is not known.

        Parameters
        ----------
        shape : tuple of int
            Lines and samples.
        transform : affine.Affine
            From samples and lines, counted from the outer corner of its first pixel, to x and y.
        """
        heights = self._heights_of_tile(shape, transform)
        has_height = np.isfinite(heights)
        if not has_height.any():
            return np.full((*shape, 2), np.nan)
        levels = self._height_levels(
            float(heights[has_height].min()), float(heights[has_height].max()))
        sampled = self._draw_pixels(has_height)
        plan = self._ground_of_pixels(sampled.astype(np.float64) + 0.5, transform)
        exact = self._image_positions(np.column_stack([plan, heights[tuple(sampled.T)]]))
        # The step is halved until the largest error at the sampled pixels is below `CLOSE_PX`; it
        # begins with the one that the last tile needed, as neighbours are alike.
        step = self._step
        while True:
            positions = self._interpolate_positions(shape, transform, heights, levels, step)
            error = _largest_distance(positions[tuple(sampled.T)], exact)
            if error <= CLOSE_PX or step <= FINEST:
                break
            step //= 2
        self._step = min(2 * step, COARSEST) if error < _COARSER_SHARE * CLOSE_PX else step
        if error > CLOSE_PX:
            return self._position_each_pixel(shape, transform, heights)
        return positions

    def _draw_pixels(self, has_height: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Return lines and samples (m, 2) of random pixels of a tile whose height is known.

        At most TRIED of them, some of which may be the same.
        """
        with_height = np.argwhere(has_height) if has_height.mean() < 0.5 else None
        if with_height is not None:
            return np.asarray(with_height[self._rng.integers(0, len(with_height), TRIED)])
        # Most pixels have heights: four times as many are drawn as are needed.
        pixels = np.stack([self._rng.integers(0, size, 4 * TRIED)
                           for size in has_height.shape], axis=1)
        return np.asarray(pixels[has_height[tuple(pixels.T)]][:TRIED])

    def _interpolate_positions(self, shape: tuple[int, int], transform: Any, heights: FloatArray,
                               levels: FloatArray, step: int) -> FloatArray:
        """Return the line and sample in the image of the pixels of a tile, (lines, samples, 2).

        They are computed at nodes, every `step` pixels, at each of the `levels` of height, and
        interpolated at the `heights` (lines, samples) of the pixels.
        """
        nodes, size = _grid_over_tile(shape, step)
        plan = self._ground_of_pixels(nodes, transform)
        # Heights move positions by more than a line: each node is projected at every level.
        at_levels = np.stack(
            [
                self._image_positions(np.column_stack([plan, np.full(len(plan), level)]))
                for level in levels
            ]
        )
        positions = np.empty((*shape, 2))
        _between(at_levels.reshape(len(levels), *size, 2), levels, heights, step, positions)
        return positions

    def _position_each_pixel(self, shape: tuple[int, int], transform: Any,
                             heights: FloatArray) -> FloatArray:
        """Return the positions of all pixels, (lines, samples, 2), each computed by the model.

        They are for tiles where the model bends too much to be interpolated.
        """
        # The middles of the pixels: maps are counted from the corner of the first pixel.
        lines, samples = np.indices(shape)
        pixels: FloatArray = np.column_stack([lines.ravel(), samples.ravel()]) + np.float64(0.5)
        positions = np.empty((len(pixels), 2))
        flat = heights.ravel()
        for start in range(0, len(pixels), AT_ONCE):
            batch = slice(start, start + AT_ONCE)
            plan = self._ground_of_pixels(pixels[batch], transform)
            positions[batch] = self._image_positions(np.column_stack([plan, flat[batch]]))
        return positions.reshape(*shape, 2)

    def _image_positions(self, ground: FloatArray) -> FloatArray:
        """Return line and sample (n, 2) of places (n, 3) on the ground.

        Returns NaN for places that are not known, behind a pole of the model, or far outside the
        image: the model would compute nonsense.
        """
        positions = np.full((len(ground), 2), np.nan)
        is_valid = np.isfinite(ground).all(axis=1) & self._is_near(ground[:, :2])
        is_valid[is_valid] = self.fitted.holds(ground[is_valid])
        if is_valid.any():
            with np.errstate(all="ignore"):
                positions[is_valid] = self.fitted.project(ground[is_valid])
        return positions

    def _is_near(self, plan: FloatArray) -> NDArray[np.bool_]:
        """Return which places (n, 2) are about where the image is, (n,): beyond, polynomials turn.
        """
        normals, offsets = self._hull
        return np.asarray((plan @ normals.T <= offsets).all(axis=1))

    @cached_property
    def _hull(self) -> tuple[FloatArray, FloatArray]:
        """Normals (k, 2) and offsets (k,) of a convex polygon around the image on the ground.

        A place x is inside where n . x <= offset for all normals n. The polygon has a margin of
        _NODE_MARGIN times its extent.
        """
        from scipy.spatial import ConvexHull  # takes long to import

        corners = self.footprint[np.isfinite(self.footprint[:, :2]).all(axis=1), :2]
        equations = ConvexHull(corners).equations
        margin = _NODE_MARGIN * float(np.ptp(corners, axis=0).max())
        return equations[:, :2], margin - equations[:, 2]

    def _height_levels(self, low: float, high: float) -> FloatArray:
        """Return the heights (l,) at which the model is evaluated; one if it uses none."""
        if not self.fitted.model.uses_height or low == high:
            return np.array([low])
        return np.linspace(low - HEIGHT_MARGIN, high + HEIGHT_MARGIN, LEVELS)

    def _ground_of_pixels(self, pixels: FloatArray, transform: Any) -> FloatArray:
        """Return x and y (n, 2), in the CRS of the control, of lines and samples (n, 2) of a tile.
        """
        x, y = transform @ (pixels[:, 1], pixels[:, 0])
        ground = np.stack(self._to_ground.transform(x, y), axis=1)
        if turn := turn_of(self.fitted.control.crs):
            # By whole turns next to the image, which may lie across 180 degrees.
            lon = self.footprint[:, 0]
            ground[:, 0] = nearest_longitudes(ground[:, 0],
                                              float(np.nanmin(lon) + np.nanmax(lon)) / 2, turn)
        return ground

    @cached_property
    def _to_ground(self) -> Any:
        return plane_transformer(self.crs, horizontal_crs(self.fitted.control.crs))

    def _heights_of_tile(self, shape: tuple[int, int], transform: Any) -> FloatArray:
        """Return the heights of the ground at the pixels of a tile, (lines, samples).

        PROJ is asked at nodes of a coarse grid alone, as positions in the raster and the offset of
        its datum are smooth between; the heights of the ground, which are not, are interpolated in
        the raster for each pixel. Where the part of the raster below the tile is too large to be
        read at once, each pixel is looked up by itself.
        """
        surface = self.surface
        if not isinstance(surface, Dem):
            return np.full(shape, float(surface))
        nodes, size = _grid_over_tile(shape, COARSEST)
        ground = self._ground_of_pixels(nodes, transform)
        x, y = surface.to_raster.transform(*ground.T)
        if surface.turns:
            middle = (surface.raster.bounds.left + surface.raster.bounds.right) / 2
            x = nearest_longitudes(np.asarray(x), middle)
        to_pixel = ~surface.raster.transform
        sample, line = to_pixel @ (np.asarray(x), np.asarray(y))
        raster_positions = np.stack([line, sample], axis=1) - 0.5
        window = _raster_part_around(surface, raster_positions)
        if window is None:
            return self._height_of_each_pixel(shape, transform)
        pixels, first = window
        # What the datum adds to a height of 0, at each node.
        zeros = np.zeros(len(x))
        added = surface.converted(x, y, zeros)
        # Slope and offset of the height above the ellipsoid by the height that the raster stores,
        # which are straight lines of each other for each unit and vertical datum.
        slope = float(np.nanmedian(surface.converted(x, y, zeros + 1000.0) - added)) / 1000.0
        heights = np.empty(shape)
        at_nodes = np.column_stack([raster_positions - first, added]).reshape(*size, 3)
        end = np.array(surface.raster.shape, dtype=np.float64) - first
        _heights_between(pixels, at_nodes, COARSEST, end, first, slope, heights)
        return heights

    def _height_of_each_pixel(self, shape: tuple[int, int], transform: Any) -> FloatArray:
        """Return the heights of the ground at pixels, (lines, samples), each looked up by itself.
        """
        surface = self.surface
        assert isinstance(surface, Dem)
        lines, samples = np.indices(shape)
        pixels: FloatArray = np.column_stack([lines.ravel(), samples.ravel()]) + np.float64(0.5)
        return surface(self._ground_of_pixels(pixels, transform)).reshape(shape)


def _grid_over_tile(shape: tuple[int, int], step: int) -> tuple[FloatArray, tuple[int, int]]:
    """Return the nodes (n, 2) of a grid over a tile, and its size: nodes along lines and samples.

    `shape` is the tile's lines and samples. A node is at the centre of the first pixel and at every
    `step` pixels from there, to the centre of the last pixel or beyond, and at least two each way,
    so that each pixel is between nodes. Nodes are lines and samples [px] from the tile's outer
    corner, row by row.
    """
    n_lines, n_samples = (max(math.ceil((count - 1) / step), 1) + 1 for count in shape)
    lines, samples = np.indices((n_lines, n_samples))
    # The centre of a pixel is half a pixel from its corner.
    nodes = np.float64(step) * np.column_stack([lines.ravel(), samples.ravel()]) + 0.5
    return nodes, (n_lines, n_samples)


def _raster_part_around(
        surface: Dem, positions: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return the pixels of a raster around places, and the position of their first in the raster.

    Parameters
    ----------
    surface : Dem
    positions : ndarray, shape (n, 2)
        Line and sample in the raster; NaN where not known.

    Returns
    -------
    pixels : ndarray, shape (lines, samples)
        With a margin for interpolation; a single NaN if no position is known.
    first : ndarray, shape (2,)
        Line and sample of the first of them.

    None is returned instead of both where there are more than LARGEST_DEM pixels.
    """
    from rasterio.windows import Window

    finite = positions[np.isfinite(positions).all(axis=1)]
    size = np.array(surface.raster.shape)
    if not len(finite):
        return np.full((1, 1), np.nan), np.zeros(2)
    # A pixel more on either side, and one for the end that is not included.
    first = np.clip(np.floor(finite.min(axis=0)).astype(int) - 1, 0, size - 1)
    last = np.clip(np.ceil(finite.max(axis=0)).astype(int) + 2, 1, size)
    lines, samples = np.maximum(last - first, 1)
    if lines * samples > LARGEST_DEM:
        return None
    pixels = surface.stored(Window(first[1], first[0], samples, lines))
    return pixels, first.astype(np.float64)


def _largest_distance(positions: FloatArray, exact: FloatArray) -> float:
    """Return the largest distance of positions (n, 2) from exact ones [px].

    It is infinite where an exact position is known and the other one is not.
    """
    exact_known = np.isfinite(exact).all(axis=1)
    missing = ~np.isfinite(positions).all(axis=1)
    if (missing & exact_known).any():
        return np.inf
    comparable = exact_known & ~missing
    return float(np.linalg.norm((positions - exact)[comparable], axis=1).max(initial=0.0))


def _positions_between(nodes: Any, levels: Any, heights: Any, step: int, positions: Any) -> None:
    """Interpolate image positions at all pixels of a tile, from the positions at its nodes.

    It fills `positions` (lines, samples, 2), from `nodes` (levels, rows, columns, 2) that are
    `step` pixels apart and have the heights `levels` (levels,), at the `heights` (lines, samples)
    of the pixels. Positions are interpolated bilinearly in the plane, and by Lagrange's polynomial
    between heights. A pixel without a height has NaN for both.
    """
    count = len(levels)
    level_weights = np.empty(count)
    for i in range(positions.shape[0]):
        row = min(i // step, nodes.shape[1] - 2)
        down = i / step - row
        for j in range(positions.shape[1]):
            column = min(j // step, nodes.shape[2] - 2)
            right = j / step - column
            height = heights[i, j]
            # Weights of the levels: L_k(h) = product over m of (h - h_m) / (h_k - h_m).
            for k in range(count):
                weight = 1.0
                for m in range(count):
                    if m != k:
                        weight *= (height - levels[m]) / (levels[k] - levels[m])
                level_weights[k] = weight
            # Bilinear between the four nodes around the pixel, in every level.
            line = 0.0
            sample = 0.0
            for k in range(count):
                upper = level_weights[k] * (1.0 - down)
                lower = level_weights[k] * down
                a = upper * (1.0 - right)
                b = upper * right
                c = lower * (1.0 - right)
                d = lower * right
                line += (a * nodes[k, row, column, 0] + b * nodes[k, row, column + 1, 0]
                         + c * nodes[k, row + 1, column, 0] + d * nodes[k, row + 1, column + 1, 0])
                sample += (a * nodes[k, row, column, 1] + b * nodes[k, row, column + 1, 1]
                           + c * nodes[k, row + 1, column, 1]
                           + d * nodes[k, row + 1, column + 1, 1])
            if np.isnan(height):
                line = np.nan
            positions[i, j, 0] = line
            positions[i, j, 1] = sample


_between = compile_lazily(_positions_between)


def _bilinear_heights(pixels: Any, nodes: Any, step: int, size: Any, first: Any, slope: float,
                      heights: Any) -> None:
    """Fill `heights` (lines, samples) of a tile from the pixels of a raster.

    Nodes (rows, columns, 3), every `step` pixels of the tile, have line and sample in `pixels`, and
    what the datum adds to the pixels times `slope`. The raster goes from `-first` to `size`; in the
    outer half of its outermost pixels heights are constant.
    """
    rows = pixels.shape[0]
    columns = pixels.shape[1]
    for i in range(heights.shape[0]):
        row = min(i // step, nodes.shape[0] - 2)
        down = i / step - row
        for j in range(heights.shape[1]):
            column = min(j // step, nodes.shape[1] - 2)
            right = j / step - column
            # Weights of the four nodes around the pixel.
            a = (1.0 - down) * (1.0 - right)
            b = (1.0 - down) * right
            c = down * (1.0 - right)
            d = down * right
            line = (a * nodes[row, column, 0] + b * nodes[row, column + 1, 0]
                    + c * nodes[row + 1, column, 0] + d * nodes[row + 1, column + 1, 0])
            sample = (a * nodes[row, column, 1] + b * nodes[row, column + 1, 1]
                      + c * nodes[row + 1, column, 1] + d * nodes[row + 1, column + 1, 1])
            added = (a * nodes[row, column, 2] + b * nodes[row, column + 1, 2]
                     + c * nodes[row + 1, column, 2] + d * nodes[row + 1, column + 1, 2])
            # Outside the raster there is no height.
            heights[i, j] = np.nan
            if not (-0.5 - first[0] <= line <= size[0] - 0.5
                    and -0.5 - first[1] <= sample <= size[1] - 0.5):
                continue
            # Bilinear between the four pixels of the raster around the position.
            line = min(max(line, 0.0), rows - 1.0)
            sample = min(max(sample, 0.0), columns - 1.0)
            r = min(int(line), max(rows - 2, 0))
            s = min(int(sample), max(columns - 2, 0))
            below = line - r
            aside = sample - s
            height = 0.0
            for k in range(2):
                for m in range(2):
                    weight = (below if k else 1.0 - below) * (aside if m else 1.0 - aside)
                    if weight > 0.0:  # those without any weight may be no data
                        height += weight * pixels[r + k, s + m]
            heights[i, j] = height * slope + added


_heights_between = compile_lazily(_bilinear_heights)
