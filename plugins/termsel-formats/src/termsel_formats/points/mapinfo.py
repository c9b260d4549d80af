"""Registration of a raster in MapInfo: a text file that ends in ``.tab``.

A row of a point is ``(x,y) (column,row) Label "name",``. Columns and rows are taken as GDAL takes
them, from the outer corner of the first pixel. MapInfo has no heights.
"""

from __future__ import annotations

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

_TABLE_TITLE = re.compile(rb"^\s*!table", re.IGNORECASE)
_RASTER = re.compile(rb"Type\s+\"RASTER\"", re.IGNORECASE)
_CELL = r"\s*([^\s,()]+)\s*"
_TABLE_POINT = re.compile(rf"\s*\({_CELL},{_CELL}\)\s*\({_CELL},{_CELL}\)"
                          r"(?:\s*Label\s*\"([^\"]*)\")?", re.IGNORECASE)
_SYSTEM = re.compile(r"^\s*CoordSys\s+Earth\s+Projection\s+([^\n]*)", re.IGNORECASE | re.MULTILINE)
# The number of the datum WGS84 in MapInfo.
_WGS84 = "104"


class MapInfoTab(Reader):
    """Points of a raster table of MapInfo.

    Longitude and latitude on WGS84, and UTM on WGS84, are understood as CRS; any other must be
    stated.
    """

    name = "mapinfo-tab"
    summary = "MapInfo .tab of a raster: (x,y) (column,row) Label"

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for a table of a raster."""
        return bool(_TABLE_TITLE.match(head.removeprefix(b"\xef\xbb\xbf")) and _RASTER.search(head))

    def read(self, path: Path) -> FeatureSet:
        """Return the points, without heights.

        They are numbered unless each has a label of its own. Errors name file, line and column.
        """
        text = read_text(path)
        rows = [(number, *match.groups()) for number, line in enumerate(text.splitlines(), 1)
                if (match := _TABLE_POINT.match(line))]
        if not rows:
            raise TermselError("this table has no points of registration", file=path,
                               hint="Register the raster in MapInfo, or give another file.")
        lines, *columns = zip(*rows, strict=True)
        cells = dict(zip(("x", "y", "sample", "line", "id"), columns, strict=True))
        # MapInfo does not require that labels are there, nor that they are unique.
        if None in cells["id"] or len(set(cells["id"])) < len(rows):
            del cells["id"]
        crs = _crs_of_table(text)
        table = Table(path, crs, {name: name for name in cells}, cells, lines)
        image = table.stack("line", "sample") - CORNER
        ground = np.column_stack([table.stack("x", "y"), np.full(len(image), np.nan)])
        return FeatureSet(table.points(image, ground, None, ()), crs=crs)


def _crs_of_table(text: str) -> str:
    """Return the CRS that a table states as `CoordSys Earth Projection`.

    It is an EPSG code for longitude and latitude, or UTM, on WGS84; "" for any other CRS, and if
    the table states none.
    """
    match = _SYSTEM.search(text)
    if match is None:
        return ""
    items = [item.strip().strip('"') for item in match[1].split(",")]
    if items[1:2] != [_WGS84]:
        return ""
    # The projection 1 is longitude and latitude, 8 is transverse Mercator.
    if items[0] == "1":
        return "EPSG:4326"
    try:
        lon, lat, scale, east, north = (float(item) for item in items[3:8])
    except ValueError:
        return ""
    # UTM: scale 0.9996, false easting 500 km, and a central meridian of 6 zone - 183.
    zone = round((lon + 183.0) / 6.0)
    if (items[0] != "8" or items[2] not in ("m", "7") or (lat, scale, east) != (0, 0.9996, 500000)
            or lon != 6 * zone - 183 or north not in (0.0, 1e7)):
        return ""
    return utm_crs(zone, north > 0)


class MapInfoTabWriter(PointsWriter):
    """The selected control points as the registration of a raster in MapInfo.

    In UTM on WGS84 where they are, else as longitude and latitude on WGS84.
    """

    name = "mapinfo-tab"
    summary = "selected control points as MapInfo .tab of the image, which GDAL reads too"
    suffix = ".tab"
    declared_options: ClassVar[tuple[Option, ...]] = (IMAGE_OPTION,)

    def write(self, result: Result, path: Path) -> None:
        """Write the table with the points of registration, in UTM or degrees on WGS84.

        In the image's name quotation marks become _; a label that has one, or a letter beyond
        ASCII, becomes "Pt" and a number. Logs what gdalwarp makes of the points. Raises
        TermselError for a result without control points in a CRS of the Earth.
        """
        self.require(result, path)
        used = chosen_points(result)
        points, zone = to_wgs84_points(used, result.features.crs)
        # In MapInfo the projection 1 is longitude and latitude, and the datum 104 WGS84.
        system, unit = 'Projection 1, 104', "degree"
        if zone is not None:
            number, south = zone
            # Transverse Mercator (8): the central meridian 6 n - 183, the latitude of the origin,
            # the scale on the meridian, and what is added to east and north in UTM.
            system = (f'Projection 8, 104, "m", {6 * number - 183}, 0, 0.9996, 500000, '
                      f"{10000000 if south else 0}")
            unit = "m"
        rows = [f"  ({x!r},{y!r}) ({sample + CORNER!r},{line + CORNER!r}) "
                f'Label "{_label_of_id(name, i)}"'
                for i, (name, (line, sample), (x, y, _)) in enumerate(zip(
                    points.ids, points.image.tolist(), points.ground.tolist(), strict=True), 1)]
        write_text(path, "\n".join([
            "!table", "!version 300", "!charset WindowsLatin1", "", "Definition Table",
            f'  File "{_without_quotes(image_name(self.options["image"], path))}"',
            '  Type "RASTER"',
            ",\n".join(rows), f"  CoordSys Earth {system}", f'  Units "{unit}"', ""]))
        say_by_gdal(self.name, result, used)


def _label_of_id(name: str, number: int) -> str:
    """Return an id as a label, or "Pt 7" if it has a quote or a letter beyond ASCII."""
    return name if name.isascii() and '"' not in name else f"Pt {number}"


def _without_quotes(name: str) -> str:
    """Return a name with _ in place of quotes, which end a text in a TAB file."""
    return name.replace('"', "_")
