"""One bright pixel lands where it belongs when GDAL warps by what termsel writes."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.data.features import FeatureSet, Points
from termsel.formats.writers.grids import GcpGridVrt, GeolocationVrt
from termsel.formats.writers.rpcs import Rpb, RpcTxt, RpcVrt
from termsel.formats.writers.selections import GcpVrt
from termsel.results.result import Result

rasterio = pytest.importorskip("rasterio")
from affine import Affine  # noqa: E402
from rasterio.warp import reproject  # noqa: E402

SIZE = 60, 80
BRIGHT = 23, 41
PIXEL = 1e-4  # degrees


@pytest.fixture(scope="module")
def north_up() -> Result:
    """An image whose pixels are squares of 1e-4 degrees, the first centred on 10 E, 50 N."""
    lines, samples = np.meshgrid(np.linspace(0.0, 59.0, 7), np.linspace(0.0, 79.0, 8))
    image = np.column_stack([lines.ravel(), samples.ravel()])
    heights = 100.0 + 50.0 * np.cos(np.arange(len(image)))
    ground = np.column_stack([10.0 + PIXEL * image[:, 1], 50.0 - PIXEL * image[:, 0], heights])
    points = Points(tuple(f"g{i}" for i in range(len(image))), image, ground,
                    roles=("control", "check", "control", "independent") * 14)
    return termsel.run("rfm-terms", features=FeatureSet(points, crs="EPSG:4979", image_size=SIZE),
                       model="affine", solver="all-terms")


@pytest.fixture
def image(tmp_path: Path) -> Path:
    pixels = np.zeros((1, *SIZE), dtype=np.uint8)
    pixels[0, BRIGHT[0], BRIGHT[1]] = 200
    path = tmp_path / "scene.tif"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(path, "w", driver="GTiff", width=SIZE[1], height=SIZE[0], count=1,
                           dtype="uint8") as raster:
            raster.write(pixels)
    return path


def _warped(path: Path, **options: object) -> np.ndarray:
    """Return what GDAL makes of an image on a grid of its own pixels, one pixel further out."""
    pixels = np.zeros((SIZE[0] + 2, SIZE[1] + 2), dtype=np.uint8)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(path) as source:
            reproject(rasterio.band(source, 1), pixels, dst_crs="EPSG:4326", dst_transform=Affine(
                PIXEL, 0.0, 10.0 - 1.5 * PIXEL, 0.0, -PIXEL, 50.0 + 1.5 * PIXEL), **options)
    return pixels


def _centre(pixels: np.ndarray) -> tuple[float, float]:
    """Return the centre of gravity of the brightness as line and sample of the image."""
    weight = pixels.astype(float)
    lines, samples = np.indices(pixels.shape) - 1
    return (float((weight * lines).sum() / weight.sum()),
            float((weight * samples).sum() / weight.sum()))


@pytest.mark.parametrize("resampling", ["nearest", "bilinear"])
@pytest.mark.parametrize(("writer", "name"), [
    (RpcVrt, "scene_rpc.vrt"), (Rpb, "scene.RPB"), (RpcTxt, "scene_RPC.TXT"),
    (GcpVrt, "scene_gcps.vrt"), (GcpGridVrt, "scene_grid.vrt"),
    (GeolocationVrt, "scene_geolocation.vrt")])
def test_bright_pixel(writer: type[termsel.Writer], name: str, resampling: str, image: Path,
                      north_up: Result, tmp_path: Path) -> None:
    writer(image=str(image)).write(north_up, tmp_path / name)
    options = {"RPC_HEIGHT": 100} if "rpc" in name.lower() or "RPB" in name else {}
    source = image if name in ("scene.RPB", "scene_RPC.TXT") else tmp_path / name
    warped = _warped(source, resampling=rasterio.enums.Resampling[resampling], **options)
    line, sample = _centre(warped)
    if resampling == "nearest":
        assert (line, sample) == BRIGHT
        assert warped.max() == 200
        assert np.count_nonzero(warped) == 1
    else:
        assert abs(line - BRIGHT[0]) < 0.05
        assert abs(sample - BRIGHT[1]) < 0.05


@pytest.mark.parametrize("step", [2, 5])
def test_bright_pixel_by_an_array_with_larger_steps(step: int, image: Path, north_up: Result,
                                                    tmp_path: Path) -> None:
    # GDAL takes the places of an array for corners or for middles of its cells.
    GeolocationVrt(image=str(image), step=step).write(north_up, tmp_path / "scene.vrt")
    line, sample = _centre(_warped(tmp_path / "scene.vrt",
                                   resampling=rasterio.enums.Resampling.bilinear))
    assert abs(line - BRIGHT[0]) < 0.05
    assert abs(sample - BRIGHT[1]) < 0.05
