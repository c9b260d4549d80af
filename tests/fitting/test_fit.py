"""The public fit: one model fitted to control by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import termsel
from termsel.adjustment.solve import solve, upper_triangle
from termsel.auto.methods import METHODS
from termsel.data.features import FeatureSet, Lines, Points, empty_lines, empty_points
from termsel.data.scaling import make_scaling
from termsel.fitting.least_squares import LeastSquares
from termsel.fitting.least_squares import fit as low_level
from termsel.fitting.residuals import Residuals
from termsel.models.quotient import RationalFunctions
from termsel.plugins.registry import registry
from termsel.simulate import simulate_scene


def points_of(n: int = 30, seed: int = 1, noise: float = 0.5) -> FeatureSet:
    """Points of a smooth image, in metres."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform(0, [8000, 6000, 400], (n, 3))
    x, y, z = (ground / [8000, 6000, 400]).T
    image = np.column_stack([4000 * y + 300 * x + 80 * z + 25 * x * y - 12 * y * z + 9 * x * x,
                             5000 * x - 200 * y - 60 * z + 18 * x * z + 14 * y * y])
    return FeatureSet(Points(tuple(f"P{i}" for i in range(n)),
                             image + noise * rng.normal(size=(n, 2)), ground))


def lines_of(n: int = 24, seed: int = 3, noise: float = 0.3) -> FeatureSet:
    rng = np.random.default_rng(seed)
    plain = low_level(RationalFunctions(order=1), points_of(60, noise=0.0),
                      make_scaling(points_of(60)))
    middle = rng.uniform([800, 800, 40], [7200, 5200, 360], (n, 1, 3))
    half = rng.uniform(-600, 600, (n, 1, 3)) * [1, 1, 0.1]
    ground = np.concatenate([middle - half, middle + half], axis=1)
    image = plain.project(ground.reshape(-1, 3)).reshape(n, 2, 2)
    return FeatureSet(empty_points(), Lines(tuple(f"L{i}" for i in range(n)),
                                            image + noise * rng.normal(size=image.shape), ground))


def by_refits(fitted: termsel.Fit) -> np.ndarray:
    """Errors of all control features in use, each under a fit that is made without it."""
    found = []
    for i in np.flatnonzero(fitted.used):
        one = np.zeros(len(fitted.used), dtype=bool)
        one[i] = True
        other = fitted.estimator.fit(fitted.model, fitted.control, fitted.scaling, fitted.terms,
                                     fitted.used & ~one)
        found.append(other.control_errors(one))
    return np.concatenate(found)


def table(residuals: Residuals) -> np.ndarray:
    order = sorted(range(len(residuals)), key=lambda i: (int(residuals[i].id[1:]),
                                                         residuals[i].kind))
    return np.array([[residuals[i].line, residuals[i].sample] for i in order])


# Golden figures


def test_four_points_by_hand() -> None:
    # line = 10 + 2 x + s / 4, sample = 20 + 3 y: the residuals alternate in sign.
    ground = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], dtype=float)
    s = np.array([1.0, -1.0, -1.0, 1.0])
    image = np.column_stack([10 + 2 * ground[:, 0] + s / 4, 20 + 3 * ground[:, 1]])
    fitted = termsel.fit(FeatureSet(Points(tuple("abcd"), image, ground)), "poly2d", degree=1)
    np.testing.assert_allclose(fitted.project([[0.5, 0.5, np.nan], [2, 0, np.nan]]),
                               [[11, 21.5], [14, 20]])
    np.testing.assert_allclose([one.line for one in fitted.residuals], s / 4)
    # A point of four determines the fourth coefficient: its leverage is 3/4.
    np.testing.assert_allclose([one.line for one in fitted.leave_one_out], s)
    assert fitted.adjustment.redundancy == 2
    assert fitted.leave_one_out_rmse().total == pytest.approx(1.0)


def test_affine_as_lstsq_and_the_textbook() -> None:
    features = points_of()
    fitted = termsel.fit(features, "affine")
    points = features.points
    A = np.column_stack([np.ones(len(points)), points.ground])
    x = np.linalg.lstsq(A, points.image)[0]
    np.testing.assert_allclose(fitted.project(points.ground), A @ x, atol=1e-8)
    # In scaled coordinates: s = sigma0 sqrt(diag (A^T A)^-1).
    scaled = np.column_stack([np.ones(len(points)), fitted.scaling.ground(points.ground)])
    left = (points.image - A @ x) / fitted.scaling.image_scale
    sigma0 = np.sqrt((left**2).sum() / (2 * len(points) - 8))
    expected = sigma0 * np.sqrt(np.diag(np.linalg.inv(scaled.T @ scaled)))
    np.testing.assert_allclose(list(fitted.standard_deviations.values()), np.tile(expected, 2))
    assert list(fitted.standard_deviations) == list(fitted.coefficients) == list(
        map(str, fitted.model.terms))
    assert fitted.effective == 8.0


def test_rfm_as_normal_equations() -> None:
    features = points_of(60)
    fitted = termsel.fit(features, "rfm", order=2)
    x, y, z = fitted.scaling.ground(features.points.ground).T
    one = np.ones_like(x)
    above = np.column_stack([one, x, y, z, x * y, x * z, y * z, x * x, y * y, z * z])
    places = fitted.scaling.image(features.points.image)
    computed = []
    for axis in (0, 1):
        A = np.column_stack([above, -places[:, axis:axis + 1] * above[:, 1:]])
        unknown = np.linalg.solve(A.T @ A, A.T @ places[:, axis])
        computed.append((above @ unknown[:10]) / (1 + above[:, 1:] @ unknown[10:]))
    np.testing.assert_allclose(fitted.project(features.points.ground),
                               fitted.scaling.pixels(np.column_stack(computed)), atol=1e-5)


# What a fit answers


# The prior of a scanner declines these points; tests/fitting/test_camera_prior.py has its errors.
# Projective transformations and pinhole cameras are for oblique views;
# tests/models/test_oblique_views.py and tests/models/test_pinhole_cameras.py have their errors.
@pytest.mark.parametrize("name", [one.name for one in METHODS if one.with_heights
                                  and one.name not in ("physical-cubic", "projective", "pinhole")])
def test_leave_one_out_of_points_repeats_the_procedure(name: str) -> None:
    features = points_of(50 if name == "rfm-3" else 45 if name == "ridge" else 26)
    fitted = termsel.fit(features, name)
    # Where errors of 0.5 px stand in an image of 5000, 1e-3 px are none.
    np.testing.assert_allclose(table(fitted.leave_one_out), by_refits(fitted), rtol=1e-3,
                               atol=1e-3)
    if name != "rfm-3":  # which has a pole next to one of these points
        assert fitted.leave_one_out_rmse().total > fitted.control_rmse().total


def test_leave_one_out_leaves_the_point_alone() -> None:
    """Independent of how fits are repeated: from features without the point."""
    features = points_of(20)
    fitted = termsel.fit(features, "poly3d", degree=1)
    for i, one in enumerate(fitted.leave_one_out):
        others = features.with_(points=features.points.take(np.arange(20) != i))
        error = features.points.image[i] - termsel.fit(others, "poly3d", degree=1).project(
            features.points.ground[i:i + 1])[0]
        np.testing.assert_allclose([one.line, one.sample], error, atol=1e-6)


@pytest.mark.parametrize(("name", "options", "near"), [
    ("affine", {}, 1e-6), ("dlt3d", {}, 1e-6), ("rfm", {"order": 1}, 0.02)])
def test_leave_one_out_of_lines(name: str, options: dict, near: float) -> None:
    fitted = termsel.fit(lines_of(), name, **options)
    expected = by_refits(fitted)
    np.testing.assert_allclose(table(fitted.leave_one_out), expected, atol=near)
    assert [one.kind for one in fitted.leave_one_out][::24] == ["vertex 1", "vertex 2"]
    assert fitted.leave_one_out_rmse().n == 24


def test_leave_one_out_of_an_iterated_fit_is_to_first_order_about_its_solution() -> None:
    iterated = termsel.fit(lines_of(), "rfm", order=1)
    plain = replace(iterated, estimator=LeastSquares(iterated=False))
    expected = by_refits(iterated)
    near, far = (np.abs(table(one.leave_one_out) - expected).max() for one in (iterated, plain))
    assert near < 0.5 * far


def test_without_iteration_the_equations_are_solved_once() -> None:
    features = lines_of()
    once, again = (low_level(RationalFunctions(order=1), features, make_scaling(features),
                             iterated=iterated) for iterated in (False, True))
    model = once.model
    solved = solve(model.equations(once.scaled_control), once.terms, once.used)
    np.testing.assert_array_equal(once.adjustment.coefficients, solved.coefficients)
    assert (once.adjustment.coefficients != again.adjustment.coefficients).any()


@pytest.mark.skipif("multiquadric" not in registry().names("models"),
                    reason="needs termsel-hybrids")
@pytest.mark.parametrize("name", ["multiquadric", "hybrid-1"])
def test_a_correcting_model_is_fitted_again(name: str) -> None:
    fitted = termsel.fit(points_of(24), name, degree=1)
    np.testing.assert_array_equal(table(fitted.leave_one_out), by_refits(fitted))
    assert fitted.leave_one_out_rmse().total > 0.1
    if name == "multiquadric":
        assert fitted.control_rmse().total < 1e-6


def test_candidates_say_how_many_parameters_are_effective() -> None:
    features = points_of(40)
    for name, most in (("ridge", 78), ("regularised-cubic", 40), ("regularised-quadratic", 20)):
        fitted = termsel.fit(features, name)
        assert 8 < fitted.effective < most
        assert fitted.determined
        assert np.isnan(list(fitted.standard_deviations.values())).all()
    selected = termsel.fit(features, "selected")
    assert selected.effective == selected.terms.sum() < 40
    assert np.isfinite(list(selected.standard_deviations.values())).all()


def test_locate_inverts_project() -> None:
    features = points_of()
    fitted = termsel.fit(features, "rfm", order=1)
    ground = features.points.ground
    np.testing.assert_allclose(fitted.locate(fitted.project(ground), ground[:, 2]), ground,
                               atol=1e-3)
    assert np.isnan(fitted.project([[0.0, 0.0, np.nan]])).all()
    with pytest.raises(termsel.TermselError, match=r"shape \(3,\), expected \(n, 3\)"):
        fitted.project([0.0, 0.0, 0.0])
    assert np.isnan(fitted.project([[0.0, np.inf, 0.0]])).all()
    with pytest.raises(termsel.TermselError, match=r"heights have shape \(2,\), expected \(1,\)"):
        fitted.locate([[0.0, 0.0]], [1.0, 2.0])


def test_a_fit_shows_itself_in_one_line() -> None:
    assert repr(termsel.fit(points_of(30), "affine")).startswith(
        "<Fit of affine: 8 terms, 30 features>\n")


def test_roles_say_what_is_control() -> None:
    features = points_of(30)
    roles = ("control", "", "check", "independent", "off") * 6
    fitted = termsel.fit(features.with_(points=replace(features.points, roles=roles)), "affine")
    taken = [name for name, role in zip(features.points.ids, roles, strict=True)
             if role in ("control", "")]
    assert fitted.control.ids == tuple(taken)
    assert [one.id for one in fitted.residuals] == taken
    others = features.points.take(np.isin(roles, "independent"))
    errors = others.image - fitted.project(others.ground)
    assert fitted.rmse(others).total == pytest.approx(np.sqrt((errors**2).sum(axis=1).mean()))
    assert fitted.rmse(empty_points()) is None


def test_lines_and_points_are_control_together() -> None:
    both = points_of(10).with_(lines=lines_of(12).lines)
    fitted = termsel.fit(both, "affine")
    assert len(fitted.residuals) == 10 + 24
    assert fitted.used.sum() == 22
    used = ~np.isin(fitted.control.ids, ["P3", "L7"])
    some = low_level(fitted.model, both, fitted.scaling, used=used)
    assert [(one.id, one.kind) for one in some.residuals if not one.used] == [
        ("P3", "point"), ("L7", "vertex 1"), ("L7", "vertex 2")]


def test_vertices_of_further_pieces_of_a_line_have_further_numbers() -> None:
    lines = lines_of(12).lines
    pieces = replace(lines, ids=("A", "B", "A", *(f"L{i}" for i in range(8)), "A"))
    fitted = termsel.fit(FeatureSet(empty_points(), pieces), "affine")
    assert [one.kind for one in fitted.residuals if one.id == "A"] == [
        f"vertex {number}" for number in range(1, 7)]


@pytest.mark.parametrize("make", [
    lambda: RationalFunctions(order=2), lambda: "rfm-2", lambda: RationalFunctions])
def test_every_way_of_naming_a_model_gives_the_same_fit(make: object) -> None:
    features = points_of(40)
    model = make()
    options = {"order": 2} if isinstance(model, type) else {}
    expected = termsel.fit(features, RationalFunctions(order=2))
    found = termsel.fit(features, model, **options)
    np.testing.assert_array_equal(found.adjustment.coefficients,
                                  expected.adjustment.coefficients)


def test_a_candidate_takes_the_plane_model_without_heights() -> None:
    features = points_of()
    flat = features.points.ground * [1, 1, np.nan]
    fitted = termsel.fit(features.with_(points=replace(features.points, ground=flat)), "quadratic")
    assert fitted.model.name == "poly2d"


# Errors


def without_heights() -> FeatureSet:
    features = points_of()
    ground = features.points.ground.copy()
    ground[3:, 2] = np.nan  # of most of them
    return features.with_(points=replace(features.points, ground=ground))


@pytest.mark.parametrize(("features", "model", "options", "message"), [
    (points_of(5), "rfm", {"order": 1},
     "5 control features give 10 equations for the 14 terms of model 'rfm'. Measure at least 7"),
    (points_of(30).with_(points=replace(points_of(30).points, ground=points_of(
        30).points.ground * [1, 1, 0])), "affine", {}, "determines only . of the 8 terms"),
    (without_heights(), "affine", {}, "needs heights; they are unknown for"),
    (without_heights(), "rfm-2", {},
     "a second-order rational function model needs heights that are known and differ"),
    (points_of(), "projective", {}, "a projective transformation is for features without heights"),
    (points_of(4), "regularised-cubic", {},
     "4 control points without any one of them do not determine an affine"),
    (points_of(4), "selected", {}, "4 control points are too few to select terms"),
    (lines_of(), "selected", {}, "takes control points alone, and there are control lines"),
    (points_of(), "rfm-2", {"order": 2}, "method 'rfm-2' takes no option 'order'"),
    (points_of(), RationalFunctions(), {"order": 2}, "has its options already, takes no option"),
    (points_of(), "rfn", {}, "unknown model 'rfn'. Did you mean 'rfm'"),
    (points_of(), "rfm", {"ordr": 2},
     "unknown option 'ordr' of the model 'rfm'. Did you mean 'order'?"),
    (points_of(), "rfm", {"colums": "x=east"},
     "unknown option 'colums' of the model 'rfm'. Did you mean 'columns'?"),
    (points_of(), "affine", {"degree": 2},
     "unknown option 'degree' of the model 'affine'.*poly2d, poly3d.* have it: model='poly2d'"),
    (FeatureSet(empty_points(), empty_lines()), "affine", {}, "there are no control features"),
    (points_of(6).with_(points=replace(points_of(6).points, roles=("check",) * 6)), "affine", {},
     "all 6 points have other roles than control: check")])
def test_what_cannot_be_fitted_is_refused(features: FeatureSet, model: str, options: dict,
                                          message: str) -> None:
    with pytest.raises(termsel.TermselError, match=message) as refusal:
        termsel.fit(features, model, **options)
    assert refusal.value.hint


def test_shrunken_coefficients_are_determined_by_few_points() -> None:
    points = points_of(8)
    shrunken = termsel.fit(points, "ridge")
    assert not shrunken.adjustment.feasible
    assert shrunken.determined


def test_leave_one_out_needs_redundancy() -> None:
    fitted = termsel.fit(points_of(4), "affine")
    assert np.isnan(list(fitted.standard_deviations.values())).all()
    with pytest.raises(termsel.TermselError, match="without one of its control features"):
        _ = fitted.leave_one_out


def test_coefficients_from_elsewhere_cannot_be_repeated() -> None:
    result = termsel.run("rfm-terms", solver="ridge", dataset="spot-isfahan")
    assert result.fit.determined
    assert np.isnan(result.fit.effective)
    with pytest.raises(termsel.TermselError, match="no feature can be held out"):
        _ = result.fit.leave_one_out


def test_a_run_and_the_fit_say_the_same() -> None:
    features = simulate_scene("spot-isfahan")
    result = termsel.run("rfm-terms", features=features, model="affine", solver="all-terms",
                         criterion="press", options={"check_as": "judge"})
    fitted = termsel.fit(features, "affine")
    np.testing.assert_allclose(result.fit.adjustment.coefficients,
                               fitted.adjustment.coefficients)
    assert result.objectives["press"] == pytest.approx(fitted.leave_one_out_rmse().total)


def test_a_file_that_does_not_exist_is_no_set_of_features() -> None:
    with pytest.raises(termsel.TermselError, match=r"gcps\.csv: this file does not exist"):
        termsel.fit("gcps.csv")
    assert len(termsel.simulate_scene("ikonos-hamedan").points.take([])) == 0


@pytest.mark.parametrize("rows", [3, 40, 5000, 40_001])
@pytest.mark.parametrize("condition", [1.0, 1e9])
def test_the_triangle_of_many_rows_is_that_of_all(rows: int, condition: float) -> None:
    rng = np.random.default_rng(rows)
    columns = rng.normal(size=(rows, 12)) @ (np.geomspace(1.0, 1.0 / condition, 12)[:, None]
                                             * np.linalg.qr(rng.normal(size=(12, 12)))[0])
    found = upper_triangle(columns)
    expected = np.linalg.qr(columns, mode="r")
    assert not np.tril(found, -1).any()
    np.testing.assert_allclose(*(np.abs(np.diag(r)) for r in (found, expected)), rtol=1e-6)
    np.testing.assert_allclose(found.T @ found, expected.T @ expected,
                               atol=1e-12 * np.abs(expected).max() ** 2)
