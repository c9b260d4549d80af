"""Layers of QGIS as files that termsel reads, and files of termsel as layers."""

import csv

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

from .field_names import KNOWN, field_of


def points_csv(source, fields):
    """Write the features of a source as a table of points; return its path and the CRS's text.

    Selected features, edited and unsaved ones are those that Processing gives.

    Raises
    ------
    QgsProcessingException
        If there are no fields of line and sample, or no CRS.
    """
    names = {meaning: _field(source, meaning, fields.get(meaning)) for meaning in KNOWN}
    for meaning in ("line", "sample"):
        if names[meaning] is None:
            raise QgsProcessingException(
                f"The layer of points has no field that is known as {meaning}. State which it is; "
                f"its fields are {', '.join(field.name() for field in source.fields())}.")
    path = QgsProcessingUtils.generateTempFilename("points.csv")
    with open(path, "w", newline="", encoding="utf-8") as opened:
        table = csv.writer(opened, lineterminator="\n")
        table.writerow(["id", "role", "line", "sample", "x", "y", "z"])
        for number, feature in enumerate(source.getFeatures(), 1):
            table.writerow(_row(feature, names, number))
    return path, crs_text(source.sourceCrs())


def _field(source, meaning, stated):
    """Return the name of the field that has a meaning."""
    if stated:
        return stated
    return field_of(meaning, [field.name() for field in source.fields()])


def _row(feature, names, number):
    """Return the cells of a point.

    Raises
    ------
    QgsProcessingException
        If it has no geometry, or no numbers as line and sample.
    """
    geometry = feature.geometry()
    if geometry.isNull() or geometry.isEmpty():
        raise QgsProcessingException(f"Feature {feature.id()} of the layer of points has no "
                                     "geometry.")
    vertex = next(geometry.vertices())

    def cell(meaning):
        # NULL of QGIS is an object that is neither None nor text.
        value = feature[names[meaning]] if names[meaning] else None
        return "" if value is None or str(value) == "NULL" else value

    for meaning in ("line", "sample"):
        try:
            float(str(cell(meaning)).replace(",", "."))
        except ValueError:
            # Termsel would name a line of a file that the user does not know.
            raise QgsProcessingException(
                f"Feature {feature.id()} of the layer of points has {cell(meaning)!r:.40} in its "
                f"field {names[meaning]}, which is no number. Correct it, or leave the feature "
                "out.") from None
    # Heights of a field come before those of the geometry.
    height = cell("z")
    if height == "" and QgsWkbTypes.hasZ(geometry.wkbType()):
        height = repr(vertex.z())
    return [cell("id") or f"P{number}", cell("role"), cell("line"), cell("sample"),
            repr(vertex.x()), repr(vertex.y()), height]


def crs_text(crs):
    """Return a CRS as termsel takes it.

    Raises
    ------
    QgsProcessingException
        If there is none.
    """
    if not crs.isValid():
        raise QgsProcessingException("The layer of points has no CRS: give it one in its "
                                     "properties.")
    # Other systems than EPSG's are described in full.
    return crs.authid() if crs.authid().startswith("EPSG:") else crs.toWkt()


# Post-processors, which QGIS does not keep.
_kept = []


class AsInFile(QgsProcessingLayerPostProcessorInterface):
    """Gives a layer the look that its file states: Processing takes none by itself."""

    def __init__(self):
        super().__init__()
        _kept.append(self)

    def postProcessLayer(self, layer, context, feedback):
        """Take the look."""
        layer.loadDefaultStyle()
        layer.triggerRepaint()


class BlundersInRed(AsInFile):
    """Gives the layer of blunders its look."""

    def postProcessLayer(self, layer, context, feedback):
        """Take the look."""
        blunder_style(layer)
        layer.triggerRepaint()


class InShades(AsInFile):
    """Shows an uncertainty in shades, the darker the larger."""

    def postProcessLayer(self, layer, context, feedback):
        """Take the look."""
        shade(layer)
        layer.triggerRepaint()


def shade(layer):
    """Show the uncertainty to the north, band 4, from white to red."""
    statistics = layer.dataProvider().bandStatistics(4)
    ramp = QgsColorRampShader(statistics.minimumValue, statistics.maximumValue,
                              QgsGradientColorRamp(QColor("#fff5f0"), QColor("#a50f15")))
    # Five classes between the least and the largest value, in equal steps.
    ramp.classifyColorRamp(5, 4, layer.extent(), layer.dataProvider())
    shader = QgsRasterShader(statistics.minimumValue, statistics.maximumValue)
    shader.setRasterShaderFunction(ramp)
    renderer = QgsSingleBandPseudoColorRenderer(layer.dataProvider(), 4, shader)
    renderer.setClassificationMin(statistics.minimumValue)
    renderer.setClassificationMax(statistics.maximumValue)
    layer.setRenderer(renderer)


def blunder_style(layer):
    """Show blunders as large red circles."""
    symbol = QgsMarkerSymbol.createSimple({"color": "#c22f2f", "size": "4",
                                           "outline_color": "white"})
    layer.setRenderer(QgsSingleSymbolRenderer(symbol))


def add_blunders(folder, record, target):
    """Add the blunders among the points of a result as a layer to a GeoPackage."""
    errors = {outlier["id"]: outlier["error"] for outlier in record.get("outliers", [])}
    crs = QgsCoordinateReferenceSystem()
    crs.createFromUserInput(record["data"].get("crs", ""))
    layer = QgsVectorLayer("Point?field=id:string&field=error:double", "blunders", "memory")
    layer.setCrs(crs)
    with open(folder / "points.csv", newline="", encoding="utf-8") as opened:
        rows = csv.DictReader(line for line in opened if not line.startswith("#"))
        features = []
        for row in rows:
            # Only points: a blunder among lines has no place of its own.
            if row["id"] in errors:
                feature = QgsFeature(layer.fields())
                feature.setAttributes([row["id"], errors[row["id"]]])
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
