"""The raster that a file goes with, or one without a picture in its place."""

from __future__ import annotations

import logging
import re
import shlex
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from termsel import Result, TermselError
from termsel.toolkit import private_folder, require_rasterio

log = logging.getLogger(__name__)

_PICTURES = (".tif", ".tiff", ".jp2", ".jpg", ".jpeg", ".png", ".ntf", ".img", ".vrt")
_STEM = re.compile(r"(?P<stem>.+?)(?P<rest>_rpc\.txt|\.rpb|\.t(?:i?f)?w|\.tifw|\.jgw|\.pgw|\.j2w"
                   r"|\.wld)$", re.IGNORECASE)
_AUXILIARY = ".aux.xml"
_RECORD, _CERTIFICATE = "result.json", "certificate.json"
"""Files in the folder of a result."""


@contextmanager
def raster_of(path: Path, result: Result | None) -> Iterator[Path]:
    """Yield the raster that programs can be asked about, for a raster or a file that goes with one.

    For a world file, an RPC or an auxiliary file it is the image beside it. If there is none, an
    empty raster is made, with the size of the result's image and a copy of the file beside it. Any
    other file is taken for a raster. Raises TermselError for a folder, for a file that does not
    exist, for a world file without its numbers, and if there is neither an image nor its size.
    """
    if path.is_dir():
        raise _folder_error(path)
    if path.name == _CERTIFICATE and (path.parent / _RECORD).is_file() and not path.is_file():
        raise TermselError("the run of this folder has kept no certificate", file=path,
                           hint="Run again with --solver exact --set certificate=yes.")
    if not path.is_file():
        raise TermselError("there is no such file", file=path, hint="Check the name.")
    match = _STEM.fullmatch(path.name)
    is_auxiliary = path.name.lower().endswith(_AUXILIARY)
    if not match and not is_auxiliary:
        _warn_of_world_files(path)
        yield path
        return
    # scene.tif.aux.xml belongs to scene.tif; scene.tfw and scene_RPC.TXT to any scene.* image.
    if is_auxiliary:
        stem = path.name[:-len(_AUXILIARY)]
        candidates = [path.with_name(stem)]
    else:
        stem = str(match and match["stem"])
        candidates = [entry for entry in sorted(path.parent.iterdir())
                      if entry.stem == stem and entry.suffix.lower() in _PICTURES]
    picture = next((candidate for candidate in candidates if candidate.is_file()), None)
    is_world_file = match is not None and _is_world_file(match)
    if picture is not None:
        if is_world_file:
            _require_world_file(path)
        yield picture
        return
    size = None if result is None else result.features.image_size
    if size is None:
        picture_name = candidates[0].name if is_auxiliary else f"{stem}.tif"
        if result is None:
            remedy = "or give --result DIR of a run with --image"
        else:
            remedy = "as the run of --result had no --image and does not know its size"
        raise TermselError(
            f"this file belongs to an image such as {picture_name}, which is not beside it",
            file=path, hint=f"Put the image beside it under the name {picture_name}, {remedy}.")
    if is_world_file:
        _require_world_file(path)
    # Programs look for such a file by the name of the image, so both get matching names.
    with private_folder() as folder:
        image = folder / ("image.tif" if match else Path(stem).with_suffix(".tif").name)
        _write_empty(image, size)
        name = f"{image.name}{_AUXILIARY}" if is_auxiliary else f"image{match['rest']}"  # type: ignore[index]
        shutil.copy(path, folder / name)
        yield image


def _warn_of_world_files(picture: Path) -> None:
    """Warn of each world file beside a picture that programs ignore, as it is none."""
    for entry in sorted(picture.parent.iterdir()):
        match = _STEM.fullmatch(entry.name)
        if match is None or match["stem"] != picture.stem or not _is_world_file(match):
            continue
        try:
            _require_world_file(entry)
        except TermselError as error:
            log.warning("Warning: %s", error)


def _is_world_file(match: re.Match[str]) -> bool:
    """Return whether the name of a file is that of a world file, and not of an RPC."""
    return match["rest"].lower() not in ("_rpc.txt", ".rpb")


def _folder_error(folder: Path) -> TermselError:
    """Return the error for a folder in place of a raster.

    For the folder of a result it has the commands that show the result or check a map by it.
    """
    if not (folder / _RECORD).is_file():
        return TermselError("this is a folder, expected a file", file=folder,
                            hint="Give a raster, a file that goes with one, or the "
                                 f"{_CERTIFICATE} of a result.")
    name = shlex.quote(str(folder))
    return TermselError("this is the folder of a result, expected a raster", file=folder,
                        hint=f"termsel report {name} shows the result; termsel check map.tif "
                             f"--result {name} checks a map by it.")


def _require_world_file(path: Path) -> None:
    """Raise TermselError unless a file consists of the six numbers of a world file.

    Numbers may have decimal commas. The message counts the numbers and the words that are none.
    """
    words = path.read_bytes().decode("utf-8", errors="replace").split()
    numbers = [word for word in words if _is_number(word)]
    if len(numbers) != _NUMBERS or len(words) != _NUMBERS:
        if len(numbers) == len(words):
            further_words = ""
        else:
            further_words = f", and {len(words) - len(numbers)} words that are none"
        raise TermselError(
            f"a world file has {_NUMBERS} numbers, a line each, and this one has "
            f"{len(numbers)}{further_words}: programs ignore it", file=path,
            hint="Correct it, or write it again: termsel export DIR --to world-file.")


def _is_number(word: str) -> bool:
    """Return whether a word is a finite number, with a point or a comma for its decimals."""
    try:
        return bool(np.isfinite(float(word.replace(",", "."))))
    except ValueError:
        return False


_NUMBERS = 6
"""Numbers of a world file."""


def _write_empty(path: Path, size: tuple[int, int]) -> None:
    """Write a GeoTIFF of zeros with `size` lines and samples; it is sparse, and so takes no room.
    """
    import warnings

    rasterio = require_rasterio()
    # rasterio warns of rasters that are not georeferenced, as this one must be.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(path, "w", driver="GTiff", height=size[0], width=size[1], count=1,
                           dtype=np.uint8, sparse_ok=True, tiled=True):
            pass
