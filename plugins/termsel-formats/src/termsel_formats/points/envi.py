"""Ground control points of ENVI: text files that end in ``.pts``.

From the vendor's page "GCP File Formats": comments begin with a semicolon; the columns depend on
the tool that wrote the file; the upper-left corner of the first pixel is (1, 1); the coordinates
of a subset include its offset in the whole image.
"""

from __future__ import annotations

import re
from itertools import takewhile
from pathlib import Path

import numpy as np

from termsel import FeatureSet, Option, Reader, TermselError
from termsel.toolkit import read_text
from termsel.toolkit.files import Table, image_of
from termsel_formats.points.common import utm_crs

_COLUMNS_BY_NUMBER = {
    4: ("x", "y", "sample", "line"),
    5: ("x", "y", "z", "sample", "line"),
    6: ("image", "x", "y", "z", "sample", "line"),
    7: ("sample", "line", "other sample", "other line", "x", "y", "z"),
}
"""By their number: of a map, of RPCs and exterior orientation, of rigorous orthorectification with
several images, of a stereo pair."""

# Short patterns one after another: in one pattern they take the square of a line's length.
_ENVI = re.compile(r"\bENVI\b", re.IGNORECASE)
_KIND = re.compile(r"\b(GCP|Ground Control|Points)\b", re.IGNORECASE)
_IMAGE_COLUMNS = re.compile(r"\bImage\s*\(x", re.IGNORECASE)
_PROJECTION = re.compile(r";\s*projection info\s*=\s*\{", re.IGNORECASE)
# ENVI calls the upper-left corner of the first pixel (1, 1), and so its centre (1.5, 1.5).
_CENTRE = 1.5


class EnviPoints(Reader):
    """Points of ENVI: to a map, of RPCs, of rigorous orthorectification or a stereo pair.

    UTM on WGS84, and longitude and latitude on WGS84, are understood as CRS; any other must be
    stated. The left image of a stereo pair is read.
    """

    name = "envi-pts"
    summary = "ENVI .pts: comments that begin with ; ENVI, then map and image coordinates"
    declared_options = (
        Option("image_number", None, "Number of the image, for files with several images.", int, 0,
               1_000_000),
    )

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True if the file begins with a comment of ENVI."""
        text = head.decode("utf-8-sig", errors="replace")
        lines = [line.strip() for line in text.split("\n")[:-1] if line.strip()]
        comments = takewhile(lambda line: line.startswith(";"), lines)
        return any(map(_is_title, comments))

    def read(self, path: Path) -> FeatureSet:
        """Return the points; of a file for several images those of the option `image_number`.

        Heights are NaN where the file has none. Errors name file, line and column.
        """
        rows, lines, crs = _read_rows(path)
        width = len(rows[0])
        names = _COLUMNS_BY_NUMBER[width]
        table = Table(path, crs, {name: name for name in names},
                      dict(zip(names, zip(*rows, strict=True), strict=True)), lines)
        if "image" in table.columns:
            numbers = table.stack("image")[:, 0].tolist()
            image_number = image_of(path, numbers, self.options["image_number"], "image_number=N")
            table = table.take([row for row, n in enumerate(numbers) if n == image_number])
        image = table.stack("line", "sample") - _CENTRE
        ground = (table.stack("x", "y", "z") if "z" in table.columns else
                  np.column_stack([table.stack("x", "y"), np.full(len(image), np.nan)]))
        return FeatureSet(table.points(image, ground, None, ()), crs=crs)


def _is_title(comment: str) -> bool:
    """Return whether a comment is the title, or the heading of columns, of a file of ENVI points.
    """
    envi = _ENVI.search(comment)
    return bool(envi and _KIND.search(comment, envi.end())) or bool(_IMAGE_COLUMNS.search(comment))


def _read_rows(path: Path) -> tuple[list[list[str]], list[int], str]:
    """Return the cells of each row, the numbers of their lines, and the CRS, "" if none is known.

    Raises TermselError if there is no row, if a row has another number of cells than the first, or
    a number that no kind of file has, and for points that relate two images.
    """
    rows: list[list[str]] = []
    lines: list[int] = []
    crs = ""
    # Comments say what the points relate, and state the projection.
    for number, text in enumerate(read_text(path).splitlines(), 1):
        if re.match(r"\s*;", text):
            if re.search(r"image to image|base\s+image", text, re.IGNORECASE):
                raise TermselError("these points relate two images and have no ground "
                                   "coordinates", file=path, line=number,
                                   hint="Give points of the type image to map.")
            projection = _PROJECTION.search(text)
            if projection and (end := text.rfind("}", projection.end())) >= 0:
                crs = _crs_of_projection(text[projection.end():end])
        elif text.strip():
            rows.append(text.split())
            lines.append(number)
    if not rows:
        raise TermselError("the file has no points", file=path,
                           hint="Add one row per point below the comments.")
    for row, number in zip(rows, lines, strict=True):
        if len(row) not in _COLUMNS_BY_NUMBER or len(row) != len(rows[0]):
            raise TermselError(
                f"the row has {len(row)} numbers, expected "
                + (f"{len(rows[0])} as in the first" if len(rows[0]) in _COLUMNS_BY_NUMBER else
                   f"one of {', '.join(map(str, _COLUMNS_BY_NUMBER))}"), file=path, line=number,
                hint="Decimal commas are not supported." if "," in "".join(row) else None)
    return rows, lines, crs


def _crs_of_projection(projection: str) -> str:
    """Return the CRS that ENVI describes; "" unless it is degrees or UTM on WGS84."""
    items = [item.strip().lower() for item in projection.split(",")]
    if "wgs-84" not in items:
        return ""
    if items[0].startswith("geographic"):
        return "EPSG:4326"
    match = re.search(r"^utm,\s*(\d{1,2}),\s*(north|south)", projection.strip(), re.IGNORECASE)
    return "" if match is None else utm_crs(int(match[1]), match[2].lower() == "south")
