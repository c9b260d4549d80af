"""Rough geometry of an image to start from: an RPC, a result, a few points, or nothing."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from termsel import (
    FeatureSet,
    Points,
    TermselError,
    fit,
    open_dem,
    open_raster,
    read,
    read_result,
    read_rpc,
)
from termsel.toolkit import say_difference, sentence_on_common_offset
from termsel.toolkit.coordinates import plane_transformer
from termsel_match.images.rasters import FloatArray

Heights = float | Callable[[FloatArray], FloatArray]

log = logging.getLogger("termsel.match")

_MIN_POINTS = 3
"""Number of points that determine an affine transformation."""

_BEYOND_RPC = 0.5
"""Distance of a DEM from the heights of an RPC, divided by their range, above which it is reported.
Vendors state the range with a margin."""

_FOOT = 0.3048
"""Length of a foot [m]."""

_PLACES_ALONG = 7
"""Number of positions along each side of an RPC's area at which a DEM is compared with it."""


@dataclass(frozen=True, eq=False)
class Start:
    """Rough geometry of an image.

    Parameters
    ----------
    description : str
        What the geometry is of, in words, such as "the RPC of scene.RPB".
    crs : str
        CRS of its ground coordinates.
    height : float
        Height of the ground that is taken where there is no DEM.
    project : callable
        Takes ground positions (n, 3), and returns line and sample, (n, 2).
    locate : callable
        Takes image positions (n, 2) and a height, or a function of plane positions (n, 2) that
        returns heights. Returns ground positions (n, 3).
    heights : tuple of float, optional
        Least and largest height that an RPC is made for [m].
    bias : float, optional
        Root mean square of the bias of an RPC [m], if its vendor states it.
    control : FeatureSet, optional
        Control features by which the geometry was fitted; a DEM is compared with their heights.
    places : ndarray, shape (n, 2), optional
        Longitudes and latitudes over the area that an RPC is made for.
    """

    description: str
    crs: str
    height: float
    project: Callable[[FloatArray], FloatArray]
    locate: Callable[[FloatArray, Heights], FloatArray]
    heights: tuple[float, float] | None = None
    bias: float | None = None
    control: FeatureSet | None = None
    places: FloatArray | None = None

    def warn_if_dem_contradicts(self, dem: Path | str | None) -> None:
        """Log a warning if a DEM contradicts the heights of the control, or those of an RPC."""
        if dem is None:
            return
        if self.places is not None:
            self._warn_if_dem_beyond_rpc(Path(dem), self.places)
        elif self.control is not None and np.isfinite(self.control.ground_vertices()[:, 2]).any():
            with open_dem(Path(dem), self.crs) as surface:
                say_difference(self.control, self.project, surface)

    def _warn_if_dem_beyond_rpc(self, dem: Path, places: FloatArray) -> None:
        """Log a warning if a DEM is far above or below the heights that the RPC is made for.

        Its median at `places` (n, 2), longitudes and latitudes, is compared with the range of the
        RPC's heights. Where the median in feet would be in that range, the warning says so.
        """
        assert self.heights is not None
        with open_dem(dem, self.crs) as surface:
            heights = surface(places)
        heights = heights[np.isfinite(heights)]
        if not len(heights):
            return
        low, high = self.heights
        median = float(np.median(heights))
        # Metres above the range, or below it with a negative sign; 0 within it.
        above = median - high if median > high else min(median - low, 0.0)
        if abs(above) > _BEYOND_RPC * (high - low):
            # A DEM in feet is read as if it were in metres.
            in_feet = low <= median * _FOOT <= high
            log.warning("Warning: %s", sentence_on_common_offset(
                above, f"the heights that {self.description} is made for",
                f"median {median:,.0f} m, {low:,.0f} to {high:,.0f} m", dem=dem.name,
                cause="feet and metres?" if in_feet else ""))


def transform_plane(plane: FloatArray, crs: str, to: str) -> FloatArray:
    """Return x and y, (..., 2), of the CRS `crs` in the CRS `to`; heights are not transformed."""
    turn = plane_transformer(crs, to)
    return np.stack(turn.transform(plane[..., 0], plane[..., 1]), axis=-1)


def start_of(named: str | Path | None, image: Path) -> Start | None:
    """Return the rough geometry of an image that a user names.

    Parameters
    ----------
    named : str or path, optional
        A file with an RPC, a folder with a result, a file of three points or more, "corners" for
        the GCPs or the geotransform of the image itself, or "none". By default the RPC in the image
        or next to it; without one, its GCPs or its geotransform.
    image : pathlib.Path
        The image.

    Returns
    -------
    Start or None
        None for "none", and by default if the image states nothing of its position.

    Raises
    ------
    TermselError
        If the name is none of these, or the file cannot be read.
    """
    if named is None:
        try:
            return _start_by_rpc(image)
        except TermselError:
            return _start_by_own_position(image)
    name = str(named)
    if name == "none":
        return None
    if name == "corners":
        position = _start_by_own_position(image)
        if position is None:
            raise TermselError("this image has neither GCPs nor a geotransform with a CRS",
                               file=image, hint="Give --start FILE with an RPC or with points.")
        return position
    path = Path(named)
    if path.is_dir():
        result = read_result(path)
        # Without a DEM, the ground is taken to be at the lowest height of the result's control.
        height = float(result.fit.ground_box()[0][2])
        return Start(f"the result in {path}", result.features.crs,
                     height if np.isfinite(height) else 0.0, result.project, result.locate,
                     control=result.features)
    try:
        return _start_by_rpc(path)
    except TermselError as error:
        if not path.is_file():
            raise
        # The file may be one of points, which has no RPC.
        reason = error
    try:
        return start_by_points(read(path), f"the points of {path.name}")
    except TermselError as error:
        # It is an RPC after all: why it could not be read is the error to report.
        if error.code == "rpc-alone":
            raise reason from error
        if error.code == "crs-unknown":
            raise TermselError(error.what, file=path, hint="Write it above the header of the file, "
                               "for example # crs: EPSG:32633.") from error
        raise


def _start_by_rpc(path: Path) -> Start:
    """Return the RPC of a file as a start, with the ground at the middle of the RPC's heights.

    Its `places` are 7 by 7 positions over the area that the RPC is made for. Raises TermselError
    if there is no RPC.
    """
    rpc = read_rpc(path)
    middle = rpc.ground_offset[2]
    half = abs(rpc.ground_scale[2])
    description = f"the RPC of {path.name}"
    if rpc.control_count:
        description += f", which termsel fitted to {rpc.control_count} control points"
    # An RPC is made for ground coordinates within offset +- scale.
    offsets = np.array(rpc.ground_offset[:2])
    steps = np.linspace(-1.0, 1.0, _PLACES_ALONG)
    shares = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    return Start(description, "EPSG:4979", middle, rpc.project, rpc.locate,
                 heights=(middle - half, middle + half), bias=rpc.error_bias,
                 places=offsets + shares * np.array(rpc.ground_scale[:2]))


def start_by_points(features: FeatureSet, description: str) -> Start:
    """Return an affine transformation by points as a start; heights of the points are not used.

    Raises
    ------
    TermselError
        If there are fewer than three points, or all lie on one straight line.
    """
    points = features.points
    if len(points) < _MIN_POINTS:
        raise TermselError(f"{description} are {len(points)}, and a start requires at least "
                           f"{_MIN_POINTS}",
                           hint="Add points, for example the corners of the image.")
    # With roles, only control points would be used.
    free = replace(features, points=replace(points, roles=()))
    fitted = fit(free, "poly2d", degree=1)
    heights = points.ground[:, 2]
    height = float(np.nanmean(heights)) if np.isfinite(heights).any() else 0.0
    return Start(description, features.crs, height, fitted.project, fitted.locate, control=features)


def _start_by_own_position(image: Path) -> Start | None:
    """Return the start by an image's own GCPs or geotransform.

    None if there is no geotransform and fewer than three GCPs, or no CRS.
    """
    with open_raster(image) as raster:
        gcps, crs = raster.gcps
        if not gcps and raster.crs is not None and not raster.transform.is_identity:
            crs = raster.crs
            last_line = raster.height - 1
            last_sample = raster.width - 1
            corners = [(0, 0), (0, last_sample), (last_line, 0), (last_line, last_sample)]
            # A geotransform counts from the corner of the first pixel, positions from its centre.
            positions = [(line, sample, *(raster.transform @ (sample + 0.5, line + 0.5)))
                         for line, sample in corners]
        else:
            # GCPs count from the corner of the first pixel, positions from its centre.
            positions = [(gcp.row - 0.5, gcp.col - 0.5, gcp.x, gcp.y) for gcp in gcps]
    if len(positions) < _MIN_POINTS or crs is None:
        return None
    values = np.array(positions)
    ground = np.column_stack([values[:, 2:], np.full(len(values), np.nan)])
    points = Points(tuple(map(str, range(len(values)))), values[:, :2], ground)
    return start_by_points(FeatureSet(points, crs=crs.to_wkt()),
                           f"the position that {image.name} states")
