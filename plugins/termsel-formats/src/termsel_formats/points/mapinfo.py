"""Registration of a raster in MapInfo: a text file that ends in ``.tab``.

A row of a point is ``(x,y) (column,row) Label "name",``. Columns and rows are taken as GDAL takes
them, from the outer corner of the first pixel. MapInfo has no heights.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from termsel import FeatureSet, Reader, TermselError
from termsel.formats.base import read_text
from termsel.formats.readers.table import Table

_TITLE = re.compile(rb"^\s*!table", re.IGNORECASE)
_RASTER = re.compile(rb"Type\s+\"RASTER\"", re.IGNORECASE)
_NUMBER = r"\s*([^\s,()]+)\s*"
_POINT = re.compile(rf"\s*\({_NUMBER},{_NUMBER}\)\s*\({_NUMBER},{_NUMBER}\)"
                    r"(?:\s*Label\s*\"([^\"]*)\")?", re.IGNORECASE)
_SYSTEM = re.compile(r"^\s*CoordSys\s+Earth\s+Projection\s+([^\n]*)", re.IGNORECASE | re.MULTILINE)
_WGS84 = ("104",)
_CORNER = 0.5


class MapInfoTab(Reader):
    """Points of a raster table of MapInfo.

    Longitude and latitude on WGS84, and UTM on WGS84, are understood as CRS; any other must be
    stated.
    """

    name = "mapinfo-tab"
    summary = "MapInfo .tab of a raster: (x,y) (column,row) Label"

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for a table of a raster."""
        return bool(_TITLE.match(head.removeprefix(b"\xef\xbb\xbf")) and _RASTER.search(head))

    def read(self, path: Path) -> FeatureSet:
        """Return the points; errors name file, line and column."""
        text = read_text(path)
        rows = [(number, *found.groups()) for number, line in enumerate(text.splitlines(), 1)
                if (found := _POINT.match(line))]
        if not rows:
            raise TermselError("this table has no points of registration", file=path,
                               hint="Register the raster in MapInfo, or give another file.")
        lines, *columns = zip(*rows, strict=True)
        cells = dict(zip(("x", "y", "sample", "line", "id"), columns, strict=True))
        if None in cells["id"] or len(set(cells["id"])) < len(rows):
            del cells["id"]  # labels are for the eyes alone
        crs = _crs(text)
        table = Table(path, crs, {name: name for name in cells}, cells, lines)
        image = table.stack("line", "sample") - _CORNER
        ground = np.column_stack([table.stack("x", "y"), np.full(len(image), np.nan)])
        return FeatureSet(table.points(image, ground, None, ()), crs=crs)


def _crs(text: str) -> str:
    """Return the CRS of a table where it is longitude and latitude, or UTM, on WGS84; else ""."""
    found = _SYSTEM.search(text)
    if found is None:
        return ""
    parts = [part.strip().strip('"') for part in found[1].split(",")]
    if parts[1:2] != list(_WGS84):
        return ""
    if parts[0] == "1":
        return "EPSG:4326"
    try:
        lon, lat, scale, east, north = (float(part) for part in parts[3:8])
    except ValueError:
        return ""
    zone = round((lon + 183.0) / 6.0)
    if parts[0] != "8" or parts[2] not in ("m", "7") or (lat, scale, east) != (0, 0.9996, 500000) \
            or lon != 6 * zone - 183 or not 1 <= zone <= 60 or north not in (0.0, 1e7):
        return ""
    return f"EPSG:32{7 if north else 6}{zone:02d}"
