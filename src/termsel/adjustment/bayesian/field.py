"""A polynomial with a random field: collocation, averaged over its scales.

Line and sample are each a regularised cubic polynomial (see
`termsel.adjustment.bayesian.posterior`), a stationary Gaussian random field and noise. The field
has the Matern covariance of smoothness 3/2,

    (ratio size)^2 (1 + r) exp(-r),   r^2 = 3 ((dl / length_l)^2 + (ds / length_s)^2),

with distances dl, ds between places in the image. The lengths may differ: strips and sheets of
maps stretch along one axis, and scanners shake along lines. Neither lengths nor ratio, size and
noise are known. All solutions on a grid are averaged with their posterior probabilities, those
without a field, which are believed as likely beforehand, among them. So where the points show no
local deformation the regularised polynomial remains.

In a plane, few points do not distinguish lengths from noise. There a thin-plate spline, a field
without lengths and next to affine functions alone, is a third course, and an affine image a fourth,
all as likely beforehand. From SPLINE_SURE_POINTS to SPLINE_MAX_POINTS this fades: a fold
is judged as they are. Up to SPLINE_SURE_POINTS only blunders are sought so: positions are computed
by `termsel.adjustment.bayesian.plane_average`.

With many points the field is spanned by the covariances with FIELD_KNOTS of them.

References
----------
Moritz 1980, Advanced Physical Geodesy, for collocation; Matheron 1969 for universal kriging;
Stein 1999, Interpolation of Spatial Data, for the Matern covariance; Wahba 1990 for splines as
fields; Hoeting et al. 1999 for averaging; Quinonero-Candela and Rasmussen 2005, JMLR 6, for few
knots. The prior is termsel's own.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from termsel.adjustment.bayesian.held_out import HeldOutPredictions
from termsel.adjustment.bayesian.kernels import (
    batches_of,
    farthest_points,
    spline_field,
    squared_distances,
)
from termsel.adjustment.bayesian.posterior import (
    MAX_LOG_RATIO,
    Posterior,
    normalise_probabilities,
    polynomial_posterior,
    predict_positions,
    solve_posterior,
    solve_posteriors,
)
from termsel.adjustment.bayesian.shrinkage import MIN_REDUNDANCY
from termsel.adjustment.equations import weights_of
from termsel.data.features import FloatArray, IntArray, Points
from termsel.data.monomials import Exponents, evaluate_monomials, graded_exponents
from termsel.data.view import Measurements

# How much likelier each point is as a blunder than as a right one, given all others.
#
# A right point has the noise of all. A blunder has, in line and in sample, a normal error that is
# one of BLUNDER_SIZES as large, each as likely. Under one solution on the grid (see
# `termsel.adjustment.bayesian.posterior`) the errors e of a point that the others predict are t
# distributed: with their variances v by that of the noise, and S' the sum of squares of the others,
# their density is proportional to
#
#     (v_line v_sample)^-1/2 (S' + e_line^2 / v_line + e_sample^2 / v_sample)^-nu/2,
#
# nu the degrees of freedom with the point. Without a point each solution is as likely as with it,
# by the density that it gives to the point. So one posterior, of all points, is enough: the density
# of a point given the others is the mean, over its solutions, of a density by that one.
#
# The covariance of a random field is only a form, and what it predicts is less certain than it
# says: where it is part of a solution, what v exceeds 1 by is enlarged by FIELD_VARIANCE_FACTOR.

BLUNDER_SIZES = np.array([10.0, 18.0, 32.0, 56.0, 100.0])
"""Standard deviations of blunders by that of the noise: from what spoils a fit to what anyone
sees."""

FIELD_VARIANCE_FACTOR = 2.0
"""Variance of what a random field predicts, by what follows from its covariance."""


def blunder_odds(solutions: Iterable[tuple[float, Posterior, bool]],
                 points: IntArray) -> FloatArray:
    """Return the log odds of each of m points to be a blunder, if all others are right, (m,).

    That is the natural logarithm of its density as a blunder divided by its density as a right
    point: above 0 a blunder explains the error better, at ln 19 it does so 19 times as well.
    `solutions` are those for all points, each with its probability, its posterior, and whether a
    random field is part of it; `points` (m,) are the numbers of the points to judge.
    """
    # Densities add up over the solutions by their probabilities, p(e) = sum of p(cell) p(e | cell),
    # here in logarithms.
    wrong = []
    right = []
    for probability, solution, has_field in solutions:
        log_share = np.log(probability * solution.cells.share)
        factor = FIELD_VARIANCE_FACTOR if has_field else 1.0
        wrong.append(log_share + _log_density(solution, points, factor, BLUNDER_SIZES))
        right.append(log_share + _log_density(solution, points, factor, np.ones(1)))
    return np.asarray(_log_sum(wrong) - _log_sum(right))


def _log_density(posterior: Posterior, points: IntArray, factor: float,
                 sizes: FloatArray) -> FloatArray:
    """Return the log density of each point's error under each cell of a posterior, (m, c).

    The error is normal, and its standard deviation is the noise times one of the `sizes`, each
    with equal probability. The density is divided by that of the point as measured, which the
    probability of the cell contains. The variance that a prediction adds to the noise is multiplied
    by the `factor`.
    """
    axes = posterior.errors_of(points)
    # Of line and sample, m points and the c cells, each with the solution of its axis.
    redundancies = np.stack([axis.redundancies.T.take(axis.solution_of_cell, axis=1)
                             for axis in axes])
    errors = np.stack([axis.errors.T.take(axis.solution_of_cell, axis=1) for axis in axes])
    # The error without the point is e / l, of the variance 1 / l by that of the noise.
    squares = (errors / redundancies) ** 2
    point_squares = (squares * redundancies).sum(axis=0)  # e^2 / l: what it adds to the sum S
    other_squares = np.maximum(posterior.square - point_squares,
                               posterior.noise + MIN_REDUNDANCY * posterior.square)
    log_densities = []
    for size in sizes:
        variance = size**2 + factor * (1.0 / redundancies - 1.0)
        # The logarithm of the ratio of both densities, divided by half the freedom.
        gain = np.log((other_squares + point_squares)
                      / (other_squares + (squares / variance).sum(axis=0)))
        log_densities.append(
            (posterior.freedom * gain - np.log(redundancies * variance).sum(axis=0)) / 2)
    return np.asarray(np.logaddexp.reduce(log_densities) - np.log(len(sizes)))


def _log_sum(logs: list[FloatArray]) -> FloatArray:
    """Return the logarithm of the sum over all solutions, of logarithms (m, c) of each."""
    return np.asarray(np.logaddexp.reduce(np.concatenate(logs, axis=1), axis=1))


FIELD_LENGTHS = ((0.15, 0.15), (0.3, 0.3), (0.6, 0.6), (1.2, 1.2), (0.15, 1.2), (1.2, 0.15))
"""Lengths of line and sample, by the half-range of the image: from about the distance of
neighbours among a hundred points to where a field cannot be distinguished from a polynomial;
and two that differ."""

FIELD_RATIOS = (0.02, 0.2, 2.0)
"""Standard deviations of the field by those of quadratic coefficients, which `posterior.SIZES`
takes from the noise to where they are as good as free."""

FIELD_FALLS = (0.01, 0.1)
FIELD_RELIEF = 0.1
"""Cubic coefficients by quadratic ones, and those of one power of Z more, next to a field. With one
fall alone a field must stand in for the cubic terms that it does not allow."""

FIELD_DEGREE = 3

FIELD_PROBABILITY, EQUAL_LENGTHS_PROBABILITY = 0.5, 0.9
"""Probability of a field before the points are looked at, and that its lengths are equal then."""

SPLINE_LENGTHS = (np.inf, np.inf)
"""Lengths that stand for a spline."""

SPLINE_SURE_POINTS, SPLINE_MAX_POINTS = 12, 20
"""Number of points up to which a spline and an affine image are courses in their own right, and
from which on they are not needed."""

FIELD_KNOTS = 100

NEGLIGIBLE_PROBABILITY = 1e-6
"""Probability of a solution that is left out of a prediction."""

GROUND_BATCH = 2000
"""Places whose covariances are held in memory."""

PLACES_AT_ONCE = 512
"""Places whose covariances with all knots a cache holds."""

COVARIANCE_JITTER = 1e-10
"""Part of the field's variance that is added, so that covariances of close points can be
decomposed."""


@dataclass(frozen=True, eq=False)
class FieldSolutions:
    """All solutions with one pair of lengths, or without a field."""

    grid: Posterior | None  # None where it is not likely enough to matter
    log_evidence: float  # up to what is common to all pairs of lengths
    lengths: tuple[float, float] | None  # None without a field
    # (c, k): what makes coefficients of the field uncorrelated; empty without one.
    whitening: FloatArray

    @property
    def posterior(self) -> Posterior:
        """All solutions; only to be asked of fields that are likely, whose arrays are kept."""
        assert self.grid is not None
        return self.grid


@dataclass(frozen=True, eq=False)
class GaussianProcess:
    """What control points predict, averaged over all fields and none."""

    points: Points  # scaled
    exponents: Exponents  # affine ones first
    to_image: FloatArray  # (f, 2): affine coefficients that bring ground positions into the image
    knots: FloatArray  # (k, 2): places in the image
    solutions: tuple[FieldSolutions, ...]  # those without a field first
    spline_weight: float  # how far a spline is a course: from 0, many points or heights, to 1

    @cached_property
    def probabilities(self) -> FloatArray:
        """Probability of each of the s solutions, (s,)."""
        # Evidence by the sum of evidences, of which only ratios are known.
        return normalise_probabilities(np.array([solution.log_evidence
                                                 for solution in self.solutions]))[0]

    @property
    def probability(self) -> float:
        """Probability of a field."""
        total = 0.0
        for share, solution in zip(self.probabilities, self.solutions, strict=True):
            if solution.lengths is not None:
                total += share
        return float(total)

    @property
    def effective(self) -> float:
        """Effective parameters of line and sample together."""
        total = 0.0
        for share, solution in self._likely_solutions:
            for axis in (0, 1):
                total += share * solution.posterior.mean(axis)[1]
        return float(total)

    @cached_property
    def errors(self) -> FloatArray:
        """Measured minus predicted of each point, by the other points, shape (n, 2).

        Without a point the solutions change, and so do their probabilities; both have closed forms.
        """
        return self.held_out.errors / weights_of(self.points)

    @cached_property
    def _likely_solutions(self) -> list[tuple[float, FieldSolutions]]:
        """Solutions that matter, with their probabilities."""
        # What is exp(-MAX_LOG_RATIO) of the likeliest would not change a digit.
        highest = max(solution.log_evidence for solution in self.solutions)
        return [(share, solution)
                for share, solution in zip(self.probabilities, self.solutions, strict=True)
                if solution.log_evidence > highest - MAX_LOG_RATIO]

    @cached_property
    def held_out(self) -> HeldOutPredictions:
        """The prediction of each point by all others, averaged over all solutions."""
        solutions = [solution for _, solution in self._likely_solutions]
        predictions = [solution.posterior.held_out for solution in solutions]
        logs = np.empty((len(solutions), len(self.points)))
        for i, (solution, prediction) in enumerate(zip(solutions, predictions, strict=True)):
            # What is believed beforehand is the logarithm less that of the evidence of the points.
            logs[i] = (solution.log_evidence - solution.posterior.cells.log_evidence
                       + prediction.log_evidence)
        shares = normalise_probabilities(logs)[0]  # (p, n)

        def mean(values: Iterable[FloatArray]) -> FloatArray:
            return np.asarray(np.einsum("pn,pn...->n...", shares, np.array(list(values))))

        return HeldOutPredictions(
            errors=mean(prediction.errors for prediction in predictions),
            probability=mean(prediction.probability for prediction in predictions),
            statistic=mean(prediction.statistic for prediction in predictions),
            spread=mean(prediction.spread for prediction in predictions),
            log_evidence=np.logaddexp.reduce(logs))

    def blunder_odds(self, points: IntArray) -> FloatArray:
        """Return how much likelier points are as blunders (see `blunder_odds`)."""
        return blunder_odds([(share, solution.posterior, solution.lengths is not None)
                             for share, solution in self._likely_solutions], points)

    def predict(self, ground: FloatArray) -> FloatArray:
        """Return line and sample of places, shape (m, 2)."""
        polynomial, fields = self._coefficients
        columns = evaluate_monomials(ground, self.exponents)
        image = columns @ polynomial
        # Fields live in the image: the distance between points there is what shows how alike they
        # are.
        positions = columns[:, :len(self.to_image)] @ self.to_image
        for batch in batches_of(len(ground), PLACES_AT_ONCE):
            for lengths, weights in fields:
                image[batch] += _covariances_with_knots(
                    positions[batch], self.knots, lengths) @ weights
        return np.asarray(image)

    def spread(self, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the variance of the prediction, shape (m, 2), and that of the noise, (2,).

        `ground` are scaled places (m, 3). Under each solution of the grid a place has the variance
        of a prediction, and between the knots that of a field which they do not span. By the law of
        total variance the whole is the mean of these variances plus the variance of the
        predictions, both weighted by the solutions' probabilities.
        """
        n_affine = len(self.to_image)
        columns = evaluate_monomials(ground, self.exponents)
        positions = columns[:, :n_affine] @ self.to_image
        shares = []
        predictions = []
        for share, solution in zip(self.probabilities, self.solutions, strict=True):
            if share <= NEGLIGIBLE_PROBABILITY:
                continue
            spanned = _columns_with_field(columns, positions, self.knots, solution.lengths,
                                          solution.whitening)
            unspanned = None
            if solution.lengths is not None:
                # Away from the knots the field has a variance that their covariances do not span.
                field = spanned[:, columns.shape[1]:]
                prior = _field_variances(positions, self.knots, solution.lengths)
                unspanned = (np.square(solution.posterior.scales[:, -1:])
                             * np.maximum(prior - (field**2).sum(axis=1), 0.0))
            shares.append(share)
            predictions.append(predict_positions(solution.posterior, columns[:, :n_affine],
                                                 spanned[:, n_affine:], unspanned))
        # The law of total variance: the mean of the variances, and the variance of the means.
        mean = sum(share * predicted.image
                   for share, predicted in zip(shares, predictions, strict=True))
        variance = np.zeros((len(ground), 2))
        for share, predicted in zip(shares, predictions, strict=True):
            variance = variance + share * (predicted.variance + (predicted.image - mean) ** 2)
        noise = float(np.dot(shares, [predicted.noise for predicted in predictions]))
        return variance, np.full(2, noise)

    @cached_property
    def _coefficients(self) -> tuple[FloatArray, list[tuple[tuple[float, float], FloatArray]]]:
        """Return averaged coefficients of monomials and fields, by which positions are computed.

        Coefficients of monomials are (k, 2), and each field has its two lengths and values (knots,
        2) at the knots. Prediction is linear in them, so that solutions are averaged once and not
        at each place. Affine terms are not shrunken: theirs are those of least squares to what the
        other terms leave.
        """
        n_affine = len(self.to_image)
        n_terms = len(self.exponents)
        n_shrunk = n_terms - n_affine
        weights = weights_of(self.points)
        polynomial = np.zeros((n_terms, 2))
        affine_targets = np.zeros_like(self.points.image)
        fields = []
        columns = evaluate_monomials(self.points.ground, self.exponents)
        positions = columns[:, :n_affine] @ self.to_image
        for share, solution in self._likely_solutions:
            shrunk = np.stack([solution.posterior.mean(axis)[0] for axis in (0, 1)], axis=1)
            spanned = _columns_with_field(columns, positions, self.knots, solution.lengths,
                                          solution.whitening)
            affine_targets += share * (self.points.image - spanned[:, n_affine:] @ shrunk)
            polynomial[n_affine:] += share * shrunk[:n_shrunk]
            if solution.lengths and share > NEGLIGIBLE_PROBABILITY:
                fields.append((solution.lengths, share * solution.whitening.T @ shrunk[n_shrunk:]))
        # Affine terms of each solution fit what its other terms leave: their mean fits the mean.
        affine = columns[:, :n_affine]
        for axis, w in enumerate(weights.T):
            polynomial[:n_affine, axis] = np.linalg.lstsq(affine * w[:, None],
                                                          affine_targets[:, axis] * w)[0]
        return polynomial, fields


def fit_gaussian_process(points: Points, variables: int) -> GaussianProcess | None:
    """Return the prediction by a polynomial with a random field, from scaled control points.

    The polynomial is in 2 variables, X and Y, or 3, with Z. Returns None if the points without some
    one of them do not determine an affine model with redundancy.
    """
    # Three more than the affine coefficients of an axis: with fewer a field explains anything.
    if len(points) < variables + 3:
        return None
    return _cached_gaussian_process(Measurements.of(points), variables)


@lru_cache(maxsize=1)  # of many points one takes a great part of the memory
def _cached_gaussian_process(measurements: Measurements, variables: int) -> GaussianProcess | None:
    """Return the process of points; None if they are too few for it (see `polynomial_posterior`).

    `variables` is how many coordinates the field depends on: 2, X and Y, or 3, Z too. The process
    averages the polynomial alone, fields of all `FIELD_LENGTHS` next to it, and in the plane a
    spline. It is cached, since one fit asks for it many times.
    """
    points = measurements.points
    exponents = graded_exponents(FIELD_DEGREE, variables)
    order = np.array(exponents).sum(axis=1)
    shrunk = np.array(exponents)[order > 1]
    columns = evaluate_monomials(points.ground, exponents)
    to_image = _affine_to_image(points, exponents[:variables + 1])
    positions = columns[:, :variables + 1] @ to_image
    # Of many points a hundred knots, spread evenly: a field between them is smooth.
    knots = farthest_points(positions, FIELD_KNOTS)
    weights = None if points.sigma is None else weights_of(points)
    scales = _scales_with_field(tuple(exponents[variables + 1:]), len(knots))
    spline_weight = _spline_weight(len(points)) if variables == 2 else 0.0

    grid = polynomial_posterior(points.ground, points.image, exponents, weights)
    if grid is None:
        return None
    solutions = [_solutions_of(grid, None, np.empty((0, 0)))]
    affine_columns = columns[:, :variables + 1]
    shrunk_columns = columns[:, variables + 1:]
    # Then the solutions with fields of all lengths, as one stack where points are few.
    at_once = len(FIELD_LENGTHS) if knots is positions else 1
    # One array for all of them, as it is the largest.
    shrunken = np.empty((at_once, len(positions), len(shrunk) + len(knots)))
    shrunken[..., :len(shrunk)] = shrunk_columns
    for start in range(0, len(FIELD_LENGTHS), at_once):
        batch = FIELD_LENGTHS[start:start + at_once]
        covariances = np.array([_covariances_with_knots(knots, knots, lengths)
                                for lengths in batch])
        whitenings = _whitening_matrices(covariances)
        if knots is positions:
            np.matmul(covariances, whitenings.swapaxes(1, 2), out=shrunken[..., len(shrunk):])
        else:
            _fill_field_columns(shrunken[0, :, len(shrunk):], positions, knots, batch[0],
                                whitenings[0])
        grids = solve_posteriors(affine_columns, shrunken, points.image, weights, scales,
                                 len(shrunk))
        if grids is None:
            return None
        solutions += map(_solutions_of, grids, batch, whitenings)
        highest = max(solution.log_evidence for solution in solutions)
        # Solutions that are far less likely than others lose their arrays, which fill the memory.
        for i, solution in enumerate(solutions[1:], 1):
            if solution.log_evidence <= highest - MAX_LOG_RATIO:
                solutions[i] = replace(solution, grid=None)
    if spline_weight > 0.0:
        # A spline is added to affine functions alone: the shrunken terms have the scale 0.
        whitening = _whitening_of_spline(knots)
        spline_columns = _columns_with_field(shrunk_columns, positions, knots, SPLINE_LENGTHS,
                                             whitening)
        grids = solve_posteriors(
            affine_columns, spline_columns[None], points.image, weights,
            np.repeat([[0.0, 1.0]], [len(shrunk), len(whitening)], axis=1), len(shrunk))
        if grids is None:
            return None
        solutions.append(_solutions_of(grids[0], SPLINE_LENGTHS, whitening, spline_weight))
        # Where a spline is a course of its own, so is the affine image that it would smooth.
        affine = solve_posterior(
            columns, points.image, order, weights, np.zeros((1, len(shrunk))), len(points))
        assert affine is not None
        prior = _prior_probability(None) * spline_weight
        solutions.insert(1, FieldSolutions(affine, affine.cells.log_evidence + np.log(prior), None,
                                           solutions[0].whitening))
    return GaussianProcess(points, exponents, to_image, knots, tuple(solutions), spline_weight)


def _solutions_of(grid: Posterior, lengths: tuple[float, float] | None, whitening: FloatArray,
                  weight: float = 1.0) -> FieldSolutions:
    """Return the solutions of a grid of scales for a field of `lengths`, None without a field.

    Their log evidence contains the prior probability of the lengths, times `weight`.
    """
    # Each pair of lengths shares its probability among the scales that are tried with it.
    prior = _prior_probability(lengths) * weight
    return FieldSolutions(grid, grid.cells.log_evidence + np.log(prior / len(grid.scales)), lengths,
                          whitening)


def _spline_weight(points: int) -> float:
    """Return the prior weight of a spline next to fields, 1 to 0, by the number of points.

    Points are in a plane; fields with heights know no spline.
    """
    # From certain at SPLINE_SURE_POINTS to none at SPLINE_MAX_POINTS, in a straight line.
    share = (SPLINE_MAX_POINTS - points) / (SPLINE_MAX_POINTS - SPLINE_SURE_POINTS)
    return float(np.clip(share, 0.0, 1.0))


def _scales_with_field(exponents: Exponents, knots: int) -> FloatArray:
    """Return scales of k shrunken coefficients and of a field's knots, shape (g, k + knots).

    A group has one of the falls and one of the ratios, in all g pairs; all columns of the field
    share one scale. `exponents` are those of the k terms.
    """
    shrunk = np.array(exponents)
    order = shrunk.sum(axis=1)
    scales = []
    for fall in FIELD_FALLS:
        # Coefficients shrink with their order, and those with heights more than others.
        rule = fall ** (order - 2.0) * FIELD_RELIEF ** shrunk[:, 2]
        for ratio in FIELD_RATIOS:
            scales.append([*rule, *np.full(knots, ratio)])
    return np.array(scales)


def _affine_to_image(points: Points, linear: Exponents) -> FloatArray:
    """Return the affine transformation of the ground to the image, by least squares, shape (f, 2).

    Distances between places are taken in the image: there sheets shrink and scanners shake, and
    line and sample have one unit. `linear` are the f exponents of an affine function.
    """
    return np.asarray(np.linalg.lstsq(evaluate_monomials(points.ground, linear), points.image)[0])


def _prior_probability(lengths: tuple[float, float] | None) -> float:
    """Return the probability of lengths before the points are looked at, up to a factor."""
    if lengths in (None, SPLINE_LENGTHS):
        return 1.0 - FIELD_PROBABILITY
    # Equal lengths share nine tenths of the probability, unequal ones the rest.
    n_equal = sum(line == sample for line, sample in FIELD_LENGTHS)
    if lengths[0] == lengths[1]:
        return FIELD_PROBABILITY * (EQUAL_LENGTHS_PROBABILITY / n_equal)
    return FIELD_PROBABILITY * ((1.0 - EQUAL_LENGTHS_PROBABILITY)
                                / (len(FIELD_LENGTHS) - n_equal))


def _columns_with_field(columns: FloatArray, positions: FloatArray, knots: FloatArray,
                        lengths: tuple[float, float] | None, whitening: FloatArray) -> FloatArray:
    """Return monomials (n, k) followed by the columns that span a field, (n, k + c).

    Without `lengths` there is no field, and the monomials come back alone.
    """
    if lengths is None:
        return columns
    n, k = columns.shape
    columns_with_field = np.empty((n, k + len(whitening)))
    columns_with_field[:, :k] = columns
    _fill_field_columns(columns_with_field[:, k:], positions, knots, lengths, whitening)
    return columns_with_field


def _fill_field_columns(field_columns: FloatArray, positions: FloatArray, knots: FloatArray,
                        lengths: tuple[float, float], whitening: FloatArray) -> None:
    """Fill in the columns that span a field at places (n, 2), `field_columns` (n, c)."""
    for batch in batches_of(len(positions), PLACES_AT_ONCE):
        np.matmul(_covariances_with_knots(positions[batch], knots, lengths), whitening.T,
                  out=field_columns[batch])


def _whitening_matrices(covariances: FloatArray) -> FloatArray:
    """Return W (d, k, k) of fields whose covariances of the knots are (d, k, k).

    Coefficients W' u of the knots have a field's covariance if u is white.
    """
    # K = L L': coefficients by L^-1 are independent with variance one.
    factors = np.linalg.cholesky(covariances + COVARIANCE_JITTER * np.eye(covariances.shape[1]))
    return np.asarray(np.linalg.inv(factors.swapaxes(1, 2)).swapaxes(1, 2))


def _whitening_of_spline(knots: FloatArray) -> FloatArray:
    """Return W (c, k) of the field whose best prediction is a spline (see above)."""
    values, vectors = np.linalg.eigh(_covariances_with_knots(knots, knots, SPLINE_LENGTHS))
    # What affine functions fit has no variance.
    spanned = values > COVARIANCE_JITTER * values.max()
    return np.asarray((vectors[:, spanned] / np.sqrt(values[spanned])).T)


def _covariances_with_knots(positions: FloatArray, knots: FloatArray,
                            lengths: tuple[float, float]) -> FloatArray:
    """Return covariances of a field at places (m, 2) and at knots (k, 2), shape (m, k)."""
    if lengths != SPLINE_LENGTHS:
        # Matern with nu = 3/2: (1 + r) exp(-r), r = sqrt(3) times the distance by lengths.
        r = squared_distances(positions * np.sqrt(3.0) / lengths, knots * np.sqrt(3.0) / lengths)
        np.sqrt(r, out=r)
        correlation: FloatArray = np.exp(-r)
        r += 1.0  # in place, as these are the largest arrays
        correlation *= r
        return correlation
    return spline_field(knots).covariances(positions)


def _field_variances(positions: FloatArray, knots: FloatArray,
                     lengths: tuple[float, float]) -> FloatArray:
    """Return the variances (m,) of a field at places (m, 2); its scale is another factor."""
    if lengths != SPLINE_LENGTHS:
        return np.ones(len(positions))
    return spline_field(knots).variances(positions)
