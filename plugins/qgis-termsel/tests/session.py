"""What a user does in the window of QGIS; writes what came of it to told.json.

Run by QGIS itself: qgis --code session.py, with the files of `termsel example` in the folder that
TERMSEL_PLACE names, and this plugin enabled.
"""

import json
import os
import sys
import time
import traceback
from pathlib import Path

import processing
from processing.gui import BatchPanel
from processing.gui.BatchAlgorithmDialog import BatchAlgorithmDialog
from qgis.core import (
    QgsApplication,
    QgsCoordinateReferenceSystem,
    QgsCoordinateTransform,
    QgsFeature,
    QgsGeometry,
    QgsPoint,
    QgsPointXY,
    QgsProcessingContext,
    QgsProcessingException,
    QgsProcessingFeatureSourceDefinition,
    QgsProcessingFeedback,
    QgsProcessingModelAlgorithm,
    QgsProcessingModelChildAlgorithm,
    QgsProcessingModelChildParameterSource,
    QgsProcessingModelOutput,
    QgsProcessingModelParameter,
    QgsProcessingParameterFeatureSource,
    QgsProject,
    QgsSettings,
    QgsVectorLayer,
)
from qgis.PyQt.QtCore import QEventLoop, Qt, QTimer
from qgis.PyQt.QtWidgets import QApplication, QDockWidget
from qgis.utils import iface, plugins
from qgis_termsel import child
from qgis_termsel.dock import CHECKED
from qgis_termsel.layers import points_csv, shade_uncertainty, stated_crs, write_table

folder = Path(os.environ["TERMSEL_PLACE"])
registry, project = QgsApplication.processingRegistry(), QgsProject.instance()
told = {"faults": []}
sys.excepthook = lambda *fault: told["faults"].append("".join(traceback.format_exception(*fault)))


class Told(QgsProcessingFeedback):
    """Keeps what is said."""

    def __init__(self, cancel_after=None):
        super().__init__(False)
        self.said, self.shares = [], []
        self.progressChanged.connect(self.shares.append)
        if cancel_after is not None:  # as a click on Cancel: it takes an event to be seen
            QTimer.singleShot(int(1000 * cancel_after), self.cancel)

    def pushInfo(self, info):
        self.said.append(info)

    def pushWarning(self, warning):
        self.said.append(warning)


class WhileWriting(Told):
    """Cancels as soon as the map has begun."""

    def isCanceled(self):
        return any((folder / "one map").iterdir())


def run(name, feedback=None, **parameters):
    """Return the outputs of an algorithm, or its message."""
    context = QgsProcessingContext()
    context.setProject(project)
    try:
        outputs = processing.run(name if isinstance(name, QgsProcessingModelAlgorithm) else
                                 f"termsel:{name}", parameters, context=context,
                                 feedback=feedback or Told())
    except QgsProcessingException as error:
        return {"error": str(error)}
    loaded = context.layersToLoadOnCompletion()
    return {**outputs, "loaded": sorted(details.name for details in loaded.values()),
            "valid": [bool(context.getMapLayer(source) or context.takeResultLayer(source)) or
                      QgsVectorLayer(source.partition("://")[2], "", "delimitedtext").isValid() or
                      QgsVectorLayer(source, "", "ogr").isValid() for source in loaded]}


def layer_of(table, crs):
    """Return a layer in memory, in another CRS and with edits that are not saved."""
    layer = QgsVectorLayer(f"PointZ?crs={crs}&field=id:string&field=row:double&"
                           "field=col:double&field=role:string", "points", "memory")
    header, *rows = [line.split(",") for line in table.read_text().splitlines()
                     if not line.startswith("#")]
    to = QgsCoordinateTransform(QgsCoordinateReferenceSystem("EPSG:4326"), layer.crs(), project)
    features = []
    for cells in rows:
        row = dict(zip(header, cells, strict=True))
        feature = QgsFeature(layer.fields())
        feature.setAttributes([row["id"], float(row["line"]), float(row["sample"]), row["role"]])
        place = QgsGeometry(QgsPoint(float(row["x"]), float(row["y"])))
        place.transform(to)
        place.get().addZValue(float(row["z"]))
        feature.setGeometry(place)
        features.append(feature)
    layer.startEditing()
    layer.addFeatures(features)  # neither saved nor committed
    return layer


def picture_of(dialog, path):
    """Save a picture of a dialog in which all fields fit, with a short name of the file."""
    given = dialog.createProcessingParameters()
    dialog.setParameters({**given, "FILE": "gcps.csv", "OUTPUT": "result"})
    size = dialog.size()
    dialog.resize(1280, 900)
    QApplication.processEvents()
    dialog.grab().save(str(path))
    dialog.resize(size)
    dialog.setParameters(given)


def drive(act, step, seconds=60):
    """Do what opens a dialog, and call a step on it again and again until it says that it is done.

    A dialog has an event loop of its own, so that the steps must be events.
    """
    timer, begin = QTimer(), time.monotonic()

    def look():
        for dialog in QApplication.topLevelWidgets():
            if dialog.isVisible() and hasattr(dialog, "runButton") and (
                    step(dialog) or time.monotonic() - begin > seconds):
                timer.stop()
                dialog.close()

    timer.timeout.connect(look)
    timer.start(100)
    act()
    timer.stop()


def georeference():
    """From layers, alone and in a model, and in a batch."""
    layer = layer_of(folder / "gcps.csv", "EPSG:32639")
    project.addMapLayer(layer)
    feedback = Told()
    told["layer"] = run("georeference", feedback, POINTS=layer,
                        OUTPUT=str(folder / "of layer żółć 東京"))
    told["shares"], told["said"] = feedback.shares, feedback.said
    layer.selectByExpression('"col" < 300')
    told["count"] = [layer.selectedFeatureCount(), layer.featureCount()]
    told["model"] = run(model(), points=QgsProcessingFeatureSourceDefinition(
        layer.id(), selectedFeaturesOnly=True), **{
            "georeference:result": str(folder / "of model"),
            "rectify:map": str(folder / "map of model.tif")})
    layer.rollBack()  # QGIS would ask
    project.removeMapLayer(layer.id())

    rows = (folder / "gcps.csv").read_text().splitlines()
    few = [row.split(",") for row in rows if row.startswith(("C1", "C2", "C3", "C9"))][::9]
    (folder / "few.csv").write_text("id,line,sample,x,y,z\n" + "".join(
        ",".join([cells[0], *cells[2:7]]) + "\n" for cells in few))
    told["few"] = [len(few), run("georeference", FILE=str(folder / "few.csv"), MODEL="affine",
                                 CRS="EPSG:4979", OUTPUT=str(folder / "few"))]
    in_feet = [row.split(",")[2:7] for row in rows if row.startswith("C1")]
    (folder / "feet.csv").write_text("id,line,sample,x,y,z\n" + "".join(
        f"F{i},{line},{sample},{1e6 + 3e5 * (float(x) - 48)},{1e6 + 3e5 * (float(y) - 34)},{z}\n"
        for i, (line, sample, x, y, z) in enumerate(in_feet)))
    feet = {"FILE": str(folder / "feet.csv"), "CRS": "EPSG:2263", "MODEL": "affine"}
    told["unit open"] = run("georeference", OUTPUT=str(folder / "open"), **feet)
    told["in feet"] = run("georeference", HEIGHT_UNIT="us-ft", OUTPUT=str(folder / "feet"), **feet)
    at = next(i for i, row in enumerate(rows) if row.startswith("C40,"))
    cells = rows[at].split(",")
    cells[2] = str(float(cells[2]) + 40)
    (folder / "wrong.csv").write_text(
        "\n".join([*rows[:at], ",".join(cells), *rows[at + 1:]]) + "\n")
    (folder / "batch.json").write_text(json.dumps([
        {"PARAMETERS": {"FILE": repr(str(folder / file)), "MODEL": repr(named)},
         "OUTPUTS": {"OUTPUT": str(folder / target)}}
        for file, named, target in (("wrong.csv", "affine", "wrong"),
                                    ("gcps.csv", "poly3d 2", "quadratic"))]))
    BatchPanel.QFileDialog.getOpenFileName = lambda *_: (str(folder / "batch.json"), "")
    dialog = BatchAlgorithmDialog(registry.createAlgorithmById("termsel:georeference"),
                                  iface.mainWindow())
    dialog.mainWidget().load()
    dialog.show()
    dialog.grab().save(str(folder / "batch.png"))
    dialog.runButton().click()
    dialog.close()
    told["looks"] = sorted({(layer.name(), layer.renderer().type())
                            for layer in project.mapLayers().values()})
    project.removeAllMapLayers()


def model():
    """Return a model: georeference, then rectify."""
    made = QgsProcessingModelAlgorithm("Map of points", "tests")
    made.initAlgorithm()
    made.addModelParameter(QgsProcessingParameterFeatureSource("points", "Points"),
                           QgsProcessingModelParameter("points"))
    static = QgsProcessingModelChildParameterSource.fromStaticValue
    first = QgsProcessingModelChildAlgorithm("termsel:georeference")
    first.setChildId("georeference")
    first.addParameterSources(
        "POINTS", [QgsProcessingModelChildParameterSource.fromModelParameter("points")])
    first.addParameterSources("MODEL", [static("affine")])
    then = QgsProcessingModelChildAlgorithm("termsel:rectify")
    then.setChildId("rectify")
    then.addParameterSources("RESULT", [QgsProcessingModelChildParameterSource.fromChildOutput(
        "georeference", "OUTPUT")])
    then.addParameterSources("IMAGE", [static(str(folder / "scene.tif"))])
    then.addParameterSources("HEIGHT", [static(1800)])
    for algorithm, name in ((first, "result"), (then, "map")):
        output = QgsProcessingModelOutput(name)
        output.setChildId(algorithm.childId())
        output.setChildOutputName("OUTPUT")
        algorithm.setModelOutputs({name: output})
        made.addChildAlgorithm(algorithm)
    made.updateDestinationParameters()
    return made


def results():
    """What is done with a result, and other algorithms."""
    result, plain = str(folder / "of layer żółć 東京"), str(folder / "of model")
    told["places"] = run("nextplaces", RESULT=result, NUMBER=3, OUTPUT=str(folder / "places.gpkg"))
    told["export"] = run("export", RESULT=result, FORMAT=0, OUTPUT=str(folder / "scene_RPC.TXT"))
    told["report"] = run("report", RESULT=plain, OUTPUT=str(folder / "p ü.html"))
    told["sigma"] = run("sigma", RESULT=plain, DEM=str(folder / "dem.tif"),
                        IMAGE=str(folder / "scene.tif"), RES=50,
                        OUTPUT=str(folder / "sigma ü.tif"))
    shades = iface.addRasterLayer(told["sigma"].get("OUTPUT", ""), "sigma")
    if shades:
        shade_uncertainty(shades)
        told["shades"] = [shades.renderer().band(), shades.renderer().classificationMax()]
        project.removeMapLayer(shades.id())
    told["match"] = run(
        "match", IMAGE=str(folder / "scene.tif"), REFERENCE=str(folder / "ortho.tif"),
        DEM=str(folder / "dem.tif"), START=str(folder / "vendor.RPB"),
        OUTPUT=str(folder / "candidates ü.csv"))
    told["lines"] = run("selectlines", LINES=str(folder / "lines.csv"),
                        FILE=str(folder / "points.csv"), OUTPUT=str(folder / "of lines"))
    told["block"] = run("block", BLOCK=str(folder / "block" / "block.toml"),
                        OUTPUT=str(folder / "block out"))


def wrong():
    """What cannot be done, and what is cancelled."""
    told["no fields"] = run("georeference", POINTS=QgsVectorLayer(
        "Point?crs=EPSG:4326&field=a:int", "empty", "memory"), OUTPUT=str(folder / "none"))
    words = QgsVectorLayer("Point?crs=EPSG:4326&field=row:string&field=col:double", "p", "memory")
    feature = QgsFeature(words.fields())
    feature.setAttributes(["twelve", 3.0])
    feature.setGeometry(QgsGeometry(QgsPoint(48.5, 34.8)))
    words.dataProvider().addFeatures([feature])
    told["no number"] = run("georeference", POINTS=words, OUTPUT=str(folder / "none"))
    pairs = QgsVectorLayer("MultiPoint?crs=EPSG:4326&field=row:double&field=col:double", "p",
                           "memory")
    pair = QgsFeature(pairs.fields())
    pair.setAttributes([12.0, 3.0])
    pair.setGeometry(QgsGeometry.fromWkt("MultiPoint((48.5 34.8), (48.6 34.8))"))
    pairs.dataProvider().addFeatures([pair])
    told["two points"] = run("georeference", POINTS=pairs, OUTPUT=str(folder / "none"))
    drawn = QgsVectorLayer("PointZ?crs=EPSG:4326&field=row:double&field=col:double", "p", "memory")
    point = QgsFeature(drawn.fields())
    point.setAttributes([12.0, 3.0])
    point.setGeometry(QgsGeometry(QgsPoint(48.5, 34.8, float("nan"))))
    drawn.dataProvider().addFeatures([point])
    told["without heights"] = Path(points_csv(drawn, {})[0]).read_text().splitlines()
    told["neither"] = run("georeference", OUTPUT=str(folder / "none"))
    told["taken"] = run("georeference", FILE=str(folder / "gcps.csv"),
                        OUTPUT=str(folder / "quadratic"))
    told["no points"] = run("georeference", FILE=str(folder / "dem.tif"),
                            OUTPUT=str(folder / "none"))
    begin = time.monotonic()
    told["cancelled"] = run("georeference", Told(cancel_after=0.3), FILE=str(folder / "gcps.csv"),
                            OUTPUT=str(folder / "cancelled"))
    told["seconds to cancel"] = time.monotonic() - begin - 0.3

    # A child that takes no notice of the request to end, and one that is stopped as it writes.
    stubborn = folder / "stubborn.py"
    stubborn.write_text(
        "import os, signal, time\n"
        "os.mkdir(f'{os.path.dirname(__file__)}/.termsel-0-{os.getpid()}-0')\n"
        "signal.signal(signal.SIGINT, signal.SIG_IGN)\ntime.sleep(60)\n")
    begin = time.monotonic()
    try:
        child.run([stubborn], Told(cancel_after=0.5), sys.executable)
    except QgsProcessingException as error:
        told["stubborn"] = {"error": str(error), "seconds": time.monotonic() - begin - 0.5}
    (folder / "one map").mkdir()
    told["stopped"] = run("rectify", WhileWriting(), RESULT=str(folder / "of model"), RES=0.5,
                          IMAGE=str(folder / "scene.tif"), HEIGHT=1800.0,
                          OUTPUT=str(folder / "one map" / "m.tif"))
    told["left"] = [path.name for path in folder.glob(".termsel*")]
    told["left in maps"] = [path.name for path in (folder / "one map").iterdir()]


def dock():
    """Show a result with a blunder, leave it out with a click, and run again in the dialog."""
    shown = plugins["qgis_termsel"].dock
    shown.show()
    shown.show_result(folder / "wrong")
    seen = told["dock"] = {
        "accuracy": shown.accuracy.text(), "rows": shown.table.rowCount(),
        "first": [shown.table.item(0, 1).text(), shown.table.item(0, 0).checkState() == CHECKED],
        "layers": sorted(layer.name() for layer in project.mapLayers().values())}
    iface.mainWindow().resize(1400, 900)
    for other in iface.mainWindow().findChildren(QDockWidget):
        if other.windowTitle() == "Results Viewer":
            other.close()
    QApplication.processEvents()  # a map that becomes larger keeps its scale
    canvas = iface.mapCanvas()
    canvas.setDestinationCrs(next(iter(project.mapLayers().values())).crs())
    points = next(layer for layer in project.mapLayers().values() if layer.name() == "residuals")
    extent = points.extent()
    extent.scale(1.15)
    canvas.setExtent(extent)
    picture = drawn(canvas)
    picture.save(str(folder / "map.png"))
    seen["red"] = sum(picture.pixelColor(x, y).name() == "#c22f2f"
                      for x in range(picture.width()) for y in range(picture.height()))
    shown.buttons["Choose on the map"].click()
    seen["tool"] = canvas.mapTool() is shown.map_tool
    place = shown.map_tool.positions_on_map()["C40"]
    shown.table.clearSelection()
    shown.map_tool.choose(place)
    seen["chosen"] = shown.selected_id()
    shown.map_tool.choose(QgsPointXY(place.x() + 1e7, place.y()))  # no point is near
    seen["still chosen"] = shown.selected_id()
    shown.buttons["Go to"].click()
    seen["gone to"] = [canvas.center().distance(place) < canvas.extent().width() / 100,
                       canvas.extent().width() < extent.width() / 2]
    canvas.setExtent(extent)
    seen["check"] = shown.check_these.text()
    seen["heads"] = [shown.table.horizontalHeaderItem(i).text() for i in range(6)]
    seen["roles"] = sorted({shown.table.item(i, 2).text() for i in range(shown.table.rowCount())})
    shown.table.item(1, 0).setCheckState(CHECKED)  # the blunder has its own already
    seen["left out"] = shown.left_out()
    iface.mainWindow().grab().save(str(folder / "window.png"))

    def step(dialog):
        if not getattr(dialog, "begun", False):
            dialog.begun = True
            dialog.setParameters({"OUTPUT": str(folder / "again")})
            picture_of(dialog, folder / "dialog.png")
            dialog.runButton().click()
        if dialog.results():
            seen["log"] = dialog.grab().save(str(folder / "log.png"))
        return bool(dialog.results())

    drive(shown.buttons["Run again"].click, step)
    seen["again"] = [str(shown.folder), shown.table.rowCount(), shown.accuracy.text()]
    seen["candidates"] = [
        [shown.candidates.itemText(i), shown.candidates.itemData(i),
         shown.candidates.model().item(i).isEnabled()] for i in range(shown.candidates.count())]
    shown.candidates.setCurrentIndex(
        shown.candidates.findText("quadratic", Qt.MatchFlag.MatchStartsWith))
    seen["asked"] = shown.next_run()
    shown.show_result(folder / "of lines")
    seen["asked of lines"] = shown.next_run()

    def export(dialog):
        seen["export"] = dialog.algorithm().id()
        return True

    drive(shown.buttons["Export RPC"].click, export)
    shown.show_result(folder)
    seen["none"] = shown.accuracy.text()
    stranger(shown, seen)


def stranger(shown, seen):
    """Open what somebody else has made: links, pipes, a CRS that names files, formulas."""
    for name, make in (("link", lambda path: path.symlink_to(folder / "result" / "result.json")),
                       ("pipe", os.mkfifo), ("text", lambda path: path.write_text('{"rmse": 5}'))):
        place = folder / f"of a stranger, {name}"
        place.mkdir()
        make(place / "result.json")
        (place / "residuals.csv").write_text("id\n")
        shown.show_result(place)
        seen[name] = shown.accuracy.text()
    wkt = QgsCoordinateReferenceSystem("EPSG:32639").toWkt()
    seen["crs"] = [stated_crs(text).isValid() for text in (
        "EPSG:32639", wkt, "http://127.0.0.1:9/crs", "/etc/passwd", "+proj=longlat",
        wkt.replace("]]", '],EXTENSION["PROJ4","+proj=utm +nadgrids=/dev/zero"]]', 1))]
    write_table(folder / "cells.csv", [["=cmd()", "P1", "-1.5", " @x", 2.5]])
    seen["cells"] = (folder / "cells.csv").read_text()


def drawn(canvas):
    """Return the picture of the map, once it is drawn."""
    loop = QEventLoop()
    canvas.mapCanvasRefreshed.connect(loop.quit)
    QTimer.singleShot(10_000, loop.quit)
    canvas.refreshAllLayers()
    loop.exec()
    return canvas.grab().toImage()


def setup():
    """Make an environment with a wheel, state one, and stop in the middle."""
    environment = child.own_environment()
    told["stopped setup"] = run("setup", Told(cancel_after=0.6), PACKAGES="termsel")
    told["environment left"] = environment.exists()
    wheel = next(folder.glob("*.whl"))
    feedback = Told()
    told["setup"] = run("setup", feedback, PACKAGES=f"'{wheel}'")
    told["setup said"] = feedback.said
    told["found"] = child.find_termsel_command()
    QgsSettings().remove(child.SETTING)
    stated = os.environ.pop("TERMSEL_EXECUTABLE")
    told["found without setting"] = child.find_termsel_command()
    os.environ["TERMSEL_EXECUTABLE"] = stated
    told["stated"] = run("setup", ENVIRONMENT=str(environment), PACKAGES="")
    told["no environment"] = run("setup", ENVIRONMENT=str(folder))
    QgsSettings().setValue(child.SETTING, str(folder / "nothing here"))
    told["missing"] = run("report", RESULT=str(folder), OUTPUT=str(folder / "no.html"))


def main():
    """Do all of it; whatever fails is told."""
    provider = registry.providerById("termsel")
    told["algorithms"] = sorted(one.id() for one in provider.algorithms())
    told["helps"] = all(one.shortHelpString() for one in provider.algorithms())
    told["seconds"] = {}
    for part in (georeference, results, wrong, dock, setup):
        begin = time.monotonic()
        part()
        told["seconds"][part.__name__] = time.monotonic() - begin
    plugins["qgis_termsel"].unload()
    told["unloaded"] = registry.providerById("termsel") is None


try:
    main()
except BaseException:  # noqa: BLE001 (QGIS would show a window and wait)
    told["faults"].append(traceback.format_exc())
(folder / "told.json").write_text(json.dumps(told, default=str))
os._exit(0)  # QGIS would ask whether to save the project
