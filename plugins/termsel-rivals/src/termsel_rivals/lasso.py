"""The lasso: terms that survive an L1 penalty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from termsel import Option, Regression, TermRegression
from termsel_rivals.arrays import BoolArray, FloatArray, IntArray
from termsel_rivals.nested import DEPENDENT

EXPLAINED = 1e-12
"""Share of the largest penalty below which only rounding is left."""


@dataclass(frozen=True, eq=False)
class PathPiece:
    """A piece of the path on which the same columns are in use."""

    above: float  # penalty at its start
    below: float  # penalty at its end
    active: IntArray  # the columns in use
    start: FloatArray  # (k, r): coefficients, which are linear in the penalty between both ends
    end: FloatArray  # (k, r)


def lasso_path(columns: FloatArray, target: FloatArray, most: int) -> list[PathPiece]:
    """Return the path of the lasso from the largest penalty down to `most` columns in use.

    Minimises ||y - X b||^2 / 2 + penalty sum |b| for every penalty, X (m, k) and y (m, r): least
    angle regression in which a column leaves as its coefficient passes 0 (Efron, Hastie, Johnstone,
    Tibshirani 2004, section 3.1). With several targets it is multiresponse least angle regression
    (Similä, Tikka 2005), in which no column leaves. Columns that depend on those in use do
    not enter.
    """
    k, r = columns.shape[1], target.shape[1]
    x = np.zeros((k, r))
    least = DEPENDENT * np.linalg.norm(columns, axis=0)
    lengths = np.linalg.norm(columns.T @ target, axis=1)
    top = penalty = float(lengths.max(initial=0.0))
    pieces: list[PathPiece] = []
    if most < 1 or top == 0.0:
        return pieces
    active = [int(lengths.argmax())]
    gone = -1  # the column that has just left: by rounding it might enter again
    # Many more pieces than columns would be steps of rounding size.
    while active and penalty > EXPLAINED * top and len(pieces) < 20 * k:
        rest = target - columns @ x
        # Along this step the columns in use keep equal correlations with what is left.
        q, triangle = np.linalg.qr(columns[:, active])
        step = linalg.solve_triangular(triangle, q.T @ rest)
        enters = _shares_to_enter(columns.T @ rest, columns.T @ (q @ (q.T @ rest)), penalty)
        depends = np.linalg.norm(columns - q @ (q.T @ columns), axis=0) <= least
        enters[depends] = np.inf
        if gone >= 0:
            enters[gone] = np.inf
        leaves = np.full(len(active), np.inf)
        if r == 1:  # with several targets no column leaves
            turns = x[active, 0] * step[:, 0] < 0.0
            leaves[turns] = -x[active, 0][turns] / step[turns, 0]
        share = min(1.0, float(enters.min()), float(leaves.min()))
        here, start, above = np.array(active), x.copy(), penalty
        x[active] += share * step
        penalty *= 1.0 - share
        gone = -1
        if share == leaves.min():
            gone = active.pop(int(leaves.argmin()))
            x[gone] = 0.0
        pieces.append(PathPiece(above, penalty, here, start, x.copy()))
        if gone < 0 and share < 1.0:  # at 1 the least-squares solution of those in use is reached
            if len(active) == most:
                break
            active.append(int(enters.argmin()))
    return pieces


def _shares_to_enter(c: FloatArray, a: FloatArray, penalty: float) -> FloatArray:
    """Return the share of the step at which each column correlates as much as those in use.

    The first root of |c - share a| = (1 - share) penalty, which lies between 0 and 1.
    """
    # p share^2 - 2 q share + s = 0; the form that does not cancel.
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

    def choose(self, part: Regression) -> BoolArray:
        """Return the chosen columns."""
        pieces = _path(part, np.ones(len(part.target), dtype=bool))
        if not pieces:
            return part.kept
        # The middle of each piece, in logarithms.
        penalties = np.array([np.sqrt(max(piece.above * piece.below, 0.0)) for piece in pieces])
        square = np.zeros(len(pieces))
        fold = np.arange(len(part.target)) % min(self.options["folds"], len(part.target))
        for out in range(fold.max() + 1):
            square += _squares_left_out(part, fold != out, penalties)
        # Of those that leave rounding alone the first, with the largest penalty.
        return _selection(part, pieces[int(np.maximum(square, part.rounding).argmin())])


def _path(part: Regression, rows: BoolArray) -> list[PathPiece]:
    """Return the path of the free columns over some of the rows."""
    standard = part.standardised(part.free, part.kept, rows)
    # A redundancy of 1 is left within a fold, too.
    room = min(part.most, int(rows.sum()) - 1) - int(part.kept.sum())
    return lasso_path(standard.columns, standard.target, room)


def _selection(part: Regression, piece: PathPiece) -> BoolArray:
    """Return the columns in use on a piece, with the kept ones."""
    chosen = part.kept.copy()
    chosen[np.flatnonzero(part.free)[piece.active]] = True
    return chosen


def _squares_left_out(part: Regression, rows: BoolArray, penalties: FloatArray) -> FloatArray:
    """Return the squares of the errors at the rows not in use, for each penalty (p,).

    Penalties are for all rows; with unit columns they scale with the root of the number of rows.
    """
    unit = part.unit
    path = _path(part, rows)
    choices = [part.kept, *(_selection(part, piece) for piece in path)]
    squares = []
    for chosen in choices:
        x = np.linalg.lstsq(unit[np.ix_(rows, chosen)], part.target[rows], rcond=DEPENDENT)[0]
        squares.append(((part.target[~rows] - unit[np.ix_(~rows, chosen)] @ x) ** 2).sum())
    # Before the first piece nothing free is in use; below the last the path is not known.
    above = np.array([piece.above for piece in path])
    number = (above[None] >= penalties[:, None] * np.sqrt(rows.mean())).sum(axis=1)
    return np.asarray(np.array(squares)[number])
