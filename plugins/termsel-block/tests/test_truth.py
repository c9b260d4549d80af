"""Blocks against the truth: standard deviations, blunders, heights, and what is chosen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

pytest.importorskip("termsel_block", reason="termsel-block is not installed: "
                    "pip install -e plugins/termsel-block")

from termsel_block.accuracy import independent_points, rms_length
from termsel_block.estimation.starts import start
from termsel_block.estimation.unknowns import BlockUnknowns
from termsel_block.evidence.variances import posterior_mean
from termsel_block.files.folders import image_result
from termsel_block.geometry.cameras import PolynomialCamera
from termsel_block.geometry.frame import FloatArray
from termsel_block.joint import BlockResult, adjust
from termsel_block.shown.record import WrongTie, record_of, times_seen
from termsel_block.shown.summary import first_screen, reason_of
from termsel_block.simulated import LAT, LON, Hills, Simulated, ground_heights, simulate_block


def errors(result: BlockResult) -> FloatArray:
    """Return the RMSE of the independent points of each image [px]."""
    found = []
    for i in range(len(result.block.images)):
        points = independent_points(result, i)
        assert points is not None
        found.append(rms_length(points.image - result.project(i, points.ground)))
    return np.array(found)


def chi_square(simulated: Simulated, result: BlockResult) -> float:
    """Return the mean square of the errors of ties over their variance."""
    away = result.adjusted.state.ties - result.frame.local(simulated.ties)
    covariance = result.adjusted.solved.covariance_of_ties()
    of_each = np.einsum("ti,tij,tj->t", away, np.linalg.inv(covariance), away)
    return float(of_each[times_seen(result) > 1].mean()) / 3


@pytest.mark.slow
def test_images_without_geometry_know_how_uncertain_they_are() -> None:
    """Their perspective is common to all, so that ties cannot show it."""
    found, off = [], []
    for seed in range(6):
        simulated = simulate_block(3, control=(6, 6, 0), seed=seed, independent=30)
        result = adjust(simulated.block)
        found.append(chi_square(simulated, result))
        off.append(errors(result)[2])
    assert 0.5 < np.median(found) < 1.5  # 2.1 without the perspective
    assert np.median(off) < 4.0  # px; 7 without it


@pytest.mark.slow
def test_a_wrong_ray_at_the_start_does_not_bend_all_images() -> None:
    """Six points on nearly one plane: the first model of each image has rays 13 degrees off."""
    phases = np.random.default_rng([309, 7]).uniform(0, 2 * np.pi, 4).tolist()
    simulated = simulate_block(3, n_ties=200, control=(6, 6, 0), noise=0.4, seed=309,
                               independent=30, hills=Hills(1.0, tuple(phases)))
    result = adjust(simulated.block)
    assert errors(result).max() < 3.0  # 14 px where the perspective stayed that of the start
    assert chi_square(simulated, result) < 3.0  # 26


@pytest.mark.slow
def test_a_good_tie_that_began_far_off_is_not_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def start_far_off(*given: Any) -> BlockUnknowns:
        state = start(*given)
        state.ties[:3] += [300.0, -300.0, 0.0]
        return state

    simulated = simulate_block(2, n_ties=60, control=(8, 8), noise=0.4, seed=3, wrong=0.0)
    monkeypatch.setattr("termsel_block.joint.start", start_far_off)
    result = adjust(simulated.block)
    assert (times_seen(result)[:3] > 1).all()
    assert not record_of(result).wrong_ties


def test_the_perspective_has_its_derivatives() -> None:
    rng = np.random.default_rng(0)
    camera = PolynomialCamera(np.array([10.0, -20.0, 5.0]), 12e3, 5e3, np.array([3e3, 2e3]))
    of_axes = rng.normal(0, 20, (len(camera.powers), 2))
    of_axes[1:4] += [[-900.0, 4800.0], [-4700.0, -1000.0], [800.0, 1500.0]]
    parameters = of_axes.T.ravel()
    local = rng.uniform(-12e3, 12e3, (7, 3)) * [1, 1, 0.02]
    rows = camera.jacobian(parameters, local)
    for at in range(parameters.size):
        step = np.zeros(parameters.size)
        step[at] = 0.5
        ahead, back = (camera.project(parameters + sign * step, local)
                       for sign in (1, -1))
        np.testing.assert_allclose(rows[:, :, at], ahead - back, atol=1e-6)
    assert np.abs(camera.perspective(parameters, local)).max() > 5.0  # px: more than rounding


def test_a_correction_is_dropped_only_after_those_that_contain_it() -> None:
    simulated = simulate_block(3, rpcs=True, control=(20, 0, 0), seed=11, independent=30)
    result = adjust(simulated.block)
    for camera in result.adjusted.state.cameras:
        assert camera.columns == camera.COLUMNS[:len(camera.columns)]  # type: ignore[attr-defined]
    assert errors(result).max() < 5  # 27 px with a drift but no shift
    assert len(record_of(result).wrong_ties) < 3  # 42


@pytest.mark.slow
@pytest.mark.parametrize("rpcs", [True, False])
def test_wrong_ties_cost_little(rpcs: bool) -> None:
    """A tenth of them, and at most 15 %."""
    ratios = []
    for seed in range(3):
        clean, wrong = (errors(adjust(simulate_block(
            3, rpcs=rpcs, control=(6, 6, 0), seed=seed, independent=30, wrong=share).block))
            for share in (0.0, 0.1))
        ratios.append(np.sqrt((wrong**2).mean() / (clean**2).mean()))
    assert np.mean(ratios) < 1.15


@pytest.mark.slow
def test_a_dem_holds_ties_that_no_image_in_use_sees(tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    n, half = 400, 0.3
    step = 2 * half / n
    lon, lat = LON - half + step * (np.arange(n) + 0.5), LAT + half - step * (np.arange(n) + 0.5)
    places = np.stack(np.meshgrid(lon, lat), axis=-1).reshape(-1, 2)
    with rasterio.open(
            tmp_path / "dem.tif", "w", driver="GTiff", width=n, height=n, count=1,
            dtype="float32", crs="EPSG:4979",
            transform=rasterio.transform.from_origin(LON - half, LAT + half, step, step)) as raster:
        raster.write(ground_heights(places).reshape(n, n).astype(np.float32), 1)
    simulated = simulate_block(3, control=(6, 6, 0), seed=1, independent=30, wrong=0.1)
    without = adjust(simulated.block)
    result = adjust(replace(simulated.block, dem=tmp_path / "dem.tif"))
    assert (times_seen(result) < 2).any()
    assert errors(result)[2] < 1.1 * errors(without)[2]


def test_an_image_without_ties_stays_as_its_vendor_has_it() -> None:
    block = simulate_block(3, n_ties=60, rpcs=True, control=(4, 4), seed=1, independent=10).block
    ties, keep = block.ties, block.ties.image != 2
    seen = np.bincount(ties.tie[keep], minlength=len(ties.names)) > 1
    keep &= seen[ties.tie]
    record = record_of(adjust(replace(block, ties=replace(
        ties, tie=ties.tie[keep], image=ties.image[keep], position=ties.position[keep]))))
    assert record.images[2].ties == 0
    assert ["I3"] in record.parts


def test_jitter_is_found_where_it_is_and_written() -> None:
    simulated = simulate_block(3, rpcs=True, control=(6, 6, 0), seed=2, independent=30,
                               jitter=(0.0, 1.5))
    result = adjust(simulated.block)
    record = record_of(result)
    assert [image.model == "smooth" for image in record.images] == [False, True, False]
    asked = replace(simulated.block, images=tuple(
        replace(image, model="affine") for image in simulated.block.images))
    assert errors(result)[1] < 0.7 * errors(adjust(asked))[1]
    written = image_result(result, 1, record)
    assert written.model == "rpc-jitter"
    ground = simulated.block.images[1].features.points.ground  # type: ignore[union-attr]
    away = written.fit.project(ground) - result.project(1, ground)
    assert rms_length(away) < 0.3


def test_a_variance_that_data_leave_open_is_not_zero() -> None:
    """Six values that are known worse than they scatter say no more than that."""
    rng = np.random.default_rng(0)
    kept = []
    for _ in range(200):
        truth, noise = rng.normal(0, 0.1, 6), 0.1
        prior = 4.0
        posterior = 1 / (1 / noise**2 + 1 / prior)
        mean = posterior * (truth + rng.normal(0, noise, 6)) / noise**2
        kept.append(posterior_mean(mean, np.full(6, posterior), np.full(6, prior),
                                   np.full(6, 2.0)))
    assert min(kept) > 0.03**2
    assert 0.08 < np.sqrt(np.median(kept)) < 0.2


def test_no_rejected_tie_is_said_to_be_farther_off_than_it_is() -> None:
    """Ties that no image uses are where their rays meet, and not where the ground may be."""
    simulated = simulate_block(3, rpcs=True, control=(6, 6), wrong=0.15, seed=4, independent=5)
    block = simulated.block
    ties = block.ties
    true_error: dict[str, float] = {}
    for i, sensor in enumerate(simulated.sensors):
        rows = np.flatnonzero(ties.image == i)
        away = ties.position[rows] - sensor.project(simulated.ties[ties.tie[rows]])
        for tie, error in zip(ties.tie[rows], np.hypot(*away.T), strict=True):
            name = ties.names[tie]
            true_error[name] = max(true_error.get(name, 0.0), float(error))
    record = record_of(adjust(block))
    wrong_ties = record.wrong_ties
    assert len(wrong_ties) > 20
    for tie in wrong_ties:
        assert tie.error < 1.1 * true_error[tie.id] + 1.0
    # Where no ray is used, the wrong one is farther off than its distance from where all meet.
    contradicted = [tie for tie in wrong_ties if tie.any_ray]
    assert contradicted
    for tie in contradicted:
        assert "off by more" in reason_of(tie)
        assert true_error[tie.id] > 0.9 * tie.error


def test_the_first_screen_says_what_a_distance_does_not() -> None:
    """The images of a tie that none of them uses contradict one another; which errs is unknown."""
    simulated = simulate_block(3, rpcs=True, control=(6, 6), wrong=0.05, seed=1)
    record = record_of(adjust(simulated.block))
    ties = [WrongTie("T1", "A", 40.0), WrongTie("T2", "A", 12.0, any_ray=True),
            WrongTie("T2", "B", 11.5, any_ray=True), WrongTie("T1", "C", 9.0)]
    screen = " ".join(first_screen(msgspec.structs.replace(record, wrong_ties=ties), "o").split())
    assert ("4 tie observations rejected: T1 in A 40.0 px, T2 in A or B 12.0 px or more, "
            "T1 in C 9.0 px Saved") in screen
    # However near its rays come: no image uses it.
    near = WrongTie("T3", "B", 0.1, any_ray=True)
    assert "off by more" in reason_of(near)
