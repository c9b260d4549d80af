"""Terms that are forced, capped, or kept with their parents."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest

import termsel
from termsel.data.features import FeatureSet
from termsel.models.polynomial import Polynomial3D
from termsel.selection.problems.constraints import count_excess_terms, parent_pairs
from termsel.selection.problems.selection import SelectionProblem


def run(problem: str = "poly-terms", **options: object) -> termsel.Result:
    solver = options.pop("solver", None)
    if solver == "exact":
        return termsel.run(problem, solver="exact", options=options)
    return termsel.run(problem, solver=solver, generations=6,
                       options={"population": 40, **options})


@pytest.mark.parametrize("solver", ["ga", "exact"])
def test_forced_terms_are_in_every_selection(solver: str) -> None:
    options = {"degree": 3, "force_on": "num:1, X", "force_off": "line.num:Y2,X2Y"}
    found = run(solver=solver, **options)
    terms = set(found.selection.terms)
    assert {"line.num:1", "sample.num:1", "line.num:X", "sample.num:X"} <= terms
    assert not {"line.num:Y2", "line.num:X2Y", "sample.num:X2Y"} & terms


def test_forced_terms_of_a_mask_for_both_axes() -> None:
    found = run(degree=3, mask="shared", force_on="num:X3", force_off="Y3")
    assert {"line.num:X3", "sample.num:X3"} <= set(found.selection.terms)
    assert not {"line.num:Y3", "sample.num:Y3"} & set(found.selection.terms)


@pytest.mark.parametrize(("options", "message"), [
    ({"force_on": "W"}, "unknown term 'W'"),
    ({"force_on": "X", "force_off": "line.num:X"}, "forced both on and off"),
    ({"max_share": 2}, "0 to 1"), ({"max_share": 0.1, "force_on": "X,Y,XY"}, "forced genes"),
    ({"max_share": 0.0}, "allows no terms of line: the control gives 24 equations")])
def test_wishes_that_cannot_be_are_refused(options: dict, message: str) -> None:
    with pytest.raises(termsel.TermselError, match=message):
        run(**options)


def test_a_term_has_its_parents() -> None:
    terms = Polynomial3D(degree=3).terms
    pairs = {(terms[c], terms[p]) for c, p in zip(*parent_pairs(terms), strict=True)}
    assert ("line.num:X2Y", "line.num:XY") in pairs
    assert ("line.num:X2Y", "line.num:X2") in pairs
    assert ("line.num:X", "line.num:1") in pairs
    assert ("line.num:XYZ", "line.num:YZ") in pairs
    assert not any(child.endswith(":1") for child, _ in pairs)
    assert all(child.split(":")[0] == parent.split(":")[0] for child, parent in pairs)


def test_hierarchy_leaves_no_orphans() -> None:
    found = run("rfm-terms", hierarchy=True)
    assert found.feasible
    names = found.fit.model.terms
    chosen = np.isin(names, found.selection.terms)
    child, parent = parent_pairs(names)
    assert not (chosen[child] & ~chosen[parent]).any()


@pytest.mark.slow_cases("ebic-poly-terms-options2")
@pytest.mark.parametrize(("problem", "options"), [
    ("poly-terms", {"degree": 2}), ("rfm-terms", {"order": 1}),
    ("poly-terms", {"degree": 4, "mask": "shared"})])
@pytest.mark.parametrize("criterion", ["check-rmse", "press", "ebic"])
def test_the_optimum_of_a_hierarchy(problem: str, options: dict, criterion: str) -> None:
    task = termsel.prepare(problem, solver="exact", criterion=criterion,
                           options={"hierarchy": True, "force_off": "X", **options})
    genome = task.problem.genome
    genes = np.array(list(itertools.product([False, True], repeat=genome.size)))
    evaluation = task.problem.evaluate(genes[~(genes & genome.off).any(axis=1)])
    feasible = evaluation.objectives[evaluation.violation == 0, 0]
    found = termsel.search(task.problem, task.solver)
    assert found.certificate["optimal"]
    assert found.objectives[0] == pytest.approx(feasible.min(), rel=1e-9)
    free = termsel.prepare(problem, solver="exact", criterion=criterion,
                           options={"force_off": "X", **options})
    assert termsel.search(free.problem, free.solver).objectives[0] <= found.objectives[0]


def test_regressions_keep_no_hierarchy() -> None:
    with pytest.raises(termsel.TermselError, match="cannot keep a hierarchy"):
        termsel.run("poly-terms", solver="ridge", options={"hierarchy": True})


@pytest.mark.parametrize("solver", ["ga", "exact"])
def test_no_more_terms_than_the_share(solver: str) -> None:
    found = run(solver=solver, degree=4, max_share=0.25)
    counts = [sum(term.startswith(axis) for term in found.selection.terms)
              for axis in ("line", "sample")]
    assert max(counts) <= 24 // 4


def test_coefficients_are_shrunk_after_the_selection() -> None:
    given = {"model": "poly3d", "solver": "all-terms"}
    plain, shrunk = (termsel.run("rfm-terms", options={"degree": 3, "shrink": shrink}, **given)
                     for shrink in (False, True))
    assert plain.selection == shrunk.selection
    order = np.array([sum(int(power or 1) for power in re.findall(r"[XYZ](\d?)", name))
                      for name in plain.fit.model.terms])
    one, other = (found.fit.adjustment.coefficients for found in (plain, shrunk))
    assert np.linalg.norm(other[order == 3]) < np.linalg.norm(one[order == 3])
    np.testing.assert_allclose(other[order == 1], one[order == 1], rtol=0.02, atol=5e-3)
    assert shrunk.rmse["independent"].total < plain.rmse["independent"].total
    assert not shrunk.objectives


def test_with_nothing_to_shrink_it_is_least_squares() -> None:
    given = {"model": "affine", "solver": "all-terms"}
    plain, shrunk = (termsel.run("rfm-terms", options={"shrink": shrink}, **given)
                     for shrink in (False, True))
    np.testing.assert_allclose(shrunk.fit.adjustment.coefficients,
                               plain.fit.adjustment.coefficients, atol=1e-10)


# Redundancy


def capped(problem: str = "poly-terms", **options: object) -> SelectionProblem:
    task = termsel.prepare(problem, options=options)
    assert isinstance(task.problem, SelectionProblem)
    return task.problem


@pytest.mark.parametrize(("solver", "share"), [
    (None, 2 / 3), ("exact", 2 / 3), ("nsga2", 2 / 3), ("ga", 2 / 3), ("ica", 2 / 3),
    ("all-terms", 1.0), ("ridge", 1.0)])
def test_all_solvers_have_the_same_cap_but_those_that_use_all(
        solver: str | None, share: float) -> None:
    task = termsel.prepare("poly-terms", solver=solver)
    assert task.options["problem"]["max_share"] == pytest.approx(share)
    assert task.options["problem"] == termsel.run(
        task, evaluations=5).to_dict()["options"]["problem"]


@pytest.mark.parametrize("mask", ["per-axis", "shared"])
@pytest.mark.parametrize("share", [0.2, None, 1])
def test_the_cap_of_the_optimum_is_that_of_the_evaluation(mask: str, share: float | None) -> None:
    # 9 control points give each axis 9 equations: at most 1, 6, and 8 terms of 10.
    scene = termsel.simulate_scene("ikonos-hamedan").points
    few = scene.take(np.r_[np.flatnonzero(np.array(scene.roles) == "control")[:9],
                           np.flatnonzero(np.array(scene.roles) != "control")])
    given = {} if share is None else {"max_share": share}
    task = termsel.prepare("poly-terms", features=FeatureSet(few), solver="exact",
                           options={"degree": 3, "mask": mask, **given})
    problem, found = task.problem, termsel.search(task.problem, task.solver)
    genes = np.array(list(itertools.product([False, True], repeat=10)))
    if mask == "per-axis":  # axis by axis, the other one with its constant
        constant = np.zeros_like(genes)
        constant[:, 0] = True
        genes = np.concatenate([np.column_stack([genes, constant]),
                                np.column_stack([constant, genes])])
    evaluation = problem.evaluate(genes)
    most = {0.2: 1, None: 6, 1: 8}[share]
    counts = np.array([genes[:, where].sum(axis=1) for where in problem.genome.slices().values()])
    assert (evaluation.violation[counts.max(axis=0) > most] > 0).all()
    assert counts[:, evaluation.violation == 0].max() == most
    feasible = evaluation.violation == 0
    if mask == "shared":
        assert found.objectives[0] == pytest.approx(evaluation.objectives[feasible, 0].min())
    else:
        best = [np.inf, np.inf]
        for side in (0, 1):
            some = feasible & (counts[1 - side] == 1) & genes[:, 10 * (1 - side)]
            squares = evaluation.objectives[:, 0] ** 2
            best[side] = squares[some].min()
        alone = genes[:, [0, 10]].all(axis=1) & (genes.sum(axis=1) == 2)
        assert found.objectives[0] ** 2 == pytest.approx(
            sum(best) - evaluation.objectives[alone, 0][0] ** 2)
    assert max(found.genes[where].sum() for where in problem.genome.slices().values()) <= most


def test_coupled_axes_share_a_cap() -> None:
    problem = capped("owdis-lines-terms", max_share=0.25, mask="shared")
    genes = np.zeros((3, problem.genome.size), dtype=bool)
    slices = problem.genome.slices()
    genes[:, slices["features"]] = np.arange(120) < 20  # 40 equations: 10 terms
    for row, n in zip(genes, (5, 6, 10), strict=True):
        row[slices["terms"]][:n] = True  # each gene switches a line term and a sample term
    counted = count_excess_terms(problem._parts, *problem.masks(genes), 0.25)
    assert counted.tolist() == [0, 2, 10]
    assert (problem.evaluate(genes).violation[1:] >= [2, 10]).all()
    assert slices["terms"].stop == 19
    assert problem.genome.segments[0].maximum == 19  # of 240 equations 60 terms
    few = capped("owdis-lines-terms", max_share=0.1, mask="shared")
    assert few.genome.segments[0].maximum == 12


def test_features_leave_a_degree_of_freedom_to_given_terms() -> None:
    problem = capped("owdis-points", terms="line.num:1,line.num:X,sample.num:1,sample.num:Y")
    genes = np.zeros((2, problem.genome.size), dtype=bool)
    genes[0, :2] = genes[1, :3] = True
    assert (problem.evaluate(genes).violation > 0).tolist() == [True, False]
    # Asked for two points of two terms an axis, one gets them.
    exact = capped("owdis-points", max_features=2,
                   terms="line.num:1,line.num:X,sample.num:1,sample.num:Y")
    assert exact.evaluate(genes[:1]).violation[0] == 0


def test_the_summary_states_the_cap() -> None:
    capped = termsel.run("poly-terms", strategy="as-asked", evaluations=50)
    lifted = termsel.run("poly-terms", solver="ga", evaluations=50, options={"max_share": 1})
    assert "Limit: 0.67 terms per equation" in capped.summary(verbose=True)
    assert "of their equations" not in lifted.summary(verbose=True)
