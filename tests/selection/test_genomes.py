"""Genomes of any types: what is valid, and operators that keep it so."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import termsel
from termsel import (
    Bits,
    Categories,
    CustomSegment,
    Genome,
    Integers,
    Permutation,
    Reals,
    Subset,
    TermselError,
)
from termsel.plugins.registry import registry
from termsel.selection.problems.base import Evaluation, Selection
from termsel.selection.problems.segments import SEGMENTS, AnySegment, Genes
from termsel.selection.solvers.genetic.operators import cross_pairs, from_keys, mutate_genes, n_keys
from termsel.selection.solvers.heuristics.swap import neighbour_batches
from termsel.selection.solvers.ledger import Ledger
from termsel.selection.solvers.search import search
from termsel.testing.problems import Even, Toy


def labels(letter: str, n: int) -> tuple[str, ...]:
    return tuple(f"{letter}{i}" for i in range(n))


@st.composite
def segment(draw: st.DrawFn, name: str) -> AnySegment:
    kind = draw(st.sampled_from(SEGMENTS))
    n = draw(st.integers(1, 5))
    own = labels(name, n)
    if kind is Bits:
        least = draw(st.integers(0, n))
        return Bits(name, own, least, draw(st.integers(max(least, 1), n)))
    if kind is Integers:
        low = draw(st.lists(st.integers(-5, 5), min_size=n, max_size=n))
        return Integers(name, own, low, [one + draw(st.integers(0, 300)) for one in low])
    if kind is Reals:
        return Reals(name, own, draw(st.floats(-9, 0)), draw(st.floats(0, 1e6)))
    if kind is Categories:
        return Categories(name, own, labels("choice", draw(st.integers(1, 4))))
    if kind is Permutation:
        return Permutation(name, own)
    if kind is CustomSegment:
        return Even(name, own)
    return Subset(name, own, draw(st.integers(0, n)))


@st.composite
def genomes(draw: st.DrawFn) -> Genome:
    segments = [draw(segment(name)) for name in "abc"[:draw(st.integers(1, 3))]]
    switched = [s for s in segments if isinstance(s, Bits | Subset)
                and 1 <= s.most < len(s.labels) and len(s.labels) > 1]
    on = [s.labels[0] for s in switched if draw(st.booleans())]
    off = [s.labels[-1] for s in switched if draw(st.booleans())
           and s.minimum < len(s.labels)]
    return Genome(segments, on=on, off=off)


def valid(genome: Genome, genes: Genes) -> None:
    assert genome.fault(genes) is None
    assert genome.keeps(genes).all()


@given(genomes(), st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_operators_keep_types_bounds_and_cardinality(genome: Genome, seed: int,
                                                     rate: float) -> None:
    rng = np.random.default_rng(seed)
    genes = genome.random(rng, 7)
    valid(genome, genes)
    np.testing.assert_array_equal(genome.repair(genes, rng), genes)
    before = genes.copy()
    for changed in (cross_pairs(genes, genome, rate, rng), mutate_genes(genes, genome, rate, rng)):
        assert changed.dtype == genome.dtype
        valid(genome, genome.repair(changed, rng))
        unforced = Genome([s if not isinstance(s, Bits) else Bits(s.name, s.labels)
                           for s in genome.segments])
        assert unforced.fault(changed) is None
    np.testing.assert_array_equal(genes, before)
    np.testing.assert_array_equal(cross_pairs(genes, genome, 0.0, rng), genes)
    np.testing.assert_array_equal(mutate_genes(genes, genome, 0.0, rng), genes)


@given(genomes(), st.integers(0, 2**32 - 1))
def test_neighbours_are_valid_and_others(genome: Genome, seed: int) -> None:
    genes = genome.random(np.random.default_rng(seed), 1)[0]
    around = [one for batch in neighbour_batches(genes, genome) for one in batch]
    if around:
        valid(genome, np.array(around))
        assert len({one.tobytes() for one in around} | {genes.tobytes()}) == len(around) + 1
        changed = [[name for name, where in genome.slices().items()
                    if (one[where] != genes[where]).any()] for one in around]
        assert all(len(names) == 1 for names in changed)


@given(genomes(), st.integers(0, 2**32 - 1))
def test_keys_and_any_numbers_become_valid_genes(genome: Genome, seed: int) -> None:
    rng = np.random.default_rng(seed)
    valid(genome, genome.repair(from_keys(rng.random((5, n_keys(genome))), genome), rng))
    valid(genome, genome.repair(rng.normal(0.0, 50.0, (5, genome.size)), rng))


@given(genomes(), st.integers(0, 2**32 - 1))
def test_the_ledger_knows_individuals_apart_and_returns_them(genome: Genome, seed: int) -> None:
    genes = genome.random(np.random.default_rng(seed), 20)
    figure = np.random.default_rng(1).random(genome.size) if genome.size else np.zeros(0)
    ledger = Ledger(Toy(genome, lambda x: (np.column_stack([x @ figure, -(x @ figure)]),
                                           np.zeros(len(x))), ("one", "other")))
    found = ledger.evaluate(genes)
    np.testing.assert_allclose(found.objectives[:, 0], genes @ figure)
    different = {one.tobytes() for one in genes}
    assert ledger.count - ledger.lookups == len(different)
    for one in ledger.front():
        assert one.tobytes() in different


def test_a_negative_zero_is_a_zero() -> None:
    genome = Genome([Reals("r", ("x",), -1, 1)])
    ledger = Ledger(Toy(genome, lambda x: (np.abs(x), np.zeros(len(x)))))
    ledger.evaluate(np.array([[0.0], [-0.0]]))
    assert (ledger.count, ledger.lookups) == (2, 1)


def mixed() -> Genome:
    return Genome([Bits("b", labels("b", 6), 2, 4), Integers("i", labels("i", 2), 0, (3, 100)),
                   Reals("r", labels("r", 2), -1, 1), Categories("c", ("c0",), ("x", "y", "z")),
                   Permutation("p", labels("p", 5)), Subset("s", labels("s", 9), 3)],
                  on=("b1", "s8"), off=("b0", "s0"))


def distance(genome: Genome) -> Toy:
    """The distance to one individual: 0 at it alone."""
    best = {"i": [2, 40], "r": [0.25, -0.75], "c": [1], "p": [4, 2, 0, 1, 3], "s": [2, 5, 8]}

    def judge(genes: Genes) -> tuple[np.ndarray, np.ndarray]:
        cost = (genome.chosen(genes)[:, :6] != [0, 1, 0, 1, 1, 0]).sum(axis=1).astype(float)
        for name, values in best.items():
            cost += np.abs(genome.part(genes, name) - values).sum(axis=1)
        return cost[:, None], np.zeros(len(genes))

    return Toy(genome, judge)


def test_values_are_what_the_genes_mean() -> None:
    genome = mixed()
    genes = np.array([0, 1, 0, 1, 1, 0, 2, 40, 0.25, -0.75, 1, 4, 2, 0, 1, 3, 2, 5, 8.0])
    assert genome.values(genes) == {
        "b": ("b1", "b3", "b4"), "i": {"i0": 2, "i1": 40}, "r": {"r0": 0.25, "r1": -0.75},
        "c": {"c0": "y"}, "p": ("p4", "p2", "p0", "p1", "p3"), "s": ("s2", "s5", "s8")}
    assert distance(genome).evaluate(genes[None]).objectives[0, 0] == 0
    assert genome.part(genes[None], "s").tolist() == [[2, 5, 8]]


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["ga", "pso", "swap"])
def test_solvers_find_an_individual_of_mixed_genes(solver: str) -> None:
    found, again = (search(distance(mixed()), registry().get("solvers", solver)(),
                           evaluations=20_000, polish=True) for _ in range(2))
    assert found.objectives[0] < 1e-4
    np.testing.assert_array_equal(found.genes, again.genes)


def test_deap_keeps_mixed_genes() -> None:
    genome, one = mixed(), distance(mixed())

    def judge(genes: Genes) -> tuple[np.ndarray, np.ndarray]:
        valid(genome, genes)
        return one.evaluate(genes).objectives, np.zeros(len(genes))

    first = search(Toy(genome, judge), registry().get("solvers", "deap")(population=20),
                   generations=1).objectives[0]
    assert search(Toy(genome, judge), registry().get("solvers", "deap")(population=20),
                  generations=8).objectives[0] < first


@pytest.mark.slow_cases("age-moea2")
@pytest.mark.parametrize("solver", ["nsga2", "age-moea2", "sms-emoa", "spea2"])
def test_pymoo_keeps_mixed_genes(solver: str) -> None:
    genome, one = mixed(), distance(mixed())

    def judge(genes: Genes) -> tuple[np.ndarray, np.ndarray]:
        valid(genome, genes)
        return (np.column_stack([one.evaluate(genes).objectives, genes[:, 7]]),
                np.zeros(len(genes)))

    found = search(Toy(genome, judge, ("distance", "i1")),
                   registry().get("solvers", solver)(population=30), generations=20)
    assert len(found.front) > 3
    for genes in found.front:
        valid(genome, genes[None])


def subset_problem() -> Toy:
    genome = Genome([Subset("features", labels("f", 30), 6)], on=("f3",), off=("f4",))
    weight = np.random.default_rng(0).random(30)
    return Toy(genome, lambda x: ((genome.chosen(x) @ weight)[:, None], np.zeros(len(x))))


def test_children_of_subsets_keep_what_both_parents_have() -> None:
    # 5 is first in one parent and last in the other, so that no column holds it in both.
    genome = Genome([Subset("s", labels("s", 12), 4)])
    genes = np.tile([[5, 7, 9, 11], [0, 2, 4, 5]], (50, 1))
    children = cross_pairs(genes, genome, 1.0, np.random.default_rng(1))
    assert (children == 5).any(axis=1).all()
    assert len({tuple(child) for child in children.tolist()}) > 10


@pytest.mark.parametrize("solver", ["ga-steady", "ga", "pso", "swap"])
def test_solvers_find_the_best_subset(solver: str) -> None:
    problem = subset_problem()
    found = search(problem, registry().get("solvers", solver)(), evaluations=2000, polish=True)
    weight = np.random.default_rng(0).random(30)
    others = np.argsort(weight)
    best = {3, *[int(i) for i in others if i not in (3, 4)][:5]}
    assert set(found.genes.tolist()) == best


@pytest.mark.parametrize(("wrong", "said"), [
    (lambda g: g.astype(np.float32),
     "the type float32 and the shape (1, 19); expected float64 and (n, 19)"),
    (lambda g: g[:, 1:], "the shape (1, 18)"),
    (lambda g: g[0], "the shape (19,)"),
    (lambda g: g.tolist(), "asks for an evaluation of genes of the type list; expected float64"),
    (lambda g: put(g, 0, 0.5), "those of 'b' are not all 0 or 1"),
    (lambda g: put(g, 7, 101), "those of 'i' have 101 for 'i1', which is from 0 to 100"),
    (lambda g: put(g, 7, 1.5), "those of 'i' are not all whole numbers"),
    (lambda g: put(g, 8, np.nan), "those of 'r' have nan for 'r0', which is from -1 to 1"),
    (lambda g: put(g, 10, 3), "those of 'c' are not all from 0 to 2"),
    (lambda g: put(g, 11, 2), "those of 'p' are no permutation of 0 to 4"),
    (lambda g: put(g, 16, 8), "those of 's' are not 3 different whole numbers from 0 to 8"),
])
def test_wrong_genes_are_refused_with_the_name_of_their_solver(
        wrong: Callable[[Genes], Genes], said: str) -> None:
    class Careless(termsel.Solver):
        name = "careless"
        segments = SEGMENTS

        def generations(self, problem, rng):  # type: ignore[no-untyped-def]
            genes = wrong(genome.random(rng, 1))
            yield termsel.Generation(0, genes, problem.evaluate(genes))

    genome = mixed()
    with pytest.raises(TermselError) as error:
        search(distance(genome), Careless())
    assert "solver 'careless' of" in str(error.value)
    assert said in str(error.value)


def put(genes: Genes, column: int, value: float) -> Genes:
    genes[:, column] = value
    return genes


@pytest.mark.parametrize(("make", "said"), [
    (lambda: Integers("i", ("a", "b"), 0, (3,)), "bounds of segment 'i' are not 2 pairs"),
    (lambda: Integers("i", ("a",), 2, 1), "the lower one first"),
    (lambda: Reals("r", ("a",), 0, np.inf), "finite"),
    (lambda: Categories("c", ("a",), ()), "segment 'c' has no choices"),
    (lambda: Subset("s", ("a",), 2), "segment 's' cannot choose 2 of 1"),
    (lambda: Genome([Reals("r", ("a",), 0, 1)], on=("a",)), "unknown gene 'a'"),
    (lambda: Genome([Subset("s", ("a", "b", "c"), 2)], off=("a", "b")), "2 to 2 of the 3 genes"),
    (lambda: Genome([Bits("s", ("a",)), Permutation("s", ("b",))]), "the same name: s, s"),
])
def test_segments_that_cannot_be(make: Callable[[], object], said: str) -> None:
    with pytest.raises(TermselError, match=said):
        make()


@pytest.mark.parametrize("solver", ["ica", "exact", "all-terms"])
def test_a_solver_for_bits_alone_is_refused_and_others_named(solver: str) -> None:
    class Mine(termsel.Problem):
        genome = mixed()
        objectives = ("distance",)

        def __init__(self, inputs: termsel.ProblemData) -> None:
            pass

        def evaluate(self, genes: Genes) -> Evaluation:
            return distance(self.genome).evaluate(genes)

        def decode(self, genes: Genes) -> Selection:
            return Selection((), ())

    recipe = termsel.Recipe("mine", "Mixed genes.", Mine, model="affine", dataset="ikonos-hamedan")
    with pytest.raises(TermselError, match=r"handles genes of the type Bits(, Subset)?; those of "
                                           r"'i' are Integers") as error:
        termsel.prepare(recipe, solver=solver)
    assert "Choose one of: ga, fast-ea, pso, swap, random" in str(error.value)
    assert "deap, pymoo" in str(error.value)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 12))
def test_bits_and_a_subset_have_the_same_neighbours(seed: int, n: int, m: int) -> None:
    m = min(n, m)
    subset, bits = (Genome([one]) for one in (Subset("s", labels("s", n), m),
                                              Bits("s", labels("s", n), m, m)))
    genes = subset.random(np.random.default_rng(seed), 1)
    around = [tuple(np.flatnonzero(one))
              for batch in neighbour_batches(subset.chosen(genes)[0], bits)
              for one in batch]
    assert around == [tuple(one) for batch in neighbour_batches(genes[0], subset) for one in batch]


@pytest.mark.parametrize("fault", [
    lambda ones: 0.3 * ones, lambda ones: np.nan * ones, lambda ones: 2 * ones, lambda ones: -ones,
    lambda ones: ones[:, 1:], lambda ones: ones[0], lambda _: [[1, 0], [1]],
    lambda ones: ones.astype(str)])
def test_what_are_no_bits_is_not_evaluated(fault: Callable[[np.ndarray], object]) -> None:
    # As bool, 0.3, NaN and -1 would all be on: every selection would be the same.
    problem = termsel.prepare("poly-terms", options={"degree": 2}).problem
    ones = np.ones((2, problem.genome.size))

    with pytest.raises(TermselError, match="the problem got genes"):
        problem.evaluate(fault(ones))  # type: ignore[arg-type]


@pytest.mark.parametrize("recipe", ["poly-degree", "rpc-gcps"])
def test_what_is_out_of_range_is_not_evaluated(recipe: str) -> None:
    # A point that is named twice would count once, and leave fewer than were asked for.
    problem = termsel.prepare(recipe).problem

    for genes in (np.full((2, problem.genome.size), 99), np.full((1, problem.genome.size), 1.5),
                  np.full((1, problem.genome.size), -1)):
        with pytest.raises(TermselError, match="the problem got genes"):
            problem.evaluate(genes)


def test_zeros_and_ones_of_any_type_are_bits() -> None:
    problem = termsel.prepare("poly-terms", options={"degree": 2}).problem
    genes = problem.genome.random(np.random.default_rng(1), 5)
    expected = problem.evaluate(genes).objectives

    for given_genes in (genes.astype(int), genes.astype(float), genes.tolist()):
        np.testing.assert_array_equal(problem.evaluate(given_genes).objectives, expected)
    assert problem.decode(genes[0].astype(int)) == problem.decode(genes[0])
    with pytest.raises(TermselError, match="the problem got genes"):
        problem.decode(0.3 * np.ones(problem.genome.size))
