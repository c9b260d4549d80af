"""The text of GDAL's virtual rasters: an image as it is, with georeferencing of its own."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from termsel.errors import TermselError
from termsel.files.rasters import open_raster
from termsel.files.texts import is_xml_text, xml_attribute, xml_text
from termsel.measurements.features import Points
from termsel.options import Option
from termsel.results.result import Result

log = logging.getLogger(__name__)

IMAGE = Option("image", None, "The image; if not given, the VRT has a size but no pixels.")
"""Option of every writer of a VRT."""

_DATA_TYPES = {
    "uint8": "Byte", "int8": "Int8", "uint16": "UInt16", "int16": "Int16", "uint32": "UInt32",
    "int32": "Int32", "uint64": "UInt64", "int64": "Int64", "float32": "Float32",
    "float64": "Float64", "complex64": "CFloat32", "complex128": "CFloat64",
    "complex_int16": "CInt16"}


@dataclass(frozen=True)
class Picture:
    """What a VRT must know of an image of `size` lines and samples.

    A VRT without `path` has no pixels. Data type, nodata value and colour are those of each band.
    """

    size: tuple[int, int]
    path: Path | None = None
    types: tuple[str, ...] = ("Byte",)
    nodata: tuple[float | None, ...] = (None,)
    colours: tuple[str, ...] = ("Gray",)


def picture_for(result: Result, image: Path | str | None) -> Picture:
    """Return what a VRT must know of the image of a result, by default of a size that holds all."""
    known = result.features.image_size
    if image is None:
        bottom, right = np.maximum(result.fit.image_box()[1],
                                   result.features.image_vertices().max(axis=0))
        size = known or (max(1, int(bottom) + 1), max(1, int(right) + 1))
        if known is None:
            log.warning("Warning: the size of the image is not known; %d lines and %d samples hold "
                        "all features. Give --image FILE.", *size)
        return Picture(size)
    picture = picture_of(Path(image))
    bottom, right = result.features.image_vertices().max(axis=0)
    if known is None and (bottom > picture.size[0] or right > picture.size[1]):
        what = f"but features extend to line {bottom:g} and sample {right:g}"
    elif known is not None and picture.size != known:
        what = f"the image of the result {known[0]} and {known[1]}"
    else:
        return picture
    raise TermselError(f"the image has {picture.size[0]} lines and {picture.size[1]} samples, "
                       f"{what}", file=image,
                       hint="Give the image in which the features were measured.")


def picture_of(image: Path) -> Picture:
    """Return what a VRT must know of an image; raises TermselError if GDAL cannot read it."""
    with open_raster(image) as raster:
        return Picture(raster.shape, image, tuple(_DATA_TYPES[t] for t in raster.dtypes),
                       tuple(raster.nodatavals),
                       tuple(colour.name.capitalize() for colour in raster.colorinterp))


def vrt_text(
    picture: Picture,
    folder: Path,
    *,
    domains: Mapping[str, Mapping[str, str]] | None = None,
    gcps: Points | None = None,
    crs: str = "",
) -> str:
    """Return the text of a VRT in a folder, to which the path of the image is relative.

    `domains` are metadata items by domain, such as "RPC"; "" is the default domain. `gcps` have
    heights and the CRS `crs`, a code or WKT.
    """
    lines, samples = picture.size
    parts = [f'<VRTDataset rasterXSize="{samples}" rasterYSize="{lines}">']
    for domain, items in (domains or {}).items():
        parts.append(f"  <Metadata domain={xml_attribute(domain)}>" if domain else "  <Metadata>")
        parts += [f"    <MDI key={xml_attribute(key)}>{xml_text(value)}</MDI>"
                  for key, value in items.items()]
        parts.append("  </Metadata>")
    if gcps:
        parts.append(f"  <GCPList Projection={xml_attribute(crs)}>")
        parts += [
            f'    <GCP Id={xml_attribute(name)} Info="" Pixel="{sample + 0.5!r}" '
            f'Line="{line + 0.5!r}" X="{x!r}" Y="{y!r}" Z="{z!r}"/>'
            for name, (line, sample), (x, y, z) in zip(
                gcps.ids, gcps.image.tolist(), gcps.ground.tolist(), strict=True)]
        parts.append("  </GCPList>")
    for band, (kind, nodata, colour) in enumerate(
            zip(picture.types, picture.nodata, picture.colours, strict=True), 1):
        parts.append(f'  <VRTRasterBand dataType="{kind}" band="{band}">')
        if nodata is not None:
            parts.append(f"    <NoDataValue>{nodata!r}</NoDataValue>")
        parts.append(f"    <ColorInterp>{colour}</ColorInterp>")
        if picture.path is not None:
            name = relative(picture.path, folder)
            if not is_xml_text(name.encode(errors="ignore").decode()):
                raise TermselError("the name of this image has control characters, which no "
                                   "virtual raster can hold", file=picture.path,
                                   hint="Rename it.")
            size = f'xSize="{samples}" ySize="{lines}"'
            parts += [
                "    <SimpleSource>",
                f'      <SourceFilename relativeToVRT="{int(not os.path.isabs(name))}">'
                f"{xml_text(name)}</SourceFilename>",
                f"      <SourceBand>{band}</SourceBand>",
                f'      <SrcRect xOff="0" yOff="0" {size}/>',
                f'      <DstRect xOff="0" yOff="0" {size}/>',
                "    </SimpleSource>"]
        parts.append("  </VRTRasterBand>")
    return "\n".join([*parts, "</VRTDataset>", ""])


def relative(path: Path, folder: Path) -> str:
    """Return the name of a file as seen from a folder; absolute where there is no way."""
    try:
        return os.path.relpath(path.resolve(), folder.resolve())
    except ValueError:  # on another drive
        return str(path.resolve())
