"""The lasso: terms that survive an L1 penalty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from termsel import Option, Regression, TermRegression
from termsel_optimisers.arrays import BoolArray, FloatArray, IntArray
from termsel_optimisers.rivals.nested import DEPENDENT

EXPLAINED = 1e-12
"""Share of the largest penalty below which only rounding is left."""


@dataclass(frozen=True, eq=False)
class PathSegment:
    """A segment of the path on which the same columns are in use."""

    above: float  # penalty at its start
    below: float  # penalty at its end
    active: IntArray  # the columns in use
    start: FloatArray  # (k, r): coefficients, which are linear in the penalty between both ends
    end: FloatArray  # (k, r)


def lasso_path(columns: FloatArray, target: FloatArray, max_columns: int) -> list[PathSegment]:
    """Return the path of the lasso from the largest penalty down to `max_columns` in use.

    At every penalty ||y - X b||^2 / 2 + penalty sum |b| is minimal, for columns X (m, k) and the
    target y (m, 1). The path is that of least angle regression in which a column leaves as its
    coefficient passes 0 (Efron, Hastie, Johnstone, Tibshirani 2004, section 3.1). With several
    targets (m, r) it is multiresponse least angle regression (Similä, Tikka 2005), in which no
    column leaves. Columns that depend on those in use do not enter. [] if none may or can enter.
    """
    k = columns.shape[1]
    r = target.shape[1]
    x = np.zeros((k, r))
    dependent_lengths = DEPENDENT * np.linalg.norm(columns, axis=0)
    lengths = np.linalg.norm(columns.T @ target, axis=1)
    top = penalty = float(lengths.max(initial=0.0))
    path: list[PathSegment] = []
    if max_columns < 1 or top == 0.0:
        return path
    active = [int(lengths.argmax())]
    # The column that left in the last step, which by rounding might enter again at once; -1 for
    # none.
    just_left = -1
    # Many more segments than columns would be steps of rounding size.
    while active and penalty > EXPLAINED * top and len(path) < 20 * k:
        residuals = target - columns @ x
        # Along the step to the least-squares solution the columns in use keep equal correlations
        # with the residuals.
        q, triangle = np.linalg.qr(columns[:, active])
        step = linalg.solve_triangular(triangle, q.T @ residuals)
        enters = _shares_to_enter(columns.T @ residuals, columns.T @ (q @ (q.T @ residuals)),
                                  penalty)
        depends = np.linalg.norm(columns - q @ (q.T @ columns), axis=0) <= dependent_lengths
        enters[depends] = np.inf
        if just_left >= 0:
            enters[just_left] = np.inf
        leaves = np.full(len(active), np.inf)
        if r == 1:  # with several targets no column leaves
            # x + share step = 0.
            turns = x[active, 0] * step[:, 0] < 0.0
            leaves[turns] = -x[active, 0][turns] / step[turns, 0]
        # The step ends at the solution, or where the first column enters or leaves.
        share = min(1.0, float(enters.min()), float(leaves.min()))
        in_use = np.array(active)
        start = x.copy()
        above = penalty
        x[active] += share * step
        # The penalty is the correlation of the columns in use, which falls with the residuals.
        penalty *= 1.0 - share
        just_left = -1
        if share == leaves.min():
            just_left = active.pop(int(leaves.argmin()))
            x[just_left] = 0.0
        path.append(PathSegment(above, penalty, in_use, start, x.copy()))
        # At the solution no column enters.
        if just_left < 0 and share < 1.0:
            if len(active) == max_columns:
                break
            active.append(int(enters.argmin()))
    return path


def _shares_to_enter(c: FloatArray, a: FloatArray, penalty: float) -> FloatArray:
    """Return the share (k,) of the step at which each column correlates as much as those in use.

    `c` (k, r) are the products of columns and residuals, `a` (k, r) those that the whole step takes
    off. The share is infinite if there is none.
    """
    # The first root of |c - share a| = (1 - share) penalty, or p share^2 - 2 q share + s = 0, in
    # the form that does not cancel.
    p = penalty**2 - (a**2).sum(axis=1)
    q = penalty**2 - (c * a).sum(axis=1)
    s = np.maximum(penalty**2 - (c**2).sum(axis=1), 0.0)
    root = np.sqrt(np.maximum(q**2 - p * s, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(q > 0.0, s / (q + root), (q - root) / p)
    return np.asarray(np.where(np.isfinite(shares), shares, np.inf))


class Lasso(TermRegression):
    """Lasso: terms that survive an L1 penalty, then adjusted by plain least squares.

    Tibshirani 1996; for the RFM Long, Jiao, He 2015, "RPC estimation via L1-norm-regularized
    least squares (L1LS)", IEEE TGRS 53(8), p. 4554, after the title and the authors' published
    code, which takes the penalty 1e-6 for normalised coordinates and keeps the shrunken
    coefficients. Here the lasso only selects (the LARS-OLS hybrid of Efron et al. 2004,
    section 1), since a selection is judged by its least-squares adjustment.

    The penalty is chosen by cross-validation over the control rows: for each fold the path is
    computed and every selection on it adjusted without the fold; the penalty with the least
    sum of squares over all folds is used. Every folds-th row is one fold, so that nothing is
    random. termsel's own choices: columns have unit length, the constant is not penalised, errors
    are those of the linearised equations, and a redundancy of at least 1 is left. With one
    mask for line and sample the path is that of multiresponse least angle regression.

    The path is exact, and termsel's own. Coordinate descent would converge too slowly: the
    columns of an RFM are nearly dependent and the signal is thousands of times the noise, so
    that small penalties matter.
    """

    name = "lasso"
    declared_options = (
        Option("folds", 10, "Folds of the cross-validation; at most as many as control rows.",
               int, 2, 2**31 - 1),
    )

    def choose(self, regression: Regression) -> BoolArray:
        """Return which columns (k,) the lasso uses at the penalty of the least held-out error.

        The error is that of a cross-validation, in which every `folds`-th row is held out together.
        """
        path = _lasso_path(regression, np.ones(len(regression.target), dtype=bool))
        if not path:
            return regression.kept
        # A segment is judged at its middle, in logarithms.
        penalties = np.array([np.sqrt(max(segment.above * segment.below, 0.0)) for segment in path])
        square = np.zeros(len(path))
        m = len(regression.target)
        fold = np.arange(m) % min(self.options["folds"], m)
        for held_out in range(fold.max() + 1):
            square += _held_out_squares(regression, fold != held_out, penalties)
        # If several leave nothing but rounding, the first is taken, which has the largest penalty.
        chosen = path[int(np.maximum(square, regression.rounding).argmin())]
        return regression.without_surplus(_columns_on_segment(regression, chosen))


def _lasso_path(regression: Regression, rows: BoolArray) -> list[PathSegment]:
    """Return the path of the free columns by the rows that `rows` (m,) marks.

    [] if there is no room for any.
    """
    standard = regression.standardised(regression.free, regression.kept, rows)
    # A redundancy of 1 is left within a fold, too.
    room = min(regression.most, int(rows.sum()) - 1) - int(regression.kept.sum())
    return lasso_path(standard.columns, standard.target, room)


def _columns_on_segment(regression: Regression, segment: PathSegment) -> BoolArray:
    """Return the columns (k,) in use on a segment of the path, with those always kept."""
    selection = regression.kept.copy()
    selection[np.flatnonzero(regression.free)[segment.active]] = True
    return selection


def _held_out_squares(regression: Regression, rows: BoolArray, penalties: FloatArray) -> FloatArray:
    """Return the sum of squared errors at the rows not in use, for each penalty, (p,).

    The path is by the rows that `rows` (m,) marks. Penalties are those for all rows.
    """
    unit = regression.unit
    path = _lasso_path(regression, rows)
    selections = [regression.kept, *(_columns_on_segment(regression, segment) for segment in path)]
    squares = []
    for selection in selections:
        x = np.linalg.lstsq(unit[np.ix_(rows, selection)], regression.target[rows],
                            rcond=DEPENDENT)[0]
        squares.append(((regression.target[~rows] - unit[np.ix_(~rows, selection)] @ x) ** 2).sum())
    # Above the first segment no free column is in use. Columns have unit length over all rows, so
    # that penalties are multiplied by the root of the share of rows in use.
    above = np.array([segment.above for segment in path])
    number = (above[None] >= penalties[:, None] * np.sqrt(rows.mean())).sum(axis=1)
    return np.asarray(np.array(squares)[number])
