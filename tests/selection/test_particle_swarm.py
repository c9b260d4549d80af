"""The binary particle swarm."""

from __future__ import annotations

from itertools import islice, pairwise

import numpy as np
import pytest

import termsel
from termsel.selection.problems.base import Evaluation
from termsel.selection.solvers.heuristics.pso import (
    BinarySwarm,
    are_improved,
    chance_of_gene,
    find_leaders,
)
from termsel.selection.solvers.proofs.exact import gap_to_optimum
from termsel.testing import problems


def test_feasible_ones_are_better_whatever_they_cost() -> None:
    found = Evaluation(np.array([[9.0], [1.0], [2.0], [3.0]]), np.array([0.0, 1.0, 0.0, 0.5]))
    own = Evaluation(np.array([[1.0], [9.0], [2.0], [4.0]]), np.array([1.0, 0.0, 0.0, 0.5]))
    assert are_improved(found, own).tolist() == [True, False, False, True]


def test_leaders_are_the_best_of_each_neighbourhood_in_the_ring() -> None:
    order = np.array([3, 5, 0, 1, 2, 4])
    assert find_leaders(order, 1).tolist() == [5, 0, 3, 3, 3, 5]
    assert find_leaders(order, 2).tolist() == [5, 3, 3, 3, 3, 3]


@pytest.mark.parametrize("reach", [0, 3, 50])
def test_one_leader_of_the_whole_swarm(reach: int) -> None:
    assert find_leaders(np.array([3, 5, 0, 1, 2, 4]), reach).tolist() == [3] * 6


def test_sigmoid() -> None:
    assert chance_of_gene(np.array([0.0, 4.0, -4.0])) == pytest.approx([0.5, 55.6 / 56.6, 1 / 55.6],
                                                               rel=1e-3)


def test_velocities_keep_their_limit() -> None:
    solver = BinarySwarm(velocity=1.5)
    problem = problems.bounded_problem()
    for generation in islice(solver.generations(problem, np.random.default_rng(1)), 30):
        velocity = generation.details["velocity"]
        assert velocity.shape == generation.genes.shape
        assert np.abs(velocity).max() <= 1.5


def test_particles_start_towards_where_they_are() -> None:
    first = next(BinarySwarm().generations(problems.narrow_problem(12), np.random.default_rng(1)))
    assert ((first.details["velocity"] >= 0) == first.genes).all()


def test_without_pull_the_inertia_alone_changes_velocities() -> None:
    solver = BinarySwarm(cognition=0, society=0, inertia=0.9, inertia_last=0.5, iterations=4)
    seen = [one.details["velocity"] for one in islice(
        solver.generations(problems.narrow_problem(12), np.random.default_rng(1)), 7)]
    inertia = [(after / before).mean() for before, after in pairwise(seen)]
    assert inertia == pytest.approx([0.8, 0.7, 0.6, 0.5, 0.5, 0.5])


def test_particles_are_drawn_to_the_finds_of_others_and_their_own() -> None:
    # With one gene on being all that counts, every particle ends up with it on most of the time.
    found = list(islice(BinarySwarm(velocity=6).generations(
        problems.narrow_problem(1), np.random.default_rng(1)), 40))
    assert found[-1].genes.mean() > 0.9


def test_a_falling_inertia_keeps_the_swarm_from_settling() -> None:
    problem = problems.problem_of_twelve_terms()
    spread = [
        list(islice(BinarySwarm(inertia_last=last, iterations=50).generations(
            problem, np.random.default_rng(1)), 60))[-1].genes.std(axis=0).mean()
        for last in (1.0, 0.4)]
    assert spread[0] < 0.7 * spread[1]


@pytest.mark.slow_cases("5")
@pytest.mark.parametrize("degree", [4, 5])
def test_polynomials_with_a_shared_mask(degree: int) -> None:
    task = termsel.prepare("poly-terms", dataset="ikonos-hamedan",
                           options={"degree": degree, "mask": "shared"})
    for seed in (1, 2):
        found = termsel.search(task.problem, BinarySwarm(), seed=seed, evaluations=10_000)
        certificate = gap_to_optimum(task.problem, float(found.objectives[0]))
        assert certificate is not None
        assert certificate["optimal"]
