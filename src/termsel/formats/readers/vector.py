"""Layers of vector files, through pyogrio and its GDAL."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np

from termsel.errors import GIS, TermselError, requires
from termsel.files.names import is_there, utf8_name
from termsel.files.remote import local_alone
from termsel.formats.base import read_head, read_text
from termsel.formats.readers.geojson import Feature
from termsel.formats.readers.tables import COLUMNS

LAYER = next(option for option in COLUMNS if option.name == "layer")

POINT_KINDS = {"Point": 0, "MultiPoint": 1}


def is_vector(head: bytes) -> bool:
    """Return True for the first bytes of a GeoPackage, Shapefile or FlatGeobuf."""
    return (head.startswith((b"\0\0\x27\x0a", b"fgb\x03fgb"))
            or (head.startswith(b"SQLite format 3\0") and head[68:70] == b"GP"))


def has_points(path: Path) -> bool:
    """Return whether a vector file has a layer of points; False where it cannot be read."""
    try:
        from pyogrio import list_layers
        from pyogrio.errors import DataSourceError
    except ImportError:
        return False
    try:
        with local_alone(path) as options, _configured(options), utf8_name(path) as name:
            return is_there(path) and any(
                str(kind).split(" ")[0] in POINT_KINDS for _, kind in list_layers(name))
    except (DataSourceError, TermselError):
        return False


@contextmanager
def _configured(options: Mapping[str, str]) -> Iterator[None]:
    """Set options of pyogrio's GDAL while the block runs."""
    from pyogrio import get_gdal_config_option, set_gdal_config_options

    before = {key: get_gdal_config_option(key) for key in options}
    set_gdal_config_options(dict(options))
    try:
        yield
    finally:
        set_gdal_config_options(before)


def open_layer(path: Path, layer: str | None, kinds: Container[str],
               columns: list[str] | None = None) -> tuple[dict[str, Any], Any, list[Any]]:
    """Return what is known of a layer, its shapes (None without) and its columns, by default all.

    The layer is by default the first that has such kinds, or that GDAL takes for the first.
    """
    if read_head(path, "Expected a GeoPackage, Shapefile or FlatGeobuf.").lstrip()[:1] == b"{":
        read_text(path)  # lest GDAL quotes what is no text
    with requires("this requires", "pyogrio and shapely", GIS, path):
        from pyogrio import list_layers
        from pyogrio.errors import DataLayerError, DataSourceError
        from pyogrio.raw import read
        from shapely import GEOSException, from_wkb
    try:
        with (local_alone(path) as options, _configured(options), catch_warnings(),
              utf8_name(path) as name):
            simplefilter("ignore")  # what GDAL says of a file that it reads all the same
            layers = {str(key): str(kind).split(" ")[0] for key, kind in list_layers(name)}
            if not layers:
                raise TermselError("the file has no layers", file=path, hint="Is it complete?")
            if layer is None:
                layer = next((key for key, kind in layers.items() if kind in kinds),
                             next((key for key, kind in layers.items() if kind == "Unknown"), None))
            meta, _, geometries, values = read(name, layer=layer, columns=columns)
        return meta, None if geometries is None else from_wkb(geometries), values
    except (DataSourceError, DataLayerError, GEOSException, ValueError) as error:
        raise TermselError(f"GDAL cannot read this file: {error}", file=path,
                           hint="Is it complete? A Shapefile needs its .shx and .dbf next to it."
                           ) from error


def read_layer(path: Path, layer: str | None, kinds: Mapping[str, int],
               ) -> tuple[list[Feature], str]:
    """Return the features of a layer, by default of the first that has such kinds, and its CRS."""
    meta, shapes, columns = open_layer(path, layer, kinds)
    from shapely import get_coordinates, get_parts

    names = list(meta["fields"])
    if shapes is None:
        raise TermselError("the layer has no geometry", file=path,
                           hint="Give a layer of points or lines; --set layer=NAME chooses it.")
    if not len(shapes):
        raise TermselError("the layer has no features", file=path)
    features = []
    for number, shape in enumerate(shapes, 1):
        properties = {name: _plain(values[number - 1])
                      for name, values in zip(names, columns, strict=True)}
        feature = Feature(path, number, properties, [])
        kind = "missing" if shape is None or shape.is_empty else shape.geom_type
        if kind not in kinds:
            raise feature.error(f"its geometry is {kind}, expected " + " or ".join(kinds))
        parts = [get_coordinates(part, include_z=True).tolist() for part in get_parts(shape)]
        features.append(Feature(path, number, properties, parts))
    return features, str(meta["crs"] or "")


def _plain(value: Any) -> Any:
    """Return a cell as a number or text; whole numbers, as many ids are, without a point."""
    if isinstance(value, float | np.floating):
        number = float(value)
        return None if np.isnan(number) else int(number) if number.is_integer() else number
    return value
