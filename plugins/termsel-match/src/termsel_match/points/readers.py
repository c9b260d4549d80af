"""Readers of matches that other programs have found."""

from __future__ import annotations

import csv
import logging
from collections.abc import Iterator, Sequence
from math import isfinite
from pathlib import Path

import numpy as np

from termsel import FeatureSet, Option, Points, Reader, TermselError
from termsel.toolkit import BoolArray, read_data, read_text
from termsel_match.images.rasters import FloatArray, crs_of, open_picture

log = logging.getLogger("termsel.match")

REFERENCE = Option("reference", "", "Required: the georeferenced image in which the second places "
                                    "were matched.")

RASTER_OPTION = Option("raster", "",
                       "The image: a few matches outside it are left out. By default that of "
                       "the run, --image FILE.")
_MOST_NAMED = 10
"""How many of the matches outside the image a note names."""

_MOST_OUTSIDE = 0.1
"""Share of matches outside the image up to which these are wrong, and not the image."""

_AROSICS = ("POINT_ID", "X_IM", "Y_IM", "X_MAP", "Y_MAP", "X_SHIFT_M", "Y_SHIFT_M")
"""Columns of AROSICS that are read."""

_NO_MATCH = -9999.0
"""Number that AROSICS writes where there is no match."""

NEEDS_REFERENCE = "the matches are pixels of two images, so the reference is needed"
NO_PIXEL = 100_000.0
"""Line or sample beyond which next to no image has pixels."""
_POSITION_COLUMNS = (("image_line", "image_sample", "reference_line", "reference_sample"),
                     ("y1", "x1", "y2", "x2"), ("y0", "x0", "y1", "x1"))


class ArosicsTable(Reader):
    """Tie points of AROSICS: the columns of its CoRegPoints_table, saved as CSV.

    X_IM and Y_IM count from the corner of the image. The ground position is X_MAP + X_SHIFT_M and
    Y_MAP + Y_SHIFT_M, as in the GCPs that AROSICS makes. Points without a match are left out;
    those that AROSICS takes for outliers get the role off. Heights are unknown, and the file does
    not state its CRS.
    """

    name = "arosics-csv"
    summary = "tie points of AROSICS as CSV: POINT_ID,X_IM,Y_IM,X_MAP,Y_MAP,X_SHIFT_M,Y_SHIFT_M"

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True if the header has AROSICS' columns."""
        return set(_AROSICS) <= set(_read_header(head))

    def read(self, path: Path) -> FeatureSet:
        """Return the points with a match; those that AROSICS takes for outliers are off.

        Raises TermselError, with file, line and column, for a cell that is no number, and if no
        point has a match.
        """
        ids = []
        roles = []
        rows = []
        for line, cells in _read_rows(path, _AROSICS):
            values = [_number(cells, name, path, line) for name in _AROSICS[1:]]
            if _NO_MATCH in values:
                continue
            ids.append(f"A{cells['POINT_ID'].strip()}")
            outlier = (cells.get("OUTLIER") or "").strip().lower()
            roles.append("off" if outlier in ("true", "1", "1.0") else "")
            rows.append(values)
        if not rows:
            raise TermselError("the table has no point with a match", file=path,
                               hint="Run AROSICS again with another window or reference.")
        x, y, east, north, right, up = np.array(rows).T
        # AROSICS states where the image was believed to be on the map, and the shift from there.
        # Its positions in the image count from the corner of the first pixel, termsel's from its
        # centre.
        ground = np.column_stack([east + right, north + up, np.full(len(rows), np.nan)])
        return FeatureSet(Points(tuple(ids), np.column_stack([y, x]) - 0.5, ground, None,
                                 tuple(roles)), crs="")


class MatchesCsv(Reader):
    """Matches of an image with a georeferenced one, as a table of pixels.

    Its columns are image_line, image_sample, reference_line, reference_sample, or y1, x1, y2, x2,
    or y0, x0, y1, x1, as LoFTR and similar matchers name them. The centre of the first pixel is
    (0, 0). It may have further columns: id, and sigma in px.
    """

    name = "matches-csv"
    summary = ("matches as a table headed image_line,image_sample,reference_line,"
               "reference_sample[,id,sigma]")
    declared_options = (REFERENCE, RASTER_OPTION)

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True if the header names lines and samples of both images."""
        header = set(_read_header(head))
        # termsel's tables of lines also have columns y1, x1, y2, x2, and others beside them.
        has_positions = any(set(names) <= header for names in _POSITION_COLUMNS)
        return has_positions and not {"line1", "z1"} & header

    def read(self, path: Path) -> FeatureSet:
        """Return the points; errors name file, line and column.

        The second positions are in px of the reference, which gives their ground coordinates.
        Raises TermselError for cells that are no numbers, without a reference, and where most
        second positions are beyond it, as map coordinates are.
        """
        header = _read_header(read_text(path).encode())
        names = next((names for names in _POSITION_COLUMNS if set(names) <= set(header)),
                     _POSITION_COLUMNS[0])
        ids = []
        rows = []
        sigma = []
        lines = []
        for line, cells in _read_rows(path, names):
            lines.append(f"line {line}")
            rows.append([_number(cells, name, path, line) for name in names])
            ids.append((cells.get("id") or "").strip() or f"M{len(rows):03d}")
            if "sigma" in cells:
                sigma.append(_number(cells, "sigma", path, line))
        positions = np.array(rows).reshape(-1, 4)
        line_name, sample_name, y, x = names
        columns = ("--format points-csv --columns "
                   f"sample={sample_name},line={line_name},x={x},y={y}")
        reference = self.options["reference"]
        if len(rows) and _are_beyond(positions[:, 2:], reference):
            beyond = f"the reference {Path(reference).name}" if reference else "any image"
            raise TermselError(f"{x} and {y} are beyond {beyond}, and look like map coordinates",
                               file=path, hint=f"If they are, declare the columns: {columns}.")
        if not reference:
            raise TermselError(NEEDS_REFERENCE, file=path, code="reference-missing", hint=(
                "Give it with --set reference=ORTHO.tif. If the second places are on the ground, "
                f"declare the columns: {columns}."))
        inside = are_in_image(positions[:, :2], self.options["raster"], lines)
        return with_ground(path, [ids[i] for i in np.flatnonzero(inside)], positions[inside, :2],
                           positions[inside, 2:], reference,
                           np.repeat(sigma, 2).reshape(-1, 2)[inside] if sigma else None)


def _are_beyond(positions: FloatArray, reference: str) -> bool:
    """Return whether positions (n, 2) are too large for lines and samples of the reference.

    They are if more than half lie outside it or, without a reference (""), if any is beyond
    100,000 px.
    """
    if not reference:
        return bool(np.abs(positions).max() > NO_PIXEL)
    with open_picture(reference) as picture:
        last = np.array(picture.size) - 0.5
    return bool(((positions < -0.5) | (positions > last)).any(axis=1).mean() > 0.5)


def are_in_image(positions: FloatArray, image: str, names: Sequence[str]) -> BoolArray:
    """Return which matches are in the image, (n,), and log a note about the others.

    If no image is known ("") or more than a tenth are outside, all count as inside. `positions`
    (n, 2) are lines and samples [px], and `names` say where in the file they are, such as
    "line 58".
    """
    # A few matches outside the image are wrong. Of many, the file may be of another image, which
    # is for whoever reads the points to see.
    everywhere = np.ones(len(positions), dtype=bool)
    if not image:
        return everywhere
    with open_picture(image) as picture:
        last = np.array(picture.size) - 0.5
    inside = np.asarray(((positions >= -0.5) & (positions <= last)).all(axis=1))
    outside = [name for name, is_inside in zip(names, inside, strict=True) if not is_inside]
    if not outside or len(outside) > _MOST_OUTSIDE * len(positions):
        return everywhere
    more = len(outside) - _MOST_NAMED
    listed = ", ".join(outside[:_MOST_NAMED]) + (f" and {more} more" if more > 0 else "")
    log.warning("Note: %d of %d matches %s outside the image and left out: %s of the file.",
                len(outside), len(positions), "is" if len(outside) == 1 else "are", listed)
    return inside


def with_ground(path: Path, ids: Sequence[str], image: FloatArray, at_reference: FloatArray,
                reference: str, sigma: FloatArray | None) -> FeatureSet:
    """Return matches as points, with the ground coordinates of their pixels in a reference raster.

    `image` and `at_reference` (n, 2) are lines and samples in the image and in the reference [px].
    Of matches with the same ground position only the first is returned. Raises TermselError without
    a reference or without matches.
    """
    if not reference:
        raise TermselError(NEEDS_REFERENCE, file=path, code="reference-missing",
                           hint="Give it with --set reference=ORTHO.tif. If the second places are "
                                "on the ground, declare the columns: --format points-csv --columns "
                                "sample=NAME,line=NAME,x=NAME,y=NAME.")
    if not len(image):
        raise TermselError("the table has no matches", file=path, hint="Add one row per match.")
    with open_picture(reference) as picture:
        crs = crs_of(picture)
        # The geotransform counts from the corner of the first pixel, positions from its centre.
        x, y = picture.raster.transform @ (at_reference[:, 1] + 0.5, at_reference[:, 0] + 0.5)
    ground = np.column_stack([x, y, np.full(len(at_reference), np.nan)])
    # SIFT gives a keypoint with two directions twice. Rows stay in the order of the file.
    _, first = np.unique(ground[:, :2], axis=0, return_index=True)
    first_rows = np.sort(first)
    return FeatureSet(Points(tuple(ids[i] for i in first_rows), image[first_rows],
                             ground[first_rows],
                             None if sigma is None else sigma[first_rows]), crs=crs)


def bytes_of(path: Path) -> bytes:
    """Return the content of a file; raises TermselError if it cannot be read."""
    try:
        return read_data(path)
    except OSError as error:
        raise TermselError(f"cannot read this file: {error.strerror}", file=path,
                           hint="Check the name and the folder.") from error


def _read_header(head: bytes) -> list[str]:
    """Return the column names in the first line of a table that is not blank; [""] without one."""
    text = head.decode("utf-8-sig", errors="replace")
    first = next((line for line in text.splitlines() if line.strip()), "")
    return [cell.strip().strip('"') for cell in first.split(",")]


def _read_rows(path: Path, columns: Sequence[str]) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield the line number of each row, and its cells by column name.

    Raises TermselError if one of `columns` is missing, or a quotation mark is not closed.
    """
    reader = csv.DictReader(read_text(path).splitlines(), skipinitialspace=True)
    try:
        names = [name.strip() for name in reader.fieldnames or []]
        reader.fieldnames = names
        lacking = [name for name in columns if name not in names]
        if lacking:
            raise TermselError(f"the table has no column {lacking[0]}", file=path, line=1,
                               hint=f"Expected the columns {','.join(columns)}.")
        for cells in reader:
            yield reader.line_num, cells
    except csv.Error as error:
        raise TermselError(f"this row cannot be read: {error}", file=path,
                           line=reader.line_num + 1,
                           hint='Look for a quotation mark (") that is not closed.') from error


def _number(cells: dict[str, str], name: str, path: Path, line: int) -> float:
    """Return the number in a cell; raises TermselError with file, line and column if it has none.

    Infinite numbers and NaN are refused as well.
    """
    text = (cells[name] or "").strip()
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not isfinite(value):
        raise TermselError(f"{text!r} is not a number", file=path, line=line, column=name,
                           hint="Write a number with a decimal point.")
    return value
