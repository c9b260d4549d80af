"""Tiles of maps that lie askew in the CRS shown, pixel by pixel."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from termsel import TermselError
from termsel_app import rasters
from termsel_app.maps import MapRaster, open_maps
from termsel_app.rasters import TILE, Raster

rasterio = pytest.importorskip("rasterio")


@pytest.mark.parametrize(("angle", "first", "pixel"), [
    (0.0, (0.0, 0.0), 1.0), (17.0, (0.3, 0.8), 1.0), (-64.0, (31.7, 12.2), 0.06),
    (180.0, (0.5, 0.5), 0.4), (33.0, (5.1, 2.9), 2.0)])
def test_a_tile_shows_the_pixel_of_the_map_that_is_there(
        tmp_path: Path, angle: float, first: tuple[float, float], pixel: float) -> None:
    values = np.random.default_rng(3).integers(1, 255, (300, 400), dtype=np.uint8)
    values[0, :2] = 0, 255  # so that grey is shown as it is
    transform = rasterio.Affine.rotation(angle) @ rasterio.Affine.translation(40, 70)
    path = tmp_path / "askew.tif"
    with rasterio.open(path, "w", driver="GTiff", height=300, width=400, count=1, dtype="uint8",
                       crs="EPSG:32631", transform=transform) as dataset:
        dataset.write(values, 1)
    west, north = transform @ (200.0 + first[0], 150.0 + first[1])
    extent = TILE * pixel
    raster = MapRaster(path)
    tile = raster.tile((west, north - extent, west + extent, north), "EPSG:32631")
    raster.close()
    steps = (np.arange(TILE) + 0.5) * pixel
    columns, rows = ~transform @ (np.tile(west + steps, (TILE, 1)),
                                  np.tile(north - steps, (TILE, 1)).T)
    inside = (rows > 0) & (rows < 300) & (columns > 0) & (columns < 400)
    expected = values[rows[inside].astype(int), columns[inside].astype(int)]
    assert inside.any()
    np.testing.assert_array_equal(tile[inside][:, 0], expected)
    assert not tile[~inside].any()


@pytest.mark.parametrize("name", ["places.csv", "places.TXT", "places.xlsx"])
def test_a_table_given_as_a_map_is_told_how_to_become_one(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_text("name,x,y\nP1,455000,3850000\n")
    with pytest.raises(TermselError, match="--map takes rasters and vector layers") as refused:
        open_maps([str(path)], "EPSG:32639", remote=False)
    assert "QGIS saves a table as such a layer" in str(refused.value)


@pytest.fixture
def large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, np.ndarray]:
    """A raster that is large enough for an overview, in blocks of 16 lines, and its values."""
    monkeypatch.setattr(rasters, "LARGE", 64)
    monkeypatch.setattr(rasters, "OVERVIEW", 60)
    monkeypatch.setattr(rasters, "_STRIP", 40 * 320)
    values = np.random.default_rng(3).integers(0, 255, (403, 322), dtype=np.uint8)
    path = tmp_path / "large.tif"
    with rasterio.open(path, "w", driver="GTiff", height=403, width=322, count=1, dtype="uint8",
                       tiled=True, blockxsize=16, blockysize=16) as dataset:
        dataset.write(values, 1)
    return path, values


def end_of_reading() -> None:
    for thread in threading.enumerate():
        if thread.name.endswith("(_read_overview)"):
            thread.join()


def test_an_overview_has_the_line_in_the_middle_of_each_step(
        large: tuple[Path, np.ndarray]) -> None:
    """Strips end between blocks, steps of seven lines do not."""
    path, values = large
    raster = Raster(path)
    end_of_reading()
    assert raster.share_read == 1.0
    assert raster._overview is not None
    assert raster._overview.shape[:2] == (58, 46)
    np.testing.assert_array_equal(raster._overview[:56, :, 0], values[3:392:7, 3::7])
    raster.close()


def test_a_raster_that_is_closed_at_once_ends_its_reading(
        large: tuple[Path, np.ndarray], monkeypatch: pytest.MonkeyPatch) -> None:
    raised: list[object] = []
    monkeypatch.setattr(threading, "excepthook", raised.append)
    start = threading.Event()
    read = Raster._read_overview

    def read_late(raster: Raster) -> None:
        start.wait()
        read(raster)

    monkeypatch.setattr(Raster, "_read_overview", read_late)
    raster = Raster(large[0])
    raster.close()
    start.set()
    for thread in threading.enumerate():
        if thread.name.endswith("(read_late)"):
            thread.join()
    assert not raised
    assert raster.share_read == 0.0
