"""Rasters through rasterio and its GDAL, which are optional."""

from __future__ import annotations

import logging
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from termsel.errors import GIS, TermselError, requires
from termsel.files.names import is_there, refuse_pipe, utf8_name
from termsel.files.remote import HINT, NO_PROXY_EXISTS, local_alone
from termsel.measurements.features import FloatArray


def require_rasterio() -> Any:
    """Return the package rasterio; the TermselError says how to install it if it is not there."""
    with requires("this requires", "rasterio", GIS):
        import rasterio
    # GDAL's errors come as exceptions, which termsel explains; the log would repeat them.
    logging.getLogger("rasterio").addHandler(logging.NullHandler())
    return rasterio


def empty_tiff() -> bytes:
    """Return a GeoTIFF with a single pixel, for files that GDAL reads only next to an image."""
    return tiff_bytes(np.zeros((1, 1, 1), dtype=np.uint8))


def tiff_bytes(pixels: Any, driver: str = "GTiff", **profile: Any) -> bytes:
    """Return a GeoTIFF, or other image, of pixels (bands, lines, samples), made in memory."""
    rasterio = require_rasterio()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        # What is written as bytes is complete; GDAL may not report a full disk.
        with rasterio.MemoryFile() as memory:
            with memory.open(driver=driver, count=pixels.shape[0], height=pixels.shape[1],
                             width=pixels.shape[2], dtype=pixels.dtype.name, **profile) as raster:
                raster.write(pixels)
            return bytes(memory.read())


@contextmanager
def _quiet_about_encodings() -> Iterator[None]:
    """Keep Python from printing that rasterio cannot log a message that is not UTF-8."""
    # It prints that twice, through either hook, before the error comes as an exception.
    unraisable, uncaught = sys.unraisablehook, sys.excepthook

    def not_raised(what: sys.UnraisableHookArgs) -> None:
        if not isinstance(what.exc_value, UnicodeDecodeError):
            unraisable(what)

    def not_caught(kind: type[BaseException], error: BaseException,
                   trace: TracebackType | None) -> None:
        if not isinstance(error, UnicodeDecodeError):
            uncaught(kind, error, trace)

    sys.unraisablehook, sys.excepthook = not_raised, not_caught
    try:
        yield
    finally:
        sys.unraisablehook, sys.excepthook = unraisable, uncaught


@contextmanager
def open_raster(path: Path | str) -> Iterator[Any]:
    """Open a raster for reading.

    Parameters
    ----------
    path : path-like
        Of any format that GDAL reads.

    Yields
    ------
    rasterio.DatasetReader

    Raises
    ------
    TermselError
        If rasterio is not installed; if GDAL cannot open or read the file; if it has remote
        sources that are not allowed (see `termsel.files.remote`).
    """
    rasterio = require_rasterio()
    from rasterio._err import CPLE_BaseError

    refuse_pipe(Path(path))
    try:
        with (local_alone(path) as options, rasterio.Env(**options), utf8_name(path) as name,
              _quiet_about_encodings(), np.errstate(over="ignore")):
            # The last: rasterio compares a value for no data with what pixels of the type can hold.
            with warnings.catch_warnings():
                # An image that is to be georeferenced has no geotransform.
                warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
                raster = rasterio.open(name)
            with raster:
                yield raster
    except (rasterio.errors.RasterioError, CPLE_BaseError) as error:
        if not is_there(Path(path)):
            raise TermselError("this file does not exist", file=path,
                               hint="Check the name and the folder.") from error
        # rasterio's own message only points to the cause.
        reason = str(error.__cause__ or error).rstrip(".")
        hint = HINT if NO_PROXY_EXISTS in reason else "Is it complete, and an image?"
        raise TermselError(f"GDAL cannot read this raster: {reason}", file=path,
                           hint=hint) from error
    except UnicodeDecodeError as error:  # names, or what GDAL quotes of the file
        raise TermselError("this raster has text that is not UTF-8", file=path,
                           hint="Save the file, or what is next to it, with the encoding UTF-8."
                           ) from error


def positions(raster: Any, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return line and sample (n, 2) of coordinates in the CRS of a raster with a geotransform.

    The centre of the upper-left pixel is (0, 0). Raises TermselError if the pixels have no size.
    """
    if raster.transform.is_degenerate:
        raise TermselError("the pixels of this raster have no size", file=raster.name,
                           hint="Correct its geotransform.")
    to_pixel = ~raster.transform
    with np.errstate(invalid="ignore", over="ignore"):  # what cannot be transformed is infinite
        return np.stack([to_pixel.d * x + to_pixel.e * y + to_pixel.f,
                         to_pixel.a * x + to_pixel.b * y + to_pixel.c], axis=1) - 0.5
