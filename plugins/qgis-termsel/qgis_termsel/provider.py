"""The Processing provider."""

from pathlib import Path

from qgis.core import QgsProcessingProvider
from qgis.PyQt.QtGui import QIcon

ICON = str(Path(__file__).with_name("icon.svg"))


class TermselProvider(QgsProcessingProvider):
    """All algorithms of this plugin."""

    def loadAlgorithms(self):
        """Add the algorithms to the provider; QGIS calls it."""
        from .algorithms import ALGORITHMS

        # Processing owns the instances, and asks for new ones when it reloads the provider.
        for algorithm in ALGORITHMS:
            self.addAlgorithm(algorithm())

    def id(self):
        """Return the id of the provider, what comes before the colon in scripts."""
        return "termsel"

    def name(self):
        """Return the name in the toolbox."""
        return "termsel"

    def icon(self):
        """Return the icon in the toolbox."""
        return QIcon(ICON)
