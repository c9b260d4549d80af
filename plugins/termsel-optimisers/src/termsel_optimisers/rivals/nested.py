"""Nested regression: terms are added one at a time, by how well they explain the residuals."""

from __future__ import annotations

import numpy as np

from termsel import Option, Regression, TermRegression
from termsel_optimisers.arrays import BoolArray, FloatArray

DEPENDENT = 1e-8
"""A column of length 1 whose part that the others lack is shorter depends on them."""

MIN_DENOMINATOR = 1e-12
"""Denominator in place of 0."""


class NestedRegression(TermRegression):
    """Nested regression (NRBOS): add the term that best explains the residuals.

    Long, Jiao, He 2014, "Nested regression based optimal selection (NRBOS) of rational
    polynomial coefficients", PE&RS 80(3), p. 261; abstract and the authors' published code.
    Begins with the constant; adds the column with the largest 1000 R^2 / (1 - R^2) in a
    regression of the current residuals on that column alone; adjusts all chosen columns
    together; takes the new residuals from the rational function itself. Ends when the RMS of
    the control and its change are both below the threshold, or with a redundancy of 1.

    We do not follow the code where it departs from the plain method: it measures R^2 about the
    mean of the residuals although the regression has no intercept, so that R^2 may exceed 1 and
    the best column be missed. Here sums of squares are about 0, which is the same if the
    residuals have mean 0. Its first residuals are those of 0, here those of the constant.
    Columns that depend on the chosen ones are skipped; the code uses a pseudo-inverse. With
    one mask for line and sample R^2 pools both, and both must reach the threshold.
    """

    name = "nested-regression"
    declared_options = (
        Option("thumb", 0.5, "RMS of an axis, and its change, below which no term is added [px]; "
                             "0.5 in the authors' code.", float, 0.0, 1e6),
    )

    def choose(self, regression: Regression) -> BoolArray:
        """Return the chosen columns (k,), which are added one by one.

        The next column is the one that explains most of the errors of the rational function itself.
        It ends once the root mean square of each target, and its last change, are below `thumb`, if
        no column explains anything, or if no more are allowed.
        """
        # Targets are scaled: a unit of theirs is `regression.pixels` px.
        thumb = self.options["thumb"] / regression.pixels
        selection = regression.kept.copy()
        errors = rational_errors(regression, selection)
        while selection.sum() < regression.most:
            shares = explained_shares(regression, selection, errors)
            best = regression.largest(shares)
            if shares[best] <= 0.0:
                break
            selection = selection.copy()
            selection[best] = True
            former_rms = rms_of_targets(errors)
            errors = rational_errors(regression, selection)
            new_rms = rms_of_targets(errors)
            if (selection.sum() >= regression.least and (new_rms < thumb).all()
                    and (np.abs(new_rms - former_rms) < thumb).all()):
                break
        return selection


def rms_of_targets(errors: FloatArray) -> FloatArray:
    """Return the root mean square of each target's errors (m, r), shape (r,)."""
    return np.asarray(np.sqrt((errors**2).mean(axis=0)))


def rational_errors(regression: Regression, selection: BoolArray) -> FloatArray:
    """Return the errors (m, r) of the r targets after a fit of the columns that are selected.

    `selection` (k,) marks them. Errors are scaled image coordinates, measured minus computed, of
    the rational function itself rather than of its linear equations.
    """
    x = np.zeros((len(selection), regression.target.shape[1]))
    lengths = np.linalg.norm(regression.columns[:, selection], axis=0)
    solution = np.linalg.lstsq(regression.unit[:, selection], regression.target,
                               rcond=DEPENDENT)[0]
    # The solution is of columns of unit length; a column of zeros has the coefficient 0.
    x[selection] = solution / np.where(lengths > 0, lengths, 1.0)[:, None]
    # The linear equations are those of the rational function times the denominator.
    errors = regression.target - regression.columns @ x
    if regression.denominator is not None:
        denominators = 1.0 + regression.denominator @ x
        # A pole on a point gives it an error that is huge, but finite.
        errors = errors / np.where(denominators == 0.0, MIN_DENOMINATOR, denominators)
    return np.asarray(errors)


def explained_shares(
        regression: Regression, selection: BoolArray, errors: FloatArray) -> FloatArray:
    """Return the share of the squared errors that each free column explains by itself, (k,).

    It is R^2 of a regression without intercept, over all targets. It is 0 for columns that are
    chosen, always in use, or depend on the chosen ones, and for errors that are rounding alone.
    """
    unit = regression.unit
    q = np.linalg.qr(unit[:, selection])[0]
    remaining_lengths = np.linalg.norm(unit - q @ (q.T @ unit), axis=0)
    square = float((errors**2).sum())
    if regression.explained(square):
        return np.zeros(len(selection))
    # R^2 = (a'e)^2 / (a'a e'e), with columns a of length 1.
    shares = ((unit.T @ errors) ** 2).sum(axis=1) / square
    return np.asarray(np.where(regression.free & ~selection & (remaining_lengths > DEPENDENT),
                               shares, 0.0))
