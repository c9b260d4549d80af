"""Terms by the scatter matrix of the columns and the elimination transformation."""

from __future__ import annotations

import numpy as np

from termsel import Option, Regression, TermRegression, TermselError
from termsel_rivals.arrays import BoolArray, FloatArray
from termsel_rivals.stepwise import with_column


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

    def choose(self, part: Regression) -> BoolArray:
        """Return the chosen columns; refuse limits at which terms leave more easily than enter."""
        f_in, f_out = self.options["f_in"], self.options["f_out"]
        if f_out > f_in:
            raise TermselError(f"f_out is {f_out:g} and f_in {f_in:g}",
                               hint="Give an f_out of at most f_in; otherwise terms enter and "
                                    "leave forever.")
        chosen = part.kept.copy()
        scatter, left = scatter_of(part)
        for j in np.flatnonzero(chosen & ~part.constant):
            if scatter[j, j] > self.options["tolerance"]:
                scatter = swept(scatter, int(j))
        seen = {chosen.tobytes()}
        while chosen.sum() < part.most:
            gain = explained(scatter, len(chosen))
            ready = part.free & ~chosen & (left > 0) \
                & (np.diag(scatter)[:len(chosen)] > self.options["tolerance"])
            best = part.largest(np.where(ready, gain, -1.0))
            if not ready[best]:
                break
            other = chosen.copy()
            other[best] = True
            if chosen.sum() >= part.least \
                    and self._f(part, scatter, gain[best], other, chosen, entering=True) <= f_in:
                break
            scatter, chosen = swept(scatter, best), other
            while True:
                loss = np.where(chosen & part.free, explained(scatter, len(chosen)), np.inf)
                worst = int(loss.argmin())
                fewer = with_column(chosen, worst, False)
                if worst == best or not np.isfinite(loss[worst]) or chosen.sum() <= part.least \
                        or self._f(part, scatter, loss[worst], chosen, fewer,
                                   entering=False) >= f_out:
                    break
                scatter, chosen = swept(scatter, worst), fewer
            if chosen.tobytes() in seen:
                break
            seen.add(chosen.tobytes())
        return chosen

    def _f(self, part: Regression, scatter: FloatArray, change: float, with_it: BoolArray,
           without: BoolArray, *, entering: bool) -> float:
        """Return the F of a column, given the columns in use with it and without it (k,).

        Where these leave rounding alone it is 0, and where those do, infinite: differences of the
        scatter matrix would tell neither.
        """
        if part.explained(square_left(part, without)):
            return 0.0
        if part.explained(square_left(part, with_it)):
            return float("inf")
        k, targets = len(with_it), part.target.shape[1]
        rest = float(np.diag(scatter)[k:].sum()) - (change if entering else 0.0)
        freedom = part.freedom(with_it)
        if freedom < 1:
            return 0.0
        return float("inf") if rest <= 0.0 else (change / targets) / (rest / freedom)


def square_left(part: Regression, chosen: BoolArray) -> float:
    """Return the residual sum of squares of the adjustment with chosen columns (k,)."""
    q = np.linalg.qr(part.unit[:, chosen])[0]
    rest = part.target - q @ (q.T @ part.target)
    return float((rest**2).sum())


def scatter_of(part: Regression) -> tuple[FloatArray, FloatArray]:
    """Return the scatter matrix of columns and targets, (k + r, k + r), and lengths (k,)."""
    together = np.column_stack([part.unit, part.target])
    if part.constant.any():
        constant = part.unit[:, part.constant]
        together = together - constant @ (constant.T @ together)
    k = len(part.constant)
    lengths = np.linalg.norm(together[:, :k], axis=0)
    lengths[part.constant] = 0.0
    # Unit columns have a diagonal of 1: what is left of it later is the share not explained.
    together[:, :k] = np.where(lengths > 1e-12, together[:, :k] / np.maximum(lengths, 1e-300), 0.0)
    scale = np.linalg.norm(together[:, k:])
    together[:, k:] /= scale if scale > 0 else 1.0
    return together.T @ together, np.where(lengths > 1e-12, lengths, 0.0)


def swept(scatter: FloatArray, pivot: int) -> FloatArray:
    """Return the matrix after the elimination transformation of a pivot; twice is once undone."""
    d = scatter[pivot, pivot]
    row, column = scatter[pivot].copy(), scatter[:, pivot].copy()
    after = scatter - np.outer(column, row) / d
    after[pivot], after[:, pivot] = row / d, -column / d
    after[pivot, pivot] = 1.0 / d
    return np.asarray(after)


def explained(scatter: FloatArray, k: int) -> FloatArray:
    """Return the part of the targets that each of k columns adds, or takes away if it is in use."""
    diagonal = np.diag(scatter)[:k]
    cross = -scatter[:k, k:] * scatter[k:, :k].T
    # Of a column that is in use the two have opposite signs, of another the same.
    return np.asarray(np.abs(cross).sum(axis=1) / np.where(diagonal > 0, diagonal, np.inf))
