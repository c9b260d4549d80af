"""The genetic algorithm with transgenic chromosomes."""

from __future__ import annotations

import numpy as np
import pytest
from deap import base
from scipy.stats import mannwhitneyu, norm

pytest.importorskip("termsel_optimisers", reason="termsel-optimisers is not installed: "
                    "pip install -e plugins/termsel-optimisers")

import termsel
from termsel import Evaluation, GeneticAlgorithm, search
from termsel.testing.problems import narrow_problem
from termsel.toolkit import BoolArray, FloatArray
from termsel.toolkit.searches import WORST
from termsel_optimisers import TransgenicGA
from termsel_optimisers.rivals import transgenic
from termsel_optimisers.rivals.transgenic import gene_qualification


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def judged(cost: FloatArray, violation: FloatArray | None = None) -> Evaluation:
    return Evaluation(cost[:, None], np.zeros(len(cost)) if violation is None else violation)


def _without_operators(box: base.Toolbox, seen: list[BoolArray]) -> None:
    """Let all be parents in turn, note them, and change nothing."""
    def mate(parents: BoolArray) -> BoolArray:
        seen.append(parents.copy())
        return parents

    box.register("mate", mate)
    box.register("mutate", lambda parents: parents)
    box.register("select", lambda _order, n: np.arange(n))


def test_qualification_is_the_rank_sum_test() -> None:
    genes = rng().random((60, 8)) < 0.4
    genes[:, 6], genes[:, 7] = True, False
    cost = np.round(rng(2).normal(size=60) - genes[:, 0], 1)  # rounded: with ties
    found = gene_qualification(genes, judged(cost))
    for gene in range(6):
        on = genes[:, gene]
        test = mannwhitneyu(cost[on], cost[~on], method="asymptotic", use_continuity=False)
        assert 2 * norm.sf(abs(found[gene])) == pytest.approx(test.pvalue)
        assert np.sign(found[gene]) == np.sign(cost[~on].mean() - cost[on].mean())
    assert found[0] > 2
    assert found[6:].tolist() == [0.0, 0.0]


def test_qualification_without_differences() -> None:
    genes = rng().random((20, 5)) < 0.5
    assert not gene_qualification(genes, judged(np.full(20, WORST))).any()
    assert not gene_qualification(genes[:1], judged(np.ones(1))).any()


def test_infeasible_chromosomes_rank_last() -> None:
    genes = np.arange(20)[:, None] < [10]
    cheap = np.where(genes[:, 0], 0.0, 1.0)
    assert gene_qualification(genes, judged(cheap))[0] > 3
    assert gene_qualification(genes, judged(cheap, violation=cheap == 0))[0] < -3


def test_every_second_parent_has_the_qualified_genes() -> None:
    seen: list[BoolArray] = []
    solver = TransgenicGA(population=60, elite=0, alpha=0.001, transgenic=0.25)
    genes = rng().random((60, 12)) < 0.5
    box = solver.toolbox(narrow_problem(12), rng())
    _without_operators(box, seen)
    cost = 10.0 * genes[:, 3] - 10.0 * genes[:, 8] + np.linspace(0, 1e-3, 60)
    solver.children(box, genes, judged(cost), 60)
    made = genes[:30:2].copy()
    made[:, 3], made[:, 8] = False, True
    assert np.array_equal(seen[0][:30:2], made)
    assert np.array_equal(seen[0][1:30:2], genes[1:30:2])
    assert np.array_equal(seen[0][30:], genes[30:])


@pytest.mark.parametrize(("coefficient", "qualified"), [(1.9, False), (2.0, True)])
def test_the_test_of_a_gene_has_two_sides(coefficient: float, qualified: bool,
                                          monkeypatch: pytest.MonkeyPatch) -> None:
    """At the level 0.05 the limits of a standard normal variable are -1.96 and 1.96."""
    monkeypatch.setattr(transgenic, "gene_qualification",
                        lambda *_: np.array([coefficient, -coefficient, 0.0]))
    genes = np.array([[False, True, False], [False, True, True]] * 4)
    seen: list[BoolArray] = []
    solver = TransgenicGA(population=8, elite=0, transgenic=0.5)
    box = solver.toolbox(narrow_problem(3), rng())
    _without_operators(box, seen)
    solver.children(box, genes, judged(np.arange(8.0)), 8)
    assert (seen[0][::2, :2] == [qualified, not qualified]).all()
    assert np.array_equal(seen[0][1::2], genes[1::2])


def test_without_transgenic_parents_it_is_the_ga() -> None:
    problem = termsel.prepare("poly-terms").problem
    runs = [search(problem, solver, seed=3, generations=5)
            for solver in (GeneticAlgorithm(population=30),
                           TransgenicGA(population=30, transgenic=0.0))]
    assert np.array_equal(runs[0].genes, runs[1].genes)


def test_a_whole_run() -> None:
    task = termsel.prepare("poly-terms", options={"degree": 4, "mask": "shared"})
    exact = termsel.run("poly-terms", solver="exact", options={"degree": 4, "mask": "shared"})
    found = search(task.problem, TransgenicGA(), seed=1, evaluations=16_000, polish=True)
    assert found.polish is not None
    assert found.objectives[0] == pytest.approx(exact.objectives["check-rmse"], rel=1e-9)
