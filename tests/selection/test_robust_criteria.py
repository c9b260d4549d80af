"""Criteria that withstand blunders among check points and in the control."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import termsel
from termsel.fitting.losses import rmse_like_figure
from termsel.selection.criteria import Huber, KFold, Median, Press
from termsel.simulate import simulate_scene
from tests.criteria_cases import (
    CASES,
    errors_of,
    problem_of,
    selections,
    solution,
)


@pytest.mark.slow
@pytest.mark.parametrize("criterion", ["median", "huber"])
def test_robust_criteria_withstand_blunders_in_check_points(criterion: str) -> None:
    scene = simulate_scene("ikonos-hamedan", n_lines=0)
    roles = np.array(scene.points.roles)
    image = scene.points.image.copy()
    wrong = np.flatnonzero(roles == "check")[:5]
    image[wrong] += np.random.default_rng(1).uniform(-300, 300, (5, 2))
    spoilt = scene.with_(points=replace(scene.points, image=image))
    given = {"model": "poly3d", "options": {"degree": 2, "population": 60}, "generations": 15}
    found = {name: termsel.run("rfm-terms", features=spoilt, criterion=name, **given)
             .rmse["independent"].total for name in (criterion, "check-rmse")}
    assert found[criterion] < found["check-rmse"]
    assert found[criterion] < 1.5


def test_robust_criteria_are_rmse_for_normal_errors() -> None:
    class Errors:
        check_errors = np.random.default_rng(0).normal(0, 0.5, (2, 200_000, 2))

    rmse = np.sqrt((Errors.check_errors**2).sum(axis=2).mean(axis=1))
    np.testing.assert_allclose(Median().score(Errors), rmse, rtol=0.01)
    np.testing.assert_allclose(Huber().score(Errors), rmse, rtol=0.06)
    distances = np.hypot(*np.moveaxis(Errors.check_errors, -1, 0))
    for threshold in (0.5, 3.0):
        np.testing.assert_allclose(Huber(threshold=threshold).score(Errors), rmse_like_figure(
            distances, np.ones_like(distances), "huber", threshold))


@pytest.mark.parametrize("loss", ["squares", "huber", "median"])
def test_a_figure_by_hand(loss: str) -> None:
    rng = np.random.default_rng(2)
    d = rng.exponential(1.0, (6, 9))
    used = rng.random((6, 9)) < 0.7
    used[4], used[5] = False, True
    d[0, np.flatnonzero(~used[0])[0]] = np.inf  # that is not in use
    d[5, 3] = np.inf
    weights = used * rng.integers(1, 4, 9)
    found = rmse_like_figure(d, weights, loss, 1.5)
    assert np.isinf(found[4:]).all()
    for got, errors, weight in zip(found[:4], d, weights, strict=False):
        e, w = errors[weight > 0], weight[weight > 0]
        c = 1.5 * np.median(e)
        rho = {"squares": e**2, "huber": np.where(e <= c, e**2, 2 * c * e - c**2),
               "median": np.full(len(e), np.median(e) ** 2 / np.log(2))}[loss]
        assert got == pytest.approx(np.sqrt(np.average(rho, weights=w)))


@pytest.mark.parametrize("criterion", ["press", "kfold"])
@pytest.mark.parametrize("loss", ["huber", "median"])
@pytest.mark.parametrize("case", ["points, rational", "lines and terms, rational"])
def test_robust_figures_of_features_left_out(criterion: str, loss: str, case: str) -> None:
    name, given = CASES[case]
    problem = problem_of(name, criterion, **given)
    control = problem.inputs.control
    genes = selections(problem, 3)
    folds = ([np.array([i]) for i in range(len(control))] if criterion == "press"
             else list(KFold().folds(control.points, control.lines)))
    robust = problem.judged_by({"press": Press, "kfold": KFold}[criterion](loss=loss))
    n, ends = len(control.points), 2
    for one, value in zip(genes, robust.evaluate(genes).objectives[:, 0], strict=True):
        terms, features = (None if mask is None else mask[0] for mask in problem.masks(one[None]))
        used = np.ones(len(control), dtype=bool) if features is None else features
        squares, weights = np.zeros((1, len(used))), np.zeros((1, len(used)))
        for fold in folds:
            rest = used.copy()
            rest[fold] = False
            x = solution(problem, terms, rest)
            for i in fold[used[fold]]:
                weights[0, i] = 1 if i < n else ends
                squares[0, i] = (errors_of(problem, x, np.array([i])) ** 2).sum() / weights[0, i]
        assert value == pytest.approx(
            rmse_like_figure(np.sqrt(squares), weights, loss)[0], rel=1e-7)


def test_robust_losses_cannot_be_walked_and_have_no_standard_error() -> None:
    with pytest.raises(termsel.TermselError, match="is no sum over"):
        termsel.run("poly-terms", criterion="press", solver="exact", options={"loss": "huber"})
    with pytest.raises(termsel.TermselError, match="no standard error"):
        termsel.prepare("poly-terms", criterion="kfold", solver="nsga2",
                        options={"loss": "median", "recommend": "one-standard-error"})
    task = termsel.prepare("poly-terms", criterion="kfold", solver="nsga2",
                           options={"loss": "median"})
    assert task.options["problem"]["recommend"] == "best"


def test_huber_of_features_held_out_withstands_blunders_in_control() -> None:
    scene = simulate_scene("ikonos-hamedan", n_lines=0, n_points=120)
    image = scene.points.image.copy()
    rng = np.random.default_rng(3)
    roles = np.array(["control"] * 60 + ["independent"] * 60)
    wrong = rng.permutation(60)[:4]
    image[wrong] += rng.uniform(-40, 40, (4, 2))
    spoilt = scene.with_(points=replace(scene.points, image=image, roles=tuple(roles)))
    given = {"model": "poly3d", "options": {"degree": 3}, "solver": "all-terms"}
    task = termsel.prepare("rfm-terms", features=spoilt, criterion="press", **given)
    every = np.ones((1, task.problem.genome.size), dtype=bool)
    figures = {loss: task.problem.judged_by(Press(loss=loss)).evaluate(every).objectives[0, 0]
               for loss in ("squares", "huber", "median")}
    assert figures["median"] < figures["huber"] < 0.8 * figures["squares"]
