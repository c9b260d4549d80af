"""The CRS of a map, its pixels and its extent, from what an image shows."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from termsel.core.errors import TermselError
from termsel.data.coordinates.crs import (
    LOCAL,
    geodetic_of,
    horizontal_crs,
    is_geocentric,
    is_geographic,
    metres_per_unit,
    normalise,
    plane_transformer,
    transformation_between,
)
from termsel.data.coordinates.earth import note_on_utm_zone, place_of
from termsel.data.coordinates.longitudes import turn_of, unwrap_longitudes
from termsel.data.coordinates.metres import is_polar, metric_crs, polar_crs
from termsel.data.features import FloatArray
from termsel.formats.heights import Dem, open_dem, surface_of, where_raster_is

if TYPE_CHECKING:
    from termsel.results.result import Result

log = logging.getLogger(__name__)

WIDE = 0.01
"""Error of distances beyond which an area is too wide for a zone of UTM."""

_OUTLINE = 33  # places along either side of the image its extent on the map is found by
_UNEVEN = 3.0  # largest pixel on the ground by the smallest, beyond which a view is oblique
_MAX_MAP_SIDE = 2e5  # pixels along either side of a map; more is a mistake in --res
_USUAL = 16, 30_000  # pixels along either side: others are a mistake unless the image has them


@dataclass(frozen=True)
class MapGrid:
    """The pixels of a map.

    `transform` is the affine.Affine from samples and lines, counted from the outer corner of the
    upper-left pixel, to x and y in `crs`.
    """

    crs: str
    lines: int
    samples: int
    transform: Any

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Least x and y, and largest x and y."""
        # The lower right corner; the upper left one is in the transform.
        corner = self.transform @ (self.samples, self.lines)
        return self.transform.c, corner[1], corner[0], self.transform.f

    @property
    def unit(self) -> str:
        """Unit of x and y."""
        return _unit_of_crs(self.crs)


def clip_grid(grid: MapGrid, bounds: tuple[float, float, float, float], crs: str) -> MapGrid:
    """Return the part of a grid within least and largest x and y in a CRS, at whole pixels.

    Raises TermselError where no pixel of the grid is within the bounds.
    """
    from rasterio.warp import transform_bounds

    west, south, east, north = transform_bounds(horizontal_crs(crs), grid.crs, *bounds)
    # The inverse of the grid's affine map takes two opposite corners to columns and rows.
    first_column, first_row = ~grid.transform @ (west, north)
    last_column, last_row = ~grid.transform @ (east, south)
    first = max(int(np.floor(first_column)), 0), max(int(np.floor(first_row)), 0)
    last = (min(int(np.ceil(last_column)), grid.samples),
            min(int(np.ceil(last_row)), grid.lines))
    if last[0] <= first[0] or last[1] <= first[1]:
        raise TermselError("the image shows nothing within the bounds of the map",
                           hint="Give other bounds.")
    return MapGrid(grid.crs, last[1] - first[1], last[0] - first[0],
                   grid.transform @ type(grid.transform).translation(*first))


def map_crs(result: Result, crs: str | None) -> str:
    """Return the CRS of a map: the one given, without it that of `_metric_crs`.

    A zone of UTM that does not fit the control is a warning. Raises TermselError if the control has
    no CRS, and for one that a map cannot have.
    """
    if normalise(result.features.crs) == LOCAL:
        raise TermselError("a map requires a CRS, but the result has plane coordinates without "
                           "one",
                           hint="State the CRS of the ground coordinates when you run termsel.")
    target = _metric_crs(result) if crs is None else horizontal_crs(crs)
    if not target:
        raise TermselError("a map needs a CRS", hint="Give --crs, such as EPSG:32631.")
    if is_geocentric(target):
        raise TermselError(f"a map cannot be in the geocentric CRS {target}, which has no plane",
                           hint="Give --crs with a projected or geographic CRS, such as "
                                "EPSG:32631.")
    if crs is not None and (doubt := note_on_utm_zone(target, result.features)):
        log.warning("Warning: %s.", doubt)
    return target


def _metric_crs(result: Result) -> str:
    """Return the CRS of the control if it is in metres, else the zone of UTM, or a polar one.

    On another body than the Earth a transverse Mercator projection takes the place of UTM. Warns of
    an area too wide for it. Raises TermselError where the CRS of the control cannot be transformed.
    """
    control_crs = result.features.crs
    # A unit that is not known (None) is taken for the metre.
    if not is_geographic(control_crs) and metres_per_unit(control_crs) in (1.0, None):
        return horizontal_crs(control_crs)
    geodetic = transformation_between(control_crs, geodetic_of(control_crs))
    geodetic_positions = geodetic(result.fit.control.ground_vertices())
    # Across the date line, longitudes go on beyond 180.
    geodetic_positions[:, 0] = unwrap_longitudes(geodetic_positions[:, 0])
    if is_polar(geodetic_positions):
        return polar_crs(control_crs, float(np.median(geodetic_positions[:, 1])))
    _warn_of_wide_area(geodetic_positions)
    lon, lat, _ = geodetic(result.fit.ground_box()[0][None])[0]
    return metric_crs(control_crs, float(lon), float(lat))


def _warn_of_wide_area(positions: FloatArray) -> None:
    """Warn where an area is too wide for a zone of UTM.

    `positions` (n, 2 or more) begin with longitudes and latitudes [deg].
    """
    # The scale of a transverse Mercator projection grows from its meridian as 1 + d^2 / 2, where d
    # is the distance from it in radii of the Earth: difference of longitudes times cos(latitude).
    lon = np.radians(positions[:, 0] - (positions[:, 0].min() + positions[:, 0].max()) / 2)
    scale = float(((lon * np.cos(np.radians(positions[:, 1]))) ** 2 / 2).max())
    if scale > WIDE:
        log.warning("Warning: the control spans %.0f degrees of longitude. One zone of UTM shows "
                    "distances at its edges %.2g %% too long: --crs names a projection for such an "
                    "area, such as that of an atlas.", float(np.ptp(positions[:, 0])), 100 * scale)


def _unit_of_crs(crs: str) -> str:
    """Return the name of the unit of a CRS's first axis."""
    from pyproj import CRS

    return str(CRS.from_user_input(crs).axis_info[0].unit_name)


def grid_of_image(result: Result, crs: str, resolution: float | None = None, *,
                  dem: Path | str | None, height: float) -> tuple[MapGrid, float]:
    """Return the pixels of a map that shows the image, and the share of the image on it, 0 to 1.

    The ground has the heights of the raster `dem`, or without one is level at `height`. The size of
    a pixel, `resolution`, is by default that of the image on the ground [units of the CRS]. Raises
    TermselError if no part of the image is on the map, or if the map would have fewer than 16 or
    more than 30,000 px along a side and the image does not.
    """
    from affine import Affine

    outline = _outline_on_map(result, dem, height, crs)
    unit = _unit_of_crs(crs)
    placed = outline[np.isfinite(outline).all(axis=-1)]
    # Distances on the ground between neighbours of the grid, along lines and along samples.
    line_spacing = np.linalg.norm(np.diff(outline, axis=0), axis=-1)
    sample_spacing = np.linalg.norm(np.diff(outline, axis=1), axis=-1)
    if np.isnan(line_spacing).all() or np.isnan(sample_spacing).all():
        raise _no_ground_error(result, dem, height)
    (first_line, first_sample), (last_line, last_sample) = result.fit.image_box()
    # Pixels on the ground: the spacing of nodes by the number of pixels between two of them.
    pixel_sizes = [
        np.nanmedian(line_spacing) * (_OUTLINE - 1) / max(last_line - first_line, 1.0),
        np.nanmedian(sample_spacing) * (_OUTLINE - 1) / max(last_sample - first_sample, 1.0)]
    # The finer direction decides, so that no detail of the image is lost.
    image_pixel = min(pixel_sizes)
    spacings = line_spacing[np.isfinite(line_spacing)]
    # In an oblique view pixels far away are many times larger than near ones. There the map gets as
    # many pixels as the image has on the ground that it shows.
    if spacings.max() > _UNEVEN * spacings.min():
        image_pixel = _pixel_of_equal_count(
            outline, (last_line - first_line) * (last_sample - first_sample))
    # Two digits, as a resolution is a choice and no measurement.
    image_pixel = float(f"{image_pixel:.2g}")
    if resolution is None:
        resolution = image_pixel
    # Edges on multiples of the pixel size, so that maps of neighbouring images fit together.
    low = np.floor(placed.min(axis=0) / resolution) - 1
    high = np.ceil(placed.max(axis=0) / resolution) + 1
    width, lines = high - low
    fewest_pixels, most_pixels = _USUAL
    map_sides = (high - low).tolist()
    image_sides = (np.ptp(placed, axis=0) / image_pixel).tolist()
    # An image may have such sides itself; a map that alone has them mixes up degrees and metres.
    is_tiny = min(map_sides) < fewest_pixels <= min(image_sides)
    is_huge = max(map_sides) > most_pixels >= max(image_sides)
    if is_tiny or is_huge or max(map_sides) > _MAX_MAP_SIDE:
        raise TermselError(f"with pixels of {resolution:g} {unit}s the map would have {lines:.0f} "
                           f"lines and {width:.0f} samples",
                           hint=f"Give --res in the units of the map, {unit}s: a pixel of the "
                                f"image is {image_pixel:.2g} {unit}s." + (
                                    "" if is_tiny else " Or the edge of the CRS runs through the "
                                    "image: give another --crs."))
    west = low[0] * resolution
    north = high[1] * resolution
    grid = MapGrid(crs, int(lines), int(width),
                   Affine(resolution, 0.0, west, 0.0, -resolution, north))
    share_seen = float(np.isfinite(outline).all(axis=-1).mean())
    return grid, share_seen


def _no_ground_error(result: Result, dem: Path | str | None, height: float | None) -> TermselError:
    """Return the error for an image of which the model, or the raster `dem`, shows no ground.

    Without a raster the reason is the model, or the `height` of the ground; else the raster, which
    covers another area, or has no data in that of the image.
    """
    if dem is None:
        at_height = "" if height is None else f" at the height {height:g}"
        remedy = "Do not use it: choose another model, or measure more."
        if height is not None:
            remedy = ("Give the height of the ground (--height H). If it is right, choose "
                      "another model, or measure more.")
        return TermselError("the model gives no ground position anywhere in the image"
                            f"{at_height}", hint=remedy)
    control = result.fit.control
    with open_dem(Path(dem), control.crs) as surface:
        where = where_raster_is(surface, control)
        covers_some = surface.covers(control.ground_vertices()[:, :2]).any()
    if covers_some:
        return TermselError("this raster of heights has no data in the area of the image",
                            file=dem, hint="Give one with heights there, or --height H.")
    return TermselError(f"this raster of heights does not cover the image, which is around "
                        f"{place_of(control)}", file=dem,
                        hint=f"{where} Give a raster of that area.")


def sees_all(result: Result, grid: MapGrid, height: float) -> bool:
    """Return whether all places of a map, at a height, are in front of the camera."""
    # Places at the edges of the map are among those tried, as the sky begins there.
    samples, lines = np.meshgrid(np.linspace(0.0, grid.samples, _OUTLINE),
                                 np.linspace(0.0, grid.lines, _OUTLINE))
    x, y = grid.transform @ (samples.ravel(), lines.ravel())
    to_control_crs = plane_transformer(grid.crs, horizontal_crs(result.features.crs))
    ground = np.column_stack([*to_control_crs.transform(x, y), np.full(len(x), height)])
    is_known = np.isfinite(ground).all(axis=1)
    return not result.fit.unseen(ground[is_known]).any()


def footprint_of(result: Result, surface: Dem | float) -> FloatArray:
    """Return the ground (n, 3) that a grid over the image shows, in the CRS of the control.

    Returns NaN for places of the image that show no ground, or ground at which the model does not
    hold.
    """
    (first_line, first_sample), (last_line, last_sample) = result.fit.image_box()
    # From the outer edges of the outermost pixels.
    lines = np.linspace(first_line - 0.5, last_line + 0.5, _OUTLINE)
    samples = np.linspace(first_sample - 0.5, last_sample + 0.5, _OUTLINE)
    image = np.stack(np.meshgrid(lines, samples, indexing="ij"), axis=-1).reshape(-1, 2)
    ground = result.fit.locate(image, surface)
    # The horizon is without end, and what is seen near it says nothing of the size of a pixel.
    ground[~result.fit.holds(ground)] = np.nan
    return ground


def _pixel_of_equal_count(outline: FloatArray, pixels: float) -> float:
    """Return the side of a square on the ground of as many as an image has pixels.

    `outline` are ground places (n, n, 2) of a grid over the image.
    """
    diagonals = outline[1:, 1:] - outline[:-1, :-1]
    other_diagonals = outline[1:, :-1] - outline[:-1, 1:]
    # The area of a quadrangle is half the cross product of its diagonals.
    products = (diagonals[..., 0] * other_diagonals[..., 1],
                diagonals[..., 1] * other_diagonals[..., 0])
    areas = np.abs(products[0] - products[1]) / 2
    return float(np.sqrt(np.nansum(areas) / (np.isfinite(areas).mean() * pixels)))


def _outline_on_map(
        result: Result, dem: Path | str | None, height: float, target: str) -> FloatArray:
    """Return x and y on the map of a grid over the image, shape (_OUTLINE, _OUTLINE, 2).

    Returns NaN where the image shows no ground, or the CRS `target` has no place for it.
    """
    control_crs = result.features.crs
    with surface_of(dem, control_crs, height) as surface:
        ground = footprint_of(result, surface)
    to_map = plane_transformer(horizontal_crs(control_crs), target)
    x, y = to_map.transform(ground[:, 0], ground[:, 1])
    positions = np.stack([x, y], axis=-1)
    is_placed = np.isfinite(positions).all(axis=1)
    positions[~is_placed] = np.nan
    # Across 180 degrees the outline goes on, or the map would go once around the Earth.
    if is_placed.any() and (turn := turn_of(target)):
        positions[is_placed, 0] = unwrap_longitudes(positions[is_placed, 0], turn)
    return np.asarray(positions.reshape(_OUTLINE, _OUTLINE, 2))
