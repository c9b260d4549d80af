"""Any fitted model as a grid for GDAL's warper: GCPs, or a geolocation array."""

from __future__ import annotations

import logging
from abc import abstractmethod
from contextlib import suppress
from pathlib import Path
from typing import ClassVar

import numpy as np

from termsel.core.errors import TermselError
from termsel.core.files.atomic import atomic_path, utf8_bytes, write_bytes, write_text
from termsel.core.files.names import is_there
from termsel.core.files.texts import xml_text
from termsel.core.options import COUNT, Option
from termsel.core.remedies import Remedy
from termsel.data.coordinates.earth import place_of
from termsel.data.coordinates.longitudes import nearest_longitudes, turn_of
from termsel.data.coordinates.metres import ground_for_warping
from termsel.data.features import FloatArray, Points
from termsel.data.rasters import require_rasterio, tiff_bytes
from termsel.fitting.fit import Fit
from termsel.fitting.sky import ground_where_held, refuse_sky, why_not_shown
from termsel.formats.base import Writer
from termsel.formats.deviation import fit_splines, places_of, say_deviation
from termsel.formats.heights import Dem, say_difference, surface_of
from termsel.formats.pictures import Picture
from termsel.formats.vrt import IMAGE, picture_for, vrt_text
from termsel.results.result import Result

log = logging.getLogger(__name__)

_COMPARED = 50  # meshes along either side at whose middles a grid is compared with the model

_GROUND_OPTIONS = (
    Option("dem", None, "Raster of heights for the ground of the grid."),
    Option("height", None, "Height of the ground if no raster is given; by default that of the "
                           "middle of the control.", float, -1e6, 1e6))


class GridWriter(Writer):
    """Base of the writers of grids."""

    def accepts(self, result: Result) -> bool:
        """Return True: every model can be put on a grid."""
        return True

    def ground(self, result: Result, lines: FloatArray, samples: FloatArray) -> FloatArray:
        """Return the ground seen at a grid of image places.

        Parameters
        ----------
        result : Result
        lines, samples : ndarray, shapes (l,) and (s,)
            Lines and samples of the nodes of the grid.

        Returns
        -------
        ndarray, shape (l, s, 3)
            X, Y and Z in the CRS of the control; NaN where a node shows no ground, which is logged.

        Raises
        ------
        TermselError
            If fewer than three nodes show ground, or the raster of heights cannot be read.
        """
        fitted = result.fit
        height = self.options["height"]
        if height is None:
            # The middle height of the control.
            height = float(fitted.ground_box()[0][2])
            if fitted.model.uses_height and self.options["dem"] is None:
                log.warning("Warning: without a raster of heights (%s) the ground is taken as "
                            "level, at the height %.6g.", Remedy("dem"), height)
                sampled = places_of(fitted)
                level = sampled * [1, 1, 0] + [0, 0, height]
                say_deviation(self.name, fitted, sampled, fitted.project(level),
                              ", at the heights of the control")
        image = np.stack(np.meshgrid(lines, samples, indexing="ij"), axis=-1)
        with surface_of(self.options["dem"], fitted.control.crs, height) as surface:
            say_difference(result.features, result.project, surface)
            ground = ground_where_held(fitted, image.reshape(-1, 2), surface)
            ground = ground.reshape(*image.shape[:2], 3)
            self.log_interpolation_error(fitted, image, ground, surface)
        # Three nodes are the fewest that determine a surface.
        unseen = int(np.isnan(ground).any(axis=-1).sum())
        if unseen > image[..., 0].size - 3:
            place = place_of(fitted.control)
            position = f", which is around {place}" if place else ""
            raise TermselError(
                f"fewer than three nodes of the grid have ground in the image{position}",
                file=self.options["dem"],
                hint="Give a raster of heights that covers it, the image, or a simpler model.")
        if unseen:
            reason = why_not_shown(fitted)
            log.warning("Warning: %d of %d nodes of the grid have no ground%s; the image around "
                        "them stays empty.", unseen, image[..., 0].size,
                        f", as they are {reason}" if reason else "")
        return ground

    @abstractmethod
    def log_interpolation_error(self, fitted: Fit, image: FloatArray, ground: FloatArray,
                                surface: Dem | float) -> None:
        """Log how far what GDAL makes of the grid is from the model between its places.

        `image` is (lines, samples, 2), `ground` (lines, samples, 3), `surface` the ground.
        """


def _mesh_middles(grid: FloatArray) -> FloatArray:
    """Return the middles of some meshes of a grid, shape (n, last axis)."""
    middle = (grid[1:, 1:] + grid[:-1, 1:] + grid[1:, :-1] + grid[:-1, :-1]) / 4
    steps = [max(1, size // _COMPARED) for size in middle.shape[:2]]
    return np.asarray(middle[::steps[0], ::steps[1]].reshape(-1, grid.shape[-1]))


class GcpGridVrt(GridWriter):
    """A grid of GCPs computed by the fitted model, in a virtual raster of the image."""

    name = "gcp-grid-vrt"
    summary = "any model as a grid of computed GCPs in a VRT of the image, for gdalwarp -tps"
    needs = ("any model; with heights a raster of them (--dem), else the ground is level; --image "
             "for a VRT that has pixels")
    suffix = "_grid.vrt"
    declared_options: ClassVar[tuple[Option, ...]] = (
        IMAGE, *_GROUND_OPTIONS,
        Option("across", 20, "Meshes along each side of the image.", int, 1, 60))

    def write(self, result: Result, path: Path) -> None:
        """Write a VRT with a list of GCPs, of at least three places that have ground."""
        picture = picture_for(result, self.options["image"])
        refuse_sky(result.of_image(picture.size).fit, "a spline through GCPs")
        lines, samples = (np.linspace(0.0, size - 1.0, self.options["across"] + 1)
                          for size in picture.size)
        ground, crs = ground_for_warping(
            self.ground(result, lines, samples), result.fit.control.crs)
        nodes = np.argwhere(np.isfinite(ground).all(axis=-1))
        gcps = Points(tuple(f"{i}-{j}" for i, j in nodes),
                      np.column_stack([lines[nodes[:, 0]], samples[nodes[:, 1]]]),
                      ground[nodes[:, 0], nodes[:, 1]])
        write_text(path, vrt_text(picture, path.parent, gcps=gcps, crs=crs))

    def log_interpolation_error(self, fitted: Fit, image: FloatArray, ground: FloatArray,
                                surface: Dem | float) -> None:
        """Log how far GDAL's thin plate spline through the grid is from the model.

        The arguments are those of `GeolocationVrt.log_interpolation_error`.
        """
        finite = np.isfinite(ground).all(axis=-1)
        if finite.sum() < 3:
            return
        spline = fit_splines(ground[finite][:, :2], image[finite])
        between = ground_where_held(fitted, _mesh_middles(image), surface)
        between = between[np.isfinite(between).all(axis=1)]
        say_deviation(self.name, fitted, between, spline(between), ", by gdalwarp -tps")


class GeolocationVrt(GridWriter):
    """A geolocation array computed by the fitted model, next to a virtual raster of the image."""

    name = "geolocation-vrt"
    summary = "any model as a geolocation array (GeoTIFF) with a VRT of the image, for gdalwarp"
    needs = GcpGridVrt.needs + "; rasterio (termsel[gis])"
    suffix = "_geolocation.vrt"
    declared_options: ClassVar[tuple[Option, ...]] = (
        IMAGE, *_GROUND_OPTIONS,
        Option("step", None, "Spacing of the array [px]; by default about 500 nodes along the "
                             "longer side.", int, 1, COUNT))

    def files(self, path: Path) -> tuple[Path, ...]:
        """Return the VRT and the array next to it, under the name or names in use."""
        arrays = _array_names(path)
        return path, *([array for array in arrays if is_there(array)] or arrays[:1])

    def write(self, result: Result, path: Path) -> None:
        """Write a VRT and, next to it, FILE_xy.tif with longitudes or eastings and so on."""
        self.write_picture(result, path, picture_for(result, self.options["image"]))

    def write_picture(self, result: Result, path: Path, picture: Picture) -> None:
        """Write the VRT of a picture, which is an image, or has other bands or a part of it.

        The ground positions of a grid over the image are written as a geolocation array beside the
        VRT, which GDAL warps the picture by. The bands of `picture`, an image or a tile of one, are
        those of the VRT. A VRT that is being replaced keeps its own array until the new one is in
        place.
        """
        rasterio = require_rasterio()
        step = self.options["step"] or max(1, round(max(picture.size) / 500))
        # The grid reaches beyond the edges, so that the outermost half pixels are in it.
        lines, samples = (np.arange(-step, size + 2 * step, step, dtype=np.float64)
                          for size in picture.size)
        ground, crs = ground_for_warping(
            self.ground(result, lines, samples), result.fit.control.crs)
        # An interrupt must leave no VRT with the array of another: where FILE_xy.tif is in use, the
        # new array is FILE_xy_2.tif, and the next one FILE_xy.tif again.
        array, other_array = sorted(_array_names(path), key=lambda array: _names_array(array, path))
        is_replaced = _names_array(other_array, path)
        domain = {
            "X_DATASET": array.name, "X_BAND": "1",
            "X_DATASET_RELATIVE_TO_SOURCE": "YES",
            "Y_DATASET": array.name, "Y_BAND": "2",
            "Y_DATASET_RELATIVE_TO_SOURCE": "YES",
            # GDAL counts from the corner of the upper-left pixel. By this convention, that of older
            # versions, the places are those of the array; by PIXEL_CENTER they would be half a
            # step further on.
            "PIXEL_OFFSET": str(0.5 - step), "LINE_OFFSET": str(0.5 - step),
            "PIXEL_STEP": str(step), "LINE_STEP": str(step),
            "GEOREFERENCING_CONVENTION": "TOP_LEFT_CORNER",
            "SRS": rasterio.CRS.from_user_input(crs).to_wkt() if crs else ""}
        values = np.nan_to_num(ground[..., :2], nan=_NODATA)
        content = tiff_bytes(np.moveaxis(values, -1, 0), nodata=_NODATA, compress="deflate",
                             predictor=3)
        text = vrt_text(picture, path.parent, domains={"GEOLOCATION": domain})
        with atomic_path(path) as temporary:
            temporary.write_bytes(utf8_bytes(text))
            write_bytes(array, content)
        if is_replaced:
            # The new VRT does not depend on whether the old array can be removed.
            with suppress(OSError):
                other_array.unlink()

    def log_interpolation_error(self, fitted: Fit, image: FloatArray, ground: FloatArray,
                                surface: Dem | float) -> None:
        """Log how far GDAL's interpolation between the nodes of the array is from the model.

        `image` (rows, columns, 2) and `ground` (rows, columns, 3) are the positions of the nodes;
        `surface` gives the heights between them, one for all if it is a number.
        """
        # Longitudes that jump by a full turn between two nodes have no middle.
        ground = ground.copy()
        ground[..., 0] = nearest_longitudes(
            ground[..., 0], float(fitted.ground_box()[0][0]), turn_of(fitted.control.crs))
        ground_between = _mesh_middles(ground)
        image_between = _mesh_middles(image)
        finite = np.isfinite(ground_between).all(axis=1)
        ground_between = ground_between[finite]
        image_between = image_between[finite]
        # The surface there is not the mean of the four corners.
        ground_between[:, 2] = (surface(ground_between[:, :2]) if isinstance(surface, Dem)
                                else surface)
        say_deviation(self.name, fitted, ground_between, image_between,
                      ", between the nodes of the array")


def _array_names(path: Path) -> tuple[Path, Path]:
    """Return the two names that the array of a VRT may have."""
    return path.with_name(f"{path.stem}_xy.tif"), path.with_name(f"{path.stem}_xy_2.tif")


def _names_array(array: Path, path: Path) -> bool:
    """Return whether the VRT at a path, if it exists, names an array."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return b">%b<" % utf8_bytes(xml_text(array.name)) in file.read(65536)


_NODATA = -1e10
