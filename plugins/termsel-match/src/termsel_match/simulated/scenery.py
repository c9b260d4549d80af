"""The ground of a simulated world: parcels, roads, buildings and their brightness on two days."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Voronoi

FloatArray = NDArray[np.float64]
Bytes = NDArray[np.uint8]

# Mean distance of parcels [m].
PARCEL = 90.0
# Part of the area that is different on the other day.
CHANGED = 0.15
# Wavelengths of the texture [m].
_WAVES = (2.0, 4.0, 8.0, 16.0, 40.0)
# Part of the texture that is of one day alone.
_OWN = 0.35
# Rows of cells that are computed at once.
_CELL_ROWS = 512
# Fractional bits of the positions that are drawn.
_FRACTION_BITS = 4
# Side of the town as part of the side of the ground.
_TOWN = 0.3
# Distance of its streets [m].
_STREET_DISTANCE = 70.0
# Width of its streets [m].
_STREET_WIDTH = 6.0


@dataclass(frozen=True, eq=False)
class Road:
    """A road: its vertices (n, 2), metres east and south of the corner, and its width [m]."""

    vertices: FloatArray
    width: float


@dataclass(frozen=True, eq=False)
class Scenery:
    """What is on the ground.

    Parameters
    ----------
    days : tuple of ndarray of uint8, shape (n, n)
        Brightness without the effect of slopes, on the day of the image and that of the ortho.
    buildings : ndarray of uint8, shape (n, n)
        Heights above the terrain [dm].
    roads : tuple of Road
    changed : float
        Part of the area that differs.
    """

    days: tuple[Bytes, Bytes]
    buildings: Bytes
    roads: tuple[Road, ...]
    changed: float


def simulate_scenery(rng: np.random.Generator, extent: float, cell: float,
                     suns: tuple[FloatArray, FloatArray]) -> Scenery:
    """Return the scenery of a square.

    Parameters
    ----------
    rng : numpy.random.Generator
    extent, cell : float
        Side of the square, and of a cell of its grid [m].
    suns : tuple of ndarray, shape (2,)
        For either day the shadow of a metre of height: east and south [m].
    """
    n = round(extent / cell)
    parcels, count = _random_parcels(rng, extent, cell, n)
    roads = tuple(_random_highways(rng, extent) + _town_streets(rng, extent))
    footprints, heights, roofs = _houses_along_roads(rng, extent, roads)
    areas = np.zeros(count, dtype=np.intp)
    for row in parcels:
        areas += np.bincount(row, minlength=count)
    # Whole parcels change, in random order, until their area is what is to change.
    order = rng.permutation(count)
    changed = np.zeros(count, dtype=bool)
    changed[order[np.cumsum(areas[order]) <= CHANGED * n * n]] = True
    bright = rng.uniform(70, 170, count)
    shared = _random_texture(rng, n, cell)
    days = []
    for day in (0, 1):
        # Parcels have a brightness, and a little of it differs from day to day.
        level = bright + rng.normal(0, 6, count)
        texture = _random_texture(rng, n, cell)
        weight = np.full(count, _OWN)
        if day == 1:
            level = np.where(changed, rng.uniform(70, 170, count), level)
            weight = np.where(changed, 1.0, weight)
        level = level.astype(np.float32)
        weight = weight.astype(np.float32)
        image = np.empty((n, n), dtype=np.uint8)
        # A part at a time, for the sake of memory.
        for top in range(0, n, _CELL_ROWS):
            rows = slice(top, top + _CELL_ROWS)
            mixed = weight[parcels[rows]]
            image[rows] = np.clip(level[parcels[rows]] + (1 - mixed) * shared[rows]
                                  + mixed * texture[rows], 20, 235)
        del texture
        for road in roads:
            _draw(image, [road.vertices], cell, 205, width=road.width)
        shade = np.zeros((n, n), dtype=np.uint8)
        # The shadow of a house is the hull of its footprint and of that moved by the sun.
        hulls = [cv2.convexHull(np.concatenate([base, base + height * suns[day]])
                                .astype(np.float32))[:, 0].astype(np.float64)
                 for base, height in zip(footprints, heights, strict=True)]
        _draw(shade, hulls, cell, 1)
        image[shade > 0] //= 2
        for base, roof in zip(footprints, roofs, strict=True):
            _draw(image, [base], cell, roof)
        days.append(image)
    tall = np.zeros((n, n), dtype=np.uint8)
    for base, height in zip(footprints, heights, strict=True):
        _draw(tall, [base], cell, round(10 * height), smooth=False)
    return Scenery((days[0], days[1]), tall, roads, float(areas[changed].sum() / (n * n)))


def _draw(image: Bytes, shapes: list[FloatArray], cell: float, value: int, *,
          width: float | None = None, smooth: bool = True) -> None:
    """Draw polygons in an image, or polylines if a width is given, with one value.

    `shapes` are their vertices, (n, 2) each [m] from the upper left corner; `cell` is the size of a
    pixel [m], and `width` that of the lines [m]. Edges are smoothed if `smooth`.
    """
    # The middle of the first cell is (0.5, 0.5) cells from the corner.
    points = [np.round((shape / cell - 0.5) * 2**_FRACTION_BITS).astype(np.int32)
              for shape in shapes]
    kind = cv2.LINE_AA if smooth else cv2.LINE_8
    if width is None:
        for polygon in points:
            cv2.fillPoly(image, [polygon], value, kind, _FRACTION_BITS)
    else:
        cv2.polylines(image, points, False, value, thickness=max(1, round(width / cell)),
                      lineType=kind, shift=_FRACTION_BITS)


def _random_texture(rng: np.random.Generator, n: int, cell: float) -> NDArray[np.float32]:
    """Return brightness (n, n) of all wavelengths, with the mean 0."""
    total = np.zeros((n, n), dtype=np.float32)
    wave_texture = np.empty((n, n), dtype=np.float32)
    for wave in _WAVES:
        # Two samples a wavelength, interpolated to the cells.
        size = max(4, round(n * cell / wave * 2))
        total += cv2.resize(rng.standard_normal((size, size), dtype=np.float32) * 9.0, (n, n),
                            wave_texture,
                            interpolation=cv2.INTER_CUBIC)
    return total


def _random_parcels(rng: np.random.Generator, extent: float, cell: float, n: int,
                    ) -> tuple[NDArray[np.uint16], int]:
    """Return the number of the parcel of each cell, (n, n), and how many parcels there are.

    Parcels are Voronoi cells, about `PARCEL` metres wide, over a square whose side is `extent` [m].
    """
    across = max(3, round(extent / PARCEL)) + 2
    grid = np.stack(np.meshgrid(*(np.arange(-1, across - 1),) * 2), axis=-1).reshape(-1, 2)
    seeds = (grid + rng.uniform(0.1, 0.9, grid.shape)) * extent / (across - 2)
    # Four far points close the Voronoi cells at the rim, which would be infinite.
    frame = extent * np.array([[-9, -9], [-9, 10], [10, -9], [10, 10]])
    diagram = Voronoi(np.concatenate([seeds, frame]))
    labels = np.zeros((n, n), dtype=np.uint16)
    for i in range(len(seeds)):
        region = diagram.regions[diagram.point_region[i]]
        if -1 not in region:
            points = np.round(diagram.vertices[region] / cell).clip(-n, 2 * n).astype(np.int32)
            cv2.fillPoly(labels, [points], i)
    return labels, len(seeds)


def _random_highways(rng: np.random.Generator, extent: float) -> list[Road]:
    """Return roads through a square whose side is `extent` [m].

    They have straight pieces with gentle bends between them, and are more than `_STREET_WIDTH` and
    up to 11 m wide.
    """
    roads = []
    count = max(6, round(extent / 250))
    for i in range(count):
        # By turns to the east and to the south.
        is_eastward = i % 2
        piece_length = rng.uniform(120, 260)
        steps = int(extent * 1.2 / piece_length) + 2
        # The course turns a little at each piece.
        course = rng.normal(0, 0.15) + np.cumsum(rng.normal(0, 0.12, steps))
        move = np.stack([np.cos(course), np.sin(course)], axis=1) * piece_length
        start = np.array([-0.1 * extent, (i // 2 + rng.uniform(0.2, 0.8)) * 2 * extent / count])
        vertices = np.concatenate([start[None], start + np.cumsum(move, axis=0)])
        roads.append(Road(vertices[:, ::-1] if is_eastward else vertices,
                          float(rng.uniform(_STREET_WIDTH, 11))))
    return roads


def _town_streets(rng: np.random.Generator, extent: float) -> list[Road]:
    """Return the streets of a town: a turned grid of two sets of parallels, unevenly spaced.

    `extent` is the side of the square of ground [m]; the town is somewhere in its middle.
    """
    town = _TOWN * extent
    centre = rng.uniform(0.3, 0.7, 2) * extent
    turn = rng.uniform(0.1, 1.4)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    count = max(2, round(town / _STREET_DISTANCE))
    offsets = (np.arange(count + 1) + rng.uniform(-0.2, 0.2, count + 1)) * town / count - town / 2
    streets = []
    for way in (0, 1):
        for offset in offsets:
            # A little over half of the town to either side, so that the outer streets cross.
            vertices = centre + town * 0.52 * np.array([[-1], [1]]) * axes[way]
            streets.append(Road(vertices + offset * axes[1 - way], _STREET_WIDTH))
    return streets


def _houses_along_roads(rng: np.random.Generator, extent: float, roads: tuple[Road, ...],
                        ) -> tuple[list[FloatArray], list[float], list[int]]:
    """Return footprints (4, 2) [m], heights [m] and brightness of roofs of houses along the roads.

    `extent` is the side of the square [m]. Houses stand at both sides of a road and turned like it,
    closer to each other in towns; their corners are what a matcher finds in both images, and their
    heights what it must not take for ground.
    """
    footprints = []
    heights = []
    roofs = []
    for road in roads:
        for start, end in zip(road.vertices[:-1], road.vertices[1:], strict=True):
            length = float(np.linalg.norm(end - start))
            ahead = (end - start) / length
            aside = np.array([-ahead[1], ahead[0]])
            # All other roads are wider.
            town = road.width == _STREET_WIDTH
            # Houses every 24 m in towns and every 60 m elsewhere, with gaps.
            for at in np.arange(20.0, length - 15, 24.0 if town else 60.0):
                if rng.random() < (0.25 if town else 0.6):
                    continue
                deep, wide = rng.uniform(8, 14, 2)
                away = road.width / 2 + 5 + deep / 2 + rng.uniform(0, 4)
                middle = start + at * ahead + rng.choice([-1, 1]) * away * aside
                if not ((middle > 0) & (middle < extent)).all():
                    continue
                corners = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) / 2
                footprints.append(middle + corners * [wide, deep] @ np.stack([ahead, aside]))
                heights.append(float(rng.uniform(3.5, 11)))
                roofs.append(int(rng.integers(60, 250)))
    return footprints, heights, roofs
