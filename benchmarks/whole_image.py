"""Processor time of a map of a whole Sentinel-1 GRD image, next to that of gdalwarp.

``python -m benchmarks.whole_image ANNOTATION`` makes an image of speckle of the size that an
annotation states, and a DEM of rough relief, runs termsel and gdalwarp on the same grid, one after
the other, and prints a table. ``--part SHARE`` takes a part of the map.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import rasterio
from rasterio.control import GroundControlPoint
from rasterio.transform import from_origin
from rasterio.windows import Window

import termsel

SPECKLE = 1024, 4096
"""Lines and samples of random pixels, which are repeated."""

SECOND = 1.0 / 3600.0
"""Pixel of the DEM [deg]."""

RECTIFY = """
import json, sys
import termsel
folder = sys.argv[1]
termsel.rectify(termsel.read_result(folder + "/result"), folder + "/scene.tif",
                folder + "/map.tif", dem=folder + "/dem.tif", bounds=json.loads(sys.argv[2]))
"""

MARGIN = 0.2
"""What the DEM is larger than the lattice [deg]."""


def made_image(path: Path, size: tuple[int, int], features: termsel.FeatureSet) -> None:
    """Write an image of speckle with the lattice in its tags."""
    rng = np.random.default_rng(0)
    lines, samples = size
    speckle = rng.gamma(4.0, 60.0, SPECKLE).astype(np.uint16)
    row = np.tile(speckle, (1, -(-samples // SPECKLE[1])))[:, :samples]
    gcps = [GroundControlPoint(row=line + 0.5, col=sample + 0.5, x=x, y=y, z=z)
            for (line, sample), (x, y, z) in zip(features.points.image.tolist(),
                                                 features.points.ground.tolist(), strict=True)]
    with rasterio.open(path, "w", driver="GTiff", width=samples, height=lines, count=1,
                       dtype="uint16", gcps=gcps, crs="EPSG:4326") as raster:
        for first in range(0, lines, SPECKLE[0]):
            count = min(SPECKLE[0], lines - first)
            raster.write(row[:count], 1, window=Window(0, first, samples, count))


def made_dem(path: Path, features: termsel.FeatureSet) -> None:
    """Write a DEM of rough relief between the lowest and the highest point of a lattice."""
    low = features.points.ground.min(axis=0)
    high = features.points.ground.max(axis=0)
    width, height = (int((high[axis] - low[axis] + 2 * MARGIN) / SECOND) for axis in (0, 1))
    x = np.arange(width)[None]
    middle = (low[2] + high[2]) / 2.0
    half = (high[2] - low[2]) / 2.0
    with rasterio.open(path, "w", driver="GTiff", width=width, height=height, count=1,
                       dtype="float32", crs="EPSG:4326", tiled=True, transform=from_origin(
                           low[0] - MARGIN, high[1] + MARGIN, SECOND, SECOND)) as raster:
        for first in range(0, height, 512):
            y = np.arange(first, min(first + 512, height))[:, None]
            rough = 0.7 * np.sin(x / 180.0) * np.cos(y / 140.0) + 0.2 * np.sin(x / 37 + y / 53) \
                + 0.05 * np.sin(x / 9.0) * np.sin(y / 11.0)
            raster.write((middle + half * rough).astype(np.float32), 1,
                         window=Window(0, first, width, len(y)))


def spent(command: list[str], log: Path) -> tuple[float, float]:
    """Run a command, and return its processor time [s] and largest memory [GiB]."""
    code = ("import resource, subprocess, sys, json\n"
            "done = subprocess.run(sys.argv[1:], stdout=sys.stderr)\n"
            "use = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
            "print(json.dumps([done.returncode, use.ru_utime + use.ru_stime, use.ru_maxrss]))")
    with log.open("w") as file:
        done = subprocess.run([sys.executable, "-c", code, *command], stdout=subprocess.PIPE,
                              stderr=file, text=True, check=True, env={
                                  **os.environ, "OMP_NUM_THREADS": "1",
                                  "OPENBLAS_NUM_THREADS": "1"})
    status, seconds, kilobytes = json.loads(done.stdout)
    if status:
        raise RuntimeError(f"{command[0]} failed: {log.read_text()[-500:]}")
    return seconds, kilobytes / 2**20


def rows(annotation: Path, folder: Path, part: float) -> list[tuple[str, float, float]]:
    """Return what each way takes: its name, processor time [s] and largest memory [GiB]."""
    features = termsel.read(annotation)
    image = folder / "scene.tif"
    dem = folder / "dem.tif"
    assert features.image_size is not None
    made_image(image, features.image_size, features)
    made_dem(dem, features)
    result = termsel.run(features=features, out=folder / "result")
    termsel.export(result, "rpc-vrt", folder / "rpc.vrt", image=str(image))
    ground = features.points.ground
    middle = (ground.min(axis=0) + ground.max(axis=0)) / 2.0
    half = np.ptp(ground, axis=0) / 2.0 * np.sqrt(part)
    bounds = None if part >= 1.0 else (*(middle - half)[:2].tolist(), *(middle + half)[:2].tolist())
    ours = spent([sys.executable, "-c", RECTIFY, str(folder), json.dumps(bounds)],
                 folder / "log.txt")
    with rasterio.open(folder / "map.tif") as made:
        extent = [f"{value:.3f}" for value in made.bounds]
        grid = ["-t_srs", str(made.crs), "-te", *extent, "-tr", *map(str, made.res), "-r",
                "bilinear", "-co", "TILED=YES", "-overwrite", "-q"]
        pixels = made.width * made.height
    warped = [("gdalwarp -rpc with RPC_DEM", ["-rpc", "-to", f"RPC_DEM={dem}", *grid,
                                              str(folder / "rpc.vrt")]),
              ("gdalwarp -order 3, without heights", ["-order", "3", *grid, str(image)])]
    found = [(f"termsel rectify, {pixels / 1e6:,.0f} million pixels", *ours)]
    for name, arguments in warped:
        output = folder / "warped.tif"
        found.append((name, *spent(["gdalwarp", *arguments, str(output)], folder / "log.txt")))
        output.unlink()
    return found


def timings(annotation: Path, part: float = 1.0) -> str:
    """Return the section of a page on the time that a whole image takes."""
    with tempfile.TemporaryDirectory() as name:
        measured = rows(annotation, Path(name), part)
    lines = ["## A map of a whole image", "",
             "Processor time of one thread, and the largest memory, for an image of speckle of the "
             "size of an IW GRD product", "and a DEM of 1\" that is made up"
             + (f": {part:.0%} of the map" if part < 1.0 else "") + ". The grid is the same. The "
             "map of termsel is packed, has overviews", "and is read back; those of gdalwarp are "
             "not.", "", "| way | time [s] | memory [GiB] |", "|---|---:|---:|",
             *(f"| {name} | {seconds:.0f} | {memory:.1f} |" for name, seconds, memory in measured)]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("annotation", type=Path)
    parser.add_argument("--part", type=float, default=1.0, help="share of the map's area")
    asked = parser.parse_args()
    sys.stdout.write(timings(asked.annotation, asked.part))
    sys.stderr.write(f"{resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss >> 10} MiB\n")


if __name__ == "__main__":
    main()
