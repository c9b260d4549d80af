"""GCPs in files of GDAL: the auxiliary XML next to an image, and the tags of a GeoTIFF.

Columns and rows count from the outer corner of the first pixel. ArcGIS writes its own list into the
same auxiliary file: source coordinates with rows that may be negative, which GDAL takes as rows.
"""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple
from xml.etree import ElementTree

import numpy as np

from termsel import FeatureSet, Option, Reader, Result, TermselError, open_raster
from termsel.toolkit import picture_for, private_folder, with_dataset, write_text
from termsel.toolkit.files import (
    atomic_path,
    gcps_of,
    reason_of,
    utf8_bytes,
    utf8_name,
    vrt_text,
    xml_attribute,
)
from termsel_formats.points.common import CORNER, crs_or_blank, points_of, what_lacks, xml_root
from termsel_formats.points.written import IMAGE_OPTION, PointsWriter, say_by_gdal

_GDAL_HINT = "Write it again with GDAL or ArcGIS, or give another file."


class PamGcps(Reader):
    """GCPs in the auxiliary XML of GDAL or ArcGIS, such as scene.tif.aux.xml."""

    name = "pam-gcps"
    summary = "auxiliary XML of GDAL or ArcGIS (.aux.xml) with ground control points"

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for auxiliary XML."""
        return b"<PAMDataset" in head

    def read(self, path: Path) -> FeatureSet:
        """Return the points of GDAL's list or, if there is none, those of ArcGIS.

        Raises TermselError, with the file, if there are none, or if one lacks a number.
        """
        root = xml_root(path, _GDAL_HINT)
        try:
            gcps = _gcps_of_gdal(root) or _gcps_of_arcgis(root) or _Gcps([], [], "")
        except (KeyError, ValueError) as error:
            raise TermselError(f"a ground control point cannot be read: {what_lacks(error)}",
                               file=path, hint=_GDAL_HINT) from error
        if not gcps.rows:
            raise TermselError("this file has no ground control points", file=path,
                               hint="Check the image with gdalinfo.")
        rows = [(line - CORNER, sample - CORNER, *ground) for sample, line, *ground in gcps.rows]
        return FeatureSet(points_of(path, gcps.ids, rows), crs=crs_or_blank(gcps.crs))


class _Gcps(NamedTuple):
    """GCPs of a file: ids ("" for none), rows of pixel, line, x, y and z, and the CRS as stated."""

    ids: list[str]
    rows: list[list[float]]
    crs: str


def _gcps_of_gdal(root: ElementTree.Element) -> _Gcps | None:
    """Return the GCPs of the list that GDAL writes; None if there is no list.

    Heights that are not stated are NaN. Raises KeyError or ValueError if a GCP lacks a number.
    """
    gcp_list = root.find("GCPList")
    if gcp_list is None:
        return None
    gcps = gcp_list.findall("GCP")
    rows = []
    for gcp in gcps:
        height = float(gcp.get("Z", "nan"))
        rows.append([*(float(gcp.attrib[key]) for key in ("Pixel", "Line", "X", "Y")), height])
    return _Gcps([gcp.get("Id", "") for gcp in gcps], rows, gcp_list.get("Projection", ""))


def _gcps_of_arcgis(root: ElementTree.Element) -> _Gcps | None:
    """Return the control points of ArcGIS, without ids or heights; None if there is no list.

    Raises ValueError if there are not as many numbers in the image as on the ground.
    """
    transformation = root.find(".//GeodataXform")
    if transformation is None:
        return None

    def numbers(name: str) -> list[float]:
        """Return the numbers of a list of points by its name: x, y, x, y and so on."""
        return [float(element.text or "") for element in transformation.findall(f"{name}/Double")]

    source = numbers("SourceGCPs")
    target = numbers("TargetGCPs")
    if len(source) != len(target) or len(source) % 2:
        raise ValueError(f"{len(source)} numbers in the image and {len(target)} on the ground")
    # ArcGIS counts rows upwards from the upper edge, so that they are negative in the image.
    rows = [[column, abs(row), x, y, np.nan] for column, row, x, y in zip(
        source[::2], source[1::2], target[::2], target[1::2], strict=True)]
    return _Gcps([""] * len(rows), rows, transformation.findtext("SpatialReference/WKT", ""))



class PamGcpsWriter(PointsWriter):
    """The selected control points in GDAL's auxiliary XML: name it as the image, with .aux.xml.

    GDAL and what builds on it take the points from there when they open the image.
    """

    name = "pam-gcps"
    summary = "selected control points in auxiliary XML (IMAGE.aux.xml), which GDAL reads"
    suffix = ".aux.xml"

    def write(self, result: Result, path: Path) -> None:
        """Write the selected control points as GCPs in auxiliary XML.

        Logs what gdalwarp makes of them. Raises TermselError if the result has no control points,
        or no CRS of the Earth.
        """
        self.require(result, path)
        used, gcps, crs = gcps_of(result)
        rows = [f'    <GCP Id={xml_attribute(name)} Info="" Pixel="{sample + CORNER!r}" '
                f'Line="{line + CORNER!r}" X="{x!r}" Y="{y!r}" Z="{z!r}"/>'
                for name, (line, sample), (x, y, z) in zip(
                    gcps.ids, gcps.image.tolist(), gcps.ground.tolist(), strict=True)]
        write_text(path, "\n".join([
            "<PAMDataset>", f"  <GCPList Projection={xml_attribute(crs)}>", *rows, "  </GCPList>",
            "</PAMDataset>", ""]))
        say_by_gdal(self.name, result, used)


class GcpTiff(PointsWriter):
    """A copy of the image as a GeoTIFF with the selected control points in its tags."""

    name = "gcp-tiff"
    summary = "copy of the image as a GeoTIFF with the selected control points as GCPs"
    needs = "control points in a CRS of the Earth; --image FILE, by default an image without pixels"
    suffix = "_gcps.tif"
    declared_options: ClassVar[tuple[Option, ...]] = (IMAGE_OPTION,)

    def write(self, result: Result, path: Path) -> None:
        """Write a copy of the image, or an empty one, as a GeoTIFF with the points as GCPs.

        Logs what gdalwarp makes of them. Raises TermselError for a result that the format does not
        hold, and where GDAL cannot read or write.
        """
        self.require(result, path)
        from rasterio._err import CPLE_BaseError
        from rasterio.errors import RasterioError

        used, gcps, crs = gcps_of(result)
        image = self.options["image"]
        picture = picture_for(result, None if image is None else Path(image).absolute())
        # GDAL copies from a VRT that has the image's bands and the points. It does so in a private
        # folder, so that an interrupt leaves no incomplete file. It takes names in UTF-8 alone,
        # which that of the image need not be.
        with (private_folder() as folder, atomic_path(path) as unfinished,
              utf8_name(picture.path or folder) as name_of_picture):
            source = folder / "gcps.vrt"
            if picture.path is not None:
                picture = replace(picture, path=Path(name_of_picture))
            source.write_bytes(utf8_bytes(vrt_text(picture, folder, gcps=gcps, crs=crs)))
            with open_raster(source) as raster:
                try:
                    with_dataset(raster, _copy, folder / "copy.tif", image is None)
                except (RasterioError, CPLE_BaseError) as error:
                    raise TermselError(
                        f"cannot write this file: {reason_of(error, path, folder)}", file=path,
                        hint="Check the image, and the free space on the disk.") from error
            shutil.move(folder / "copy.tif", unfinished)
        say_by_gdal(self.name, result, used)


def _copy(raster: Any, path: Path, sparse: bool) -> None:
    """Copy an open raster to a compressed GeoTIFF; if `sparse`, empty blocks take no room."""
    from rasterio.shutil import copy

    copy(raster, path, driver="GTiff", compress="deflate", tiled=True, sparse_ok=sparse)
