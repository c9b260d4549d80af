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
from .layers import add_blunders, read_result_file, show_blunders_in_red
from .map_tool import ChoosePoint, read_ground_positions

CHECKED = Qt.CheckState.Checked
UNCHECKED = Qt.CheckState.Unchecked
_COLUMNS = ("Leave out", "Id", "Role", "Residual, line [px]", "Residual, sample [px]",
            "Residual [px]")
"""Headings of the table, in the words of the page of `termsel app`."""


class ResultDock(QDockWidget):
    """Residuals on the map and in a table, with boxes to leave points out and run again.

    Parameters
    ----------
    iface : QgisInterface or None
        The window of QGIS; without one nothing is shown on the map.
    """

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
        for name, act in (("Open", self.choose_folder), ("Go to", self.go_to),
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

    def choose_folder(self):
        """Ask for the folder of a result, and show it unless the user cancels."""
        folder = QFileDialog.getExistingDirectory(self, "Folder of the result")
        if folder:
            self.show_result(folder)

    def show_result(self, folder):
        """Show the result of a folder in the dock and on the map; say so if it has none.

        Files of the folder that are missing or cannot be read are told in the dock, and nothing is
        raised.
        """
        self.folder = Path(folder)
        try:
            record = json.loads(read_result_file(self.folder, "result.json"))
            table = read_result_file(self.folder, "residuals.csv")
            rows = list(csv.DictReader(io.StringIO(table)))
            accuracy = accuracy_text(record)
        # Anybody may have written the folder, with values of any type and nested to any depth.
        except (OSError, ValueError, KeyError, TypeError, AttributeError,
                RecursionError) as error:
            self.folder = None
            self.accuracy.setText(f"{folder} has no result: {error}")
            self._enable()
            return
        self.problem = record.get("problem")
        self.accuracy.setText(accuracy)
        self.check_these.setText(describe_blunders(record, rows))
        self._list_candidates(record)
        self._fill_table(rows)
        self._enable()
        if self.iface is not None:  # without a window of QGIS there is no map
            self._add_layers(record)

    def _add_layers(self, record):
        """Add the layers residuals, vectors and blunders of a result to the project.

        If they cannot be made, the dock says why.
        """
        # termsel makes them anew: QGIS would open a GeoPackage of the folder, which may be a
        # stranger's file of any format, with all its drivers.
        file = Path(scratch_folder() + ".gpkg")
        try:
            self.map_tool.crs, self.map_tool.positions = read_ground_positions(self.folder, record)
            run(["export", self.folder, "--to", "residuals-gpkg", "-o", file],
                QgsProcessingFeedback())
            add_blunders(self.folder, record, file)
        except (QgsProcessingException, OSError, ValueError, KeyError) as error:
            self.accuracy.setText(f"{self.accuracy.text()} The map shows no residuals: {error}")
            return
        for layer in ("residuals", "vectors", "blunders"):
            map_layer = QgsVectorLayer(f"{file}|layername={layer}", layer, "ogr")
            if layer == "blunders":
                show_blunders_in_red(map_layer)
            QgsProject.instance().addMapLayer(map_layer)

    def _list_candidates(self, record):
        """List the models that auto compared, with their predicted RMSEs; auto itself comes first.

        Those that only auto can fit are shown, and cannot be chosen.
        """
        # Only a run by auto has a strategy in its result.json.
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

    def _fill_table(self, rows):
        """Fill the table with the rows of residuals.csv, the largest residual first.

        The boxes of points that this run left out are checked, as a checked box leaves a point out
        of the next run.
        """
        # A table that sorts itself would move a row while its cells are being filled.
        self.table.setSortingEnabled(False)
        self.table.setRowCount(len(rows))
        rows.sort(key=lambda row: -float(row["distance"] or 0))
        for at, row in enumerate(rows):
            box = QTableWidgetItem()
            box.setFlags(Qt.ItemFlag.ItemIsUserCheckable | Qt.ItemFlag.ItemIsEnabled)
            # Check points are not used in the fit either, but are needed as checks.
            is_left_out = row["role"] == "off" or (row["used"] == "no" and row["blunder"])
            box.setCheckState(CHECKED if is_left_out else UNCHECKED)
            self.table.setItem(at, 0, box)
            for column, text in enumerate((row["id"], role_text(row), row["residual_line"],
                                           row["residual_sample"], row["distance"]), 1):
                item = QTableWidgetItem()
                # Residuals become numbers, by which the table sorts: as text 10 is before 9.
                try:
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
        """Select a row of the feature that has an id, and scroll to it."""
        for row in range(self.table.rowCount()):
            if self.table.item(row, 1).text() == name:
                self.table.selectRow(row)
                self.table.scrollToItem(self.table.item(row, 1))

    def selected_id(self):
        """Return the id in the selected row; "" if there is none."""
        row = self.table.currentRow()
        return "" if row < 0 else self.table.item(row, 1).text()

    def go_to(self):
        """Move the map so that the point of the selected row is in its middle."""
        if self.map_tool is not None:
            self.map_tool.go_to(self.selected_id())

    def choose_on_map(self):
        """Let clicks on the map select the row of the nearest point."""
        if self.map_tool is not None:
            self.iface.mapCanvas().setMapTool(self.map_tool)

    def rerun(self):
        """Open the dialog of the algorithm for another run, and show the result of that run."""
        from processing import execAlgorithmDialog

        # The dialog is filled in, and the user may change all of it before running.
        outputs = execAlgorithmDialog(*self.next_run())
        # There are none if the user closes the dialog without running.
        if outputs:
            self.show_result(outputs["OUTPUT"])

    def next_run(self):
        """Return the algorithm by which the result can be computed again, and its parameters.

        Points and lines whose boxes are checked are left out, and the model is the one chosen in
        the list of candidates.

        Returns
        -------
        algorithm : str
            Its id, such as "termsel:georeference".
        parameters : dict of str to str
            Those that fill in its dialog, by name.
        """
        # A result has points, lines or both.
        files = {"FILE": self.folder / "points.csv", "LINES": self.folder / "lines.csv"}
        parameters = {name: str(file) for name, file in files.items() if file.exists()}
        parameters.update(inputs_of(self.folder))
        parameters["OFF"] = ",".join(self.left_out())
        # Lines are selected by a problem of their own.
        if self.problem == "owdis-lines":
            return "termsel:selectlines", parameters
        return "termsel:georeference", {**parameters, "MODEL": self.candidates.currentData() or ""}

    def export(self):
        """Open the dialog of the algorithm Export model for the result, with an RPC as format."""
        from processing import execAlgorithmDialog

        # The first of the formats is rpc-txt.
        execAlgorithmDialog("termsel:export", {"RESULT": str(self.folder), "FORMAT": 0})

    def _enable(self):
        """Enable the buttons that need a result if one is shown, and disable them otherwise."""
        for name in ("Go to", "Choose on the map", "Run again", "Export RPC"):
            self.buttons[name].setEnabled(self.folder is not None)


def role_text(row):
    """Return the role of a feature in words, from its row of residuals.csv.

    A feature that the program left out of the fit is "left out as a blunder"; of others the words
    are those of `termsel app`, after "line, " for a line.
    """
    if row["role"] != "off" and row["used"] == "no" and row["blunder"]:
        return "left out as a blunder"
    # Files say "check" for points that select a model, which readers would take for a test of it.
    role = {"check": "selection", "independent": "independent check"}.get(row["role"], row["role"])
    return f"line, {role}" if row["kind"] == "line" else role


def describe_blunders(record, rows):
    """Return a text that asks to check the blunders, with a sentence on each; "" without any.

    `record` is the content of result.json, and `rows` are those of residuals.csv.
    """
    distances = {row["id"]: float(row["distance"] or 0) for row in rows}
    unused = {row["id"] for row in rows if row["used"] == "no"}
    sentences = []
    for outlier in record.get("outliers", []):
        name = outlier["id"]
        distance = distances.get(name, outlier["error"])
        sentences.append(f"{name} is off by {distance:.3g} px ({outlier['certainty']}).")
        if name in unused:
            sentences.append("The model does without it.")
    return "Check these: " + " ".join(sentences) if sentences else ""


def accuracy_text(record):
    """Return sentences on the accuracy that the content of a result.json states.

    They are on the RMSE at independent check points and the predicted RMSE with its interval, as
    far as there are any [px]; without both, the sentence says that the accuracy is not known.
    """
    # A result without independent points has null in place of their figures.
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
