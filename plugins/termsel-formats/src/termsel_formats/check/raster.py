"""What rasterio takes from a raster."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from termsel import open_raster
from termsel.toolkit import FloatArray, require_rasterio
from termsel_formats.check.base import NONE, Places, Taken
from termsel_formats.check.gdal import WGS84


def taken_by_rasterio(path: Path) -> Iterator[Taken]:
    """Yield what rasterio takes: the geotransform, or else its transformer of GCPs or of RPCs.

    One answer is yielded, without a transformation if the raster has none of these.
    """
    rasterio = require_rasterio()
    from rasterio.transform import AffineTransformer, GCPTransformer, RPCTransformer

    program = f"rasterio {rasterio.__version__}"
    with open_raster(path) as raster:
        (gcps, crs) = raster.gcps
        rpcs = raster.rpcs
        # rasterio gives the identity for a raster without a geotransform.
        if not raster.transform.is_identity:
            yield Taken(program, "affine transformation", _wkt_of_crs(raster.crs),
                        _transform_by_rasterio(AffineTransformer, raster.transform))
        elif gcps:
            yield Taken(program, "polynomial through GCPs (GCPTransformer)", _wkt_of_crs(crs),
                        _transform_by_rasterio(GCPTransformer, gcps))
        elif rpcs:
            yield Taken(program, "RPC at the height 0 (RPCTransformer)", WGS84,
                        _transform_by_rasterio(RPCTransformer, rpcs))
        else:
            yield Taken(program, NONE)


def size_of(path: Path) -> tuple[int, int]:
    """Return lines and samples of a raster; raises TermselError if it cannot be read."""
    with open_raster(path) as raster:
        lines, samples = raster.shape
        return lines, samples


def is_map_of_termsel(path: Path) -> bool:
    """Return whether a raster is a map that termsel made of an image, by the tags of maps."""
    with open_raster(path) as raster:
        tags = raster.tags()
    return "ACCURACY_DATE" in tags and tags.get("TIFFTAG_SOFTWARE", "").startswith("termsel")


def _wkt_of_crs(crs: object) -> str:
    """Return the WKT of rasterio's CRS; "" without one."""
    return crs.to_wkt() if crs else ""  # type: ignore[attr-defined]


def _transform_by_rasterio(transformer: type, argument: object) -> Places:
    """Return the function from image positions to the ground by a transformer of rasterio.

    `argument` is what the transformer is made of. All positions are taken at the height 0.
    """
    def transform(image: FloatArray, _heights: FloatArray) -> FloatArray:
        """Return x and y (n, 2) of image positions, line and sample (n, 2)."""
        # rasterio adds half a pixel itself, so that whole numbers are the centres of pixels.
        with transformer(argument) as opened:
            x, y = opened.xy(image[:, 0].tolist(), image[:, 1].tolist(), zs=[0.0] * len(image))
        return np.column_stack([x, y])

    return transform
