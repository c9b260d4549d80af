"""The scene of the tutorial: a checkerboard on hills, which a scanner looks at from the side.

Every corner of the board has a known place on the ground and in the image. All is simulated.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.data.rpc import Rpc
from termsel.fitting.least_squares import fit_all_terms
from termsel.fitting.rpc_fit import rpc_of
from termsel.models.polynomial import Polynomial3D
from termsel.simulate.orbit import pushbroom_at
from termsel.simulate.render import checkerboard_pattern, render
from termsel.simulate.terrain import Terrain, hilly_terrain

LON, LAT, LOW, HIGH = 48.5, 34.8, 1500.0, 2200.0
SIZE = (500, 600)
GSD = 10.0
EXAMPLE_NOISE = 0.15
CRS, MAP_CRS = "EPSG:4979", "EPSG:32639"
SIDE = 0.004, 0.0033  # degrees: about 366 m each way
VENDOR = 14.0, -9.0  # px that the vendor's RPC is off in line and sample
SENSOR = pushbroom_at(LON, LAT, height=(LOW + HIGH) / 2, off_nadir=25.0, gsd=GSD,
                      image_size=SIZE, altitude=681e3, inclination=98.1)
BOARD = checkerboard_pattern((LON, LAT), SIDE)


@cache  # one terrain, asked for by image, heights and map
def example_terrain() -> Terrain:
    """Return hills between `LOW` and `HIGH` over the ground of the image."""
    edge = np.stack(np.meshgrid(np.linspace(0, SIZE[0], 40), np.linspace(0, SIZE[1], 40)), -1)
    positions = SENSOR.locate(edge.reshape(-1, 2), (LOW + HIGH) / 2)
    hills = hilly_terrain(8, LON, LAT, (SIZE[1] * GSD, SIZE[0] * GSD), 20.0)
    return hills.between(positions, LOW, HIGH)[0]


def ground_of_corners() -> FloatArray:
    """Return longitude, latitude and height of the corners in the image, shape (n, 3)."""
    i, j = np.meshgrid(np.arange(-12, 13), np.arange(-12, 13))
    positions = np.column_stack([LON + SIDE[0] * i.ravel(), LAT + SIDE[1] * j.ravel()])
    ground = np.column_stack([positions, example_terrain()(positions)])
    image = SENSOR.project(ground)
    return ground[((image > 12) & (image < np.array(SIZE) - 13)).all(axis=1)]


def picture_and_points() -> tuple[np.ndarray, Points]:
    """Return the image, of bytes (lines, samples), and every other corner as measured in it.

    The further corners are left for checks of a result.
    """
    brightness = render(SENSOR, example_terrain(), BOARD)
    rng = np.random.default_rng(0)
    noisy = brightness + rng.normal(0.0, 2.0, brightness.shape)
    # From 1, as 0 stands for no data.
    pixels = np.clip(noisy, 1, 255).astype(np.uint8)
    ground = ground_of_corners()[::2]
    image = SENSOR.project(ground) + rng.normal(0.0, EXAMPLE_NOISE, (len(ground), 2))
    return pixels, Points(tuple(f"C{i}" for i in range(len(ground))), np.round(image, 3),
                          np.column_stack([ground[:, :2], ground[:, 2].round(3)]))


def vendor_rpc() -> Rpc:
    """Return an RPC of the image that is off by `VENDOR` [px], as a vendor delivers it."""
    # A virtual grid in image and height, as vendors make their RPCs from.
    axes = (np.linspace(0, SIZE[0], 9), np.linspace(0, SIZE[1], 9), np.linspace(LOW, HIGH, 5))
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    ground = np.column_stack([SENSOR.locate(grid[:, :2], grid[:, 2]), grid[:, 2]])
    points = Points(tuple(map(str, range(len(grid)))), grid[:, :2] + VENDOR, ground)
    control = FeatureSet(points, crs=CRS, image_size=SIZE)
    return rpc_of(fit_all_terms(Polynomial3D(degree=3), control)).rpc.as_delivered()
