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

from .algorithms.base import scratch
from .algorithms.georeference import inputs_of, model_named
from .child import run
from .layers import add_blunders, blunder_style, read_inside

CHECKED = Qt.CheckState.Checked
UNCHECKED = Qt.CheckState.Unchecked
_COLUMNS = ("leave out", "id", "role", "line [px]", "sample [px]", "distance [px]")


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
        self.candidates.setToolTip("Candidates of auto, and the RMSE that is predicted for each. "
                                   "Run again takes the one shown.")
        self.table = QTableWidget(0, len(_COLUMNS))
        self.table.setHorizontalHeaderLabels(_COLUMNS)
        self.table.setSortingEnabled(True)
        buttons = QHBoxLayout()
        self.buttons = {}
        for name, act in (("Open", self.choose), ("Run again", self.rerun),
                          ("Export RPC", self.export)):
            button = QPushButton(name)
            button.clicked.connect(act)
            buttons.addWidget(button)
            self.buttons[name] = button
        inside = QWidget()
        rows = QVBoxLayout()
        rows.addWidget(self.accuracy)
        rows.addWidget(self.candidates)
        rows.addWidget(self.table)
        rows.addLayout(buttons)
        inside.setLayout(rows)
        self.setWidget(inside)
        self._enable()

    def choose(self):
        """Ask for a folder and show it."""
        folder = QFileDialog.getExistingDirectory(self, "Folder of the result")
        if folder:
            self.show_result(folder)

    def show_result(self, folder):
        """Show the result of a folder."""
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
        self._offer(record)
        self._fill(rows)
        self._enable()
        if self.iface is not None:  # without a window of QGIS there is no map
            self._add_layers(record)

    def _add_layers(self, record):
        """Add the layers that Georeference adds, made anew by termsel from the result.

        QGIS would open a file of the folder, which may be a stranger's, with all its drivers.
        """
        file = Path(scratch() + ".gpkg")
        try:
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
        """Offer the candidates; those that only auto can fit are shown and cannot be taken."""
        strategy = record.get("strategy")
        strategy = strategy if isinstance(strategy, dict) else {}
        self.candidates.clear()
        chosen_name = strategy.get("chosen")
        self.candidates.addItem(f"chosen by auto: {chosen_name}" if chosen_name
                                else "the choice of auto", "")
        for candidate in strategy.get("candidates", []):
            predicted = candidate.get("predicted")
            text = "" if predicted is None else f", predicted {predicted:.3g} px"
            model = model_named(candidate["name"], candidate["model"])
            self.candidates.addItem(candidate["name"] + text, model)
            if not model:
                self.candidates.model().item(self.candidates.count() - 1).setEnabled(False)

    def _fill(self, rows):
        """Fill the table, the largest residuals first."""
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
            for column, text in enumerate((row["id"], row["role"], row["residual_line"],
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

    def rerun(self):
        """Open the dialog of the algorithm with the same points, and what is to be left out."""
        from processing import execAlgorithmDialog

        # The dialog is filled in, and the user may change all of it before running.
        outputs = execAlgorithmDialog(*self.again())
        if outputs:
            self.show_result(outputs["OUTPUT"])

    def again(self):
        """Return the algorithm and the parameters of another run."""
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
        for name in ("Run again", "Export RPC"):
            self.buttons[name].setEnabled(self.folder is not None)


def accuracy_text(record):
    """Return the accuracy of a result in two sentences."""
    independent = (record.get("rmse") or {}).get("independent") or {}
    predicted = record.get("predicted") or {}
    sentences = []
    if independent:
        sentences.append(f"Accuracy: RMSE {independent['total']:.3g} px on {independent['n']} "
                         "independent check points.")
    if predicted:
        sentences.append(f"Predicted: {predicted['rmse']:.3g} px, {predicted['low']:.3g} to "
                         f"{predicted['high']:.3g} px with a probability of "
                         f"{100 * predicted['level']:.0f}\u00a0%.")
    return " ".join(sentences) or "No point took no part, so that the accuracy is not known."
