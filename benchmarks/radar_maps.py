"""Maps of gdalwarp and QGIS by the RPC of a radar, pixel by pixel next to those of `rectify`.

The image has its own line and sample as pixels, so that a map shows where each of its pixels was
taken from, and differences of two maps are distances in the image.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from rasterio.transform import from_origin
from rasterio.windows import Window

import termsel
from termsel.data.features import FeatureSet, FloatArray
from termsel.fitting.rpc_fit import rpc_of

HALF, EDGE = 620, 5.0
"""Half a side of the part of the image that has pixels, and of its edge that is not compared, as
resampling mixes what is outside [px]."""

DEM_PIXELS, SECOND = 900, 1.0 / 3600.0
AROUND = 0.05
"""Half a side of the map [deg]."""

ASKED = 200
"""Pixels of QGIS's layer that are compared."""

LAYER = """
import json, sys
from qgis.core import QgsApplication, QgsPointXY, QgsRasterLayer
app = QgsApplication([], False)
app.initQgis()
asked = json.load(open(sys.argv[1]))
layer = QgsRasterLayer(asked["raster"], "layer")
box = layer.extent()
width, height = box.width() / layer.width(), box.height() / layer.height()
centres, pixels = [], []
for x, y in asked["places"]:
    x = box.xMinimum() + (int((x - box.xMinimum()) / width) + 0.5) * width
    y = box.yMaximum() - (int((box.yMaximum() - y) / height) + 0.5) * height
    shown = [layer.dataProvider().sample(QgsPointXY(x, y), band)[0] for band in (1, 2)]
    centres.append((x, y))
    pixels.append(shown)
json.dump({"centres": centres, "pixels": pixels}, open(sys.argv[2], "w"))
"""


@dataclass(frozen=True)
class Beside:
    """How far maps by the RPC are from those of `rectify`, and what the RPC's message says [px]."""

    pixels: int
    gdal_rms: float
    gdal_largest: float
    qgis_largest: float  # beyond half a pixel, as QGIS takes the nearest one
    stated_rms: float
    stated_largest: float


def beside(features: FeatureSet, folder: Path) -> Beside:
    """Return how far maps are apart, about the middle of an image whose points name its radar."""
    result = termsel.run(features=features)
    assert features.image_size is not None
    middle = _middle(features)
    image = folder / "scene.tif"
    _write_image(image, features.image_size, middle)
    level = float(features.points.ground[:, 2].mean())
    place = result.locate(np.array([middle]), level)[0]
    dem = folder / "dem.tif"
    _write_dem(dem, place, features.points.ground[:, 2])
    termsel.export(result, "rpc-vrt", folder / "rpc.vrt", image=str(image))
    bounds = (*(place[:2] - AROUND).tolist(), *(place[:2] + AROUND).tolist())
    termsel.rectify(result, image, folder / "map.tif", dem=dem, bounds=bounds)
    _warp(folder, dem)
    away = _distances(folder, middle)
    rpc = rpc_of(result.fit)
    return Beside(len(away), float(np.sqrt((away**2).mean())), float(away.max()),
                  _in_qgis(result, folder, middle), rpc.rms, rpc.worst)


def _middle(features: FeatureSet) -> FloatArray:
    """Return the middle of the lattice in the image."""
    image = features.points.image
    return np.asarray((image.min(axis=0) + image.max(axis=0)) / 2.0).round()


def _write_image(path: Path, size: tuple[int, int], middle: FloatArray) -> None:
    line, sample = (int(value) for value in middle)
    first = max(line - HALF, 0), max(sample - HALF, 0)
    last = min(line + HALF, size[0]), min(sample + HALF, size[1])
    lines, samples = np.mgrid[first[0]:last[0], first[1]:last[1]].astype(np.float32)
    window = Window(first[1], first[0], last[1] - first[1], last[0] - first[0])
    with rasterio.open(path, "w", driver="GTiff", width=size[1], height=size[0], count=2,
                       dtype="float32", sparse_ok=True, tiled=True, nodata=-1.0) as raster:
        raster.write(np.stack([lines, samples]), window=window)


def _write_dem(path: Path, place: FloatArray, heights: FloatArray) -> None:
    """Write rough relief between the lowest and the highest point."""
    x = np.arange(DEM_PIXELS)[None]
    y = x.T
    rough = 0.7 * np.sin(x / 180.0) * np.cos(y / 140.0) + 0.2 * np.sin(x / 37 + y / 53) \
        + 0.05 * np.sin(x / 9.0) * np.sin(y / 11.0)
    low, high = heights.min(), heights.max()
    half = DEM_PIXELS / 2 * SECOND
    with rasterio.open(path, "w", driver="GTiff", width=DEM_PIXELS, height=DEM_PIXELS, count=1,
                       dtype="float32", crs="EPSG:4979", transform=from_origin(
                           place[0] - half, place[1] + half, SECOND, SECOND)) as raster:
        raster.write(((low + high) / 2 + (high - low) / 2 * rough).astype(np.float32), 1)


def _warp(folder: Path, dem: Path) -> None:
    """Let gdalwarp make the same map by the RPC and the DEM."""
    with rasterio.open(folder / "map.tif") as made:
        grid = ["-t_srs", str(made.crs), "-te", *map(repr, made.bounds), "-tr",
                *map(str, made.res)]
    subprocess.run(
        ["gdalwarp", "-q", "-rpc", "-to", f"RPC_DEM={dem}", "-to",
         "RPC_DEM_APPLY_VDATUM_SHIFT=FALSE", "-et", "0", *grid, "-r", "bilinear", "-dstnodata",
         "-1", str(folder / "rpc.vrt"), str(folder / "warped.tif")], check=True)


def _distances(folder: Path, middle: FloatArray) -> FloatArray:
    """Return how far apart pixels of two maps were taken from the image [px]."""
    maps = []
    for name in ("map.tif", "warped.tif"):
        with rasterio.open(folder / name) as made:
            maps.append(made.read())
    inner = np.ones(maps[0].shape[1:], dtype=bool)
    for bands in maps:
        for axis in (0, 1):
            inner &= np.abs(bands[axis] - middle[axis]) < HALF - EDGE
    return np.asarray(np.linalg.norm((maps[0] - maps[1])[:, inner], axis=0))


def _in_qgis(result: termsel.Result, folder: Path, middle: FloatArray) -> float:
    """Return how far QGIS shows pixels from where the model has them, beyond half a pixel.

    QGIS takes an RPC at its height offset, and the nearest pixel.
    """
    offset = re.search(r'HEIGHT_OFF">([^<]+)', (folder / "rpc.vrt").read_text())
    assert offset is not None
    height = float(offset[1])
    aside = np.random.default_rng(0).uniform(-0.9 * HALF, 0.9 * HALF, (ASKED, 2))
    places = result.locate(middle + aside, height)[:, :2]
    (folder / "asked.json").write_text(json.dumps(
        {"raster": str(folder / "rpc.vrt"), "places": places.tolist()}))
    (folder / "layer.py").write_text(LAYER)
    environment = {key: value for key, value in os.environ.items()
                   if key not in ("VIRTUAL_ENV", "PYTHONHOME", "PYTHONPATH")}
    environment |= {"PATH": os.defpath, "QT_QPA_PLATFORM": "offscreen"}
    subprocess.run(["/usr/bin/python3", *(str(folder / name) for name in (
        "layer.py", "asked.json", "answer.json"))], env=environment, check=True,
        stderr=subprocess.DEVNULL)
    answer = json.loads((folder / "answer.json").read_text())
    centres = np.array(answer["centres"])
    exact = result.project(np.column_stack([centres, np.full(len(centres), height)]))
    beyond = np.abs(np.array(answer["pixels"], dtype=float) - exact).max(axis=1) - 0.5
    return float(max(beyond.max(), 0.0))
