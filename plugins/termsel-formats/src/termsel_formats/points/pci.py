"""Text files of ground control points of PCI Geomatica and CATALYST (.gcp).

A line is a point, with fields by a layout such as "ID P L X Y Z S": identifier, pixel and line in
the image, place on the ground, and status (G ground control, C check point, I inactive). Pixels and
lines are taken as GDAL takes those of PCI's segments, from the outer corner of the first pixel.

References
----------
CATALYST Professional, "Understanding formats for text files containing GCPs"; "GCPWRIT".
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import ClassVar

import numpy as np

from termsel import FeatureSet, Option, Reader, Result, TermselError
from termsel.toolkit import read_text, write_text
from termsel.toolkit.files import LARGEST_IMAGE, Table, chosen_points, guard_cell
from termsel_formats.points.common import CORNER
from termsel_formats.points.written import PointsWriter, say_points

_FIELD = re.compile(r'"([^"]*)"|([^\s,]+)')
# Degrees, minutes and seconds as GCPWRIT writes them with DMSFORM, such as 48d30'15.5"N.
_DMS = re.compile(r"""\d{1,3}d\d{1,2}'\d{1,2}(\.\d*)?"[NSEW]""")
_TOKEN = re.compile(r"ID|I|e[PLXYZ]|[PLXYZES]")
_MEANING = {"ID": "id", "I": "id", "P": "sample", "L": "line", "X": "x", "Y": "y", "Z": "z",
            "E": "z", "eP": "sigma_sample", "eL": "sigma_line", "S": "role"}
_ROLES = {"G": "control", "C": "check", "I": "off"}
_USUAL_COLUMNS = {5: "ID P L X Y", 6: "ID P L X Y Z"}
_COMMENT = ("#", ";", "!")


class PciGcp(Reader):
    """Ground control points of PCI: one line a point, with fields by `layout`."""

    name = "pci-gcp"
    summary = "text of GCPs of PCI and CATALYST (.gcp): ID P L X Y [Z] [S]; --set layout=..."
    declared_options: ClassVar[tuple[Option, ...]] = (
        Option("layout", "", "Fields of a line, such as IDPLXYZ or IXYZPL; by default ID, P, L, X, "
                             "Y, then Z and S if present."),)

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for lines of an id and four or five numbers in a file that ends in .gcp."""
        # Rows of an id and numbers are in many files, so that the ending must be PCI's.
        if path.suffix.lower() != ".gcp":
            return False
        # The last line of the head may be cut.
        complete_lines = head.decode("utf-8", "replace").rpartition("\n")[0]
        rows = [row for _, row in _numbered_rows(complete_lines)]
        return bool(rows) and all(
            len(row) - (len(row[-1]) == 1 and row[-1].isalpha()) in _USUAL_COLUMNS
            and _are_numbers(row[1:5])
            for row in rows)

    def read(self, path: Path) -> FeatureSet:
        """Return the points; the format states no CRS.

        The option `layout` names the fields, or else their number in the first row shows them. The
        status G, C or I is the role control, check or off. Raises TermselError, with file, line and
        column, also if the fields that are taken as pixel and line are beyond any image.
        """
        rows = _numbered_rows(read_text(path))
        if not rows:
            raise TermselError("this file has no points", file=path,
                               hint="A line is ID P L X Y Z.")
        # The first row decides what fields there are; all others must have them.
        fields = self._field_names(path, rows[0][1])
        for number, row in rows:
            if len(row) != len(fields):
                raise TermselError(f"{len(row)} fields, expected {len(fields)}: "
                                   f"{' '.join(fields)}", file=path, line=number,
                                   hint="Correct the line, or name the fields with "
                                        "--set layout=IDPLXYZ.")
        lines, cells = zip(*rows, strict=True)
        columns = {}
        for i, field in enumerate(fields):
            if field in _MEANING:
                columns[_MEANING[field]] = [row[i] for row in cells]
        if "role" in columns:
            for number, status in zip(lines, columns["role"], strict=True):
                if status not in _ROLES:
                    raise TermselError(f"{status!r:.20} is no status", file=path, line=number,
                                       hint="Write G for control, C for a check point, or I for a "
                                            "point that is out of use.")
            columns["role"] = [_ROLES[status] for status in columns["role"]]
        table = Table(path, "", {name: name for name in columns}, columns, lines)
        # PCI counts from the corner of the first pixel.
        image = table.stack("line", "sample") - CORNER
        if not self.options["layout"] and np.abs(image).max() > LARGEST_IMAGE:
            raise TermselError(f"the fields are taken as {' '.join(fields)}, and pixel and line "
                               f"{image[0, 1]:.10g}, {image[0, 0]:.10g} are in no image",
                               file=path, line=lines[0],
                               hint="Name the fields in their order, such as --set "
                                    "layout=IDXYZPL.")
        if {"sigma_line", "sigma_sample"} <= set(columns):
            sigma = table.sigma("sigma_line", "sigma_sample")
        else:
            sigma = None
        return FeatureSet(table.points(image, table.stack("x", "y", "z"), sigma, table.roles()),
                          crs="")

    def _field_names(self, path: Path, first: list[str]) -> list[str]:
        """Return the names of the fields, by the option `layout` or by the number of the first row.

        Raises TermselError for a layout that PCI does not have, and for a number of fields that has
        no usual layout.
        """
        layout = re.sub(r"[\s,]", "", str(self.options["layout"]))
        if not layout:
            # A status of a letter ends the row, if there is one.
            status = first[-1] in _ROLES
            usual = _USUAL_COLUMNS.get(len(first) - status)
            if usual is None:
                raise TermselError(f"a line has {len(first)} fields", file=path,
                                   hint="Name them with --set layout=IDPLXYZ.")
            return usual.split() + ["S"] * status
        # Names of fields may follow one another without a space, as in IDPLXYZ.
        fields = _TOKEN.findall(layout)
        meanings = [_MEANING[field] for field in fields if field in _MEANING]
        has_other_characters = "".join(fields) != layout
        names_field_twice = len(set(meanings)) < len(meanings)
        lacks_position = not {"sample", "line", "x", "y"} <= set(meanings)
        if has_other_characters or names_field_twice or lacks_position:
            raise TermselError(f"the layout {layout!r:.40} is none of PCI",
                               hint="It consists of ID, P, L, X, Y, Z, eP, eL, eX, eY, eZ and S; "
                                    "P, L, X and Y are required.")
        return fields


def _numbered_rows(text: str) -> list[tuple[int, list[str]]]:
    """Return the number, from 1, and the fields of each line that is neither blank nor a comment.
    """
    rows = []
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.lstrip().startswith(_COMMENT):
            rows.append((number, [quoted or bare for quoted, bare in _FIELD.findall(line)]))
    return rows


def _are_numbers(cells: list[str]) -> bool:
    """Return whether all cells are finite numbers or degrees, minutes and seconds."""
    try:
        return bool(np.isfinite([float(cell) for cell in cells if not _DMS.fullmatch(cell)]).all())
    except ValueError:
        return False


class PciGcpWriter(PointsWriter):
    """The selected control points as text for PCI and CATALYST, with the layout ID P L X Y [Z] S.

    The file does not name the CRS; state it when you read the file there.
    """

    name = "pci-gcp"
    summary = "selected control points as text for PCI and CATALYST: ID P L X Y [Z] S"
    needs = "control points"
    suffix = ".gcp"

    def accepts(self, result: Result) -> bool:
        """Return True for control points."""
        return bool(len(result.fit.control.points))

    def write(self, result: Result, path: Path) -> None:
        """Write a line for each of the selected control points, without a header.

        It has id, pixel, line, x, y, z unless a height is unknown, and status. Logs that it holds
        no model. Raises TermselError
        for a result without control points.
        """
        self.require(result, path)
        points = chosen_points(result)
        # All rows have the same fields: one unknown height leaves out all.
        heights = not np.isnan(points.ground[:, 2]).any()
        status = {role: letter for letter, role in _ROLES.items()}
        rows = []
        for name, (line, sample), position, role in zip(
                points.ids, points.image.tolist(), points.ground.tolist(), points.roles,
                strict=True):
            numbers = (sample + CORNER, line + CORNER, *position[:3 if heights else 2])
            rows.append(" ".join([_quote(name), *map(repr, numbers), status.get(role, "G")]))
        write_text(path, "\n".join([*rows, ""]))
        say_points(self.name)


def _quote(name: str) -> str:
    """Return a name in quotes if it would otherwise be no single field."""
    name = guard_cell(name.replace('"', "'"))
    if _FIELD.findall(name) != [("", name)] or name.startswith(_COMMENT):
        return f'"{name}"'
    return name
