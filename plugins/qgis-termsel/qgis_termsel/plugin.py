"""The plugin: a Processing provider, and a dock that shows a result."""

from qgis.core import QgsApplication

from .provider import TermselProvider


class TermselPlugin:
    """Adds termsel's algorithms, a dock and a menu entry to QGIS, and removes them again.

    QGIS makes one when it loads the plugin. Without a window, as in qgis_process, it calls
    `initProcessing` alone, and there are only the algorithms.
    """

    def __init__(self, iface):
        self.iface = iface
        self.provider = None
        self.dock = None
        self.action = None

    def initProcessing(self):
        """Register the provider of the algorithms."""
        self.provider = TermselProvider()
        QgsApplication.processingRegistry().addProvider(self.provider)

    def initGui(self):
        """Register the algorithms, and add the dock and its action."""
        self.initProcessing()
        # Without a window, as in qgis_process, these modules may be missing.
        from qgis.PyQt.QtCore import Qt
        from qgis.PyQt.QtGui import QIcon

        from .dock import ResultDock
        from .provider import ICON

        self.dock = ResultDock(self.iface)
        self.iface.addDockWidget(Qt.DockWidgetArea.RightDockWidgetArea, self.dock)
        self.dock.hide()
        self.action = self.dock.toggleViewAction()
        self.action.setText("termsel result")
        self.action.setIcon(QIcon(ICON))
        self.iface.addPluginToRasterMenu("termsel", self.action)

    def unload(self):
        """Remove the dock, its action and the algorithms."""
        if self.provider is not None:
            QgsApplication.processingRegistry().removeProvider(self.provider)
        if self.dock is not None:
            self.iface.removePluginRasterMenu("termsel", self.action)
            self.iface.removeDockWidget(self.dock)
            self.dock.deleteLater()
