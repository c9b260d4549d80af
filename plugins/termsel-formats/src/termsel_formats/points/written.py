"""What writers of control points share: which points, in which CRS, and how they are named."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np

from termsel import Option, Points, Result, TermselError, Writer
from termsel.toolkit import GDALWARP, LOCAL, horizontal, say_nearest, to_wgs84
from termsel_formats.points.common import utm

log = logging.getLogger("termsel.formats")

IMAGE = Option("image", None, "The image; its name is written into the file.")

_UTM = {utm(zone, south): (zone, south) for south in (False, True) for zone in range(1, 61)}


class PointsWriter(Writer):
    """Base of the formats of control points in a CRS of the Earth."""

    needs = "control points in a CRS of the Earth"

    def accepts(self, result: Result) -> bool:
        """Return True for control points in a CRS of the Earth."""
        return bool(len(result.fit.control.points)) and result.features.crs != LOCAL

    def require(self, result: Result, path: Path) -> None:
        """Refuse a result that this format does not hold."""
        if not self.accepts(result):
            raise TermselError(f"this result cannot be written as {self.name}", file=path,
                               hint=f"The format requires {self.needs}.")


def on_wgs84(points: Points, crs: str) -> tuple[Points, tuple[int, bool] | None]:
    """Return points in UTM on WGS84 as they are, others as longitude and latitude on WGS84.

    The second value is the zone, and whether it is in the south; None for longitude and latitude.
    """
    code = horizontal(crs)
    if code in _UTM:
        return points, _UTM[code]
    if code != "EPSG:4326":
        ground = to_wgs84(crs)(np.nan_to_num(points.ground))
        if not np.isfinite(ground).all():
            raise TermselError("some points have no longitude and latitude on WGS84",
                               hint="Check the CRS of the points.")
        points = replace(points, ground=ground)
    return points, None


def image_name(image: Path | str | None, path: Path) -> str:
    """Return the name of the image, by default that of the file with the ending .tif."""
    return Path(image).name if image is not None else f"{path.stem}.tif"


def say_by_gdal(name: str, result: Result, points: Points) -> None:
    """Log what gdalwarp makes of the points of a file."""
    say_nearest(name, result.fit, points.ground[:, :2], points.image, GDALWARP, "by gdalwarp {}")


def say_points(name: str) -> None:
    """Log that a file holds points and no model, so that nothing deviates."""
    log.info("%s holds the control points, not the model.", name)
