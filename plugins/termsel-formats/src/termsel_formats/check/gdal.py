"""What GDAL takes from a raster, by its command line."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from termsel.toolkit import FloatArray
from termsel_formats.check.base import NONE, NoAnswer, Places, Taken, answer, find_program

WGS84 = "EPSG:4326"
# Difference of two transformations that are the same, as a share of the coordinates: rounding.
_SAME_SHARE = 1e-9
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
        Version of GDAL.
    size : tuple of int
        Lines and samples.
    crs : str
        WKT of what GDAL takes; "" for none.
    kind : str
        "geotransform", "gcps", "rpc", "geolocation" or "" for none.
    geotransform : tuple of float or None
    height : float or None
        The height offset of its RPC [m].
    with_rpc : bool
        Whether it has an RPC, which GDAL takes by the option ``-rpc`` where `kind` is another.
    """

    version: str
    size: tuple[int, int]
    crs: str
    kind: str
    geotransform: tuple[float, ...] | None
    height: float | None = None
    with_rpc: bool = False


def read_gdalinfo(path: Path) -> Header | None:
    """Return what gdalinfo says of a raster.

    None if gdalinfo is not installed, or gdaltransform, by which positions are asked for.

    Raises
    ------
    NoAnswer
        If GDAL cannot read the raster.
    """
    program = find_program("gdalinfo")
    if program is None or find_program("gdaltransform") is None:
        return None
    version = answer([program, "--version"]).partition(",")[0]
    description: dict[str, Any] = json.loads(answer(
        [program, "-json", "-mdd", "RPC", "-mdd", "GEOLOCATION", "-norat", "-noct",
         str(path.absolute())]))
    samples, lines = description["size"]
    crs = description.get("coordinateSystem", {}).get("wkt", "")
    metadata = description.get("metadata", {})
    kind = ""
    # The order in which GDAL's transformer looks for them.
    if "geoTransform" in description:
        kind = "geotransform"
    elif "gcps" in description:
        kind = "gcps"
        crs = description["gcps"].get("coordinateSystem", {}).get("wkt", "")
    elif "RPC" in metadata:
        kind = "rpc"
        crs = WGS84
    elif "GEOLOCATION" in metadata:
        kind = "geolocation"
        crs = metadata["GEOLOCATION"].get("SRS", crs)
    geotransform = description.get("geoTransform")
    height = _number(metadata.get("RPC", {}).get("HEIGHT_OFF", "")) if kind == "rpc" else None
    return Header(version, (lines, samples), crs, kind,
                  tuple(geotransform) if geotransform else None, height, "RPC" in metadata)


def transformation_of_gdal(path: Path, *options: str) -> Places:
    """Return the function from image positions and heights to the ground, by gdaltransform.

    `options` are those of gdaltransform; the function raises NoAnswer if that fails.
    """
    program = find_program("gdaltransform") or "gdaltransform"

    def transform(image: FloatArray, heights: FloatArray) -> FloatArray:
        """Return x and y (n, 2) of image positions (n, 2) at heights (n,); NaN where it fails."""
        # GDAL counts pixels from the corner of the first one.
        rows = (f"{sample + 0.5!r} {line + 0.5!r} {height!r}"
                for (line, sample), height in zip(image.tolist(), heights.tolist(), strict=True))
        text = answer([program, *options, str(path.absolute())], "\n".join(rows) + "\n")
        pairs = [_parse_pair(row) for row in text.splitlines()]
        if len(pairs) != len(image):
            raise NoAnswer(f"gdaltransform answered {len(pairs)} of {len(image)} places")
        return np.array(pairs)

    return transform


def _parse_pair(row: str) -> tuple[float, float]:
    """Return x and y of a row of gdaltransform; NaN if it says that the transformation failed."""
    try:
        x, y = map(float, row.split()[:2])
    except ValueError:
        return np.nan, np.nan
    return x, y


def _number(text: str) -> float | None:
    """Return the number at the beginning of a text, which a unit may follow; None without one."""
    try:
        return float(text.split()[0])
    except (ValueError, IndexError):
        return None


def with_fixed_height(transform: Places, height: float = 0.0) -> Places:
    """Return a transformation that takes all positions at one height, whatever heights it is given.
    """
    return lambda image, _heights: transform(image, np.full(len(image), height))


def taken_by_gdal(path: Path, raster_header: Header) -> Iterator[Taken]:
    """Yield what GDAL takes of a raster by default, then what it takes with options of gdalwarp.

    What it takes with an option has `by_default` False, and the option, indented, as its `program`.
    Raises NoAnswer where gdaltransform fails on a raster with GCPs.
    """
    program = raster_header.version
    transform = transformation_of_gdal(path)
    if not raster_header.kind:
        yield Taken(program, NONE)
    elif raster_header.kind == "geotransform":
        yield Taken(program, "affine transformation", raster_header.crs, transform)
    elif raster_header.kind == "geolocation":
        yield Taken(program, "geolocation array", raster_header.crs, transform)
    elif raster_header.kind == "rpc":
        # gdalwarp knows no heights of the ground: without a DEM it takes an RPC at the height 0
        # (RPC_HEIGHT), whatever the height of the scene.
        yield Taken(program, "RPC at the height 0", WGS84, with_fixed_height(transform))
        yield Taken("  with -to RPC_DEM", "RPC at the heights of the ground", WGS84, transform,
                    False)
    else:
        with_options = dict(_possible_by_gcps(path, raster_header))
        # A transformation through GCPs does not depend on heights.
        default = with_fixed_height(transform)
        yield Taken(program, _name_default(default, with_options, raster_header.size),
                    raster_header.crs, default)
        for words, (options, by_option) in with_options.items():
            yield Taken(f"  with {' '.join(options)}", words, raster_header.crs, by_option, False)
    if raster_header.with_rpc and raster_header.kind != "rpc":
        by_rpc = transformation_of_gdal(path, "-rpc")
        yield Taken("  with -rpc", "RPC at the height 0", WGS84, with_fixed_height(by_rpc), False)
        yield Taken("  with -rpc -to RPC_DEM", "RPC at the heights of the ground", WGS84, by_rpc,
                    False)


def _possible_by_gcps(path: Path, raster_header: Header,
                      ) -> Iterator[tuple[str, tuple[tuple[str, ...], Places]]]:
    """Yield (words, (options, transformation)) for each transformation through the GCPs.

    Transformations for which there are too few GCPs are left out.
    """
    for words, options in _BY_GCPS:
        transform = with_fixed_height(transformation_of_gdal(path, *options))
        # With too few GCPs gdaltransform fails, or its answers are no numbers.
        try:
            is_determined = np.isfinite(
                transform(_corner_pixels(raster_header.size), np.zeros(4))).all()
        except NoAnswer:
            continue
        if is_determined:
            yield words, (options, transform)


def _name_default(default: Places, with_options: dict[str, tuple[tuple[str, ...], Places]],
                  size: tuple[int, int]) -> str:
    """Return the words for the transformation with options that the default one equals.

    They are compared at the corners of the image. If it equals none, the words are "transformation
    through GCPs".
    """
    # GDAL does not say which transformation it takes by default.
    image = _corner_pixels(size)
    flat = np.zeros(4)
    by_default = default(image, flat)
    for words, (_, transform) in with_options.items():
        difference = np.abs(transform(image, flat) - by_default).max()
        if difference <= _SAME_SHARE * np.abs(by_default).max():
            return words
    return "transformation through GCPs"


def _corner_pixels(size: tuple[int, int]) -> FloatArray:
    """Return line and sample (4, 2) of the corner pixels of an image."""
    lines, samples = (float(length) - 1.0 for length in size)
    return np.array([[0.0, 0.0], [0.0, samples], [lines, samples], [lines, 0.0]])


def border_places(size: tuple[int, int], across: int = 21) -> FloatArray:
    """Return line and sample (n, 2) of positions along the outer border of an image.

    `size` is lines and samples; there are `across` positions on each side, corners included.
    """
    shares = np.linspace(0.0, 1.0, across)
    zeros = np.zeros_like(shares)
    ones = np.ones_like(shares)
    borders = [np.column_stack([zeros, shares]), np.column_stack([ones, shares]),
               np.column_stack([shares, zeros]), np.column_stack([shares, ones])]
    # The border is half a pixel outside the centres of the outermost pixels.
    return np.asarray(np.concatenate(borders) * size - 0.5)
