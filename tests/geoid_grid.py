"""A geoid of one height all over the Earth, under the name of a grid that PROJ knows."""

from __future__ import annotations

from pathlib import Path

import numpy as np

EGM96, EGM2008 = "us_nga_egm96_15.tif", "us_nga_egm08_25.tif"


def write_geoid(folder: Path, name: str, height: float) -> None:
    """Write a grid of undulations, in the form of PROJ's own grids."""
    import rasterio
    from rasterio.transform import from_origin

    step, rows, columns = 4.5, 41, 81
    with rasterio.open(folder / name, "w", driver="GTiff", width=columns, height=rows, count=1,
                       dtype="float32", crs="EPSG:4326",
                       transform=from_origin(-180 - step / 2, 90 + step / 2, step, step)) as grid:
        grid.write(np.full((1, rows, columns), height, dtype=np.float32))
        grid.update_tags(TYPE="VERTICAL_OFFSET_GEOGRAPHIC_TO_VERTICAL", AREA_OR_POINT="Point")
        grid.set_band_description(1, "geoid_undulation")
        grid.units = ("metre",)
