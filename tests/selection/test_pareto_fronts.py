"""Several objectives: fronts, what is recommended from them, and who can search them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymoo.algorithms.moo.age2 import AGEMOEA2Survival
from scipy.spatial import ConvexHull, QhullError

import termsel
from termsel.adjustment.leave_out import independent_parts
from termsel.data.features import FeatureSet, Points
from termsel.runs.recommend import with_recommended_member
from termsel.selection.problems.coverage import hull_areas, uncovered_share
from termsel.selection.problems.objectives import (
    PopulationSelection,
    max_correlation,
    uncovered,
    unevenness,
)
from termsel.selection.solvers.search import SearchResult
from termsel_optimisers.survivals import _AgeSurvival

SOLVERS = ("nsga2", "age-moea2", "sms-emoa", "spea2")


@pytest.mark.slow_cases("age-moea2")
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_front_has_neither_dominated_members_nor_duplicates(solver: str) -> None:
    result = termsel.run("poly-terms", solver=solver, evaluations=800,
                         options={"degree": 4, "population": 40})
    points = np.array([[m.objectives["check-rmse"], m.objectives["n_terms"]]
                       for m in result.front])
    assert len(np.unique(points, axis=0)) == len(points) > 3
    for point in points:
        others = (points <= point).all(axis=1) & (points < point).any(axis=1)
        assert not others.any()
    for member in result.front:
        assert member.rmse.check.total == pytest.approx(
            member.objectives["check-rmse"], rel=1e-6)
        assert member.rmse.independent.n == 26
        assert member.selection.n_terms == member.objectives["n_terms"]


@pytest.mark.slow
def test_nsga2_lies_on_the_exact_front_of_the_21_term_problem() -> None:
    exact = termsel.run("poly-terms", solver="exact", options={"degree": 5})
    best = {m.objectives["n_terms"]: m.objectives["check-rmse"] for m in exact.front}
    result = termsel.run("poly-terms", solver="nsga2", evaluations=80_000,
                         options={"degree": 5, "polish": True})
    on = [m.objectives["check-rmse"] == pytest.approx(best.get(m.objectives["n_terms"], 0))
          for m in result.front]
    assert np.mean(on) >= 0.9


def two(n: int = 4) -> tuple[termsel.Task, SearchResult]:
    task = termsel.prepare("poly-terms", solver="nsga2", options={"degree": 4})
    return task, termsel.search(task.problem, task.solver, generations=n)


def test_the_rules_recommend_what_they_say() -> None:
    task, found = two()
    evaluation = task.problem.evaluate(np.array(found.front))
    first, second = evaluation.objectives.T
    assert (np.diff(first) > 0).all()
    assert (np.diff(second) < 0).all()
    chosen = {}
    for rule in ("best", "knee", "one-standard-error"):
        task.options["problem"]["recommend"] = rule
        chosen[rule] = with_recommended_member(task, found).objectives
    assert chosen["best"][0] == first.min()
    bound = first.min() * (1 + 1 / np.sqrt(4 * 24))
    assert chosen["one-standard-error"][0] <= bound
    assert (second[first <= bound] >= chosen["one-standard-error"][1]).all()
    assert chosen["knee"][1] < chosen["best"][1]


def test_the_least_ebic_of_a_front() -> None:
    given = {"degree": 5, "max_share": 1, "recommend": "ebic"}
    task = termsel.prepare("poly-terms", solver="nsga2", options=given)
    found = termsel.search(task.problem, task.solver, generations=4)
    # Two with 21 of 24 equations in terms, too many for the criterion, whatever they are worth.
    rich = tuple(np.arange(42) != left_out for left_out in (20, 41))
    front = (*rich, *found.front)
    figures = termsel.prepare("poly-terms", criterion="ebic", options={
        "degree": 5, "max_share": 1, "check_as": "judge"}).problem.evaluate(np.array(front))
    assert (figures.violation[:2] > 0).all()
    best = np.where(figures.violation > 0, np.inf, figures.objectives[:, 0]).argmin()
    assert best >= 2
    of_front = SearchResult(**{**vars(found), "front": front})
    assert (with_recommended_member(task, of_front).genes == front[best]).all()
    # Without any member of enough redundancy it is the best criterion.
    first = task.problem.evaluate(np.array(rich)).objectives[:, 0].argmin()
    crowded = SearchResult(**{**vars(found), "front": rich})
    assert (with_recommended_member(task, crowded).genes == rich[first]).all()


@pytest.mark.slow
def test_the_proven_front_is_recommended_from_where_a_rule_is_given() -> None:
    given = {"solver": "exact", "model": "poly2d"}
    best = termsel.run("rfm-terms", options={"degree": 4}, **given)
    assert best.certificate.optimal
    assert best.options.problem["recommend"] == "best"
    for rule in ("one-standard-error", "knee", "ebic"):
        found = termsel.run("rfm-terms", options={"degree": 4, "recommend": rule}, **given)
        assert found.front == best.front
        assert len(found.selection.terms) < len(best.selection.terms)
        assert not found.certificate.optimal
        assert found.certificate.gap == pytest.approx(
            found.objectives["check-rmse"] / best.objectives["check-rmse"] - 1)
        text = found.summary(verbose=True)
        assert f"recommended by the rule {rule}" in text
        assert "above the proven optimum" in text
        assert "--set recommend=best finds it" in text


def test_rules_that_cannot_be() -> None:
    with pytest.raises(termsel.TermselError, match="no standard error"):
        termsel.run("poly-terms", criterion="ebic", solver="nsga2",
                    options={"recommend": "one-standard-error"})
    with pytest.raises(termsel.TermselError, match="option 'recommend' does not accept 'ebic'"):
        termsel.run("owdis-points", solver="nsga2", options={"recommend": "ebic"})
    found = termsel.run("poly-terms", solver="ga", evaluations=50, options={"recommend": "knee"})
    assert any("no front" in note for note in found.notes)


def test_a_front_of_one_member_is_recommended() -> None:
    task, found = two()
    alone = SearchResult(**{**vars(found), "front": found.front[:1]})
    task.options["problem"]["recommend"] = "knee"
    assert (with_recommended_member(task, alone).genes == found.front[0]).all()


def test_a_solver_for_one_objective_is_refused_with_those_that_can() -> None:
    with pytest.raises(termsel.TermselError, match="Choose one of: nsga2, pymoo, age-moea2"):
        termsel.run("poly-terms", solver="ga", options={"objectives": "n_terms"})


def test_unknown_objectives_are_refused() -> None:
    with pytest.raises(termsel.TermselError, match="unknown objective 'terms'"):
        termsel.run("poly-terms", solver="nsga2", options={"objectives": "terms"})


class Hopeless(termsel.Problem):
    """Nothing is feasible."""

    genome = termsel.Genome([termsel.Bits("all", tuple("abcdef"))])
    objectives = ("one", "two")

    def evaluate(self, genes: np.ndarray) -> termsel.Evaluation:
        return termsel.Evaluation(np.zeros((len(genes), 2)), genes.sum(axis=1) + 1.0)

    def decode(self, genes: np.ndarray) -> termsel.Selection:
        return termsel.Selection((), ())


@pytest.mark.parametrize("solver", SOLVERS)
def test_without_anything_feasible_the_least_violation_is_returned(solver: str) -> None:
    from termsel.plugins.registry import registry

    found = termsel.search(Hopeless(), registry().get("solvers", solver)(population=10),
                           generations=5)
    assert found.violation >= 1
    assert found.front == ()


def test_an_infeasible_result_says_so_in_words() -> None:
    features = termsel.simulate_scene("ikonos-hamedan")
    result = termsel.run("rfm-terms", solver="all-terms", features=features)
    assert not result.feasible
    assert "does not satisfy all conditions" in result.judgement


def chosen(image: np.ndarray, mask: np.ndarray) -> PopulationSelection:
    task = termsel.prepare("poly-terms", options={"degree": 1})
    control = FeatureSet(Points(tuple(f"P{i}" for i in range(len(image))), image,
                                np.column_stack([image, np.zeros(len(image))])))
    return PopulationSelection(task.problem.equations, (), control,
                               np.ones((len(mask), 6), dtype=bool), mask)


def test_uncovered_and_unevenness_of_a_square() -> None:
    square = np.array([[0.0, 0], [0, 10], [10, 0], [10, 10], [5, 5]])
    masks = np.array([[1, 1, 1, 1, 0], [1, 1, 1, 0, 0], [1, 1, 0, 0, 0], [1, 0, 0, 1, 1]], bool)
    assert uncovered(chosen(square, masks)) == pytest.approx([0.0, 0.5, 1.0, 1.0])
    assert unevenness(chosen(square, masks)) == pytest.approx([0.0, 0.0, 1.0, 0.0])


def test_max_correlation_is_that_of_numpy() -> None:
    task = termsel.prepare("rfm-terms", options={"order": 2})
    rng = np.random.default_rng(0)
    masks = rng.random((20, 38)) < 0.3
    parts = independent_parts(task.problem.equations, task.model.axis)
    got = max_correlation(PopulationSelection(
        task.problem.equations, parts, task.problem.inputs.control, masks,
        np.ones((20, 24), dtype=bool)))
    for mask, value in zip(masks, got, strict=True):
        expected = 0.0
        for part in parts:
            columns = mask[part.columns] & (np.ptp(part.equations.A, axis=0) > 0)
            correlation = np.abs(np.atleast_2d(np.corrcoef(part.equations.A[:, columns].T)))
            np.fill_diagonal(correlation, 0)
            expected = max(expected, correlation.max(initial=0))
        assert value == pytest.approx(expected, abs=1e-9)


def test_two_constants_do_not_correlate() -> None:
    task = termsel.prepare("poly-terms", options={"degree": 1})
    parts = independent_parts(task.problem.equations, task.model.axis)
    names = task.model.terms
    mask = np.array([[name.endswith(":1") for name in names]])
    assert max_correlation(PopulationSelection(
        task.problem.equations, parts, task.problem.inputs.control, mask,
        np.ones((1, 24), dtype=bool))) == 0


@pytest.mark.slow
@settings(deadline=None)  # pymoo compiles first
@given(st.integers(0, 2**32), st.sampled_from([0.5, 1.0, 1.7, 4.0]))
def test_distances_on_an_estimated_front_are_those_of_pymoo(seed: int, p: float) -> None:
    front = np.random.default_rng(seed).uniform(0.01, 1.0, (12, 2))
    assert _AgeSurvival.pairwise_distances(front, p) == pytest.approx(
        AGEMOEA2Survival.pairwise_distances(front, p))


@settings(deadline=None)
@given(st.integers(0, 2**32))
def test_hull_areas_are_those_of_qhull(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.integers(0, 6, (15, 2)).astype(float)  # with ties and collinear points
    masks = rng.random((20, 15)) < rng.random((20, 1))
    for mask, area in zip(masks, hull_areas(points, masks), strict=True):
        try:
            expected = ConvexHull(points[mask]).volume if mask.sum() > 2 else 0.0
        except QhullError:
            expected = 0.0
        assert area == pytest.approx(expected, abs=1e-9)


@pytest.mark.slow
def test_spread_as_a_constraint() -> None:
    result = termsel.run("owdis-points", solver="ga-steady", generations=20, options={
        "degree": 1, "min_features": 8, "max_features": 8, "max_uncovered": 0.3})
    task = termsel.prepare("owdis-points")
    chosen_ids = np.isin(task.observations.control.ids, result.selection.features)
    places = task.observations.control.points.image
    assert result.feasible
    assert uncovered_share(places, chosen_ids[None])[0] <= 0.3
    free = termsel.run("owdis-points", solver="ga-steady", generations=20, options={
        "degree": 1, "min_features": 8, "max_features": 8})
    chosen_ids = np.isin(task.observations.control.ids, free.selection.features)
    assert uncovered_share(places, chosen_ids[None])[0] > 0.3
