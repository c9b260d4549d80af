"""Images resampled to a map by GDAL's warper, through a fitted model."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from termsel.core.arguments import explains_arguments
from termsel.core.errors import TermselError, rounded_size_text
from termsel.core.files.atomic import private_folder, write_text
from termsel.core.files.names import utf8_name
from termsel.core.remedies import Remedy
from termsel.data.archives import raster_in
from termsel.data.cog import require_tiff_name
from termsel.data.coordinates.crs import (
    UTM,
    CrsLike,
    crs_text,
    has_ellipsoidal_metres,
    horizontal_crs,
    plane_transformer,
    short_crs_name,
    to_wgs84,
)
from termsel.data.coordinates.earth import note_on_turned
from termsel.data.rasters import gdal_name, open_raster, refuse_empty_giant, require_rasterio
from termsel.fitting.datum_accuracy import say_stand_in
from termsel.fitting.rpc_fit import GOOD, RpcFit, closest_rpc
from termsel.fitting.sky import NEAR_OR_FAR, why_not_shown
from termsel.formats.deviation import places_of, say_deviation
from termsel.formats.heights import (
    Dem,
    HeightCaution,
    say_difference,
    surface_of,
    write_ellipsoidal,
)
from termsel.formats.pictures import Picture
from termsel.formats.rpc_files import rpc_items
from termsel.formats.vrt import picture_for, vrt_text
from termsel.io.accuracy_tags import accuracy_tags
from termsel.io.export import as_exported
from termsel.io.map_grid import (
    MapGrid,
    clip_grid,
    footprint_of,
    grid_of_image,
    map_crs,
    sees_all,
)
from termsel.io.map_pixels import map_pixels, warp
from termsel.io.map_positions import MapPositions
from termsel.io.replacing import require_replaceable
from termsel.results.result import Result, require_result

log = logging.getLogger(__name__)

_DATUM_PX = 0.1
"""Largest move of a map by the way over WGS84, as an RPC goes, in px of the map."""


@explains_arguments(checked_within=("result",))
def rectify(
    result: Result,
    image: Path | str,
    output: Path | str,
    *,
    dem: Path | str | None = None,
    height: float | None = None,
    crs: CrsLike | None = None,
    resolution: float | None = None,
    resampling: str | None = None,
    nodata: float | None = None,
    bounds: tuple[float, float, float, float] | None = None,
    overwrite: bool = False,
    final: bool | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Resample an image to a map.

    A fit that an RPC represents within 0.05 px is warped as RPC, by GDAL's warper. Of any other,
    positions in the image are computed on a coarse grid of the map, at some heights, and
    interpolated to 0.05 px. Either way the heights of the raster are looked up for every pixel of
    the map.

    Parameters
    ----------
    result : Result
        As `termsel.run` or `termsel.read_result` returns it.
    image : path-like
        The image the features were measured in; a zip or folder that holds it alone, or its place
        in a zip, ``FILE.zip/PLACE.tif``.
    output : path-like
        Cloud-optimised GeoTIFF.
    dem : path-like, optional
        Raster of heights. Its vertical datum is that of the control where it declares none, else
        it is converted to that.
    height : float, optional
        Height of the ground, where no raster is given. A model that uses heights needs one of
        the two.
    crs : str, int or CRS, optional
        CRS of the map, as for `termsel.read`; by default that of the control where it is in metres,
        else the zone of UTM, or on another body than the Earth a transverse Mercator projection.
    resolution : float, optional
        Size of a pixel of the map [units of its CRS]; that of the image on the ground by default.
    resampling : str, optional
        nearest, bilinear, cubic, cubic_spline, lanczos or average. By default nearest where
        pixels are categories (indices of a colour table, bits, classes), else bilinear.
    nodata : float, optional
        Value of the map where it does not show the image; that of the image by default, or NaN for
        numbers with a fraction, or with a colour table an index that the image does not use. Else
        the image's alpha band, or a mask inside the file, says where that is.
    bounds : tuple of float, optional
        Least x and y and largest x and y of the map, in the CRS of the control, where only a part
        of the image is wanted.
    overwrite : bool
        Whether a file that is there may be replaced.
    final : bool, optional
        As for `termsel.export`.
    progress : callable, optional
        Called with the fraction that is done, 0 to 1.

    Returns
    -------
    None
        The map is the file `output`.

    Raises
    ------
    TermselError
        If rasterio is not installed; if the model uses heights and none are given; if image or
        raster of heights cannot be read or do not fit the result; if no part of the image is on the
        map; if the map would have fewer than 16 or more than 30,000 px along a side and the image
        does not; if the file exists and may not be replaced, or cannot be written.

    Examples
    --------
    >>> import tempfile, termsel
    >>> from pathlib import Path
    >>> from termsel.toolkit.files import write_example
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = Path(folder) / "files"
    ...     _ = write_example(files)
    ...     result = termsel.run("poly-terms", features=files / "gcps.csv", generations=2)
    ...     termsel.rectify(result, files / "scene.tif", files / "map.tif", dem=files / "dem.tif")
    ...     with termsel.open_raster(files / "map.tif") as written:
    ...         written.shape, written.res  # px; metres
    ((610, 723), (9.6, 9.6))
    """
    require_result(result, "rectify")
    require_rasterio()
    image = raster_in(Path(image))
    output = Path(output)
    require_tiff_name(output)
    require_replaceable([output], reads=[image, dem], overwrite=overwrite)
    for name, value in (("height", height), ("resolution", resolution)):
        if value is not None and not np.isfinite(value):
            raise TermselError(f"the {name} of a map cannot be {value}", hint="Give a number.")
    if resolution is not None and resolution <= 0.0:
        raise TermselError(f"the resolution of a map cannot be {resolution:g}",
                           hint="Give the size of its pixels, a positive number: --res.")
    if bounds is not None:
        west, south, east, north = bounds
        if not (west < east and south < north):
            raise TermselError("the bounds of the map enclose no area",
                               hint="Give least x, least y, largest x and largest y, in this "
                                    "order.")
    if dem is None and height is None and result.fit.model.uses_height:
        raise TermselError("the position of the image on the map depends on the height of the "
                           "ground",
                           hint=f"Give {Remedy('dem', 'FILE')} or {Remedy('height', 'H')}.")
    target = map_crs(result, None if crs is None else crs_text(crs))
    # Names and numbers were checked first; now come files, and then long work.
    result = as_exported(result, final)
    picture = picture_for(result, image)
    with open_raster(image) as raster:
        refuse_empty_giant(raster)
    pixels = map_pixels(picture, resampling, nodata)
    result = result.of_image(picture.size)
    # The level of the ground where no raster is given: the middle of the control.
    level = float(result.fit.ground_box()[0][2]) if height is None else height
    with ExitStack() as stack:
        folder = stack.enter_context(private_folder())
        grid, share = grid_of_image(result, target, resolution, dem=dem, height=level)
        if bounds is not None:
            grid = clip_grid(grid, bounds, result.features.crs)
        surface = stack.enter_context(surface_of(dem, result.features.crs, level))
        caution = _say_heights(result, surface)
        warped = replace(pixels.plain, path=Path(stack.enter_context(utf8_name(image))))
        source, options = _write_source(result, warped, folder / "scene.vrt", surface, grid)
        # Positions are computed here where GDAL's warper cannot: by any model but an RPC.
        positions = None if options is not None else MapPositions(
            result.fit, grid.crs, surface, footprint_of(result, level))
        options = options or {}
        if "RPC_DEM" in options:
            options["RPC_DEM"] = str(stack.enter_context(utf8_name(options["RPC_DEM"])))
        with open_raster(source) as raster:
            zone = "the zone of UTM, " if UTM.fullmatch(target) else ""
            if crs is not None or target == horizontal_crs(result.features.crs):
                crs_note = ""
            else:
                crs_note = f" ({zone}as the control is not in metres; --crs names another)"
            _log_map(result, grid, crs_note, share, dem)
            say_stand_in(result.fit, grid.crs)
            warp(raster, output, grid, pixels, tags=accuracy_tags(result, caution),
                 progress=progress, positions=positions, **options)


def _write_source(result: Result, picture: Picture, vrt: Path, surface: Dem | float, grid: MapGrid,
                  ) -> tuple[Path, dict[str, Any] | None]:
    """Write the virtual raster that is warped, and return its path and the options of the warper.

    The raster has an RPC where one is near enough to the model, and the options then say what
    heights go with it: a number, or a raster, which is written next to it where heights have to be
    converted. Else there are no options, None, which is logged: positions come from a grid of the
    map.
    """
    # By an RPC the warper would put the sky, mirrored, on places behind the camera.
    level = float(result.fit.ground_box()[0][2]) if isinstance(surface, Dem) else surface
    rpc_fit = None
    if sees_all(result, grid, level) and _shift_over_wgs84(result, grid) <= _DATUM_PX:
        rpc_fit = _usable_rpc(result)
    # GDAL looks a longitude up in the raster as it is, and would find nothing in a raster whose
    # longitudes go on beyond 180 degrees.
    if rpc_fit is None or (isinstance(surface, Dem) and surface.is_beyond_180):
        log.info("Positions in the image are computed on a grid of the map, and interpolated.")
        write_text(vrt, vrt_text(picture, vrt.parent))
        return vrt, None
    write_text(vrt, vrt_text(picture, vrt.parent, domains={"RPC": rpc_items(rpc_fit.rpc)}))
    # An RPC takes ellipsoidal heights in metres, whatever those of the control are.
    to_ellipsoidal = to_wgs84(result.features.crs)
    if not isinstance(surface, Dem):
        # At the middle of the control, since ellipsoid and geoid are parallel over one image.
        middle = np.append(result.fit.ground_box()[0][:2], surface)
        return vrt, {"RPC_HEIGHT": float(to_ellipsoidal(middle[None])[0, 2])}
    dem = gdal_name(surface.path)
    if isinstance(dem, Path):
        dem = dem.absolute()
    if not (surface.is_as_stored and has_ellipsoidal_metres(result.features.crs)):
        dem = vrt.with_name("ellipsoidal.tif")
        write_ellipsoidal(surface, dem, grid.bounds, grid.crs)
    # GDAL's PROJ must not convert heights once more.
    return vrt, {"RPC_DEM": str(dem), "RPC_DEM_APPLY_VDATUM_SHIFT": "FALSE"}


def _shift_over_wgs84(result: Result, grid: MapGrid) -> float:
    """Return how far a map by an RPC is off at most, as RPCs take positions in WGS84 [px of map].

    It is 0 if PROJ goes the same way from the CRS of the control to WGS84 as from that of the
    map, there and back.
    """
    control_crs = result.features.crs
    from pyproj import Transformer

    ground = result.features.ground_vertices()
    direct = plane_transformer(horizontal_crs(control_crs), grid.crs).transform(*ground[:, :2].T)
    # GDAL's warper takes whatever PROJ has first, ballpark ones included.
    from_wgs84 = Transformer.from_crs("EPSG:4326", grid.crs, always_xy=True)
    over_wgs84 = from_wgs84.transform(*to_wgs84(control_crs)(ground)[:, :2].T)
    shifts = np.hypot(*(np.asarray(direct) - np.asarray(over_wgs84))) / grid.transform.a
    return float(shifts[np.isfinite(shifts)].max(initial=0.0))


def _say_heights(result: Result, surface: Dem | float) -> HeightCaution | None:
    """Warn where the heights of the ground contradict the control, or a level leaves out relief.

    Returns the caution that has the larger effect; None if there is neither.
    """
    if isinstance(surface, Dem) and not result.fit.model.uses_height:
        log.info("Note: this model uses no heights, so the raster of heights (%s) changes nothing "
                 "in the map.", Remedy("dem"))
    level = _say_level(result, surface)
    difference = say_difference(result.features, result.project, surface)
    cautions = [caution for caution in (level, difference) if caution is not None]
    return max(cautions, key=lambda caution: caution.pixels, default=None)


def _say_level(result: Result, surface: Dem | float) -> HeightCaution | None:
    """Warn how far the map is off because the ground is taken as level; return the caution.

    Returns None if a raster of heights is given, or if the model uses no heights.
    """
    if isinstance(surface, Dem) or not result.fit.model.uses_height:
        return None
    log.warning("Warning: without a raster of heights (%s) the ground is taken as level, at the "
                "height %.6g.", Remedy("dem"), surface)
    positions = places_of(result.fit)
    # Where each place would be seen if the ground were level.
    level = positions * [1, 1, 0] + [0, 0, surface]
    pixels = say_deviation("map", result.fit, positions, result.fit.project(level),
                           ", at the heights of the control")
    return HeightCaution(
        f"Without a raster of heights the ground is taken as level, at the height {surface:.6g}: "
        f"at the heights of the control the map is up to {rounded_size_text(pixels)} px from the "
        "model",
        pixels)


def _usable_rpc(result: Result) -> RpcFit | None:
    """Return the RPC closest to the fit of a result; None if no map can be made by it.

    So it is if none can be fitted, if it is more than `GOOD` [px] off at some place, and if it
    leaves out a part of the image. Why there is none is logged for developers.
    """
    try:
        rpc_fit = closest_rpc(result.fit)
    except TermselError as error:
        # The map is made in another way: why there is no RPC matters only to a developer.
        log.debug("%s.", error.what)
        return None
    # A map is a box, and shows ground beyond the part of an oblique image that the RPC follows.
    return rpc_fit if rpc_fit.worst <= GOOD and not rpc_fit.excluded_part else None


_SYMBOLS = {"metre": "m", "degree": "degrees", "foot": "ft", "US survey foot": "US survey ft"}
"""What a line calls the units of a CRS, in which a pixel has a size."""


def _log_map(result: Result, grid: MapGrid, crs_note: str, share: float,
             dem: Path | str | None) -> None:
    """Log size and CRS of the map, and which share of the image it shows, 0 to 1.

    `crs_note` follows the CRS in the message. Warns if the map seems mirrored; if it lacks a part
    of the image, for which `dem` may be a reason; or if the model is of some lines alone.
    """
    known = result.fit.model.known_image()
    if known is not None and known.lines is not None:
        log.warning("Warning: %s. The map shows no others.", known.sentence())
    if mirrored := note_on_turned(result.features):
        log.warning("Warning: %s", mirrored)
    log.info("Map: %d x %d px of %g %s in %s%s, with %s of the image.", grid.samples,
             grid.lines, grid.transform.a, _SYMBOLS.get(grid.unit, grid.unit),
             short_crs_name(grid.crs), crs_note,
             "all" if share == 1 else f"about {100 * share:.0f} %")
    if share < 1:
        log.warning("Warning: about %.0f %% of the image is not on the map, as %s.",
                    100 - 100 * share, _why_not(result, dem))


def _why_not(result: Result, dem: Path | str | None) -> str:
    """Return why a part of the image is not on the map."""
    reason = why_not_shown(result.fit)
    if reason and (dem is None or reason != NEAR_OR_FAR):
        return f"it is {reason}"
    if dem is None:
        return "the model has no ground position there"
    return f"{dem} has no heights there"
