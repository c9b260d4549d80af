"""Georeference from points, and select control lines."""

import html
import json
from pathlib import Path

from qgis.core import (
    QgsProcessing,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingOutputHtml,
    QgsProcessingOutputNumber,
    QgsProcessingOutputString,
    QgsProcessingOutputVectorLayer,
    QgsProcessingParameterCrs,
    QgsProcessingParameterDefinition,
    QgsProcessingParameterEnum,
    QgsProcessingParameterFeatureSource,
    QgsProcessingParameterField,
    QgsProcessingParameterFile,
    QgsProcessingParameterFolderDestination,
    QgsProcessingParameterRasterLayer,
    QgsProcessingParameterString,
)

from ..child import run
from ..layers import (
    StyleOfBlunders,
    StyleOfFile,
    add_blunders,
    crs_text,
    points_csv,
    read_result_file,
)
from .base import Algorithm, layer_file, move_into_place, scratch_folder, with_page

_RESIDUALS = "result_residuals.gpkg"
INPUTS = "qgis.json"
"""File of this plugin in the folder of a result: parameters of inputs that are not copied there."""

_WITHOUT_CHECK = "--criterion press"
"""The option that termsel's message proposes if the points are too few for selection points."""

_DEGREE_BY_NAME = {"linear": 1, "quadratic": 2, "cubic": 3}


def inputs_of(folder):
    """Return the parameters for another run that the folder of a result does not have as files.

    That is {"RPC": path} for a result that was made with an RPC by this plugin, else {}.
    """
    # The file is this plugin's, but anything may have happened to the folder.
    try:
        stated = json.loads(read_result_file(folder, INPUTS))
    except (OSError, ValueError, RecursionError):
        return {}
    rpc = stated.get("RPC") if isinstance(stated, dict) else None
    return {"RPC": rpc} if isinstance(rpc, str) else {}


def model_named(candidate, model):
    """Return the parameter MODEL that fits a candidate of auto again; "" if only auto can fit it.

    `candidate` and `model` are a candidate's name and its model in result.json, such as "cubic"
    and "poly3d", for which the parameter is "poly3d 3".
    """
    # auto calls polynomials by their degrees; those whose terms it selects have other names.
    if model in ("poly2d", "poly3d"):
        return f"{model} {_DEGREE_BY_NAME[candidate]}" if candidate in _DEGREE_BY_NAME else ""
    # auto states this model for all its corrections of an RPC; by itself it fits the affine one.
    if model == "rpc-affine":
        return model if candidate == "rpc-by-affine" else ""
    return "" if candidate.startswith(("regularised", "selected")) else model


HEIGHT_UNITS = ("metre", "ft", "us-ft")
"""Units of heights as termsel calls them: a CRS in feet may have heights in feet or in metres."""


class Georeference(Algorithm):
    """Fits a model to the control points of an image, by `termsel run`."""

    NAME, TITLE, GROUP = "georeference", "Georeference from points", "Georeferencing"
    HELP = (
        "Chooses a model for an image from ground control points, names blunders, and reports "
        "the accuracy of the result.\n\nPoints are a layer with fields of line and sample (rows "
        "and columns in the image, the centre of the upper left pixel is 0, 0), or a file: .points "
        "of QGIS's georeferencer, CSV, or any other that termsel reads.\n\n"
        "Points with the role independent are independent check points: no fit and no choice uses "
        "them, and their RMSE is the accuracy. Rectify, Export model and Accuracy report read the "
        "output folder.")

    def initAlgorithm(self, config=None):
        """Declare parameters and outputs."""
        add = self.addParameter
        add(QgsProcessingParameterFeatureSource(
            "POINTS", "Layer of points", [QgsProcessing.SourceType.TypeVectorPoint], optional=True))
        # Fields that are called as usual are found by their names: these parameters are for others.
        for name, label in (("LINE", "Field of line (row)"), ("SAMPLE", "Field of sample (column)"),
                            ("HEIGHT", "Field of height"), ("ID", "Field of names"),
                            ("ROLE", "Field of roles")):
            field = QgsProcessingParameterField(name, label, parentLayerParameterName="POINTS",
                                                optional=True)
            field.setFlags(field.flags() | QgsProcessingParameterDefinition.Flag.FlagAdvanced)
            add(field)
        unit = QgsProcessingParameterEnum(
            "HEIGHT_UNIT", "Unit of heights (z_unit), if the CRS leaves it open",
            list(HEIGHT_UNITS), optional=True, usesStaticStrings=True)
        unit.setFlags(unit.flags() | QgsProcessingParameterDefinition.Flag.FlagAdvanced)
        add(unit)
        add(QgsProcessingParameterFile("FILE", "Or file of points", optional=True))
        add(QgsProcessingParameterCrs("CRS", "CRS of the file, if it states none", optional=True))
        add(QgsProcessingParameterRasterLayer("DEM", "Raster of heights", optional=True))
        add(QgsProcessingParameterRasterLayer(
            "IMAGE", "Image: its size, and its RPC and camera if it states them",
            optional=True))
        add(QgsProcessingParameterFile("RPC", "RPC of the vendor", optional=True))
        add(QgsProcessingParameterFile("LINES", "File of control lines", optional=True))
        add(QgsProcessingParameterString(
            "MODEL", "Model, unless it is chosen automatically, such as affine, tps or poly3d 2",
            optional=True))
        self._declare_outputs()

    def _declare_outputs(self):
        """Declare the outputs, and the parameters that come last in the dialog.

        `SelectLines` has the same.
        """
        self.addParameter(QgsProcessingParameterString(
            "OFF", "Points or lines to leave out, such as P07,L12", optional=True))
        self.addParameter(QgsProcessingParameterFolderDestination("OUTPUT", "Folder of the result"))
        self.addOutput(QgsProcessingOutputVectorLayer("RESIDUALS", "Residuals"))
        self.addOutput(QgsProcessingOutputVectorLayer("VECTORS", "Residual vectors"))
        self.addOutput(QgsProcessingOutputVectorLayer("WRONG", "Layer of blunders"))
        self.addOutput(QgsProcessingOutputHtml("SUMMARY", "Summary"))
        self.addOutput(QgsProcessingOutputNumber("RMSE", "RMSE of independent check points [px]"))
        self.addOutput(QgsProcessingOutputString("BLUNDERS", "Blunders"))

    def processAlgorithm(self, parameters, context, feedback):
        """Run `termsel run` and return its outputs."""
        return self._run(self._point_arguments(parameters, context)
                         + self._option_arguments(parameters, context),
                         parameters, context, feedback)

    def _point_arguments(self, parameters, context):
        """Return the arguments of `termsel run` that state the points and their CRS.

        A layer of points is written to a temporary file. Raises QgsProcessingException unless
        either a layer or a file of points is given.
        """
        source = self.parameterAsSource(parameters, "POINTS", context)
        file = self.parameterAsFile(parameters, "FILE", context)
        if bool(source) == bool(file):
            raise QgsProcessingException("Give a layer of points or a file of points, and not "
                                         "both." if file else "Give a layer or a file of points.")
        if file:
            crs = self.parameterAsCrs(parameters, "CRS", context)
            return ["--points", file, *(["--crs", crs_text(crs)] if crs.isValid() else [])]
        # The names of termsel's columns by the parameters of the dialog.
        fields = {meaning: self.parameterAsString(parameters, name, context)
                  for meaning, name in (("line", "LINE"), ("sample", "SAMPLE"), ("z", "HEIGHT"),
                                        ("id", "ID"), ("role", "ROLE"))}
        path, crs = points_csv(source, fields)
        return ["--points", path, "--crs", crs]

    def _option_arguments(self, parameters, context):
        """Return the arguments of `termsel run` for the parameters other than the points.

        They state the raster of heights, image, RPC, lines, unit of heights and model, as far as
        they are given.
        """
        arguments = []
        dem = self.parameterAsRasterLayer(parameters, "DEM", context)
        if dem is not None:
            arguments += ["--dem", layer_file(dem, "raster of heights")]
        image = self.parameterAsRasterLayer(parameters, "IMAGE", context)
        if image is not None:
            arguments += ["--image", layer_file(image, "image")]
        for name, option in (("RPC", "--rpc"), ("LINES", "--lines")):
            file = self.parameterAsFile(parameters, name, context)
            if file:
                arguments += [option, file]
        unit = self.parameterAsEnumString(parameters, "HEIGHT_UNIT", context)
        if unit:
            arguments += ["--set", f"z_unit={unit}"]
        # "poly3d 2": a model, and its degree where it has one.
        model, _, degree = self.parameterAsString(parameters, "MODEL", context).partition(" ")
        if model:
            arguments += ["--strategy", "as-asked", "--problem", "poly-terms", "--solver",
                          "all-terms", "--model", model]
            arguments += ["--set", f"degree={degree}"] if degree else []
        return arguments

    def _run(self, arguments, parameters, context, feedback):
        """Run `termsel run`, move its result to the output folder, and return the outputs.

        `arguments` are those of the command without the features left out, the folder and the
        export. If the points are too few to set selection points aside, the command is run once
        more without any. Raises QgsProcessingException if termsel fails, or if the output folder
        has a result already.
        """
        new_folder = scratch_folder()
        target = self.parameterAsString(parameters, "OUTPUT", context)
        # termsel refuses this, too, but only after the search.
        if (Path(target) / "result.json").exists():
            raise QgsProcessingException(f"{target} has a result already. Choose another folder.")
        off = self.parameterAsString(parameters, "OFF", context)
        command = ["run", *arguments, *(["--off", off] if off else []), "--out", new_folder,
                   "--export", "residuals-gpkg", "--progress", "json", "--json"]
        try:
            printed = run(command, feedback)
        except QgsProcessingException as error:
            # With few points the message of termsel proposes to judge models by leaving each point
            # out in turn (PRESS), which needs no selection points: a dialog can do so at once.
            if _WITHOUT_CHECK not in str(error):
                raise
            feedback.pushInfo("The points are too few for selection points: none are set aside.")
            printed = run([*command, *_WITHOUT_CHECK.split()], feedback)
        record = json.loads(printed)
        rpc = self.parameterAsFile(parameters, "RPC", context)
        # Another run needs the RPC again, of which the folder of the result has no copy.
        if rpc:
            (Path(new_folder) / INPUTS).write_text(json.dumps({"RPC": rpc}), encoding="utf-8")
        move_into_place(new_folder, target)
        return self._outputs_of_result(Path(target), record, context, feedback)

    def _outputs_of_result(self, folder, record, context, feedback):
        """Return the outputs for the result in a folder, and let QGIS load its layers.

        `record` is the content of its result.json. Summary and notes are shown in the log, and the
        summary becomes a page of the results viewer, too.
        """
        summary = (folder / "summary.txt").read_text(encoding="utf-8")
        feedback.pushInfo(summary)
        for note in record.get("notes", []):
            feedback.pushWarning(note)
        page = folder / "summary.html"
        # Writing to a link would overwrite the file that it leads to.
        page.unlink(missing_ok=True)
        page.write_text("<!doctype html><meta charset='utf-8'><pre>" + html.escape(summary)
                        + "</pre>", encoding="utf-8")
        add_blunders(folder, record, folder / _RESIDUALS)
        layers = {"RESIDUALS": ("residuals", "Residuals"),
                  "VECTORS": ("vectors", "Residual vectors"), "WRONG": ("blunders", "Blunders")}
        outputs = {"OUTPUT": str(folder),
                   "RMSE": ((record.get("rmse") or {}).get("independent") or {}).get("total"),
                   "BLUNDERS": ",".join(outlier["id"] for outlier in record.get("outliers", []))}
        for name, (layer, title) in layers.items():
            outputs[name] = f"{folder / _RESIDUALS}|layername={layer}"
            details = QgsProcessingContext.LayerDetails(title, context.project(), name)
            # termsel wrote styles of its layers to the GeoPackage, where blunders have none.
            details.setPostProcessor(StyleOfBlunders() if name == "WRONG" else StyleOfFile())
            context.addLayerToLoadOnCompletion(outputs[name], details)
        return with_page(outputs, "SUMMARY", page, feedback)


class SelectLines(Georeference):
    """Selects control lines by OWDIS, and fits a model to them, by `termsel run`."""

    NAME, TITLE = "selectlines", "Select control lines (OWDIS)"
    HELP = (
        "Selects the optimum number of well-distributed control lines (OWDIS; Yavari et al. 2018) "
        "and fits the model to them.\n\n"
        "Lines are a table with two measured image points and two ground vertices of each: "
        "id, line1, sample1, line2, sample2, x1, y1, z1, x2, y2, z2. Selection points decide which "
        "lines are used, and independent check points give the accuracy.")

    def initAlgorithm(self, config=None):
        """Declare parameters and outputs."""
        self.addParameter(QgsProcessingParameterFile("LINES", "File of control lines"))
        self.addParameter(QgsProcessingParameterFile(
            "FILE", "File of selection points and independent check points"))
        self.addParameter(QgsProcessingParameterCrs("CRS", "CRS of the files", optional=True))
        self._declare_outputs()

    def processAlgorithm(self, parameters, context, feedback):
        """Run `termsel run` with the problem owdis-lines and return its outputs."""
        crs = self.parameterAsCrs(parameters, "CRS", context)
        return self._run(
            ["--problem", "owdis-lines", "--lines", self.parameterAsFile(
                parameters, "LINES", context),
             "--points", self.parameterAsFile(parameters, "FILE", context),
             *(["--crs", crs_text(crs)] if crs.isValid() else [])], parameters, context, feedback)
