"""Tables of links of ArcGIS: places in an image and on the ground, without a header.

A row is ``X Source, Y Source, X Map, Y Map``, between tabs, blanks or commas; ArcGIS Pro and
Allmaps may begin it with a number, and end it with residuals. The ordinate of an image without a
map points up, so that its y is 0 at the upper edge and negative below.

References
----------
Esri, "Fundamentals of georeferencing a raster dataset", on saving links as a text file; Allmaps,
formats arcgis-csv and arcgis-tsv of its package io.
"""

from __future__ import annotations

import logging
import re
from itertools import chain
from pathlib import Path

import numpy as np

from termsel import FeatureSet, Reader, TermselError
from termsel.toolkit import read_text
from termsel.toolkit.files import LARGEST_IMAGE, Table, is_number
from termsel_formats.points.common import CORNER

log = logging.getLogger("termsel.formats")

_LINKS_HEADINGS = {"sample": "X Source", "line": "Y Source", "x": "X Map", "y": "Y Map"}
_WIDTHS = (4, 5, 7, 8)  # without and with a number, without and with three residuals
_SMALLEST = 360.0  # above this, numbers are no degrees
_LINKS_HINT = "A row is X Source, Y Source, X Map, Y Map; y counts upwards from the upper edge."


class ArcgisLinks(Reader):
    """Links of ArcGIS, with y upwards from the upper edge of the image."""

    name = "arcgis-links"
    summary = "links of ArcGIS, also of Allmaps: x y X Y without a header, y negative downwards"

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for rows of numbers of which the second is negative, or that a title names.

        Elsewhere the numbers do not show which are of the image.
        """
        text = head.decode("utf-8-sig", "replace")
        complete = text.rpartition("\n")[0] if len(head) > 60000 else text
        rows = [cells for _, cells in _numbered_rows(complete)]
        if rows and not all(map(is_number, rows[0])):
            # A title says nothing of columns; a header of another order says that it is no link's.
            if not _may_head_links(complete):
                return False
            rows = rows[1:]
        if len(rows) < 2 or len({len(cells) for cells in rows}) > 1 or len(rows[0]) not in _WIDTHS:
            return False
        if not all(map(is_number, chain.from_iterable(rows))):
            return False
        table = np.array(rows, dtype=np.float64)
        if not np.isfinite(table).all():
            return False
        first = _column_of_x(len(rows[0]))
        # A first column that does not count is a coordinate, and the file another one.
        if first and not np.array_equal(table[:, 0], np.arange(len(table)) + table[0, 0]):
            return False
        column = table[:, first]
        row = table[:, first + 1]
        size = max(np.abs(column).max(), np.abs(row).max())
        return bool((row <= 0.0).all() and (column >= 0.0).all() and (row < 0.0).any()
                    and _SMALLEST < size < LARGEST_IMAGE)

    def read(self, path: Path) -> FeatureSet:
        """Return the points; errors name file, line and column.

        A file of links has no header, and four numbers in a row, or five with a number first,
        sometimes residuals after them. Lines count upwards in ArcGIS and from the corner of the
        upper-left pixel. As nothing says so in the file, the first link is shown as it is read.
        Errors name file and line.
        """
        rows = _numbered_rows(read_text(path))
        if rows and not all(map(is_number, rows[0][1])):
            rows = rows[1:]
        if not rows:
            raise TermselError("this file has no links", file=path, hint=_LINKS_HINT)
        width = len(rows[0][1])
        for number, cells in rows:
            if len(cells) != width or width not in _WIDTHS:
                expected = width if width in _WIDTHS else _WIDTHS[0]
                raise TermselError(f"{len(cells)} cells, expected {expected}", file=path,
                                   line=number, hint=_LINKS_HINT)
        lines, cells_of_rows = zip(*rows, strict=True)
        first = _column_of_x(width)
        columns = {}
        for i, meaning in enumerate(_LINKS_HEADINGS):
            columns[meaning] = [cells[first + i] for cells in cells_of_rows]
        names = dict(_LINKS_HEADINGS)
        if first:
            columns["id"] = [cells[0] for cells in cells_of_rows]
            names["id"] = "number"
        table = Table(path, "", names, columns, lines)
        image = table.stack("line", "sample") * [-1.0, 1.0] - CORNER
        # No header says so: the signs of the second column show.
        log.info("Note: %s is read as links of ArcGIS, X Source, Y Source, X Map, Y Map, whose Y "
                 "Source counts upwards; the first is at sample %.6g, line %.6g, x %s, y %s.",
                 path, image[0, 1], image[0, 0], columns["x"][0], columns["y"][0])
        return FeatureSet(table.points(image, table.stack("x", "y", "z"), None, ()), crs="")


def _may_head_links(text: str) -> bool:
    """Return whether the first line of a text is a title, or names the places in the image first.
    """
    lines = [line for line in text.splitlines() if line.strip() and line.lstrip()[0] != "#"]
    separator = next((mark for mark in "\t;," if mark in lines[0]), None)
    names = [name.strip(' "').casefold() for name in lines[0].split(separator)]
    cells = lines[1].split(separator) if len(lines) > 1 else []
    return len(names) != len(cells) or any("source" in name for name in names[:2])


def _column_of_x(width: int) -> int:
    """Return the number of the column of X Source: 1 after the number of a link, else 0."""
    return 1 if width in (5, 8) else 0


def _numbered_rows(text: str) -> list[tuple[int, list[str]]]:
    """Return number and cells of the lines that are neither blank nor comments.

    Decimal commas become points.
    """
    # Next to tabs or semicolons, commas are decimal, as ArcGIS writes them in many countries.
    if re.search(r"[\t;]", text) and "." not in text:
        text = text.replace(",", ".")
    rows = []
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            cells = re.split(r"[\s,;]+", line.strip())
            rows.append((number, [cell for cell in cells if cell]))
    return rows
