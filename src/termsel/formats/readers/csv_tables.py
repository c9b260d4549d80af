"""Points and lines as tables of values separated by commas, semicolons or tabs.

Comment lines begin with ``#``; ``# crs: EPSG:4979`` declares the CRS, ``# image_size: 4000,5000``
lines and samples of the image, and ``# units: degrees`` or ``# units: metres`` the units of the
ground coordinates. The centre of the upper-left pixel is (0, 0), whatever the image columns are
called.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import isnan
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from termsel.core.arguments import explains_arguments
from termsel.core.errors import TermselError
from termsel.core.files.atomic import write_text
from termsel.core.files.texts import cell_text
from termsel.core.options import Option
from termsel.data.features import FeatureSet, FloatArray, Lines, Points
from termsel.data.tables.columns import LINES, POINTS, fold_name, parse_columns
from termsel.data.tables.tabular import Attributes
from termsel.formats.base import IMAGE_NAME, LARGEST_IMAGE, image_of
from termsel.formats.readers.cells import header_row, read_cells
from termsel.formats.readers.tables import COLUMNS, Table, TableReader, points_of

log = logging.getLogger(__name__)

_IMAGES = frozenset({
    "image", "imagename", "imagefile", "imageid", "imageno", "imagenumber", "img", "imgname",
    "photo", "photoname", "photofile", "photoid", "photono", "photonumber", "picture", "filename",
    "mapid", "mapname", "scan", "scanid", "scanno", "scanname", "scanfile", "raster", "rasterid",
    "rastername", "rasterfile", "scene", "sceneid", "scenename", "sheetid", "canvas", "canvasid",
    "bild", "bildname", "bilddatei", "kartenid", "foto", "imagen", "imagem", "immagine", "cliche",
    "zdjecie"})
"""Names of the column that says which image a point was measured in, without signs."""


class PointsCsv(TableReader):
    """Points with line and sample, ground coordinates, and optionally role and sigma.

    Text in any usual encoding with any usual separator, or a spreadsheet.
    """

    states_origin = False
    name = "points-csv"
    summary = "points as a table headed id,role,line,sample,x,y,z[,sigma_line,sigma_sample]"
    aliases = POINTS
    declared_options: ClassVar[tuple[Option, ...]] = (IMAGE_NAME, *COLUMNS)

    def features(self, table: Table) -> FeatureSet:
        """Return the points of a table; errors name file, line and column.

        Of a table of several images these are the points of the image that the option `image_name`
        names.
        """
        images = _images_of({name: list(cells) for name, cells in table.attributes.items()})
        stated_image = self.options["image_name"]
        if images or stated_image is not None:
            image = image_of(table.path or Path(), images, stated_image,
                             "image_name=NAME")
            table = table.take([row for row, name in enumerate(images) if name == image])
        features = replace(points_of(table, table.crs), image_size=table.image_size)
        _note_x_and_y_as_pixels(table, features)
        return features

    def parts(self, path: Path) -> dict[str, dict[str, Any]]:
        """Return the options that choose each image of the table, by its name; {} for one image."""
        stated = parse_columns(self.options.get("columns", ""))
        # The cells are read without the table, which would log its notes.
        rows = read_cells(path, self.aliases, stated, self.options.get("layer")).rows
        first = header_row(rows, self.aliases, stated)
        header = rows[first]
        return parts_of(header, [row for row in rows[first + 1:] if len(row) == len(header)])


def parts_of(header: Sequence[str], rows: Sequence[Sequence[str]]) -> dict[str, dict[str, Any]]:
    """Return the options of each image of a table; empty where it has one image."""
    images = _images_of(dict(zip(header, zip(*rows, strict=True), strict=False)))
    return {image: {"image_name": image} for image in dict.fromkeys(images)}


def _images_of(columns: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the name of the image that each point was measured in; [] where there is one image.

    `columns` are cells by the name of their column. A column with another name for each point does
    not count: these are pictures of the points.
    """
    for name, cells in columns.items():
        images = [str(cell).strip() for cell in cells]
        if fold_name(name) in _IMAGES and 1 < len(set(images)) < len(images):
            return images
    return []


def _note_x_and_y_as_pixels(table: Table, features: FeatureSet) -> None:
    """Log a note that columns called x and y are read as sample and line, next to lon and lat.

    Tables of GIS have x and y on the ground, tables of viewers in the image; next to lon and lat
    they can only be in the image. Raises TermselError if they are too large for pixels.
    """
    image_names = [table.names.get(meaning, "").strip().casefold()
                   for meaning in ("sample", "line")]
    if image_names != ["x", "y"] or not len(features.points):
        return
    if np.abs(features.points.image).max() > LARGEST_IMAGE:
        ground_names = [table.names[meaning].strip() for meaning in ("x", "y")]
        # Photogrammetrists call the image x' and y'.
        are_primed = [fold_name(name) for name in ground_names] == ["x", "y"]
        if are_primed and np.abs(features.points.ground[:, :2]).max() <= LARGEST_IMAGE:
            # In double quotes for the shell, as names may have a prime.
            sample, line = ground_names
            exchanged = f'"x=x,y=y,sample={sample},line={line}"'
            raise table.error(
                f"x and y are no pixels, and {' and '.join(ground_names)} look like pixels", 0,
                "sample", f"Declare them: --columns {exchanged}. If lines count upwards, add --set "
                          "image_origin=bottom-left --image FILE.")
        raise table.error("x and y are no pixels, and there are no other columns of the image", 0,
                          "sample", "Declare the columns of the image, --columns "
                                    "line=NAME,sample=NAME.")
    log.info("Note: x and y are read as sample and line, next to %s and %s on the ground.",
             table.names["x"].strip(), table.names["y"].strip())


class LinesCsv(TableReader):
    """Lines, each with two image points and two ground vertices that are not conjugate."""

    states_origin = False
    name = "lines-csv"
    summary = "lines as a table headed id,line1,sample1,line2,sample2,x1,y1,z1,x2,y2,z2[,sigma]"
    aliases = LINES
    # Other tables have x1, y1, x2, y2 too: pixels of two images, or boxes.
    required = (("line1",), ("sample1",), ("line2",), ("sample2",))

    def features(self, table: Table) -> FeatureSet:
        """Return the lines that are not off; errors name file, line and column.

        Raises TermselError for a line in the role check or independent, and for what `Lines`
        refuses.
        """
        roles = table.roles()
        for row, role in enumerate(roles):
            if role in ("check", "independent"):
                raise table.error(f"a line cannot have the role {role!r}", row, "role",
                                  "Lines are always control: use control, off or blank.")
        image = table.stack("line1", "sample1", "line2", "sample2").reshape(-1, 2, 2)
        ground = table.stack("x1", "y1", "z1", "x2", "y2", "z2").reshape(-1, 2, 3)
        sigma = table.sigma("sigma")
        try:
            lines = Lines(tuple(table.ids()), image, ground,
                          None if sigma is None else sigma[:, 0], table.attributes)
        except TermselError as error:
            raise table.placed(error) from error
        if "off" in roles:
            # `Lines` have no roles: those that are off are left out.
            lines = lines.take([role != "off" for role in roles])
        return FeatureSet(lines=lines, crs=table.crs, image_size=table.image_size,
                          named_units=table.named_units())


@explains_arguments()
def write_points_csv(points: Points, path: Path | str, crs: str = "") -> None:
    """Write points as a table that `PointsCsv` reads back exactly.

    Parameters
    ----------
    points : Points
        Image coordinates are counted from the centre of the upper-left pixel.
    path : path-like
    crs : str, optional
        Declared in a comment line.

    Returns
    -------
    None

    Raises
    ------
    TermselError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile, termsel
    >>> points = termsel.simulate_scene("ikonos-hamedan", n_points=6).points
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     termsel.write_points_csv(points, f"{folder}/points.csv", crs="EPSG:4979")
    ...     len(termsel.read(f"{folder}/points.csv").points)
    6
    """
    write_text(path, points_text(points, crs))


def points_text(points: Points, crs: str, image_size: tuple[int, int] | None = None) -> str:
    """Return the text of a table; see `write_points_csv`."""
    header, values = point_columns(points)
    texts = [[name, role] for name, role in zip(points.ids, points.roles, strict=True)]
    return table_text(crs, ["id", "role", *header], texts, values, points.attributes, image_size)


def point_columns(points: Points) -> tuple[list[str], FloatArray]:
    """Return headings and values, (n, k), of the columns of numbers that hold points in a table."""
    header = ["line", "sample", "x", "y", "z"]
    columns = [points.image, points.ground]
    if points.sigma is not None:
        header += ["sigma_line", "sigma_sample"]
        columns.append(points.sigma)
    return header, np.concatenate(columns, axis=1)


@explains_arguments()
def write_lines_csv(lines: Lines, path: Path | str, crs: str = "") -> None:
    """Write lines as a table that `LinesCsv` reads back exactly.

    Parameters
    ----------
    lines : Lines
        Image coordinates are counted from the centre of the upper-left pixel.
    path : path-like
    crs : str, optional
        Declared in a comment line.

    Returns
    -------
    None

    Raises
    ------
    TermselError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile, termsel
    >>> lines = termsel.simulate_scene("ikonos-hamedan", n_lines=3).lines
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     termsel.write_lines_csv(lines, f"{folder}/lines.csv", crs="EPSG:4979")
    ...     len(termsel.read(lines=f"{folder}/lines.csv").lines)
    3
    """
    write_text(path, lines_text(lines, crs))


def lines_text(lines: Lines, crs: str, image_size: tuple[int, int] | None = None) -> str:
    """Return the text of a table; see `write_lines_csv`."""
    header, values = line_columns(lines)
    return table_text(crs, ["id", *header], [[name] for name in lines.ids], values,
                      lines.attributes, image_size)


def line_columns(lines: Lines) -> tuple[list[str], FloatArray]:
    """Return headings and values, (n, k), of the columns of numbers that hold lines in a table."""
    header = ["line1", "sample1", "line2", "sample2", "x1", "y1", "z1", "x2", "y2", "z2"]
    columns = [lines.image.reshape(-1, 4), lines.ground.reshape(-1, 6)]
    if lines.sigma is not None:
        header.append("sigma")
        columns.append(lines.sigma[:, None])
    return header, np.concatenate(columns, axis=1)


def table_text(crs: str, header: list[str], texts: list[list[str]], values: FloatArray,
               attributes: Attributes | None = None,
               image_size: tuple[int, int] | None = None) -> str:
    """Return the text of a table with the CRS, "" for none, and the image's size as comments.

    `texts` are the first cells of each row, `values` (rows, columns) those after them, where NaN
    becomes a blank cell; `attributes` are further columns of text.
    """
    attributes = attributes or {}
    if attributes:
        attributes_of_rows = list(zip(*attributes.values(), strict=True))
    else:
        attributes_of_rows = [()] * len(texts)
    rows = []
    for row, numbers, attribute_cells in zip(texts, values.tolist(), attributes_of_rows,
                                             strict=True):
        # repr() gives the fewest digits, 17 at most, that are read back to the same number.
        number_cells = ["" if isnan(number) else repr(number) for number in numbers]
        rows.append(",".join([*map(cell_text, row), *number_cells,
                              *map(cell_text, attribute_cells)]))
    # WKT may span lines, a comment may not.
    comments = [f"# crs: {' '.join(crs.split())}"] if crs else []
    if image_size is not None:
        comments.append(f"# image_size: {image_size[0]},{image_size[1]}")
    return "\n".join([*comments, ",".join([*header, *map(cell_text, attributes)]), *rows]) + "\n"
