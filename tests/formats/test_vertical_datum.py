"""Heights that refer to different surfaces: converted by PROJ's grids, or refused by name."""

from __future__ import annotations

import logging
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.data.coordinates import crs as crs_module
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.data.rpc import Rpc
from termsel.formats.heights import open_dem, with_heights
from termsel.formats.vertical import require_grid
from termsel.io.project import project_table
from tests.geoid_grid import EGM96, write_geoid

rasterio = pytest.importorskip("rasterio")
pyproj = pytest.importorskip("pyproj")
from rasterio.transform import Affine, from_origin  # noqa: E402

needs_rpc = pytest.mark.skipif(find_spec("termsel_rpc") is None, reason="corrects the RPC")
pytestmark = pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")

WEST, NORTH, STEP = 9.0, 45.1, 0.001
GEOID = 48.5
LINEAR = (0.0, 1.0, *[0.0] * 18), (0.0, 0.0, 1.0, *[0.0] * 17)
ONE = (1.0, *[0.0] * 19)


@pytest.fixture
def geoid(tmp_path: Path) -> Iterator[None]:
    """Give PROJ a grid for EGM96."""
    folder = tmp_path / "proj"
    folder.mkdir()
    write_geoid(folder, EGM96, GEOID)
    before = pyproj.datadir.get_data_dir()
    pyproj.datadir.append_data_dir(str(folder))
    crs_module.transformation_between.cache_clear()
    yield
    pyproj.datadir.set_data_dir(before)
    crs_module.transformation_between.cache_clear()


def relief(x: FloatArray, y: FloatArray) -> FloatArray:
    return 400 + 900 * np.sin(60 * x) * np.cos(45 * y)


def dem(path: Path, *, crs: str = "EPSG:4326", above: float = 0.0, unit: float = 1.0,
        units: str = "", offset: float = 0.0, turn: float = 0.0,
        transform: Affine = from_origin(WEST, NORTH, STEP, STEP), **tags: str) -> Path:
    """Write heights of the relief, so much above it, in a unit, less an offset that is stated."""
    row, column = np.mgrid[:100, :100] + 0.5
    values = (relief(*(transform @ (column, row))) + above) / unit
    with rasterio.open(path, "w", driver="GTiff", width=100, height=100, count=1, dtype="float64",
                       crs=crs, transform=Affine.translation(turn, 0.0) @ transform) as raster:
        raster.write(values - offset, 1)
        raster.offsets = (offset,)
        raster.update_tags(**tags)
        if units:
            raster.units = (units,)
    return path


def test_a_dem_is_refused_where_rasterio_cannot_read_the_database_of_proj(tmp_path: Path) -> None:
    """GDAL then reads a CRS without its vertical part."""
    raster = dem(tmp_path / "above_geoid.tif", crs="EPSG:4326+5773")
    code = f"""from pathlib import Path
from termsel.core.errors import TermselError
from termsel.formats.heights import open_dem
try:
    with open_dem(Path({str(raster)!r}), "EPSG:4979"):
        pass
except TermselError as error:
    print(error)"""
    done = subprocess.run([sys.executable, "-c", code], text=True, capture_output=True,
                          check=True, env=os.environ | {"PROJ_DATA": str(tmp_path)})
    assert "rasterio cannot read PROJ's database" in done.stdout
    assert f"Unset PROJ_DATA={tmp_path}" in done.stdout


def camera() -> Rpc:
    """An RPC that height moves along the lines: 0.4 px for each metre."""
    line = (0.0, 0.0, -1.0, 0.2, *[0.0] * 16)
    return Rpc((1000.0, 1000.0), (1000.0, 1000.0), (9.05, 45.05, 400.0), (0.05, 0.05, 500.0),
               line, ONE, LINEAR[0], ONE, source="vendor.RPB")


def control(count: int = 12, *, sigma: float = 0.2) -> FeatureSet:
    """Points on the relief with ellipsoidal heights, as the RPC sees them but for a shift."""
    rng = np.random.default_rng(5)
    xy = np.column_stack([rng.uniform(9.01, 9.09, count), rng.uniform(45.01, 45.09, count)])
    ground = np.column_stack([xy, relief(*xy.T)])
    image = camera().project(ground) + np.array([6.0, -4.0])
    image += rng.normal(0.0, sigma, (count, 2))
    names = tuple(f"P{i}" for i in range(count))
    return FeatureSet(Points(names, image, ground), crs="EPSG:4979", rpc=camera())


def blank(features: FeatureSet, rows: slice = slice(None)) -> FeatureSet:
    ground = features.points.ground.copy()
    ground[rows, 2] = np.nan
    return features.with_(points=replace(features.points, ground=ground))


def noted(result: Any) -> str:
    return " ".join(" ".join([*result.notes, result.summary()]).split())


@pytest.mark.parametrize(("declared", "tags"), [
    ("EPSG:4326+5773", {}), ("EPSG:4326", {"VERTICAL_DATUM": "EGM96"}),
    ("EPSG:4326", {"DTED_VerticalDatum": "E96"}), ("EPSG:4326", {"vertical_crs": "EPSG:5773"}),
    ("EPSG:4326", {"GEOID_MODEL_REFERENCE": "EGM 96 geoid"})])
@pytest.mark.usefixtures("geoid")
def test_a_dem_above_a_geoid_gives_ellipsoidal_heights(tmp_path: Path, declared: str,
                                                       tags: dict[str, str]) -> None:
    path = dem(tmp_path / "dem.tif", crs=declared, above=-GEOID, **tags)
    expected = control()
    filled = with_heights(blank(expected), path)
    np.testing.assert_allclose(filled.points.ground[:, 2], expected.points.ground[:, 2], atol=0.8)
    assert "EGM96 height, converted to that of EPSG:4979" in filled.heights


@pytest.mark.parametrize("crs", ["EPSG:4979", "EPSG:4326"])
@pytest.mark.parametrize(("declared", "tags", "datum"), [
    ("EPSG:4326+5773", {}, "EGM96 height"),
    ("EPSG:4326+3855", {}, "EGM2008 height"),
    ("EPSG:4326", {"VERTICAL_DATUM": "EGM2008"}, "EGM2008 height"),
    ("EPSG:4326", {"altdatum": "North American Vertical Datum of 1988"}, "NAVD88 height"),
    ("EPSG:4326", {"VERT_DATUM": "DHHN2016"}, "DHHN2016 height")])
def test_without_the_grid_it_is_refused_by_name(tmp_path: Path, crs: str, declared: str,
                                                tags: dict[str, str], datum: str) -> None:
    path = dem(tmp_path / "dem.tif", crs=declared, **tags)
    with pytest.raises(TermselError, match=datum) as caught, open_dem(path, crs):
        pass
    assert str(path) in str(caught.value)
    assert len(str(caught.value)) < 900
    assert ("If the control has the same heights" in str(caught.value)) == (crs == "EPSG:4326")


def test_a_datum_that_nobody_knows_is_refused(tmp_path: Path) -> None:
    path = dem(tmp_path / "dem.tif", VERTICAL_DATUM="Harbour gauge of Utopia")
    with pytest.raises(TermselError, match="Harbour gauge of Utopia"), open_dem(path, "EPSG:4979"):
        pass


@pytest.mark.parametrize("tags", [
    {"VERTICAL_DATUM": "WGS 84 ellipsoid"}, {"VERTICAL_DATUM": "unknown"},
    {"VERTICAL_ACCURACY": "4.1"}, {"TIFFTAG_DATETIME": "2020"}, {"DATUM": "WGS84"}])
def test_tags_of_something_else_change_nothing(tmp_path: Path, tags: dict[str, str]) -> None:
    path = dem(tmp_path / "dem.tif", **tags)
    with open_dem(path, "EPSG:4979") as surface:
        assert surface.is_as_stored
        np.testing.assert_allclose(surface(np.array([[9.05, 45.05]])), relief(9.05, 45.05),
                                   atol=1.0)


def test_heights_of_one_geoid_need_no_grid(tmp_path: Path) -> None:
    path = dem(tmp_path / "dem.tif", crs="EPSG:4326+5773")
    with open_dem(path, "EPSG:4326+5773") as surface:
        assert surface.is_as_stored


@pytest.mark.parametrize(("units", "size"), [
    ("ft", 0.3048), ("foot", 0.3048), ("US survey foot", 1200 / 3937), ("us-ft", 1200 / 3937),
    ("metre", 1.0), ("m", 1.0)])
@pytest.mark.parametrize("crs", ["EPSG:4979", "EPSG:4326"])
def test_a_dem_in_feet_gives_metres(tmp_path: Path, units: str, size: float, crs: str) -> None:
    path = dem(tmp_path / "dem.tif", unit=size, units=units)
    with open_dem(path, crs) as surface, open_dem(dem(tmp_path / "m.tif"), crs) as metres:
        place = np.array([[9.05, 45.05], [9.02, 45.07]])
        np.testing.assert_allclose(surface(place), metres(place), rtol=1e-6)


def test_units_that_are_unclear_are_refused(tmp_path: Path) -> None:
    cases = [("EPSG:4326", "fathom", "is in fathom"),
             ("EPSG:2263", "", "in metres or, like x and y, in US survey feet"),
             ("EPSG:2263+6360", "m", "in metres, and the heights of its CRS are in US survey")]
    for crs, units, words in cases:
        path = dem(tmp_path / "dem.tif", crs=crs, units=units)
        with pytest.raises(TermselError, match=words), open_dem(path, "EPSG:4979"):
            pass


@needs_rpc
def test_an_rpc_from_such_heights_is_right_for_ellipsoidal_users(tmp_path: Path,
                                                                 geoid: None) -> None:
    path = dem(tmp_path / "dem.tif", crs="EPSG:4326+5773", above=-GEOID)
    expected = control(200, sigma=0.0)
    result = termsel.run(features=with_heights(blank(control(5)), path))
    termsel.export(result, "rpb", tmp_path / "refined.RPB")
    errors = termsel.read_rpc(tmp_path / "refined.RPB").project(expected.points.ground) \
        - expected.points.image
    assert np.sqrt((errors**2).sum(axis=1).mean()) < 0.5


@needs_rpc
@pytest.mark.usefixtures("geoid")
def test_control_above_a_geoid_is_converted_for_an_rpc(tmp_path: Path) -> None:
    features, expected = control(5), control(200, sigma=0.0)
    ground = features.points.ground - [0.0, 0.0, GEOID]
    result = termsel.run(features=replace(
        features, crs="EPSG:4326+5773", points=replace(features.points, ground=ground)))
    termsel.export(result, "rpb", tmp_path / "refined.RPB")
    errors = termsel.read_rpc(tmp_path / "refined.RPB").project(expected.points.ground) \
        - expected.points.image
    assert np.sqrt((errors**2).sum(axis=1).mean()) < 0.5


def test_a_grid_that_cannot_be_fetched_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """PROJ gives infinity for a grid that it may fetch from the network, and cannot."""
    monkeypatch.setattr("pyproj.network.is_network_enabled", lambda: True)
    with pytest.raises(TermselError, match="could not be fetched"):
        require_grid(lambda ground: ground[:, 2] * np.nan, (14.7, 46.8), Path("dem.tif"))
    require_grid(lambda ground: ground[:, 2] + 47.0, (14.7, 46.8), Path("dem.tif"))


def test_without_the_grid_a_run_with_an_rpc_ends() -> None:
    with pytest.raises(TermselError, match="the RPC takes ellipsoidal heights") as caught:
        termsel.run(features=replace(control(6), crs="EPSG:4326+5773"))
    assert "pyproj sync" in str(caught.value)


@needs_rpc
def test_an_rpc_that_is_not_used_is_said_in_the_first_lines() -> None:
    result = termsel.run(features=blank(control(12)))
    opening = " ".join(result.summary().split())
    assert "The RPC is not used: it needs ellipsoidal heights, and P" in opening


@needs_rpc
@pytest.mark.parametrize("above", [-48.6, 48.6, 20.0])
def test_a_run_says_that_a_dem_contradicts_the_surveyed_heights(tmp_path: Path, above: float,
                                                                ) -> None:
    path = dem(tmp_path / "dem.tif", above=above)
    result = termsel.run(features=with_heights(blank(control(4), slice(0, 2)), path))
    said = noted(result)
    side = "above" if above > 0 else "below"
    assert f"m {side} the control (median of 2 heights" in said
    assert "px on a map; geoid and ellipsoid?" in said
    assert re.search(f"Caution the DEM is [0-9.]+ m {side} the control: [0-9.]+ px on a map; geoid "
                     r"and ellipsoid\?", said)


@needs_rpc
def test_a_run_keeps_silent_of_a_dem_that_agrees(tmp_path: Path) -> None:
    path = dem(tmp_path / "dem.tif", above=0.3)
    said = noted(termsel.run(features=with_heights(blank(control(4), slice(0, 2)), path)))
    assert "geoid and ellipsoid?" not in said


@pytest.fixture
def image(tmp_path: Path) -> Path:
    path = tmp_path / "image.tif"
    pattern = np.add.outer(np.arange(400) // 8, np.arange(400) // 8) % 2
    with rasterio.open(path, "w", driver="GTiff", width=400, height=400, count=1,
                       dtype="uint8") as raster:
        raster.write((40 + 170 * pattern).astype(np.uint8), 1)
    return path


def small(features: FeatureSet) -> FeatureSet:
    """The features in an image of 400 px along a side."""
    return replace(features, rpc=None, points=replace(
        features.points, image=features.points.image / 5), image_size=(400, 400))


@pytest.mark.usefixtures("geoid")
def test_maps_are_the_same_whatever_the_dem_refers_to(tmp_path: Path, image: Path) -> None:
    """GDAL's warper takes an RPC and ellipsoidal metres; so a DEM is converted for it."""
    result = termsel.run("poly-terms", features=small(control(30, sigma=0.0)), model="poly3d",
                         solver="all-terms", options={"degree": 1})
    dems = {"plain": dem(tmp_path / "plain.tif"),
            "geoid": dem(tmp_path / "geoid.tif", crs="EPSG:4326+5773", above=-GEOID),
            "feet": dem(tmp_path / "feet.tif", unit=0.3048, units="ft"),
            "offset": dem(tmp_path / "offset.tif", offset=300.0),
            "south up": dem(tmp_path / "south_up.tif", unit=0.3048, units="ft",
                            transform=Affine(STEP, 0.0, WEST, 0.0, STEP, NORTH - 100 * STEP)),
            "turned": dem(tmp_path / "turned_round.tif", offset=300.0,
                          transform=Affine(0.0, STEP, WEST, -STEP, 0.0, NORTH)),
            "0 to 360": dem(tmp_path / "turned.tif", turn=360.0)}
    maps = {}
    for name, path in dems.items():
        termsel.rectify(result, image, tmp_path / f"{name}_map.tif", dem=path, resolution=20)
        with rasterio.open(tmp_path / f"{name}_map.tif") as raster:
            maps[name] = raster.read(1).astype(float)
    for name in dems:
        assert maps[name].shape == maps["plain"].shape
        assert np.mean(np.abs(maps[name] - maps["plain"]) > 1) < 0.001


def test_rectify_says_by_how_much_a_map_is_off(tmp_path: Path, image: Path,
                                               caplog: pytest.LogCaptureFixture) -> None:
    result = termsel.run("poly-terms", features=small(control(30, sigma=0.0)), model="poly3d",
                         solver="all-terms", options={"degree": 1})
    with caplog.at_level(logging.WARNING, "termsel"):
        termsel.rectify(result, image, tmp_path / "map.tif", resolution=20,
                        dem=dem(tmp_path / "dem.tif", above=-48.6))
    # 0.4 px for a metre in 2000 lines are 0.08 px in 400: 3.9 px.
    assert "m below the control" in caplog.text
    assert ": 3.89 px on a map" in caplog.text
    caplog.clear()
    with caplog.at_level(logging.WARNING, "termsel"):
        termsel.rectify(result, image, tmp_path / "map2.tif", resolution=20,
                        dem=dem(tmp_path / "dem2.tif", above=0.3))
    assert "the control" not in caplog.text


@pytest.mark.slow_cases("0.3-sigma", "-48.6-sigma")
@pytest.mark.parametrize("verb", ["project", "gcp-grid-vrt", "sigma"])
@pytest.mark.parametrize("above", [-48.6, 0.3])
def test_whatever_takes_a_dem_holds_it_against_the_control(
        tmp_path: Path, image: Path, verb: str, above: float,
        caplog: pytest.LogCaptureFixture) -> None:
    result = termsel.run("poly-terms", features=small(control(30, sigma=0.3)), model="poly3d",
                         solver="all-terms", options={"degree": 1})
    path = dem(tmp_path / "dem.tif", above=above)
    caplog.clear()
    with caplog.at_level(logging.WARNING, "termsel"):
        if verb == "project":
            (tmp_path / "pixels.csv").write_text("id,line,sample\na,200,200\n")
            project_table(result, tmp_path / "pixels.csv", inverse=True, dem=path)
        elif verb == "sigma":
            pytest.importorskip("termsel_standards").write_sigma(result, tmp_path / "sigma.tif",
                                                                 dem=path)
        else:
            termsel.export(result, verb, tmp_path / "grid.vrt", image=str(image), dem=str(path))
    assert caplog.text.count("geoid and ellipsoid?") == (1 if above < -1 else 0)


@pytest.mark.parametrize(("above", "is_hole"), [(1000.0, True), (0.0, False)])
def test_holes_of_a_dem_that_are_filled_with_0_are_named(
        above: float, is_hole: bool, tmp_path: Path, image: Path,
        caplog: pytest.LogCaptureFixture) -> None:
    """Of a coast, whose heights go down to the sea, nobody can tell."""
    features = small(control(30, sigma=0.0))
    ground = features.points.ground + np.array([0.0, 0.0, above])
    result = termsel.run(features=replace(features, points=replace(features.points, ground=ground)),
                         model="poly3d", solver="all-terms", options={"degree": 1})
    path = dem(tmp_path / "dem.tif", above=above)
    with rasterio.open(path, "r+") as raster:
        heights = raster.read(1)
        heights[40:60, 40:60] = 0.0
        raster.write(heights, 1)
    caplog.clear()
    termsel.rectify(result, image, tmp_path / "map.tif", dem=path, resolution=20)
    assert ("are exactly 0" in caplog.text) == is_hole
