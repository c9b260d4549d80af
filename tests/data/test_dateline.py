"""Scenes on the 180 degree meridian are as good as any other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import termsel
from termsel.data.coordinates.longitudes import (
    from_start,
    has_longitude_jump,
    turn_of,
    unwrap_longitudes,
    without_jump,
)
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.formats.readers.csv_tables import write_points_csv

Call = Callable[..., SimpleNamespace]


def turned(lon: float, low: float = -180.0) -> FeatureSet:
    """A scene whose middle is at a longitude; longitudes begin at `low`."""
    scene = termsel.simulate_scene("ikonos-hamedan", n_points=60)
    moved = []
    for part in (scene.points, scene.lines):
        ground = part.ground.copy()
        ground[..., 0] = (ground[..., 0] - 48.49 + lon - low) % 360 + low
        moved.append(replace(part, ground=ground))
    return scene.with_(points=moved[0], lines=moved[1])


@pytest.mark.slow
@pytest.mark.parametrize("fit_crs", [None, "geodetic", "projected", "geocentric"])
@pytest.mark.parametrize("problem", ["rfm-terms", "owdis-lines"])
def test_a_jump_of_longitudes_changes_nothing(problem: str, fit_crs: str | None) -> None:
    options: dict[str, object] = {} if fit_crs is None else {"fit_crs": fit_crs}
    if problem == "owdis-lines":
        options |= {"population": 20, "polish": False}
    given = {"generations": 2} if problem == "owdis-lines" else {}
    jumping, plain = (termsel.run(problem, features=turned(180.0, low), options=options, **given)
                      for low in (-180.0, 0.0))
    assert jumping.features.points.ground[:, 0].max() > 180.0
    assert jumping.selection == plain.selection
    for role in ("control", "independent"):
        ours, theirs = jumping.rmse[role], plain.rmse[role]
        assert ours is not None
        assert theirs is not None
        assert ours.total == pytest.approx(theirs.total, rel=1e-4)
    said = "The longitudes jump by a full turn between points."
    assert any(note.startswith(said) for note in jumping.notes)
    assert not any(note.startswith(said) for note in plain.notes)


@pytest.mark.slow
def test_places_are_projected_from_either_side() -> None:
    result = termsel.run("rfm-terms", features=turned(180.0))
    image = result.project(np.array([[180.01, 34.8, 1800.0], [-179.99, 34.8, 1800.0],
                                     [179.99, 34.8, 1800.0], [-180.01, 34.8, 1800.0]]))
    np.testing.assert_allclose(image[0], image[1], rtol=0, atol=1e-6)
    np.testing.assert_allclose(image[2], image[3], rtol=0, atol=1e-6)
    assert np.hypot(*(image[0] - image[2])) > 100.0
    # The places stay far apart where they are: no other number is taken for a longitude.
    assert np.abs(result.project(np.array([[500_000.0, 34.8, 1800.0]]))).max() > 1e6
    ground = result.locate(image[:1], 1800.0)
    np.testing.assert_allclose(ground[0, :2], [180.01, 34.8], rtol=0, atol=1e-6)
    rpc = result.to_rpc()
    assert abs(rpc.ground_offset[0]) <= 180.0
    for lon in (180.01, -179.99):
        np.testing.assert_allclose(rpc.project(np.array([[lon, 34.8, 1800.0]])), image[:1],
                                   rtol=0, atol=0.05)


@pytest.mark.slow
def test_a_result_is_read_back_and_exported(call: Call, tmp_path: Path) -> None:
    write_points_csv(turned(180.0).points, tmp_path / "p.csv", crs="EPSG:4979")
    done = call("run", "--problem", "rfm-terms", "--points", tmp_path / "p.csv", "--out",
                tmp_path / "r", "--quiet")
    assert done.exit_code == 0, done.stderr
    (tmp_path / "q.csv").write_text("# crs: EPSG:4979\nid,x,y,z\na,180.01,34.8,1800\n"
                                    "b,-179.99,34.8,1800\n")
    done = call("project", tmp_path / "r", "--points", tmp_path / "q.csv")
    first, second = (row.split(",") for row in done.stdout.splitlines() if row[:2] in ("a,", "b,"))
    assert [float(cell) for cell in first[1:3]] == pytest.approx(
        [float(cell) for cell in second[1:3]], abs=1e-6)
    assert float(first[-1]) == float(second[-1]) == 0.0  # neither is outside the control
    done = call("export", tmp_path / "r", "--to", "rpb", "-o", tmp_path / "r.rpb")
    assert done.exit_code == 0, done.stderr
    offset = next(row for row in (tmp_path / "r.rpb").read_text().splitlines()
                  if "longOffset" in row)
    assert abs(float(offset.partition("=")[2].strip(" ;"))) <= 180.0


@pytest.mark.slow
@pytest.mark.parametrize("how", ["rpc", "geolocation"])
def test_a_map_shows_what_is_on_either_side(how: str, tmp_path: Path,
                                            monkeypatch: pytest.MonkeyPatch) -> None:
    rasterio = pytest.importorskip("rasterio")
    from termsel.io.rectify import rectify

    if how == "geolocation":
        monkeypatch.setattr("termsel.io.rectify.GOOD", -1.0)
    scene = turned(180.0)
    image = scene.points.image / 10.0
    small = FeatureSet(replace(scene.points, image=image), crs=scene.crs, image_size=(700, 800))
    result = termsel.run("rfm-terms", features=small)
    pixels = np.add.outer(np.arange(700.0), 1000.0 * np.arange(800.0)).astype(np.float32)
    with rasterio.open(tmp_path / "s.tif", "w", driver="GTiff", height=700, width=800, count=1,
                       dtype="float32") as raster:
        raster.write(pixels, 1)
    for crs in ("EPSG:4326", "EPSG:32601"):
        rectify(result, tmp_path / "s.tif", tmp_path / "m.tif", height=1800.0, crs=crs,
                overwrite=True, resampling="nearest")
        with rasterio.open(tmp_path / "m.tif") as found:
            assert max(found.shape) < 2000
            for lon in (179.98, 180.02):
                x, y = lon, 34.8
                if crs != "EPSG:4326":
                    from pyproj import Transformer
                    x, y = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(x, y)
                value = float(next(found.sample([(x, y)]))[0])
                line, sample = result.project(np.array([[lon, 34.8, 1800.0]]))[0]
                assert value % 1000 == pytest.approx(line, abs=2.0)
                assert value // 1000 == pytest.approx(sample, abs=2.0)


def test_independent_points_do_not_decide_where_longitudes_begin() -> None:
    scene = turned(180.0)
    points = scene.points
    ground = points.ground.copy()
    ground[np.array(points.roles) == "independent", 0] = 0.0
    moved = scene.with_(points=replace(points, ground=ground))
    apart = np.array(points.roles) != "independent"
    np.testing.assert_array_equal(without_jump(moved).points.ground[apart],
                                  without_jump(scene).points.ground[apart])


@pytest.mark.parametrize(("given", "expected"), [
    ([179.0, -179.0], [179.0, 181.0]), ([-179.0, 178.0, 181.0], [181.0, 178.0, 181.0]),
    ([10.0, 20.0], [10.0, 20.0]), ([181.0, 359.0], [181.0, 359.0]),
    ([-175.0, -60.0, 60.0, 175.0], [-175.0, -60.0, 60.0, 175.0]),
    ([0.5, 359.5], [0.5, -0.5])])
def test_longitudes_that_go_on(given: list[float], expected: list[float]) -> None:
    np.testing.assert_allclose(unwrap_longitudes(np.array(given)) % 360, np.array(expected) % 360)
    assert np.ptp(unwrap_longitudes(np.array(given))) == pytest.approx(np.ptp(expected))


def test_the_first_place_of_a_map_is_not_a_turn_further_by_rounding() -> None:
    lon = np.random.default_rng(1).uniform(0.0, 360.0, 1000)
    starts = (lon + 180.0) % 360.0 - 180.0
    np.testing.assert_allclose(from_start(lon, starts, 360.0), starts, rtol=0, atol=1e-9)


PACIFIC = "+proj=eqc +lon_0=160 +R=6371000"
"""Maps of the world whose edges are at 20 W."""


def map_of_the_world(projection: str, west: float, east: float, low: float = -180.0) -> FeatureSet:
    """Forty points of a small-scale map, longitudes begin at `low`; errors of 2 px."""
    pyproj = pytest.importorskip("pyproj")
    rng = np.random.default_rng(3)
    lon = rng.uniform(west, east, 40)
    lat = rng.uniform(-55, 70, 40)
    x, y = pyproj.Transformer.from_crs("EPSG:4326", projection, always_xy=True).transform(lon, lat)
    image = np.column_stack([2500 - np.asarray(y) / 5000, 4000 + np.asarray(x) / 5000])
    ground = np.column_stack([(lon - low) % 360 + low, lat, np.full(40, np.nan)])
    points = Points(ids=tuple(f"p{i:02}" for i in range(40)), roles=("control",) * 40,
                    image=image + rng.normal(0, 2, (40, 2)), ground=ground)
    return FeatureSet(points, crs="EPSG:4326")


@pytest.mark.parametrize(("west", "east", "low"), [
    (60.0, 340.0, -180.0), (-18.0, 338.0, -180.0), (-18.0, 338.0, 0.0)])
def test_a_map_of_the_world_begins_where_its_image_does(
        west: float, east: float, low: float) -> None:
    jumping = map_of_the_world(PACIFIC, west, east, low)
    assert has_longitude_jump(jumping)
    moved = without_jump(jumping).points.ground[:, 0]
    from_the_edge = map_of_the_world(PACIFIC, west, east, low=west).points.ground[:, 0]
    np.testing.assert_allclose(moved - from_the_edge, (moved - from_the_edge)[0], atol=1e-9)


@pytest.mark.parametrize("projection", [
    "+proj=stere +lat_0=90", "+proj=laea +lat_0=-90", "+proj=robin +lon_0=0", "+proj=merc"])
def test_other_maps_of_the_world_begin_at_180(projection: str) -> None:
    if "lat_0" in projection:  # around a pole
        scene = map_of_a_pole(projection, -1.0 if "-90" in projection else 1.0)
    else:
        scene = map_of_the_world(projection, -179.0, 179.0)
    assert not has_longitude_jump(scene)
    kept = without_jump(scene)
    assert (kept.points.ground == scene.points.ground)[:, :2].all()
    assert kept.x_start == -180.0


def chart_of_the_world(lon: FloatArray, lat: FloatArray) -> FeatureSet:
    """Places on a map in Mercator's projection, 14 px a degree, whose left edge is at 180 W."""
    stretched = np.degrees(np.log(np.tan(np.pi / 4 + np.radians(lat) / 2)))
    image = 14.0 * np.column_stack([85.0 - stretched, lon + 180.0])
    ground = np.column_stack([lon, lat, np.full(len(lon), np.nan)])
    return FeatureSet(Points(tuple(f"P{i}" for i in range(len(lon))), image, ground),
                      crs="EPSG:4326")


@pytest.mark.parametrize("lon", [
    [-165.0, -120.0, -75.0, -30.0, 20.0, 60.0, 110.0, 150.0, 178.0],  # the middle is 6 E
    [-160.0, -70.0, 20.0, 100.0, 177.0], [-178.0, -90.0, -10.0, 30.0, 90.0, 120.0]])
def test_both_edges_of_a_map_of_the_world_stay_where_they_are(
        lon: list[float], tmp_path: Path) -> None:
    lat = np.resize([52.0, -33.0, 12.0, -48.0, 35.0], len(lon))
    result = termsel.run(features=chart_of_the_world(np.array(lon), lat), out=tmp_path / "r")
    edges = chart_of_the_world(np.array([-180.0, -179.5, -174.0, 174.0, 179.5, 180.0]),
                               np.full(6, 10.0))
    for fitted in (result, termsel.read_result(tmp_path / "r")):
        found = fitted.project(edges.points.ground[:, :2])
        np.testing.assert_allclose(found[:, 1], edges.points.image[:, 1], rtol=0, atol=40.0)
    # No point held out lies on the other edge, 5,040 px away.
    assert result.predicted is not None
    assert result.predicted.rmse < 100.0
    assert not result.outliers


def test_longitudes_that_leave_half_of_a_map_empty_need_not_jump() -> None:
    chart = chart_of_the_world(np.array([-147.6, -69.3, 129.0, 137.5, 167.4]),
                               np.array([52.0, -33.0, 12.0, -48.0, 35.0]))
    assert not has_longitude_jump(chart)
    # From the west of the Pacific to its east they do, as the image has it.
    pacific = chart.with_(points=replace(
        chart.points, image=14.0 * np.column_stack([
            chart.points.image[:, 0] / 14.0, chart.points.ground[:, 0] % 360.0])))
    assert has_longitude_jump(pacific)


def map_of_a_pole(projection: str, sign: float) -> FeatureSet:
    """Forty points of all longitudes around a pole."""
    pyproj = pytest.importorskip("pyproj")
    scene = map_of_the_world(PACIFIC, -179.0, 179.0)
    ground = scene.points.ground.copy()
    ground[:, 1] = sign * np.linspace(45.0, 88.0, 40)
    x, y = pyproj.Transformer.from_crs("EPSG:4326", projection, always_xy=True).transform(
        *ground[:, :2].T)
    image = np.column_stack([-np.asarray(y), np.asarray(x)]) / 5000 + 3000
    return scene.with_(points=replace(scene.points, ground=ground, image=image))


def test_places_beside_a_wide_map_are_those_next_to_it() -> None:
    scene = map_of_the_world(PACIFIC, 110.0, 286.0)
    result = termsel.run(features=scene)
    beyond = result.project(np.array([[-71.0, 0.0, 0.0], [289.0, 0.0, 0.0]]))
    np.testing.assert_allclose(beyond[0], beyond[1], rtol=0, atol=1e-6)
    # 111 km a degree at the equator, 5 km a pixel, counted from 160 E.
    assert beyond[0, 1] == pytest.approx(4000 + (289 - 160) * 111.2 / 5, abs=30)


@pytest.mark.parametrize("x", [np.inf, -np.inf])
def test_places_without_coordinates_stay_far_away(x: float) -> None:
    scaling = termsel.FitData.of(map_of_the_world(PACIFIC, 110.0, 286.0)).scaling
    assert scaling.x_turn == 360.0
    assert abs(scaling.ground([[x, 0.0, 0.0]])[0, 0]) > 1e5


def test_x_of_cylindrical_projections_goes_on_across_180_degrees() -> None:
    pyproj = pytest.importorskip("pyproj")
    scene = map_of_the_world("+proj=merc +lon_0=180", 170.0, 195.0)
    to_web = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:3857", always_xy=True)
    ground = scene.points.ground.copy()
    ground[:, 0], ground[:, 1] = to_web.transform(ground[:, 0], ground[:, 1])
    web = FeatureSet(replace(scene.points, ground=ground), crs="EPSG:3857")
    result = termsel.run(features=web)
    assert result.predicted is not None
    assert result.predicted.rmse < 4.0
    turn = turn_of("EPSG:3857")
    place = np.array([[20.1e6, -2e6, 0.0]])
    np.testing.assert_allclose(result.project(place), result.project(place - [[turn, 0, 0]]),
                               rtol=0, atol=1e-6)


@pytest.mark.parametrize(("crs", "turn"), [
    ("EPSG:4326", 360.0), ("EPSG:3395", 40075016.7), ("+proj=eqc +lat_ts=60 +type=crs", 20037508.3),
    ("EPSG:32633", 0.0), ("EPSG:3035", 0.0), ("+proj=robin +type=crs", 0.0), ("local", 0.0)])
def test_what_a_turn_adds_to_x(crs: str, turn: float) -> None:
    assert turn_of(crs) == pytest.approx(turn, rel=1e-4)


def test_an_array_on_both_sides_is_compared_with_the_model_on_either(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    rng = np.random.default_rng(6)
    image = rng.uniform(0.0, 999.0, (12, 2))
    lon = (175.0 + 0.01 * image[:, 1] + 180.0) % 360.0 - 180.0
    points = Points(tuple(map(str, range(12))), image,
                    np.column_stack([lon, -10.0 - 0.01 * image[:, 0], np.full(12, np.nan)]))
    features = FeatureSet(points, crs="EPSG:4326", image_size=(1000, 1000))
    with pytest.importorskip("rasterio").open(
            tmp_path / "scene.tif", "w", driver="GTiff", height=1000, width=1000, count=1,
            dtype="uint8") as raster:
        raster.write(np.full((1000, 1000), 9, dtype=np.uint8), 1)
    termsel.export(termsel.run(features=features), "geolocation-vrt", tmp_path / "scene.vrt",
                   image=tmp_path / "scene.tif")
    assert "geolocation-vrt: at most" in caplog.text
    assert not any("geolocation-vrt" in record.message for record in caplog.records
                   if record.levelname == "WARNING")


def test_a_map_of_the_world_in_metres_is_cut_at_its_own_edges() -> None:
    pyproj = pytest.importorskip("pyproj")
    crs = "+proj=eqc +lon_0=160 +datum=WGS84 +type=crs"
    chart = chart_of_the_world(np.array([-178.0, -150.0, -90.0, -10.0, 30.0, 90.0, 120.0, 176.0]),
                               np.array([52.0, -33.0, 12.0, -48.0, 35.0, 60.0, -20.0, 0.0]))
    # The same sheet from 20 W to 20 W, in metres from its middle.
    lon = chart.points.ground[:, 0] + 160.0
    x, y = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(
        lon, chart.points.ground[:, 1])
    ground = np.column_stack([x, y, np.full(len(lon), np.nan)])
    result = termsel.run(features=FeatureSet(replace(chart.points, ground=ground), crs=crs))
    assert not result.outliers
    edge = pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(-21.0, 10.0)
    assert result.project(np.array([edge]))[0, 1] == pytest.approx(14.0 * 359.0, abs=40.0)
