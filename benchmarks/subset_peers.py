"""A peer of `benchmarks.best_subsets`: reads systems from stdin, writes a subset of each size.

``python subset_peers.py PEER`` runs in the environment of that peer and imports nothing of termsel.
Columns and target have length 1, as all peers are given them. Seconds are those of the processor,
without imports and without a first small system, which compiles.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

GAP = 1e-4
"""Relative gap of the residual sum of squares at which a proof ends."""

RIDGE = 1e-9
"""Penalty on the squared coefficients where a peer requires one."""

UNITS = (1.0, 1e2, 1e4, 1e6, 1e8)
"""Factors of the target for abess, whose thresholds are absolute: the best subset of all counts."""


@dataclass(frozen=True)
class Question:
    """Columns and target, the number of columns to choose, and what else a peer is told."""

    X: Any
    y: Any
    k: int
    least: float  # residual sum of squares
    seconds: float
    penalty: tuple[float, float] | None  # on each column, and the largest coefficient


Answer = tuple[list[int], float | None]
"""Columns of the subset, and a lower bound of the residual sum of squares if there is one."""


def abess(asked: Question) -> Answer:
    """Splice a subset of this size."""
    from abess.linear import LinearRegression

    subsets = []
    for unit in UNITS:
        fitted = LinearRegression(support_size=asked.k, fit_intercept=False, thread=1).fit(
            asked.X, unit * asked.y)
        subset = np.flatnonzero(fitted.coef_).tolist()
        A = asked.X[:, subset]
        left = asked.y - A @ np.linalg.lstsq(A, asked.y, rcond=None)[0]
        subsets.append((float(left @ left), subset))
    return min(subsets)[1], None


def okridge(asked: Question) -> Answer:
    """Prove the ridge regression with this number of coefficients."""
    from okridge.node import Node
    from okridge.tree import BNBTree

    if not hasattr(Node, "lower_solve"):  # version 0.1.1 calls it by this name, which it lacks
        Node.lower_solve = Node.lower_solve_fast
    tree = BNBTree(asked.X, asked.y, lambda2=RIDGE, max_memory_GB=2)
    # Its costs are without y'y, so that the gap is of another size.
    _, beta, _, bound, _ = tree.solve(asked.k, gap_tol=GAP * asked.least,
                                      time_limit=asked.seconds)[:5]
    return np.flatnonzero(beta).tolist(), float(bound) + float(asked.y @ asked.y)


def l0bnb(asked: Question) -> Answer:
    """Prove the regression with a penalty on each coefficient that this size is the best for."""
    setattr(np, "Inf", np.inf)  # noqa: B010 - it was written for NumPy 1
    from l0bnb import BNBTree

    if asked.penalty is None:
        raise ValueError("no penalty has this size as its optimum")
    penalty, largest = asked.penalty
    tree = BNBTree(asked.X, asked.y)
    result = tree.solve(penalty, 0.0, 1.2 * largest, gap_tol=GAP, time_limit=asked.seconds)
    # Its gap is relative to its cost, which has half of the squares.
    bound = 2.0 * (float(result.cost) * (1.0 - float(result.gap)) - penalty * asked.k)
    return np.flatnonzero(result.beta).tolist(), bound


def highs(asked: Question) -> Answer:
    """Cut the convex function of the columns in use by its tangents, a MILP each (no MIQP there).

    With the ridge penalty 1 / g the least squares f(z) = y' (I + g X diag(z) X')^-1 y are convex in
    z, with the derivative -g (x_j' a)^2 of a = (I + g X diag(z) X')^-1 y (Bertsimas and Van Parys
    2020).
    """
    import highspy

    X = asked.X
    y = asked.y
    k = asked.k
    p = X.shape[1]
    start = time.process_time()
    model = highspy.Highs()
    model.setOptionValue("output_flag", False)
    model.setOptionValue("threads", 1)
    z = [model.addBinary() for _ in range(p)]
    eta = model.addVariable(0.0)
    model.addConstr(sum(z) == k)
    g = 1.0 / RIDGE
    support = np.argsort(-np.abs(X.T @ y))[:k].tolist()
    best: tuple[float, list[int]] = np.inf, support
    bound = 0.0
    while time.process_time() - start < asked.seconds:
        A = X[:, support]
        alpha = y - A @ np.linalg.solve(A.T @ A + RIDGE * np.eye(k), A.T @ y)
        value = float(y @ alpha)
        best = min(best, (value, support))
        slope = -g * (X.T @ alpha) ** 2
        slope[support] = -((np.linalg.lstsq(A, y, rcond=None)[0]) ** 2) * RIDGE
        if best[0] - bound <= GAP * best[0]:
            break
        # Coefficients that HiGHS takes for zero are: the tangent stays below the function.
        negligible = np.abs(slope) < 1e-9
        constant = value - float(slope[support].sum()) + float(slope[negligible].sum())
        slope[negligible] = 0.0
        # eta - slope z >= constant; the columns in use come first.
        model.addRow(constant, highspy.kHighsInf, p + 1, np.arange(p + 1, dtype=np.int32),
                     np.append(-slope, 1.0))
        model.setOptionValue("time_limit", max(asked.seconds - (time.process_time() - start), 0.1)
                             + model.getRunTime())
        model.minimize(eta)
        bound = max(bound, float(model.getInfo().mip_dual_bound))
        chosen = model.getSolution().col_value
        if not len(chosen):
            break
        support = [j for j in range(p) if chosen[j] > 0.5]
        if len(support) != k:
            break
    return best[1], bound


def sklearn(asked: Question) -> Answer:
    """Add columns one by one, each the one that leaves the smallest residuals."""
    from sklearn.feature_selection import SequentialFeatureSelector
    from sklearn.linear_model import LinearRegression

    rows = np.arange(len(asked.y))
    selector = SequentialFeatureSelector(LinearRegression(fit_intercept=False), scoring="r2",
                                         n_features_to_select=asked.k, cv=[(rows, rows)])
    return np.flatnonzero(selector.fit(asked.X, asked.y).get_support()).tolist(), None


PEERS = {"abess": abess, "okridge": okridge, "l0bnb": l0bnb, "highs": highs, "sklearn": sklearn}


def main() -> None:
    """Answer each system as soon as it is solved."""
    # Limits are of this processor's time: others may be at work on the machine.
    time.time = time.process_time
    peer = PEERS[sys.argv[1]]
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what compiled code prints
    rng = np.random.default_rng(0)
    warm = rng.normal(size=(12, 5))
    warm /= np.linalg.norm(warm, axis=0)
    with contextlib.redirect_stdout(sys.stderr):
        with contextlib.suppress(Exception):
            peer(Question(warm, warm[:, 0] + warm[:, 1] / 2, 2, 1e-3, 5.0, (1e-3, 2.0)))
        for line in sys.stdin:
            system = json.loads(line)
            for k in system["sizes"]:
                asked = Question(np.array(system["X"]), np.array(system["y"]), k,
                                 system["least"][str(k)], system["seconds"],
                                 system["penalties"].get(str(k)))
                start = time.process_time()
                try:
                    columns, bound = peer(asked)
                    failure = ""
                except Exception as error:  # noqa: BLE001 - of another package: the page says it
                    columns, bound, failure = [], None, f"{type(error).__name__}: {error}"
                row = {"k": k, "columns": columns, "bound": bound, "failure": failure,
                       "seconds": time.process_time() - start}
                answers.write(json.dumps(row) + "\n")
                answers.flush()


if __name__ == "__main__":
    main()
