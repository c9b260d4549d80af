"""Features in tables of Python: frames of pandas, geopandas and polars, lists of dicts."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet
from termsel.data.tables.columns import LINES, POINTS, columns_by_meaning, parse_columns
from termsel.formats.readers.cells import count_meanings, rows_of_records
from termsel.formats.readers.csv_tables import LinesCsv
from termsel.formats.readers.tables import points_of, table_of

log = logging.getLogger(__name__)

ACCEPTED = ("a FeatureSet, the name of a file, a DataFrame of pandas, geopandas or polars, a list "
            "of dicts, or a dict of columns")
_GROUND = {axis: f"{axis} of the geometry" for axis in "xyz"}


def read_frame(frame: Any, columns: str = "", decimal: str | None = None) -> FeatureSet:
    """Return the points or lines of a table in Python, whose columns are named as in a file.

    x and y of a GeoDataFrame are those of its geometry. Raises TermselError for anything that is no
    table, and for what is refused in a table of a file.
    """
    records, crs = _table_records(frame)
    if not records:
        raise TermselError("the table has no rows", hint="Give a row for each point or line.")
    cells = rows_of_records(records, "row", _GROUND)
    stated = parse_columns(columns)
    header = cells.rows[0]
    # Only lines have two ends in the image.
    ends = {meaning: LINES[meaning] for meaning in ("line1", "sample1", "line2", "sample2")}
    if count_meanings(header, ends, stated) == len(ends):
        return LinesCsv().features(table_of(None, cells, LINES, stated, decimal, flat=True))
    return points_of(table_of(None, cells, POINTS, stated, decimal, flat=True), crs)


def _table_records(frame: Any) -> tuple[list[dict[str, Any]], str]:
    """Return the rows of a table as dicts, and its CRS; "" if it states none.

    Tables are a dict of columns, a list of dicts, and those of polars, pandas and GeoPandas, none
    of which has to be installed: each is known by its methods. Points of a GeoDataFrame become x, y
    and z. Raises TermselError for anything else, for columns of different lengths or of one name,
    and for rows without a point beside rows with one.
    """
    if isinstance(frame, Mapping) and all(_is_column(column) for column in frame.values()):
        sizes = {name: len(column) for name, column in frame.items()}
        if len(set(sizes.values())) > 1:
            raise TermselError(f"the columns have different lengths: {sizes}",
                               hint="Give each column a value for every row.")
        return [dict(zip(frame, row, strict=True)) for row in zip(*frame.values(), strict=True)], ""
    if (isinstance(frame, Sequence) and not isinstance(frame, str | bytes)
            and all(isinstance(row, Mapping) for row in frame)):
        return [dict(row) for row in frame], ""
    if hasattr(frame, "to_dicts"):  # polars
        return list(frame.to_dicts()), ""
    if not hasattr(frame, "to_dict") or not hasattr(frame, "columns"):
        raise TermselError(f"features cannot be read from the type {type(frame).__name__}"
                           f"{_content_in_words(frame)}",
                           hint=_as_table(frame) or f"Give {ACCEPTED}.")
    repeated = [str(name) for name in frame.columns[frame.columns.duplicated()]]
    if repeated:
        raise TermselError(f"the table has several columns named {repeated[0]!r}",
                           hint="Rename or drop all but one.")
    # An index with a name was a column; one without a name only counts rows.
    records = (frame.reset_index() if frame.index.name else frame).to_dict("records")
    shapes = list(frame.geometry) if hasattr(frame, "geom_type") else []
    if not any(_is_point(shape) for shape in shapes):
        _refuse_other_shapes(records, frame)
        return records, ""
    name = frame.geometry.name
    _say_other_columns(frame)
    rows = []
    for number, (record, shape) in enumerate(zip(records, shapes, strict=True), 1):
        if not _is_point(shape):
            kind = "no geometry" if shape is None or shape.is_empty else f"a {shape.geom_type}"
            raise TermselError(f"row {number} has {kind} where others have a point", column=name,
                               hint="Give it the geometry of a point, or drop the row.")
        point = shape.geoms[0] if shape.geom_type == "MultiPoint" else shape
        row = {key: value for key, value in record.items() if key != name}
        row |= {_GROUND["x"]: point.x, _GROUND["y"]: point.y}
        if shape.has_z:  # a geometry without a height leaves that to a column of heights
            row[_GROUND["z"]] = point.z
        rows.append(row)
    return rows, "" if frame.crs is None else frame.crs.to_wkt()


def _content_in_words(frame: Any) -> str:
    """Return what a list holds, such as " of Point"; "" for other values."""
    if isinstance(frame, Sequence) and len(frame):
        return f" of {type(frame[0]).__name__}"
    return ""


def _as_table(frame: Any) -> str:
    """Return how a table is made of what is none, but is often at hand; "" for anything else."""
    if isinstance(frame, tuple) and len(frame) == 2 and isinstance(frame[0], list):
        return "A rasterio dataset has both: GCPS, CRS = DATASET.gcps, then read GCPS. " + (
            _as_table(frame[0]))
    if isinstance(frame, Mapping):
        return "Give each column a list, also of one row: {'line': [12.5], ...}."
    if hasattr(frame, "to_dataframe"):  # xarray
        return "Give DATASET.to_dataframe().reset_index()."
    first = frame[0] if isinstance(frame, Sequence) and len(frame) else None
    # Points of rasterio count rows and columns from the corner of a pixel.
    if hasattr(first, "row") and hasattr(first, "col"):
        return ("Of points of rasterio: termsel.read([{'id': p.id, 'line': p.row, 'sample': p.col, "
                "'x': p.x, 'y': p.y, 'z': p.z} for p in GCPS], crs=CRS, image_origin='corner').")
    if hasattr(frame, "geom_type") or hasattr(first, "geom_type"):
        return ("Geometries have no image coordinates. Give them a table with these: "
                "geopandas.GeoDataFrame({'line': LINES, 'sample': SAMPLES}, geometry=GEOMETRIES, "
                "crs=CRS).")
    if isinstance(first, str | Path):
        return ("Read each file by itself: termsel.read(FILE); one of points and one of lines "
                "together: termsel.read(POINTS, LINES).")
    if hasattr(frame, "to_frame"):  # a row or a column of pandas
        return "Give a table: TABLE.loc[[ROW]] is one of a single row."
    if hasattr(frame, "__array__") or isinstance(first, Sequence) or hasattr(first, "__array__"):
        return ("Name the columns: pandas.DataFrame(ROWS, columns=['line', 'sample', 'x', 'y', "
                "'z']), in the order that they have.")
    return ""


def _refuse_other_shapes(records: Sequence[Mapping[str, Any]], frame: Any) -> None:
    """Raise TermselError for a table without ground coordinates but with geometries.

    They are those of a GeoDataFrame, of which none is a point, or points in a plain table.
    """
    for name, value in (records[0] if records else {}).items():
        if not hasattr(value, "geom_type") or _has_ground(frame.columns):
            continue
        if not hasattr(frame, "geom_type"):
            raise TermselError("the table has geometries, and is no GeoDataFrame", column=name,
                               hint=f"Give geopandas.GeoDataFrame(TABLE, geometry={name!r}, "
                                    "crs=CRS).")
        kind = value.geom_type
        remedy = ("A table of lines has columns line1, sample1, line2, sample2, x1, y1, z1, x2, y2 "
                  "and z2; those of a file are read by lines=FILE." if "Line" in kind else
                  "Their centres are points: TABLE.set_geometry(TABLE.to_crs(UTM).centroid). Areas "
                  "of the ground and of the image are read from files, by areas=FILE.")
        raise TermselError(f"the table has the geometry of a {kind}, expected points",
                           column=name, hint=remedy)


def _has_ground(names: Iterable[Any]) -> bool:
    """Return whether columns have names for x and y."""
    header = [str(name) for name in names]
    return all(columns_by_meaning(header, {axis: POINTS[axis]})[axis] for axis in "xy")


def _say_other_columns(frame: Any) -> None:
    """Log a note on columns of x and y that differ from the geometry, which is taken."""
    header = [str(name) for name in frame.columns]
    for axis in "xy":
        for index in columns_by_meaning(header, {axis: POINTS[axis]})[axis]:
            column = frame.iloc[:, index]
            geometry = getattr(frame.geometry, axis) if _is_points(frame.geometry) else column
            if column.dtype.kind in "iuf" and not np.allclose(column, geometry, equal_nan=True):
                log.warning("Note: the column %r of row 1 is %s, and %s of its geometry %s: the "
                            "geometry is read, and its CRS.", header[index],
                            column.iloc[0], axis, geometry.iloc[0])
                return


def _is_points(geometry: Any) -> bool:
    """Return whether all geometries are single points."""
    return bool((geometry.geom_type == "Point").all())


def _is_point(shape: Any) -> bool:
    """Return whether a geometry is one point, also one of a layer of multipoints."""
    return shape is not None and not shape.is_empty and (
        shape.geom_type == "Point" or (shape.geom_type == "MultiPoint" and len(shape.geoms) == 1))


def _is_column(column: Any) -> bool:
    """Return whether a value of a table has a value for each row, and is no text."""
    return hasattr(column, "__len__") and not isinstance(column, str | bytes | Mapping)
