"""Where the images of a study are: their rows as a map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from termsel.errors import requires
from termsel.io.result_folder import read_result
from termsel.measurements.coordinates.crs import horizontal
from termsel.studies.cells.images import IMAGES, folders_of
from termsel.studies.cells.table import Row

if TYPE_CHECKING:
    import geopandas as gpd

LONGITUDE_LATITUDE = "EPSG:4326"


def map_of(rows: Sequence[Row], columns: Sequence[str], cells: Mapping[str, Mapping[str, Any]],
           folder: Path) -> gpd.GeoDataFrame:
    """Return rows of a study with the outline of each image's control.

    `cells` are the labels of all cells by key, `folder` that of the study. Images without a result
    are left out. Raises TermselError without geopandas, or where a result cannot be read.
    """
    with requires("maps of images require", "geopandas", "geopandas"):
        import geopandas as gpd
        import shapely
    folders = folders_of(cells)
    found: dict[str, tuple[str, Any]] = {}
    for key in (row["cell"] for row in rows if row["state"] == "done" and row["cell"] in folders):
        features = read_result(folder / IMAGES / folders[key]).features
        places = features.ground_vertices()[:, :2]
        found[key] = horizontal(features.crs), shapely.multipoints(places).convex_hull
    known = any(crs for crs, _ in found.values())
    outlines = {key: gpd.GeoSeries([outline], crs=crs).to_crs(LONGITUDE_LATITUDE)[0]
                if known else outline for key, (crs, outline) in found.items() if crs or not known}
    there = [row for row in rows if row["cell"] in outlines]
    return gpd.GeoDataFrame(
        {name: [row[name] for row in there] for name in columns},
        geometry=[outlines[row["cell"]] for row in there],
        crs=LONGITUDE_LATITUDE if known else None)
