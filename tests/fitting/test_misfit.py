"""The uncertainty of a model holds what it does not fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.fitting.local_courses import MAX_CELLS, TREND_COLUMNS, local_courses
from termsel.fitting.misfit import (
    LikelySolutions,
    NoisePrior,
    Spectrum,
    Whitened,
    matern_correlations,
    misfit_of,
    mixed_misfit,
    trend_of,
)
from termsel.fitting.scene import scene_grid
from termsel.io.plan import plan
from termsel.io.result_folder import write_result

NOISE, SIZE = 0.5, np.array([4000.0, 5000.0])


def bend(share: FloatArray, amplitude: float, rng: np.random.Generator) -> FloatArray:
    """Return smooth local shifts at places in shares of the image (n, 2) [px]."""
    waves = rng.normal(0.0, 4.0, (2, 40, 2))
    phases = rng.uniform(0.0, 2 * np.pi, (2, 40))
    return amplitude * np.sqrt(2 / 40) * np.stack([
        np.cos(share @ wave.T + phase).sum(axis=1)
        for wave, phase in zip(waves, phases, strict=True)], axis=1)


def sheet(n: int, amplitude: float, seed: int) -> tuple[FeatureSet, FloatArray, FloatArray]:
    """Return control points of a sheet, and places of it with their image coordinates."""
    rng = np.random.default_rng([seed, n])
    share = rng.uniform(0.02, 0.98, (n + 300, 2))
    inside = (np.abs(share - 0.5) < 0.42).all(axis=1)
    image = share * SIZE + bend(share, amplitude, rng)
    ground = np.column_stack([500_000 + 3 * SIZE[1] * share[:, 1], 5e6 - 3 * SIZE[0] * share[:, 0],
                              np.full(len(share), np.nan)])
    measured = image[:n] + rng.normal(0.0, NOISE, (n, 2))
    features = FeatureSet(Points(tuple(f"P{i}" for i in range(n)), measured, ground[:n]),
                          crs="EPSG:32633", image_size=(4000, 5000))
    dense = np.flatnonzero(inside[n:]) + n
    return features, ground[dense], image[dense]


def ratio(model: str, n: int, amplitude: float, seeds: range) -> float:
    """Return the root mean square of errors by their standard deviations."""
    squares = []
    for seed in seeds:
        features, ground, truth = sheet(n, amplitude, seed)
        fitted = termsel.fit(features, model)
        squares.append((((fitted.project(ground) - truth) / fitted.sigma(ground))**2).mean())
    return float(np.sqrt(np.mean(squares)))


def noise_prior(pixel: float, sigma: FloatArray | None = None) -> NoisePrior:
    """Return what is known of the noise of maps."""
    return NoisePrior.of(pixel, sigma, with_heights=False)


@pytest.mark.parametrize(("model", "n", "amplitude"), [
    ("projective", 30, 1.5), ("projective", 40, 0.0), ("tps", 30, 1.5), ("field", 12, 2.0),
    ("regularised-quadratic", 30, 0.6)])
def test_errors_are_of_the_size_that_is_stated(model: str, n: int, amplitude: float) -> None:
    assert 0.8 < ratio(model, n, amplitude, range(6)) < 1.3


def test_a_model_that_others_are_better_than_is_stated_to_be_no_better_than_it_is() -> None:
    assert 0.85 < ratio("projective", 60, 2.5, range(4)) < 1.2


def test_a_scatter_of_pixels_among_few_points_is_rather_misfit_than_noise() -> None:
    rng = np.random.default_rng(5)
    image = rng.uniform(-1.0, 1.0, (12, 2))
    residuals = rng.normal(0.0, 1.0, (12, 2))
    places = rng.uniform(-0.7, 0.7, (50, 2))
    shares = []
    for scatter in (0.3, 1.0, 3.0, 10.0):  # px
        missed = misfit_of(image, residuals, noise_prior(1.0 / scatter), 6.0)
        assert missed is not None
        shares.append(missed.squares(places).mean())
    assert shares == sorted(shares)
    assert shares[0] < 0.25
    assert 0.4 < shares[-1] < 2.0


def test_stated_deviations_of_measurements_are_what_is_known_of_the_noise() -> None:
    rng = np.random.default_rng(6)
    image = rng.uniform(-1.0, 1.0, (12, 2))
    residuals = rng.normal(0.0, 1.0, (12, 2))
    precise, rough = (misfit_of(image, residuals, noise_prior(0.01, np.full((12, 2), sigma)), 6.0)
                      for sigma in (0.05, 1.0))
    assert precise is not None
    assert rough is not None
    assert precise.probability > 2 * rough.probability


def test_what_is_mixed_is_missed_by_the_mean_of_the_squares() -> None:
    rng = np.random.default_rng(7)
    image = rng.uniform(-1.0, 1.0, (20, 2))
    first, second = (misfit_of(image, rng.normal(0.0, size, (20, 2)), noise_prior(1.0), 6.0)
                     for size in (1.0, 3.0))
    assert first is not None
    assert second is not None
    mixed = mixed_misfit([(0.3, first), (0.7, second)])
    assert mixed is not None
    expected = 0.3 * first.squares(image) + 0.7 * second.squares(image)
    np.testing.assert_allclose(mixed.squares(image), expected)
    assert mixed_misfit([]) is None


def test_the_uncertainty_is_less_where_the_control_shows_the_misfit() -> None:
    features, _, _ = sheet(60, 3.0, 1)
    fitted = termsel.fit(features, "projective")
    assert fitted.misfit is not None
    assert fitted.misfit.probability > 0.95
    near = features.points.image[:1]
    far = near + 1e6
    scaled = fitted.scaling.image(np.concatenate([near, far]))
    covariance = fitted.misfit.covariance(scaled, 0)
    assert covariance[0, 0] < 0.5 * covariance[1, 1]


def test_beyond_the_control_a_misfit_has_an_end() -> None:
    features, _, _ = sheet(60, 3.0, 1)
    misfit = termsel.fit(features, "projective").misfit
    assert misfit is not None
    far, farther = (np.sqrt(misfit.squares(np.full((1, 2), distance))) for distance in (5.0, 50.0))
    np.testing.assert_allclose(far, farther, rtol=0.01)


def test_noise_alone_has_no_misfit_that_matters() -> None:
    rng = np.random.default_rng(3)
    image = rng.uniform(-1.0, 1.0, (120, 2))
    noise = rng.normal(0.0, 1.0, (120, 2))
    trend = trend_of(image, 6)
    missed = misfit_of(image, noise - trend @ np.linalg.lstsq(trend, noise)[0], noise_prior(2.0),
                       12.0)
    assert missed is not None
    assert missed.squares(rng.uniform(-1.0, 1.0, (100, 2))).mean() < 0.03
    assert misfit_of(image[:5], image[:5], noise_prior(2.0), 6.0) is None
    assert misfit_of(image, np.zeros((120, 2)), noise_prior(2.0), 6.0) is None


def test_no_camera_is_without_misfit_however_small_the_noise() -> None:
    prior = NoisePrior.of(1.0, None, with_heights=True)
    precise, rough = (
        prior.field_size_probabilities(np.array([noise])).sum() for noise in (0.03, 1.0))
    assert 0.95 < precise < 1.0
    assert 0.36 < rough < 0.5  # a small misfit is none by so much noise
    drawing = NoisePrior.of(1.0, None, with_heights=False).field_size_probabilities(np.ones(3))
    np.testing.assert_allclose(drawing.sum(axis=0), 0.36)


@pytest.mark.parametrize("noise", [0.05, 0.1, 0.5])
def test_matched_points_of_a_camera_leave_some_hundredths_of_a_pixel_open(noise: float) -> None:
    rng = np.random.default_rng(21)
    image = rng.uniform(-1.0, 1.0, (60, 2))
    trend = trend_of(image, 10)
    measured = rng.normal(0.0, noise, (60, 2))
    residuals = measured - trend @ np.linalg.lstsq(trend, measured)[0]
    missed = misfit_of(image, residuals, NoisePrior.of(1.0, None, with_heights=True), 20.0)
    assert missed is not None
    size = np.sqrt(missed.squares(image).mean())
    assert 0.01 < size < 0.5 * noise


def test_a_field_that_a_cubic_fit_has_flattened_is_seen_still() -> None:
    rng = np.random.default_rng(22)
    image = rng.uniform(-1.0, 1.0, (300, 2))
    waves = np.column_stack([np.sin(image @ [6.0, 2.0]), np.cos(image @ [-3.0, 6.0])])
    seen = 1.5 * waves[:60] + rng.normal(0.0, 0.3, (60, 2))
    cubic = trend_of(image, 10)
    coefficients = np.linalg.lstsq(cubic[:60], seen)[0]
    missed = misfit_of(image[:60], seen - cubic[:60] @ coefficients,
                       NoisePrior.of(1.0, None, with_heights=True), 20.0)
    assert missed is not None
    errors = (1.5 * waves - cubic @ coefficients)[60:]
    assert 0.75 < np.sqrt((errors**2 / missed.squares(image[60:])).mean()) < 1.25


def test_points_in_rows_that_determine_no_cubic_trend_have_a_misfit_by_a_lesser_one() -> None:
    rng = np.random.default_rng(23)
    image = np.column_stack([rng.uniform(-1.0, 1.0, 60), np.repeat([-1.0, 0.0, 1.0], 20)])
    missed = misfit_of(image, rng.normal(0.0, 1.0, (60, 2)), noise_prior(1.0), 20.0)
    assert missed is not None
    assert np.isfinite(missed.squares(image)).all()
    in_a_row = image * [1.0, 0.0]
    assert misfit_of(in_a_row, rng.normal(0.0, 1.0, (60, 2)), noise_prior(1.0), 20.0) is None


def test_what_lines_have_in_common_is_no_noise_however_fast_it_changes() -> None:
    rng = np.random.default_rng(8)
    image = rng.uniform(-1.0, 1.0, (160, 2))
    shaken = 3.0 * np.sin(100.0 * image[:, :1] + [0.0, 1.0]) + rng.normal(0.0, 0.5, (160, 2))
    missed = misfit_of(image[:60], shaken[:60], noise_prior(1.0), 6.0)
    assert missed is not None
    assert 0.8 < np.sqrt((shaken[60:]**2 / (missed.squares(image[60:]) + 0.25)).mean()) < 1.2


def test_a_scatter_of_pixels_is_rather_misfit_in_images_of_cameras_than_on_maps() -> None:
    rng = np.random.default_rng(9)
    image = rng.uniform(-1.0, 1.0, (12, 2))
    residuals = rng.normal(0.0, 3.0, (12, 2))
    camera, drawing = (misfit_of(image, residuals, NoisePrior.of(1.0, None, with_heights=heights),
                                 6.0) for heights in (True, False))
    assert camera is not None
    assert drawing is not None
    assert camera.squares(image).mean() > 1.2 * drawing.squares(image).mean()


def rough_or_smooth(smoothness: float, seed: int) -> tuple[FeatureSet, FloatArray, FloatArray]:
    """Return control of a sheet with local errors of 8 px, and 100 places where it shows them."""
    rng = np.random.default_rng([10, seed])
    share = rng.uniform(0.02, 0.98, (160, 2))
    root = np.linalg.cholesky(
        matern_correlations(share, share, (0.3, 0.3), smoothness) + 1e-9 * np.eye(160))
    image = share * SIZE + 8.0 * root @ rng.standard_normal((160, 2))
    ground = np.column_stack([500_000 + 3 * SIZE[1] * share[:, 1], 5e6 - 3 * SIZE[0] * share[:, 0],
                              np.full(160, np.nan)])
    measured = image[:60] + rng.normal(0.0, NOISE, (60, 2))
    points = Points(tuple(f"P{i}" for i in range(60)), measured, ground[:60])
    return FeatureSet(points, crs="EPSG:32633"), ground[60:], image[60:]


@pytest.mark.parametrize("smoothness", [0.5, np.inf])
@pytest.mark.parametrize("model", ["tps", "field"])
def test_errors_of_local_models_are_stated_for_rough_and_for_smooth_sheets(
        model: str, smoothness: float) -> None:
    squares = []
    for seed in range(4):
        features, ground, truth = rough_or_smooth(smoothness, seed)
        fitted = termsel.fit(features, model)
        squares.append((((fitted.project(ground) - truth) / fitted.sigma(ground))**2).mean())
    assert 0.8 < np.sqrt(np.mean(squares)) < 1.25


def test_more_points_than_the_field_is_found_by_do_not_change_the_uncertainty_at_once() -> None:
    rng = np.random.default_rng(11)
    image = rng.uniform(-1.0, 1.0, (201, 2))
    rough = image + 0.01 * np.floor(3.0 * image[:, ::-1]) + rng.normal(0.0, 1e-3, (201, 2))
    ground = np.column_stack([image, np.full(201, np.nan)])
    places = ground[:50] * 0.9
    squares = []
    for n in (200, 201):
        courses = local_courses(Points(tuple(map(str, range(n))), rough[:n], ground[:n]), 1e-3)
        assert courses is not None
        squares.append(courses.squares(places, places[:, :2]))
    np.testing.assert_allclose(squares[0].mean(), squares[1].mean(), rtol=0.1)


def road_and_sheet() -> Points:
    """Return 400 points of a straight road, and 100 all over a sheet that bends."""
    rng = np.random.default_rng(12)
    road = np.column_stack([np.linspace(-0.8, -0.4, 400), np.full(400, -0.8)])
    places = np.concatenate([road, rng.uniform(-1.0, 1.0, (100, 2))])
    image = places + 0.02 * np.sin(4.0 * places) + rng.normal(0.0, 1e-3, places.shape)
    return Points(tuple(map(str, range(500))), image, np.column_stack([places, np.zeros(500)]))


def test_points_in_a_row_do_not_alone_say_what_is_uncertain_near_them() -> None:
    courses = local_courses(road_and_sheet(), 1e-3)
    assert courses is not None
    beside_road = np.array([[-0.6, -0.75, 0.0], [-0.6, -0.6, 0.0], [-0.8, -0.6, 0.0]])
    truth = beside_road[:, :2] + 0.02 * np.sin(4.0 * beside_road[:, :2])
    sigma = np.sqrt(courses.squares(beside_road, truth))
    assert (sigma < 0.02).all()


def test_cells_of_many_points_are_few_and_are_not_kept() -> None:
    rng = np.random.default_rng(13)
    image = rng.uniform(-1.0, 1.0, (6000, 2))
    rough = image + 0.01 * np.floor(3.0 * image[:, ::-1]) + rng.normal(0.0, 1e-3, (6000, 2))
    ground = np.column_stack([image, np.zeros(6000)])
    courses = local_courses(Points(tuple(map(str, range(6000))), rough, ground), 1e-3)
    assert courses is not None
    assert len(courses._centres) == MAX_CELLS
    before = set(vars(courses))
    assert np.isfinite(courses.squares(ground[:2], image[:2])).all()
    assert set(vars(courses)) == before


def many_points(field: FloatArray, places: FloatArray) -> Points:
    """Return points of a sheet whose shifts are a field (n, 2), with a noise of 1."""
    rng = np.random.default_rng(15)
    scale = 1e-3
    image = places + scale * (field + rng.normal(0.0, 1.0, places.shape))
    return Points(tuple(map(str, range(len(places)))), image,
                  np.column_stack([places, np.zeros(len(places))]))


def test_many_points_know_a_weak_bend_better_than_any_two_hundred_of_them() -> None:
    places = np.random.default_rng(14).uniform(-1.0, 1.0, (2000, 2))
    courses = local_courses(many_points(0.6 * np.sin(4.0 * places[:, ::-1] + 1.0), places), 2e-3)
    assert courses is not None
    near = 0.05 * places[:20] + 0.3
    truth = near + 6e-4 * np.sin(4.0 * near[:, ::-1] + 1.0)
    sigma = np.sqrt(courses.squares(np.column_stack([near, np.zeros(20)]), truth).mean())
    assert np.sqrt(courses.noise) == pytest.approx(1e-3, rel=0.05)
    assert sigma < 0.15e-3


def distorted(count: int, size: float, relief: float) -> FeatureSet:
    """Return points of an image that is distorted by a size towards its corners [px].

    They are measured to half a pixel. Without relief no height is known.
    """
    rng = np.random.default_rng([33, count])
    share = rng.uniform(0.0, 1.0, (count, 2))
    centred = 2.0 * share - 1.0
    distortion = size * centred * (0.5 * centred**2).sum(axis=1, keepdims=True)**2
    heights = rng.uniform(0.0, relief, count) if relief else np.full(count, np.nan)
    parallax = centred * np.nan_to_num(heights)[:, None] / 8.0
    ground = np.column_stack([5e5 + 8e3 * share[:, 1], 5e6 - 8e3 * share[:, 0], heights])
    image = 4e3 * share + distortion + parallax + rng.normal(0.0, 0.5, (count, 2))
    return FeatureSet(Points(tuple(map(str, range(count))), image, ground), crs="EPSG:32633")


@pytest.mark.parametrize(("relief", "model"), [(0.0, "field"), (300.0, "field3d")])
@pytest.mark.parametrize("size", [0.0, 100.0, 1000.0])
def test_noise_is_told_from_a_field_of_any_size(size: float, relief: float, model: str) -> None:
    # A field of 1000 px had the noise stated as up to ten times what it is.
    features = distorted(60, size, relief)
    fitted = termsel.fit(features, model)
    places = features.points.ground
    noise = np.sqrt(fitted.sigma(places, measured=True)**2 - fitted.sigma(places)**2)
    assert 0.3 < noise.mean() < 1.3


@pytest.mark.parametrize("smoothness", [0.5, 1.5])
def test_groups_of_many_points_tell_a_rough_field_from_a_smooth_one(smoothness: float) -> None:
    rng = np.random.default_rng(16)
    places = rng.uniform(-1.0, 1.0, (600, 2))
    root = np.linalg.cholesky(
        matern_correlations(places, places, (0.6, 0.6), smoothness) + 1e-9 * np.eye(600))
    courses = local_courses(many_points(6.0 * root @ rng.standard_normal((600, 2)), places), 2e-3)
    assert courses is not None
    share = sum(solutions.shares[:, 0].sum() for solutions in courses.solutions
                if solutions.smoothness == smoothness)
    assert share > 0.9


def test_rows_of_points_determine_a_trend_of_as_high_a_degree_as_they_can() -> None:
    line, sample = np.meshgrid(np.linspace(-1.0, 1.0, 3), np.linspace(-1.0, 1.0, 10))
    places = np.column_stack([line.ravel(), sample.ravel(), np.zeros(30)])
    rng = np.random.default_rng(17)
    image = places[:, :2] + 1e-3 * rng.standard_normal((30, 2))
    for grid, columns in ((image, 10), (places[:, :2], 6)):
        courses = local_courses(Points(tuple(map(str, range(30))), image,
                                       np.column_stack([grid, np.zeros(30)])), 1e-3)
        assert courses is not None
        assert courses.control.trend.shape == (30, columns)


def test_a_bend_of_third_degree_is_no_field() -> None:
    rng = np.random.default_rng(18)
    places = rng.uniform(-1.0, 1.0, (60, 2))
    bend = 8.0 * places * (places**2).sum(axis=1, keepdims=True)
    courses = local_courses(many_points(bend, places), 2e-3)
    assert courses is not None
    cubic = sum(solutions.shares[-1, 0].sum() for solutions in courses.solutions)
    assert cubic > 0.9


def test_jumps_between_swaths_are_told_from_a_smooth_course_across_them() -> None:
    rng = np.random.default_rng(19)
    places = rng.uniform(-1.0, 1.0, (600, 2))
    shifts = rng.normal(0.0, 0.8, (10, 2))
    in_swaths = shifts[(5.0 * (places[:, 1] + 1.0)).astype(int)]
    courses = local_courses(many_points(in_swaths, places), 2e-3)
    assert courses is not None
    rough = sum(solutions.shares[:, 0].sum() for solutions in courses.solutions
                if solutions.lengths[0] == 20.0)
    assert rough > 0.5


def test_a_course_of_several_trends_is_the_sum_of_theirs() -> None:
    courses = local_courses(road_and_sheet().take(np.arange(380, 500)), 1e-3)
    assert courses is not None
    system = courses.control
    places = np.array([[0.2, 0.3], [-0.7, 0.9]])
    trend = trend_of(places, 10)
    for solutions in courses.solutions[:3]:
        expected = np.zeros((2, 2))
        for columns, shares in zip(TREND_COLUMNS, solutions.shares, strict=True):
            spectrum, = system.spectra([solutions.lengths], solutions.smoothness)
            course = replace(system, trend=system.trend[:, :columns]).course(
                spectrum, solutions.ratios, shares)
            expected += course.squares(course.columns(
                places, system.positions, trend[:, :columns]), 0.01)
        course = solutions.course(system)
        found = course.squares(course.columns(places, system.positions, trend), 0.01)
        np.testing.assert_allclose(found, expected, rtol=0.01, atol=1e-9)


def test_a_course_of_likely_solutions_is_that_of_the_inverse_of_each_system() -> None:
    rng = np.random.default_rng(17)
    places = rng.uniform(-1.0, 1.0, (12, 2))
    trend = trend_of(places, 6)
    deviations = rng.normal(size=(12, 2))
    variances = rng.uniform(0.5, 2.0, 12)
    correlations = [matern_correlations(places, places, (length, 0.5)) for length in (0.3, 0.9)]
    ratios = (0.5, 2.0)
    seen = Whitened.of([Spectrum.of(K, variances, (1.0, 0.5), 1.5) for K in correlations], ratios,
                       trend, deviations)
    # An affine trend that nothing shrinks, without columns of higher degree, and a shrunken one.
    precisions = np.array([[0.0] * 3 + [np.inf] * 3, [0.0] * 3 + [7.0] * 3])
    noise = rng.uniform(size=(2, 2))
    course = seen.courses([LikelySolutions(1, 1.0, np.array([0, 1]), precisions, noise, noise)])[0]
    explained = np.zeros((2, 18, 18))
    for i, columns in enumerate((3, 6)):
        S = np.diag(variances) + ratios[i]**2 * correlations[1]
        F = trend[:, :columns]
        inverse = np.linalg.inv(np.block([[S, F], [F.T, -np.diag(precisions[i, :columns])]]))
        scale = np.append(np.full(12, ratios[i]**2), np.ones(columns))
        solution = scale[:, None] * inverse[:, :12] @ deviations
        np.testing.assert_allclose(course.means[i][:12 + columns], solution, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(course.means[i][12 + columns:], 0.0, atol=1e-12)
        explained[:, :12 + columns, :12 + columns] += (
            noise[:, i, None, None] * scale[:, None] * inverse * scale)
    np.testing.assert_allclose(course.explained, explained, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(course.variance, noise @ np.square(ratios))


def test_few_points_of_unknown_noise_say_that_they_do_not_tell_it_from_deformation() -> None:
    features, _, _ = sheet(12, 2.0, 5)
    fitted = termsel.fit(features, "projective")
    assert fitted.uncertainty_caveat.startswith("12 control points cannot distinguish noise")
    known = replace(features, points=replace(features.points, sigma=np.full((12, 2), 0.5)))
    assert termsel.fit(known, "projective").uncertainty_caveat == ""
    assert termsel.fit(sheet(40, 2.0, 5)[0], "projective").uncertainty_caveat == ""


@pytest.mark.parametrize("model", ["projective", "tps"])
def test_a_thousand_points_are_enough_to_know_it(model: str) -> None:
    features, ground, truth = sheet(1000, 2.0, 2)
    fitted = termsel.fit(features, model)
    sigma = fitted.sigma(ground)
    assert np.isfinite(sigma).all()
    assert 0.85 < np.sqrt((((fitted.project(ground) - truth) / sigma)**2).mean()) < 1.2


def test_a_plan_counts_what_the_model_does_not_fit(tmp_path: Path) -> None:
    features, _, _ = sheet(40, 2.5, 3)
    result = termsel.run("poly-terms", features=features, model="projective2d", solver="all-terms",
                         criterion="press", options={"fractions": "1:0:0"})
    assert result.fit.misfit is not None
    planned = plan(result, 3)
    scene = scene_grid(result.fit, 20)[1]
    seen = scene[np.isfinite(scene).all(axis=1)]
    squares = (result.fit.sigma(seen)**2).sum(axis=1)
    assert planned.sigma_before == pytest.approx(np.sqrt(squares.mean()), rel=0.01)
    assert (np.diff([planned.sigma_before, *planned.values[:, 5]]) < 0).all()


def test_what_all_places_share_is_part_of_the_uncertainty(tmp_path: Path) -> None:
    features, ground, _ = sheet(20, 0.0, 4)
    result = termsel.run(features=features)
    shared = result.with_(shared_sigma=(3.0, 4.0))
    np.testing.assert_allclose(shared.sigma(ground), np.hypot(result.sigma(ground), [3.0, 4.0]))
    expected = np.hypot(plan(result, 1).sigma_before, 5.0)
    assert plan(shared, 1).sigma_before == pytest.approx(expected)
    assert min(row["sigma"] for row in shared.view.sigma) > 5.0
    (tmp_path / "r").mkdir()
    write_result(shared, tmp_path / "r")
    assert termsel.read_result(tmp_path / "r").shared_sigma == (3.0, 4.0)
