"""Ground control points of the Ames Stereo Pipeline: text files that end in ``.gcp``.

From its manual, section "Ground control points" of `bundle_adjust`: one row per point, cells
separated by spaces or commas: id, latitude, longitude, height above a datum that is stated
elsewhere, their three standard deviations [m]; then for each image its name, column and row
counted from 0, and their standard deviations [px]. Ids are whole numbers: bundle_adjust leaves out
rows with others. Names of points are in comments here, ``# id 7 is NAME``.
"""

from __future__ import annotations

import re
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from termsel import FeatureSet, Option, Reader, Result, TermselError
from termsel.toolkit import read_text, write_text
from termsel.toolkit.coordinates import normalise, to_wgs84
from termsel.toolkit.files import IMAGE_NAME, Table, image_of, is_number
from termsel_formats.points.written import (
    IMAGE_OPTION,
    PointsWriter,
    image_in_one_cell,
    image_sigma,
    points_for_others,
    require_points,
    say_checked,
)

_GROUND_CELLS = ("id", "lat", "lon", "height", "sigma_x", "sigma_y", "sigma_z")
_IMAGE_CELLS = ("image", "column", "row", "sigma_column", "sigma_row")
_HEADINGS = {"id": "id", "y": "lat", "x": "lon", "z": "height", "sample": "column", "line": "row",
         "sigma_sample": "sigma_column", "sigma_line": "sigma_row"}

_NAME_COMMENT = re.compile(r"#\s*id (\d+) is (.+)")
"""Comments of termsel on the name of a point."""
_WKT = re.compile(r"#\s*WKT:\s*(\S.*)")

_WKT_OF_WGS84 = ('GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],'
                 'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4326"]]')
_LARGEST_ID = 2**31 - 1

_CHECK_SIGMA = 10000.0
"""Standard deviation of a check point [m], so large that it does not constrain the adjustment."""


class AspGcp(Reader):
    """Points of the Ames Stereo Pipeline, latitude before longitude.

    The datum is in a comment, ``# WKT: GEOGCS[...]``, as gcp_gen and dem2gcp write it, or must be
    stated: ``--crs EPSG:4979`` for WGS84. Pixel centres are taken to have whole numbers.
    """

    name = "asp-gcp"
    summary = "Ames Stereo Pipeline .gcp: id lat lon height 3 sigmas, image col row 2 sigmas"
    declared_options = (IMAGE_NAME,)

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True if the first row that is not a comment has the cells of a point."""
        text = head.decode("utf-8-sig", errors="replace")
        # Other programs' .gcp files have fewer cells, and no name among them.
        first = next((line for line in text.splitlines() if not _is_blank_or_comment(line)), "")
        cells = _split_cells(first)
        return (_fits_layout(cells) and all(map(is_number, cells[:7] + cells[8:12]))
                and not is_number(cells[7]))

    def read(self, path: Path) -> FeatureSet:
        """Return the points that one image sees; of several, the option `image_name` chooses one.

        Points have the names that comments of termsel state, or else the ids of ASP. Errors name
        file, line and column.
        """
        points = _parse_rows(path)
        names = chain.from_iterable(images for _, _, images in points)
        image = image_of(path, names, self.options["image_name"], "image_name=NAME")
        # A point need not be in every image.
        rows = [(number, *ground, image, *images[image])
                for number, ground, images in points if image in images]
        lines, ids, *columns = zip(*rows, strict=True)
        name_of = _names_by_id(path)
        # ASP takes whole numbers as ids alone; the names are in comments.
        columns.insert(0, tuple(name_of.get(cell, cell) for cell in ids))
        cells_of = dict(zip(_GROUND_CELLS + _IMAGE_CELLS, columns, strict=True))
        table = Table(path, "", _HEADINGS, {key: cells_of[name] for key, name in _HEADINGS.items()},
                      lines)
        return FeatureSet(table.points(table.stack("line", "sample"), table.stack("x", "y", "z"),
                                       table.sigma("sigma_line", "sigma_sample"), ()),
                          crs=_crs_of_datum(path))

    def parts(self, path: Path) -> dict[str, dict[str, Any]]:
        """Return the options for each image of the file; {} if there is only one."""
        images = dict.fromkeys(chain.from_iterable(names for _, _, names in _parse_rows(path)))
        return {image: {"image_name": image} for image in images} if len(images) > 1 else {}


_Row = tuple[int, list[str], dict[str, list[str]]]
"""Line of the file, cells of the ground, and cells of each image."""


def _parse_rows(path: Path) -> list[_Row]:
    """Return the rows of a file that are not comments, divided into their cells.

    Of each row there are the number of its line, the cells of `_GROUND_CELLS`, and for each image
    by its name the cells of `_IMAGE_CELLS` after the name. Raises TermselError if there is no row,
    or if one does not have seven cells and five for each image.
    """
    points: list[_Row] = []
    for number, text in enumerate(read_text(path).splitlines(), 1):
        if _is_blank_or_comment(text):
            continue
        cells = _split_cells(text)
        if not _fits_layout(cells):
            raise TermselError(
                f"the row has {len(cells)} cells, expected 7 and 5 for each image", file=path,
                line=number, hint=f"Expected: {' '.join(_GROUND_CELLS)}, then "
                                  f"{' '.join(_IMAGE_CELLS)}.")
        points.append((number, cells[:7], {
            cells[i]: cells[i + 1:i + 5] for i in range(7, len(cells), 5)}))
    if not points:
        raise TermselError("the file has no points", file=path,
                           hint="Add one row per point.")
    return points


def _names_by_id(path: Path) -> dict[str, str]:
    """Return the names of points by their ids, from comments of termsel; {} if there are none."""
    matches = map(_NAME_COMMENT.match, read_text(path).splitlines())
    return {match[1]: match[2].strip() for match in matches if match}


def _crs_of_datum(path: Path) -> str:
    """Return the CRS of the first comment that states a datum; "" if there is none, or no CRS."""
    stated = map(_WKT.match, read_text(path).splitlines())
    wkt = next((match[1] for match in stated if match), "")
    try:
        crs = normalise(wkt)
    except TermselError:
        return ""
    # Heights of these files are above the ellipsoid of the datum.
    return "EPSG:4979" if crs == "EPSG:4326" else crs


def _is_blank_or_comment(line: str) -> bool:
    """Return whether a line of a file has no cells."""
    return not line.strip() or line.lstrip().startswith("#")


def _split_cells(line: str) -> list[str]:
    """Return the cells of a line, between blanks or commas."""
    return [cell for cell in re.split(r"[\s,]+", line.strip()) if cell]


def _fits_layout(cells: list[str]) -> bool:
    """Return whether a row can be one of the layout: seven cells, then five for each image."""
    return len(cells) >= 12 and (len(cells) - 7) % 5 == 0


class AspGcpWriter(PointsWriter):
    """Control and check points as a .gcp file of the Ames Stereo Pipeline, without blunders.

    Places are longitude, latitude and height above the ellipsoid on WGS84. Of check points all
    standard deviations are large, so that bundle_adjust follows the control. Points whose names are
    no whole numbers are numbered; comments have their names, which termsel reads back.
    """

    name = "asp-gcp"
    summary = "points without blunders as .gcp of the Ames Stereo Pipeline, with sigmas"
    needs = "control points with heights, in a CRS of the Earth"
    suffix = ".gcp"
    declared_options: ClassVar[tuple[Option, ...]] = (
        IMAGE_OPTION,
        Option("ground_sigma", 1.0, "Standard deviation of the ground coordinates [m]; they are "
                                    "not in the control of termsel.", float, 0.0, 1e6))

    def write(self, result: Result, path: Path) -> None:
        """Write a row for each point, in WGS84 with ellipsoidal heights.

        How many points there are, and which are left out, is logged. Raises TermselError if no
        point has a height and can be written, or if the option `ground_sigma` is no standard
        deviation.
        """
        self.require(result, path)
        sigma_ground = float(self.options["ground_sigma"])
        if not 0.0 < sigma_ground < np.inf:
            raise TermselError(f"ground_sigma is {sigma_ground:g}, which is no standard deviation",
                               hint="Give it in metres, such as --set ground_sigma=0.5.")
        checked = points_for_others(result, with_heights=True)
        require_points(checked, path, self.needs)
        points = checked.points
        ground = to_wgs84(result.features.crs)(points.ground)
        sigma_image = image_sigma(points, result)
        image = image_in_one_cell(self.options["image"], path, r"\s,#", "blanks, commas or #")
        rows = [f"# WKT: {_WKT_OF_WGS84}", f"# {' '.join(_GROUND_CELLS)} {' '.join(_IMAGE_CELLS)}",
                "# WGS84; heights above the ellipsoid [m]; rows and columns from 0"]
        numbers = _row_ids(points.ids)
        columns = (points.image.tolist(), ground.tolist(), sigma_image.tolist(), checked.is_check)
        for name, number, (line, sample), (x, y, z), (sigma_line, sigma_sample), is_check in zip(
                points.ids, numbers, *columns, strict=True):
            if number != name:
                rows.append(f"# id {number} is {' '.join(name.split())}")
            # ASP has no check points: bundle_adjust would hold them as it does control.
            sigma_xyz = _CHECK_SIGMA if is_check else sigma_ground
            sigmas = " ".join([repr(sigma_xyz)] * 3)
            rows.append(f"{number} {y!r} {x!r} {z!r} {sigmas} {image} {sample!r} {line!r} "
                        f"{sigma_sample!r} {sigma_line!r}")
        write_text(path, "\n".join([*rows, ""]))
        say_checked(self.name, checked)


def _row_ids(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names as ids if all are whole numbers up to 2^31 - 1, else numbers from 1."""
    # bundle_adjust leaves out rows whose ids are no whole numbers.
    are_numbers = all(name.isascii() and name.isdecimal() and str(int(name)) == name
                      and int(name) <= _LARGEST_ID for name in names)
    return names if are_numbers else tuple(str(number) for number in range(1, len(names) + 1))
