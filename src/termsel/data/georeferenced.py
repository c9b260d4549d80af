"""Images that are maps already, given as those in which features were measured."""

from __future__ import annotations

import logging
from contextlib import suppress
from pathlib import Path

import numpy as np

from termsel.core.errors import TermselError
from termsel.data.coordinates.crs import LOCAL, normalise, transformation_between
from termsel.data.features import FeatureSet
from termsel.data.rasters import open_raster, pixel_positions

log = logging.getLogger(__name__)

_FAR = 0.02
"""Share of the diagonal of an image: rough georeferencing of an image as delivered is nearer."""


_LARGEST_BLOCK = 1e7
"""Pixels of a block that is read to see whether it can be."""


def warn_of_incomplete(image: Path | str) -> None:
    """Warn of an image whose last pixel cannot be read, as after a download that broke off.

    The size of such an image is known all the same, so that nothing else would show the damage
    before a map is made. An image in large blocks is not tested.
    """
    from rasterio.errors import RasterioError

    with open_raster(image) as raster:
        # To read a pixel GDAL reads its block, which a small file may claim to be of any size.
        if not raster.count or np.prod(raster.block_shapes[0], dtype=float) > _LARGEST_BLOCK:
            return
        last = (raster.height - 1, raster.height), (raster.width - 1, raster.width)
        try:
            # Bands may lie one after the other: the last one ends the file.
            raster.read(raster.count, window=last)
        except RasterioError:
            log.warning("Warning: %s is incomplete or damaged: its size is used, but its pixels "
                        "cannot be read. Copy or download it again before a map is made.", image)


def warn_of_map(features: FeatureSet, image: Path | str) -> None:
    """Warn of an image whose own georeferencing shows features far from where they were measured.

    A map, rectified before, is easily taken for the image it was made from: it may hold all
    measured positions, and nothing else would show.
    """
    with open_raster(image) as raster:
        transform = raster.transform
        if (raster.crs is None or transform.is_identity or transform.is_degenerate
                or normalise(features.crs) == LOCAL):
            return
        ground = features.ground_vertices()
        measured = features.image_vertices()
        # Vertices of a line in the image are not those on the ground: points alone are compared.
        ground = ground[:len(features.points)]
        measured = measured[:len(features.points)]
        expected = np.full_like(measured, np.nan)
        # If one CRS cannot be transformed to the other, nothing is known of the image.
        with suppress(TermselError):
            expected = pixel_positions(raster, *transformation_between(
                features.crs, raster.crs.to_wkt(), for_fit=True)(np.nan_to_num(ground))[:, :2].T)
        distances = np.linalg.norm(expected - measured, axis=1)
        distances = distances[np.isfinite(distances)]
        if len(distances) and np.median(distances) > _FAR * np.hypot(*raster.shape):
            log.warning(
                "Warning: %s is georeferenced, and shows the points %.0f px (median) from where "
                "they were measured. If it is a map made of the image, give the image in its "
                "place.", Path(image).name, np.median(distances))
