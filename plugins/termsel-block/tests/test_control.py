"""Control that is a blunder, and how probable control is by all other measurements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("termsel_block", reason="termsel-block is not installed: "
                    "pip install -e plugins/termsel-block")

from termsel_block.block import Block
from termsel_block.estimation import adjustment
from termsel_block.estimation.steps import Steps, shrinkage_of_mean_square, soft_weights
from termsel_block.geometry.frame import BoolArray
from termsel_block.joint import adjust
from termsel_block.shown.record import record_of
from termsel_block.simulated import simulate_block


def with_blunder(block: Block, row: int, by: tuple[float, float]) -> tuple[Block, str]:
    """Return the block with one point of its first image moved, and the point's id."""
    image = block.images[0]
    assert image.features is not None
    points = image.features.points
    place = points.image.copy()
    place[row] += by
    features = replace(image.features, points=replace(points, image=place))
    return replace(block, images=(replace(image, features=features), *block.images[1:])), (
        points.ids[row])


@pytest.mark.parametrize("by", [(5.0, 0.0), (-3.0, 4.0)])
def test_a_blunder_among_three_and_three_points_is_named(by: tuple[float, float]) -> None:
    """Of 12 standard deviations, where few points tell how large these are."""
    block, name = with_blunder(simulate_block(
        3, n_ties=60, rpcs=True, control=(3, 3), seed=1, independent=4).block, 1, by)
    assert [(one.id, one.image) for one in record_of(adjust(block)).wrong_control] == [
        (name, "I1")]


@pytest.mark.parametrize("seed", [0, 3])
def test_a_block_is_adjusted_again_only_if_the_use_of_a_measurement_changed(
        seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tie of which one image alone agrees is used in none, again and again."""
    judge = adjustment._Run.judge_measurements
    changes = []

    def compare(run: adjustment._Run) -> bool:
        before = [*run.state.in_use, *run.state.control_in_use]
        told = judge(run)
        after = [*run.state.in_use, *run.state.control_in_use]
        assert told == any((old != new).any() for old, new in zip(before, after, strict=True))
        changes.append(told)
        return told

    monkeypatch.setattr(adjustment._Run, "judge_measurements", compare)
    adjust(simulate_block(3, n_ties=60, rpcs=True, control=(5, 4), wrong=0.1, seed=seed,
                          independent=2).block)
    assert changes[0]
    assert not changes[-1]


def solved_without(run: Steps, i: int, at: BoolArray) -> float:
    """Return the density of a feature by equations that it is not in."""
    used, known = run.state.control_in_use[i], run.control[i]
    run.state.control_in_use[i] = used & ~at
    solved = run.linearised(run.state.variances)
    run.state.control_in_use[i] = used
    rows = run._control_rows(i, run.state.cameras[i], known)
    away = run._control_residuals(i, run.state.cameras[i], known)
    away = (away - rows @ solved.steps[i])[at]
    spread = rows[at] @ solved.image_covariances[i] @ rows[at].T + np.diag(
        (run.state.sigma_control * known.sigma[at])**2)
    good = np.exp(-away @ np.linalg.inv(spread) @ away / 2) / (
        2 * np.pi * np.sqrt(np.linalg.det(spread)))
    return float(np.log(0.95 * good + 0.05 / 100.0**2))


def test_the_score_is_that_of_blocks_without_each_feature(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """Also of one that was left out, in whose equations it has no part."""
    block, wrong = with_blunder(simulate_block(
        3, n_ties=40, rpcs=True, control=(5, 4), seed=3, independent=4).block, 2, (30.0, 0.0))
    compared = []

    def compare(run: adjustment._Run) -> bool:
        scores = run.score_of_control()
        for i, name in scores:
            at = np.array([one == name for one in run.control[i].feature])
            # The equations are of a standard deviation that is estimated after them.
            run.state.sigma_control = float(run.noise[i][0] / run.control[i].sigma[0])
            compared.append((i, name, scores[i, name], solved_without(run, i, at)))
        return False

    monkeypatch.setattr(adjustment._Run, "loosen", compare)
    adjust(block)
    assert len(compared) == 9
    assert compared[2][1] == wrong
    assert compared[2][2] == pytest.approx(np.log(0.05 / 100.0**2), abs=1e-6)
    np.testing.assert_allclose([one[2] for one in compared], [one[3] for one in compared],
                               atol=0.01)


def test_control_that_its_image_follows_is_not_judged(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """A lone point tells its image's shift, so that nothing else predicts it."""
    scores = []

    def score(run: adjustment._Run) -> bool:
        scores.append(run.score_of_control())
        return False

    monkeypatch.setattr(adjustment._Run, "loosen", score)
    adjust(simulate_block(2, n_ties=30, rpcs=True, control=(1,), seed=2, independent=4).block)
    assert scores == [{}]


@pytest.mark.parametrize("axes", [1, 2])
@pytest.mark.parametrize("share", [0.3, 1.0])
def test_weights_that_fall_make_squares_so_much_less(share: float, axes: int) -> None:
    residual = np.sqrt(share) * np.random.default_rng(0).standard_normal((400_000, axes))
    square = (residual**2).sum(axis=1)
    weight = soft_weights(np.sqrt(square))
    simulated = (weight @ square) / (axes * weight.sum()) / share
    assert shrinkage_of_mean_square(share, axes) == pytest.approx(simulated, rel=0.01)
