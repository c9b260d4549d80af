"""A set of the benchmark, and its text, which the checksum is of."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

import numpy as np

from termsel import FeatureSet, Lines, Points, Rpc
from termsel.toolkit import FloatArray, rpc_txt_text

INDEPENDENT = 1000
"""Independent points of a simulated set."""

PIXELS, METRES, DEGREES = 3, 3, 9
"""Decimals of image positions, of metres and of degrees."""

COEFFICIENTS = 9
"""Decimals of coefficients of RPCs: what least squares leave differs by less between machines."""

LINE_COLUMNS = ("id", "line1", "sample1", "line2", "sample2", "x1", "y1", "z1", "x2", "y2", "z2")
"""Columns of a table of lines: two ends in the image, and two on the ground."""

_ROUNDED_OF_RPC = ("image_offset", "image_scale", "ground_offset", "ground_scale", "line_numerator",
                   "line_denominator", "sample_numerator", "sample_denominator")


@dataclass(frozen=True, eq=False)
class BenchSet:
    """What a method sees of a set, and what it is judged by.

    Parameters
    ----------
    name, kind : str
    features : FeatureSet
        Control and selection points, lines, the RPC: all that a method sees.
    independent : Points
        Independent check points; without noise where they are simulated.
    licence, source : str
        Licence and source of a real set; "" for a simulated one.
    """

    name: str
    kind: str
    features: FeatureSet
    independent: Points
    licence: str = ""
    source: str = ""

    def files(self) -> dict[str, str]:
        """Return the texts of the set's files by their names.

        They are a table of points, and a table of lines and an RPC if the set has them. Tables
        begin with the names of their columns, as the readers of Croissant expect; `crs_files` has
        what says their CRS.
        """
        texts = {f"{self.name}.csv": _encode_text(
            "id,role,line,sample,x,y,z",
            [*_scene_rows(self.features.points, self),
             *_scene_rows(self.independent, self, "independent")])}
        lines = self.features.lines
        if len(lines):
            rows = []
            for name, image, ground in zip(lines.ids, lines.image, lines.ground, strict=True):
                vertices = chain.from_iterable(_place(vertex, self) for vertex in ground)
                rows.append((name, *_format_numbers(image.ravel(), PIXELS), *vertices))
            texts[f"{self.name}-lines.csv"] = _encode_text(",".join(LINE_COLUMNS), rows)
        if self.features.rpc is not None:
            texts[f"{self.name}_RPC.TXT"] = rpc_txt_text(self.features.rpc)
        return texts

    def crs_files(self) -> dict[str, str]:
        """Return the text of the .prj file next to each table, by its name: the CRS."""
        return {file.removesuffix(".csv") + ".prj": f"{self.features.crs}\n"
                for file in self.files() if file.endswith(".csv")}

    def checksums(self) -> dict[str, str]:
        """Return the SHA-256 of each file by its name."""
        return {name: hashlib.sha256(text.encode()).hexdigest()
                for name, text in self.files().items()}

    @property
    def geographic(self) -> bool:
        """Whether ground coordinates are degrees."""
        return self.features.crs in ("EPSG:4979", "EPSG:4326")


def means_of(text: str) -> tuple[list[float], list[float]]:
    """Return the means of the columns of numbers of a file, and the units of their last decimals.

    The file of an RPC has one mean, of all its numbers; blank heights count as 0.
    """
    # Tables of points and lines begin with a column of names, the text of an RPC does not.
    if not text.startswith("id,"):
        return [float(np.mean([float(row.split()[1]) for row in text.splitlines()]))], [1e-5]
    # The first line names the columns; numbers begin with the line.
    header, *rows = [row.split(",") for row in text.splitlines()]
    first = [name.startswith("line") for name in header].index(True)
    cells = np.array([row[first:] for row in rows])
    values = np.where(cells == "", "0", cells).astype(float)
    return values.mean(axis=0).tolist(), [
        10.0 ** -len(cell.partition(".")[2]) for cell in rows[0][first:]]


def round_to_files(bench_set: BenchSet) -> BenchSet:
    """Return a set with all numbers rounded to the decimals that its files have.

    Simulations differ by the rounding of machines, and files do not.
    """
    def round_ground(ground: FloatArray) -> FloatArray:
        """Return ground coordinates (..., 3) with the decimals of degrees or metres."""
        plane = DEGREES if bench_set.geographic else METRES
        return np.concatenate([ground[..., :2].round(plane), ground[..., 2:].round(METRES)], -1)

    def round_points(points: Points) -> Points:
        """Return points with the decimals of image and ground coordinates in files."""
        return replace(points, image=points.image.round(PIXELS),
                       ground=round_ground(points.ground))

    lines = bench_set.features.lines
    features = replace(
        bench_set.features, points=round_points(bench_set.features.points),
        lines=Lines(lines.ids, lines.image.round(PIXELS), round_ground(lines.ground)))
    if bench_set.features.rpc is not None:
        features = replace(features, rpc=_rounded_rpc(bench_set.features.rpc))
    return replace(bench_set, features=features, independent=round_points(bench_set.independent))


def _rounded_rpc(rpc: Rpc) -> Rpc:
    """Return an RPC with its offsets, scales and coefficients rounded to the decimals of a file."""
    def rounded(numbers: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(float(round(number, COEFFICIENTS)) for number in numbers)

    fields: dict[str, Any] = {name: rounded(getattr(rpc, name)) for name in _ROUNDED_OF_RPC}
    return replace(rpc, **fields)


def _encode_text(header: str, rows: list[tuple[str, ...]]) -> str:
    """Return the lines of a CSV: the header and the rows."""
    return "\n".join([header, *(",".join(row) for row in rows)]) + "\n"


def _scene_rows(points: Points, bench_set: BenchSet, role: str = "") -> Iterator[tuple[str, ...]]:
    """Yield the cells of each point; `role`, if given, is that of all."""
    for name, own_role, image, ground in zip(points.ids, points.roles, points.image, points.ground,
                                             strict=True):
        yield (name, role or own_role, *_format_numbers(image, PIXELS), *_place(ground, bench_set))


def _place(ground: FloatArray, bench_set: BenchSet) -> tuple[str, ...]:
    """Return the coordinates of a place as text: degrees or metres, and "" for an unknown height.
    """
    return (*_format_numbers(ground[:2], DEGREES if bench_set.geographic else METRES),
            *("" if np.isnan(z) else f"{z:.{METRES}f}" for z in ground[2:]))


def _format_numbers(values: FloatArray, decimals: int) -> tuple[str, ...]:
    """Return numbers with so many decimals as text, zero without a sign."""
    # Adding 0 removes the sign of a negative zero.
    return tuple(f"{value + 0.0:.{decimals}f}" for value in values)
