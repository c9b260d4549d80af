"""Ground control points that ERDAS IMAGINE lists or exports as text.

The columns are those of its table of points: Point #, Point ID, X Input, Y Input, X Ref., Y Ref.,
Z Ref., Type. Input coordinates count from the centre of the first pixel; rows may be negative, as
the ordinate of an image without a map points up.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np

from termsel import FeatureSet, Reader, Result, TermselError
from termsel.toolkit import read_data, read_text, write_text
from termsel.toolkit.files import Table, cell_text, chosen_points
from termsel_formats.points.written import PointsWriter, say_points

_COLUMNS = {"point id": "id", "x input": "sample", "y input": "line", "x ref": "x", "y ref": "y",
            "z ref": "z", "type": "role"}
_ROLES = {"control": "control", "check": "check"}
_BINARY = b"EHFA_HEADER_TAG"


class ErdasGcps(Reader):
    """Points of ERDAS IMAGINE as text, separated by tabs, commas or semicolons.

    A .gcc file is binary and refused: IMAGINE exports its points as text.
    """

    name = "erdas-gcps"
    summary = "points of ERDAS IMAGINE as text with X Input, Y Input, X Ref., Y Ref."

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for a table with these columns, or a binary .gcc file."""
        first = head.removeprefix(b"\xef\xbb\xbf").lstrip().split(b"\n", 1)[0].lower()
        return (b"x input" in first and b"x ref" in first) or (
            head.startswith(_BINARY) and path.suffix.lower() == ".gcc")

    def read(self, path: Path) -> FeatureSet:
        """Return the points; the format states no CRS.

        The separator is the most frequent one of the header, whose words are compared without case
        and signs. Lines of which none is above 0 count upwards, and are turned. Raises
        TermselError, with file, line and column, also for a binary file.
        """
        if path.suffix.lower() == ".gcc" and read_data(path).startswith(_BINARY):
            raise TermselError("this .gcc file of ERDAS IMAGINE is binary", file=path,
                               hint="Export the points from IMAGINE's table of points as text.")
        text = read_text(path).lstrip("\n\r ")
        header, *text_rows = text.splitlines() or [""]
        separator = max("\t,;", key=header.count)
        names = [cell.strip() for cell in header.split(separator)]
        column_of = {meaning: i for i, name in enumerate(names)
                     if (meaning := _COLUMNS.get(re.sub(r"[^a-z ]", "", name.lower()).strip()))}
        if not {"sample", "line", "x", "y"} <= set(column_of):
            raise TermselError("this table has no X Input, Y Input, X Ref. and Y Ref.", file=path,
                               line=1, hint="Export these columns too.")
        # Lines count from 1, and the header may stand below blank ones.
        first_line = read_text(path).splitlines().index(header) + 2
        rows = []
        for number, row in enumerate(csv.reader(text_rows, delimiter=separator), first_line):
            if not any(cell.strip() for cell in row):
                continue
            if len(row) <= max(column_of.values()):
                raise TermselError(f"{len(row)} cells, expected {len(names)}", file=path,
                                   line=number, hint="Give every point all its cells.")
            rows.append((number, row))
        if not rows:
            raise TermselError("this table has no points", file=path, hint="Export them again.")
        lines, cells = zip(*rows, strict=True)
        columns = {}
        for meaning, i in column_of.items():
            columns[meaning] = [row[i].strip() for row in cells]
        if "role" in columns:
            columns["role"] = [_ROLES.get(cell.lower(), "") for cell in columns["role"]]
        table = Table(path, "", {meaning: names[i] for meaning, i in column_of.items()}, columns,
                      lines)
        image = table.stack("line", "sample")
        # IMAGINE counts lines upwards where the image has no map coordinates: all are negative
        # then, and are turned back.
        if (image[:, 0] <= 0).all():
            image[:, 0] *= -1
        return FeatureSet(table.points(image, table.stack("x", "y", "z"), None, table.roles()),
                          crs="")


class ErdasGcpsWriter(PointsWriter):
    """The selected control points as text with the columns of ERDAS IMAGINE, separated by tabs.

    Rows are negative, as IMAGINE has those of an image without a map. The CRS is not in the file.
    """

    name = "erdas-gcps"
    summary = "selected control points as text with the columns of ERDAS IMAGINE"
    needs = "control points"
    suffix = "_erdas.txt"

    def accepts(self, result: Result) -> bool:
        """Return True for control points."""
        return bool(len(result.fit.control.points))

    def write(self, result: Result, path: Path) -> None:
        """Write the selected control points as a table with the columns of IMAGINE, between tabs.

        Lines are negative, as IMAGINE has those of an image without a map, and unknown heights are
        blank. Logs that it holds no model. Raises TermselError for a result without control points.
        """
        self.require(result, path)
        points = chosen_points(result)
        rows = ["Point #\tPoint ID\tX Input\tY Input\tX Ref.\tY Ref.\tZ Ref.\tType"]
        for i, (name, (line, sample), (x, y, z), role) in enumerate(zip(
                points.ids, points.image.tolist(), points.ground.tolist(), points.roles,
                strict=True), 1):
            height = "" if np.isnan(z) else repr(z)
            kind = "Check" if role == "check" else "Control"
            rows.append(f"{i}\t{cell_text(name)}\t{sample!r}\t{-line!r}\t{x!r}\t{y!r}\t{height}\t"
                        f"{kind}")
        write_text(path, "\n".join([*rows, ""]))
        say_points(self.name)
