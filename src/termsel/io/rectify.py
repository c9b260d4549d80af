"""Images resampled to a map by GDAL's warper, through a fitted model."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zlib import crc32

import numpy as np

from termsel.errors import TermselError
from termsel.files.atomic import atomic_path, private_folder, write_text
from termsel.files.names import utf8_folder, utf8_name
from termsel.files.rasters import open_raster, require_rasterio
from termsel.formats.heights import surface_of
from termsel.formats.rpc_files import rpc_items
from termsel.formats.vrt import Picture, picture_for, vrt_text
from termsel.formats.writers.grids import GeolocationVrt
from termsel.io.export import as_exported
from termsel.io.replacing import require_replaceable
from termsel.measurements.coordinates.crs import (
    LOCAL,
    UTM,
    geodetic_of,
    horizontal,
    is_geocentric,
    is_geographic,
    metres_per_unit,
    normalise,
    short,
    transformation,
)
from termsel.measurements.coordinates.longitudes import continuous
from termsel.measurements.coordinates.utm import metric_crs
from termsel.measurements.features import FloatArray
from termsel.models.rpc_fit import GOOD, RpcFit, rpc_of

if TYPE_CHECKING:
    from termsel.results.result import Result

log = logging.getLogger(__name__)

RESAMPLING = ("nearest", "bilinear", "cubic", "cubic_spline", "lanczos", "average")

_TILE = 1024  # size of the tiles that are warped at once [px of the map]
_NARROW = 128  # across, where GDAL interpolates places along lines between ends and middle
_OUTLINE = 33  # places along either side of the image its extent on the map is found by
_LARGEST = 2e5  # pixels along either side of a map; more is a mistake in --res
_USUAL = 16, 30_000  # pixels along either side: others are a mistake unless the image has them


def rectify(
    result: Result,
    image: Path | str,
    output: Path | str,
    *,
    dem: Path | str | None = None,
    height: float | None = None,
    crs: str | None = None,
    resolution: float | None = None,
    resampling: str = "bilinear",
    nodata: float | None = None,
    overwrite: bool = False,
    final: bool | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Resample an image to a map.

    A fit that an RPC represents within 0.05 px is warped as RPC, with the heights of the
    raster looked up for every pixel of the map; any other by a geolocation array whose rays
    meet the raster.

    Parameters
    ----------
    result : Result
    image : path-like
        The image the features were measured in.
    output : path-like
        Cloud-optimised GeoTIFF.
    dem : path-like, optional
        Raster of heights, with the vertical datum of the control.
    height : float, optional
        Of the ground, where no raster is given; that of the middle of the control by default.
    crs : str, optional
        Of the map; by default that of the control where it is in metres, else the zone of UTM, or
        on another body than the Earth a transverse Mercator projection.
    resolution : float, optional
        Size of a pixel of the map [units of its CRS]; that of the image on the ground by default.
    resampling : str
        One of `RESAMPLING`.
    nodata : float, optional
        Where the image shows nothing; that of the image by default, else 0, or NaN for numbers
        with a fraction.
    overwrite : bool
        Whether a file that is there may be replaced.
    final : bool, optional
        As for `termsel.export`.
    progress : callable, optional
        Called with the fraction that is done, 0 to 1.

    Raises
    ------
    TermselError
        If rasterio is not installed; if image or raster of heights cannot be read or do not
        fit the result; if no part of the image is on the map; if the map would have fewer than 16
        or more than 30,000 px along a side and the image does not; if the file exists and may
        not be replaced, or cannot be written.
    """
    require_rasterio()
    image, output = Path(image), Path(output)
    require_replaceable([output], reads=[image, dem], overwrite=overwrite)
    if normalise(result.features.crs) == LOCAL:
        raise TermselError("a map requires a CRS, but the result has plane coordinates without one",
                           hint="State the CRS of the ground coordinates when you run termsel.")
    if resampling not in RESAMPLING:
        raise TermselError(f"unknown resampling {resampling!r}",
                           hint=f"Known: {', '.join(RESAMPLING)}.")
    for name, value in (("height", height), ("resolution", resolution)):
        if value is not None and not np.isfinite(value):
            raise TermselError(f"the {name} of a map cannot be {value}", hint="Give a number.")
    target = _in_metres(result) if crs is None else horizontal(crs)
    if not target:
        raise TermselError("a map needs a CRS", hint="Give --crs, such as EPSG:32631.")
    if is_geocentric(target):
        raise TermselError(f"a map cannot be in the geocentric CRS {target}, which has no plane",
                           hint="Give --crs with a projected or geographic CRS, such as "
                                "EPSG:32631.")
    result = as_exported(result, final)
    picture = picture_for(result, image)
    result = result.of_image(picture.size)
    level = float(result.fit.ground_box()[0][2]) if height is None else height
    with ExitStack() as stack:
        folder = stack.enter_context(private_folder())
        source, options = _source(result, picture, folder / "scene.vrt", dem, level)
        if "RPC_DEM" in options:
            options["RPC_DEM"] = str(stack.enter_context(utf8_name(options["RPC_DEM"])))
        outline = _ground(result, dem, level, target)
        unit = _unit(target)
        shape, transform = _map(result, outline, dem, resolution, unit)
        with open_raster(source) as raster, atomic_path(output) as temporary:
            empty = _nodata(raster) if nodata is None else _held(nodata, raster.dtypes[0])
            zone = "the zone of UTM, " if UTM.fullmatch(target) else ""
            chosen = "" if crs is not None or target == horizontal(result.features.crs) else \
                f" ({zone}as the control is not in metres; --crs names another)"
            _say(shape, f"{transform.a:g} {unit} in {short(target)}{chosen}", outline, dem)
            with utf8_folder(temporary.parent) as place, _gdal_faults(output):
                _warp(raster, place / "map.tif", shape, transform, target, empty, progress,
                      resampling=resampling, **options)
                (place / "map.tif").replace(place / temporary.name)


def _in_metres(result: Result) -> str:
    """Return the CRS of the control if it is in metres, else the zone of UTM."""
    own = result.features.crs
    if not is_geographic(own) and metres_per_unit(own) in (1.0, None):  # None: nobody knows it
        return horizontal(own)
    lon, lat, _ = transformation(own, geodetic_of(own))(result.fit.ground_box()[0][None])[0]
    try:
        return metric_crs(own, float(lon), float(lat))
    except TermselError as error:
        raise TermselError(f"the map has no CRS: {error.what}",
                           hint="Give --crs with a projected CRS in metres, such as EPSG:3413."
                           ) from error


def _source(result: Result, picture: Picture, vrt: Path, dem: Path | str | None, height: float,
            ) -> tuple[Path, dict[str, Any]]:
    """Write the virtual raster that is warped; return it and the options of the warper."""
    found = _rpc(result)
    if found is None:
        log.info("Warping by a geolocation array.")
        writer = GeolocationVrt(image=str(picture.path), dem=None if dem is None else str(dem),
                                height=height)
        writer.write(result, vrt)
        return vrt, {}
    write_text(vrt, vrt_text(picture, vrt.parent, domains={"RPC": rpc_items(found.rpc)}))
    if dem is None:
        return vrt, {"RPC_HEIGHT": height}
    # Heights are those of the control: the datum must not change after the fit.
    return vrt, {"RPC_DEM": str(Path(dem).absolute()), "RPC_DEM_APPLY_VDATUM_SHIFT": "FALSE"}


def _rpc(result: Result) -> RpcFit | None:
    """Return the RPC of a result, or None if it is too far from the model."""
    try:
        found = rpc_of(result.fit)
    except TermselError as error:
        log.info("%s.", error.what)
        return None
    return found if found.worst <= GOOD else None


def _say(shape: tuple[int, int], pixels: str, outline: FloatArray, dem: Path | str | None,
         ) -> None:
    """Log what the map is, and which share of the image it shows."""
    share = float(np.isfinite(outline).all(axis=-1).mean())
    log.info("Map: %d lines and %d samples of %s, with %s of the image.", *shape, pixels,
             "all" if share == 1 else f"about {100 * share:.0f} %")
    if share < 1:
        log.warning("Warning: about %.0f %% of the image is not on the map, as %s.",
                    100 - 100 * share, "the model has no ground position there" if dem is None
                    else f"{dem} has no heights there")


def _unit(crs: str) -> str:
    from pyproj import CRS

    return str(CRS.from_user_input(crs).axis_info[0].unit_name)


def _map(result: Result, outline: FloatArray, dem: Path | str | None, resolution: float | None,
         unit: str) -> tuple[tuple[int, int], Any]:
    """Return lines and samples of the map, and its geotransform."""
    from affine import Affine

    known = outline[np.isfinite(outline).all(axis=-1)]
    if not len(known):
        raise TermselError("the image is outside the raster of heights", file=dem,
                           hint="Give a raster that covers the image.")
    (top, left), (bottom, right) = result.fit.image_box()
    along, across = (np.linalg.norm(np.diff(outline, axis=axis), axis=-1) for axis in (0, 1))
    pixels = [np.nanmedian(along) * (_OUTLINE - 1) / max(bottom - top, 1.0),
              np.nanmedian(across) * (_OUTLINE - 1) / max(right - left, 1.0)]
    of_image = float(f"{min(pixels):.2g}")
    if resolution is None:
        resolution = of_image
    # Edges on multiples of the pixel size, so that maps of neighbouring images fit together.
    low = np.floor(known.min(axis=0) / resolution) - 1
    high = np.ceil(known.max(axis=0) / resolution) + 1
    width, lines = high - low
    least, most = _USUAL
    sides, own = (high - low).tolist(), (np.ptp(known, axis=0) / of_image).tolist()
    # An image may have such sides itself; a map that alone has them mixes up degrees and metres.
    if min(sides) < least <= min(own) or max(sides) > most >= max(own) or max(sides) > _LARGEST:
        raise TermselError(f"with pixels of {resolution:g} {unit} the map would have {lines:.0f} "
                           f"lines and {width:.0f} samples",
                           hint=f"Give --res in the units of the map, {unit}: the image has "
                                f"{of_image:g}. Or give a --crs whose edge does not run through "
                                "the image.")
    west, north = low[0] * resolution, high[1] * resolution
    return (int(lines), int(width)), Affine(resolution, 0.0, west, 0.0, -resolution, north)


def _ground(result: Result, dem: Path | str | None, height: float, target: str,
            ) -> FloatArray:
    """Return where on the map a grid of image places is, shape (_OUTLINE, _OUTLINE, 2)."""
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    (top, left), (bottom, right) = result.fit.image_box()
    # From the outer edges of the outermost pixels.
    image = np.stack(np.meshgrid(np.linspace(top - 0.5, bottom + 0.5, _OUTLINE),
                                 np.linspace(left - 0.5, right + 0.5, _OUTLINE), indexing="ij"),
                     axis=-1).reshape(-1, 2)
    own = result.features.crs
    with surface_of(dem, own, height) as surface:
        ground = result.fit.locate(image, surface)
    try:
        turn = Transformer.from_crs(horizontal(own), target, always_xy=True)
    except ProjError as error:
        raise TermselError(f"coordinates in {own} cannot be transformed to the map's CRS: {error}",
                           hint="Give another --crs.") from error
    x, y = turn.transform(ground[:, 0], ground[:, 1])
    places = np.stack([x, y], axis=-1)
    known = np.isfinite(places).all(axis=1)
    places[~known] = np.nan
    if known.any() and is_geographic(target):
        places[known, 0] = continuous(places[known, 0])
    return np.asarray(places.reshape(_OUTLINE, _OUTLINE, 2))


def _held(nodata: float, dtype: str) -> float:
    """Return a value for empty pixels; refuse what pixels of this type cannot hold."""
    from rasterio.dtypes import in_dtype_range

    if not in_dtype_range(nodata, dtype) or (np.dtype(dtype).kind in "iu"
                                             and nodata != int(nodata)):
        raise TermselError(f"pixels of the type {dtype} cannot hold the value {nodata:g}",
                           hint="Give another --nodata.")
    return nodata


def _nodata(raster: Any) -> float:
    if raster.nodata is not None:
        return float(raster.nodata)
    return float("nan") if raster.dtypes[0].startswith(("float", "complex")) else 0.0


def _warp(raster: Any, output: Path, shape: tuple[int, int], transform: Any, crs: str,
          nodata: float, progress: Callable[[float], None] | None, *, resampling: str,
          **options: Any) -> None:
    """Warp tile by tile into a GeoTIFF, make that cloud-optimised, and read it back."""
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.shutil import copy
    from rasterio.warp import reproject
    from rasterio.windows import Window

    plain = output.with_name("tiles.tif")
    profile = {"driver": "GTiff", "height": shape[0], "width": shape[1], "count": raster.count,
               "dtype": raster.dtypes[0], "crs": crs, "transform": transform, "nodata": nodata,
               "tiled": True, "compress": "deflate", "bigtiff": "if_safer"}
    across = _TILE if raster.rpcs else _NARROW
    tiles = [Window(column, row, min(across, shape[1] - column), min(_TILE, shape[0] - row))
             for row in range(0, shape[0], _TILE) for column in range(0, shape[1], across)]
    checksums = []
    bands = list(range(1, raster.count + 1))
    with rasterio.open(plain, "w", **profile) as tiled:
        tiled.colorinterp = raster.colorinterp
        for done, window in enumerate(tiles):
            pixels = np.full((raster.count, window.height, window.width), nodata,
                             dtype=raster.dtypes[0])
            # Only where RPCs are named here does rasterio let GDAL compute every pixel's place
            # rather than interpolate along lines, which does not hold in relief.
            reproject(rasterio.band(raster, bands), pixels, dst_crs=crs, dst_nodata=nodata,
                      dst_transform=tiled.window_transform(window), rpcs=raster.rpcs,
                      resampling=Resampling[resampling], **options)
            tiled.write(pixels, window=window)
            checksums.append(crc32(pixels.data))
            if progress is not None:
                progress((done + 1) / len(tiles))
    copy(plain, output, driver="COG", compress="deflate", bigtiff="if_safer")
    # GDAL does not report that a disk is full when it closes a file.
    with rasterio.open(output) as made:
        if [crc32(made.read(window=window).data) for window in tiles] != checksums:
            raise TermselError("the map that is read back is not the one that was written",
                               file=output, hint="Check the free space on the disk.")


@contextmanager
def _gdal_faults(output: Path) -> Iterator[None]:
    from rasterio._err import CPLE_BaseError
    from rasterio.errors import NotGeoreferencedWarning, RasterioError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            yield
    except (RasterioError, CPLE_BaseError) as error:
        raise TermselError(f"GDAL cannot make this map: {error}", file=output,
                           hint="Check the image, the raster of heights, and the free space on the "
                                "disk.") from error
