"""Selection of the columns of a design matrix by a solver of termsel."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from math import comb, log
from typing import Any, ClassVar

import numpy as np
from sklearn.feature_selection import SelectorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from termsel import (
    Bits,
    EnumerablePart,
    Evaluation,
    Genome,
    Problem,
    Selection,
    SubsetSystem,
    TermselError,
    search,
)
from termsel_sklearn.arrays import BoolArray, FloatArray, IntArray
from termsel_sklearn.parts import WithOptions, weights_of

_INFEASIBLE_VALUE = 1e9
"""Criterion of columns that depend on each other; finite, as every objective is."""

_MIN_EIGENVALUE = 1e-10
"""Smallest eigenvalue that the Gram matrix of the columns in use may have; each has length 1."""


def _unit_columns(values: FloatArray, root: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return columns (n, k) as weighted least squares take them, and which are constant (k,).

    `root` (n, 1) has the roots of the weights. The weighted mean is taken off each column, which is
    then multiplied by `root` and scaled to length 1. Constant columns keep what rounding leaves.
    """
    # A constant column without its mean has values of rounding alone. Rounding is relative to the
    # size of the column, so that units do not matter.
    rounding = len(values) * np.finfo(np.float64).eps * np.linalg.norm(root * values, axis=0)
    centred = root * (values - np.average(values, axis=0, weights=root[:, 0]**2))
    size = np.linalg.norm(centred, axis=0)
    constant = size <= rounding
    return centred / np.where(constant, 1.0, size), constant


class ColumnProblem(Problem):
    """Which columns of X (n, k), at most so many, explain y (n, m) by the extended BIC.

    n log(RSS / n) + s log n + 2 log C(k, s) for s of k columns (Chen and Chen 2008, Biometrika
    95(3), equation 1 with gamma 1). Above half of the columns C(k, s) is that of half of them:
    it falls again there, and is 1 of all columns, which would let noise among few columns in. A
    constant, the first gene, is always in the fit and does not
    count. RSS is that of all targets, each in the unit of its own standard deviation. Weights (n,)
    are above 0 and count relative to each other: a variance that the criterion estimates has no
    other use for them.
    """

    objectives = ("ebic",)

    def __init__(self, X: FloatArray, y: FloatArray, weights: FloatArray, max_columns: int) -> None:
        """Put columns and targets in the units of the fit; TermselError if all of X or of y are
        constant.
        """
        self._n, k = X.shape
        # Their mean is 1, so that RSS / n is a mean of squares.
        weights = weights / weights.mean()
        # Rows times the roots of their weights: plain least squares are then weighted ones.
        root = np.sqrt(weights)[:, None]
        # With columns of length 1, one limit of the eigenvalues holds in all units.
        X, constant = _unit_columns(X, root)
        if constant.all():
            raise TermselError("every column of X is constant, so that there is none to select")
        y, is_constant_target = _unit_columns(y, root)
        if is_constant_target.all():
            raise TermselError("y is constant, so that there is nothing for columns to explain")
        # With standard deviations of 1, the unit of a target does not decide how much it counts.
        y = y[:, ~is_constant_target] * np.sqrt(self._n)
        self._gram = X.T @ X
        self._right = X.T @ y
        self._total = float((y**2).sum())
        self._design = np.column_stack([root, X])
        self._target = y
        # The penalty of Chen and Chen for each number of columns.
        self._penalty = np.array([s * log(self._n) + 2.0 * log(comb(k, min(s, k // 2)))
                                  for s in range(k + 1)])
        names = tuple(f"{i}" for i in range(k))
        self.genome = Genome(
            [Bits("columns", ("constant", *names), 2,
                  min(max_columns, int((~constant).sum())) + 1)],
            on=["constant"], off=[name for name, off in zip(names, constant, strict=True) if off])

    def evaluate(self, genes: BoolArray) -> Evaluation:
        """Return the criterion for genes (p, 1 + k), the first of which is that of the constant.

        Selections with a constant column, or with columns that depend on each other, are violated,
        and have the value `_INFEASIBLE_VALUE`. RSS is y'y - b'X'y at the solution b.
        """
        violation = (genes & self.genome.off).sum(axis=1).astype(np.float64)
        genes = genes[:, 1:]
        in_use_together = genes[:, :, None] & genes[:, None, :]
        # Columns out of use become those of the unit matrix: all systems have one size, and are
        # solved at once.
        system = np.where(in_use_together, self._gram, np.eye(genes.shape[1]))
        violation += np.linalg.eigvalsh(system)[:, 0] < _MIN_EIGENVALUE
        right = np.where(genes[:, :, None], self._right, 0.0)
        is_feasible = violation == 0
        rss = np.full(len(genes), np.inf)
        solved = np.linalg.solve(system[is_feasible], right[is_feasible])
        rss[is_feasible] = self._total - (solved * right[is_feasible]).sum(axis=(1, 2))
        value = self._criterion_values(rss, genes.sum(axis=1))
        return Evaluation(np.where(is_feasible, value, _INFEASIBLE_VALUE)[:, None], violation)

    def _criterion_values(self, rss: FloatArray, size: IntArray) -> FloatArray:
        """Return the criterion of sums of squares (p,) by selections of so many columns (p,)."""
        # An exact fit has a residual of rounding alone, whose logarithm is a matter of chance.
        floor = np.finfo(np.float64).eps * max(self._total, np.finfo(np.float64).tiny)
        return np.asarray(
            self._n * np.log(np.maximum(rss, floor) / self._n) + self._penalty[size])

    def parts(self) -> tuple[EnumerablePart, ...]:
        """Return the one linear system, in which the constant is always used."""
        genome = self.genome
        # The constant does not count.
        sizes = np.maximum(np.arange(genome.size + 1) - 1, 0)
        return (EnumerablePart(
            np.arange(genome.size),
            SubsetSystem(self._design, self._target, forced=genome.on, forbidden=genome.off),
            "rss", partial(self._criterion_values, size=sizes)),)

    def design(self) -> FloatArray:
        """Return the columns of the constant and of X, as the system has them, shape (n, 1 + k)."""
        return self._design

    def decode(self, genes: BoolArray) -> Selection:
        """Return the columns that genes (1 + k,) select, by their numbers from 0 as names of terms.
        """
        return Selection(tuple(str(i) for i in np.flatnonzero(genes[1:])), ())


class TermSelector(SelectorMixin, WithOptions):  # type: ignore[misc]
    """Select columns, such as those of `PolynomialFeatures`, by a search over all subsets.

    Parameters
    ----------
    solver : str, class or Solver
        Such as "ga", "swap" or "pso"; "exact", which proves the best of up to 61 columns; or a
        method of its own criterion, such as "stepwise".
    max_terms : int or None
        Most columns; by default a third of the rows that differ.
    generations : int or None
        Budget of the search; the solver's own by default.
    seed : int
        Seed of the search.
    options : dict or None
        Options of the solver. ``set_params`` and grids also take each by its name.

    Attributes
    ----------
    support_ : ndarray of bool, shape (k,)
        Columns that are selected, at least one.
    search_ : termsel.Search
        The search, with its criterion.

    Examples
    --------
    >>> import numpy as np
    >>> from termsel_sklearn import TermSelector
    >>> X = np.random.default_rng(1).normal(size=(60, 8))
    >>> y = 2.0 * X[:, 1] - X[:, 4]
    >>> TermSelector().fit(X, y).get_support(indices=True).tolist()
    [1, 4]
    """

    extension = "solver"
    attributes_elsewhere: ClassVar[Mapping[str, str]] = {
        "predict": "A selector predicts nothing: put it before a regressor, "
                   "make_pipeline(TermSelector(), LinearRegression()).",
        "coef_": "A selector has the columns alone: support_.",
        "estimator_": "A selector has none; its search is search_.",
        "ranking_": "Columns are selected or not: support_.",
        "n_features_": "support_.sum() counts them.",
        "scores_": "The criterion of the columns is that of search_."}

    def __init__(self, solver: Any = "swap", max_terms: int | None = None,
                 generations: int | None = None, seed: int = 1,
                 options: dict[str, Any] | None = None) -> None:
        self.solver = solver
        self.max_terms = max_terms
        self.generations = generations
        self.seed = seed
        self.options = options

    def fit(self, X: Any, y: Any, sample_weight: Any = None) -> TermSelector:
        """Select columns.

        Parameters
        ----------
        X : array_like, shape (n, k)
        y : array_like, shape (n,) or (n, m)
            Targets; units do not matter, since each is divided by its standard deviation.
        sample_weight : array_like, shape (n,), optional
            Weights of the rows relative to each other, such as 1 over the variance of each; their
            scale does not matter, and a row of weight 0 is left out.

        Returns
        -------
        TermSelector
            Itself, fitted.

        Raises
        ------
        ValueError
            For a parameter that is not known, or a value it does not accept; if y or all columns of
            X are constant.
        """
        X, y = validate_data(self, X, y, multi_output=True, y_numeric=True, dtype=np.float64,
                             ensure_min_samples=2)
        y = np.asarray(y, np.float64).reshape(len(X), -1)
        weights = weights_of(sample_weight, X)
        use = weights > 0
        # Repeated rows add no degrees of freedom.
        distinct = len(np.unique(np.column_stack([X, y])[use], axis=0))
        max_columns = max(1, distinct // 3) if self.max_terms is None else self.max_terms
        if not isinstance(max_columns, (int, np.integer)) or max_columns < 1:
            raise ValueError(f"max_terms is {self.max_terms!r}: give a whole number of at least 1, "
                             "or None for a third of the rows that differ")
        try:
            problem = ColumnProblem(X[use], y[use], weights[use], max_columns)
            self.search_ = search(problem, self._make_extension(), seed=self.seed,
                                  generations=self.generations)
        except TermselError as error:
            raise ValueError(str(error)) from error
        self.support_ = self.search_.genes[1:]
        return self

    def _get_support_mask(self) -> BoolArray:
        """Return which columns are selected, shape (k,); raise NotFittedError before `fit`."""
        check_is_fitted(self)
        return self.support_

    def __sklearn_tags__(self) -> Any:
        """Return the tags of the estimator, which say that it needs y."""
        tags = super().__sklearn_tags__()
        tags.target_tags.required = True
        return tags
