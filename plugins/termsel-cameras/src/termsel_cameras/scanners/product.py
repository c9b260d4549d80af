"""The files of a Sentinel-1 product: a folder, its zip, an annotation, or an image.

A product is a folder named ``....SAFE`` with one annotation for each swath and polarisation, in
``annotation``, and one image for each, in ``measurement``. It is distributed as a zip of that
folder. Nothing is unpacked: an annotation in a zip is named as if the zip were a folder.
"""

from __future__ import annotations

import os
import re
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from termsel import TermselError
from termsel.toolkit import read_data

LARGEST = 64 << 20
"""Bytes of an annotation; those of the products have up to 4 MiB."""

MOST_FILES = 10_000
"""Files of a zip; products have some fifty."""

ANNOTATION_NAMES = re.compile(r"(?P<mission>s1[a-z])-(?P<swath>[a-z0-9]+)-(?P<kind>slc|grd[a-z]?)-"
                              r"(?P<polarisation>[hv]{2})-\d{8}t\d{6}-", re.IGNORECASE)
"""Names of annotations and images (Sentinel-1 Product Specification, section 3.2)."""

HINT = ("Give a product of Sentinel-1: the folder ....SAFE, its zip, an annotation "
        "(annotation/s1...xml), or an image (measurement/s1...tiff).")

_ZIP = (b"PK\x03\x04", b"PK\x05\x06")
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_BROKEN = (OSError, EOFError, KeyError, ValueError, zlib.error, NotImplementedError, RuntimeError,
           zipfile.BadZipFile)


@dataclass(frozen=True)
class Image:
    """One image of a product, by the name of its annotation."""

    annotation: Path
    swath: str  # such as "IW" or "IW2"; "" where the name does not say it
    polarisation: str

    @property
    def name(self) -> str:
        """Swath and polarisation."""
        return f"{self.swath} {self.polarisation}".strip() or self.annotation.name


def images_of(path: Path) -> tuple[Image, ...]:
    """Return the images of a product, each by its annotation.

    Parameters
    ----------
    path : pathlib.Path
        A folder, its zip, its manifest.safe, or an image.

    Returns
    -------
    tuple of Image
        Empty if the path is no product of Sentinel-1, cannot be read, or is an annotation itself.
    """
    # The kind of a file is shown by its first bytes rather than its name, which people change.
    try:
        if path.is_dir():
            return _images_in_order(_annotations_in_folder(path))
        if not path.is_file():
            return ()
        with path.open("rb") as file:
            head = file.read(4)
    except OSError:
        return ()
    if head in _ZIP:
        return _images_in_order(_annotations_in_zip(path))
    if path.name.lower() == "manifest.safe":
        return _images_in_order(_annotations_in_folder(path.parent))
    if head in _TIFF:
        return tuple(map(_image_of_annotation, _annotation_of_image(path)))
    return ()


def is_image(path: Path, head: bytes) -> bool:
    """Return whether a file is an image of Sentinel-1: a TIFF of its name, or that says so."""
    return head.startswith(_TIFF) and (ANNOTATION_NAMES.match(path.name) is not None
                                       or b"Sentinel-1 IPF" in head)


def choose_images(images: tuple[Image, ...], path: Path, swath: str | None,
                  polarisation: str | None) -> tuple[Image, ...]:
    """Return the images of a product that have a swath and a polarisation, whatever their case.

    A swath or polarisation of "" or None stands for any. `path` is that of the product, for
    messages.

    Raises
    ------
    TermselError
        If there is none, or they are of several swaths.
    """
    matching = [image for image in images
                if swath in (None, "") or image.swath.casefold() == str(swath).casefold()]
    matching = [image for image in matching if polarisation in (None, "")
                or image.polarisation.casefold() == str(polarisation).casefold()]
    listed = ", ".join(image.name for image in images)
    if not matching:
        request = " ".join(filter(None, (swath, polarisation)))
        raise TermselError(f"the product has no image {request!r}: it has {listed}", file=path,
                           hint="Choose one with --set swath=... and --set polarisation=....")
    swaths = sorted({image.swath for image in matching})
    if len(swaths) > 1:
        raise TermselError(f"the product has images of the swaths {', '.join(swaths)}: {listed}",
                           file=path, hint=f"Choose one with --set swath={swaths[0]}.")
    return tuple(matching)


def content_of(path: Path) -> bytes:
    """Return the bytes of an annotation, whose path may lead into a zip as into a folder.

    Raises
    ------
    TermselError
        If it does not exist, cannot be read, or has more than `LARGEST` bytes.
    """
    if path.is_file():
        return read_data(path)
    archive = archive_of(path)
    if archive is None:
        raise TermselError(f"{path} is no file", hint=HINT)
    member = path.relative_to(archive).as_posix()
    # One byte more than is allowed shows that it is too large, before memory is full.
    try:
        with zipfile.ZipFile(archive) as packed, packed.open(member) as file:
            data = file.read(LARGEST + 1)
    except _BROKEN as error:
        raise TermselError(f"{member} cannot be read in this zip: {error}", file=archive,
                           hint="It is incomplete or damaged: download the product again."
                           ) from error
    if len(data) > LARGEST:
        raise TermselError(f"{member} has more than {LARGEST >> 20} MiB", file=archive, hint=HINT)
    return data


def archive_of(path: Path) -> Path | None:
    """Return the zip that a path leads into; None if it leads into none."""
    return next((parent for parent in path.parents if parent.is_file()), None)


def time_of_change(path: Path) -> int:
    """Return when an annotation, or the zip that it is in, was changed [ns]."""
    return (path if path.is_file() else archive_of(path) or path).stat().st_mtime_ns


def _annotations_in_folder(folder: Path) -> list[Path]:
    """Return the annotations of a product's folder, or of the only product in a folder.

    [] if there are none, or if the folder has several products.
    """
    inner = folder / "annotation"
    if not inner.is_dir():
        products = [entry for entry in folder.iterdir()
                    if entry.name.upper().endswith(".SAFE") and entry.is_dir()]
        if len(products) != 1:
            return []
        inner = products[0] / "annotation"
    if not inner.is_dir():
        return []
    return [entry for entry in inner.iterdir() if _is_annotation(entry.name) and entry.is_file()]


def _annotations_in_zip(path: Path) -> list[Path]:
    """Return the annotations in the zip of a product, as paths that lead into it.

    [] if there are none, if it is damaged, or if it has more than `MOST_FILES` files.
    """
    try:
        with zipfile.ZipFile(path) as packed:
            names = packed.namelist()
    except _BROKEN:
        return []
    if len(names) > MOST_FILES:
        return []
    members = [PurePosixPath(name) for name in names]
    # A name with .. or from the root would lead out of the zip.
    return [path / name for name in members if name.parent.name == "annotation"
            and ".." not in name.parts and not name.is_absolute() and _is_annotation(name.name)]


def _annotation_of_image(image: Path) -> list[Path]:
    """Return a list of the annotation of an image; [] if there is none.

    It is in the folder annotation next to that of the image, or in the image's own folder.
    """
    # A cloud-optimised copy is named as the image, with -cog.
    stem = re.sub("-cog$", "", image.stem, flags=re.IGNORECASE)
    folders = (image.parent.parent / "annotation", image.parent)
    candidates = [folder / f"{name}.xml" for folder in folders
                  for name in dict.fromkeys((image.stem, stem))]
    return [candidate for candidate in candidates if candidate.is_file()][:1]


def _is_annotation(name: str) -> bool:
    """Return whether the name of a file is that of an annotation of Sentinel-1."""
    return ANNOTATION_NAMES.match(name) is not None and name.lower().endswith(".xml")


def _image_of_annotation(annotation: Path) -> Image:
    """Return the image of an annotation, with swath and polarisation by its name; "" if not stated.
    """
    match = ANNOTATION_NAMES.match(annotation.name)
    return Image(annotation, match["swath"].upper() if match else "",
                 match["polarisation"].upper() if match else "")


def _images_in_order(annotations: list[Path]) -> tuple[Image, ...]:
    """Return the images of annotations, in the order of their paths."""
    return tuple(map(_image_of_annotation, sorted(annotations, key=os.fspath)))
