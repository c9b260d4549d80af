"""Names of the columns of tables: what means what, and which names are free for others."""

from __future__ import annotations

USE = {"id": ("id", "name"), "role": ("role",), "enabled": ("enabled", "enable")}
"""Columns of text by their meaning, with the names they may have; all others hold numbers."""

COORDINATES = {
    "line": ("line", "row", "y_px"),
    "sample": ("sample", "col", "column", "x_px", "pixel"),
    "x": ("x", "lon", "longitude", "easting"),
    "y": ("y", "lat", "latitude", "northing"),
    "z": ("z", "h", "height", "elev", "elevation", "alt", "altitude"),
}
POINTS = USE | COORDINATES | {
    "sigma_line": ("sigma_line", "sigma_px"), "sigma_sample": ("sigma_sample", "sigma_px")}
LINES = USE | {"sigma": ("sigma", "sigma_px")} | {
    f"{meaning}{end}": tuple(f"{alias}{end}" for alias in aliases)
    for end in "12" for meaning, aliases in COORDINATES.items()}
OPTIONAL = frozenset({"role", "enabled", "sigma_line", "sigma_sample", "sigma"})
"""Meanings that a table may have no column for."""

COMPUTED = ("computed_line", "computed_sample", "residual_line", "residual_sample",
            "residual1", "residual2", "dx", "dy", "residual", "geometry")
"""Columns that termsel, QGIS and GeoPandas add to measurements."""

TAKEN = frozenset(COMPUTED).union(*POINTS.values(), *LINES.values()) - {"sigma"}
"""Names, in lower case, that columns of attributes cannot have; of lines nor sigma."""
