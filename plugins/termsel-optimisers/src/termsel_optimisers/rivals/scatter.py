"""Terms by the scatter matrix of the columns and the elimination transformation."""

from __future__ import annotations

import numpy as np

from termsel import Option, Regression, TermRegression, TermselError
from termsel_optimisers.arrays import BoolArray, FloatArray
from termsel_optimisers.rivals.stepwise import with_column


class ScatterMatrix(TermRegression):
    """Scatter matrix and elimination transformation: terms enter and leave by F tests.

    Zhang, Lu, Wang and Huang 2012, "A new approach on optimization of the rational function model
    of high-resolution satellite imagery", IEEE TGRS 50(7), p. 2758. Only a summary could be
    consulted: about 35 essential coefficients remain, chosen by the scatter matrix and the
    elimination transformation, which remove collinear ones. The formulation here is termsel's own,
    that of stepwise regression by these two tools.

    The scatter matrix has the products of all columns and the target, each about its part along
    the constant and at unit length. The elimination transformation of a pivot (a sweep) takes a
    column in, and a second one takes it out again. The diagonal then says of each column which
    share of it the chosen ones leave: below `tolerance` it is collinear and cannot enter. The
    column that explains most enters if its F is above `f_in`; the one in use that explains least
    leaves if its F is below `f_out`.

    It differs from `stepwise` in the test of collinearity, which that has for rounding alone, and
    in fixed limits to F.
    """

    name = "scatter-matrix"
    declared_options = (
        Option("f_in", 4.0, "F from which a term enters.", float, 0.0, 1e9),
        Option("f_out", 3.9, "F below which a term leaves; at most f_in.", float, 0.0, 1e9),
        Option("tolerance", 1e-4, "Least share of a column that the chosen ones do not explain; a "
                                  "variance inflation of 10,000.", float, 1e-10, 1.0))

    def choose(self, regression: Regression) -> BoolArray:
        """Return the chosen columns (k,), which enter and leave by F tests.

        Raises TermselError for limits at which terms leave more easily than they enter.
        """
        f_in = self.options["f_in"]
        f_out = self.options["f_out"]
        if f_out > f_in:
            raise TermselError(f"f_out is {f_out:g} and f_in {f_in:g}",
                               hint="Give an f_out of at most f_in; otherwise terms enter and "
                                    "leave forever.")
        selection = regression.kept.copy()
        scatter, lengths = scatter_of(regression)
        # Columns that are always in use are swept first. The constant is in no product.
        for j in np.flatnonzero(selection & ~regression.constant):
            if scatter[j, j] > self.options["tolerance"]:
                scatter = sweep_pivot(scatter, int(j))
        visited = {selection.tobytes()}
        while selection.sum() < regression.most:
            gain = explained_squares(scatter, len(selection))
            unexplained = np.diag(scatter)[:len(selection)]
            can_enter = (regression.free & ~selection & (lengths > 0)
                         & (unexplained > self.options["tolerance"]))
            best = regression.largest(np.where(can_enter, gain, -1.0))
            if not can_enter[best]:
                break
            larger = selection.copy()
            larger[best] = True
            # Up to the fewest columns the best one enters whatever its F.
            if selection.sum() >= regression.least and self._partial_f(
                    regression, scatter, gain[best], larger, selection, entering=True) <= f_in:
                break
            scatter = sweep_pivot(scatter, best)
            selection = larger
            while True:
                loss = np.where(selection & regression.free,
                                explained_squares(scatter, len(selection)), np.inf)
                worst = int(loss.argmin())
                smaller = with_column(selection, worst, False)
                # A column that has just entered does not leave at once, as it might alternate.
                if (worst == best or not np.isfinite(loss[worst])
                        or selection.sum() <= regression.least):
                    break
                f_of_worst = self._partial_f(regression, scatter, loss[worst], selection, smaller,
                                             entering=False)
                if f_of_worst >= f_out:
                    break
                scatter = sweep_pivot(scatter, worst)
                selection = smaller
            if selection.tobytes() in visited:
                break
            visited.add(selection.tobytes())
        return selection

    def _partial_f(self, regression: Regression, scatter: FloatArray, change: float,
                   with_it: BoolArray, without: BoolArray, *, entering: bool) -> float:
        """Return the F of a column that enters, or leaves if not `entering`.

        `with_it` and `without` (k,) are the columns in use with and without the column, and
        `change` is the difference of their residual squares, in units of the scatter matrix. F is 0
        if the residuals without the column are rounding alone, or without redundancy, and infinite
        if only those with the column are.
        """
        # Differences of the scatter matrix would not show residuals that are rounding alone.
        if regression.explained(residual_square_of(regression, without)):
            return 0.0
        if regression.explained(residual_square_of(regression, with_it)):
            return float("inf")
        # F = (change / r) / (RSS / f), with RSS and its degrees of freedom f of the larger set.
        k = len(with_it)
        r = regression.target.shape[1]
        # The matrix has the residual squares of the columns in use, which lack one that enters.
        residual_square = float(np.diag(scatter)[k:].sum()) - (change if entering else 0.0)
        f = regression.freedom(with_it)
        if f < 1:
            return 0.0
        if residual_square <= 0.0:
            return float("inf")
        return float((change / r) / (residual_square / f))


def residual_square_of(regression: Regression, selection: BoolArray) -> float:
    """Return the residual sum of squares of the adjustment with chosen columns (k,)."""
    q = np.linalg.qr(regression.unit[:, selection])[0]
    residuals = regression.target - q @ (q.T @ regression.target)
    return float((residuals**2).sum())


def scatter_of(regression: Regression) -> tuple[FloatArray, FloatArray]:
    """Return the scatter matrix (k + r, k + r) of columns and targets, and lengths (k,).

    Lengths are those of the columns without their part along the constant, and 0 for one that
    depends on it. In the matrix columns have the length 1, and so have all targets together.
    """
    columns = np.column_stack([regression.unit, regression.target])
    if regression.constant.any():
        constant = regression.unit[:, regression.constant]
        columns = columns - constant @ (constant.T @ columns)
    k = len(regression.constant)
    lengths = np.linalg.norm(columns[:, :k], axis=0)
    lengths[regression.constant] = 0.0
    # With unit columns the diagonal is 1, and later the share that the columns in use leave.
    columns[:, :k] = np.where(lengths > 1e-12, columns[:, :k] / np.maximum(lengths, 1e-300), 0.0)
    scale = np.linalg.norm(columns[:, k:])
    columns[:, k:] /= scale if scale > 0 else 1.0
    return columns.T @ columns, np.where(lengths > 1e-12, lengths, 0.0)


def sweep_pivot(scatter: FloatArray, pivot: int) -> FloatArray:
    """Return a scatter matrix (n, n) after the elimination of the column `pivot`.

    Its rows and columns are then those of the residuals of the others after a regression on that
    column. Done twice, it gives the matrix back.
    """
    d = scatter[pivot, pivot]
    row = scatter[pivot].copy()
    column = scatter[:, pivot].copy()
    # s_ij - s_ip s_pj / s_pp; the row of the pivot is divided by s_pp, its column by -s_pp.
    swept = scatter - np.outer(column, row) / d
    swept[pivot] = row / d
    swept[:, pivot] = -column / d
    swept[pivot, pivot] = 1.0 / d
    return np.asarray(swept)


def explained_squares(scatter: FloatArray, k: int) -> FloatArray:
    """Return the part of the targets' square (k,) that each column explains or would explain.

    For a column that is not in use it is what it would add, for one in use what would be lost
    without it.
    """
    diagonal = np.diag(scatter)[:k]
    # The sum over the targets t of |s_it s_ti| / s_ii: a column that was swept has s_ti = -s_it.
    products = scatter[:k, k:] * scatter[k:, :k].T
    return np.asarray(np.abs(products).sum(axis=1) / np.where(diagonal > 0, diagonal, np.inf))
