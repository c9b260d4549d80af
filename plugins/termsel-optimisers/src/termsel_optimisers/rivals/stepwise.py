"""Solvers that choose terms by tests of significance."""

from __future__ import annotations

from math import ceil

import numpy as np
from scipy import special

from termsel import Option, Regression, TermRegression, TermselError
from termsel_optimisers.arrays import BoolArray, FloatArray
from termsel_optimisers.rivals.nested import DEPENDENT


def gains_of_entering(regression: Regression, selection: BoolArray) -> tuple[FloatArray, float]:
    """Return how much each column, if added, lowers the residual sum of squares (k,), and that sum.

    `selection` (k,) marks the chosen columns, with which alone the sum is computed. The gain is 0
    for the chosen columns, and for those that depend on them.
    """
    unit = regression.unit
    q = np.linalg.qr(unit[:, selection])[0]
    residuals = regression.target - q @ (q.T @ regression.target)
    unit = unit - q @ (q.T @ unit)
    # Once the chosen columns are projected out of column a, it lowers the sum by (a . r)^2 / |a|^2.
    lengths = np.linalg.norm(unit, axis=0)
    independent_columns = (lengths > DEPENDENT) & ~selection
    products = np.where(independent_columns[:, None], unit.T @ residuals, 0.0)
    components = products / np.where(independent_columns, lengths, 1.0)[:, None]
    return (components**2).sum(axis=1), float((residuals**2).sum())


def losses_of_leaving(regression: Regression, selection: BoolArray) -> tuple[FloatArray, float]:
    """Return how much each column, if dropped, raises the residual sum of squares, and that sum.

    `selection` (k,) marks the chosen columns, with which the sum is computed. The loss (k,) is
    infinite for columns that are not chosen.
    """
    # Columns that are always in use may depend on each other, which the pseudo-inverse allows.
    inverse = np.linalg.pinv(regression.unit[:, selection], rcond=DEPENDENT)
    x = inverse @ regression.target
    # Without column j the sum rises by x_j^2 / q_jj, with the cofactors Q = (A^T A)^-1 = A+ A+^T.
    cofactors = (inverse**2).sum(axis=1)
    loss = np.full(len(selection), np.inf)
    loss[selection] = (x**2).sum(axis=1) / np.where(cofactors > 0.0, cofactors, np.inf)
    return loss, float(((regression.target - regression.unit[:, selection] @ x) ** 2).sum())


def p_value_of_change(
        regression: Regression, change: float, residual_square: float, selection: BoolArray,
) -> float:
    """Return the probability of a change this large by a column that is not part of the target.

    It is the partial F test of one column, F = (change / r) / (residual_square / f) with r and f
    degrees of freedom. `selection` (k,) has the column, `residual_square` is the residual sum of
    squares with it, and `change` the amount by which it lowers that sum. With one target r is 1,
    and the test is the t test of the column's coefficient, F = t^2. If nothing but rounding errors
    remains with the column, the probability is 0, or 1 if nothing remained without it, either.
    """
    r = regression.target.shape[1]
    f = regression.freedom(selection)
    if regression.explained(residual_square):  # F would be a quotient of rounding errors
        return 1.0 if regression.explained(change) else 0.0
    return float(special.fdtrc(r, f, (change / r) / (residual_square / f)))


def with_column(selection: BoolArray, j: int, is_chosen: bool) -> BoolArray:
    """Return a copy of a selection (k,) in which column j is chosen or not."""
    changed = selection.copy()
    changed[j] = is_chosen
    return changed


class Stepwise(TermRegression):
    """Stepwise regression: add and drop terms by partial F tests.

    Efroymson 1960, "Multiple regression analysis", in Ralston and Wilf, Mathematical Methods
    for Digital Computers; for the RFM Li, Liu, Deng 2016, ISPRS Archives XLI-B3, p. 65, who
    say that line and sample are chosen independently; their thresholds could not be
    consulted. The column that lowers the residual sum of squares most enters if its F is
    significant at `alpha_in`; then, as long as the least significant of those in use is not
    significant at `alpha_out`, it leaves. Only control rows take part. The equations are the
    linearised ones, without the gross-error detection of the paper.

    termsel's own choices: the constant is always in use; columns that depend on those in use do
    not enter, and none enters if that leaves a redundancy below 1; the steps also end when they
    would return to an earlier selection. With one mask for line and sample their
    sums of squares and degrees of freedom are pooled.
    """

    name = "stepwise"
    declared_options = (
        Option("alpha_in", 0.05, "Significance level below which a term enters; 0.05 and 0.10 are "
               "the defaults of SPSS and of MATLAB's stepwisefit.", float, 0.0, 1.0),
        Option("alpha_out", 0.10, "Significance level above which a term leaves; at least "
               "alpha_in.", float, 0.0, 1.0),
    )

    def choose(self, regression: Regression) -> BoolArray:
        """Return the chosen columns (k,), which enter and leave by their significance.

        Raises TermselError for levels at which terms leave more easily than they enter.
        """
        alpha_in = self.options["alpha_in"]
        alpha_out = self.options["alpha_out"]
        if alpha_in > alpha_out:
            raise TermselError(f"alpha_in is {alpha_in:g} and alpha_out {alpha_out:g}",
                               hint="Give an alpha_out of at least alpha_in; otherwise terms enter "
                                    "and leave forever.")
        selection = regression.kept.copy()
        visited = {selection.tobytes()}
        while True:
            grown = self._grow(regression, selection, alpha_in)
            if grown is None:
                return selection
            grown = _prune(regression, grown, alpha_out)
            # A selection that comes back would do so for ever.
            if grown.tobytes() in visited:
                return selection
            visited.add(grown.tobytes())
            selection = grown

    def _grow(self, regression: Regression, selection: BoolArray, alpha: float) -> BoolArray | None:
        """Return the selection (k,) with the further column that gains most.

        None if no column may enter, none gains anything, or the best is not significant at `alpha`;
        below the fewest columns that are allowed it enters whatever its significance.
        """
        count = int(selection.sum())
        gain, residual_square = gains_of_entering(regression, selection)
        gain[~regression.free] = 0.0
        # Of columns that gain the same but for rounding the first one enters, on any machine.
        best = regression.largest(gain)
        if count >= regression.most or gain[best] == 0.0:
            return None
        grown = with_column(selection, best, True)
        if count < regression.least:
            return grown
        if regression.explained(residual_square):
            return None
        # Rounding may leave the sum with the column just below zero.
        square_with_column = max(residual_square - gain[best], 0.0)
        p_value = p_value_of_change(regression, gain[best], square_with_column, grown)
        return grown if p_value < alpha else None


def _prune(regression: Regression, selection: BoolArray, alpha: float) -> BoolArray:
    """Return a selection (k,) without its insignificant columns.

    The least significant one is dropped first, and the others are tested again. Columns that are
    always in use stay, and so do as many as must be chosen.
    """
    while selection.sum() > regression.least:
        loss, residual_square = losses_of_leaving(regression, selection)
        loss[~regression.free] = np.inf  # columns that are always in use
        weakest = int(loss.argmin())
        if (not np.isfinite(loss[weakest])
                or p_value_of_change(
                    regression, loss[weakest], residual_square, selection) <= alpha):
            break
        selection = with_column(selection, weakest, False)
    return selection


def independent_columns(regression: Regression, max_columns: int) -> BoolArray:
    """Return the selection (k,) of the columns always in use and of the first independent others.

    Others depend on no column before them. They are added as long as fewer than `max_columns` are
    chosen.
    """
    selection = regression.kept.copy()
    # Q grows by a column at a time: modified Gram-Schmidt, each column against all before it.
    q = np.linalg.qr(regression.unit[:, selection])[0]
    for j in np.flatnonzero(regression.free):
        if selection.sum() >= max_columns:
            break
        remainder = regression.unit[:, j] - q @ (q.T @ regression.unit[:, j])
        remainder -= q @ (q.T @ remainder)  # twice is enough against rounding
        length = np.linalg.norm(remainder)
        if length > DEPENDENT:
            selection[j] = True
            q = np.column_stack([q, remainder / length])
    return selection


class TTest(TermRegression):
    """Backward elimination: fit as many terms as possible, then drop the insignificant ones.

    After the significance test of Moghaddam et al. 2017, ISPRS Archives XLII-4/W4, p. 23 (seen
    in abstract only), which drops RPCs that a t test finds insignificant. termsel's own choices:
    one term leaves at a time, that of the smallest ``|t|``, and all are tested again; the constant
    stays. Only control rows take part. With one mask for line and sample the test of a term is
    the F test of both of its coefficients.

    Elimination must begin with a determined adjustment that has redundancy for the tests: the
    first columns, in the model's own order, that do not depend on earlier ones. In the order
    of an RFM these are low powers before high ones and numerators before denominators. QR with
    column pivoting, which takes the most independent columns whatever they mean, was tried; it
    drops columns such as X and Y. On the embedded scenes its RFM misses independent points by
    up to hundreds of px, while this start misses them by 1 to 3 px.
    """

    name = "t-test"
    declared_options = (
        Option("alpha", 0.05, "Significance level of the two-sided test.",
               float, 0.0, 1.0),
        Option("redundancy", None, "Fewest degrees of freedom of an axis at the start; by default "
                                   "a quarter of its equations.", int, 1, 2**31 - 1),
    )

    def choose(self, regression: Regression) -> BoolArray:
        """Return the chosen columns (k,): as many as can be tested, less the insignificant ones."""
        m = len(regression.target)
        # A quarter of the equations is left as redundancy, without which F has no meaning.
        max_columns = min(regression.most, m - (self.options["redundancy"] or ceil(m / 4)))
        return _prune(
            regression, independent_columns(regression, max_columns), self.options["alpha"])
