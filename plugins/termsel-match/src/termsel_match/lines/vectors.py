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
# Px by which a vector may bend within a piece.
_STRAIGHT = 0.5
# Px of a piece.
SHORTEST, _LONGEST = 40.0, 150.0
# Px between vertices that are projected.
_VERTEX_STEP = 16.0
# Of the image, around it, where vectors may be that it shows.
_MARGIN = 0.5
# Pieces; more would take time and show next to nothing.
MOST_PIECES = 400
# Of the image along either side, and of pieces, from which they are.
_IMAGE_CELLS, _PIECE_DIRECTIONS = 6, 4


@dataclass(frozen=True, eq=False)
class Pieces:
    """Straight pieces of vectors.

    Parameters
    ----------
    vector : tuple of str
        Which vector each is of.
    ground : ndarray, shape (n, 2, 3)
        Their ends, in the CRS.
    image : ndarray, shape (n, 2, 2)
        Where the start sees the ends [px].
    crs : str
    """

    vector: tuple[str, ...]
    ground: FloatArray
    image: FloatArray
    crs: str


def pieces_of(path: Path | str, start: Start, dem: Path | str | None, size: tuple[int, int],
              ) -> Pieces:
    """Return the straight pieces of vectors that the image shows, as the start says.

    Parameters
    ----------
    path : path-like
        Lines, or areas for their boundaries, in any format of GDAL and any CRS.
    start : Start
    dem : path-like, optional
        Raster of heights; without it the height of the start is taken.
    size : tuple of int
        Lines and samples of the image.

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
    # Where the start sees every vertex; what has no height is nowhere.
    x, y = to_start.transform(*plane.T)
    at_image = start.project(np.column_stack([x, y, heights]))
    ground = np.column_stack([plane, heights])
    vector = []
    ends = []
    image = []
    for i in range(len(lines)):
        finite = np.flatnonzero((owner == i) & np.isfinite(at_image).all(axis=1))
        # Without the vertices that have no height the line is not one.
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
    # Not all pieces, but long ones in all parts of the image and in all directions.
    taken_pieces = _spread_pieces(measured, size)
    return Pieces(tuple(vector[i] for i in taken_pieces), ground_ends[taken_pieces],
                  measured[taken_pieces], crs)


def _mesh_of_image(start: Start, to_start: Any, size: tuple[int, int]) -> FloatArray:
    """Return where an image lies in the plane of the vectors: a mesh (7, 7, 2), NaN for no place.
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
    """Return the parts of vectors near an image, and which vector each is of.

    They get vertices every 16 px, as the terrain bends where a map has none.
    """
    low, high = (limit(plane_mesh, axis=(0, 1)) for limit in (np.nanmin, np.nanmax))
    if not np.isfinite([low, high]).all():
        # Vectors around the image count too: a start may be off by half an image.
        return [], []
    around = _MARGIN * (high - low)
    near = shapely.clip_by_rect([shapely.LineString(line) for line in lines],
                                *(low - around), *(high + around))
    clipped, vector = shapely.get_parts(near, return_index=True)
    # How many units of the map a pixel is, from steps of the mesh.
    steps = np.linalg.norm(np.diff(plane_mesh, axis=0), axis=2) / (size[0] / 6)
    dense = shapely.segmentize(clipped, _VERTEX_STEP * float(np.nanmedian(steps)))
    return [shapely.get_coordinates(line) for line in dense], vector.tolist()


def read_vectors(path: Path) -> tuple[list[FloatArray], str]:
    """Return the vertices of the lines of a file, shape (n, 2) each, and the CRS.

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
    # The boundary of an area is a line, as that of a field or a lake.
    areal = shapely.get_dimensions(shapes) == 2
    shapes = np.where(areal, shapely.boundary(shapes), shapes)
    merged = shapely.get_parts(shapely.line_merge(shapes[~shapely.is_empty(shapes)]))
    lines = [shapely.get_coordinates(line) for line in merged
             if shapely.get_dimensions(line) == 1 and len(shapely.get_coordinates(line)) > 1]
    if not lines:
        raise TermselError("the file has no lines", file=path,
                           hint="Give a file of lines, such as roads.")
    return lines, str(meta["crs"])


def _spread_pieces(image: FloatArray, size: tuple[int, int]) -> NDArray[np.intp]:
    """Return the indices of at most `MOST_PIECES` pieces, sorted: the longest of each cell first.

    Pieces (n, 2, 2) are in lines and samples [px]; a cell is split by direction, too.
    """
    run = image[:, 1] - image[:, 0]
    cell = np.clip(image.mean(axis=1) / size * _IMAGE_CELLS, 0, _IMAGE_CELLS - 1).astype(np.intp)
    # A direction has no sense: half a turn is the same one.
    turn = np.arctan2(run[:, 0], run[:, 1]) % np.pi
    direction = np.minimum((turn / np.pi * _PIECE_DIRECTIONS).astype(np.intp),
                           _PIECE_DIRECTIONS - 1)
    group = (cell[:, 0] * _IMAGE_CELLS + cell[:, 1]) * _PIECE_DIRECTIONS + direction
    order = np.lexsort((-np.linalg.norm(run, axis=1), group))
    # The rank within its group: first the longest of all groups, then the second of all.
    first = np.searchsorted(group[order], group[order])
    rank = np.arange(len(order)) - first
    return np.sort(order[np.argsort(rank, kind="stable")[:MOST_PIECES]])


def _straight_pieces(image: FloatArray) -> list[tuple[int, int]]:
    """Return first and last vertex of the straight pieces of a polyline (n, 2) in the image [px].

    [] if it has fewer than two vertices.
    """
    if len(image) < 2:
        return []
    # Douglas and Peucker: what bends by less than half a pixel is straight.
    vertices = shapely.get_coordinates(shapely.simplify(shapely.LineString(image), _STRAIGHT))
    # Vertices that are kept are those of the polyline, in its order.
    at = 0
    numbers = []
    for vertex in vertices:
        at += int(np.argmin(np.abs(image[at:] - vertex).sum(axis=1)))
        numbers.append(at)
    return list(pairwise(numbers))


def _shares_in_image(image: FloatArray, size: tuple[int, int]) -> list[FloatArray]:
    """Return the parts of a straight piece (2, 2) in the image, as first and last share of each.

    [] if less than `SHORTEST` px of it is in the image.
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
