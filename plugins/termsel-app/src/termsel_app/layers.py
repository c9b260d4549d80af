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
"""Places along either side of a tile where the model is computed; it is interpolated between."""


def image_resolutions(size: tuple[int, int] | None) -> list[float]:
    """Return how many pixels of an image (lines, samples) a pixel of a tile spans on each level.

    The coarsest level comes first, the last is 1. Without a size it is that of 1000 x 1000 px.
    """
    height, width = size or (1000, 1000)
    levels = max(int(np.ceil(np.log2(max(height, width) / TILE))), 0)
    return [float(2**level) for level in range(levels, -1, -1)]


def image_tile(image: Raster, level: int, column: int, row: int) -> Pixels:
    """Return a tile of the image (TILE, TILE, 4); transparent outside it, and on levels it has not.
    """
    resolutions = image_resolutions((image.height, image.width))
    if not 0 <= level < len(resolutions):
        return np.zeros((TILE, TILE, 4), dtype=np.uint8)
    length = TILE * resolutions[level]
    return image.pixels((row * length, column * length, length, length), (TILE, TILE))


def box_of_tile(session: Session, box: Box, level: int, column: int, row: int) -> Box | None:
    """Return the box of a tile of the map, whose grid begins in the north-west of `box`.

    None if there is no such level.
    """
    resolutions = session.maps.resolutions(box)
    if not 0 <= level < len(resolutions):
        return None
    length = TILE * resolutions[level]
    west = box[0] + column * length
    north = box[3] - row * length
    return (west, north - length, west + length, north)


def warped_tile(image: Raster, prediction: Prediction, box: Box) -> Pixels:
    """Return a tile of the map (TILE, TILE, 4) as the image shows it through the model.

    Transparent as a whole if the model does not see all of the box.
    """
    from scipy.ndimage import map_coordinates

    west, south, east, north = box
    # The model at 17 x 17 nodes, and bilinear between them: no eye sees a
    # difference.
    x = np.linspace(west, east, NODES_OF_TILE)
    y = np.linspace(north, south, NODES_OF_TILE)
    nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    image_nodes = prediction.to_image(nodes).reshape(NODES_OF_TILE, NODES_OF_TILE, 2)
    if not np.isfinite(image_nodes).all():
        return np.zeros((TILE, TILE, 4), dtype=np.uint8)
    at = (np.arange(TILE) + 0.5) / TILE * (NODES_OF_TILE - 1)
    mesh = np.meshgrid(at, at, indexing="ij")
    lines, samples = (map_coordinates(image_nodes[..., axis], mesh, order=1).ravel()
                      for axis in (0, 1))
    return resample_tile(image, lines, samples)


def drawn_graticule(session: Session, box: Box) -> dict[str, Any]:
    """Return lines of round coordinates on the map, and through the model in the image.

    `image` of a line is None as long as there is no model.
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


def drawn_vectors(session: Session) -> dict[str, Any]:
    """Return the map's vector layers through the model: `lines` of (line, sample), for the page.

    Empty as long as there is no model.
    """
    prediction = session.prediction
    if prediction is None:
        return {"lines": []}
    lines = []
    for layer in session.maps.vectors:
        for feature in layer.collection["features"]:
            lines += [project_visible(prediction, line) for line in _lines_of(feature["geometry"])]
    return {"lines": [line for line in lines if len(line) > 1]}


def project_visible(prediction: Prediction, vertices: Any) -> list[list[float]]:
    """Return line and sample of vertices on the map (n, 2), but for those the model does not see.
    """
    if not len(vertices):
        return []
    image = prediction.to_image(vertices)
    visible: list[list[float]] = image[~np.isnan(image).any(axis=1)].tolist()
    return visible


def _lines_of(geometry: Any) -> list[Any]:
    """Return the vertices of each line of a geometry of GeoJSON, rings included; [] of points."""
    kind = geometry["type"]
    coordinates = geometry.get("coordinates", ())
    if kind == "LineString":
        return [coordinates]
    if kind in ("MultiLineString", "Polygon"):
        return list(coordinates)
    if kind == "MultiPolygon":
        return list(chain.from_iterable(coordinates))
    if kind == "GeometryCollection":
        return list(chain.from_iterable(map(_lines_of, geometry["geometries"])))
    return []
