"""Marks of Pix4D: where points are in images, and a second file of where they are on the ground.

A line of the marks is ``image,label,column,row[,accuracy]``, of the ground
``label,x,y,z[,accuracy,accuracy]``. Columns and rows are taken from the outer corner of the first
pixel. Geographic coordinates are usually in the order latitude, longitude there.

References
----------
Pix4D, "How to import and export Tie Points (marks)" and "Tie points (GCPs, CPs) import format".
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from termsel import FeatureSet, Option, Reader, Result, TermselError
from termsel.toolkit import read_text, unguard_cell, write_text
from termsel.toolkit.coordinates import is_geographic
from termsel.toolkit.files import (
    IMAGE_NAME,
    Table,
    atomic_path,
    cell_text,
    image_of,
    is_number,
    utf8_bytes,
)
from termsel_formats.points.common import CORNER, file_beside
from termsel_formats.points.written import (
    IMAGE_OPTION,
    PointsWriter,
    image_in_one_cell,
    points_for_others,
    require_points,
    say_checked,
)

_IMAGES = re.compile(r"\.(?:jpe?g|tiff?|png|dng|rjpg|raw)", re.IGNORECASE)
_HEADER = re.compile(r"(image|file|photo)\s*_?(name)?", re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+")
_SNIFFED = 20  # lines that show the format
_LATITUDE = ("lat", "latitude", "y", "northing", "north")
_LATITUDE_FIRST = Option(
    "latitude_first", None, "Whether the second column of the ground file is a latitude, or a "
                            "northing; by default its header says so, and without one it is not.",
    bool)


class Pix4dMarks(Reader):
    """Marks of Pix4D in one image, with the places of the points from a file of their own."""

    name = "pix4d-marks"
    summary = "marks of Pix4D: image,label,x,y; --set ground=FILE has label,x,y,z"
    declared_options: ClassVar[tuple[Option, ...]] = (
        Option("ground", None, "The file with label,x,y,z of the points; by default the one "
                               "named like that of the marks, ending in _gcps.csv."),
        _LATITUDE_FIRST, IMAGE_NAME)

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for lines that begin with the name of an image, a label and two numbers."""
        text = head.decode("utf-8-sig", "replace")
        lines = [line for line in text.splitlines()[:_SNIFFED] if line.strip()]
        # The last line of the beginning of a file may be cut.
        complete = lines[:-1] or lines
        try:
            rows = list(_split_rows(complete))
        except csv.Error:
            return False
        if rows and _HEADER.fullmatch(rows[0][0]) and _is_header(rows[0]):
            rows = rows[1:]
        return bool(rows) and all(map(_is_mark, rows))

    def read(self, path: Path) -> FeatureSet:
        """Return the marks of one image that have ground coordinates in a second file.

        Of several images the option `image_name` chooses one. The second file is that of the option
        `ground`, or else NAME_gcps.csv beside the first. Raises TermselError with the file at
        fault, its line and column.
        """
        marks = _numbered_rows(path, (4, 5), "image,label,x,y")
        stated = self.options["ground"]
        ground_file = _ground_file(path) if stated is None else file_beside(path, stated)
        if stated is None and not ground_file.is_file():
            raise TermselError("the marks have image coordinates only", file=path,
                               hint="Name the file of their ground coordinates, "
                                    "--set ground=FILE.")
        numbered_rows = _numbered_rows(ground_file, (3, 4, 5, 6), "label,x,y,z")
        ground_rows = {row[0]: (number, row) for number, row in numbered_rows}
        if any(row[1] in ground_rows for _, row in marks):
            image = image_of(path, (row[0] for _, row in marks if row[1] in ground_rows),
                             self.options["image_name"], "image_name=NAME")
        else:
            image = None
        used = [(number, row) for number, row in marks if row[0] == image and row[1] in ground_rows]
        if not used:
            raise TermselError(f"no label of these marks is in {ground_file.name}", file=path,
                               hint="Give the file of the same points.")
        lines, cells = zip(*used, strict=True)
        table = Table(path, "", {"id": "label", "sample": "x", "line": "y"}, {
            "id": [unguard_cell(row[1]) for row in cells], "sample": [row[2] for row in cells],
            "line": [row[3] for row in cells]}, lines)
        # A table of its own, so that errors name the file and line of the ground.
        used_ground = [ground_rows[row[1]] for row in cells]
        latitude_first = self.options["latitude_first"]
        if latitude_first is None:
            latitude_first = _names_latitude(ground_file)
        first, second = ("y", "x") if latitude_first else ("x", "y")
        ground = Table(ground_file, "", {axis: axis for axis in "xyz"}, {
            first: [row[1] for _, row in used_ground], second: [row[2] for _, row in used_ground],
            "z": [row[3] if len(row) > 3 else "" for _, row in used_ground]},
            [number for number, _ in used_ground])
        return FeatureSet(table.points(table.stack("line", "sample") - CORNER,
                                       ground.stack("x", "y", "z"), None, ()), crs="")

    def parts(self, path: Path) -> dict[str, dict[str, Any]]:
        """Return the options for each image of the marks; {} if there is only one."""
        images = dict.fromkeys(row[0] for _, row in _numbered_rows(path, (4, 5), "image,label,x,y"))
        return {image: {"image_name": image} for image in images} if len(images) > 1 else {}


def _ground_file(path: Path) -> Path:
    """Return the path of the ground coordinates that belong to a file of marks."""
    return path.with_name(f"{path.stem}_gcps.csv")


def _is_header(cells: list[str]) -> bool:
    """Return whether none of a row's cells after the first is a number, as in a header."""
    return not any(map(is_number, cells[1:]))


def _names_latitude(path: Path) -> bool:
    """Return whether a header of the ground file says that latitudes come first."""
    first = next(_split_rows(read_text(path).splitlines()), [])
    return len(first) > 1 and first[1].lower() in _LATITUDE


def _is_mark(cells: list[str]) -> bool:
    """Return whether cells are a mark: a file of an image, a label, two or three numbers."""
    return (len(cells) in (4, 5) and _IMAGES.fullmatch(Path(cells[0]).suffix) is not None
            and bool(cells[1]) and all(map(is_number, cells[2:])))


def _split_rows(lines: Sequence[str]) -> Iterator[list[str]]:
    """Yield the cells of each line, between tabs, semicolons, commas or spaces.

    The separator is the first of these that the first line has: next to the others a comma is
    decimal, as spreadsheets write it in many countries. Raises csv.Error for a line that the csv
    module cannot split.
    """
    first = next((line for line in lines if line.strip()), "")
    separator = next((mark for mark in "\t;," if mark in first), " ")
    # Several spaces may align a column.
    for row in csv.reader(lines, delimiter=separator, skipinitialspace=separator == " "):
        cells = [cell.strip() for cell in row]
        if separator != ",":
            cells = [cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell
                     for cell in cells]
        yield [cell for cell in cells if cell] if separator == " " else cells


def _numbered_rows(path: Path, widths: tuple[int, ...], form: str) -> list[tuple[int, list[str]]]:
    """Return the number, from 1, and the cells of each row of a table but its header.

    Raises TermselError if there is no row, or if one has a number of cells that is not among
    `widths`; its hint is `form`, which states how a row is written.
    """
    rows: list[tuple[int, list[str]]] = []
    # A header can only be above all rows; further down it would be a row that lacks its numbers.
    try:
        for number, cells in enumerate(_split_rows(read_text(path).splitlines()), 1):
            if not any(cells) or (not rows and _is_header(cells)):
                continue
            if len(cells) not in widths:
                raise TermselError(f"a line has {len(cells)} cells", file=path, line=number,
                                   hint=f"A line is {form}.")
            rows.append((number, cells))
    except csv.Error as error:
        raise TermselError(f"this table cannot be read: {error}", file=path,
                           hint=f"A line is {form}.") from error
    if not rows:
        raise TermselError("this file has no points", file=path, hint=f"A line is {form}.")
    return rows


class Pix4dMarksWriter(PointsWriter):
    """Control points as marks for Pix4D without blunders, and NAME_gcps.csv with their places.

    Independent check points are left out, as the files do not distinguish them from control. Of
    geographic coordinates the latitude comes first there, as Pix4D expects it.
    """

    name = "pix4d-marks"
    summary = "control without blunders as marks for Pix4D, and their coordinates in NAME_gcps.csv"
    suffix = "_marks.csv"
    declared_options: ClassVar[tuple[Option, ...]] = (IMAGE_OPTION,)

    def files(self, path: Path) -> tuple[Path, ...]:
        """Return the files of the marks and of the places on the ground."""
        return path, _ground_file(path)

    def write(self, result: Result, path: Path) -> None:
        """Write the marks of control points and, beside them, the file of their ground coordinates.

        If one file cannot be written, neither is. How many points there are, and which are left
        out, is logged. Raises TermselError if no point can be written.
        """
        self.require(result, path)
        # Nothing in these files distinguishes a check point from control.
        checked = points_for_others(result).without_checks()
        require_points(checked, path, self.needs)
        points = checked.points
        image = cell_text(image_in_one_cell(self.options["image"], path, ",", "commas"))
        # Pix4D expects latitudes before longitudes.
        latitude_first = is_geographic(result.features.crs)
        marks = []
        ground_rows = []
        for name, (line, sample), (x, y, z) in zip(
                map(cell_text, points.ids), points.image.tolist(), points.ground.tolist(),
                strict=True):
            marks.append(f"{image},{name},{sample + CORNER!r},{line + CORNER!r}")
            first, second = (y, x) if latitude_first else (x, y)
            ground_rows.append(f"{name},{first!r},{second!r},{'' if np.isnan(z) else repr(z)}")
        # The first file gets its name once the second has been written.
        with atomic_path(path) as unfinished:
            unfinished.write_bytes(utf8_bytes("\n".join([*marks, ""])))
            write_text(_ground_file(path), "\n".join([*ground_rows, ""]))
        say_checked(self.name, checked)
