"""Files whose ground coordinates are not all of one kind, of which the image tells."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.data.coordinates.plausible import note_on_wrong_coordinates
from termsel.data.features import FeatureSet, Points
from termsel.results.first_screen import next_step_for_user

pyproj = pytest.importorskip("pyproj")


def seen(lon: np.ndarray, lat: np.ndarray, noise: float = 0.5) -> np.ndarray:
    """Line and sample of places, north up."""
    rng = np.random.default_rng(5)
    image = np.column_stack([(lat.max() - lat) * 9000.0, (lon - lon.min()) * 6500.0])
    return image + rng.normal(0, noise, image.shape)


def places(west: float, south: float, width: float, height: float, count: int = 14,
           ) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(9)
    return west + width * rng.uniform(size=count), south + height * rng.uniform(size=count)


def features(image: np.ndarray, x: np.ndarray, y: np.ndarray, crs: str) -> FeatureSet:
    ground = np.column_stack([x, y, np.full(len(x), np.nan)])
    return FeatureSet(Points(tuple(f"P{i}" for i in range(len(x))), image, ground), crs=crs)


def in_zones(lon: np.ndarray, lat: np.ndarray, zones: list[int], base: int = 32600,
             ) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.empty_like(lon), np.empty_like(lat)
    for zone in set(zones):
        here = np.array(zones) == zone
        turn = pyproj.Transformer.from_crs("EPSG:4326", f"EPSG:{base + zone}", always_xy=True)
        x[here], y[here] = turn.transform(lon[here], lat[here])
    return x, y


def test_places_on_a_map_are_told_from_pixels() -> None:
    x, y = places(268_500.0, 4_488_300.0, 900.0, 700.0)
    on_map = np.column_stack([y - 0.4, x + 0.3])
    for crs in ("local", "EPSG:2100"):
        assert "map coordinates of a georeferenced image" in note_on_wrong_coordinates(
            features(on_map, x, y, crs))
    pixels = on_map - on_map.min(axis=0)
    assert note_on_wrong_coordinates(features(pixels, x, y, "local")) == ""
    # Two images of one size: both are pixels.
    assert note_on_wrong_coordinates(features(pixels, pixels[:, 1], pixels[:, 0], "local")) == ""


@pytest.mark.parametrize("stated", [32, 33])
def test_points_of_the_next_zone_of_utm_are_named(stated: int) -> None:
    lon, lat = places(11.6, 47.0, 0.8, 0.5)
    zones = [33 if one > 12 else 32 for one in lon]
    note = note_on_wrong_coordinates(features(
        seen(lon, lat), *in_zones(lon, lat, zones), f"EPSG:{32600 + stated}"))
    fewer = min((32, 33), key=zones.count)
    assert note.startswith(f"{zones.count(fewer)} of 14 points look as if they were in the zone of "
                           f"UTM {'west' if fewer == 32 else 'east'} of that of the others")
    assert f"P{zones.index(fewer)}" in note


def test_one_zone_has_no_note_in_either_hemisphere_nor_beyond_its_border() -> None:
    lon, lat = places(11.6, 47.0, 0.8, 0.5)
    assert note_on_wrong_coordinates(features(
        seen(lon, lat), *in_zones(lon, lat, [32] * 14), "EPSG:32632")) == ""
    lon, lat = places(-70.5, -33.5, 5.0, 0.5)  # wide, with gaps
    assert note_on_wrong_coordinates(features(
        seen(lon, lat), *in_zones(lon, lat, [19] * 14, 32700), "EPSG:32719")) == ""


def test_a_blunder_is_no_other_zone() -> None:
    lon, lat = places(11.6, 47.0, 0.3, 0.3)
    x, y = in_zones(lon, lat, [32] * 14)
    x[3] += 300_000.0
    assert note_on_wrong_coordinates(features(seen(lon, lat), x, y, "EPSG:32632")) == ""


def typed(angle: np.ndarray, *, seconds: bool = False) -> np.ndarray:
    """Degrees with minutes, and seconds, as decimals."""
    size = np.abs(angle)
    minutes = (size % 1) * 60
    part = np.floor(minutes) / 100 + (minutes % 1) * 60 / 10_000 if seconds else minutes / 100
    return np.sign(angle) * np.round(np.floor(size) + part, 6)


@pytest.mark.parametrize(("west", "south"), [(10.6, 48.1), (-71.3, -33.8)])
@pytest.mark.parametrize("seconds", [False, True])
def test_minutes_typed_as_decimals_are_named(west: float, south: float, seconds: bool) -> None:
    lon, lat = places(west, south, 0.8, 0.6)
    note = note_on_wrong_coordinates(features(seen(lon, lat), typed(lon, seconds=seconds),
                                  typed(lat, seconds=seconds), "EPSG:4326"))
    words = "degrees, minutes and seconds" if seconds else "degrees and minutes"
    assert note.startswith(f"Coordinates look like {words} typed as decimals: ")


def test_decimal_degrees_have_no_note() -> None:
    for seed_west in (10.6, 10.05, -71.3):
        lon, lat = places(seed_west, 48.05, 0.8, 0.4)
        assert note_on_wrong_coordinates(features(seen(lon, lat), lon, lat, "EPSG:4326")) == ""
    few = slice(0, 5)
    lon, lat = places(10.6, 48.1, 0.8, 0.6)
    assert note_on_wrong_coordinates(features(seen(lon, lat)[few], typed(lon)[few], typed(lat)[few],
                                  "EPSG:4326")) == ""


def test_a_run_says_so_and_keeps_it(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    lon, lat = places(10.6, 48.1, 0.8, 0.6)
    image = seen(lon, lat)
    rows = ["# crs: EPSG:4326", "id,line,sample,x,y"]
    rows += [f"P{i},{line:.2f},{sample:.2f},{x:.6f},{y:.6f}" for i, (line, sample, x, y)
             in enumerate(zip(*image.T, typed(lon), typed(lat), strict=True))]
    (tmp_path / "points.csv").write_text("\n".join(rows))
    result = termsel.run(features=tmp_path / "points.csv")
    assert any("typed as decimals" in note for note in result.notes)
    assert any(one.startswith("Warning: Coordinates look like") for one in caplog.messages)


@pytest.mark.parametrize("kind", ["minutes", "zones"])
def test_what_to_do_next_is_to_correct_the_coordinates(kind: str) -> None:
    """Blunders that such coordinates make come after them."""
    lon, lat = places(11.6, 47.0, 0.8, 0.5)
    image = seen(lon, lat)
    if kind == "zones":
        given = features(image, *in_zones(lon, lat, [33 if one > 12.2 else 32 for one in lon]),
                         "EPSG:32632")
    else:
        def typed(angle: np.ndarray) -> np.ndarray:
            return np.round(np.floor(angle) + (angle - np.floor(angle)) * 0.6, 4)

        given = features(image, typed(lon), typed(lat), "EPSG:4326")
    result = termsel.run(features=given)
    words = " ".join(result.summary().split())
    assert "correct the coordinates first: " in words
    assert "Next: run again with --off" not in words
    assert next_step_for_user(result, "result") == "Next: correct the coordinates, then run again"
    assert result.data.read.mixed == note_on_wrong_coordinates(given)


@pytest.mark.parametrize("crs", ["EPSG:32632", "EPSG:3035", "EPSG:27700"])
def test_eastings_and_northings_in_kilometres_are_named(crs: str) -> None:
    lon, lat = places(-2.5, 52.0, 0.1, 0.1) if crs == "EPSG:27700" else places(9.0, 47.0, 0.1, 0.1)
    image = 10.0 * seen(lon, lat)
    x, y = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(lon, lat)
    assert not note_on_wrong_coordinates(features(image, x, y, crs))
    sign = "x and y look like kilometres: times 1,000 they are in the area of"
    assert sign in note_on_wrong_coordinates(
        features(image, x / 1000, y / 1000, crs))


@pytest.mark.parametrize("tilt", [0.2, 1.0])
def test_heights_in_kilometres_are_named_where_the_image_shows_them(tilt: float) -> None:
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0, 4000, (2, 20))
    z = rng.uniform(400, 1900, 20)
    image = np.column_stack([(4000 - y) / 2, (x + tilt * z) / 2]) + rng.normal(0, 0.5, (20, 2))
    for heights, is_named in ((z, False), (z / 1000, True)):
        ground = np.column_stack([6e5 + x, 5e6 + y, heights])
        points = Points(tuple(map(str, range(20))), image, ground)
        note = note_on_wrong_coordinates(FeatureSet(points, crs="EPSG:32632"))
        assert ("look like kilometres" in note) == is_named
    flat = np.column_stack([6e5 + x, 5e6 + y, rng.uniform(0, 2, 20)])
    image = np.column_stack([(4000 - y) / 2, x / 2]) + rng.normal(0, 0.5, (20, 2))
    points = Points(tuple(map(str, range(20))), image, flat)
    assert not note_on_wrong_coordinates(FeatureSet(points, crs="EPSG:32632"))


@pytest.mark.parametrize("crs", ["EPSG:3068", "EPSG:2454"])
def test_metres_near_the_origin_of_a_crs_are_no_kilometres(crs: str) -> None:
    # A thousand times as far from the origin, the projection has no ground.
    x, y = places(12_000.0, 13_000.0, 4000.0, 4000.0)
    image = np.column_stack([y.max() - y, x - x.min()])
    assert note_on_wrong_coordinates(features(image, x, y, crs)) == ""
    note = note_on_wrong_coordinates(features(image, x / 1000, y / 1000, crs))
    assert "look like kilometres" in note


def test_a_bend_along_a_slope_is_no_sign_of_kilometres() -> None:
    rng = np.random.default_rng(4)
    u, v = rng.uniform(0, 1, (2, 30))
    image = np.column_stack([5000 * v, 5000 * u + 300 * u**2]) + rng.normal(0, 0.5, (30, 2))
    heights = 8 * u**2 + rng.uniform(0, 0.3, 30)
    ground = np.column_stack([5e5 + 5000 * u, 5e6 - 5000 * v, heights])
    points = Points(tuple(map(str, range(30))), image, ground)
    assert not note_on_wrong_coordinates(FeatureSet(points, crs="EPSG:32632"))


@pytest.mark.parametrize(("crs", "x", "y"), [
    # Toises of a city, metres of another continent, and a site grid, under the CRS of a project.
    ("EPSG:2154", (-400.0, 200.0), (1400.0, 1800.0)),
    ("EPSG:2154", (432_000.0, 434_000.0), (178_000.0, 180_000.0)),
    ("EPSG:27700", (650_000.0, 655_000.0), (6_860_000.0, 6_863_000.0)),
    ("EPSG:31370", (1_000.0, 1_500.0), (-2_000_000.0, -1_999_000.0))])
def test_coordinates_of_another_grid_than_the_crs_are_named(
        crs: str, x: tuple[float, float], y: tuple[float, float]) -> None:
    [sample], [line] = np.random.default_rng(1).uniform(0, 2000, (2, 1, 14))
    found = features(np.column_stack([line, sample]), x[0] + sample * (x[1] - x[0]) / 2000,
                     y[1] - line * (y[1] - y[0]) / 2000, crs)
    note = note_on_wrong_coordinates(found)
    assert f"{crs} is for the area from" in note
    assert "of another grid" in note
    in_a_plane = features(found.points.image, *found.points.ground[:, :2].T, "local")
    assert note_on_wrong_coordinates(in_a_plane) == ""


@pytest.mark.parametrize(("crs", "x", "y"), [
    ("EPSG:28407", 7_430_000.0, 6_170_000.0), ("EPSG:4547", 500_000.0, 3_400_000.0)])
def test_a_northing_called_x_looks_swapped(crs: str, x: float, y: float) -> None:
    [sample], [line] = np.random.default_rng(1).uniform(0, 2000, (2, 1, 14))
    image = np.column_stack([line, sample])
    assert note_on_wrong_coordinates(features(image, x + sample, y - line, crs)) == ""
    note = note_on_wrong_coordinates(features(image, y - line, x + sample, crs))
    assert note.endswith("x and y look swapped. --set swapped=xy exchanges them.")


@pytest.mark.parametrize(("crs", "lon", "lat"), [
    ("EPSG:2154", 2.0, 47.0), ("EPSG:2154", 12.0, 44.0), ("EPSG:32631", 9.0, 40.0),
    ("EPSG:3857", 175.0, -40.0), ("EPSG:3035", 10.0, 52.0), ("EPSG:2193", 178.0, -38.0),
    ("EPSG:3031", -60.0, -75.0), ("+proj=laea +lat_0=10 +lon_0=-50", 60.0, 40.0)])
def test_points_in_or_next_to_the_area_of_their_crs_are_not(
        crs: str, lon: float, lat: float) -> None:
    lons, lats = places(lon, lat, 0.4, 0.3)
    x, y = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(lons, lats)
    assert note_on_wrong_coordinates(features(seen(lons, lats), x, y, crs)) == ""


@pytest.mark.parametrize(("zeros", "of", "said"), [
    (1, "ground", ""), (2, "ground", "2 points lie at x = 0 and y = 0"), (1, "image", ""),
    (5, "image", "5 points lie at line = 0 and sample = 0")])
def test_zeros_that_stand_for_unknown_places_are_named(zeros: int, of: str, said: str) -> None:
    x, y = places(500_000.0, 5_000_000.0, 900.0, 700.0)
    image = np.column_stack([y.max() - y, x - x.min()]) + 5.0
    if of == "ground":
        x[:zeros] = y[:zeros] = 0.0
    else:
        image[:zeros] = 0.0
    # Points of one place are refused as they are read, unless their heights differ.
    ground = np.column_stack([x, y, 10.0 * np.arange(len(x))])
    points = Points(tuple(f"P{i}" for i in range(len(x))), image, ground)
    note = note_on_wrong_coordinates(FeatureSet(points))
    assert note.startswith(said) if said else "lie at" not in note
    assert not said or "P0" in note


def test_points_at_zero_state_no_accuracy() -> None:
    """Nor is a model compared with others at them."""
    scene = termsel.simulate_scene("ikonos-hamedan", roles=(40, 0, 20), n_lines=0)
    ground = scene.points.ground.copy()
    ground[::5, :2] = 0.0
    wrong = scene.with_(points=replace(scene.points, ground=ground))
    screen = " ".join(termsel.run(features=wrong).summary().split())
    assert "Accuracy not known: points whose coordinates are wrong are among the independent" in (
        screen)
    assert "Compared" not in screen
    assert " px" in " ".join(termsel.run(features=scene).summary().partition("Accuracy")[2].split())


def test_zeros_that_are_left_out_raise_no_doubt(tmp_path: Path,
                                                caplog: pytest.LogCaptureFixture) -> None:
    rng = np.random.default_rng(4)
    rows = [f"P{i},{100 + 900 * x:.2f},{100 + 800 * y:.2f},{0 if i < 3 else 8 + 0.01 * y:.8f},"
            f"{0 if i < 3 else 47 - 0.008 * x:.8f},{10 + i}"
            for i, (x, y) in enumerate(rng.uniform(0, 1, (18, 2)))]
    table = tmp_path / "zeros.csv"
    table.write_text("\n".join(["id,line,sample,x,y,z", *rows]), encoding="utf-8")
    said = "3 points lie at x = 0 and y = 0"
    kept = termsel.run(features=termsel.read(table, crs="EPSG:4979"))
    assert said in caplog.text
    assert said in kept.summary()
    caplog.clear()
    off = "P0,P1,P2"
    result = termsel.run(features=termsel.read(table, crs="EPSG:4979", off=off),
                         options={"off": off})
    assert said not in caplog.text
    assert said not in result.summary()
    assert not any(said in note for note in result.notes)


@pytest.mark.slow_cases("option-EPSG:32632-500050-5.2e12-300", "option-EPSG:4979-8.001-460.1-300")
@pytest.mark.parametrize(("crs", "x", "y", "z"), [
    ("EPSG:4979", "8.001", "460.1", "300"), ("EPSG:4979", "1120", "47", "300"),
    ("EPSG:32632", "500050", "5.2e12", "300"), ("EPSG:32632", "8.001", "47", "300"),
    ("EPSG:4979", "8.001", "47", "90000")])
@pytest.mark.parametrize("by", ["option", "role"])
def test_what_no_crs_has_does_not_end_a_run_that_leaves_it_out(
        crs: str, x: str, y: str, z: str, by: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    places = rng.uniform(0, 1, (14, 2))
    if crs == "EPSG:4979":
        ground = np.column_stack([8 + 0.01 * places[:, 1], 47 - 0.008 * places[:, 0]])
    else:
        ground = np.column_stack([5e5 + 800 * places[:, 1], 5.2e6 - 900 * places[:, 0]])
    rows = [f"P{i},{100 + 900 * line:.2f},{100 + 800 * sample:.2f},{east:.7f},{north:.7f},300,"
            for i, ((line, sample), (east, north)) in enumerate(zip(places, ground, strict=True))]
    wrong = f"BAD,500,500,{x},{y},{z},"
    table = tmp_path / "control.csv"
    role = "off" if by == "role" else ""
    header = "id,line,sample,x,y,z,role"
    table.write_text("\n".join([header, *rows, wrong + role]), encoding="utf-8")
    off = {"off": "BAD"} if by == "option" else {}
    result = termsel.run(features=termsel.read(table, crs=crs, **off), options=off)
    assert "BAD" not in result.fit.control.ids
    assert "correct the coordinates" not in result.summary()
    control = result.fit.control.points
    assert np.abs(result.fit.project(control.ground) - control.image).max() < 1.0
    table.write_text("\n".join([header, *rows, wrong]), encoding="utf-8")
    with pytest.raises(termsel.TermselError, match="BAD"):
        termsel.read(table, crs=crs)
