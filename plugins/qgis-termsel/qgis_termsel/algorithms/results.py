"""What is done with a result: maps, files for other programs, reports and plans."""

import csv
import json

from qgis.core import (
    QgsFeature,
    QgsGeometry,
    QgsPointXY,
    QgsProcessing,
    QgsProcessingException,
    QgsProcessingOutputHtml,
    QgsProcessingParameterCrs,
    QgsProcessingParameterEnum,
    QgsProcessingParameterFeatureSink,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterNumber,
    QgsProcessingParameterRasterDestination,
    QgsProcessingParameterRasterLayer,
    QgsVectorLayer,
    QgsWkbTypes,
)

from ..child import run
from ..layers import StyleOfUncertainty, crs_text, read_result_file, stated_crs
from .base import Algorithm, layer_file, result_parameter, scratch_folder, with_page

_FORMATS = ("rpc-txt", "rpb", "rpc-vrt", "gcp-vrt", "gcp-grid-vrt", "geolocation-vrt",
            "qgis-points", "points-csv", "residuals-gpkg")
_RESAMPLING = ("as suits the image", "nearest", "bilinear", "cubic", "cubic_spline", "lanczos",
               "average")
_WITH_IMAGE = ("rpc-vrt", "gcp-vrt", "gcp-grid-vrt", "geolocation-vrt")


class Rectify(Algorithm):
    """Resamples an image to a map through the model of a result, by `termsel rectify`."""

    NAME, TITLE, GROUP = "rectify", "Rectify", "Results"
    HELP = ("Resamples an image to a map through the model of a result. The height of the ground "
            "comes from a raster, or is one number. Without a CRS the map has that of the "
            "control if it is in metres, else UTM.")

    def initAlgorithm(self, config=None):
        """Declare parameters and outputs."""
        add = self.addParameter
        add(result_parameter())
        add(QgsProcessingParameterRasterLayer("IMAGE", "Image"))
        add(QgsProcessingParameterRasterLayer("DEM", "Raster of heights", optional=True))
        add(QgsProcessingParameterNumber("HEIGHT", "Or one height of the ground [m]",
                                         QgsProcessingParameterNumber.Type.Double, optional=True))
        add(QgsProcessingParameterCrs("CRS", "CRS of the map", optional=True))
        add(QgsProcessingParameterNumber("RES", "Pixel size in units of the CRS",
                                         QgsProcessingParameterNumber.Type.Double, optional=True,
                                         minValue=0))
        add(QgsProcessingParameterEnum("RESAMPLING", "Resampling", _RESAMPLING, defaultValue=0,
                                       optional=True))
        add(QgsProcessingParameterNumber("NODATA", "Value outside the image",
                                         QgsProcessingParameterNumber.Type.Double, optional=True))
        add(QgsProcessingParameterRasterDestination("OUTPUT", "Map"))

    def processAlgorithm(self, parameters, context, feedback):
        """Run `termsel rectify` and return the map.

        For parameters that are not given, the command has its own defaults. Its errors are those
        of the algorithm.
        """
        arguments = ["rectify", self.parameterAsString(parameters, "RESULT", context),
                     layer_file(self.parameterAsRasterLayer(parameters, "IMAGE", context), "image")]
        dem = self.parameterAsRasterLayer(parameters, "DEM", context)
        # A raster of heights comes before the one height.
        if dem is not None:
            arguments += ["--dem", layer_file(dem, "raster of heights")]
        elif parameters.get("HEIGHT") is not None:
            arguments += ["--height", self.parameterAsDouble(parameters, "HEIGHT", context)]
        crs = self.parameterAsCrs(parameters, "CRS", context)
        if crs.isValid():
            arguments += ["--crs", crs_text(crs)]
        if parameters.get("RES"):
            arguments += ["--res", self.parameterAsDouble(parameters, "RES", context)]
        # The first one leaves it to the command: nearest for categories, else bilinear.
        resampling = self.parameterAsEnum(parameters, "RESAMPLING", context)
        if resampling:
            arguments += ["--resampling", _RESAMPLING[resampling]]
        if parameters.get("NODATA") is not None:
            arguments += ["--nodata", self.parameterAsDouble(parameters, "NODATA", context)]
        output = self.parameterAsOutputLayer(parameters, "OUTPUT", context)
        run([*arguments, "-o", output, "--overwrite", "--progress", "json"], feedback)
        return {"OUTPUT": output}


class Uncertainty(Algorithm):
    """Writes the standard deviations of a model as a raster, by `termsel sigma`."""

    NAME, TITLE, GROUP = "sigma", "Uncertainty raster", "Results"
    HELP = ("Writes the standard deviations of a model over the image or a map: of line and sample "
            "[px], of east and north [m], and a band that is 1 outside the control. The layer "
            "shows that of north. It needs the package termsel-standards.")

    def initAlgorithm(self, config=None):
        """Declare parameters and outputs."""
        add = self.addParameter
        add(result_parameter())
        add(QgsProcessingParameterRasterLayer("IMAGE", "Image, if its size is not known",
                                              optional=True))
        add(QgsProcessingParameterRasterLayer("MAP", "Map whose extent and CRS it has",
                                              optional=True))
        add(QgsProcessingParameterRasterLayer("DEM", "Raster of heights", optional=True))
        add(QgsProcessingParameterNumber("HEIGHT", "Or one height of the ground [m]",
                                         QgsProcessingParameterNumber.Type.Double, optional=True))
        add(QgsProcessingParameterNumber("RES", "Pixel size in units of the CRS",
                                         QgsProcessingParameterNumber.Type.Double, optional=True,
                                         minValue=0))
        add(QgsProcessingParameterRasterDestination("OUTPUT", "Uncertainty raster"))

    def processAlgorithm(self, parameters, context, feedback):
        """Run `termsel sigma` and return the raster, which QGIS shows in shades of red.

        Its bands are the standard deviations of line and sample [px] and of east and north [m],
        and 1 outside the control.
        """
        arguments = ["sigma", self.parameterAsString(parameters, "RESULT", context)]
        for name, description in (("IMAGE", "image"), ("MAP", "map"), ("DEM", "raster of heights")):
            layer = self.parameterAsRasterLayer(parameters, name, context)
            if layer is not None:
                arguments += [f"--{name.lower()}", layer_file(layer, description)]
        if parameters.get("HEIGHT") is not None:
            arguments += ["--height", self.parameterAsDouble(parameters, "HEIGHT", context)]
        if parameters.get("RES"):
            arguments += ["--res", self.parameterAsDouble(parameters, "RES", context)]
        output = self.parameterAsOutputLayer(parameters, "OUTPUT", context)
        run([*arguments, "-o", output, "--overwrite", "--progress", "json"], feedback)
        # Only a layer that QGIS is to load has details to be changed.
        if context.willLoadLayerOnCompletion(output):
            details = context.layerToLoadOnCompletionDetails(output)
            details.setPostProcessor(StyleOfUncertainty())
        return {"OUTPUT": output}


class ExportModel(Algorithm):
    """Writes the model of a result for another program, by `termsel export`."""

    NAME, TITLE, GROUP = "export", "Export model", "Results"
    HELP = ("Writes the model of a result for GDAL, QGIS, OTB and others: as an RPC, as GCPs, as a "
            "geolocation array, or as points of QGIS's georeferencer. The log gives the largest "
            "distance of the file from the model.")

    def initAlgorithm(self, config=None):
        """Declare parameters and outputs."""
        add = self.addParameter
        add(result_parameter())
        add(QgsProcessingParameterEnum("FORMAT", "Format", _FORMATS, defaultValue=0))
        add(QgsProcessingParameterRasterLayer("IMAGE", "Image, for formats that refer to it",
                                              optional=True))
        add(QgsProcessingParameterRasterLayer("DEM", "Raster of heights, for grids",
                                              optional=True))
        add(QgsProcessingParameterFileDestination("OUTPUT", "Exported file"))

    def processAlgorithm(self, parameters, context, feedback):
        """Run `termsel export` and return the file that it writes.

        Raises QgsProcessingException if the format refers to an image and none is given.
        """
        form = _FORMATS[self.parameterAsEnum(parameters, "FORMAT", context)]
        output = self.parameterAsFileOutput(parameters, "OUTPUT", context)
        arguments = ["export", self.parameterAsString(parameters, "RESULT", context), "--to", form,
                     "--output", output, "--overwrite"]
        image = self.parameterAsRasterLayer(parameters, "IMAGE", context)
        if image is not None:
            arguments += ["--image", layer_file(image, "image")]
        # The command refuses this too, but its message names the option --image.
        elif form in _WITH_IMAGE:
            raise QgsProcessingException(f"The format {form} refers to the image. Give it.")
        dem = self.parameterAsRasterLayer(parameters, "DEM", context)
        if dem is not None:
            arguments += ["--dem", layer_file(dem, "raster of heights")]
        run(arguments, feedback)
        return {"OUTPUT": output}


class Report(Algorithm):
    """Writes the page that shows a result and its accuracy, by `termsel report`."""

    NAME, TITLE, GROUP = "report", "Accuracy report", "Results"
    HELP = ("Writes a page that shows a result: model, accuracy, residuals, blunders and "
            "uncertainty. It opens in the results viewer or in a browser.")

    def initAlgorithm(self, config=None):
        """Declare parameters and outputs."""
        self.addParameter(result_parameter())
        self.addParameter(QgsProcessingParameterFileDestination("OUTPUT", "Page of the report",
                                                                "HTML files (*.html)"))
        self.addOutput(QgsProcessingOutputHtml("PAGE", "Report"))

    def processAlgorithm(self, parameters, context, feedback):
        """Run `termsel report` and return the page."""
        output = self.parameterAsFileOutput(parameters, "OUTPUT", context)
        run(["report", self.parameterAsString(parameters, "RESULT", context), "-o", output,
             "--overwrite"], feedback)
        return with_page({"OUTPUT": output}, "PAGE", output, feedback)


class NextPlaces(Algorithm):
    """Proposes where to measure further control points, by `termsel plan`."""

    NAME, TITLE, GROUP = "nextplaces", "Where to measure next", "Results"
    HELP = ("Lists the positions at which further control points would lower the uncertainty of "
            "the model most, the best one first.")

    def initAlgorithm(self, config=None):
        """Declare parameters and outputs."""
        self.addParameter(result_parameter())
        self.addParameter(QgsProcessingParameterNumber("NUMBER", "Number of positions",
                                                       defaultValue=5, minValue=1))
        self.addParameter(QgsProcessingParameterFeatureSink(
            "OUTPUT", "Positions", QgsProcessing.SourceType.TypeVectorPoint))

    def processAlgorithm(self, parameters, context, feedback):
        """Run `termsel plan` and return the proposed positions as a layer of points.

        The layer has the columns of the command's table but x and y as fields, and the CRS of the
        result. All of them are numbers, except the ids.
        """
        folder = self.parameterAsString(parameters, "RESULT", context)
        table = scratch_folder() + ".csv"
        run(["plan", folder, "-n", self.parameterAsInt(parameters, "NUMBER", context), "-o", table],
            feedback)
        with open(table, newline="", encoding="utf-8") as opened:
            # Lines with a number sign state the CRS, before the header.
            rows = list(csv.DictReader(line for line in opened if not line.startswith("#")))
        names = [name for name in (rows[0] if rows else {}) if name not in ("x", "y")]
        # The memory layer's only purpose is to have the fields made from their text.
        types = "&".join(f"field={name}:{'string' if name == 'id' else 'double'}" for name in names)
        fields = QgsVectorLayer(f"Point?{types}", "places", "memory").fields()
        sink, target = self.parameterAsSink(parameters, "OUTPUT", context, fields,
                                            QgsWkbTypes.Type.Point, _crs_of(folder))
        for row in rows:
            feature = QgsFeature(fields)
            feature.setGeometry(
                QgsGeometry.fromPointXY(QgsPointXY(float(row["x"]), float(row["y"])))
            )
            feature.setAttributes([row[name] if name == "id" else float(row[name] or "nan")
                                   for name in names])
            sink.addFeature(feature)
        return {"OUTPUT": target}


def _crs_of(folder):
    """Return the CRS of the result in a folder; it is invalid if the result states none."""
    record = json.loads(read_result_file(folder, "result.json"))
    return stated_crs(record["data"].get("crs", ""))
