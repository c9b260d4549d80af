"""The raster that is meant where a zip, a product's folder, or a place in a zip is given."""

from __future__ import annotations

import os
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from termsel.core.errors import TermselError

SUFFIXES = (".tif", ".tiff")
"""Endings of rasters that are looked for in zips and folders."""

MAX_ARCHIVE_FILES = 10_000
"""Files of a zip that is looked into."""

_LISTED = 8  # rasters in a message
_BROKEN = (OSError, EOFError, ValueError, zlib.error, NotImplementedError, zipfile.BadZipFile)


def raster_in(path: Path) -> Path:
    """Return the raster that a path stands for: itself, or the one in a zip or folder.

    Parameters
    ----------
    path : pathlib.Path
        A raster; a zip or folder in which there is one TIFF, such as a product of Sentinel-1 with
        one polarisation; or the place of one in a zip, such as ``product.zip/measurement/a.tiff``.

    Returns
    -------
    pathlib.Path
        The raster; one in a zip by its name for GDAL. A path that is neither a zip or folder nor
        in a zip comes back unchanged, whether or not it exists.

    Raises
    ------
    TermselError
        If a zip or folder has several TIFFs or none, if a zip cannot be read, or if it has more
        than `MAX_ARCHIVE_FILES` files.
    """
    # os.path instead of pathlib, whose is_dir raises for names that the system refuses, such as
    # too long ones: these are simply not there.
    if os.path.isdir(path):
        return _only_raster(path, _tiffs_in_folder(path))
    if os.path.isfile(path):
        return path if not zipfile.is_zipfile(path) else _only_raster(path, _tiffs_in_zip(path))
    archive = next((parent for parent in path.parents if os.path.isfile(parent)), None)
    if archive is None or not zipfile.is_zipfile(archive):
        return path
    return _name_for_gdal(path, archive)


def _only_raster(path: Path, rasters: list[Path]) -> Path:
    """Return the only raster of a zip or folder, by its name for GDAL.

    Raises TermselError where there is none, and where there are several.
    """
    if not rasters:
        raise TermselError("there is no TIFF in it", file=path,
                           hint="Give the raster, or its place in the zip: FILE.zip/PLACE.tif.")
    if len(rasters) > 1:
        listed = ", ".join(str(raster.relative_to(path)) for raster in rasters[:_LISTED])
        raise TermselError(f"there are {len(rasters)} rasters in it: {listed}", file=path,
                           hint=f"Name one, such as {rasters[0]}.")
    return rasters[0] if path.is_dir() else _name_for_gdal(rasters[0], path)


def _name_for_gdal(path: Path, archive: Path) -> Path:
    """Return the path by which GDAL reads a file in a zip."""
    return Path("/vsizip", *archive.absolute().parts[1:], *path.relative_to(archive).parts)


def _tiffs_in_folder(folder: Path) -> list[Path]:
    """Return the TIFFs of a folder, or of the folder ``measurement`` of a product."""
    inner = folder / "measurement"
    place = inner if inner.is_dir() else folder
    return sorted(entry for entry in place.iterdir() if entry.suffix.lower() in SUFFIXES)


def _tiffs_in_zip(archive: Path) -> list[Path]:
    """Return the TIFFs of a zip, as if it were a folder.

    Raises TermselError for a zip that cannot be read, or has more than `MAX_ARCHIVE_FILES` files.
    """
    try:
        with zipfile.ZipFile(archive) as packed:
            names = packed.namelist()
    except _BROKEN as error:
        raise TermselError(f"this zip cannot be read: {error}", file=archive,
                           hint="Download or copy it again.") from error
    if len(names) > MAX_ARCHIVE_FILES:
        raise TermselError(f"this zip has {len(names):,} files", file=archive,
                           hint="Name the raster in it: FILE.zip/PLACE.tif.")
    # A name that leads out of the zip is not followed.
    places = map(PurePosixPath, names)
    rasters = (place for place in places if place.suffix.lower() in SUFFIXES
               and ".." not in place.parts and not place.is_absolute())
    return sorted(archive / place for place in rasters)
