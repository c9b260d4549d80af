"""More than a third of the points wrong: a majority of many decides, few contradict one another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

import termsel
from termsel import FeatureSet, Points
from termsel.auto import majority
from termsel.auto.auto import Auto
from termsel.auto.blunders import agreement, find_blunders
from termsel.auto.majority import Halves, _are_interleaved, closest_halves, find_majority
from termsel.data.features import FloatArray, empty_lines
from termsel.data.fit_data import FitData
from termsel.data.roles import observations_by_role
from termsel.runs.verdict import judge_features


def scene(n: int, seed: int = 1) -> FeatureSet:
    features = termsel.simulate_scene("spot-isfahan", seed=seed, n_points=n, n_lines=0)
    return features.with_(points=replace(features.points, roles=("control",) * n),
                          lines=empty_lines())


def spoilt(features: FeatureSet, share: float, *, alike: bool = False,
           times: float = 1.0) -> tuple[FeatureSet, set[int]]:
    """Return points of which a share is 20 to 60 px off, in any direction or all in one."""
    n = len(features.points)
    rng = np.random.default_rng(n)
    wrong = rng.permutation(n)[:round(share * n)]
    angle = rng.uniform(0, 2 * np.pi, len(wrong))
    shift = np.column_stack([np.sin(angle), np.cos(angle)]) * rng.uniform(20, 60, (len(wrong), 1))
    image = features.points.image.copy()
    image[wrong] += times * (shift[:1] if alike else shift)
    return features.with_(points=replace(features.points, image=image)), set(wrong.tolist())


@pytest.mark.parametrize(("n", "share", "alike"), [(40, 0.4, False), (60, 0.5, False),
                                                   (60, 0.4, True)])
def test_a_majority_names_exactly_the_blunders(n: int, share: float, alike: bool) -> None:
    features, wrong = spoilt(scene(n), share, alike=alike)
    suspects = find_blunders(FitData.of(features, True))
    assert suspects is not None
    assert set(np.flatnonzero(suspects.blunders)) == wrong


@pytest.mark.slow
def test_a_model_costs_what_the_right_points_alone_do() -> None:
    whole = scene(180)
    clean = whole.with_(points=whole.points.take(np.arange(180) < 60))
    others = whole.points.take(np.arange(180) >= 60)
    features, wrong = spoilt(clean, 0.4)

    def rmse(control: FeatureSet) -> float:
        errors = termsel.run(features=control).project(others.ground) - others.image
        return float(np.sqrt((errors**2).sum(axis=1).mean()))

    right = [i not in wrong for i in range(60)]
    assert rmse(features) == pytest.approx(rmse(clean.with_(points=clean.points.take(right))),
                                           rel=0.02)


def test_sound_points_have_no_minority() -> None:
    for n, seed in ((20, 1), (40, 2), (100, 3)):
        data = FitData.of(scene(n, seed), True)
        assert find_majority(data) is None
        assert agreement(data) is None


def panoramic(n: int, seed: int) -> FeatureSet:
    """Return points of a camera that turns, which no quadratic polynomial follows."""
    x, y = np.random.default_rng(seed).uniform(-1, 1, (n, 2)).T
    ground = np.column_stack([5e5 + 1e4 * x, 5e6 + 1e4 * y, 100 * np.sin(3 * x) * np.cos(2 * y)])
    image = np.column_stack([4000 * np.arctan(0.4 * y) + 300 * x * y, 3000 * x + 90 * x * y**2])
    image += np.random.default_rng(seed + 1).normal(0, 0.5, (n, 2))
    points = Points(tuple(f"P{i:02d}" for i in range(n)), image, ground, roles=("control",) * n)
    return FeatureSet(points, empty_lines(), "EPSG:32639")


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_majority_decides_where_no_quadratic_polynomial_fits(seed: int) -> None:
    sound = panoramic(40, seed)
    assert find_majority(FitData.of(sound, True)) is None
    features, wrong = spoilt(sound, 0.45, times=4.0)
    suspects = find_blunders(FitData.of(features, True))
    assert suspects is not None
    assert set(np.flatnonzero(suspects.blunders)) == wrong


def flown(n: int, seed: int) -> FeatureSet:
    """Return points of an aircraft that sways, which no polynomial of few terms follows."""
    x, y = np.random.default_rng(seed).uniform(-1, 1, (n, 2)).T
    height = 100 * np.sin(3 * x) * np.cos(2 * y)
    line = 3000 * y + 12 * np.sin(4 * y)
    sample = 3000 * x + 60 * np.sin(2 * y) + 15 * np.cos(5 * y) + 0.5 * height * x
    image = np.column_stack([line, sample])
    image += np.random.default_rng(seed + 1).normal(0, 0.5, (n, 2))
    ground = np.column_stack([5e5 + 1e3 * x, 5e6 + 1e3 * y, height])
    points = Points(tuple(f"P{i:02d}" for i in range(n)), image, ground, roles=("control",) * n)
    return FeatureSet(points, empty_lines(), "EPSG:32639")


def test_a_majority_decides_on_the_blunders_of_a_flight() -> None:
    features, wrong = spoilt(flown(40, 4), 0.45, times=2.0)
    suspects = find_blunders(FitData.of(features, True))
    assert suspects is not None
    # Half of the points agree so well that one of the others looks wrong.
    named = set(np.flatnonzero(suspects.blunders))
    assert wrong <= named
    assert len(named - wrong) <= 1


@pytest.mark.parametrize("seed", [3, 4])
def test_bends_of_a_flight_are_no_blunders(seed: int) -> None:
    # Those of the first lie among points that agree, in waves.
    suspects = find_blunders(FitData.of(flown(40, seed), True))
    assert suspects is not None
    assert not suspects.blunders.any()


def test_a_cluster_of_blunders_is_no_bend() -> None:
    sound = panoramic(60, 4)
    ground = sound.points.ground
    # A third of the points and more, all in one part, with errors in all directions.
    wrong = np.argsort(ground[:, 0])[:24]
    image = sound.points.image.copy()
    image[wrong] += np.random.default_rng(1).uniform(-200, 200, (24, 2))
    points = replace(sound.points, image=image)
    agreeing = find_majority(FitData.of(sound.with_(points=points), True))
    assert agreeing is not None
    # A polynomial leaves places beyond the agreeing points so free that a few fit by chance.
    assert agreeing[wrong].sum() <= 3
    # A part that is bent has errors that are alike, and stays.
    bent = sound.points.image + np.maximum(5.001e5 - ground[:, :1], 0) * [0.02, 0.03]
    assert find_majority(FitData.of(sound.with_(points=replace(sound.points, image=bent)),
                               True)) is None


def test_few_points_are_said_to_contradict_one_another() -> None:
    features, wrong = spoilt(scene(30), 0.4)
    verdict = judge_features(observations_by_role(features), Auto())
    [note] = [note for note in verdict.notes if "contradict one another" in note]
    assert f"{30 - len(wrong)} of 30 agree" in note
    for index in wrong:
        assert features.points.ids[index] in note


@pytest.mark.parametrize("n", [30, 36])
@pytest.mark.parametrize(("image", "times"), [(panoramic, 4.0), (flown, 2.0)])
def test_few_points_of_an_image_that_bends_are_said_to_contradict_one_another(
        image: Callable[[int, int], FeatureSet], times: float, n: int) -> None:
    sound = image(n, 1)
    assert agreement(FitData.of(sound, True)) is None
    features, wrong = spoilt(sound, 0.4, times=times)
    agreeing = agreement(FitData.of(features, True))
    assert agreeing is not None
    disagreeing = set(np.flatnonzero(~agreeing))
    # A wrong point may look right; so few points have some right ones look wrong.
    assert len(wrong & disagreeing) >= len(wrong) - 1
    assert len(disagreeing) <= n / 2


def test_the_closest_half_is_about_the_best_of_all_halves() -> None:
    # Of twelve points all 924 halves can be tried.
    rng = np.random.default_rng(5)
    for _ in range(5):
        x = rng.uniform(-1, 1, 12)
        design = np.column_stack([np.ones(12), x])
        image = np.column_stack([2 + 3 * x, x]) + rng.normal(0, 0.01, (12, 2))
        image[:5] += rng.uniform(1, 5, (5, 2))

        def squares(half: tuple[int, ...], design: np.ndarray = design,
                    image: np.ndarray = image) -> float:
            of_half = list(half)
            coefficients = np.linalg.lstsq(design[of_half], image[of_half])[0]
            return float(((image[of_half] - design[of_half] @ coefficients) ** 2).sum())

        [[found, *_]] = closest_halves([design], image, np.ones(2, dtype=bool),
                                       np.random.default_rng(0))
        least = min(map(squares, combinations(range(12), 6)))
        assert not found[:5].any()
        # Concentration ends where no refit helps, next to the least of all halves.
        assert squares(tuple(np.flatnonzero(found))) <= 1.5 * least


def test_points_that_disagree_are_among_the_others_in_whatever_order_they_are() -> None:
    rng = np.random.default_rng(3)
    ground = rng.uniform(0.0, 1.0, (2000, 3))
    ordered = ground[np.argsort(ground[:, 1])]
    for seed in range(10):
        # Of the first 300 of either kind, those that disagree reach twice as far up the image.
        agreeing = np.random.default_rng(seed).uniform(size=2000) > 0.35
        assert _are_interleaved(ordered, agreeing)
        assert _are_interleaved(ground, agreeing)
    assert not _are_interleaved(ordered, np.arange(2000) > 700)


@pytest.mark.parametrize("share", [0.0, 0.2, 0.4])
def test_a_forward_search_of_many_points_ends_early_with_the_same_majority(
    share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = FitData.of(spoilt(scene(400), share)[0], True)
    steps = []
    noise_and_strains = majority._noise_and_strains

    def counted(*arguments: FloatArray) -> tuple[float, FloatArray]:
        steps.append(1)
        return noise_and_strains(*arguments)

    monkeypatch.setattr(majority, "_noise_and_strains", counted)
    halves = Halves.of(data)
    by_all_steps = find_majority(data, halves)
    all_steps = len(steps)
    monkeypatch.setattr(majority, "MANY_POINTS", 400)
    found = find_majority(data, halves)
    if share < 1 / 3:
        assert found is None
        assert by_all_steps is None
    else:
        assert found is not None
        np.testing.assert_array_equal(found, by_all_steps)
    assert share or len(steps) - all_steps < 0.7 * all_steps
