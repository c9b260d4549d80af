"""Maps by models that are no RPCs: each pixel shows the image where the model sees its ground."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import termsel
from termsel import FeatureSet, Points
from termsel.formats.heights import open_dem
from termsel.io.resampling import ImageWindow, resample_pixels

rasterio = pytest.importorskip("rasterio")

from rasterio.transform import from_origin  # noqa: E402

FloatArray = NDArray[np.float64]
CRS = "EPSG:32633"
SIZE = 700, 800


def control(jump: float = 0.0, count: int = 60) -> FeatureSet:
    """Return control of a view over relief that no cubic follows."""
    rng = np.random.default_rng(3)
    ground = np.column_stack([rng.uniform(400000.0, 408000.0, count),
                              rng.uniform(5.000e6, 5.007e6, count), rng.uniform(0, 900.0, count)])
    x, y, z = ((ground - [404000.0, 5.0035e6, 450.0]) / [4000.0, 3500.0, 450.0]).T
    line = 350.0 - 310.0 * y + 20.0 * x * y + 4.0 * z + jump * np.sin(4.0 * x)
    sample = 400.0 + 360.0 * x + 12.0 * z * (1.0 - 0.3 * x) + jump * np.cos(4.0 * y + x)
    return FeatureSet(Points(tuple(f"P{i}" for i in range(count)), np.column_stack([line, sample]),
                             ground), crs=CRS, image_size=SIZE)


def image_of_positions(path: Path) -> Path:
    """Write an image whose bands are its own lines and samples."""
    lines, samples = np.indices(SIZE).astype(np.float32)
    with rasterio.open(path, "w", driver="GTiff", height=SIZE[0], width=SIZE[1], count=2,
                       dtype="float32") as raster:
        raster.write(np.stack([lines, samples]))
    return path


def relief(path: Path, crs: str = CRS) -> Path:
    """Write rough heights, in the CRS of the map or in degrees."""
    if crs == CRS:
        grid = from_origin(399000.0, 5.008e6, 45.0, 45.0)
        shape = 200, 230
    else:
        grid = from_origin(13.70, 45.24, 0.0006, 0.0004)
        shape = 330, 280
    y, x = np.indices(shape)
    heights = 450.0 + 300.0 * np.sin(x / 9.0) * np.cos(y / 11.0) + 60.0 * np.sin(x * 1.7 + y)
    with rasterio.open(path, "w", driver="GTiff", height=shape[0], width=shape[1], count=1,
                       dtype="float32", crs=crs, transform=grid) as raster:
        raster.write(heights.astype(np.float32), 1)
    return path


@pytest.mark.slow_cases("metres")
@pytest.mark.parametrize("crs", [CRS, "EPSG:4326"], ids=["metres", "degrees"])
def test_each_pixel_shows_the_image_at_its_own_ground(crs: str, tmp_path: Path) -> None:
    result = termsel.run(features=control(jump=6.0))
    assert result.strategy is not None
    assert result.strategy.chosen == "field"
    dem = relief(tmp_path / "dem.tif", crs)
    termsel.rectify(result, image_of_positions(tmp_path / "image.tif"), tmp_path / "map.tif",
                    dem=dem, crs=CRS)
    _require_own_ground(result, tmp_path / "map.tif", dem)


def _require_own_ground(result: termsel.Result, path: Path, dem: Path) -> None:
    """Require positions on a map to be those of the model, within 0.05 px."""
    with rasterio.open(path) as raster:
        shown = raster.read(masked=True)
        lines, samples = np.indices(raster.shape)
        x, y = raster.transform @ (samples.ravel() + 0.5, lines.ravel() + 0.5)
    with open_dem(dem, CRS) as surface:
        heights = surface(np.column_stack([x, y]))
    exact = result.project(np.column_stack([x, y, heights]))
    there = ~np.ma.getmaskarray(shown).any(axis=0).ravel()
    inside = ((exact > 0.5) & (exact < np.array(SIZE) - 1.5)).all(axis=1)
    assert (there | ~inside).mean() > 0.999
    both = there & inside
    assert both.sum() > 0.5 * SIZE[0] * SIZE[1]
    away = np.linalg.norm(shown.reshape(2, -1).T[both] - exact[both], axis=1)
    assert away.max() < 0.05


@pytest.mark.parametrize("resampling", ["nearest", "bilinear", "cubic", "cubic_spline", "lanczos",
                                        "average"])
@pytest.mark.parametrize("step", [1.0, 3.0])
def test_resampling_is_that_of_gdal(resampling: str, step: float) -> None:
    """On an unrotated grid GDAL's warper does the same."""
    from rasterio.enums import Resampling
    from rasterio.warp import reproject

    rng = np.random.default_rng(0)
    pixels = rng.uniform(0.0, 200.0, (1, 90, 120)).astype(np.float32)
    shape = int(80 / step), int(100 / step)
    first = 4.3, 5.6
    made = np.zeros((1, *shape), dtype=np.float32)
    reproject(pixels, made, src_transform=from_origin(5e5, 5e6, 1.0, 1.0), src_crs=CRS,
              dst_transform=from_origin(5e5 + first[1], 5e6 - first[0], step, step), dst_crs=CRS,
              resampling=Resampling[resampling])
    lines, samples = np.indices(shape)
    # The centre of a pixel of the map, in pixels of the image from the centre of the first one.
    positions = np.stack([first[0] + (lines + 0.5) * step, first[1] + (samples + 0.5) * step],
                         axis=-1) - 0.5
    mine, shown = resample_pixels(ImageWindow(pixels, np.ones(pixels.shape, dtype=bool), 0, 0),
                                  positions,
                                  resampling, (90, 120), np.zeros(1))
    inner = (slice(None), slice(4, -4), slice(4, -4))
    assert shown[inner].all()
    assert np.abs(mine - made)[inner].max() < 1e-3


def test_pixels_without_data_take_no_part_in_means() -> None:
    pixels = np.full((1, 20, 20), 10, dtype=np.uint8)
    pixels[0, :, 10:] = 200
    known = pixels != 200
    lines, samples = np.indices((10, 20))
    positions = np.stack([lines + 3.4, samples - 0.3], axis=-1)
    for resampling in ("bilinear", "cubic", "lanczos", "average"):
        values, shown = resample_pixels(ImageWindow(pixels, known, 0, 0), positions, resampling,
                                        (20, 20),
                                        np.zeros(1))
        assert set(values[shown].tolist()) == {10}
        assert not shown[0, :, 11:].any()
        assert not shown[0, positions[..., 1] < -0.5].any()


def test_complex_pixels_keep_both_parts() -> None:
    pixels = (np.arange(100.0).reshape(1, 10, 10) * (1 + 2j)).astype(np.complex64)
    positions = np.stack(np.meshgrid([2.5, 3.5], [4.25, 5.0], indexing="ij"), axis=-1)
    window = ImageWindow(pixels, np.ones(pixels.shape, dtype=bool), 0, 0)
    values, shown = resample_pixels(window, positions, "bilinear", (10, 10), np.zeros(1))
    assert shown.all()
    np.testing.assert_allclose(values[0], (1 + 2j) * (10 * positions[..., 0] + positions[..., 1]),
                               rtol=1e-6)
