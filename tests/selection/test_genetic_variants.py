"""The variants of the GA: steady state over tuples."""

from __future__ import annotations

from itertools import combinations, islice

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.data.features import BoolArray, FloatArray
from termsel.models.base import LINE, SAMPLE
from termsel.selection.problems.base import Evaluation, Problem
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.segments import Bits, Integers, Reals, random_subsets
from termsel.selection.solvers.base import Solver
from termsel.selection.solvers.genetic.fast import FastMutation
from termsel.selection.solvers.genetic.ga import GeneticAlgorithm
from termsel.selection.solvers.genetic.ga_steady import (
    SteadyStateGA,
    coding_of_genome,
)
from termsel.selection.solvers.genetic.operators import (
    cross_at_two_points,
    cross_pairs,
    replace_one,
    set_crossover,
)
from termsel.selection.solvers.heuristics.yardsticks import RandomSearch
from termsel.selection.solvers.search import search
from termsel.testing import problems
from termsel.testing.problems import Toy


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def m_of_n(problem: str, m: int, **options: object) -> Problem:
    made = termsel.prepare(problem, options={"min_features": m, "max_features": m, **options})
    return made.problem


def judged(cost: FloatArray, violation: FloatArray | None = None) -> Evaluation:
    return Evaluation(cost[:, None], np.zeros(len(cost)) if violation is None else violation)


def fixed(labels: int, m: int, on: tuple[str, ...] = (), off: tuple[str, ...] = ()) -> Genome:
    names = tuple(f"g{i + 1}" for i in range(labels))
    return Genome([Bits("features", names, m, m)], on=on, off=off)


# The design matrix by gene


@pytest.mark.parametrize("options", [{}, {"mixed": True}, {"denominators": "shared"}])
def test_design_has_the_columns_of_the_equations(options: dict[str, object]) -> None:
    task = termsel.prepare("rfm-terms", options=options)
    problem = task.problem
    terms = np.array(task.model.terms)
    column = [int(np.flatnonzero(terms == label)[0]) for label in problem.genome.labels]
    assert np.array_equal(problem.design(), problem.equations.A[:, column])


@pytest.mark.parametrize("options", [{}, {"mixed": True}, {"denominators": "shared"}])
def test_a_shared_gene_stacks_line_and_sample(options: dict[str, object]) -> None:
    task = termsel.prepare("rfm-terms", options={**options, "mask": "shared"})
    problem, terms, axis = task.problem, task.model.terms, task.model.axis
    matrix = problem.equations.A
    rows = [(matrix[:, axis == side] != 0).any(axis=1) for side in (LINE, SAMPLE)]
    design = problem.design()
    points, lines = len(task.observations.control.points), len(task.observations.control.lines)
    assert len(design) == 2 * points + 4 * lines
    for gene, label in enumerate(problem.genome.labels):
        stacked = [matrix[here, terms.index(label if label in terms else f"{side}.{label}")]
                   for here, side in zip(rows, ("line", "sample"), strict=True)]
        assert np.array_equal(design[:, gene], np.concatenate(stacked))


# Tuples of m numbers


def distinct(tuples: np.ndarray, n: int) -> bool:
    return bool((np.diff(tuples, axis=1) > 0).all() and tuples.min() >= 0 and tuples.max() < n)


def test_random_subsets_are_sets_and_meet_every_number() -> None:
    tuples = random_subsets(4000, 10, 3, rng())
    assert tuples.shape == (4000, 3)
    assert distinct(tuples, 10)
    assert np.bincount(tuples.ravel()) / 4000 == pytest.approx([0.3] * 10, abs=0.03)


def test_children_keep_what_both_parents_have_and_add_what_one_has() -> None:
    parents = random_subsets(401, 12, 6, rng())
    children = set_crossover(parents, 1.0, rng(2))
    assert distinct(children, 12)
    for i in range(0, 400, 2):
        first, second = set(parents[i]), set(parents[i + 1])
        for child in children[i:i + 2]:
            assert first & second <= set(child) <= first | second
    assert np.array_equal(children[400], parents[400])  # it has no mate
    assert not np.array_equal(children[:400:2], children[1:400:2])
    assert np.array_equal(set_crossover(parents, 0.0, rng()), parents)


def test_what_one_parent_has_is_drawn_evenly() -> None:
    parents = np.tile([[0, 1, 2, 3], [2, 3, 4, 5]], (3000, 1))
    children = set_crossover(parents, 1.0, rng())
    share = np.bincount(children.ravel(), minlength=6) / len(children)
    assert share == pytest.approx([0.5, 0.5, 1.0, 1.0, 0.5, 0.5], abs=0.03)


def test_mutation_replaces_one_number_by_a_new_one() -> None:
    before = np.tile([0, 3, 4, 7], (4000, 1))
    after = replace_one(before, 8, 1.0, rng())
    assert distinct(after, 8)
    new = [set(a) - set(b) for a, b in zip(after, before, strict=True)]
    assert all(len(one) == 1 for one in new)
    share = np.bincount([one.pop() for one in new], minlength=8) / 4000
    assert share == pytest.approx([0, 0.25, 0.25, 0, 0, 0.25, 0.25, 0], abs=0.03)
    assert np.array_equal(replace_one(before, 8, 0.0, rng()), before)
    assert np.array_equal(replace_one(before, 4, 1.0, rng()), before)  # nothing is left to take


def test_coding_leaves_forced_genes_alone() -> None:
    genome = fixed(9, 4, ("g2",), ("g5", "g6"))
    code = coding_of_genome(genome)
    assert (code.free.tolist(), code.m) == ([0, 2, 3, 6, 7, 8], 3)
    tuples = random_subsets(50, len(code.free), code.m, rng())
    genes = code.genes(tuples)
    assert np.array_equal(genome.repair(genes, rng()), genes)
    assert np.array_equal(code.tuples(genes), tuples)


@pytest.mark.parametrize(("least", "most"), [(2, 5), (0, None), (0, 3), (4, None)])
def test_coding_of_a_range_of_numbers(least: int, most: int | None) -> None:
    labels = tuple(f"g{i}" for i in range(9))
    genome = Genome([Bits("features", labels, least, most)], on=("g2",), off=("g5", "g6"))
    code = coding_of_genome(genome)
    genes = code.genes(random_subsets(500, code.numbers, code.m, rng()))
    assert np.array_equal(genome.repair(genes, rng()), genes)
    assert {max(least, 1) + 1, (most or 7) - 1} <= set(genes.sum(axis=1))
    assert np.array_equal(code.genes(code.tuples(genes)), genes)


def test_every_generation_has_m_features() -> None:
    problem = m_of_n("owdis-lines", 25)
    for generation in islice(SteadyStateGA().generations(problem, rng()), 10):
        assert (generation.genes.sum(axis=1) == 25).all()


def test_m_in_a_range() -> None:
    result = termsel.run("owdis-points", solver="ga-steady", generations=20,
                         options={"min_features": 11, "max_features": 16, "population": 50})
    assert result.feasible
    assert 11 <= len(result.selection.features) <= 16


def test_half_lives_on_and_immigrants_join() -> None:
    problem = m_of_n("owdis-lines", 25)
    solver = SteadyStateGA(population=40, crossover=0.0, mutation=0.0, immigrants=0.3)
    first, second = islice(solver.generations(problem, rng()), 2)
    best = first.evaluation.order()[:20]
    assert np.array_equal(second.genes[:20], first.genes[best])
    known = {one.tobytes() for one in first.genes}
    assert [one.tobytes() in known for one in second.genes[20:]] == [True] * 14 + [False] * 6


def test_of_equal_chromosomes_one_lives_on() -> None:
    genes = np.eye(6, dtype=bool)[[0, 0, 0, 1, 2, 2]]
    kept = SteadyStateGA().survivors(genes, judged(np.array([1.0, 1.0, 1.0, 2.0, 3.0, 3.0])))
    assert [int(genes[i].argmax()) for i in kept] == [0, 1, 2]
    # Something is bred in every generation, even if all could live on.
    different = np.eye(6, dtype=bool)
    kept = SteadyStateGA(overlap=1.0).survivors(different, judged(np.arange(6.0)))
    assert kept.tolist() == [0, 1, 2, 3, 4]


def test_steady_state_finds_the_best_22_of_24_points() -> None:
    problem = m_of_n("owdis-points", 22)
    dropped = np.array(list(combinations(range(24), 2)))
    genes = np.ones((len(dropped), 24), dtype=bool)
    np.put_along_axis(genes, dropped, False, axis=1)
    best = problem.evaluate(genes)
    optimum = best.objectives[best.order()[0], 0]
    found = search(problem, SteadyStateGA(), seed=1, evaluations=2000)
    assert found.objectives[0] == pytest.approx(optimum, rel=1e-12)


def test_what_is_not_m_of_n_is_refused() -> None:
    for name in ("rfm-terms", "owdis-points-terms"):
        with pytest.raises(TermselError, match=r"this problem chooses terms\.line, terms\.sample"):
            search(termsel.prepare(name).problem, SteadyStateGA(), generations=1)


# The number of features of a problem


@pytest.mark.parametrize(("options", "message"), [
    ({"min_features": 25}, "'min_features' is 25; there are 24 control features"),
    ({"max_features": 25}, "Give a number from 1 to 24"),
    ({"max_features": 0}, "whole number from 1 to 1,000,000"),
    ({"min_features": 14, "max_features": 13}, "is 14, more than 'max_features', 13"),
    ({"max_features": 9}, "gives 9 equations with at most 9 features. Raise max_features"),
])
def test_numbers_of_features_that_cannot_be(options: dict[str, int], message: str) -> None:
    with pytest.raises(TermselError, match=message):
        termsel.prepare("owdis-points", options=options)


@pytest.mark.slow_cases("owdis-lines", "owdis-lines-terms")
@pytest.mark.parametrize("problem", ["owdis-points", "owdis-lines", "owdis-points-terms",
                                     "owdis-lines-terms"])
def test_bounds_on_the_number_of_features_hold(problem: str) -> None:
    result = termsel.run(problem, generations=3, options={
        "min_features": 14, "max_features": 16, "population": 20})
    assert 14 <= result.to_dict()["selection"]["n_features"] <= 16


def test_the_two_best_are_the_parents_of_all() -> None:
    """Without mutation, children have a gene only if the best or the second best has it."""
    problem = termsel.prepare("poly-terms", solver="ga").problem
    solver = termsel.prepare("poly-terms", solver="ga", options={
        "parents": "two-best", "population": 30, "mutation": 0.0, "elite": 0,
        "max_share": 1}).solver
    first, second = islice(solver.generations(problem, np.random.default_rng(2)), 2)
    one, other = first.genes[first.evaluation.order()[:2]]
    assert (second.genes <= (one | other)).all()
    assert (second.genes >= (one & other)).all()
    assert len(np.unique(second.genes, axis=0)) > 1


# The first population


def first_of(genome: Genome, **options: object) -> np.ndarray:
    box = GeneticAlgorithm(population=400, **options).toolbox(Toy(genome, no_cost), rng())
    return np.asarray(box.population())


def no_cost(genes: np.ndarray) -> tuple[FloatArray, FloatArray]:
    return np.zeros((len(genes), 1)), np.zeros(len(genes))


def test_half_of_the_bits_are_on_at_first_if_asked() -> None:
    genome = Genome([Bits("b", tuple(f"b{i}" for i in range(80)))], on=("b0",), off=("b1",))
    shares, half = (first_of(genome, first=first)[:, 2:].mean(axis=1)
                    for first in ("shares", "half"))
    assert shares.std() > 0.2
    assert half.std() == pytest.approx(0.5 / np.sqrt(78), rel=0.2)
    assert half.mean() == pytest.approx(0.5, abs=0.01)
    genes = first_of(genome, first="half")
    assert genes[:, 0].all()
    assert not genes[:, 1].any()


@pytest.mark.parametrize(("budget", "all_near_half"), [(100, False), (200, False), (500, True)])
def test_a_short_search_begins_with_selections_of_all_sizes(budget: int,
                                                            all_near_half: bool) -> None:
    problem = problems.trap_problem(78)
    problem.budget = budget
    sizes = GeneticAlgorithm().toolbox(problem, rng()).population().sum(axis=1)
    assert ((sizes > 20) & (sizes < 58)).all() == all_near_half


@pytest.mark.parametrize("seed", [1, 2])
def test_a_hundred_evaluations_find_a_selection_that_meets_the_conditions(seed: int) -> None:
    problem = termsel.prepare("rfm-terms").problem
    found = search(problem, GeneticAlgorithm(), seed=seed, evaluations=100)
    assert found.violation == 0


def test_ga_beats_random_selections_within_two_hundred_evaluations() -> None:
    problem = termsel.prepare("poly-terms").problem
    by_ga, at_random = (
        [search(problem, solver, seed=seed, evaluations=200).objectives[0] for seed in (1, 2, 3)]
        for solver in (GeneticAlgorithm(), RandomSearch()))
    assert max(by_ga) < min(at_random)


def test_genes_that_are_no_bits_begin_as_ever() -> None:
    genome = Genome([Bits("b", tuple(f"b{i}" for i in range(80))), Reals("r", ("x",), 2.0, 3.0)])
    genes = first_of(genome, first="half")
    assert set(np.unique(genes[:, :80])) == {0.0, 1.0}
    assert genes[:, :80].mean(axis=1).std() < 0.1
    assert np.ptp(genes[:, 80]) > 0.9
    assert genes[:, 80].min() >= 2.0


@pytest.mark.parametrize("size", [1, 7, 78])
def test_two_point_crossover_swaps_what_lies_between_two_places(size: int) -> None:
    parents = np.zeros((400, size), dtype=bool)
    parents[1::2] = True
    children = cross_at_two_points(parents, 1.0, rng(3))
    first, second = children[::2], children[1::2]
    # Each gene is in one of two children, and what was swapped is one piece.
    assert (first ^ second).all()
    changes = (np.diff(first.astype(int), axis=1) != 0).sum(axis=1)
    assert (changes <= 2).all()
    assert 0 < first.any(axis=1).mean() <= 1
    assert (cross_at_two_points(parents, 0.0, rng()) == parents).all()


def test_bits_among_other_genes_are_crossed_between_two_places() -> None:
    genome = Genome([Bits("bits", tuple("abcdefgh")), Integers("number", ("n",), 0, 9)])
    parents = np.zeros((200, 9), dtype=np.intp)
    parents[1::2, :8] = 1
    children = cross_pairs(parents, genome, 1.0, rng(), points=2)
    changes = (np.diff(children[:, :8], axis=1) != 0).sum(axis=1)
    assert changes.max() == 2


def test_few_evaluations_suffice_for_fast_mutation() -> None:
    def reached(solver: Solver, evaluations: int) -> float:
        return float(np.median([search(problems.bounded_problem(), solver, seed=seed,
                                       evaluations=evaluations).objectives[0]
                                for seed in range(3)]))

    assert reached(FastMutation(), 150) <= reached(RandomSearch(), 300)


class Worsening(Problem):
    """Whatever is evaluated is worse than all before it, so that no child takes its parent's place.
    """

    objectives = ("evaluations",)

    def __init__(self, size: int) -> None:
        self.genome = Genome([Bits("bits", tuple(f"g{i}" for i in range(size)))])
        self.seen: list[BoolArray] = []

    def evaluate(self, genes: BoolArray) -> Evaluation:
        before = len(self.seen)
        self.seen += list(genes)
        return judged(np.arange(before, len(self.seen), dtype=float))

    def decode(self, genes: BoolArray) -> termsel.Selection:
        raise NotImplementedError


def test_fast_mutation_changes_ever_fewer_genes_of_a_parent() -> None:
    problem = Worsening(80)
    search(problem, FastMutation(), seed=1, evaluations=1000)
    parent, *children = problem.seen[:1] + problem.seen[10:]
    changed = np.array([(child != parent).sum() for child in children])
    # After t evaluations 80 x 1.54 ln(t) / t: 24 at the 11th, 5 at the 150th, 1 from the 960th.
    assert 12 <= changed[:10].mean() <= 32
    assert 3 <= changed[120:160].mean() <= 7
    assert changed[-100:].mean() < 2.5
    assert changed.min() == 1


def test_fast_mutation_ends_where_a_parent_has_no_other_child() -> None:
    genome = fixed(3, 2, on=("g1", "g2"))
    problem = Worsening(3)
    problem.genome = genome
    found = search(problem, FastMutation(), seed=1, evaluations=30)
    assert found.genes.tolist() == [True, True, False]


# Who survives


def zeros_cost(genes: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return the number of genes that are off."""
    return (~genes.astype(bool)).sum(axis=1)[:, None].astype(float), np.zeros(len(genes))


def test_the_best_of_parents_and_children_survive_without_copies() -> None:
    problem = Toy(Genome([Bits("terms", tuple(f"t{i}" for i in range(40)))]), zeros_cost)
    solver = GeneticAlgorithm(population=20, survival="best")
    generations = list(islice(solver.generations(problem, rng()), 15))
    worst = [generation.evaluation.objectives.max() for generation in generations]
    assert worst == sorted(worst, reverse=True)
    for generation in generations[1:]:
        assert len(np.unique(generation.genes, axis=0)) == 20


def test_a_space_smaller_than_the_population_has_copies() -> None:
    problem = Toy(Genome([Bits("terms", ("a", "b"))]), zeros_cost)
    solver = GeneticAlgorithm(population=8, survival="best")
    last = list(islice(solver.generations(problem, rng()), 4))[-1]
    assert len(last.genes) == 8


@pytest.mark.parametrize(("budget", "keeps_best"), [(None, False), (4_000, False), (13_200, True)])
def test_the_budget_decides_who_survives(budget: int | None, keeps_best: bool) -> None:
    problem = Toy(Genome([Bits("terms", ("a", "b"))]), zeros_cost)
    problem.budget = budget
    assert GeneticAlgorithm().keeps_best(problem) is keeps_best
    assert GeneticAlgorithm(survival="best").keeps_best(problem)
    assert not GeneticAlgorithm(survival="children").keeps_best(problem)
