"""What the Orfeo ToolBox takes from a raster, by its applications."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from termsel.toolkit import FloatArray
from termsel_formats.check.base import NoAnswer, Taken, answer, find_program
from termsel_formats.check.gdal import WGS84, Header

MOST_PLACES = 25
"""Places that OTB is asked for, each by a start of its application."""

_VALUE = re.compile(r"^([\w.]+): *(.*)$", re.MULTILINE)


def taken_by_otb(path: Path, raster_header: Header) -> Taken | None:
    """Return what OTB takes from a raster; None if OTB is not installed.

    It is an RPC, if OTB has one, or else the origin and spacing of the geotransform. `places` is
    None where its applications do not report the georeferencing, or not the rotation of it.

    Raises
    ------
    NoAnswer
        If OTB cannot read the raster or answers in another form, or the path has a question mark.
    """
    info, convert = map(find_program, ("otbcli_ReadImageInfo", "otbcli_ConvertSensorToGeoPoint"))
    if info is None or convert is None:
        return None
    # What follows a question mark in a name would be options of OTB, which may name other files.
    if "?" in str(path.absolute()):
        raise NoAnswer("OTB does not take a name with a question mark")
    name = "OTB"

    def places(image: FloatArray, _heights: FloatArray) -> FloatArray:
        """Return x and y (n, 2) of `MOST_PLACES` image positions by OTB's RPC; NaN of the others.

        They are spread evenly over the rows; heights are ignored.
        """
        ground = np.full((len(image), 2), np.nan)
        asked_rows = np.unique(np.linspace(0, len(image) - 1, MOST_PLACES).round().astype(int))
        for row in asked_rows.tolist():
            line, sample = image[row].tolist()
            # Whole numbers are the centres of pixels.
            values = dict(_VALUE.findall(answer(
                [convert, "-in", str(path.absolute()), "-input.idx", repr(sample),
                 "-input.idy", repr(line)])))
            try:
                ground[row] = float(values["output.idx"]), float(values["output.idy"])
            except (KeyError, ValueError):
                raise NoAnswer("otbcli_ConvertSensorToGeoPoint gave an answer of another form"
                               ) from None
        return ground

    values = dict(_VALUE.findall(answer([info, "-in", str(path.absolute())])))
    try:
        origin = np.array([float(values["originx"]), float(values["originy"])])
        spacing = np.array([float(values["spacingx"]), float(values["spacingy"])])
    except (KeyError, ValueError):
        raise NoAnswer("otbcli_ReadImageInfo gave an answer of another form") from None
    # Its application refuses rasters without an RPC, or with one that it does not know.
    try:
        places(np.zeros((1, 2)), np.zeros(1))
    except NoAnswer:
        pass
    else:
        return Taken(name, "RPC at the height 0", WGS84, places)
    # Without georeferencing OTB reports the centre of the first pixel at 0.5 and a spacing of 1.
    if np.allclose(origin, 0.5) and np.allclose(np.abs(spacing), 1.0):
        return Taken(name, "not reported by its applications")
    # Terms 2 and 4 of GDAL's geotransform are the rotation.
    if raster_header.geotransform and any(raster_header.geotransform[i] for i in (2, 4)):
        return Taken(name, "affine transformation, whose rotation it does not state")
    return Taken(name, "origin and spacing", raster_header.crs,
                 lambda image, _heights: origin + spacing * image[:, ::-1])
