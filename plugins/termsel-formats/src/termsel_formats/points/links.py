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
# Cells of a row: four, one more with a number, three more with residuals.
_WIDTHS = (4, 5, 7, 8)
# Numbers that are larger are no degrees.
_MOST_DEGREES = 360.0
_LINKS_HINT = "A row is X Source, Y Source, X Map, Y Map; y counts upwards from the upper edge."


class ArcgisLinks(Reader):
    """Links of ArcGIS, with y upwards from the upper edge of the image."""

    name = "arcgis-links"
    summary = "links of ArcGIS, also of Allmaps: x y X Y without a header, y negative downwards"

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for rows of numbers whose signs and sizes are those of links.

        X Source is never negative, Y Source never positive, and the largest of them is beyond what
        degrees can be and within the size of an image. Other rows of numbers do not show which of
        them are in the image.
        """
        text = head.decode("utf-8-sig", "replace")
        complete = text.rpartition("\n")[0] if len(head) > 60000 else text
        rows = [cells for _, cells in _numbered_rows(complete)]
        # The first row may be a title or a header.
        if rows and not all(map(is_number, rows[0])):
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
        # A first column that does not number the rows has coordinates, as no file of links has.
        if first and not np.array_equal(table[:, 0], np.arange(len(table)) + table[0, 0]):
            return False
        column = table[:, first]
        row = table[:, first + 1]
        size = max(np.abs(column).max(), np.abs(row).max())
        return bool((row <= 0.0).all() and (column >= 0.0).all() and (row < 0.0).any()
                    and _MOST_DEGREES < size < LARGEST_IMAGE)

    def read(self, path: Path) -> FeatureSet:
        """Return the points; the format states no CRS.

        A first row that is not of numbers is left out. A note shows how the first link was read, as
        nothing in the file states the order of its numbers. Errors name file, line and column.
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
        # Y Source counts upwards from the outer corner of the first pixel.
        image = table.stack("line", "sample") * [-1.0, 1.0] - CORNER
        log.info("Note: %s is read as links of ArcGIS, X Source, Y Source, X Map, Y Map, whose Y "
                 "Source counts upwards; the first is at sample %.6g, line %.6g, x %s, y %s.",
                 path, image[0, 1], image[0, 0], columns["x"][0], columns["y"][0])
        return FeatureSet(table.points(image, table.stack("x", "y", "z"), None, ()), crs="")


def _may_head_links(text: str) -> bool:
    """Return whether the first line of a text may stand above links.

    It may if it is a title, which has another number of cells than the line below it, or if it is a
    header that calls one of its first two columns a source.
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
    """Return the number, from 1, and the cells of each line that is neither blank nor a comment.

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
