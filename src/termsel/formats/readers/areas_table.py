"""Areas as a table of their corners."""

from __future__ import annotations

from itertools import pairwise

from termsel.core.errors import TermselError
from termsel.core.options import Option
from termsel.data.areas import FORMS, Area, CornerError, boundary, centroids
from termsel.data.features import FeatureSet
from termsel.data.tables.attributes import alike
from termsel.data.tables.columns import COORDINATES, CORNER, USE
from termsel.formats.readers.table import Table
from termsel.formats.readers.tables import COLUMNS, TableReader


class AreasCsv(TableReader):
    """Areas by their corners, as the edges or the centroids of polygons."""

    states_origin = False
    name = "areas-csv"
    summary = "areas as a table of corners headed id,corner,line,sample,x,y,z"
    areas = True
    known = USE | COORDINATES | CORNER
    needed = (("corner",),)
    declared_options = (*COLUMNS, Option(
        "areas_as", "boundary", "How areas are used: their edges as lines, all those of an area "
                                "one feature; or their centroids as points.", choices=FORMS))

    def features(self, table: Table) -> FeatureSet:
        """Return the areas as lines or points; errors name file, line and column."""
        rows = _rows_of_areas(table)
        image = table.stack("line", "sample")
        ground = table.stack("x", "y", "z")
        roles = table.roles()
        # Their edges are lines, of which sigma is a measurement.
        more = {key: cells for key, cells in table.more.items() if key.casefold() != "sigma"}
        areas = []
        for name, own in rows.items():
            role = next((roles[row] for row in own if roles[row]), "")
            for row in own:
                if roles[row] not in ("", role):
                    raise table.error(f"area {name!r} has the roles {role!r} and {roles[row]!r}",
                                      row, "role" if "role" in table.names else "enabled",
                                      "Give it one role.")
            try:
                areas.append(Area(name, image[own], ground[own], role, alike(
                    [{key: cells[row] for key, cells in more.items()} for row in own])))
            except CornerError as error:
                raise table.error(error.what, own[error.corner],
                                  "line" if error.where == "image" else "x", error.hint) from error
        try:
            if self.options["areas_as"] == "boundary":
                return FeatureSet(lines=boundary(areas), crs=table.crs)
            return FeatureSet(centroids(areas), crs=table.crs)
        except TermselError as error:
            first = rows[error.ids[0]][0] if error.ids else 0
            raise table.at(error, first) from error


def _rows_of_areas(table: Table) -> dict[str, list[int]]:
    """Return the rows of each area in the order of its corners."""
    rows: dict[str, list[int]] = {}
    for row, name in enumerate(table.ids()):
        rows.setdefault(name, []).append(row)
    number = table.stack("corner")[:, 0]
    for name, own in rows.items():
        own.sort(key=lambda row: float(number[row]))
        for one, other in pairwise(own):
            if number[one] == number[other]:
                raise table.error(f"corner {number[one]:g} of area {name!r} is also on line "
                                  f"{table.lines[one]}", other, "corner",
                                  "Number the corners in order around the area.")
    return rows
