"""Robust fits, blunders among lines, and the strategy auto for lines."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import termsel
from termsel.auto.auto import Auto
from termsel.auto.blunders import find_blunders
from termsel.auto.shrunken import fit_average, fit_average_with_lines
from termsel.cli.main import cli
from termsel.data.features import FeatureSet, Lines, empty_lines
from termsel.data.fit_data import FitData
from termsel.data.roles import observe
from termsel.data.scaling import make_scaling
from termsel.io.result_folder import read_result
from termsel.models.polynomial import Polynomial3D
from termsel.simulate import scene_truth, simulate_scene

QUICK = {"population": 40, "polish": False}


def control_of(seed: int = 0, **more: int) -> FeatureSet:
    scene = simulate_scene("ikonos-hamedan", seed=seed, **more)
    return observe(scene, control="both", rng=np.random.default_rng(0)).together


def polylines() -> FeatureSet:
    """Points, and lines of which the first three are one feature."""
    control = control_of(n_points=12, n_lines=40, wrong_lines=0)
    lines = control.lines
    return control.with_(lines=Lines((lines.ids[0],) * 3 + lines.ids[3:], lines.image,
                                     lines.ground))


@pytest.mark.parametrize("degree", [2, 3])
def test_errors_without_a_line_are_those_of_the_others(degree: int) -> None:
    """The closed form against the whole average repeated without a line, a polyline, a point."""
    control = polylines()
    scaling, model = make_scaling(control), Polynomial3D(degree=degree)
    scaled = scaling.features(control)
    found = fit_average_with_lines(scaled, model)
    assert found is not None
    for out in (0, len(control.points), len(control.points) + 5):
        others = scaled.take(np.arange(len(scaled)) != out)
        alone = fit_average_with_lines(others, model)
        assert alone is not None
        # The weights of rows, by where approximate vertices lie, depend a little on all features.
        assert len(found.errors) - len(alone.errors) == (scaled.vertex_feature == out).sum()
        image = model.project(alone.coefficients.T.ravel(), scaled.ground_vertices())
        mine = scaled.vertex_feature == out
        if out < len(control.points):
            expected = scaled.points.image[out] - image[out]
            np.testing.assert_allclose(found.errors[out], expected, rtol=0.05, atol=2e-6)
        else:
            length = np.linalg.norm(found.errors[mine], axis=1)
            assert (length > 0).all()
            at = scaled.lines.feature == out - len(control.points)
            along = scaled.lines.image[at, 1] - scaled.lines.image[at, 0]
            normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            rho = (normal * scaled.lines.image[at].mean(axis=1)).sum(axis=1)
            seen = image[mine].reshape(-1, 2, 2)
            distance = np.abs(rho[:, None] - np.einsum("ia,iva->iv", normal, seen)).ravel()
            np.testing.assert_allclose(length, distance, rtol=0.1, atol=4e-6)


def test_points_alone_get_the_same_from_coupled_equations() -> None:
    """Two grids of scales, one posterior: the averages differ by far less than the noise."""
    control = control_of(n_points=60, n_lines=4)
    control = control.with_(lines=empty_lines())
    scaling, model = make_scaling(control), Polynomial3D(degree=3)
    scaled = scaling.features(control)
    coupled = fit_average_with_lines(scaled, model)
    apart = fit_average(scaled.points.ground, scaled.points.image, model.exponents)
    assert coupled is not None
    assert apart is not None
    difference = (coupled.errors - apart.errors) * scaling.image_scale
    assert np.sqrt((difference**2).sum(axis=1).mean()) < 0.05
    assert abs(coupled.effective - apart.effective) < 1
    assert np.sqrt((apart.errors**2).sum(axis=1).mean()) * scaling.image_scale > 0.5


@pytest.mark.parametrize("with_points", [True, False])
def test_wrong_lines_are_found_and_right_ones_kept(with_points: bool) -> None:
    control = control_of()
    if not with_points:
        control = control.with_(points=control.points.take([]))
    found = find_blunders(FitData.of(control, True))
    assert found is not None
    named = {control.ids[i] for i in np.flatnonzero(found.blunders)}
    wrong = set(scene_truth("ikonos-hamedan").wrong_lines)
    assert named <= wrong
    assert len(named) >= 0.95 * len(wrong)
    assert (found.errors[found.blunders] > 3.5).all()


def test_a_third_of_wrong_lines_is_found() -> None:
    control = control_of(n_lines=90, wrong_lines=30)
    found = find_blunders(FitData.of(control, True))
    assert found is not None
    named = {control.ids[i] for i in np.flatnonzero(found.blunders)}
    wrong = set(scene_truth("ikonos-hamedan", n_lines=90, wrong_lines=30).wrong_lines)
    assert len(named & wrong) >= 0.9 * len(wrong)
    assert len(named - wrong) <= 1


def test_right_lines_and_points_stay() -> None:
    lost = []
    for seed in range(4):
        found = find_blunders(FitData.of(control_of(seed, wrong_lines=0), True))
        assert found is not None
        lost.append(found.blunders.mean())
    assert np.mean(lost) < 0.005


def test_a_wrong_point_among_lines_is_found() -> None:
    control = control_of(n_lines=60, wrong_lines=0)
    image = control.points.image.copy()
    image[7] += [9.0, -7.0]
    spoilt = control.with_(points=replace(control.points, image=image))
    found = find_blunders(FitData.of(spoilt, True))
    assert found is not None
    assert list(np.flatnonzero(found.blunders)) == [7]


def test_shrunken_polynomials_of_lines_predict_better_than_plain_ones() -> None:
    """Few lines: least squares of all terms is far off, and leave-one-out knows."""
    control = control_of(1, n_points=8, n_lines=24, wrong_lines=0)
    choice = Auto().choose(FitData.of(control, True))
    assert choice is not None
    by_name = {one.method.name: one for one in choice.compared}
    assert choice.method.name.startswith("regularised")
    assert choice.chosen.held_out_rmse < by_name["quadratic"].held_out_rmse
    independent = simulate_scene("ikonos-hamedan", n_points=60, n_lines=0, seed=9).points
    mine, plain = (fitted.rmse(independent) for fitted in (choice.chosen, by_name["quadratic"]))
    assert mine is not None
    assert plain is not None
    assert mine.total < plain.total


@pytest.mark.slow
def test_predictions_from_lines_come_true() -> None:
    ratios = []
    for seed in range(3):
        control = control_of(seed, n_points=20, n_lines=40, wrong_lines=0)
        independent = simulate_scene("ikonos-hamedan", n_points=80, n_lines=0,
                                     seed=50 + seed).points
        both = FitData.of(control, True)
        choice, errors = Auto().choose_features(both), Auto().repeated(both)
        assert choice is not None
        assert errors is not None
        assert errors.shape == (len(control.points) + 40, 2)
        rmse = choice.chosen.rmse(independent)
        assert rmse is not None
        ratios.append(rmse.total / np.sqrt((errors**2).sum(axis=1).mean()))
    assert 0.75 < np.median(ratios) < 1.3


def noisy_lines(noise: float) -> FeatureSet:
    """A scene whose points are good, and whose lines are measured `noise` times worse."""
    scene = simulate_scene("ikonos-hamedan", n_lines=40, wrong_lines=0)
    rng = np.random.default_rng(2)
    image = scene.lines.image + rng.normal(0, noise, scene.lines.image.shape)
    return scene.with_(lines=replace(scene.lines, image=image))


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "used"), [(0.0, True), (8.0, False)])
def test_lines_are_used_only_where_they_help(noise: float, used: bool) -> None:
    result = termsel.run("owdis-lines", features=noisy_lines(noise), strategy="auto")
    lines = set(result.fit.control.lines.features)
    assert bool(lines & set(result.selection.features)) == used
    note = "None of the 40 lines is used: the points alone predict better."
    assert (note in result.notes) != used
    assert result.strategy is not None
    assert "Points alone predict the points" in result.strategy.reason
    assert result.rmse["independent"].total < 1.1


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of `of_lines`."""
    return tmp_path_factory.mktemp("of_lines")


@pytest.fixture(scope="module")
def of_lines(folder: Path) -> termsel.Result:
    return termsel.run("owdis-lines", strategy="auto", out=folder)


def test_auto_for_lines_leaves_out_blunders_and_says_which(of_lines: termsel.Result) -> None:
    wrong = set(scene_truth("ikonos-hamedan").wrong_lines)
    out = {one.id for one in of_lines.outliers if one.excluded}
    assert wrong <= out
    assert not out & set(of_lines.selection.features)
    assert {one.kind for one in of_lines.outliers} == {"line"}
    assert {one.role for one in of_lines.outliers} == {"control"}
    assert "8 lines rejected: " in of_lines.summary()
    searched = termsel.run("owdis-lines", generations=8, options=QUICK)
    assert of_lines.rmse["independent"].total < searched.rmse["independent"].total
    assert of_lines.data.counts.lines == 120
    used = {r.id for r in of_lines.residuals if r.kind == "vertex 1" and not r.used}
    assert used == out


def test_auto_for_lines_is_read_back(of_lines: termsel.Result, folder: Path, tmp_path: Path,
                                     ) -> None:
    found, again = of_lines, read_result(folder)
    assert again.to_dict() == found.to_dict()
    assert list(again.residuals) == list(found.residuals)
    ground = found.features.points.ground
    np.testing.assert_allclose(again.project(ground), found.project(ground))
    assert found.final is not None
    assert again.final is not None
    assert again.final.control.ids == found.final.control.ids
    assert not {one.id for one in found.outliers} & set(again.final.control.ids)
    assert list(again.as_exported().residuals) == list(found.as_exported().residuals)
    assert f"all {len(found.final.control)} features. The measured" in found.summary(verbose=True)
    termsel.export(again, "lines-csv", tmp_path / "all.csv")
    rows = [row.split(",") for row in (tmp_path / "all.csv").read_text().splitlines()[2:]]
    assert {row[0] for row in rows if row[2] == "0"} == {one.id for one in found.outliers}


@pytest.mark.parametrize(("points", "lines"), [(0, 2), (0, 3), (0, 4), (2, 2), (1, 3), (0, 5)])
def test_few_lines_are_answered(points: int, lines: int) -> None:
    scene = simulate_scene("ikonos-hamedan", n_lines=30, wrong_lines=0)
    control = replace(scene.points.take(np.arange(points)), roles=("control",) * points)
    features = FeatureSet(control, scene.lines.take(5 * np.arange(lines)), crs=scene.crs)
    result = termsel.run(features=features)
    assert len(result.fit.control) == points + lines
    assert "points determine" not in result.summary(verbose=True)
    if points + lines == 4:  # lines alone are too few to predict by
        assert (result.predicted is None) == (points == 0)


@pytest.mark.slow
def test_independent_points_take_no_part_with_lines() -> None:
    scene = simulate_scene("ikonos-hamedan", n_lines=40)
    independent = np.array(scene.points.roles) == "independent"
    moved = scene.with_(points=replace(
        scene.points, image=scene.points.image + 7.0 * independent[:, None]))
    for more in ({"strategy": "auto"}, {"generations": 5, "seed": 2, "options": QUICK}):
        one, other = (termsel.run("owdis-lines", features=features, **more).to_dict()
                      for features in (scene, moved))
        assert one["rmse"]["independent"] != other["rmse"]["independent"]
        for key in ("selection", "coefficients", "objectives", "options", "evaluations"):
            assert one[key] == other[key], key
        of_control = [[o for o in record["outliers"] if o["role"] != "independent"]
                      for record in (one, other)]
        assert of_control[0] == of_control[1]
        assert one["strategy"] == other["strategy"]
        assert [b["name"] for b in one["baselines"]] == [b["name"] for b in other["baselines"]]
        for a, b in zip(one["baselines"], other["baselines"], strict=True):
            assert (a["predicted"], a["rmse"]["check"]) == (b["predicted"], b["rmse"]["check"])


@pytest.mark.slow
def test_the_search_stays_the_default_of_its_problem() -> None:
    scene = simulate_scene("ikonos-hamedan", n_points=30, n_lines=14)
    assert termsel.run("owdis-lines", features=scene, options=QUICK).strategy is None
    unnamed = termsel.run(features=scene)
    assert unnamed.problem == "owdis-lines"
    assert unnamed.strategy is not None
    assert unnamed.strategy.name == "auto"
    asked = termsel.run(features=scene, generations=2, options=QUICK)
    assert asked.strategy is None


@pytest.mark.slow
def test_lines_without_a_problem_are_answered_by_auto(of_lines: termsel.Result, folder: Path,
                                                      ) -> None:
    done = CliRunner().invoke(cli, [
        "run", "--lines", str(folder / "lines.csv"), "--crs", "EPSG:4979", "--json"])
    assert done.exit_code == 0, done.output
    record = json.loads(done.stdout)
    assert record["strategy"]["name"] == "auto"
    assert record["strategy"]["predicted"] > 0
    assert {one["id"] for one in record["outliers"] if one["excluded"]} >= set(
        scene_truth("ikonos-hamedan").wrong_lines)
    assert record["rmse"]["independent"]["total"] is None


def searched(**options: object) -> termsel.Result:
    return termsel.run("owdis-lines", seed=6, generations=2, options={**QUICK, **options})


@pytest.mark.slow
def test_a_search_leaves_no_blunder_in_use_that_it_names() -> None:
    kept, clean = searched(blunders="keep"), searched()
    assert any(not one.excluded for one in kept.outliers)
    assert all(one.excluded for one in clean.outliers)
    assert clean.outliers
    assert [one.id for one in clean.outliers] == [one.id for one in kept.outliers]
    assert not {one.id for one in clean.outliers} & set(clean.selection.features)
    said = "Outliers were removed before the search; --set blunders=keep keeps them."
    assert said in clean.notes
    assert said not in kept.notes
    assert clean.rmse["independent"].total < 1.1 * kept.rmse["independent"].total


@pytest.mark.slow
def test_blunders_that_the_user_wants_stay() -> None:
    wrong = scene_truth("ikonos-hamedan").wrong_lines[0]
    result = searched(force_on=wrong)
    assert wrong in result.selection.features
    assert [one.id for one in result.outliers if not one.excluded] == [wrong]


@pytest.mark.slow
def test_too_few_features_for_a_search_without_blunders_are_said_to_be() -> None:
    result = searched(min_features=118)
    note, = (note for note in result.notes if note.startswith("Blunders are in use"))
    assert note.endswith("without them no selection satisfies all conditions.")
    assert any(not one.excluded for one in result.outliers)


@pytest.mark.slow
def test_a_search_is_told_where_a_robust_fit_is_no_worse() -> None:
    result = termsel.run("owdis-lines", generations=1, options=QUICK)
    rows = {one.name: one for one in result.baselines}
    assert {"huber", "tukey", "without-blunders"} <= set(rows)
    reference = rows["without-blunders"].rmse["independent"].total
    assert reference < rows["quadratic"].rmse["independent"].total
    assert result.rmse["independent"].total > 1.05 * reference
    assert "outliers removed, is" in result.judgement
    assert "omit --problem, --solver and --model" in result.judgement
    assert "outliers removed *" in result.summary(verbose=True)


@pytest.mark.slow
def test_searches_over_points_are_compared_with_robust_fits_too() -> None:
    scene = simulate_scene("ikonos-hamedan", n_points=90, n_lines=0)
    roles = np.array(scene.points.roles)
    image = scene.points.image.copy()
    bad = np.flatnonzero(roles != "independent")[5:9]
    image[bad] += [[20.0, 9.0], [-30.0, 12.0], [14.0, -22.0], [8.0, 18.0]]
    spoilt = scene.with_(points=replace(scene.points, image=image))
    result = termsel.run("rfm-terms", features=spoilt, generations=2, options=QUICK)
    rows = {one.name: one.rmse["independent"] for one in result.baselines}
    assert rows["without-blunders"].total < 0.5 * rows["regularised-cubic"].total
    assert rows["tukey"].total < 0.5 * rows["quadratic"].total
    assert "outliers removed, is" in result.judgement
    clean = termsel.run("rfm-terms", features=scene, generations=2, options=QUICK)
    assert "without-blunders" not in {one.name for one in clean.baselines}
    assert {"huber", "tukey"} <= {one.name for one in clean.baselines}


@pytest.mark.slow
def test_plane_lines_get_plane_models() -> None:
    scene = simulate_scene("ikonos-hamedan", n_lines=40)
    flat = scene.lines.ground.copy()
    flat[..., 2] = np.nan
    ground = scene.points.ground.copy()
    ground[:, 2] = np.nan
    features = scene.with_(points=replace(scene.points, ground=ground),
                           lines=replace(scene.lines, ground=flat))
    result = termsel.run("owdis-lines", features=features, strategy="auto")
    assert not result.fit.model.uses_height


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ikonos_lines", "ventoux_lines"])
def test_real_geometry(data_folder: Path, name: str) -> None:
    features = termsel.read(data_folder / name / "points.csv", data_folder / name / "lines.csv",
                            crs="EPSG:4979")
    auto, searched = (termsel.run("owdis-lines", features=features, strategy=strategy)
                      for strategy in ("auto", None))
    assert auto.rmse["independent"].total < {"ikonos_lines": 0.75, "ventoux_lines": 0.85}[name]
    assert auto.rmse["independent"].total < searched.rmse["independent"].total
    assert all(one.excluded for one in searched.outliers)
    assert len([one for one in auto.outliers if one.excluded]) >= 13


@pytest.mark.slow
def test_where_points_alone_are_used_they_alone_predict() -> None:
    scene = simulate_scene("ikonos-hamedan", n_lines=40)
    rng = np.random.default_rng(1)
    lines = scene.lines
    rough = scene.with_(lines=replace(lines, image=lines.image + rng.normal(
        0.0, 8.0, lines.image.shape)))
    found = termsel.run("owdis-lines", features=rough, strategy="auto")
    alone = termsel.run("rfm-terms", features=scene.with_(lines=empty_lines()))
    assert "so the lines are not used." in found.strategy.reason
    assert found.predicted.rmse == pytest.approx(alone.predicted.rmse, rel=0.05)


@pytest.mark.slow
def test_lines_that_are_not_used_say_nothing_of_the_prediction() -> None:
    scene = simulate_scene("ikonos-hamedan", n_points=20, n_lines=8)
    error = np.random.default_rng(1).normal(0.0, 12.0, scene.lines.image.shape)
    rough = scene.with_(lines=replace(scene.lines, image=scene.lines.image + error))
    result = termsel.run("owdis-lines", features=rough, strategy="auto")
    assert not any(one.used for one in result.residuals if one.kind != "point")
    assert result.predicted is not None
    assert result.predicted.rmse < 1.3  # the lines are off by 12 px
