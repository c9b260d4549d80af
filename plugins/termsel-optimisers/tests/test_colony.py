"""The ant colony."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

pytest.importorskip("termsel_optimisers", reason="termsel-optimisers is not installed: "
                    "pip install -e plugins/termsel-optimisers")

import termsel
from termsel import Bits, Generation, Genome
from termsel.testing import problems
from termsel.testing.problems import Toy
from termsel.toolkit import BoolArray, FloatArray
from termsel.toolkit.searches import gap_to_optimum
from termsel_optimisers.rivals.colony import AntColony, deposit, graft_segments, has_settled, renew


def bits(*texts: str) -> BoolArray:
    return np.array([[digit == "1" for digit in text] for text in texts])


def generations(problem: termsel.Problem, n: int, seed: int = 1,
                **options: float) -> list[Generation]:
    return list(islice(AntColony(**options).generations(problem, np.random.default_rng(seed)), n))


def test_ants_deposit_by_rank() -> None:
    # Weights 3, 2 and 1 of 6.
    assert deposit(bits("1100", "1010", "1001")) == pytest.approx(
        np.array([[0, 3, 4, 5], [6, 3, 2, 1]]) / 6)


def test_evaporation_and_deposit_within_limits() -> None:
    pheromone = np.array([[0.5, 0.9, 0.1], [0.5, 0.1, 0.9]])
    deposited = np.array([[1.0, 1.0, 0.5], [0.0, 0.0, 0.5]])
    assert renew(pheromone, deposited, 0.2, 0.1, 0.9) == pytest.approx(
        np.array([[0.6, 0.9, 0.18], [0.4, 0.1, 0.82]]))


def test_settled_by_the_rarer_states() -> None:
    chance = np.array([0.02, 0.98, 0.9])
    assert has_settled(chance, 0.05)
    assert not has_settled(chance, 0.04)
    assert not has_settled(np.empty(0), 0.5)


def test_grafts_take_one_segment_each() -> None:
    genome = Genome([Bits("a", ("1", "2")), Bits("b", ("3", "4", "5"))])
    assert graft_segments(bits("11000")[0], bits("01101")[0], genome).tolist() == bits(
        "01000", "11101").tolist()


def test_pheromone_begins_even_keeps_its_limits_and_leads_to_the_genes() -> None:
    found = generations(problems.narrow_problem(12), 30, tau_min=0.1, tau_max=0.8, restart=0)
    assert (found[0].details["pheromone"] == 0.5).all()
    for one in found:
        assert one.details["pheromone"].shape == (2, 12)
        assert one.details["pheromone"].min() >= 0.1
        assert one.details["pheromone"].max() <= 0.8
    assert found[-1].details["pheromone"] == pytest.approx(np.array([[0.1], [0.8]]).repeat(12, 1))
    assert found[-1].genes.mean() == pytest.approx(0.8 / 0.9, abs=0.05)


def starts(found: list[Generation]) -> list[int]:
    return [one.index for one in found if (one.details["pheromone"] == 0.5).all()]


def test_a_settled_colony_restarts() -> None:
    began = starts(generations(problems.narrow_problem(12), 100))
    assert len(began) > 2
    assert np.diff(began).min() > 5
    assert starts(generations(problems.narrow_problem(12), 100, restart=0)) == [0]


def test_a_colony_of_forced_genes_goes_on() -> None:
    found = generations(problems.narrow_problem(2, on=("g1", "g2")), 20)
    assert all(one.genes.all() for one in found)


def test_finds_of_different_starts_come_together() -> None:
    """Each segment has a best selection, and nearly as good a one far from it."""
    pattern = np.arange(30) % 2 == 0
    seen: list[float] = []

    def judge(genes: BoolArray) -> tuple[FloatArray, FloatArray]:
        different = (genes != pattern).reshape(len(genes), 5, 6).sum(axis=2)
        cost = np.minimum(different, 6.1 - different).sum(axis=1)
        seen.append(cost.min())
        return cost[:, None], np.zeros(len(genes))

    segments = [Bits(name, tuple(f"{name}{i}" for i in range(6))) for name in "abcde"]
    in_one_start = 0
    for seed in range(1, 6):
        found = generations(Toy(Genome(segments), judge), 120, seed)
        assert len(starts(found)) > 3
        assert min(seen) == 0.0
        seen.clear()
        in_one_start += min(one.evaluation.objectives.min() for one in found) == 0.0
    assert in_one_start < 3


@pytest.mark.slow_cases("5")
@pytest.mark.parametrize("degree", [4, 5])
def test_polynomials_with_a_shared_mask(degree: int) -> None:
    task = termsel.prepare("poly-terms", dataset="ikonos-hamedan",
                           options={"degree": degree, "mask": "shared"})
    for seed in (1, 2):
        found = termsel.search(task.problem, AntColony(), seed=seed, evaluations=40_000,
                               polish=True)
        certificate = gap_to_optimum(task.problem, float(found.objectives[0]))
        assert certificate is not None
        assert certificate["optimal"]
