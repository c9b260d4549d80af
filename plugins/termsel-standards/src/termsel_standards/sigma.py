"""The uncertainty of a model as a raster: exact on a grid of nodes, interpolated between them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from termsel import Result, TermselError, open_raster, require_replaceable
from termsel.toolkit import FloatArray, picture_for, say_difference
from termsel.toolkit.coordinates import (
    horizontal_crs,
    is_geographic,
    nearest_longitudes,
    offsets_in_metres,
    plane_transformer,
    turn_of,
)
from termsel.toolkit.files import MapGrid, accuracy_tags, grid_of_image, map_crs, surface_of
from termsel.toolkit.models import (
    FAR_OUTSIDE,
    distance_outside_control,
    require_tiff_name,
    write_cog,
)

log = logging.getLogger(__name__)

BANDS = (("line", "px"), ("sample", "px"), ("east", "m"), ("north", "m"), ("outside", "1 or 0"))
"""Bands of the raster, and their units."""

TOLERANCE = 0.01
"""Relative error of the interpolation below which the grid is made no finer."""

_INCLUDED = ("the model's coefficients and of what it does not fit, without the errors of heights "
             "and of control on the ground")

# Intervals of the coarsest and the finest grid along either side.
_MIN_INTERVALS, _MAX_INTERVALS = 9, 129
# Intervals of the grid between the least and the largest height.
_N_LEVELS = 12
# Nodes of the grid beyond each of its sides, as a spline is less exact near its ends.
_N_NODES_BEYOND = 4
# Places at which a grid is tested.
_N_TESTED = 400
# Pixels of a raster along its longer side by default.
_USUAL_SIDE = 500
# Most pixels of a raster along either side.
_MAX_SIDE = 2e4
# Half the distance on the ground of places whose difference is a derivative, as a share of half the
# extent of the control.
_STEP = 1e-4


def write_sigma(
    result: Result,
    output: Path | str,
    *,
    image: Path | str | None = None,
    like_map: Path | str | None = None,
    bounds: Sequence[float] | None = None,
    resolution: float | None = None,
    crs: str | None = None,
    dem: Path | str | None = None,
    height: float | None = None,
    final: bool | None = None,
    overwrite: bool = False,
    progress: Callable[[float], None] | None = None,
) -> float:
    """Write standard deviations of a model all over a map as a cloud-optimised GeoTIFF.

    The bands are those of `BANDS`. Line and sample are what `termsel.Result.sigma` says; east and
    north are these on the ground at a fixed height, line and sample taken as independent. `outside`
    is 1 outside the hull of the control, or above or below its heights, and 0 inside.

    Parameters
    ----------
    result : Result
        As `termsel.run` returns it.
    output : path-like
        The GeoTIFF to write.
    image : path-like, optional
        The image, where the result does not know its size: the raster covers what it shows.
    like_map : path-like, optional
        A map whose extent and CRS the raster has, instead of bounds and CRS.
    bounds : sequence of float, optional
        West, south, east and north in the CRS of the raster; by default those of what the image
        shows. Without effect with `like_map`.
    resolution : float, optional
        Size of a pixel [units of the CRS]; by default such that the longer side has about 500.
    crs : str, optional
        As for `termsel.rectify`.
    dem : path-like, optional
        Raster of heights. Its vertical datum is that of the control where it declares none, else
        it is converted to that.
    height : float, optional
        Height of the ground, where no raster is given; by default that of the middle of the
        control.
    final : bool, optional
        As for `termsel.export`.
    overwrite : bool
        Whether a file that is there may be replaced.
    progress : callable, optional
        Called with the fraction that is done, 0 to 1.

    Returns
    -------
    float
        Largest relative error of the interpolation at the places where it was tested. It is logged
        with the size of the raster, and as a note if it is above `TOLERANCE`.

    Raises
    ------
    TermselError
        If a file cannot be read or written, if height, resolution or extent are none, if the raster
        would be too large, or if the map has no heights, is far outside the control, or the
        uncertainty is known nowhere on it.

    Examples
    --------
    >>> import termsel
    >>> from termsel_standards import write_sigma
    >>> result = termsel.run("poly-terms", evaluations=200, options={"degree": 2})
    >>> error = write_sigma(result, "sigma.tif", crs="EPSG:32639", resolution=100.0,
    ...                     bounds=(269_000, 3_850_000, 274_000, 3_855_000))
    >>> round(error, 2)  # as a part of the uncertainty
    0.08
    """
    output = Path(output)
    require_tiff_name(output)
    require_replaceable([output], reads=[image, like_map, dem], overwrite=overwrite)
    if height is not None and not isfinite(height):
        raise TermselError(f"the height of a map cannot be {height}", hint="Give a number.")
    # The tags state the accuracy of the run, the bands are of the fit that is exported.
    result_of_run = result
    result = result.as_exported(final)
    if image is not None:
        result = result.of_image(picture_for(result, image).size)
    level = float(result.fit.ground_box()[0][2]) if height is None else height
    grid = _choose_grid(result, like_map, bounds, resolution, crs, heights=(dem, level))
    with surface_of(dem, result.features.crs, level) as surface:
        difference = say_difference(result.features, result.project, surface)
        tags = accuracy_tags(result_of_run, difference)
        nodes = _Nodes.of(result, grid, surface)
        precision = (f"interpolated, within {100 * nodes.error:.2g} % of the model at {_N_TESTED} "
                     "places")
        log.info("Uncertainty: %d x %d px of %g %s in %s, %s.",
                 *(grid.samples, grid.lines, grid.transform.a, grid.unit, grid.crs, precision))
        if result.fit.uncertainty_caveat:
            log.warning("Note: %s", result.fit.uncertainty_caveat)
        if nodes.error > TOLERANCE:
            log.warning("Note: between the nodes of its grid the uncertainty is interpolated, to "
                        "within %.0f %% of itself.", 100 * nodes.error)

        def describe(raster: Any) -> None:
            """Write the tags of a raster, and the names and units of its bands."""
            raster.update_tags(**tags,
                               UNCERTAINTY=f"standard deviations of {_INCLUDED}; {precision}")
            for band, (name, unit) in enumerate(BANDS, 1):
                raster.set_band_description(band, name)
                raster.set_band_unit(band, unit)

        write_cog(output, {"height": grid.lines, "width": grid.samples, "count": len(BANDS),
                           "dtype": "float32", "crs": grid.crs, "transform": grid.transform,
                           "nodata": float("nan")}, nodes.pixels, describe=describe,
                  statistics=True, progress=progress)
    return nodes.error


def _choose_grid(result: Result, like_map: Path | str | None, bounds: Sequence[float] | None,
                 resolution: float | None, crs: str | None,
                 heights: tuple[Path | str | None, float]) -> MapGrid:
    """Return the pixels of the raster: all over a map, or within bounds, or within the image.

    A map gives its extent and CRS alone. Without a resolution, the longer side has about
    `_USUAL_SIDE` pixels. `heights` are the raster of heights or None, and the height used without
    one. Raises TermselError for a resolution that is not above 0, a map without a CRS or with a
    turn, bounds without an area, and too many pixels.
    """
    from affine import Affine

    if resolution is not None and not (isfinite(resolution) and resolution > 0):
        raise TermselError(f"the resolution of a map cannot be {resolution}",
                           hint="Give a positive number.")
    if like_map is not None:
        with open_raster(like_map) as raster:
            # The terms b and d of the transform turn a map, so that north is not up.
            if raster.crs is None or raster.transform.b or raster.transform.d:
                why = "has no CRS" if raster.crs is None else "does not have north up"
                raise TermselError(f"this raster {why}, so it is no map to take pixels from",
                                   file=like_map,
                                   hint="Give a map that termsel rectify wrote, or leave --map "
                                        "out: the raster then covers the image.")
            target = raster.crs.to_wkt()
            bounds = tuple(raster.bounds)
    else:
        target = map_crs(result, crs)
    # What the image shows depends on the heights of the ground.
    if bounds is None:
        dem, height = heights
        image_grid = grid_of_image(result, target, dem=dem, height=height)[0]
        bounds = image_grid.bounds
    west, south, east, north = bounds
    if not (all(map(isfinite, bounds)) and west < east and south < north):
        raise _no_area_error(bounds, target)
    if resolution is None:
        # The size has one digit, as people would choose it.
        resolution = float(f"{max(east - west, north - south) / _USUAL_SIDE:.1g}")
    samples, lines = (max(round(extent / resolution), 1) for extent in (east - west, north - south))
    if max(samples, lines) > _MAX_SIDE:
        usual = float(f"{max(east - west, north - south) / _USUAL_SIDE:.1g}")
        raise TermselError(f"with pixels of {resolution:g} the raster would have {lines} lines and "
                           f"{samples} samples",
                           hint=f"Give a larger --res, such as {usual:g} in units of the "
                                "CRS, or smaller --bounds.")
    return MapGrid(target, lines, samples, Affine(resolution, 0.0, west, 0.0, -resolution, north))


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Standard deviations on a grid of nodes, and how to interpolate between them.

    `axes` are x, y and height of the nodes. `table` has the variances as coefficients of splines of
    `order`, shape (4, x, y, heights); `error` is the largest relative error found. `to_ground`
    transforms places on the map (n, 2) into ground (n, 3) in the CRS of the control, and `surface`
    gives the height of x and y (n, 2) there. `control` are the vertices of the control; `flat` says
    that the model uses no heights.
    """

    axes: tuple[FloatArray, FloatArray, FloatArray]
    table: FloatArray
    order: int
    error: float
    control: FloatArray
    to_ground: Callable[[FloatArray], FloatArray]
    surface: Callable[[FloatArray], FloatArray]
    flat: bool

    @classmethod
    def of(cls, result: Result, grid: MapGrid, surface: Any) -> _Nodes:
        """Return nodes so close that interpolation is within `TOLERANCE`, or the closest allowed.

        The interpolation is tested at `_N_TESTED` places of the map. Raises TermselError if none of
        these has a height, all are far outside the control, or the uncertainty is known at none.
        """
        from scipy.ndimage import spline_filter

        flat = not result.fit.model.uses_height
        # The raster is of the fit that is exported, but the extent of control is that of the run.
        as_made = result.fit.original or result.fit
        control = as_made.control.take(as_made.used).ground_vertices()
        to_ground = _to_ground(grid.crs, result.features.crs, control)
        heights = surface if callable(surface) else lambda xy: np.full(len(xy), float(surface))
        west = grid.transform.c
        north = grid.transform.f
        east = west + grid.samples * grid.transform.a
        south = north + grid.lines * grid.transform.e
        # A fixed seed, so that the same map has the same figure.
        rng = np.random.default_rng(0)
        tested = np.column_stack([rng.uniform(west, east, _N_TESTED),
                                  rng.uniform(south, north, _N_TESTED)])
        tested_ground = to_ground(tested)
        tested_ground[:, 2] = heights(tested_ground[:, :2])
        known_heights = tested_ground[np.isfinite(tested_ground[:, 2]), 2]
        if not len(known_heights):
            raise TermselError("the raster of heights has none on this map",
                               hint="Give a raster that covers the map.")
        low = known_heights.min()
        high = known_heights.max()
        levels = np.array([low]) if flat or low == high else _axis_nodes(low, high, _N_LEVELS)
        closest = np.nanmin(distance_outside_control(control, tested_ground))
        if FAR_OUTSIDE < closest < np.inf:
            raise TermselError("all of this map is far outside the control, and the model is not "
                               "valid there",
                               hint=_advice_far_outside(grid, result.features.crs, control,
                                                        known_heights, flat=flat))
        truth = _sigma_at(result, tested_ground)
        if not np.isfinite(truth).any():
            raise TermselError("the uncertainty of this model is not known anywhere on this map",
                               hint="The control determines the model without redundancy, or the "
                                    "map is elsewhere. Give more control, or other --bounds.")
        # Twice as many intervals each time, until the interpolation is exact enough.
        intervals = _MIN_INTERVALS
        while True:
            x = _axis_nodes(west, east, intervals)
            y = _axis_nodes(south, north, intervals)
            mesh = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
            ground = np.repeat(to_ground(mesh), len(levels), axis=0)
            ground[:, 2] = np.tile(levels, len(mesh))
            # Variances are smoother than standard deviations: those of polynomials are polynomials.
            squares = _sigma_at(result, ground).T.reshape(4, len(x), len(y), len(levels)) ** 2
            # A cubic spline needs values at all nodes. Linear interpolation needs those around a
            # place.
            order = 3 if np.isfinite(squares).all() else 1
            table = squares
            if order == 3:
                table = np.stack([spline_filter(square, order=3, mode="mirror")
                                  for square in squares])
            nodes = cls((x, y, levels), table, order, error=0.0, control=control,
                        to_ground=to_ground, surface=heights, flat=flat)
            interpolated = nodes.interpolate_sigma(tested, tested_ground)
            with np.errstate(invalid="ignore", divide="ignore"):
                error = np.abs(interpolated / truth - 1.0)
            largest = float(np.nanmax(error, initial=0.0))
            if largest <= TOLERANCE or 2 * intervals > _MAX_INTERVALS:
                return replace(nodes, error=largest)
            intervals *= 2

    def interpolate_sigma(self, xy: FloatArray, ground: FloatArray) -> FloatArray:
        """Return the standard deviations at places on the map (n, 2), whose ground is (n, 3).

        They are those of line and sample [px], and of east and north [m], shape (n, 4); NaN where
        the ground has no height, unless the model uses none.
        """
        from scipy.ndimage import map_coordinates

        # Positions count nodes from 0; what lies beyond the nodes gets the position of the last.
        positions = np.zeros((len(self.axes), len(xy)))
        for position, values, axis in zip(positions, (*xy.T, ground[:, 2]), self.axes, strict=True):
            if len(axis) > 1:
                unit = (values - axis[0]) / np.ptp(axis) * (len(axis) - 1)
                position[:] = np.clip(unit, 0, len(axis) - 1)
            else:
                # Every value is at the only node; the product keeps NaN where it is unknown.
                position[:] = 0.0 * values
        unknown = ~np.isfinite(positions).all(axis=0)
        positions[:, unknown] = 0.0
        # The tables are coefficients of splines already, so they are not filtered again.
        squares = np.stack([map_coordinates(table, positions, order=self.order, mode="mirror",
                                            prefilter=False) for table in self.table], axis=1)
        squares[unknown] = np.nan
        # A spline of positive variances may fall below 0 between the nodes.
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)))

    def pixels(self, window: Any, transform: Any) -> Any:
        """Return the bands of a window of the raster, shape (bands, lines, samples).

        All bands are NaN where a standard deviation is not known.
        """
        x = transform.c + (np.arange(window.width) + 0.5) * transform.a
        y = transform.f + (np.arange(window.height) + 0.5) * transform.e
        xy = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        ground = self.to_ground(xy)
        ground[:, 2] = self.surface(ground[:, :2])
        # Bands 1 to 4 are standard deviations, 5 says whether the pixel is outside the control.
        bands = np.empty((len(BANDS), len(xy)), dtype=np.float32)
        bands[:4] = self.interpolate_sigma(xy, ground).T
        if self.flat:
            # A plane model has no range of heights to be outside of.
            ground[:, 2] = np.nan
        distance = distance_outside_control(self.control, ground)
        bands[4] = np.where(np.isfinite(distance), distance > 0, np.nan)
        bands[:, ~np.isfinite(bands[:4]).all(axis=0)] = np.nan
        return bands.reshape(len(BANDS), window.height, window.width)


def _advice_far_outside(grid: MapGrid, control_crs: str, control: FloatArray,
                        heights: FloatArray, *, flat: bool) -> str:
    """Return a hint for a map whose ground is all far outside the control (v, 3).

    `heights` are those of the map; the hint names them if none is within those of the control.
    """
    lowest, highest = np.nanmin(control[:, 2]), np.nanmax(control[:, 2])
    if not flat and (heights.max() < lowest or heights.min() > highest):
        about_heights = (f"Its heights are {heights.min():,.0f} to {heights.max():,.0f}, those of "
                         f"the control {lowest:,.0f} to {highest:,.0f}: give those of the ground. ")
    else:
        about_heights = ""
    to_map = plane_transformer(horizontal_crs(control_crs), grid.crs)
    x, y = to_map.transform(*control[:, :2].T)
    # A whole degree is larger than most maps.
    decimals = 4 if is_geographic(grid.crs) else 0
    bounds = " ".join(f"{round(bound, decimals):.10g}"
                      for bound in (min(x), min(y), max(x), max(y)))
    given = grid.bounds
    if not is_geographic(grid.crs) and _may_be_degrees(given):
        return (f"{about_heights}The raster is in {grid.crs}, and these bounds look like degrees: "
                f"add --crs EPSG:4326, or give --bounds {bounds}, which holds the control.")
    return f"{about_heights}The raster is in {grid.crs}, where --bounds {bounds} holds the control."


_MAX_DEGREES = (360.0, 90.0)
"""Longitude and latitude beyond which no bounds are degrees."""


def _may_be_degrees(bounds: Sequence[float]) -> bool:
    """Return whether bounds, west south east north, may be of longitudes and latitudes."""
    longitude, latitude = _MAX_DEGREES
    west, south, east, north = map(abs, bounds)
    return max(west, east) <= longitude and max(south, north) <= latitude


def _no_area_error(bounds: Sequence[float], crs: str) -> TermselError:
    """Return the error for bounds that enclose no area: why, and the bounds in their right order.

    The latter are left out if the area is 0 in any order. `crs` is that of the raster.
    """
    west, south, east, north = bounds
    reasons = []
    # Comparisons with NaN are False, so that it is no reason here.
    if west >= east:
        reasons.append(f"west {west:.10g} is not west of {east:.10g}")
    if south >= north:
        reasons.append(f"south {south:.10g} is not south of {north:.10g}")
    # People give the order of other programs, such as west east south north.
    ordered = (min(west, east), min(south, north), max(west, east), max(south, north))
    remedy = ""
    if all(map(isfinite, bounds)) and west != east and south != north:
        remedy = f": --bounds {' '.join(f'{bound:.10g}' for bound in ordered)}"
        if not is_geographic(crs) and _may_be_degrees(ordered):
            remedy += f" --crs EPSG:4326, as they look like degrees, and the raster is in {crs}"
    reason = " and ".join(reasons) or "not all are finite"
    return TermselError(f"--bounds enclose no area: {reason}",
                        hint="The order is west south east north, in the CRS of the raster"
                             f"{remedy}.")


def _axis_nodes(low: float, high: float, intervals: int) -> FloatArray:
    """Return evenly spaced nodes from `low` to `high`, and four more beyond either end.

    There are `intervals` from `low` to `high`.
    """
    step = (high - low) / intervals
    return np.asarray(low + step * np.arange(-_N_NODES_BEYOND, intervals + _N_NODES_BEYOND + 1))


def _to_ground(
    crs: str, control_crs: str, control: FloatArray
) -> Callable[[FloatArray], FloatArray]:
    """Return a function from x and y on the map (n, 2) to the ground (n, 3) with heights of 0.

    `crs` is that of the map. Longitudes are those next to the control (v, 3).
    """
    turn = plane_transformer(crs, horizontal_crs(control_crs))
    full_turn = turn_of(control_crs)
    middle = float(control[:, 0].min() + control[:, 0].max()) / 2

    def to_ground(xy: FloatArray) -> FloatArray:
        """Return ground places (n, 3) of the map; NaN where the transformation has no value."""
        x, y = turn.transform(xy[:, 0], xy[:, 1])
        x, y = (np.where(np.isfinite(values), values, np.nan) for values in (x, y))
        # Longitudes repeat after a full turn, and the control may be on the other side of 180°.
        return np.column_stack(
            [nearest_longitudes(x, middle, full_turn), y, np.zeros(len(xy))])

    return to_ground


def _sigma_at(result: Result, ground: FloatArray) -> FloatArray:
    """Return the standard deviations at ground places (n, 3), shape (n, 4).

    They are those of line and sample [px], and of east and north [m]; all four are NaN where one is
    not known. Raises TermselError if lengths on the ground are not known in metres.
    """
    with np.errstate(all="ignore"):
        sigma_of_image = result.sigma(ground)
        scale = result.fit.ground_box()[1][:2]
        # Control along one axis has no extent along the other.
        step = _STEP * np.where(scale > 0, scale, scale.max())
        # Central differences of line and sample by east and north.
        (lx, sx), (ly, sy) = (
            ((result.project(ground + move) - result.project(ground - move)) / (2 * size)).T
            for move, size in zip(np.eye(2, 3) * step[:, None], step, strict=True))
        determinant = lx * sy - ly * sx
        # Errors of line and sample, taken as independent, times the inverse of [lx ly; sx sy].
        east = np.hypot(sigma_of_image[:, 0] * sy, sigma_of_image[:, 1] * ly) / np.abs(determinant)
        north = np.hypot(sigma_of_image[:, 0] * sx, sigma_of_image[:, 1] * lx) / np.abs(determinant)
        metres = offsets_in_metres(result.features.crs, ground, np.column_stack([east, north]))
    if metres is None:
        raise TermselError("the uncertainty on the ground is not known in metres",
                           hint="State the CRS of the ground coordinates when you run termsel.")
    values = np.column_stack([sigma_of_image, metres])
    values[~np.isfinite(values).all(axis=1)] = np.nan
    return values
