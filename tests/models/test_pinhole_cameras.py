"""Cameras of few unknowns: few points of oblique views over hills."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import termsel
from benchmarks.oblique import Scene, rival, rmse, scene
from termsel.auto.methods import named
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.data.fit_data import FitData
from termsel.fitting.accuracy import predict_rmse_of_fit
from termsel.fitting.fit import Undetermined
from termsel.fitting.pinhole import (
    FOCAL_LOG_DEVIATION,
    Cameras,
    Measured,
    camera_of,
    pinhole_of,
    rotation_matrices,
)
from termsel.simulate import simulate_scene


def seen_by(drawn: Scene, *, size: bool = True) -> FloatArray:
    """Return where the camera of all control sees the truth, with its image's size or without."""
    features = drawn.features if size else replace(drawn.features, image_size=None)
    control = FitData.of(features)
    camera = pinhole_of(control.scaled, control.scaling)
    assert camera is not None
    ground = control.scaling.ground(drawn.ground)
    line, sample, below = camera.matrix @ np.column_stack([np.ones(len(ground)), ground]).T
    return control.scaling.pixels(np.column_stack([line, sample]) / below[:, None])


@pytest.mark.slow_cases("20-6", "30-5", "40-7")
@pytest.mark.parametrize(("angle", "count"), [(10, 5), (20, 6), (30, 5), (40, 7)])
def test_few_points_over_hills_tell_a_camera(angle: int, count: int) -> None:
    errors = [rmse(seen_by(drawn), drawn.image) for drawn in (
        scene(angle, 100, count, seed) for seed in (11, 12, 13))]
    assert np.median(errors) < 1.5


def test_steps_lead_down_the_slope_of_the_costs() -> None:
    rng = np.random.default_rng(0)
    ground = rng.uniform(-1.0, 1.0, (6, 3))
    camera = Cameras(np.eye(3)[None], np.array([[0.1, -0.2, 5.0]]), np.array([2.0]),
                     np.array([[0.3, -0.2]]))
    measured = Measured(ground, camera.image(ground)[0] + 0.1, np.ones((6, 2)), np.zeros(2), 0.1,
                        1.8, np.ones(3), 0.01, tilt=0.5)
    rows = np.ones((1, 6))
    design, residuals = measured.system(camera, rows, 0.1)
    step = 1e-6 * np.eye(9)
    for unknown in range(9):
        ahead, back = (measured.costs(camera.moved(sign * step[unknown:unknown + 1]), rows, 0.1)[0]
                       for sign in (1.0, -1.0))
        slope = -2.0 * design[0, :, unknown] @ residuals[0]
        assert slope == pytest.approx((ahead - back) / 2e-6, rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("spread", [0.5, FOCAL_LOG_DEVIATION, 0.8, 2.0, 10.0])
@pytest.mark.parametrize("factor", [0.3, 2.0])
def test_a_focal_length_that_is_hardly_known_does_not_lead_astray(
        factor: float, spread: float) -> None:
    drawn = scene(25, 100, 5, 12)
    control = FitData.of(drawn.features)
    usual = pinhole_of(control.scaled, control.scaling)
    assert usual is not None
    camera = camera_of(replace(usual.measured, focal=factor * usual.camera.focal[0],
                               focal_spread=spread))
    assert camera is not None
    assert camera.camera.focal[0] == pytest.approx(usual.camera.focal[0], rel=0.02)


def test_a_camera_is_found_without_the_size_of_the_image() -> None:
    drawn = [scene(20, 100, 8, seed) for seed in (11, 12, 13)]
    assert np.median([rmse(seen_by(one, size=False), one.image) for one in drawn]) < 3.0


def cropped(drawn: Scene, lines: int) -> Scene:
    """Return a photograph without its upper lines, so that its middle is no principal point."""
    points = drawn.features.points
    away = np.array([float(lines), 0.0])
    high, wide = drawn.features.image_size or (0, 0)
    features = replace(drawn.features, image_size=(high - lines, wide),
                       points=replace(points, image=points.image - away))
    return Scene(features, drawn.ground, drawn.image - away)


def test_an_image_that_was_cropped_moves_the_principal_point() -> None:
    drawn = cropped(scene(25, 100, 12, 5), 700)
    other = rival(drawn.features.points, drawn.ground, heights=True)
    assert other is not None
    assert rmse(seen_by(drawn), drawn.image) < 1.3 * rmse(other, drawn.image)


def test_a_mirrored_photograph_is_a_camera_too() -> None:
    drawn = scene(25, 100, 6, 3)
    points = drawn.features.points
    turned = np.array([1.0, -1.0])
    across = np.array([0.0, 3999.0])
    mirrored = Scene(replace(drawn.features, points=replace(
        points, image=points.image * turned + across)), drawn.ground, drawn.image * turned + across)
    assert rmse(seen_by(mirrored), mirrored.image) == pytest.approx(
        rmse(seen_by(drawn), drawn.image), abs=0.3)


@pytest.mark.slow_cases("25-100-6", "35-0-5")
@pytest.mark.parametrize(("angle", "relief", "count"), [(10, 100, 5), (25, 100, 6), (35, 0, 5)])
def test_auto_takes_the_camera_and_says_how_good_it_is(angle: int, relief: int, count: int) -> None:
    predicted, true = [], []
    for seed in (21, 22, 23):
        drawn = scene(angle, relief, count, seed)
        result = termsel.run(features=drawn.features)
        assert result.predicted is not None
        predicted.append(result.predicted.rmse)
        true.append(np.hypot(rmse(result.project(drawn.ground), drawn.image), 0.5 * 2**0.5))
    assert np.median(true) < 2.0
    assert 0.3 < np.median(predicted) / np.median(true) < 4.0


@pytest.mark.slow_cases("30")
@pytest.mark.parametrize("count", [21, 30])
def test_a_camera_asked_for_by_name_is_fitted_to_any_number_of_points(count: int) -> None:
    """Auto tries it for up to 20 points, which is no reason to refuse who asks for it."""
    drawn = scene(30, 60, count, 5)
    fitted = termsel.fit(drawn.features, "pinhole")
    assert rmse(fitted.project(drawn.ground), drawn.image) < 1.0
    result = termsel.run(features=drawn.features, method="pinhole")
    assert result.strategy is not None
    assert result.strategy.chosen == "pinhole"
    assert rmse(result.project(drawn.ground), drawn.image) < 1.0


def test_errors_are_as_large_as_their_standard_deviations() -> None:
    squares = []
    for seed in range(4):
        drawn = scene(20, 100, 6, 40 + seed)
        pinhole = named("pinhole")
        assert pinhole is not None
        fitted = pinhole.fit(FitData.of(drawn.features))
        errors = fitted.project(drawn.ground) - drawn.image
        squares.append((errors / fitted.sigma(drawn.ground))**2)
    assert 0.6 < np.sqrt(np.mean([one.mean() for one in squares])) < 1.6


def test_the_result_of_a_camera_is_read_again(tmp_path: object) -> None:
    drawn = scene(20, 100, 6, 21)
    result = termsel.run(features=drawn.features, out=f"{tmp_path}/result")
    assert result.strategy is not None
    assert result.strategy.chosen == "pinhole"
    again = termsel.read_result(f"{tmp_path}/result")
    np.testing.assert_allclose(again.project(drawn.ground), result.project(drawn.ground),
                               atol=1e-6)
    np.testing.assert_allclose(again.sigma(drawn.ground), result.sigma(drawn.ground), rtol=1e-3)


@pytest.mark.parametrize("name", ["ikonos-hamedan", "spot-isfahan"])
@pytest.mark.parametrize("count", [4, 5, 7, 20])
def test_what_is_seen_from_above_calls_for_no_camera(name: str, count: int) -> None:
    features = termsel.get("datasets", name).load()
    pinhole = named("pinhole")
    assert pinhole is not None
    few = features.take(np.arange(len(features)) < count)
    with pytest.raises(Undetermined):
        pinhole.fit(FitData.of(few))


def test_four_points_over_hills_get_a_camera_of_unknown_accuracy() -> None:
    drawn = scene(20, 100, 4, 7)
    result = termsel.run(features=drawn.features)
    assert result.strategy is not None
    assert result.strategy.chosen == "pinhole"
    assert result.predicted is None


def vertical_photo(seed: int, noise: float) -> tuple[FeatureSet, FloatArray, FloatArray]:
    """Return 8 points clicked with some noise [px] on a photo from 3 km above 250 m of relief.

    Beside them are 200 places within their reach, and where the photo shows them.
    """
    rng = np.random.default_rng(seed)
    ground = np.column_stack([rng.uniform(-1000, 1000, (208, 2)), rng.uniform(0, 250, 208)])
    tilts = rng.normal(0.0, np.radians(2.0), 2)
    turn = rotation_matrices(np.array([[*tilts, rng.uniform(0, 6.28)]]))[0]
    # The photo looks down: its rows are lines to the south, samples to the east, and the view.
    axes = turn @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    seen = (ground - [0.0, 0.0, 3000.0]) @ axes.T
    image = 749.5 + 1500.0 * seen[:, :2] / seen[:, 2:]
    control = slice(0, 8)
    points = Points(tuple(f"P{i}" for i in range(8)),
                    image[control] + rng.normal(0, noise, (8, 2)), ground[control] + [5e5, 5e6, 0])
    features = FeatureSet(points, crs="EPSG:32632", image_size=(1500, 1500))
    places = np.abs(ground[8:, :2]).max(axis=1) < 700.0
    return features, ground[8:][places] + [5e5, 5e6, 0], image[8:][places]


def test_rough_clicks_on_a_vertical_photo_get_its_camera() -> None:
    by_auto, by_camera = [], []
    for seed in range(5):
        features, ground, image = vertical_photo(seed, noise=4.0)
        by_auto.append(rmse(termsel.run(features=features).project(ground), image))
        control = FitData.of(features)
        camera = named("pinhole")
        assert camera is not None
        by_camera.append(rmse(camera.fit(control).project(ground), image))
    assert np.median(np.array(by_auto) / by_camera) < 1.2


def test_four_points_of_mountains_from_orbit_are_no_photo() -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        scene_from_orbit = simulate_scene("spot-isfahan", n_points=40, seed=seed)
        some = scene_from_orbit.take(np.isin(np.arange(len(scene_from_orbit)),
                                             rng.choice(40, 4, replace=False)))
        pinhole = named("pinhole")
        assert pinhole is not None
        with pytest.raises(Undetermined):
            pinhole.fit(FitData.of(some))


def with_distortion(drawn: Scene, strength: float) -> Scene:
    """Return a scene as a lens with radial distortion sees it, without the size of the image."""
    assert drawn.features.image_size is not None
    middle = (np.array(drawn.features.image_size) - 1.0) / 2.0
    half = float(np.linalg.norm(middle))

    def distorted(image: FloatArray) -> FloatArray:
        offsets = image - middle
        squares = (offsets**2).sum(axis=1, keepdims=True) / half**2
        return np.asarray(image + strength * squares * offsets)

    points = drawn.features.points
    features = replace(drawn.features, image_size=None,
                       points=replace(points, image=distorted(points.image)))
    return replace(drawn, features=features, image=distorted(drawn.image))


def test_five_points_of_a_lens_with_distortion_understate_no_error() -> None:
    # A camera takes up 9 of 10 measurements: errors were 3 to 20 times what was stated.
    ratios = []
    shares = []
    for seed in range(11, 19):
        drawn = with_distortion(scene(40, 100, 5, seed), 0.01)
        control = FitData.of(drawn.features, heights=True)
        camera = named("pinhole").fit(control)
        errors = camera.project(drawn.ground) - drawn.image
        predicted = predict_rmse_of_fit(camera, camera.held_out().errors, 0)
        ratios.append(rmse(camera.project(drawn.ground), drawn.image) / predicted.rmse)
        shares.append((np.abs(errors) < 1.645 * camera.sigma(drawn.ground)).mean())
    assert np.median(ratios) < 1.5
    assert np.mean(shares) > 0.75
