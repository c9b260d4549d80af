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

# Points that determine an affine transformation.
_MIN_POINTS = 3
# Part of the range of an RPC's heights beyond which no ground is.
_BEYOND_RPC = 0.5
_FOOT = 0.3048
# Places along each side of an RPC's area where a DEM is looked up.
_PLACES_ALONG = 7


@dataclass(frozen=True, eq=False)
class Start:
    """Rough geometry of an image.

    Parameters
    ----------
    description : str
        What it is, in words.
    crs : str
        Of its ground coordinates.
    height : float
        Of the ground, where there is no DEM.
    project : callable
        Line and sample (n, 2) of ground places (n, 3).
    locate : callable
        Ground places (n, 3) of image places (n, 2) and heights, or what gives them.
    heights : tuple of float, optional
        Least and largest height that an RPC is made for [m].
    bias : float, optional
        Root mean square of its bias [m], where its vendor states it.
    control : FeatureSet, optional
        What it was made from, whose heights a DEM is held against.
    places : ndarray, shape (n, 2), optional
        Longitudes and latitudes that an RPC is made for.
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
        """Warn where a DEM contradicts the heights of the control, or those of an RPC."""
        if dem is None:
            return
        if self.places is not None:
            self._warn_if_dem_beyond_rpc(Path(dem), self.places)
        elif self.control is not None and np.isfinite(self.control.ground_vertices()[:, 2]).any():
            with open_dem(Path(dem), self.crs) as surface:
                say_difference(self.control, self.project, surface)

    def _warn_if_dem_beyond_rpc(self, dem: Path, places: FloatArray) -> None:
        """Warn where a DEM lies far beyond the heights that an RPC is made for."""
        assert self.heights is not None
        with open_dem(dem, self.crs) as surface:
            heights = surface(places)
        heights = heights[np.isfinite(heights)]
        if not len(heights):
            return
        low, high = self.heights
        median = float(np.median(heights))
        above = median - high if median > high else min(median - low, 0.0)
        # Vendors state the range with a margin.
        if abs(above) > _BEYOND_RPC * (high - low):
            in_feet = low <= median * _FOOT <= high
            log.warning("Warning: %s", sentence_on_common_offset(
                above, f"the heights that {self.description} is made for",
                f"median {median:,.0f} m, {low:,.0f} to {high:,.0f} m", dem=dem.name,
                cause="feet and metres?" if in_feet else ""))


def transform_plane(plane: FloatArray, crs: str, to: str) -> FloatArray:
    """Return plane coordinates (..., 2), x and y, of a CRS in another one."""
    # Heights stay as they are: only the plane is transformed.
    turn = plane_transformer(crs, to)
    return np.stack(turn.transform(plane[..., 0], plane[..., 1]), axis=-1)


def start_of(named: str | Path | None, image: Path) -> Start | None:
    """Return the start that a user names; None for none.

    Parameters
    ----------
    named : str or path, optional
        A file with an RPC, a folder with a result, a file of three points or more, "corners" for
        what the image itself says of its position, or "none". By default the RPC of the image, or
        next to it, else its position, else none.
    image : pathlib.Path

    Raises
    ------
    TermselError
        If it is none of these, or cannot be read.
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
        # The lowest height of the result stands in where there is no DEM.
        height = float(result.fit.ground_box()[0][2])
        return Start(f"the result in {path}", result.features.crs,
                     height if np.isfinite(height) else 0.0, result.project, result.locate,
                     control=result.features)
    try:
        return _start_by_rpc(path)
    except TermselError as error:
        if not path.is_file():
            raise
        # It may be a file of points: then that it has no RPC is no error.
        reason = error
    try:
        return start_by_points(read(path), f"the points of {path.name}")
    except TermselError as error:
        # But one that cannot be read.
        if error.code == "rpc-alone":
            raise reason from error
        if error.code == "crs-unknown":
            raise TermselError(error.what, file=path, hint="Write it above the header of the file, "
                               "for example # crs: EPSG:32633.") from error
        raise


def _start_by_rpc(path: Path) -> Start:
    """Return the start that is the RPC of a file, at the middle of its heights.

    Its places are a lattice over the area of the RPC. Raises TermselError if there is no RPC.
    """
    rpc = read_rpc(path)
    middle = rpc.ground_offset[2]
    half = abs(rpc.ground_scale[2])
    description = f"the RPC of {path.name}"
    if rpc.control_count:
        description += f", which termsel fitted to {rpc.control_count} control points"
    offsets = np.array(rpc.ground_offset[:2])
    steps = np.linspace(-1.0, 1.0, _PLACES_ALONG)
    shares = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    return Start(description, "EPSG:4979", middle, rpc.project, rpc.locate,
                 heights=(middle - half, middle + half), bias=rpc.error_bias,
                 places=offsets + shares * np.array(rpc.ground_scale[:2]))


def start_by_points(features: FeatureSet, description: str) -> Start:
    """Return an affine transformation by points, whose heights are not used.

    Raises
    ------
    TermselError
        If they are fewer than three, or on one straight line.
    """
    points = features.points
    if len(points) < _MIN_POINTS:
        raise TermselError(f"{description} are {len(points)}, and a start requires at least "
                           f"{_MIN_POINTS}",
                           hint="Add points, for example the corners of the image.")
    # Roles would leave out points for check; a start uses all.
    free = replace(features, points=replace(points, roles=()))
    fitted = fit(free, "poly2d", degree=1)
    heights = points.ground[:, 2]
    height = float(np.nanmean(heights)) if np.isfinite(heights).any() else 0.0
    return Start(description, features.crs, height, fitted.project, fitted.locate, control=features)


def _start_by_own_position(image: Path) -> Start | None:
    """Return the start by an image's own GCPs or geotransform; None if they are too few.

    None without a CRS, too.
    """
    with open_raster(image) as raster:
        gcps, crs = raster.gcps
        if not gcps and raster.crs is not None and not raster.transform.is_identity:
            crs = raster.crs
            last_line = raster.height - 1
            last_sample = raster.width - 1
            corners = [(0, 0), (0, last_sample), (last_line, 0), (last_line, last_sample)]
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
