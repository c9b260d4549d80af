"""Criteria without check points: against explicit refits, brute force, and from end to end."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import termsel
from termsel.adjustment.equations import Equations
from termsel.adjustment.leave_out import leave_one_out
from termsel.data.features import FeatureSet, Points, empty_lines, empty_points
from termsel.data.scaling import make_scaling
from termsel.fitting.population import Fits
from termsel.formats.readers.csv_tables import write_points_csv
from termsel.models.base import SensorModel
from termsel.models.polynomial import Polynomial3D
from termsel.models.quotient import RationalModel
from termsel.selection.criteria import CheckRmse, Ebic, KFold, Press
from termsel.selection.problems.base import WORST, ProblemData
from termsel.selection.problems.selection import SelectionProblem
from termsel.selection.solvers.proofs.exact import gap_to_optimum
from termsel.selection.solvers.proofs.proof import count, prove
from termsel.simulate import simulate_scene
from tests.criteria_cases import (
    CASES,
    CRITERIA,
    Opaque,
    Spreading,
    problem_of,
    refitted,
    selections,
    solution,
)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("criterion", ["press", "kfold"])
def test_left_out_features_against_refits(case: str, criterion: str) -> None:
    name, given = CASES[case]
    problem = problem_of(name, criterion, **given)
    genes = selections(problem, 3 if "lines" in case else 8)
    control = problem.inputs.control
    folds = ([np.array([i]) for i in range(len(control))] if criterion == "press"
             else list(KFold().folds(control.points, control.lines)))
    expected = [refitted(problem, one, folds) for one in genes]
    assert problem.evaluate(genes).objectives[:, 0] == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("model", [Spreading(degree=1), Opaque()])
def test_models_that_are_no_plain_quotients(model: SensorModel) -> None:
    control = simulate_scene("ikonos-hamedan").with_(lines=empty_lines())
    scaling = make_scaling(control)
    features = scaling.features(control)
    for criterion in (Press(), KFold(folds=4)):
        problem = SelectionProblem(ProblemData(model, features, empty_points(), scaling.image_scale,
                                          criterion), terms=True, features=False)
        genes = selections(problem, 4)
        folds = ([np.array([i]) for i in range(len(control))] if isinstance(criterion, Press)
                 else list(criterion.folds(features.points, empty_lines())))
        assert problem.evaluate(genes).objectives[:, 0] == pytest.approx(
            [refitted(problem, one, folds) for one in genes], rel=1e-9)


def weighted() -> FeatureSet:
    """Return a scene with points of different accuracy."""
    features = simulate_scene("ikonos-hamedan")
    points = features.points
    sigma = np.random.default_rng(2).uniform(0.3, 3.0, (len(points), 2))
    return features.with_(points=Points(points.ids, points.image, points.ground, sigma,
                                        points.roles))


def test_weights_count_in_the_fit_and_not_in_the_error() -> None:
    problem = problem_of("rfm-terms", "press", features=weighted())
    genes = selections(problem, 4)
    folds = [np.array([i]) for i in range(len(problem.inputs.control))]
    assert problem.evaluate(genes).objectives[:, 0] == pytest.approx(
        [refitted(problem, one, folds) for one in genes], rel=1e-7)


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize("name", ["rfm-terms", "owdis-lines-terms"])
def test_a_batch_is_one_by_one(criterion: str, name: str) -> None:
    if (criterion, name) == ("ebic", "owdis-lines-terms"):
        pytest.skip("ebic does not select features")
    problem = problem_of(name, criterion)
    genes = np.concatenate([selections(problem, 5), np.zeros((2, problem.genome.size), bool),
                            np.ones((1, problem.genome.size), bool)])
    together = problem.evaluate(genes)
    alone = [problem.evaluate(one[None]) for one in genes]
    assert together.objectives[:, 0] == pytest.approx([e.objectives[0, 0] for e in alone])
    assert together.violation == pytest.approx([e.violation[0] for e in alone])


@pytest.mark.parametrize("weight", [0.0, 0.5])
def test_leaving_out_blocks_of_any_height(weight: float) -> None:
    rng = np.random.default_rng(5)
    feature = rng.permutation(np.repeat(np.arange(9), [1, 2, 3, 1, 2, 4, 1, 2, 2]))
    prior = weight * np.array([1.0, 0.0, 1.0, 2.0, 0.0, 1.0])
    equations = Equations(rng.normal(size=(18, 6)), rng.normal(size=18), feature, prior)
    terms = rng.random((20, 6)) < 0.6
    used = rng.random((20, 9)) < 0.9
    solutions, determined = leave_one_out(equations, terms, used)
    assert determined.any()
    for p in range(20):  # one alone is solved by another way
        alone, known = leave_one_out(equations, terms[p:p + 1], used[p:p + 1])
        assert known.tolist() == [determined[p]]
        if determined[p]:
            assert alone[:, 0] == pytest.approx(solutions[:, p], abs=1e-9)
    for p, f in itertools.product(np.flatnonzero(determined), range(9)):
        if used[p, f]:
            rows = used[p][feature] & (feature != f)
            x = np.zeros(6)
            A = np.concatenate([equations.A[rows], np.diag(prior)])[:, terms[p]]
            b = np.concatenate([equations.b[rows], np.zeros(6)])
            x[terms[p]] = np.linalg.lstsq(A, b, rcond=None)[0]
            assert solutions[f, p] == pytest.approx(x, abs=1e-9)


@pytest.mark.parametrize(("left", "determined"), [(3e-5, False), (3e-4, True)])
def test_a_feature_that_alone_tells_a_term_but_for_rounding_is_indispensable(
        left: float, determined: bool) -> None:
    # The first row has a leverage of 1 - left^2, and the bound on what is left is 1e-8.
    A = np.ones((8, 2))
    A[:, 1] = [1.0, *(left / np.sqrt(6) * np.resize([1.0, -1.0], 6)), 0.0]
    A[:, 0] = [0.0, *np.ones(7)]
    equations = Equations(A, np.arange(8.0), np.arange(8), np.zeros(2))
    for many in (1, 2):  # one alone is solved by another way
        found = leave_one_out(equations, np.ones((many, 2), dtype=bool),
                              np.ones((many, 8), dtype=bool))[1]
        assert found.tolist() == [determined] * many


def test_an_indispensable_feature_makes_a_selection_infeasible() -> None:
    rng = np.random.default_rng(3)
    ground = rng.uniform(-1, 1, (12, 3))
    ground[1:, 2] = 0.25  # one point alone has another height
    points = Points(tuple(f"p{i}" for i in range(12)), ground[:, :2] + 0.1 * ground[:, 2:], ground)
    for criterion in (Press(), KFold()):
        problem = SelectionProblem(
            ProblemData(
                Polynomial3D(degree=1), FeatureSet(points), empty_points(), 1000.0, criterion),
            terms=True, features=False)
        names = np.array([name.split(":")[1] for name in problem.inputs.model.terms])
        evaluation = problem.evaluate(np.array([names != "", names != "Z"]))
        assert evaluation.violation.tolist() == [1.0, 0.0]
        assert evaluation.objectives[0, 0] == WORST
        assert evaluation.objectives[1, 0] < 1e3


@pytest.mark.parametrize("how", ["spatial", "random"])
def test_folds_partition_the_control(how: str) -> None:
    features = simulate_scene("ikonos-hamedan")
    points, lines = features.points, features.lines
    n = len(features)
    folds = KFold(folds=7, repeats=3, how=how).folds(points, lines)
    assert len(folds) == 21
    for repeat in range(3):
        seven = folds[7 * repeat:7 * repeat + 7]
        assert sorted(np.concatenate(seven)) == list(range(n))
        assert {len(fold) for fold in seven} == {n // 7, n // 7 + 1}
    different = {tuple(map(tuple, folds[7 * r:7 * r + 7])) for r in range(3)}
    assert len(different) == 3
    xy = np.concatenate([points.ground, lines.ground.mean(axis=1)])[:, :2]
    inner = np.mean([xy[fold].std(axis=0).mean() for fold in folds])
    assert (inner < 0.6 * xy.std(axis=0).mean()) == (how == "spatial")
    again = KFold(folds=7, repeats=3, how=how).folds(points, lines)
    assert all(np.array_equal(a, b) for a, b in zip(folds, again, strict=True))
    assert len(KFold(folds=500).folds(points, lines)) == n


def test_random_folds_follow_their_seed() -> None:
    points = simulate_scene("ikonos-hamedan").points
    first, second = (KFold(how="random", fold_seed=seed).folds(points, empty_lines())
                     for seed in (1, 2))
    assert not np.array_equal(first[0], second[0])


def test_as_many_folds_as_points_are_press() -> None:
    press = problem_of("rfm-terms", "press")
    kfold = problem_of("rfm-terms", "kfold", options={"folds": 1000})
    genes = selections(press, 6)
    assert kfold.evaluate(genes).objectives == pytest.approx(press.evaluate(genes).objectives)


# EBIC


def test_ebic_by_hand() -> None:
    problem = problem_of("rfm-terms", "ebic", options={"gamma": 0.5})
    control = problem.inputs.control
    n, axis = len(control), problem.inputs.model.axis
    for genes in selections(problem, 5):
        terms = problem.masks(genes[None])[0][0]
        x = solution(problem, terms, np.ones(n, dtype=bool))
        v = (problem.equations.b - problem.equations.A @ x).reshape(-1, 2)
        expected = 0.0
        for side in (0, 1):
            k = int(terms[axis == side].sum())
            expected += (n * math.log((v[:, side]**2).sum() / n) + k * math.log(n)
                         + 2 * 0.5 * math.log(math.comb(39, min(k, 19))))
        assert problem.evaluate(genes[None]).objectives[0, 0] == pytest.approx(expected, rel=1e-9)


def test_ebic_of_terms_chosen_together_is_of_one_system() -> None:
    problem = problem_of("poly-terms", "ebic", options={"degree": 3, "mask": "shared"})
    n = len(problem.inputs.control)
    for genes in selections(problem, 5):
        terms = problem.masks(genes[None])[0][0]
        x = solution(problem, terms, np.ones(n, dtype=bool))
        v = problem.equations.b - problem.equations.A @ x
        k = int(genes.sum())
        expected = (2 * n * math.log(v @ v / (2 * n)) + 2 * k * math.log(2 * n)
                    + 2 * math.log(math.comb(10, min(k, 5))))
        assert problem.evaluate(genes[None]).objectives[0, 0] == pytest.approx(expected, rel=1e-9)


def test_ebic_costs_more_the_more_terms_there_are() -> None:
    """All of ten terms are one selection, which is no reason to take them all."""
    problem = problem_of("poly-terms", "ebic", options={"degree": 2})
    size = problem.genome.size // 2
    genes = np.zeros((size, 2 * size), dtype=bool)
    for used in range(1, size + 1):
        genes[used - 1, :used] = genes[used - 1, size:size + used] = True
    judged = problem.evaluate(genes)
    n = len(problem.inputs.control)
    v = np.array([problem.equations.b - problem.equations.A @ solution(
        problem, problem.masks(one[None])[0][0], np.ones(n, dtype=bool)) for one in genes])
    fit = sum(n * np.log((v[:, side::2]**2).sum(axis=1) / n) for side in (0, 1))
    penalty = judged.objectives[:, 0] - fit
    assert (np.diff(penalty) > 0).all()


def test_ebic_demands_redundancy() -> None:
    genes = np.zeros((1, 78), dtype=bool)
    genes[0, :9] = genes[0, 39:40] = True  # nine terms for the line, one for the sample
    n = len(problem_of("rfm-terms", "ebic").inputs.control)
    for least, violation in ((n - 9, 0.0), (n - 8, 1.0)):
        problem = problem_of("rfm-terms", "ebic", options={"min_redundancy": least})
        assert problem.evaluate(genes).violation[0] == violation


@pytest.mark.slow
def test_ebic_counts_only_terms_that_may_be_chosen() -> None:
    # One term forced on, two never: 2 of the other 7 are chosen, not 3 of 10.
    names = [str(term) for term in termsel.Polynomial3D(degree=2).terms]
    forced = {"model": "poly3d", "options": {"degree": 2, "force_on": names[0],
                                             "force_off": f"{names[8]},{names[9]}"}}
    some = termsel.prepare("poly-terms", criterion="ebic", solver="exact", **forced).problem
    every = termsel.prepare("poly-terms", criterion="ebic", model="poly3d",
                            options={"degree": 2}).problem
    genes = np.zeros((1, every.genome.size), dtype=bool)
    genes[0, [0, 1, 2, 10, 11, 12]] = True
    counted = [problem.evaluate(genes).objectives[0, 0] for problem in (some, every)]
    gain = 2 * (math.log(math.comb(10, 3)) - math.log(math.comb(7, 2)))
    assert counted[1] - counted[0] == pytest.approx(gain)
    *_, proof = prove(some)
    cost = sum(float(one.min()) for one in proof._costs())
    assert some.evaluate(proof.front()[-1][None]).objectives[0, 0] == pytest.approx(cost)


def test_ebic_of_a_perfect_fit_prefers_fewer_terms() -> None:
    rng = np.random.default_rng(4)
    ground = rng.uniform(-1, 1, (40, 3))
    points = Points(tuple(f"p{i}" for i in range(40)),
                    ground[:, :2] * 0.5 + 0.1 * ground[:, 2:], ground)
    problem = SelectionProblem(ProblemData(Polynomial3D(degree=2), FeatureSet(points),
                                           empty_points(),
                                      1000.0, Ebic()), terms=True, features=False)
    names = [name.split(":")[1] for name in problem.inputs.model.terms]
    affine = np.array([name in ("1", "X", "Y", "Z") for name in names])
    more = affine | np.array([name == "X2" for name in names])
    few, many = problem.evaluate(np.array([affine, more])).objectives[:, 0]
    assert np.isfinite(few)
    assert few < many


def test_ebic_refuses_to_select_features() -> None:
    with pytest.raises(termsel.TermselError, match="same observations"):
        termsel.run("owdis-points", criterion="ebic", generations=1)


# The proven optimum

SPACES = {
    "per axis": ("poly-terms", {"degree": 2}),
    "shared": ("poly-terms", {"degree": 3, "mask": "shared"}),
    "rational": ("rfm-terms", {"order": 1}),
}
OPTIONS = {"press": {}, "kfold": {"folds": 4, "repeats": 2}, "ebic": {"gamma": 0.7}}


@pytest.mark.parametrize("space", SPACES)
@pytest.mark.parametrize("criterion", CRITERIA)
def test_exact_finds_what_brute_force_finds(criterion: str, space: str) -> None:
    name, options = SPACES[space]
    task = termsel.prepare(name, criterion=criterion, solver="exact",
                           options={**options, **OPTIONS[criterion]})
    problem = task.problem
    genes = np.array(list(itertools.product([False, True], repeat=problem.genome.size)))
    evaluation = problem.evaluate(genes)
    objectives = np.where(evaluation.violation == 0, evaluation.objectives[:, 0], np.inf)
    *_, proof = prove(problem)
    assert proof.decided == count(problem)
    front = np.array(proof.front())
    values = problem.evaluate(front)
    assert (values.violation == 0).all()
    assert values.objectives[-1, 0] == pytest.approx(objectives.min(), rel=1e-9)
    # The front is the best of every size that beats all smaller ones.
    size = genes.sum(axis=1)
    best, expected = np.inf, {}
    for k in range(problem.genome.size + 1):
        least = objectives[size == k].min(initial=np.inf)
        if np.isfinite(least) and not least >= best - 1e-9 * abs(least):
            expected[k] = best = least
    found = dict(zip(front.sum(axis=1).tolist(), values.objectives[:, 0].tolist(), strict=True))
    assert found == pytest.approx(expected, rel=1e-9)
    assert gap_to_optimum(problem, float(objectives.min()))["optimal"]
    assert not gap_to_optimum(problem, float(np.sort(objectives)[5]))["optimal"]


@pytest.mark.parametrize("criterion", ["press", "kfold"])
def test_weighted_rows_are_not_enumerated(criterion: str) -> None:
    with pytest.raises(termsel.TermselError, match="standard deviations weight the rows"):
        problem_of("poly-terms", criterion, features=weighted()).parts()
    assert problem_of("poly-terms", "ebic", features=weighted()).parts()


def test_a_spreading_model_is_not_enumerated() -> None:
    features = simulate_scene("ikonos-hamedan").with_(lines=empty_lines())
    scaling = make_scaling(features)
    problem = SelectionProblem(
        ProblemData(Spreading(degree=1), scaling.features(features), empty_points(),
                    scaling.image_scale, Press()), terms=True, features=False)
    with pytest.raises(termsel.TermselError, match="corrects its predictions by the control"):
        problem.parts()


# From end to end


def without_check() -> FeatureSet:
    """Return a scene whose points are control and independent points alone."""
    features = simulate_scene("ikonos-hamedan")
    points = features.points
    roles = tuple("control" if role == "check" else role for role in points.roles)
    return features.with_(points=Points(points.ids, points.image, points.ground, None, roles))


@pytest.mark.slow
@pytest.mark.parametrize("criterion", CRITERIA)
def test_control_and_check_points_are_used_together(criterion: str) -> None:
    given = {"criterion": criterion, "generations": 6}
    options = {"population": 60, "polish": False}
    results = [termsel.run("rfm-terms", features=features, options=options, **given)
               for features in (None, without_check())]
    for result in results:
        assert result.feasible
        assert result.criterion == criterion
        assert set(result.objectives) == {criterion}
        assert result.rmse["independent"].total < 20
        assert result.rmse["check"] is None
        assert json.loads(result.to_json())["rmse"]["check"]["total"] is None
        assert "independent check points" in result.judgement
        assert "48 control points, no selection points" in result.summary(verbose=True).lower()
        assert result.options.data["check_as"] == "control"
    # The points come in another order, of which the folds and rounding take notice.
    assert set(results[0].fit.control.ids) == set(results[1].fit.control.ids)
    apart = termsel.run("rfm-terms", options={**options, "check_as": "judge"}, **given)
    assert apart.rmse["check"].n == apart.rmse["control"].n == 24


def test_check_points_next_to_lines_alone_stay_apart() -> None:
    task = termsel.prepare("owdis-lines", criterion="press")
    assert task.options["data"]["check_as"] == "judge"
    assert len(task.observations.check) == 24
    mixed = termsel.prepare("owdis-lines", criterion="press", options={"mixed": True})
    assert len(mixed.observations.control.points) == 48
    with pytest.raises(termsel.TermselError, match="no selection points"):
        termsel.prepare("rfm-terms", options={"check_as": "control"})


@pytest.mark.slow
def test_lines_alone_need_no_check_points() -> None:
    scene = simulate_scene("ikonos-hamedan")
    points = scene.points.take([role == "independent" for role in scene.points.roles])
    result = termsel.run("owdis-lines", criterion="press", features=scene.with_(points=points),
                         generations=3, options={"population": 20, "polish": False})
    assert result.feasible
    assert result.rmse["check"] is None
    assert result.rmse["independent"].n == len(points)


def test_check_rmse_still_asks_for_check_points() -> None:
    assert CheckRmse.needs_check
    with pytest.raises(termsel.TermselError, match="check-rmse chooses by at least 2") as bad:
        termsel.run("rfm-terms", features=without_check(), strategy="as-asked")
    assert "press" in bad.value.hint


def test_command_line(tmp_path: Path, call: Callable[..., SimpleNamespace]) -> None:
    write_points_csv(without_check().points, tmp_path / "points.csv")
    done = call("run", "--problem", "rfm-terms", "--points", tmp_path / "points.csv", "--crs",
                "EPSG:4979", "--criterion", "kfold", "--set", "folds=4", "--set", "how=random",
                "--set", "population=20", "--set", "polish=false", "--generations", "2", "--json")
    assert done.exit_code == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["options"]["criterion"] == {"folds": 4, "repeats": 1, "how": "random",
                                              "fold_seed": 0, "loss": "squares",
                                              "threshold": 2.0}
    assert result["objectives"]["kfold"] > 0
    assert result["data"]["counts"]["check"] == 0


def test_fits_without_the_optional_parts_serve_the_check_rmse() -> None:
    problem = problem_of("poly-terms", "check-rmse")
    inputs = problem.inputs
    assert isinstance(inputs.model, RationalModel)
    terms = np.ones((1, len(inputs.model.terms)), dtype=bool)
    x = solution(problem, terms[0], np.ones(len(inputs.control), dtype=bool))[None]
    fits = Fits(inputs.model, inputs.control.points, inputs.check, inputs.pixels, terms, x)
    assert CheckRmse().score(fits)[0] == pytest.approx(
        problem.evaluate(np.ones((1, problem.genome.size), dtype=bool)).objectives[0, 0])
