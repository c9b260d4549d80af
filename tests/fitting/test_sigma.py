"""The standard deviation of predictions, against truth and against closed forms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.data.coordinates.places import distance_beyond_hull
from termsel.data.features import FeatureSet, FloatArray, Points, empty_lines
from termsel.simulate import scene_truth, simulate_scene
from termsel.simulate.catalogue import SCENES
from termsel.simulate.scenes import _ground_positions

NORMAL_90 = 1.645
REGIONS = ("inside", "edge", "outside")


def _part(name: str, seed: int, count: int) -> FeatureSet:
    """Return control from three quarters of the lines and samples of a scene."""
    points = simulate_scene(name, seed=seed, n_points=4 * count).points
    near = np.flatnonzero((points.image < 0.75 * np.array(SCENES[name].image_size)).all(axis=1))
    return FeatureSet(replace(points.take(near[:count]), roles=("control",) * count), empty_lines(),
                      "EPSG:4979")


def _covered(model: str, count: int, **options: int) -> dict[str, tuple[float, float]]:
    """Return, by region, the shares of true and of measured places within their 90 % bounds."""
    found: dict[str, list[tuple[float, float]]] = {region: [] for region in REGIONS}
    for name in SCENES:
        for seed in range(3):
            control = _part(name, seed, count)
            rng = np.random.default_rng([seed, count])
            ground = _ground_positions(name,
                                       rng.uniform(0.02, 0.98, (300, 2)) * SCENES[name].image_size)
            truth = scene_truth(name).sensor.project(ground)
            fitted = termsel.fit(control, model, **options)
            errors, noise = fitted.project(ground) - truth, rng.standard_normal(truth.shape) / 2
            within = [np.abs(e) < NORMAL_90 * fitted.sigma(ground, measured=measured)
                      for e, measured in ((errors, False), (errors + noise, True))]
            away = distance_beyond_hull(control.points.image, truth)
            for region, which in zip(REGIONS, (away == 0, (away > 0) & (away < 0.15),
                                               away >= 0.15), strict=True):
                found[region].append((within[0][which].mean(), within[1][which].mean()))
    return {region: tuple(np.mean(values, axis=0)) for region, values in found.items()}


@pytest.mark.parametrize(("model", "options"), [
    ("regularised-cubic", {}), ("affine", {}), ("poly3d", {"degree": 2})])
def test_nine_in_ten_true_places_are_within_their_bounds_in_every_region(
        model: str, options: dict[str, int]) -> None:
    for region, (true, measured) in _covered(model, 14, **options).items():
        assert 0.80 <= true <= 0.99, region
        assert 0.82 <= measured <= 0.99, region


def _line_scene(n: int, rng: np.random.Generator) -> tuple[FeatureSet, FloatArray]:
    ground = np.column_stack([rng.uniform(0, 100, (n, 2)), rng.uniform(0, 10, n)])
    image = ground @ np.array([[3.0, 0.2], [0.1, -2.0], [0.4, 0.3]]) + 500
    ids = tuple(f"P{i}" for i in range(n))
    return FeatureSet(Points(ids, image + rng.standard_normal(image.shape), ground)), ground


def test_lines_alone_propagate_the_noise_of_their_own_adjustment() -> None:
    scene = termsel.simulate_scene("ikonos-hamedan", wrong_lines=0)
    control = scene.with_(points=scene.points.take(np.zeros(len(scene.points), dtype=bool)))
    fitted = termsel.fit(control, "affine")
    ground = scene.points.ground[:20]
    columns = np.column_stack([np.ones(20), fitted.scaling.ground(ground)])
    A = fitted.model.equations(fitted.scaled_control).A
    # Errors have Student's distribution with as many degrees of freedom as there is redundancy.
    freedom = fitted.adjustment.redundancy
    covariance = fitted.adjustment.sigma0**2 * freedom / (freedom - 2) * np.linalg.inv(A.T @ A)
    for axis, rows in ((0, slice(0, 4)), (1, slice(4, 8))):
        expected = np.sqrt(np.einsum("ni,ij,nj->n", columns, covariance[rows, rows], columns))
        np.testing.assert_allclose(fitted.sigma(ground)[:, axis],
                                   expected * fitted.scaling.image_scale, rtol=1e-5)


def test_of_a_regularised_polynomial_points_and_lines_tell_together() -> None:
    """Errors at independent points are of that size, with many points and with few."""
    scene = simulate_scene("ikonos-hamedan", seed=3, roles=(20, 0, 40), n_lines=60, wrong_lines=0)
    roles = np.array(scene.points.roles)
    independent = scene.points.take(roles == "independent")

    def fitted(count: int) -> termsel.Fit:
        used = np.flatnonzero(roles == "control")[:count]
        points = scene.points.take(np.isin(np.arange(len(roles)), used))
        return termsel.fit(scene.with_(points=points), "regularised-cubic")

    for count in (20, 7):
        errors = independent.image - fitted(count).project(independent.ground)
        ratio = errors / fitted(count).sigma(independent.ground, measured=True)
        assert 0.7 < np.sqrt((ratio**2).mean()) < 1.3


def test_measured_adds_the_noise_and_nothing_else() -> None:
    control, ground = _line_scene(30, np.random.default_rng(0))
    fitted = termsel.fit(control, "regularised-cubic")
    noise = fitted.sigma(ground, measured=True) ** 2 - fitted.sigma(ground) ** 2
    np.testing.assert_allclose(noise, noise[0, 0])
    assert 0.7 < noise[0, 0] ** 0.5 < 1.4


def test_sigma_falls_with_more_points_and_grows_away_from_them() -> None:
    rng = np.random.default_rng(1)
    few, many = (termsel.fit(_line_scene(n, rng)[0], "regularised-cubic") for n in (12, 120))
    middle, away = [50.0, 50.0, 5.0], [200.0, 50.0, 5.0]
    at_few, at_many = few.sigma([middle, away]), many.sigma([middle, away])
    assert (at_many < at_few / 1.5).all()
    assert (at_few[1] > 5 * at_few[0]).all()


def test_a_worse_fit_is_told_to_be_worse() -> None:
    """An affine model of a curved image errs by the curvature, which no noise of its own shows."""
    control, ground = _line_scene(60, np.random.default_rng(2))
    curved = replace(control.points, image=control.points.image
                     + (ground[:, :1] - 50) ** 2 / 100)
    fitted = termsel.fit(control.with_(points=curved), "affine")
    middle = [[50.0, 50.0, 5.0]]
    truth = np.array(middle) @ np.array([[3.0, 0.2], [0.1, -2.0], [0.4, 0.3]]) + 500
    error = np.abs(fitted.project(middle) - truth)
    assert (error > 5).all()
    np.testing.assert_allclose(fitted.sigma(middle), error, rtol=0.3)


def test_without_redundancy_sigma_is_not_known() -> None:
    control, ground = _line_scene(4, np.random.default_rng(3))
    assert np.isnan(termsel.fit(control, "affine").sigma(ground)).all()


def test_a_place_without_height_has_no_sigma() -> None:
    control, _ = _line_scene(20, np.random.default_rng(4))
    sigma = termsel.fit(control, "regularised-cubic").sigma([[50, 50, np.nan], [50, 50, 5]])
    assert np.isnan(sigma).all(axis=1).tolist() == [True, False]


@pytest.mark.slow_cases("asked0")
@pytest.mark.parametrize("asked", [
    {}, {"solver": "all-terms", "model": "affine"}, {"solver": "ridge", "model": "rfm"}])
def test_a_result_read_back_has_the_same_sigma(tmp_path: Path, asked: dict[str, str]) -> None:
    result = termsel.run("rfm-terms", out=tmp_path / "r", **asked)
    ground = result.features.points.ground[:5]
    expected = result.sigma(ground, measured=True)
    assert np.isfinite(expected).all()
    back = termsel.read_result(tmp_path / "r")
    np.testing.assert_allclose(back.sigma(ground, measured=True), expected, rtol=1e-4)
    np.testing.assert_allclose(back.sigma(ground), result.sigma(ground), rtol=1e-4)
