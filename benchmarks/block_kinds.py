"""Kinds of simulated blocks, unlike in images, views, ground, control and what vendors give."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.ndimage import gaussian_filter

from termsel_block.block import Block
from termsel_block.simulated import VIEWS, Hills, Simulated, ground_heights, simulate_block

OWN = 6
_JUDGING = 160
_BETWEEN = (20.0, 20.0), (20.0, 200.0), (3.0, 110.0)
"""Views of a stack whose third image looks between the others."""


@dataclass(frozen=True)
class Kind:
    """A kind of block: images, control of the first ones, and which have an RPC."""

    name: str
    images: int
    control: tuple[int, ...]
    rpcs: bool = True
    without_rpc: int | None = None
    """Image that has none: with `rpcs` a block of mixed sensors."""
    views: tuple[tuple[float, float], ...] = VIEWS
    relief: float = 1.0
    drift: float = 2.0
    dem: bool = False
    seeds: float = 1.0
    """Times as many blocks as asked for."""
    model: str = "auto"
    """Of all images."""
    bend: float = 2.0
    """What the attitude bends half an image by [px]."""


KINDS = (
    Kind("pair, 1 point in each", 2, (1, 1)),
    Kind("triplet, 1 point in each", 3, (1, 1, 1)),
    Kind("triplet, 1 point in each, drift 0.3 px", 3, (1, 1, 1), drift=0.3),
    Kind("pair, 1 point in each, drift 0.3 px", 2, (1, 1), drift=0.3),
    Kind("pair", 2, (6, 0)),
    Kind("pair, plain of 10 m", 2, (20, 0), relief=0.05),
    Kind("pair, DEM", 2, (6, 0), dem=True, seeds=0.5),
    Kind("pair, 20 points, DEM", 2, (20, 0), dem=True, seeds=0.5),
    Kind("triplet", 3, (6, 6, 0)),
    Kind("triplet, DEM", 3, (6, 6, 0), dem=True, seeds=0.5),
    Kind("triplet, third between", 3, (6, 6, 0), views=_BETWEEN),
    Kind("triplet, 12 points in two", 3, (12, 12, 0)),
    Kind("triplet, 20 points in two", 3, (20, 20, 0)),
    Kind("triplet, 20 points in one", 3, (20, 0, 0)),
    Kind("triplet without RPCs", 3, (6, 6, 0), rpcs=False, seeds=0.5),
    Kind("triplet without RPCs, bent as real ones", 3, (6, 6, 0), rpcs=False, seeds=0.5,
         bend=6.0),
    Kind("triplet without RPCs, scanners", 3, (6, 6, 0), rpcs=False, seeds=0.5, model="scanner"),
    Kind("triplet without RPCs, 20 points in two", 3, (20, 20, 0), rpcs=False),
    Kind("triplet, one without RPC", 3, (6, 6, 0), without_rpc=2),
    Kind("strip of 12, 6 points in two", 12, (6, 6, 0), seeds=0.25),
    Kind("strip of 12, 20 points in four", 12, (20, 20, *(0,) * 7, 20, 20), seeds=0.25),
    Kind("strip of 12, 6 points in two, DEM", 12, (6, *(0,) * 8, 6), dem=True, seeds=0.25),
    Kind("100 images, 6 points in ten", 100, (6, *(0,) * 9) * 10, seeds=0.15),
    Kind("100 images, 20 points in twenty", 100, (20, 20, *(0,) * 7) * 10, seeds=0.15),
)


@contextmanager
def drawn(kind: Kind, seed: int) -> Iterator[tuple[Simulated, Block, float, float]]:
    """Yield a block and its truth, and the standard deviations of biases and of noise [px]."""
    rng = np.random.default_rng([seed, 7])
    bias, noise = (5.0, 20.0, 50.0)[seed % 3], (0.3, 0.4, 0.5)[seed // 3 % 3]
    hills = Hills(kind.relief, tuple(rng.uniform(0, 2 * np.pi, 4).tolist()))
    simulated = simulate_block(
        kind.images, n_ties=200 if kind.images < 50 else 100, control=kind.control,
        rpcs=kind.rpcs, bias=bias, drift=kind.drift, noise=noise, seed=seed, independent=_JUDGING,
        views=kind.views, hills=hills, vendor_height=float(rng.normal(0, 40)), bend=kind.bend)
    block = replace(simulated.block, images=tuple(
        replace(image, model=kind.model) for image in simulated.block.images))
    if kind.without_rpc is not None:
        images = list(block.images)
        images[kind.without_rpc] = replace(images[kind.without_rpc], rpc=None)
        block = replace(block, images=tuple(images))
    with TemporaryDirectory() as folder:
        if kind.dem:
            block = replace(block, dem=_dem(Path(folder), simulated, hills, rng))
        yield simulated, block, bias, noise


def _dem(folder: Path, simulated: Simulated, hills: Hills, rng: np.random.Generator) -> Path:
    """Write heights 100 m apart, off by 3 m as a whole, and by 3 m that neighbours share."""
    from rasterio import open as opened
    from rasterio.transform import from_origin

    step, reach = 0.001, 0.25
    west, south = simulated.ties[:, :2].min(axis=0) - reach
    east, north = simulated.ties[:, :2].max(axis=0) + reach
    lon, lat = np.arange(west, east, step), np.arange(north, south, -step)
    places = np.stack(np.meshgrid(lon, lat), axis=-1).reshape(-1, 2)
    errors = gaussian_filter(rng.standard_normal((len(lat), len(lon))), 6)
    heights = ground_heights(places,
                             hills).reshape(errors.shape) + 3 * errors / errors.std() + rng.normal(
        0, 3)
    with opened(folder / "dem.tif", "w", driver="GTiff", width=len(lon), height=len(lat), count=1,
                dtype="float32", crs="EPSG:4979",
                transform=from_origin(west - step / 2, north + step / 2, step, step)) as raster:
        raster.write(heights.astype(np.float32), 1)
    return folder / "dem.tif"


