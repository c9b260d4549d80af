"""The parts of an annotation, as versions 0 and 1 of the extension and Allmaps have them."""

from __future__ import annotations

import json
import re
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit
from xml.etree import ElementTree

import msgspec

FORMAT_NAME = "georeference-annotation"
SOURCE, MASK, TRANSFORMATION = "iiif_source", "iiif_mask", "iiif_transformation"
"""Attributes in which the first point of a map keeps what is not of a point."""

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_CORNER = re.compile(rf"\s*({_NUMBER})[\s,]+({_NUMBER})\s*,?")

Pair = Annotated[list[float], msgspec.Meta(min_length=2)]
Service = Literal["ImageService1", "ImageService2", "ImageService3", "Canvas"]


class _Properties(msgspec.Struct):
    """Where a point is in the image: `resourceCoords` of version 1, `pixelCoords` of version 0."""

    resourceCoords: Pair | None = None
    pixelCoords: Pair | None = None


class _Geometry(msgspec.Struct):
    """Where a point is on the ground: longitude and latitude [degrees]."""

    coordinates: Pair
    type: Literal["Point"] = "Point"


class Feature(msgspec.Struct):
    """One control point."""

    type: Literal["Feature"]
    properties: _Properties
    geometry: _Geometry
    id: Any = None

    @property
    def image(self) -> list[float]:
        """Column and row from the upper left corner of the image; raises ValueError if not stated.
        """
        position = self.properties.resourceCoords or self.properties.pixelCoords
        if position is None:
            raise ValueError("Object missing required field `resourceCoords`")
        return position


class _Body(msgspec.Struct):
    """The control points of a map."""

    type: Literal["FeatureCollection"]
    features: list[Feature]
    transformation: Any = None


class _Source(msgspec.Struct):
    """An image in version 1."""

    type: Service
    id: str | None = None
    at_id: str | None = msgspec.field(default=None, name="@id")
    height: Annotated[int, msgspec.Meta(gt=0)] | None = None
    width: Annotated[int, msgspec.Meta(gt=0)] | None = None


class _OneService(msgspec.Struct):
    """The service of an image in version 0."""

    id: str = msgspec.field(name="@id")
    type: Service


class _Selector(msgspec.Struct):
    """The part of the image that is the map."""

    type: Literal["SvgSelector"]
    value: str


class _Target(msgspec.Struct):
    """The image of a map."""

    source: str | _Source
    selector: _Selector
    service: Annotated[list[_OneService], msgspec.Meta(min_length=1, max_length=1)] | None = None


class MapAnnotation(msgspec.Struct):
    """One map."""

    type: Literal["Annotation"]
    target: _Target
    body: _Body
    id: str | None = None


class Map(msgspec.Struct):
    """What is used of an annotation: image, control points, mask and transformation.

    `resource` has id, type, width and height of the image; `mask` is the SVG of the selector;
    `transformation` is as the annotation states it, or None; `features` are column, row, longitude
    and latitude of each point.
    """

    id: str | None
    resource: dict[str, Any]
    mask: str
    transformation: Any
    features: list[tuple[float, float, float, float]]


def maps_of(text: bytes) -> list[Map]:
    """Return the maps of an annotation or of a page of them.

    Raises
    ------
    ValueError
        If it is neither; the message says what is wrong, and where as a path in the JSON.
    """
    content = msgspec.json.decode(text)
    if not isinstance(content, dict):
        raise ValueError("Expected an object - at `$`")  # noqa: TRY004
    if content.get("type") == "AnnotationPage":
        items = content.get("items")
        if not isinstance(items, list):
            raise ValueError("Expected an array of annotations - at `$.items`")
        return [_parse_map(item, f"$.items[{i}]") for i, item in enumerate(items)]
    return [_parse_map(content, "$")]


def _parse_map(item: Any, path: str) -> Map:
    """Return the map of an annotation, a JSON value; `path` is its place in the file.

    Raises ValueError, with the place of what is wrong, if it is none.
    """
    try:
        annotation = msgspec.convert(item, MapAnnotation)
    except msgspec.ValidationError as error:
        # msgspec names a place within the item as `$.…`.
        raise ValueError(str(error).replace("`$", f"`{path}")) from error
    points = []
    for i, feature in enumerate(annotation.body.features):
        try:
            column, row = feature.image[:2]
        except ValueError as error:
            raise ValueError(f"{error} - at `{path}.body.features[{i}].properties`") from error
        lon, lat = feature.geometry.coordinates[:2]
        points.append((column, row, lon, lat))
    size = _parse_selector_size(annotation.target.selector.value, path)
    transformation = annotation.body.transformation
    return Map(annotation.id, _parse_resource(annotation.target, size, path),
               annotation.target.selector.value,
               transformation if isinstance(transformation, dict) else None, points)


def _parse_resource(target: _Target, size: tuple[int, int] | None, path: str) -> dict[str, Any]:
    """Return "id", "type", "width" and "height" of the image of a map.

    `size` is width and height that the selector states, taken where the image states none. Without
    either, width and height are None. Raises ValueError without an address of the image.
    """
    source = target.source
    if isinstance(source, _Source):
        name = source.id or source.at_id
        if not name:
            raise ValueError(f"Object missing required field `id` - at `{path}.target.source`")
        _require_url(name, f"{path}.target.source.id")
        width = source.width
        height = source.height
        if width is None or height is None:
            width, height = size or (None, None)
        return {"id": name, "type": source.type, "width": width, "height": height}
    _require_url(source, f"{path}.target.source")
    if target.service is None:
        raise ValueError(f"Object missing required field `service` - at `{path}.target`")
    service = target.service[0]
    _require_url(service.id, f"{path}.target.service[0].@id")
    # In version 0 the selector alone states a size of the image.
    width, height = size or (None, None)
    return {"id": service.id, "type": service.type, "width": width, "height": height}


def _require_url(text: str, path: str) -> None:
    """Raise ValueError if a text is no address; `path` is its place in the file."""
    url = urlsplit(text)
    if not url.scheme or not (url.netloc or url.path):
        raise ValueError(f"Invalid url {text!r} - at `{path}`")


def _parse_selector_size(value: str, path: str) -> tuple[int, int] | None:
    """Return width and height that a selector, an SVG, states; None if it does not state both.

    `path` is the place of its map in the file. Raises ValueError if it is no SVG, has declarations,
    or has no polygon of three corners or more.
    """
    location = f" - at `{path}.target.selector.value`"
    # Declarations of entities can make a short text very long.
    if "<!" in value:
        raise ValueError(f"SVG with declarations{location}")
    try:
        svg = ElementTree.fromstring(value)
    except ElementTree.ParseError as error:
        raise ValueError(f"Invalid SVG: {error}{location}") from error
    polygon = next((element for element in svg.iter()
                    if element.tag.rpartition("}")[2] == "polygon"), None)
    if polygon is None or len(polygon_corners(polygon.get("points", ""))) < 3:
        raise ValueError(f"Invalid SVG, expected a polygon of three corners or more{location}")
    return _stated_size(svg)


def _stated_size(svg: ElementTree.Element) -> tuple[int, int] | None:
    """Return width and height that an SVG states as numbers; None if it does not state both."""
    try:
        return int(float(svg.get("width", ""))), int(float(svg.get("height", "")))
    except ValueError:
        return None


def selector_of_other_size(map_: Map) -> tuple[int, int] | None:
    """Return width and height that the selector of a map states, if the image states others.

    None if they are the same to a hundredth, which is rounding, or if either is not stated.

    Examples
    --------
    >>> svg = '<svg width="300" height="200"><polygon points="0,0 9,0 9,9" /></svg>'
    >>> selector_of_other_size(Map("", {"width": 600, "height": 400}, svg, None, []))
    (300, 200)
    """
    size = _stated_size(ElementTree.fromstring(map_.mask))
    width = map_.resource["width"]
    height = map_.resource["height"]
    if size is None or not width or not height:
        return None
    is_same = abs(size[0] - width) <= 0.01 * width and abs(size[1] - height) <= 0.01 * height
    return None if is_same else size


def polygon_corners(points: str) -> list[tuple[float, float]]:
    """Return the corners (x, y) of an SVG polygon [px], by the text of its attribute `points`.

    [] if the text is no list of pairs of numbers.
    """
    pairs = []
    start = 0
    # SVG separates numbers by commas or blanks, so the pairs are read one after the other.
    while start < len(points.rstrip()):
        match = _CORNER.match(points, start)
        if match is None:
            return []
        pairs.append((float(match[1]), float(match[2])))
        start = match.end()
    return pairs


def attributes_of_map(georeferenced: Map) -> dict[str, str]:
    """Return source, mask and transformation of a map as texts, by the names of attributes.

    The transformation is "" if the map states none.
    """
    return {SOURCE: json.dumps({"annotation": georeferenced.id, **georeferenced.resource}),
            MASK: georeferenced.mask,
            TRANSFORMATION: json.dumps(georeferenced.transformation) if georeferenced.transformation
            else ""}
