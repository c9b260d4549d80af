"""A map given as the image in which features were measured is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from termsel.data.features import FeatureSet, Points
from termsel.data.georeferenced import warn_of_incomplete, warn_of_map
from termsel.simulate.example import SENSOR, SIZE, ground_of_corners

rasterio = pytest.importorskip("rasterio")

GROUND = np.asarray(ground_of_corners())


def measured(image: np.ndarray, crs: str = "EPSG:4979") -> FeatureSet:
    return FeatureSet(Points(tuple(map(str, range(len(image)))), image, GROUND), crs=crs)


@pytest.fixture
def map_image(tmp_path: Path) -> Path:
    """A map with the bounds of the example's control."""
    west, south = GROUND[:, :2].min(axis=0)
    east, north = GROUND[:, :2].max(axis=0)
    path = tmp_path / "map.tif"
    transform = rasterio.transform.from_bounds(west - 0.01, south - 0.01, east + 0.01, north + 0.01,
                                               SIZE[1], SIZE[0])
    with rasterio.open(path, "w", driver="GTiff", width=SIZE[1], height=SIZE[0], count=1,
                       dtype="uint8", crs="EPSG:4326", transform=transform):
        pass
    return path


def test_a_map_that_shows_the_points_elsewhere_is_named(
        map_image: Path, caplog: pytest.LogCaptureFixture) -> None:
    warn_of_map(measured(SENSOR.project(GROUND)), map_image)
    assert "map.tif is georeferenced, and shows the points" in caplog.text
    assert "give the image in its place" in caplog.text


def test_points_measured_in_the_map_say_nothing(
        map_image: Path, caplog: pytest.LogCaptureFixture) -> None:
    with rasterio.open(map_image) as raster:
        samples, lines = ~raster.transform @ (GROUND[:, 0], GROUND[:, 1])
    image = np.column_stack([lines, samples]) - 0.5
    warn_of_map(measured(image + 5.0), map_image)
    warn_of_map(measured(SENSOR.project(GROUND), crs="local"), map_image)
    assert not caplog.messages


def test_an_image_without_georeferencing_says_nothing(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "image.tif"
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning), \
            rasterio.open(path, "w", driver="GTiff", width=600, height=500, count=1, dtype="uint8"):
        pass
    features = measured(SENSOR.project(GROUND))
    warn_of_map(replace(features, image_size=SIZE), path)
    assert not caplog.messages


@pytest.mark.parametrize(("bands", "interleave"), [(1, "band"), (3, "pixel"), (3, "band")])
def test_an_image_that_broke_off_is_warned_of(bands: int, interleave: str, tmp_path: Path,
                                              caplog: pytest.LogCaptureFixture) -> None:
    whole = tmp_path / "whole.tif"
    noise = np.random.default_rng(1).integers(0, 255, (bands, 64, 64), dtype=np.uint8)
    with rasterio.open(whole, "w", driver="GTiff", width=64, height=64, count=bands, dtype="uint8",
                       blockysize=8, interleave=interleave) as raster:
        raster.write(noise)
    broken = tmp_path / "broken.tif"
    broken.write_bytes(whole.read_bytes()[:-1500])
    warn_of_incomplete(whole)
    assert not caplog.messages
    warn_of_incomplete(broken)
    assert "broken.tif is incomplete or damaged: its size is used" in caplog.text
