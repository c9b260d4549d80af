"""The models of termsel-hybrids, as installed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator

pytest.importorskip("termsel_hybrids", reason="termsel-hybrids is not installed: "
                    "pip install -e plugins/termsel-hybrids")

from termsel import FeatureSet, Points, SensorModel
from termsel.adjustment import solve
from termsel.plugins.manager import registry


def control_points(n: int = 30, seed: int = 3) -> Points:
    """A scaled scene with relief displacement that no plane polynomial follows."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform(-1, 1, (n, 3))
    relief = np.sin(3 * ground[:, :1]) * np.cos(2 * ground[:, 1:2])
    image = ground[:, :2] @ [[0.1, 0.9], [-0.9, 0.1]] + relief * [0.02, -0.05]
    return Points(tuple(f"P{i}" for i in range(n)), image, ground)


def fitted(model: SensorModel, control: Points) -> NDArray[np.float64]:
    return solve(model.equations(FeatureSet(control))).coefficients


def test_is_registered_under_its_name() -> None:
    entry = next(e for e in registry().entries("models") if e.name == "multiquadric")
    assert entry.provided_by == "termsel-hybrids"
    assert entry.summary.startswith("Plane polynomial with multiquadric")
    assert not registry().failures("models")


@pytest.mark.parametrize("degree", [1, 2, 5])
def test_has_the_terms_of_poly2d(degree: int) -> None:
    model = registry().get("models", "multiquadric")(degree=degree)
    plane = registry().get("models", "poly2d")(degree=degree)
    ground = control_points().ground
    assert model.terms == plane.terms
    np.testing.assert_allclose(model.blocks(ground).line, plane.blocks(ground).line, rtol=1e-14)


def test_interpolates_residuals_as_a_linear_radial_basis_function() -> None:
    model = registry().get("models", "multiquadric")()
    control = control_points()
    coefficients = fitted(model, control)
    ground = control_points(200, seed=4).ground
    plain = model.project(coefficients, ground)
    residuals = control.image - model.project(coefficients, control.ground)
    expected = RBFInterpolator(control.ground[:, :2], residuals, kernel="linear", degree=-1)
    assert np.abs(residuals).max() > 0.01
    np.testing.assert_allclose(model.predict(coefficients, FeatureSet(control), ground) - plain,
                               expected(ground[:, :2]), atol=1e-12)


def test_control_points_are_met_exactly() -> None:
    model = registry().get("models", "multiquadric")()
    control = control_points()
    met = model.predict(fitted(model, control), FeatureSet(control), control.ground)
    np.testing.assert_allclose(met, control.image, atol=1e-12)


def test_a_population_is_predicted_as_its_members_are() -> None:
    model = registry().get("models", "multiquadric")()
    control = control_points()
    one = fitted(model, control)
    many = np.stack([one, 0.5 * one, 0 * one])
    together = model.predict(many, FeatureSet(control), control.ground[:5])
    for coefficients, expected in zip(many, together, strict=True):
        np.testing.assert_allclose(
            model.predict(coefficients, FeatureSet(control), control.ground[:5]), expected,
            atol=1e-12)


def test_points_at_one_place_share_their_mean_residual() -> None:
    model = registry().get("models", "multiquadric")()
    control = control_points().ground.copy()
    control[1, :2] = control[0, :2]
    weights = model.residual_weights(control, control)
    values = np.arange(30.0)
    spread = weights @ values
    np.testing.assert_allclose(spread[:2], [0.5, 0.5], atol=1e-9)
    np.testing.assert_allclose(spread[2:], values[2:], atol=1e-9)


def test_one_control_point_corrects_nothing() -> None:
    model = registry().get("models", "multiquadric")()
    ground = control_points().ground
    assert not model.residual_weights(ground[:1], ground).any()
