"""The lasso, against its conditions, scikit-learn and coordinate descent."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

pytest.importorskip("termsel_rivals", reason="termsel-rivals is not installed: "
                    "pip install -e plugins/termsel-rivals")

from termsel import Regression
from termsel_rivals.lasso import Lasso, PathPiece, lasso_path


def conditions_hold(columns: np.ndarray, target: np.ndarray, piece: PathPiece, share: float,
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
    rng = np.random.default_rng(3)
    columns = np.column_stack([np.ones(20), rng.normal(size=(20, 8))])
    target = columns[:, [0, 2, 5, 7]] @ rng.normal(size=(4, 1)) + rng.normal(size=(20, 1))
    first = np.arange(9) == 0
    part = Regression(np.arange(9), columns, target, None, first, first, ~first, 1, 9, 1.0)
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
