"""Layers of QGIS as files that termsel reads, and files of termsel as layers."""

import csv
import io
import math
import re
import stat
from pathlib import Path

from qgis.core import (
    QgsColorRampShader,
    QgsCoordinateReferenceSystem,
    QgsCoordinateTransformContext,
    QgsFeature,
    QgsGeometry,
    QgsGradientColorRamp,
    QgsMarkerSymbol,
    QgsPointXY,
    QgsProcessingException,
    QgsProcessingLayerPostProcessorInterface,
    QgsProcessingUtils,
    QgsRasterShader,
    QgsSingleBandPseudoColorRenderer,
    QgsSingleSymbolRenderer,
    QgsVectorFileWriter,
    QgsVectorLayer,
    QgsWkbTypes,
)
from qgis.PyQt.QtGui import QColor

from .field_names import KNOWN, field_of, heading, passed_on


def points_csv(source, fields):
    """Write a layer of control points as a CSV that termsel reads.

    Parameters
    ----------
    source : QgsProcessingFeatureSource
        The features to write: all of a layer, or those that are selected.
    fields : dict of str to str
        Names of fields that the user stated, by their meanings, which are the keys of `KNOWN`. A
        field that is not stated, or stated as "", is found by its name.

    Returns
    -------
    path, crs : str
        Path of a temporary file, and the CRS of its x and y as `crs_text` states it.

    Raises
    ------
    QgsProcessingException
        If there is no field of line or sample, a feature has no geometry, several points or no
        number as line or sample, or the layer has no CRS.
    """
    names = {meaning: _find_field(source, meaning, fields.get(meaning)) for meaning in KNOWN}
    for meaning in ("line", "sample"):
        if names[meaning] is None:
            raise QgsProcessingException(
                f"The layer of points has no field that is known as {meaning}. State which it is; "
                f"its fields are {', '.join(field.name() for field in source.fields())}.")
    path = QgsProcessingUtils.generateTempFilename("points.csv")
    further = passed_on([field.name() for field in source.fields()], names.values())
    rows = [[*_point_cells(feature, names, number), *(_cell(feature, name) for name in further)]
            for number, feature in enumerate(source.getFeatures(), 1)]
    headings = {meaning: heading(meaning, field) for meaning, field in names.items()}
    write_table(path, [["id", "role", headings["line"], headings["sample"], "x", "y",
                        headings["z"], *further], *rows])
    return path, crs_text(source.sourceCrs())


_FORMULA = re.compile(r"'*\s*[=+\-@\uff1d\uff0b\uff0d\uff20\ufe62\ufe63\ufe66\ufe6b]")
"""How a formula of a spreadsheet begins, as in termsel.core.files.texts."""


def write_table(path, rows):
    """Write rows as CSV, with an apostrophe before texts that a spreadsheet would run.

    `unguard_formula` and termsel take the apostrophe off again.
    """
    with open(path, "w", newline="", encoding="utf-8") as opened:
        csv.writer(opened, lineterminator="\n").writerows(
            [[_guard_formula(cell) for cell in row] for row in rows])


def _guard_formula(cell):
    """Return a cell with an apostrophe before a text that a spreadsheet would run as a formula.

    Numbers, also as text, and other texts are returned unchanged.
    """
    if not isinstance(cell, str) or not _FORMULA.match(cell):
        return cell
    # "-12.5" begins as a formula does, and is a number.
    try:
        float(cell)
    except ValueError:
        return f"'{cell}"
    return cell


def unguard_formula(text):
    """Return a cell without the apostrophe that `write_table` puts before a formula."""
    return text[1:] if text[:1] == "'" and _FORMULA.match(text) else text


def _find_field(source, meaning, stated):
    """Return the name of the field of a source that has a meaning, such as "line".

    It is `stated` if that is a name, or else the field that is called as usual (see `field_of`);
    None if there is none.
    """
    if stated:
        return stated
    return field_of(meaning, [field.name() for field in source.fields()])


def _point_cells(feature, names, number):
    """Return the cells of a feature of the layer of points: id, role, line, sample, x, y, z.

    `names` are the names of the layer's fields by meaning, None where there is none. A feature
    without an id is called P followed by `number`; x and y are those of its point. Cells without
    a value are "".

    Raises
    ------
    QgsProcessingException
        If the feature has no geometry or several points, or its line or sample is no number.
    """
    geometry = feature.geometry()
    if geometry.isNull() or geometry.isEmpty():
        raise QgsProcessingException(f"Feature {feature.id()} of the layer of points has no "
                                     "geometry.")
    vertex, *others = geometry.vertices()
    if others:
        raise QgsProcessingException(
            f"Feature {feature.id()} of the layer of points has {len(others) + 1} points for one "
            "line and sample. Make each a feature, as Multipart to singleparts does, with its own "
            "line and sample.")

    def cell(meaning):
        """Return the value of a field by its meaning; "" for NULL, and without such a field."""
        return _cell(feature, names[meaning]) if names[meaning] else ""

    for meaning in ("line", "sample"):
        # A decimal comma is left to termsel, which reads it.
        try:
            float(str(cell(meaning)).replace(",", "."))
        except ValueError:
            # The message of termsel would name a line of the table, which the user does not see.
            raise QgsProcessingException(
                f"Feature {feature.id()} of the layer of points has {cell(meaning)!r:.40} in its "
                f"field {names[meaning]}, which is no number. Correct it, or leave the feature "
                "out.") from None
    # A field of heights comes before the z of the geometry, which may be there by accident.
    height = cell("z")
    # A point that was drawn without a height has NaN for z.
    if height == "" and QgsWkbTypes.hasZ(geometry.wkbType()) and math.isfinite(vertex.z()):
        height = repr(vertex.z())
    return [cell("id") or f"P{number}", cell("role"), cell("line"), cell("sample"),
            repr(vertex.x()), repr(vertex.y()), height]


def _cell(feature, field):
    """Return the value of a field of a feature; "" for NULL."""
    # NULL of QGIS is an object that is neither None nor text.
    value = feature[field]
    return "" if value is None or str(value) == "NULL" else value


def crs_text(crs):
    """Return a CRS as text that termsel takes: an EPSG code, or else WKT.

    Raises
    ------
    QgsProcessingException
        If the CRS is not valid, as of a layer without one.
    """
    if not crs.isValid():
        raise QgsProcessingException("The layer of points has no CRS: give it one in its "
                                     "properties.")
    return crs.authid() if crs.authid().startswith("EPSG:") else crs.toWkt()


_CRS_CODE = re.compile(r"\w{2,20}:\w{1,20}")
_FILE_IN_WKT = re.compile(r"(grids|file|model|init)\s*=\s*\S*[/\\]|PARAMETERFILE|PROJ4_GRIDS",
                          re.IGNORECASE)
"""Parts of WKT that may name a file, which PROJ would open."""


def stated_crs(text):
    """Return the QGIS CRS of a text that a result states, which is a code or WKT.

    The CRS is invalid for other texts and for WKT that may name a file: the result may be a
    stranger's, and for such texts GDAL would open files or ask servers.
    """
    if _CRS_CODE.fullmatch(text):
        return QgsCoordinateReferenceSystem(text)
    if "[" in text and not _FILE_IN_WKT.search(text):
        return QgsCoordinateReferenceSystem.fromWkt(text)
    return QgsCoordinateReferenceSystem()


MAX_FILE_BYTES = 256 << 20
"""Size of the largest file of a result that is read."""


def read_result_file(folder, name):
    """Return the text of a file in the folder of a result, which may be a stranger's.

    Raises
    ------
    OSError
        If it is no regular file, is larger than `MAX_FILE_BYTES`, or cannot be read.
    UnicodeDecodeError
        If it is not UTF-8.
    """
    path = Path(folder) / name
    # lstat does not follow links: one could name any file of the user.
    state = path.lstat()
    if not stat.S_ISREG(state.st_mode) or state.st_size > MAX_FILE_BYTES:
        raise OSError(f"{name} is a link, no file, or too large")
    return path.read_text(encoding="utf-8")


# QGIS keeps no references to post-processors, so they would be deleted before they are called.
_post_processors = []


class StyleOfFile(QgsProcessingLayerPostProcessorInterface):
    """Gives a layer the style that its file states, which Processing does not do by itself."""

    def __init__(self):
        super().__init__()
        _post_processors.append(self)

    def postProcessLayer(self, layer, context, feedback):
        """Give a layer the style that its file states; QGIS calls it when the layer is loaded."""
        layer.loadDefaultStyle()
        layer.triggerRepaint()


class StyleOfBlunders(StyleOfFile):
    """Shows the layer of blunders as red circles."""

    def postProcessLayer(self, layer, context, feedback):
        """Show blunders as red circles; QGIS calls it when the layer is loaded."""
        show_blunders_in_red(layer)
        layer.triggerRepaint()


class StyleOfUncertainty(StyleOfFile):
    """Shows the raster of `termsel sigma` in shades of red, the darker the larger."""

    def postProcessLayer(self, layer, context, feedback):
        """Show the uncertainty in shades of red; QGIS calls it when the layer is loaded."""
        shade_uncertainty(layer)
        layer.triggerRepaint()


# Bands of `termsel sigma`: line, sample [px], east, north [m], and outside the control.
_NORTH_BAND = 4
_SHADES = 5


def shade_uncertainty(layer):
    """Show the standard deviation to the north [m] in five shades, from white to red.

    `layer` is the raster of `termsel sigma`.
    """
    statistics = layer.dataProvider().bandStatistics(_NORTH_BAND)
    ramp = QgsColorRampShader(statistics.minimumValue, statistics.maximumValue,
                              QgsGradientColorRamp(QColor("#fff5f0"), QColor("#a50f15")))
    ramp.classifyColorRamp(_SHADES, _NORTH_BAND, layer.extent(), layer.dataProvider())
    shader = QgsRasterShader(statistics.minimumValue, statistics.maximumValue)
    shader.setRasterShaderFunction(ramp)
    renderer = QgsSingleBandPseudoColorRenderer(layer.dataProvider(), _NORTH_BAND, shader)
    renderer.setClassificationMin(statistics.minimumValue)
    renderer.setClassificationMax(statistics.maximumValue)
    layer.setRenderer(renderer)


def show_blunders_in_red(layer):
    """Show the points of a layer as large red circles."""
    symbol = QgsMarkerSymbol.createSimple({"color": "#c22f2f", "size": "4",
                                           "outline_color": "white"})
    layer.setRenderer(QgsSingleSymbolRenderer(symbol))


def add_blunders(folder, record, target):
    """Write the points of a result that are blunders to the layer "blunders" of a GeoPackage.

    Each has its id and its error [px]. `folder` is that of the result, `record` the content of its
    result.json, and `target` the GeoPackage, which is made if it does not exist. A layer of this
    name is replaced; the new one has no features if no point is a blunder.
    """
    errors = {outlier["id"]: outlier["error"] for outlier in record.get("outliers", [])}
    layer = QgsVectorLayer("Point?field=id:string&field=error:double", "blunders", "memory")
    layer.setCrs(stated_crs(record["data"].get("crs", "")))
    # A result of lines alone has no table of points.
    has_points = (Path(folder) / "points.csv").exists()
    text = read_result_file(folder, "points.csv") if has_points else ""
    features = []
    # Blunders among lines are not in this table, and so not in the layer.
    for row in csv.DictReader(line for line in io.StringIO(text) if not line.startswith("#")):
        name = unguard_formula(row["id"])
        if name in errors:
            feature = QgsFeature(layer.fields())
            feature.setAttributes([name, errors[name]])
            feature.setGeometry(QgsGeometry.fromPointXY(
                QgsPointXY(float(row["x"]), float(row["y"]))))
            features.append(feature)
    layer.dataProvider().addFeatures(features)
    options = QgsVectorFileWriter.SaveVectorOptions()
    options.layerName = "blunders"
    options.actionOnExistingFile = (
        QgsVectorFileWriter.ActionOnExistingFile.CreateOrOverwriteLayer)
    QgsVectorFileWriter.writeAsVectorFormatV3(layer, str(target), QgsCoordinateTransformContext(),
                                              options)
