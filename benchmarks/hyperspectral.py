"""Products of hyperspectral satellites matched to a map, and given a geolocation array again.

``python -m benchmarks.hyperspectral --write`` makes docs/evidence/hyperspectral.md: simulated
products of the structure of those of PRISMA, EnMAP and HYPSO, and the commands of the guide. Needs
the packages termsel-match, termsel-rpc and termsel-formats.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from scipy.ndimage import map_coordinates

import termsel
from benchmarks.sets import put
from termsel.core.threads import one_blas_thread
from termsel.data.features import FloatArray
from termsel.formats.rpc_files import rpc_items
from termsel.testing import invoke
from termsel_match.simulated.world import WORLD_CRS, World
from termsel_match.simulated.world_files import write_world

SIZE, SEED, OFF = 420, 4, 12.0
"""Pixels along a side of the images, and how far the product's own georeferencing is off [px]."""

BANDS = 3
"""Bands of the simulated metadata of EnMAP, each a little off the others."""

KEYSTONE = 0.2
"""Distance of the bands from each other [px]."""

STEP = 10
"""Pixels between the tie points of HYPSO."""

INTRODUCTION = f"""# Hyperspectral products matched to a map

*Simulated:* a rendered place of {SIZE} px, seen by an exact scanner, as products of the structure
of PRISMA (longitude and latitude of every pixel, without heights), EnMAP (metadata with an RPC for
each band) and HYPSO (longitude and latitude of every {STEP}th pixel). Their own georeferencing is
{OFF:g} px off and drifts. The commands are those of the [guide](../how-to/hyperspectral.md): the
product's georeferencing is where matching starts, the selected candidates fit the model, and a
geolocation array is written. `python -m benchmarks.hyperspectral --write` makes this page.

Errors are against the exact scanner, at 200 places that took no part [px]; those of the array are
at pixels of the image, on the ground of the DEM.

| product | as delivered, RMSE | matched, RMSE | stated by independent candidates, RMSE | \
`sigma`, median | array, RMSE |
|---|---:|---:|---:|---:|---:|
"""


@dataclass(frozen=True)
class Product:
    """Files of a simulated product, and the arguments of the command that reads them."""

    name: str
    reading: tuple[str, ...]  # arguments of `termsel run`; empty for an RPC
    start: str  # what matching starts from


def delivered_places(world: World, folder: Path, image: FloatArray) -> FloatArray:
    """Return longitudes and latitudes (n, 2) that a vendor gives for image places, on the DEM."""
    places = world.rpc.locate(image, np.full(len(image), 520.0))
    for _ in range(6):
        places = world.rpc.locate(image, heights_at(folder / "dem.tif", places[:, :2]))
    return np.asarray(places[:, :2])


def heights_at(dem: Path, lonlat: FloatArray) -> FloatArray:
    """Return heights of the DEM (n,) at longitudes and latitudes."""
    from pyproj import Transformer

    x, y = Transformer.from_crs("EPSG:4326", WORLD_CRS, always_xy=True).transform(*lonlat.T)
    with rasterio.open(dem) as raster:
        sample, line = ~raster.transform @ (np.asarray(x), np.asarray(y))
        heights = raster.read(1).astype(np.float64)
    return np.asarray(map_coordinates(heights, [line - 0.5, sample - 0.5], order=1,
                                      mode="nearest"))


def write_arrays(world: World, folder: Path, step: int) -> None:
    """Write longitudes and latitudes of every so many pixels, as the guide extracts them."""
    numbers = np.arange(0, SIZE, step)
    image = np.stack(np.meshgrid(numbers, numbers, indexing="ij"), axis=-1).reshape(-1, 2)
    lonlat = delivered_places(world, folder, image.astype(np.float64))
    for name, values in zip(("lon.tif", "lat.tif"), lonlat.T, strict=True):
        with rasterio.open(folder / name, "w", driver="GTiff", width=len(numbers),
                           height=len(numbers), count=1, dtype="float64") as raster:
            raster.write(values.reshape(len(numbers), -1), 1)


def write_enmap(world: World, folder: Path) -> None:
    """Write metadata of EnMAP with an RPC for each band."""
    bands = ""
    for number in range(1, BANDS + 1):
        items = rpc_items(world.rpc)
        shift = KEYSTONE * (number - (BANDS + 1) / 2)
        items["SAMP_OFF"] = repr(float(items["SAMP_OFF"]) + shift)
        bands += f"<bandID number='{number}'>"
        for name, text in items.items():
            tag = name.replace("LINE", "ROW").replace("SAMP", "COL")
            numbers = text.split()
            if name.startswith("ERR"):
                continue
            bands += "".join(f"<{tag}_{i}>{value}</{tag}_{i}>"
                             for i, value in enumerate(numbers, 1)) \
                if len(numbers) > 1 else f"<{tag}>{text}</{tag}>"
        bands += "</bandID>"
    (folder / "METADATA.XML").write_text(
        f"<level_X><product><navigation><RPC>{bands}</RPC></navigation></product></level_X>")


def products(world: World, folder: Path) -> list[Product]:
    """Return the products, whose files are in folders of their own."""
    found = []
    for name, step in (("PRISMA", 1), ("HYPSO", STEP)):
        place = folder / name
        write_world(world, place)
        (place / "image.RPB").unlink()
        write_arrays(world, place, step)
        found.append(Product(name, ("--points", "lon.tif", "--format", "geolocation-array", "--set",
                                    "latitude=lat.tif", "--set", f"array_step={step},{step}"),
                             "delivered.RPB"))
    place = folder / "EnMAP"
    write_world(world, place)
    (place / "image.RPB").unlink()
    write_enmap(world, place)
    return [found[0], Product("EnMAP", (), "METADATA.XML"), found[1]]


def row(product: Product, world: World, folder: Path) -> str:
    """Return the row of a product, after the commands of the guide."""
    place = folder / product.name
    at = {"lon.tif", "lat.tif", "METADATA.XML"}
    if product.reading:
        command("run", *(str(place / part) if part in at else part.replace(
            "latitude=", f"latitude={place}/") for part in product.reading), "--image",
            place / "image.tif", "--dem", place / "dem.tif", "--out", place / "delivered")
        command("export", place / "delivered", "--to", "rpb", "--output", place / "delivered.RPB")
    command("auto-georeference", place / "image.tif", "--reference", place / "ortho.tif", "--dem",
            place / "dem.tif", "--start", place / product.start, "--out", place / "result",
            "-o", place / "map.tif", "--quiet")
    command("export", place / "result/result", "--to", "geolocation-vrt", "--image",
            place / "image.tif", "--dem", place / "dem.tif", "--set", "step=10", "--output",
            place / "scene.vrt")
    truth = world.independent()
    result = termsel.read_result(place / "result/result")
    delivered = world.rpc.project(to_degrees(truth.ground))
    stated = result.rmse["independent"]
    sigma = np.linalg.norm(result.fit.sigma(truth.ground), axis=1)
    return (f"| {product.name} | {rmse(delivered - truth.image):.1f} "
            f"| {rmse(result.project(truth.ground) - truth.image):.2f} "
            f"| {stated.total:.2f} ({stated.n}) | {np.median(sigma):.2f} "
            f"| {array_error(place, world):.2f} |")


def to_degrees(ground: FloatArray) -> FloatArray:
    """Return longitude, latitude and height of places in the plane."""
    from pyproj import Transformer

    lon, lat = Transformer.from_crs(WORLD_CRS, "EPSG:4326", always_xy=True).transform(*ground.T[:2])
    return np.column_stack([lon, lat, ground[:, 2]])


def array_error(place: Path, world: World) -> float:
    """Return how far the exact scanner sees places of the array from their pixels [px]."""
    features = termsel.read(place / "scene.vrt", format="geolocation-array")
    ground = features.points.ground.copy()
    if not features.crs.startswith(("EPSG:4326", "EPSG:4979")):
        ground = to_degrees(ground)
    ground[:, 2] = heights_at(place / "dem.tif", ground[:, :2])
    return rmse(world.camera.project(ground) - features.points.image)


def rmse(errors: FloatArray) -> float:
    """Return the root mean square distance."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def command(*arguments: object) -> None:
    """Run a command of termsel, which must succeed."""
    done = invoke(*map(str, arguments))
    if done.exit_code:
        raise RuntimeError(f"{arguments[0]} failed: {done.output[-2000:]}")


@one_blas_thread
def main() -> None:
    """Print the page, or renew it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="renew the page")
    asked = parser.parse_args()
    world = World(size=SIZE, seed=SEED, off=OFF)
    with tempfile.TemporaryDirectory() as name:
        rows = [row(product, world, Path(name)) for product in products(world, Path(name))]
    put("hyperspectral", INTRODUCTION + "\n".join(rows) + "\n", write=asked.write)
    sys.stdout.flush()


if __name__ == "__main__":
    main()
