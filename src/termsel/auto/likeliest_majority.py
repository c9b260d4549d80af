"""The half of many points that agrees best, where the image bends more than polynomials follow.

An aircraft's or a panoramic image leaves such noise to the polynomials of `termsel.auto.majority`
that blunders of some tens of pixels do not stand out, and few points have to carry all terms. So
the points that agree are those under which all are likeliest: a right one is predicted by the other
right ones, under a cubic polynomial whose terms are believed to be small, and the error of a wrong
one is normal, as large as what all points together leave. From the halves of the polynomials on,
each point goes where it is likelier, until none moves (classification EM; Celeux and Govaert 1992).
How small terms and noise are is each time chosen by the evidence.

Points without blunders disagree as well where the image bends. A majority counts only if it makes
all points far likelier than one polynomial of all does, if the others are gross next to it, and if
their errors differ from those of their neighbours or are one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import TypeAlias

import numpy as np

from termsel.adjustment.equations import weights_of
from termsel.auto.contradictions import Division, Test, polynomial_of
from termsel.auto.majority import (
    LEAST_VARIANCE,
    MAX_BLUNDER_SHARE,
    MAX_DEVIATION,
    MAX_SAMPLED_POINTS,
    MIN_POINTS,
    MIN_SEEN_POINTS,
    Halves,
    distances_from_fit,
    may_be_bend,
    polynomial_designs,
)
from termsel.data.features import BoolArray, FloatArray
from termsel.data.fit_data import FitData
from termsel.data.monomials import evaluate_monomials

Majority: TypeAlias = tuple[BoolArray, Test]
"""Points (n,) that agree, and what they predict for all."""

LEAST_DISTANCE = 1e-6
"""Distances of scaled coordinates below which rounding shows in variances."""

FIRST_STARTS = 3
"""Halves of each polynomial that are climbed from at first."""

REFINED = 4
"""Sets climbed to that the regularised polynomial of all solutions judges."""

SAMPLES = 4000
SAMPLE_SIZE = 10
"""Random samples under each scale of terms, and their size: of points half of which are wrong, four
samples of 4,000 have none."""

SAMPLED_SCALES = (1, 4, 7)
SAMPLED_NOISE = 4
"""Numbers of the scales and of the noise of samples."""

SAMPLED_STARTS = 12
"""Samples of each scale that are climbed from."""

CLIMBED_STEPS = 12
"""Most steps of a climb; five are usual."""

NOISES = 2.0 ** -np.arange(9)
"""Noise of right points, by the distances that all points have from their quadratic polynomial."""

TERM_SCALES = tuple((quadratic, quadratic * cubic) for quadratic in (0.003, 0.01, 0.03, 0.1)
                    for cubic in (1.0, 0.3, 0.1))
"""Standard deviations of quadratic and cubic coefficients of scaled coordinates."""

AFFINE_SCALE = 10.0
"""Standard deviation of the others, which nothing is believed of."""

MIN_GAIN = 0.5
"""Gain of the log-likelihood for each point, next to a polynomial of all, from which on a majority
counts. Of scenes without blunders whose errors are no bend it is up to 0.47."""

MIN_GAIN_OF_FEW = 1.0
"""The same of fewer than MIN_POINTS, which agree by chance more often: sheets with humps may reach
0.5 without blunders, and none of 280 sheets and images without any reached this."""

MIN_SEEN_GAIN = 0.3
"""Such a gain by one solution, from which on further starts and all solutions are asked: that takes
longer."""

UNLIKE_AT_FIRST = 0.2
"""Difference of the errors of neighbours, as CLEARLY_UNLIKE, from which on they are."""

CLEAR_GAIN = 1.8
"""Gain of the first starts, from which on further ones would find the same."""

GROSS_STRAIN = 5.0
"""Standard deviations that the others disagree by, in the median."""

CLEARLY_UNLIKE = 0.5
"""Squared difference of the errors of neighbours, by that of independent errors, from which on they
are no bend. Of bends that pass all else it is at most 0.4."""

RELIEF_CROSS = 0.33
"""Sine of the angle between errors and the directions of relief, up to which they may be such: in
the root mean square. Of twenty independent errors it is 0.4 to 0.7."""

PREDICTED_STRAIN = 3.0
"""Standard deviations within which the regularised polynomial takes a point into its next fit."""

_TINY = 1e-300
"""What takes the place of a zero that is divided by."""

REGULARISED_STEPS = 12
"""Most fits of the regularised polynomial from one set; four are usual."""


@dataclass(frozen=True, eq=False)
class SetsJudged:
    """What sets of points make of all points, by their likeliest solutions."""

    log_likelihood: FloatArray  # (m,)
    log_odds: FloatArray  # (m, n): of each point, right by wrong
    errors: FloatArray  # (m, n, 2): from what the others of the set predict, scaled
    variances: FloatArray  # (m, n): of these errors


@dataclass(frozen=True, eq=False)
class Likelihoods:
    """Control points as the likelihood needs them: right ones follow a cubic, blunders do not.

    The likelihood of a point with the error e is the mean of two normal densities: of a right
    point with the variance of its prediction, of a blunder with that of all distances.
    """

    design: FloatArray  # (n, k)
    powers: FloatArray  # (k,): total powers of the terms
    image: FloatArray  # (n, 2), scaled
    distances: FloatArray  # (n,): from the quadratic polynomial of all points, scaled

    @cached_property
    def scales(self) -> FloatArray:
        """Standard deviations of the k coefficients under each of the s priors, (s, k)."""
        return np.array([np.where(self.powers <= 1, AFFINE_SCALE,
                                  np.where(self.powers == 2, quadratic, cubic))
                         for quadratic, cubic in TERM_SCALES])

    @cached_property
    def mean_square(self) -> float:
        """Mean square of the distances for each of both coordinates, the variance of blunders."""
        return float((self.distances**2).mean()) / 2

    @cached_property
    def noises(self) -> FloatArray:
        """Standard deviations that right points may have, (q,)."""
        return np.asarray(np.sqrt(self.mean_square) * NOISES)

    @cached_property
    def log_wrong(self) -> FloatArray:
        """Log density of each point's error if it is a blunder, (n,): normal in the plane."""
        return np.asarray(-np.log(2 * np.pi * self.mean_square)
                          - self.distances**2 / (2 * self.mean_square))

    def judge(self, sets: BoolArray) -> SetsJudged:
        """Fit the polynomial to each of m sets of points (m, n), and judge all points by each fit.

        Each set is fitted under the prior of the coefficients, and with the noise, under which it
        is likeliest.
        """
        count, n = sets.shape
        k = self.design.shape[1]
        used = sets.astype(float)
        # With the deviations S of the coefficients, the design A of a set and its image b, the
        # decomposition V w V' is that of S A'A S, and z = V' S A'b. A noise s^2 then has the
        # coefficients S V z / (w + s^2).
        products = (self.design[:, :, None] * self.design[:, None, :]).reshape(n, k * k)
        gram = (used @ products).reshape(count, 1, k, k)
        values, vectors = np.linalg.eigh(
            gram * self.scales[:, :, None] * self.scales[:, None, :])         # (m, s, k), (.., k)
        values = np.maximum(values, 0.0)
        right_side = np.stack([(used * self.image[:, axis]) @ self.design for axis in (0, 1)], 2)
        z = vectors.transpose(0, 1, 3, 2) @ (self.scales[:, :, None] * right_side[:, None])
        squares = used @ (self.image**2).sum(axis=1)
        scale, noise = self._likeliest_scale_and_noise(values, z, squares, used.sum(axis=1))

        # The solution of each set: its coefficients, and what it predicts for all points.
        rows = np.arange(count)
        scaled_vectors = self.scales[scale][:, :, None] * vectors[rows, scale]  # S V
        variance = self.noises[noise]**2
        inverse = 1.0 / (values[rows, scale] + variance[:, None])               # (m, k)
        coefficients = scaled_vectors @ (z[rows, scale] * inverse[:, :, None])
        errors = self.image - self.design @ coefficients
        # h = a' S V (w + s^2)^-1 V' S a, the variance of the prediction by that of the noise.
        leverage = ((self.design @ scaled_vectors)**2 * inverse[:, None, :]).sum(axis=2)
        # A point of the set is predicted by the others of it: r / (1 - h), with s^2 / (1 - h).
        redundancy = np.maximum(1.0 - leverage, LEAST_VARIANCE)
        errors = np.where(sets[:, :, None], errors / redundancy[:, :, None], errors)
        variances = variance[:, None] * np.where(sets, 1.0 / redundancy, 1.0 + leverage)
        log_right = (-np.log(2 * np.pi * variances) - (errors**2).sum(axis=2) / (2 * variances))
        return SetsJudged(np.logaddexp(log_right, self.log_wrong).sum(axis=1),
                          log_right - self.log_wrong, errors, variances)

    def _likeliest_scale_and_noise(self, values: FloatArray, z: FloatArray, squares: FloatArray,
                                   points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return which scales and which noise have the largest evidence for each set, (m,) each.

        They are numbers of rows of `scales` and of entries of `noises`. With the design A of a set
        and the deviations S of the coefficients, S A'A S is V w V' with the eigenvalues w, `values`
        (m, s, k). `z` (m, s, k, 2) is V' S A'b for the image b of line and of sample, `squares`
        (m,) the sums b'b of both, and `points` (m,) how many points are in the sets.
        """
        # The evidence is the density of b as normal with the covariance C = A S^2 A' + s^2:
        # log |C| = sum log(1 + w / s^2) + n log s^2, b' C^-1 b = (b'b - sum z^2 / (w + s^2)) / s^2.
        variance = self.noises**2
        sums = values[..., None] + variance                                   # (m, s, k, q)
        points = points[:, None, None]
        log_determinant = (np.log(sums / variance).sum(axis=2)
                           + points * np.log(2 * np.pi * variance))
        explained = ((z**2).sum(axis=3)[..., None] / sums).sum(axis=2)
        quadratic_form = (squares[:, None, None] - explained) / variance
        # Twice the logarithm of the determinant's root: line and sample have one each.
        evidence = -log_determinant - quadratic_form / 2
        best = evidence.reshape(len(evidence), -1).argmax(axis=1)
        return np.divmod(best, len(variance))

    def climb(self, sets: BoolArray) -> list[tuple[float, BoolArray]]:
        """Return the log-likelihoods of all sets passed in climbing from m sets, and the sets (n,).

        The likeliest come first, each once. A step takes the points that a set makes likelier right
        than wrong as the next set, which is at least as likely (classification EM).
        """
        reached: dict[bytes, tuple[float, BoolArray]] = {}
        for _ in range(CLIMBED_STEPS):
            # Climbs often meet: each set is judged once.
            new_sets = {used.tobytes(): used for used in sets if used.tobytes() not in reached}
            if not new_sets:
                break
            sets = np.array(list(new_sets.values()))
            judged = self.judge(sets)
            for used, likelihood in zip(sets, judged.log_likelihood, strict=True):
                reached[used.tobytes()] = float(likelihood), used
            sets = likelier_right(judged.log_odds)
        return sorted(reached.values(), key=lambda likelihood_and_set: -likelihood_and_set[0])

    def best_samples(self, rng: np.random.Generator) -> BoolArray:
        """Return masks (m, n) of the points that the best random samples make likelier right.

        These are SAMPLED_STARTS samples under each of the SAMPLED_SCALES, m in all; a sample's own
        points are in its mask. A sample predicts all other points as a random field of these terms
        does: far from it the prediction is uncertain. `rng` draws the samples.
        """
        n = len(self.design)
        samples = np.argpartition(rng.random((SAMPLES, n)), SAMPLE_SIZE, axis=1)[:, :SAMPLE_SIZE]
        variance = self.noises[SAMPLED_NOISE]**2
        sets = []
        for scales in self.scales[list(SAMPLED_SCALES)]:
            # Kriging from the sample: the covariance of two places is a' S^2 b.
            covariance = (self.design * scales**2) @ self.design.T
            within = covariance[samples[:, :, None], samples[:, None, :]]
            to_all = covariance[samples]                                      # (m, size, n)
            weights = np.linalg.solve(within + variance * np.eye(SAMPLE_SIZE), to_all)
            predicted = weights.transpose(0, 2, 1) @ self.image[samples]
            explained = (to_all * weights).sum(axis=1)
            variances = np.maximum(np.diag(covariance) - explained, 0.0) + variance
            squares = ((self.image - predicted)**2).sum(axis=2)
            log_odds = (-np.log(2 * np.pi * variances) - squares / (2 * variances)
                        - self.log_wrong)
            # What a sample predicts for its own points says nothing.
            np.put_along_axis(log_odds, samples, 0.0, axis=1)
            best = np.argsort(-np.logaddexp(log_odds, 0.0).sum(axis=1),
                              kind="stable")[:SAMPLED_STARTS]
            # The points of a sample are in its set.
            log_odds_of_best = log_odds[best]
            np.put_along_axis(log_odds_of_best, samples[best], np.inf, axis=1)
            sets.append(likelier_right(log_odds_of_best))
        return np.concatenate(sets)

    def is_contradicted(self, used: BoolArray) -> bool:
        """Return whether a set, a mask (n,), shows more than a third of all to be gross blunders.

        Errors that may be relief, or a bend of the image, do not make blunders.
        """
        if (~used).mean() <= MAX_BLUNDER_SHARE:
            return False
        judged = self.judge(used[None])
        if _may_be_relief(self.image[~used], judged.errors[0, ~used]):
            return False
        # Of an error in line and sample the square over 2 variances is 1 in the mean by chance.
        squares = (judged.errors[0, ~used]**2).sum(axis=1)
        strains = np.sqrt(squares / 2 / judged.variances[0, ~used])
        are_gross = bool(np.median(strains) >= GROSS_STRAIN)
        return are_gross and not self.may_be_bend(used, CLEARLY_UNLIKE)

    def may_be_bend(self, used: BoolArray, max_unlikeness: float) -> bool:
        """Return whether the errors of the points outside a set (n,) may be a bend of the image.

        `max_unlikeness` is as for `majority.may_be_bend`.
        """
        # The second and third term are the scaled coordinates of the plane.
        return may_be_bend(self.design[:, 1:3], used, self.judge(used[None]).errors[0, ~used],
                           max_unlikeness)


def _may_be_relief(image: FloatArray, errors: FloatArray) -> bool:
    """Return whether errors (m, 2) at image positions (m, 2) are what unknown heights do.

    Relief moves points along one direction in the image of a scanner, and along lines through the
    nadir point c in that of a camera: e x (p - c) is 0 for the direction e of each error. In
    homogeneous coordinates, (w p - c) with w = 0 for one direction, that is the least singular
    value of the rows (e x p, e_sample, -e_line).
    """
    # Errors that are all the same are a shift, and no relief.
    shift = errors.mean(axis=0)
    if np.linalg.norm(errors - shift) < MAX_DEVIATION * np.linalg.norm(shift) * len(errors)**0.5:
        return False
    # An error counts by the root of its size, as the direction of a small one is noise.
    sizes = np.linalg.norm(errors, axis=1)
    line, sample = (errors / np.sqrt(np.maximum(sizes * sizes.mean(), _TINY))[:, None]).T
    rows = np.column_stack([line * image[:, 1] - sample * image[:, 0], sample, -line])
    # The first column becomes as long as the others, whatever the extent of the image.
    rows[:, 0] /= max(float(np.sqrt((rows[:, 0]**2).mean() * 2)), _TINY)
    least = np.linalg.svd(rows, compute_uv=False)[-1]
    return bool(least < RELIEF_CROSS * len(rows)**0.5)


def likelier_right(log_odds: FloatArray) -> BoolArray:
    """Return masks (m, n) of the points that are likelier right than wrong by their log odds.

    Where these are fewer than half of the n points, the half with the largest odds comes back: a
    smaller set would fit fewer and fewer points.
    """
    rank = np.argsort(np.argsort(-log_odds, axis=1, kind="stable"), axis=1)
    return np.asarray((log_odds > 0) | (rank < log_odds.shape[1] // 2))


def likeliest_majority(control: FitData, of_polynomials: Majority | None,
                       halves: Halves | None = None) -> Majority | None:
    """Return the majority of control points under which all points are likeliest, and its test.

    Parameters
    ----------
    control : FitData
        Control points; with lines, or fewer than MIN_SEEN_POINTS, nothing is sought.
    of_polynomials : tuple or None
        The majority that `termsel.auto.majority` found, which is returned where none is likelier.
    halves : Halves, optional
        The halves of the control points, if they are known.

    Returns
    -------
    tuple of ndarray and Test, or None
        The mask (n,) of the majority, and its test of all points. None if no majority is clear: a
        third of the points or fewer disagree, or not grossly, or one polynomial of all points makes
        them about as likely.
    """
    n = len(control)
    if n < MIN_SEEN_POINTS or len(control.features.lines):
        return of_polynomials
    if n <= MAX_SAMPLED_POINTS:
        return _likeliest_of(control, of_polynomials, halves)
    if of_polynomials is not None:
        return of_polynomials
    # Of many points a sample shows the majority; its prediction then decides about all.
    is_sampled = np.zeros(n, dtype=bool)
    is_sampled[np.random.default_rng(0).permutation(n)[:MAX_SAMPLED_POINTS]] = True
    of_sample = _likeliest_of(control.take(is_sampled), None)
    if of_sample is None:
        return None
    is_sampled[is_sampled] = of_sample[0]
    test = Division(control, is_sampled).shrunken_test()
    if test is None:
        return None
    used = test.strain <= PREDICTED_STRAIN
    test = Division(control, used).shrunken_test()
    return None if test is None else (used, test)


def _likeliest_of(data: FitData, of_polynomials: Majority | None,
                  halves: Halves | None = None) -> Majority | None:
    """Return the majority of at most MAX_SAMPLED_POINTS points that makes all of them likeliest.

    The climb starts from the best halves of polynomials. Further halves and random samples follow
    only where these find something, but nothing clear. Where nothing is found, `of_polynomials`
    comes back, which may be None.
    """
    n = len(data)
    points = data.scaled.points
    everything = np.ones(n, dtype=bool)
    [design, *_], _ = polynomial_designs(points.ground, heights=data.heights)
    distances = distances_from_fit(design, points.image, everything)
    halves = None if distances.max() < LEAST_DISTANCE else halves or Halves.of(data)
    if halves is None:
        return of_polynomials
    exponents = polynomial_of(data.heights, 3).exponents
    likelihoods = Likelihoods(evaluate_monomials(points.ground, exponents),
                              np.array(exponents).sum(axis=1), points.image, distances)
    # A majority must make the points likelier than one polynomial of all of them does.
    likelihood_of_all = float(likelihoods.judge(everything[None]).log_likelihood[0])
    min_likelihood = likelihood_of_all + MIN_SEEN_GAIN * n
    first_starts: list[BoolArray] = []
    for halves_of_design in halves.of_designs:
        first_starts += halves_of_design[:FIRST_STARTS]
    reached = likelihoods.climb(np.array(first_starts))
    # Most points without blunders end here.
    if not any(likelihood > min_likelihood and not likelihoods.may_be_bend(used, UNLIKE_AT_FIRST)
               for likelihood, used in reached[:REFINED]):
        return of_polynomials
    likelihood, used = reached[0]
    if likelihood - likelihood_of_all < CLEAR_GAIN * n or not likelihoods.is_contradicted(used):
        every_half = list(chain.from_iterable(halves.of_designs))
        rng = np.random.default_rng(0)  # the same points have the same majority
        reached = likelihoods.climb(np.concatenate([every_half, likelihoods.best_samples(rng)]))
    likely_sets = [used for likelihood, used in reached[:REFINED] if likelihood > min_likelihood]
    return _likeliest_fit(data, likelihoods, likely_sets, of_polynomials)


def _likeliest_fit(data: FitData, likelihoods: Likelihoods, sets: Sequence[BoolArray],
                   of_polynomials: Majority | None) -> Majority | None:
    """Return the likeliest majority under the regularised polynomial, sought from each of the sets.

    Each set is a mask (n,) of the points that the search begins with. Where one polynomial of all
    points makes them about as likely, or no majority is likelier than `of_polynomials`, that comes
    back.
    """
    distances = likelihoods.distances * data.scaling.image_scale
    weights = weights_of(data.features.points)

    def likelihood(fit: Majority) -> float:
        return _log_likelihood(fit[1], distances, weights)

    everything = np.ones(len(data), dtype=bool)
    test_of_all = Division(data, everything).shrunken_test()
    fits: dict[bytes, Majority] = {}
    for start in sets:
        for used, test in _regularised_fits(data, start):
            fits[used.tobytes()] = used, test
    if not fits or test_of_all is None:
        return of_polynomials
    used, test = max(fits.values(), key=likelihood)
    gain = likelihood((used, test)) - likelihood((everything, test_of_all))
    min_gain = MIN_GAIN if len(data) >= MIN_POINTS else MIN_GAIN_OF_FEW
    if gain < min_gain * len(data) or not likelihoods.is_contradicted(used):
        return of_polynomials
    # Some points that the majority predicts well may not be in it.
    used = used | (test.strain <= PREDICTED_STRAIN)
    test = Division(data, used).shrunken_test() or test
    if of_polynomials is not None and likelihood(of_polynomials) >= likelihood((used, test)):
        return of_polynomials
    return used, test


def _regularised_fits(data: FitData, start: BoolArray) -> list[Majority]:
    """Return the points in use (n,) and their test, for each step of refitting from a start (n,).

    A step fits the regularised polynomial to the points in use. The next step uses the points that
    it predicts within PREDICTED_STRAIN, or the closer half of all where these are fewer. The list
    is empty where the points of the start are too few.
    """
    fits: dict[bytes, Majority] = {}
    used = start
    # A set that is met again would lead to the same sets for ever.
    while used.tobytes() not in fits and len(fits) < REGULARISED_STEPS:
        test = Division(data, used).shrunken_test()
        if test is None:
            break
        fits[used.tobytes()] = used, test
        used = test.strain <= PREDICTED_STRAIN
        if used.sum() < len(data) // 2:
            used = np.zeros(len(data), dtype=bool)
            used[np.argsort(test.strain, kind="stable")[:len(data) // 2]] = True
    return list(fits.values())


def _log_likelihood(test: Test, distances: FloatArray, weights: FloatArray) -> float:
    """Return the log-likelihood of all points, if each is right or wrong with equal probability.

    `distances` (n,) are how far the points are from one polynomial of all, `weights` (n, 2) belong
    to their coordinates.
    """
    # A right point is predicted by the others with the strain s and the variances u and v of both
    # coordinates: exp(-s^2) / (2 pi sqrt(u v)). The error of a wrong one is normal with the mean
    # square of the distances. The factor 2 pi that both have is left out.
    deviations = (test.noise * test.spread)[:, None] / weights
    mean_square = (distances**2).mean() / 2
    right = -np.log(deviations).sum(axis=1) - test.strain**2
    wrong = -np.log(mean_square) - distances**2 / (2 * mean_square)
    return float(np.logaddexp(right, wrong).sum())
