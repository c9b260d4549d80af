# ruff: noqa: ARG005
"""The plugin's windows in Qt 6, with a stand-in for QGIS; prints what came of it as JSON.

    qt6.py FOLDER PICTURE.png     FOLDER has a result

No package has a QGIS of Qt 6 for Debian 12. What QGIS itself gives is replaced by classes that take
anything, so that this tells of the widgets, their enumerations and their signals alone.
"""

import importlib
import json
import sys
import types


class Any(type):
    """Of a class that has every attribute, and whose attributes have, too."""

    def __getattr__(cls, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return Any(name, (), {"__init__": lambda self, *_, **__: None,
                              "__getattr__": lambda self, name: lambda *_, **__: None})


class StandIn(types.ModuleType):
    """A module that has every class."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        setattr(self, name, getattr(Any("Root", (), {}), name))
        return getattr(self, name)


for name in ("qgis", "qgis.core", "qgis.gui", "processing"):
    sys.modules[name] = StandIn(name)
    sys.modules[name].__path__ = []
for name in ("PyQt", "PyQt.QtCore", "PyQt.QtGui", "PyQt.QtWidgets"):
    sys.modules[f"qgis.{name}"] = importlib.import_module(name.replace("PyQt", "PyQt6"))

from PyQt6.QtCore import QT_VERSION_STR  # noqa: E402
from PyQt6.QtWidgets import QApplication  # noqa: E402
from qgis_termsel import plugin  # noqa: E402
from qgis_termsel.algorithms import ALGORITHMS  # noqa: E402
from qgis_termsel.dock import CHECKED, ResultDock  # noqa: E402

application = QApplication([])
for algorithm in ALGORITHMS:
    algorithm().initAlgorithm()
    assert algorithm().icon().isNull() is False
assert plugin.TermselPlugin(None).dock is None
dock = ResultDock(None)
dock.show_result(sys.argv[1])
before = dock.left_out()
dock.table.item(0, 0).setCheckState(CHECKED)
dock.candidates.setCurrentIndex(1)
name, asked = dock.next_run()
dock.resize(460, 420)
told = {"qt": QT_VERSION_STR, "rows": dock.table.rowCount(), "accuracy": dock.accuracy.text(),
        "candidates": dock.candidates.count(), "before": before, "left out": dock.left_out(),
        "first": dock.table.item(0, 1).text(), "asked": [name, asked],
        "picture": dock.grab().save(sys.argv[2])}
print(json.dumps(told))
