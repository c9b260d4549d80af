"""The map: rasters and vectors in any CRS, shown in one, in tiles that all layers share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from termsel import TermselError
from termsel.toolkit import FloatArray, open_layer
from termsel.toolkit.coordinates import LOCAL, normalise
from termsel_app.places import MERCATOR, shown_crs, transform_places, transformer_between
from termsel_app.rasters import TILE, Pixels, Raster, refuse_giant

MOST_VERTICES = 400_000
"""Vertices of vector layers that the page gets."""
GEOMETRIES = ("Point", "LineString", "Polygon", "MultiPoint", "MultiLineString", "MultiPolygon",
              "GeometryCollection")
_VECTORS = (".gpkg", ".geojson", ".json", ".shp", ".fgb", ".kml", ".gml", ".gpx")
FINER = 4
"""Levels of tiles beyond the finest raster."""

Box = tuple[float, float, float, float]
"""Least x and y, largest x and y."""


def is_tiles(name: str) -> bool:
    """Return whether the name of a map is an address of tiles, with {x}, {y} and {z} in it."""
    return (name.startswith(("http://", "https://")) and "{x}" in name and "{z}" in name
            and ("{y}" in name or "{-y}" in name))


def is_vector(name: str) -> bool:
    """Return whether a map is a vector file, by the suffix of its name."""
    return Path(name).suffix.lower() in _VECTORS


_TABLES = (".csv", ".tsv", ".txt", ".points", ".xlsx", ".ods")

TABLE_AS_LAYER = "QGIS saves a table as such a layer (Add Delimited Text Layer, then Export)."
"""How a table of places becomes what --map takes."""


def _refuse_table(name: str) -> None:
    """Raise TermselError, with what to do, if a name is that of a table on the disk."""
    if Path(name).suffix.lower() in _TABLES and Path(name).is_file():
        raise TermselError("a table is no map: --map takes rasters and vector layers", file=name,
                           hint="If it has places on the ground alone, give them as a layer: --map "
                                f"FILE.gpkg. {TABLE_AS_LAYER} Points that are measured in the "
                                "image, too, are given by --points FILE.")


@dataclass(frozen=True)
class VectorLayer:
    """A vector layer as GeoJSON in the CRS shown."""

    name: str
    collection: dict[str, Any]
    box: Box


class MapRaster:
    """A georeferenced raster as tiles in any CRS."""

    def __init__(self, path: Path | str, remote: bool = False, crs: str | None = None) -> None:
        """Open a raster, of which `crs` is the CRS if it has none; `remote` as for `Raster`.

        Raises TermselError for a raster that is not georeferenced, has no CRS while none is given,
        is too large or cannot be read.
        """
        refuse_giant(path)
        self.raster = Raster(path, remote)
        dataset = self.raster.dataset
        # GDAL gives the identity where there is no geotransform.
        if dataset.transform.is_identity:
            self.close()
            raise TermselError("this map is not georeferenced", file=path,
                               hint="Give a raster with a geotransform, such as an orthoimage. The "
                                    "image to georeference comes first, without --map.")
        if dataset.crs is None and crs is None:
            self.close()
            raise TermselError("this map has no CRS", file=path,
                               hint="State it with --crs, such as --crs EPSG:25832; or --crs local "
                                    "for plane coordinates without a CRS.")
        self.crs = normalise(dataset.crs.to_wkt()) if dataset.crs else normalise(crs or LOCAL)

    def close(self) -> None:
        """Close the file."""
        self.raster.close()

    def box(self, crs: str) -> Box:
        """Return the extent (x min, y min, x max, y max) in a CRS."""
        dataset = self.raster.dataset
        share = np.linspace(0, 1, 21)
        zero = np.zeros_like(share)
        unit = np.ones_like(share)
        # The edges are curves in another CRS, so the corners alone would not do.
        edge = np.concatenate([np.column_stack([share, zero]), np.column_stack([zero, share]),
                               np.column_stack([share, unit]), np.column_stack([unit, share])])
        x, y = dataset.transform @ (edge[:, 0] * dataset.width, edge[:, 1] * dataset.height)
        return box_of(transform_places(transformer_between(self.crs, crs), np.column_stack([x, y])))

    def resolution(self, crs: str) -> float:
        """Return the width of a pixel in the middle of the raster, in units of a CRS."""
        dataset = self.raster.dataset
        row = dataset.height / 2
        column = dataset.width / 2
        x, y = dataset.transform @ (np.array([column, column + 1]), np.array([row, row]))
        ends = transform_places(transformer_between(self.crs, crs), np.column_stack([x, y]))
        return float(np.hypot(*(ends[1] - ends[0])))

    def tile(self, box: Box, crs: str) -> Pixels:
        """Return the colours of a box, west, south, east and north in a CRS: (TILE, TILE, 4).

        They are transparent outside the raster. If the raster is in that CRS with north up, they
        are a window of it; else they are resampled at the centres of the tile's pixels.
        """
        from affine import Affine

        west, south, east, north = box
        dataset = self.raster.dataset
        transform = dataset.transform
        # Without the turns b and d, and with lines that run south, north is up.
        upright = transform.b == transform.d == 0 and transform.a > 0 > transform.e
        if upright and transformer_between(self.crs, crs) is None:
            return self.raster.pixels(((transform.f - north) / -transform.e,
                                       (west - transform.c) / transform.a,
                                       (north - south) / -transform.e,
                                       (east - west) / transform.a), (TILE, TILE))
        target = Affine(((east - west) / TILE), 0, west, 0, (south - north) / TILE, north)
        # Centres of the tile's pixels.
        rows, columns = np.mgrid[0:TILE, 0:TILE] + 0.5
        return self._resample_tile(target @ (columns.ravel(), rows.ravel()), crs)

    def _resample_tile(self, xy: Any, crs: str) -> Pixels:
        """Return the colours at x and y of a tile's pixels in a CRS, shape (TILE, TILE, 4)."""
        positions = transform_places(
            transformer_between(self.crs, crs), np.column_stack(xy), inverse=True)
        columns, rows = ~self.raster.dataset.transform @ (positions[:, 0], positions[:, 1])
        return resample_tile(self.raster, rows - 0.5, columns - 0.5)


def resample_tile(raster: Raster, lines: Any, samples: Any) -> Pixels:
    """Return the colours of a raster for the pixels of a tile, shape (TILE, TILE, 4).

    `lines` and `samples` (TILE * TILE,) say where each pixel of the tile is in the raster [px]. It
    gets the nearest pixel of what is read, which has about the resolution of the tile; outside the
    raster it is transparent.
    """
    tile = np.zeros((TILE * TILE, 4), dtype=np.uint8)
    inside = np.flatnonzero((lines > -0.5) & (lines < raster.height - 0.5)
                            & (samples > -0.5) & (samples < raster.width - 0.5))
    if not len(inside):
        return tile.reshape(TILE, TILE, 4)
    # Counted from the outer corner of the image, pixels begin at whole numbers. The window that is
    # read has whole pixels: of another, GDAL would take the nearest ones, and shift all.
    positions = np.column_stack([lines[inside], samples[inside]]) + 0.5
    first = np.floor(positions.min(axis=0))
    size = np.floor(positions.max(axis=0)) + 1.0 - first
    # Twice the pixels of the tile are enough; the others of a finer image would not be seen.
    shape = np.minimum(size, 2 * TILE).astype(int)
    pixels = raster.pixels((float(first[0]), float(first[1]), float(size[0]), float(size[1])),
                           (int(shape[0]), int(shape[1])))
    row, column = np.clip((positions - first) * (shape / size), 0, shape - 1).T
    tile[inside] = pixels[row.astype(np.intp), column.astype(np.intp)]
    return tile.reshape(TILE, TILE, 4)


def box_of(xy: FloatArray) -> Box:
    """Return (x min, y min, x max, y max) of places (n, 2), without those that are not finite.

    The unit square if none is left.
    """
    xy = xy[np.isfinite(xy).all(axis=1)]
    if not len(xy):
        # Tiles need a box of some size.
        return (0.0, 0.0, 1.0, 1.0)
    low = xy.min(axis=0)
    high = xy.max(axis=0)
    return (float(low[0]), float(low[1]), float(high[0]), float(high[1]))


def box_around(boxes: Sequence[Box]) -> Box:
    """Return the smallest box (x min, y min, x max, y max) that holds all boxes, one or more."""
    values = np.array(boxes)
    low = values[:, :2].min(axis=0)
    high = values[:, 2:].max(axis=0)
    return (float(low[0]), float(low[1]), float(high[0]), float(high[1]))


@dataclass
class Maps:
    """All layers of the map, and the grid of their tiles."""

    shown: str
    rasters: list[MapRaster] = field(default_factory=list)
    vectors: list[VectorLayer] = field(default_factory=list)
    tiles: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def close(self) -> None:
        """Close all files."""
        for raster in self.rasters:
            raster.close()

    @property
    def box(self) -> Box | None:
        """The extent of all files (x min, y min, x max, y max) as shown; None without files."""
        boxes = [raster.box(self.shown) for raster in self.rasters]
        boxes += [layer.box for layer in self.vectors]
        return box_around(boxes) if boxes else None

    def resolutions(self, box: Box) -> list[float]:
        """Return the size of a pixel of a tile on each level, in units of the CRS that is shown.

        The coarsest level comes first, and shows all of the box in one tile.
        """
        width = max(box[2] - box[0], box[3] - box[1], 1e-9)
        # Points are measured within pixels, so there are levels finer than any raster.
        finest = min((raster.resolution(self.shown) for raster in self.rasters),
                     default=width / 4096) / 2**FINER
        levels = max(int(np.ceil(np.log2(width / TILE / finest))), 0) + 2
        return [finest * 2**level for level in range(levels, -1, -1)]


def open_maps(names: Sequence[str], crs: str | None, remote: bool) -> Maps:
    """Return all maps that are named, open and shown in one CRS.

    With tiles, this is web Mercator; else it is that of the first raster, or of the first layer of
    vectors if there is none, or `crs`, or "local". Names are files, addresses of tiles, and, if
    `remote`, files on servers. A layer that does not overlap the first one is noted in the maps.
    Raises TermselError for a file that cannot be read, is not georeferenced, or has no CRS while
    `crs` is None; the maps that are open by then are closed.
    """
    rasters = []
    try:
        for name in names:
            if not is_tiles(name) and not is_vector(name):
                _refuse_table(name)
                rasters.append(MapRaster(name, remote, crs))
        # Tiles are in web Mercator alone, so the other maps are shown in it too.
        tiles = [name for name in names if is_tiles(name)]
        vectors = [_layer_of(name) for name in names if not is_tiles(name) and is_vector(name)]
        stated = [raster.crs for raster in rasters]
        stated += [crs_of_layer for _, crs_of_layer in vectors if crs_of_layer]
        first = MERCATOR if tiles else next(iter(stated), crs or LOCAL)
        maps = Maps(shown_crs(normalise(first)), rasters, [], tiles)
        for name, (shapes, crs_of_layer) in zip([name for name in names if not is_tiles(name)
                                                 and is_vector(name)], vectors, strict=True):
            maps.vectors.append(_shapes_shown(name, shapes, crs_of_layer or crs, maps.shown))
        _say_far(maps)
    except BaseException:
        for raster in rasters:
            raster.close()
        raise
    return maps


def _layer_of(name: str) -> tuple[Any, str]:
    """Return the shapes of a vector file, and its CRS, "" if it states none.

    Raises TermselError for a file without geometry.
    """
    meta, shapes, _ = open_layer(Path(name), None, GEOMETRIES)
    if shapes is None:
        raise TermselError("the layer has no geometry", file=name,
                           hint="Give a layer of points, lines or areas.")
    stated = str(meta["crs"] or "")
    return shapes, normalise(stated) if stated else ""


def _shapes_shown(name: str, shapes: Any, crs: str | None, page_crs: str) -> VectorLayer:
    """Return shapes in `crs` as a layer in the CRS of the page; `name` is that of their file.

    Shapes without a vertex, or with one that has no place in the CRS of the page, are left out.
    Raises TermselError without a CRS, or for more than `MOST_VERTICES` vertices.
    """
    import shapely

    if crs is None:
        raise TermselError("this map has no CRS", file=name, hint="State it with --crs.")
    shapes = shapely.force_2d([shape for shape in shapes if shape is not None
                               and not shape.is_empty])
    count = int(shapely.get_num_coordinates(shapes).sum()) if len(shapes) else 0
    if count > MOST_VERTICES:
        raise TermselError(f"this layer has {count:,} vertices, and the page shows at most "
                           f"{MOST_VERTICES:,}", file=name,
                           hint="Cut out the area, for example with ogr2ogr -spat.")
    # The page draws coordinates as they are, so they are transformed here.
    transformer = transformer_between(normalise(crs), page_crs)
    shapes = shapely.transform(shapes, lambda xy: transform_places(transformer, xy))
    features = [{"type": "Feature", "properties": {}, "geometry": shapely.geometry.mapping(shape)}
                for shape in shapes if np.isfinite(shapely.get_coordinates(shape)).all()]
    return VectorLayer(Path(name).name, {"type": "FeatureCollection", "features": features},
                       box_of(shapely.get_coordinates(shapes)))


def _say_far(maps: Maps) -> None:
    """Add a note to the maps on each layer that does not overlap the first one."""
    layers = [(raster.raster.name, raster.box(maps.shown)) for raster in maps.rasters]
    layers += [(layer.name, layer.box) for layer in maps.vectors]
    for name, box in layers[1:]:
        first = layers[0][1]
        is_far = (box[0] > first[2] or box[2] < first[0] or box[1] > first[3] or box[3] < first[1])
        if is_far:
            maps.notes.append(f"{name} does not overlap {layers[0][0]}: is it a map of another "
                              "area?")
