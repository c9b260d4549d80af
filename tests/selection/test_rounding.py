"""Points computed by a polynomial: every choice is the same on all processors, without surplus.

What a right model leaves of such points is rounding, and each processor rounds otherwise.
`.ci/run` runs these tests as several processors.
"""

from __future__ import annotations

import numpy as np
import pytest

import termsel
from termsel.adjustment.solve import index_of_largest, replace_rounding_by_size
from termsel.auto.selected import select_forward
from termsel.data.features import FeatureSet, Points
from termsel.data.monomials import evaluate_monomials, graded_exponents

PARTS = {
    "affine": ({"1": 1.0, "X": 0.9, "Y": -0.1, "Z": 0.05},
               {"1": 1.0, "X": 0.2, "Y": 0.8, "Z": -0.02}),
    "quadratic": ({"1": 1.0, "X": 0.9, "Y": -0.1, "Z": 0.05, "XY": 0.01},
                  {"1": 1.0, "X": 0.2, "Y": 0.8, "Z": -0.02, "X2": 0.02}),
    "cubic": ({"1": 1.0, "X": 0.9, "Y": -0.1, "Z": 0.05, "XY": 0.01, "X3": -0.003},
              {"1": 1.0, "X": 0.2, "Y": 0.8, "Z": -0.02, "XYZ": 0.004}),
}
POWERS = {"1": (0, 0, 0), "X": (1, 0, 0), "Y": (0, 1, 0), "Z": (0, 0, 1), "XY": (1, 1, 0),
          "X2": (2, 0, 0), "X3": (3, 0, 0), "XYZ": (1, 1, 1)}


def computed(kind: str, n: int = 36, half_range: float = 4000.0) -> FeatureSet:
    """Points without any noise; those at the corners of the area keep its scaling symmetric."""
    rng = np.random.default_rng(1)
    unit = rng.uniform(-1, 1, (n, 3))
    unit[:6] = [[-1, -1, -1], [1, 1, 1], [-1, 1, 1], [1, -1, -1], [-1, -1, 1], [1, 1, -1]]
    image = np.column_stack([
        sum(factor * np.prod(unit ** POWERS[term], axis=1) for term, factor in part.items())
        for part in PARTS[kind]]) * half_range
    ground = unit * [5000, 4000, 150] + [500_000, 4_000_000, 400]
    roles = tuple(("control", "control", "check")[i % 3] for i in range(n))
    return FeatureSet(Points(tuple(f"P{i}" for i in range(n)), image, ground, None, roles),
                      crs="EPSG:32632")


def terms_of(kind: str) -> set[str]:
    """Terms but the constants, which scaled coordinates need not have."""
    return {f"{axis}.num:{term}" for axis, part in zip(("line", "sample"), PARTS[kind], strict=True)
            for term in part if term != "1"}


def without_constants(terms: tuple[str, ...]) -> set[str]:
    return {term for term in terms if not term.endswith(":1")}


@pytest.mark.parametrize("kind", PARTS)
@pytest.mark.parametrize(("solver", "criterion"), [
    ("exact", "check-rmse"), ("exact", "press"), ("exact", "kfold"), ("exact", "ebic"),
    ("stepwise", "check-rmse"), ("scatter-matrix", "check-rmse"), ("lasso", "check-rmse")])
def test_a_selection_has_the_terms_of_the_polynomial_and_no_other(
        kind: str, solver: str, criterion: str) -> None:
    degree = 3 if kind == "cubic" else 2
    result = termsel.run("rfm-terms", features=computed(kind), model="poly3d", solver=solver,
                         criterion=criterion, strategy="as-asked", options={"degree": degree})
    assert without_constants(result.selection.terms) == terms_of(kind)


@pytest.mark.parametrize("criterion", ["check-rmse", "press", "kfold", "ebic", "median", "huber"])
def test_a_search_ends_without_surplus_terms(criterion: str) -> None:
    result = termsel.run("rfm-terms", features=computed("quadratic"), model="poly3d",
                         solver="swap", criterion=criterion, strategy="as-asked", seed=1,
                         evaluations=4000, options={"degree": 2})
    assert without_constants(result.selection.terms) == terms_of("quadratic")


@pytest.mark.parametrize(("kind", "chosen"), [
    ("affine", "regularised-quadratic"), ("quadratic", "regularised-quadratic")])
def test_auto_takes_the_plainest_of_candidates_that_leave_rounding(kind: str, chosen: str) -> None:
    result = termsel.run("rfm-terms", features=computed(kind))
    assert result.strategy is not None
    assert result.strategy.chosen == chosen
    assert not result.outliers


@pytest.mark.parametrize("kind", PARTS)
def test_forward_selection_ends_where_rounding_is_left(kind: str) -> None:
    fitted = termsel.fit(computed(kind), "selected")
    chosen = np.array(fitted.model.terms, dtype=str)[fitted.terms]
    assert without_constants(tuple(chosen)) == terms_of(kind)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e6])
def test_the_rounding_of_a_target_is_by_its_size(scale: float) -> None:
    rng = np.random.default_rng(4)
    exponents = graded_exponents(3, 3)
    columns = evaluate_monomials(rng.uniform(-1, 1, (60, 3)), exponents)
    affine = np.array([sum(one) < 2 for one in exponents])
    target = scale * (columns[:, affine].sum(axis=1) + 2.0 * columns[:, 12])
    chosen, = select_forward(columns[None], target[None], affine) or []
    assert np.flatnonzero(chosen.terms & ~affine).tolist() == [12]
    assert np.abs(chosen.errors).max() < 1e-9 * scale


def test_fewest_features_are_the_best_where_all_leave_rounding() -> None:
    features = computed("affine", 12)
    result = termsel.run("owdis-points", features=features, model="affine", solver="exact",
                         strategy="as-asked")
    assert len(result.selection.features) == 5  # four determine it, and one is redundancy


def test_of_values_that_are_equal_but_for_rounding_the_first_is_the_largest() -> None:
    values = np.array([[1.0, 3.0, 3.0 + 1e-12, -1.0], [0.0, -1.0, -1.0, 2.0]])
    assert index_of_largest(values).tolist() == [1, 3]


def test_figures_that_are_rounding_are_by_the_size_of_the_selection() -> None:
    figures = replace_rounding_by_size(
        np.array([1e-12, 5.0, 1e-13]), 1e-9, np.array([0.5, 0.1, 1.0]))
    np.testing.assert_allclose(figures, [5e-10, 5.0, 1e-9])


def test_a_fit_through_all_points_is_called_exact() -> None:
    features = computed("quadratic", 12)
    roles = tuple("control" if i < 10 else "check" for i in range(12))
    points = features.points
    rng = np.random.default_rng(0)
    noisy = Points(points.ids, points.image + rng.normal(0, 1, (12, 2)), points.ground, None, roles)
    result = termsel.run("rfm-terms", features=features.with_(points=noisy), model="poly3d",
                         solver="stepwise", criterion="check-rmse", strategy="as-asked",
                         options={"degree": 2})
    row = next(line for line in result.summary(verbose=True).splitlines()
               if line.strip().startswith("all terms"))
    assert row.split()[3] == "exact"


class Tied(termsel.Problem):
    """The distance of the number of genes from five: many selections are equally good.

    Fewer than three genes are a violation. Each figure is computed with its own error, of some
    1e-14, as another processor would compute it.
    """

    objectives = ("distance",)

    def __init__(self, processor: int) -> None:
        self.genome = termsel.Genome([termsel.Segment("g", tuple("abcdefghijkl"))])
        self.processor = processor

    def evaluate(self, genes: np.ndarray) -> termsel.Evaluation:
        weights = np.random.default_rng(self.processor).uniform(-1e-14, 1e-14, genes.shape[1])
        number = genes.sum(axis=1)
        distance = 1.3 + np.abs(number - 5.0) + genes @ weights
        violation = np.where(number < 3, 3.0 - number + genes @ weights, 0.0)
        return termsel.Evaluation(distance[:, None], violation)

    def decode(self, genes: np.ndarray) -> termsel.Selection:
        return termsel.Selection((), ())


@pytest.mark.parametrize("solver", ["ga", "ica", "pso", "swap", "random"])
def test_a_search_ends_at_the_same_selection_however_a_processor_rounds(solver: str) -> None:
    ends = {tuple(termsel.search(Tied(processor), termsel.get("solvers", solver)(), seed=2,
                                 evaluations=600).genes.tolist())
            for processor in range(4)}
    assert len(ends) == 1
