"""The selected features in formats of other programs, with their residuals."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from termsel.core.errors import TermselError
from termsel.core.files.atomic import write_text
from termsel.core.options import Option
from termsel.data.coordinates.crs import horizontal_crs
from termsel.data.coordinates.metres import ground_for_warping
from termsel.data.features import BoolArray, FloatArray, Points
from termsel.formats.base import Writer
from termsel.formats.deviation import GDALWARP, QGIS, say_measured, say_nearest_transformation
from termsel.formats.readers.csv_tables import line_columns, point_columns, table_text
from termsel.formats.vrt import IMAGE, picture_for, vrt_text
from termsel.results.result import Result


class SelectionWriter(Writer):
    """Base of the writers of control points."""

    needs = "control points"

    def accepts(self, result: Result) -> bool:
        """Return True if the control has points."""
        return bool(len(result.fit.control.points))


def _require_accepted(writer: Writer, result: Result, path: Path, hint: str) -> None:
    """Raise TermselError if a writer cannot write a result."""
    if not writer.accepts(result):
        raise TermselError(f"this result cannot be written as {writer.name}", file=path, hint=hint)


def _features_in_adjustment(result: Result) -> set[str]:
    """Return the features in the adjustment, with selection points if a strategy adds them."""
    return {residual.id for residual in result.residuals if residual.used}


def _are_in_adjustment(result: Result) -> BoolArray:
    """Return which of all n points are in the adjustment, (n,)."""
    return np.isin(result.features.points.ids, list(_features_in_adjustment(result)))


def chosen_points(result: Result) -> Points:
    """Return the points in the adjustment."""
    return result.features.points.take(_are_in_adjustment(result))


def gcps_of(result: Result) -> tuple[Points, Points, str]:
    """Return the chosen points as measured, as GCPs with heights, and the CRS of these as WKT."""
    used = chosen_points(result)
    ground, crs = ground_for_warping(used.ground, result.features.crs)
    # GDAL has no missing heights; it takes 0 for one that it does not need.
    return used, replace(used, ground=np.nan_to_num(ground)), crs


def _errors_of_points(result: Result) -> FloatArray:
    """Return measured minus computed line and sample of all points, (n, 2) [px].

    Errors are NaN where a height that the model uses is not known.
    """
    points = result.features.points
    errors = np.asarray(result.fit.errors(points))
    if result.fit.model.uses_height:
        # Without a height there is no computed place.
        errors[np.isnan(points.ground[:, 2])] = np.nan
    return errors


_NO_POINTS = "It has no control points; residuals-gpkg and lines-csv take control lines."


class QgisPointsWriter(SelectionWriter):
    """All points without heights, the selected ones enabled, with residuals, as QGIS saves them."""

    name = "qgis-points"
    summary = "points for QGIS's georeferencer, the selected ones enabled, with residuals"
    suffix = ".points"

    def write(self, result: Result, path: Path) -> None:
        """Write a .points file; dX, dY are computed minus measured, right and down, as in QGIS.

        A residual that is not known is written as 0, as each column of the format has a number.
        Logs the nearest transformation that QGIS has. Raises TermselError if the result is none
        that the format can hold, or the file cannot be written.
        """
        _require_accepted(self, result, path, _NO_POINTS)
        points = result.features.points
        rows = []
        for (x, y, _), (line, sample), selected, (dl, ds) in zip(
                points.ground.tolist(), points.image.tolist(), _are_in_adjustment(result),
                np.nan_to_num(_errors_of_points(result)).tolist(), strict=True):
            # QGIS counts from the edge of a pixel; its y points up for places, down for residuals.
            values = (x, y, sample + 0.5, -line - 0.5, int(selected), -ds, -dl, math.hypot(dl, ds))
            rows.append(",".join(map(repr, values)))
        crs = horizontal_crs(result.features.crs)
        declared = [f"#CRS: {wkt_in_one_line(crs)}"] if crs else []
        write_text(path, "\n".join([
            *declared, "mapX,mapY,sourceX,sourceY,enable,dX,dY,residual", *rows, ""]))
        used = chosen_points(result)
        say_nearest_transformation(self.name, result.fit, used.ground[:, :2], used.image, QGIS,
                                   "where QGIS has the transformation type {}")


class GcpVrt(SelectionWriter):
    """The selected control points as GCPs in a virtual raster of the image."""

    name = "gcp-vrt"
    summary = "selected control points as GCPs in a VRT of the image, for gdalwarp -tps or -order"
    needs = "control points; --image for a VRT that has pixels"
    suffix = "_gcps.vrt"
    declared_options: ClassVar[tuple[Option, ...]] = (IMAGE,)

    def write(self, result: Result, path: Path) -> None:
        """Write a VRT with a list of GCPs; log what gdalwarp makes of them.

        Raises TermselError if the result is none that the format can hold, or the file cannot be
        written.
        """
        _require_accepted(self, result, path, _NO_POINTS)
        points, gcps, crs = gcps_of(result)
        write_text(path, vrt_text(picture_for(result, self.options["image"]), path.parent,
                                  gcps=gcps, crs=crs))
        say_nearest_transformation(self.name, result.fit, points.ground[:, :2], points.image,
                                   GDALWARP, "by gdalwarp {}")


class PointsTable(SelectionWriter):
    """All points as a table that termsel reads, with computed places and residuals."""

    name = "points-csv"
    summary = "all points as CSV with computed line and sample and residuals; termsel reads it"
    suffix = "_points.csv"

    def write(self, result: Result, path: Path) -> None:
        """Write a table; control points that were not selected have 0 in the column enabled.

        Logs that it holds no model. Raises TermselError for a result without control points.
        """
        _require_accepted(self, result, path, _NO_POINTS)
        points = result.features.points
        selected = _are_in_adjustment(result)
        errors = _errors_of_points(result)
        # Measured values in the CRS of the control, so that the table can be read again.
        header, measured = point_columns(points)
        header = ["id", "role", "enabled", *header, "computed_line", "computed_sample",
                  "residual_line", "residual_sample"]
        values = np.concatenate([measured, points.image - errors, errors], axis=1)
        # Only control is selected; other roles are never switched off.
        texts = [[name, role, str(int(on or role != "control"))]
                 for name, role, on in zip(points.ids, points.roles, selected, strict=True)]
        write_text(path, table_text(result.features.crs, header, texts, values,
                                    points.attributes))
        say_measured(self.name)


class LinesTable(Writer):
    """All control lines as a table that termsel reads, with residuals."""

    name = "lines-csv"
    summary = "all control lines as CSV with the residuals of both vertices; termsel reads it"
    needs = "control lines"
    suffix = "_lines.csv"

    def accepts(self, result: Result) -> bool:
        """Return True if there are control lines, used or not."""
        return bool(len(result.features.lines))

    def write(self, result: Result, path: Path) -> None:
        """Write a table; lines that were not selected have 0 in the column enabled.

        Logs that it holds no model. Raises TermselError for a result without control lines.
        """
        _require_accepted(self, result, path, "It has no control lines; points-csv takes points.")
        lines = result.features.lines
        selected = _features_in_adjustment(result)
        header, values = line_columns(lines)
        # Only the distance across a line is an error.
        distances = np.linalg.norm(result.fit.line_errors(lines), axis=-1)
        texts = [[name, "control", str(int(name in selected))] for name in lines.ids]
        write_text(path, table_text(
            result.features.crs, ["id", "role", "enabled", *header, "residual1", "residual2"],
            texts, np.concatenate([values, distances], axis=1), lines.attributes))
        say_measured(self.name)


def wkt_in_one_line(crs: str) -> str:
    """Return the WKT of a CRS in one line; without pyproj the text of the CRS in one line."""
    try:
        from pyproj import CRS
    except ImportError:
        return " ".join(crs.split())
    return str(CRS.from_user_input(crs).to_wkt())
