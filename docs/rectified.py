"""Draw the picture of the whole way, from an actual run: python docs/rectified.py

A simulated scanner looks from the side at a checkerboard that lies on hills. The corners are
measured in the image with some noise, termsel selects terms, and the image is resampled to a
map; left the image, right the map. Needs the extra `gis`. The tests use the functions below.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import rasterio
from affine import Affine
from pyproj import Transformer
from rasterio.errors import NotGeoreferencedWarning
from scipy.ndimage import gaussian_filter

import termsel
from termsel.features import Points
from termsel.io.csv_tables import write_points_csv
from termsel.simulate import pushbroom_at
from termsel.simulate.render import checkerboard, render
from termsel.simulate.terrain import hilly

TARGET = Path(__file__).parent / "_static" / "rectified.png"
LON, LAT, LOW, HIGH = 48.5, 34.8, 1500.0, 2200.0
SIZE, GSD, NOISE = (500, 600), 10.0, 0.15
SIDE = 0.004, 0.0033  # degrees: about 366 m each way
MAP_CRS = "EPSG:32639"
SENSOR = pushbroom_at(LON, LAT, height=(LOW + HIGH) / 2, off_nadir=25.0, gsd=GSD,
                      image_size=SIZE, altitude=681e3, inclination=98.1)


def _terrain():
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
    """Write scene.tif, dem.tif and corners.csv, every other corner, to a folder."""
    pixels = render(SENSOR, TERRAIN, checkerboard((LON, LAT), SIDE))
    noise = np.random.default_rng(0)
    pixels = np.clip(pixels + noise.normal(0.0, 2.0, pixels.shape), 1, 255).astype(np.uint8)
    import warnings

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
                     folder / "corners.csv", "EPSG:4979")


def corners_true(path: Path) -> np.ndarray:
    """Return line and sample of the corners in a map, shape (n, 2)."""
    with rasterio.open(path) as raster:
        turn = Transformer.from_crs("EPSG:4326", raster.crs, always_xy=True)
        x, y = turn.transform(*corners()[:, :2].T)
        sample, line = ~raster.transform @ (np.asarray(x), np.asarray(y))
    return np.column_stack([line, sample]) - 0.5


def corners_found(path: Path) -> np.ndarray:
    """Return where corners are in a map: saddles of its brightness near where they belong."""
    with rasterio.open(path) as raster:
        bright = gaussian_filter(raster.read(1).astype(float), 1.5)
    offset = np.stack(np.meshgrid(np.arange(-5, 6), np.arange(-5, 6), indexing="ij"),
                      -1).reshape(-1, 2)
    found = []
    for place in corners_true(path):
        here = place.copy()
        for _ in range(6):
            middle = np.rint(here).astype(int)
            u, v = offset.T
            columns = np.column_stack([np.ones(len(u)), u, v, u * u, u * v, v * v])
            values = bright[middle[0] + u, middle[1] + v]
            _, gu, gv, uu, uv, vv = np.linalg.lstsq(columns, values, rcond=None)[0]
            here = middle - np.linalg.solve([[2 * uu, uv], [uv, 2 * vv]], [gu, gv])
        found.append(here)
    return np.array(found)


def _picture(scene: Path, rectified: Path) -> np.ndarray:
    """Return image and map side by side, shape (lines, samples, 3)."""
    panels = []
    points = np.array([SENSOR.project(corners()[::2]), None], dtype=object)
    for path, marks in ((scene, points[0]), (rectified, None)):
        with rasterio.open(path) as raster:
            grey = raster.read(1)
        panel = np.repeat(grey[..., None], 3, axis=2)
        if marks is None:
            panel[grey == 0] = 252
        panels.append(panel)
    return panels


def main() -> None:
    """Run the way and write the picture."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        make_scene(folder)
        result = termsel.run("rfm-terms", features=termsel.read(folder / "corners.csv"),
                             out=folder)
        rectified = folder / "map.tif"
        termsel.rectify(result, folder / "scene.tif", rectified, dem=folder / "dem.tif",
                        crs=MAP_CRS, resolution=GSD)
        apart = np.linalg.norm(corners_found(rectified) - corners_true(rectified), axis=1)
        print(f"{len(apart)} corners, at most {apart.max():.2f} px from their places, "
              f"{np.sqrt((apart**2).mean()):.2f} px RMS", file=sys.stderr)


if __name__ == "__main__":
    main()
