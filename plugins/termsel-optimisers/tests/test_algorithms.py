"""Algorithms of DEAP and pymoo: the batched twin, conformance, and names of earlier versions."""

from __future__ import annotations

from typing import Any

import pytest
from pymoo.algorithms.moo import age
from scipy.stats import ks_2samp

import termsel
from termsel import GeneticAlgorithm, search
from termsel.testing import Check, checks
from termsel.toolkit.searches import Ledger
from termsel_optimisers.deap_algorithms import Deap
from termsel_optimisers.survivals import AgeMoea2, SmsEmoa, Spea2

SEEDS = range(30)

# Kept on disk: else each process of tests would compile them for four seconds.
for compiled in (age.find_corner_solutions, age.point_2_line_distance,
                 age.AGEMOEASurvival.minkowski_distances):
    compiled.enable_caching()


@pytest.mark.slow
@pytest.mark.parametrize(("problem", "options"), [
    ("poly-terms", {"degree": 4}), ("rfm-terms", {"order": 2}), ("owdis-points", {})])
def test_ga_is_the_batched_twin_of_deap(problem: str, options: dict[str, Any]) -> None:
    task = termsel.prepare(problem, options=options)
    shared = Ledger(task.problem)  # both look up what either has evaluated

    def reached(solver: termsel.Solver) -> list[float]:
        return [float(search(shared, solver, seed=seed, generations=12).objectives[0])
                for seed in SEEDS]

    batched = reached(GeneticAlgorithm(population=40, elite=0))
    plain = reached(Deap(population=40))
    assert len(set(batched)) > 5
    assert ks_2samp(batched, plain).pvalue > 0.01
    # The test has power: with half of the generations' crossover and mutation it sees the gap.
    weak = reached(Deap(population=40, select="selRandom"))
    assert ks_2samp(batched, weak).pvalue < 0.001


@pytest.mark.slow_cases(
    "age-moea2-narrow_genomes", "age-moea2-typed_genomes", "sms-emoa-typed_genomes",
    "spea2-narrow_genomes", "spea2-typed_genomes")
@pytest.mark.parametrize("check", [
    pytest.param(check, id=f"{solver.name}-{check.name}")
    # A small population is quick, and goes through the same code.
    for solver in (AgeMoea2, SmsEmoa, Spea2) for check in checks(solver(population=20))])
def test_the_other_algorithms_conform(check: Check) -> None:
    check.run()
