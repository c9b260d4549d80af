"""Messages say where images, maps and DEMs are, in degrees."""

from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from termsel import TermselError
from termsel_match.images.positions import middle_in_words, require_same_area


def raster(path: Path, west: float, north: float, crs: str = "EPSG:4326", pixel: float = 0.1,
           ) -> Path:
    with rasterio.open(path, "w", driver="GTiff", width=10, height=10, count=1, dtype="uint8",
                       crs=crs, transform=from_origin(west, north, pixel, pixel)) as written:
        written.write(np.ones((1, 10, 10), dtype=np.uint8))
    return path


def test_places_are_said_in_degrees_whatever_their_crs() -> None:
    assert middle_in_words(np.array([[500000.0, 0.0]]), "EPSG:32631") == "0.000 N, 3.000 E"
    assert middle_in_words(np.array([[-70.5, -33.25]]), "EPSG:4326") == "33.250 S, 70.500 W"


def test_a_reference_and_a_dem_of_two_places_are_refused(tmp_path: Path) -> None:
    reference = raster(tmp_path / "ortho.tif", 14.0, 48.0)
    require_same_area([reference], None)
    require_same_area([reference], raster(tmp_path / "near.tif", 14.5, 47.5))
    with pytest.raises(TermselError, match=r"ortho.tif \(47.500 N, 14.500 E\) and the DEM "
                                           r"far.tif \(34.500 N, 48.500 E\) do not overlap"):
        require_same_area([reference], raster(tmp_path / "far.tif", 48.0, 35.0))


def test_a_reference_about_a_pole_shows_what_lies_near_it(tmp_path: Path) -> None:
    polar = tmp_path / "polar.tif"
    with rasterio.open(polar, "w", driver="GTiff", width=10, height=10, count=1, dtype="uint8",
                       crs="EPSG:3413", transform=from_origin(-1e6, 1e6, 2e5, 2e5)) as written:
        written.write(np.ones((1, 10, 10), dtype=np.uint8))
    require_same_area([polar], raster(tmp_path / "north.tif", 20.0, 88.0))


def test_longitudes_may_be_counted_from_zero(tmp_path: Path) -> None:
    reference = raster(tmp_path / "ortho.tif", -70.5, -33.0)
    require_same_area([reference], raster(tmp_path / "dem.tif", 289.0, -33.2))
