"""Points of the QGIS Georeferencer: files that end in ``.points``.

From the source of QGIS (class QgsGCPList, its `saveGcps` and `loadGcps`): an optional first line
``#CRS: WKT``, a header, and rows ``mapX,mapY,sourceX,sourceY,enable,dX,dY,residual``; before 3.26
the columns were called pixelX and pixelY, and before that there were four of them between tabs.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from termsel.core.errors import TermselError
from termsel.core.options import Option
from termsel.data.features import FeatureSet, FloatArray
from termsel.data.rasters import open_raster, positions
from termsel.formats.readers.table import Table
from termsel.formats.readers.tables import TableReader

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
    required. There are no heights; points that are not enabled have the role "off".
    """

    name = "qgis-points"
    summary = "QGIS .points: a header mapX,mapY,sourceX,sourceY,enable, or pixelX,pixelY"
    aliases = _COLUMNS
    flat = False
    declared_options = (
        Option("raster", None, "The image in which the points were measured, if it was already "
                               "georeferenced."),
        Option("disabled", "off", "Role of points that are not enabled.",
               choices=("off", "check", "independent")),
    )

    def features(self, table: Table) -> FeatureSet:
        """Return the points; errors name file, line and column."""
        x, y = table.stack("x", "y").T
        image, size = self._image(table)
        roles = [self.options["disabled"] if role else "" for role in table.roles()]
        ground = np.column_stack([x, y, np.full(len(x), np.nan)])
        return FeatureSet(table.points(image, ground, None, roles), crs=table.crs,
                          image_size=size)

    def _image(self, table: Table) -> tuple[FloatArray, tuple[int, int] | None]:
        """Return line and sample, and the size of the image where it is known."""
        source = table.stack("source_x", "source_y")
        # Pixel edges are whole numbers and y points up: line = -y - 1/2, sample = x - 1/2.
        pixels = source[:, ::-1] * [-1.0, 1.0] - 0.5
        if self.options["raster"] is None:
            _refuse_layer(table, source)
            return pixels, None
        with open_raster(Path(self.options["raster"])) as raster:
            if not raster.transform.is_identity:
                pixels = positions(raster, *source.T)
            rows, columns = raster.shape
        # Within an image of the same size around it: points a little outside occur.
        near = (np.abs(pixels - [rows / 2, columns / 2]) <= [rows, columns]).all(axis=1)
        if not near.any():
            raise TermselError(f"no point lies in the image {self.options['raster']}",
                               file=table.path,
                               hint="Give the image in which these points were measured.")
        return pixels, (rows, columns)


def _refuse_layer(table: Table, source: FloatArray) -> None:
    """Refuse sources that are not pixels, such as those of a georeferenced raster."""
    with np.errstate(over="ignore"):  # Points refuses numbers that are so large
        extent = np.ptp(source, axis=0)
        far = np.abs(source).min(axis=0) > _MAX_EXTENTS * np.maximum(extent, _SMALL)
    # Rows of pixels are negative in these files.
    upwards = (source[:, 1] > 0).mean() > 0.5
    if (upwards or (len(source) > 1 and (extent < _SMALL).all())
            or far.all()):
        raise table.error(
            "these look like map coordinates of a raster that was already georeferenced, not like "
            "pixels", 0, "source_x", "Give the image with --raster FILE.")
