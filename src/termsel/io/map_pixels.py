"""The pixels of a map: their colours, what lies outside the image, and how they are resampled."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from termsel.core.errors import TermselError, unknown_name_error
from termsel.core.files.reasons import reason_of
from termsel.core.remedies import Remedy
from termsel.data.cog import write_cog
from termsel.data.distant_rasters import with_dataset
from termsel.data.features import FloatArray
from termsel.data.rasters import open_raster
from termsel.formats.pictures import Band, Colour, Picture, expand_colours
from termsel.io.map_grid import MapGrid
from termsel.io.map_positions import MapPositions
from termsel.io.resampling import ImageWindow, extent_of_positions, reach, resample_pixels

log = logging.getLogger(__name__)

RESAMPLING = ("nearest", "bilinear", "cubic", "cubic_spline", "lanczos", "average")

Values = NDArray[Any]
Mask = NDArray[np.bool_]

_LARGEST_PART = 1 << 28  # bytes of an image that are read at once for a tile
_NEGATIVE_WEIGHTS = ("cubic", "lanczos")  # kernels that have them
_WITH_TABLE = ("Byte", "UInt16")  # types whose colours a GeoTIFF holds
_WHITE: Colour = (255, 255, 255, 255)
_TYPES = {"Byte": "uint8", "CFloat32": "complex64", "CFloat64": "complex128", "CInt16": "complex64"}


@dataclass(frozen=True)
class MapPixels:
    """What the pixels of a map are made of.

    `picture` is the image as it is warped, its alpha band, if any, last; `order` are its bands in
    the order of the map, counted from 0. `empty` is the value of each band but alpha for no data in
    the image. Where the image shows nothing, the map has the value `nodata`; without one its alpha
    band says so, or else a mask, and pixels have the value `fill` there.
    """

    picture: Picture
    order: tuple[int, ...]
    resampling: str
    empty: tuple[float | None, ...]
    nodata: float | None
    fill: float | None

    @property
    def bands(self) -> list[Band]:
        """Bands in the order of the map."""
        return [self.picture.bands[index] for index in self.order]

    @property
    def plain(self) -> Picture:
        """The picture without tables and categories, which the warper does not need."""
        return replace(self.picture, bands=tuple(
            replace(band, table=(), categories=()) for band in self.picture.bands))

    @property
    def alpha(self) -> bool:
        """Whether the last band of the image is alpha."""
        return self.picture.bands[-1].alpha

    @property
    def masked(self) -> bool:
        """Whether the map needs a mask: it has no value for no data, and no alpha that is one."""
        # GDAL takes alpha for the mask of two or four bands alone, and of the last band.
        usual = self.alpha and len(self.order) in (2, 4) and self.bands[-1].alpha
        return self.nodata is None and not usual

    @property
    def category(self) -> bool:
        """Whether values are categories."""
        return self.picture.category

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type that holds the values of every band."""
        return np.result_type(*(_TYPES.get(band.type, band.type.lower())
                                for band in self.picture.bands))

    @property
    def table(self) -> tuple[Colour, ...]:
        """Colours of the values of the only band that is no alpha."""
        return self.picture.bands[0].table if len(self.empty) == 1 else ()

    @property
    def bits(self) -> int | None:
        """Bits of a pixel where a byte holds several pixels; None for all other maps.

        They are as few as can hold the pixels of the image and the value for "no data".
        """
        if len(self.picture.bands) > 1 or not self.category:
            return None
        stored = self.picture.bands[0].bits
        for bits in (1, 2, 4):
            if stored is not None and bits >= stored and (self.nodata or 0) < 2**bits:
                return bits
        return None


def map_pixels(picture: Picture, resampling: str | None, nodata: float | None) -> MapPixels:
    """Return how the pixels of a map are made from those of a picture; say where they differ.

    Parameters
    ----------
    picture : Picture
    resampling : str, optional
        By default nearest for categories, else bilinear.
    nodata : float, optional
        The value of pixels that show nothing; see `termsel.rectify`.

    Raises
    ------
    TermselError
        If the resampling is not known or would mix classes, if pixels cannot hold the value, or if
        the picture has no band but transparency.
    """
    picture, resampling = _prepare_for_resampling(picture, resampling)
    # Of several bands of transparency the last is used; it comes last in the picture that is
    # warped. The others are treated as colours.
    alpha = [index for index, band in enumerate(picture.bands) if band.alpha][-1:]
    colours = [index for index in range(len(picture.bands)) if index not in alpha]
    if not colours:
        raise TermselError("the image has a band of transparency alone", file=picture.path,
                           hint="Give an image with colours or values.")
    bands = [picture.bands[index] for index in colours + alpha]
    empty = tuple(band.nodata for band in bands[:len(colours)])
    common, same = _common_nodata(empty)
    # The warper takes one value for all bands; where there are several it takes bands one by one.
    warped = replace(picture, masked=picture.masked and not alpha, bands=tuple(
        band if same and not band.alpha else replace(band, nodata=None) for band in bands))
    # argsort inverts the reordering: the map has the bands in the order of the image.
    order = tuple(int(index) for index in np.argsort(colours + alpha))
    spec = MapPixels(warped, order, resampling, empty, None, None)
    if nodata is not None:
        _require_held(nodata, spec.dtype)
        if alpha:
            log.warning("Warning: the map has an alpha band, which marks the outside; the value "
                        "%g of %s is written there, but not declared.", nodata, Remedy("nodata"))
        return replace(spec, nodata=None if alpha else nodata, fill=nodata)
    if alpha:
        return spec
    if not same:
        log.warning("Note: the bands of the image have different nodata values, and a GeoTIFF "
                    "has only one: a mask marks the outside.")
    elif common is None and spec.dtype.kind in "fc":
        common = float("nan")
    elif common is None and spec.table:
        # QGIS draws a table next to a mask without its colours.
        common = _unused_index(picture)
    return replace(spec, nodata=common, fill=common)


def _unused_index(picture: Picture) -> int | None:
    """Return an index of the colour table that no pixel has, to mark where the map has no data.

    Returns None if pixels have all indices, if the picture is not a file, or if its type has no
    table.
    """
    band = picture.bands[0]
    if picture.path is None or band.type not in _WITH_TABLE:
        return None
    is_used = np.zeros(2**16 if band.type == "UInt16" else 2**8, dtype=bool)
    with open_raster(picture.path) as raster:
        for _, window in raster.block_windows(band.source):
            is_used[raster.read(band.source, window=window).ravel()] = True
    unused = np.flatnonzero(~is_used)
    # Past the end of the table if possible: such an index takes no colour from the image's own.
    past_table = unused[unused >= len(band.table)]
    candidates = past_table if len(past_table) else unused
    return int(candidates[0]) if len(candidates) else None


def _common_nodata(values: tuple[float | None, ...]) -> tuple[float | None, bool]:
    """Return the value of all bands for no data, and True; None and False if they differ.

    The value is None, too, where no band has one.
    """
    first = values[0]
    for value in values[1:]:
        both_nan = (value is not None and first is not None
                    and np.isnan(value) and np.isnan(first))
        if value != first and not both_nan:
            return None, False
    return first, True


def _prepare_for_resampling(picture: Picture, resampling: str | None) -> tuple[Picture, str]:
    """Return a picture whose values may be resampled as is asked for, and the resampling.

    Colours are resampled instead of the indices of a table, and grey instead of bits; so are
    tables with colours that are partly transparent, which a GeoTIFF does not hold. Both are noted.
    By default the resampling is nearest for indices, classes and bits, else bilinear.

    Raises TermselError for an unknown resampling, and for one that would mix pixels of classes.
    """
    if resampling is not None and resampling not in RESAMPLING:
        raise unknown_name_error("resampling", resampling, RESAMPLING)
    if not picture.category:
        return picture, resampling or "bilinear"
    # Indices of a table are names, not amounts: between red and blue is no index of violet.
    mixes_pixels = (resampling or "nearest") != "nearest"
    bands = [band for band in picture.bands if band.category]
    if mixes_pixels and any(band.thematic for band in bands):
        raise TermselError(f"the pixels of this image are classes, which {resampling} would mix",
                           file=picture.path, hint="Leave --resampling out, for nearest.")
    if mixes_pixels:
        log.warning("Note: the map has the colours of the image's table instead of its indices, as "
                    "%s mixes pixels; without %s it keeps them.", resampling, Remedy("resampling"))
        return expand_colours(picture), str(resampling)
    # The colour table of a GeoTIFF knows opaque colours alone.
    alphas = {colour[3] for band in bands for colour in band.table}
    if any(0 < alpha < 255 for alpha in alphas):
        log.warning("Note: the map has red, green, blue and alpha instead of the image's table, "
                    "as colours of that are partly transparent.")
        return expand_colours(picture), "nearest"
    if resampling is None:
        log.info("Resampling: nearest, as the pixels are %s.",
                 "bits" if any(band.bits == 1 for band in bands) else "indices or classes")
    return picture, "nearest"


def _require_held(nodata: float, dtype: np.dtype[Any]) -> None:
    """Raise TermselError for a value that pixels of this type cannot hold."""
    from rasterio.dtypes import in_dtype_range

    if not in_dtype_range(nodata, dtype.name) or (dtype.kind in "iu" and nodata != int(nodata)):
        raise TermselError(f"pixels of the type {dtype} cannot have the value {nodata:g}",
                           hint="Give another --nodata.")


def warp(raster: Any, output: Path, grid: MapGrid, spec: MapPixels, *, tags: Mapping[str, str],
         progress: Callable[[float], None] | None, positions: MapPositions | None = None,
         **options: Any) -> None:
    """Warp a picture, tile by tile, into a cloud-optimised GeoTIFF.

    Warns of pixels that have the value of nodata in the image itself, and are empty on the map.

    Parameters
    ----------
    raster : rasterio.DatasetReader
        The VRT of `spec.picture`, with georeferencing unless positions are given.
    output : pathlib.Path
    grid : MapGrid
    spec : MapPixels
    tags : mapping
        The tags of the map.
    progress : callable, optional
        Called with the share that is finished, 0 to 1.
    positions : MapPositions, optional
        Where the pixels of the map are in the image; by default GDAL's warper computes that.
    **options
        Options of GDAL's transformer.

    Raises
    ------
    TermselError
        If the image or the heights cannot be read, or the map cannot be written.
    """
    from rasterio._err import CPLE_BaseError
    from rasterio.errors import RasterioError

    lost = 0

    def warp_tile(window: Any, transform: Any) -> tuple[Values, Mask]:
        """Return the values of a tile of the map, and where it has any.

        They are (bands, lines, samples) and (lines, samples). Raises TermselError where the image
        or the heights cannot be read.
        """
        nonlocal lost
        shape = window.height, window.width
        try:
            if positions is not None:
                tile, visible = _interpolate_tile(raster, spec,
                                                  positions.of_tile(shape, transform))
            else:
                tile, visible = with_dataset(raster, _warp_tile, spec, shape, grid.crs, transform,
                                             options)
        except (RasterioError, CPLE_BaseError) as error:
            raise _unreadable_source(spec.picture.path, error) from error
        if spec.table:
            # Values whose colour is transparent are no picture; those without a colour are.
            opaque = np.ones(max(len(spec.table), int(tile[0].max()) + 1), dtype=bool)
            opaque[:len(spec.table)] = [alpha > 0 for *_, alpha in spec.table]
            visible &= opaque[tile[0]]
        if spec.fill is not None:
            if spec.nodata is not None:
                lost += _move_off_nodata(tile[:len(spec.empty)], visible, spec)
            tile[:len(spec.empty), ~visible] = spec.fill
        in_order = spec.order == tuple(range(len(tile)))
        return tile if in_order else tile[list(spec.order)], visible

    write_cog(output, _profile_of_map(grid, spec), warp_tile, describe=lambda tiled: _describe(
        tiled, spec, tags), progress=progress,
        masked=spec.masked, nearest=spec.category, bits=spec.bits)
    if lost:
        log.warning("Warning: %d px of the map have the value %g of %s in the image itself; they "
                    "are empty on the map. Give another value, or none.", lost, spec.nodata,
                    Remedy("nodata"))


def _unreadable_source(image: Path | None, error: Exception) -> TermselError:
    """Return the error for a failed warp: of the image if it cannot be read, or of heights."""
    # GDAL says only that warping failed. Reading the image alone shows whether it is at fault.
    if image is not None:
        try:
            with open_raster(image) as raster:
                for _, window in raster.block_windows(1):
                    raster.read(window=window)
        except TermselError as unreadable:
            return unreadable
    return TermselError(f"GDAL cannot warp this image: {reason_of(error)}", file=image,
                        hint="Check the raster of heights: is it complete?")


def _interpolate_tile(raster: Any, spec: MapPixels, positions: FloatArray) -> tuple[Values, Mask]:
    """Return a tile of the map (bands, lines, samples), alpha last, and where it shows the image.

    `positions` (lines, samples, 2) are line and sample in the image of the pixels of the tile, NaN
    for pixels that are not in it. Only the window of the image that they need is read; where that
    would be too large, as under a map much coarser than the image, the tile is made in two halves.
    `spec` says how pixels are resampled and which value stands for no data.
    """
    n_colours = len(spec.empty)
    bands = n_colours + spec.alpha
    shape = positions.shape[:2]
    empty = np.array([0.0 if value is None else value for value in spec.empty] + [0.0] * spec.alpha)
    window = _window_of(raster, spec, positions)
    if window is None:
        tile = np.zeros((bands, *shape), dtype=spec.dtype)
        tile[:] = empty.astype(spec.dtype)[:, None, None]
        return tile, np.zeros(shape, dtype=bool)
    # Each half needs a smaller window, down to a single pixel.
    size = window.width * window.height * bands * spec.dtype.itemsize
    if size > _LARGEST_PART and max(shape) > 1:
        axis = int(np.argmax(shape))
        halves = [_interpolate_tile(raster, spec, half)
                  for half in np.array_split(positions, 2, axis)]
        return (np.concatenate([tile for tile, _ in halves], axis + 1),
                np.concatenate([visible for _, visible in halves], axis))
    values, has_data = _pixels_and_mask(raster, spec, window)
    image_window = ImageWindow(values, has_data, window.row_off, window.col_off)
    tile, has_value = resample_pixels(image_window, positions, spec.resampling, raster.shape, empty)
    # As gdalwarp does: a pixel that has no data in some bands is visible by the others.
    visible = np.asarray(has_value[:n_colours].any(axis=0))
    if spec.alpha:
        visible &= tile[-1] != 0
    return tile, visible


def _window_of(raster: Any, spec: MapPixels, positions: FloatArray) -> Any:
    """Return the window of an image that resampling at positions needs; None if all are outside.

    `positions` (..., 2) are line and sample.
    """
    from rasterio.windows import Window

    lines, samples = raster.shape
    low, high = extent_of_positions(positions, lines, samples)
    if not (low <= high).all():
        return None
    # A kernel reaches beyond the position that it is for.
    margin = np.ceil(reach(spec.resampling, positions)).astype(int)
    first = np.maximum(np.floor(low).astype(int) - margin, 0)
    last = np.minimum(np.ceil(high).astype(int) + margin + 1, [lines, samples])
    return Window(int(first[1]), int(first[0]), int(last[1] - first[1]), int(last[0] - first[0]))


def _pixels_and_mask(raster: Any, spec: MapPixels, window: Any) -> tuple[Values, Mask]:
    """Return pixels (bands, lines, samples) of a window, alpha last, and which of them are data.

    A pixel is data in a band unless it has the band's value for no data, is masked, or is wholly
    transparent.
    """
    bands = list(range(1, len(spec.empty) + spec.alpha + 1))
    values = np.ascontiguousarray(raster.read(bands, window=window).astype(spec.dtype, copy=False))
    has_data = np.ones(values.shape, dtype=bool)
    for band, empty in enumerate(spec.empty):
        # NaN is no data in every image of floating-point numbers, declared or not.
        if spec.dtype.kind in "fc":
            has_data[band] = ~np.isnan(values[band])
        if empty is not None and not np.isnan(empty):
            has_data[band] &= values[band] != spec.dtype.type(empty)
    if spec.picture.masked:
        has_data &= raster.read_masks(1, window=window) > 0
    if spec.alpha:
        has_data[:-1] &= values[-1] > 0
    return values, has_data


def _warp_tile(raster: Any, spec: MapPixels, shape: tuple[int, int], crs: str, transform: Any,
               options: Mapping[str, Any]) -> tuple[Values, Mask]:
    """Return a tile of the map (bands, lines, samples), alpha last, and where it shows the image.

    GDAL computes the positions itself here, by the RPC in `raster`. `transform` places the tile in
    `crs`; `options` are further ones of the warper. Bands whose value for "no data" differs are
    warped one by one.
    """
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.warp import reproject

    colours = len(spec.empty)
    tile = np.zeros((colours + 1, *shape), dtype=spec.dtype)
    # PARTIAL is as gdalwarp does: a pixel that has no data in some bands is visible by the others.
    # Only where RPCs are named does rasterio let GDAL compute every pixel's place rather than
    # interpolate along lines, which does not hold in relief.
    warp_options = {"dst_crs": crs, "dst_transform": transform, "dst_alpha": colours + 1,
                    "src_alpha": colours + 1 if spec.alpha else 0, "rpcs": raster.rpcs,
                    "resampling": Resampling[spec.resampling], "UNIFIED_SRC_NODATA": "PARTIAL",
                    **options}
    if len(set(map(str, spec.empty))) == 1:
        empty = spec.empty[0]
        if empty is None and spec.dtype.kind in "fc":
            empty = float("nan")
        every_band = rasterio.band(raster, list(range(1, colours + 1)))
        reproject(every_band, tile, src_nodata=empty, **warp_options)
        visible = tile[-1] != 0
        if empty is not None and colours > 1 and spec.resampling in _NEGATIVE_WEIGHTS:
            # Where a band has no data at a pixel's own place and others do, the warper divides by
            # a sum of weights near zero: 65,535 came of data up to 20,000.
            nearest_tile = np.zeros_like(tile)
            nearest = warp_options | {"resampling": Resampling.nearest}
            reproject(every_band, nearest_tile, src_nodata=empty, **nearest)
            if np.isnan(empty):
                is_empty = np.isnan(nearest_tile)
            else:
                is_empty = nearest_tile == tile.dtype.type(empty)
            tile[:-1][is_empty[:-1]] = empty
    else:
        visible = np.zeros(shape, dtype=bool)
        for number, empty in enumerate(spec.empty, 1):
            tile[-1] = 0
            reproject(rasterio.band(raster, [number]), tile, src_nodata=empty, **warp_options)
            visible |= tile[-1] != 0
    return (tile if spec.alpha else tile[:-1]), visible


def _move_off_nodata(tile: Values, visible: Mask, spec: MapPixels) -> int:
    """Move visible values that equal the map's no-data value by the least step, in place.

    The values of categories are not moved: the pixels that have that value are lost. Returns how
    many these are, and 0 otherwise.
    """
    if spec.nodata is None or np.isnan(spec.nodata):
        return 0
    like_nodata = visible & (tile == spec.nodata)
    if spec.empty[0] is not None:
        # In the image, a pixel that has data may have none in some of its bands.
        like_nodata &= like_nodata.all(axis=0)
    if spec.category:
        return int(like_nodata.any(axis=0).sum())
    if like_nodata.any():
        value = tile.dtype.type(spec.nodata)
        if tile.dtype.kind in "iu":
            tile[like_nodata] = value - 1 if value == np.iinfo(tile.dtype).max else value + 1
        else:
            tile[like_nodata] = np.nextafter(value.real, value.real + 1)
    return 0


def _profile_of_map(grid: MapGrid, spec: MapPixels) -> dict[str, Any]:
    """Return the profile of the map, with which rasterio creates it."""
    return {"height": grid.lines, "width": grid.samples, "count": len(spec.order),
            "dtype": spec.dtype.name, "crs": grid.crs, "transform": grid.transform,
            "nodata": spec.nodata, **({"alpha": "YES"} if spec.alpha else {}),
            **({"nbits": spec.bits} if spec.bits else {})}


def _describe(tiled: Any, spec: MapPixels, tags: Mapping[str, str]) -> None:
    """Set the colours of the map, and the descriptions, units, scales and tags (in place).

    A table of colours that a GeoTIFF cannot have is left out with a warning.
    """
    from rasterio.enums import ColorInterp

    bands = spec.bands
    colours = [ColorInterp[band.colour] for band in bands]
    tables = [number for number, band in enumerate(bands, 1) if band.table]
    if spec.table and spec.picture.bands[0].type in _WITH_TABLE and tables[0] == 1:
        table = dict(enumerate(spec.table))
        # White around the image for programs that show the value of --nodata as any other.
        if spec.nodata is not None:
            table.setdefault(int(spec.nodata), _WHITE)
        tiled.write_colormap(1, table)
    elif tables:
        log.warning("Warning: a GeoTIFF can have a colour table for one band of 8 or 16 bits only; "
                    "the map has the values without colours. gdal_translate -expand rgb makes an "
                    "image with colours.")
        colours = [ColorInterp.undefined if colour == ColorInterp.palette else colour
                   for colour in colours]
    tiled.colorinterp = colours
    for number, band in enumerate(bands, 1):
        if band.description:
            tiled.set_band_description(number, band.description)
        if band.unit:
            tiled.set_band_unit(number, band.unit)
    tiled.scales = [band.scale for band in bands]
    tiled.offsets = [band.offset for band in bands]
    tiled.update_tags(**tags)
