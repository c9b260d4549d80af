"""What is not matched, and references of many files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("termsel_match", reason="termsel-match is not installed: "
                    "pip install -e plugins/termsel-match")

import rasterio
import shapely
from pyogrio.raw import write
from rasterio.windows import Window

from termsel import TermselError
from termsel_match import commands
from termsel_match.images.masks import NONE, open_masked, otsu_threshold, warn_of_idle_masks
from termsel_match.points.candidates import match_points as match

pytestmark = pytest.mark.filterwarnings("ignore:Dataset has no geotransform",
                                        "ignore:The given matrix")


def polygons(path: Path, shapes: list[Any], crs: str | None) -> Path:
    write(path, shapely.to_wkb(np.array(shapes)), [np.arange(len(shapes))], fields=["n"],
          geometry_type="Polygon", crs=crs)
    return path


@pytest.mark.slow
def test_nothing_is_matched_in_polygons(place: Any, tmp_path: Path) -> None:
    left = shapely.box(0, 0, 250, 500)
    in_px = polygons(tmp_path / "px.gpkg", [left], None)
    down = polygons(tmp_path / "down.gpkg", [shapely.affinity.scale(left, 1, -1, origin=(0, 0))],
                    None)
    west, north = place.world.corner
    middle = west + place.world.side / 2
    ground = polygons(tmp_path / "ground.gpkg", [
        shapely.box(west, north - place.world.side, middle, north)], "EPSG:32633")
    for mask in (in_px, down):
        with open_masked(place / "image.tif", None, [mask]) as picture:
            known = picture.read(0, 0, 500, 500, 2)[1]
        assert not known[:, :125].any()
        assert known[:, 126:].all()
    found = match(place / "image.tif", place / "ortho.tif", dem=place / "dem.tif", count=40,
                  masks=[ground])
    assert (found.points.ground[:, 0] > middle - 2).all()
    assert len(found.points) >= 8


def test_geojson_may_be_in_px_though_it_always_has_a_crs(place: Any, says: Any,
                                                         tmp_path: Path) -> None:
    in_px = polygons(tmp_path / "px.geojson", [shapely.box(100, 0, 500, 500)], None)
    with open_masked(place / "image.tif", None, [in_px]) as picture:
        known = picture.read(0, 0, 500, 500, 2)[1]
    assert known[:, :49].all()
    assert not known[:, 51:].any()
    nowhere = polygons(tmp_path / "nowhere.gpkg", [shapely.box(104, 0, 106, 1)], "EPSG:4326")
    code, text = says("match-points", place / "image.tif", "--reference", place / "ortho.tif",
                      "--mask", nowhere, "-o", tmp_path / "c.csv")
    assert code == 2
    assert "cannot be converted to the CRS of the reference" in text


def test_a_mask_that_touches_nothing_is_told(place: Any, tmp_path: Path,
                                             caplog: pytest.LogCaptureFixture) -> None:
    """Px near the first corner are read as degrees of GeoJSON."""
    corner, far = shapely.box(60, 10, 80, 30), shapely.box(900, 900, 950, 950)
    west, north = place.world.corner
    there = shapely.box(west - 50, north - 50, west + 50, north + 50)
    files = [place / "ortho.tif"]
    for name, shape, crs, said in (
            ("near.geojson", corner, None, "GeoPackage without a CRS"),
            ("far.gpkg", far, None, "px of the image"), ("px.gpkg", corner, None, ""),
            ("utm.gpkg", there, "EPSG:32633", ""), ("off.gpkg", far, "EPSG:32633", "reference")):
        caplog.clear()
        mask = polygons(tmp_path / name, [shape], crs)
        warn_of_idle_masks([NONE, mask], [place / "image.tif"], files)
        assert (str(mask) in caplog.text) == bool(said)
        assert said in caplog.text
    with pytest.raises(TermselError, match="candidates"):
        match(place / "image.tif", place / "ortho.tif", count=20, seconds=0.0,
              masks=[tmp_path / "far.gpkg"])
    assert "far.gpkg hides nothing" in caplog.text


def test_a_mask_that_is_none_is_refused(place: Any, says: Any, tmp_path: Path) -> None:
    for mask, said in ((place / "roads.gpkg", "has no polygons"),
                       (tmp_path / "missing.gpkg", "missing.gpkg"),
                       (place / "image.RPB", "image.RPB")):
        code, text = says("match-points", place / "image.tif", "--reference", place / "ortho.tif",
                          "--mask", mask, "-o", tmp_path / "c.csv")
        assert code == 2
        assert said in text


def scene(path: Path, water: bool, cloud: bool) -> Path:
    """Write blue, green, red and near infrared of fields, with a lake and a cloud."""
    rng = np.random.default_rng(0)
    fields = rng.uniform(0.7, 1.3, (8, 8)).repeat(50, 0).repeat(50, 1)
    bands = np.stack([level * fields for level in (300, 400, 350, 900)])
    if water:
        bands[:, 250:, :200] = np.array([250, 200, 120, 40])[:, None, None]
    if cloud:
        bands[:, :150, 250:] = np.array([1500, 1520, 1480, 1600])[:, None, None]
    bands += rng.normal(0, 15, bands.shape)
    with rasterio.open(path, "w", driver="GTiff", width=400, height=400, count=4,
                       dtype="uint16") as raster:
        raster.write(np.clip(bands, 1, 2047).astype(np.uint16))
    return path


@pytest.mark.parametrize(("water", "cloud"), [(True, True), (False, True), (True, False),
                                              (False, False)])
def test_bands_tell_clouds_and_water(tmp_path: Path, water: bool, cloud: bool) -> None:
    path = scene(tmp_path / "scene.tif", water, cloud)
    with open_masked(path, None, ()) as picture:
        known = picture.read(0, 0, 400, 400)[1]
        half = picture.read(0, 0, 400, 400, 2)[1]
    for seen, step in ((known, 1), (half, 2)):
        lake, sky, land = (seen[rows, columns].mean() for rows, columns in (
            (slice(260 // step, None), slice(0, 190 // step)),
            (slice(0, 140 // step), slice(260 // step, None)),
            (slice(0, 230 // step), slice(0, 230 // step))))
        assert (lake < 0.01) == water
        assert (sky < 0.01) == cloud
        assert land == 1.0
    with open_masked(path, None, [NONE]) as picture:
        assert picture.read(0, 0, 400, 400)[1].all()


def test_areas_of_zeros_are_no_data_unless_the_file_says_otherwise(tmp_path: Path) -> None:
    pixels = np.full((1, 100, 100), 50, dtype=np.uint8)
    pixels[0, :, :40] = 0
    pixels[0, 70, 70] = 0  # a dark pixel
    for nodata, empty in ((None, True), (255, False)):
        with rasterio.open(tmp_path / "a.tif", "w", driver="GTiff", width=100, height=100, count=1,
                           dtype="uint8", nodata=nodata) as raster:
            raster.write(pixels)
        with open_masked(tmp_path / "a.tif", None, ()) as picture:
            known = picture.read(0, 0, 100, 100)[1]
        assert known[:, 40:].all()
        assert known[:, :40].any() != empty


def test_otsu_divides_two_classes() -> None:
    rng = np.random.default_rng(1)
    limit, apart = otsu_threshold(np.concatenate([rng.normal(0, 1, 900), rng.normal(20, 1, 100)]))
    assert 3 < limit < 17
    assert apart > 0.9
    assert otsu_threshold(rng.normal(0, 1, 1000))[1] < 0.75


@pytest.mark.slow
def test_chips_and_tiles_are_a_reference(place: Any, says: Any, tmp_path: Path) -> None:
    folder = tmp_path / "chips"
    folder.mkdir()
    with rasterio.open(place / "ortho.tif") as raster:
        size = raster.width
        for n, (row, column) in enumerate([(100, 100), (100, size - 260), (size - 260, 100),
                                           (size - 260, size - 260), (250, 250)]):
            window = Window(column, row, 160, 160)
            profile = raster.profile | {
                "width": 160, "height": 160, "transform": raster.window_transform(window),
                "tiled": False}
            profile.pop("blockxsize"), profile.pop("blockysize")
            with rasterio.open(folder / f"chip{n}.tif", "w", **profile) as chip:
                chip.write(raster.read(window=window))
    (folder / "notes.txt").write_text("where they are from")
    code, text = says("auto-georeference", place / "image.tif", "--reference", folder, "--dem",
                      place / "dem.tif", "--count", 400, "-o", tmp_path / "map.tif", "--out",
                      tmp_path / "out", "--quiet")
    assert code == 0, text
    assert (tmp_path / "out" / "residuals.png").read_bytes()[:4] == b"\x89PNG"
    from termsel import read_result

    result = read_result(tmp_path / "out" / "result")
    independent = place.world.independent()
    away = result.project(independent.ground) - independent.image
    assert np.sqrt((away**2).sum(axis=1).mean()) < 0.5
    for chip in folder.glob("*.tif"):
        chip.unlink()
    with pytest.raises(TermselError, match="has no image"):
        match(place / "image.tif", folder, dem=place / "dem.tif")


@pytest.mark.slow
def test_time_ends_the_matching_with_what_there_is(place: Any, monkeypatch: pytest.MonkeyPatch,
                                                   ) -> None:
    from termsel_match.points import cells

    calls = iter(range(1000))
    # Each look at the clock takes a second: three of four blocks are looked at.
    monkeypatch.setattr(cells, "monotonic", lambda: 1e12 * (next(calls) > 2))
    found = match(place / "image.tif", place / "ortho.tif", dem=place / "dem.tif", count=60,
                  seconds=100)
    assert len(found.points) >= 8
    assert found.cells["no time"] > 0
    monkeypatch.setattr(cells, "monotonic", lambda: 1e12)
    with pytest.raises(TermselError, match="Give more --seconds"):
        match(place / "image.tif", place / "ortho.tif", dem=place / "dem.tif", seconds=1)


def test_progress_without_a_terminal_is_a_line_every_ten_seconds(
        monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    now = [0.0]
    monkeypatch.setattr(commands, "monotonic", lambda: now[0])
    with commands.progress_bar("match", quiet=False) as tell:
        assert tell is not None
        for second in range(0, 25):
            now[0] = float(second)
            tell(second / 25)
    assert capsys.readouterr().err == "match: 40 %\nmatch: 80 %\n"
    with commands.progress_bar("match", quiet=True) as tell:
        assert tell is None
