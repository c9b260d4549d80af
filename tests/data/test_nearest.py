"""The nearest points are the same by all distances and by a tree."""

from __future__ import annotations

import numpy as np
import pytest

from termsel.data.coordinates import nearest
from termsel.data.coordinates.nearest import nearest_points


@pytest.mark.parametrize("count", [1, 3, 7])
@pytest.mark.parametrize("dimensions", [2, 3])
def test_by_all_distances_and_by_a_tree_they_are_the_same(
        monkeypatch: pytest.MonkeyPatch, count: int, dimensions: int) -> None:
    rng = np.random.default_rng(5)
    points = rng.uniform(-1e3, 1e3, (7, dimensions))
    places = rng.uniform(-2e3, 2e3, (200, dimensions))
    distances, numbers = nearest_points(points, places, count)
    monkeypatch.setattr(nearest, "MAX_PAIRS", 0)
    by_tree, numbers_by_tree = nearest_points(points, places, count)
    assert np.array_equal(numbers, numbers_by_tree)
    assert numbers.shape == distances.shape == (200, count)
    np.testing.assert_allclose(distances, by_tree, rtol=1e-12)


def test_a_place_on_a_point_is_at_no_distance_from_it() -> None:
    points = np.array([[0.0, 0.0], [3.0, 4.0], [6.0, 8.0]])
    distances, numbers = nearest_points(points, points[1:2], 3)
    assert numbers[0, 0] == 1
    assert distances.tolist() == [[0.0, 5.0, 5.0]]
