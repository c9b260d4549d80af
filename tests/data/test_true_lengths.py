"""Longitudes and latitudes in grads, from Greenwich and from elsewhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.data.coordinates.earth import degrees_of
from termsel.data.coordinates.metres import offsets_in_metres

pyproj = pytest.importorskip("pyproj")


def table(folder: Path, crs: str, header: str = "x,y") -> Path:
    path = folder / "control.csv"
    rows = [[-4.25 + 0.01 * i, 53.9 - 0.003 * i * i, 5.0 * i, 7.0 * i * i] for i in range(5)]
    path.write_text("\n".join([f"# crs: {crs}", f"{header},line,sample", *(
        ",".join(map(str, row)) for row in rows)]))
    return path


# NTF, Voirol 1875 and Tananarive, all of Paris.
@pytest.mark.parametrize("crs", ["EPSG:4807", "EPSG:4811", "EPSG:4810"])
def test_grads_become_degrees_of_the_same_datum(crs: str, tmp_path: Path) -> None:
    path = table(tmp_path, crs)
    read = termsel.read(path)
    raw = np.loadtxt(path, delimiter=",", skiprows=2)[:, :2]
    np.testing.assert_allclose(read.points.ground[:, :2], 0.9 * raw, rtol=1e-14)
    before = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    after = pyproj.Transformer.from_crs(read.crs, "EPSG:4326", always_xy=True)
    np.testing.assert_allclose(after.transform(*read.points.ground[:, :2].T),
                               before.transform(*raw.T), rtol=0, atol=1e-11)


def test_a_grad_to_the_north_is_a_hundred_kilometres(tmp_path: Path) -> None:
    """The metre was once the ten millionth part of a quadrant of the meridian."""
    read = termsel.read(table(tmp_path, "EPSG:4807"))
    north = offsets_in_metres(read.crs, read.points.ground[:1, :2], np.array([[0.0, 0.9]]))
    assert north is not None
    assert north[0, 1] == pytest.approx(1e5, rel=0.005)


@pytest.mark.parametrize(("crs", "lon"), [
    ("EPSG:4807", 2.3372 - 0.9 * 4.23),     # Paris, in grads
    ("EPSG:4805", -17.6667 - 4.23),         # Ferro, in degrees
    ("EPSG:4326", -4.23)])
def test_the_place_counts_from_greenwich(crs: str, lon: float, tmp_path: Path) -> None:
    read = termsel.read(table(tmp_path, crs))
    place = degrees_of(read.crs, read.points.ground)
    assert place is not None
    assert place[0] == pytest.approx(lon, abs=0.01)


def test_columns_in_gons_by_their_names_are_converted_once(tmp_path: Path) -> None:
    by_crs = termsel.read(table(tmp_path, "EPSG:4807"))
    named = termsel.read(table(tmp_path, "EPSG:4807", "lon (gon),lat (gon)"))
    assert named.crs == by_crs.crs
    np.testing.assert_allclose(named.points.ground, by_crs.points.ground, rtol=1e-13)


@pytest.mark.parametrize(("crs", "lon", "lat"), [
    ("EPSG:3857", 15.0, 47.0), ("EPSG:3395", -70.0, 65.0), ("EPSG:4087", 15.0, 47.0),
    ("EPSG:3413", -45.0, 50.0), ("IAU_2015:30110", 10.0, 60.0)])
def test_metres_are_those_of_the_ground_in_a_stretched_projection(
        crs: str, lon: float, lat: float) -> None:
    parsed = pyproj.CRS(crs)
    geodetic = parsed.geodetic_crs
    forward = pyproj.Transformer.from_crs(geodetic, parsed, always_xy=True)
    ends = np.column_stack(forward.transform([lon, lon + 1e-4, lon], [lat, lat, lat + 1e-4]))
    metres = offsets_in_metres(crs, ends[:1].repeat(2, axis=0), ends[1:] - ends[0])
    geod = geodetic.get_geod()
    lengths = [geod.inv(lon, lat, lon + 1e-4, lat)[2], geod.inv(lon, lat, lon, lat + 1e-4)[2]]
    assert metres is not None
    np.testing.assert_allclose(np.linalg.norm(metres, axis=1), lengths, rtol=2e-3)


@pytest.mark.parametrize("crs", ["EPSG:2056", "EPSG:32633", "EPSG:27700", "EPSG:2263"])
def test_metres_of_surveyors_stay_those_of_the_plane(crs: str) -> None:
    area = pyproj.CRS(crs).area_of_use
    forward = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    place = forward.transform((area.west + area.east) / 2, (area.south + area.north) / 2)
    unit = pyproj.CRS(crs).axis_info[0].unit_conversion_factor
    metres = offsets_in_metres(crs, np.array([place]), np.array([[3.0, 4.0]]))
    np.testing.assert_array_equal(metres, [[3.0 * unit, 4.0 * unit]])


def test_a_stretched_projection_is_named(tmp_path: Path,
                                         caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "termsel")
    path = tmp_path / "control.csv"
    rows = [f"{1.67e6 + 300 * i},{5.94e6 + 90 * i * i},{5 * i},{7 * i * i}" for i in range(5)]
    path.write_text("\n".join(["# crs: EPSG:3857", "x,y,line,sample", *rows]))
    termsel.read(path)
    assert "EPSG:3857 shows lengths here 1.46 times as long as they are" in caplog.text


@pytest.mark.parametrize("crs", ["ESRI:54009", "ESRI:54030"])
def test_places_that_a_projection_does_not_show_have_no_scale(crs: str) -> None:
    offsets = np.array([[3.0, 4.0]])
    metres = offsets_in_metres(crs, np.array([[9e9, 9e9]]), offsets)
    np.testing.assert_array_equal(metres, offsets)
