"""Where the images of a study are: their rows as a map."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from termsel import Study, TermselError, read_result
from termsel.toolkit import require_import
from termsel.toolkit.coordinates import horizontal_crs
from termsel.toolkit.studies import IMAGES, folders_of

if TYPE_CHECKING:
    import geopandas as gpd

LONGITUDE_LATITUDE = "EPSG:4326"


def map_of(study: Study) -> gpd.GeoDataFrame:
    """Return the rows of a study that are images, with the outline of each image's control.

    Images without a result are left out. If some images have a CRS, so are those without one, as
    they have no place on the map.

    Parameters
    ----------
    study : Study
        Run with a folder.

    Returns
    -------
    geopandas.GeoDataFrame
        The columns of `Study.rows`, and as geometry the convex hull of the control: in longitude
        and latitude if any image has a CRS, else in the coordinates of the images, without a CRS.

    Raises
    ------
    TermselError
        Without geopandas, without the folder of the study, or if a result cannot be read.

    Examples
    --------
    >>> import termsel
    >>> from termsel_studies import map_of
    >>> from termsel.testing import invoke
    >>> written = invoke("example", "files")
    >>> study = termsel.compare(data=[{"points": "files/images/image-1.csv"}], out="study")
    >>> len(map_of(study))
    1
    """
    if study.folder is None:
        raise TermselError("this study was run without a folder, so its images are not kept",
                           hint="Pass out= to termsel.compare.")
    with require_import("maps of images require", "geopandas", "geopandas"):
        import geopandas as gpd
        import shapely
    folders = folders_of(study.cells)
    rows = study.rows
    hulls: dict[str, tuple[str, Any]] = {}
    # Only finished cells have a folder with a result.
    for key in (row["cell"] for row in rows if row["state"] == "done" and row["cell"] in folders):
        features = read_result(study.folder / IMAGES / folders[key]).features
        positions = features.ground_vertices()[:, :2]
        hulls[key] = horizontal_crs(features.crs), shapely.multipoints(positions).convex_hull
    # Images in several CRSs get one in which all have coordinates.
    has_crs = any(crs for crs, _ in hulls.values())
    outlines = {}
    for key, (crs, outline) in hulls.items():
        if not has_crs:
            outlines[key] = outline
        elif crs:
            outlines[key] = gpd.GeoSeries([outline], crs=crs).to_crs(LONGITUDE_LATITUDE)[0]
    rows_with_outline = [row for row in rows if row["cell"] in outlines]
    columns: dict[str, list[Any]] = {}
    for name in study.columns:
        columns[name] = [row[name] for row in rows_with_outline]
    return gpd.GeoDataFrame(
        columns, geometry=[outlines[row["cell"]] for row in rows_with_outline],
        crs=LONGITUDE_LATITUDE if has_crs else None)
