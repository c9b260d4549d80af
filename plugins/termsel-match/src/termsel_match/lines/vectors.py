"""Straight pieces of vectors, and where a start says that the image shows them."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from termsel import TermselError, open_dem
from termsel.toolkit import open_layer
from termsel.toolkit.coordinates import plane_transformer
from termsel_match.images.positions import middle_in_words
from termsel_match.images.rasters import FloatArray
from termsel_match.images.starts import Start

_KINDS = ("LineString", "MultiLineString", "Polygon", "MultiPolygon")
"""Types of geometry that are read."""

_STRAIGHT = 0.5
"""Largest deviation of a vector from a straight line within a piece [px]."""

SHORTEST, _LONGEST = 40.0, 150.0
"""Least and largest length of a piece [px]."""

_VERTEX_STEP = 16.0
"""Largest distance of vertices that are projected [px]."""

_MARGIN = 0.5
"""Margin around the image in which vectors are kept, as a share of its extent: a start may be off
by as much."""

MOST_PIECES = 400
"""Most pieces that are looked for: more take time, and say next to nothing new."""

_IMAGE_CELLS, _PIECE_DIRECTIONS = 6, 4
"""Number of cells along either side of the image, and of classes of direction, over which the
pieces are spread."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """Straight pieces of vectors.

    Parameters
    ----------
    vector : tuple of str
        Name of the vector of each piece.
    ground : ndarray, shape (n, 2, 3)
        Ground coordinates of both ends of each piece.
    image : ndarray, shape (n, 2, 2)
        Lines and samples of both ends by the start [px].
    crs : str
        CRS of the ground coordinates.
    """

    vector: tuple[str, ...]
    ground: FloatArray
    image: FloatArray
    crs: str


def pieces_of(path: Path | str, start: Start, dem: Path | str | None, size: tuple[int, int],
              ) -> Pieces:
    """Return the straight pieces of vectors which, by the start, the image shows.

    Parameters
    ----------
    path : path-like
        Lines, or areas for their boundaries, in any format of GDAL and any CRS.
    start : Start
        Rough geometry of the image.
    dem : path-like, optional
        Raster of heights; without it, the height that the start states holds everywhere.
    size : tuple of int
        Lines and samples of the image.

    Returns
    -------
    Pieces
        Ends on the ground, in the CRS of the file, and in the image by the start [px], and the
        number of the vector that each piece is of, from "1" on.

    Raises
    ------
    TermselError
        If the file cannot be read, has no CRS or no lines, the DEM does not cover the vectors, or
        none of them is in the image; or if the image has a single line or sample.
    """
    if min(size) < 2:
        raise TermselError(f"an image of {size[0]} x {size[1]} px shows no lines",
                           hint="Give the whole image, or a larger part of it.")
    lines, crs = read_vectors(Path(path))
    to_start = plane_transformer(crs, start.crs)
    image_place = start.locate(np.array([[0.0, 0.0], [size[0] - 1.0, size[1] - 1.0]]), start.height)
    nowhere = TermselError(
        f"no straight piece of {SHORTEST:.0f} px of the vectors is in the image: they are around "
        f"{middle_in_words(np.concatenate(lines)[:, :2], crs)}, the image by {start.description} "
        f"around {middle_in_words(image_place[:, :2], start.crs)}",
        file=path, hint="Give vectors of the same area; if the place of the image is wrong, "
                        "another --start.")
    lines, vector_of = _vectors_near_image(lines, _mesh_of_image(start, to_start, size), size)
    if not lines:
        raise nowhere
    owner = np.repeat(np.arange(len(lines)), [len(line) for line in lines])
    plane = np.concatenate(lines)
    with ExitStack() as stack:
        if dem is None:
            heights = np.full(len(plane), start.height)
        else:
            heights = stack.enter_context(open_dem(Path(dem), crs))(plane)
    if not np.isfinite(heights).any():
        raise TermselError("the DEM does not cover any of the vectors", file=dem,
                           hint="Give a DEM of the area. Vectors may be in another CRS.")
    # Vertices without a height have no position in the image (NaN), also by a start that uses none.
    x, y = to_start.transform(*plane.T)
    at_image = start.project(np.column_stack([x, y, heights]))
    at_image[np.isnan(heights)] = np.nan
    ground = np.column_stack([plane, heights])
    vector = []
    ends = []
    image = []
    for i in range(len(lines)):
        finite = np.flatnonzero((owner == i) & np.isfinite(at_image).all(axis=1))
        # Where vertices have no height, the vector is divided into runs of those that have.
        for run in np.split(finite, np.flatnonzero(np.diff(finite) > 1) + 1):
            for first, last in _straight_pieces(at_image[run]):
                of_image = at_image[run[[first, last]]]
                of_ground = ground[run[[first, last]]]
                for share in _shares_in_image(of_image, size):
                    vector.append(str(vector_of[i] + 1))
                    image.append(of_image[0] + share[:, None] * (of_image[1] - of_image[0]))
                    ends.append(of_ground[0] + share[:, None] * (of_ground[1] - of_ground[0]))
    if not vector:
        raise nowhere
    measured = np.array(image)
    ground_ends = np.array(ends)
    taken_pieces = _spread_pieces(measured, size)
    return Pieces(tuple(vector[i] for i in taken_pieces), ground_ends[taken_pieces],
                  measured[taken_pieces], crs)


def _mesh_of_image(start: Start, to_start: Any, size: tuple[int, int]) -> FloatArray:
    """Return x and y in the CRS of the vectors, (7, 7, 2), of positions spread over an image.

    NaN for positions that the start does not locate.
    """
    steps = (np.linspace(0, extent - 1, 7) for extent in size)
    image = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
    ground = start.locate(image, start.height)
    plane = to_start.transform(ground[:, 0], ground[:, 1], direction="INVERSE")
    plane_positions = np.column_stack(plane)
    plane_positions[~np.isfinite(plane_positions).all(axis=1)] = np.nan
    return plane_positions.reshape(7, 7, 2)


def _vectors_near_image(lines: list[FloatArray], plane_mesh: FloatArray, size: tuple[int, int],
                        ) -> tuple[list[FloatArray], list[int]]:
    """Return the parts of vectors near an image, and the number of the vector of each.

    Parameters
    ----------
    lines : list of ndarray, shape (n, 2) each
        Vertices of the vectors, x and y in their CRS.
    plane_mesh : ndarray, shape (7, 7, 2)
        Positions in that CRS of nodes spread over the image, as `_mesh_of_image` returns them.
    size : tuple of int
        Lines and samples of the image.

    Returns
    -------
    parts : list of ndarray, shape (m, 2) each
        Vertices, of which some are added so that they are at most 16 px of the image apart. Empty
        if the position of the image is not known.
    numbers : list of int
        The vector of each part, counted from 0.
    """
    low, high = (limit(plane_mesh, axis=(0, 1)) for limit in (np.nanmin, np.nanmax))
    if not np.isfinite([low, high]).all():
        return [], []
    around = _MARGIN * (high - low)
    near = shapely.clip_by_rect([shapely.LineString(line) for line in lines],
                                *(low - around), *(high + around))
    clipped, vector = shapely.get_parts(near, return_index=True)
    # Size of a pixel in units of the map: the steps of the mesh, which are a sixth of the lines.
    steps = np.linalg.norm(np.diff(plane_mesh, axis=0), axis=2) / (size[0] / 6)
    # Relief bends a line in the image that is straight on the map.
    dense = shapely.segmentize(clipped, _VERTEX_STEP * float(np.nanmedian(steps)))
    return [shapely.get_coordinates(line) for line in dense], vector.tolist()


def read_vectors(path: Path) -> tuple[list[FloatArray], str]:
    """Return the vertices of the lines of a file, (n, 2) each, and their CRS.

    Areas count as lines by their boundaries; lines that continue each other are joined.

    Raises
    ------
    TermselError
        If the file cannot be read, or has no CRS or no lines.
    """
    meta, shapes, _ = open_layer(path, None, _KINDS, columns=[])
    if shapes is None:
        raise TermselError("the layer has no geometry", file=path, hint="Give a layer of lines.")
    if meta["crs"] is None:
        raise TermselError("the vectors have no CRS", file=path,
                           hint="Assign the CRS in a GIS and save them again.")
    shapes = shapely.force_2d(shapes)
    areal = shapely.get_dimensions(shapes) == 2
    shapes = np.where(areal, shapely.boundary(shapes), shapes)
    # Maps divide a road at each crossing; straight pieces are longer in the joined line.
    merged = shapely.get_parts(shapely.line_merge(shapes[~shapely.is_empty(shapes)]))
    lines = [shapely.get_coordinates(line) for line in merged
             if shapely.get_dimensions(line) == 1 and len(shapely.get_coordinates(line)) > 1]
    if not lines:
        raise TermselError("the file has no lines", file=path,
                           hint="Give a file of lines, such as roads.")
    return lines, str(meta["crs"])


def _spread_pieces(image: FloatArray, size: tuple[int, int]) -> NDArray[np.intp]:
    """Return the sorted indices of at most 400 pieces, spread over the image and all directions.

    Pieces are grouped by cells of the image and by direction. The longest of each group are taken
    first, then the second longest, and so on. `image` (n, 2, 2) has the lines and samples of their
    ends [px].
    """
    run = image[:, 1] - image[:, 0]
    cell = np.clip(image.mean(axis=1) / size * _IMAGE_CELLS, 0, _IMAGE_CELLS - 1).astype(np.intp)
    # A piece and its reverse, half a turn apart, have the same direction.
    turn = np.arctan2(run[:, 0], run[:, 1]) % np.pi
    direction = np.minimum((turn / np.pi * _PIECE_DIRECTIONS).astype(np.intp),
                           _PIECE_DIRECTIONS - 1)
    group = (cell[:, 0] * _IMAGE_CELLS + cell[:, 1]) * _PIECE_DIRECTIONS + direction
    order = np.lexsort((-np.linalg.norm(run, axis=1), group))
    # The rank of each piece within its group, 0 for the longest.
    first = np.searchsorted(group[order], group[order])
    rank = np.arange(len(order)) - first
    return np.sort(order[np.argsort(rank, kind="stable")[:MOST_PIECES]])


def _straight_pieces(image: FloatArray) -> list[tuple[int, int]]:
    """Return the numbers of the first and last vertex of each straight piece of a polyline (n, 2).

    The vertices are in px of the image. [] if there are fewer than two.
    """
    if len(image) < 2:
        return []
    # Douglas and Peucker's method: what bends by less than half a pixel is straight.
    vertices = shapely.get_coordinates(shapely.simplify(shapely.LineString(image), _STRAIGHT))
    # The vertices kept are vertices of the polyline, in its order.
    at = 0
    numbers = []
    for vertex in vertices:
        at += int(np.argmin(np.abs(image[at:] - vertex).sum(axis=1)))
        numbers.append(at)
    return list(pairwise(numbers))


def _shares_in_image(image: FloatArray, size: tuple[int, int]) -> list[FloatArray]:
    """Return the parts of a straight piece that are in the image, none longer than 150 px.

    Each part is where it begins and ends, as shares of the piece from 0 to 1. `image` (2, 2) has
    the ends of the piece [px]. [] if less than 40 px of it is in the image.
    """
    run = image[1] - image[0]
    length = float(np.linalg.norm(run))
    if length < SHORTEST:
        return []
    with np.errstate(divide="ignore", invalid="ignore"):
        # Shares at which the line meets the four edges of the image.
        low = (0 - image[0]) / run
        high = (np.array(size) - 1 - image[0]) / run
    enter = np.nanmax(np.minimum(low, high), initial=0.0)
    leave = np.nanmin(np.maximum(low, high), initial=1.0)
    if (leave - enter) * length < SHORTEST:
        return []
    count = int(np.ceil((leave - enter) * length / _LONGEST))
    steps = np.linspace(enter, leave, count + 1)
    return [steps[i:i + 2] for i in range(count)]
