"""The style in which QGIS shows residuals by itself: a table of the GeoPackage, with QML.

The table is the one that QGIS makes when a user saves a style as default (`saveStyle` of its OGR
provider); QGIS since 2.18 applies the row of a layer with `useAsDefault` when it opens the layer.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from termsel.toolkit.charts import GROUND, ROLE_COLOURS, ROLE_SHAPES

TABLE = "layer_styles"
LAYER_OPTIONS = {"FID": "id"}
"""Options of GDAL for the layer: the name of its key."""

_ROLE = """CASE WHEN "role" IN ('control', 'off') AND NOT "used" THEN 'left out' ELSE "role" END"""

_COLOURS = {role: colour for role, colour in ROLE_COLOURS.items() if role != "rejected"}
"""Colours by role: in the layer, outliers are among those left out."""

_LABELS = {"check": "selection", "independent": "independent check", "left out": "not used"}
"""What the legend calls roles, where that differs."""

_SHAPES = {"circle": "circle", "square": "square", "triangle-up": "triangle",
           "cross": "cross_fill"}
"""Names of QGIS for those of the charts."""


def layer_style_rows() -> dict[str, Any]:
    """Return the columns of the table layer_styles of a GeoPackage, by name.

    Each is an array (2,): the rows are the styles of the layers residuals and vectors.
    """
    layers = {"residuals": _marker_style(), "vectors": _arrow_style()}

    def text(*values: str) -> Any:
        """Return a column of texts; a single one is that of all rows."""
        return np.array(values * (len(layers) if len(values) == 1 else 1), dtype=object)

    return {
        "f_table_catalog": text(""), "f_table_schema": text(""), "f_table_name": text(*layers),
        "f_geometry_column": text("geom"), "styleName": text(*layers),
        "styleQML": text(*layers.values()), "styleSLD": text(""),
        "useAsDefault": np.ones(len(layers), dtype=bool), "description": text("residuals by role"),
        "owner": text(""), "ui": text(""),
        "update_time": np.full(len(layers), np.datetime64("now", "ms"))}


def _marker_style() -> str:
    """Return the style of residuals in QML, with a marker for each role."""
    return _style_by_role("marker", 0, {
        role: _symbol_layer_qml("SimpleMarker", name=_SHAPES[ROLE_SHAPES[role]],
                                color=_qgis_colour(colour),
                                outline_color=_qgis_colour(GROUND), outline_width="0.2",
                                outline_width_unit="MM",
                                size="2.2", size_unit="MM") for role, colour in _COLOURS.items()})


def _arrow_style() -> str:
    """Return the style of residual vectors as QML, with a straight arrow for each role.

    Sizes are in mm on the screen or on paper, whatever the scale of the map.
    """
    arrows = {}
    # An arrow is a polygon, whose fill is a symbol of its own: @i@0 is that of the i-th role.
    for i, (role, colour) in enumerate(_COLOURS.items()):
        fill = _symbol_layer_qml(
            "SimpleFill", color=_qgis_colour(colour), style="solid", outline_style="no")
        arrows[role] = _symbol_layer_qml(
            "ArrowLine", _symbol_qml("fill", f"@{i}@0", fill), arrow_type="0", head_type="0",
            is_curved="0", is_repeated="1", arrow_width="0.4", arrow_width_unit="MM",
            arrow_start_width="0.4", arrow_start_width_unit="MM", head_length="2",
            head_length_unit="MM", head_thickness="0.8", head_thickness_unit="MM")
    return _style_by_role("line", 1, arrows)


def _style_by_role(kind: str, geometry: int, layers: dict[str, str]) -> str:
    """Return a style in QML with a symbol for each role.

    `kind` is "marker" or "line", and `geometry` QGIS's number of that type of geometry, 0 or 1.
    `layers` has the QML of the symbol layer by role.
    """
    categories = "".join(
        f'<category value="{role}" label="{_LABELS.get(role, role)}" symbol="{i}" render="true"/>'
        for i, role in enumerate(layers))
    symbols = "".join(_symbol_qml(kind, str(i), layer) for i, layer in enumerate(layers.values()))
    attribute = _ROLE.replace('"', "&quot;")
    return (f'<!DOCTYPE qgis PUBLIC "http://mrcc.com/qgis.dtd" "SYSTEM">\n'
            f'<qgis version="3.22.0" styleCategories="Symbology">'
            f'<renderer-v2 type="categorizedSymbol" attr="{attribute}" symbollevels="0" '
            f'enableorderby="0" forceraster="0"><categories>{categories}</categories>'
            f"<symbols>{symbols}</symbols></renderer-v2>"
            f"<layerGeometryType>{geometry}</layerGeometryType></qgis>\n")


def _symbol_qml(kind: str, name: str, layer: str) -> str:
    """Return a symbol in QML, with one symbol layer."""
    return f'<symbol type="{kind}" name="{name}" alpha="1" clip_to_extent="1">{layer}</symbol>'


def _symbol_layer_qml(kind: str, inner: str = "", **properties: str) -> str:
    """Return a symbol layer of a class in QML, with its properties."""
    # <prop> rather than <Option>, which earlier versions of QGIS do not read.
    entries = "".join(f'<prop k="{name}" v="{value}"/>' for name, value in properties.items())
    return f'<layer class="{kind}" enabled="1" locked="0" pass="0">{entries}{inner}</layer>'


def _qgis_colour(colour: str) -> str:
    """Return a colour such as #0072b2 as QGIS writes it: 0,114,178,255."""
    return ",".join(str(component) for component in bytes.fromhex(colour[1:])) + ",255"
