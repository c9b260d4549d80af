"""A simulated world as the files that a user has."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from termsel import write_points_csv, write_rpc
from termsel.simulate import write_geometry
from termsel.toolkit.files import new_folder
from termsel_match.simulated.world import SPACING, WORLD_CRS, World

log = logging.getLogger("termsel.match")

IMAGE, RPC, ORTHO, DEM, ROADS, CAMERA, INDEPENDENT = NAMES = (
    "image.tif", "image.RPB", "ortho.tif", "dem.tif", "roads.gpkg", "camera.json",
    "independent.csv")


def write_world(world: World, folder: Path | str) -> None:
    """Write a world to a new folder, completely or not at all.

    Parameters
    ----------
    world : World
    folder : path-like
        Gets image.tif (16 bits) with the vendor's RPC in image.RPB; ortho.tif, dem.tif and
        roads.gpkg of the place; camera.json with the exact scanner; and independent.csv with 200
        places that nobody may use but to judge by.

    Raises
    ------
    TermselError
        If the folder exists or cannot be written.
    """
    with new_folder(Path(folder)) as new_files:
        _write(world, new_files)


def _write(world: World, folder: Path) -> None:
    """Write the files of a simulated place, as `write_world` lists them, to a new folder."""
    from rasterio.transform import from_origin

    west, north = world.corner
    _write_raster(folder / IMAGE, world.image())
    write_rpc(world.rpc, folder / RPC)
    _write_raster(folder / ORTHO, world.ortho(), crs=WORLD_CRS,
                  transform=from_origin(west, north, world.gsd, world.gsd))
    # The first height is that of the corner itself, so its pixel begins half a step before it.
    _write_raster(folder / DEM, world.dem().astype(np.float32), crs=WORLD_CRS,
                  transform=from_origin(
        west - SPACING / 2, north + SPACING / 2, SPACING, SPACING))
    _write_roads(folder / ROADS, world.vectors())
    write_geometry(world.camera, folder / CAMERA)
    write_points_csv(world.independent(), folder / INDEPENDENT, WORLD_CRS)


def _write_raster(path: Path, pixels: np.ndarray[Any, Any], **profile: Any) -> None:
    """Write pixels (lines, samples) as a tiled GeoTIFF of one band.

    `profile` are further arguments of `rasterio.open`, such as `crs` and `transform`.
    """
    from warnings import catch_warnings, simplefilter

    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    with catch_warnings():
        simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", driver="GTiff", height=pixels.shape[0],
                           width=pixels.shape[1], count=1, dtype=pixels.dtype.name, tiled=True,
                           blockxsize=256, blockysize=256, compress="deflate", **profile) as file:
            file.write(pixels, 1)


def _write_roads(path: Path, roads: list[np.ndarray[Any, Any]]) -> None:
    """Write roads, vertices (n, 2) each, as a layer of named lines."""
    from pyogrio.raw import write

    names = np.array([f"road {i + 1}" for i in range(len(roads))], dtype=object)
    write(path, shapely.to_wkb(np.array([shapely.LineString(road) for road in roads])), [names],
          fields=["name"], geometry_type="LineString", crs=WORLD_CRS, layer="roads")
