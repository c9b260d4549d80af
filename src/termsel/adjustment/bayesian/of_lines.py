"""The posterior of a regularised polynomial whose equations couple line and sample, as lines do.

`termsel.auto.shrunken` says what the prior is, `termsel.adjustment.bayesian.posterior` how the
same is found faster from points alone. Here the grid has one size for both axes and some ratios of
that of line to that of sample. A feature has some rows: a point two, a line two for each of its
pieces. It is left out with all of them, in closed form (Cook and Weisberg 1982, ch. 2).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from termsel.adjustment.bayesian import posterior
from termsel.adjustment.bayesian.held_out import chance_of
from termsel.adjustment.bayesian.posterior import (
    NEVER,
    NO_NOISE,
    TYPICAL,
    scales_of,
    shares,
)
from termsel.adjustment.bayesian.shrinkage import TINY
from termsel.adjustment.equations import Equations
from termsel.adjustment.solve import TOLERANCE
from termsel.data.features import FloatArray, IntArray
from termsel.data.monomials import Exponents

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
    left: FloatArray  # (c, r, r, f): 1 minus the leverage of their rows


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

    def held_out_errors(self) -> FloatArray:
        """Return measured minus predicted of all rows, each by the other features, shape (m,)."""
        errors = np.empty(self.errors.shape[1])
        for group in self.features:
            held_out, share, _, _ = self._without(group.left, group.rows)
            errors[group.rows] = np.einsum("cf,crf->fr", share, held_out)
        return errors

    def _without(self, left: FloatArray, rows: IntArray,
                 ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return errors of features (c, r, f), each held out with its rows (f, r); then, (c, f),
        the probabilities of the solutions without it, sums of squares, and how much less they are.
        """
        fitted = self.errors[:, rows.T]
        # (I - H)^-1 e: the errors without the feature, all of its rows held out.
        held_out, determinant = _solved(left, fitted)
        quadratic = (held_out * fitted).sum(axis=1)
        rest = np.maximum(self.square[:, None] - quadratic, TINY * self.square[:, None])
        share, _ = shares(self.evidence[:, None] - 0.5 * np.log(determinant)
                          - (self.freedom - rows.shape[1]) / 2 * np.log(rest))
        return held_out, share, rest, quadratic

    def predictions(self, weights: FloatArray) -> Predictions:
        """Return each feature as the others predict it.

        The rows of features are multiplied by the weights (n,). Those with another weight than 1,
        too small to matter, do not count as others.
        """
        n = sum(len(group.feature) for group in self.features)
        errors = np.empty(self.errors.shape[1])
        chance, strain, spread = np.empty((3, n))
        for group in self.features:
            for on in (True, False):
                some = (weights[group.feature] == 1.0) == on
                if not some.any():
                    continue
                feature = group.feature[some]
                rows = group.rows[some]
                left = group.left if some.all() else group.left[..., some]
                held_out, share, rest, quadratic = self._without(left, rows)
                if on:
                    freedom = self.freedom - rows.shape[1]
                    variance = rest / freedom
                    widest = 1.0 / _eigenvalue(left, least=True)
                else:
                    weight = weights[feature]
                    identity = np.eye(rows.shape[1])[:, :, None]
                    # Its rows are multiplied by a tiny weight: back to the unit of the others.
                    held_out /= weight
                    covariance = identity + (identity - left) / weight**2
                    quadratic = (held_out * _solved(covariance, held_out)[0]).sum(axis=1)
                    share = self.share[:, None]
                    freedom = self.freedom
                    variance = self.square[:, None] / freedom
                    widest = _eigenvalue(covariance)
                statistic = quadratic / rows.shape[1] / variance
                errors[rows] = np.einsum("cf,crf->fr", np.broadcast_to(
                    share, statistic.shape), held_out)
                as_large = chance_of(statistic, freedom, rows.shape[1] // 2)
                chance[feature] = (share * as_large).sum(axis=0)
                strain[feature] = np.sqrt((share * statistic).sum(axis=0))
                spread[feature] = np.sqrt((share * widest).sum(axis=0))
        return Predictions(errors, chance, strain, spread)


# Nearly all features have two rows, and of these there are hundreds of thousands.
def _solved(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a^-1 b (c, r, f) and the determinants (c, f) of symmetric matrices (c, r, r, f)."""
    if b.shape[1] != 2:
        every = np.moveaxis(a, 3, 1)
        x = np.asarray(np.linalg.solve(every, np.moveaxis(b, 2, 1)[..., None]), dtype=np.float64)
        return np.moveaxis(x[..., 0], 1, 2), np.asarray(np.linalg.det(every), dtype=np.float64)
    x = np.empty_like(b)
    across = a[:, 0, 1]
    determinant = a[:, 0, 0] * a[:, 1, 1] - across**2
    x[:, 0] = (a[:, 1, 1] * b[:, 0] - across * b[:, 1]) / determinant
    x[:, 1] = (a[:, 0, 0] * b[:, 1] - across * b[:, 0]) / determinant
    return x, determinant


def _eigenvalue(a: FloatArray, *, least: bool = False) -> FloatArray:
    """Return the largest or the least eigenvalue of symmetric matrices (..., r, r, f)."""
    if a.shape[-2] != 2:
        return np.asarray(np.linalg.eigvalsh(np.moveaxis(a, -1, -3))[..., 0 if least else -1])
    one = a[..., 0, 0, :]
    other = a[..., 1, 1, :]
    middle = (one + other) / 2
    half = (one - other) / 2
    return np.asarray(middle + (-1 if least else 1) * np.sqrt(half**2 + a[..., 0, 1, :]**2))


def averaged(equations: Equations, exponents: Exponents,
             ) -> tuple[FloatArray, float, FloatArray] | None:
    """Return `Coupled.mean`, then `held_out_errors`, of all solutions for features in use.

    None as for `coupled`.
    """
    return _averaged(*(part.tobytes() for part in (equations.A, equations.b, equations.feature)),
                     exponents)


@lru_cache(maxsize=4)  # what is asked for again is among the last four
def _averaged(A: bytes, b: bytes, feature: bytes, exponents: Exponents,
              ) -> tuple[FloatArray, float, FloatArray] | None:
    """Return the same; one run asks for that of features without blunders more than once."""
    found = coupled(Equations(
        np.frombuffer(A).reshape(-1, 2 * len(exponents)), np.frombuffer(b),
        np.frombuffer(feature, dtype=np.intp)), exponents, posterior.DRAWS, len(b) // 8)
    return None if found is None else (*found.mean(), found.held_out_errors())


def coupled(equations: Equations, exponents: Exponents, draws: int,
            in_use: int) -> Coupled | None:
    """Return all solutions for features; None if all but any one do not determine the affine terms.

    The equations are those of a polynomial, weighted: all terms of line, then all of sample, with
    the same k exponents; affine ones are not shrunk. Factors of single terms are drawn `draws`
    times (see `scales_of`). The weight of `in_use` rows matters.
    """
    A = equations.A
    b = equations.b
    powers = np.array(exponents)
    order = powers.sum(axis=1)
    free = np.tile(order < 2, 2)
    scales = scales_of(powers[order > 1], draws)
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
    keep = keep[group, size]
    strength = strength[group, size]
    part = keep * along[group]
    basis = q[:, count:]
    errors = outside + np.matmul(part[:, None], u[group].transpose(0, 2, 1))[:, 0] @ basis.T
    coefficients = grid[group] * SIZES[size, None] * np.matmul((strength * part)[:, None],
                                                               vt[group])[:, 0]
    left = [np.empty((len(group), rows.shape[1], *rows.T.shape)) for _, rows in alike]
    # All sizes of a group have its singular vectors, and stand next to each other.
    groups, starts = np.unique(group, return_index=True)
    for one, start, end in zip(groups, starts, [*starts[1:], len(group)], strict=True):
        of = slice(start, end)
        directions = basis @ u[one]
        for (_, rows), some in zip(alike, left, strict=True):
            held = directions[rows.T]
            products = held[:, None] * held                                    # (r, r, f, q)
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
    number = np.bincount(feature)
    order = np.argsort(feature, kind="stable")
    first = np.cumsum(number) - number
    alike = [(np.flatnonzero(number == rows), np.arange(rows)) for rows in np.unique(number)]
    return [(some, order[first[some, None] + rows]) for some, rows in alike]


def _left(q: FloatArray, rows: IntArray) -> FloatArray:
    """Return 1 minus the leverage that orthonormal columns give to rows, shape (r, r, f)."""
    own = q[rows] @ q[rows].transpose(0, 2, 1)
    return np.ascontiguousarray((np.eye(rows.shape[1]) - own).transpose(1, 2, 0))
