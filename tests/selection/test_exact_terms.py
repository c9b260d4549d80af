"""The proven optimum, against brute force through the problem itself."""

from __future__ import annotations

import itertools
import re
import time
from dataclasses import replace

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.data.record.figures import as_plain_data
from termsel.fitting.population import Fits
from termsel.runs.searching import result_of_search
from termsel.selection.best_subsets import descents as subset_descents
from termsel.selection.best_subsets import subsets
from termsel.selection.criteria import CheckRmse
from termsel.selection.solvers.genetic.ga import GeneticAlgorithm
from termsel.selection.solvers.proofs import exact
from termsel.selection.solvers.proofs import proof as proof_module
from termsel.selection.solvers.proofs.exact import Exact, gap_to_optimum
from termsel.selection.solvers.proofs.proof import count, prove
from termsel.testing import check

pytestmark = pytest.mark.usefixtures("bounds_of_few")


def brute_force(problem: termsel.Problem) -> tuple[np.ndarray, np.ndarray]:
    """Return all genes and their objectives, infinite where infeasible."""
    size = problem.genome.size
    genes = np.array(list(itertools.product([False, True], repeat=size)))
    evaluation = problem.evaluate(genes)
    return genes, np.where(evaluation.violation == 0, evaluation.objectives[:, 0], np.inf)


CASES = {
    "per axis": ("poly-terms", {"options": {"degree": 2}}),
    "shared": ("poly-terms", {"options": {"degree": 4, "mask": "shared"}}),
    "rational": ("rfm-terms", {"options": {"order": 1}}),
    "no denominators": ("rfm-terms", {"options": {"order": 1, "denominators": "none"}}),
}


@pytest.mark.slow_cases("spot-isfahan-per axis", "spot-isfahan-rational", "spot-isfahan-shared")
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("dataset", ["ikonos-hamedan", "spot-isfahan"])
def test_exact_finds_what_brute_force_finds(case: str, dataset: str) -> None:
    problem, given = CASES[case]
    task = termsel.prepare(problem, solver="exact", dataset=dataset, **given)
    genes, objectives = brute_force(task.problem)
    result = termsel.run(task)
    assert result.objectives["check-rmse"] == pytest.approx(objectives.min(), rel=1e-9)
    optimum = result.objectives["check-rmse"]
    most = task.problem.genome.segments[0].maximum
    space = "all selections" + (
        "" if most is None or most >= len(genes[0]) // len(task.problem.parts())
        else f" of up to {most} terms" + " an axis" * (case != "shared"))
    assert as_plain_data(result.certificate) == {
        "optimal": True, "subsets": count(task.problem), "of": count(task.problem),
        "bounded": result.certificate.bounded, "space": space, "bound": optimum,
        "gap": 0.0}
    # The front is the best of every size that beats all smaller ones.
    terms = task.problem.masks(genes)[0].sum(axis=1)
    best, expected, by_size = np.inf, {}, {}
    for size in range(terms.max() + 1):
        least = objectives[terms == size].min(initial=np.inf)
        if np.isfinite(least):
            by_size[size] = least
        if least < best * (1 - 1e-12):
            expected[size] = best = least
    found = {m.objectives["n_terms"]: m.objectives["check-rmse"] for m in result.front}
    assert found == pytest.approx(expected, rel=1e-9)
    # The best of every size has its own proof, on the front or not.
    rows = {m.objectives["n_terms"]: m for m in result.by_size}
    assert {n: m.objectives["check-rmse"] for n, m in rows.items()} == pytest.approx(
        by_size, rel=1e-9)
    assert all(m.optimal and m.gap == 0 and m.bound == m.objectives["check-rmse"]
               for m in rows.values())
    assert {n for n, m in rows.items() if m.better} == set(expected)


def test_forced_genes_and_cardinality_hold() -> None:
    task = termsel.prepare("poly-terms", options={"degree": 2})
    problem = task.problem
    line, sample = problem.genome.segments
    problem.genome = termsel.Genome(
        [termsel.Bits(line.name, line.labels, minimum=2, maximum=3), sample],
        on=["line.num:Y2"], off=["sample.num:X"])
    genes, objectives = brute_force(problem)
    kept = (genes == problem.genome.repair(genes, np.random.default_rng(0))).all(axis=1)
    found = termsel.search(problem, Exact())
    assert found.objectives[0] == pytest.approx(objectives[kept].min(), rel=1e-9)


def test_max_terms_is_the_space_of_the_certificate() -> None:
    result = termsel.run("poly-terms", solver="exact", options={"degree": 3, "max_terms": 4})
    assert result.certificate.space == "selections of up to 4 terms per coordinate"
    assert result.certificate.subsets == 2 * sum([1, 10, 45, 120, 210])
    assert len(result.selection.terms) <= 8


@pytest.mark.slow
def test_a_large_space_is_not_cut_and_ends_with_a_certificate(
        caplog: pytest.LogCaptureFixture) -> None:
    task = termsel.prepare("poly-terms", solver="exact", options={"degree": 7, "max_share": 1.0})
    with caplog.at_level("INFO", logger="termsel"):
        found = termsel.search(task.problem, task.solver, seconds=0.3)
    assert re.search(r"exact: 132,955,328,176 subsets to enumerate or exclude by bounds "
                     r"\(all selections of up to 23 terms "
                     r"an axis, 2 parts\)", caplog.text)
    certificate = result_of_search(task, found).certificate
    assert not certificate.optimal
    assert certificate.subsets < certificate.of == count(task.problem)
    assert 0 <= certificate.bound <= found.objectives[0]


@pytest.mark.parametrize("criterion", ["check-rmse", "ebic"])
def test_at_any_time_the_bound_holds_and_rises(criterion: str,
                                               monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subsets, "_BOUNDED_SUBSETS", 1 << 9)
    problem = termsel.prepare("poly-terms", criterion=criterion, options={"degree": 4}).problem
    states = list(prove(problem))
    found = problem.evaluate(np.array([state.front()[-1] for state in states[1:]]))
    bounds = [state.bound(best) for state, best in
              zip(states[1:], found.objectives[:, 0], strict=True)]
    assert bounds == sorted(bounds)
    assert bounds[0] < bounds[-1] == found.objectives[-1, 0] == found.objectives.min()
    assert len(set(bounds)) > 2


@pytest.mark.parametrize("criterion", ["check-rmse", "ebic", "press"])
def test_at_any_time_every_size_has_a_bound_that_holds(criterion: str,
                                                       monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subsets, "_BOUNDED_SUBSETS", 1 << 9)
    monkeypatch.setattr(subsets, "_NODE_SUBSETS", 1 << 9)
    if criterion == "ebic":
        monkeypatch.setattr(subsets, "_BOUNDED_SUBSETS", 1 << 6)
    monkeypatch.setattr(subsets, "_DESCEND_FROM", 1)
    monkeypatch.setattr(subsets, "_SMALL_SIZES", 1 << 9)
    monkeypatch.setattr(subset_descents, "_RESTARTS", 1)
    monkeypatch.setattr(subset_descents, "_KICKS", 1)
    problem = termsel.prepare("poly-terms", criterion=criterion, options={"degree": 3}).problem
    states = list(prove(problem))
    least = {one.genes.sum(): one.objective for one in states[-1].by_size(problem)}
    partly = 0
    for state in states[1::len(states) // 12]:
        sizes = state.by_size(problem)
        for one in sizes:
            optimum = least[one.genes.sum()]
            assert one.bound <= optimum + 1e-9 * abs(optimum) <= one.objective + 2e-9 * abs(optimum)
            assert not one.optimal or one.objective == pytest.approx(optimum, rel=1e-9)
        partly += 0 < sum(one.optimal for one in sizes) < len(sizes)
    assert partly
    # Of the extended BIC, only those that beat all smaller ones have to be proven.
    assert all(one.optimal or (criterion == "ebic" and not one.better)
               for one in states[-1].by_size(problem))


@pytest.mark.parametrize("fewest", [0, 12])
def test_of_many_selections_those_that_beat_all_smaller_ones_are_proven(
        fewest: int, monkeypatch: pytest.MonkeyPatch) -> None:
    most = proof_module.limits_of
    monkeypatch.setattr(proof_module, "limits_of", lambda *given: (fewest, most(*given)[1]))
    problem = termsel.prepare("poly-terms", criterion="ebic", options={"degree": 4}).problem
    *_, proof = prove(problem)
    whole = {one.genes.sum(): one for one in proof.by_size(problem)}
    monkeypatch.setattr(subsets, "_DESCEND_FROM", 1)
    monkeypatch.setattr(subsets, "_SMALL_SIZES", 1)
    monkeypatch.setattr(subset_descents, "_RESTARTS", 0)
    *_, proof = prove(problem)
    assert proof.complete
    least, beaten = np.inf, 0
    for one in proof.by_size(problem):
        optimum = whole[one.genes.sum()]
        if optimum.better:
            assert one.optimal
            least = optimum.objective
        else:
            assert least * (1 + 1e-9) <= one.bound <= optimum.objective  # figures are negative
            beaten += not one.optimal
    assert least == whole[max(n for n, one in whole.items() if one.better)].objective
    assert beaten


def test_a_bound_that_reaches_the_best_proves_it(monkeypatch: pytest.MonkeyPatch) -> None:
    task = termsel.prepare("poly-terms", solver="exact", options={"degree": 2})
    *_, proof = prove(task.problem)
    for above, proven in ((1.0, True), (1.0 - 1e-6, False)):
        open_ = replace(proof, results=tuple(
            replace(one, subsets=one.total - 1, floor=one.best * above) for one in proof.results))
        monkeypatch.setattr(exact, "prove", lambda *_, state=open_: iter([state]))
        found = termsel.search(task.problem, task.solver)
        assert found.certificate["optimal"] is proven
        assert found.certificate["gap"] == pytest.approx(1 / above**0.5 - 1, rel=1e-3)


def test_an_interrupted_proof_proves_nothing_but_has_the_best_so_far() -> None:
    task = termsel.prepare("poly-terms", solver="exact", options={"degree": 6, "workers": 2})

    def interrupt(progress: object) -> None:
        raise KeyboardInterrupt

    found = termsel.search(task.problem, task.solver, observers=[interrupt])
    assert found.interrupted
    assert found.violation == 0
    assert not found.certificate["optimal"]
    assert found.certificate["subsets"] < found.certificate["of"]
    result = result_of_search(task, found)
    assert as_plain_data(result.certificate) == found.certificate
    assert not result.front
    assert not all(one.optimal for one in result.by_size)
    assert re.search(r"^Pareto front\n.* best of its size$", result.summary(verbose=True),
                     re.MULTILINE)


def test_a_heuristic_states_its_gap() -> None:
    result = termsel.run("poly-terms", generations=2,
                         options={"degree": 4, "population": 10, "polish": False})
    optimum = termsel.run("poly-terms", solver="exact", options={"degree": 4})
    certificate = result.certificate
    best = optimum.objectives["check-rmse"]
    assert certificate.optimum == pytest.approx(best, rel=1e-9)
    assert certificate.gap == pytest.approx(result.objectives["check-rmse"] / best - 1)
    assert not certificate.optimal
    assert "above the proven optimum" in result.summary(verbose=True)


def test_a_large_space_has_no_gap() -> None:
    assert gap_to_optimum(termsel.prepare("rfm-terms").problem, 1.0) is None
    assert gap_to_optimum(termsel.prepare("owdis-lines").problem, 1.0) is None


def test_systems_of_very_many_rows_are_not_made_for_a_gap(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = termsel.prepare("poly-terms", criterion="kfold", options={"degree": 2}).problem
    assert gap_to_optimum(problem, 1e6) is not None
    monkeypatch.setattr("termsel.selection.solvers.proofs.exact.QUICK_ROWS", 400)
    assert gap_to_optimum(problem, 1e6) is None


@pytest.mark.parametrize(("problem", "options", "why"), [
    ("owdis-lines-terms", {}, "whose terms are columns"),
    ("rfm-terms", {"denominators": "shared"}, "couple the axes"),
    ("rfm-terms", {"order": 1, "mask": "shared"}, "no denominators"),
    ("rfm-terms", {"order": 1, "ridge": 0.01}, "pseudo-observations"),
])
def test_what_cannot_be_walked_is_refused(problem: str, options: dict, why: str) -> None:
    with pytest.raises(termsel.TermselError, match=why):
        termsel.run(problem, solver="exact", options=options)


def test_polish_says_what_it_added() -> None:
    bare = {"degree": 5, "population": 20}
    alone = termsel.run("poly-terms", generations=3, options={**bare, "polish": False})
    polished = termsel.run("poly-terms", generations=3, options=bare)
    assert alone.polish is None
    assert polished.polish.found == alone.objectives["check-rmse"]
    assert polished.polish.polished == polished.objectives["check-rmse"]
    assert polished.polish.polished < polished.polish.found
    assert polished.evaluations - polished.polish.evaluations == alone.evaluations


def test_a_polished_selection_has_no_better_neighbour() -> None:
    task = termsel.prepare("poly-terms", options={"degree": 3})
    found = termsel.search(task.problem, GeneticAlgorithm(population=10), generations=2,
                           polish=True)
    genes = found.genes
    flips = genes ^ np.eye(len(genes), dtype=bool)
    swaps = [genes ^ (np.arange(len(genes)) == i) ^ (np.arange(len(genes)) == j)
             for where in task.problem.genome.slices().values()
             for i, j in itertools.combinations(range(where.start, where.stop), 2)
             if genes[i] != genes[j]]
    around = task.problem.evaluate(np.concatenate([flips, np.array(swaps)]))
    feasible = around.violation == 0
    assert around.objectives[feasible, 0].min() >= found.objectives[0]


def test_swap_reaches_the_optimum_of_a_small_space() -> None:
    optimum = termsel.run("poly-terms", solver="exact", options={"degree": 3})
    swapped = termsel.run("poly-terms", solver="swap", options={"degree": 3})
    assert swapped.objectives["check-rmse"] == pytest.approx(
        optimum.objectives["check-rmse"], rel=1e-9)
    assert swapped.certificate.optimal


class Median(CheckRmse):
    """Median distance of the check points, which does not add up over line and sample."""

    name = "not-additive"

    def score(self, fits: Fits) -> np.ndarray:
        return np.median(np.sqrt((fits.check_errors**2).sum(axis=2)), axis=1)


def test_a_proof_that_an_evaluation_beats_is_refused() -> None:
    task = termsel.prepare("poly-terms", solver="exact", options={"degree": 2})
    with pytest.raises(TermselError, match=r"subset_score does not agree with its score"):
        termsel.search(task.problem.judged_by(Median()), task.solver)
    with pytest.raises(AssertionError, match="subset_score_agrees"):
        check(Median)


def test_no_gap_to_an_optimum_that_the_find_beats() -> None:
    problem = termsel.prepare("poly-terms", options={"degree": 2}).problem
    optimum = gap_to_optimum(problem, 1e6)["optimum"]
    assert gap_to_optimum(problem, optimum)["optimal"]
    assert gap_to_optimum(problem, 0.9 * optimum) is None


@pytest.mark.slow
def test_the_number_of_evaluations_is_the_same_on_a_slow_machine(
        monkeypatch: pytest.MonkeyPatch) -> None:
    task = termsel.prepare("poly-terms", solver="exact", criterion="kfold",
                           options={"degree": 4, "workers": 1})
    monkeypatch.setattr(subsets, "_BOUNDED_SUBSETS", 1 << 10)
    found = [termsel.search(task.problem, task.solver,
                            observers=[lambda _, wait=wait: time.sleep(wait)])
             for wait in (0.0, 0.01)]
    assert found[0].evaluations == found[1].evaluations
    assert found[0].generations == found[1].generations > 10
