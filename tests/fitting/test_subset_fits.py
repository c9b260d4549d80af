"""Least-squares fits of many sets of points at once."""

from __future__ import annotations

import numpy as np
import pytest

from termsel.adjustment.subset_fits import squared_distances_from_fits
from termsel.data.monomials import evaluate_monomials
from termsel.models.polynomial import Polynomial3D


@pytest.fixture
def design() -> np.ndarray:
    ground = np.random.default_rng(3).uniform(-1.0, 1.0, (60, 3))
    ground[:30, 2] = 0.2  # a half of the points on a level plane
    return evaluate_monomials(ground, Polynomial3D(degree=2).exponents)


def distances_by_numpy(design: np.ndarray, image: np.ndarray, used: np.ndarray) -> np.ndarray:
    coefficients = np.linalg.lstsq(design[used], image[used])[0]
    return ((image - design @ coefficients)**2).sum(axis=1)


def test_distances_are_those_of_numpy(design: np.ndarray) -> None:
    rng = np.random.default_rng(4)
    image = design @ rng.normal(size=(design.shape[1], 2)) + 0.01 * rng.normal(size=(60, 2))
    sets = np.argsort(rng.random((20, 60)), axis=1) < 30
    found = squared_distances_from_fits(design, image, sets)
    for squares, used in zip(found, sets, strict=True):
        np.testing.assert_allclose(squares, distances_by_numpy(design, image, used), rtol=1e-9)


def test_points_that_leave_terms_free_have_the_shortest_solution(design: np.ndarray) -> None:
    image = np.random.default_rng(5).normal(size=(60, 2))
    level = np.arange(60) < 30
    [squares] = squared_distances_from_fits(design, image, level[None])
    np.testing.assert_allclose(squares, distances_by_numpy(design, image, level), rtol=1e-9)


def test_points_without_errors_have_none(design: np.ndarray) -> None:
    image = design @ np.random.default_rng(6).normal(size=(design.shape[1], 2))
    sets = np.arange(60) < np.array([[40], [50]])
    assert squared_distances_from_fits(design, image, sets).max() < 1e-24
