"""Rasters through rasterio and its GDAL, which are optional."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from termsel.errors import TermselError


def require_rasterio() -> Any:
    """Return the package rasterio.

    Raises
    ------
    TermselError
        If it is not installed, with the command that installs it.
    """
    try:
        import rasterio
    except ImportError:
        raise TermselError("this needs the packages for rasters, and rasterio is not installed",
                           hint='Install them: pip install "termsel[gis]".') from None
    # GDAL's errors come as exceptions, and termsel says what they mean; the log says them twice.
    logging.getLogger("rasterio").addHandler(logging.NullHandler())
    return rasterio


@contextmanager
def open_raster(path: Path | str) -> Iterator[Any]:
    """Open a raster for reading.

    Parameters
    ----------
    path : path-like

    Yields
    ------
    rasterio.DatasetReader

    Raises
    ------
    TermselError
        If rasterio is not installed, or GDAL cannot open or read the file.
    """
    rasterio = require_rasterio()
    try:
        with warnings.catch_warnings():
            # An image that is to be georeferenced has no geotransform.
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            raster = rasterio.open(path)
        with raster:
            yield raster
    except (rasterio.errors.RasterioError, rasterio.errors.RasterioIOError) as error:
        raise TermselError(f"GDAL cannot read this raster: {error}", file=path,
                           hint="Is it whole, and an image?") from error
