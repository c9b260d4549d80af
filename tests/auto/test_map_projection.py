"""Maps of countries, whose control is in degrees or Web Mercator, are fitted in a projection."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import termsel
from termsel.cli.main import cli
from termsel.data.coordinates.crs import transformation_between
from termsel.data.record.search import FITTED_IN
from termsel.formats.readers.csv_tables import write_points_csv

pyproj = pytest.importorskip("pyproj")

EARTH = "+datum=WGS84 +units=m +no_defs"
CONIC = f"+proj=lcc +lat_1=40 +lat_2=50 +lat_0=45 +lon_0=10 {EARTH}"
NEW = 60


def drawn_map(projection: str, count: int, *, lon: float = 10.0, lat: float = 46.0,
              size: float = 15.0, crs: str = "EPSG:4326",
              seed: int = 1) -> tuple[termsel.FeatureSet, termsel.Points]:
    """Return control of a map drawn in a projection, and further points without errors.

    The image is some 5,000 px wide, turned by 3 degrees; control is measured with 1.5 px.
    """
    rng = np.random.default_rng(seed)
    degrees = np.column_stack([
        lon + rng.uniform(-0.5, 0.5, count + NEW) * size,
        lat + rng.uniform(-0.5, 0.5, count + NEW) * 0.7 * size, np.zeros(count + NEW)])
    on_plane = transformation_between("EPSG:4326", projection)(degrees)[:, :2]
    on_plane = on_plane - on_plane.mean(axis=0)
    x, y = 2500.0 * (on_plane / np.abs(on_plane).max()).T
    turn = np.radians(3.0)
    image = np.column_stack([2500.0 - np.cos(turn) * y + np.sin(turn) * x,
                             2500.0 + np.cos(turn) * x + np.sin(turn) * y])
    ground = transformation_between("EPSG:4326", crs)(degrees)
    ground[:, 2] = np.nan
    ids = tuple(f"P{index}" for index in range(count + NEW))
    every = termsel.Points(ids, image, ground)
    measured = every.take(np.arange(count))
    measured = replace(measured, image=measured.image + rng.normal(0.0, 1.5, (count, 2)))
    return (termsel.FeatureSet(points=measured, crs=crs),
            every.take(np.arange(count, count + NEW)))


@pytest.mark.slow
def test_longitudes_in_gons_are_those_of_degrees() -> None:
    """As features made in Python may have them; files are converted as they are read."""
    in_degrees, new = drawn_map(CONIC, 12, crs="EPSG:4275")
    gons = pyproj.CRS("EPSG:4275").to_json_dict()
    gons.pop("id")
    for axis in gons["coordinate_system"]["axis"]:
        axis["unit"] = {"type": "AngularUnit", "name": "grad",
                        "conversion_factor": np.pi / 200.0}
    scale = np.array([1.0 / 0.9, 1.0 / 0.9, 1.0])
    in_gons = replace(
        in_degrees, crs=pyproj.CRS.from_json_dict(gons).to_wkt(),
        points=replace(in_degrees.points, ground=in_degrees.points.ground * scale))
    results = [termsel.run(features=features) for features in (in_degrees, in_gons)]
    notes = [next(note for note in result.notes if FITTED_IN in note) for result in results]
    assert notes[1].split(":")[0] == notes[0].split(":")[0]
    errors = [rms_error(results[0], new),
              rms_error(results[1], replace(new, ground=new.ground * scale))]
    assert errors[1] == pytest.approx(errors[0], rel=1e-3)


def rms_error(result: termsel.Result, points: termsel.Points) -> float:
    """Return the RMS of distances in the image [px] between a model and points."""
    ground = np.column_stack([points.ground[:, :2], np.zeros(len(points))])
    errors = np.asarray(result.project(ground)) - points.image
    return float(np.sqrt((errors ** 2).sum(axis=1).mean()))


def projection_of(result: termsel.Result) -> str:
    """Return the name of the projection of the fit; "" where it is in the file's coordinates."""
    data = result.record.data
    return "" if data.fit_crs == data.crs else data.fit_crs.split('"')[1].partition(" about")[0]


@pytest.mark.slow_cases("conic-12", "conic-14", "conic-6", "stereographic-10")
@pytest.mark.parametrize(("projection", "count", "crs"), [
    (CONIC, 6, "EPSG:4326"), (CONIC, 12, "EPSG:4326"), (CONIC, 14, "EPSG:3857"),
    (f"+proj=stere +lat_0=46 +lon_0=7 {EARTH}", 10, "EPSG:4258"),
    (f"+proj=poly +lat_0=46 +lon_0=12 {EARTH}", 6, "EPSG:4326")],
    ids=["conic-6", "conic-12", "conic-14", "stereographic-10", "polyconic-6"])
def test_maps_of_countries_are_fitted_in_a_projection(projection: str, count: int,
                                                      crs: str) -> None:
    ratios = []
    for seed in (2, 3):
        features, others = drawn_map(projection, count, crs=crs, seed=seed)
        result = termsel.run(features=features)
        kept = termsel.run(features=features, options={"fit_crs": crs})
        assert projection_of(kept) == ""
        assert not any(note.startswith(FITTED_IN) for note in kept.notes)
        # It is never taken without a word.
        assert any(note.startswith(FITTED_IN) for note in result.notes) == bool(
            projection_of(result))
        ratios.append(rms_error(result, others) / rms_error(kept, others))
    assert max(ratios) < 1.1
    assert np.exp(np.mean(np.log(ratios))) < 0.8


@pytest.mark.parametrize("count", [3, 4])
def test_of_three_and_four_points_a_map_is_taken_to_be_true_to_scale(count: int) -> None:
    features, others = drawn_map(CONIC, count, size=0.6, lat=60.0)
    result = termsel.run(features=features)
    kept = termsel.run(features=features, options={"fit_crs": "EPSG:4326"})
    assert projection_of(result) == "Lambert azimuthal"
    assert rms_error(result, others) < 0.7 * rms_error(kept, others)


@pytest.mark.parametrize("count", [4, 9])
def test_a_projection_that_cannot_be_made_is_no_reason_to_fail(
        count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    features, _ = drawn_map(CONIC, count)
    # Heights above a geoid whose grid PROJ need not have; where it has, a projection is taken.
    above_geoid = termsel.run(features=termsel.FeatureSet(
        points=features.points, crs="EPSG:4326+5773"))
    assert projection_of(above_geoid) or any(
        note.startswith("No projection was tried") for note in above_geoid.notes)
    # A map of another place, as projections are remembered.
    elsewhere, _ = drawn_map(CONIC.replace("lon_0=10", "lon_0=33"), count, lon=33.0)
    monkeypatch.setitem(sys.modules, "pyproj", None)
    monkeypatch.setitem(sys.modules, "pyproj.crs", None)
    result = termsel.run(features=elsewhere)
    assert projection_of(result) == ""
    [note] = [note for note in result.notes if note.startswith("No projection was tried")]
    assert "pip install" in note


def test_across_180_degrees() -> None:
    features, others = drawn_map(f"+proj=aea +lat_1=60 +lat_2=66 +lat_0=63 +lon_0=180 {EARTH}", 10,
                                 lon=179.0, lat=62.0)
    result = termsel.run(features=features)
    assert projection_of(result) == "Lambert azimuthal"
    assert rms_error(result, others) < 3.0


def test_a_map_of_the_world_in_mercator_is_fitted_in_mercator() -> None:
    features, others = drawn_map(f"+proj=merc {EARTH}", 24, lon=10.0, lat=20.0, size=130.0)
    result = termsel.run(features=features)
    assert projection_of(result) == "Mercator"
    assert rms_error(result, others) < 3.0


@pytest.mark.slow_cases(
    "10-5.0-210.0-moll-Mollweide", "10-5.0-210.0-robin-Robinson", "8--45.0-150.0-robin-Robinson",
    "8--45.0-150.0-wintri-Winkel tripel")
@pytest.mark.parametrize(("method", "name"), [
    ("robin", "Robinson"), ("wintri", "Winkel tripel"), ("moll", "Mollweide")])
@pytest.mark.parametrize(("count", "lon", "width"), [(10, 5.0, 210.0), (8, -45.0, 150.0)])
def test_a_map_of_the_world_in_an_oval_is_fitted_in_its_projection(
        method: str, name: str, count: int, lon: float, width: float) -> None:
    """In degrees such maps bend so much that right points would look like blunders."""
    features, new = drawn_map(f"+proj={method} +lon_0=0 {EARTH}", count, lon=lon, lat=5.0,
                              size=width)
    result = termsel.run(features=features)
    assert projection_of(result).startswith(name)
    assert not result.outliers
    assert rms_error(result, new) < 4.0
    assert result.predicted is not None
    assert result.predicted.high < 20.0


def test_a_chart_drawn_in_degrees_stays_in_degrees() -> None:
    features, _ = drawn_map(f"+proj=eqc {EARTH}", 14)
    assert projection_of(termsel.run(features=features)) == ""


@pytest.mark.slow_cases("EPSG:3857")
@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:3857"])
def test_the_plan_of_a_town_is_fitted_in_its_own_coordinates(crs: str) -> None:
    # Over 2 km no projection differs from another by what anyone measures.
    features, _ = drawn_map(CONIC, 14, size=0.02, crs=crs)
    assert projection_of(termsel.run(features=features)) == ""


def test_national_grids_and_methods_that_are_asked_for_stay_as_they_are() -> None:
    in_utm, _ = drawn_map(CONIC, 10, size=4.0, crs="EPSG:32632")
    assert projection_of(termsel.run(features=in_utm)) == ""
    in_degrees, _ = drawn_map(CONIC, 10)
    assert projection_of(termsel.run(features=in_degrees, method="quadratic")) == ""


def test_independent_points_take_no_part_in_the_choice_of_a_projection() -> None:
    features, _ = drawn_map(CONIC, 16)
    points = replace(features.points, roles=("independent",) * 6 + ("control",) * 10)
    spoilt = replace(points, image=points.image + np.where(
        np.arange(16)[:, None] < 6, [500.0, -900.0], 0.0))
    runs = [termsel.run(features=features.with_(points=some)) for some in (points, spoilt)]
    assert projection_of(runs[0]) == "Lambert azimuthal"
    assert runs[0].record.data.fit_crs == runs[1].record.data.fit_crs


def test_one_blunder_does_not_choose_the_projection() -> None:
    features, others = drawn_map(CONIC, 12, seed=3)
    image = features.points.image.copy()
    image[3] += [70.0, -40.0]
    result = termsel.run(features=features.with_(points=replace(features.points, image=image)))
    assert projection_of(result) == "Lambert azimuthal"
    assert [outlier.id for outlier in result.outliers] == ["P3"]
    assert rms_error(result, others) < 5.0


def test_the_screen_names_the_projection(tmp_path: Path) -> None:
    features, _ = drawn_map(CONIC, 12)
    write_points_csv(features.points, tmp_path / "map.csv", features.crs)
    shown = CliRunner().invoke(cli, ["run", str(tmp_path / "map.csv"), "--out",
                                     str(tmp_path / "result")])
    assert shown.exit_code == 0, shown.output
    words = " ".join(shown.output.split())
    assert "fitted in Lambert azimuthal about 46 N, 10 E" in words
    # What is done as well as possible is no reason for caution.
    assert "Caution" not in words
    # The summary names it too, and does not print its WKT.
    summary = (tmp_path / "result" / "summary.txt").read_text()
    assert "Fitted in Lambert azimuthal about 46 N, 10 E;" in summary
    assert "PROJCRS" not in summary
    # And it is read back as it was.
    result = termsel.read_result(tmp_path / "result")
    assert projection_of(result) == "Lambert azimuthal"
    inside = np.array([[10.0, 46.0, 0.0], [6.0, 43.0, 0.0]])
    located = np.asarray(result.locate(result.project(inside), 0.0))
    np.testing.assert_allclose(located[:, :2], inside[:, :2], atol=1e-6)


def test_a_stated_crs_of_the_fit_holds_around_a_pole() -> None:
    # The choice of a polar projection is for coordinates of which nothing is said.
    rng = np.random.default_rng(3)
    degrees = np.column_stack([rng.uniform(-180.0, 180.0, 14), rng.uniform(80.0, 89.0, 14),
                               np.zeros(14)])
    plane = transformation_between("EPSG:4326", "EPSG:3413")(degrees)
    image = 1000.0 + plane[:, 1::-1] / [-1000.0, 1000.0] + rng.normal(0.0, 0.5, (14, 2))
    ground = np.column_stack([degrees[:, :2], np.full(14, np.nan)])
    features = termsel.FeatureSet(crs="EPSG:4326", points=termsel.Points(
        tuple(f"P{index}" for index in range(14)), image, ground))
    assert termsel.run(features=features).record.data.fit_crs == "EPSG:3413"
    kept = termsel.run(features=features, options={"fit_crs": "EPSG:4326"})
    assert kept.record.data.fit_crs == kept.record.data.crs
