"""The imperialist competitive algorithm: each equation by hand, and what holds in every search."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import termsel
from termsel.selection.problems.base import Evaluation
from termsel.selection.solvers.base import Generation
from termsel.selection.solvers.heuristics.ica import (
    Empires,
    ImperialistCompetition,
    assimilate,
    count_colonies,
    finite_costs,
    found_empires,
    normalise_cost,
    normalised_power,
    normalised_powers,
    possession_probability,
    revolt,
    total_power,
)
from termsel.selection.solvers.proofs.exact import gap_to_optimum
from termsel.testing import Check, checks, problems
from termsel.testing.problems import Watched


def bits(text: str) -> np.ndarray:
    return np.array([[digit == "1" for digit in text]])


def evaluation(objective: list[float], violation: list[float]) -> Evaluation:
    return Evaluation(np.array(objective)[:, None], np.array(violation))


# The equations


def test_equation_5() -> None:
    assert normalise_cost(np.array([1.0, 2.0, 4.0]), 5.0).tolist() == [4.0, 3.0, 1.0]


def test_equation_6() -> None:
    assert normalised_powers(np.array([4.0, 3.0, 1.0])).tolist() == [0.5, 0.375, 0.125]


def test_equation_6_where_all_cost_the_same() -> None:
    assert normalised_powers(np.zeros(4)).tolist() == [0.25] * 4


@pytest.mark.parametrize(("share", "colonies", "expected"), [
    ([0.5, 0.375, 0.125], 8, [4, 3, 1]),
    ([0.42, 0.38, 0.2], 10, [4, 4, 2]),
    ([1 / 3, 1 / 3, 1 / 3], 10, [4, 3, 3]),  # rounded: 9
    ([0.5, 0.25, 0.25], 10, [5, 3, 2]),  # rounded half up: 11
    ([0.96, 0.02, 0.02], 10, [10, 0, 0]),
])
def test_equation_7(share: list[float], colonies: int, expected: list[int]) -> None:
    assert count_colonies(np.array(share), colonies).tolist() == expected


@given(st.lists(st.floats(0.0, 1e6), min_size=1, max_size=20), st.integers(0, 500))
def test_sizes_add_up_and_are_the_rounded_ones_where_these_do(
        normalised: list[float], colonies: int) -> None:
    share = normalised_powers(np.array(normalised))
    size = count_colonies(share, colonies)
    assert size.sum() == colonies
    assert (np.abs(size - share * colonies) < 1 + 1e-6).all()
    rounded = np.floor(share * colonies + 0.5)
    if rounded.sum() == colonies:
        assert np.abs(size - rounded).sum() == 0


def test_figure_3() -> None:
    drawn = np.array([[0.523, 0.321, 0.724, 0.841, 0.229, 0.912]])
    moved = assimilate(bits("100100"), bits("110011"), 0.5, drawn)
    assert moved.tolist() == bits("110110").tolist()


def test_section_3_3_takes_the_rate_from_similarity() -> None:
    # Of two colonies one equals its imperialist in all genes but one, the other in one alone.
    drawn = np.array([[0.7, 0.7, 0.7, 0.7], [0.7, 0.7, 0.7, 0.7]])
    colonies = np.concatenate([bits("1110"), bits("0000")])
    imperialists = np.concatenate([bits("1111"), bits("1110")])
    rate = (colonies == imperialists).mean(axis=1, keepdims=True)
    assert rate.tolist() == [[0.75], [0.25]]
    assert (assimilate(colonies, imperialists, rate, drawn)
            == np.concatenate([bits("1111"), bits("0000")])).all()


@pytest.mark.slow
def test_the_set_up_of_the_paper_takes_the_rate_from_similarity() -> None:
    asked = termsel.prepare("zakaryaie-2015")
    assert asked.solver.options["similarity"] is True
    runs = [termsel.run("zakaryaie-2015", seed=1, generations=4,
                        options={"similarity": similar}).history[-1] for similar in (True, False)]
    assert runs[0] != runs[1]



def test_figure_4() -> None:
    colonies = np.concatenate([bits("10001110")] * 2)
    redrawn = np.concatenate([bits("11001100")] * 2)
    drawn = np.concatenate([bits("11111010")] * 2)
    revolted = revolt(colonies, np.array([True, False]), redrawn, drawn)
    assert revolted.tolist() == np.concatenate([bits("11001010"), bits("10001110")]).tolist()


COST = np.array([1.0, 2.0, 3.0, 5.0, 10.0, 7.0])
EMPIRE = np.array([0, 1, 0, 0, 1, 2])
IMPERIALISTS = np.array([0, 1, 5])


def test_equation_8() -> None:
    power = total_power(COST, EMPIRE, IMPERIALISTS, 0.08)
    # The third has no colonies; its own cost stands for their mean.
    assert power == pytest.approx([1 + 0.08 * 4, 2 + 0.08 * 10, 7 + 0.08 * 7])


def test_equations_9_and_10() -> None:
    normalised = normalised_power(np.array([2.0, 4.0, 8.0]))
    assert normalised.tolist() == [4.0, 2.0, 1.0]
    assert possession_probability(normalised) == pytest.approx([4 / 7, 2 / 7, 1 / 7])


@pytest.mark.parametrize(("power", "expected"), [
    ([0.0, 1.0], [1.0, 0.0]),
    ([0.0, 0.0], [0.5, 0.5]),
    ([-3.0, -1.0], [2 / 3, 1 / 3]),  # shifted to 2 and 4
    ([-1.0, -1.0], [0.5, 0.5]),
    ([5.0], [1.0]),
])
def test_equation_9_where_the_paper_would_divide_by_zero_or_less(
        power: list[float], expected: list[float]) -> None:
    assert possession_probability(
        normalised_power(np.array(power))) == pytest.approx(expected, abs=1e-11)


@given(st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=20))
def test_the_more_powerful_the_more_probable(power: list[float]) -> None:
    chance = possession_probability(normalised_power(np.array(power)))
    assert chance.sum() == pytest.approx(1)
    assert (np.diff(chance[np.argsort(power, kind="stable")]) <= 1e-12).all()


# Costs


def test_infeasible_countries_cost_a_bounded_penalty_by_rank() -> None:
    judged = evaluation([4.0, 1e9, 2.0, 1e9, 0.0], [0.0, 7.0, 0.0, 1e6, 7.0])
    assert finite_costs(judged) == pytest.approx([4.0, 4 + 2 * 2 / 3, 2.0, 6.0, 4 + 2 / 3])


def test_costs_where_nothing_is_feasible() -> None:
    assert finite_costs(evaluation([1e9, 1e9, 1e9], [3.0, 1.0, 3.0])).tolist() == [1.0, 0.5, 1.0]


@given(st.lists(st.tuples(st.floats(-1e9, 1e9), st.sampled_from([0.0, 0.0, 1e-9, 1.0, 1e9])),
                min_size=1, max_size=30))
def test_costs_are_finite_and_in_order(countries: list[tuple[float, float]]) -> None:
    judged = evaluation([c for c, _ in countries], [v for _, v in countries])
    cost = finite_costs(judged)
    assert np.isfinite(cost).all()
    assert (np.diff(cost[judged.order()]) >= 0).all()
    feasible = judged.violation == 0
    assert (cost[feasible] == judged.objectives[feasible, 0]).all()
    assert cost[feasible].max(initial=-np.inf) < cost[~feasible].min(initial=np.inf)


# Empires


def test_first_empires() -> None:
    cost = np.array([9.0, 1.0, 8.0, 5.0, 7.0, 9.0, 6.0, 9.0])
    world = found_empires(cost, 2, np.random.default_rng(1))
    assert world.imperialists.tolist() == [1, 3]
    # Equations (5) to (7): 9 - 1 = 8 and 9 - 5 = 4, so 2/3 and 1/3 of six colonies.
    assert np.bincount(world.empire).tolist() == [5, 3]
    assert world.empire[world.imperialists].tolist() == [0, 1]


def test_a_better_colony_takes_over_and_an_equal_one_does_not() -> None:
    world = Empires(EMPIRE, IMPERIALISTS, np.arange(3))
    cost = np.array([4.0, 2.0, 3.0, 3.5, 2.0, 7.0])
    assert world.crown(cost).imperialists.tolist() == [2, 1, 5]


def test_the_weakest_colony_of_the_weakest_empire_moves() -> None:
    world = Empires(np.array([0, 1, 0, 1, 1]), np.array([0, 1]), np.array([0, 1]))
    after = world.compete(COST[:5], np.array([1.0, 2.0]), np.array([0.1, 0.9]))
    assert after.empire.tolist() == [0, 1, 0, 1, 0]
    assert after.imperialists.tolist() == [0, 1]


def test_the_weakest_empire_may_win_its_own_colony() -> None:
    world = Empires(np.array([0, 1, 0, 1, 1]), np.array([0, 1]), np.array([0, 1]))
    after = world.compete(COST[:5], np.array([1.0, 2.0]), np.array([0.9, 0.1]))
    assert after.empire.tolist() == world.empire.tolist()


def test_empires_without_colonies_vanish_and_their_imperialists_become_colonies() -> None:
    # Empire 4 has none to begin with; empire 7 loses its only one, country 4, to empire 6.
    world = Empires(np.array([0, 1, 0, 2, 1]), np.array([0, 1, 3]), np.array([6, 7, 4]))
    after = world.compete(COST[:5], np.array([1.0, 9.0, 2.0]), np.array([0.0, 0.9, 0.9]))
    assert after.empire.tolist() == [0] * 5
    assert after.imperialists.tolist() == [0]
    assert after.names.tolist() == [6]


def test_an_empire_without_colonies_may_win_one_and_stay() -> None:
    world = Empires(np.array([0, 1, 0, 2, 1]), np.array([0, 1, 3]), np.array([6, 7, 4]))
    after = world.compete(COST[:5], np.array([1.0, 9.0, 2.0]), np.array([0.9, 0.9, 0.0]))
    assert after.empire.tolist() == [0, 1, 0, 1, 1]
    assert after.imperialists.tolist() == [0, 3]
    assert after.names.tolist() == [6, 4]


# Whole searches


def check_world(generation: Generation, before: Generation | None) -> None:
    genes, found = generation.genes, generation.details
    empire, imperialists, names = found["empire"], found["imperialists"], found["names"]
    assert empire.shape == (len(genes),)
    assert set(empire) == set(names)
    assert empire[imperialists].tolist() == names.tolist()
    assert found["power"].shape == names.shape
    for name, imperialist in zip(names, imperialists, strict=True):
        assert found["cost"][imperialist] <= found["cost"][empire == name].min()
    if before is None:
        return
    assert genes.shape == before.genes.shape
    assert set(names) <= set(before.details["names"])
    best, best_before = (g.evaluation.take(g.evaluation.order()[:1]) for g in (generation, before))
    assert ((best.violation[0], best.objectives[0, 0])
            <= (best_before.violation[0], best_before.objectives[0, 0]))


@pytest.mark.parametrize("seed", range(1, 6))
@pytest.mark.parametrize("population", [4, 7, 30, 100])
@pytest.mark.parametrize("problem", [
    problems.problem_of_twelve_terms(), problems.bounded_problem(), problems.trap_problem(),
    problems.hopeless_problem(), problems.narrow_problem(1)],
    ids=["twelve terms", "bound", "trap", "hopeless", "narrow"])
def test_what_holds_in_every_generation(problem: termsel.Problem, population: int,
                                        seed: int) -> None:
    solver = ImperialistCompetition(population=population)
    before = None
    for generation in islice(solver.generations(problem, np.random.default_rng(seed)), 40):
        check_world(generation, before)
        before = generation


def test_the_last_generation_has_one_empire() -> None:
    found = list(ImperialistCompetition(population=12, imperialists=0.4).generations(
        problems.problem_of_twelve_terms(), np.random.default_rng(1)))
    assert len(found[0].details["names"]) == 5
    assert all(len(one.details["names"]) > 1 for one in found[:-1])
    assert len(found[-1].details["names"]) == 1
    assert len(set(found[-1].details["empire"])) == 1


def test_half_the_countries_may_be_imperialists() -> None:
    solver = ImperialistCompetition(population=9, imperialists=0.5)
    first = next(solver.generations(problems.narrow_problem(12), np.random.default_rng(1)))
    assert len(first.details["names"]) == 4


def test_only_colonies_are_evaluated_again() -> None:
    problem = Watched(problems.narrow_problem(12))
    running = ImperialistCompetition().generations(problem, np.random.default_rng(1))
    next(running)
    assert problem.evaluated == 100
    next(running)
    assert problem.evaluated == 190


@pytest.mark.slow
@pytest.mark.parametrize(("degree", "population"), [(4, 50), (5, 100)])
def test_the_polynomials_of_the_paper(degree: int, population: int) -> None:
    task = termsel.prepare("poly-terms", dataset="ikonos-hamedan",
                           options={"degree": degree, "mask": "shared"})
    for seed in (1, 2):
        found = termsel.search(task.problem, ImperialistCompetition(population=population),
                               seed=seed, evaluations=40_000, polish=True)
        certificate = gap_to_optimum(task.problem, float(found.objectives[0]))
        assert certificate is not None
        assert certificate["optimal"]


def test_empires_that_have_met_unite_by_hand() -> None:
    genes = np.array([[1, 1, 1, 1], [1, 1, 1, 0], [0, 0, 0, 0], [0, 1, 0, 1], [1, 0, 1, 0],
                      [1, 1, 0, 0]], dtype=bool)
    cost = np.array([2.0, 1.0, 3.0, 9.0, 8.0, 7.0])
    world = Empires(np.array([0, 1, 2, 0, 1, 2]), np.array([0, 1, 2]), np.array([0, 1, 2]))
    # The first two imperialists differ in one gene of four; the second is the better one.
    united = world.unite(genes, cost, 0.25)
    assert united.imperialists.tolist() == [1, 2]
    assert united.names.tolist() == [1, 2]
    assert united.empire.tolist() == [0, 0, 1, 0, 0, 1]
    assert world.unite(genes, cost, 0.24).empire.tolist() == world.empire.tolist()
    assert world.unite(genes, cost, 1.0).imperialists.tolist() == [1]


def test_uniting_ends_a_search_that_hardly_ends_by_itself() -> None:
    problem = termsel.prepare("poly-terms", solver="ica", options={
        "degree": 4, "mask": "shared"}).problem

    def ends(**options: object) -> int:
        solver = ImperialistCompetition(population=100, **options)
        last = 0
        for generation in islice(solver.generations(problem, np.random.default_rng(1)), 301):
            last = generation.index
        return last

    assert ends() == 300
    assert ends(uniting=0.02) < 300


def test_more_contested_colonies_move_in_one_generation() -> None:
    problem = termsel.prepare("poly-terms", solver="ica").problem

    def moved(contested: int) -> int:
        solver = ImperialistCompetition(population=40, contested=contested)
        first, second = islice(solver.generations(problem, np.random.default_rng(1)), 2)
        return int((first.details["empire"] != second.details["empire"]).sum())

    assert moved(1) <= 1 < moved(12)


@pytest.mark.parametrize("check", checks(ImperialistCompetition, options=[{}, {"population": 60}]),
                         ids=lambda check: check.name)
def test_it_conforms(check: Check) -> None:
    check.run()
