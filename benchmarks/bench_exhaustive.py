"""Exhaustive selection: `exact` compared with mlxtend's exhaustive feature selector.

Both evaluate every selection of the first terms of a 2-D polynomial for the line coordinate of
the embedded scene `ikonos-hamedan`, by the sum of squared errors at the selection points. Times are
seconds per selection. mlxtend runs with a scikit-learn regressor, a fixed split into control and
check, and no parallel jobs. The benchmark is skipped if mlxtend is not installed (pip install
mlxtend).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from time import perf_counter

import numpy as np

from benchmarks.bench_kernels import Row
from termsel import prepare
from termsel.selection.best_subsets.columns.system import SubsetSystem
from termsel.selection.best_subsets.subsets import search

TERMS = 10


def rows() -> Iterator[Row]:
    """Yield one row, or none without mlxtend."""
    try:
        from mlxtend.feature_selection import ExhaustiveFeatureSelector
        from sklearn.linear_model import LinearRegression
        from sklearn.metrics import make_scorer
        from sklearn.model_selection import PredefinedSplit
    except ImportError:
        print("bench_exhaustive: skipped; requires mlxtend (pip install mlxtend)", file=sys.stderr)
        return
    whole = prepare("poly-terms", options={"degree": 4}).problem.parts()[0].system
    assert whole.check_design is not None
    system = SubsetSystem(whole.design[:, :TERMS], whole.target, whole.check_design[:, :TERMS],
                          whole.check_target)
    *_, result = search(system, "check")
    start = perf_counter()
    *_, result = search(system, "check")
    ours = (perf_counter() - start) / 2**TERMS

    def squares(measured: np.ndarray, computed: np.ndarray) -> float:
        return float(((measured - computed) ** 2).sum())

    assert system.check_design is not None
    assert system.check_target is not None
    X = np.concatenate([system.design, system.check_design])
    y = np.concatenate([system.target, system.check_target])[:, 0]
    fold = np.r_[np.full(len(system.design), -1), np.zeros(len(system.check_design), dtype=int)]
    selector = ExhaustiveFeatureSelector(
        LinearRegression(fit_intercept=False), min_features=1, max_features=TERMS,
        scoring=make_scorer(squares, greater_is_better=False), cv=PredefinedSplit(fold),
        print_progress=False)
    start = perf_counter()
    selector.fit(X, y)
    theirs = (perf_counter() - start) / 2**TERMS
    best = float(result.best[1:].min())
    yield (f"all 2^{TERMS} selections of {TERMS} terms", ours, "mlxtend, scikit-learn", theirs,
           theirs / ours, abs(best + selector.best_score_) / best)
