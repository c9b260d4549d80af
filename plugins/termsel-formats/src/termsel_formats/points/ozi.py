"""Calibration of a map in OziExplorer: a text file that ends in ``.map``.

A row of a point is ``Point01,xy,column,row,in,deg,48,30.5,N,11,20.25,E,grid,zone,x,y,N``; blank
cells mean that the point is not used. Columns and rows are taken as GDAL takes them, from the outer
corner of the first pixel. The format has no heights.
"""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import ClassVar

import numpy as np

from termsel import FeatureSet, Option, Reader, Result, TermselError
from termsel.toolkit import read_text, write_text
from termsel.toolkit.files import Table, chosen_points
from termsel_formats.points.common import CORNER, utm_crs
from termsel_formats.points.written import (
    IMAGE_OPTION,
    PointsWriter,
    image_name,
    say_by_gdal,
    to_wgs84_points,
)

log = logging.getLogger("termsel.formats")

_OZI_TITLE = b"OziExplorer Map Data File"
_OZI_POINT = re.compile(r"\s*Point(\d+)\s*,\s*xy\s*,", re.IGNORECASE)
# Points that a map of OziExplorer holds at most.
_MAX_POINTS = 30
_SIGN = {"N": 1, "S": -1, "E": 1, "W": -1}


class OziMap(Reader):
    """Points of a map of OziExplorer, as longitude and latitude, or else as grid coordinates.

    WGS 84 is understood as datum, with UTM for grid coordinates; any other CRS must be stated.
    """

    name = "ozi-map"
    summary = "OziExplorer .map: Point01,xy,column,row,in,deg,..."

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for a file of OziExplorer."""
        return head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(_OZI_TITLE)

    def read(self, path: Path) -> FeatureSet:
        """Return the points in use, with longitude and latitude or with grid coordinates.

        Their heights are not known. Raises TermselError if there are none, or if some have degrees
        and others grid coordinates. Errors name file, line and column.
        """
        text = read_text(path).splitlines()
        rows: list[tuple[int, str, str, str, str, str]] = []
        zones = set()
        kinds = set()
        # Of a row of 17 cells: pixels in 2 and 3, degrees, minutes and side of the latitude in 6 to
        # 8 and of the longitude in 9 to 11, or zone, easting, northing and hemisphere in 13 to 16.
        # OziExplorer also writes rows for points that are not used, without pixels.
        for number, line in enumerate(text, 1):
            match = _OZI_POINT.match(line)
            cells = [cell.strip() for cell in line.split(",")]
            if match is None or len(cells) < 17 or not cells[2] or not cells[3]:
                continue
            if cells[6] and cells[9]:
                kinds.add("deg")
                x, y = (_degrees_text(path, number, *cells[i:i + 3]) for i in (9, 6))
            elif cells[14] and cells[15]:
                kinds.add("grid")
                zones.add((cells[13], cells[16]))
                x, y = cells[14:16]
            else:
                continue
            rows.append((number, match[1], x, y, cells[2], cells[3]))
        if not rows:
            raise TermselError("this map has no points in use", file=path,
                               hint="Calibrate it in OziExplorer, or give another file.")
        if len(kinds) > 1:
            raise TermselError("some points have degrees and others grid coordinates", file=path,
                               hint="Give all of them in one way.")
        lines, *columns = zip(*rows, strict=True)
        cells_of = dict(zip(("id", "x", "y", "sample", "line"), columns, strict=True))
        # The fifth line is the datum.
        crs = _crs_of_points(text[4] if len(text) > 4 else "", kinds, zones)
        table = Table(path, crs, {name: name for name in cells_of}, cells_of, lines)
        image = table.stack("line", "sample") - CORNER
        ground = np.column_stack([table.stack("x", "y"), np.full(len(image), np.nan)])
        return FeatureSet(table.points(image, ground, None, ()), crs=crs)


def _degrees_text(path: Path, line: int, degrees: str, minutes: str, hemisphere: str) -> str:
    """Return the text of an angle [deg] that is given as degrees, minutes and side.

    Raises TermselError, with file and line, if they are no angle.
    """
    try:
        return repr(_SIGN[hemisphere.upper()] * (float(degrees) + float(minutes or 0) / 60))
    except (KeyError, ValueError):
        raise TermselError(f"{degrees!r}, {minutes!r}, {hemisphere!r} are no degrees, minutes and "
                           "side", file=path, line=line,
                           hint="Write them as in 48, 30.5, N.") from None


def _crs_of_points(datum: str, kinds: set[str], zones: set[tuple[str, str]]) -> str:
    """Return the CRS of points in degrees or in one zone of UTM, on WGS84; "" of any other.

    `kinds` are "deg" and "grid", as far as points are of them; `zones` are pairs of a zone and a
    hemisphere.
    """
    if not datum.upper().replace(" ", "").startswith("WGS84"):
        return ""
    if kinds == {"deg"}:
        return "EPSG:4326"
    if len(zones) > 1:
        return ""
    zone, hemisphere = next(iter(zones))
    is_utm = zone.isdecimal() and hemisphere.upper() in ("N", "S")
    return utm_crs(int(zone), hemisphere.upper() == "S") if is_utm else ""


class OziMapWriter(PointsWriter):
    """The selected control points as the calibration of a map in OziExplorer, 30 at most.

    In UTM on WGS 84 where they are, else as degrees and minutes on WGS 84. Columns and rows keep
    their fractions, which GDAL reads.
    """

    name = "ozi-map"
    summary = "selected control points, 30 at most, as OziExplorer .map, which GDAL reads too"
    needs = f"at most {_MAX_POINTS} control points in a CRS of the Earth"
    suffix = ".map"
    declared_options: ClassVar[tuple[Option, ...]] = (IMAGE_OPTION,)

    def accepts(self, result: Result) -> bool:
        """Return True for 30 control points or fewer in a CRS of the Earth."""
        return super().accepts(result) and len(chosen_points(result)) <= _MAX_POINTS

    def write(self, result: Result, path: Path) -> None:
        """Write the selected points as the calibration of a map, on WGS84.

        They are in UTM if the CRS is a zone of it, else in degrees and minutes. Logs what gdalwarp
        makes of them, and warns of points on both sides of 180 degrees. Raises TermselError
        for a result without control points in a CRS of the Earth, or with more than 30.
        """
        self.require(result, path)
        used = chosen_points(result)
        points, zone = to_wgs84_points(used, result.features.crs)
        # Longitudes on both sides of 180 degrees are counted beyond it, such as 181.
        if zone is None and np.abs(points.ground[:, 0]).max() > 180.0:
            log.warning("Warning: %s: the points are on both sides of 180 degrees, and GDAL maps "
                        "one side alone. termsel rectify and gcp-vrt have both.", self.name)
        rows = [_point_line(i, line + CORNER, sample + CORNER, x, y, zone)
                for i, ((line, sample), (x, y, _)) in enumerate(zip(
                    points.image.tolist(), points.ground.tolist(), strict=True), 1)]
        image = image_name(self.options["image"], path)
        projection = "Latitude/Longitude" if zone is None else "(UTM) Universal Transverse Mercator"
        write_text(path, "\n".join([
            f"{_OZI_TITLE.decode()} Version 2.2", path.stem, image, "1 ,Map Code,",
            "WGS 84,WGS 84,   0.0000,   0.0000,WGS 84", "Reserved 1", "Reserved 2",
            "Magnetic Variation,,,E",
            f"Map Projection,{projection},PolyCal,No,AutoCalOnly,No,BSBUseWPX,No", *rows,
            "Projection Setup,,,,,,,,,,", "Map Feature = MF ; Map Comment = MC",
            "Track File = TF", "Moving Map Parameters = MM?", "MM0,No", "MMPNUM,0", ""]))
        say_by_gdal(self.name, result, used)


def _point_line(number: int, row: float, column: float, x: float, y: float,
                zone: tuple[int, bool] | None) -> str:
    """Return the line of a point in a map of OziExplorer.

    `zone` is the zone of UTM and whether it is in the south; None if x and y are degrees.
    """
    beginning = f"Point{number:02d},xy,{column!r},{row!r},in"
    if zone is None:
        latitude = _degrees_and_side(y, "NS")
        longitude = _degrees_and_side(x, "EW")
        return f"{beginning},deg,{latitude},{longitude},grid,,,,N"
    hemisphere = "S" if zone[1] else "N"
    return f"{beginning},deg,,,{hemisphere},,,E,grid,{zone[0]},{x!r},{y!r},{hemisphere}"


def _degrees_and_side(angle: float, hemispheres: str) -> str:
    """Return degrees, minutes and side of an angle [deg] with commas between, such as 48,30.5,N."""
    # The sides are N, S or E, W: the second is that of negative angles.
    degrees = int(abs(angle))
    return f"{degrees},{(abs(angle) - degrees) * 60!r},{hemispheres[angle < 0]}"
