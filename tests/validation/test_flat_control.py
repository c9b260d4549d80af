"""Flat control, and places of other heights: the uncertainty there is known, and said."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import termsel
from termsel.data.features import FeatureSet, FloatArray, Lines, Points
from termsel.data.fit_data import FitData, distance_off_plane, with_usual_heights
from termsel.fitting.accuracy import predict_rmse_of_fit
from termsel.simulate import pushbroom_at

OTHERS = 60


def seen(camera: str, plan: FloatArray, height: FloatArray) -> tuple[FloatArray, FloatArray, str]:
    """Return ground and image of places (m, 2) [m] from the middle of a scene, and the CRS."""
    if camera == "scanner":
        ground = np.column_stack([20.0 + plan[:, 0] / 78e3, 45.0 + plan[:, 1] / 111e3, height])
        sensor = pushbroom_at(20.0, 45.0, off_nadir=25.0, gsd=10.0, image_size=(4000, 4000),
                              altitude=700e3, inclination=98.0)
        return ground, sensor.project(ground), "EPSG:4979"
    ground = np.column_stack([plan + np.array([500e3, 4e6]), height])
    if camera == "photo":  # a central projection from 25 km
        image = 2500.0 + plan[:, ::-1] * [-0.1, 0.1] / (1.0 - height[:, None] / 25e3)
    elif camera == "tilted":
        distance = 1.0 - (height / 25e3 + plan[:, 1] / 80e3)[:, None]
        image = 2500.0 + plan[:, ::-1] * [-0.1, 0.1] / distance
    else:
        image = 2500.0 + plan[:, ::-1] * [-0.1, 0.1] + np.outer(height, [0.01, 0.04])
    return ground, image, "EPSG:32639"


def scene(camera: str, relief: str, count: int, noise: float = 0.5) -> FeatureSet:
    """Return flat control, of which some may be on hills, and independent points on mountains."""
    rng = np.random.default_rng(count)
    plan = rng.uniform(-15e3, 15e3, (count + OTHERS, 2))
    height = np.concatenate([np.zeros(count), rng.uniform(100.0, 1500.0, OTHERS)])
    height[:count] += {"dust": 1e-5, "rough": 2.0}.get(relief, 0.0) * rng.standard_normal(count)
    hills = {"tower": 1, "hills": 2, "six": 6}.get(relief, 0)
    height[:hills] = np.linspace(80.0, 900.0, 6)[:hills]
    if relief == "slope":
        height[:count] = 400.0 + 0.02 * plan[:count, 0]
    ground, image, crs = seen(camera, plan, height)
    roles = ("control",) * count + ("independent",) * OTHERS
    return FeatureSet(Points(
        tuple(f"P{i}" for i in range(len(plan))),
        image + noise * rng.standard_normal(image.shape), ground, roles=roles), crs=crs)


@pytest.mark.slow_cases(
    "photo-level-8-the heig", "photo-slope-12-heights ", "scanner-dust-12-the heig",
    "scanner-hills-12-the heig", "scanner-level-8-the heig", "tilted-dust-12-the heig",
    "tilted-dust-20-the heig", "tilted-dust-30-the heig")
@pytest.mark.parametrize(("camera", "relief", "count", "covers"), [
    ("affine", "level", 4, "the height 0 m alone"),
    ("photo", "level", 8, "the height 0 m alone"),
    ("scanner", "level", 8, "the height 0 m alone"),
    ("scanner", "dust", 12, "the height 0 m alone"),
    ("tilted", "dust", 12, "the height 0 m alone"),
    ("tilted", "dust", 20, "the height 0 m alone"),
    ("tilted", "dust", 30, "the height 0 m alone"),
    ("affine", "tower", 12, "the height 0 m alone"),
    ("scanner", "hills", 12, "the height 0 m alone"),
    ("photo", "slope", 12, r"heights from \d+(\.\d)? to \d+(\.\d)? m on one plane"),
    ("affine", "rough", 12, r"heights from -\d(\.\d)? to \d(\.\d)? m on one plane"),
], ids=lambda value: str(value)[:8])
def test_the_prediction_holds_where_heights_differ_from_those_of_control(
        camera: str, relief: str, count: int, covers: str) -> None:
    features = scene(camera, relief, count)
    result = termsel.run(features=features)
    others = features.points.take([role == "independent" for role in features.points.roles])
    errors, true = result.fit.errors(others), result.rmse["independent"]
    assert result.predicted is not None
    assert true is not None
    assert true.total > 10.0
    assert 0.25 < true.total / result.predicted.rmse < 2.0
    assert result.predicted.low < true.total < result.predicted.high
    sigma = result.fit.sigma(others.ground, measured=True)
    assert (np.abs(errors) < 1.645 * sigma).mean() > 0.75
    assert any(re.search(f"covers {covers}.*px error per 100 m", note) for note in result.notes)
    said = result.summary(verbose=True)
    assert "The independent check points have other heights than the control points" in said
    assert not re.search(r"\d{7}", said.replace(",", ""))


def test_heights_that_tell_are_used_and_predicted_without_more() -> None:
    """Six points on hills among 20: leave-one-out alone is optimistic, as most of them are flat."""
    features = scene("scanner", "six", 20)
    result = termsel.run(features=features)
    assert result.fit.model.uses_height
    assert result.predicted is not None
    true = result.rmse["independent"]
    assert true is not None
    assert 0.4 < true.total / result.predicted.rmse < 2.5
    assert not any("covers the height" in note for note in result.notes)


def test_noise_that_hides_what_heights_do_makes_the_model_plane() -> None:
    """With 3 px of noise 2 m of relief tell less of a height than views in general do."""
    quiet, noisy = (FitData.of(scene("affine", "rough", 20, noise).take(
        np.arange(20 + OTHERS) < 20)) for noise in (0.01, 3.0))
    assert quiet.heights is False  # 2 m move the image by 0.1 px
    rough = scene("affine", "six", 20, 3.0)
    assert FitData.of(rough.take(np.arange(20 + OTHERS) < 20)).heights
    steep = np.where(np.arange(80)[:, None] < 20, rough.points.ground * [1, 1, 0.01],
                     rough.points.ground)
    low = FeatureSet(Points(rough.points.ids, rough.points.image, steep,
                            roles=rough.points.roles), crs=rough.crs)
    assert not FitData.of(low.take(np.arange(80) < 20)).heights
    assert not noisy.heights


def test_one_blunder_does_not_hide_what_heights_do() -> None:
    features = scene("affine", "six", 20).take(np.arange(20 + OTHERS) < 20)
    image = features.points.image.copy()
    image[11] += 300.0
    assert FitData.of(features.with_(points=Points(
        features.points.ids, image, features.points.ground,
        roles=features.points.roles))).heights


def test_places_like_the_control_change_nothing() -> None:
    features = termsel.simulate_scene("spot-isfahan", n_points=60)
    control = FitData.of(FeatureSet(features.points.take(range(20)), crs=features.crs))
    ground = features.points.ground[20:]
    assert with_usual_heights(control, ground) is ground
    found = termsel.fit(control.features, "regularised-quadratic")
    errors = np.random.default_rng(0).standard_normal((20, 2))
    assert predict_rmse_of_fit(found, errors, 40, ground) == predict_rmse_of_fit(found, errors, 40)
    higher = ground + np.array([0.0, 0.0, 3000.0])
    assert predict_rmse_of_fit(
        found, errors, 40, higher).rmse > predict_rmse_of_fit(found, errors, 40).rmse
    usual = with_usual_heights(control, higher)
    np.testing.assert_allclose(usual[:, :2], ground[:, :2])
    assert usual[:, 2].max() < higher[:, 2].min() - 1000.0


def test_a_plane_model_is_not_fitted_to_independent_points_on_mountains() -> None:
    assert termsel.run(features=scene("affine", "level", 12)).final is None


def test_lines_on_a_plain_predict_what_mountains_add() -> None:
    points = scene("affine", "level", 24).points
    ends = points.take(np.arange(24))
    lines = Lines(tuple(f"L{i}" for i in range(12)), ends.image.reshape(-1, 2, 2),
                  ends.ground.reshape(-1, 2, 3))
    result = termsel.run("rfm-terms-lines", strategy="auto", features=FeatureSet(
        points.take(np.arange(24, len(points))), lines, crs="EPSG:32639"))
    true = result.rmse["independent"]
    assert true is not None
    assert result.predicted is not None
    assert result.predicted.low < true.total < result.predicted.high
    assert true.total > 10.0


def test_a_blank_height_does_not_let_a_plane_fit_take_mountains() -> None:
    features = scene("affine", "level", 15)
    ground = features.points.ground.copy()
    ground[-1, 2] = np.nan
    assert termsel.run(features=features).final is None
    assert termsel.run(features=features.with_(
        points=replace(features.points, ground=ground))).final is None


def test_heights_in_feet_do_what_they_do_in_metres() -> None:
    pytest.importorskip("pyproj")
    points = scene("affine", "level", 12).points
    feet = points.ground * [1.0, 1.0, 3937.0 / 1200.0]
    notes, effects = [], []
    for ground, vertical in ((points.ground, 5703), (feet, 6360)):  # NAVD88, in m and in feet
        crs = f"EPSG:32618+{vertical}"
        control = FitData.of(FeatureSet(Points(
            points.ids[:12], points.image[:12], ground[:12]), crs=crs))
        effects.append(distance_off_plane(control, ground)[1])
        found = termsel.run("poly-terms", model="affine", solver="all-terms", criterion="press",
                            features=FeatureSet(replace(points, ground=ground), crs=crs))
        notes.append([note for note in found.notes if " m a" in note])
    np.testing.assert_allclose(*effects, rtol=1e-6)
    assert len(notes[0]) == 2
    assert notes[0] == notes[1]
