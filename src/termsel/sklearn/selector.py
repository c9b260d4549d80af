"""Selection of the columns of a design matrix by a solver of termsel."""

from __future__ import annotations

from math import comb, log
from typing import Any

import numpy as np
from sklearn.base import BaseEstimator
from sklearn.feature_selection import SelectorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from termsel.errors import TermselError
from termsel.measurements.features import BoolArray, FloatArray
from termsel.plugins.registry import registry
from termsel.problems.base import WORST, Evaluation, Problem, Selection
from termsel.problems.genome import Genome
from termsel.problems.segments import Bits
from termsel.solvers.search import search

_SMALL = 1e-10
"""Smallest share of a column that the others in use must leave."""


class ColumnProblem(Problem):
    """Which columns of X (n, k), at most so many, explain y (n, m) by the extended BIC.

    n log(RSS / n) + s log n + 2 log C(k, s) for s of k columns (Chen and Chen 2008, Biometrika
    95(3), equation 1 with gamma 1). A constant is always in the fit and does not count.
    """

    objectives = ("ebic",)

    def __init__(self, X: FloatArray, y: FloatArray, most: int) -> None:
        X, y = X - X.mean(axis=0), y - y.mean(axis=0)
        # A constant is always in the fit: nothing is left of it once the mean is taken off.
        size = np.linalg.norm(X, axis=0)
        self._constant = size <= _SMALL * np.maximum(np.abs(X).max(initial=0.0), 1.0)
        X = X / np.where(self._constant, 1.0, size)
        self._gram, self._right, self._total = X.T @ X, X.T @ y, float((y**2).sum())
        self._n = len(X)
        k = X.shape[1]
        self._choices = np.array([log(comb(k, size)) for size in range(k + 1)])
        self.genome = Genome([Bits("columns", tuple(f"{i}" for i in range(k)), 1, most)])

    def evaluate(self, genes: BoolArray) -> Evaluation:
        """Return the criterion; columns that depend on others in use violate it."""
        k = len(self._gram)
        both = genes[:, :, None] & genes[:, None, :]
        # Columns that are not in use are those of the unit matrix, so that all systems have one
        # size.
        system = np.where(both, self._gram, np.eye(k))
        violation = (genes & self._constant).sum(axis=1).astype(np.float64)
        violation += np.linalg.eigvalsh(system)[:, 0] < _SMALL
        right = np.where(genes[:, :, None], self._right, 0.0)
        good = violation == 0
        rss = np.full(len(genes), np.inf)
        solved = np.linalg.solve(system[good], right[good])
        rss[good] = self._total - (solved * right[good]).sum(axis=(1, 2))
        size = genes.sum(axis=1)
        # An exact fit has a residual of rounding alone, whose logarithm would choose by chance.
        floor = np.finfo(np.float64).eps * max(self._total, np.finfo(np.float64).tiny)
        value = (self._n * np.log(np.maximum(rss, floor) / self._n) + size * log(self._n)
                 + 2.0 * self._choices[size])
        return Evaluation(np.where(good, value, WORST)[:, None], violation)

    def decode(self, genes: BoolArray) -> Selection:
        """Return the numbers of the columns as names of terms."""
        return Selection(tuple(str(i) for i in np.flatnonzero(genes)), ())


class TermSelector(SelectorMixin, BaseEstimator):  # type: ignore[misc]
    """Select columns, such as those of `PolynomialFeatures`, by a search over all subsets.

    Parameters
    ----------
    solver : str
        Name of a solver, such as "ga", "swap" or "pso".
    max_terms : int or None
        Most columns; by default a third of the rows.
    generations : int or None
        Budget of the search; the solver's own by default.
    seed : int
        Seed of the search.
    options : dict or None
        Options of the solver.

    Attributes
    ----------
    support_ : ndarray of bool, shape (k,)
        Columns that are selected, at least one.
    search_ : termsel.Search
        The search, with its criterion.

    Examples
    --------
    >>> import numpy as np
    >>> from termsel.sklearn import TermSelector
    >>> X = np.random.default_rng(1).normal(size=(60, 8))
    >>> y = 2.0 * X[:, 1] - X[:, 4]
    >>> TermSelector().fit(X, y).get_support(indices=True).tolist()
    [1, 4]
    """

    def __init__(self, solver: str = "swap", max_terms: int | None = None,
                 generations: int | None = None, seed: int = 1,
                 options: dict[str, Any] | None = None) -> None:
        self.solver = solver
        self.max_terms = max_terms
        self.generations = generations
        self.seed = seed
        self.options = options

    def fit(self, X: Any, y: Any) -> TermSelector:
        """Select columns.

        Parameters
        ----------
        X : array_like, shape (n, k)
        y : array_like, shape (n,) or (n, m)

        Raises
        ------
        ValueError
            For a parameter that is not known.
        """
        X, y = validate_data(self, X, y, multi_output=True, y_numeric=True, dtype=np.float64,
                             ensure_min_samples=2)
        n, k = X.shape
        most = max(1, n // 3) if self.max_terms is None else self.max_terms
        try:
            problem = ColumnProblem(X, np.asarray(y, np.float64).reshape(n, -1), min(most, k))
            self.search_ = search(
                problem, registry().get("solvers", self.solver)(**(self.options or {})),
                seed=self.seed, generations=self.generations)
        except TermselError as error:
            raise ValueError(str(error)) from error
        self.support_ = self.search_.genes
        return self

    def _get_support_mask(self) -> BoolArray:
        check_is_fitted(self)
        return self.support_

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.required = True
        return tags
