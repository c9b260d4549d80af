"""What models with heights are off by, as their control shows it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import termsel
from termsel import FeatureSet, Points
from termsel.data.features import FloatArray
from termsel.fitting.camera_courses import camera_courses

SIZE = 4000.0
NOISE = 0.4

Shift = Callable[[FloatArray], FloatArray]


def shaken_in_time(share: FloatArray) -> FloatArray:
    """Return how far a scanner that shakes moves places, given in shares of the image [px]."""
    phase = 14.0 * share[:, 0]
    return np.column_stack([1.5 * np.cos(phase), 4.0 * np.sin(phase + 1.0)])


def bent_film(share: FloatArray) -> FloatArray:
    """Return how far a film that bends moves places [px]."""
    return 3.0 * np.column_stack([np.sin(5.0 * share[:, 0]) * np.cos(4.0 * share[:, 1]),
                                  np.cos(4.0 * share @ [1.0, 1.0])])


def still(share: FloatArray) -> FloatArray:
    """Return no shifts."""
    return np.zeros_like(share)


def image_with(shift: Shift, seed: int, count: int) -> tuple[FeatureSet, FloatArray, FloatArray]:
    """Return control of an image over relief, and 100 places within it where it shows them."""
    rng = np.random.default_rng([31, seed])
    share = rng.uniform(0.02, 0.98, (count + 100, 2))
    share[count:] = 0.5 + 0.8 * (share[count:] - 0.5)
    heights = rng.uniform(0.0, 800.0, len(share))
    # A camera 8 km up that looks a little aside.
    centred = share - 0.5
    depths = 1.0 - heights / 8000.0 + centred @ rng.normal(0.0, 0.1, 2)
    image = SIZE * (0.5 + centred / depths[:, None]) + shift(share)
    ground = np.column_stack([5e5 + 2.0 * SIZE * share[:, 1], 5e6 - 2.0 * SIZE * share[:, 0],
                              heights])
    measured = image[:count] + rng.normal(0.0, NOISE, (count, 2))
    points = Points(tuple(map(str, range(count))), measured, ground[:count])
    return (FeatureSet(points, crs="EPSG:32633", image_size=(int(SIZE), int(SIZE))),
            ground[count:], image[count:])


def errors_by_sigma(shift: Shift, model: str, count: int) -> float:
    """Return the root mean square of errors by their standard deviations, of six images."""
    squares = []
    for seed in range(6):
        features, ground, truth = image_with(shift, seed, count)
        fitted = termsel.fit(features, model)
        squares.append((((fitted.project(ground) - truth) / fitted.sigma(ground))**2).mean())
    return float(np.sqrt(np.mean(squares)))


@pytest.mark.slow_cases("bent_film-60", "shaken_in_time-30", "still-60")
@pytest.mark.parametrize("count", [30, 60])
@pytest.mark.parametrize("shift", [shaken_in_time, bent_film, still])
def test_errors_of_a_field_with_heights_are_stated_for_cameras_of_all_kinds(
        shift: Shift, count: int) -> None:
    assert 0.8 < errors_by_sigma(shift, "field3d", count) < 1.25


def test_errors_of_a_polynomial_that_a_scanner_shakes_are_stated() -> None:
    assert 0.8 < errors_by_sigma(shaken_in_time, "poly3d", 40) < 1.25


def test_mean_products_of_a_place_with_itself_are_its_mean_squares() -> None:
    features, ground, truth = image_with(shaken_in_time, 1, 30)
    fitted = termsel.fit(features, "field3d")
    courses = fitted.local_courses
    assert courses is not None
    places = fitted.scaling.ground(ground)
    seen = fitted.scaling.image(truth)
    squares = courses.squares(places, seen)
    for axis in (0, 1):
        np.testing.assert_allclose(np.diag(courses.covariance(places, seen, axis)),
                                   squares[:, axis], rtol=1e-6)


def test_places_without_coordinates_have_no_error() -> None:
    features, ground, _ = image_with(still, 2, 30)
    fitted = termsel.fit(features, "field3d")
    places = ground[:3].copy()
    places[1, 2] = np.nan
    assert np.isfinite(fitted.sigma(places)).all(axis=1).tolist() == [True, False, True]


def test_few_points_and_heights_in_a_plane_have_no_courses() -> None:
    points = image_with(still, 3, 30)[0].points
    assert camera_courses(points.take(np.arange(19)), 1e-3) is None
    flat = points.ground * [1.0, 1.0, 0.0]
    assert camera_courses(Points(points.ids, points.image, flat), 1e-3) is None


def test_an_image_without_noise_is_certain() -> None:
    rng = np.random.default_rng(32)
    ground = rng.uniform(-1.0, 1.0, (40, 3))
    image = ground @ rng.normal(0.0, 0.5, (3, 2))
    courses = camera_courses(Points(tuple(map(str, range(40))), image, ground), 1e-3)
    assert courses is not None
    assert np.sqrt(courses.squares(ground, image).max()) < 1e-2 * 1e-3


@pytest.mark.slow_cases("still")
@pytest.mark.parametrize("shift", [shaken_in_time, bent_film, still])
def test_one_point_more_changes_no_uncertainty_at_once(shift: Shift) -> None:
    # From 200 points to 201 it rose by up to a half.
    features, ground, _ = image_with(shift, 1, 201)

    def sigma(count: int) -> float:
        few = features.take(np.arange(len(features)) < count)
        return float(np.sqrt((termsel.fit(few, "field3d").sigma(ground)**2).mean()))

    assert sigma(201) == pytest.approx(sigma(200), rel=0.06)
