"""Files of ground control points of GRASS GIS: POINTS and CONTROL_POINTS of an imagery group.

A line is east and north in the image, east and north on the ground, and 1 where the point is used,
0 where it is not; in CONTROL_POINTS a height follows each pair. North in the image counts upwards
from the lower edge of its last row, so that the height of the image must be known.

References
----------
GRASS GIS, manual of `i.rectify`, `g.gui.gcp` and `i.ortho.photo`, and the files that these write.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from termsel import FeatureSet, Reader, TermselError
from termsel.toolkit import read_text
from termsel.toolkit.files import Table, is_number

_GRASS_TITLE = b"Ground Control Points File"
# Its library writes no title, and this above the points of i.points and i.rectify.
_GRASS_HEADING = re.compile(r"^#\s*(?:image|source)\s+target\s+status\s*$", re.MULTILINE)
_PLANE = ("source east", "source north", "east", "north", "status")
_SPATIAL = ("source east", "source north", "source height", "east", "north", "height", "status")
_GRASS_HEADINGS = {"sample": "source east", "line": "source north", "x": "east", "y": "north",
                   "z": "height", "enabled": "status"}
_GRASS_HINT = f"A line is {', '.join(_PLANE)}."


class GrassPoints(Reader):
    """Points of GRASS GIS; those whose status is 0 have the role "off".

    The image is required, because rows count from its lower edge: ``--image FILE``.
    """

    name = "grass-points"
    summary = "POINTS and CONTROL_POINTS of GRASS GIS: east north east north status"
    states_origin = False
    default_origin = "bottom-left-corner"

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for a file with the title of GRASS, or its name or heading, and its rows."""
        if head.lstrip(b"\xef\xbb\xbf \t\r\n#").startswith(_GRASS_TITLE):
            return True
        text = head.decode("utf-8-sig", "replace")
        rows = _numbered_rows(text.rpartition("\n")[0])
        is_called_so = (path.name in ("POINTS", "CONTROL_POINTS")
                        or _GRASS_HEADING.search(text) is not None)
        return is_called_so and bool(rows) and all(
            len(cells) in (5, 7) and all(map(is_number, cells)) and cells[-1] in ("0", "1")
            for _, cells in rows)

    def read(self, path: Path) -> FeatureSet:
        """Return the points, whose lines count upwards from the lower edge of the image.

        `default_origin` tells the caller, who has the image, to turn them. The format states no
        CRS. Errors name file, line and column.
        """
        rows = _numbered_rows(read_text(path))
        if not rows:
            raise TermselError("this file has no points", file=path, hint=_GRASS_HINT)
        width = len(rows[0][1])
        names = _SPATIAL if width == len(_SPATIAL) else _PLANE
        for number, cells in rows:
            if len(cells) != len(names):
                raise TermselError(f"{len(cells)} cells, expected {len(names)}", file=path,
                                   line=number, hint=_GRASS_HINT)
        lines, cells_of_rows = zip(*rows, strict=True)
        cells_of = dict(zip(names, zip(*cells_of_rows, strict=True), strict=True))
        columns = {meaning: cells_of[name] for meaning, name in _GRASS_HEADINGS.items()
                   if name in cells_of}
        table = Table(path, "", _GRASS_HEADINGS, columns, lines)
        ground = table.stack("x", "y", "z")
        # GRASS writes 0 for heights that are not known.
        if not np.nan_to_num(ground[:, 2]).any():
            ground[:, 2] = np.nan
        return FeatureSet(table.points(table.stack("line", "sample"), ground, None,
                                       table.roles()), crs="")


def _numbered_rows(text: str) -> list[tuple[int, list[str]]]:
    """Return the number, from 1, and the cells of each line that is neither blank nor a comment."""
    return [(number, re.split(r"\s+", line.strip()))
            for number, line in enumerate(text.splitlines(), 1)
            if line.strip() and not line.lstrip().startswith("#")]
