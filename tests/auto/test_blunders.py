"""Blunders among points: the strategy auto finds them, names them and does without them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import fdtrc

import termsel
from termsel import FeatureSet, Points
from termsel.adjustment.bayesian.held_out import chance_of
from termsel.adjustment.bayesian.posterior import scales_of, solve_posterior
from termsel.auto import contradictions
from termsel.auto.auto import Auto
from termsel.auto.blunders import _agreeing_features, find_blunders, judge_others
from termsel.auto.contradictions import Test as Contradictions
from termsel.auto.memory import Memory
from termsel.auto.misplaced import misplaced_points
from termsel.auto.shrunken import fit_average
from termsel.data.features import empty_lines, empty_points
from termsel.data.fit_data import FitData
from termsel.data.monomials import evaluate_monomials, graded_exponents
from termsel.data.record.figures import as_plain_data
from termsel.data.scaling import make_scaling


def scene(n: int, seed: int = 1, name: str = "ikonos-hamedan") -> FeatureSet:
    return termsel.simulate_scene(name, seed=seed, n_points=n).with_(lines=empty_lines())


def moved(features: FeatureSet, shifts: dict[int, tuple[float, float]]) -> FeatureSet:
    image = features.points.image.copy()
    for at, shift in shifts.items():
        image[at] += shift
    return features.with_(points=replace(features.points, image=image))


def all_control(features: FeatureSet) -> FeatureSet:
    points = features.points
    return FeatureSet(Points(points.ids, points.image, points.ground), crs=features.crs,
                      lines=empty_lines())


@pytest.mark.slow_cases(
    "ikonos-hamedan-0", "ikonos-hamedan-1", "ikonos-hamedan-2", "ikonos-hamedan-3",
    "irs1c-mashad-1", "irs1c-mashad-2", "irs1c-mashad-3", "spot-isfahan-0", "spot-isfahan-1",
    "spot-isfahan-2", "spot-isfahan-3")
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", ["ikonos-hamedan", "spot-isfahan", "irs1c-mashad"])
def test_a_fifth_of_blunders_is_found_and_nothing_else(name: str, seed: int) -> None:
    clean = all_control(scene(50, seed, name))
    rng = np.random.default_rng(seed)
    wrong = rng.choice(50, 10, replace=False)
    angle, size = rng.uniform(0, 2 * np.pi, 10), 0.5 * 10 ** rng.uniform(1.2, 2, 10)
    spoilt = moved(clean, {int(at): (s * np.cos(a), s * np.sin(a))
                           for at, s, a in zip(wrong, size, angle, strict=True)})
    found = find_blunders(FitData.of(spoilt, True))
    assert found is not None
    assert set(np.flatnonzero(found.blunders)) == set(wrong)
    nothing = find_blunders(FitData.of(clean, True))
    assert nothing is not None
    assert not nothing.blunders.any()


def test_of_many_points_some_compare_the_polynomials(monkeypatch: pytest.MonkeyPatch) -> None:
    control = FitData.of(all_control(scene(50)), True)
    used = np.arange(50) != 7

    def compared() -> np.ndarray:
        found = contradictions._prediction_of_points(contradictions.Division(control, used), 2)
        assert found is not None
        return found.squares

    every = compared()
    assert every.shape == (49,)
    monkeypatch.setattr(contradictions, "MAX_COMPARED_POINTS", 20)
    np.testing.assert_allclose(compared(), every[::3], rtol=1e-9)


@pytest.mark.slow
def test_blunders_do_not_spoil_the_accuracy_and_are_told() -> None:
    clean = scene(74)
    control, check, independent = (clean.points.roles.index(role)
                                   for role in ("control", "check", "independent"))
    ids = clean.points.ids
    spoilt = termsel.run("rfm-terms", features=moved(
        clean, {control: (30.0, -12.0), check: (0.0, 25.0), independent: (40.0, 0.0)}))
    before = termsel.run("rfm-terms", features=clean)
    assert [(one.id, one.role, one.kind, one.excluded) for one in spoilt.outliers] == [
        (ids[control], "control", "point", True), (ids[check], "check", "point", True),
        (ids[independent], "independent", "point", False)]
    assert [one.error for one in spoilt.outliers] == pytest.approx([30.0, 25.0, 40.0], abs=2.5)
    assert {one.certainty for one in spoilt.outliers} == {"certain"}
    assert before.outliers == ()
    assert spoilt.notes == before.notes == ()
    said = " ".join(spoilt.summary().split())
    assert f"Outliers 2 points rejected: {ids[control]} " in said
    assert f"1 independent check point contradicts the model: {ids[independent]} " in said
    assert spoilt.next_step("r") == (
        f"Next: run again with options={{'off': '{ids[independent]}'}}")
    independent_rmse, bare_rmse = spoilt.rmse["independent"], before.rmse["independent"]
    assert independent_rmse is not None
    assert bare_rmse is not None
    assert independent_rmse.total > 5 * bare_rmse.total  # it counts, and is told without
    assert spoilt.accuracy_without is not None
    assert before.accuracy_without is None
    assert spoilt.accuracy_without.image.total == pytest.approx(bare_rmse.total, rel=0.1)
    assert spoilt.strategy is not None
    assert before.strategy is not None
    assert spoilt.strategy.predicted == pytest.approx(before.strategy.predicted, rel=0.1)


@pytest.mark.slow
def test_independent_points_change_nothing_but_their_own_figures() -> None:
    clean = scene(60)
    at = clean.points.roles.index("independent")
    runs = [termsel.run("rfm-terms", features=one).to_dict()
            for one in (clean, moved(clean, {at: (500.0, 80.0)}))]
    for key in ("selection", "coefficients", "strategy", "scaling"):
        assert runs[0][key] == runs[1][key]
    assert runs[0]["rmse"]["check"] == runs[1]["rmse"]["check"]
    assert runs[1]["outliers"][0]["role"] == "independent"
    assert not runs[1]["outliers"][0]["excluded"]


@pytest.mark.slow
def test_a_result_without_its_blunders_is_read_back_as_it_was(tmp_path: Path) -> None:
    clean = scene(40)
    at = clean.points.roles.index("control")
    result = termsel.run("rfm-terms", features=moved(clean, {at: (25.0, 25.0)}), out=tmp_path)
    again = termsel.read_result(tmp_path)
    assert again.outliers == result.outliers != ()
    assert again.summary() == result.summary()
    record = json.loads((tmp_path / "result.json").read_text())
    assert record["data"]["roles"]["off"] == [clean.points.ids[at]]
    assert record["outliers"][0]["id"] == clean.points.ids[at]


def test_a_point_that_says_it_is_inexact_is_no_blunder() -> None:
    clean = all_control(scene(45))
    spoilt = moved(clean, {7: (40.0, 0.0)})
    sigma = np.full((45, 2), 0.5)
    sigma[7] = 40.0
    told = spoilt.with_(points=replace(spoilt.points, sigma=sigma))
    found, known = find_blunders(FitData.of(spoilt, True)), find_blunders(FitData.of(told, True))
    assert found is not None
    assert known is not None
    assert list(np.flatnonzero(found.blunders)) == [7]
    assert not known.blunders.any()


def test_rounding_errors_are_no_blunders() -> None:
    rng = np.random.default_rng(0)
    ground = rng.uniform(0, [1000, 1000, 100], (40, 3))
    bend = ground[:, :1] ** 2 * [1e-4, 0]
    image = ground[:, 1::-1] * [-2, 2] + ground[:, 2:] * [0.1, -0.2] + bend
    exact = FeatureSet(Points(tuple(map(str, range(40))), image, ground), empty_lines(), "local")
    found = termsel.run("rfm-terms", options={"fractions": "1:1:0"}, features=exact)
    assert found.strategy is not None
    assert found.strategy.predicted < 1e-6
    assert found.outliers == ()
    assert found.notes == ()


@pytest.mark.parametrize(("error", "blunder"), [(5e-7, False), (5e-5, True)])
def test_an_error_below_rounding_is_no_blunder(error: float, blunder: bool) -> None:
    rng = np.random.default_rng(0)
    ground = rng.uniform(0, [1000, 1000, 100], (40, 3))
    image = ground[:, 1::-1] * 2 + ground[:, 2:] * [0.1, -0.2] + ground[:, :1] ** 2 * [1e-4, 0]
    image[7, 0] += error
    found = find_blunders(FitData.of(FeatureSet(Points(tuple(map(str, range(40))), image, ground),
                                     empty_lines(), "local"), True))
    assert found is not None
    assert list(np.flatnonzero(found.blunders)) == ([7] if blunder else [])
    points = Points(tuple(map(str, range(40))), image, ground)
    there = np.isin(np.arange(40), [7, 8, 9])
    choice = Auto(
        ).choose(FitData.of(FeatureSet(points.take(~there), empty_lines(), "local"), True))
    assert choice is not None
    others = judge_others(choice.chosen, True, points.take(there), Memory())
    assert others is not None
    assert list(others.blunders) == [blunder, False, False]


@pytest.mark.slow
def test_few_points_say_what_cannot_be_found() -> None:
    points = scene(74).points.take(np.arange(9))
    few = FeatureSet(replace(points, roles=("control",) * 9), empty_lines(), "EPSG:4979")
    note, = (one for one in termsel.run("rfm-terms", features=few).notes
             if one.startswith("With 9 points an error must exceed "))
    worst = find_blunders(FitData.of(few, True)).limits.argmax()
    assert note.endswith(f" px at {points.ids[int(worst)]}.")
    more = termsel.run("rfm-terms", features=scene(60))
    assert not any(note.startswith("With ") for note in more.notes)


def blank(n: int) -> FeatureSet:
    points = scene(74).points.take(np.arange(n) * 5)
    return FeatureSet(Points(points.ids, points.image, points.ground), empty_lines(), "EPSG:4979")


@pytest.mark.slow_cases("8", "14")
@pytest.mark.parametrize("n", [5, 8, 11, 14])
def test_few_points_without_roles_are_all_control(n: int) -> None:
    result = termsel.run("rfm-terms", features=blank(n))
    assert as_plain_data(result.data.counts) == {
        "control": n, "check": 0, "independent": 0, "lines": 0, "off": 0}
    assert result.strategy is not None
    assert result.strategy.predicted is not None


@pytest.mark.slow
def test_roles_are_assigned_where_shares_are_given() -> None:
    for options in ({"fractions": "2:1:1"}, {"fractions": "1:1:1"}, {"roles": "random"}):
        result = termsel.run("rfm-terms", features=blank(11), options=options)
        assert result.data.counts.independent > 0


def test_no_others_are_not_judged() -> None:
    choice = Auto().choose(FitData.of(termsel.simulate_scene("ikonos-hamedan", n_lines=0), True))
    assert choice is not None
    assert judge_others(choice.chosen, True, empty_points(), Memory()) is None


def test_the_chance_of_a_statistic_is_that_of_the_f_distribution() -> None:
    statistic = np.array([0.0, 0.3, 2.0, 40.0])
    for freedom in (2, 7, 1400):
        for pairs in (1, 2, 5):
            np.testing.assert_allclose(chance_of(statistic, freedom, pairs),
                                       fdtrc(2 * pairs, freedom, statistic), rtol=1e-9)


def test_a_prediction_is_the_mean_over_all_solutions() -> None:
    """The compiled means against those by logarithms, with points not in use."""
    features = scene(60)
    used = np.arange(60) < 45
    scaled = make_scaling(features).points(features.points)
    exponents = graded_exponents(2, 3)
    order = np.array(exponents).sum(axis=1)
    found = solve_posterior(evaluate_monomials(scaled.ground, exponents), scaled.image, order,
                            np.where(used, 1.0, 1e-3)[:, None] * np.ones((60, 2)),
                            scales_of(np.array(exponents)[order > 1]), int(used.sum()))
    assert found is not None
    left, errors = (np.array(
        [getattr(side, name)[side.solution_of_cell].T for side in found.errors_of(slice(45))])
                    for name in ("redundancies", "errors"))  # (2, n, c)
    half = found.freedom // 2 - 1
    parts = (errors**2 / left).sum(axis=0)
    rest = found.square - parts
    logs = (np.log(found.cells.share) + found.cells.log_evidence
            + (half + 1) * np.log(found.square) - half * np.log(rest)
            - np.log(left).sum(axis=0) / 2)
    total = np.logaddexp.reduce(logs, axis=1)
    share = np.exp(logs - total[:, None])
    statistic = half * parts / rest
    direct = {"errors": np.einsum("nc,anc->na", share, errors / left), "log_evidence": total,
              "probability": (share * fdtrc(2, 2 * half, statistic)).sum(axis=1),
              "statistic": (share * statistic).sum(axis=1),
              "spread": np.einsum("nc,anc->na", share, 1 / left)}
    for name, expected in direct.items():
        np.testing.assert_allclose(getattr(found.held_out, name), expected, rtol=1e-7, atol=1e-12)


def test_many_points_are_left_out_in_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    exponents = graded_exponents(2, 3)
    order = np.array(exponents).sum(axis=1)
    points = make_scaling(scene(61)).points(scene(61).points)

    def predicted() -> dict[str, np.ndarray]:
        found = solve_posterior(evaluate_monomials(points.ground, exponents), points.image, order,
                                None,
                                scales_of(np.array(exponents)[order > 1]), len(points))
        assert found is not None
        return vars(found.held_out)

    whole = predicted()
    monkeypatch.setattr("termsel.adjustment.bayesian.posterior.POINTS_AT_ONCE", 20)
    for name, values in predicted().items():
        np.testing.assert_allclose(values, whole[name], rtol=1e-9, atol=1e-12)


def test_a_prediction_without_a_point_is_that_of_the_others() -> None:
    """The closed form against the posterior computed again; a tiny weight against both."""
    rng = np.random.default_rng(5)
    ground = rng.uniform(-1, 1, (20, 3))
    exponents = graded_exponents(2, 3)
    order = np.array(exponents).sum(axis=1)
    image = evaluate_monomials(ground, exponents) @ rng.standard_normal((10, 2)) \
        + 0.01 * rng.standard_normal((20, 2))
    scales = scales_of(np.array(exponents)[order > 1])
    columns = evaluate_monomials(ground, exponents)
    whole = solve_posterior(columns, image, order, None, scales, 20)
    weights = np.ones((20, 2))
    weights[19] = 1e-3
    others = solve_posterior(columns, image, order, weights, scales, 19)
    assert whole is not None
    assert others is not None
    closed, direct = whole.held_out, others.predict_unused(1e-3)
    keep = np.arange(20) != 19
    alone = fit_average(ground[keep], image[keep], exponents)
    assert alone is not None
    there = image[19] - columns[19] @ alone.coefficients
    np.testing.assert_allclose(closed.errors[19], there, rtol=1e-6)
    np.testing.assert_allclose(direct.errors[0], there, rtol=1e-4)
    for name in ("probability", "statistic", "spread"):
        np.testing.assert_allclose(getattr(closed, name)[19], getattr(direct, name)[0], rtol=1e-4)


def test_an_error_says_nothing_where_its_prediction_is_as_uncertain() -> None:
    none = np.zeros(3)
    found = Contradictions(none, none, np.array([0.9, 4.5, 5.5]), np.array([1.0, 5.0, 5.0]), 0.3,
                           20, none)
    assert found.beyond_form().tolist() == [False, False, True]


def hemisphere(longitude: np.ndarray, latitude: np.ndarray) -> np.ndarray:
    """Positions on a stereographic map of half the Earth, of 7000 px."""
    away = 1.0 + np.cos(latitude) * np.cos(longitude)
    return 1750 * np.stack([-np.sin(latitude), np.cos(latitude) * np.sin(longitude)], 1) / away[
        :, None]


def mercator(longitude: np.ndarray, latitude: np.ndarray) -> np.ndarray:
    """Positions on a Mercator map of the world, of 7000 px."""
    return 1150 * np.stack([-np.arctanh(np.sin(latitude)), longitude], 1)


def small_scale_map(project: Callable[[np.ndarray, np.ndarray], np.ndarray], reach: float,
                    seed: int, wrong: int = 0) -> tuple[FitData, np.ndarray]:
    """A map of 25 points with errors of 6 px, the last of them wrong by some 250 px."""
    rng = np.random.default_rng(seed)
    longitude = rng.uniform(-reach, reach, 25)
    latitude = rng.uniform(-75.0, 75.0, 25)
    image = project(np.radians(longitude), np.radians(latitude)) + rng.normal(0.0, 6.0, (25, 2))
    is_wrong = np.arange(25) >= 25 - wrong
    angle = rng.uniform(0.0, 2.0 * np.pi, 25)
    image[is_wrong] += 250.0 * np.stack([np.cos(angle), np.sin(angle)], 1)[is_wrong]
    ground = np.stack([longitude, latitude, np.full(25, np.nan)], 1)
    points = Points(tuple(f"P{i}" for i in range(25)), image, ground)
    return FitData.of(FeatureSet(points, crs="EPSG:4326", lines=empty_lines()), False), is_wrong


@pytest.mark.slow_cases("mercator-175.0")
@pytest.mark.parametrize(("project", "reach"), [(hemisphere, 80.0), (mercator, 175.0)])
def test_right_points_of_a_map_of_half_the_earth_are_no_blunders(
        project: Callable[[np.ndarray, np.ndarray], np.ndarray], reach: float) -> None:
    named = []
    for seed in range(10):
        found = find_blunders(small_scale_map(project, reach, seed)[0])
        assert found is not None
        named.append(int(found.blunders.sum()))
    # A cubic polynomial alone names points of five and of eight of the ten.
    assert sum(named) <= 1


def test_blunders_on_a_map_of_the_world_are_still_found() -> None:
    found = []
    for seed in range(10):
        data, is_wrong = small_scale_map(mercator, 175.0, seed, wrong=2)
        suspects = find_blunders(data)
        assert suspects is not None
        found.append(int((suspects.blunders & is_wrong).sum()))
    assert sum(found) >= 18


@pytest.mark.slow_cases("ikonos-hamedan-33-False", "spot-isfahan-12-True")
@pytest.mark.parametrize("two", [False, True])
@pytest.mark.parametrize(("name", "count"), [("ikonos-hamedan", 33), ("spot-isfahan", 12)])
def test_a_degree_that_is_wrong_is_a_blunder_though_polynomials_could_bend_to_it(
        name: str, count: int, two: bool) -> None:
    scene = termsel.simulate_scene(name, n_points=count, seed=1)
    ground = scene.points.ground.copy()
    ground[7, 0] += 1.0
    if two:  # two points that are wrong, in unlike directions
        ground[3, 1] -= 1.0
    points = replace(scene.points, ground=ground, roles=("control",) * count)
    wrong = [3, 7] if two else [7]
    alone = scene.with_(points=points, lines=empty_lines())
    for right, features in ((scene.with_(lines=empty_lines()), alone),
                            (scene, scene.with_(points=points))):
        before = find_blunders(FitData.of(right))
        suspects = find_blunders(FitData.of(features))
        assert before is not None
        assert suspects is not None
        assert sorted(np.flatnonzero(before.blunders).tolist() + wrong) == \
            np.flatnonzero(suspects.blunders).tolist()
    result = termsel.run(features=alone)
    assert result.predicted is not None
    assert result.predicted.rmse < 3.0


def test_far_ground_that_an_oblique_view_shows_over_near_points_is_no_blunder() -> None:
    # A camera 500 m above the plain looks down by 20 degrees; a lake 30 km away lies below near
    # summits in the image.
    rng = np.random.default_rng(2)
    near = np.column_stack([rng.uniform(-600, 600, 14), rng.uniform(900, 2200, 14),
                            rng.uniform(0, 420, 14)])
    ground = np.vstack([near, [[0.0, 30000.0, 0.0]]])
    seen = ground - [0.0, 0.0, 500.0]
    angle = np.radians(20.0)
    ahead = np.cos(angle) * seen[:, 1] - np.sin(angle) * seen[:, 2]
    below = -np.sin(angle) * seen[:, 1] - np.cos(angle) * seen[:, 2]
    image = np.column_stack([1000 + 2000 * below / ahead, 1500 + 2000 * seen[:, 0] / ahead])
    points = Points(tuple(f"P{i:02}" for i in range(15)), image + rng.normal(0, 0.5, (15, 2)),
                    ground + np.array([5e5, 5e6, 0.0]))
    features = FeatureSet(points, crs="EPSG:32632", image_size=(2000, 3000))
    suspects = find_blunders(FitData.of(features))
    assert suspects is not None
    assert not suspects.blunders.any()


def panorama(seed: int, *, count: int = 40) -> FeatureSet:
    """Return places of a plain on an upright cylinder, down from near the horizon, with noise."""
    rng = np.random.default_rng(seed)
    focal, altitude = 2000.0, 600.0
    azimuth, slope = rng.uniform(-1.0, 1.0, count), rng.uniform(np.tan(np.radians(3.0)), 1.0, count)
    distance = altitude / slope
    ground = np.column_stack([distance * np.sin(azimuth), distance * np.cos(azimuth),
                              np.full(count, np.nan)])
    image = focal * np.column_stack([slope, azimuth]) + 4.0 * rng.standard_normal((count, 2))
    return FeatureSet(Points(tuple(f"P{i:02}" for i in range(count)), image,
                             ground + np.array([5e5, 5e6, 0.0])), crs="EPSG:32632")


@pytest.mark.parametrize("seed", range(6))
def test_ground_near_the_horizon_of_a_panorama_is_no_blunder(seed: int) -> None:
    suspects = find_blunders(FitData.of(panorama(seed)))
    assert suspects is not None
    assert not suspects.blunders.any()


@pytest.mark.parametrize("view", ["panorama", "photograph"])
def test_ground_near_the_horizon_is_not_out_of_place(view: str) -> None:
    for seed in range(40):
        points = panorama(seed).points
        if view == "photograph":  # the same rays on a plane
            turn = points.image[:, 1] / 2000.0
            image = np.column_stack([points.image[:, 0] / np.cos(turn), 2000.0 * np.tan(turn)])
            points = replace(points, image=image)
        assert not misplaced_points(points)[0].any()


def test_a_digit_that_is_wrong_in_a_panorama_is_no_blunder_for_certain_but_named() -> None:
    features = panorama(2)
    ground = features.points.ground.copy()
    near = int(np.argmin(np.linalg.norm(ground[:, :2] - [5e5, 5e6], axis=1)))
    ground[near, 0] += 20_000.0
    suspects = find_blunders(FitData.of(
        features.with_(points=replace(features.points, ground=ground))))
    assert suspects is not None
    assert (suspects.blunders | suspects.undecided)[near]


def test_a_digit_that_is_wrong_is_out_of_place_on_a_map_with_errors_of_drawing() -> None:
    rng = np.random.default_rng(4)
    plan = rng.uniform(0.0, 1000.0, (20, 2))
    image = plan[:, ::-1] * [-1.0, 1.0] + 15.0 * rng.standard_normal((20, 2))
    plan[5, 0] += 10_000.0
    points = Points(tuple(f"P{i:02}" for i in range(20)), image,
                    np.column_stack([plan, np.full(20, np.nan)]))
    assert np.flatnonzero(misplaced_points(points)[0]).tolist() == [5]


def distorted_map(seed: int, *, size: float, length: float = 0.8) -> FeatureSet:
    """Return 16 points of a map that is deformed smoothly by so many px, with noise of 4 px."""
    rng = np.random.default_rng(seed)
    plan = rng.uniform(0.0, 1.0, (16, 2))
    distances = np.linalg.norm(plan[:, None] - plan, axis=2) / length
    covariance = (1.0 + np.sqrt(3.0) * distances) * np.exp(-np.sqrt(3.0) * distances)
    factor = np.linalg.cholesky(covariance + 1e-9 * np.eye(16))
    deformation = size * factor @ rng.standard_normal((16, 2))
    noise = 4.0 * rng.standard_normal((16, 2))
    ground = np.column_stack([2000.0 * plan, np.full(16, np.nan)])
    points = Points(tuple(f"P{i:02}" for i in range(16)),
                    5000.0 * plan[:, ::-1] * [-1.0, 1.0] + deformation + noise, ground)
    return FeatureSet(points, crs="EPSG:32632")


@pytest.mark.parametrize(("seed", "length"), [(18, 0.8), (43, 0.5), (53, 0.5)])
def test_a_point_that_alone_shows_a_deformation_stays_in_use_and_is_named(
        seed: int, length: float) -> None:
    suspects = find_blunders(FitData.of(distorted_map(seed, size=60.0, length=length)))
    assert suspects is not None
    assert not suspects.blunders.any()
    assert suspects.undecided.any()


def test_blunders_at_the_edge_of_a_map_without_deformation_are_still_found() -> None:
    found = []
    for seed in range(8):
        features = distorted_map(seed, size=0.0)
        corner = int(features.points.ground[:, :2].sum(axis=1).argmax())
        suspects = find_blunders(FitData.of(moved(features, {corner: (60.0, -60.0)})))
        assert suspects is not None
        found.append(np.flatnonzero(suspects.blunders).tolist() == [corner])
    assert sum(found) >= 7


def test_limits_of_detection_do_not_depend_on_a_point_out_of_place() -> None:
    features = scene(74)
    points = features.points
    # Waves of 20 px, which a random field follows and a polynomial does not.
    waves = 20.0 * np.sin(points.image[:, ::-1] / 1500.0)
    points = replace(points, image=points.image + waves)
    ground = points.ground.copy()
    ground[10, :2] += (1.0, 0.8)  # degrees: outside of anything that the image shows
    others = np.arange(len(points)) != 10
    suspects = find_blunders(FitData.of(
        features.with_(points=replace(points, ground=ground))))
    without = find_blunders(FitData.of(features.with_(points=points.take(others))))
    assert suspects is not None
    assert without is not None
    assert suspects.blunders.nonzero()[0].tolist() == [10]
    assert np.median(suspects.limits[others]) == pytest.approx(np.median(without.limits), rel=0.15)


@pytest.mark.parametrize("wrong", [0, 8])
def test_two_tests_show_that_none_of_many_points_is_a_blunder(
    wrong: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    control = FitData.of(moved(all_control(scene(120)),
                               {7 * i: (20.0, -10.0) for i in range(wrong)}), True)
    tests = []
    clearly_better_of = contradictions._clearly_better_of

    def counted(*tests_of_degrees: Any) -> Any:
        tests.append(1)
        return clearly_better_of(*tests_of_degrees)

    monkeypatch.setattr(contradictions, "_clearly_better_of", counted)
    everything = contradictions.Division(control, np.ones(120, dtype=bool))
    by_steps = _agreeing_features(control, cache(everything.shrunken_test))
    steps = len(tests)
    monkeypatch.setattr("termsel.auto.blunders.MANY_POINTS", 100)
    found = _agreeing_features(control, cache(everything.shrunken_test))
    assert found is not None
    assert by_steps is not None
    assert (~found[0]).sum() == wrong
    np.testing.assert_array_equal(found[0], by_steps[0])
    np.testing.assert_array_equal(found[1].strain, by_steps[1].strain)
    assert steps > 8
    assert len(tests) - steps == (steps if wrong else 2)
