"""The models of termsel-hybrids, as installed."""

from __future__ import annotations

import re

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator, RBFInterpolator

pytest.importorskip("termsel_hybrids", reason="termsel-hybrids is not installed: "
                    "pip install -e plugins/termsel-hybrids")

import termsel
from termsel import DLT2D, FeatureSet, LeastSquares, Lines, Points, SensorModel, rpc_of
from termsel.testing import Check, checks
from termsel.toolkit import registry, solve
from termsel_hybrids import Hybrid1, Hybrid3, Multiquadric, Piecewise, Pointwise
from termsel_hybrids.by_axis import Polynomial2DByAxis, Polynomial3DByAxis

MODELS = ("multiquadric", "pointwise", "piecewise", "hybrid-1", "hybrid-3")


def model_of(name: str, **options: object) -> SensorModel:
    model = registry().get("models", name)(**options)
    assert isinstance(model, SensorModel)
    return model


def control_points(n: int = 30, seed: int = 3) -> Points:
    """A scaled scene with relief displacement that no 2-D polynomial follows."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform(-1, 1, (n, 3))
    relief = np.sin(3 * ground[:, :1]) * np.cos(2 * ground[:, 1:2])
    image = ground[:, :2] @ [[0.1, 0.9], [-0.9, 0.1]] + relief * [0.02, -0.05]
    return Points(tuple(f"P{i}" for i in range(n)), image, ground)


def fitted(model: SensorModel, control: Points) -> NDArray[np.float64]:
    return solve(model.equations(FeatureSet(control))).coefficients


def predicted(model: SensorModel, control: Points, ground: NDArray[np.float64],
              ) -> NDArray[np.float64]:
    return model.predict(fitted(model, control), FeatureSet(control), ground)


CHECKS = {
    "multiquadric": checks(Multiquadric),
    "hybrid-3": checks(Hybrid3),
    "piecewise": checks(Piecewise),
    "poly2d-by-axis": checks(Polynomial2DByAxis, options=[{}, {"line_x": 0}]),
    "poly3d-by-axis": checks(Polynomial3DByAxis, options=[{}, {"sample_z": 3}]),
    "hybrid-1": checks(Hybrid1, options=[{"degree": d} for d in (1, 3)]),
    "pointwise": checks(Pointwise) + checks(
        Pointwise, options=[{"local_degree": 3, "count": 12}, {"local_degree": 0}]),
}


@pytest.mark.parametrize("check", [
    pytest.param(check, id=f"{name}-{i}-{check.name}")
    for name, checks in CHECKS.items() for i, check in enumerate(checks)])
def test_conforms(check: Check) -> None:
    check.run()


@pytest.mark.parametrize("name", MODELS)
def test_is_registered_under_its_name(name: str) -> None:
    entry = next(e for e in registry().entries("models") if e.name == name)
    assert entry.provided_by == "termsel-hybrids"
    assert model_of(name).corrects
    assert not registry().failures("models")


@pytest.mark.parametrize("name", MODELS)
def test_has_the_terms_of_poly2d(name: str) -> None:
    assert model_of(name, degree=3).terms == model_of("poly2d", degree=3).terms
    assert not model_of(name).uses_height


# Multiquadric and hybrid-3


@pytest.mark.parametrize("name", ["multiquadric", "hybrid-3"])
def test_interpolates_residuals_as_a_linear_radial_basis_function(name: str) -> None:
    model, control = model_of(name), control_points()
    ground = control_points(200, seed=4).ground
    coefficients = fitted(model_of("poly2d", **model.options), control)
    plain = model.project(coefficients, ground)
    residuals = control.image - model.project(coefficients, control.ground)
    expected = RBFInterpolator(control.ground[:, :2], residuals, kernel="linear", degree=-1)
    assert np.abs(residuals).max() > 0.003
    np.testing.assert_allclose(predicted(model, control, ground) - plain, expected(ground[:, :2]),
                               atol=1e-12)


def test_control_points_are_met_exactly() -> None:
    control = control_points()
    met = predicted(model_of("multiquadric"), control, control.ground)
    np.testing.assert_allclose(met, control.image, atol=1e-12)


def test_points_at_one_place_share_their_mean_residual() -> None:
    model = model_of("multiquadric")
    control = control_points().ground.copy()
    control[1, :2] = control[0, :2]
    weights = model.residual_weights(control, control)
    assert weights is not None
    values = np.arange(30.0)
    spread = weights @ values
    np.testing.assert_allclose(spread[:2], [0.5, 0.5], atol=1e-9)
    np.testing.assert_allclose(spread[2:], values[2:], atol=1e-9)


def test_one_control_point_corrects_nothing() -> None:
    ground = control_points().ground
    weights = model_of("multiquadric").residual_weights(ground[:1], ground)
    assert weights is not None
    assert not weights.any()


def test_fitness_under_hybrid_3_is_that_after_interpolation() -> None:
    """Some terms of a polynomial, then scipy's interpolation of what they leave."""
    task = termsel.prepare("poly-terms", model="hybrid-3")
    problem = task.problem
    genes = problem.genome.random(np.random.default_rng(1), 20)
    genes[:, [0, 1, 2, 15, 16, 17]] = True
    found = problem.evaluate(genes)
    control = task.scaling.features(task.observations.control)
    check = task.scaling.points(task.observations.check)
    equations = task.model.equations(control)
    terms = np.array(task.model.terms)
    for one, fitness in zip(genes, found.objectives[:, 0], strict=True):
        used = np.isin(terms, problem.decode(one).terms)
        coefficients = solve(equations, used).coefficients
        residuals = control.points.image - task.model.project(coefficients, control.points.ground)
        correction = RBFInterpolator(control.points.ground[:, :2], residuals, kernel="linear",
                                     degree=-1)(check.ground[:, :2])
        errors = task.model.project(coefficients, check.ground) + correction - check.image
        rmse = np.sqrt((errors**2).sum(axis=1).mean()) * task.scaling.image_scale
        assert fitness == pytest.approx(rmse, rel=1e-9)


@pytest.mark.slow
def test_the_best_terms_under_hybrid_3_are_proven() -> None:
    found = termsel.run("poly-terms", model="hybrid-3", solver="exact", options={"degree": 3})
    searched = termsel.run("poly-terms", model="hybrid-3", options={"degree": 3}, generations=20)
    assert found.certificate is not None
    assert found.certificate.optimal
    optimum, best = (one.objectives["check-rmse"] for one in (found, searched))
    assert optimum is not None
    assert best is not None
    assert optimum <= best + 1e-9


# Pointwise


def by_hand(control: Points, place: NDArray[np.float64], neighbours: NDArray[np.intp],
            power: int, *, degree: int = 1) -> NDArray[np.float64]:
    """Fit a polynomial of image coordinates to some control points; return its value."""
    offset = control.ground[neighbours, :2] - place[:2]
    distance = np.linalg.norm(offset, axis=1)
    weight = 1 / (distance / distance.max() + 1e-4)**power
    x, y = offset.T
    columns = np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)],
                       axis=1)
    root = np.sqrt(weight)[:, None]
    found = np.linalg.lstsq(root * columns, root * control.image[neighbours], rcond=None)[0]
    return np.asarray(found[0])


@pytest.mark.parametrize(("weight", "power"), [("uniform", 0), ("inverse-distance", 1),
                                               ("inverse-square", 2)])
@pytest.mark.parametrize("degree", [1, 2])
def test_nearest_neighbours_are_fitted_point_by_point(weight: str, power: int,
                                                      degree: int) -> None:
    # A local polynomial absorbs a global one of its degree, so image coordinates are fitted.
    control, places = control_points(40), control_points(25, seed=4).ground
    model = model_of("pointwise", degree=degree, local_degree=degree, weight=weight, count=9)
    for place, found in zip(places, predicted(model, control, places), strict=True):
        distance = np.linalg.norm(control.ground[:, :2] - place[:2], axis=1)
        nearest = np.argsort(distance)[:9]
        np.testing.assert_allclose(
            found, by_hand(control, place, nearest, power, degree=degree), atol=1e-9)


def test_neighbours_in_each_quadrant() -> None:
    control, places = control_points(40), control_points(25, seed=4).ground
    model = model_of("pointwise", degree=1, neighbours="quadrants", count=3)
    for place, found in zip(places, predicted(model, control, places), strict=True):
        offset = control.ground[:, :2] - place[:2]
        distance = np.linalg.norm(offset, axis=1)
        around: list[int] = []
        for right in (True, False):
            for up in (True, False):
                inside = np.flatnonzero(((offset[:, 0] >= 0) == right)
                                        & ((offset[:, 1] >= 0) == up))
                around.extend(inside[np.argsort(distance[inside])][:3])
        np.testing.assert_allclose(found, by_hand(control, place, np.array(around), 2), atol=1e-9)


def test_residuals_beyond_the_global_polynomial_are_corrected() -> None:
    control, others = control_points(60), control_points(50, seed=4)

    def rmse(model: SensorModel) -> float:
        errors = predicted(model, control, others.ground) - others.image
        return float(np.sqrt((errors**2).mean()))

    assert rmse(model_of("pointwise")) < 0.5 * rmse(model_of("poly2d", degree=2))


def test_a_local_mean_keeps_to_its_neighbours() -> None:
    model = model_of("pointwise", local_degree=0, weight="gaussian", count=5)
    control, places = control_points().ground, control_points(seed=4).ground
    weights = model.residual_weights(control, places)
    assert weights is not None
    assert ((weights > 0).sum(axis=1) == 5).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1)
    distance = np.linalg.norm(places[:, None, :2] - control[None, :, :2], axis=2)
    np.testing.assert_array_equal(weights.argmax(axis=1), distance.argmin(axis=1))


@pytest.mark.parametrize("n", [1, 2, 5])
def test_few_control_points_lower_the_local_degree(n: int) -> None:
    model = model_of("pointwise", local_degree=2)
    weights = model.residual_weights(control_points(n).ground, control_points(seed=4).ground)
    assert weights is not None
    np.testing.assert_allclose(weights.sum(axis=1), 1)  # constants are kept


# Hybrid-1


def test_hybrid_1_is_a_polynomial_and_then_a_projective_transformation_of_its_output() -> None:
    control, places = control_points(), control_points(40, seed=4).ground
    polynomial, second = model_of("poly2d", degree=3), DLT2D()
    first = fitted(polynomial, control)

    def computed(ground: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack([polynomial.project(first, ground), np.zeros(len(ground))])

    middle = Points(control.ids, control.image, computed(control.ground))
    expected = second.project(fitted(second, middle), computed(places))
    found = predicted(model_of("hybrid-1"), control, places)
    np.testing.assert_allclose(found, expected, atol=1e-10)
    assert np.abs(found - computed(places)[:, :2]).max() > 1e-4


def test_the_second_step_of_hybrid_1_takes_lines() -> None:
    """Lines whose image a projective transformation has bent out of shape."""
    rng = np.random.default_rng(6)
    second = np.array([0.05, 0.9, 0.1, 0.02, -0.03, -0.1, 0.95, 0.03, 0.06, -0.05, 0.04])
    vertices = rng.uniform(-1, 1, (30, 2, 3))
    image = DLT2D().project(second, vertices.reshape(-1, 3)).reshape(30, 2, 2)
    lines = Lines(tuple(f"L{i}" for i in range(30)),
                  image[:, :1] + np.array([-0.2, 1.3])[:, None] * (image[:, 1:] - image[:, :1]),
                  vertices)
    model = model_of("hybrid-1", degree=1)
    identity = np.zeros(len(model.terms))
    identity[[model.terms.index("line.num:X"), model.terms.index("sample.num:Y")]] = 1.0
    places = rng.uniform(-1, 1, (20, 3))
    found = model.predict(identity, FeatureSet(lines=lines), places)
    np.testing.assert_allclose(found, DLT2D().project(second, places), atol=1e-9)


def test_the_second_step_of_hybrid_1_weighs_as_dlt2d_does() -> None:
    """With a polynomial that gives X and Y back, the second step is an adjustment of dlt2d."""
    rng = np.random.default_rng(8)
    vertices, ground = rng.uniform(-1, 1, (20, 2, 3)), rng.uniform(-1, 1, (12, 3))
    ends = vertices[..., :2] + rng.normal(0, 0.02, (20, 2, 2))
    lines = Lines(tuple(f"L{i}" for i in range(20)), ends, vertices, rng.uniform(0.01, 0.1, 20))
    points = Points(tuple(f"P{i}" for i in range(12)),
                    ground[:, :2] + rng.normal(0, 0.02, (12, 2)), ground,
                    rng.uniform(0.01, 0.1, (12, 2)))
    control, model = FeatureSet(points, lines), model_of("hybrid-1", degree=1)
    identity = np.zeros(len(model.terms))
    identity[[model.terms.index("line.num:X"), model.terms.index("sample.num:Y")]] = 1.0
    places = rng.uniform(-1, 1, (20, 3))
    expected = DLT2D().project(solve(DLT2D().equations(control)).coefficients, places)
    np.testing.assert_allclose(model.predict(identity, control, places), expected, atol=1e-9)


def test_a_pole_of_the_second_step_between_the_points_is_seen() -> None:
    """The denominator 1 - 1.05 x is 0 at x = 0.95, between control points at 0.9 and 1."""
    x, y = (values.ravel() for values in np.meshgrid([-1, -0.5, 0, 0.5, 0.9, 1],
                                                     np.linspace(-1, 1, 5)))
    ground = np.column_stack([x, y, 0 * x])
    points = Points(tuple(f"P{i}" for i in range(30)),
                    np.column_stack([x, y]) / (1 - x[:, None] / 0.95), ground)
    model = model_of("hybrid-1", degree=1)
    identity = np.zeros(len(model.terms))
    identity[[model.terms.index("line.num:X"), model.terms.index("sample.num:Y")]] = 1.0
    found = model.predict(np.stack([identity, 0 * identity]), FeatureSet(points),
                          np.array([[-0.8, 0.0, 0.0]]))
    assert np.isinf(found[0]).all()
    assert np.isfinite(found[1]).all()  # the second step of a constant is one


def test_without_control_hybrid_1_is_its_polynomial() -> None:
    model, control = model_of("hybrid-1"), control_points()
    coefficients = fitted(model, control)
    np.testing.assert_allclose(model.predict(coefficients, FeatureSet(), control.ground),
                               model.project(coefficients, control.ground))


def test_hybrid_1_cannot_be_enumerated() -> None:
    with pytest.raises(termsel.TermselError, match="second step of model 'hybrid-1'"):
        termsel.prepare("poly-terms", model="hybrid-1", solver="exact").problem.parts()


# Hybrid-2, and all of them in a run


def test_hybrid_2_is_poly_terms_by_ga() -> None:
    mine = termsel.run("hybrid-2", generations=5)
    plain = termsel.run("poly-terms", generations=5)
    assert mine.solver == "ga"
    assert mine.selection == plain.selection


@pytest.mark.parametrize("name", MODELS)
def test_leave_one_out_figures_are_next_to_those_of_the_control(name: str) -> None:
    features = termsel.simulate_scene("ikonos-hamedan", n_points=45, n_lines=0)
    result = termsel.run("poly-terms", features=features, model=name, solver="all-terms",
                         options={"degree": 1})
    control = result.fit.control.points
    errors = []
    for i in range(len(control)):
        others = control.take(np.arange(len(control)) != i)
        scaled = result.fit.scaling.points(others)
        place = result.fit.scaling.ground(control.ground[i:i + 1])
        model = result.fit.model
        assert isinstance(model, SensorModel)
        image = predicted(model, scaled, place)
        errors.append(control.image[i] - result.fit.scaling.pixels(image)[0])
    line, sample = np.sqrt((np.array(errors)**2).mean(axis=0))
    found = result.to_dict()["rmse"]["leave-one-out"]
    assert found["n"] == len(control)
    assert found["line"] == pytest.approx(line)
    assert found["sample"] == pytest.approx(sample)
    assert found["total"] == pytest.approx(np.hypot(line, sample))
    [shown, _] = re.findall(r"^  leave-one-out +(\S+)$", result.summary(verbose=True), re.MULTILINE)
    assert float(shown) == pytest.approx(found["total"], rel=0.005)


def test_other_models_need_no_leave_one_out() -> None:
    result = termsel.run("hybrid-2", generations=1)
    assert list(result.to_dict()["rmse"]) == ["control", "check", "independent"]
    assert "\n  leave-one-out" not in result.summary(verbose=True)


@pytest.mark.slow
def test_a_line_is_left_out_as_a_whole() -> None:
    result = termsel.run("poly-terms", model="hybrid-1", solver="all-terms",
                         options={"mixed": True, "degree": 1})
    control, lines = result.fit.control, result.fit.control.lines
    found = result.rmse["leave-one-out"]
    assert found is not None
    assert found.n == len(control) == len(control.points) + len(lines)
    last = np.arange(len(control)) == len(control) - 1
    without = LeastSquares().fit(result.fit.model, control, result.fit.scaling,
                                 np.ones(len(result.fit.model.terms), dtype=bool), ~last)
    assert np.abs(without.line_errors()[-1]).max() > np.abs(result.fit.line_errors()[-1]).max()


@pytest.mark.slow_cases("hybrid-3", "multiquadric", "pointwise")
@pytest.mark.parametrize("name", MODELS)
def test_features_are_judged_with_the_correction_by_those_in_use(name: str) -> None:
    task = termsel.prepare("owdis-points", dataset="ikonos-hamedan", model=name)
    genes = task.problem.genome.random(np.random.default_rng(4), 15)
    feasible = task.problem.evaluate(genes).violation == 0
    genes = genes[feasible][:3]
    fitness = task.problem.evaluate(genes).objectives[:, 0]
    points = task.features.points
    check = points.take(np.array(points.roles) == "check")
    for one, value in zip(genes, fitness, strict=True):
        selected = task.problem.decode(one).features
        assert selected is not None
        alone = points.take(np.isin(points.ids, selected))
        result = termsel.assess(termsel.GivenGenes(one), task)
        of_check = result.fit.rmse(check)
        assert of_check is not None
        assert value == pytest.approx(of_check.total)
        assert result.fit.control.take(result.fit.used).points.ids == alone.ids
    assert len(set(fitness)) == 3


@pytest.mark.parametrize("name", MODELS)
def test_features_are_not_selected_without_check_points(name: str) -> None:
    with pytest.raises(termsel.TermselError, match="cannot be selected without selection points"):
        termsel.prepare("owdis-points", dataset="ikonos-hamedan", model=name, criterion="press")


def test_a_polynomial_with_a_correction_is_no_rpc_as_it_is() -> None:
    points = control_points()
    places = points.ground * [0.05, 0.05, 100.0] + [48.0, 35.0, 1000.0]
    image = 1000.0 * points.ground[:, :2] + np.random.default_rng(0).normal(0, 0.1, (30, 2))
    control = FeatureSet(Points(points.ids, image, places), crs="EPSG:4979")
    assert rpc_of(termsel.fit(control, model_of("poly2d", degree=2))).how == "exact"
    found = rpc_of(termsel.fit(control, model_of("multiquadric")))
    assert found.how.startswith("all")  # refitted: the polynomial alone is another model
    assert 1e-3 < found.worst < 1.0


def test_a_triangle_has_the_affine_transformation_of_its_points() -> None:
    control = control_points(40)
    corners = LinearNDInterpolator(control.ground[:, :2], control.image)
    ground = np.random.default_rng(1).uniform(-0.6, 0.6, (50, 3))
    np.testing.assert_allclose(predicted(Piecewise(), control, ground), corners(ground[:, :2]),
                               atol=1e-9)


def test_outside_of_all_triangles_a_place_is_corrected_as_the_nearest_of_their_hull() -> None:
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    weights = Piecewise().residual_weights(square, np.array([[0.5, 3, 0], [4, 4, 0], [1, 1, 0]]))
    expected = np.array([[0.0, 0.0, 0.75, 0.25], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    np.testing.assert_allclose(weights, expected, atol=1e-12)


def test_points_on_a_line_or_at_one_place_correct_nothing_or_their_mean() -> None:
    line = np.column_stack([np.linspace(-1, 1, 5), np.linspace(-1, 1, 5), np.zeros(5)])
    assert not Piecewise().residual_weights(line, line).any()
    twice = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0], [0, 1, 5]])
    np.testing.assert_allclose(Piecewise().residual_weights(twice, twice[3:]), [[0, 0, 0.5, 0.5]],
                               atol=1e-12)


@pytest.mark.parametrize("count", [12, 40])
@pytest.mark.parametrize("model", ["piecewise", "multiquadric", "pointwise"])
def test_what_follows_the_noise_of_control_is_as_uncertain_as_it_is(model: str, count: int) -> None:
    """Triangles carry the noise of their corners: of a plane they are worse than the plane."""
    ratios = []
    for seed in (1, 2, 3):
        rng = np.random.default_rng(seed)
        plane = rng.uniform(0.0, 3000.0, (count, 2))
        image = np.column_stack([3000.0 - plane[:, 1], plane[:, 0]])
        control = FeatureSet(Points(
            tuple(map(str, range(count))), image + rng.normal(0.0, 0.5, image.shape),
            np.column_stack([plane, np.full(count, np.nan)])), crs="local")
        places = rng.uniform(300.0, 2700.0, (200, 2))
        fitted = termsel.fit(control, model)
        errors = fitted.project(places) - np.column_stack([3000.0 - places[:, 1], places[:, 0]])
        ratios.append(np.sqrt(((errors / fitted.sigma(places))**2).mean()))
    assert 0.7 < np.mean(ratios) < 1.3
