"""Warnings of places far outside the control."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import termsel
from termsel.data.coordinates.places import convex_hull, distance_beyond_hull
from termsel.data.features import FeatureSet, Points
from termsel.data.scaling import make_scaling
from termsel.fitting.least_squares import fit
from termsel.models.polynomial import Polynomial2D
from termsel.runs.data_notes import uncertain_corners
from termsel.simulate import simulate_scene

SQUARE = np.array([(0.0, 0.0), (0.0, 10.0), (10.0, 0.0), (10.0, 10.0), (5.0, 5.0)])


def test_distances_from_a_square() -> None:
    places = np.array([(5.0, 5.0), (10.0, 3.0), (15.0, 5.0), (-2.0, 20.0)])
    np.testing.assert_allclose(distance_beyond_hull(SQUARE, places), [0, 0, 0.5, 1.0], atol=1e-12)


def test_control_without_a_hull_reaches_nothing() -> None:
    assert np.isinf(distance_beyond_hull(np.arange(6.0).reshape(3, 2), SQUARE)).all()
    assert np.isinf(distance_beyond_hull(SQUARE[:2], SQUARE)).all()


@pytest.mark.parametrize("start", [(500000.1, 5500000.3), (51.25, 35.7)])
def test_places_on_one_oblique_line_have_no_hull(start: tuple[float, float]) -> None:
    """In UTM and in degrees, whose last digits are rounded."""
    for seed in range(50):
        rng = np.random.default_rng(seed)
        along = rng.uniform(0, 1000 if start[0] > 1e3 else 0.01, 6)
        line = np.array(start) + along[:, None] * rng.uniform(-2, 2, 2)
        assert convex_hull(line) == []


@pytest.mark.parametrize("n", [3, 10, 1000])
def test_a_hull_is_that_of_scipy(n: int) -> None:
    places = np.random.default_rng(n).random((n, 2)) * [3.0, 1000.0] + 4e6
    corners = ConvexHull(places).vertices.tolist()
    found = convex_hull(np.concatenate([places, places.mean(axis=0)[None], places[corners[:2]]]))
    assert sorted(map(tuple, np.concatenate([places, [[0, 0]], places[corners[:2]]])[found])) \
        == sorted(map(tuple, places[corners]))


def test_control_in_one_corner_is_warned_of() -> None:
    scene = simulate_scene("ikonos-hamedan", n_points=90, n_lines=0)
    near = (scene.points.image < 3000).all(axis=1)
    roles = np.where(near, "control", "check").astype(object)
    roles[::3] = "independent"
    corner = FeatureSet(replace(scene.points, roles=tuple(roles)), image_size=scene.image_size)
    found = termsel.run("rfm-terms", model="affine", solver="all-terms", features=corner)
    assert any("selection points and 3 of 4 corners of the image lie far outside" in note
               for note in found.notes)


def test_corners_where_the_model_is_uncertain_are_said() -> None:
    rng = np.random.default_rng(4)
    xy = rng.uniform(300.0, 700.0, (24, 2))
    points = Points(tuple(f"P{i}" for i in range(24)), xy[:, ::-1] + rng.normal(0.0, 0.5, (24, 2)),
                    np.column_stack([xy * 0.5, np.zeros(24)]) + np.array([4e5, 5e6, 0.0]))
    inner, whole = (FeatureSet(points, crs="EPSG:32633", image_size=size)
                    for size in ((720, 720), (1000, 1000)))
    [said] = uncertain_corners(fit(Polynomial2D(degree=3), whole, make_scaling(whole)), 0.8)
    assert "px at the corners of the image" in said
    assert "times the RMSE, which holds within the control" in said
    # A model of few terms goes on as far as it was measured.
    affine = fit(Polynomial2D(degree=1), inner, make_scaling(inner))
    assert list(uncertain_corners(affine, 0.8)) == []


@pytest.mark.slow
def test_control_over_the_scene_is_not() -> None:
    assert not any("Extrapolation" in note for note in termsel.run("rfm-terms").notes)
