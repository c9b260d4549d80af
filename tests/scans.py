"""Scans of every kind, an affine model of them, and gdalwarp through the same geometry."""

from __future__ import annotations

import shutil
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import rasterio.shutil
from rasterio.enums import ColorInterp
from rasterio.rpc import RPC

import termsel
from termsel.formats.rpc_files import rpc_items
from termsel.models.polynomial import Polynomial3D

SIZE = 90, 120
HEIGHT = 110.0


@cache
def result() -> termsel.Result:
    """Return an affine model of an image that is turned by some 20 degrees."""
    rng = np.random.default_rng(3)
    image = rng.uniform(0.0, np.array(SIZE) - 1.0, (12, 2))
    heights = np.full(12, HEIGHT) + rng.uniform(-10.0, 10.0, 12)
    x = 690_000 + 1.9 * image[:, 1] + 0.7 * image[:, 0]
    y = 5_300_000 + 0.6 * image[:, 1] - 2.1 * image[:, 0]
    points = termsel.Points(tuple(map(str, range(12))), image, np.column_stack([x, y, heights]))
    features = termsel.FeatureSet(points, crs="EPSG:25832", image_size=SIZE)
    return termsel.run("poly-terms", features=features, model=Polynomial3D(degree=1),
                       solver="all-terms", seed=1)


def noise(bands: int = 1, levels: int = 4, seed: int = 1) -> np.ndarray:
    """Return pixels without any smoothness, of a few values from 0 to 255."""
    values = np.random.default_rng(seed).integers(0, levels, (bands, *SIZE))
    return (values * (255 // (levels - 1))).astype(np.uint8)


def half() -> np.ndarray:
    """Return where a mask shows the image: all but a square and scattered pixels."""
    shown = np.random.default_rng(9).uniform(size=SIZE) > 0.1
    shown[20:40, 30:60] = False
    return shown


def write(path: Path, pixels: np.ndarray, *, table: dict[int, tuple[int, ...]] | None = None,
          mask: np.ndarray | None = None, inside: bool = True, colours: tuple[str, ...] = (),
          **profile: Any) -> Path:
    """Write an image that has no georeferencing."""
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=inside), rasterio.open(
            path, "w", driver="GTiff", height=SIZE[0], width=SIZE[1], count=len(pixels),
            dtype=pixels.dtype.name, **profile) as raster:
        if table:
            raster.write_colormap(1, table)
        if colours:
            raster.colorinterp = [ColorInterp[name] for name in colours]
        raster.write(pixels)
        if mask is not None:
            raster.write_mask(mask)
    return path


def rectified(image: Path, **options: Any) -> Path:
    """Return the map that termsel makes of an image."""
    made = image.with_name(f"{image.stem}_map.tif")
    termsel.rectify(result(), image, made, height=HEIGHT, overwrite=True, **options)
    return made


def gdalwarped(image: Path, like: Path, resampling: str, *more: str) -> np.ndarray:
    """Return what `gdalwarp -dstalpha` makes of an image, on the pixels of a map; alpha last."""
    source = image.with_name(f"{image.stem}_source.vrt")
    rasterio.shutil.copy(image, source, driver="VRT")
    with rasterio.open(source, "r+") as raster:
        raster.rpcs = RPC.from_gdal(rpc_items(result().to_rpc()))
    target = source.with_suffix(".warped.tif")
    with rasterio.open(like) as map_:
        west, south, east, north = map_.bounds
        command = ["gdalwarp", "-q", "-overwrite", "-dstalpha", "-rpc", "-et", "0", "-to",
                   f"RPC_HEIGHT={HEIGHT}", "-r", {"nearest": "near"}.get(resampling, resampling),
                   "-t_srs", "EPSG:25832", "-te", *map(repr, (west, south, east, north)),
                   "-ts", str(map_.width), str(map_.height), *more, str(source), str(target)]
    subprocess.run(command, check=True, capture_output=True)
    with rasterio.open(target) as raster:
        return np.asarray(raster.read())


def has_gdalwarp() -> bool:
    """Return whether the program is there."""
    return shutil.which("gdalwarp") is not None
