"""Regressions made up for tests of solvers that choose terms by regression."""

from __future__ import annotations

from typing import Any

import numpy as np

from termsel import Regression


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
