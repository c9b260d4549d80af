"""What writers of control points share: which points, in which CRS, and how they are named."""

from __future__ import annotations

import logging
import re
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from termsel import Option, Points, Result, TermselError, Writer
from termsel.toolkit import FloatArray
from termsel.toolkit.coordinates import LOCAL, horizontal_crs, to_wgs84
from termsel.toolkit.files import GDALWARP, say_nearest_transformation
from termsel_formats.points.common import utm_crs

log = logging.getLogger("termsel.formats")

IMAGE_OPTION = Option("image", None, "The image; its name is written into the file.")

_UTM = {utm_crs(zone, south): (zone, south) for zone, south in product(range(1, 61), (False, True))}


class PointsWriter(Writer):
    """Base of the formats of control points in a CRS of the Earth."""

    needs = "control points in a CRS of the Earth"

    def accepts(self, result: Result) -> bool:
        """Return True for control points in a CRS of the Earth."""
        return bool(len(result.fit.control.points)) and result.features.crs != LOCAL

    def require(self, result: Result, path: Path) -> None:
        """Raise TermselError for a result that this format does not hold."""
        if not self.accepts(result):
            raise TermselError(f"this result cannot be written as {self.name}", file=path,
                               hint=f"The format requires {self.needs}.")


@dataclass(frozen=True)
class CheckedPoints:
    """The points of a result without its blunders.

    Parameters
    ----------
    points : Points
        Control and check points.
    is_check : tuple of bool
        Whether each is an independent check point, which took no part in any choice.
    left_out : tuple of str
        Each point that is not among them, with the reason.
    """

    points: Points
    is_check: tuple[bool, ...]
    left_out: tuple[str, ...]

    def without_checks(self) -> CheckedPoints:
        """Return the control alone; check points are added to those left out."""
        is_control = np.logical_not(np.array(self.is_check, dtype=np.bool_))
        checks = tuple(f"{name} (check point)" for name, is_check in zip(
            self.points.ids, self.is_check, strict=True) if is_check)
        control = self.points.take(is_control)
        return CheckedPoints(control, (False,) * len(control), (*self.left_out, *checks))


def points_for_others(result: Result, *, with_heights: bool = False) -> CheckedPoints:
    """Return the points that other programs may take: control points and check points.

    Certain and probable blunders are left out, possible ones only if they were excluded from the
    fit. Points that are off are left out and, with `with_heights`, those of unknown height.
    """
    points = result.features.points
    role_of = {residual.id: residual.role for residual in result.residuals
               if residual.kind == "point"}
    reason_of_id: dict[str, str] = {}
    # A point that is a blunder, too, gets that as its reason in the second loop.
    for name, role, height in zip(points.ids, points.roles, points.ground[:, 2], strict=True):
        if role == "off" or name not in role_of:
            reason_of_id[name] = "off"
        elif with_heights and np.isnan(height):
            reason_of_id[name] = "no height"
    for outlier in result.outliers:
        if outlier.kind == "point" and (outlier.excluded or outlier.certainty != "possible"):
            reason_of_id[outlier.id] = f"blunder of {outlier.error:,.2f} px"
    is_written = np.array([name not in reason_of_id for name in points.ids], dtype=np.bool_)
    written = points.take(is_written)
    return CheckedPoints(written, tuple(role_of[name] == "independent" for name in written.ids),
                         tuple(f"{name} ({reason})" for name, reason in reason_of_id.items()))


def require_points(checked: CheckedPoints, path: Path, needs: str) -> None:
    """Raise TermselError, with the reason why each point was left out, if none is to be written."""
    if not len(checked.points):
        raise TermselError(f"no point of this result can be written: {', '.join(checked.left_out)}",
                           file=path, hint=f"The format requires {needs}.")


def say_checked(name: str, checked: CheckedPoints) -> None:
    """Log the numbers of control and check points in a file, and which points were left out."""
    checks = sum(checked.is_check)
    control = len(checked.is_check) - checks
    log.info("%s holds %d control and %d check points, not the model. Left out: %s.", name,
             control, checks, ", ".join(checked.left_out) or "none")


def image_in_one_cell(image: Path | str | None, path: Path, signs: str, signs_in_words: str) -> str:
    """Return the name of an image (see `image_name`) with _ in place of some signs.

    `signs` is what a regular expression has between brackets: what separates the cells of a file.
    A note is logged where the name is changed, as a program will look for an image of that name.
    """
    name = image_name(image, path)
    changed = re.sub(f"[{signs}]+", "_", name)
    if changed != name:
        log.warning("Note: %s calls the image '%s' %s, as names have no %s there. Rename the "
                    "image, so that it is found.", path.name, name, changed, signs_in_words)
    return changed


def image_sigma(points: Points, result: Result) -> FloatArray:
    """Return the standard deviations of line and sample (n, 2) [px].

    They are those of the points if they have some, else those that the result predicts, and 1 px
    if its prediction is missing, zero or not finite.
    """
    if points.sigma is not None:
        return points.sigma
    predicted = result.predicted
    # The predicted RMSE is of both axes together: RMSE^2 = 2 sigma^2.
    axis_sigma = predicted.rmse / np.sqrt(2.0) if predicted is not None else 1.0
    if not np.isfinite(axis_sigma) or axis_sigma <= 0.0:
        axis_sigma = 1.0
    return np.full(points.image.shape, axis_sigma)


def to_wgs84_points(points: Points, crs: str) -> tuple[Points, tuple[int, bool] | None]:
    """Return points in UTM on WGS84 as they are, others with longitude and latitude on WGS84.

    The second value is the zone of UTM and whether it is in the south; None for longitude and
    latitude. Raises TermselError if a point has none.
    """
    code = horizontal_crs(crs)
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
    """Return the name of `image` without its folder; if it is None, that of `path` with .tif.

    In that case a note is logged.
    """
    if image is not None:
        return Path(image).name
    # Programs look for an image of this name, so that a guess must not go unnoticed.
    name = f"{path.stem}.tif"
    log.warning("Note: %s calls the image %s, as nothing states its name: --image FILE does.",
                path.name, name)
    return name


def say_by_gdal(name: str, result: Result, points: Points) -> None:
    """Log what gdalwarp makes of the points of a file."""
    say_nearest_transformation(name, result.fit, points.ground[:, :2], points.image, GDALWARP,
                               "by gdalwarp {}")


def say_points(name: str) -> None:
    """Log that a file holds points and no model, so that nothing deviates."""
    log.info("%s contains the control points, not the model.", name)
