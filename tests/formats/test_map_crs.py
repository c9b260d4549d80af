"""The CRS and the size of a map where nothing, or a number in the wrong unit, is said of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.io import map_grid as module
from termsel.io.rectify import rectify
from termsel.models.polynomial import Polynomial3D

rasterio = pytest.importorskip("rasterio")
pyproj = pytest.importorskip("pyproj")

SIZE = 300, 400


def scene(crs: str, lon: float, lat: float, size: tuple[int, int] = SIZE, gsd: float = 2.0,
          ) -> termsel.Result:
    """Return an affine model of an image with north up, fitted to control in a CRS."""
    rng = np.random.default_rng(3)
    image = rng.uniform(0.0, np.array(size) - 1.0, (12, 2))
    east, north = (image[:, 1] - size[1] / 2) * gsd, -(image[:, 0] - size[0] / 2) * gsd
    ground = np.column_stack([lon + east / 111_320 / np.cos(np.radians(lat)), lat + north / 111_320,
                              rng.uniform(100.0, 120.0, 12)])
    turn = pyproj.Transformer.from_crs("EPSG:4979", crs, always_xy=True)
    points = termsel.Points(tuple(map(str, range(12))), image,
                            np.column_stack(turn.transform(*ground.T)))
    features = termsel.FeatureSet(points, crs=crs, image_size=size)
    return termsel.run("poly-terms", features=features, model=Polynomial3D(degree=1),
                       solver="all-terms", seed=1)


def picture(folder: Path, size: tuple[int, int] = SIZE) -> Path:
    path = folder / "scene.tif"
    with rasterio.open(path, "w", driver="GTiff", height=size[0], width=size[1], count=1,
                       dtype="uint8") as raster:
        raster.write(np.full(size, 100, dtype=np.uint8), 1)
    return path


def made(result: termsel.Result, folder: Path, size: tuple[int, int] = SIZE, **options: Any,
         ) -> tuple[int, tuple[int, int], float]:
    """Return the code of the CRS of a map, its shape and the size of its pixels."""
    rectify(result, picture(folder, size), folder / "map.tif", height=110.0, **options)
    with rasterio.open(folder / "map.tif") as raster:
        assert (raster.read(1) == 100).mean() > 0.4  # north is not up in every zone
        return raster.crs.to_epsg(), raster.shape, raster.res[0]


@pytest.mark.parametrize(("crs", "says"), [
    ("EPSG:32633", "EPSG:32633 is for the area from 0.0 N, 12.0 E to 84.0 N, 18.0 E, but the map "
                   "is at 34.8 N, 48.5 E: --crs EPSG:32639 is the zone of UTM there."),
    ("EPSG:32639", ""), ("EPSG:32638", ""), ("EPSG:3857", "")])
def test_a_map_far_outside_its_crs_is_told_the_zone(crs: str, says: str,
                                                    caplog: pytest.LogCaptureFixture) -> None:
    module.map_crs(scene("EPSG:4979", 48.5, 34.8), crs)
    assert says in caplog.text
    assert ("is for the area" in caplog.text) == bool(says)


@pytest.mark.parametrize(("crs", "lon", "lat", "expected"), [
    ("EPSG:4979", 11.0, 47.4, 32632), ("EPSG:4979", -70.0, -33.5, 32719),
    ("EPSG:4326", 179.99, -16.9, 32760), ("EPSG:2263", -74.0, 40.7, 32618)])
def test_control_that_is_not_in_metres_is_mapped_in_utm(
        crs: str, lon: float, lat: float, expected: int, tmp_path: Path,
        caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", logger="termsel"):
        code, shape, side = made(scene(crs, lon, lat), tmp_path)
    assert code == expected
    assert shape == pytest.approx(SIZE, rel=0.1)
    assert side == pytest.approx(2.0, rel=0.06)
    assert f" m in EPSG:{expected} (the zone of UTM, as the control is not in metres; " \
        "--crs names another), with all of the image." in caplog.text


@pytest.mark.parametrize(("crs", "lon", "lat"), [("EPSG:25832", 11.0, 47.4),
                                                 ("EPSG:3413", -45.0, 86.0)])
def test_control_in_metres_keeps_its_crs(crs: str, lon: float, lat: float, tmp_path: Path,
                                         caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", logger="termsel"):
        code, _, side = made(scene(crs, lon, lat), tmp_path)
    assert f"EPSG:{code}" == crs
    assert 1.5 < side < 2.5
    assert "UTM" not in caplog.text


def test_a_crs_that_is_named_is_taken(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", logger="termsel"):
        code, shape, _ = made(scene("EPSG:4979", 11.0, 47.4), tmp_path, crs="EPSG:4326")
    assert code == 4326
    assert min(shape) > 200
    assert "UTM" not in caplog.text


@pytest.mark.parametrize(("options", "lines", "unit", "right"), [
    ({"resolution": 10.0, "crs": "EPSG:4326"}, 2, "degrees", "1.8e-05"),  # metres are meant
    ({"resolution": 2e-5}, 30_000_000, "metres", "2"),                    # degrees are meant
    ({"resolution": 200.0}, 5, "metres", "2"),                            # centimetres
    ({"resolution": 0.01}, 60_000, "metres", "2")])
def test_a_map_in_the_wrong_unit_is_refused(options: dict[str, Any], lines: int, unit: str,
                                            right: str, tmp_path: Path) -> None:
    with pytest.raises(termsel.TermselError) as caught:
        made(scene("EPSG:4979", 11.0, 47.4), tmp_path, **options)
    text = str(caught.value)
    assert f"{unit} the map would have " in text
    shown = int(text.partition("would have ")[2].partition(" lines")[0])
    assert shown == pytest.approx(lines, rel=0.1, abs=1)
    assert f"units of the map, {unit}: a pixel of the image is {right} {unit}." in text
    assert not (tmp_path / "map.tif").exists()


def test_images_that_are_as_narrow_or_as_wide_as_that_are_mapped(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    narrow = (12, 400)
    _, shape, _ = made(scene("EPSG:25832", 11.0, 47.4, narrow), tmp_path, narrow)
    assert 12 <= shape[0] < 30
    monkeypatch.setattr(module, "_USUAL", (16, 350))  # as if 400 samples were too many
    _, shape, _ = made(scene("EPSG:25832", 11.0, 47.4), tmp_path, overwrite=True)
    assert shape[1] > 350
    monkeypatch.setattr(module, "_USUAL", (16, 450))
    with pytest.raises(termsel.TermselError, match=r"lines and 8\d\d samples"):
        made(scene("EPSG:25832", 11.0, 47.4), tmp_path, overwrite=True, resolution=1.0)


def test_an_image_of_which_single_places_are_known_has_no_map(
        monkeypatch: pytest.MonkeyPatch) -> None:
    outline = np.full((21, 21, 2), np.nan)
    outline[3, 4] = outline[9, 12] = 5e5, 5.2e6
    monkeypatch.setattr(module, "_outline_on_map", lambda *_: outline)
    with pytest.raises(termsel.TermselError, match="no ground position anywhere"):
        module.grid_of_image(scene("EPSG:25832", 11.0, 47.4), "EPSG:25832", dem=None, height=110.0)


def test_a_continent_is_not_put_into_one_zone_of_utm_without_a_word(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    wide = scene("EPSG:4979", 15.0, 48.0, gsd=8000.0)
    made(wide, tmp_path)
    said = [one for one in caplog.messages if "zone of UTM shows distances" in one]
    assert len(said) == 1
    assert "spans 36 degrees" in said[0]
    caplog.clear()
    made(scene("EPSG:4979", 15.0, 48.0), tmp_path, overwrite=True)
    made(wide, tmp_path, overwrite=True, crs="EPSG:3035")
    assert not [one for one in caplog.messages if "zone of UTM shows distances" in one]


@pytest.mark.parametrize(("lat", "expected"), [(-78.0, 3031), (86.0, 3413), (-84.0, 3031)])
def test_control_around_a_pole_is_mapped_in_a_polar_projection(
        lat: float, expected: int, tmp_path: Path) -> None:
    assert made(scene("EPSG:4979", 160.0, lat, gsd=1600.0), tmp_path)[0] == expected


@pytest.mark.slow_cases(
    "EPSG:26711-EPSG:26911--117.0-34.0-211.8", "EPSG:28355-EPSG:7855-147.0--36.0-1.5")
@pytest.mark.parametrize(("crs", "target", "lon", "lat", "moved"), [
    ("EPSG:28355", "EPSG:7855", 147.0, -36.0, 1.5), ("EPSG:7855", "EPSG:28355", 147.0, -36.0, 1.5),
    ("EPSG:26711", "EPSG:26911", -117.0, 34.0, 211.8),
    ("EPSG:32632", "EPSG:25832", 9.0, 48.0, 0.0)])
def test_a_map_in_another_datum_is_where_the_operation_between_the_two_puts_it(
        crs: str, target: str, lon: float, lat: float, moved: float, tmp_path: Path) -> None:
    size = 60, 80
    result = scene(crs, lon, lat, size=size, gsd=0.1)
    pixels = np.stack(np.indices(size), axis=-1).reshape(-1, 2)
    ground = result.locate(pixels, 110.0)[:, :2]
    middle = ground.mean(axis=0)
    path = tmp_path / "scene.tif"
    with rasterio.open(path, "w", driver="GTiff", height=size[0], width=size[1], count=2,
                       dtype="float32") as raster:
        raster.write((ground - middle).T.reshape(2, *size).astype("float32"))
    rectify(result, path, tmp_path / "map.tif", height=110.0, crs=target)
    with rasterio.open(tmp_path / "map.tif") as raster:
        row, column = (side // 2 for side in raster.shape)
        shown = raster.read()[:, row, column] + middle
        place = np.array(raster.xy(row, column))
    turn = pyproj.Transformer.from_crs(crs, target, always_xy=True, allow_ballpark=False)
    expected = np.array(turn.transform(*shown))
    assert np.linalg.norm(expected - shown) == pytest.approx(moved, abs=0.6)
    assert place == pytest.approx(expected, abs=0.02)


OLD_DATUMS = (("EPSG:27700", 400_000.0, 400_000.0), ("EPSG:26716", 400_000.0, 4_200_000.0),
              ("EPSG:31467", 3_500_000.0, 5_500_000.0), ("EPSG:27572", 600_000.0, 2_200_000.0))
"""CRSs whose ellipsoids slope against that of WGS84, and a place in each."""


def level_result(crs: str, east: float, north: float, pixel: float = 80.0) -> termsel.Result:
    """Return a similarity of points without heights, turned against the axes of the map."""
    rng = np.random.default_rng(3)
    image = rng.uniform(0.0, np.array(SIZE) - 1.0, (14, 2))
    points = termsel.Points(tuple(map(str, range(14))), image,
                            level_places(image, east, north, pixel))
    return termsel.run(features=termsel.FeatureSet(points, crs=crs, image_size=SIZE),
                       model="helmert2d", solver="all-terms")


def level_places(image: np.ndarray, east: float, north: float, pixel: float) -> np.ndarray:
    line, sample = image.T
    return np.column_stack([east + pixel * sample + 3.0 * line, north - pixel * line + 3.0 * sample,
                            np.full(len(image), np.nan)])


@pytest.mark.parametrize(("crs", "east", "north"), OLD_DATUMS)
def test_a_map_of_level_control_in_an_old_datum_shows_a_mark_in_its_place(
        crs: str, east: float, north: float, tmp_path: Path) -> None:
    result = level_result(crs, east, north)
    pixels = np.full(SIZE, 100, dtype=np.uint8)
    pixels[147:152, 247:252] = 255
    with rasterio.open(tmp_path / "scene.tif", "w", driver="GTiff", height=SIZE[0], width=SIZE[1],
                       count=1, dtype="uint8") as raster:
        raster.write(pixels, 1)
    rectify(result, tmp_path / "scene.tif", tmp_path / "map.tif")
    x, y, _ = level_places(np.array([[149.0, 249.0]]), east, north, 80.0)[0]
    with rasterio.open(tmp_path / "map.tif") as raster:
        marked = np.argwhere(raster.read(1) > 200).mean(axis=0)
        assert np.abs(marked - np.array(raster.index(x, y))).max() < 1.0


@pytest.mark.parametrize(("crs", "east", "north"), OLD_DATUMS)
def test_an_rpc_of_level_control_ignores_heights_in_any_datum(crs: str, east: float, north: float,
                                                              ) -> None:
    rpc = termsel.rpc_of(level_result(crs, east, north).fit).rpc
    image = np.random.default_rng(4).uniform(0.0, np.array(SIZE) - 1.0, (50, 2))
    places = level_places(image, east, north, 80.0)
    turn = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    lon, lat = turn.transform(places[:, 0], places[:, 1])
    for height in (-100.0, 0.0, 3000.0):
        seen = rpc.project(np.column_stack([lon, lat, np.full(50, height)]))
        assert np.abs(seen - image).max() < 0.05
