"""Standard deviations of models that are fitted to control lines."""

from __future__ import annotations

import numpy as np
import pytest

from termsel.adjustment.bayesian.line_posterior import line_covariance, mean_line_solution
from termsel.auto.methods import named
from termsel.data.features import empty_points
from termsel.data.fit_data import FitData
from termsel.models.polynomial import Polynomial3D
from termsel.simulate import scene_truth, simulate_scene

NAME = "ikonos-hamedan"


@pytest.mark.parametrize(("points", "lines"), [(0, 25), (8, 25)])
def test_a_regularised_polynomial_of_lines_knows_its_errors(points: int, lines: int) -> None:
    ratios = []
    for seed in range(3):
        features = simulate_scene(NAME, seed=seed, roles=(points, 0, 80), n_lines=lines,
                                  wrong_lines=0)
        is_control = np.array(features.points.roles) == "control"
        others = features.points.take(~is_control)
        control = features.with_(points=features.points.take(is_control) if points
                                 else empty_points())
        fitted = named("regularised-quadratic").fit(FitData.of(control))
        seen = scene_truth(NAME, seed=seed, n_lines=lines, wrong_lines=0).sensor.project(
            others.ground)
        ratios.append((((fitted.project(others.ground) - seen)
                        / fitted.sigma(others.ground)) ** 2).mean())
    assert 0.6 < np.sqrt(np.mean(ratios)) < 1.6


def test_the_posterior_of_lines_has_the_averaged_coefficients_for_its_mean() -> None:
    features = simulate_scene(NAME, seed=1, roles=(0, 0, 0), n_lines=30, wrong_lines=0)
    model = Polynomial3D(degree=2)
    equations = model.equations(FitData.of(features).scaled)
    posterior = line_covariance(equations, model.exponents)
    averaged = mean_line_solution(equations, model.exponents)
    assert posterior is not None
    assert averaged is not None
    is_shrunk = np.tile(np.array(model.exponents).sum(axis=1) > 1, 2)
    assert np.allclose(posterior[0][is_shrunk], averaged[0], rtol=1e-6, atol=1e-9)
    assert (np.linalg.eigvalsh(posterior[1]) > -1e-15).all()
