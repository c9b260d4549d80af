"""Layers of vector files, through pyogrio and its GDAL."""

from __future__ import annotations

import glob
import logging
import re
import shutil
import sqlite3
from collections.abc import Container, Iterator, Mapping
from contextlib import closing, contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from urllib.parse import quote
from warnings import catch_warnings, simplefilter

import numpy as np

from termsel.core.errors import GIS, TermselError, require_import
from termsel.core.files.apart import call_apart
from termsel.core.files.atomic import private_folder
from termsel.core.files.drivers import DRIVER_HINT, WORKING_DRIVERS, gdal_options, vector_drivers
from termsel.core.files.endings import SINGLE_VECTORS
from termsel.core.files.names import is_there, refuse_grids, require_regular
from termsel.core.files.sources import foreign_format, is_text
from termsel.formats.base import read_head, read_utf8
from termsel.formats.readers.geojson import Feature
from termsel.formats.readers.tables import COLUMNS

log = logging.getLogger(__name__)

LAYER = next(option for option in COLUMNS if option.name == "layer")

_INDEX = re.compile(
    r"""CREATE\s+VIRTUAL\s+TABLE\s+(IF\s+NOT\s+EXISTS\s+)?("([^"]|"")*"|'([^']|'')*'|\w+)"""
    r"""\s+USING\s+["'`\[]?(rtree|rtree_i32|fts[345]|geopoly)\b""", re.IGNORECASE)
"""Virtual tables that hold their own rows. A comment could hide another module: none is taken."""

POINT_KINDS = {"Point": 0, "MultiPoint": 1}


def is_vector(head: bytes) -> bool:
    """Return True for the first bytes of a GeoPackage, Shapefile or FlatGeobuf."""
    return (head.startswith((b"\0\0\x27\x0a", b"fgb\x03fgb"))
            # The application id in the header distinguishes a GeoPackage from other databases.
            or (head.startswith(b"SQLite format 3\0") and head[68:70] == b"GP"))


def has_points(path: Path) -> bool:
    """Return whether a vector file has a layer of points; False where it cannot be read.

    That is also so if pyogrio is not installed.
    """
    if find_spec("pyogrio") is None:
        return False
    try:
        return is_there(path) and any(kind in POINT_KINDS
                                      for kind in call_apart(_layer_geometries, path).values())
    except TermselError:
        return False


def open_layer(path: Path, layer: str | None, kinds: Container[str],
               columns: list[str] | None = None, chooser: str | None = "",
               ) -> tuple[dict[str, Any], Any, list[Any]]:
    """Return the metadata of a layer by name, its shapes, and the values of its columns.

    Shapes are None for a layer without geometry.

    Parameters
    ----------
    path : Path
    layer : str or None
        By default the first with a geometry of `kinds`, else the first of mixed geometries, else
        the one that GDAL takes for the first.
    kinds : container of str
        Types of geometry, such as "Point".
    columns : list of str, optional
        The columns to be read; by default all.
    chooser : str or None
        What chooses another layer, for a note where several suit: an option, "" for ogr2ogr, or
        None for no note.

    Raises
    ------
    TermselError
        If the file cannot be read, or has no layers or not this one.
    """
    # The text of JSON is checked first: GDAL's own message would quote bytes that are no text.
    if read_head(path, "Expected a GeoPackage, Shapefile or FlatGeobuf.").lstrip()[:1] == b"{":
        read_utf8(path)
    with require_import("this requires", "pyogrio and shapely", GIS, path):
        import pyogrio.errors  # noqa: F401 (what the other process imports)
        from shapely import GEOSException, from_wkb
    # In a process of its own: GDAL may crash on a damaged file.
    layers = call_apart(_layer_geometries, path)
    if not layers:
        raise TermselError("the file has no layers", file=path,
                           hint="Check it in a GIS, or export it again.")
    if layer is not None and layer not in layers:
        raise TermselError(f"the file has no layer {layer!r}", file=path,
                           hint=f"It has {', '.join(layers)}.")
    if layer is None:
        # A layer of mixed geometries has the kind Unknown.
        suitable = ([key for key, kind in layers.items() if kind in kinds]
                    or [key for key, kind in layers.items() if kind == "Unknown"])
        layer = suitable[0] if suitable else None
        if chooser is not None and len(suitable) > 1:
            log.info("Note: %s has the layers %s; %s is read, and %s chooses another.", path.name,
                     ", ".join(suitable), layer, chooser or f"ogr2ogr one.gpkg {path.name} NAME")
    meta, geometries, values = call_apart(_read_layer, path, layer, columns)
    # A CRS may name grid files, which PROJ would open.
    refuse_grids(str(meta["crs"] or ""), path)
    try:
        return meta, None if geometries is None else from_wkb(geometries), values
    except GEOSException as error:
        raise _unreadable_error(path, error) from error


def _layer_geometries(path: Path) -> dict[str, str]:
    """Return the kind of geometry of each layer, in the process that reads vector files."""
    from pyogrio import list_layers

    with _name_for_drivers(path) as name:
        return {str(key): str(kind).split(" ")[0] for key, kind in list_layers(name)}


def _read_layer(path: Path, layer: str | None, columns: list[str] | None,
                ) -> tuple[dict[str, Any], Any, list[Any]]:
    """Return metadata of a layer, its geometries and its columns; called in GDAL's process."""
    from pyogrio.raw import read

    with _name_for_drivers(path) as name:
        meta, _, geometries, values = read(name, layer=layer, columns=columns)
    return meta, geometries, list(values)


@contextmanager
def _name_for_drivers(path: Path) -> Iterator[Path]:
    """Yield a name in a private folder by which the drivers that are allowed read a vector file.

    Raises TermselError where reading it in the block fails, and for files of drivers that are off.
    """
    from pyogrio.errors import DataLayerError, DataSourceError

    _turn_off_drivers()
    # SQLite would run the module of a virtual table as soon as it is read.
    _refuse_queries(path)
    try:
        with private_folder() as folder, catch_warnings():
            # Warnings are about files that GDAL reads all the same.
            simplefilter("ignore")
            yield _link_into_folder(path, folder)
    except (DataSourceError, DataLayerError, ValueError) as error:
        # pyogrio has no class of its own for this.
        if "not recognized as being in a supported file format" in str(error):
            raise _refused_driver_error(path) from None
        raise _unreadable_error(path, error) from None


def _turn_off_drivers() -> None:
    """Leave the GDAL of this process only the drivers that may open vector files."""
    from pyogrio import core, list_drivers, set_gdal_config_options

    # All but the allowed ones: a new version of GDAL may have new drivers.
    refused = [name for name in list_drivers() if name not in (*vector_drivers(), *WORKING_DRIVERS)]
    # OGR_SKIP, which the user's environment may set, would turn off further ones.
    set_gdal_config_options({**gdal_options(), "GDAL_SKIP": ",".join(refused) or None,
                             "OGR_SKIP": None})
    if refused:
        # GDAL_SKIP counts only when drivers are registered.
        core._register_drivers()


def _link_into_folder(path: Path, folder: Path) -> Path:
    """Link a file into a folder, where GDAL may write files next to it; return the link.

    The further files of a Shapefile, of the same stem, are linked as well; no others, and no
    folders, are there for GDAL to read. Files are copied where links are not possible or not
    enough.
    """
    # pyogrio cannot pass on names that are no UTF-8.
    name = folder / path.name.encode(errors="replace").decode()
    files = [path]
    if path.suffix.lower() not in SINGLE_VECTORS:
        files += [file for file in path.parent.glob(f"{glob.escape(path.stem)}.*")
                  if file != path and not file.is_dir()]
    for file in files:
        link = name if file == path else name.with_suffix(file.suffix)
        if not file.is_file():
            require_regular(file, path)
            continue
        # Of a database with a journal SQLite writes files next to it, wherever links lead.
        if _is_wal(file):
            shutil.copy(file, link)
            continue
        try:
            link.symlink_to(file.absolute())
        except FileExistsError:
            continue
        except OSError:  # links need a permission on some systems
            shutil.copy(file, link)
    return name


def _is_wal(path: Path) -> bool:
    """Return whether a file of SQLite keeps its newest content in a journal next to it."""
    with path.open("rb") as file:
        head = file.read(20)
    return head.startswith(b"SQLite format 3\0") and 2 in head[18:20]


def _refuse_queries(path: Path) -> None:
    """Raise TermselError for a database of SQLite with tables that read other files.

    Other files pass, and so do the indices of a GeoPackage.
    """
    with path.open("rb") as file:
        if file.read(16) != b"SQLite format 3\0":
            return
    # Opened here without its journal, so that nothing is written next to it. Virtual tables have
    # no page of their own: rootpage is 0.
    address = f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1"
    try:
        with closing(sqlite3.connect(address, uri=True)) as database:
            virtual = [str(sql) for sql, in database.execute(
                "SELECT sql FROM sqlite_master WHERE type = 'table' AND rootpage = 0")]
    except sqlite3.Error as error:
        raise _unreadable_error(path, error) from None
    for sql in virtual:
        if not _INDEX.match(sql):
            raise TermselError("this database has a virtual table, which may read any file",
                               file=path, hint="Write its layers to a plain GeoPackage: ogr2ogr "
                                               "plain.gpkg FILE LAYER.")


def _refused_driver_error(path: Path) -> TermselError:
    """Return the error for a file of a driver that is off, by what its head looks like.

    It says of text, of rasters and of formats that termsel knows what to give instead.
    """
    with path.open("rb") as file:
        head = file.read(4096)
    if is_text(head):
        return TermselError("this is a table or other text, without lines of a map", file=path,
                            hint="Give a file of vectors, such as roads in a GeoPackage or in "
                                 "GeoJSON. Tables of points are for termsel run: --points FILE.")
    # TIFF in either byte order, and BigTIFF.
    if head.startswith((b"II*\0", b"MM\0*", b"II+\0")):
        return TermselError("this is a raster (TIFF), expected vectors", file=path,
                            hint="Give a file of lines or points, such as a GeoPackage.")
    name = foreign_format(head)
    if name:
        reason = f"this is of the format {name}, which termsel does not open"
    else:
        reason = "this is no vector file of a format that termsel opens"
    allowing = f" {DRIVER_HINT.format(name=name)}" if name else ""
    return TermselError(reason, file=path, hint=f"Convert it: ogr2ogr lines.gpkg FILE.{allowing}")


def _unreadable_error(path: Path, error: Exception) -> TermselError:
    """Return the error for a vector file that GDAL cannot read."""
    return TermselError(f"GDAL cannot read this file: {error}", file=path,
                        hint="Export it again. A Shapefile needs its .shx and .dbf beside it.")


def read_layer(path: Path, layer: str | None, kinds: Mapping[str, int],
               chooser: str | None = "") -> tuple[list[Feature], str]:
    """Return the features of a layer, and its CRS; "" if it states none.

    Each feature has its properties by name, and for each part of its geometry a list of vertices
    [x, y, z], with NaN for z where the layer is flat.

    Parameters
    ----------
    path : Path
    layer : str or None
        By default the first with a geometry of `kinds`; see `open_layer`.
    kinds : mapping
        The types of geometry that are expected, as keys.
    chooser : str or None
        The option that chooses a layer, for a note where there are several; see `open_layer`.

    Raises
    ------
    TermselError
        If the file cannot be read, if the layer has no features or no geometry, or if the geometry
        of a feature is missing or of another type.
    """
    meta, shapes, columns = open_layer(path, layer, kinds, chooser=chooser)
    from shapely import get_coordinates, get_parts

    names = list(meta["fields"])
    if shapes is None:
        raise TermselError("the layer has no geometry", file=path,
                           hint="Give a layer of points or lines; --set layer=NAME chooses it.")
    if not len(shapes):
        raise TermselError("the layer has no features", file=path,
                           hint="Choose another layer: --set layer=NAME.")
    features = []
    for number, shape in enumerate(shapes, 1):
        properties = {name: _number_or_text(values[number - 1])
                      for name, values in zip(names, columns, strict=True)}
        vertex_lists = [get_coordinates(part, include_z=True).tolist()
                        for part in get_parts(shape)]
        feature = Feature(path, number, properties, vertex_lists)
        # A layer may mix kinds, and have features without any.
        kind = "missing" if shape is None or shape.is_empty else shape.geom_type
        if kind not in kinds:
            raise feature.error(f"its geometry is {kind}, expected {' or '.join(kinds)}",
                                hint=_other_geometry(kind))
        features.append(feature)
    return features, str(meta["crs"] or "")


def _other_geometry(kind: str) -> str:
    """Return what to do with a layer that has a geometry of another kind."""
    if kind == "missing":
        return "Give it a geometry, or delete the feature."
    if "Polygon" in kind:
        return ("Points of the centres: in QGIS Vector > Geometry Tools > Centroids, in geopandas "
                "TABLE.set_geometry(TABLE.centroid). Areas are read from a table of their corners.")
    return "Give a layer of that kind, or delete the feature."


def _number_or_text(value: Any) -> Any:
    """Return a cell as a number or text: None for NaN, and whole numbers, as many ids are, as int.
    """
    if not isinstance(value, float | np.floating):
        return value
    number = float(value)
    if np.isnan(number):
        return None
    return int(number) if number.is_integer() else number
