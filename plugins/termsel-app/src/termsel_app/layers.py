"""What the page draws: tiles of image and map, the image warped onto the map, graticules."""

from __future__ import annotations

from itertools import chain
from typing import Any

import numpy as np

from termsel_app.graticule import graticule_lines
from termsel_app.maps import Box, resample_tile
from termsel_app.prediction import Prediction
from termsel_app.rasters import TILE, Pixels, Raster
from termsel_app.session import Session

NODES_OF_TILE = 17
"""Positions along either side of a tile at which the model is computed, and interpolated between.
"""


def image_resolutions(size: tuple[int, int] | None) -> list[float]:
    """Return how many pixels of an image a pixel of a tile spans on each level.

    The coarsest level comes first; the last spans 1. `size` is lines and samples of the image; an
    image without one is taken to have 1000 x 1000 px.
    """
    height, width = size or (1000, 1000)
    levels = max(int(np.ceil(np.log2(max(height, width) / TILE))), 0)
    return [float(2**level) for level in range(levels, -1, -1)]


def image_tile(image: Raster, level: int, column: int, row: int) -> Pixels:
    """Return a tile of the image, shape (TILE, TILE, 4).

    It is transparent outside the image, and all over on a level that the image does not have.
    """
    resolutions = image_resolutions((image.height, image.width))
    if not 0 <= level < len(resolutions):
        return np.zeros((TILE, TILE, 4), dtype=np.uint8)
    length = TILE * resolutions[level]
    return image.pixels((row * length, column * length, length, length), (TILE, TILE))


def box_of_tile(session: Session, box: Box, level: int, column: int, row: int) -> Box | None:
    """Return the box of a tile of the map, whose grid begins in the north-west of `box`.

    None if the map has no such level.
    """
    resolutions = session.maps.resolutions(box)
    if not 0 <= level < len(resolutions):
        return None
    length = TILE * resolutions[level]
    west = box[0] + column * length
    north = box[3] - row * length
    return (west, north - length, west + length, north)


def warped_tile(image: Raster, prediction: Prediction, box: Box) -> Pixels:
    """Return a tile of the map as the image shows it through the model, shape (TILE, TILE, 4).

    All of it is transparent if the model has no place in the image for some part of the box.
    """
    from scipy.ndimage import map_coordinates

    west, south, east, north = box
    # The model is computed at nodes and interpolated bilinearly between them, which nobody can see.
    x = np.linspace(west, east, NODES_OF_TILE)
    y = np.linspace(north, south, NODES_OF_TILE)
    nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    image_nodes = prediction.to_image(nodes).reshape(NODES_OF_TILE, NODES_OF_TILE, 2)
    if not np.isfinite(image_nodes).all():
        return np.zeros((TILE, TILE, 4), dtype=np.uint8)
    # The centres of the tile's pixels, in steps from node to node.
    centres = (np.arange(TILE) + 0.5) / TILE * (NODES_OF_TILE - 1)
    mesh = np.meshgrid(centres, centres, indexing="ij")
    lines, samples = (map_coordinates(image_nodes[..., axis], mesh, order=1).ravel()
                      for axis in (0, 1))
    return resample_tile(image, lines, samples)


def graticule_for_page(session: Session, box: Box) -> dict[str, Any]:
    """Return lines of round coordinates within a box of the map, for the page.

    Each of "lines" has "label", "axis", and its vertices on the "map" and in the "image" through
    the model, without those that the model does not see; "image" is None if there is no model.
    """
    lines = graticule_lines(session.places, box)
    prediction = session.prediction
    return {
        "lines": [
            {
                "label": line["label"],
                "axis": line["axis"],
                "map": line["map"],
                "image": None if prediction is None else project_visible(prediction, line["map"]),
            }
            for line in lines
        ]
    }


def vectors_for_page(session: Session) -> dict[str, Any]:
    """Return the vector layers of the map as the model shows them in the image, for the page.

    Each of "lines" is a list of line and sample, without vertices that the model does not see.
    Lines of fewer than two vertices are left out. There are none if there is no model.
    """
    prediction = session.prediction
    if prediction is None:
        return {"lines": []}
    lines = []
    for layer in session.maps.vectors:
        for feature in layer.collection["features"]:
            lines += [project_visible(prediction, line)
                      for line in _vertices_of_lines(feature["geometry"])]
    return {"lines": [line for line in lines if len(line) > 1]}


def project_visible(prediction: Prediction, vertices: Any) -> list[list[float]]:
    """Return line and sample of vertices on the map (n, 2), without those the model does not see.
    """
    if not len(vertices):
        return []
    image = prediction.to_image(vertices)
    visible: list[list[float]] = image[~np.isnan(image).any(axis=1)].tolist()
    return visible


def _vertices_of_lines(geometry: Any) -> list[Any]:
    """Return the lines of a geometry of GeoJSON, each a list of its vertices; [] for points.

    The lines of an area are its outer boundary and those of its holes.
    """
    kind = geometry["type"]
    coordinates = geometry.get("coordinates", ())
    if kind == "LineString":
        return [coordinates]
    if kind in ("MultiLineString", "Polygon"):
        return list(coordinates)
    if kind == "MultiPolygon":
        return list(chain.from_iterable(coordinates))
    if kind == "GeometryCollection":
        return list(chain.from_iterable(map(_vertices_of_lines, geometry["geometries"])))
    return []
