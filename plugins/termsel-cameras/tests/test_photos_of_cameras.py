"""Frame and panoramic cameras against simulated photos whose geometry is written out here."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("termsel_cameras", reason="termsel-cameras is not installed: "
                    "pip install -e plugins/termsel-cameras")


import termsel
from termsel import FeatureSet, Points
from termsel.testing import checks
from termsel_cameras import FrameCamera
from termsel_cameras.scanners.photos import PHOTO_METHODS

HIGH, FOCAL = 3000.0, 6000.0

FloatArray = NDArray[np.float64]


def photo(kind: str, count: int, seed: int = 0, noise: float = 0.5,
          relief: float = 100.0) -> FeatureSet:
    """Return points of a photo from 3000 m over hills; the last 80 are independent and exact."""
    rng = np.random.default_rng(seed)
    plan = rng.uniform(-1500.0, 1500.0, (count + 80, 2))
    height = relief * (np.sin(plan[:, 0] / 700.0) + np.cos(plan[:, 1] / 900.0))
    turn, tilt = 0.7, 0.03
    x = plan @ [np.cos(turn), np.sin(turn)]
    y = plan @ [-np.sin(turn), np.cos(turn)]
    down = HIGH - height
    x, down = x * np.cos(tilt) + down * np.sin(tilt), down * np.cos(tilt) - x * np.sin(tilt)
    if kind == "frame":
        image = FOCAL * np.column_stack([-y / down, x / down])
        image *= 1.0 + 3e-4 * (image**2).sum(axis=1, keepdims=True) / FOCAL**2
    else:
        image = FOCAL * np.column_stack([-y / np.hypot(x, down), np.arctan2(x, down)])
    image[:count] += rng.normal(0.0, noise, (count, 2))
    ground = np.column_stack([plan + np.array([400000.0, 4000000.0]), height])
    return FeatureSet(Points(
        tuple(f"P{i}" for i in range(len(image))), image + 3000.0, ground, None,
        ("control",) * count + ("independent",) * 80,
        attributes={"sensor": np.array([kind] * len(image), dtype=object)}), crs="local")


def rmse(fitted: termsel.Fit, features: FeatureSet) -> float:
    others = features.points.take([role == "independent" for role in features.points.roles])
    return float(np.sqrt((fitted.errors(others) ** 2).sum(axis=1).mean()))


@pytest.mark.parametrize("kind", ["frame", "panoramic"])
def test_few_points_of_a_photo_are_enough(kind: str) -> None:
    scene = photo(kind, 8)
    fitted = termsel.fit(scene, f"{kind}-camera")
    assert rmse(fitted, scene) < 3.0
    assert rmse(termsel.fit(scene, "affine"), scene) > 30.0
    sigma = fitted.sigma(scene.points.ground[8:])
    assert 0.3 < rmse(fitted, scene) / np.sqrt((sigma**2).sum(axis=1).mean()) < 3.0
    assert fitted.adjustment.converged
    assert fitted.adjustment.steps
    for camera in PHOTO_METHODS:
        if camera.name == f"{kind}-camera":
            assert "converged" in camera.describe(fitted)
        else:
            with pytest.raises(termsel.TermselError, match=r"not those of|did not converge"):
                termsel.fit(photo(kind, 16), camera.name)


def test_a_frame_camera_states_its_place_and_angles() -> None:
    fitted = termsel.fit(photo("frame", 40, noise=0.0), "frame-camera")
    figures = {figure.name: figure.value
               for figure in fitted.model.sensor_figures(fitted.adjustment.coefficients)}
    # Priors pull the focal length, and with it the flying height, of a vertical photo.
    height = figures["projection centre z"]
    assert height == pytest.approx(HIGH, rel=0.05)
    assert figures["focal length"] / height == pytest.approx(FOCAL / HIGH, rel=0.01)
    assert figures["projection centre x"] == pytest.approx(400_000.0, abs=60.0)
    assert figures["projection centre y"] == pytest.approx(4_000_000.0, abs=60.0)
    assert figures["kappa"] == pytest.approx(np.degrees(0.7), abs=0.2)


@pytest.mark.parametrize("kind", ["frame", "panoramic"])
def test_golden_positions(kind: str) -> None:
    # All of the truth is in the model: what exact points leave is what priors pull.
    scene = photo(kind, 40, noise=0.0)
    fitted = termsel.fit(scene, f"{kind}-camera")
    assert rmse(fitted, scene) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("mirrored", [False, True])
def test_auto_chooses_the_camera_and_reads_it_back(mirrored: bool, tmp_path: Path) -> None:
    scene = photo("panoramic", 10)
    if mirrored:
        image = scene.points.image * [-1.0, 1.0]
        scene = replace(scene, points=replace(scene.points, image=image))
    unsaid = termsel.run(features=replace(scene, points=replace(scene.points, attributes={})))
    assert unsaid.strategy is not None
    assert unsaid.strategy.chosen != "panoramic-camera"
    result = termsel.run(features=scene, out=tmp_path / "out")
    assert result.strategy is not None
    assert result.strategy.chosen == "panoramic-camera"
    assert "panoramic camera" in result.summary()
    again = termsel.read_result(tmp_path / "out").fit
    np.testing.assert_allclose(again.project(scene.points.ground),
                               result.fit.project(scene.points.ground), atol=1e-6)


def test_one_blunder_hardly_moves_a_robust_fit() -> None:
    scene = photo("frame", 12)
    image = scene.points.image.copy()
    image[3] += 60.0
    bad = replace(scene, points=replace(scene.points, image=image))
    assert rmse(termsel.fit(bad, FrameCamera()), scene) < 30.0


@pytest.mark.parametrize("candidate", PHOTO_METHODS, ids=lambda one: one.name)
def test_candidates_keep_the_rules(candidate: termsel.Method) -> None:
    kind = candidate.name.partition("-")[0]
    for check in checks(candidate, features=[photo(kind, 10), photo("frame", 3)]):
        check.run()


@pytest.mark.slow_cases("30.0")
@pytest.mark.parametrize("relief", [8.0, 30.0])
def test_low_hills_serve_a_camera_though_polynomials_do_not_see_them(relief: float) -> None:
    """What polynomials leave of a panorama is more than such heights do."""
    scene = photo("panoramic", 12, seed=1, relief=relief)
    result = termsel.run(features=scene)
    assert result.strategy is not None
    assert result.strategy.chosen == "panoramic-camera"
    assert rmse(result.fit, scene) < 3.0
    assert "heights" not in " ".join(result.notes)


def test_flat_control_calls_for_no_camera() -> None:
    scene = photo("frame", 12)
    flat = scene.points.ground * [1.0, 1.0, 1e-7]
    result = termsel.run(features=replace(scene, points=replace(scene.points, ground=flat)))
    assert result.strategy is not None
    assert not result.strategy.chosen.endswith("-camera")


def oblique(seed: int, count: int = 8) -> tuple[FeatureSet, FloatArray, FloatArray]:
    """Return control of a camera 15 degrees below the horizon over hills, other ground, its image.
    """
    rng = np.random.default_rng(seed)
    down, turn = np.radians(15.0), rng.uniform(0, 2 * np.pi)
    ahead = np.array([np.sin(turn), np.cos(turn), 0.0])
    right = np.array([np.cos(turn), -np.sin(turn), 0.0])
    view = np.cos(down) * ahead - np.sin(down) * np.array([0.0, 0.0, 1.0])
    axes = np.stack([np.cross(view, right), right, view])
    far, aside = rng.uniform(800.0, 4000.0, 200), rng.uniform(-0.4, 0.4, 200)
    ground = far[:, None] * (ahead + aside[:, None] * right)
    ground[:, 2] = 30.0 * (np.sin(ground[:, 0] / 400.0) + np.cos(ground[:, 1] / 500.0))
    seen = (ground - [0.0, 0.0, 500.0]) @ axes.T
    image = 3500.0 * seen[:, :2] / seen[:, 2:] + [1500.0, 2000.0]
    origin = np.array([400_000.0, 5_000_000.0, 300.0])
    points = Points(tuple(f"P{i}" for i in range(count)),
                    image[:count] + 0.5 * rng.standard_normal((count, 2)),
                    ground[:count] + origin)
    return (FeatureSet(points, crs="EPSG:32633", image_size=(3000, 4000)),
            ground[count:] + origin, image[count:])


def test_a_camera_that_points_name_may_look_towards_the_horizon() -> None:
    frame, errors = PHOTO_METHODS[0], []
    for seed in range(4):
        control, ground, image = oblique(seed)
        assert not frame.tried(termsel.FitData.of(control))  # nobody says that it is a photo
        names = {"sensor": np.array(["frame"] * len(control.points), dtype=object)}
        named = replace(control, points=replace(control.points, attributes=names))
        data = termsel.FitData.of(named)
        assert frame.tried(data)
        fitted = frame.fit(data)
        errors.append(np.sqrt(((fitted.project(ground) - image)**2).sum(axis=1).mean()))
    assert len(errors) >= 3
    assert np.median(errors) < 3.0
