"""Ground control points of the Ames Stereo Pipeline: text files that end in ``.gcp``.

From its manual, section "Ground control points" of `bundle_adjust`: one row per point, cells
separated by spaces or commas: id, latitude, longitude, height above a datum that is stated
elsewhere, their three standard deviations [m]; then for each image its name, column and row
counted from 0, and their standard deviations [px].
"""

from __future__ import annotations

import re
from pathlib import Path

from termsel import FeatureSet, Reader, TermselError
from termsel.toolkit import IMAGE_NAME, Table, image_of, is_number, read_text

_GROUND = ("id", "lat", "lon", "height", "sigma_x", "sigma_y", "sigma_z")
_IMAGE = ("image", "column", "row", "sigma_column", "sigma_row")
_READ = {"id": "id", "y": "lat", "x": "lon", "z": "height", "sample": "column", "line": "row",
         "sigma_sample": "sigma_column", "sigma_line": "sigma_row"}


class AspGcp(Reader):
    """Points of the Ames Stereo Pipeline, latitude before longitude.

    The datum of the heights is not in the file, so the CRS must be stated: ``--crs EPSG:4979``
    for WGS84. Pixel centres are taken to have whole numbers.
    """

    name = "asp-gcp"
    summary = "Ames Stereo Pipeline .gcp: id lat lon height 3 sigmas, image col row 2 sigmas"
    declared_options = (IMAGE_NAME,)

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True if the first row that is not a comment has the cells of a point."""
        text = head.decode("utf-8-sig", errors="replace")
        first = next((line for line in text.splitlines() if not _idle(line)), "")
        cells = _cells(first)
        return (_fits(cells) and all(map(is_number, cells[:7] + cells[8:12]))
                and not is_number(cells[7]))

    def read(self, path: Path) -> FeatureSet:
        """Return the points; errors name file, line and column."""
        points: list[tuple[int, list[str], dict[str, list[str]]]] = []
        for number, text in enumerate(read_text(path).splitlines(), 1):
            if _idle(text):
                continue
            cells = _cells(text)
            if not _fits(cells):
                raise TermselError(
                    f"the row has {len(cells)} cells, expected 7 and 5 for each image", file=path,
                    line=number, hint=f"Expected: {' '.join(_GROUND)}, then {' '.join(_IMAGE)}.")
            points.append((number, cells[:7], {
                cells[i]: cells[i + 1:i + 5] for i in range(7, len(cells), 5)}))
        if not points:
            raise TermselError("the file has no points", file=path,
                               hint="Add one row per point.")
        image = image_of(path, (name for _, _, images in points for name in images),
                         self.options["image_name"], "image_name=NAME")
        rows = [(number, *ground, image, *images[image])
                for number, ground, images in points if image in images]
        lines, *columns = zip(*rows, strict=True)
        cells_of = dict(zip(_GROUND + _IMAGE, columns, strict=True))
        table = Table(path, "", _READ, {key: cells_of[name] for key, name in _READ.items()},
                      lines)
        return FeatureSet(table.points(table.stack("line", "sample"), table.stack("x", "y", "z"),
                                       table.sigma("sigma_line", "sigma_sample"), ()), crs="")


def _idle(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith("#")


def _cells(line: str) -> list[str]:
    return [cell for cell in re.split(r"[\s,]+", line.strip()) if cell]


def _fits(cells: list[str]) -> bool:
    return len(cells) >= 12 and (len(cells) - 7) % 5 == 0
