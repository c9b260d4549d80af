"""QGIS plugin of termsel: what QGIS calls when it loads the plugin."""


def classFactory(iface):
    """Return the plugin for QGIS's interface `iface`; QGIS calls it."""
    from .plugin import TermselPlugin

    return TermselPlugin(iface)
