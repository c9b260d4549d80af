"""Properties of the core that hold for whatever input."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from termsel.adjustment.equations import Equations, row_weights
from termsel.adjustment.solve import solve
from termsel.core.errors import TermselError
from termsel.data.features import BoolArray, FloatArray, Lines, Points
from termsel.models.base import SensorModel
from termsel.models.polynomial import Affine, Polynomial2D, Polynomial3D
from termsel.models.quotient import Blocks, RationalFunctions, RationalModel
from termsel.selection.criteria import CheckRmse
from termsel.selection.problems.base import Evaluation, Problem, ProblemData
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.segments import Bits
from termsel.selection.problems.selection import SelectionProblem
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.ledger import BudgetSpent, Ledger
from termsel.selection.solvers.search import search
from termsel.testing.problems import Toy, Watched, problem_of_twelve_terms, trap_problem
from termsel.testing.scenes import imaged_features, random_coefficients

# The same examples every time: a failure in a test of figures must not depend on luck.
settings.register_profile("core", deadline=None, derandomize=True, max_examples=40)
settings.load_profile("core")

seeds = st.integers(0, 2**32 - 1)


# Equations


class Dlt(RationalModel):
    """Direct linear transformation: one denominator for both axes."""

    name = "dlt-demo"

    def blocks(self, ground: FloatArray) -> Blocks:
        one = np.column_stack([np.ones(len(ground)), ground])
        return Blocks(line=one, sample=one, shared_denominator=ground)


EXACT_MODELS: list[SensorModel] = [
    *(RationalFunctions(order=order, denominators=kind)
      for order in (1, 2, 3) for kind in ("shared", "none")),
    Polynomial2D(degree=3), Polynomial3D(degree=2), Affine(), Dlt()]


@given(st.sampled_from(EXACT_MODELS), st.integers(0, 5), st.integers(1, 8), seeds)
def test_lines_on_their_image_leave_no_residual(model: SensorModel, n: int, m: int,
                                                seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = random_coefficients(model, rng)
    equations = model.equations(imaged_features(model, truth, rng, points=n, lines=m))
    np.testing.assert_allclose(equations.A @ truth, equations.b, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(equations.feature, np.repeat(np.arange(n + m), 2))


@given(st.integers(1, 3), st.integers(1, 9), seeds)
def test_points_leave_no_residual_under_separate_denominators(order: int, n: int,
                                                              seed: int) -> None:
    model, rng = RationalFunctions(order=order), np.random.default_rng(seed)
    truth = random_coefficients(model, rng)
    equations = model.equations(imaged_features(model, truth, rng, points=n))
    np.testing.assert_allclose(equations.A @ truth, equations.b, rtol=0, atol=1e-12)


@given(st.sampled_from(EXACT_MODELS), seeds, st.floats(-0.3, 0.3))
def test_line_residual_is_the_distance_from_the_image_line(model: SensorModel, seed: int,
                                                           shift: float) -> None:
    rng = np.random.default_rng(seed)
    truth = random_coefficients(model, rng)
    features = imaged_features(model, truth, rng, lines=3)
    along = features.lines.image[:, 1] - features.lines.image[:, 0]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    moved = Lines(features.lines.ids, features.lines.image + shift * normal[:, None],
                  features.lines.ground)
    equations = model.equations(features.with_(lines=moved))
    below = model.denominators(truth, features.lines.ground.reshape(-1, 3))
    # Rows are multiplied by the denominator, which both axes share.
    scale = row_weights(features.with_(lines=moved), heights=model.uses_height) * (
        1.0 if below is None else below[:, 0])
    np.testing.assert_allclose((equations.b - equations.A @ truth) / scale, shift, atol=1e-11)


# Adjustment


def make_system(m: int, k: int, rng: np.random.Generator) -> Equations:
    """Return a well-conditioned system of columns of different lengths."""
    q, _ = np.linalg.qr(rng.normal(size=(m, k)))
    A = (q + 0.1 * rng.normal(size=(m, k))) * 10.0 ** rng.uniform(-3, 3, k)
    return Equations(A, rng.normal(size=m), np.repeat(np.arange((m + 1) // 2), 2)[:m])


@given(st.integers(1, 12), st.integers(0, 20), seeds)
def test_solution_is_that_of_lstsq(k: int, redundancy: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    m = k + redundancy
    equations = make_system(m, k, rng)
    A, b = equations.A, equations.b
    lengths = np.linalg.norm(A, axis=0)
    assume(np.linalg.cond(A / lengths) < 1e4)
    found = solve(equations)
    x = np.linalg.lstsq(A / lengths, b, rcond=None)[0] / lengths
    np.testing.assert_allclose(found.coefficients * lengths, x * lengths, rtol=1e-8, atol=1e-10)
    assert (found.rank, found.violation, found.redundancy) == (k, 0, redundancy)
    assert found.condition == pytest.approx(np.linalg.cond(A / lengths), rel=1e-6)
    if redundancy == 0:
        assert np.isnan(found.sigma0)
        assert np.isnan(found.deviations).all()
        return
    v = b - A @ x
    variance = v @ v / redundancy
    cofactors = np.linalg.inv((A / lengths).T @ (A / lengths))
    assert found.sigma0 == pytest.approx(np.sqrt(variance), rel=1e-8)
    np.testing.assert_allclose(found.deviations * lengths, np.sqrt(variance * np.diag(cofactors)),
                               rtol=1e-7)


@given(st.integers(2, 10), st.integers(5, 12), seeds)
def test_masks_take_columns_and_features(k: int, n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    equations = make_system(2 * n, k, rng)
    terms, features = rng.random(k) < 0.6, rng.random(n) < 0.8
    found = solve(equations, terms, features)
    rows = np.repeat(features, 2)
    alone = solve(Equations(equations.A[np.ix_(rows, terms)], equations.b[rows],
                            np.repeat(np.arange(features.sum()), 2)))
    np.testing.assert_array_equal(found.coefficients[~terms], 0.0)
    np.testing.assert_array_equal(found.deviations[~terms], 0.0)
    np.testing.assert_allclose(found.coefficients[terms], alone.coefficients, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.deviations[terms], alone.deviations, rtol=1e-9)
    assert (found.n_terms, found.n_equations) == (terms.sum(), rows.sum())
    assert (found.rank, found.violation) == (alone.rank, alone.violation)


@given(st.integers(1, 10), st.integers(0, 12), st.integers(1, 4), seeds)
def test_dependent_columns_are_counted(k: int, redundancy: int, extra: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    equations = make_system(k + redundancy, k, rng)
    lengths = np.linalg.norm(equations.A, axis=0)
    assume(np.linalg.cond(equations.A / lengths) < 1e4)
    mixed = equations.A / lengths @ rng.normal(size=(k, extra))
    order = rng.permutation(k + extra)
    A = np.concatenate([equations.A, mixed], axis=1)[:, order]
    found = solve(Equations(A, equations.b, equations.feature))
    assert found.rank == k
    assert found.violation == extra
    assert not found.feasible
    assert np.isfinite(found.coefficients).all()


@given(st.integers(1, 10), st.integers(1, 10), st.integers(0, 3), seeds)
def test_too_few_equations(k: int, short: int, empty: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    m = max(k - short, 0)
    A = np.concatenate([rng.normal(size=(m, k)), np.zeros((m, empty))], axis=1)
    right = rng.normal(size=m)
    found = solve(Equations(A, right, np.arange(m)))
    assert found.violation == k + empty - m
    assert np.isfinite(found.coefficients).all()
    np.testing.assert_array_equal(found.coefficients[k:], 0.0)
    np.testing.assert_allclose(right - A @ found.coefficients, 0.0, atol=1e-6)


def test_dependent_columns_get_the_least_norm_solution() -> None:
    for seed in range(100):
        rng = np.random.default_rng(seed)
        column, b = rng.normal(size=8), rng.normal(size=8)
        factor = rng.normal()
        A = np.stack([column, factor * column], axis=1)
        found = solve(Equations(A, b, np.arange(8)))
        fitted = column * (column @ b) / (column @ column)
        np.testing.assert_allclose(A @ found.coefficients, fitted, atol=1e-7)


def test_undetermined_terms_have_no_standard_deviation() -> None:
    A = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])
    found = solve(Equations(A, np.array([1.0, 2.0, 3.5]), np.arange(3)))
    assert not found.feasible
    assert np.isnan(found.deviations).all()


# Genomes


@st.composite
def genomes(draw: st.DrawFn) -> Genome:
    """Return genomes whose forced genes leave room for the cardinality."""
    segments, on, off = [], [], []
    for name in "abc"[:draw(st.integers(1, 3))]:
        labels = tuple(f"{name}{i}" for i in range(draw(st.integers(1, 8))))
        forced = draw(st.lists(st.sampled_from(["on", "off", "free"]), min_size=len(labels),
                               max_size=len(labels)))
        least, most = forced.count("on"), len(labels) - forced.count("off")
        maximum = draw(st.one_of(st.none(), st.integers(least, len(labels))))
        top = most if maximum is None else min(most, maximum)
        segments.append(Bits(name, labels, draw(st.integers(0, top)), maximum))
        on += [x for x, kind in zip(labels, forced, strict=True) if kind == "on"]
        off += [x for x, kind in zip(labels, forced, strict=True) if kind == "off"]
    return Genome(segments, on=on, off=off)


@given(genomes(), st.integers(0, 20), seeds)
def test_repaired_genes_keep_the_rules(genome: Genome, n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    genes = rng.random((n, genome.size)) < rng.random()
    before = genes.copy()
    repaired = genome.repair(genes, rng)
    assert genome.keeps(repaired).all()
    np.testing.assert_array_equal(genes, before)
    np.testing.assert_array_equal(repaired[genome.keeps(genes)], genes[genome.keeps(genes)])
    np.testing.assert_array_equal(genome.repair(repaired, rng), repaired)
    drawn = genome.random(rng, n)
    assert drawn.shape == (n, genome.size)
    assert genome.keeps(drawn).all()
    first, second = (genome.random(np.random.default_rng(seed), n) for _ in range(2))
    np.testing.assert_array_equal(first, second)


# Record of a search


@given(st.lists(st.integers(0, 30), max_size=12), st.integers(1, 150), seeds)
def test_ledger_counts_exactly(batches: list[int], limit: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    problem = Watched(trap_problem())
    ledger = Ledger(problem, evaluations=limit)
    pool = problem.genome.random(rng, 40)
    met: set[bytes] = set()
    asked = 0
    for size in batches:
        genes = pool[rng.integers(0, len(pool), size)]
        allowed = min(size, limit - asked)
        met |= {row.tobytes() for row in genes[:allowed]}
        asked += allowed
        if not allowed:
            continue
        if allowed < size:
            with pytest.raises(BudgetSpent):
                ledger.evaluate(genes)
        else:
            found = ledger.evaluate(genes)
            true = problem.inner.evaluate(genes)
            np.testing.assert_array_equal(found.objectives, true.objectives)
            np.testing.assert_array_equal(found.violation, true.violation)
        assert ledger.count == asked
        assert problem.evaluated == len(met)
        assert ledger.lookups == asked - len(met)
        assert ledger.best == problem.best
        if met:
            assert ledger.best_genes is not None
            true = problem.inner.evaluate(ledger.best_genes[None])
            assert (true.violation[0], true.objectives[0, 0]) == ledger.best


class OneByOne(Solver):
    """Evaluates one individual at a time, several between generations."""

    name = "one-by-one"

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        index = 0
        while True:
            genes = problem.genome.random(rng, 10)
            ones = [problem.evaluate(genes[i:i + 1]) for i in range(10)]
            yield Generation(index, genes, Evaluation(
                np.concatenate([one.objectives for one in ones]),
                np.concatenate([one.violation for one in ones])))
            index += 1


def test_budget_spent_between_evaluations_of_one_generation() -> None:
    assert search(problem_of_twelve_terms(), OneByOne(), evaluations=15).evaluations == 15


@given(st.sampled_from([np.nan, np.inf, -np.inf]), st.booleans(), seeds)
def test_ledger_refuses_what_is_not_finite(bad: float, violated: bool, seed: int) -> None:
    def judge(genes: BoolArray) -> tuple[FloatArray, FloatArray]:
        objectives, violation = np.zeros((len(genes), 1)), np.zeros(len(genes))
        (violation if violated else objectives[:, 0])[-1] = bad
        return objectives, violation

    problem = Toy(trap_problem().genome, judge)
    genes = problem.genome.random(np.random.default_rng(seed), 5)
    with pytest.raises(TermselError, match="not finite"):
        Ledger(problem).evaluate(genes)


# Selection


def selection_problem(rng: np.random.Generator, order: int, kind: str, n: int, m: int,
                      selects: str, mask: str, flat: bool) -> SelectionProblem:
    model = RationalFunctions(order=order, denominators=kind)
    truth = random_coefficients(model, rng)
    control = imaged_features(model, truth, rng, points=n, lines=m)
    if flat and n:
        # On one straight line on the ground: hardly any term is determined.
        points = control.points
        line = points.ground[:, :1] * [[1.0, 0.5, 0.2]]
        control = control.with_(points=Points(points.ids, points.image, line))
    check = imaged_features(model, truth, rng, points=6).points
    check = Points(check.ids, check.image + rng.normal(0, 0.01, (6, 2)), check.ground)
    inputs = ProblemData(model, control, check, 5000.0, CheckRmse())
    return SelectionProblem(inputs, terms="terms" in selects, features="features" in selects,
                            mask=mask)


@given(st.integers(1, 3), st.sampled_from(["separate", "shared", "none"]), st.integers(0, 30),
       st.integers(0, 20), st.sampled_from(["terms", "features", "terms and features"]),
       st.sampled_from(["per-axis", "shared"]), st.booleans(), seeds)
def test_any_selection_has_a_finite_evaluation(
        order: int, kind: str, n: int, m: int, selects: str, mask: str, flat: bool,
        seed: int) -> None:
    assume(n + m >= 3)
    rng = np.random.default_rng(seed)
    try:
        problem = selection_problem(rng, order, kind, n, m, selects, mask, flat)
    except TermselError as error:
        # Without a choice of terms, too little control is refused before any search.
        if selects != "features" or "terms to be determined" not in str(error):
            raise
        return
    genes = rng.random((25, problem.genome.size)) < rng.random((25, 1))
    found = problem.evaluate(genes)
    assert found.objectives.shape == (25, 1)
    assert found.violation.shape == (25,)
    assert np.isfinite(found.objectives).all()
    assert np.isfinite(found.violation).all()
    assert (found.violation >= 0).all()
    # Alone or in company, an individual is worth the same.
    single = problem.evaluate(genes[7:8])
    np.testing.assert_allclose(single.objectives[0], found.objectives[7], rtol=1e-9)
    np.testing.assert_allclose(single.violation[0], found.violation[7], rtol=1e-9, atol=1e-12)
    selection = problem.decode(genes[7])
    assert set(selection.terms) <= set(problem.inputs.model.terms)
    assert set(selection.features) <= set(problem.inputs.control.ids)


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), min_size=1, max_size=20))
def test_order_puts_feasible_first(values: list[tuple[int, int]]) -> None:
    objectives = np.array([[v[0]] for v in values], dtype=float)
    evaluation = Evaluation(objectives, np.array([v[1] for v in values], dtype=float))
    ranked = [(values[i][1], values[i][0]) for i in evaluation.order()]
    assert ranked == sorted(ranked)
