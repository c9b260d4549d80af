"""Robust estimators: their losses, their weights, and blunders that do not move them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares, minimize

import termsel
from termsel.adjustment.equations import Equations
from termsel.auto.robust import HUBER, TUKEY, reweighted
from termsel.fitting.figures import NORMAL_MEDIAN
from termsel.simulate import simulate_scene


def system(wrong: int = 0) -> Equations:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(60, 4))
    b = A @ [1.0, -2.0, 0.5, 3.0] + rng.normal(0, 0.1, 60)
    b[:wrong] += 5.0
    return Equations(A, b, np.arange(60))


def scale_at(equations: Equations, x: np.ndarray) -> float:
    return float(np.median(np.abs(equations.b - equations.A @ x))) / NORMAL_MEDIAN


def test_huber_is_that_of_scipy() -> None:
    equations = system(wrong=8)
    x, weights = reweighted(equations, biweight=False)
    found = least_squares(lambda y: equations.A @ y - equations.b, np.zeros(4), loss="huber",
                          f_scale=HUBER * scale_at(equations, x), xtol=1e-14, ftol=1e-14)
    np.testing.assert_allclose(x, found.x, atol=1e-5)
    assert (weights[:8] < 0.1).all()
    assert np.median(weights[8:]) == 1.0


def test_the_biweight_minimises_its_own_loss() -> None:
    equations = system(wrong=15)
    x, weights = reweighted(equations, biweight=True)
    scale = scale_at(equations, x)

    def loss(y: np.ndarray) -> float:
        u = np.minimum(np.abs(equations.b - equations.A @ y) / scale / TUKEY, 1.0)
        return float((1.0 - (1.0 - u**2) ** 3).sum())

    found = minimize(loss, x, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-14})
    np.testing.assert_allclose(x, found.x, atol=1e-5)
    assert (weights[:15] == 0.0).all()
    assert (weights[15:] > 0.0).all()
    np.testing.assert_allclose(x, [1.0, -2.0, 0.5, 3.0], atol=0.1)


def test_a_row_beyond_the_limit_of_the_biweight_has_no_weight() -> None:
    equations = system()
    x, _ = reweighted(equations, biweight=True)
    scale = scale_at(equations, x)
    b = equations.b.copy()
    b[0] = float(equations.A[0] @ x) + 1.5 * TUKEY * scale
    moved = replace(equations, b=b)
    x, weights = reweighted(moved, biweight=True)
    ratio = np.abs(moved.b - moved.A @ x) / scale_at(moved, x)
    assert TUKEY < ratio[0] < 2 * TUKEY
    assert weights[0] == 0.0


def test_without_outliers_all_three_agree() -> None:
    equations = system()
    plain = np.linalg.lstsq(equations.A, equations.b)[0]
    for biweight in (False, True):
        np.testing.assert_allclose(reweighted(equations, biweight)[0], plain, atol=0.02)


def test_rows_that_fit_exactly_end_the_iteration() -> None:
    equations = system()
    exact = replace(equations, b=equations.A @ [1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(reweighted(exact, biweight=True)[0], [1.0, 2.0, 3.0, 4.0])


@pytest.mark.parametrize("name", ["huber", "tukey"])
def test_a_robust_fit_by_its_name_is_not_moved_by_blunders(name: str) -> None:
    scene = simulate_scene("ikonos-hamedan", n_points=60, n_lines=0)
    image = scene.points.image.copy()
    image[:6] += 80.0
    spoilt = scene.with_(points=replace(scene.points, image=image, roles=("",) * 60))
    independent = simulate_scene("ikonos-hamedan", n_points=50, n_lines=0, seed=5).points
    robust, plain = (termsel.fit(spoilt, one).rmse(independent) for one in (name, "quadratic"))
    assert robust is not None
    assert plain is not None
    assert robust.total < 2.0
    assert plain.total > 5.0
