"""The posterior of a shrunken polynomial whose equations couple line and sample, as lines do.

`termsel.candidates.shrunken` says what the prior is, `termsel.priors.posterior` how the same is
found faster from points alone. Here the grid has one size for both axes and some ratios of that of
line to that of sample. A feature has some rows: a point two, a line two for each of its pieces. It
is left out with all of them, in closed form (Cook and Weisberg 1982, ch. 2).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from termsel.adjustment.equations import Equations
from termsel.adjustment.monomials import Exponents
from termsel.adjustment.solve import TOLERANCE
from termsel.measurements.features import FloatArray, IntArray
from termsel.priors import posterior
from termsel.priors.held_out import chance_of
from termsel.priors.posterior import NEVER, NO_NOISE, TYPICAL, scales_of, shares
from termsel.priors.shrinkage import TINY

SIZES = posterior.SIZES[1:]
"""Those of an image that is not affine: with lines none is."""

RATIOS = 10.0 ** np.array([-1.0, 0.0, 1.0])
"""Sizes of line by those of sample."""


@dataclass(frozen=True, eq=False)
class Predictions:
    """Each of n features as the others predict it, averaged over the solutions."""

    errors: FloatArray  # (m,): measured minus predicted of all rows
    chance: FloatArray  # (n,): of errors as large
    strain: FloatArray  # (n,): error in standard deviations, root mean square over the rows
    spread: FloatArray  # (n,): largest standard deviation of a row's error by that of the noise


@dataclass(frozen=True, eq=False)
class RowGroup:
    """Features that have the same number of rows."""

    feature: IntArray  # (f,)
    rows: IntArray  # (f, r)
    left: FloatArray  # (c, f, r, r): 1 minus the leverage of their rows


@dataclass(frozen=True, eq=False)
class Coupled:
    """All solutions that matter."""

    # Prior and marginal likelihood are square^-freedom/2 exp(evidence).
    evidence: FloatArray  # (c,)
    square: FloatArray  # (c,)
    errors: FloatArray  # (c, m): what the fit leaves of each row
    features: tuple[RowGroup, ...]
    coefficients: FloatArray  # (c, j): the shrunken ones
    effective: FloatArray  # (c,)
    freedom: int  # equations in use less the terms that are not shrunk

    @cached_property
    def share(self) -> FloatArray:
        """Probability of each solution, shape (c,)."""
        return shares(self.evidence - self.freedom / 2 * np.log(self.square))[0]

    @property
    def noise(self) -> float:
        """Standard deviation of the noise."""
        return float(np.sqrt(self.share @ self.square / self.freedom))

    def mean(self) -> tuple[FloatArray, float]:
        """Return the shrunken coefficients, averaged, and all effective parameters."""
        return self.share @ self.coefficients, float(self.share @ self.effective)

    def predictions(self, weights: FloatArray | float = 1.0) -> Predictions:
        """Return each feature as the others predict it.

        The rows of features are multiplied by the weights (n,). Those with another weight than 1,
        too small to matter, do not count as others.
        """
        n = sum(len(group.feature) for group in self.features)
        weights = np.broadcast_to(np.asarray(weights, dtype=np.float64), n)
        errors = np.empty(self.errors.shape[1])
        chance, strain, spread = np.empty((3, n))
        for group in self.features:
            for on in (True, False):
                some = (weights[group.feature] == 1.0) == on
                feature, rows = group.feature[some], group.rows[some]
                left, fitted = group.left[:, some], self.errors[:, rows]
                # (I - H)^-1 e: the errors without the feature, all of its rows held out.
                held_out = _times(_inverse(left), fitted)
                if on:
                    # Without the feature: sum of squares, degrees of freedom and evidence.
                    quadratic = (held_out * fitted).sum(axis=2)
                    freedom = self.freedom - rows.shape[1]
                    rest = np.maximum(self.square[:, None] - quadratic,
                                      TINY * self.square[:, None])
                    share, _ = shares(self.evidence[:, None] - 0.5 * np.log(_determinant(left))
                                      - freedom / 2 * np.log(rest))
                    variance, widest = rest / freedom, 1.0 / _eigenvalue(left, least=True)
                else:
                    weight, identity = weights[feature][:, None, None], np.eye(rows.shape[1])
                    # Its rows are multiplied by a tiny weight: back to the unit of the others.
                    held_out /= weight[:, :, 0]
                    covariance = identity + (identity - left) / weight**2
                    quadratic = (held_out * _times(_inverse(covariance), held_out)).sum(axis=2)
                    share, freedom = self.share[:, None], self.freedom
                    variance, widest = self.square[:, None] / freedom, _eigenvalue(covariance)
                statistic = quadratic / rows.shape[1] / variance
                errors[rows] = (share[:, :, None] * held_out).sum(axis=0)
                as_large = chance_of(statistic, freedom, rows.shape[1] // 2)
                chance[feature] = (share * as_large).sum(axis=0)
                strain[feature] = np.sqrt((share * statistic).sum(axis=0))
                spread[feature] = np.sqrt((share * widest).sum(axis=0))
        return Predictions(errors, chance, strain, spread)


# Nearly all features have two rows, and of these there are hundreds of thousands.
def _inverse(a: FloatArray) -> FloatArray:
    if a.shape[-1] != 2:
        return np.asarray(np.linalg.inv(a), dtype=np.float64)
    turned = np.empty_like(a)
    turned[..., 0, 0], turned[..., 1, 1] = a[..., 1, 1], a[..., 0, 0]
    turned[..., 0, 1], turned[..., 1, 0] = -a[..., 0, 1], -a[..., 1, 0]
    return np.asarray(turned / _determinant(a)[..., None, None])


def _determinant(a: FloatArray) -> FloatArray:
    if a.shape[-1] != 2:
        return np.asarray(np.linalg.det(a))
    return np.asarray(a[..., 0, 0] * a[..., 1, 1] - a[..., 0, 1] * a[..., 1, 0])


def _eigenvalue(a: FloatArray, *, least: bool = False) -> FloatArray:
    """Return the largest or the least eigenvalue of symmetric matrices."""
    if a.shape[-1] != 2:
        return np.asarray(np.linalg.eigvalsh(a)[..., 0 if least else -1])
    middle, half = (a[..., 0, 0] + a[..., 1, 1]) / 2, (a[..., 0, 0] - a[..., 1, 1]) / 2
    return np.asarray(middle + (-1 if least else 1) * np.hypot(half, a[..., 0, 1]))


def _times(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    if vectors.shape[-1] == 2:
        return np.asarray(matrices[..., 0] * vectors[..., :1] + matrices[..., 1] * vectors[..., 1:])
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def coupled(equations: Equations, exponents: Exponents, draws: int,
            in_use: int) -> Coupled | None:
    """Return all solutions for features; None if all but any one do not determine the affine terms.

    The equations are those of a polynomial, weighted: all terms of line, then all of sample, with
    the same k exponents; affine ones are not shrunk. Factors of single terms are drawn `draws`
    times (see `scales_of`). The weight of `in_use` rows matters.
    """
    A, b = equations.A, equations.b
    powers = np.array(exponents)
    order = powers.sum(axis=1)
    free, scales = np.tile(order < 2, 2), scales_of(powers[order > 1], draws)
    count = int(free.sum())
    freedom = in_use - count
    alike = _of_equal_number(equations.feature)
    if freedom - max(rows.shape[1] for _, rows in alike) < 2 or len(A) <= count:
        return None
    q, r = np.linalg.qr(np.concatenate([A[:, free], A[:, ~free]], axis=1))
    # Without any one feature the affine terms are still to be determined.
    lead = q[:, :count]
    if (np.abs(np.diag(r))[:count] <= TOLERANCE * np.linalg.norm(A[:, free], axis=0)).any() or min(
            _eigenvalue(_left(lead, rows), least=True).min() for _, rows in alike) < TOLERANCE:
        return None
    # The geometric mean of both sizes is that of the grid.
    sides = np.stack([np.sqrt(RATIOS), 1 / np.sqrt(RATIOS)])               # line, sample
    grid = np.concatenate([(scales * side[:, None, None]).reshape(-1, scales.shape[1])
                           for side in sides], axis=1)                     # (g, 2 j)
    # Everything is worked out in the basis of what the shrunken columns add to the affine ones.
    u, values, vt = np.linalg.svd(r[count:, count:] * grid[:, None, :], full_matrices=False)
    inner = q[:, count:].T @ b
    along = inner @ u                                                       # (g, q)
    outside = b - q @ (q.T @ b)
    strength = SIZES[:, None] * values[:, None, :]                          # (g, s, q)
    keep = 1.0 / (1.0 + strength**2)
    prior = np.log1p((SIZES * np.repeat(sides, len(scales), axis=1)[..., None] / TYPICAL) ** 2)
    evidence = 0.5 * np.log(keep).sum(axis=2) - 0.5 * prior.sum(axis=0)
    square = (outside @ outside + (keep * along[:, None, :]**2).sum(axis=2)
              + in_use * (NO_NOISE * float(np.ptp(b)) / 2) ** 2)
    likely = evidence - freedom / 2 * np.log(square)
    which = np.argwhere(likely > likely.max() - NEVER)
    group, size = which.T
    keep, strength = keep[group, size], strength[group, size]
    part = keep * along[group]
    basis = q[:, count:]
    errors = np.empty((len(group), len(b)))
    left = [np.empty((len(group), *rows.shape, rows.shape[1])) for _, rows in alike]
    coefficients = np.empty((len(group), int((~free).sum())))
    # All sizes of a group have its singular vectors, and stand next to each other.
    groups, starts = np.unique(group, return_index=True)
    for one, start, end in zip(groups, starts, [*starts[1:], len(group)], strict=True):
        of = slice(start, end)
        directions = basis @ u[one]
        np.add(outside, part[of] @ directions.T, out=errors[of])
        coefficients[of] = grid[one] * ((SIZES[size[of], None] * strength[of] * part[of]) @ vt[one])
        for (_, rows), some in zip(alike, left, strict=True):
            held = directions[rows]
            products = held[:, :, None] * held[:, None]                        # (f, r, r, q)
            np.matmul(keep[of], products.reshape(-1, products.shape[3]).T,
                      out=some[of].reshape(end - start, -1))
    for (_, rows), some in zip(alike, left, strict=True):
        some += _left(q, rows)
    return Coupled(evidence[group, size], square[group, size], errors,
                   tuple(RowGroup(feature, rows, some)
                         for (feature, rows), some in zip(alike, left, strict=True)),
                   coefficients, count + (1.0 - keep).sum(axis=1), freedom)


def _of_equal_number(feature: IntArray) -> list[tuple[IntArray, IntArray]]:
    """Return the features of each number of rows, (f,), and their rows, (f, r)."""
    number, order = np.bincount(feature), np.argsort(feature, kind="stable")
    first = np.cumsum(number) - number
    alike = [(np.flatnonzero(number == rows), np.arange(rows)) for rows in np.unique(number)]
    return [(some, order[first[some, None] + rows]) for some, rows in alike]


def _left(q: FloatArray, rows: IntArray) -> FloatArray:
    """Return 1 minus the leverage that orthonormal columns give to rows, shape (f, r, r)."""
    return np.asarray(np.eye(rows.shape[1]) - q[rows] @ q[rows].transpose(0, 2, 1))
