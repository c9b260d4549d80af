"""The right points among many, as one part of a mixture that all points are.

A right point is predicted by the other right ones, with a normal error. Of a wrong one nothing is
believed but that its error has any size from the noise to the largest of all, each equally likely
by its logarithm, and any direction. From a set of points on each point goes where it is
likelier, until none moves (classification EM; Celeux and Govaert 1992). How many are wrong is
believed place by place: where most of the neighbours are, a point that agrees does so by chance.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from termsel.auto.contradictions import Division, Test
from termsel.auto.majority import (
    LEAST_NOISE,
    MAX_SAMPLED_POINTS,
    MIN_AFFINE_POINTS,
    Halves,
    is_affine_error,
)
from termsel.data.features import BoolArray, FloatArray, IntArray
from termsel.data.fit_data import FitData
from termsel.data.record.chances import median_of

NEIGHBOURS = 8
"""Nearest points whose share of blunders is believed at a place."""

WEIGHT_OF_ALL = 4.0
"""Points that the share among all counts for beside them."""

MOSTLY_WRONG = 2 / 3
"""Share of blunders about a point from which on it may agree by chance."""

CLIMBED_STEPS = 15
"""Most steps of a climb; five are usual."""

STARTS = 2
"""Halves of each polynomial that are climbed from."""

MIN_RIGHT_SHARE = 1 / 3
"""Share of right points below which no mixture is looked at."""

LENIENT_ODDS = 4.0
"""Logarithm of the odds against a point up to which it may be right."""

HARD_ODDS = 1.5
"""The same up to which a point is in use all the same, where the others predict it well."""

SLACK = 6.0
"""What the log-likelihood may lose by each such point."""

FAR_FROM_GROUP = 3.0
"""Distance from the map of a group, by the median of the group, beyond which a point is not of it.
"""

LIKE_SIZE = 0.75
"""Share of the points in use that a second group must have to be as good a candidate."""

LEAST_GAIN = 0.1
"""Gain of the log-likelihood for each point from which on a mixture counts."""

MIN_SHARE = 0.1
"""Share of blunders below which the usual search finds them."""

CLEAR_STRAIN = 3.0
"""Standard deviations that blunders are off, in the median."""

UNLIKE_NEAREST = 0.3
"""Squared difference of the errors of blunders and the nearest points, by that of independent
errors, from which on they are no bend. Of bends it is up to 0.25."""

CLOSER_NOISE = 0.6
"""Noise of the half that agrees best, by that of the points in use, below which some of these may
be wrong."""

LEAST_MEDIAN = 0.8
"""Median of the squared errors of right points by that of normal ones with the same mean: below it
some errors may be of another kind."""


@dataclass(frozen=True, eq=False)
class Mixture:
    """What a test makes of all points if those in use, the mask `used` (n,), are right."""

    used: BoolArray
    test: Test
    neighbours: IntArray  # (n, NEIGHBOURS): the nearest other points of each
    log_sizes: float  # logarithm of the largest error by the noise

    @cached_property
    def wrong_share(self) -> FloatArray:
        """Share of blunders that is believed about each point, (n,)."""
        # One blunder in all more, and one right one: no share is 0 or 1.
        of_all = ((~self.used).sum() + 1) / (len(self.used) + 2)
        wrong_nearby = (~self.used)[self.neighbours].sum(axis=1)
        return np.asarray((wrong_nearby + WEIGHT_OF_ALL * of_all)
                          / (self.neighbours.shape[1] + WEIGHT_OF_ALL))

    @cached_property
    def _log_densities(self) -> tuple[FloatArray, FloatArray]:
        """Logarithms of the densities of each point as a right and a wrong one, (n,) both.

        With the strain t, the error of a right point has the density exp(-t^2) / v, but for a
        factor of all; v is the variance of its prediction. Errors r of blunders whose sizes are
        uniform in logarithms over a range L have 1 / (L r^2), and the prediction adds v to r^2.
        """
        squares = self.test.strain**2
        assert self.test.vectors is not None
        # The strain t is sqrt(e^2 / 2 v); an error of 0 has the variance that its place gives.
        lengths = (self.test.vectors**2).sum(axis=1)
        of_place = (self.test.noise * self.test.spread)**2
        variance = np.where(squares > 1e-4, lengths / 2 / np.maximum(squares, 1e-4), of_place)
        log_variance = np.log(np.maximum(variance, 1e-300))
        right = np.log1p(-self.wrong_share) - squares - log_variance
        wrong = (np.log(self.wrong_share) - np.log(self.log_sizes) - np.log1p(2.0 * squares)
                 - log_variance)
        return right, wrong

    @property
    def log_odds(self) -> FloatArray:
        """Logarithm of how much likelier each point is right than wrong, (n,)."""
        right, wrong = self._log_densities
        return np.asarray(right - wrong)

    @property
    def log_likelihood(self) -> float:
        """Logarithm of the density of all points, those in use as right and the others as wrong."""
        return float(np.where(self.used, *self._log_densities).sum())

    def is_hardly_wrong(self, log_odds: float) -> BoolArray:
        """Return which points, (n,), are wrong with few odds, these at most where others are near.

        To lose a right point costs more than to keep a wrong one that is hardly off, and the more
        so the less the others say of its place. Where most neighbours are wrong, it may be off all
        the same.
        """
        return np.asarray((self.log_odds > -log_odds * self.test.spread**2)
                          & (self.wrong_share < MOSTLY_WRONG))

    @property
    def is_suspicious(self) -> bool:
        """Whether some points are out of use, or errors of those in use are not all of one kind."""
        if (~self.used).mean() > MIN_SHARE:
            return True
        squares = self.test.strain[self.used]**2
        # Squared errors in the plane are exponential: their median is ln 2 of their mean.
        return bool(np.median(squares) < LEAST_MEDIAN * np.log(2) * squares.mean())

    def has_clear_blunders(self) -> bool:
        """Return whether the points out of use are many, stand out, and are no bend."""
        wrong = ~self.used
        assert self.test.vectors is not None
        if wrong.mean() < MIN_SHARE or np.median(self.test.strain[wrong]) < CLEAR_STRAIN:
            return False
        unlikeness = unlikeness_to_nearest(wrong, self.test.vectors, self.neighbours[:, 0])
        return unlikeness > UNLIKE_NEAREST


def mixtures_from(control: FitData, starts: Iterable[BoolArray], *,
                  by_field: bool = False) -> list[Mixture]:
    """Return the mixtures that climbs from some sets of points (n,) pass, the likeliest first.

    A step takes the points that are likelier right, or the half with the largest odds where these
    are fewer. Tests are by regularised polynomials, or with `by_field` by a random field where the
    points support one.
    """
    passed: dict[bytes, Mixture] = {}
    for start in starts:
        used = start
        for _ in range(CLIMBED_STEPS):
            if used.tobytes() in passed:
                break
            mixture = mixture_of(control, used, by_field=by_field)
            if mixture is None:
                break
            passed[used.tobytes()] = mixture
            odds = mixture.log_odds
            half = np.argsort(-odds, kind="stable")[:len(used) // 2]
            used = odds > 0.0
            used[half] = True
    return sorted(passed.values(), key=lambda mixture: -mixture.log_likelihood)


def _with_hardly_wrong(control: FitData, mixture: Mixture) -> Mixture:
    """Return a mixture with the points, too, that are hardly likelier wrong than right."""
    for _ in range(CLIMBED_STEPS):
        extended = mixture.used | mixture.is_hardly_wrong(HARD_ODDS)
        added = int((extended & ~mixture.used).sum())
        with_points = mixture_of(control, extended, by_field=True) if added else None
        if (with_points is None
                or with_points.log_likelihood < mixture.log_likelihood - SLACK * added):
            break
        mixture = with_points
    return mixture


def unlikeness_to_nearest(wrong: BoolArray, errors: FloatArray, nearest: IntArray) -> float:
    """Return how much errors of blunders differ from those of the nearest points of all.

    It is sum |e_i - e_j|^2 / sum (|e_i|^2 + |e_j|^2), j being the nearest point to the blunder
    i: 1 for independent errors, 0 for alike ones as of a bend. Errors (n, 2) of all points count by
    their direction and the root of their size; `wrong` (n,) is a mask, `nearest` (n,) are numbers.
    """
    sizes = np.maximum(np.linalg.norm(errors, axis=1), LEAST_NOISE)
    tempered = errors / np.sqrt(sizes)[:, None]
    of_nearest = tempered[nearest[wrong]]
    tempered = tempered[wrong]
    both = (tempered**2).sum() + (of_nearest**2).sum()
    return float(((tempered - of_nearest)**2).sum() / np.maximum(both, LEAST_NOISE))


def second_group(control: FitData, used: BoolArray) -> tuple[BoolArray, float] | None:
    """Return the points that agree on another map than those in use, and its median distance [px].

    `used` (n,) are the points in use, and the group is such a mask, too. Returns None where fewer
    agree on one, by LIKE_SIZE of those in use: then the majority decides.
    """
    test = Division(control, used).test()
    if test is None or test.vectors is None:
        return None
    ground = control.scaled.points.ground
    errors = test.vectors
    group = ~used
    # Points that fit neither map are left out, until all of the group agree.
    for _ in range(CLIMBED_STEPS):
        if group.sum() < max(MIN_AFFINE_POINTS, LIKE_SIZE * used.sum()):
            return None
        if is_affine_error(ground[group], errors[group]):
            break
        design = np.column_stack([np.ones(len(ground)), ground[:, :2]])
        residuals = errors - design @ np.linalg.lstsq(design[group], errors[group])[0]
        distances = np.linalg.norm(residuals, axis=1)
        closer = group & (distances <= FAR_FROM_GROUP * np.median(distances[group]))
        if (closer == group).all():
            return None
        group = closer
    return group, float(median_of(np.linalg.norm(errors[group], axis=1)))


def mixture_of(control: FitData, used: BoolArray, test: Test | None = None, *,
               by_field: bool = False) -> Mixture | None:
    """Return the mixture in which the points `used` (n,) are right; None if they are too few.

    `test` is the test by these points, if it is known.
    """
    if used.sum() < MIN_RIGHT_SHARE * len(used):
        return None
    if test is None:
        division = Division(control, used)
        test = division.test() if by_field else division.shrunken_test()
    if test is None:
        return None
    places = control.scaled.points.ground[:, :2]
    distances = np.linalg.norm(places[:, None] - places, axis=2)
    np.fill_diagonal(distances, np.inf)
    neighbours = np.argsort(distances, axis=1, kind="stable")[:, :NEIGHBOURS]
    assert test.vectors is not None
    largest = float(np.linalg.norm(test.vectors, axis=1).max())
    log_sizes = np.log(max(largest, LEAST_NOISE) / max(test.noise, LEAST_NOISE))
    return Mixture(used, test, neighbours, max(float(log_sizes), 1.0))


def likelier_mixture(control: FitData, halves: Halves | None, used: BoolArray, test: Test,
                     by_majority: bool) -> Mixture | None:
    """Return the mixture under which the points are clearly likelier than by a test of them.

    Parameters
    ----------
    control : FitData
        Points, without lines.
    halves : Halves or None
        The halves that agree best, from which on right points are sought.
    used : ndarray of bool, shape (n,)
        The points that are in use so far, and
    test : Test
        the test of all points by them.
    by_majority : bool
        Whether more than a third of the points are known to contradict the others, grossly.

    Returns
    -------
    Mixture or None
        None where none is clearly likelier, and where the points that it leaves out are few, hardly
        stand out, or may be a bend of the image.
    """
    n = len(control)
    if halves is None or n > MAX_SAMPLED_POINTS:
        return None
    present = mixture_of(control, used, test)
    if present is None:
        return None
    noise_of_half = halves.least_noise(control) * control.scaling.image_scale
    if not (by_majority or present.is_suspicious or noise_of_half < CLOSER_NOISE * test.noise):
        return None
    starts = [half for of_design in halves.of_designs for half in of_design[:STARTS]]
    likeliest = mixtures_from(control, [*starts, used, used & (present.wrong_share < MOSTLY_WRONG)])
    # Fields take long: only the likeliest set is worth one, and the likeliest with blunders.
    divided = [mixture for mixture in likeliest if (~mixture.used).mean() > MIN_SHARE]
    by_field = mixtures_from(control, [mixture.used for mixture in (*likeliest[:1], *divided[:1])],
                             by_field=True)
    # A step back from its edge shows whether the noise of a closer set was too small for right
    # points.
    best = mixtures_from(control, [by_field[0].used, by_field[0].log_odds > -LENIENT_ODDS],
                         by_field=True)[0]
    best = _with_hardly_wrong(control, best)
    gain = best.log_likelihood - present.log_likelihood
    # What would be lost for little odds may be a right point.
    doubtful = used & ~best.used & best.is_hardly_wrong(LENIENT_ODDS)
    if gain < LEAST_GAIN * n + SLACK * doubtful.sum():
        return None
    if not (by_majority or best.has_clear_blunders()):
        return None
    return best
