"""A polynomial with the prior of known cameras."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import termsel
from termsel import FeatureSet, TermselError
from termsel.adjustment.bayesian import physics
from termsel.adjustment.bayesian.cameras import frame_views, radar_views
from termsel.adjustment.bayesian.physics import (
    N_FREE,
    CameraEquations,
    CameraPriors,
    CameraSolutions,
)
from termsel.auto.physical import camera_average, camera_average_of
from termsel.data.fit_data import FitData
from termsel.data.monomials import evaluate_monomials, graded_exponents
from termsel.simulate import simulate_scene
from termsel_bench.scenes.cameras import CHOSEN, image_of


def solutions(rows=slice(None), seed=3, scale=1.0):
    """A stack of one prior."""
    rng = np.random.default_rng(seed)
    columns = evaluate_monomials(rng.uniform(-1, 1, (7, 3)), graded_exponents(2, 3))
    image, weights = rng.normal(size=(7, 2)), rng.uniform(0.5, 1.5, (7, 2))
    rest = 2 * (columns.shape[1] - N_FREE)
    mean, root = 0.1 * rng.normal(size=rest), scale * rng.normal(size=(rest, rest))
    prior = CameraPriors(
        mean[None], (root @ root.T)[None], np.zeros(rest), ("any",), view=np.zeros(1, dtype=int),
        width=np.ones(1), size=np.ones(1), share=np.full(1, 0.25))
    return columns, image, weights, prior, CameraSolutions(
        CameraEquations(columns[rows], image[rows], weights[rows]), prior, 1.0)


def dense(columns, image, weights, prior, noise, free):
    """Mean and covariance of all measurements where free columns have a finite, wide prior."""
    both = np.kron(np.eye(2), columns)
    k = columns.shape[1]
    rest = np.r_[N_FREE:k, k + N_FREE:2 * k]
    covariance = np.zeros((2 * k, 2 * k))
    covariance[np.ix_(rest, rest)] = prior.covariances[0]
    for axis in (0, 1):
        covariance[axis * k + np.arange(N_FREE), axis * k + np.arange(N_FREE)] = free**2
    mean = np.zeros(2 * k)
    mean[rest] = prior.means[0]
    w = weights.T.ravel()
    return (w * (both @ mean), (w[:, None] * (both @ covariance @ both.T) * w)
            + noise**2 * np.eye(len(w)), w * image.T.ravel())


def test_marginal_likelihood_and_average_are_those_of_dense_normal_densities():
    columns, image, weights, prior, found = solutions()
    free, logs = 1e3, []
    for noise in physics.NOISE_GRID:
        mean, covariance, target = dense(columns, image, weights, prior, noise, free)
        logs.append(multivariate_normal.logpdf(target, mean, covariance, allow_singular=True))
    before = np.exp(
        -0.5 *
        (np.log(physics.NOISE_GRID / physics.NOISE_MEDIAN) / physics.NOISE_LOG_DEVIATION) ** 2)
    before /= before.sum()
    # A flat prior of density 1 for each free coefficient instead of a wide normal one.
    flat = np.array(logs) + 2 * N_FREE * np.log(free * np.sqrt(2 * np.pi))
    total = np.logaddexp.reduce(flat + np.log(before)) + np.log(prior.share[0])
    assert found.log_evidence[0] == pytest.approx(total, abs=1e-3)
    share = np.exp(flat + np.log(before) + np.log(prior.share[0]) - total)
    np.testing.assert_allclose(found.share[0], share, atol=1e-4)


def test_errors_of_points_left_out_are_those_of_solutions_without_them():
    columns, image, _, _, found = solutions()
    logs, errors = found.left_out()
    for out in range(7):
        rest = np.arange(7) != out
        without = solutions(rest)[-1]
        np.testing.assert_allclose(errors[0, out],
                                   image[out] - columns[out] @ without.coefficients[0], atol=1e-8)
        assert logs[0, out] == pytest.approx(without.log_evidence[0], abs=1e-8)


def test_spread_at_a_place_is_the_variance_of_a_measurement_there():
    columns, image, weights, prior, found = solutions()
    place = np.array([[1.0, 0.3, -0.2, 0.5, 0.09, -0.06, 0.15, 0.04, -0.1, 0.25]])
    variance, noise = found.spread(place)
    assert noise[0] == pytest.approx(found.share[0] @ found.noise**2)
    means, each = [], []
    for one in found.noise:
        mean, covariance, target = dense(
            np.concatenate([columns, place]), np.concatenate([image, np.zeros((1, 2))]),
            np.concatenate([weights, np.ones((1, 2))]), prior, one, 1e3)
        there = np.isin(np.arange(16), (7, 15))
        gain = covariance[np.ix_(there, ~there)] @ np.linalg.inv(covariance[np.ix_(~there, ~there)])
        means.append(mean[there] + gain @ (target - mean)[~there])
        each.append(np.diag(covariance[np.ix_(there, there)]
                            - gain @ covariance[np.ix_(~there, there)]) - one**2)
    middle = found.share[0] @ means
    expected = found.share[0] @ (np.array(each) + (np.array(means) - middle) ** 2)
    np.testing.assert_allclose(variance[0, 0], expected, rtol=1e-3)
    np.testing.assert_allclose((place @ found.coefficients[0])[0], middle, rtol=1e-3)


def worth(mine, others, without):
    """Return the RMSE with the prior over that without it."""
    rmse = [np.sqrt((termsel.fit(mine, name).errors(others) ** 2).sum(axis=1).mean())
            for name in ("physical-cubic", without)]
    return rmse[0] / rmse[1]


def test_six_points_of_a_steady_scanner_are_worth_twice_as_much():
    ratios = []
    for seed in range(4):
        scene = simulate_scene("spot-isfahan", seed=seed, roles=(6, 0, 60))
        independent = scene.points.take([role == "independent" for role in scene.points.roles])
        ratios.append(worth(scene, independent, "regularised-cubic"))
    assert np.median(ratios) < 0.5


@pytest.mark.parametrize(("kind", "count", "without", "least", "named"), [
    ("radar", 8, "regularised-cubic", 0.7, "a radar in orbit"),
    ("frame", 6, "regularised-quadratic", 0.5, "a frame camera")])
def test_few_points_of_a_radar_or_a_photo_are_worth_more_too(kind, count, without, least, named):
    ratios, kinds = [], []
    for seed in range(4):
        every = image_of(kind, seed, CHOSEN, count + 60)
        first = np.arange(count + 60) < count
        mine, others = every.take(first), every.points.take(~first)
        ratios.append(worth(mine, others, without))
        kinds.append(camera_average_of(termsel.fit(mine, "physical-cubic")).kind)
    assert np.median(ratios) < least
    assert kinds.count(named) >= 3


def test_a_place_above_is_seen_outward_by_its_share_of_the_height_of_the_camera():
    places = np.array([[1e3, 0.0, 0.0], [1e3, 0.0, 10.0], [0.0, 0.0, 0.0], [0.0, 1e3, 0.0],
                       [0.0, -1e3, 0.0]])
    seen, = frame_views(places, 0.0)
    assert len(seen) > 190
    ahead, right = (seen[:, i] - seen[:, 2] for i in (3, 0))
    assert (np.sign(ahead[:, 0]) == 1).all()
    assert (np.sign(right[:, 1]) == 1).all()
    # Of upright cameras (the middle of the tilts) a place is moved by z / (H - z) of its slope.
    above = 2.0 / (ahead[:, 0] - (seen[:, 4] - seen[:, 2])[:, 0]) * 1e3
    moved = np.linalg.norm(seen[:, 1] - seen[:, 0], axis=1)
    expected = 10.0 / above * np.linalg.norm(seen[:, 0], axis=1)
    assert np.median(moved / expected) == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose([above.min(), above.max()], [1e3, 1e4], rtol=0.3)


@pytest.mark.parametrize("on_ground", [False, True])
@pytest.mark.parametrize("right", [False, True])
def test_radars_see_heights_nearer_by_the_cotangent_and_in_the_same_line(right, on_ground):
    """North is ahead: a place 1 km up is nearer as one is on the ground, 1 km / tan away."""
    places = np.array([[0.0, 0.0, 0.0], [1e3, 0.0, 0.0], [0.0, 1e3, 0.0], [0.0, 0.0, 1e3]])
    seen = radar_views(places, 0.0, 45.0, right=right)[on_ground]
    assert len(seen) > 90
    _, east, north, up = (seen - seen[:, :1]).transpose(1, 0, 2)
    across = np.hypot(east[:, 1], north[:, 1])  # by 1 km along the range
    assert (np.sign(east[:, 1]) == (1 if right else -1)).all()
    incidence = np.degrees(np.arctan2(across, -up[:, 1]))
    assert 17.5 < incidence.min() < 22
    assert 48 < incidence.max() < 52.5
    assert np.abs(up[:, 0]).max() < 1e-3 * north[:, 0].min()
    np.testing.assert_allclose(north[:, 0], 0.145, atol=0.015)  # 6 to 8 km/s


def test_no_radar_sees_both_sides_of_its_track():
    wide = np.column_stack([np.linspace(-200e3, 200e3, 9), np.zeros((9, 2))])
    across = radar_views(wide, 0.0, 45.0, right=True)[1][..., 1]
    assert 10 < len(across) < 90
    assert (np.diff(across) > 0.0).all()


def test_more_than_the_fewest_points_must_call_for_it_by_strong_evidence():
    for count, at_odds_of_ten in ((6, False), (8, True)):
        control = FitData.of(simulate_scene("spot-isfahan", roles=(count, 0, 0), n_lines=0))
        found = camera_average(control.scaled.points, control.scaling, control.features.crs,
                               graded_exponents(3, 3))
        physical = len(found.physical)

        def by_odds(odds, found=found, physical=physical):
            shares = np.zeros(len(found.shares))
            shares[0], shares[physical] = odds / (1 + odds), 1 / (1 + odds)
            return replace(found, shares=shares, worse=0.0)

        assert [by_odds(odds).is_uncalled_for(None)
                for odds in (2, 10, 30)] == [True, at_odds_of_ten, False]


@pytest.mark.parametrize(("count", "needed"), [(12, [False, False, True]),
                                               (16, [False, True, True])])
def test_beyond_twelve_points_it_must_also_predict_points_better(count, needed):
    control = FitData.of(simulate_scene("spot-isfahan", roles=(count, 0, 0), n_lines=0))
    found = camera_average(control.scaled.points, control.scaling, control.features.crs,
                           graded_exponents(3, 3))
    assert [replace(found, worse=worse).is_uncalled_for(None)
            for worse in (-1.5, 0.0, 1.5)] == needed


@pytest.mark.parametrize(("shrunk", "meant"), [(1.0, True), (0.05, True), (1e-3, False),
                                               (1e4, False)])
def test_no_satellite_has_pixels_of_millimetres_or_of_kilometres(shrunk, meant):
    """Degrees without a CRS are no metres. SPOT's 10 m are a pixel, and so are 0.5 m."""
    points = simulate_scene("spot-isfahan", roles=(8, 0, 0), n_lines=0).points
    metres = (points.ground - points.ground.mean(axis=0)) * [90e3, 111e3, 1.0]
    control = FitData.of(FeatureSet(replace(points, ground=shrunk * metres)))
    found = camera_average(control.scaled.points, control.scaling, "", graded_exponents(3, 3))
    assert (found is not None) == meant


def test_auto_chooses_it_and_says_why_and_the_result_is_the_same_fit_again(tmp_path):
    scene = simulate_scene("spot-isfahan", roles=(8, 0, 30))
    result = termsel.run(features=scene, out=tmp_path / "out")
    assert result.strategy.chosen == "physical-cubic"
    assert "most likely a line scanner in orbit" in result.strategy.reason
    again = termsel.fit(scene, "physical-cubic")
    np.testing.assert_allclose(result.fit.adjustment.coefficients, again.adjustment.coefficients)
    others = scene.points.take([role == "independent" for role in scene.points.roles])
    sigma, errors = again.sigma(others.ground), again.errors(others)
    assert 0.5 < np.sqrt((sigma**2).mean() / (errors**2).mean()) < 3.0


@pytest.mark.slow_cases("radar-2-8-20", "steady-1-8-40")
@pytest.mark.parametrize(("kind", "seed", "control", "more"), [
    ("frame", 1, 6, 10), ("radar", 2, 8, 20), ("steady", 1, 8, 40)])
def test_with_independent_points_there_is_a_final_fit_as_well(kind, seed, control, more, tmp_path):
    """More points may no longer call for the prior, but the model to export is fitted to them."""
    every = image_of(kind, seed, CHOSEN, control + more)
    roles = ("control",) * control + ("independent",) * more
    result = termsel.run(features=every.with_(points=replace(every.points, roles=roles)),
                         out=tmp_path / "out")
    assert result.strategy.chosen == "physical-cubic"
    assert result.final is not None
    again = termsel.read_result(tmp_path / "out")
    ground = every.points.ground
    np.testing.assert_allclose(again.as_exported(True).project(ground),
                               result.as_exported(True).project(ground))
    errors = result.as_exported(True).project(ground) - every.points.image
    assert np.sqrt((errors**2).sum(axis=1).mean()) < 2.5


@pytest.mark.parametrize(("kind", "count"), [("frame", 12), ("panoramic", 20), ("steady", 5)])
def test_it_declines_where_the_image_is_no_scanner_or_points_are_few(kind, count):
    with pytest.raises(TermselError, match="do not support the sensor-geometry prior of a scanner"):
        termsel.fit(image_of(kind, 0, CHOSEN, count), "physical-cubic")


def test_it_declines_on_other_bodies_and_with_lines():
    image = image_of("steady", 0, CHOSEN, 8)
    with pytest.raises(TermselError, match="do not support"):
        termsel.fit(replace(image, crs="IAU_2015:49900"), "physical-cubic")
    lines = simulate_scene("ikonos-hamedan", n_points=12, n_lines=8)
    with pytest.raises(TermselError, match="takes control points alone"):
        termsel.fit(FeatureSet(lines.points, lines.lines, crs=lines.crs), "physical-cubic")


@pytest.mark.parametrize("height", [200.0, 1e9])
def test_a_prior_has_the_covariance_of_its_cameras_even_of_absurd_heights(height):
    rng = np.random.default_rng(0)
    scaled = rng.uniform(-1.2, 1.2, (60, 3))
    priors = physics.camera_priors(
        [physics.SCANNERS], scaled * [6e3, 6e3, height], scaled, graded_exponents(3, 3), 35.0,
        np.array([[0.0, -1.0], [1.0, 0.0]]) / 6e3, 4e-4)
    size = priors.means.shape[1]
    covariances = np.stack([priors.covariance_times(np.tile(unit, (len(priors.share), 1)))
                            for unit in np.eye(size)], axis=2)
    narrow, wide = covariances[[0, -1]]
    ratio = physics.PRIOR_WIDTHS[-1] / physics.PRIOR_WIDTHS[0]
    off = ~np.eye(len(narrow), dtype=bool)  # what comes to the variances of cameras is diagonal
    np.testing.assert_allclose(wide[off], ratio**2 * narrow[off], rtol=1e-6,
                               atol=1e-9 * abs(wide).max())
