"""The text of GDAL's virtual rasters: an image as it is, with georeferencing of its own."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from termsel.core.errors import TermselError
from termsel.core.files.texts import is_xml_text, xml_attribute, xml_text
from termsel.core.options import Option
from termsel.core.remedies import Remedy
from termsel.data.features import Points
from termsel.data.georeferenced import warn_of_map
from termsel.data.image_files import image_file_of
from termsel.data.rasters import gdal_name
from termsel.formats.image_origin import (
    note_on_exif_orientation,
    other_image_error,
    require_inside,
    say_other_number,
)
from termsel.formats.pictures import Band, Picture, picture_of
from termsel.results.result import Result

log = logging.getLogger(__name__)

IMAGE = Option("image", None, "The image; if not given, the VRT has a size but no pixels.")
"""Option of every writer of a VRT."""


def picture_for(result: Result, image: Path | str | None) -> Picture:
    """Return the description of a result's image for a VRT, and warn of what is doubtful about it.

    Without an image its size is that of the features, or if they state none, one that holds them
    all. Raises TermselError if the image has another size than the features state, if features lie
    outside it, or if it cannot be read.
    """
    size_of_features = result.features.image_size
    if image is None:
        require_inside(result.features, size_of_features, None)
        # The box of the fit, and whatever was measured outside it.
        bottom, right = np.maximum(result.fit.image_box()[1],
                                   result.features.image_vertices().max(axis=0))
        size = size_of_features or (max(1, int(bottom) + 1), max(1, int(right) + 1))
        if size_of_features is None:
            log.warning("Warning: the size of the image is not known. The file says %d lines and "
                        "%d samples, which hold all points; %s gives the true size.",
                        *size, Remedy("image", "FILE"))
        return Picture(size)
    picture = picture_of(Path(image))
    # Lines and samples of another size are of another image, or of a resampled one.
    if size_of_features is not None and picture.size != size_of_features:
        lines, samples = size_of_features
        raise other_image_error(
            picture.size, f"the image of the result {lines} and {samples}", image)
    require_inside(result.features, picture.size, image)
    warn_of_map(result.features, image)
    note_on_exif_orientation(image)
    say_other_image(result, image)
    return picture


def say_other_image(result: Result, image: Path | str) -> None:
    """Warn where an image is another file than that of the run, or its name than that of points.

    Sheets of a series have one size, so that nothing else shows it.
    """
    read = result.data.read
    known = None if read is None else read.image
    found = None if known is None else image_file_of(image)
    # Of the same or an unknown file only the numbers in the names can be compared.
    if known is None or found is None or (known.size, known.digest) == (found.size, found.digest):
        say_other_number(result.data.source, image)
    else:
        size = (f"{found.size:,} bytes, not {known.size:,}" if found.size != known.size
                else "as many bytes, but others")
        log.warning("Warning: %s is another file than the image of the run, which was %s (%s). Was "
                    "it only saved again, or is it another image?", found.name, known.name, size)


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
    rows = [f'<VRTDataset rasterXSize="{samples}" rasterYSize="{lines}">']
    for domain, items in (domains or {}).items():
        rows.append(f"  <Metadata domain={xml_attribute(domain)}>" if domain else "  <Metadata>")
        rows += [f"    <MDI key={xml_attribute(key)}>{xml_text(value)}</MDI>"
                 for key, value in items.items()]
        rows.append("  </Metadata>")
    if gcps:
        rows.append(f"  <GCPList Projection={xml_attribute(crs)}>")
        rows += [
            # GDAL counts from the corner of a pixel, termsel from its centre.
            f'    <GCP Id={xml_attribute(name)} Info="" Pixel="{sample + 0.5!r}" '
            f'Line="{line + 0.5!r}" X="{x!r}" Y="{y!r}" Z="{z!r}"/>'
            for name, (line, sample), (x, y, z) in zip(
                gcps.ids, gcps.image.tolist(), gcps.ground.tolist(), strict=True)]
        rows.append("  </GCPList>")
    source = None if picture.path is None else _name_in_vrt(picture.path, folder)
    for number, band in enumerate(picture.bands, 1):
        rows.append(f'  <VRTRasterBand dataType="{band.type}" band="{number}">')
        rows += [f"    {line}" for line in _description_xml(band)]
        if source is not None:
            rows += _source_xml(source, str(band.source), picture.size, band.lookup)
        rows.append("  </VRTRasterBand>")
    # GDAL reads a mask as the band "mask,1" of its image.
    if picture.masked and source is not None:
        rows += ["  <MaskBand>", '  <VRTRasterBand dataType="Byte">',
                 *_source_xml(source, "mask,1", picture.size),
                 "  </VRTRasterBand>", "  </MaskBand>"]
    return "\n".join([*rows, "</VRTDataset>", ""])


def _name_in_vrt(image: Path, folder: Path) -> str:
    """Return the name of an image as seen from the folder of a VRT.

    Raises TermselError for a name that XML cannot hold.
    """
    # A file in an archive has no name that is relative to a folder.
    name = str(gdal_name(image)) if str(image).startswith("/vsi") else relative_name(image, folder)
    if not is_xml_text(name):
        raise TermselError("the name of this image has control characters, or is not UTF-8, which "
                           "no virtual raster can represent", file=image, hint="Rename it.")
    return name


def _description_xml(band: Band) -> list[str]:
    """Return the elements of XML that describe a band, without those that have GDAL's default."""
    elements = {"Description": band.description, "UnitType": band.unit}
    lines = [f"<{name}>{xml_text(value)}</{name}>" for name, value in elements.items() if value]
    # repr has all digits of a number, so that the value for "no data" is met exactly.
    if band.nodata is not None:
        lines.append(f"<NoDataValue>{band.nodata!r}</NoDataValue>")
    if (band.scale, band.offset) != (1.0, 0.0):
        lines += [f"<Offset>{band.offset!r}</Offset>", f"<Scale>{band.scale!r}</Scale>"]
    lines.append(f"<ColorInterp>{band.colour_in_vrt}</ColorInterp>")
    if band.categories:
        lines += ["<CategoryNames>",
                  *(f"  <Category>{xml_text(name)}</Category>" for name in band.categories),
                  "</CategoryNames>"]
    if band.table:
        lines += ["<ColorTable>",
                  *(f'  <Entry c1="{red}" c2="{green}" c3="{blue}" c4="{alpha}"/>'
                    for red, green, blue, alpha in band.table), "</ColorTable>"]
    return lines


def _source_xml(name: str, number: str, size: tuple[int, int], lookup: Sequence[int] = (),
                ) -> list[str]:
    """Return the lines of XML that say where the pixels of a band are.

    Parameters
    ----------
    name : str
        Name of the source, relative to the folder of the VRT or absolute.
    number : str
        Number of the band in the source; "mask,1" for its mask.
    size : tuple of int
        Lines and samples of the source, all of which are taken.
    lookup : sequence of int
        What each value of the source becomes, from 0 on; () to leave them as they are.
    """
    # Only a complex source maps values; a simple one is faster.
    kind = "ComplexSource" if lookup else "SimpleSource"
    extent = f'xSize="{size[1]}" ySize="{size[0]}"'
    table = ",".join(f"{value}:{result}" for value, result in enumerate(lookup))
    return [
        f"    <{kind}>",
        f'      <SourceFilename relativeToVRT="{int(not os.path.isabs(name))}">'
        f"{xml_text(name)}</SourceFilename>",
        f"      <SourceBand>{number}</SourceBand>",
        f'      <SrcRect xOff="0" yOff="0" {extent}/>',
        f'      <DstRect xOff="0" yOff="0" {extent}/>',
        *([f"      <LUT>{table}</LUT>"] if lookup else []),
        f"    </{kind}>"]


def relative_name(path: Path, folder: Path) -> str:
    """Return the name of a file as seen from a folder; absolute if it is on another drive."""
    # A link keeps its own name: GDAL may not take the name of the file that it leads to.
    file = path.parent.resolve() / path.name
    try:
        return os.path.relpath(file, folder.resolve())
    except ValueError:
        return str(file)
