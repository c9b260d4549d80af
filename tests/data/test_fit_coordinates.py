"""Models fitted in other coordinates than those of the files."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import termsel
from termsel.cli.main import cli
from termsel.core.errors import TermselError
from termsel.data.coordinates.crs import (
    height_reference,
    is_geocentric,
    to_wgs84,
    transformation_between,
)
from termsel.data.coordinates.metres import metric_crs, polar_crs
from termsel.data.features import FeatureSet, Lines, Points
from termsel.data.fit_data import FitData
from termsel.data.scaling import Scaling, make_scaling
from termsel.fitting.least_squares import fit
from termsel.fitting.rpc_fit import rpc_of
from termsel.formats.readers.csv_tables import PointsCsv, write_points_csv
from termsel.models.polynomial import Affine, Polynomial3D
from termsel.runs.fit_crs import fit_crs_of

pyproj = pytest.importorskip("pyproj")

SYSTEMS = {"geodetic": "EPSG:4979", "projected": "EPSG:32639", "geocentric": "EPSG:4978"}


@pytest.fixture(scope="module")
def scene() -> FeatureSet:
    """IKONOS, Hamedan, in UTM zone 39 with ellipsoidal heights."""
    given = termsel.simulate_scene("ikonos-hamedan", n_points=90)
    turn = transformation_between(given.crs, "EPSG:32639")
    return FeatureSet(
        replace(given.points, ground=turn(given.points.ground)),
        replace(given.lines, ground=turn(given.lines.ground.reshape(-1, 3)).reshape(-1, 2, 3)),
        "EPSG:32639", given.image_size, given.noise)


def run(scene: FeatureSet, choice: str | None = None, problem: str = "rfm-terms",
        model: str | None = "poly3d", **options: object) -> termsel.Result:
    return termsel.run(problem, features=scene, model=model, solver="all-terms",
                       options=options | ({} if choice is None else {"fit_crs": choice}))


@pytest.mark.parametrize(("system", "crs"), SYSTEMS.items())
def test_a_point_in_each_system(scene: FeatureSet, system: str, crs: str) -> None:
    assert fit_crs_of(system, scene) == crs
    some = scene.points.ground[:3]
    found = transformation_between(scene.crs, crs)(some)
    source, target = (pyproj.CRS(name) for name in (scene.crs, crs))
    # By two steps over longitude and latitude, each with pyproj's own three-dimensional CRS.
    geodetic = pyproj.Transformer.from_crs(source.to_3d(), "EPSG:4979", always_xy=True)
    on = pyproj.Transformer.from_crs("EPSG:4979", target if len(target.axis_info) == 3
                                     else target.to_3d(), always_xy=True)
    expected = np.stack(on.transform(*geodetic.transform(*some.T)), axis=1)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    # The scaled coordinates are those of the system, and lead back.
    scaling = make_scaling(replace(scene, fit_crs="" if crs == scene.crs else crs))
    np.testing.assert_allclose(scaling.ground(some), (found - scaling.ground_offset)
                               / scaling.ground_scale, rtol=0, atol=1e-9)
    np.testing.assert_allclose(scaling.unscaled(scaling.ground(some)), some, rtol=0, atol=1e-6)
    assert Scaling.from_numbers(scaling.numbers()) == scaling


def test_geocentric_by_hand() -> None:
    # At longitude 90 on the equator, 1000 m up: along Y, by the semi-major axis of WGS84.
    found = transformation_between("EPSG:4979", "EPSG:4978")(np.array([[90.0, 0.0, 1000.0]]))
    np.testing.assert_allclose(found, [[0.0, 6_378_137.0 + 1000.0, 0.0]], rtol=0, atol=1e-6)


@pytest.mark.parametrize(("lon", "lat", "crs"), [
    (48.5, 34.8, "EPSG:32639"), (-70.6, -33.4, "EPSG:32719"), (179.9, -17, "EPSG:32760"),
    (180.1, -17, "EPSG:32701"), (358.0, 40.0, "EPSG:32630")])
def test_the_utm_zone_is_that_of_the_features(lon: float, lat: float, crs: str) -> None:
    points = Points(("a", "b"), [[0, 0], [1, 1]], [[lon - .01, lat, 5], [lon + .01, lat, 5]])
    assert fit_crs_of("projected", FeatureSet(points, crs="EPSG:4979")) == crs


@pytest.mark.parametrize(("lon", "lat"), [(-180, 1), (6, 50), (0, 0), (5, 60), (12, -0.1),
                                          (179.99, -80), (-90, 84)])
def test_utm_zones_are_those_of_proj_on_borders_too(lon: float, lat: float) -> None:
    zones = pyproj.database.query_utm_crs_info(
        "WGS 84", pyproj.aoi.AreaOfInterest(lon, lat, lon, lat))
    assert metric_crs("EPSG:4979", lon, lat) == f"EPSG:{zones[0].code}"


def test_no_utm_zone_at_the_pole() -> None:
    points = Points(("a",), [[0, 0]], [[0, -89, 5]])
    with pytest.raises(TermselError, match=r"no UTM zone.*EPSG:3031"):
        fit_crs_of("projected", FeatureSet(points, crs="EPSG:4979"))


@pytest.mark.slow_cases("geodetic")
@pytest.mark.parametrize("choice", [*SYSTEMS, "EPSG:4978"])
def test_results_stay_in_the_coordinates_given(scene: FeatureSet, choice: str,
                                               tmp_path: Path) -> None:
    result = termsel.run("rfm-terms", features=scene, model="poly3d", solver="all-terms",
                         options={"fit_crs": choice}, out=tmp_path)
    assert result.data.crs == "EPSG:32639"
    assert result.data.fit_crs == SYSTEMS.get(choice, choice)
    assert result.data.heights == "not stated by EPSG:32639; taken as ellipsoidal"
    # The same as a fit to coordinates that were turned before, by all that a result can do.
    crs = result.data.fit_crs
    before = result.fit.control
    turned = FeatureSet(replace(before.points, ground=transformation_between(scene.crs, crs)(
        before.points.ground)), crs=crs)
    direct = fit(Polynomial3D(degree=2), turned, make_scaling(turned))
    others = scene.points.ground[:20]
    np.testing.assert_allclose(result.project(others),
                               direct.project(transformation_between(scene.crs, crs)(others)),
                               rtol=0, atol=1e-6)
    image = result.project(others)
    np.testing.assert_allclose(result.locate(image, others[:, 2]), others, rtol=0, atol=1e-5)
    assert (result.residuals[0].x, result.residuals[0].y) == tuple(before.points.ground[0, :2])
    again = termsel.read_result(tmp_path)
    np.testing.assert_allclose(again.project(others), image, rtol=0, atol=1e-9)
    assert again.to_dict() == result.to_dict()
    assert ("Fitted in" in (tmp_path / "summary.txt").read_text()) == (crs != scene.crs)
    termsel.export(result, "points-csv", tmp_path / "export.csv")
    table = PointsCsv().read(tmp_path / "export.csv")
    assert table.crs == "EPSG:32639"
    np.testing.assert_array_equal(table.points.ground, result.features.points.ground)


def test_affine_in_geodetic_coordinates_given_in_them(scene: FeatureSet) -> None:
    given = termsel.simulate_scene("ikonos-hamedan", n_points=90)
    plain, asked = run(given), run(given, "geodetic")
    assert asked.features.fit_crs == ""
    assert asked.data.fit_crs == "EPSG:4979"
    np.testing.assert_array_equal(plain.fit.adjustment.coefficients,
                                  asked.fit.adjustment.coefficients)


@pytest.mark.slow
def test_lines(scene: FeatureSet) -> None:
    result = run(scene, "geocentric", "owdis-lines", blunders="keep")
    own = scene.lines.ground.reshape(-1, 3)
    turned = FeatureSet(lines=Lines(scene.lines.ids, scene.lines.image, transformation_between(
        scene.crs, "EPSG:4978")(own).reshape(-1, 2, 3)), crs="EPSG:4978")
    direct = fit(Polynomial3D(degree=2), turned, make_scaling(turned))
    np.testing.assert_allclose(result.fit.line_errors(), direct.line_errors(), rtol=0, atol=1e-6)


@pytest.mark.slow
def test_an_rpc_from_each_system(scene: FeatureSet, caplog: pytest.LogCaptureFixture) -> None:
    places = scene.points.ground[:30]
    geodetic = to_wgs84(scene.crs)(places)
    exact = rpc_of(run(scene, "geodetic", model="rfm", order=1).fit)
    assert (exact.how, exact.worst < 1e-6) == ("exact", True)
    result = run(scene, "geocentric", model="rfm", order=1)
    with caplog.at_level(logging.INFO):
        renewed = rpc_of(result.fit)
    assert renewed.how != "exact"
    assert renewed.worst < 0.01
    assert "RPC: refitted to the model" in caplog.text
    assert "at most" in caplog.text
    np.testing.assert_allclose(renewed.rpc.project(geodetic), result.project(places), rtol=0,
                               atol=0.01)


@pytest.mark.slow
def test_auto_takes_the_best_by_leave_one_out(scene: FeatureSet) -> None:
    from termsel.auto.auto import Auto

    few = scene.with_(points=scene.points.take(np.arange(36)))
    result = termsel.run("rfm-terms", features=few, strategy="auto", options={"fit_crs": "auto"})
    both = result.features.points.take(np.isin(result.features.points.roles,
                                               ("control", "check")))
    predicted = {}
    for crs in SYSTEMS.values():
        own = FeatureSet(both, crs=few.crs, fit_crs="" if crs == few.crs else crs)
        choice = Auto().choose(FitData.of(own, True))
        assert choice is not None
        predicted[crs] = choice.chosen.held_out_rmse
    assert result.data.fit_crs == min(predicted, key=lambda crs: predicted[crs])


@pytest.mark.parametrize(("crs", "choice", "model", "words"), [
    ("local", "geocentric", "poly3d", "fit_crs geocentric: plane coordinates without a CRS"),
    ("local", "auto", "poly3d", "State the CRS"),
    ("EPSG:32639", "geocentric", "poly2d", "model 'poly2d' has none"),
    ("EPSG:32639", "UTM", "poly3d", "option 'fit_crs' does not take 'UTM'"),
    ("EPSG:32639", "local", "poly3d", "option 'fit_crs' does not take 'local'"),
    ("EPSG:32639", "EPSG:999999", "poly3d", "EPSG:999999"),
])
def test_refusals(scene: FeatureSet, crs: str, choice: str, model: str, words: str) -> None:
    with pytest.raises(TermselError, match=words):
        run(replace(scene, crs=crs), choice, model=model)


def test_geocentric_needs_heights_that_differ(scene: FeatureSet) -> None:
    level = scene.points.ground * [1, 1, 0]
    with pytest.raises(TermselError, match="heights that are known and differ"):
        run(FeatureSet(replace(scene.points, ground=level), crs=scene.crs), "geocentric",
            model="affine")


def test_command_line(scene: FeatureSet, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    write_points_csv(scene.points, path, scene.crs)
    words = ["run", "--problem", "rfm-terms", "--points", str(path), "--model", "affine",
             "--solver", "all-terms", "--json"]
    done = CliRunner().invoke(cli, [*words, "--fit-crs", "geocentric"], catch_exceptions=False)
    record = json.loads(done.stdout)
    assert record["data"]["fit_crs"] == record["scaling"]["fit_crs"] == "EPSG:4978"
    assert record["options"]["data"]["fit_crs"] == "geocentric"
    twice = CliRunner().invoke(cli, [*words, "--fit-crs", "geocentric", "--set", "fit_crs=auto"],
                               catch_exceptions=False)
    assert twice.exit_code == 2
    assert "fit_crs is given twice" in twice.output


@pytest.mark.slow
def test_without_pyproj(tmp_path: Path) -> None:
    code = ("import sys; sys.modules['pyproj'] = None\n"
            "from termsel.__main__ import main\n"
            "sys.exit(main())")
    done = subprocess.run([sys.executable, "-c", code, "run", "--problem", "rfm-terms",
                           "--fit-crs", "geocentric"], capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert 'requires pyproj, which is not installed. Install it: pip install ' \
        '"termsel[gis]"' in done.stderr
    assert "Traceback" not in done.stderr


def test_what_heights_refer_to() -> None:
    assert height_reference("local") == ""
    assert height_reference("EPSG:4979") == "ellipsoidal (WGS 84)"
    assert height_reference("EPSG:4326") == "not stated by EPSG:4326; taken as ellipsoidal"
    compound = pyproj.CRS("EPSG:32639+5773").to_wkt()
    assert height_reference(compound) == "EGM96 height"
    assert is_geocentric("EPSG:4978")
    assert not is_geocentric("local")


def test_places_beyond_a_projection_are_seen_nowhere(scene: FeatureSet) -> None:
    control = replace(scene, lines=Lines((), np.empty((0, 2, 2)), np.empty((0, 2, 3))),
                      crs="EPSG:4979", fit_crs="EPSG:32639",
                      points=replace(scene.points, ground=to_wgs84(scene.crs)(
                          scene.points.ground)))
    fitted = fit(Affine(), control, make_scaling(control))
    away = fitted.project(np.array([[48.5, 200.0, 0.0]]))
    assert np.isfinite(away).all()
    assert np.abs(away).max() > 1e6


def around_pole(crs: str, middle: tuple[float, float], size: float = 400_000.0, count: int = 30,
                ) -> FeatureSet:
    """An affine view of a polar area, its control in degrees."""
    rng = np.random.default_rng(7)
    plan = rng.uniform(-size, size, (count, 2))
    turn = pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    lon, lat = turn.transform(*(plan + middle).T)
    image = plan @ np.array([[0.0, 0.001], [-0.001, 0.0]]) + [500.0, 500.0]
    return FeatureSet(Points(tuple(f"P{i}" for i in range(count)), image,
                             np.column_stack([lon, lat, np.full(count, np.nan)])), crs="EPSG:4326")


@pytest.mark.parametrize(("crs", "middle"), [
    ("EPSG:3031", (0.0, 0.0)), ("EPSG:3031", (600_000.0, 300_000.0)), ("EPSG:3413", (0.0, 0.0)),
    ("EPSG:3413", (-900_000.0, 700_000.0))])
def test_auto_fits_in_a_polar_projection_around_a_pole(
        crs: str, middle: tuple[float, float], tmp_path: Path) -> None:
    features = around_pole(crs, middle)
    result = termsel.run(features=features, out=tmp_path)
    assert result.fit.control.fit_crs == crs
    assert result.data.crs == "EPSG:4326"
    assert result.predicted is not None
    assert result.predicted.rmse < 0.01
    predicted = termsel.read_result(tmp_path).project(features.points.ground)
    assert np.abs(predicted - features.points.image).max() < 0.01


def test_longitudes_around_a_pole_are_of_one_turn() -> None:
    result = termsel.run(features=around_pole("EPSG:3413", (0.0, 0.0), size=10_000.0))
    image = np.random.default_rng(2).uniform(491.0, 509.0, (300, 2))
    places = result.locate(image, 0.0)
    np.testing.assert_allclose(result.project(places), image, atol=1e-5)
    assert np.abs(places[:, 0]).max() <= 180.0


@pytest.mark.parametrize("blunder", [False, True])
def test_around_a_pole_blunders_are_looked_for_in_the_polar_projection(*, blunder: bool) -> None:
    # A strip across the pole: next to it a degree of longitude is a few hundred metres.
    plan = np.array([(x, y) for y in range(16) for x in (-1, 0, 1)]) * [200_000.0, 160_000.0]
    turn = pyproj.Transformer.from_crs("EPSG:3031", "EPSG:4326", always_xy=True)
    lon, lat = turn.transform(*(plan - [0.0, 1_120_000.0]).T)
    noise = np.random.default_rng(1).normal(0.0, 0.3, (48, 2))
    image = plan @ np.array([[0.0, 0.0025], [-0.0025, 0.0]]) + noise
    image[20] += 40.0 * blunder
    points = Points(tuple(map(str, range(48))), image,
                    np.column_stack([lon, lat, np.full(48, np.nan)]))
    result = termsel.run(features=FeatureSet(points, crs="EPSG:4326"))
    assert [outlier.id for outlier in result.outliers] == ["20"] * blunder


def test_the_search_for_a_crs_leaves_out_what_does_not_hold_there() -> None:
    features = around_pole("EPSG:3031", (600_000.0, 300_000.0))  # without a zone of UTM
    result = termsel.run(features=features, options={"fit_crs": "auto"})
    assert result.fit.control.fit_crs == "EPSG:3031"


def test_a_method_that_is_asked_for_stays_in_degrees_and_says_so() -> None:
    features = around_pole("EPSG:3031", (600_000.0, 300_000.0))
    result = termsel.run("poly-terms", features=features, solver="all-terms")
    assert not result.fit.control.fit_crs
    assert any("--fit-crs polar (EPSG:3031)" in note for note in result.notes)


def test_heights_whose_grid_is_not_there_end_no_run_around_a_pole() -> None:
    # Heights above the geoid EGM96, whose grid PROJ does not bring along.
    points = around_pole("EPSG:3413", (0.0, 0.0)).points
    ground = points.ground.copy()
    ground[:, 2] = np.random.default_rng(1).uniform(0.0, 500.0, len(ground))
    result = termsel.run(features=FeatureSet(replace(points, ground=ground), crs="EPSG:4326+5773"))
    assert np.isfinite(result.project(ground)).all()


def test_elsewhere_no_polar_projection_is_tried(scene: FeatureSet) -> None:
    result = termsel.run("rfm-terms", features=scene)
    assert not result.fit.control.fit_crs
    assert not any("pole" in note for note in result.notes)


def test_the_moon_has_poles_too() -> None:
    assert "Polar stereographic at -90" in polar_crs("IAU_2015:30100", -85.0)


def test_a_place_that_is_not_known_stays_unknown() -> None:
    places = np.array([[500_000.0, 5_200_000.0, np.nan], [np.nan, np.nan, 400.0]])
    found = transformation_between("EPSG:32632", "EPSG:4979")(places)
    assert np.isfinite(found[0]).all()
    assert np.isnan(found[1]).all()
