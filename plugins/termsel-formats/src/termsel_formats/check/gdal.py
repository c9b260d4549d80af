"""What GDAL takes from a raster, by its command line."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from termsel.toolkit import FloatArray
from termsel_formats.check.base import NoAnswer, Places, Taken, answer, installed

WGS84 = "EPSG:4326"
_ALIKE = 1e-9  # of the size of the coordinates
_BY_GCPS = (("polynomial of order 1 through GCPs", ("-order", "1")),
            ("polynomial of order 2 through GCPs", ("-order", "2")),
            ("polynomial of order 3 through GCPs", ("-order", "3")),
            ("thin plate spline through GCPs", ("-tps",)))


@dataclass(frozen=True, eq=False)
class Header:
    """What gdalinfo says of a raster.

    Parameters
    ----------
    version : str
        Of GDAL.
    size : tuple of int
        Lines and samples.
    crs : str
        WKT of what GDAL takes; "" for none.
    kind : str
        "geotransform", "gcps", "rpc", "geolocation" or "" for none.
    geotransform : tuple of float or None
    height : float or None
        The height offset of its RPC [m].
    """

    version: str
    size: tuple[int, int]
    crs: str
    kind: str
    geotransform: tuple[float, ...] | None
    height: float | None = None


def header(path: Path) -> Header | None:
    """Return what gdalinfo says of a raster, or None where it is not installed.

    Raises
    ------
    NoAnswer
        If GDAL cannot read the raster.
    """
    program = installed("gdalinfo")
    if program is None or installed("gdaltransform") is None:
        return None
    version = answer([program, "--version"]).partition(",")[0]
    said: dict[str, Any] = json.loads(answer(
        [program, "-json", "-mdd", "RPC", "-mdd", "GEOLOCATION", "-norat", "-noct",
         str(path.absolute())]))
    samples, lines = said["size"]
    crs = said.get("coordinateSystem", {}).get("wkt", "")
    metadata = said.get("metadata", {})
    kind = ""
    # The order in which GDAL's transformer looks for them.
    if "geoTransform" in said:
        kind = "geotransform"
    elif "gcps" in said:
        kind = "gcps"
        crs = said["gcps"].get("coordinateSystem", {}).get("wkt", "")
    elif "RPC" in metadata:
        kind = "rpc"
        crs = WGS84
    elif "GEOLOCATION" in metadata:
        kind = "geolocation"
        crs = metadata["GEOLOCATION"].get("SRS", crs)
    given = said.get("geoTransform")
    height = _number(metadata.get("RPC", {}).get("HEIGHT_OFF", "")) if kind == "rpc" else None
    return Header(version, (lines, samples), crs, kind, tuple(given) if given else None, height)


def transformed(path: Path, *options: str) -> Places:
    """Return what gdaltransform computes with options."""
    program = installed("gdaltransform") or "gdaltransform"

    def places(image: FloatArray, heights: FloatArray) -> FloatArray:
        # GDAL counts pixels from the corner of the first one.
        rows = (f"{sample + 0.5!r} {line + 0.5!r} {height!r}" for (line, sample), height
                in zip(image.tolist(), heights.tolist(), strict=True))
        said = answer([program, *options, str(path.absolute())], "\n".join(rows) + "\n")
        found = [_pair(row) for row in said.splitlines()]
        if len(found) != len(image):
            raise NoAnswer(f"gdaltransform answered {len(found)} of {len(image)} places")
        return np.array(found)

    return places


def _pair(row: str) -> tuple[float, float]:
    """Return x and y of a row of gdaltransform, which may say that the transformation failed."""
    try:
        x, y = map(float, row.split()[:2])
    except ValueError:
        return np.nan, np.nan
    return x, y


def _number(text: str) -> float | None:
    """Return the number at the beginning of a text, which a unit may follow."""
    try:
        return float(text.split()[0])
    except (ValueError, IndexError):
        return None


def level(places: Places, height: float = 0.0) -> Places:
    """Return places at one height, whatever the heights."""
    return lambda image, _heights: places(image, np.full(len(image), height))


def taken(path: Path, found: Header) -> Iterator[Taken]:
    """Yield what GDAL takes by default, then what it takes with options of gdalwarp."""
    program = found.version
    places = transformed(path)
    if not found.kind:
        yield Taken(program, "none: no georeferencing")
    elif found.kind == "geotransform":
        yield Taken(program, "affine transformation", found.crs, places)
    elif found.kind == "geolocation":
        yield Taken(program, "geolocation array", found.crs, places)
    elif found.kind == "rpc":
        yield Taken(program, "RPC at the height 0", WGS84, level(places))
        yield Taken("  with -to RPC_DEM", "RPC at the heights of the ground", WGS84, places, False)
    else:
        others = dict(_possible(path, found))
        yield Taken(program, _alike(level(places), others, found.size), found.crs, level(places))
        for words, (options, other) in others.items():
            yield Taken(f"  with {' '.join(options)}", words, found.crs, other, False)


def _possible(path: Path, found: Header) -> Iterator[tuple[str, tuple[tuple[str, ...], Places]]]:
    """Yield the transformations that GDAL can compute through the GCPs, with their options."""
    for words, options in _BY_GCPS:
        places = level(transformed(path, *options))
        try:
            known = np.isfinite(places(_corners(found.size), np.zeros(4))).all()
        except NoAnswer:  # too few GCPs
            continue
        if known:
            yield words, (options, places)


def _alike(places: Places, others: dict[str, tuple[tuple[str, ...], Places]],
           size: tuple[int, int]) -> str:
    """Return which of the transformations with options is the one without."""
    image = _corners(size)
    flat = np.zeros(4)
    own = places(image, flat)
    for words, (_, other) in others.items():
        if np.abs(other(image, flat) - own).max() <= _ALIKE * np.abs(own).max():
            return words
    return "transformation through GCPs"


def _corners(size: tuple[int, int]) -> FloatArray:
    lines, samples = (float(side) - 1.0 for side in size)
    return np.array([[0.0, 0.0], [0.0, samples], [lines, samples], [lines, 0.0]])


def outline(size: tuple[int, int], across: int = 21) -> FloatArray:
    """Return places along the outer border of an image, line and sample (n, 2)."""
    share = np.linspace(0.0, 1.0, across)
    sides = [np.column_stack(pair) for pair in (
        (0 * share, share), (0 * share + 1, share), (share, 0 * share), (share, 0 * share + 1))]
    return np.asarray(np.concatenate(sides) * size - 0.5)
