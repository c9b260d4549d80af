"""Solvers by regression: their base, and ridge."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import termsel
from termsel.adjustment.solve import Spectrum, choose_penalty
from termsel.data.features import BoolArray
from termsel.fitting.least_squares import fit
from termsel.selection.problems.base import Problem
from termsel.selection.solvers.heuristics.yardsticks import AllTerms
from termsel.selection.solvers.regression.base import (
    Regression,
    TermRegression,
    regressions_of_problem,
)
from termsel.selection.solvers.regression.ridge import Ridge, shrink
from termsel.simulate import simulate_scene
from tests.regressions import part_of, sparse


class First(TermRegression):
    """Choose the first columns, as many as there may be."""

    name = "first"

    def choose(self, part: Regression) -> BoolArray:
        """Return the chosen columns."""
        count = part.most - int(part.kept.sum())
        return part.kept | (part.free & (np.cumsum(part.free) <= count))


SOLVERS = (First, Ridge)


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


# As solvers

@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(("name", "options"), [
    ("rfm-terms", {}), ("poly-terms", {"degree": 5}),
    ("poly-terms", {"degree": 5, "mask": "shared"})])
def test_embedded_scenes_run(solver: type[termsel.Solver], name: str, options: dict) -> None:
    task = termsel.prepare(name, solver=solver, options=options)
    if name == "rfm-terms":
        assert [part.columns.shape
                for part in regressions_of_problem(task.problem)] == [(24, 39)] * 2
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
        assert [part.constant.sum() for part in regressions_of_problem(problem)] == [1, 0]
        genes = termsel.search(problem, solver()).genes[None]
        np.testing.assert_array_equal(
            genes, problem.genome.repair(genes, np.random.default_rng(0)))


def test_cardinality_is_kept_without_chance() -> None:
    problem = termsel.prepare("poly-terms", options={"degree": 4}).problem
    line, sample = problem.genome.segments
    problem.genome = termsel.Genome(
        [termsel.Bits(line.name, line.labels, minimum=9, maximum=9), sample])
    first, second = (termsel.search(problem, First(), seed=seed).genes for seed in (1, 2))
    np.testing.assert_array_equal(first, second)


def test_the_constant_is_found_under_weights() -> None:
    features = simulate_scene("ikonos-hamedan")
    rng = np.random.default_rng(0)
    points = dataclasses.replace(features.points, sigma=rng.uniform(0.3, 1.0, (74, 2)))
    task = termsel.prepare("rfm-terms", features=features.with_(points=points))
    for part, name in zip(
            regressions_of_problem(task.problem), ("line.num:1", "sample.num:1"), strict=True):
        labels = [task.problem.genome.labels[g] for g in part.genes[part.constant]]
        assert labels == [name]
        assert np.ptp(part.columns[:, part.constant]) > 0
        assert part.pixels == task.scaling.image_scale


@pytest.mark.parametrize("solver", SOLVERS)
def test_what_has_no_parts_is_refused(solver: type[termsel.Solver]) -> None:
    problem: Problem = termsel.prepare("owdis-lines").problem
    with pytest.raises(termsel.TermselError, match="whose terms are columns"):
        termsel.search(problem, solver())
