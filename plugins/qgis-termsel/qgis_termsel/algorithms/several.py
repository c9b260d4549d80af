"""What needs further packages of termsel: image matching, and blocks of images."""

from qgis.core import (
    QgsProcessingOutputHtml,
    QgsProcessingParameterFile,
    QgsProcessingParameterFileDestination,
    QgsProcessingParameterFolderDestination,
    QgsProcessingParameterRasterLayer,
)

from ..child import run
from .base import Algorithm, layer_file


class MatchReference(Algorithm):
    """Find candidates of control in an image and a map."""

    NAME, TITLE, GROUP = "match", "Match against reference", "Georeferencing"
    HELP = ("Finds places that an image and an orthophoto have in common, as a table of candidate "
            "points. Some are wrong: Georeference from points names them. It needs the package "
            "termsel-match.")

    def initAlgorithm(self, config=None):
        """Declare parameters and outputs."""
        add = self.addParameter
        add(QgsProcessingParameterRasterLayer("IMAGE", "Image"))
        add(QgsProcessingParameterRasterLayer("REFERENCE", "Georeferenced image of the place"))
        add(QgsProcessingParameterRasterLayer("DEM", "Raster of heights", optional=True))
        add(QgsProcessingParameterFile("START", "Rough geometry: a file with an RPC or of three "
                                       "points, if the image has none", optional=True))
        add(QgsProcessingParameterFileDestination("OUTPUT", "Candidates", "CSV files (*.csv)"))

    def processAlgorithm(self, parameters, context, feedback):
        """Run the command."""
        output = self.parameterAsFileOutput(parameters, "OUTPUT", context)
        arguments = ["match-points"]
        for name, what in (("IMAGE", "image"), ("REFERENCE", "reference"),
                           ("DEM", "raster of heights")):
            layer = self.parameterAsRasterLayer(parameters, name, context)
            if layer is not None:
                arguments += [*([] if name == "IMAGE" else [f"--{name.lower()}"]),
                              layer_file(layer, what)]
        start = self.parameterAsFile(parameters, "START", context)
        arguments += ["--start", start] if start else []
        run([*arguments, "-o", output, "--overwrite"], feedback)
        return {"OUTPUT": output}


class AdjustBlock(Algorithm):
    """Adjust several images together."""

    NAME, TITLE, GROUP = "block", "Adjust a block of images", "Georeferencing"
    HELP = ("Adjusts several images together by their control and tie points. The block is a file "
            "in TOML that names the images. It needs the package termsel-block.")

    def initAlgorithm(self, config=None):
        """Declare parameters and outputs."""
        self.addParameter(QgsProcessingParameterFile("BLOCK", "File of the block",
                                                     extension="toml"))
        self.addParameter(QgsProcessingParameterFolderDestination("OUTPUT", "Adjusted block"))
        self.addOutput(QgsProcessingOutputHtml("PAGE", "Report"))

    def processAlgorithm(self, parameters, context, feedback):
        """Run the command."""
        output = self.parameterAsString(parameters, "OUTPUT", context)
        feedback.pushInfo(run(["block", self.parameterAsFile(parameters, "BLOCK", context), "--out",
                               output], feedback))
        return {"OUTPUT": output, "PAGE": f"{output}/report.html"}
