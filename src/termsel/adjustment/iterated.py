"""Least squares of distances in the image, of many selections of the terms of quotients at once.

The linear equations of a quotient are those of its distances multiplied by the denominator. Here
they are divided by it, about the last solution: Gauss-Newton, as a single fit is iterated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from termsel.adjustment.parts import IndependentPart
from termsel.adjustment.solve import TOLERANCE
from termsel.measurements.features import BoolArray, FloatArray, IntArray

ITERATIONS = 50
"""Most Gauss-Newton steps of a fit; two or three are usual, ten from a distant start."""

HALVINGS = tuple(0.5**i for i in range(8))
"""Shares of a Gauss-Newton step that are tried in turn."""

GAIN = 1e-5
"""Share of the residuals that a last step may leave: their squares are then known to 1e-10."""


@dataclass(frozen=True, eq=False)
class Quotients:
    """Image coordinates that are quotients of linear forms: target = above x / (1 + below x)."""

    above: FloatArray  # (m, k)
    below: FloatArray  # (m, k)
    target: FloatArray  # (m,)
    weights: FloatArray  # (p, m): 0 of rows that are not in use

    def left(self, x: FloatArray, some: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return weighted distances, quotients, and weights over denominators of some, (p, m)."""
        with np.errstate(all="ignore"):  # beyond a pole, where no step ends
            denominators = 1.0 + x @ self.below.T
            quotients = (x @ self.above.T) / denominators
            weights = self.weights[some]
            return weights * (self.target - quotients), quotients, weights / denominators

    def squares(self, prior: FloatArray | None, x: FloatArray, some: IntArray) -> FloatArray:
        """Return the sums of squares that are to be least, shape (p,)."""
        held = 0.0 if prior is None else ((prior * x)**2).sum(axis=1)
        return np.asarray((self.left(x, some)[0]**2).sum(axis=1) + held)


def least_distances(quotients: Quotients, parts: tuple[IndependentPart, ...], terms: BoolArray,
                    coefficients: FloatArray) -> FloatArray:
    """Return coefficients (p, k) of the least weighted distances, from those of a first solution.

    Each part of the terms (p, k) is iterated by itself. Steps that do not lessen the sum of squares
    are halved.
    """
    found = coefficients.copy()
    for part in parts:
        chosen = part.columns
        rows = (quotients.above[:, chosen].any(axis=1) | quotients.below[:, chosen].any(axis=1))
        system = Quotients(quotients.above[np.ix_(rows, chosen)],
                           quotients.below[np.ix_(rows, chosen)], quotients.target[rows],
                           quotients.weights[:, rows])
        prior, mine = part.equations.prior, terms[:, chosen]
        x, live = found[:, chosen], np.arange(len(terms))
        for _ in range(ITERATIONS):
            step, gain, before = _steps(system, prior, mine[live], x[live], live)
            going = gain > GAIN * np.sqrt(before)
            live, step, before = live[going], step[going], before[going]
            todo = np.arange(len(live))
            for share in HALVINGS:
                tried = x[live[todo]] + share * step[todo]
                after = system.squares(prior, tried, live[todo])
                better = after < (1 - 1e-10) * before[todo]
                x[live[todo[better]]] = tried[better]
                todo = todo[~better]
            live = np.delete(live, todo)
            if not len(live):
                break
        found[:, chosen] = x
    return found


def _steps(system: Quotients, prior: FloatArray | None, terms: BoolArray, x: FloatArray,
           live: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return full steps (p, k), what they would take from the distances, and the squares (p,)."""
    v, quotients, factors = system.left(x, live)
    step, gain = np.zeros_like(x), np.zeros(len(x))
    sizes = terms.sum(axis=1)
    sizes[~np.isfinite(v).all(axis=1)] = 0
    for size in np.unique(sizes[sizes > 0]):
        some = np.flatnonzero(sizes == size)
        columns: IntArray = np.nonzero(terms[some])[1].reshape(-1, size)
        rows = (system.above.T[columns] - quotients[some, None] * system.below.T[columns]
                ) * factors[some, None]
        left = v[some]
        if prior is not None:
            rows = np.concatenate([rows, prior[columns][..., None] * np.eye(size)], axis=2)
            left = np.concatenate([left, -prior[columns] * np.take_along_axis(
                x[some], columns, axis=1)], axis=1)
        q, r = np.linalg.qr(rows.swapaxes(1, 2))
        lengths = np.linalg.norm(rows, axis=2)
        known = (np.abs(np.diagonal(r, axis1=1, axis2=2)) > TOLERANCE * lengths).all(axis=1)
        along = np.einsum("pmn,pm->pn", q, left)[known]
        step[some[known, None], columns[known]] = np.linalg.solve(
            r[known], along[..., None])[..., 0]
        gain[some[known]] = np.linalg.norm(along, axis=1)
    return step, gain, system.squares(prior, x, live)
