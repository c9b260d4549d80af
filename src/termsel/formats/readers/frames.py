"""Features in tables of Python: frames of pandas, geopandas and polars, lists of dicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet
from termsel.data.tables.columns import LINES, POINTS, parse_columns
from termsel.formats.readers.cells import count_meanings, rows_of_records
from termsel.formats.readers.csv_tables import LinesCsv
from termsel.formats.readers.tables import points_of, table_of

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
        raise TermselError(f"features cannot be read from the type {type(frame).__name__}",
                           hint=f"Give {ACCEPTED}. Of an array A: {{'line': A[:, 0], "
                                "'sample': A[:, 1], 'x': A[:, 2], 'y': A[:, 3]}.")
    repeated = [str(name) for name in frame.columns[frame.columns.duplicated()]]
    if repeated:
        raise TermselError(f"the table has several columns named {repeated[0]!r}",
                           hint="Rename or drop all but one.")
    # An index with a name was a column; one without a name only counts rows.
    records = (frame.reset_index() if frame.index.name else frame).to_dict("records")
    shapes = list(frame.geometry) if hasattr(frame, "geom_type") else []
    if not any(_is_point(shape) for shape in shapes):
        return records, ""
    name = frame.geometry.name
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


def _is_point(shape: Any) -> bool:
    """Return whether a geometry is one point, also one of a layer of multipoints."""
    return shape is not None and not shape.is_empty and (
        shape.geom_type == "Point" or (shape.geom_type == "MultiPoint" and len(shape.geoms) == 1))


def _is_column(column: Any) -> bool:
    """Return whether a value of a table has a value for each row, and is no text."""
    return hasattr(column, "__len__") and not isinstance(column, str | bytes | Mapping)
