"""Write the files of the tutorial: an image, its ground control points and a height model.

    python make_scene.py

All three are simulated. A scanner looks from the side at a checkerboard that lies on hills. Every
other corner is a control point, measured in the image with a noise of 0.15 px. Needs the extra
`gis`.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from rasterio.errors import NotGeoreferencedWarning

from termsel import write_points_csv
from termsel.measurements.features import Points
from termsel.simulate import pushbroom_at
from termsel.simulate.render import checkerboard, render
from termsel.simulate.terrain import Terrain, hilly

LON, LAT, LOW, HIGH = 48.5, 34.8, 1500.0, 2200.0
SIZE, GSD, NOISE = (500, 600), 10.0, 0.15
SIDE = 0.004, 0.0033  # degrees: about 366 m each way
SENSOR = pushbroom_at(LON, LAT, height=(LOW + HIGH) / 2, off_nadir=25.0, gsd=GSD,
                      image_size=SIZE, altitude=681e3, inclination=98.1)


def _terrain() -> Terrain:
    """Return hills between LOW and HIGH over what the image shows."""
    edge = np.stack(np.meshgrid(np.linspace(0, SIZE[0], 40), np.linspace(0, SIZE[1], 40)), -1)
    places = SENSOR.locate(edge.reshape(-1, 2), (LOW + HIGH) / 2)
    hills = hilly(8, LON, LAT, (SIZE[1] * GSD, SIZE[0] * GSD), 20.0)
    return hills.between(places, LOW, HIGH)[0]


TERRAIN = _terrain()


def corners() -> np.ndarray:
    """Return longitude, latitude and height of the corners in the image, shape (n, 3)."""
    i, j = np.meshgrid(np.arange(-12, 13), np.arange(-12, 13))
    place = np.column_stack([LON + SIDE[0] * i.ravel(), LAT + SIDE[1] * j.ravel()])
    ground = np.column_stack([place, TERRAIN(place)])
    image = SENSOR.project(ground)
    return ground[((image > 12) & (image < np.array(SIZE) - 13)).all(axis=1)]


def make_scene(folder: Path) -> None:
    """Write scene.tif, dem.tif and gcps.csv, which has every other corner, to a folder."""
    pixels = render(SENSOR, TERRAIN, checkerboard((LON, LAT), SIDE))
    noise = np.random.default_rng(0)
    pixels = np.clip(pixels + noise.normal(0.0, 2.0, pixels.shape), 1, 255).astype(np.uint8)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(folder / "scene.tif", "w", driver="GTiff", height=SIZE[0],
                           width=SIZE[1], count=1, dtype="uint8") as raster:
            raster.write(pixels, 1)
    step, n = 0.0002, 520
    west, north = LON - n / 2 * step, LAT + n / 2 * step
    x, y = np.meshgrid(west + (np.arange(n) + 0.5) * step, north - (np.arange(n) + 0.5) * step)
    heights = TERRAIN(np.column_stack([x.ravel(), y.ravel()])).reshape(n, n)
    with rasterio.open(folder / "dem.tif", "w", driver="GTiff", height=n, width=n, count=1,
                       dtype="float32", crs="EPSG:4326",
                       transform=Affine(step, 0.0, west, 0.0, -step, north)) as raster:
        raster.write(heights.astype(np.float32), 1)
    ground = corners()[::2]
    image = SENSOR.project(ground) + noise.normal(0.0, NOISE, (len(ground), 2))
    write_points_csv(Points(tuple(f"C{i}" for i in range(len(ground))), image, ground),
                     folder / "gcps.csv", "EPSG:4979")


if __name__ == "__main__":
    make_scene(Path())
