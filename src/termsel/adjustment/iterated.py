"""Least squares of distances in the image, of many selections of the terms of quotients at once.

The linear equations of a quotient are those of its distances multiplied by the denominator. Here
they are divided by it, about the last solution: Gauss-Newton, as a single fit is iterated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel.adjustment.leave_out import IndependentPart
from termsel.adjustment.solve import TOLERANCE
from termsel.data.features import BoolArray, FloatArray, IntArray

ITERATIONS = 50
"""Most Gauss-Newton steps of a fit; two or three are usual, ten from a distant start."""

HALVINGS = tuple(0.5**i for i in range(8))
"""Shares of a Gauss-Newton step that are tried in turn."""

SMALLEST_DECREASE = 1e-10
"""Share of the sum of squares that a step must take away to count as one that lessens it."""

MIN_STEP_GAIN = 1e-5
"""Share of the residuals that a last step may leave: their squares are then known to 1e-10."""


@dataclass(frozen=True, eq=False)
class Quotients:
    """Image coordinates that are quotients of linear forms: target = above x / (1 + below x)."""

    numerator: FloatArray  # (m, k)
    denominator: FloatArray  # (m, k)
    target: FloatArray  # (m,)
    weights: FloatArray  # (p, m): 0 of rows that are not in use

    def misfits(self, x: FloatArray,
                individuals: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return weighted distances, quotients, and weights divided by denominators, (p, m) each.

        `x` (p, k) are the coefficients of the `individuals` (p,), which are rows of the weights.
        """
        with np.errstate(all="ignore"):  # beyond a pole, where no step ends
            denominators = 1.0 + x @ self.denominator.T
            quotients = (x @ self.numerator.T) / denominators
            weights = self.weights[individuals]
            return weights * (self.target - quotients), quotients, weights / denominators

    def squares(self, prior: FloatArray | None, x: FloatArray, individuals: IntArray) -> FloatArray:
        """Return the sums of squares that are to be least, shape (p,)."""
        prior_squares = 0.0 if prior is None else ((prior * x)**2).sum(axis=1)
        return np.asarray((self.misfits(x, individuals)[0]**2).sum(axis=1) + prior_squares)


def solve_least_distances(quotients: Quotients, parts: tuple[IndependentPart, ...],
                          terms: BoolArray, coefficients: FloatArray) -> FloatArray:
    """Return coefficients (p, k) of the least weighted distances, starting from a first solution.

    `coefficients` (p, k) are that solution, `terms` (p, k) the selected terms. Each independent
    part of the terms is iterated by itself. Steps that do not lessen the sum of squares are halved.
    """
    solution = coefficients.copy()
    for part in parts:
        columns = part.columns
        rows = (quotients.numerator[:, columns].any(axis=1)
                | quotients.denominator[:, columns].any(axis=1))
        distances = Quotients(quotients.numerator[np.ix_(rows, columns)],
                              quotients.denominator[np.ix_(rows, columns)], quotients.target[rows],
                              quotients.weights[:, rows])
        prior = part.equations.prior
        part_terms = terms[:, columns]
        x = solution[:, columns]
        active = np.arange(len(terms))  # individuals whose squares still fall
        for _ in range(ITERATIONS):
            step, gain, squares = _newton_steps(distances, prior, part_terms[active], x[active],
                                                active)
            # The length of Q'v is what a full step would take from the residuals.
            is_worthwhile = gain > MIN_STEP_GAIN * np.sqrt(squares)
            active = active[is_worthwhile]
            step = step[is_worthwhile]
            squares = squares[is_worthwhile]
            # Steps are halved until the squares are less; an individual for which they never are
            # is done.
            not_improved = np.arange(len(active))
            for share in HALVINGS:
                candidate = x[active[not_improved]] + share * step[not_improved]
                new_squares = distances.squares(prior, candidate, active[not_improved])
                is_improved = new_squares < (1 - SMALLEST_DECREASE) * squares[not_improved]
                x[active[not_improved[is_improved]]] = candidate[is_improved]
                not_improved = not_improved[~is_improved]
                if not len(not_improved):
                    break
            active = np.delete(active, not_improved)
            if not len(active):
                break
        solution[:, columns] = x
    return solution


def _newton_steps(system: Quotients, prior: FloatArray | None, terms: BoolArray, x: FloatArray,
                  active: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return full Gauss-Newton steps (p, k), how much they gain (p,), and the sums of squares (p,).

    They are for p selections of `terms`, masks (p, k), from the coefficients `x` (p, k); `active`
    (p,) are the numbers of these individuals. The gain is the length that a full step would take
    from the distances. Step and gain are 0 for selections beyond a pole, or with dependent columns.
    """
    v, quotients, factors = system.misfits(x, active)
    step = np.zeros_like(x)
    gain = np.zeros(len(x))
    sizes = terms.sum(axis=1)
    sizes[~np.isfinite(v).all(axis=1)] = 0  # no step from beyond a pole
    for size in np.unique(sizes[sizes > 0]):
        batch = np.flatnonzero(sizes == size)
        columns: IntArray = np.nonzero(terms[batch])[1].reshape(-1, size)
        # Derivative of w (t - a x / d), d = 1 + b x, but for its sign: w (a - (a x / d) b) / d.
        rows = (system.numerator.T[columns] - quotients[batch, None] * system.denominator.T[columns]
                ) * factors[batch, None]
        misfits = v[batch]
        # Pseudo-observations p x = 0: rows p, misfits -p x.
        if prior is not None:
            rows = np.concatenate([rows, prior[columns][..., None] * np.eye(size)], axis=2)
            misfits = np.concatenate([misfits, -prior[columns] * np.take_along_axis(
                x[batch], columns, axis=1)], axis=1)
        q, r = np.linalg.qr(rows.swapaxes(1, 2))
        lengths = np.linalg.norm(rows, axis=2)
        is_determined = (np.abs(np.diagonal(r, axis1=1, axis2=2))
                         > TOLERANCE * lengths).all(axis=1)
        projections = np.einsum("pmn,pm->pn", q, misfits)[is_determined]
        step[batch[is_determined, None], columns[is_determined]] = np.linalg.solve(
            r[is_determined], projections[..., None])[..., 0]
        gain[batch[is_determined]] = np.linalg.norm(projections, axis=1)
    return step, gain, system.squares(prior, x, active)
