"""Points that repeat each other share a role and a fold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import termsel
from termsel.data.features import FeatureSet, Points, empty_lines
from termsel.data.roles import find_twins, with_merged_twins
from termsel.selection.criteria import KFold


def scene(n: int = 16) -> FeatureSet:
    given = termsel.simulate_scene("ikonos-hamedan", n_points=n)
    points = given.points
    return FeatureSet(Points(points.ids, points.image, points.ground), crs=given.crs)


def twice(features: FeatureSet, shift: float = 1e-8) -> FeatureSet:
    points = features.points
    again = Points(tuple(f"{name}-again" for name in points.ids), points.image,
                   points.ground + np.array([shift, 0.0, 0.0]))
    return features.with_(points=points.join(again))


@pytest.mark.slow
def test_repeated_points_promise_no_accuracy_that_is_not_there() -> None:
    # So many that both have points in each role.
    plain, repeated = (termsel.run("rfm-terms", features=one)
                       for one in (scene(80), twice(scene(80))))
    for role in ("control", "check", "independent"):
        ours, theirs = repeated.rmse[role], plain.rmse[role]
        assert ours is not None
        assert theirs is not None
        assert ours.total == pytest.approx(theirs.total, rel=1e-3)
        assert ours.n == 2 * theirs.n
        ids = set(getattr(repeated.data.roles, role))
        assert {name.removesuffix("-again") for name in ids} == set(getattr(plain.data.roles, role))
    assert repeated.strategy is not None
    assert plain.strategy is not None
    assert repeated.strategy.predicted == pytest.approx(plain.strategy.predicted, rel=1e-3)
    assert repeated.strategy.folds == plain.strategy.folds
    assert repeated.final is not None
    assert plain.final is not None
    np.testing.assert_allclose(repeated.final.adjustment.coefficients,
                               plain.final.adjustment.coefficients, rtol=1e-3, atol=1e-6)
    assert any(note.startswith("Points too close to each other to be independent")
               and "and 55 more groups" in note for note in repeated.notes)
    assert not any("too close" in note for note in plain.notes)


def test_a_blank_role_is_that_of_the_twin() -> None:
    one = twice(scene())
    roles = ["independent"] * 8 + ["control"] * 8 + [""] * 16
    result = termsel.run("rfm-terms", features=one.with_(
        points=replace(one.points, roles=tuple(roles))))
    assert set(result.data.roles.independent) == {
        name for first in one.points.ids[:8] for name in (first, f"{first}-again")}


def test_independent_twins_of_control_are_told() -> None:
    one = twice(scene())
    roles = ["control"] * 16 + ["independent"] * 16
    result = termsel.run("rfm-terms", features=one.with_(
        points=replace(one.points, roles=tuple(roles))))
    note, = (note for note in result.notes if "do not test the model" in note)
    assert f"{one.points.ids[0]} and {one.points.ids[0]}-again" in note


def test_folds_hold_out_both_of_two_twins() -> None:
    points = twice(scene(20)).points
    for how in ("spatial", "random"):
        folds = KFold(how=how, folds=5).folds(points, empty_lines())
        assert sorted(np.concatenate(folds)) == list(range(40))
        for fold in folds:
            assert set(fold % 20) == set(fold[fold < 20])


@pytest.mark.slow
def test_a_blunder_is_left_out_with_its_twin() -> None:
    one = twice(scene(30))
    image = one.points.image.copy()
    image[[3, 33]] += 60.0
    result = termsel.run("rfm-terms", features=one.with_(
        points=replace(one.points, image=image, roles=("control",) * 60)))
    first = one.points.ids[3]
    assert set(result.data.roles.off) == {first, f"{first}-again"}
    assert [outlier.id for outlier in result.outliers] == [first]


@pytest.mark.parametrize("few", [300, 0])
@pytest.mark.parametrize(("shift", "groups"), [(0.9, 24), (1.1, 25)])
def test_how_near_twins_are(shift: float, groups: int, few: int,
                            monkeypatch: pytest.MonkeyPatch) -> None:
    # Twins of more points are found by their order.
    monkeypatch.setattr("termsel.data.roles.MAX_PAIRWISE_PLACES", few)
    ground = np.array([(x, y, 5.0 * x) for x in range(5) for y in range(5)], dtype=float)
    # Half of the points are between 1 and 3: the spread is 4, the side of a point's square 0.8.
    ground[0] = ground[1] - [0.0, 0.008 * shift, 0.0]
    assert len(set(find_twins(ground))) == groups
    ground[7] = [1e6, -1e6, 0.0]  # one wild point makes no others near
    assert len(set(find_twins(ground))) == groups
    above = ground[1] + [0.0, 0.0, 0.2 * shift]
    ground[0] = above
    assert len(set(find_twins(ground))) == groups


@pytest.mark.parametrize("places", ["scattered", "in columns", "in one column"])
def test_twins_of_many_points_are_those_of_all_pairs(
    places: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(3)
    ground = rng.uniform(0.0, 1e4, (900, 3))
    monkeypatch.setattr("termsel.data.roles.MAX_COMPARED_PAIRS", 30_000)
    if places != "scattered":
        ground[:, 0] = 500.0 * (np.arange(900) % 30 if places == "in columns" else np.ones(900))
    ground[100:140] = ground[300:340] + rng.uniform(-5.0, 5.0, (40, 3))
    found = find_twins(ground)
    monkeypatch.setattr("termsel.data.roles.MAX_PAIRWISE_PLACES", 900)
    by_all_pairs = find_twins(ground)
    assert len(set(by_all_pairs)) < 900
    np.testing.assert_array_equal(found, by_all_pairs)


def test_points_that_are_apart_stay_as_they_are() -> None:
    features = scene(30)
    assert with_merged_twins(features) is features
    seen_through = features.points.ground.copy()
    seen_through[1] = seen_through[0] + [0.0, 0.0, 300.0]  # one line of sight
    assert len(set(find_twins(seen_through))) == 30
    assert list(find_twins(seen_through[:1])) == [0]


@pytest.mark.parametrize("problem", ["rfm-terms", "owdis-points"])
def test_leave_one_out_holds_out_twins_together(problem: str) -> None:
    given = twice(scene(20))
    options = {"degree": 2, "check_as": "control"}
    task = termsel.prepare(problem, features=given.with_(points=replace(
        given.points, roles=("control",) * 40)), model="poly3d", criterion="press",
        solver="random", options=options)
    genes = np.random.default_rng(0).random((30, task.problem.genome.size)) < 0.8
    found = task.problem.evaluate(genes).objectives[:, 0]
    fits = [task.problem.decode(one) for one in genes]
    control = task.observations.control
    expected = np.full(30, np.inf)
    for i, selected in enumerate(fits):
        used = np.isin(control.ids, selected.features) if "owdis" in problem else np.ones(40, bool)
        terms = np.isin(task.model.terms, selected.terms)
        errors = []
        for j in np.flatnonzero(used):
            name = control.ids[j].removesuffix("-again")
            rest = used & np.array([one.removesuffix("-again") != name for one in control.ids])
            A, b = (part for part in _of_points(task, control.points, terms))
            rows = np.repeat(rest, 2)
            x = np.linalg.lstsq(A[rows], b[rows], rcond=None)[0]
            mine = slice(2 * j, 2 * j + 2)
            errors.append(((A[mine] @ x - b[mine]) ** 2).sum())
        expected[i] = np.sqrt(np.mean(errors)) * task.scaling.image_scale
    usable = np.isfinite(found) & (found < 1e6)
    assert usable.sum() > 3
    np.testing.assert_allclose(found[usable], expected[usable], rtol=1e-6)


def _of_points(task: termsel.Task, points: Points, terms: np.ndarray) -> tuple:
    scaled = FeatureSet(task.scaling.points(points))
    equations = task.model.equations(scaled)
    return equations.A[:, terms], equations.b


def test_an_enumeration_holds_out_twins_together() -> None:
    given = twice(scene(14))
    task = termsel.prepare("poly-terms", features=given.with_(points=replace(
        given.points, roles=("control",) * 28)), criterion="press", solver="exact",
        options={"degree": 2})
    found = termsel.search(task.problem, task.solver)
    assert task.problem.evaluate(found.genes[None]).objectives[0, 0] == pytest.approx(
        found.objectives[0], rel=1e-9)
    every = np.array(np.meshgrid(*[[False, True]] * 12)).reshape(12, -1).T
    assert task.problem.evaluate(every).objectives[:, 0].min() == pytest.approx(
        found.objectives[0], rel=1e-9)
