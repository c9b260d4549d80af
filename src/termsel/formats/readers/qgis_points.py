"""Points of the QGIS Georeferencer: files that end in ``.points``.

From the source of QGIS (class QgsGCPList, its `saveGcps` and `loadGcps`): an optional first line
``#CRS: WKT``, a header, and rows ``mapX,mapY,sourceX,sourceY,enable,dX,dY,residual``; before 3.26
the columns were called pixelX and pixelY, and before that there were four of them between tabs.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from termsel.core.errors import TermselError
from termsel.core.options import Option
from termsel.data.features import FeatureSet, FloatArray
from termsel.data.rasters import open_raster, pixel_positions
from termsel.formats.image_origin import EDGE_MARGIN
from termsel.formats.readers.tables import Table, TableReader

log = logging.getLogger(__name__)

_COLUMNS = {
    "x": ("mapx",), "y": ("mapy",),
    "source_x": ("sourcex", "pixelx"), "source_y": ("sourcey", "pixely"),
    "enabled": ("enable", "enabled"),
}
_SMALL = 20.0  # px; no image to be georeferenced has all its points within so few
_MAX_EXTENTS = 10.0  # points of an image lie about as far from its corner as apart


class QgisPoints(TableReader):
    """Points of the QGIS Georeferencer.

    Pixels are counted from the corner of the first one, down as negative numbers. If the
    raster was already georeferenced, points hold its coordinates instead; that raster is then
    required. Some other programs write positive numbers downwards: these are read with the image,
    or with ``downwards``. There are no heights; points that are not enabled have the role "off".
    """

    name = "qgis-points"
    summary = "QGIS .points: a header mapX,mapY,sourceX,sourceY,enable, or pixelX,pixelY"
    aliases = _COLUMNS
    flat = False
    declared_options = (
        Option("raster", None, "The image in which the points were measured, if it was already "
                               "georeferenced."),
        Option("downwards", False, "Whether sourceY is positive downwards, as some other programs "
                                   "write it.", bool),
        Option("disabled", "off", "Role of points that are not enabled.",
               choices=("off", "check", "independent")),
    )

    def features(self, table: Table) -> FeatureSet:
        """Return the points; errors name file, line and column."""
        x, y = table.stack("x", "y").T
        image, size = self._image_positions(table)
        roles = [self.options["disabled"] if role else "" for role in table.roles()]
        ground = np.column_stack([x, y, np.full(len(x), np.nan)])
        return FeatureSet(table.points(image, ground, None, roles), crs=table.crs,
                          image_size=size)

    def _image_positions(self, table: Table) -> tuple[FloatArray, tuple[int, int] | None]:
        """Return line and sample, (n, 2), and the size of the image, None if it is not known.

        Without the image, sources are pixels, upwards as QGIS writes them unless the option
        `downwards` is set. Raises TermselError for sources that do not look like pixels.
        """
        source = table.stack("source_x", "source_y")
        if self.options["downwards"]:
            return _source_pixels(source, downwards=True), None
        if self.options["raster"] is not None:
            return self._positions_in_image(table, source)
        _refuse_layer(table, source)
        return _source_pixels(source), None

    def _positions_in_image(
            self, table: Table, source: FloatArray) -> tuple[FloatArray, tuple[int, int]]:
        """Return line and sample in the given image, (n, 2), and its lines and samples.

        The columns may hold map coordinates of the image, pixels upwards or pixels downwards. The
        reading by which most points lie in the image counts; between equals the first of these.
        Pixels downwards are noted, as QGIS does not write them. Raises TermselError where no point
        lies in the image, and they do not look like pixels, and for an image that cannot be read.
        """
        with open_raster(Path(self.options["raster"])) as raster:
            size = raster.shape
            georeferenced = not raster.transform.is_identity
            readings = [pixel_positions(raster, *source.T)] if georeferenced else []
        readings += [_source_pixels(source), _source_pixels(source, downwards=True)]
        inside = [_count_inside(pixels, size) for pixels in readings]
        if not max(inside) and _is_of_layer(source):
            raise TermselError(f"no point lies in the image {self.options['raster']}",
                               file=table.path,
                               hint="Give the image in which these points were measured.")
        # Upwards comes before downwards, as QGIS writes it.
        best = inside.index(max(inside))
        if best == len(readings) - 1:
            log.warning("Note: %s: sourceY is positive, unlike in files of QGIS, and is read as "
                        "counted downwards from the top of the image.",
                        "the table" if table.path is None else table.path.name)
        return readings[best], size


def _source_pixels(source: FloatArray, downwards: bool = False) -> FloatArray:
    """Return line and sample (n, 2) of sourceX and sourceY that are pixels.

    Pixel edges are whole numbers: sample = x - 1/2, line = -y - 1/2, or y - 1/2 downwards.
    """
    return source[:, ::-1] * [1.0 if downwards else -1.0, 1.0] - 0.5


def _count_inside(pixels: FloatArray, size: tuple[int, int]) -> int:
    """Return how many points (n, 2) lie in an image of a size [px], or at its edge."""
    inside = (pixels >= -0.5 - EDGE_MARGIN) & (pixels <= np.array(size) - 0.5 + EDGE_MARGIN)
    return int(inside.all(axis=1).sum())


def _is_of_layer(source: FloatArray) -> bool:
    """Return whether sources (n, 2) look like places of a georeferenced raster.

    They do in three cases: if most rows are positive, which those of pixels are not in these files;
    if they are all closer together than pixels would be; or if they are far from 0 for their
    extent.
    """
    with np.errstate(over="ignore"):  # Points refuses numbers that are so large
        extent = np.ptp(source, axis=0)
        is_far = np.abs(source).min(axis=0) > _MAX_EXTENTS * np.maximum(extent, _SMALL)
    has_positive_rows = (source[:, 1] > 0).mean() > 0.5
    is_close = len(source) > 1 and (extent < _SMALL).all()
    return bool(has_positive_rows or is_close or is_far.all())


def _refuse_layer(table: Table, source: FloatArray) -> None:
    """Raise TermselError for sources that are not pixels, such as those of a georeferenced raster.
    """
    if _is_of_layer(source):
        raise table.error(
            "these are not pixels as QGIS counts them, negative downwards: they may be map "
            "coordinates of a raster that was already georeferenced", 0, "source_x",
            "Give the image in which they were measured, with --image FILE. If they are pixels "
            "that are positive downwards, add --set downwards=true.")
