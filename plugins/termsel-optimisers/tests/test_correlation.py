"""The GA whose first population follows the correlations of the design matrix."""

from __future__ import annotations

import numpy as np
import pytest

import termsel
from termsel import TermselError, search
from termsel.testing import Check, checks
from termsel_optimisers.papers.correlation import (
    CorrelationSeededGA,
    activation_probabilities,
    correlation_sums,
    seed_population,
)


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.parametrize("check", checks(
    CorrelationSeededGA, options=[{}, {"population": 21, "preset": "case-1"}],
    expected_failures={"any_problem": "it needs a design matrix"}), ids=lambda check: check.name)
def test_it_conforms(check: Check) -> None:
    check.run()


# Correlations of the design matrix

A = np.array([[1.0, 1.0, 2.0], [-1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, -2.0]])
HALF = np.sqrt(0.5)  # correlation of the third column, the sum of the others, with each of them


def test_eq_3_and_eq_4_by_hand() -> None:
    sums = correlation_sums(A + np.array([0.0, 7.0, -3.0]))
    assert sums == pytest.approx([1 + HALF, 1 + HALF, 1 + 2 * HALF])
    freedom = 1 - (1 + HALF) / (1 + 2 * HALF)
    assert activation_probabilities(sums, 1.0, 0.0) == pytest.approx([freedom, freedom, 0.0])
    assert activation_probabilities(sums, 1.19, 0.15) == pytest.approx(
        [1.19 * freedom + 0.15, 1.19 * freedom + 0.15, 0.15])


def test_correlations_are_those_of_the_joint_matrix() -> None:
    problem = termsel.prepare("rfm-terms").problem
    design = problem.design()
    assert design.shape == (48, 78)
    assert correlation_sums(design) == pytest.approx(
        np.abs(np.corrcoef(design, rowvar=False)).sum(axis=0))


def test_columns_without_variance() -> None:
    sums = correlation_sums(np.column_stack([A, np.full(4, 5.0), np.zeros(4)]))
    assert sums == pytest.approx([1 + HALF, 1 + HALF, 1 + 2 * HALF, 1 + HALF, 1 + 2 * HALF])
    assert correlation_sums(np.array([[1.0, 0.0], [1.0, 0.0]])) == pytest.approx([1.0, 1.0])


def test_probabilities_beyond_1_are_refused_with_what_is_permitted() -> None:
    sums = np.array([1.0, 2.0, 5.0])
    with pytest.raises(TermselError) as caught:
        activation_probabilities(sums, 1.69, 0.0)
    assert "the probability 1.352, which exceeds 1" in str(caught.value)
    assert "allow a scale of up to 1.25 with offset 0" in str(caught.value)
    assert "--set preset=own --set scale=1.25 --set offset=0" in str(caught.value)
    assert activation_probabilities(sums, 1.25, 0.0).max() == 1.0
    with pytest.raises(TermselError, match=r"or an offset of up to 0\.19\d* with scale 1"):
        activation_probabilities(sums, 1.0, 0.9)


@pytest.mark.parametrize("n", [1, 37, 200])
def test_genes_are_on_in_exactly_so_many_chromosomes(n: int) -> None:
    probability = np.array([0.0, 0.15, 0.5, 0.59, 1.0])
    genes = seed_population(probability, n, rng())
    assert genes.shape == (n, 5)
    assert genes.sum(axis=0).tolist() == [round(p * n) for p in probability]


def test_first_generation_on_real_problems() -> None:
    for name, options in (("rfm-terms", {}), ("poly-terms", {"mask": "shared"})):
        # The cap on terms would switch off some of those that the probabilities switch on.
        problem = termsel.prepare(name, solver="ga-correlation",
                                  options={**options, "max_share": 1.0}).problem
        solver = CorrelationSeededGA(population=150, preset="case-1")
        first = next(solver.generations(problem, rng()))
        probability = activation_probabilities(correlation_sums(problem.design()), 1.19, 0.15)
        assert first.genes.sum(axis=0).tolist() == np.rint(150 * probability).tolist()


def test_scale_and_offset_belong_to_their_preset() -> None:
    with pytest.raises(TermselError, match="preset=own requires scale and offset"):
        CorrelationSeededGA(preset="own", scale=1.0)
    with pytest.raises(TermselError, match="requires preset=own, but the preset is case-3"):
        CorrelationSeededGA(offset=0.1)
    problem = termsel.prepare("rfm-terms").problem
    same = [next(CorrelationSeededGA(**o).generations(problem, rng())).genes
            for o in ({"preset": "case-2"}, {"preset": "own", "scale": "1.69", "offset": 0})]
    assert np.array_equal(same[0], same[1])


def test_a_problem_without_a_design_matrix_is_refused() -> None:
    for name in ("owdis-lines", "owdis-points-terms"):
        problem = termsel.prepare(name).problem
        with pytest.raises(TermselError, match="no design matrix"):
            search(problem, CorrelationSeededGA(), generations=1)


def test_a_whole_run() -> None:
    task = termsel.prepare("poly-terms", options={"degree": 4, "mask": "shared"})
    exact = termsel.run("poly-terms", solver="exact", options={"degree": 4, "mask": "shared"})
    found = search(task.problem, CorrelationSeededGA(), seed=1, evaluations=16_000, polish=True)
    assert found.polish is not None
    assert found.objectives[0] == pytest.approx(exact.objectives["check-rmse"], rel=1e-9)


