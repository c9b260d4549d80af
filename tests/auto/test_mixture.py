"""Right and wrong points among many, told by which division makes all of them likeliest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from termsel import FeatureSet
from termsel.auto.auto import Auto
from termsel.auto.blunders import find_blunders
from termsel.auto.mixture import Mixture, mixture_of, second_group, unlikeness_to_nearest
from termsel.data.features import BoolArray, FloatArray
from termsel.data.fit_data import FitData
from termsel.data.roles import observations_by_role
from termsel.runs.verdict import judge_features
from tests.auto.test_majority import scene


def spoilt(n: int, wrong: BoolArray, errors: FloatArray, seed: int = 1) -> FeatureSet:
    """Return points of a satellite image, some of which have errors [px]."""
    sound = scene(n, seed)
    image = sound.points.image.copy()
    image[wrong] += errors
    return sound.with_(points=replace(sound.points, image=image))


def random_wrong(n: int, count: int, seed: int) -> BoolArray:
    return np.isin(np.arange(n), np.random.default_rng(seed).permutation(n)[:count])


def affine_errors(features: FeatureSet, wrong: BoolArray) -> FloatArray:
    """Return errors of some tens of pixels that are an affine function of the place."""
    image = features.points.image
    from_middle = (image - image.mean(axis=0)) / np.ptp(image, axis=0).max()
    return np.asarray((np.array([30.0, -40.0]) + from_middle @ [[30, 10], [-20, 40]])[wrong])


@pytest.mark.parametrize("share", [0.2, 0.4])
def test_points_of_another_affine_map_are_blunders(share: float) -> None:
    wrong = random_wrong(60, round(60 * share), 3)
    features = spoilt(60, wrong, affine_errors(scene(60), wrong))
    suspects = find_blunders(FitData.of(features, True))
    assert suspects is not None
    assert (suspects.blunders == wrong).all()


def test_wrong_points_in_one_place_do_not_agree_by_chance() -> None:
    image = scene(60, 2).points.image
    wrong = np.zeros(60, dtype=bool)
    wrong[np.argsort(np.linalg.norm(image - image[0], axis=1))[:27]] = True
    errors = np.random.default_rng(5).uniform(-60.0, 60.0, (27, 2))
    suspects = find_blunders(FitData.of(spoilt(60, wrong, errors, 2), True))
    assert suspects is not None
    assert not (wrong & ~suspects.blunders).any()


def test_small_blunders_do_not_hide_in_the_noise_that_they_make() -> None:
    rng = np.random.default_rng(4)
    wrong = random_wrong(80, 24, 4)
    angle = rng.uniform(0.0, 2.0 * np.pi, 24)
    errors = rng.uniform(5.0, 15.0, (24, 1)) * np.column_stack([np.sin(angle), np.cos(angle)])
    suspects = find_blunders(FitData.of(spoilt(80, wrong, errors), True))
    assert suspects is not None
    assert (wrong & ~suspects.blunders).sum() <= 1
    assert (suspects.blunders & ~wrong).sum() <= 1


def test_two_halves_that_agree_among_themselves_are_told() -> None:
    wrong = random_wrong(40, 20, 6)
    features = spoilt(40, wrong, affine_errors(scene(40), wrong))
    verdict = judge_features(observations_by_role(features), Auto())
    [note] = [note for note in verdict.notes if "contradict one another" in note]
    assert "20 of 40 agree on one map, and 20 on another one" in note


def test_a_majority_is_no_second_group() -> None:
    wrong = random_wrong(60, 20, 7)
    features = spoilt(60, wrong, np.tile([30.0, 20.0], (20, 1)))
    assert second_group(FitData.of(features, True), ~wrong) is None


def test_points_in_use_are_likeliest_as_right_ones() -> None:
    wrong = random_wrong(40, 12, 8)
    data = FitData.of(spoilt(40, wrong, np.tile([30.0, 20.0], (12, 1))), True)
    truth = mixture_of(data, ~wrong)
    everything = mixture_of(data, np.ones(40, dtype=bool))
    assert isinstance(truth, Mixture)
    assert everything is not None
    assert (truth.log_odds > 0.0).tolist() == (~wrong).tolist()
    assert truth.log_likelihood > everything.log_likelihood
    assert truth.wrong_share[wrong].mean() > truth.wrong_share[~wrong].mean()
    assert not truth.is_hardly_wrong(1.5)[wrong].any()


def test_errors_are_alike_where_the_image_bends() -> None:
    places = np.linspace(0.0, 1.0, 50)
    bend = np.column_stack([places**3, -places**3])
    nearest = np.append(np.arange(1, 50), 48)
    assert unlikeness_to_nearest(places > 0.5, bend, nearest) < 0.01
    scattered = np.random.default_rng(9).normal(size=(50, 2))
    assert unlikeness_to_nearest(places > 0.5, scattered, nearest) > 0.5
