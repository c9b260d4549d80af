"""Residuals as a GeoPackage, for a map."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from termsel import Option, Result, TermselError, Writer
from termsel.toolkit import FloatArray, private_folder, require_import, write_bytes
from termsel.toolkit.coordinates import horizontal_crs
from termsel.toolkit.files import TextArray, distinct_names, reason_of, say_measured
from termsel.toolkit.models import errors_on_ground
from termsel.toolkit.runs import GIS
from termsel_formats.maps.qgis_style import LAYER_OPTIONS, TABLE, layer_style_rows

# The version of GeoPackage that GDAL 3.6 and QGIS 3.22 read without a warning.
_VERSION = {"VERSION": "1.3"}
# Length of the median vector on the map, as a share of the map's extent.
_MEDIAN_LENGTH_SHARE = 0.03


class ResidualsGeopackage(Writer):
    """Residuals of all features as points, and as vectors drawn larger, in a GeoPackage.

    A vector leads from the feature on the ground to the place where the model sees its measured
    image position, at the feature's height. QGIS shows both by role, the vectors as arrows. Points
    have their measured line and sample and their height, too, so that they can be read again.
    """

    name = "residuals-gpkg"
    summary = "residuals as GeoPackage: layers of points and of vectors, for a map in a GIS"
    needs = "pyogrio and shapely (termsel[gis])"
    suffix = "_residuals.gpkg"
    declared_options: ClassVar[tuple[Option, ...]] = (
        Option("exaggeration", None, "Exaggeration of the vectors; by default the median one has 3 "
                                     "% of the extent.", float, 0, 1e9),)

    def accepts(self, result: Result) -> bool:
        """Return True: every result has residuals."""
        return True

    def write(self, result: Result, path: Path) -> None:
        """Write the layers residuals and vectors, with their styles.

        The GeoPackage is made in a folder of its own and moved when it is complete, as its driver
        writes in place. Vectors are exaggerated by a round factor, which their style names. Logs
        that it holds no model. Raises TermselError without the extra `gis`, and where the disk is
        full.
        """
        with require_import("this format requires", "pyogrio and shapely", GIS, path):
            import shapely
            from pyogrio import read_info
            from pyogrio.errors import DataLayerError, DataSourceError
            from pyogrio.raw import write
        residuals = result.residuals
        columns: dict[str, Any] = {}
        for name in ("id", "kind", "role", "used"):
            columns[name] = np.array([getattr(residual, name) for residual in residuals])
        ground = residuals.ground
        columns["line"], columns["sample"] = _measured_positions(result).T
        columns["z"] = ground[:, 2]
        for column, name in (("residual_line", "line"), ("residual_sample", "sample"),
                             ("distance", "distance"), ("blunder", "blunder")):
            columns[column] = np.array([getattr(residual, name) for residual in residuals])
        ends, exaggeration = self._vector_ends(result, ground)
        layers = {
            "residuals": shapely.points(ground[:, :2]),
            "vectors": shapely.linestrings(np.stack([ground[:, :2], ends], axis=1))}
        columns["exaggeration"] = np.full(len(residuals), exaggeration)
        # GeoPackages have columns fid and geom of their own.
        columns |= _attribute_columns(result, [*columns, "fid", "geom"])
        fields = [np.asarray(column, dtype=object) if column.dtype.kind in "UO" else column
                  for column in columns.values()]
        with private_folder() as folder, warnings.catch_warnings():
            file = folder / "residuals.gpkg"
            # Plane coordinates have no CRS, of which pyogrio warns.
            warnings.filterwarnings("ignore", "'crs' was not provided")
            try:
                for layer, shapes in layers.items():
                    write(str(file), shapely.to_wkb(shapes), fields, list(columns), layer=layer,
                          driver="GPKG", geometry_type="Point" if layer == "residuals"
                          else "LineString", crs=horizontal_crs(result.features.crs) or None,
                          append=file.exists(), dataset_options=_VERSION)
                    # On a full disk GDAL may write fewer features without an error.
                    if read_info(file, layer=layer)["features"] != len(residuals):
                        raise DataLayerError("the file is incomplete")  # noqa: TRY301
                layer_styles = layer_style_rows()
                write(str(file), None, list(layer_styles.values()), list(layer_styles),
                      layer=TABLE, driver="GPKG", append=True, layer_options=LAYER_OPTIONS)
            except (DataSourceError, DataLayerError) as error:
                raise TermselError(
                    f"cannot make the GeoPackage: {reason_of(error, file)}", file=path,
                    hint="Check that there is room for temporary files.") from error
            write_bytes(path, file.read_bytes())
        say_measured(self.name)

    def _vector_ends(self, result: Result, ground: FloatArray) -> tuple[FloatArray, float]:
        """Return the ends (n, 2) of the vectors on the ground, and their exaggeration.

        Unless the option states it, it is such that the median vector is drawn with 3 % of the
        extent, rounded to one digit; 1 if the median vector has no length. Vectors that cannot be
        computed end where they begin.
        """
        vectors = np.nan_to_num(errors_on_ground(result.fit, result.residuals))
        exaggeration = self.options["exaggeration"]
        if exaggeration is None:
            length = float(np.median(np.linalg.norm(vectors, axis=1)))
            extent = float(np.ptp(ground[:, :2], axis=0).max())
            # One digit, such as 200 times, is a factor that people can divide by.
            if length > 0:
                exaggeration = float(f"{_MEDIAN_LENGTH_SHARE * extent / length:.1g}")
            else:
                exaggeration = 1.0
        return ground[:, :2] + exaggeration * vectors, float(exaggeration)


def _measured_positions(result: Result) -> FloatArray:
    """Return the measured line and sample [px] of each residual, (n, 2); NaN for control lines."""
    points = result.features.points
    row = {name: i for i, name in enumerate(points.ids)}
    positions = np.full((len(result.residuals), 2), np.nan)
    for i, residual in enumerate(result.residuals):
        if residual.id in row:
            positions[i] = points.image[row[residual.id]]
    return positions


def _attribute_columns(result: Result, reserved: list[str]) -> dict[str, TextArray]:
    """Return the columns of the features' file, by name, as texts (n,) in the order of residuals.

    Columns with `reserved` names are left out.
    """
    features = result.features
    row = {name: i for i, name in enumerate(features.ids)}
    rows = [row[residual.id] for residual in result.residuals]
    names = distinct_names([*features.points.attributes, *features.lines.attributes])
    return {name: features.texts(name)[rows] for name in names
            if name.casefold() not in reserved}
