"""QGIS plugin of termsel: what QGIS calls when it loads the plugin."""


def classFactory(iface):
    """Return the plugin."""
    from .plugin import TermselPlugin

    return TermselPlugin(iface)
