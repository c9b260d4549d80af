"""Nested regression: terms are added one at a time, by how well they explain the residuals."""

from __future__ import annotations

import numpy as np

from termsel import Option, Regression, TermRegression
from termsel_rivals.arrays import BoolArray, FloatArray

DEPENDENT = 1e-8
"""A column of length 1 whose part that the others lack is shorter depends on them."""

ON_A_POLE = 1e-12
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

    def choose(self, part: Regression) -> BoolArray:
        """Return the chosen columns."""
        thumb = self.options["thumb"] / part.pixels
        chosen = part.kept.copy()
        errors = rational_errors(part, chosen)
        while chosen.sum() < part.most:
            # By the errors of the quotient itself, not by those of the linear equations.
            share = explained_share(part, chosen, errors)
            best = part.largest(share)
            if share[best] <= 0.0:
                break
            chosen = chosen.copy()
            chosen[best] = True
            before, errors = rms(errors), rational_errors(part, chosen)
            now = rms(errors)
            if (chosen.sum() >= part.least and (now < thumb).all()
                    and (np.abs(now - before) < thumb).all()):
                break
        return chosen


def rms(errors: FloatArray) -> FloatArray:
    """Return the root mean square of each target's errors, shape (r,)."""
    return np.asarray(np.sqrt((errors**2).mean(axis=0)))


def rational_errors(part: Regression, chosen: BoolArray) -> FloatArray:
    """Return the errors of image coordinates after adjusting the chosen columns, (m, r)."""
    x = np.zeros((len(chosen), part.target.shape[1]))
    lengths = np.linalg.norm(part.columns[:, chosen], axis=0)
    x[chosen] = np.linalg.lstsq(part.unit[:, chosen], part.target, rcond=DEPENDENT)[0] \
        / np.where(lengths > 0, lengths, 1.0)[:, None]
    errors = part.target - part.columns @ x
    if part.denominator is not None:
        below = 1.0 + part.denominator @ x
        # A pole on a point: its error is huge, and finite.
        errors = errors / np.where(below == 0.0, ON_A_POLE, below)
    return np.asarray(errors)


def explained_share(part: Regression, chosen: BoolArray, errors: FloatArray) -> FloatArray:
    """Return the share of the errors' squares that each free column explains alone, shape (k,).

    This is R^2 of a regression without intercept; R^2 / (1 - R^2) grows with it. It is 0 for
    columns that depend on the chosen ones.
    """
    unit = part.unit
    q = np.linalg.qr(unit[:, chosen])[0]
    left = np.linalg.norm(unit - q @ (q.T @ unit), axis=0)
    square = float((errors**2).sum())
    if part.explained(square):
        return np.zeros(len(chosen))
    share = ((unit.T @ errors) ** 2).sum(axis=1) / square
    return np.asarray(np.where(part.free & ~chosen & (left > DEPENDENT), share, 0.0))
