"""GeoJSON as in RFC 7946, with the "crs" that GDAL and QGIS still write."""

from __future__ import annotations

import re
from collections.abc import Container, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import isfinite, nan
from pathlib import Path
from typing import Any

from termsel.core.errors import TermselError
from termsel.data.coordinates.crs import normalise
from termsel.data.tables.tabular import is_free
from termsel.formats.base import error_in_file, parse_json, read_text

_ONE_FEATURE = re.compile(r'\s*\{\s*"type"\s*:\s*"(Feature|(Multi)?(Point|LineString|Polygon))"')


@dataclass(frozen=True)
class Feature:
    """A feature of a collection, and its place there, from 1.

    `parts` are lines of vertices x, y, z, NaN for a missing z; a point is one line of one vertex.
    """

    path: Path
    number: int
    properties: Mapping[str, Any]
    vertex_lists: list[list[list[float]]]

    def error(self, message: str, column: str | None = None,
              hint: str | None = None) -> TermselError:
        """Return an error that says where the feature is."""
        return TermselError(f"feature {self.number}: {message}", file=self.path, column=column,
                            hint=hint)

    def text(self, name: str) -> str:
        """Return a property as text, "" where it is missing or null; refuse lists and objects."""
        value = self.properties.get(name)
        if isinstance(value, list | dict):
            raise self.error("this property is a list or an object, expected text or a number",
                             name)
        return "" if value is None else str(value).strip()

    def attributes(self, used: Container[str]) -> dict[str, str]:
        """Return the properties that the reader does not use as text; without lists and objects.

        `used` are the names that it uses; those in small letters stand for capitals, too. Names of
        columns that have a meaning are left out: they would be read as such next time.
        """
        return {name: self.text(name) for name, value in self.properties.items()
                if name not in used and name.casefold() not in used and is_free(name)
                and not isinstance(value, list | dict)}

    def pixels(self, name: str = "ji") -> Any:
        """Return a property that holds lists of numbers, which GDAL returns as JSON text."""
        value = self.properties.get(name)
        if isinstance(value, str):
            with suppress(TermselError):
                value = parse_json(value, "")
        return value


def sniff_geojson(head: bytes, geometry: str) -> bool:
    """Return True if the text begins as a collection with a geometry that fits the pattern."""
    text = head.decode("utf-8-sig", errors="replace")
    # An annotation of the IIIF has a collection inside: it is another format.
    return (text.lstrip()[:1] == "{" and '"FeatureCollection"' in text
            and re.search(r'"type"\s*:\s*"Annotation', text) is None
            and re.search(rf'"type"\s*:\s*"{geometry}"', text) is not None)


def is_without_collection(head: bytes) -> bool:
    """Return whether a text begins as one feature or one geometry, which is no collection."""
    return _ONE_FEATURE.match(head.decode("utf-8-sig", errors="replace")) is not None


def read_geojson(path: Path, kinds: Mapping[str, int]) -> tuple[list[Feature], str]:
    """Return the features of a collection, and the CRS it declares, "" for none.

    `kinds` are the types of geometry that are read, and how deep their lists of vertices are
    nested. Raises TermselError if this is no such collection, or a feature has another geometry.
    """
    try:
        collection = parse_json(read_text(path), "The file is incomplete or damaged: get it again.")
    except TermselError as error:
        raise error_in_file(error, path) from error
    if not isinstance(collection, dict) or not isinstance(collection.get("features"), list):
        raise TermselError("this is not a GeoJSON FeatureCollection", file=path,
                           hint='It must have the members "type" and "features".')
    if not collection["features"]:
        raise TermselError("the collection has no features", file=path,
                           hint="Export it again with its features.")
    features = [_parse_feature(path, number, item, kinds)
                for number, item in enumerate(collection["features"], 1)]
    return features, _crs_member(path, collection.get("crs"))


def _parse_feature(path: Path, number: int, item: Any, kinds: Mapping[str, int]) -> Feature:
    """Return a feature of the collection with its properties and vertices.

    `kinds` has the geometries that are taken, by how deep their coordinates are nested: 0 for a
    point, 1 for a line, 2 for several lines. Every kind becomes lists of vertices, with NaN for a
    height that is missing. Errors name the feature by its number.

    Raises TermselError for another geometry, and for coordinates that are not two or three finite
    numbers each.
    """
    item = item if isinstance(item, dict) else {}
    # An item that is no object becomes a feature without geometry, which is refused below.
    properties = item.get("properties")
    geometry = item.get("geometry")
    properties = properties if isinstance(properties, dict) else {}
    # RFC 7946 puts the id beside the properties; one among the properties comes before it.
    if "id" in item:
        properties = {"id": item["id"], **properties}
    feature = Feature(path, number, properties, [])
    geometry = geometry if isinstance(geometry, dict) else {}
    kind = str(geometry.get("type", "missing"))
    if kind not in kinds:
        or_points = (" Or make points of these in a GIS, such as where they end or cross."
                     if "Point" in kinds and kind != "missing" else "")
        raise feature.error(f"its geometry is {kind}, expected " + " or ".join(kinds), "geometry",
                            f"Export features of that geometry alone.{or_points}")
    coordinates: Any = geometry.get("coordinates")
    # Nested like several lines: a point is then a list of one list of one vertex.
    for _ in range(2 - kinds[kind]):
        coordinates = [coordinates]
    if not numbers_at(coordinates, 2, (2, 3)):
        raise feature.error("its coordinates are not those of a " + kind, "coordinates",
                            "Vertices are lists of two or three finite numbers.")
    vertex_lists = []
    for positions in coordinates:
        # As floats, since numpy has no whole numbers beyond 64 bits.
        vertex_lists.append([[*map(float, position), nan][:3] for position in positions])
    return Feature(path, number, properties, vertex_lists)


def numbers_at(value: Any, depth: int, lengths: tuple[int, ...]) -> bool:
    """Return whether lists of a depth hold lists of finite numbers, of these lengths.

    At the depth 0 a value is such a list of numbers itself. An empty list holds none.
    """
    if not isinstance(value, list):
        return False
    if depth:
        return bool(value) and all(numbers_at(item, depth - 1, lengths) for item in value)
    return len(value) in lengths and all(
        isinstance(number, int | float) and not isinstance(number, bool) and _is_finite(number)
        for number in value)


def _is_finite(number: float) -> bool:
    """Return whether a number is finite as a float, too."""
    try:
        return isfinite(number)
    except OverflowError:  # a whole number beyond any float
        return False


def _crs_member(path: Path, member: Any) -> str:
    """Return the CRS of the old member "crs"; "" where there is none.

    Raises TermselError, with the file, for one that is not known.
    """
    try:
        # "crs" is not in RFC 7946; without one coordinates are WGS 84.
        name = member["properties"]["name"]
    except (TypeError, KeyError):
        return ""
    try:
        return normalise(str(name))
    except TermselError as error:
        raise error_in_file(error, path, column="crs") from error

