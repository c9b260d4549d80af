"""The map tool: a click chooses the point of the control that is nearest, as on termsel's page."""

import csv
import io

from qgis.core import (
    QgsCoordinateTransform,
    QgsPointXY,
    QgsProject,
)
from qgis.gui import QgsMapToolEmitPoint

from .layers import read_inside, stated_crs, unguard_formula

CLICK_PX = 15
"""Pixels of the screen within which a click finds a point."""
CLOSER = 4
"""By how much "Go to" enlarges a map that shows all points."""


def places_of(folder, record):
    """Return the CRS of a result, and the places of its points in that CRS by id.

    `folder` is that of the result, and `record` the content of its result.json.

    Raises
    ------
    OSError, ValueError, KeyError
        If the folder has no table of points, or one with other columns or no numbers.
    """
    text = read_inside(folder, "points.csv")
    rows = csv.DictReader(line for line in io.StringIO(text) if not line.startswith("#"))
    places = {unguard_formula(row["id"]): QgsPointXY(float(row["x"]), float(row["y"]))
              for row in rows}
    return stated_crs(record["data"].get("crs", "")), places


class ChoosePoint(QgsMapToolEmitPoint):
    """Chooses the point nearest to a click.

    Parameters
    ----------
    canvas : QgsMapCanvas
    chosen : callable
        Called with the id of the point.
    """

    def __init__(self, canvas, chosen):
        super().__init__(canvas)
        self.chosen = chosen
        self.crs = None
        self.places = {}
        self.canvasClicked.connect(self.choose)

    def on_map(self):
        """Return the places of the points by id in the CRS of the map.

        If the result or the map has no CRS, they are not transformed.
        """
        crs = self.canvas().mapSettings().destinationCrs()
        if self.crs is None or not self.crs.isValid() or not crs.isValid():
            return dict(self.places)
        transformation = QgsCoordinateTransform(self.crs, crs, QgsProject.instance())
        return {name: transformation.transform(place) for name, place in self.places.items()}

    def choose(self, click, _button=None):
        """Choose the point nearest to a place on the map, if it is within `CLICK_PX`."""
        near = CLICK_PX * self.canvas().mapUnitsPerPixel()
        distances = {name: place.distance(click) for name, place in self.on_map().items()}
        name = min(distances, key=distances.get, default=None)
        if name is not None and distances[name] <= near:
            self.chosen(name)

    def go_to(self, name):
        """Show a point in the middle of the map, enlarged unless it is larger already.

        Nothing happens for an id without a place.
        """
        places = self.on_map()
        if name not in places:
            return
        canvas = self.canvas()
        canvas.setCenter(places[name])
        xs = [place.x() for place in places.values()]
        wide = (max(xs) - min(xs)) / CLOSER
        if wide and canvas.extent().width() > wide:
            canvas.zoomByFactor(wide / canvas.extent().width())
        canvas.refresh()
