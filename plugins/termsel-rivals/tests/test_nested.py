"""Nested regression."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("termsel_rivals", reason="termsel-rivals is not installed: "
                    "pip install -e plugins/termsel-rivals")

import termsel
from termsel import Regression
from termsel.fits.least_squares import fit
from termsel.solvers.regression.stepwise import regressions
from termsel_rivals import NestedRegression
from termsel_rivals.nested import explained_share, rational_errors, rms


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
    share = explained_share(part, part.kept, rational_errors(part, part.kept))
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
    for side, part in enumerate(regressions(problem)):
        chosen = NestedRegression().choose(part)
        terms = np.zeros(78, dtype=bool)
        terms[part.genes[chosen]] = True
        fitted = fit(task.model, task.observations.control, task.scaling, terms)
        errors = fitted.errors(task.observations.control.points)[:, side]
        np.testing.assert_allclose(
            rational_errors(part, chosen)[:, 0] * part.pixels, errors, atol=1e-6)
        assert 2 <= chosen.sum() <= 23
        assert rms(errors[:, None])[0] < 0.5 or chosen.sum() == 23


@pytest.mark.parametrize(("noise", "thumb"), [(0.1, 0.15), (0.0, 1e-9)])
@pytest.mark.parametrize("r", [1, 2])
def test_the_truth_is_found(noise: float, thumb: float, r: int) -> None:
    for seed in range(3):
        part, true = sparse(seed, r=r, noise=noise)
        chosen = NestedRegression(thumb=thumb).choose(part)
        assert chosen[true].all()
        assert chosen.sum() <= true.sum() + 4
