"""A dock that shows a result: its accuracy, its points, and what they say without some of them."""

import csv
import io
import json
from pathlib import Path

from qgis.core import (
    QgsProcessingException,
    QgsProcessingFeedback,
    QgsProject,
    QgsVectorLayer,
)
from qgis.PyQt.QtCore import Qt
from qgis.PyQt.QtWidgets import (
    QComboBox,
    QDockWidget,
    QFileDialog,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from .algorithms.base import scratch_folder
from .algorithms.georeference import inputs_of, model_named
from .child import run
from .layers import add_blunders, blunder_style, read_inside
from .map_tool import ChoosePoint, places_of

CHECKED = Qt.CheckState.Checked
UNCHECKED = Qt.CheckState.Unchecked
_COLUMNS = ("Leave out", "Id", "Role", "Residual, line [px]", "Residual, sample [px]",
            "Residual [px]")
"""In the words of the page of `termsel app`."""


class ResultDock(QDockWidget):
    """Residuals on the map and in a table, with boxes to leave points out and run again."""

    def __init__(self, iface):
        super().__init__("termsel result")
        self.iface = iface
        self.folder = self.problem = None
        self.setObjectName("termselResult")
        self.accuracy = QLabel("Open the folder of a result.")
        self.accuracy.setWordWrap(True)
        self.candidates = QComboBox()
        self.candidates.setToolTip("Models that were compared, with the predicted RMSE of each. "
                                   "Run again takes the one shown.")
        self.table = QTableWidget(0, len(_COLUMNS))
        self.table.setHorizontalHeaderLabels(_COLUMNS)
        self.table.setSortingEnabled(True)
        buttons = QHBoxLayout()
        self.buttons = {}
        for name, act in (("Open", self.choose), ("Go to", self.go_to),
                          ("Choose on the map", self.choose_on_map), ("Run again", self.rerun),
                          ("Export RPC", self.export)):
            button = QPushButton(name)
            button.clicked.connect(act)
            buttons.addWidget(button)
            self.buttons[name] = button
        self.check_these = QLabel()
        self.check_these.setWordWrap(True)
        self.check_these.setTextFormat(Qt.TextFormat.PlainText)
        self.map_tool = None if iface is None else ChoosePoint(iface.mapCanvas(), self.select)
        inside = QWidget()
        rows = QVBoxLayout()
        rows.addWidget(self.accuracy)
        rows.addWidget(self.check_these)
        rows.addWidget(self.candidates)
        rows.addWidget(self.table)
        rows.addLayout(buttons)
        inside.setLayout(rows)
        self.setWidget(inside)
        self._enable()

    def choose(self):
        """Ask for the folder of a result and show it; nothing if the user cancels."""
        folder = QFileDialog.getExistingDirectory(self, "Folder of the result")
        if folder:
            self.show_result(folder)

    def show_result(self, folder):
        """Show the result of a folder in the dock and on the map; say so if it has none.

        The folder may have been written by anybody: whatever is wrong with its files is told in the
        dock, and raises nothing.
        """
        self.folder = Path(folder)
        try:
            record = json.loads(read_inside(self.folder, "result.json"))
            rows = list(csv.DictReader(io.StringIO(read_inside(self.folder, "residuals.csv"))))
            accuracy = accuracy_text(record)
        except (OSError, ValueError, KeyError, TypeError, AttributeError,
                RecursionError) as error:  # of a folder that anybody may have written
            self.folder = None
            self.accuracy.setText(f"{folder} has no result: {error}")
            self._enable()
            return
        self.problem = record.get("problem")
        self.accuracy.setText(accuracy)
        self.check_these.setText(check_these(record, rows))
        self._offer(record)
        self._fill(rows)
        self._enable()
        if self.iface is not None:  # without a window of QGIS there is no map
            self._add_layers(record)

    def _add_layers(self, record):
        """Add the layers that Georeference adds, made anew by termsel from the result.

        QGIS would open a file of the folder, which may be a stranger's, with all its drivers.
        """
        file = Path(scratch_folder() + ".gpkg")
        try:
            self.map_tool.crs, self.map_tool.places = places_of(self.folder, record)
            run(["export", self.folder, "--to", "residuals-gpkg", "-o", file],
                QgsProcessingFeedback())
            add_blunders(self.folder, record, file)
        except (QgsProcessingException, OSError, ValueError, KeyError) as error:
            self.accuracy.setText(f"{self.accuracy.text()} The map shows no residuals: {error}")
            return
        for layer in ("residuals", "vectors", "blunders"):
            map_layer = QgsVectorLayer(f"{file}|layername={layer}", layer, "ogr")
            if layer == "blunders":
                blunder_style(map_layer)
            QgsProject.instance().addMapLayer(map_layer)

    def _offer(self, record):
        """List the candidates of auto; those that only auto can fit cannot be chosen."""
        strategy = record.get("strategy")
        strategy = strategy if isinstance(strategy, dict) else {}
        self.candidates.clear()
        chosen_name = strategy.get("chosen")
        self.candidates.addItem(f"automatic choice: {chosen_name}" if chosen_name
                                else "automatic choice", "")
        for candidate in strategy.get("candidates", []):
            predicted = candidate.get("predicted")
            text = "" if predicted is None else f", predicted {predicted:.3g} px"
            model = model_named(candidate["name"], candidate["model"])
            self.candidates.addItem(candidate["name"] + text, model)
            if not model:
                self.candidates.model().item(self.candidates.count() - 1).setEnabled(False)

    def _fill(self, rows):
        """Fill the table with rows of residuals, the largest first, and check those left out.

        A checked box leaves a point out of the next run. Rows are sorted by their numbers, as text
        would put 10 before 9.
        """
        # While rows are filled they must not change their places.
        self.table.setSortingEnabled(False)
        self.table.setRowCount(len(rows))
        rows.sort(key=lambda row: -float(row["distance"] or 0))
        for at, row in enumerate(rows):
            box = QTableWidgetItem()
            box.setFlags(Qt.ItemFlag.ItemIsUserCheckable | Qt.ItemFlag.ItemIsEnabled)
            # Check points are not used either where they judge: they are not left out.
            is_left_out = row["role"] == "off" or (row["used"] == "no" and row["blunder"])
            box.setCheckState(CHECKED if is_left_out else UNCHECKED)
            self.table.setItem(at, 0, box)
            for column, text in enumerate((row["id"], role_text(row), row["residual_line"],
                                           row["residual_sample"], row["distance"]), 1):
                item = QTableWidgetItem()
                try:
                    # Numbers are sorted as numbers, which texts would not be.
                    item.setData(0, round(float(text), 3) if column > 2 else text)
                except ValueError:
                    item.setData(0, text)
                self.table.setItem(at, column, item)
        self.table.resizeColumnsToContents()
        self.table.horizontalHeader().setSortIndicator(5, Qt.SortOrder.DescendingOrder)
        self.table.setSortingEnabled(True)

    def left_out(self):
        """Return the ids whose boxes are checked; a line has a row for each of its vertices."""
        return list(dict.fromkeys(
            self.table.item(row, 1).text() for row in range(self.table.rowCount())
            if self.table.item(row, 0).checkState() == CHECKED))

    def select(self, name):
        """Choose the rows of a feature, by its id, and scroll to them."""
        for row in range(self.table.rowCount()):
            if self.table.item(row, 1).text() == name:
                self.table.selectRow(row)
                self.table.scrollToItem(self.table.item(row, 1))

    def chosen(self):
        """Return the id in the current row; "" if there is none."""
        row = self.table.currentRow()
        return "" if row < 0 else self.table.item(row, 1).text()

    def go_to(self):
        """Move the map so that the chosen point is in its middle."""
        if self.map_tool is not None:
            self.map_tool.go_to(self.chosen())

    def choose_on_map(self):
        """Let a click on the map choose a row."""
        if self.map_tool is not None:
            self.iface.mapCanvas().setMapTool(self.map_tool)

    def rerun(self):
        """Open the dialog of the algorithm, filled in by `again`, and show what it gives."""
        from processing import execAlgorithmDialog

        # The dialog is filled in, and the user may change all of it before running.
        outputs = execAlgorithmDialog(*self.again())
        if outputs:
            self.show_result(outputs["OUTPUT"])

    def again(self):
        """Return the id of the algorithm that made the result, and its parameters for another run.

        Features whose boxes are checked are left out.
        """
        files = {"FILE": self.folder / "points.csv", "LINES": self.folder / "lines.csv"}
        # Files that a result has: points, lines or both.
        parameters = {name: str(file) for name, file in files.items() if file.exists()}
        parameters.update(inputs_of(self.folder))
        parameters["OFF"] = ",".join(self.left_out())
        # Lines are selected by a problem of their own.
        if self.problem == "owdis-lines":
            return "termsel:selectlines", parameters
        return "termsel:georeference", {**parameters, "MODEL": self.candidates.currentData() or ""}

    def export(self):
        """Open the dialog of the export."""
        from processing import execAlgorithmDialog

        execAlgorithmDialog("termsel:export", {"RESULT": str(self.folder), "FORMAT": 0})

    def _enable(self):
        """Enable the buttons that need a result."""
        for name in ("Go to", "Choose on the map", "Run again", "Export RPC"):
            self.buttons[name].setEnabled(self.folder is not None)


def role_text(row):
    """Return the role of a row of residuals in the words of `termsel app`; "left out as a blunder".
    """
    if row["role"] != "off" and row["used"] == "no" and row["blunder"]:
        return "left out as a blunder"
    # The words of all screens for the roles of files.
    role = {"check": "selection", "independent": "independent check"}.get(row["role"], row["role"])
    return f"line, {role}" if row["kind"] == "line" else role


def check_these(record, rows):
    """Return a sentence on each blunder, after "Check these:"; "" if there are none."""
    sizes = {row["id"]: float(row["distance"] or 0) for row in rows}
    unused = {row["id"] for row in rows if row["used"] == "no"}
    sentences = [f"{outlier['id']} is off by "
                 f"{sizes.get(outlier['id'], outlier['error']):.3g} px ({outlier['certainty']})."
                 + (" The model does without it." if outlier["id"] in unused else "")
                 for outlier in record.get("outliers", [])]
    return "Check these: " + " ".join(sentences) if sentences else ""


def accuracy_text(record):
    """Return the RMSE at independent check points and the predicted one, with its interval.

    In words; if there is neither, that the accuracy is not known.
    """
    independent = (record.get("rmse") or {}).get("independent") or {}
    predicted = record.get("predicted") or {}
    sentences = []
    if independent:
        sentences.append(f"Accuracy: RMSE {independent['total']:.3g} px at {independent['n']} "
                         "independent check points.")
    if predicted:
        sentences.append(f"Predicted: {predicted['rmse']:.3g} px, {predicted['low']:.3g} to "
                         f"{predicted['high']:.3g} px ({100 * predicted['level']:.0f}\u00a0% "
                         "interval).")
    unknown = "The accuracy is not known: there are no independent check points."
    return " ".join(sentences) or unknown
