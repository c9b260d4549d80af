"""Baselines that choose terms by regression, against formulas and refits written out here."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy import stats

import termsel
from termsel.adjustment.equations import Equations
from termsel.adjustment.ridge import Spectrum, choose_penalty
from termsel.adjustment.solve import solve
from termsel.fits.least_squares import fit
from termsel.measurements.features import FeatureSet, Points
from termsel.problems.base import Problem
from termsel.simulate import simulate_scene
from termsel.solvers.heuristics.yardsticks import AllTerms
from termsel.solvers.regression.ridge import Ridge, shrink
from termsel.solvers.regression.stepwise import (
    Regression,
    Stepwise,
    TermRegression,
    TTest,
    gains,
    independent,
    losses,
    regressions,
    significance,
)

SELECTORS = (Stepwise, TTest)
SOLVERS = (*SELECTORS, Ridge)


def part_of(columns: np.ndarray, target: np.ndarray, **given: Any) -> Regression:
    """Return a regression whose first column is the constant, unless told otherwise."""
    k = columns.shape[1]
    first = np.arange(k) == 0
    target = target.reshape(len(columns), -1)
    return Regression(**{
        "genes": np.arange(k), "columns": columns, "target": target, "denominator": None,
        "constant": first, "kept": first, "free": ~first, "least": 1,
        "most": min(k, len(columns) - 1), "pixels": 1.0, **given})


def sparse(seed: int, m: int = 40, k: int = 12, r: int = 1, noise: float = 0.1,
           ) -> tuple[Regression, np.ndarray]:
    """Return a regression of columns at random and the columns that have a part in it."""
    rng = np.random.default_rng(seed)
    columns = np.column_stack([np.ones(m), rng.normal(size=(m, k - 1))])
    true = np.zeros(k, dtype=bool)
    true[[0, 2, 5, 7]] = True
    x = np.where(true[:, None], rng.choice([-1.0, 1.0], (k, r)) * rng.uniform(1, 3, (k, r)), 0.0)
    return part_of(columns, columns @ x + noise * rng.normal(size=(m, r))), true


def square(part: Regression, chosen: np.ndarray) -> float:
    """Return the residual sum of squares of an adjustment of the chosen columns."""
    A = part.columns[:, chosen]
    return float(((part.target - A @ np.linalg.lstsq(A, part.target)[0]) ** 2).sum())


def flipped(chosen: np.ndarray, j: int) -> np.ndarray:
    return chosen ^ (np.arange(len(chosen)) == j)


def every_selector() -> list[TermRegression]:
    return [solver() for solver in SELECTORS]


# The tests of significance

def test_gains_and_losses_are_those_of_refits() -> None:
    part, _ = sparse(1, r=2)
    chosen = np.zeros(12, dtype=bool)
    chosen[[0, 1, 2, 6]] = True
    gain, before = gains(part, chosen)
    loss, same = losses(part, chosen)
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
    loss, rest = losses(part, chosen)
    t = adjusted.coefficients / adjusted.deviations
    np.testing.assert_allclose(loss / (rest / 28), t**2, rtol=1e-9)
    for j in range(12):
        assert significance(part, loss[j], rest, chosen) == pytest.approx(
            2 * stats.t.sf(abs(t[j]), 28), rel=1e-9)


def test_significance_of_a_line_through_five_points() -> None:
    # y = 1, 3, 2, 5, 4 at x = -2 ... 2: slope 8/10, regression 6.4 and residual 3.6 of 10,
    # F = 6.4 / (3.6 / 3) = 16/3.
    columns = np.column_stack([np.ones(5), np.arange(-2.0, 3.0)])
    part = part_of(columns, np.array([1.0, 3.0, 2.0, 5.0, 4.0]))
    both = np.ones(2, dtype=bool)
    loss, rest = losses(part, both)
    assert (loss[1], rest) == pytest.approx((6.4, 3.6))
    expected = stats.f.sf(16 / 3, 1, 3)
    assert significance(part, loss[1], rest, both) == pytest.approx(expected)
    assert expected == pytest.approx(
        stats.linregress(columns[:, 1], part.target[:, 0]).pvalue)
    # With an image of two axes: the same again next to it, twice the degrees of freedom.
    double = part_of(columns, np.column_stack([part.target, part.target]))
    assert significance(double, 12.8, 7.2, both) == pytest.approx(stats.f.sf(16 / 3, 2, 6))


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
    assert gains(part, part.kept)[0].argmax() == 3  # it enters first
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
    assert np.flatnonzero(independent(part, 12)).tolist() == [0, 1, 2, 4, 6, 7, 8, 9]
    assert np.flatnonzero(independent(part, 5)).tolist() == [0, 1, 2, 4, 6]
    assert np.linalg.matrix_rank(columns[:, independent(part, 12)]) == 8
    # By default a quarter of the equations is left to test with.
    begins = TTest(alpha=1.0).choose(part)
    assert np.flatnonzero(begins).tolist() == [0, 1, 2, 4, 6, 7]
    assert TTest(alpha=1.0, redundancy=1).choose(part).sum() == 7
    assert TTest(redundancy=9).choose(part).tolist() == part.kept.tolist()


# Ridge

def smoother(part: Regression, penalty: float) -> np.ndarray:
    """Return the matrix from target to adjusted target: centred unit columns are penalised."""
    centred = part.columns[:, 1:] - part.columns[:, 1:].mean(axis=0)
    A = np.column_stack([np.ones(len(centred)), centred / np.linalg.norm(centred, axis=0)])
    weight = np.diag(np.append(0.0, np.full(A.shape[1] - 1, penalty**2)))
    return A @ np.linalg.solve(A.T @ A + weight, A.T)


def spectrum_of(part: Regression) -> Spectrum:
    standard = part.standardised(~part.constant, part.constant)
    u, s, _ = np.linalg.svd(standard.columns, full_matrices=False)
    u, s = u[:, s > 1e-9], s[s > 1e-9]
    inner = u.T @ standard.target
    outside = float(((standard.target - u @ inner) ** 2).sum())
    return Spectrum(s, np.linalg.norm(inner, axis=1), outside if outside > 1e-20 else 0.0,
                    len(part.target) - 1)


@pytest.mark.parametrize(("m", "k", "r"), [(20, 8, 1), (20, 8, 2), (9, 14, 1)])
def test_gcv_is_that_of_the_explicit_matrix(m: int, k: int, r: int) -> None:
    part, _ = sparse(1, m=m, k=k + 1, r=r, noise=1.0)
    penalties = np.geomspace(1e-2, 10, 25)
    expected = []
    for penalty in penalties:
        H = smoother(part, penalty)
        errors = part.target - H @ part.target
        expected.append((errors**2).sum() / np.trace(np.eye(m) - H) ** 2)
    np.testing.assert_allclose(spectrum_of(part).gcv(penalties), expected, rtol=1e-6)


def test_gcv_without_redundancy_is_level() -> None:
    """Nothing is left but what the penalty leaves, however small it is."""
    spectrum = Spectrum(np.array([1.0]), np.array([1.0]), 0.0, 1)
    np.testing.assert_allclose(spectrum.gcv(np.geomspace(1.0, 1e-9, 20)), 1.0)


def test_where_gcv_is_flat_the_largest_penalty_is_chosen() -> None:
    spectrum = Spectrum(np.array([1.0]), np.array([1.0]), 1e-3, 10)
    penalties = spectrum.penalties(1e-8)
    gcv = spectrum.gcv(penalties)
    flat = penalties[gcv <= gcv.min() * (1 + 1e-6)]
    assert flat.max() > penalties[gcv.argmin()]
    assert choose_penalty(spectrum, "gcv") == flat.max()


def test_gcv_of_a_circulant_system_is_leaving_one_out() -> None:
    # All rows have the same leverage there, so that the generalised is the ordinary.
    angle = 2 * np.pi * np.arange(12) / 12
    columns = np.column_stack([np.ones(12)] + [f(n * angle) for n in (1, 2, 3)
                                               for f in (np.cos, np.sin)])
    part = part_of(columns, np.random.default_rng(2).normal(size=12))
    lengths = np.linalg.norm(columns[:, 1:], axis=0)
    for penalty in (0.05, 0.3, 2.0):
        total = 0.0
        for i in range(12):
            keep = np.arange(12) != i
            A, y = columns[keep], part.target[keep, 0]
            weight = np.diag(np.append(0.0, (penalty * lengths) ** 2))
            x = np.linalg.solve(A.T @ A + weight, A.T @ y)
            total += (part.target[i, 0] - columns[i] @ x) ** 2
        assert spectrum_of(part).gcv(np.array([penalty]))[0] * 12**2 == pytest.approx(total)


def test_the_curvature_is_that_of_the_curve() -> None:
    rng = np.random.default_rng(3)
    s = np.geomspace(1.0, 1e-4, 8)
    inner = np.abs(s * rng.normal(size=8) + 1e-3 * rng.normal(size=8))

    def place(log_penalty: float) -> np.ndarray:
        f = s**2 / (s**2 + np.exp(2 * log_penalty))
        return np.log([np.linalg.norm(np.append((1 - f) * inner, 1e-3)),
                       np.linalg.norm(f * inner / s)])

    penalties = np.geomspace(1e-4, 1.0, 9)
    expected = []
    for t in np.log(penalties):
        before, here, after = place(t - 1e-4), place(t), place(t + 1e-4)
        first, second = (after - before) / 2e-4, (after - 2 * here + before) / 1e-8
        expected.append((first[0] * second[1] - first[1] * second[0])
                        / np.hypot(*first) ** 3)
    np.testing.assert_allclose(Spectrum(s, inner, 1e-6, 12).curvature(penalties), expected,
                               rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("choice", ["gcv", "l-curve"])
@pytest.mark.parametrize(("m", "k", "r"), [(20, 8, 1), (20, 8, 2), (9, 14, 1)])
def test_ridge_coefficients_are_those_of_the_normal_equations(choice: str, m: int, k: int,
                                                             r: int) -> None:
    part, _ = sparse(4, m=m, k=k, r=r, noise=1.0)
    everything = np.ones(k, dtype=bool)
    x, penalty = shrink(part, everything, choice)
    assert x.shape == (r, k)
    np.testing.assert_allclose(part.columns @ x.T, smoother(part, penalty) @ part.target,
                               atol=1e-9)
    spectrum = spectrum_of(part)
    grid = spectrum.penalties(1e-8)
    if choice == "gcv":
        assert spectrum.gcv(np.array([penalty]))[0] <= spectrum.gcv(grid).min() * (1 + 1e-5)
    # The constant is free, and units of the columns do not matter.
    shifted = dataclasses.replace(part, target=part.target + 7.0)
    moved, same = shrink(shifted, everything, choice)
    assert same == pytest.approx(penalty)
    np.testing.assert_allclose(moved - x, 7.0 * np.repeat(part.constant[None], r, axis=0),
                               atol=1e-9)
    units = np.linspace(0.01, 50.0, k)
    np.testing.assert_allclose(
        shrink(part_of(part.columns * units, part.target), everything, choice)[0] * units, x,
        rtol=1e-6, atol=1e-9)


def test_ridge_of_nothing_but_a_constant() -> None:
    part = part_of(np.ones((5, 1)), np.arange(5.0))
    x, penalty = shrink(part, np.ones(1, dtype=bool), "gcv")
    assert (x[0, 0], penalty) == (pytest.approx(2.0), 0.0)
    none = part_of(np.zeros((5, 2)), np.arange(5.0), constant=np.zeros(2, dtype=bool))
    assert shrink(none, np.ones(2, dtype=bool), "l-curve")[0].tolist() == [[0.0, 0.0]]


@pytest.mark.parametrize("mask", ["per-axis", "shared"])
def test_ridge_yields_coefficients_in_the_order_of_the_terms(mask: str) -> None:
    task = termsel.prepare("poly-terms", options={"degree": 2, "mask": mask})
    generation = next(Ridge().generations(task.problem, np.random.default_rng(1)))
    coefficients = generation.details["coefficients"]
    assert coefficients.shape == (len(task.model.terms),)
    assert len(generation.details["penalties"]) == (1 if mask == "shared" else 2)
    # Far more equations than terms: GCV hardly shrinks, and this is nearly the plain fit.
    plain = fit(task.model, task.observations.control, task.scaling)
    np.testing.assert_allclose(coefficients, plain.adjustment.coefficients, atol=2e-3)
    shrunk = dataclasses.replace(plain, adjustment=dataclasses.replace(
        plain.adjustment, coefficients=coefficients))
    assert shrunk.control_rmse().total == pytest.approx(plain.control_rmse().total, rel=0.05)
    assert generation.genes.all()


def test_ridge_betters_a_rational_model_with_ample_control() -> None:
    task = termsel.prepare("rfm-terms", options={"order": 2},
                           features=simulate_scene("ikonos-hamedan", n_points=240))
    plain = fit(task.model, task.observations.control, task.scaling)

    def miss(choice: str) -> float:
        generation = next(Ridge(choice=choice).generations(
            task.problem, np.random.default_rng(1)))
        shrunk = dataclasses.replace(plain, adjustment=dataclasses.replace(
            plain.adjustment, coefficients=generation.details["coefficients"]))
        return shrunk.rmse(task.observations.independent).total

    # 38 terms and 80 control points: 2.3 px without a penalty.
    assert miss("gcv") < 0.8 * plain.rmse(task.observations.independent).total
    assert miss("l-curve") < 1.0


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


# As solvers

@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(("name", "options"), [
    ("rfm-terms", {}), ("poly-terms", {"degree": 5}),
    ("poly-terms", {"degree": 5, "mask": "shared"})])
def test_embedded_scenes_run(solver: type[termsel.Solver], name: str, options: dict) -> None:
    task = termsel.prepare(name, solver=solver.name, options=options)
    if name == "rfm-terms":
        assert [part.columns.shape for part in regressions(task.problem)] == [(24, 39)] * 2
    before = np.random.get_state()[1].tobytes()
    found = [list(solver().generations(task.problem, np.random.default_rng(seed)))
             for seed in (1, 2)]
    assert np.random.get_state()[1].tobytes() == before
    assert len(found[0]) == 1
    np.testing.assert_array_equal(found[0][0].genes, found[1][0].genes)
    assert found[0][0].genes.shape == (1, task.problem.genome.size)
    if solver is Ridge:
        np.testing.assert_array_equal(found[0][0].details["coefficients"],
                                      found[1][0].details["coefficients"])
        return
    assert found[0][0].evaluation.violation[0] == 0
    searched = termsel.search(task.problem, solver(), evaluations=1)
    np.testing.assert_array_equal(searched.genes, found[0][0].genes[0])
    assert searched.evaluations == 1
    full = termsel.search(task.problem, AllTerms())
    assert searched.violation <= full.violation
    assert searched.objectives[0] < 100.0


@pytest.mark.parametrize("solver", SOLVERS)
def test_forced_genes_and_cardinality_hold(solver: type[termsel.Solver]) -> None:
    task = termsel.prepare("poly-terms", options={"degree": 4})
    problem = task.problem
    line, sample = problem.genome.segments
    for least, most in ((2, 4), (9, 12), (15, 15)):
        problem.genome = termsel.Genome(
            [termsel.Bits(line.name, line.labels, minimum=least, maximum=most), sample],
            on=["line.num:Y4", "sample.num:X2"], off=["sample.num:1", "sample.num:Y3"])
        assert [part.constant.sum() for part in regressions(problem)] == [1, 0]
        genes = termsel.search(problem, solver()).genes[None]
        np.testing.assert_array_equal(
            genes, problem.genome.repair(genes, np.random.default_rng(0)))


@pytest.mark.parametrize("solver", SELECTORS)
def test_cardinality_is_kept_without_chance(solver: type[termsel.Solver]) -> None:
    problem = termsel.prepare("poly-terms", options={"degree": 4}).problem
    line, sample = problem.genome.segments
    problem.genome = termsel.Genome(
        [termsel.Bits(line.name, line.labels, minimum=9, maximum=9), sample])
    first, second = (termsel.search(problem, solver(), seed=seed).genes for seed in (1, 2))
    np.testing.assert_array_equal(first, second)


def test_the_constant_is_found_under_weights() -> None:
    features = simulate_scene("ikonos-hamedan")
    rng = np.random.default_rng(0)
    points = dataclasses.replace(features.points, sigma=rng.uniform(0.3, 1.0, (74, 2)))
    task = termsel.prepare("rfm-terms", features=features.with_(points=points))
    for part, name in zip(regressions(task.problem), ("line.num:1", "sample.num:1"), strict=True):
        labels = [task.problem.genome.labels[g] for g in part.genes[part.constant]]
        assert labels == [name]
        assert np.ptp(part.columns[:, part.constant]) > 0
        assert part.pixels == task.scaling.image_scale


@pytest.mark.parametrize("selector", every_selector(), ids=lambda s: s.name)
def test_hardly_any_equations(selector: TermRegression) -> None:
    rng = np.random.default_rng(9)
    for m in (2, 3, 4):
        columns = np.column_stack([np.ones(m), rng.normal(size=(m, 5))])
        chosen = selector.choose(part_of(columns, rng.normal(size=m)))
        assert 1 <= chosen.sum() <= m - 1
    # Kept columns that depend on one another, a column of zeros, a target of zeros.
    columns = np.column_stack([np.ones(6), np.ones(6), np.zeros(6), rng.normal(size=(6, 4))])
    kept = np.arange(7) < 2
    for target in (rng.normal(size=6), np.zeros(6), np.ones(6)):
        chosen = selector.choose(part_of(columns, target, kept=kept, free=~kept))
        assert chosen[kept].all()
        assert not chosen[2]


@pytest.mark.parametrize("solver", SOLVERS)
def test_what_has_no_parts_is_refused(solver: type[termsel.Solver]) -> None:
    problem: Problem = termsel.prepare("owdis-lines").problem
    with pytest.raises(termsel.TermselError, match="whose terms are columns"):
        termsel.search(problem, solver())
