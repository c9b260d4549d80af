"""Solvers that choose terms by regression, against formulas and refits written out here."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats

pytest.importorskip("termsel_optimisers", reason="termsel-optimisers is not installed: "
                    "pip install -e plugins/termsel-optimisers")

import termsel
from termsel import Equations, FeatureSet, LeastSquares, Points, Regression, TermRegression
from termsel.toolkit import solve
from termsel.toolkit.searches import regressions_of_problem
from termsel_optimisers.rivals.lasso import Lasso, PathSegment, lasso_path
from termsel_optimisers.rivals.nested import (
    NestedRegression,
    explained_shares,
    rational_errors,
    rms_of_targets,
)
from termsel_optimisers.rivals.scatter import ScatterMatrix
from termsel_optimisers.rivals.stepwise import (
    Stepwise,
    TTest,
    gains_of_entering,
    independent_columns,
    losses_of_leaving,
    p_value_of_change,
)
from tests.regressions import part_of, sparse, square

SELECTORS = (Stepwise, TTest, Lasso, ScatterMatrix)


def flipped(chosen: np.ndarray, j: int) -> np.ndarray:
    return np.asarray(chosen ^ (np.arange(len(chosen)) == j))


# The tests of significance

def test_gains_and_losses_are_those_of_refits() -> None:
    part, _ = sparse(1, r=2)
    chosen = np.zeros(12, dtype=bool)
    chosen[[0, 1, 2, 6]] = True
    gain, before = gains_of_entering(part, chosen)
    loss, same = losses_of_leaving(part, chosen)
    assert before == pytest.approx(square(part, chosen))
    assert same == pytest.approx(before)
    for j in range(12):
        other = square(part, flipped(chosen, j))
        if chosen[j]:
            assert loss[j] == pytest.approx(other - before)
        else:
            assert gain[j] == pytest.approx(before - other)
            assert np.isinf(loss[j])


def test_a_loss_is_the_square_of_t() -> None:
    part, _ = sparse(2)
    chosen = np.ones(12, dtype=bool)
    adjusted = solve(Equations(part.columns, part.target[:, 0], np.arange(40)))
    loss, rest = losses_of_leaving(part, chosen)
    t = adjusted.coefficients / adjusted.deviations
    np.testing.assert_allclose(loss / (rest / 28), t**2, rtol=1e-9)
    for j in range(12):
        assert p_value_of_change(part, loss[j], rest, chosen) == pytest.approx(
            2 * stats.t.sf(abs(t[j]), 28), rel=1e-9)


def test_significance_of_a_line_through_five_points() -> None:
    # y = 1, 3, 2, 5, 4 at x = -2 ... 2: slope 8/10, regression 6.4 and residual 3.6 of 10,
    # F = 6.4 / (3.6 / 3) = 16/3.
    columns = np.column_stack([np.ones(5), np.arange(-2.0, 3.0)])
    part = part_of(columns, np.array([1.0, 3.0, 2.0, 5.0, 4.0]))
    both = np.ones(2, dtype=bool)
    loss, rest = losses_of_leaving(part, both)
    assert (loss[1], rest) == pytest.approx((6.4, 3.6))
    expected = stats.f.sf(16 / 3, 1, 3)
    assert p_value_of_change(part, loss[1], rest, both) == pytest.approx(expected)
    assert expected == pytest.approx(
        stats.linregress(columns[:, 1], part.target[:, 0]).pvalue)
    # With an image of two axes: the same again next to it, twice the degrees of freedom.
    double = part_of(columns, np.column_stack([part.target, part.target]))
    assert p_value_of_change(double, 12.8, 7.2, both) == pytest.approx(stats.f.sf(16 / 3, 2, 6))


def p_value(part: Regression, smaller: np.ndarray, larger: np.ndarray) -> float:
    """Return the p value of the partial F test of one column, from two refits."""
    m, r = part.target.shape
    rest, freedom = square(part, larger), r * (m - int(larger.sum()))
    return float(stats.f.sf((square(part, smaller) - rest) / r / (rest / freedom), r, freedom))


def stepwise(part: Regression, alpha_in: float, alpha_out: float) -> np.ndarray:
    """Return what stepwise regression chooses, every test from two refits."""
    chosen = part.kept.copy()
    while True:
        out = [j for j in range(len(chosen)) if not chosen[j]]
        if not out or chosen.sum() >= part.most:
            return chosen
        p = {j: p_value(part, chosen, flipped(chosen, j)) for j in out}
        best = min(out, key=lambda j: square(part, flipped(chosen, j)))
        if p[best] >= alpha_in:
            return chosen
        chosen = flipped(chosen, best)
        while True:
            inside = [j for j in range(1, len(chosen)) if chosen[j]]
            p = {j: p_value(part, flipped(chosen, j), chosen) for j in inside}
            worst = max(inside, key=p.__getitem__)
            if p[worst] <= alpha_out:
                break
            chosen = flipped(chosen, worst)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("r", [1, 2])
def test_stepwise_is_that_of_explicit_f_tests(seed: int, r: int) -> None:
    part, _ = sparse(seed, m=14, k=12, r=r, noise=2.0)
    # Columns that lean on one another, so that some leave again.
    part.columns[:, 8] = part.columns[:, 2] + part.columns[:, 5] + 0.3 * part.columns[:, 8]
    for alpha_in, alpha_out in ((0.05, 0.10), (0.3, 0.3), (0.9, 0.95)):
        chosen = Stepwise(alpha_in=alpha_in, alpha_out=alpha_out).choose(part)
        np.testing.assert_array_equal(chosen, stepwise(part, alpha_in, alpha_out))


def test_stepwise_drops_what_others_make_superfluous() -> None:
    rng = np.random.default_rng(5)
    a, b = rng.normal(size=(2, 60))
    columns = np.column_stack([np.ones(60), a, b, a + b + 0.4 * rng.normal(size=60)])
    part = part_of(columns, a + b + 0.01 * rng.normal(size=60))
    assert gains_of_entering(part, part.kept)[0].argmax() == 3  # it enters first
    np.testing.assert_array_equal(Stepwise().choose(part), [True, True, True, False])


def test_stepwise_refuses_thresholds_that_go_in_circles() -> None:
    with pytest.raises(termsel.TermselError, match="alpha_out"):
        Stepwise(alpha_in=0.2, alpha_out=0.1).choose(sparse(1)[0])


@pytest.mark.parametrize("seed", range(6))
def test_t_test_is_backward_elimination_by_t(seed: int) -> None:
    part, _ = sparse(seed, m=20, k=12, noise=2.0)
    chosen = np.ones(12, dtype=bool)
    while True:
        adjusted = solve(Equations(part.columns, part.target[:, 0], np.arange(20)), chosen)
        with np.errstate(invalid="ignore"):
            t = np.abs(adjusted.coefficients / adjusted.deviations)
        t[~chosen | part.constant] = np.inf
        if 2 * stats.t.sf(t.min(), adjusted.redundancy) <= 0.05:
            break
        chosen[t.argmin()] = False
    np.testing.assert_array_equal(TTest().choose(part), chosen)


def test_elimination_begins_with_the_first_independent_columns() -> None:
    rng = np.random.default_rng(7)
    columns = np.column_stack([np.ones(8), rng.normal(size=(8, 11))])
    columns[:, 3] = columns[:, 1] - 2 * columns[:, 2]
    columns[:, 5] = 0.0
    part = part_of(columns, rng.normal(size=8))
    assert np.flatnonzero(independent_columns(part, 12)).tolist() == [0, 1, 2, 4, 6, 7, 8, 9]
    assert np.flatnonzero(independent_columns(part, 5)).tolist() == [0, 1, 2, 4, 6]
    assert np.linalg.matrix_rank(columns[:, independent_columns(part, 12)]) == 8
    # By default a quarter of the equations is left to test with.
    begins = TTest(alpha=1.0).choose(part)
    assert np.flatnonzero(begins).tolist() == [0, 1, 2, 4, 6, 7]
    assert TTest(alpha=1.0, redundancy=1).choose(part).sum() == 7
    assert TTest(redundancy=9).choose(part).tolist() == part.kept.tolist()


# Recovery

@pytest.mark.parametrize("solver", SELECTORS)
@pytest.mark.parametrize("r", [1, 2])
def test_the_truth_is_found(solver: type[TermRegression], r: int) -> None:
    for seed in range(3):
        part, true = sparse(seed, r=r)
        chosen = solver().choose(part)
        assert chosen[true].all()
        assert chosen.sum() <= true.sum() + 4


@pytest.mark.parametrize("solver", SELECTORS)
def test_without_noise_nothing_but_the_truth_is_found(solver: type[TermRegression]) -> None:
    part, true = sparse(2, noise=0.0)
    chosen = solver().choose(part)
    assert chosen[true].all()
    if solver is Stepwise:
        np.testing.assert_array_equal(chosen, true)


@pytest.mark.parametrize("solver", SELECTORS)
def test_a_bilinear_image_is_found_among_polynomials(solver: type[TermRegression]) -> None:
    rng = np.random.default_rng(8)
    xy = rng.uniform(-1.0, 1.0, (60, 2))
    xy[:4] = [[-1, -1], [1, -1], [-1, 1], [1, 1]]  # control keeps its scaling
    x, y = xy.T
    image = np.column_stack([4000 + 3000 * x + 200 * y + 90 * x * y,
                             5000 - 300 * x + 2800 * y + 80 * x * y])
    points = Points(tuple(f"p{i}" for i in range(60)), image + 0.2 * rng.normal(size=(60, 2)),
                    np.column_stack([5e5 + 1e4 * xy, np.zeros(60)]), None,
                    ("control",) * 36 + ("check",) * 12 + ("independent",) * 12)
    task = termsel.prepare("poly-terms", features=FeatureSet(points, crs="local"),
                           options={"degree": 4})
    terms = task.problem.decode(termsel.search(task.problem, solver()).genes).terms
    assert {f"{axis}.num:{name}" for axis in ("line", "sample")
            for name in ("1", "X", "Y", "XY")} <= set(terms)
    assert len(terms) < 20


# Nested regression

def test_nested_regression_by_hand() -> None:
    # Orthogonal columns of length 2: the residuals of the constant lie 6 along the second
    # column, 2.4 along the third, 0.2 along the fourth. RMS: 3.23, 1.20, 0.1, 0.
    columns = np.array([[1.0, 1, 1, 1], [1, 1, -1, -1], [1, -1, 1, -1], [1, -1, -1, 1]])
    columns = np.repeat(columns, 2, axis=0) / np.sqrt(2)
    target = columns @ np.array([5.0, 3.0, 1.2, 0.1]) * np.sqrt(2)

    def terms(thumb: float, pixels: float = 1.0) -> list[int]:
        part = part_of(columns, target, pixels=pixels)
        return np.flatnonzero(NestedRegression(thumb=thumb).choose(part)).tolist()

    part = part_of(columns, target)
    share = explained_shares(part, part.kept, rational_errors(part, part.kept))
    np.testing.assert_allclose(share, np.array([0.0, 9.0, 1.44, 0.01]) / 10.45, atol=1e-12)
    assert terms(3.3) == [0, 1]          # 1.20 and a change of 2.03 are both below
    assert terms(1.9) == [0, 1, 2]       # 1.20 is, but the change of 2.03 is not
    assert terms(1.15) == [0, 1, 2]      # 0.1, change 1.10
    assert terms(1.05) == [0, 1, 2, 3]   # the change of 1.10 is not
    assert terms(115.0, pixels=100.0) == terms(1.15)
    # With one mask for both axes, one that is good enough does not end the search for the other.
    both = columns @ np.array([[5.0, 3.0, 2.9, 2.8], [5.0, 0.1, 0.1, 0.1]]).T * np.sqrt(2)
    chosen = NestedRegression(thumb=1.5).choose(part_of(columns, both))
    assert np.flatnonzero(chosen).tolist() == [0, 1, 2, 3]


def centred_r2(errors: np.ndarray, column: np.ndarray) -> float:
    """Return R^2 as the authors' code has it: about the mean, of a fit without intercept."""
    fitted = column * (column @ errors) / (column @ column)
    return float(((fitted - errors.mean()) ** 2).sum() / ((errors - errors.mean()) ** 2).sum())


@pytest.mark.parametrize("seed", range(5))
def test_nested_regression_of_a_polynomial_is_that_of_the_authors(seed: int) -> None:
    part, _ = sparse(seed, m=15, k=20, noise=1.0)
    thumb, y = 0.6, part.target[:, 0]
    chosen = [0]
    errors, before = y - y.mean(), np.sqrt(((y - y.mean()) ** 2).mean())
    while len(chosen) < 14:
        sign = {}
        for j in set(range(20)) - set(chosen):
            r2 = centred_r2(errors, part.columns[:, j])
            sign[j] = 1000 * r2 / (1 - r2)
        chosen.append(max(sign, key=sign.__getitem__))
        A = part.columns[:, chosen]
        errors = y - A @ np.linalg.lstsq(A, y)[0]
        now = np.sqrt((errors**2).mean())
        if abs(before - now) < thumb and now < thumb:
            break
        before = now
    found = NestedRegression(thumb=thumb).choose(part)
    assert np.flatnonzero(found).tolist() == sorted(chosen)


def test_residuals_of_nested_regression_are_those_of_the_quotient() -> None:
    task = termsel.prepare("rfm-terms")
    problem = task.problem
    for side, part in enumerate(regressions_of_problem(problem)):
        chosen = NestedRegression().choose(part)
        terms = np.zeros(78, dtype=bool)
        terms[part.genes[chosen]] = True
        control = task.observations.control
        fitted = LeastSquares().fit(task.model, control, task.scaling, terms,
                                    np.ones(len(control), dtype=bool))
        errors = fitted.errors(control.points)[:, side]
        np.testing.assert_allclose(
            rational_errors(part, chosen)[:, 0] * part.pixels, errors, atol=1e-6)
        assert 2 <= chosen.sum() <= 23
        assert rms_of_targets(errors[:, None])[0] < 0.5 or chosen.sum() == 23


@pytest.mark.parametrize(("noise", "thumb"), [(0.1, 0.15), (0.0, 1e-9)])
@pytest.mark.parametrize("r", [1, 2])
def test_the_truth_is_found_by_nested_regression(noise: float, thumb: float, r: int) -> None:
    for seed in range(3):
        part, true = sparse(seed, r=r, noise=noise)
        chosen = NestedRegression(thumb=thumb).choose(part)
        assert chosen[true].all()
        assert chosen.sum() <= true.sum() + 4


# Lasso

def conditions_hold(columns: np.ndarray, target: np.ndarray, piece: PathSegment, share: float,
                    ) -> None:
    """Assert the conditions of Karush, Kuhn and Tucker somewhere on a piece."""
    x = piece.start + share * (piece.end - piece.start)
    penalty = piece.above + share * (piece.below - piece.above)
    slope = columns.T @ (target - columns @ x)
    size = np.linalg.norm(slope, axis=1)
    assert (size <= penalty + 1e-10).all()
    np.testing.assert_allclose(size[piece.active], penalty, atol=1e-10)
    assert not np.delete(x, piece.active, axis=0).any()
    if target.shape[1] == 1 and penalty > 1e-8:
        used = np.abs(x[:, 0]) > 1e-9
        assert (np.sign(x[used, 0]) == np.sign(slope[used, 0])).all()


@pytest.mark.parametrize(("m", "k", "r"), [(30, 10, 1), (24, 39, 1), (12, 39, 1), (30, 10, 2)])
def test_the_path_keeps_the_conditions_of_the_lasso(m: int, k: int, r: int) -> None:
    rng = np.random.default_rng(m + k)
    columns = rng.normal(size=(m, k))
    columns[:, 3] = columns[:, 2] + 1e-3 * rng.normal(size=m)
    columns /= np.linalg.norm(columns, axis=0)
    target = columns[:, :4] @ rng.normal(size=(4, r)) + 0.1 * rng.normal(size=(m, r))
    path = lasso_path(columns, target, m - 1)
    assert path[0].above == pytest.approx(np.linalg.norm(columns.T @ target, axis=1).max())
    for piece, following in itertools.pairwise(path):
        assert piece.below == following.above
        np.testing.assert_array_equal(piece.end, following.start)
    for piece, share in itertools.product(path, (0.0, 0.4, 1.0)):
        conditions_hold(columns, target, piece, share)
    if m > k:
        np.testing.assert_allclose(path[-1].end, np.linalg.lstsq(columns, target)[0], atol=1e-8)
    if k > m:  # columns leave on the way, so that this is the lasso and not forward alone
        sizes = [len(piece.active) for piece in path]
        assert max(sizes) == m - 1
        assert any(later < earlier for earlier, later in itertools.pairwise(sizes))


def test_the_path_on_orthogonal_columns_is_soft_thresholding() -> None:
    columns = np.eye(6)[:, :4]
    target = np.array([[3.0], [-2.0], [0.5], [1.0], [9.0], [9.0]])
    path = lasso_path(columns, target, 4)
    assert [piece.above for piece in path] == pytest.approx([3.0, 2.0, 1.0, 0.5])
    assert [piece.active.tolist() for piece in path] == [[0], [0, 1], [0, 1, 3], [0, 1, 3, 2]]
    np.testing.assert_allclose(path[2].end[:, 0], [2.5, -1.5, 0.0, 0.5])


def test_the_path_of_nothing_and_of_twins() -> None:
    columns = np.eye(5)[:, :3]
    assert lasso_path(columns, np.zeros((5, 1)), 3) == []
    assert lasso_path(columns, np.ones((5, 1)), 0) == []
    assert lasso_path(columns[:, :0], np.ones((5, 1)), 3) == []
    twins = lasso_path(np.repeat(columns, 2, axis=1), np.array([[3.0], [2], [1], [0], [0]]), 5)
    assert [len(piece.active) for piece in twins] == [1, 2, 3]


def test_the_path_is_that_of_scikit_learn() -> None:
    linear = pytest.importorskip("sklearn.linear_model")
    rng = np.random.default_rng(4)
    columns = rng.normal(size=(20, 30))
    target = columns[:, :4] @ rng.normal(size=(4, 1)) + 0.1 * rng.normal(size=(20, 1))
    path = lasso_path(columns, target, 19)
    alphas, _, coefficients = linear.lars_path(columns, target[:, 0], method="lasso")
    for piece, alpha, x in zip(path, alphas * 20, coefficients.T, strict=False):
        assert piece.above == pytest.approx(alpha)
        np.testing.assert_allclose(piece.start[:, 0], x, atol=1e-8)


def descended(columns: np.ndarray, target: np.ndarray, penalty: float) -> np.ndarray:
    """Return the lasso's coefficients by coordinate descent; columns of unit length."""
    x, rest = np.zeros(columns.shape[1]), target.copy()
    for _ in range(200):
        for j, column in enumerate(columns.T):
            z = column @ rest + x[j]
            new = np.sign(z) * max(abs(z) - penalty, 0.0)
            rest += column * (x[j] - new)
            x[j] = new
    return x


def test_the_lasso_is_chosen_by_cross_validation() -> None:
    part, _ = sparse(3, m=20, k=9, noise=3.0)
    y, ones = part.target[:, 0], np.ones(20, dtype=bool)
    whole = part.standardised(part.free, part.kept)
    path = lasso_path(whole.columns, whole.target, 18)
    penalties = [np.sqrt(piece.above * piece.below) for piece in path]

    def selected(rows: np.ndarray, penalty: float) -> np.ndarray:
        centred = part.columns[rows, 1:] - part.columns[rows, 1:].mean(axis=0)
        centred /= np.linalg.norm(centred, axis=0)
        x = descended(centred, y[rows] - y[rows].mean(), penalty * np.sqrt(rows.mean()))
        return np.append(True, np.abs(x) > 1e-9)

    sums = []
    for penalty in penalties:
        total = 0.0
        for fold in range(4):
            rows = np.arange(20) % 4 != fold
            use = selected(rows, penalty)
            x = np.linalg.lstsq(part.columns[rows][:, use], y[rows])[0]
            total += ((y[~rows] - part.columns[~rows][:, use] @ x) ** 2).sum()
        sums.append(total)
    assert len(set(sums)) > 2
    np.testing.assert_array_equal(
        Lasso(folds=4).choose(part), selected(ones, penalties[int(np.argmin(sums))]))


# As solvers

@pytest.mark.parametrize("solver", SELECTORS)
def test_forced_genes_and_cardinality_hold(solver: type[TermRegression]) -> None:
    problem = termsel.prepare("poly-terms", options={"degree": 4}).problem
    line, sample = problem.genome.segments
    for least, most in ((2, 4), (9, 12), (15, 15)):
        problem.genome = termsel.Genome(
            [termsel.Bits(line.name, line.labels, minimum=least, maximum=most), sample],
            on=["line.num:Y4", "sample.num:X2"], off=["sample.num:1", "sample.num:Y3"])
        genes = termsel.search(problem, solver()).genes[None]
        np.testing.assert_array_equal(
            genes, problem.genome.repair(genes, np.random.default_rng(0)))


@pytest.mark.parametrize("solver", SELECTORS)
def test_hardly_any_equations(solver: type[TermRegression]) -> None:
    rng = np.random.default_rng(9)
    for m in (2, 3, 4):
        columns = np.column_stack([np.ones(m), rng.normal(size=(m, 5))])
        chosen = solver().choose(part_of(columns, rng.normal(size=m)))
        assert 1 <= chosen.sum() <= m - 1
    # Kept columns that depend on one another, a column of zeros, a target of zeros.
    columns = np.column_stack([np.ones(6), np.ones(6), np.zeros(6), rng.normal(size=(6, 4))])
    kept = np.arange(7) < 2
    for target in (rng.normal(size=6), np.zeros(6), np.ones(6)):
        chosen = solver().choose(part_of(columns, target, kept=kept, free=~kept))
        assert chosen[kept].all()
        assert not chosen[2]
