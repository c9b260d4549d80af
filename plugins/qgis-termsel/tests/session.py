"""What a user does in QGIS, without a window; prints what came of it as JSON.

Run by the Python of QGIS: session.py FOLDER, with the files of `termsel example` in FOLDER.
"""

import json
import sys
import time
from pathlib import Path

from qgis.core import (
    QgsApplication,
    QgsCoordinateReferenceSystem,
    QgsFeature,
    QgsGeometry,
    QgsMapRendererSequentialJob,
    QgsMapSettings,
    QgsPoint,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingFeatureSourceDefinition,
    QgsProcessingFeedback,
    QgsProject,
    QgsRasterLayer,
    QgsVectorLayer,
)
from qgis.PyQt.QtCore import QSize, Qt
from qgis.PyQt.QtGui import QColor

application = QgsApplication([], True)
application.initQgis()
sys.path.insert(0, str(Path(QgsApplication.pkgDataPath()) / "python" / "plugins"))

import processing  # noqa: E402
from processing.core.Processing import Processing  # noqa: E402
from qgis_termsel import child  # noqa: E402
from qgis_termsel.dock import CHECKED, ResultDock  # noqa: E402
from qgis_termsel.layers import blunder_style, shade  # noqa: E402
from qgis_termsel.provider import TermselProvider  # noqa: E402

Processing.initialize()
provider = TermselProvider()
QgsApplication.processingRegistry().addProvider(provider)
folder = Path(sys.argv[1])
told = {"algorithms": sorted(one.id() for one in provider.algorithms()),
        "helps": all(one.shortHelpString() for one in provider.algorithms())}


class Told(QgsProcessingFeedback):
    """Keeps what is said."""

    def __init__(self, cancel_after=None):
        super().__init__(False)
        self.said, self.shares, self.begin = [], [], time.monotonic()
        self.cancel_after = cancel_after
        self.progressChanged.connect(self.shares.append)

    def pushInfo(self, info):
        self.said.append(info)

    def pushWarning(self, warning):
        self.said.append(warning)

    def isCanceled(self):
        return (self.cancel_after is not None
                and time.monotonic() - self.begin > self.cancel_after)


def layer_of(table, crs):
    """Return a memory layer, in another CRS and with an edit that is not saved."""
    layer = QgsVectorLayer("PointZ?crs=EPSG:4979&field=id:string&field=row:double&"
                           "field=col:double&field=role:string", "points", "memory")
    rows = [line.split(",") for line in table.read_text().splitlines() if not
            line.startswith("#")]
    header = rows[0]
    features = []
    for cells in rows[1:]:
        row = dict(zip(header, cells, strict=True))
        feature = QgsFeature(layer.fields())
        feature.setAttributes([row["id"], float(row["line"]), float(row["sample"]), row["role"]])
        feature.setGeometry(QgsGeometry(QgsPoint(*(float(row[axis]) for axis in "xyz"))))
        features.append(feature)
    layer.startEditing()
    layer.addFeatures(features)  # neither saved nor committed
    if crs:
        layer.setCrs(QgsCoordinateReferenceSystem(crs))
    return layer


def run(name, feedback=None, **parameters):
    """Return the outputs of an algorithm, or its message."""
    context = QgsProcessingContext()
    context.setProject(QgsProject.instance())
    try:
        outputs = processing.run(f"termsel:{name}", parameters, context=context,
                                 feedback=feedback or Told())
    except QgsProcessingException as error:
        return {"error": str(error)}
    outputs["loaded"] = sorted(
        details.name for details in context.layersToLoadOnCompletion().values())
    return outputs


rows = (folder / "gcps.csv").read_text().splitlines()
at = next(i for i, row in enumerate(rows) if row.startswith("C40,"))
cells = rows[at].split(",")
cells[2] = str(float(cells[2]) + 40)
(folder / "wrong.csv").write_text("\n".join([*rows[:at], ",".join(cells), *rows[at + 1:]]) + "\n")
layer = layer_of(folder / "gcps.csv", None)
feedback = Told()
told["layer"] = run("georeference", feedback, POINTS=layer, OUTPUT=str(folder / "of layer ü"))
told["shares"] = feedback.shares
told["said"] = feedback.said
QgsProject.instance().addMapLayer(layer)
layer.selectByExpression('"col" < 300')
told["count"] = [layer.selectedFeatureCount(), layer.featureCount()]
told["selected"] = run("georeference", POINTS=QgsProcessingFeatureSourceDefinition(
    layer.id(), selectedFeaturesOnly=True), OUTPUT=str(folder / "of selected"))
told["no fields"] = run("georeference", POINTS=QgsVectorLayer(
    "Point?crs=EPSG:4326&field=a:int", "empty", "memory"), OUTPUT=str(folder / "none"))
told["neither"] = run("georeference", OUTPUT=str(folder / "none"))
told["taken"] = run("georeference", FILE=str(folder / "gcps.csv"),
                    OUTPUT=str(folder / "of layer ü"))
begin = time.monotonic()
told["cancelled"] = run("georeference", Told(cancel_after=0.3), FILE=str(folder / "gcps.csv"),
                        OUTPUT=str(folder / "cancelled"))
told["seconds to cancel"] = time.monotonic() - begin - 0.3
told["places"] = run("nextplaces", RESULT=str(folder / "of layer ü"), NUMBER=3,
                     OUTPUT=str(folder / "places.gpkg"))
told["export"] = run("export", RESULT=str(folder / "of layer ü"), FORMAT=0,
                     OUTPUT=str(folder / "scene_RPC.TXT"))

told["report"] = run("report", RESULT=str(folder / "of layer ü"), OUTPUT=str(folder / "p ü.html"))
told["sigma"] = run("sigma", RESULT=str(folder / "of layer ü"), DEM=str(folder / "dem.tif"),
                    IMAGE=str(folder / "scene.tif"), OUTPUT=str(folder / "sigma ü.tif"))
told["match"] = run("match", IMAGE=str(folder / "scene.tif"), REFERENCE=str(folder / "ortho.tif"),
                    DEM=str(folder / "dem.tif"), START=str(folder / "vendor.RPB"),
                    OUTPUT=str(folder / "candidates ü.csv"))
told["lines"] = run("selectlines", LINES=str(folder / "lines.csv"),
                    FILE=str(folder / "points.csv"), OUTPUT=str(folder / "of lines"))
told["block"] = run("block", BLOCK=str(folder / "block" / "block.toml"),
                    OUTPUT=str(folder / "block out"))
told["model"] = run("georeference", FILE=str(folder / "gcps.csv"), MODEL="poly3d 2",
                    OUTPUT=str(folder / "quadratic"))

# A child that takes no notice of the request to end, and one that is stopped as it writes.
stubborn = folder / "stubborn.py"
stubborn.write_text("import os, signal, time\nos.mkdir(f'{os.path.dirname(__file__)}/.termsel-0-"
                    "{os.getpid()}-0')\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\n"
                    "time.sleep(60)\n")
begin = time.monotonic()
try:
    child.run([stubborn], Told(cancel_after=0.5), sys.executable)
except QgsProcessingException as error:
    told["stubborn"] = {"error": str(error), "seconds": time.monotonic() - begin - 0.5}
(folder / "maps").mkdir()


class WhileWriting(Told):
    """Cancels as soon as the map has begun."""

    def isCanceled(self):
        return any((folder / "maps").iterdir())


told["stopped"] = run("rectify", WhileWriting(), RESULT=str(folder / "of layer ü"), RES=0.5,
                      IMAGE=str(folder / "scene.tif"), HEIGHT=1800.0,
                      OUTPUT=str(folder / "maps" / "m.tif"))
told["left"] = [path.name for path in folder.glob(".termsel*")]
told["left in maps"] = [path.name for path in (folder / "maps").iterdir()]

shades = QgsRasterLayer(told["sigma"].get("OUTPUT", ""), "sigma")
if shades.isValid():
    shade(shades)
    told["shades"] = [shades.renderer().band(), shades.renderer().classificationMax()]

dock = ResultDock(None)
dock.show_result(folder / "of layer ü")
told["dock"] = {"accuracy": dock.accuracy.text(), "rows": dock.table.rowCount(),
                "first": dock.table.item(0, 1).text()}
dock.table.item(0, 0).setCheckState(CHECKED)
told["dock"]["left out"] = dock.left_out()
dock.resize(460, 420)
dock.grab().save(str(folder / "dock.png"))
told["dock"]["candidates"] = [
    [dock.candidates.itemText(i), dock.candidates.itemData(i),
     dock.candidates.model().item(i).isEnabled()] for i in range(dock.candidates.count())]
dock.candidates.setCurrentIndex(dock.candidates.findText("quadratic", Qt.MatchFlag.MatchStartsWith))
asked = []
processing.execAlgorithmDialog = lambda name, parameters: asked.append([name, parameters])
dock.rerun()
told["dock"]["asked"] = asked
dock.show_result(folder)
told["dock"]["none"] = dock.accuracy.text()

told["wrong"] = run("georeference", FILE=str(folder / "wrong.csv"), OUTPUT=str(folder / "wrong"))
layers = []
for name in ("blunders", "residuals", "vectors"):
    shown = QgsVectorLayer(f"{folder / 'wrong' / 'result_residuals.gpkg'}|layername={name}", name,
                           "ogr")
    layers.append(shown)
blunder_style(layers[0])
settings = QgsMapSettings()
settings.setLayers(layers)
settings.setOutputSize(QSize(700, 500))
settings.setBackgroundColor(QColor("white"))
extent = layers[1].extent()
extent.scale(1.15)
settings.setExtent(extent)
settings.setDestinationCrs(layers[0].crs())
job = QgsMapRendererSequentialJob(settings)
job.start()
job.waitForFinished()
picture = job.renderedImage()
picture.save(str(folder / "map.png"))
red = QColor("#c22f2f").rgb()
told["red"] = sum(picture.pixel(x, y) == red for x in range(0, 700) for y in range(0, 500))

child.executable = lambda: str(folder / "nothing here")
told["missing"] = run("report", RESULT=str(folder), OUTPUT=str(folder / "no.html"))
print("TOLD" + json.dumps(told, default=str))
