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
    MAX_LOG_RATIO,
    NO_NOISE,
    TYPICAL_SIZE,
    normalise_probabilities,
    scales_of,
)
from termsel.adjustment.bayesian.shrinkage import MIN_REDUNDANCY
from termsel.adjustment.equations import Equations
from termsel.adjustment.solve import TOLERANCE
from termsel.data.features import FloatArray, IntArray
from termsel.data.monomials import Exponents

LINE_SIZES = posterior.PRIOR_SIZES[1:]
"""Those of an image that is not affine: with lines none is."""

AXIS_RATIOS = 10.0 ** np.array([-1.0, 0.0, 1.0])
"""Sizes of line by those of sample."""


@dataclass(frozen=True, eq=False)
class FeaturePredictions:
    """Each of n features as the other features predict it, averaged over the solutions."""

    errors: FloatArray  # (m,): measured minus predicted of all rows
    probability: FloatArray  # (n,): of errors as large
    strain: FloatArray  # (n,): error in standard deviations, root mean square over the rows
    spread: FloatArray  # (n,): largest standard deviation of a row's error by that of the noise


@dataclass(frozen=True, eq=False)
class RowGroup:
    """Features that have the same number of rows."""

    feature: IntArray  # (f,)
    rows: IntArray  # (f, r)
    redundancy: FloatArray  # (c, r, r, f): 1 minus the leverage of their rows


@dataclass(frozen=True, eq=False)
class LinePosterior:
    """All solutions that matter."""

    # Prior and marginal likelihood are square^-freedom/2 exp(log_factor).
    log_factor: FloatArray  # (c,)
    square: FloatArray  # (c,)
    errors: FloatArray  # (c, m): what the fit leaves of each row
    groups: tuple[RowGroup, ...]
    coefficients: FloatArray  # (c, j): the shrunken ones
    sizes: FloatArray  # (c, j): prior standard deviations of these, by that of the noise
    effective: FloatArray  # (c,)
    freedom: int  # equations in use less the terms that are not shrunk

    @cached_property
    def share(self) -> FloatArray:
        """Probability of each solution, shape (c,)."""
        return normalise_probabilities(self.log_factor - self.freedom / 2 * np.log(self.square))[0]

    @property
    def noise(self) -> float:
        """Standard deviation of the noise."""
        return float(np.sqrt(self.share @ self.square / self.freedom))

    def mean(self) -> tuple[FloatArray, float]:
        """Return the averaged shrunken coefficients, (2 k,), and effective parameters."""
        return self.share @ self.coefficients, float(self.share @ self.effective)

    def held_out_errors(self) -> FloatArray:
        """Return measured minus predicted of all rows, each by the other features, shape (m,)."""
        errors = np.empty(self.errors.shape[1])
        for group in self.groups:
            held_out, share, _, _ = self._held_out_errors_and_weights(group.redundancy, group.rows)
            errors[group.rows] = np.einsum("cf,crf->fr", share, held_out)
        return errors

    def _held_out_errors_and_weights(self, redundancy: FloatArray, rows: IntArray,
                                     ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return what c solutions become without each of f features of r rows.

        These are the errors of the features, (c, r, f); and, (c, f) each, the probabilities of the
        solutions, their sums of squares, and by how much these are less than with the feature.
        `redundancy` (c, r, r, f) and `rows` (f, r) are as of a `RowGroup`.
        """
        fitted = self.errors[:, rows.T]
        # (I - H)^-1 e: the errors without the feature, all of its rows held out.
        held_out, determinant = _solve_by_cholesky(redundancy, fitted)
        quadratic = (held_out * fitted).sum(axis=1)
        other_squares = np.maximum(self.square[:, None] - quadratic,
                                   MIN_REDUNDANCY * self.square[:, None])
        share, _ = normalise_probabilities(self.log_factor[:, None] - 0.5 * np.log(determinant)
                                           - (self.freedom
                                              - rows.shape[1]) / 2 * np.log(other_squares))
        return held_out, share, other_squares, quadratic

    def predictions(self, weights: FloatArray) -> FeaturePredictions:
        """Return each of n features as the other features predict it.

        `weights` (n,) are what the rows of each feature were multiplied by. Features with another
        weight than 1, which is too small to matter, are predicted by those with the weight 1.
        """
        n = sum(len(group.feature) for group in self.groups)
        errors = np.empty(self.errors.shape[1])
        probability, strain, spread = np.empty((3, n))
        for group in self.groups:
            for in_use in (True, False):
                selected = (weights[group.feature] == 1.0) == in_use
                if not selected.any():
                    continue
                feature = group.feature[selected]
                rows = group.rows[selected]
                redundancy = group.redundancy if selected.all() else group.redundancy[..., selected]
                held_out, share, other_squares, quadratic = (
                    self._held_out_errors_and_weights(redundancy, rows))
                # A feature in use is predicted without its rows, which count no more as redundancy.
                if in_use:
                    freedom = self.freedom - rows.shape[1]
                    variance = other_squares / freedom
                    widest = 1.0 / _extreme_eigenvalue(redundancy, smallest=True)
                else:
                    weight = weights[feature]
                    identity = np.eye(rows.shape[1])[:, :, None]
                    # From rows with a tiny weight back to the unit of the other features.
                    held_out /= weight
                    covariance = identity + (identity - redundancy) / weight**2
                    quadratic = (held_out * _solve_by_cholesky(covariance, held_out)[0]).sum(axis=1)
                    share = self.share[:, None]
                    freedom = self.freedom
                    variance = self.square[:, None] / freedom
                    widest = _extreme_eigenvalue(covariance)
                # F of the errors: their weighted square by their number, over the variance.
                statistic = quadratic / rows.shape[1] / variance
                errors[rows] = np.einsum("cf,crf->fr", np.broadcast_to(
                    share, statistic.shape), held_out)
                probability_each = chance_of(statistic, freedom, rows.shape[1] // 2)
                probability[feature] = (share * probability_each).sum(axis=0)
                strain[feature] = np.sqrt((share * statistic).sum(axis=0))
                spread[feature] = np.sqrt((share * widest).sum(axis=0))
        return FeaturePredictions(errors, probability, strain, spread)


# Nearly all features have two rows, and of these there are hundreds of thousands.
def _solve_by_cholesky(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a^-1 b (c, r, f) and the determinants (c, f) of symmetric matrices (c, r, r, f)."""
    # Mostly two rows, those of a point or of a line: then by Cramer's rule.
    if b.shape[1] != 2:
        matrices = np.moveaxis(a, 3, 1)
        x = np.asarray(np.linalg.solve(matrices, np.moveaxis(b, 2, 1)[..., None]), dtype=np.float64)
        return np.moveaxis(x[..., 0], 1, 2), np.asarray(np.linalg.det(matrices), dtype=np.float64)
    x = np.empty_like(b)
    across = a[:, 0, 1]
    determinant = a[:, 0, 0] * a[:, 1, 1] - across**2
    x[:, 0] = (a[:, 1, 1] * b[:, 0] - across * b[:, 1]) / determinant
    x[:, 1] = (a[:, 0, 0] * b[:, 1] - across * b[:, 0]) / determinant
    return x, determinant


def _extreme_eigenvalue(a: FloatArray, *, smallest: bool = False) -> FloatArray:
    """Return the largest or the least eigenvalue of symmetric matrices (..., r, r, f)."""
    if a.shape[-2] != 2:
        return np.asarray(np.linalg.eigvalsh(np.moveaxis(a, -1, -3))[..., 0 if smallest else -1])
    # Of [[p, q], [q, r]]: (p + r) / 2 -+ sqrt(((p - r) / 2)^2 + q^2).
    p = a[..., 0, 0, :]
    q = a[..., 0, 1, :]
    r = a[..., 1, 1, :]
    middle = (p + r) / 2
    half_difference = (p - r) / 2
    sign = -1 if smallest else 1
    return np.asarray(middle + sign * np.sqrt(half_difference**2 + q**2))


def mean_line_solution(equations: Equations, exponents: Exponents,
                       ) -> tuple[FloatArray, float, FloatArray] | None:
    """Return averaged shrunken coefficients, effective parameters and held-out errors (m,).

    They are those of `LinePosterior.mean` and `held_out_errors`, over all solutions for m rows that
    are all in use. Returns None where `line_posterior` returns none.
    """
    return _cached_mean(equations.A.tobytes(), equations.b.tobytes(), equations.feature.tobytes(),
                        exponents)


@lru_cache(maxsize=4)  # what is asked for again is among the last four
def _cached_mean(A: bytes, b: bytes, feature: bytes, exponents: Exponents,
                 ) -> tuple[FloatArray, float, FloatArray] | None:
    """Return what `mean_line_solution` does, None included, of arrays as bytes, the cache's key.

    One run asks more than once for the solution of the features without blunders.
    """
    equations = Equations(np.frombuffer(A).reshape(-1, 2 * len(exponents)), np.frombuffer(b),
                          np.frombuffer(feature, dtype=np.intp))
    solutions = line_posterior(equations, exponents, posterior.N_DRAWS, len(equations.b))
    if solutions is None:
        return None
    coefficients, effective = solutions.mean()
    return coefficients, effective, solutions.held_out_errors()


def line_covariance(equations: Equations,
                    exponents: Exponents) -> tuple[FloatArray, FloatArray, float] | None:
    """Return the posterior mean (2 k,) and covariance (2 k, 2 k) of coefficients, and the noise.

    The terms of line come first, then those of sample; all rows are in use, and the noise is the
    standard deviation of unit weight. Returns None where `line_posterior` returns none.
    """
    return _cached_covariance(equations.A.tobytes(), equations.b.tobytes(),
                              equations.feature.tobytes(), exponents)


@lru_cache(maxsize=4)  # maps of uncertainty ask for one piece of the image after the other
def _cached_covariance(A: bytes, b: bytes, feature: bytes, exponents: Exponents,
                       ) -> tuple[FloatArray, FloatArray, float] | None:
    """Return what `line_covariance` does, of arrays as bytes, the cache's key."""
    equations = Equations(np.frombuffer(A).reshape(-1, 2 * len(exponents)), np.frombuffer(b),
                          np.frombuffer(feature, dtype=np.intp))
    solutions = line_posterior(equations, exponents, posterior.N_DRAWS, len(equations.b))
    if solutions is None:
        return None
    is_shrunk = np.tile(np.array(exponents).sum(axis=1) > 1, 2)
    normal = equations.A.T @ equations.A
    right = equations.A.T @ equations.b
    # Student's t of each solution has the variance square / (freedom - 2).
    noise_squares = solutions.square / max(solutions.freedom - 2.0, 1.0)
    means = np.empty((len(solutions.share), len(normal)))
    covariance = np.zeros_like(normal)
    for cell, sizes in enumerate(solutions.sizes):
        # (A'A + D^-2)^-1, with D the prior standard deviations; affine terms have no prior. Scaled
        # by D, it exists where some of them are 0.
        scale = np.ones(len(normal))
        scale[is_shrunk] = sizes
        scaled = scale[:, None] * normal * scale + np.diag(is_shrunk.astype(np.float64))
        inverse = scale[:, None] * np.linalg.inv(scaled) * scale
        means[cell] = inverse @ right
        covariance += solutions.share[cell] * noise_squares[cell] * inverse
    # To the variance within solutions comes that of their means.
    mean = solutions.share @ means
    deviations = means - mean
    covariance += (solutions.share[:, None] * deviations).T @ deviations
    return mean, covariance, float(np.sqrt(solutions.share @ noise_squares))


def line_posterior(equations: Equations, exponents: Exponents, draws: int,
                   in_use: int) -> LinePosterior | None:
    """Return all solutions for points and lines.

    The equations are those of a polynomial, weighted: all terms of line, then all of sample, with
    the same k exponents; affine terms are not shrunk. Factors of single terms are drawn `draws`
    times (see `scales_of`). `in_use` is how many rows have a weight that matters.

    Returns None if the features without some one of them do not determine the affine terms, or
    leave fewer than two degrees of freedom.
    """
    A = equations.A
    b = equations.b
    powers = np.array(exponents)
    order = powers.sum(axis=1)
    is_free = np.tile(order < 2, 2)
    scales = scales_of(powers[order > 1], draws)
    count = int(is_free.sum())
    freedom = in_use - count
    by_row_count = _features_by_row_count(equations.feature)
    if freedom - max(rows.shape[1] for _, rows in by_row_count) < 2 or len(A) <= count:
        return None
    q, r = np.linalg.qr(np.concatenate([A[:, is_free], A[:, ~is_free]], axis=1))
    lengths = np.linalg.norm(A[:, is_free], axis=0)
    if (np.abs(np.diag(r))[:count] <= TOLERANCE * lengths).any():
        return None
    # The affine terms must be determined without any one feature, too.
    if min(_extreme_eigenvalue(_redundancy_matrices(q[:, :count], rows), smallest=True).min()
           for _, rows in by_row_count) < TOLERANCE:
        return None
    # Sizes of line and of sample by their geometric mean, which is the size of the grid.
    axis_sizes = np.stack([np.sqrt(AXIS_RATIOS), 1 / np.sqrt(AXIS_RATIOS)])
    grid = np.concatenate([(scales * axis_size[:, None, None]).reshape(-1, scales.shape[1])
                           for axis_size in axis_sizes], axis=1)                     # (g, 2 j)
    # Everything is worked out in the basis of what the shrunken columns add to the affine ones.
    u, values, vt = np.linalg.svd(r[count:, count:] * grid[:, None, :], full_matrices=False)
    inner = q[:, count:].T @ b
    projections = inner @ u                                                       # (g, q)
    outside = b - q @ (q.T @ b)
    strength = LINE_SIZES[:, None] * values[:, None, :]                          # (g, s, q)
    shrink = 1.0 / (1.0 + strength**2)
    prior = np.log1p(
        (LINE_SIZES * np.repeat(axis_sizes, len(scales), axis=1)[..., None] / TYPICAL_SIZE) ** 2)
    log_factor = 0.5 * np.log(shrink).sum(axis=2) - 0.5 * prior.sum(axis=0)
    square = (outside @ outside + (shrink * projections[:, None, :]**2).sum(axis=2)
              + in_use * (NO_NOISE * float(np.ptp(b)) / 2) ** 2)
    log_posterior = log_factor - freedom / 2 * np.log(square)
    group, size = np.nonzero(log_posterior > log_posterior.max() - MAX_LOG_RATIO)
    shrink = shrink[group, size]
    strength = strength[group, size]
    residual_projections = shrink * projections[group]
    basis = q[:, count:]
    errors = outside + np.matmul(residual_projections[:, None], u[group].transpose(
        0, 2, 1))[:, 0] @ basis.T
    coefficients = grid[group] * LINE_SIZES[size, None] * np.matmul(
        (strength * residual_projections)[:, None], vt[group])[:, 0]
    # I - H of each feature's rows: I less the leverage of all columns, and what each solution
    # leaves along the directions of its group.
    row_groups = [RowGroup(feature, rows,
                           np.empty((len(group), rows.shape[1], *rows.T.shape)))
                  for feature, rows in by_row_count]
    # All sizes of a group have its singular vectors, and stand next to each other.
    groups, starts = np.unique(group, return_index=True)
    for number, start, end in zip(groups, starts, [*starts[1:], len(group)], strict=True):
        cells = slice(start, end)
        directions = basis @ u[number]
        for row_group in row_groups:
            feature_directions = directions[row_group.rows.T]
            products = feature_directions[:, None] * feature_directions        # (r, r, f, q)
            np.matmul(shrink[cells], products.reshape(-1, products.shape[3]).T,
                      out=row_group.redundancy[cells].reshape(end - start, -1))
    for row_group in row_groups:
        row_group.redundancy[...] += _redundancy_matrices(q, row_group.rows)
    return LinePosterior(
        log_factor=log_factor[group, size], square=square[group, size], errors=errors,
        groups=tuple(row_groups), coefficients=coefficients,
        sizes=grid[group] * LINE_SIZES[size, None],
        effective=count + (1.0 - shrink).sum(axis=1), freedom=freedom)


def _features_by_row_count(feature: IntArray) -> list[tuple[IntArray, IntArray]]:
    """Return the features that have r rows, (f,), and their rows, (f, r), for each r in order.

    `feature` (m,) is the feature of each row.
    """
    row_counts = np.bincount(feature)
    # The rows sorted by feature: those of feature i are order[starts[i]:starts[i] + its count].
    order = np.argsort(feature, kind="stable")
    starts = np.cumsum(row_counts) - row_counts
    groups = []
    for row_count in np.unique(row_counts):
        features = np.flatnonzero(row_counts == row_count)
        groups.append((features, order[starts[features, None] + np.arange(row_count)]))
    return groups


def _redundancy_matrices(q: FloatArray, rows: IntArray) -> FloatArray:
    """Return I - Q_i Q_i' of f features, (r, r, f), for orthonormal columns q and `rows` (f, r)."""
    leverage = q[rows] @ q[rows].transpose(0, 2, 1)
    return np.ascontiguousarray((np.eye(rows.shape[1]) - leverage).transpose(1, 2, 0))
