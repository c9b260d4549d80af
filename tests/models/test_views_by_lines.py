"""Photographs by control lines alone: the lines support a central view, as points do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from termsel.adjustment.control_views import view_of_control
from termsel.auto.auto import Auto
from termsel.auto.methods import named
from termsel.auto.rule import validated
from termsel.data.features import FeatureSet, FloatArray, Lines, Points, empty_points
from termsel.data.fit_data import FitData
from termsel.data.view import view_of

FOCAL = 5000.0
FLIGHT = 1500.0
IMAGE_SIZE = 4000, 6000


def photo(degrees: float, relief: float, count: int,
          seed: int) -> tuple[FeatureSet, FloatArray, FloatArray]:
    """Return lines of a photo of hills, tilted by some degrees, and places with their images."""
    rng = np.random.default_rng([60, int(degrees), count, seed])
    turned = Rotation.from_euler("zx", [rng.uniform(0.0, 360.0), degrees], degrees=True)

    def ground(image: FloatArray) -> FloatArray:
        """Return places that are seen at image places (..., 2), some of them on hills."""
        z = rng.uniform(0.0, relief, image.shape[:-1])
        upward = (np.array(IMAGE_SIZE) / 2.0 - image) / FOCAL
        rays = np.stack([-upward[..., 1], upward[..., 0], -np.ones(z.shape)], axis=-1)
        rays = turned.apply(rays.reshape(-1, 3)).reshape(rays.shape)
        return np.asarray(rays * ((z - FLIGHT) / rays[..., 2])[..., None] + [0.0, 0.0, FLIGHT])

    def seen(places: FloatArray) -> FloatArray:
        local = turned.apply((places - [0.0, 0.0, FLIGHT]).reshape(-1, 3), inverse=True)
        across = -FOCAL * local[:, :2] / local[:, 2:]
        image = np.array(IMAGE_SIZE) / 2.0 + np.stack([-across[:, 1], across[:, 0]], axis=1)
        return np.asarray(image.reshape(*places.shape[:-1], 2))

    middle = rng.uniform(0.1, 0.9, (count, 1, 2)) * IMAGE_SIZE
    bearing = rng.uniform(0.0, 2 * np.pi, count)
    half = rng.uniform(20.0, 200.0, count) * np.stack([np.sin(bearing), np.cos(bearing)])
    vertices = ground(middle + half.T[:, None] * np.array([[-1.0], [1.0]]))
    # Each line is measured at other places than its vertices.
    shares = np.column_stack([rng.uniform(-0.2, 0.3, count), rng.uniform(0.7, 1.2, count)])
    image = seen(vertices[:, :1] + shares[..., None] * (vertices[:, 1:] - vertices[:, :1]))
    image += 0.5 * rng.standard_normal(image.shape)
    corner = np.array([5e5, 5.2e6, 400.0])
    lines = Lines(tuple(map(str, range(count))), image, vertices + corner)
    places = ground(rng.uniform(0.15, 0.85, (200, 2)) * IMAGE_SIZE)
    return (FeatureSet(empty_points(), lines, "EPSG:32632", IMAGE_SIZE), places + corner,
            seen(places))


@pytest.mark.parametrize(("degrees", "relief", "count", "seed"), [
    (55.0, 150.0, 25, 5), (2.0, 10.0, 20, 10), (2.0, 10.0, 20, 0), (2.0, 30.0, 20, 4)])
def test_lines_of_a_photo_choose_its_projection(degrees: float, relief: float, count: int,
                                                seed: int) -> None:
    features, ground, image = photo(degrees, relief, count, seed)
    choice = Auto().choose_features(FitData.of(features), with_contained=False)
    assert choice is not None
    assert choice.method.name == "dlt"
    assert np.sqrt(((choice.chosen.project(ground) - image) ** 2).sum(axis=1).mean()) < 1.0


def test_what_lies_behind_the_camera_is_no_pole_of_lines() -> None:
    features = photo(55.0, 150.0, 25, 3)[0]
    assert validated(named("dlt"), FitData.of(features)) is not None


def test_lines_support_the_view_that_points_do() -> None:
    features, ground, image = photo(40.0, 100.0, 25, 1)
    data = FitData.of(features)
    by_lines = view_of_control(data.scaled)
    points = Points(tuple(map(str, range(len(ground)))), image, ground)
    by_points = view_of(data.scaling.points(points))
    assert by_lines is not None
    assert by_points is not None
    scaled = data.scaling.ground(ground)
    shares = [view.distances(scaled) / view.distances(scaled).max()
              for view in (by_lines, by_points)]
    assert np.allclose(*shares, atol=0.01)
