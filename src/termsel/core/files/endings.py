"""Endings of files by what other programs expect in them, in small letters.

A file is read by its content. Its ending counts where there is no content yet: what a name on the
command line is for, and what a program will look for in a file that is about to be written.
"""

from __future__ import annotations

RASTERS = frozenset((".tif", ".tiff", ".jp2", ".jpg", ".jpeg", ".png", ".img", ".ntf", ".vrt",
                     ".gif", ".bmp", ".bil"))
"""Images and maps of pixels."""

PAGES = frozenset((".html", ".htm", ".pdf", ".svg", ".docx", ".doc", ".odt", ".rtf"))
"""Reports, charts and letters, which hold no table of points that termsel reads."""

SPREADSHEETS = frozenset((".xlsx", ".xlsm", ".xlsb", ".xls", ".ods"))

SINGLE_VECTORS = frozenset((".gpkg", ".fgb", ".geojson", ".json", ".geojsonl", ".kml", ".kmz",
                            ".gml", ".gpx", ".xml", ".zip", ".shz"))
"""Points and lines of a GIS in one file; a shapefile or a geodatabase is several."""

TEXTS = frozenset((".csv", ".txt"))
"""Tables that any editor opens."""

OTHERS = frozenset((".dbf", ".docx", ".parquet", ".points", ".shp", ".toml", ".tsv"))
"""Endings that promise a content of their own, and are none of the kinds above."""

EXPECTED = RASTERS | PAGES | SPREADSHEETS | SINGLE_VECTORS | TEXTS | OTHERS
"""All endings by which a program decides how to open a file."""
