"""Draw the picture of the whole way, from an actual run: python docs/rectified.py

A simulated scanner looks from the side at a checkerboard that lies on hills. The corners are
measured in the image with some noise, termsel selects terms, and the image is resampled to a
map; left the image, right the map. Needs the extra `gis`. The tests use the functions below.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import rasterio
from affine import Affine
from pyproj import Transformer
from rasterio.errors import NotGeoreferencedWarning
from scipy.ndimage import gaussian_filter

import termsel
from termsel.formats.readers.csv_tables import write_points_csv
from termsel.measurements.features import Points
from termsel.simulate import pushbroom_at
from termsel.simulate.render import checkerboard, render
from termsel.simulate.terrain import Terrain, hilly

TARGET = Path(__file__).parent / "_static" / "rectified.png"
LON, LAT, LOW, HIGH = 48.5, 34.8, 1500.0, 2200.0
SIZE, GSD, NOISE = (500, 600), 10.0, 0.15
GROUND = 252, 252, 250  # reads alike on light and dark pages
SIDE = 0.004, 0.0033  # degrees: about 366 m each way
MAP_CRS = "EPSG:32639"
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
    """Write scene.tif, dem.tif and corners.csv, every other corner, to a folder."""
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


def _panel(path: Path, marks: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """Return a raster in grey, shape (lines, samples, 3), with a cross at each mark."""
    with rasterio.open(path) as raster:
        grey, nodata = raster.read(1), raster.nodata
    # Without the noise of the pixels the file is a tenth as large.
    panel = np.repeat((np.rint(grey / 32.0) * 32.0).astype(np.uint8)[..., None], 3, axis=2)
    if nodata is not None:
        panel[grey == nodata] = GROUND
    for line, sample in np.rint(marks).astype(int):
        panel[line, sample - 4:sample + 5] = colour
        panel[line - 4:line + 5, sample] = colour
    return panel


def draw(scene: Path, rectified: Path, measured: np.ndarray) -> np.ndarray:
    """Return image and map side by side, shape (3, lines, samples).

    Parameters
    ----------
    scene, rectified : Path
    measured : ndarray, shape (n, 2)
        Line and sample of the points the model was fitted to.
    """
    panels = [_panel(scene, measured, (209, 36, 47)),
              _panel(rectified, corners_true(rectified), (11, 122, 117))]
    height = max(panel.shape[0] for panel in panels)
    columns = []
    for panel in panels:
        above = (height - panel.shape[0]) // 2
        below = height - panel.shape[0] - above
        columns.append(np.pad(panel.astype(int) + 1, ((above, below), (8, 8), (0, 0))))
    whole = np.concatenate(columns, axis=1) - 1
    whole[(whole < 0).all(axis=2)] = GROUND
    return np.moveaxis(whole.astype(np.uint8), -1, 0)


def main() -> None:
    """Run the way and write the picture."""
    with TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        folder = Path(name)
        make_scene(folder)
        result = termsel.run("rfm-terms", features=termsel.read(folder / "corners.csv"))
        rectified = folder / "map.tif"
        termsel.rectify(result, folder / "scene.tif", rectified, dem=folder / "dem.tif",
                        crs=MAP_CRS, resolution=GSD)
        apart = np.linalg.norm(corners_found(rectified) - corners_true(rectified), axis=1)
        fitted = np.isin(result.features.points.ids, [r.id for r in result.residuals if r.used])
        picture = draw(folder / "scene.tif", rectified, result.features.points.image[fitted])
        with rasterio.open(TARGET, "w", driver="PNG", height=picture.shape[1],
                           width=picture.shape[2], count=3, dtype="uint8", zlevel=9) as raster:
            raster.write(picture)
    print(f"{fitted.sum()} points, {len(result.selection.terms)} terms of "
          f"{result.model}; {len(apart)} corners, at most {apart.max():.2f} px from their places, "
          f"{np.sqrt((apart**2).mean()):.2f} px RMS", file=sys.stderr)


if __name__ == "__main__":
    main()
