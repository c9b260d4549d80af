"""Oblique photographs: what lies below or behind the camera is no pole, and has no place."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import termsel
from benchmarks.oblique import LINES, SAMPLES, Scene, case_of, rmse, scene
from termsel.auto.auto import Auto
from termsel.auto.blunders import find_blunders
from termsel.auto.methods import named
from termsel.auto.rule import has_pole, refusal, validated
from termsel.data import view
from termsel.data.features import FloatArray, Points
from termsel.data.fit_data import FitData, relief_carriers
from termsel.data.scaling import make_scaling
from termsel.data.view import view_of
from termsel.fitting.accuracy import predict_rmse_of_fit

MOST = 1.3
"""RMSE of auto at the truth by that of the better projection."""


PROJECTIONS = ("projective", "dlt", "pinhole")


def chosen_by(drawn: Scene) -> tuple[str, float]:
    """Return what is chosen from all control, and its RMSE at the truth."""
    choice = Auto().choose(FitData.of(drawn.features))
    assert choice is not None
    return choice.method.name, rmse(choice.chosen.project(drawn.ground), drawn.image)


@pytest.mark.slow_cases("10-0-8", "10-20-14", "20-100-24")
@pytest.mark.parametrize(("angle", "relief", "count"), [
    (10, 0, 8), (30, 0, 14), (10, 20, 14), (40, 100, 8), (20, 100, 24)])
def test_the_projection_of_an_oblique_photograph_is_chosen(angle: int, relief: int,
                                                           count: int) -> None:
    found, error = chosen_by(scene(angle, relief, count, 0))
    assert found in PROJECTIONS
    assert error < 2.0


@pytest.mark.slow_cases("0-14")
@pytest.mark.parametrize(("relief", "count"), [(0, 14), (100, 20)])
def test_auto_is_near_the_better_projection(relief: int, count: int) -> None:
    assert case_of(15, relief, count, 3).ratio < MOST


@pytest.mark.slow_cases("2", "3")
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_five_points_of_level_ground_suffice_without_heights(seed: int) -> None:
    found, error = chosen_by(scene(20, 0, 5, seed, heights=False, noise=0.05))
    assert found in PROJECTIONS
    assert error < 3.0


@pytest.mark.slow_cases("10-4", "12-0")
@pytest.mark.parametrize(("count", "seed"), [(10, 1), (10, 4), (12, 0)])
def test_birds_eye_views_that_are_drawn_roughly_are_projective(count: int, seed: int) -> None:
    found, error = chosen_by(scene(40, 0, count, seed, heights=False, noise=10.0))
    assert found in PROJECTIONS
    assert error < 10.0


def test_heights_count_by_what_they_do_in_the_image() -> None:
    """Hills of 3 m in a plain of kilometres, near a camera that looks along the ground."""
    low, level = (scene(10, relief, 20, 4).features for relief in (8, 0))
    assert FitData.of(low).heights
    assert not FitData.of(level).heights


@pytest.mark.parametrize(("relief", "columns"), [(0, 3), (100, 4)])
def test_heights_of_a_view_are_judged_without_scipy(
        relief: int, columns: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy.special", None)  # it takes 0.1 s to import
    found = view_of(FitData.of(scene(20, relief, 9, 17).features).scaled.points)
    assert found is not None
    assert found.matrix.shape == (3, columns)


def test_a_pole_among_the_control_is_refused_and_named() -> None:
    drawn = scene(20, 100, 20, 0)
    dlt = named("dlt")
    assert dlt is not None
    fitted = dlt.fit(FitData.of(drawn.features))
    assert not has_pole(fitted)
    assert refusal(fitted) == ""
    coefficients = fitted.adjustment.coefficients.copy()
    below_control = fitted.model.denominators(
        coefficients, fitted.scaled_control.points.ground)
    assert below_control is not None
    far = fitted.scaled_control.points.ground[np.argmax(below_control[:, 0])]
    # The line of the camera moves across the control: 1 + d c = 0 halfway to the farthest point.
    below = [fitted.model.terms.index(f"den:{axis}") for axis in "XYZ"]
    coefficients[below] = -2.0 * far / (far @ far)
    crossed = replace(fitted, adjustment=replace(fitted.adjustment, coefficients=coefficients))
    assert has_pole(crossed)
    assert "a pole" in refusal(crossed)


def test_overfitted_rational_functions_are_refused_still() -> None:
    drawn = scene(15, 100, 24, 1)
    rfm = named("rfm-2")
    assert rfm is not None
    control = FitData.of(drawn.features)
    judged = validated(rfm, control)
    # 38 terms of 48 coordinates have a pole somewhere, or errors of the left out that are great.
    assert judged is None or judged.held_out_rmse > 5.0


def test_a_refused_model_says_why(tmp_path: Path) -> None:
    features = scene(15, 100, 40, 2).features
    result = termsel.run(features=features, out=tmp_path / "result")
    text = result.summary(verbose=True)
    refused = [one.name for one in result.baselines if one.refused]
    for name in refused:
        assert name in ("rfm-2", "rfm-3")
    assert text.count("Refused:") == len(refused)
    again = termsel.read_result(tmp_path / "result")
    assert [one.refused for one in again.baselines] == [one.refused for one in result.baselines]


def fit_of(angle: int = 10, relief: int = 0) -> tuple[Scene, termsel.Fit]:
    drawn = scene(angle, relief, 20, 1)
    choice = Auto().choose(FitData.of(drawn.features))
    assert choice is not None
    return drawn, choice.chosen


def behind(drawn: Scene) -> FloatArray:
    """Return a place on the other side of the camera, which is above the origin of the scene."""
    origin = np.array([500_000.0, 5_200_000.0, 400.0])
    ahead = drawn.features.points.ground[:, :2].mean(axis=0) - origin[:2]
    return np.array([[*(origin[:2] - ahead), 400.0]])


@pytest.mark.parametrize("relief", [0, 100])
def test_a_place_behind_the_camera_has_no_image(relief: int) -> None:
    drawn, fitted = fit_of(relief=relief)
    ground = np.concatenate([drawn.ground[:3], behind(drawn)])
    image = fitted.project(ground)
    assert np.isfinite(image[:3]).all()
    assert np.isnan(image[3]).all()
    assert fitted.unseen(ground).tolist() == [False, False, False, True]
    assert np.isnan(fitted.sigma(ground)[3]).all()


def test_the_sky_has_no_ground() -> None:
    drawn, fitted = fit_of()
    level = float(np.median(drawn.ground[:, 2]))
    sky, low = np.array([[50.0, SAMPLES / 2]]), np.array([[LINES - 50.0, SAMPLES / 2]])
    assert fitted.above_horizon(sky).all()
    assert not fitted.above_horizon(low).any()
    assert np.isnan(fitted.locate(sky, level)).any()
    assert np.isfinite(fitted.locate(low, level)).all()


@pytest.mark.slow_cases("10-0", "40-20")
@pytest.mark.parametrize(("angle", "relief"), [(10, 0), (20, 100), (40, 20)])
def test_locate_finds_all_that_an_oblique_photograph_shows(angle: int, relief: int) -> None:
    drawn, fitted = fit_of(angle, relief)
    seen = fitted.project(drawn.ground)
    place = fitted.locate(seen, drawn.ground[:, 2])
    middle, half = fitted.ground_box()
    near = (np.abs(drawn.ground - middle) < 3.0 * half)[:, :2].all(axis=1)
    assert near.mean() > 0.9
    assert np.isfinite(place[near]).all()
    np.testing.assert_allclose(fitted.project(place[near]), seen[near], atol=1e-5)


def test_a_vertical_photograph_and_a_satellite_call_for_no_oblique_view() -> None:
    features = termsel.get("datasets", "ikonos-hamedan").load()
    assert view_of(make_scaling(features).features(features).points) is None


def test_project_names_places_behind_the_camera(tmp_path: Path,
                                                monkeypatch: pytest.MonkeyPatch) -> None:
    from termsel.io.project import project_table

    drawn = scene(10, 0, 20, 1)
    result = termsel.run(features=drawn.features)
    back = behind(drawn)[0]
    table = tmp_path / "places.csv"
    table.write_text(f"# crs: EPSG:32632\nid,x,y\nin front,{drawn.ground[0, 0]},"
                     f"{drawn.ground[0, 1]}\nback,{back[0]},{back[1]}\n")
    text, warnings = project_table(result, table)
    assert "1 point lies behind the camera or beyond the horizon, and no image shows it: back" \
        in warnings
    assert text.splitlines()[-1].startswith("back,,")
    table.write_text("id,line,sample\nsky,20,2000\nground,2900,2000\n")
    _, warnings = project_table(result, table, inverse=True)
    assert "1 point shows no ground, as above the horizon: sky" in warnings


# Four corners, and points that are exchanged

CORNERS = np.array([(0, 0), (0, 3840), (2160, 3840), (2160, 0)], dtype=float)
PLACES = np.array([(0, 2000), (3000, 2400), (1900, 300), (700, 0)], dtype=float)
"""Of the corners on the ground: a view to the north."""

ORIGIN = np.array([500_000.0, 5_000_000.0])


def corners(image: FloatArray = CORNERS, places: FloatArray = PLACES) -> termsel.FeatureSet:
    ground = np.column_stack([places + ORIGIN, np.full(len(places), np.nan)])
    return termsel.FeatureSet(termsel.Points(tuple("ABCDEFG"[:len(places)]), image, ground),
                              crs="EPSG:32633", image_size=(2161, 3841))


def chosen_of(result: termsel.Result) -> str:
    assert result.strategy is not None
    return result.strategy.chosen


def line_on_blunders(result: termsel.Result) -> str:
    return next(line for line in result.summary().splitlines() if line.startswith("Outliers"))


def test_four_sound_corners_of_an_oblique_view_get_a_projective_transformation() -> None:
    result = termsel.run(features=corners())
    assert chosen_of(result) == "projective"
    np.testing.assert_allclose(result.project(corners().points.ground[:, :2]), CORNERS, atol=1e-6)
    assert any("determine the model exactly" in note for note in result.notes)
    assert result.predicted is None


def test_four_corners_of_a_map_keep_a_plain_model() -> None:
    square = np.array([(0, 2160), (3840, 2160), (3840, 0), (0, 0)], dtype=float)
    noise = np.random.default_rng(0).normal(0, 8.0, (4, 2))
    assert chosen_of(termsel.run(features=corners(places=square + noise))) != "projective"


@pytest.mark.parametrize("pair", [(0, 1), (1, 2), (2, 3), (0, 3)])
def test_exchanged_corners_are_named(pair: tuple[int, int]) -> None:
    order = np.arange(4)
    order[list(pair)] = pair[::-1]
    result = termsel.run(features=corners(CORNERS[order]))
    assert chosen_of(result) != "projective"
    assert "none" not in line_on_blunders(result)
    likely = [note for note in result.notes if "exchanged" in note]
    assert len(likely) == 1
    # Of four corners another pair explains it as well, as a view that is turned.
    assert likely[0][:6] in ("A and ", "B and ", "C and ")


def test_two_exchanged_points_of_six_are_named() -> None:
    rng = np.random.default_rng(3)
    image = np.concatenate([CORNERS, [(700.0, 900.0), (1500.0, 2800.0)]])
    matrix = np.array([[0.9, 0.2, 100.0], [-0.3, 1.1, 50.0], [1e-5, 2e-5, 1.0]])
    places = np.column_stack([image[:, 1], -image[:, 0], np.ones(6)]) @ matrix.T
    ground = places[:, :2] / places[:, 2:] + rng.normal(0, 1.0, (6, 2))
    assert not termsel.run(features=corners(image, ground)).outliers
    image[[0, 4]] = image[[4, 0]]
    result = termsel.run(features=corners(image, ground))
    assert {one.id for one in result.outliers} == {"A", "E"}


def test_a_mirrored_image_reverses_all_triangles_and_is_no_exchange() -> None:
    result = termsel.run(features=corners(CORNERS[:, :] * [1.0, -1.0] + [0.0, 3840.0]))
    assert not result.outliers


# Exports of what an oblique photograph shows, and of what it does not

def result_of(angle: int, relief: int) -> termsel.Result:
    return termsel.run(features=scene(angle, relief, 20, 1).features)


def test_exports_that_would_give_ground_to_the_sky_name_the_horizon(tmp_path: Path) -> None:
    result = result_of(10, 0)
    for to in ("rpb", "rpc-txt", "rpc-vrt", "gcp-grid-vrt", "world-file"):
        path = tmp_path / "photo.out"
        with pytest.raises(termsel.TermselError, match="% of the image is above the horizon") as no:
            termsel.export(result, to, path)
        assert "geolocation-vrt" in str(no.value.hint)
        assert not path.exists()


def test_a_geolocation_array_leaves_the_sky_empty_and_says_why(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    import rasterio

    result = result_of(10, 0)
    termsel.export(result, "geolocation-vrt", tmp_path / "photo.vrt", step=100)
    with rasterio.open(tmp_path / "photo_xy.tif") as array:
        x, y = array.read(masked=True)
    assert "have no ground, as they are above the horizon" in caplog.text
    assert x.mask[0].all()
    assert not x.mask[-1].any()
    places = np.column_stack([x.compressed(), y.compressed(), np.zeros(x.count())])
    assert result.fit.holds(places).all()


def test_points_of_a_photograph_with_sky_warn_of_what_others_make_of_it(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    termsel.export(result_of(10, 0), "gcp-vrt", tmp_path / "photo.vrt")
    assert "of the image is above the horizon, and whatever is fitted" in caplog.text


def test_an_rpc_of_an_oblique_view_follows_the_model_where_it_holds(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    from termsel.data.coordinates.crs import to_wgs84
    from termsel.formats.rpc_files import read_rpc

    drawn, result = scene(40, 100, 20, 1), result_of(40, 100)
    termsel.export(result, "rpb", tmp_path / "photo.RPB")
    rpc = read_rpc(tmp_path / "photo.RPB")
    apart = rpc.project(to_wgs84("EPSG:32632")(drawn.ground)) - result.project(drawn.ground)
    assert np.abs(apart).max() < 0.5
    assert "horizon" not in caplog.text


def test_an_image_from_above_shows_no_sky() -> None:
    from termsel.fitting.sky import part_said, sky_said

    features = termsel.get("datasets", "ikonos-hamedan").load()
    result = termsel.run(features=features)
    assert sky_said(result.fit) == ""
    assert part_said(result.fit) == ""


@pytest.mark.slow_cases("40-100-30", "30-60-22")
@pytest.mark.parametrize(("angle", "relief", "count"), [(30, 100, 24), (40, 100, 30), (30, 60, 22)])
def test_what_an_oblique_view_predicts_is_no_blunder(angle: int, relief: int, count: int) -> None:
    """Polynomials name a right point for the bend of the view; a blunder is still named alone."""
    features = scene(angle, relief, count, 2).features
    right = find_blunders(FitData.of(features))
    assert right is not None
    assert not (right.blunders | right.undecided).any()

    image = features.points.image.copy()
    image[7] += [200.0, -200.0]
    wrong = find_blunders(FitData.of(replace(features, points=replace(features.points,
                                                                      image=image))))
    assert wrong is not None
    assert np.flatnonzero(wrong.blunders | wrong.undecided).tolist() == [7]


@pytest.mark.slow_cases("12-0", "38-40")
@pytest.mark.parametrize(("angle", "relief"), [(12, 0), (25, 100), (38, 40)])
def test_a_medium_blunder_in_an_oblique_view_is_named_alone(angle: int, relief: int) -> None:
    features = scene(angle, relief, 30, 1).features
    image = features.points.image.copy()
    image[11] += [15.0, -20.0]
    found = find_blunders(FitData.of(replace(features, points=replace(features.points,
                                                                      image=image))))
    assert found is not None
    assert np.flatnonzero(found.blunders).tolist() == [11]


@pytest.mark.parametrize(("name", "is_projection"), [
    ("dlt", True), ("regularised-quadratic", False)])
def test_only_a_projection_explains_its_held_out_errors_by_leverage(name: str,
                                                                    is_projection: bool) -> None:
    """What a polynomial misses of a view stays, however much each point bears on it."""
    fitted = termsel.fit(scene(40, 100, 9, 0).features, name)
    assert fitted.view is not None
    errors = np.ones((9, 2))
    predicted = predict_rmse_of_fit(fitted, errors, 50).rmse
    assert predicted < 1.3 if is_projection else predicted == pytest.approx(np.sqrt(2.0))


def test_two_points_off_a_plane_confirm_each_other_in_a_view() -> None:
    drawn = scene(40, 20, 8, 3)
    points = drawn.features.points
    assert relief_carriers(FitData.of(drawn.features)) == ()
    name, error = chosen_by(drawn)
    assert name == "pinhole"
    assert error < 1.0
    wrong = points.ground.copy()
    wrong[2, 2] += 12.0
    changed = replace(drawn.features, points=replace(points, ground=wrong))
    assert set(relief_carriers(FitData.of(changed))) == {"P02", "P05"}


def test_the_sky_is_not_held_and_outlines_leave_it_out(tmp_path: Path) -> None:
    result = termsel.run(features=scene(22, 40, 10, 77).features)
    sky = result.fit.locate([[0.0, 2000.0]], 410.0)
    assert np.isnan(sky).all()
    assert not result.fit.holds(sky).any()
    pytest.importorskip("termsel_standards")
    file = tmp_path / "scene_stac.json"
    termsel.export(result, "stac-item", file)
    west, south, east, north = json.loads(file.read_text(encoding="utf-8"))["bbox"]
    assert 8.5 < west < east < 9.5
    assert 46.5 < south < north < 47.5


def test_a_view_that_is_hardly_oblique_gets_a_camera_if_it_fits_far_better() -> None:
    """The nearest point is at 0.81 of the distance of the middle."""
    name, error = chosen_by(scene(40, 100, 5, 2))
    assert name == "pinhole"
    assert error < 1.0


@pytest.mark.slow_cases(*map(str, range(12, 40)))
@pytest.mark.parametrize("seed", range(40))
def test_no_view_is_missed_where_no_search_is_made(seed: int,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(5, 30))
    ground = rng.uniform(-1.0, 1.0, (n, 3)) * [1.0, 1.0, rng.choice([0.0, 0.1, 1.0])]
    columns = np.column_stack([np.ones(n), ground])
    matrix = rng.normal(size=(3, 4)) * [[1.0], [1.0], [rng.choice([0.0, 0.01, 0.1, 0.4])]]
    matrix[2, 0] = 1.5
    line, sample, below = matrix @ columns.T
    image = np.column_stack([line, sample]) / np.maximum(np.abs(below), 0.3)[:, None]
    image += rng.choice([1e-6, 1e-3, 0.03, 0.3]) * rng.normal(size=image.shape)
    points = Points(tuple(map(str, range(n))), image, ground)
    found = view_of(points)
    monkeypatch.setattr(view, "_may_be_clearly_better", lambda *_: True)
    view._view_of.cache_clear()
    searched = view_of(points)
    assert (found is None) == (searched is None)
    assert found is None or np.array_equal(found.matrix, searched.matrix)
