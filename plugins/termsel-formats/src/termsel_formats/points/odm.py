"""OpenDroneMap's list of ground control points, ``gcp_list.txt``.

The first line is the CRS: "EPSG:32633", "WGS84 UTM 16N" or a string of PROJ. Each other line is a
mark of a point in an image: ``geo_x geo_y geo_z im_x im_y image_name [gcp_name] [more]``, separated
by blanks or tabs; geo_z may be NaN. People also separate them by commas or semicolons, write
decimal commas, and leave the first line out. Marks count from the centre of the first pixel, as
OpenSfM, to which OpenDroneMap hands them, adds half a pixel to them.

References
----------
OpenDroneMap documentation, "Ground Control Points", section "File format"; OpenSfM,
``features.normalized_image_coordinates``.
"""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import Any, ClassVar
from warnings import catch_warnings, simplefilter

from termsel import FeatureSet, Option, Reader, Result, TermselError
from termsel.toolkit import ONCE, read_text, require_import, write_text
from termsel.toolkit.coordinates import begins_as_crs, horizontal_crs, is_crs, normalise
from termsel.toolkit.files import (
    IMAGE_NAME,
    LARGEST_IMAGE,
    Table,
    error_in_file,
    image_of,
    is_number,
)
from termsel.toolkit.runs import GIS
from termsel_formats.points.written import (
    IMAGE_OPTION,
    PointsWriter,
    image_in_one_cell,
    points_for_others,
    require_points,
    say_checked,
)

log = logging.getLogger("termsel.formats")

_ODM_COLUMNS = ("geo_x", "geo_y", "geo_z", "im_x", "im_y", "image_name", "gcp_name")
_ODM_HEADINGS = {"x": "geo_x", "y": "geo_y", "z": "geo_z", "sample": "im_x", "line": "im_y"}
_IMAGES = frozenset((".jpg", ".jpeg", ".tif", ".tiff", ".png", ".dng"))
_CODE = re.compile(r"\d{4,5}")
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+")
# Marks that are tested to recognise a list without its first line.
_SNIFFED = 20
_CHECK = "CHK-"
"""Beginning of the names of check points. Versions of OpenDroneMap that know it keep them out of
the adjustment; others take them as control (github.com/WebODM/WebODM/issues/1824)."""
_ODM_HINT = f"The first line is the CRS, the others are {' '.join(_ODM_COLUMNS[:6])} [gcp_name]."


class OdmGcpList(Reader):
    """Marks of one image in a list of OpenDroneMap, whose first line is the CRS."""

    name = "odm-gcp-list"
    summary = "gcp_list.txt of OpenDroneMap: CRS, then x y z col row image [name]"
    declared_options: ClassVar[tuple[Option, ...]] = (IMAGE_NAME,)

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for a CRS and rows of five numbers and the name of an image."""
        rows = _numbered_lines(head.decode("utf-8-sig", errors="replace"))
        # The head may end within a row, so that only the first row of a mark is looked at.
        first_mark = next(
            (i for i, (_, text) in enumerate(rows) if _is_mark(_split_cells(text))), 0)
        return (_crs_row(rows[:first_mark]) is not None or _has_unknown_crs(rows)
                or _lacks_crs(rows))

    def read(self, path: Path) -> FeatureSet:
        """Return the points of one image; of several, the option `image_name` chooses one.

        The first line is the CRS, without which the CRS is unknown, and a note shows how the first
        mark is read. Names are optional, and points whose names begin as those of check points are
        independent. Errors name file, line and column.
        """
        crs, marks = _read_marks(path)
        image = image_of(path, (cells[5] for _, cells in marks), self.options["image_name"],
                         "image_name=NAME")
        image_marks = [(number, cells) for number, cells in marks if cells[5] == image]
        lines, rows = zip(*image_marks, strict=True)
        columns = {}
        for meaning, name in _ODM_HEADINGS.items():
            columns[meaning] = [
                _blank_unknown_height(cells[_ODM_COLUMNS.index(name)]) for cells in rows]
        names = dict(_ODM_HEADINGS)
        # Names are optional; where one row lacks its name, all are numbered.
        if all(len(cells) > 6 for cells in rows):
            columns["id"] = [cells[6] for cells in rows]
            names["id"] = "gcp_name"
        table = Table(path, crs, names, columns, lines)
        roles = ["independent" if name.startswith(_CHECK) else "" for name in columns.get("id", ())]
        return FeatureSet(table.points(table.stack("line", "sample"), table.stack("x", "y", "z"),
                                       None, roles), crs=crs)

    def parts(self, path: Path) -> dict[str, dict[str, Any]]:
        """Return the options for each image of the list; {} if there is only one."""
        images = dict.fromkeys(cells[5] for _, cells in _read_marks(path)[1])
        return {image: {"image_name": image} for image in images} if len(images) > 1 else {}


def _read_marks(path: Path) -> tuple[str, list[tuple[int, list[str]]]]:
    """Return the CRS of a list, and the number and cells of each line of a mark.

    The CRS is "" for a list without it; a note says then how its first mark is read. Raises
    TermselError without marks, and for a line that is none.
    """
    rows = _numbered_lines(read_text(path))
    if not rows:
        raise TermselError("the file is empty", file=path, hint=_ODM_HINT)
    if _lacks_crs(rows):
        marks = _marks_of(path, rows)
        _say_first_mark(path, marks[0][1])
        return "", marks
    # Without a statement that is understood, the first line is the one to name in the error.
    i = _crs_row(rows) or 0
    return _crs_of_line(path, rows, i), _marks_of(path, rows[i + 1:])


def _crs_of_line(path: Path, rows: list[tuple[int, str]], i: int) -> str:
    """Return the CRS that line `i` states; "", with a note, for a statement that is none.

    Raises TermselError for a line that is no statement either.
    """
    number, first = rows[i]
    try:
        return normalise(first.removeprefix("#").strip())
    except TermselError as error:
        if not _has_unknown_crs(rows):
            raise error_in_file(error, path, number) from error
        log.warning("Note: %s, line %d: '%s' is no CRS that is known, so --crs EPSG:CODE must "
                    "state it.", path, number, first)
        return ""


def _marks_of(path: Path, rows: list[tuple[int, str]]) -> list[tuple[int, list[str]]]:
    """Return number and cells of each line of a mark, of the lines below the CRS.

    Raises TermselError without marks, and for a line that is none.
    """
    marks: list[tuple[int, list[str]]] = []
    for number, text in rows:
        cells = _split_cells(text)
        # The names of the columns may stand above the marks.
        if text.startswith("#") or not (marks or any(map(is_number, cells))):
            continue
        if not _is_mark(cells):
            raise TermselError("this line is no mark of a point in an image", file=path,
                               line=number, hint=_ODM_HINT)
        marks.append((number, cells))
    if not marks:
        raise TermselError("the file has no points", file=path, hint=_ODM_HINT)
    return marks


def _say_first_mark(path: Path, cells: list[str]) -> None:
    """Say how the first mark of a list without its CRS is read: nothing else shows what it is."""
    x, y, _, sample, line = cells[:5]
    log.info("Note: %s is read as a list of OpenDroneMap without the CRS that its first line has, "
             "x y z column row image; the first mark is at sample %s, line %s, x %s, y %s.", path,
             sample, line, x, y, extra={ONCE: f"a list without its CRS, {path}"})


def _numbered_lines(text: str) -> list[tuple[int, str]]:
    """Return number and text of the lines that are not blank."""
    return [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)
            if line.strip()]


def _crs_row(rows: list[tuple[int, str]]) -> int | None:
    """Return the index of the line that states the CRS, with or without a #; None if none does.

    It is the first line that is no comment, or a comment before that which states a CRS.
    """
    for i, (_, text) in enumerate(rows):
        statement = text.removeprefix("#").strip()
        # What looks like a CRS but is none counts as one, so that `_read_marks` names it.
        if begins_as_crs(statement) or _CODE.fullmatch(statement) or is_crs(statement):
            return i
        if not text.startswith("#"):
            return None
    return None


def _has_unknown_crs(rows: list[tuple[int, str]]) -> bool:
    """Return whether the first line states an unknown CRS: words above the mark of an image.

    Words of as many cells as the mark has would be the header of another table.
    """
    if len(rows) < 2 or _crs_row(rows) is not None:
        return False
    first = _split_cells(rows[0][1])
    mark = _split_cells(rows[1][1])
    return (not any(map(is_number, first)) and len(first) < len(mark) and _is_mark(mark)
            and Path(mark[5]).suffix.lower() in _IMAGES)


def _lacks_crs(rows: list[tuple[int, str]]) -> bool:
    """Return whether lines are marks from the first on, in files of images, without a CRS.

    Numbers that are beyond any image show another order of columns.
    """
    marks = [_split_cells(text) for _, text in rows if not text.startswith("#")][:_SNIFFED]
    # The last line of the beginning of a file may be cut.
    complete = marks[:-1] or marks
    return bool(complete) and _crs_row(rows) is None and all(
        _is_mark(cells) and Path(cells[5]).suffix.lower() in _IMAGES
        and all(abs(float(cell)) <= LARGEST_IMAGE for cell in cells[3:5]) for cells in complete)


def _split_cells(text: str) -> list[str]:
    """Return the cells of a line, its numbers with decimal points.

    Between tabs, semicolons or commas, names of images may have blanks.
    """
    # The separator is the first by which the line is a mark; None stands for any blanks.
    for separator in ("\t", ";", None, ","):
        cells = [cell.strip() for cell in text.split(separator)]
        numbers = [cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell
                   for cell in cells[:5]]
        if _is_mark([*numbers, *cells[5:]]):
            return [*numbers, *cells[5:]]
    # What is no mark, such as the CRS or a header.
    between_tabs = [cell.strip() for cell in text.split("\t")]
    return between_tabs if len(between_tabs) > 5 else text.split()


def _is_mark(cells: list[str]) -> bool:
    """Return whether cells are a mark: five numbers, x, y, z, column and row, then an image's name.
    """
    return (len(cells) > 5 and all(is_number(cell) for cell in (*cells[:2], *cells[3:5]))
            and (is_number(cells[2])
                 or not _blank_unknown_height(cells[2])) and not is_number(cells[5]))


def _blank_unknown_height(cell: str) -> str:
    """Return a cell; "" if it says that a height is unknown."""
    return "" if cell.lower() in ("nan", "none", "-") else cell


class OdmGcpListWriter(PointsWriter):
    """Control and check points as a list of OpenDroneMap, without blunders.

    The names of independent check points begin with "CHK-", which not every version of OpenDroneMap
    knows: a note says so, and without `check_points` they are left out. Heights that are not known
    are NaN.
    """

    name = "odm-gcp-list"
    summary = "points without blunders as gcp_list.txt of OpenDroneMap, with check points"
    suffix = "_gcp_list.txt"
    declared_options: ClassVar[tuple[Option, ...]] = (
        IMAGE_OPTION,
        Option("check_points", True, "Whether the list has the independent check points, too, with "
                                     "names that begin with CHK-.", type=bool))

    def write(self, result: Result, path: Path) -> None:
        """Write the CRS and a line for each point; check points unless `check_points` is off.

        A note is logged if there are check points, as earlier versions of OpenDroneMap take them as
        control. Raises TermselError for a result without control points in a CRS of the Earth, or
        if none can be written.
        """
        self.require(result, path)
        checked = points_for_others(result)
        if not self.options["check_points"]:
            checked = checked.without_checks()
        require_points(checked, path, self.needs)
        image = image_in_one_cell(self.options["image"], path, r"\s", "blanks")
        rows = [_crs_line(result.features.crs)]
        for name, (line, sample), position, is_check in zip(
                checked.points.ids, checked.points.image.tolist(), checked.points.ground.tolist(),
                checked.is_check, strict=True):
            label = _as_one_word(
                f"{_CHECK}{name}" if is_check and not name.startswith(_CHECK) else name)
            # NaN is how the list states an unknown height.
            x, y, z = (repr(value) if value == value else "NaN" for value in position)
            rows.append(f"{x} {y} {z} {sample!r} {line!r} {image} {label}")
        write_text(path, "\n".join([*rows, ""]))
        say_checked(self.name, checked)
        if any(checked.is_check):
            log.warning("Note: names of check points begin with %s. Versions of OpenDroneMap that "
                        "do not know this take them as control: --set check_points=false leaves "
                        "them out.", _CHECK)


def _crs_line(crs: str) -> str:
    """Return the first line of a list: a code of EPSG, else a string of PROJ."""
    plane = horizontal_crs(crs)
    # OpenDroneMap reads no compound CRS.
    if plane.startswith("EPSG:") and "+" not in plane:
        return plane
    with require_import("gcp_list.txt in this CRS requires", "pyproj", GIS):
        from pyproj import CRS
    # pyproj warns that a string of PROJ may lose parts of a CRS; OpenDroneMap reads nothing else.
    with catch_warnings():
        simplefilter("ignore")
        return str(CRS.from_user_input(plane).to_proj4())


def _as_one_word(text: str) -> str:
    """Return a text with _ in place of blanks, which separate the cells of a list; "_" of ""."""
    return "_".join(text.split()) or "_"
