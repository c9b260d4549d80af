"""Local search: its neighbourhood, and where its climbs end."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import termsel
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.segments import Bits
from termsel.selection.solvers import refinement
from termsel.selection.solvers.genetic.ga import GeneticAlgorithm
from termsel.selection.solvers.heuristics import swap as local
from termsel.selection.solvers.ledger import Progress
from termsel.selection.solvers.proofs.proof import prove


@given(st.integers(0, 2**32), st.integers(1, 5), st.integers(1, 4))
def test_neighbours_are_all_selections_one_step_away(seed: int, a: int, b: int) -> None:
    rng = np.random.default_rng(seed)
    least = int(rng.integers(0, a + 1))
    genome = Genome([Bits("a", tuple(f"a{i}" for i in range(a)), least,
                             int(rng.integers(least, a + 1))),
                     Bits("b", tuple(f"b{i}" for i in range(b)))], on=("b0",))
    genes = genome.random(rng, 1)[0]
    found = {tuple(one) for batch in local.neighbour_batches(genes, genome) for one in batch}
    everything = (np.arange(2**genome.size)[:, None] >> np.arange(genome.size)) & 1 > 0
    expected = set()
    for one in everything[genome.keeps(everything)]:
        changed = one != genes
        gained, lost = (one & changed), (genes & changed)
        within = changed[:a].sum() in (0, changed.sum())
        if changed.sum() == 1 or (changed.sum() == 2 and gained.sum() == lost.sum() and within):
            expected.add(tuple(one))
    assert found == expected


def test_neighbours_of_many_genes_come_in_batches() -> None:
    genome = Genome([Bits("features", tuple(map(str, range(200))))])
    sizes = [len(b) for b in local.neighbour_batches(np.arange(200) % 2 == 0, genome)]
    assert sum(sizes) == 200 + 100 * 100
    assert max(sizes) == local.BATCH


def test_neighbours_of_very_many_genes_take_no_memory_before_their_turn() -> None:
    genome = Genome([Bits("features", tuple(map(str, range(20_000))))])
    tracemalloc.start()
    batches = local.neighbour_batches(np.arange(20_000) % 2 == 0, genome)
    assert len(next(batches)) == local.BATCH
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 3 * local.BATCH * 20_000  # 100 million pairs alone would take 1.6 GB


def test_the_local_refinement_keeps_to_its_budget_and_tells(monkeypatch: pytest.MonkeyPatch,
                                                            ) -> None:
    task = termsel.prepare("owdis-points")
    told: list[Progress] = []
    solver = GeneticAlgorithm(population=10)
    free = termsel.search(task.problem, solver, generations=1, polish=True,
                          observers=[told.append])
    assert free.polish
    assert free.polish.evaluations > 100
    shares = [one.share for one in told if one.what == "local refinement"]
    assert len(shares) >= 2
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert [one.evaluations for one in told] == sorted(one.evaluations for one in told)
    monkeypatch.setattr(refinement, "DESCENT", 70 * task.problem.genome.size)
    kept = termsel.search(task.problem, solver, generations=1, polish=True)
    assert kept.polish is not None
    assert kept.polish.evaluations == 70
    assert kept.polish.polished <= kept.polish.found


@pytest.mark.slow_cases("per-axis")
@pytest.mark.parametrize("mask", ["per-axis", "shared"])
def test_polish_reaches_the_proven_optimum_of_15_terms(mask: str) -> None:
    task = termsel.prepare("poly-terms", options={"degree": 4, "mask": mask})
    *_, proof = prove(task.problem)
    best = task.problem.evaluate(proof.front()[-1][None]).objectives[0, 0]
    for seed in (1, 2):
        found = termsel.search(task.problem, task.solver, seed=seed, evaluations=40_000,
                               polish=True)
        assert found.objectives[0] == pytest.approx(best, rel=1e-9)
        assert found.evaluations <= 40_000
        assert 0 < found.polish.evaluations <= 30_000
