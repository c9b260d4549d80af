"""The ground of a simulated world: parcels, roads, buildings and their brightness on two days."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Voronoi

FloatArray = NDArray[np.float64]
Bytes = NDArray[np.uint8]

PARCEL = 90.0  # mean distance of parcels [m]
CHANGED = 0.15  # part of the area that is different on the other day
_WAVES = (2.0, 4.0, 8.0, 16.0, 40.0)  # of the texture [m]
_OWN = 0.35  # part of the texture that is of one day alone
_ROWS = 512  # of cells that are computed at once
_SHIFT = 4  # fractional bits of the positions that are drawn
_TOWN = 0.3  # side of the town as part of the side of the ground
_BLOCK = 70.0  # distance of its streets [m]


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


def scenery(rng: np.random.Generator, side: float, cell: float,
            suns: tuple[FloatArray, FloatArray]) -> Scenery:
    """Return the scenery of a square.

    Parameters
    ----------
    rng : numpy.random.Generator
    side, cell : float
        Of the square and of a cell of its grid [m].
    suns : tuple of ndarray, shape (2,)
        For either day the shadow of a metre of height: east and south [m].
    """
    n = round(side / cell)
    parcels, count = _parcels(rng, side, cell, n)
    roads = tuple(_highways(rng, side) + _streets(rng, side))
    footprints, heights, roofs = _houses(rng, side, roads)
    areas = np.zeros(count, dtype=np.intp)
    for row in parcels:
        areas += np.bincount(row, minlength=count)
    order = rng.permutation(count)
    changed = np.zeros(count, dtype=bool)
    changed[order[np.cumsum(areas[order]) <= CHANGED * n * n]] = True
    bright = rng.uniform(70, 170, count)
    shared = _texture(rng, n, cell)
    days = []
    for day in (0, 1):
        level = bright + rng.normal(0, 6, count)
        own = _texture(rng, n, cell)
        part = np.full(count, _OWN)
        if day == 1:
            level = np.where(changed, rng.uniform(70, 170, count), level)
            part = np.where(changed, 1.0, part)
        level = level.astype(np.float32)
        part = part.astype(np.float32)
        image = np.empty((n, n), dtype=np.uint8)
        for top in range(0, n, _ROWS):  # a part at a time, for the sake of memory
            rows = slice(top, top + _ROWS)
            mixed = part[parcels[rows]]
            image[rows] = np.clip(level[parcels[rows]] + (1 - mixed) * shared[rows]
                                  + mixed * own[rows], 20, 235)
        del own
        for road in roads:
            _draw(image, [road.vertices], cell, 205, width=road.width)
        shade = np.zeros((n, n), dtype=np.uint8)
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
    """Draw polygons, or polylines of a width, whose vertices are in metres from the corner."""
    # The middle of the first cell is (0.5, 0.5) cells from the corner.
    points = [np.round((shape / cell - 0.5) * 2**_SHIFT).astype(np.int32) for shape in shapes]
    kind = cv2.LINE_AA if smooth else cv2.LINE_8
    if width is None:
        for one in points:
            cv2.fillPoly(image, [one], value, kind, _SHIFT)
    else:
        cv2.polylines(image, points, False, value, max(1, round(width / cell)), kind, _SHIFT)


def _texture(rng: np.random.Generator, n: int, cell: float) -> NDArray[np.float32]:
    """Return brightness of all wavelengths with the mean 0."""
    total = np.zeros((n, n), dtype=np.float32)
    one = np.empty((n, n), dtype=np.float32)
    for wave in _WAVES:
        size = max(4, round(n * cell / wave * 2))
        total += cv2.resize(rng.standard_normal((size, size), dtype=np.float32) * 9.0, (n, n), one,
                            interpolation=cv2.INTER_CUBIC)
    return total


def _parcels(rng: np.random.Generator, side: float, cell: float, n: int,
             ) -> tuple[NDArray[np.uint16], int]:
    """Return which parcel each cell is in, and how many there are."""
    across = max(3, round(side / PARCEL)) + 2
    grid = np.stack(np.meshgrid(*(np.arange(-1, across - 1),) * 2), axis=-1).reshape(-1, 2)
    seeds = (grid + rng.uniform(0.1, 0.9, grid.shape)) * side / (across - 2)
    frame = side * np.array([[-9, -9], [-9, 10], [10, -9], [10, 10]])  # close the outer cells
    diagram = Voronoi(np.concatenate([seeds, frame]))
    labels = np.zeros((n, n), dtype=np.uint16)
    for i in range(len(seeds)):
        region = diagram.regions[diagram.point_region[i]]
        if -1 not in region:
            points = np.round(diagram.vertices[region] / cell).clip(-n, 2 * n).astype(np.int32)
            cv2.fillPoly(labels, [points], i)
    return labels, len(seeds)


def _highways(rng: np.random.Generator, side: float) -> list[Road]:
    """Return roads through the square, of straight pieces with gentle bends."""
    roads = []
    count = max(6, round(side / 250))
    for i in range(count):
        along = i % 2  # by turns to the east and to the south
        piece = rng.uniform(120, 260)
        steps = int(side * 1.2 / piece) + 2
        course = rng.normal(0, 0.15) + np.cumsum(rng.normal(0, 0.12, steps))
        move = np.stack([np.cos(course), np.sin(course)], axis=1) * piece
        start = np.array([-0.1 * side, (i // 2 + rng.uniform(0.2, 0.8)) * 2 * side / count])
        vertices = np.concatenate([start[None], start + np.cumsum(move, axis=0)])
        roads.append(Road(vertices[:, ::-1] if along else vertices, float(rng.uniform(6, 11))))
    return roads


def _streets(rng: np.random.Generator, side: float) -> list[Road]:
    """Return the streets of a town, a turned grid."""
    town = _TOWN * side
    centre = rng.uniform(0.3, 0.7, 2) * side
    turn = rng.uniform(0.1, 1.4)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    count = max(2, round(town / _BLOCK))
    places = (np.arange(count + 1) + rng.uniform(-0.2, 0.2, count + 1)) * town / count - town / 2
    return [Road(centre + town * 0.52 * np.array([[-1], [1]]) * axes[way]
                 + offset * axes[1 - way], 6.0) for way in (0, 1) for offset in places]


def _houses(rng: np.random.Generator, side: float, roads: tuple[Road, ...],
            ) -> tuple[list[FloatArray], list[float], list[int]]:
    """Return footprints, heights [m] and brightness of houses along the roads."""
    footprints = []
    heights = []
    roofs = []
    for road in roads:
        for start, end in zip(road.vertices[:-1], road.vertices[1:], strict=True):
            length = float(np.linalg.norm(end - start))
            ahead = (end - start) / length
            aside = np.array([-ahead[1], ahead[0]])
            town = road.width == 6.0
            for at in np.arange(20.0, length - 15, 24.0 if town else 60.0):
                if rng.random() < (0.25 if town else 0.6):
                    continue
                deep, wide = rng.uniform(8, 14, 2)
                away = road.width / 2 + 5 + deep / 2 + rng.uniform(0, 4)
                middle = start + at * ahead + rng.choice([-1, 1]) * away * aside
                if not ((middle > 0) & (middle < side)).all():
                    continue
                corners = np.array([[-1, -1], [-1, 1], [1, 1], [1, -1]]) / 2
                footprints.append(middle + corners * [wide, deep] @ np.stack([ahead, aside]))
                heights.append(float(rng.uniform(3.5, 11)))
                roofs.append(int(rng.integers(60, 250)))
    return footprints, heights, roofs
