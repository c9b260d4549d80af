"""Splines and random fields against scipy, dense algebra, refits and simulated maps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import RBFInterpolator
from scipy.stats import multivariate_normal

import termsel
from termsel.adjustment.bayesian import field, posterior
from termsel.adjustment.bayesian.field import fit_gaussian_process
from termsel.adjustment.bayesian.posterior import predict_positions
from termsel.adjustment.bayesian.shrinkage import orthogonal_factors
from termsel.adjustment.bayesian.thin_plate import thin_plates
from termsel.auto.auto import Auto
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.data.fit_data import FitData
from termsel.data.monomials import evaluate_monomials, graded_exponents
from termsel_cameras import simulate_map

UNITS = (1.0, 0.7)


def scattered(n: int, noise: float = 0.02, seed: int = 3, *, sigma: bool = False) -> Points:
    """Return scaled points of a bent image."""
    rng = np.random.default_rng(seed)
    ground = rng.uniform(-1, 1, (n, 3))
    x, y, _ = ground.T
    image = np.stack([0.1 - 0.9 * y + 0.1 * np.sin(3 * x), 0.8 * x + 0.1 * np.cos(4 * x * y)],
                     axis=1)
    deviation = rng.uniform(0.5, 2.0, (n, 2)) if sigma else None
    image += noise * (1.0 if deviation is None else deviation) * rng.standard_normal((n, 2))
    return Points(tuple(f"P{i}" for i in range(n)), image, ground, deviation)


def theirs(ground: FloatArray, values: FloatArray, at: FloatArray,
           smoothing: float | FloatArray) -> FloatArray:
    spline = RBFInterpolator(ground[:, :2] * UNITS, values, smoothing=smoothing,
                             kernel="thin_plate_spline")
    return np.asarray(spline(at[:, :2] * UNITS))


@pytest.mark.parametrize("smoothing", [0.0, 0.03, 2.0])
def test_a_spline_is_that_of_scipy(smoothing: float) -> None:
    points, at = scattered(30), scattered(50, seed=4).ground
    found = thin_plates(points, UNITS, smoothing, "reml")
    assert found is not None
    expected = theirs(points.ground, points.image, at, smoothing)
    np.testing.assert_allclose(found.predict(at), expected, atol=1e-9)
    if not smoothing:
        np.testing.assert_allclose(found.predict(points.ground), points.image, atol=1e-9)
    # Left-out errors and effective parameters, by scipy alone
    for i in (0, 17):
        others = points.take(np.arange(30) != i)
        expected = points.image[i] - theirs(others.ground, others.image, points.ground[i:i + 1],
                                            smoothing)[0]
        np.testing.assert_allclose(found.errors[i], expected, atol=1e-9)
    hat = theirs(points.ground, np.eye(30), points.ground, smoothing)
    np.testing.assert_allclose(found.effective, 2 * np.trace(hat))


def test_generalised_cross_validation_chooses_as_the_hat_matrices_of_scipy_say() -> None:
    points = scattered(25)
    found = thin_plates(points, UNITS, None, "gcv")
    assert found is not None
    wanted = []
    for smoothing in (10.0 ** np.arange(-6.0, 2.0, 0.1)).tolist():
        left = np.eye(25) - theirs(points.ground, np.eye(25), points.ground, smoothing)
        wanted.append(25 * ((left @ points.image) ** 2).sum(axis=0) / np.trace(left) ** 2)
    best = 10.0 ** (-6.0 + 0.1 * np.argmin(wanted, axis=0))
    np.testing.assert_allclose(found.smoothing, best, rtol=1e-6)


def test_reml_chooses_the_likeliest_of_all_smoothings() -> None:
    points = scattered(25)
    found = thin_plates(points, UNITS, None, "reml")
    assert found is not None
    places = points.ground[:, :2] * UNITS
    distance = np.linalg.norm(places[:, None] - places, axis=2)
    kernel = distance**2 * np.log(np.where(distance > 0, distance, 1.0))
    lead = np.column_stack([np.ones(25), places])
    contrasts = np.linalg.svd(lead.T)[2][3:]
    of_contrasts = contrasts @ points.image
    for axis in (0, 1):
        def likelihood(smoothing: float, target: FloatArray = of_contrasts[:, axis]) -> float:
            shape = contrasts @ (kernel + smoothing * np.eye(25)) @ contrasts.T
            scale = target @ np.linalg.solve(shape, target) / len(target)
            return float(multivariate_normal.logpdf(target, np.zeros(len(target)), scale * shape))

        chosen = found.smoothing[axis]
        assert all(likelihood(chosen) >= likelihood(chosen * factor)
                   for factor in (0.01, 0.3, 0.79, 1.26, 3.0, 100.0))


def test_standard_deviations_smooth_each_point_by_its_own() -> None:
    points, at = scattered(30, 0.1, sigma=True), scattered(50, seed=4).ground
    found = thin_plates(points, UNITS, 0.05, "reml")
    assert found is not None
    assert points.sigma is not None
    for axis in (0, 1):
        own = 0.05 * (points.sigma[:, axis] / np.median(points.sigma)) ** 2
        expected = theirs(points.ground, points.image[:, axis:axis + 1], at, own)
        np.testing.assert_allclose(found.predict(at)[:, axis:axis + 1], expected, atol=1e-9)


@pytest.mark.parametrize("criterion", ["reml", "gcv"])
def test_the_smoothing_is_chosen_again_without_each_point(criterion: str) -> None:
    points = scattered(20, 0.1)
    found = thin_plates(points, UNITS, None, criterion)
    assert found is not None
    for i in range(20):
        others = points.take(np.arange(20) != i)
        again = thin_plates(others, UNITS, None, criterion)
        assert again is not None
        expected = points.image[i] - again.predict(points.ground[i:i + 1])[0]
        np.testing.assert_allclose(found.errors[i], expected, atol=1e-8)


def one_cell(monkeypatch: pytest.MonkeyPatch) -> tuple[float, float, tuple[float, float]]:
    """Leave one solution with a field on the grid, and return its size, ratio and lengths."""
    size, ratio, lengths = 10.0, 0.25, (0.4, 0.8)
    monkeypatch.setattr(posterior, "PRIOR_SIZES", np.array([size]))
    monkeypatch.setattr("termsel.adjustment.bayesian.posterior.PRIOR_SIZES",
                        np.array([size]))
    for name, value in (("FIELD_RATIOS", (ratio,)), ("FIELD_FALLS", (0.1,)),
                        ("FIELD_LENGTHS", (lengths, lengths[::-1])),
                        ("FIELD_PROBABILITY", 1 - 1e-15),
                        ("EQUAL_LENGTHS_PROBABILITY", 0.0)):
        monkeypatch.setattr(field, name, value)
    field._cached_gaussian_process.cache_clear()
    posterior._cached_polynomial_posterior.cache_clear()
    return size, ratio, lengths


def test_one_solution_is_universal_kriging(monkeypatch: pytest.MonkeyPatch) -> None:
    size, ratio, lengths = one_cell(monkeypatch)
    monkeypatch.setattr(field, "FIELD_LENGTHS", (lengths,))
    points, at = scattered(25), scattered(12, seed=6).ground
    found = fit_gaussian_process(points, 2)
    field._cached_gaussian_process.cache_clear()
    posterior._cached_polynomial_posterior.cache_clear()
    assert found is not None
    one, other = (evaluate_monomials(g, found.exponents) for g in (points.ground, at))
    own = size * np.array([0.1 ** (sum(e) - 2.0) for e in found.exponents[3:]])
    turn = np.linalg.lstsq(one[:, :3], points.image)[0]

    def covariance(a: FloatArray, b: FloatArray) -> FloatArray:
        apart = (a[:, None, :3] @ turn - b[None, :, :3] @ turn) / lengths
        r = np.sqrt(3 * (apart**2).sum(axis=2))
        return np.asarray((ratio * size) ** 2 * (1 + r) * np.exp(-r)
                          + (a[:, 3:] * own) @ (b[:, 3:] * own).T)

    data = covariance(one, one) + np.eye(25)
    lead, there = one[:, :3], covariance(other, one)
    inner = np.linalg.inv(lead.T @ np.linalg.solve(data, lead))
    trend = inner @ lead.T @ np.linalg.solve(data, points.image)
    expected = other[:, :3] @ trend + there @ np.linalg.solve(data, points.image - lead @ trend)
    np.testing.assert_allclose(found.predict(at), expected, atol=1e-6)
    rest = points.image - lead @ trend
    noise = (rest * np.linalg.solve(data, rest)).sum() / (2 * 22 - 2)
    left = other[:, :3] - there @ np.linalg.solve(data, lead)
    variance = noise * (np.diag(covariance(other, other))
                        - (there * np.linalg.solve(data, there.T).T).sum(axis=1)
                        + ((left @ inner) * left).sum(axis=1))
    np.testing.assert_allclose(found.spread(at)[0], np.stack([variance] * 2, axis=1), rtol=1e-4)


def test_one_solution_for_few_points_is_a_thin_plate_spline(
        monkeypatch: pytest.MonkeyPatch) -> None:
    one_cell(monkeypatch)
    monkeypatch.setattr(field, "_prior_probability",
                        lambda lengths: float(lengths == field.SPLINE_LENGTHS) or 1e-300)
    points, at = scattered(field.SPLINE_SURE_POINTS), scattered(12, seed=6).ground
    found = fit_gaussian_process(points, 2)
    field._cached_gaussian_process.cache_clear()
    posterior._cached_polynomial_posterior.cache_clear()
    assert found is not None
    # In the image, where the kernels have a mean variance of 1, and the size is 10.
    one, other = (np.column_stack([np.ones(len(g)), g[:, :2]]) for g in (points.ground, at))
    turn = np.linalg.lstsq(one, points.image)[0]
    there, places = (np.pad(g @ turn, ((0, 0), (0, 1))) for g in (other, one))
    square = ((places[:, None] - places) ** 2).sum(axis=2)
    left = np.eye(len(one)) - one @ np.linalg.pinv(one)
    smoothing = np.trace(left @ (square * np.log(np.sqrt(square) + np.eye(len(one))))) / len(one)
    spline = thin_plates(replace(points, ground=places), (1.0, 1.0), smoothing / 100, "reml")
    assert spline is not None
    np.testing.assert_allclose(found.predict(at), spline.predict(there), atol=1e-9)
    np.testing.assert_allclose(found.errors, spline.errors, atol=1e-9)
    (variance, noise), (expected, of_spline) = found.spread(at), spline.spread(there)
    np.testing.assert_allclose(variance / noise, expected / of_spline, rtol=1e-6)


@pytest.mark.parametrize(("count", "variables", "wanted"), [(19, 2, 1), (20, 2, 0), (19, 3, 0)])
def test_a_spline_is_a_course_of_few_points_without_heights(
        count: int, variables: int, wanted: int) -> None:
    found = fit_gaussian_process(scattered(count), variables)
    assert found is not None
    assert sum(part.lengths == field.SPLINE_LENGTHS for part in found.solutions) == wanted
    np.testing.assert_allclose(found.probabilities.sum(), 1.0)


def test_four_courses_are_as_likely_beforehand_for_few_points_of_a_plane() -> None:
    found = fit_gaussian_process(scattered(12), 2)
    assert found is not None
    polynomial, plain, *fields, spline = (
        np.exp(part.log_evidence - part.posterior.cells.log_evidence) * len(part.posterior.scales)
        for part in found.solutions)
    assert [part.lengths is None for part in found.solutions[:3]] == [True, True, False]
    np.testing.assert_allclose([polynomial, plain, sum(fields)], spline)


def test_what_is_foreseen_varies_within_solutions_and_between_them() -> None:
    """The law of total variance, with each solution by dense algebra."""
    points, at = scattered(12), scattered(5, seed=6).ground
    exponents = graded_exponents(2, 3)
    order = np.array(exponents).sum(axis=1)
    one, other = evaluate_monomials(points.ground, exponents), evaluate_monomials(at, exponents)
    scales = posterior.scales_of(np.array(exponents)[order > 1])
    found = posterior.solve_posterior(one, points.image, order, None, scales, 12)
    assert found is not None
    foreseen = predict_positions(found, other[:, order < 2], other[:, order > 1])
    share, precision = found.cells.share, np.zeros(len(order))
    for axis in (0, 1):
        means, variances = np.empty((2, len(share), 5))
        for i, (which, noise) in enumerate(zip(
                found.cells.solutions[axis], found.square / (found.freedom - 2), strict=True)):
            group, size = divmod(which, len(posterior.PRIOR_SIZES))
            precision[order > 1] = (posterior.PRIOR_SIZES[size] * scales[group]) ** -2.0
            inverse = np.linalg.inv(one.T @ one + np.diag(precision))
            means[i] = other @ inverse @ one.T @ points.image[:, axis]
            variances[i] = noise * ((other @ inverse) * other).sum(axis=1)
        between = share @ (means - share @ means) ** 2
        assert (between > 0.01 * (share @ variances)).any()
        np.testing.assert_allclose(foreseen.image[:, axis], share @ means, rtol=1e-6)
        np.testing.assert_allclose(foreseen.variance[:, axis], share @ variances + between,
                                   rtol=1e-6)


@pytest.mark.parametrize(("n", "noise", "near"), [(9, 0.02, 1e-9), (40, 0.02, 1e-9),
                                                  (60, 1e-9, 1e-6)])
def test_one_decomposition_for_all_scales_gives_what_one_for_each_does(
        n: int, noise: float, near: float) -> None:
    points = scattered(n)
    columns = np.concatenate([evaluate_monomials(points.ground, graded_exponents(2, 2)),
                              np.random.default_rng(1).normal(size=(n, 30))], axis=1)
    image = columns @ np.random.default_rng(2).normal(size=(36, 2)) \
        + noise * np.random.default_rng(3).normal(size=(n, 2))
    scales = np.array([[*rule, *[ratio] * 30] for rule in ((1.0, 0.3, 0.1), (1.0, 1.0, 1.0))
                       for ratio in (0.02, 2.0)])
    others = columns.copy()
    others[:, 6:] *= 2.0
    stack = np.array([others, columns])[:, :, 3:]
    by_one = posterior.solve_posteriors(columns[:, :3], stack, image, None, scales, 3)
    by_each = posterior.solve_posteriors(columns[:, :3], stack, image, None, scales, 33)
    assert by_one is not None
    assert by_each is not None
    found = by_one[1]
    expected = by_each[1]
    for one, other in zip(found.evidence, expected.evidence, strict=True):
        np.testing.assert_allclose(one.log_factor, other.log_factor, atol=1e-8)
        np.testing.assert_allclose(one.square, other.square, rtol=near)
    size = np.abs(expected.held_out.errors).max()
    np.testing.assert_allclose(found.held_out.errors, expected.held_out.errors, atol=near * size)
    for axis in (0, 1):
        np.testing.assert_allclose(*(one.mean(axis)[0] for one in (found, expected)), rtol=near)
        np.testing.assert_allclose(*(one.mean(axis)[1] for one in (found, expected)), rtol=near)


@pytest.mark.parametrize("condition", [1.0, 1e4, 1e7, 1e12])
def test_columns_are_orthogonal_whatever_their_condition(condition: float) -> None:
    rng = np.random.default_rng(8)
    turn = np.linalg.qr(rng.normal(size=(64, 64)))[0]
    columns = rng.normal(size=(300, 64)) * np.geomspace(1.0, 1.0 / condition, 64) @ turn
    q, r = orthogonal_factors(columns)
    np.testing.assert_allclose(q.T @ q, np.eye(64), atol=1e-13)
    np.testing.assert_allclose(q @ r, columns, atol=1e-13 * np.abs(columns).max())
    assert not np.tril(r, -1).any()


def test_few_columns_of_many_rows_are_orthogonal_too() -> None:
    columns = np.vander(np.linspace(-1.0, 1.0, 5000), 8)
    q, r = orthogonal_factors(columns)
    np.testing.assert_allclose(q.T @ q, np.eye(8), atol=1e-13)
    np.testing.assert_allclose(q @ r, columns, atol=1e-13)
    columns[:, 3] = columns[:, 5]  # dependent
    q, r = orthogonal_factors(columns)
    np.testing.assert_allclose(q @ r, columns, atol=1e-13)


@pytest.mark.parametrize("sigma", [False, True])
def test_a_field_without_each_point_is_the_field_of_the_others(sigma: bool) -> None:
    points = scattered(25, sigma=sigma)
    found = fit_gaussian_process(points, 2)
    assert found is not None
    for i in (0, 11):
        again = fit_gaussian_process(points.take(np.arange(25) != i), 2)
        assert again is not None
        # The affine transformation into the image, by which distances are taken, has all points.
        expected = points.image[i] - again.predict(points.ground[i:i + 1])[0]
        np.testing.assert_allclose(found.errors[i], expected, atol=0.1 * np.abs(expected).max())


def test_the_order_of_points_has_no_influence() -> None:
    points = scattered(120)
    order = np.random.default_rng(1).permutation(120)
    one, other = (fit_gaussian_process(p, 2) for p in (points, points.take(order)))
    assert one is not None
    assert other is not None
    at = scattered(9, seed=5).ground
    assert len(one.knots) < 120
    np.testing.assert_allclose(one.predict(at), other.predict(at), atol=1e-8)


def unseen(features: FeatureSet, count: int) -> tuple[FeatureSet, Points]:
    points = replace(features.points, roles=())
    return features.with_(points=points.take(np.arange(len(points)) < count)), points.take(
        np.arange(len(points)) >= count)


def total(errors: FloatArray) -> float:
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


@pytest.mark.parametrize("seed", [0, 1])
def test_local_deformation_calls_for_a_field(seed: int) -> None:
    control, others = unseen(simulate_map(seed=seed, n_points=260, sheets=(1, 1), local=10.0), 60)
    choice = Auto().choose(FitData.of(control, False))
    assert choice is not None
    assert choice.method.name in ("field", "tps")
    assert "show local deformation, with a probability of" in choice.reason
    best = min(total(one.errors(others)) for one in choice.compared if one.method.is_plain)
    assert total(choice.chosen.errors(others)) < 0.8 * best
    # It knows how uncertain it is between the points.
    sigma = choice.chosen.sigma(others.ground, measured=True)
    inside = np.abs(choice.chosen.errors(others)) < 1.645 * sigma
    assert 0.83 < inside.mean() < 0.97


@pytest.mark.parametrize("seed", range(3))
def test_an_affine_scan_calls_for_no_field(seed: int) -> None:
    control, others = unseen(simulate_map(seed=seed, n_points=240, sheets=(1, 1), local=0.0), 40)
    choice = Auto().choose(FitData.of(control, False))
    assert choice is not None
    assert choice.method.kind != "local"
    assert not {"field", "tps"} & {one.method.name for one in choice.compared}
    # Nor does it harm where it is asked for.
    field_errors = termsel.fit(control, "field").errors(others)
    assert total(field_errors) < 1.05 * total(choice.chosen.errors(others))


def test_folds_of_twenty_points_are_judged_as_all_of_them_are() -> None:
    """They have 19: were a spline a course of its own there, all of them would choose a field."""
    control, _ = unseen(simulate_map(seed=0, n_points=120, sheets=(1, 2), local=0.0, joints=12.0),
                        20)
    whole, *folds = (
        Auto().choose(FitData.of(control.take(np.arange(20) != out), False), with_contained=False)
        for out in (20, *range(6)))
    assert whole is not None
    assert sum(one is not None and one.method.name == whole.method.name for one in folds) >= 4


def test_few_points_of_joined_sheets_are_predicted_as_a_spline_does() -> None:
    errors = []
    for seed in range(8):
        control, others = unseen(simulate_map(
            seed=seed, n_points=112, sheets=(1, 2), local=0.0, joints=12.0), 12)
        choice = Auto().choose(FitData.of(control, False), with_contained=False)
        assert choice is not None
        errors.append([total(choice.chosen.errors(others)),
                       *(total(termsel.fit(control, name).errors(others))
                         for name in ("tps", "regularised-cubic"))])
    auto, spline, cubic = np.exp(np.log(errors).mean(axis=0))
    assert auto < 1.05 * spline
    assert auto < 0.9 * cubic


def test_models_of_points_refuse_what_they_cannot_do() -> None:
    scene = termsel.simulate_scene("ikonos-hamedan", n_points=12)
    with pytest.raises(termsel.TermselError, match="'smoothing'"):
        termsel.fit(scene, "tps", smoothing=-1.0)
    two = scene.take(np.arange(len(scene)) < 2)
    with pytest.raises(termsel.TermselError, match="6 terms"):
        termsel.fit(two, "field")


def test_more_points_leave_less_uncertain_in_units_of_the_noise(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """As long as each is a knot of the field; what it has between knots stays unknown."""
    one_cell(monkeypatch)
    monkeypatch.setattr(field, "_affine_to_image", lambda points, linear: np.eye(3)[:, :2])
    points = scattered(80)
    before, after = (fit_gaussian_process(points.take(np.arange(n)), 2) for n in (40, 80))
    field._cached_gaussian_process.cache_clear()
    posterior._cached_polynomial_posterior.cache_clear()
    assert before is not None
    assert after is not None
    (less, noise), (more, other) = (found.spread(points.ground) for found in (after, before))
    assert (less / noise <= more / other * (1 + 1e-9)).all()
    monkeypatch.setattr(field, "FIELD_KNOTS", 10)
    few = fit_gaussian_process(points, 2)
    field._cached_gaussian_process.cache_clear()
    posterior._cached_polynomial_posterior.cache_clear()
    assert few is not None
    variance, counted = few.spread(points.ground)
    assert (variance / counted).mean() > (less / noise).mean()
