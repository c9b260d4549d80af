"""Rasters through rasterio and its GDAL, which are optional."""

from __future__ import annotations

import logging
import os
import re
import sys
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from termsel.core.arguments import explains_arguments
from termsel.core.errors import GIS, TermselError, require_import
from termsel.core.files.drivers import (
    NO_PROXY_EXISTS,
    drivers_are_off,
    gdal_options,
    keep_own_drivers_only,
    raster_drivers,
    without_proxy_exceptions,
)
from termsel.core.files.names import (
    is_there,
    no_such_file_error,
    refuse_grids,
    refuse_pipe,
    utf8_name,
)
from termsel.core.files.sources import (
    REMOTE_HINT,
    is_single_file,
    may_name_more,
    refuse_foreign,
    refuse_named,
    refused_format_error,
)
from termsel.data.distant_rasters import open_distant
from termsel.data.features import FloatArray

LARGEST_BLOCK = 2**29
"""Bytes of one band that GDAL may have to hold at once."""

SMALL = 2**28
"""Bytes of pixels that are read whatever the size of the file."""

_DENSEST = 500
"""Bytes of pixels that a byte of a file may hold unasked; scans of text and constant images have
more."""

_MOST_BLOCKS = 100
"""Rows and columns of blocks of a giant TIFF that are looked for."""

_LEAST_SHARE = 0.5
"""Of the blocks of a giant TIFF that must be in the file."""

_WITHOUT_HOLES = ("JPEG", "JP2OpenJPEG", "PNG")
"""Formats that cannot leave out pixels: those that a file lacks cannot be read."""

_UNREADABLE_PIXELS = re.compile(r"IReadBlock failed|TIFFReadEncoded|TIFFFillStrip|TIFFFillTile")
"""What GDAL says where a file ends before its pixels do, or they are damaged."""

_BYTES = {"complex_int16": "complex64"}
"""Types of rasterio that NumPy has not."""


def require_rasterio() -> Any:
    """Return the package rasterio; raises TermselError, with how to install it, if it is missing.

    GDAL keeps only the drivers that are allowed in this process.
    """
    if "rasterio" not in sys.modules:
        # GDAL's errors come as exceptions, which termsel explains; the log would repeat them.
        logging.getLogger("rasterio").addHandler(logging.NullHandler())
    with keep_own_drivers_only(), require_import("this requires", "rasterio", GIS):
        import rasterio

        # GDAL looks for its drivers in the first environment, which has to be this one.
        with rasterio.Env():
            pass
    return rasterio


def empty_tiff() -> bytes:
    """Return a GeoTIFF with a single pixel, for files that GDAL reads only next to an image."""
    return tiff_bytes(np.zeros((1, 1, 1), dtype=np.uint8))


def tiff_bytes(pixels: Any, driver: str = "GTiff", **profile: Any) -> bytes:
    """Return the bytes of a GeoTIFF, made in memory, of pixels (bands, lines, samples).

    `driver` is GDAL's name of another format, and `profile` are further options of it. Raises
    TermselError without rasterio.
    """
    rasterio = require_rasterio()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        # In memory the file is always complete; on a full disk GDAL may fail without an error.
        with rasterio.MemoryFile() as memory:
            with memory.open(driver=driver, count=pixels.shape[0], height=pixels.shape[1],
                             width=pixels.shape[2], dtype=pixels.dtype.name, **profile) as raster:
                raster.write(pixels)
            return bytes(memory.read())


@contextmanager
def _quiet_about_encodings() -> Iterator[None]:
    """Keep Python from printing that rasterio cannot log a message that is not UTF-8.

    Python would print it twice, through two hooks, before the error is raised, which says what is
    wrong. The hooks are put back afterwards.
    """
    unraisable = sys.unraisablehook
    uncaught = sys.excepthook

    def not_raised(unraised: sys.UnraisableHookArgs) -> None:
        if not isinstance(unraised.exc_value, UnicodeDecodeError):
            unraisable(unraised)

    def not_caught(kind: type[BaseException], error: BaseException,
                   trace: TracebackType | None) -> None:
        if not isinstance(error, UnicodeDecodeError):
            uncaught(kind, error, trace)

    sys.unraisablehook = not_raised
    sys.excepthook = not_caught
    try:
        yield
    finally:
        sys.unraisablehook = unraisable
        sys.excepthook = uncaught


@explains_arguments()
@contextmanager
def open_raster(path: Path | str) -> Iterator[Any]:
    """Open a raster for reading.

    Parameters
    ----------
    path : path-like
        A raster of a format of `termsel.core.files.drivers`, or of one that the user allows, or a
        virtual raster whose sources are such.

    Yields
    ------
    rasterio.DatasetReader or termsel.data.distant_rasters.DistantRaster
        The second has the attributes and methods of the first. In a program of the user, whose GDAL
        has all drivers, it stands for a raster of several files, which a process of termsel reads.
        Functions of rasterio that take a dataset are called by `with_dataset`.

    Raises
    ------
    TermselError
        If rasterio is not installed; if GDAL cannot open or read the file; if it, or what it
        names, is of another format or on a server (see `termsel.core.files.sources`).

    Examples
    --------
    >>> import tempfile, termsel
    >>> from pathlib import Path
    >>> from termsel.toolkit.files import write_example
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = Path(folder) / "files"
    ...     _ = write_example(files)
    ...     with termsel.open_raster(files / "scene.tif") as raster:
    ...         raster.count
    1
    """
    rasterio = require_rasterio()
    from rasterio._err import CPLE_BaseError

    refuse_pipe(Path(path))
    path = gdal_name(path)
    sources = refuse_foreign(path)
    # In termsel's own processes GDAL has no driver beyond the list. Elsewhere the list is given for
    # one file, and GDAL would use any driver for further files that it opens with that one.
    may_open_others = not drivers_are_off() and not is_single_file(path)
    try:
        with ExitStack() as stack:
            raster = None if may_open_others else stack.enter_context(_open_here(path, sources))
            if raster is None or (not drivers_are_off() and any(_rasters_named_by(raster))):
                stack.close()
                raster = stack.enter_context(open_distant(path))
            _refuse_large_blocks(path, raster)
            for crs in (raster.crs, raster.gcps[1]):
                refuse_grids("" if crs is None else crs.to_wkt(), path)
            yield raster
    except (rasterio.errors.RasterioError, CPLE_BaseError) as error:
        # rasterio's own message only points to the cause.
        raise _unreadable_error(path, str(error.__cause__ or error).rstrip(".")) from error
    except UnicodeDecodeError as error:  # names, or what GDAL quotes of the file
        raise TermselError("this raster has text that is not UTF-8", file=path,
                           hint="Save the file, or the file beside it, with the encoding UTF-8."
                           ) from error


@contextmanager
def _open_here(path: Path | str, sources: list[str]) -> Iterator[Any]:
    """Open a raster in this process: with a driver of the list, and without requests."""
    import rasterio

    drivers = [name for name in raster_drivers() if name != "VRT" or drivers_are_off()]
    with (without_proxy_exceptions(), rasterio.Env(**gdal_options()), utf8_name(path) as name,
          _quiet_about_encodings(), np.errstate(over="ignore")):
        # np.errstate is for rasterio, which compares a nodata value with what the type can hold.
        with warnings.catch_warnings():
            # An image that is to be georeferenced has no geotransform.
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            # rasterio.open itself takes no list of drivers.
            raster = rasterio.io.DatasetReader(str(name), driver=drivers)
        with raster:
            refuse_named(path, _rasters_named_by(raster))
            for name in sources:
                if name != str(path) and may_name_more(name):
                    _refuse_named_by(name)
            yield raster


@contextmanager
def without_siblings() -> Iterator[None]:
    """Let GDAL see an image alone, without the files next to it."""
    rasterio = require_rasterio()
    with rasterio.Env(GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR"):
        yield


def gdal_name(path: Path | str) -> Path | str:
    """Return a path as a name for GDAL, with the second slashes that pathlib took away.

    Addresses such as ``/vsicurl/https://...`` and absolute places in archives have them. Any other
    path is returned unchanged, and so is that of a file which exists.
    """
    name = str(path)
    if os.path.lexists(name):
        return path
    # pathlib makes one slash of "https://", and two of "/vsizip//tmp" likewise.
    address = re.sub(r"\b(https?|ftp):/(?!/)", r"\1://", name)
    if address != name:
        return address
    archive = re.fullmatch(r"(/vsi(?:zip|tar|gzip|7z|rar)/)([^/{].*)", name)
    if archive is None or any(map(os.path.lexists, (archive[2], archive[2].partition("/")[0]))):
        return path
    return f"{archive[1]}/{archive[2]}"


def _refuse_named_by(name: str) -> None:
    """Raise TermselError if a source of a virtual raster names a file that must not be opened.

    A source that cannot be opened raises nothing: reading its pixels does.
    """
    import rasterio

    try:
        source = rasterio.io.DatasetReader(name, driver=list(raster_drivers()))
    except rasterio.errors.RasterioIOError:
        return
    with source:
        refuse_named(name, _rasters_named_by(source))


def _rasters_named_by(raster: Any) -> Iterator[str]:
    """Yield the rasters that the metadata of an open one name, wherever GDAL found them."""
    for domain in ("OVERVIEWS", "GEOLOCATION"):
        tags = raster.tags(ns=domain)
        yield from (value for key, value in tags.items()
                    if key.upper() in ("OVERVIEW_FILE", "X_DATASET", "Y_DATASET"))


def _refuse_large_blocks(path: Path | str, raster: Any) -> None:
    """Refuse a raster of which GDAL must hold more than a gigabyte to read a single pixel."""
    # A block is what GDAL reads at once: a strip may be a whole image.
    sizes = [lines * samples * np.dtype(_BYTES.get(kind, kind)).itemsize
             for (lines, samples), kind in zip(raster.block_shapes, raster.dtypes, strict=True)]
    if max(sizes, default=0) > LARGEST_BLOCK:
        raise TermselError(
            f"GDAL would have to hold {max(sizes) / 2**30:,.1f} GiB of this raster at once",
            file=path, hint="Divide it into tiles: gdal_translate -co TILED=YES FILE map.tif.")


def refuse_empty_giant(raster: Any) -> None:
    """Refuse to read a raster whose pixels are hundreds of times what its files hold.

    A small file can claim to have any size, and to read all of its pixels would take hours. One
    that compresses well has its pixels, and is not refused. Rasters in archives and on servers,
    whose files have no known size, are not refused either.

    Raises
    ------
    TermselError
        If the pixels take more than `SMALL`, and more than `_DENSEST` times the size of the files,
        and are not in them.
    """
    pixels = float(raster.width) * raster.height * raster.count
    size = pixels * np.dtype(_BYTES.get(raster.dtypes[0], raster.dtypes[0])).itemsize
    # All files count: a virtual raster has its pixels in others.
    stored = sum(os.path.getsize(file) for file in raster.files if os.path.isfile(file))
    archived = any(file.startswith("/vsi") for file in raster.files)
    if archived or size <= SMALL or size <= _DENSEST * stored or _has_its_pixels(raster):
        return
    raise TermselError(
        f"this raster of {raster.height:,} lines and {raster.width:,} samples has only "
        f"{stored / 1024:,.0f} KiB of data", file=raster.name,
        hint="Give a raster that has pixels, or a smaller one.")


def _has_its_pixels(raster: Any) -> bool:
    """Return whether the pixels of a raster are in its file, by its blocks or its end.

    Formats of which neither is known are taken to lack them.
    """
    from rasterio.errors import RasterioIOError
    from rasterio.windows import Window

    if raster.driver == "GTiff":
        return _share_of_blocks(raster) >= _LEAST_SHARE
    if raster.driver not in _WITHOUT_HOLES:
        return False
    # The last block of the last band is at the end of the file.
    lines, samples = raster.block_shapes[-1]
    first_line = (raster.height - 1) // lines * lines
    first_sample = (raster.width - 1) // samples * samples
    try:
        raster.read(raster.count, window=Window(first_sample, first_line,
                                                raster.width - first_sample,
                                                raster.height - first_line))
    except RasterioIOError:
        return False
    return True


def _share_of_blocks(raster: Any) -> float:
    """Return the share of the blocks of a TIFF that are in its file.

    Of many blocks those on a regular grid are looked at, in each band.
    """
    present: list[bool] = []
    for band, (lines, samples) in enumerate(raster.block_shapes, 1):
        rows = -(-raster.height // lines)
        columns = -(-raster.width // samples)
        for row in range(0, rows, -(-rows // _MOST_BLOCKS)):
            for column in range(0, columns, -(-columns // _MOST_BLOCKS)):
                offset = raster.get_tag_item(f"BLOCK_OFFSET_{column}_{row}", "TIFF", band)
                present.append(offset is not None)
    return sum(present) / len(present)


def _unreadable_error(path: Path | str, reason: str) -> TermselError:
    """Return the error for a raster that GDAL cannot read, with a hint by GDAL's `reason`."""
    if not is_there(Path(path)) and not str(path).startswith("/vsi"):
        return no_such_file_error(path)
    if "not recognized as being in a supported file format" in reason:
        try:
            head = Path(path).read_bytes() if Path(path).stat().st_size < 4096 else b""
        except OSError:
            head = b""
        return refused_format_error(path, head)
    if _UNREADABLE_PIXELS.search(reason):
        return TermselError("the pixels of this raster cannot be read: it is incomplete or damaged",
                            file=path, hint="Copy or download it again.")
    if NO_PROXY_EXISTS in reason:
        hint = REMOTE_HINT
    else:
        hint = "Copy it again if it is incomplete, or convert it: gdal_translate FILE map.tif."
    return TermselError(f"GDAL cannot read this raster: {reason}", file=path, hint=hint)


def pixel_positions(raster: Any, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return line and sample (n, 2) of coordinates in the CRS of a raster with a geotransform.

    The centre of the upper-left pixel is (0, 0). Raises TermselError if the pixels have no size.
    """
    if raster.transform.is_degenerate:
        raise TermselError("the pixels of this raster have no size", file=raster.name,
                           hint="Correct its geotransform.")
    # The inverse affine map gives sample and line from the upper-left corner: half a pixel less
    # from the centre of the first pixel.
    to_pixel = ~raster.transform
    with np.errstate(invalid="ignore", over="ignore"):  # what cannot be transformed is infinite
        return np.stack([to_pixel.d * x + to_pixel.e * y + to_pixel.f,
                         to_pixel.a * x + to_pixel.b * y + to_pixel.c], axis=1) - 0.5
