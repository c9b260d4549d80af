"""Ground control points as features: GeoJSON, also of Orthority, and vector files of a GIS."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from math import nan
from pathlib import Path
from typing import Any

from termsel.data.features import FeatureSet
from termsel.data.tables.columns import POINTS, Aliases, columns_by_meaning, parse_columns
from termsel.formats.base import IMAGE_NAME, Reader, image_of, read_head
from termsel.formats.readers.cells import rows_of_records
from termsel.formats.readers.geojson import (
    Feature,
    is_without_collection,
    numbers_at,
    read_geojson,
    sniff_geojson,
)
from termsel.formats.readers.tables import COLUMNS, Table, points_of, table_of
from termsel.formats.readers.vector import POINT_KINDS, has_points, is_vector, read_layer

_GROUND = {axis: f"{axis} of the geometry" for axis in "xyz"}
_OF_JI = {"sample": "column of ji", "line": "row of ji"}
_OF_SIGMA = {"sigma_sample": "column of sigma_px", "sigma_line": "row of sigma_px"}
_USED = ("filename", "ji", "sigma_px", "info")


class GeoJsonPoints(Reader):
    """Points with image columns of any known name, or the property `ji` of Orthority.

    Further properties may be `id`, `filename` of the image, `role`, `enabled` and `sigma_px`, one
    standard deviation or a pair for column and row. Without a "crs" of its own the file is in
    WGS84, with ellipsoidal heights if there are any.
    """

    states_origin = False
    name = "geojson-points"
    summary = "GeoJSON points with properties line and sample, or ji = [column, row]"
    declared_options = (IMAGE_NAME, *COLUMNS[:2])

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for a collection of points."""
        return sniff_geojson(head, "(Multi)?Point")

    def read(self, path: Path) -> FeatureSet:
        """Return the points; errors name file, feature and property."""
        features, crs = read_geojson(path, POINT_KINDS)
        table = _table_of_features(path, features, self.options)
        # Without heights the CRS must not claim a meaning of heights.
        flat = "z" not in table.columns or not any(table.columns["z"])
        return points_of(table, crs or ("EPSG:4326" if flat else "EPSG:4979"))

    def parts(self, path: Path) -> dict[str, dict[str, Any]]:
        """Return the images of the points, each of which is a part."""
        return _images_of(read_geojson(path, POINT_KINDS)[0])


class VectorPoints(Reader):
    """Points of a GeoPackage, Shapefile or FlatGeobuf, with image columns as in GeoJSON."""

    states_origin = False
    name = "vector-points"
    summary = "GeoPackage, Shapefile or FlatGeobuf of points with columns line and sample"
    declared_options = (IMAGE_NAME, *COLUMNS)

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for a vector file with a layer of points."""
        return is_vector(head) and has_points(path)

    def read(self, path: Path) -> FeatureSet:
        """Return the points; errors name file, feature and column."""
        features, crs = read_layer(path, self.options["layer"], POINT_KINDS, "--set layer=NAME")
        return points_of(_table_of_features(path, features, self.options), crs)

    def parts(self, path: Path) -> dict[str, dict[str, Any]]:
        """Return the images of the points, each of which is a part."""
        return _images_of(read_layer(path, self.options["layer"], POINT_KINDS, None)[0])


def table_of_places(path: Path, aliases: Aliases, stated: Mapping[str, str], *,
                    layer: str | None = None, flat: bool = False) -> Table | None:
    """Return the points of a vector file as a table of their coordinates and properties.

    Of a file with several layers it reads `layer`, or the first one of points. Returns None if the
    file is neither GeoJSON nor a vector file of a GIS. With `flat`, heights may be missing, and are
    then blank. Raises TermselError where the file has other geometries than points.

    Examples
    --------
    >>> from pathlib import Path
    >>> table_of_places(Path("gcps.csv"), {"x": ("x",)}, {}) is None
    True
    """
    # An empty file, and a name that is no file, are left to the reader of tables.
    has_content = os.path.isfile(path) and path.stat().st_size > 0
    head = read_head(path, "Give points as a table or a vector file.") if has_content else b""
    if is_vector(head):
        features, crs = read_layer(path, layer, POINT_KINDS, "--layer NAME of termsel project")
    elif sniff_geojson(head, r"\w+") or is_without_collection(head):
        features, crs = read_geojson(path, POINT_KINDS)
    else:
        return None
    records = []
    for feature in features:
        vertex = _require_one_vertex(feature)
        places = {name: value for name, value in zip(_GROUND.values(), vertex, strict=True)
                  if value == value}
        records.append({**feature.properties, **places})
    has_heights = any(_GROUND["z"] in record for record in records)
    fixed = {axis: name for axis, name in _GROUND.items() if axis in aliases}
    names = list(dict.fromkeys(chain.from_iterable(records)))
    has_column_of_heights = "z" in stated or bool(columns_by_meaning(names, aliases).get("z"))
    if not has_heights and not has_column_of_heights and not flat and "z" in fixed:
        # With blank heights the error is that a height is missing, not that a column is.
        for record in records:
            record[_GROUND["z"]] = nan
    cells = rows_of_records(records, "feature", fixed, [feature.number for feature in features])
    table = table_of(path, cells, aliases, stated, flat=flat)
    return replace(table, crs=crs or ("EPSG:4979" if has_heights else "EPSG:4326"))


def _require_one_vertex(feature: Feature) -> list[float]:
    """Return the vertex of a point; raises TermselError for a feature of several."""
    if sum(map(len, feature.vertex_lists)) != 1:
        raise feature.error("it has several vertices, expected one point", "geometry",
                            "Make a feature of each point.")
    return feature.vertex_lists[0][0]


def _images_of(features: Sequence[Feature]) -> dict[str, dict[str, Any]]:
    """Return the options that read the points of each of several images."""
    images = dict.fromkeys(feature.text("filename") for feature in features)
    return {image: {"image_name": image} for image in images} if len(images) > 1 else {}


def _table_of_features(path: Path, features: list[Feature], options: Mapping[str, Any]) -> Table:
    """Return the properties and vertices of the features of one image, by their meaning.

    One image is read, that of the option `image_name` where there are several. Image coordinates
    are those of Orthority's property `ji` (sample and line) unless `columns` says otherwise, ground
    coordinates those of the geometry, with the height from a property where the geometry has none.
    Errors name the feature by its number, as GeoJSON has no lines.
    """
    names = [feature.text("filename") for feature in features]
    image = image_of(path, names, options["image_name"], "image_name=NAME")
    features = [feature for feature, name in zip(features, names, strict=True) if name == image]
    stated = parse_columns(options["columns"])
    has_ji = any("ji" in feature.properties for feature in features)
    has_id = any("id" in feature.properties for feature in features)
    records = []
    for feature in features:
        record = {name: value for name, value in feature.properties.items()
                  if name not in _USED or name in stated.values()}
        # Columns that the user has named come before those of Orthority.
        if has_ji and not {"line", "sample"} & stated.keys():
            record |= dict(zip(_OF_JI.values(), _sample_and_line(feature), strict=True))
        if feature.properties.get("sigma_px") is not None:
            record |= dict(zip(_OF_SIGMA.values(), _stated_sigma(feature), strict=True))
        # A geometry without a height leaves that to a column of heights.
        vertex = _require_one_vertex(feature)
        record |= {name: value for name, value in zip(_GROUND.values(), vertex, strict=True)
                   if value == value}
        if has_id:
            record["id"] = feature.text("id") or f"P{feature.number}"
        records.append(record)
    names = list(dict.fromkeys(chain.from_iterable(records)))
    has_heights = (_GROUND["z"] in names or "z" in stated
                   or bool(columns_by_meaning(names, POINTS)["z"]))
    # Without any height there is still a column of heights, which are blank.
    if not has_heights:
        for record in records:
            record[_GROUND["z"]] = nan
    numbers = [feature.number for feature in features]
    cells = rows_of_records(records, "feature", {**_GROUND, **_OF_JI, **_OF_SIGMA}, numbers)
    return table_of(path, cells, POINTS, stated, options["decimal"])


def _sample_and_line(feature: Feature) -> list[float]:
    """Return the property ji, [column, row]; raises TermselError if a feature lacks it."""
    ji: Any = feature.pixels()
    if not numbers_at(ji, 0, (2,)):
        raise feature.error("it has no image coordinates", "ji",
                            "Add the property ji as [column, row].")
    return list(ji)


def _stated_sigma(feature: Feature) -> list[float]:
    """Return the standard deviations of sample and line [px], of which a feature may state one.

    Raises TermselError where they are no numbers.
    """
    value = feature.pixels("sigma_px")
    pair = value if isinstance(value, list) else [value, value]
    if not numbers_at(pair, 0, (2,)):
        raise feature.error("its standard deviation is missing or not a number", "sigma_px",
                            "Give it for every point, or for none.")
    return [float(number) for number in pair]
