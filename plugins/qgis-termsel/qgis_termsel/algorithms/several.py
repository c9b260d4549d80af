"""What needs further packages of termsel: image matching, and blocks of images."""

from itertools import takewhile
from pathlib import Path
from urllib.parse import urlencode

from qgis.core import (
    QgsProcessingContext,
    QgsProcessingOutputHtml,
    QgsProcessingOutputVectorLayer,
    QgsProcessingParameterFile,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterFolderDestination,
    QgsProcessingParameterRasterLayer,
    QgsProcessingUtils,
)

from ..child import run
from .base import Algorithm, layer_file, with_page


class MatchReference(Algorithm):
    """Finds points that an image and an orthophoto have in common, by `termsel match-points`."""

    NAME, TITLE, GROUP = "match", "Match against reference", "Georeferencing"
    HELP = ("Finds points that an image and an orthophoto have in common, as a table of matches. "
            "Some are wrong: Georeference from points names them. It needs the package "
            "termsel-match.")

    def initAlgorithm(self, config=None):
        """Declare parameters and outputs."""
        add = self.addParameter
        add(QgsProcessingParameterRasterLayer("IMAGE", "Image"))
        add(QgsProcessingParameterRasterLayer("REFERENCE", "Georeferenced image of the same area"))
        add(QgsProcessingParameterRasterLayer("DEM", "Raster of heights", optional=True))
        add(QgsProcessingParameterFile("START", "Rough geometry: a file with an RPC or of three "
                                       "points, if the image has none", optional=True))
        add(QgsProcessingParameterFileDestination("OUTPUT", "Matches", "CSV files (*.csv)"))
        self.addOutput(QgsProcessingOutputVectorLayer("LAYER", "Matches"))

    def processAlgorithm(self, parameters, context, feedback):
        """Run `termsel match-points`; return the table of matches, and a layer that shows it."""
        output = self.parameterAsFileOutput(parameters, "OUTPUT", context)
        arguments = ["match-points"]
        # The command takes the image without an option, and other layers as --reference and --dem.
        for name, description in (("IMAGE", "image"), ("REFERENCE", "reference"),
                                  ("DEM", "raster of heights")):
            layer = self.parameterAsRasterLayer(parameters, name, context)
            if layer is not None:
                arguments += [*([] if name == "IMAGE" else [f"--{name.lower()}"]),
                              layer_file(layer, description)]
        start = self.parameterAsFile(parameters, "START", context)
        arguments += ["--start", start] if start else []
        run([*arguments, "-o", output, "--overwrite"], feedback)
        layer = _layer_of(output)
        context.addLayerToLoadOnCompletion(layer, QgsProcessingContext.LayerDetails(
            "Matches", context.project(), "LAYER", QgsProcessingUtils.LayerHint.Vector))
        return {"OUTPUT": output, "LAYER": layer}


def _layer_of(table):
    """Return the source, as QGIS writes it, of a layer that shows a CSV of points.

    Points are at the columns x, y and z, in the CRS that a comment line at the top of the table
    states.
    """
    with open(table, encoding="utf-8") as opened:
        comments = list(takewhile(lambda line: line.startswith("#"), opened))
    crs = next((comment.partition(":")[2].strip() for comment in comments
                if comment.startswith("# crs:")), "")
    # QGIS's provider of texts knows no comments, so they are skipped by their number.
    options = {"type": "csv", "skipLines": len(comments), "xField": "x", "yField": "y",
               "zField": "z", "crs": crs, "detectTypes": "yes"}
    return f"delimitedtext://{Path(table).absolute().as_uri()}?{urlencode(options, safe=':')}"


class AdjustBlock(Algorithm):
    """Adjusts the models of several images together, by `termsel block`."""

    NAME, TITLE, GROUP = "block", "Adjust a block of images", "Georeferencing"
    HELP = ("Adjusts several images together by their control and tie points. The block is a file "
            "in TOML that names the images. It needs the package termsel-block.")

    def initAlgorithm(self, config=None):
        """Declare parameters and outputs."""
        self.addParameter(QgsProcessingParameterFile(
            "BLOCK", "File of the block, such as block.toml", extension="toml"))
        self.addParameter(QgsProcessingParameterFolderDestination("OUTPUT", "Adjusted block"))
        self.addOutput(QgsProcessingOutputHtml("PAGE", "Report"))

    def processAlgorithm(self, parameters, context, feedback):
        """Run `termsel block` and return the folder of the block, with its report as a page."""
        output = self.parameterAsString(parameters, "OUTPUT", context)
        feedback.pushInfo(run(["block", self.parameterAsFile(parameters, "BLOCK", context), "--out",
                               output], feedback))
        return with_page({"OUTPUT": output}, "PAGE", Path(output) / "report.html", feedback)
