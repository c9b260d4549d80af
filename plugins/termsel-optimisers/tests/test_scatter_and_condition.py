"""Scatter matrix and figure condition, against refits and formulas written out here."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("termsel_optimisers", reason="termsel-optimisers is not installed: "
                    "pip install -e plugins/termsel-optimisers")

import termsel
from termsel_optimisers.rivals.scatter import (
    ScatterMatrix,
    explained_squares,
    scatter_of,
    sweep_pivot,
)
from termsel_optimisers.rivals.stepwise import gains_of_entering, losses_of_leaving
from tests.regressions import part_of, sparse, square


@pytest.mark.parametrize("seed", range(4))
def test_a_sweep_gives_gains_and_losses_and_is_undone(seed: int) -> None:
    part, _ = sparse(seed, k=8, r=1 + seed % 2)
    scatter, lengths = scatter_of(part)
    assert (lengths[1:] > 0).all()
    chosen = part.kept.copy()
    scale = square(part, chosen)  # the target about the constant has the length 1
    for j in (3, 5):
        gain, _ = gains_of_entering(part, chosen)
        open_ones = ~chosen
        np.testing.assert_allclose(explained_squares(scatter, 8)[open_ones] * scale,
                                   gain[open_ones], rtol=1e-8)
        scatter, chosen[j] = sweep_pivot(scatter, j), True
    loss, _ = losses_of_leaving(part, chosen)
    np.testing.assert_allclose(explained_squares(scatter, 8)[[3, 5]] * scale, loss[[3, 5]],
                               rtol=1e-8)
    np.testing.assert_allclose(np.trace(scatter[8:, 8:]) * scale, square(part, chosen), rtol=1e-8)
    np.testing.assert_allclose(sweep_pivot(sweep_pivot(scatter, 2), 2), scatter, atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_scatter_matrix_finds_true_terms_and_is_stepwise_by_f(seed: int) -> None:
    part, true = sparse(seed)
    found = ScatterMatrix(f_in=12.0, f_out=12.0).choose(part)
    assert found[true].all()
    assert found.sum() <= true.sum() + 1
    for j in np.flatnonzero(found & ~part.kept):  # each in use is significant at the limit
        rest = square(part, found)
        change = square(part, found & (np.arange(len(found)) != j)) - rest
        assert change / (rest / (len(part.columns) - found.sum())) >= 12.0 - 1e-9


def test_scatter_matrix_takes_no_collinear_term() -> None:
    part, _ = sparse(1)
    own = np.random.default_rng(4).normal(size=len(part.columns))
    twin = part.columns[:, 2] + 1e-3 * own
    both = part_of(np.column_stack([part.columns, twin]), part.target)
    strict = ScatterMatrix(tolerance=1e-2).choose(both)
    assert not (strict[2] and strict[-1])
    ga, gb = (ScatterMatrix(tolerance=t, f_in=0.0, f_out=0.0).choose(both) for t in (1e-2, 1e-9))
    assert not (ga[2] and ga[-1])
    assert gb[2]
    assert gb[-1]


def test_scatter_matrix_runs_and_refuses_limits_that_never_end() -> None:
    result = termsel.run("rfm-terms", dataset="ikonos-hamedan", solver="scatter-matrix",
                         strategy="as-asked")
    assert 8 <= len(result.selection.terms) <= 32
    independent = result.rmse["independent"]
    assert independent is not None
    assert independent.total < 5
    with pytest.raises(termsel.TermselError, match="f_out is 5 and f_in 4"):
        termsel.run("rfm-terms", solver="scatter-matrix", options={"f_out": 5.0})


def test_figure_condition_is_the_predicted_error_of_the_fit() -> None:
    features = termsel.simulate_scene("spot-isfahan", n_lines=0, n_points=90)
    task = termsel.prepare("poly-terms", features=features, criterion="figure-condition",
                           options={"degree": 2})
    genes = np.ones(task.problem.genome.size, dtype=bool)
    value = task.problem.evaluate(genes[None]).objectives[0, 0]
    fitted = termsel.assess(termsel.GivenGenes(genes), task).fit
    points = fitted.control.points
    ground = points.ground
    low, high = ground[:, :2].min(axis=0), ground[:, :2].max(axis=0)
    x, y = np.meshgrid(*(np.linspace(low[j], high[j], 9) for j in (0, 1)))
    middle = ground[:, :2].mean(axis=0)

    def columns(plan: np.ndarray) -> np.ndarray:
        u, v = (plan - middle).T
        return np.column_stack([np.ones(len(u)), u, v, u * v, u**2, v**2])

    A, at = columns(ground[:, :2]), columns(np.column_stack([x.ravel(), y.ravel()]))
    rest = ((points.image - A @ np.linalg.lstsq(A, points.image)[0]) ** 2).sum(axis=0)
    share = np.einsum("ij,jk,ik->i", at, np.linalg.inv(A.T @ A), at).mean()
    expected = np.sqrt(share * rest.sum() / (len(A) - 6))
    assert value == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
def test_figure_condition_prefers_fewer_terms_than_the_control_rmse_does() -> None:
    task = termsel.prepare("rfm-terms", dataset="ikonos-hamedan", criterion="figure-condition",
                           options={"order": 2})
    found = termsel.search(task.problem, task.solver, seed=1, evaluations=4000)
    result = termsel.assess(termsel.GivenGenes(found.genes), task)
    independent = result.rmse["independent"]
    assert independent is not None
    assert independent.total < 2
    everything = np.ones((1, task.problem.genome.size), dtype=bool)
    worse = task.problem.evaluate(everything)
    assert not worse.objectives[0, 0] < found.objectives[0]


def test_figure_condition_refuses_models_that_correct() -> None:
    pytest.importorskip("termsel_hybrids")
    with pytest.raises(termsel.TermselError, match="cannot judge model 'pointwise'"):
        termsel.run("poly-terms", dataset="ikonos-hamedan", model="pointwise",
                    criterion="figure-condition", evaluations=50)
