"""Areas as a table of their corners."""

from __future__ import annotations

from itertools import pairwise

from termsel.core.errors import TermselError
from termsel.core.options import Option
from termsel.data.areas import FORMS, Area, CornerError, boundary_lines, centroid_points
from termsel.data.features import FeatureSet
from termsel.data.tables.columns import COORDINATES, CORNER, USE
from termsel.data.tables.tabular import common_attributes
from termsel.formats.readers.tables import COLUMNS, Table, TableReader


class AreasCsv(TableReader):
    """Areas by their corners, as the edges or the centroids of polygons."""

    states_origin = False
    name = "areas-csv"
    summary = "areas as a table of corners headed id,corner,line,sample,x,y,z"
    areas = True
    aliases = USE | COORDINATES | CORNER
    required = (("corner",),)
    declared_options = (*COLUMNS, Option(
        "areas_as", "boundary", "How areas are used: their edges as lines, all those of an area "
                                "one feature; or their centroids as points.", choices=FORMS))

    def features(self, table: Table) -> FeatureSet:
        """Return the areas as lines or points; errors name file, line and column.

        The rows of one area are its corners in their order. An area becomes its centroid, measured
        once, or the lines of its boundary, by the option `areas_as`. Raises TermselError for an
        area with two roles, and for what `Area` and its points or lines refuse.
        """
        rows = _rows_of_areas(table)
        image = table.stack("line", "sample")
        ground = table.stack("x", "y", "z")
        roles = table.roles()
        # A column of that name would be read as a deviation where the lines are written.
        attributes = {key: cells for key, cells in table.attributes.items()
                      if key.casefold() != "sigma"}
        areas = []
        for name, corners in rows.items():
            # One corner with a role gives it to the area.
            role = next((roles[row] for row in corners if roles[row]), "")
            for row in corners:
                if roles[row] not in ("", role):
                    raise table.error(f"area {name!r} has the roles {role!r} and {roles[row]!r}",
                                      row, "role" if "role" in table.names else "enabled",
                                      "Give it one role.")
            described = [{key: cells[row] for key, cells in attributes.items()} for row in corners]
            try:
                areas.append(
                    Area(name, image[corners], ground[corners], role, common_attributes(described)))
            # The error has the number of a corner, which is a row of the file.
            except CornerError as error:
                raise table.error(error.what, corners[error.corner],
                                  "line" if error.where == "image" else "x", error.hint) from error
        try:
            if self.options["areas_as"] == "boundary":
                return FeatureSet(lines=boundary_lines(areas), crs=table.crs)
            return FeatureSet(centroid_points(areas), crs=table.crs)
        except TermselError as error:
            # Errors of several areas name one of them by its id.
            first = rows[error.ids[0]][0] if error.ids else 0
            raise table.at(error, first) from error


def _rows_of_areas(table: Table) -> dict[str, list[int]]:
    """Return the rows of each area, by its id, in the order of its corners.

    Its corners need not be next to each other in the file. Raises TermselError where an area has
    two corners of one number.
    """
    rows: dict[str, list[int]] = {}
    for row, name in enumerate(table.ids()):
        rows.setdefault(name, []).append(row)
    number = table.stack("corner")[:, 0]
    for name, corners in rows.items():
        corners.sort(key=lambda row: float(number[row]))
        # Two corners of one number could be joined in either order.
        for first, second in pairwise(corners):
            if number[first] == number[second]:
                raise table.error(f"corner {number[first]:g} of area {name!r} is also on line "
                                  f"{table.lines[first]}", second, "corner",
                                  "Number the corners in order around the area.")
    return rows
