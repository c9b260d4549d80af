"""What the pixels of an image are: their types, colours, masks, and whether they are categories."""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from termsel.core.files.names import is_there
from termsel.data.distant_rasters import with_dataset
from termsel.data.rasters import open_raster

log = logging.getLogger(__name__)

Colour = tuple[int, int, int, int]
"""Red, green, blue and alpha, 0 to 255."""

_DATA_TYPES = {
    "uint8": "Byte", "int8": "Int8", "uint16": "UInt16", "int16": "Int16", "uint32": "UInt32",
    "int32": "Int32", "uint64": "UInt64", "int64": "Int64", "float32": "Float32",
    "float64": "Float64", "complex64": "CFloat32", "complex128": "CFloat64",
    "complex_int16": "CInt16"}

_NAMES_IN_VRT = {"Y": "YCbCr_Y", "Cb": "YCbCr_Cb", "Cr": "YCbCr_Cr", "other_ir": "OtherIR"}

_CONTROL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f]")  # characters that XML does not have
_TABLE_OF_ATTRIBUTES = re.compile(rb"<GDALRasterAttributeTable([^>]*)>")
_SIDECAR = 4_000_000  # bytes of a file next to an image that are looked at

_BLACK: Colour = (0, 0, 0, 255)

GREY_OF_BITS: tuple[Colour, Colour] = ((0, 0, 0, 255), (255, 255, 255, 255))
"""What a bit without a colour table looks like."""


@dataclass(frozen=True)
class Band:
    """A band of a picture.

    `source` is its number in the file. `table` are the colours of the values 0, 1, ..., and
    `categories` their names. `thematic` says that the file calls its values classes. A band with
    a `lookup` shows what the values 0, 1, ... of the file become.
    """

    type: str = "Byte"
    nodata: float | None = None
    colour: str = "gray"  # as rasterio calls it
    source: int = 1
    table: tuple[Colour, ...] = ()
    categories: tuple[str, ...] = ()
    thematic: bool = False
    description: str = ""
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0
    bits: int | None = None
    lookup: tuple[int, ...] = ()

    @property
    def colour_in_vrt(self) -> str:
        """GDAL's name of the colour in a VRT."""
        return _NAMES_IN_VRT.get(self.colour, self.colour.capitalize())

    @property
    def alpha(self) -> bool:
        """Whether the band says how opaque the others are."""
        return self.colour == "alpha"

    @property
    def whole(self) -> bool:
        """Whether its values are whole numbers."""
        return self.type == "Byte" or self.type.startswith(("Int", "UInt"))

    @property
    def category(self) -> bool:
        """Whether its values are indices or classes, so that none lies between two of them."""
        return self.whole and bool(self.table or self.thematic or self.bits == 1)


@dataclass(frozen=True)
class Picture:
    """What a VRT must know of an image of `size` lines and samples.

    A VRT without `path` has no pixels. `masked` says that the image has a mask, inside it or next
    to it.
    """

    size: tuple[int, int]
    path: Path | None = None
    bands: tuple[Band, ...] = (Band(),)
    masked: bool = False

    @property
    def category(self) -> bool:
        """Whether any band but those of transparency has categories."""
        return any(band.category for band in self.bands if not band.alpha)


def picture_of(image: Path) -> Picture:
    """Return the description of an image for a VRT; raises TermselError if GDAL cannot read it."""
    with open_raster(image) as raster:
        thematic = _has_classes(image)
        # rasterio has no names of categories and no lookup tables.
        described = _band_descriptions(raster)
        bands = tuple(_band_description(raster, number, element, thematic)
                      for number, element in zip(raster.indexes, described, strict=True))
        return Picture(raster.shape, image, bands, _has_own_mask(raster, image))


def _band_descriptions(raster: Any) -> Sequence[ElementTree.Element]:
    """Return GDAL's description of each band in a VRT: rasterio has no names of categories."""
    # The copy must be made where the dataset is open, in the other process.
    text = with_dataset(raster, _text_of_vrt)
    return ElementTree.fromstring(_CONTROL.sub("", text)).findall("VRTRasterBand")


def _text_of_vrt(raster: Any) -> str:
    """Return the text of a VRT of an open raster, into which GDAL writes all that it knows of it.
    """
    import rasterio
    from rasterio.shutil import copy

    with rasterio.MemoryFile(ext=".vrt") as memory:
        copy(raster, memory.name, driver="VRT")
        return str(memory.read().decode("utf-8", errors="replace"))


def _band_description(raster: Any, number: int, element: ElementTree.Element,
                      thematic: bool) -> Band:
    """Return the description of one band for a VRT.

    `element` describes it in GDAL's own VRT; `thematic` says whether the values of the image are
    known to be classes. A band may say so itself.
    """
    def text_of(name: str, default: str) -> str:
        return element.findtext(name) or default

    table = _used_colours(element.findall("ColorTable/Entry"))
    names = tuple(name.text or "" for name in element.findall("CategoryNames/Category"))
    # A band of few bits has the type Byte; this tag alone shows how many.
    bits = raster.tags(number, ns="IMAGE_STRUCTURE").get("NBITS", "")
    has_classes = thematic or any(names) or raster.tags(number).get("LAYER_TYPE") == "thematic"
    return Band(
        _DATA_TYPES[raster.dtypes[number - 1]], raster.nodatavals[number - 1],
        raster.colorinterp[number - 1].name, source=number, table=table, categories=names,
        thematic=has_classes, description=text_of("Description", ""), unit=text_of("UnitType", ""),
        scale=float(text_of("Scale", "1")), offset=float(text_of("Offset", "0")),
        bits=int(bits) if bits.isdecimal() else None)


def _used_colours(entries: Sequence[ElementTree.Element]) -> tuple[Colour, ...]:
    """Return the colours of a table without those that GDAL added at its end.

    GDAL fills tables up to 256 entries, mostly with black. Of black entries at the end the first
    one stays, as it may be a colour of the image.
    """
    used = len(entries)
    while used > 1 and _colour_entry(
            entries[used - 2]) == _colour_entry(entries[used - 1]) == _BLACK:
        used -= 1
    return tuple(_colour_entry(entry) for entry in entries[:used])


def _colour_entry(entry: ElementTree.Element) -> Colour:
    """Return red, green, blue and alpha, 0 to 255, of an entry of GDAL's table."""
    red, green, blue, alpha = (int(entry.get(f"c{component}", "255")) for component in (1, 2, 3, 4))
    return red, green, blue, alpha


def _has_classes(image: Path) -> bool:
    """Return whether a file next to an image gives the classes of its values."""
    sidecar = image.with_name(f"{image.name}.aux.xml")
    if is_there(sidecar) and sidecar.is_file():
        with sidecar.open("rb") as file:
            table = _TABLE_OF_ATTRIBUTES.search(file.read(_SIDECAR))
        # A table of ranges of values is a histogram.
        if table is not None and b"athematic" not in table[1] and b"row0Min" not in table[1]:
            return True
    return is_there(image.with_name(f"{image.name}.vat.dbf"))


def _has_own_mask(raster: Any, image: Path) -> bool:
    """Return whether an image has a mask of its own; warn if its bands have different ones."""
    from rasterio.enums import MaskFlags

    flags = raster.mask_flag_enums
    # A band without flags has a mask that is neither of the dataset nor made of nodata or alpha.
    have_own_masks = [not kinds for kinds in flags]
    if any(have_own_masks):
        log.warning("Warning: the bands of %s have masks of their own; that of the first band is "
                    "taken for all.", image)
    has_dataset_mask = any(MaskFlags.per_dataset in kinds and MaskFlags.alpha not in kinds
                           for kinds in flags)
    return any(have_own_masks) or has_dataset_mask


def expand_colours(picture: Picture) -> Picture:
    """Return a picture with the colours of tables instead of indices: grey, or red, green, blue.

    Colours that are not opaque become alpha, and so does an index for no data.
    """
    bands: list[Band] = []
    for band in picture.bands:
        if not band.category:
            bands.append(band)
            continue
        # Where the image has no data, the colours are transparent.
        table = np.array(band.table or GREY_OF_BITS)
        if band.nodata is not None and 0 <= band.nodata < len(table):
            table[int(band.nodata), 3] = 0
        # One band instead of three where red, green and blue are the same.
        is_grey = bool((table[:, :3] == table[:, :1]).all())
        names = ["gray"] if is_grey else ["red", "green", "blue"]
        columns = [0] if is_grey else [0, 1, 2]
        if (table[:, 3] < 255).any() and not any(any_band.alpha for any_band in picture.bands):
            names.append("alpha")
            columns.append(3)
        bands += [Band("Byte", None, name, band.source, lookup=tuple(table[:, column].tolist()))
                  for name, column in zip(names, columns, strict=True)]
    return replace(picture, bands=tuple(bands))
