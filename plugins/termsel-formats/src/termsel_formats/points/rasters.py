"""Ground control points that rasters carry, through rasterio and its GDAL."""

from __future__ import annotations

from pathlib import Path
from shlex import quote

import numpy as np

from termsel import FeatureSet, Option, Reader, TermselError, open_raster
from termsel.toolkit.files import read_head
from termsel_formats.points.common import CORNER, points_of

# How files begin: TIFF and BigTIFF; PNG, JPEG and JPEG 2000; ERDAS IMAGINE, NITF, netCDF and HDF5.
_MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+",
          b"\x89PNG", b"\xff\xd8\xff", b"\0\0\0\x0cjP  ", b"\xff\x4f\xff\x51",
          b"EHFA_HEADER_TAG", b"NITF", b"NSIF", b"CDF\x01", b"CDF\x02", b"\x89HDF")


class GdalGcps(Reader):
    """Ground control points in a GeoTIFF, a VRT or any other raster GDAL knows.

    GDAL counts pixels from the corner of the first one, but the program that wrote a file may not.
    Heights that are all 0 count as unknown, as GDAL cannot omit them.
    """

    name = "gdal-gcps"
    summary = "a raster or VRT with ground control points as GDAL reads them (requires rasterio)"
    general = True
    declared_options = (
        Option("gcp_origin", "corner", "Position in the first pixel that has the coordinates 0, 0.",
               choices=("corner", "centre")),
    )

    def sniff(self, path: Path, head: bytes) -> bool:
        """Return True for a VRT, or a file that begins as the usual rasters do."""
        text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
        # ERDAS IMAGINE has tables of points, .gcc, in the form of its images.
        return text.startswith(b"<VRTDataset") or (
            head.startswith(_MAGIC) and path.suffix.lower() != ".gcc")

    def read(self, path: Path) -> FeatureSet:
        """Return the points, counted from where the option `gcp_origin` says.

        The CRS is a code of EPSG where it has one, else WKT. Raises TermselError, with the file,
        for a raster without points, or one that cannot be read.
        """
        read_head(path, "Expected a raster.")
        with open_raster(path) as raster:
            gcps, crs = raster.gcps
            size = raster.shape
        if not gcps:
            raise TermselError("this raster has no ground control points", file=path,
                               hint="If its points are in a file of their own, give that file. If "
                                    "not, measure some: termsel app "
                                    f"{quote(str(path))} --map MAP.")
        corner = CORNER if self.options["gcp_origin"] == "corner" else 0.0
        points = points_of(path, [str(gcp.id or "") for gcp in gcps], [
            (gcp.row - corner, gcp.col - corner, gcp.x, gcp.y, np.nan if gcp.z is None else gcp.z)
            for gcp in gcps])
        # A code says more to people than the same CRS as WKT.
        epsg = crs.to_epsg() if crs else None
        wkt = crs.to_wkt() if crs else ""
        return FeatureSet(points, crs=wkt if epsg is None else f"EPSG:{epsg}", image_size=size)
