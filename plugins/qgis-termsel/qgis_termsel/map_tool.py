"""The map tool: a click chooses the point of the control that is nearest, as on termsel's page."""

import csv
import io

from qgis.core import (
    QgsCoordinateTransform,
    QgsPointXY,
    QgsProject,
)
from qgis.gui import QgsMapToolEmitPoint

from .layers import read_result_file, stated_crs, unguard_formula

CLICK_PX = 15
"""Pixels of the screen within which a click finds a point."""
_ENLARGEMENT = 4
"""By how much "Go to" enlarges a map that shows all points."""


def read_ground_positions(folder, record):
    """Return the CRS of a result, and the x and y of its points in that CRS.

    `folder` is that of the result, and `record` the content of its result.json.

    Returns
    -------
    crs : QgsCoordinateReferenceSystem
        Invalid if the result states none, or one that `stated_crs` does not take.
    positions : dict of str to QgsPointXY
        The position of each point by its id.

    Raises
    ------
    OSError, ValueError, KeyError
        If the folder has no table of points, or one with other columns or no numbers.
    """
    text = read_result_file(folder, "points.csv")
    rows = csv.DictReader(line for line in io.StringIO(text) if not line.startswith("#"))
    positions = {unguard_formula(row["id"]): QgsPointXY(float(row["x"]), float(row["y"]))
                 for row in rows}
    return stated_crs(record["data"].get("crs", "")), positions


class ChoosePoint(QgsMapToolEmitPoint):
    """Chooses the point of a result that is nearest to a click on the map.

    Parameters
    ----------
    canvas : QgsMapCanvas
    on_choice : callable
        Called with the id of the point.

    Attributes
    ----------
    crs, positions
        What `read_ground_positions` returned for the result that is shown; None and {} before.
    """

    def __init__(self, canvas, on_choice):
        super().__init__(canvas)
        self.on_choice = on_choice
        self.crs = None
        self.positions = {}
        self.canvasClicked.connect(self.choose)

    def positions_on_map(self):
        """Return the positions of the points in the CRS of the map, by id.

        If the result or the map has no CRS, they are returned as the result states them.
        """
        crs = self.canvas().mapSettings().destinationCrs()
        if self.crs is None or not self.crs.isValid() or not crs.isValid():
            return dict(self.positions)
        transformation = QgsCoordinateTransform(self.crs, crs, QgsProject.instance())
        return {name: transformation.transform(position)
                for name, position in self.positions.items()}

    def choose(self, click, _button=None):
        """Choose the point nearest to a click, if it is within `CLICK_PX` on the screen."""
        # Positions are in units of the map, whose size on the screen depends on the zoom.
        tolerance = CLICK_PX * self.canvas().mapUnitsPerPixel()
        distances = {name: position.distance(click)
                     for name, position in self.positions_on_map().items()}
        name = min(distances, key=distances.get, default=None)
        if name is not None and distances[name] <= tolerance:
            self.on_choice(name)

    def go_to(self, name):
        """Move the map so that a point is in its middle, and enlarge it if it shows a wide area.

        Afterwards the map is at most a quarter as wide as the points are. Nothing happens for an
        id without a position.
        """
        positions = self.positions_on_map()
        if name not in positions:
            return
        canvas = self.canvas()
        canvas.setCenter(positions[name])
        xs = [position.x() for position in positions.values()]
        width = (max(xs) - min(xs)) / _ENLARGEMENT
        # A single point has no width to go by.
        if width and canvas.extent().width() > width:
            canvas.zoomByFactor(width / canvas.extent().width())
        canvas.refresh()
