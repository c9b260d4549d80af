"""The unit of z: stated, told by a DEM or an RPC, or asked for; RPCs are in metres."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.data.coordinates.crs import horizontal_crs, metres_per_height, to_wgs84
from termsel.data.coordinates.height_units import UNITS, with_height_unit
from termsel.data.features import FloatArray, Points
from termsel.formats.readers.csv_tables import write_points_csv
from termsel.formats.rpc_files import write_rpc
from termsel.io.project import project_table
from tests.formats.test_vertical_datum import camera

rasterio = pytest.importorskip("rasterio")
pyproj = pytest.importorskip("pyproj")
from rasterio.transform import from_origin  # noqa: E402

US_FOOT = UNITS["us-ft"]
FLORIDA = "EPSG:2236"  # in US survey feet


def relief(lon: FloatArray, lat: FloatArray) -> FloatArray:
    """Ground of Florida: low, with little relief [m]."""
    return 20 + 14 * np.sin(400 * lon) * np.cos(300 * lat)


def ground(count: int = 14) -> tuple[FloatArray, FloatArray]:
    """Places in longitude, latitude and metres, and in the plane in US survey feet."""
    rng = np.random.default_rng(2)
    lonlat = np.column_stack([rng.uniform(-80.39, -80.37, count), rng.uniform(27.10, 27.12, count)])
    turn = pyproj.Transformer.from_crs("EPSG:4326", FLORIDA, always_xy=True)
    x, y = turn.transform(*lonlat.T)
    z = relief(*lonlat.T)
    return np.column_stack([lonlat, z]), np.column_stack([x, y, z])


def rpc(height: float = 20.0, half: float = 50.0) -> termsel.Rpc:
    """An RPC of the place, which a metre of height moves by 0.4 px."""
    return replace(camera(), ground_offset=(-80.38, 27.11, height),
                   ground_scale=(0.012, 0.012, half),
                   line_numerator=(0.0, 0.0, -1.0, 0.4 * half / 1000, *[0.0] * 16))


def table(tmp_path: Path, unit: float, crs: str = FLORIDA) -> Path:
    """Points whose z is in a unit."""
    lonlat, plane = ground()
    image = rpc().project(lonlat) + np.array([3.0, -5.0])
    image += np.random.default_rng(4).normal(0.0, 0.3, (len(lonlat), 2))
    path = tmp_path / "points.csv"
    names = tuple(f"P{i}" for i in range(len(plane)))
    write_points_csv(Points(names, image, plane / [1.0, 1.0, unit]), path, crs)
    return path


def surface(tmp_path: Path, above: float = 0.0) -> Path:
    row, column = np.mgrid[:120, :120] + 0.5
    values = relief(-80.395 + 25e-5 * column, 27.125 - 25e-5 * row) + above
    path = tmp_path / "dem.tif"
    with rasterio.open(path, "w", driver="GTiff", width=120, height=120, count=1, dtype="float64",
                       crs="EPSG:4326", transform=from_origin(-80.395, 27.125, 25e-5, 25e-5)
                       ) as raster:
        raster.write(values, 1)
    return path


def opening(result: termsel.Result) -> str:
    return result.summary().partition("\n\n")[0].replace("\n    ", " ")


@pytest.mark.slow_cases(
    "ft-0.3048-z in feet, as stated", "us-ft-0.3048006096012192-z in US survey feet, as stated")
@pytest.mark.parametrize(("asked", "unit", "words"), [
    ("us-ft", US_FOOT, "z in US survey feet, as stated"),
    ("crs", US_FOOT, "z in US survey feet, as stated"),
    ("ft", 0.3048, "z in feet, as stated"), ("metre", 1.0, "z in metres, as stated")])
def test_a_unit_that_is_stated(tmp_path: Path, asked: str, unit: float, words: str) -> None:
    features = termsel.read(table(tmp_path, unit), z_unit=asked)
    np.testing.assert_allclose(to_wgs84(features.crs)(features.points.ground), ground()[0],
                               atol=1e-5)
    result = termsel.run(features=features, out=tmp_path / "result")
    assert words in opening(result)
    termsel.export(result, "rpb", tmp_path / "result.RPB")
    written = termsel.read_rpc(tmp_path / "result.RPB")
    heights = ground()[0][:, 2]
    assert heights.min() - 1 < written.ground_offset[2] < heights.max() + 1
    again = termsel.read_result(tmp_path / "result")
    assert again.features.crs == features.crs


@pytest.mark.parametrize("unit", [US_FOOT, 1.0])
def test_without_a_word_it_is_asked(tmp_path: Path, unit: float) -> None:
    path = table(tmp_path, unit)
    with pytest.raises(TermselError, match="z may be in US survey feet") as caught:
        termsel.read(path)
    assert "z_unit='us-ft' or z_unit='metre'" in str(caught.value)
    assert str(path) in str(caught.value)
    with pytest.raises(TermselError, match="z may be in US survey feet"):
        termsel.run(features=path)


@pytest.mark.parametrize("above", [0.0, -30.0, 30.0])
@pytest.mark.parametrize(("unit", "words"), [
    (US_FOOT, "z in US survey feet, as the DEM says"), (1.0, "z in metres, as the DEM says")])
def test_a_dem_tells_the_unit_whatever_its_datum(tmp_path: Path, unit: float, words: str,
                                                 above: float) -> None:
    features = termsel.read(table(tmp_path, unit), dem=surface(tmp_path, above))
    assert f"z in {features.z_unit}" == words
    assert metres_per_height(features.crs) == pytest.approx(unit)


@pytest.mark.parametrize(("unit", "words"), [
    (US_FOOT, "z in US survey feet, as the RPC says"), (1.0, "z in metres, as the RPC says")])
def test_an_rpc_tells_the_unit(tmp_path: Path, unit: float, words: str) -> None:
    vendor = tmp_path / "vendor.RPB"
    write_rpc(rpc(), vendor)
    features = termsel.read(table(tmp_path, unit), rpc=vendor)
    assert f"z in {features.z_unit}" == words


def test_a_dem_gives_heights_in_the_unit_of_z(tmp_path: Path) -> None:
    path = table(tmp_path, US_FOOT)
    rows = path.read_text().splitlines()
    rows[2] = rows[2].rsplit(",", 1)[0] + ","  # the height of the first point
    path.write_text("\n".join(rows) + "\n")
    features = termsel.read(path, dem=surface(tmp_path), z_unit="us-ft")
    assert features.points.ground[0, 2] == pytest.approx(ground()[0][0, 2] / US_FOOT, abs=1.0)


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:4979", "EPSG:32617", "EPSG:32617+5773",
                                 "EPSG:2236", "EPSG:2236+6360"])
@pytest.mark.parametrize("unit", UNITS)
def test_a_crs_states_any_unit_of_heights(crs: str, unit: str) -> None:
    changed = with_height_unit(crs, unit)
    assert metres_per_height(changed) == pytest.approx(UNITS[unit], rel=1e-12)
    assert horizontal_crs(changed) == horizontal_crs(crs)
    assert with_height_unit(changed, unit) == changed


def test_a_unit_that_the_crs_declares_is_said(tmp_path: Path) -> None:
    features = termsel.read(table(tmp_path, US_FOOT, "EPSG:2236+6360"))
    assert features.z_unit == "US survey feet"


def test_what_has_no_unit_to_state(tmp_path: Path) -> None:
    path = table(tmp_path, 1.0, "local")
    assert termsel.read(path).z_unit == ""
    with pytest.raises(TermselError, match="without a CRS"):
        termsel.read(path, z_unit="ft")
    with pytest.raises(TermselError, match="z_unit"):
        termsel.read(table(tmp_path, 1.0), z_unit="inch")


def test_heights_that_are_unknown_are_not_asked_for(tmp_path: Path) -> None:
    path = table(tmp_path, np.nan)
    assert termsel.read(path).z_unit == ""


def test_a_dem_above_control_in_feet_is_said_in_metres(tmp_path: Path) -> None:
    features = termsel.read(table(tmp_path, US_FOOT), dem=surface(tmp_path, -30.0), z_unit="us-ft")
    assert features.dem_difference is not None
    assert features.dem_difference.above == pytest.approx(-30.0, abs=1.0)


def test_places_in_the_same_plane_are_projected(tmp_path: Path) -> None:
    """A table of the same CRS without heights has z in the unit that was stated."""
    features = termsel.read(table(tmp_path, US_FOOT), z_unit="us-ft")
    result = termsel.run(features=features)
    text, _ = project_table(result, tmp_path / "points.csv")
    row = text.splitlines()[2].split(",")
    assert float(row[1]) == pytest.approx(features.points.image[0, 0], abs=3.0)
