"""The best subset of each size: `exact` compared with abess, l0bnb and scikit-learn.

All select among 20 terms of a 2-D polynomial, 27 control points, with the constant taken out.
Times are processor seconds on one core, the least of three. `exact` proves the least sum of
squares of every size up to the given one; abess splices subsets of each of these sizes and proves
none; l0bnb proves one size up to a gap of 1 %, with the penalty that has this size as its optimum,
or ends after a minute; scikit-learn adds terms one by one, judged at the selection points, as
`exact` is for that row. The disagreement is by how much more their worst size leaves. What is not
installed is left out (pip install abess l0bnb).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator

import numpy as np

from benchmarks.bench_kernels import Row, best_of
from benchmarks.bench_subsets import finish, lapack, polynomial_2d
from termsel.data.features import BoolArray, FloatArray
from termsel.selection.best_subsets.columns.system import SubsetSystem

MOST, PENALISED = 8, 4
"""Terms of the largest subsets, and of those that l0bnb proves."""

ROUNDING = 1e-6
"""Unit of the target for abess: what gains less than about 0.01 is not exchanged."""


def without_constant() -> SubsetSystem:
    """Return 20 terms of which the mean over the control points is taken, as intercepts do."""
    whole = polynomial_2d(np.random.default_rng(21))
    assert whole.check_design is not None
    assert whole.check_target is not None
    columns, target = whole.design[:, 1:].mean(axis=0), whole.target.mean(axis=0)
    return SubsetSystem(whole.design[:, 1:] - columns, whole.target - target,
                        whole.check_design[:, 1:] - columns, whole.check_target - target)


def _excess(system: SubsetSystem, score: str, best: FloatArray,
            selected: dict[int, BoolArray]) -> float:
    """Return by how much more than the best of their sizes some subsets leave, at worst."""
    return max(lapack(system, score, columns, ()) / float(best[size]) - 1
               for size, columns in selected.items())


def abess(system: SubsetSystem) -> Iterator[Row]:
    """Yield all sizes next to abess."""
    from abess.linear import LinearRegression

    target = system.target[:, 0] / ROUNDING

    def splice() -> dict[int, BoolArray]:
        return {size: LinearRegression(support_size=size, thread=1).fit(
            system.design, target).coef_ != 0 for size in range(1, MOST + 1)}

    best = finish(system, "rss", max_terms=MOST)[0].best
    ours, theirs = best_of([lambda: finish(system, "rss", max_terms=MOST), splice])
    yield (f"rss, 1 to {MOST} of 20 terms", ours, "abess, no proof", theirs, theirs / ours,
           _excess(system, "rss", best, splice()))


def l0bnb(system: SubsetSystem) -> Iterator[Row]:
    """Yield one size next to l0bnb, whose problem has a penalty on the number of terms."""
    setattr(np, "Inf", np.inf)  # noqa: B010 - it was written for NumPy 1
    from l0bnb import BNBTree

    result = finish(system, "rss", max_terms=MOST)[0]
    best = np.append([(system.target**2).sum()], result.best[1:MOST + 1])
    below, above = np.arange(PENALISED), np.arange(PENALISED + 1, MOST + 1)
    penalty = np.sqrt(((best[below] - best[PENALISED]) / (PENALISED - below)).min()
                      * ((best[PENALISED] - best[above]) / (above - PENALISED)).max()) / 2
    columns = result.columns(PENALISED)
    largest = np.abs(np.linalg.lstsq(system.design[:, columns], system.target)[0]).max()
    found: list[BoolArray] = []

    def prove() -> None:
        tree = BNBTree(system.design, system.target[:, 0])
        found.append(tree.solve(penalty, 0.0, 1.2 * largest, gap_tol=0.01,
                                time_limit=60).beta != 0)

    prove()  # compiles
    ours, theirs = best_of([lambda: finish(system, "rss", max_terms=PENALISED), prove])
    yield (f"rss, {PENALISED} of 20 terms", ours, "l0bnb, gap of 1 %", theirs, theirs / ours,
           _excess(system, "rss", best, {PENALISED: found[-1]}))


def forward(system: SubsetSystem) -> Iterator[Row]:
    """Yield the best subset by selection points next to scikit-learn's forward selection."""
    from sklearn.feature_selection import SequentialFeatureSelector
    from sklearn.linear_model import LinearRegression
    from sklearn.model_selection import PredefinedSplit

    assert system.check_design is not None
    assert system.check_target is not None
    X = np.concatenate([system.design, system.check_design])
    y = np.concatenate([system.target, system.check_target])[:, 0]
    check = np.r_[np.full(len(system.design), -1), np.zeros(len(system.check_design), dtype=int)]

    def select() -> BoolArray:
        return np.asarray(SequentialFeatureSelector(
            LinearRegression(fit_intercept=False), n_features_to_select=MOST,
            scoring="neg_mean_squared_error", cv=PredefinedSplit(check)).fit(X, y).get_support())

    best = finish(system, "check", max_terms=MOST)[0].best
    ours, theirs = best_of([lambda: finish(system, "check", max_terms=MOST), select])
    yield (f"check, up to {MOST} of 20 terms", ours, "scikit-learn, forward", theirs,
           theirs / ours, _excess(system, "check", best, {MOST: select()}))


def rows() -> Iterator[Row]:
    """Yield a row for each that is installed."""
    system = without_constant()
    peers: tuple[Callable[[SubsetSystem], Iterator[Row]], ...] = (forward, abess, l0bnb)
    for peer in peers:
        try:
            yield from peer(system)
        except ImportError as error:
            print(f"bench_peers: {peer.__name__} is skipped; requires {error.name}",
                  file=sys.stderr)
