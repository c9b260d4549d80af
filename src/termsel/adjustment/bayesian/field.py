"""A polynomial with a random field: collocation, averaged over its scales.

Line and sample are each a shrunken cubic polynomial (see `termsel.adjustment.bayesian.posterior`),
a stationary Gaussian random field and noise. The field has the Matern covariance of smoothness 3/2,

    (ratio size)^2 (1 + r) exp(-r),   r^2 = 3 ((dl / length_l)^2 + (ds / length_s)^2),

with distances dl, ds between places in the image. The lengths may differ: strips and sheets of
maps stretch along one axis, and scanners shake along lines. Neither lengths nor ratio, size and
noise are known. All solutions on a grid are averaged with their posterior probabilities, those
without a field, which are believed as likely beforehand, among them. So where the points show no
local deformation the regularised polynomial remains.

In a plane, few points do not tell lengths from noise. There a thin-plate spline, a field without
lengths and next to affine functions alone, is a third course, and an affine image a fourth, all as
likely beforehand. From SURE to FEW points this fades: a fold of the points is then judged as they
are.

With many points the field is spanned by the covariances with KNOTS of them.

References
----------
Moritz 1980, Advanced Physical Geodesy, for collocation; Matheron 1969 for universal kriging;
Stein 1999, Interpolation of Spatial Data, for the Matern covariance; Wahba 1990 for splines as
fields; Hoeting et al. 1999 for averaging; Quinonero-Candela and Rasmussen 2005, JMLR 6, for few
knots. The prior is termsel's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from termsel.adjustment.bayesian.blunder_odds import blunder_odds
from termsel.adjustment.bayesian.foresight import foresee
from termsel.adjustment.bayesian.held_out import Prediction
from termsel.adjustment.bayesian.kernels import (
    kernel,
    left_by_affine,
    own_variance,
    spread_out,
    squared_distances,
)
from termsel.adjustment.bayesian.posterior import (
    NEVER,
    Posterior,
    polynomial_posterior,
    posterior,
    shares,
)
from termsel.adjustment.equations import weights_of
from termsel.data.features import FloatArray, IntArray, Points
from termsel.data.monomials import Exponents, graded_exponents, monomials

LENGTHS = ((0.15, 0.15), (0.3, 0.3), (0.6, 0.6), (1.2, 1.2), (0.15, 1.2), (1.2, 0.15))
"""Lengths of line and sample, by the half-range of the image: from about the distance of
neighbours among a hundred points to where a field cannot be told from a polynomial; and two that
differ."""

RATIOS = (0.02, 0.2, 2.0)
"""Standard deviations of the field by those of quadratic coefficients, which `posterior.SIZES`
takes from the noise to where they are as good as free."""

FALLS = (0.01, 0.1)
RELIEF = 0.1
"""Cubic coefficients by quadratic ones, and those of one power of Z more, next to a field. With one
fall alone a field must stand in for the cubic terms that it does not allow."""

DEGREE = 3

FIELD, ALIKE = 0.5, 0.9
"""Probability of a field before the points are looked at, and that its lengths are equal then."""

SPLINE = (np.inf, np.inf)
"""Lengths that stand for a spline."""

SURE, FEW = 12, 20
"""Number of points up to which a spline and an affine image are courses in their own right, and
from which on they are not needed."""

KNOTS = 100

NEGLIGIBLE = 1e-6
"""Probability of a part that is left out of a prediction."""

AT_ONCE = 2000
"""Places whose covariances are held in memory."""

JITTER = 1e-10
"""Part of the field's variance that is added, so that covariances of close points can be
decomposed."""


@dataclass(frozen=True, eq=False)
class FieldPart:
    """All solutions with one pair of lengths, or without a field."""

    posterior: Posterior
    log: float  # logarithm of the evidence, up to what all parts share
    lengths: tuple[float, float] | None  # None without a field
    # (c, k): what makes coefficients of the field uncorrelated; empty without one.
    inverse: FloatArray


@dataclass(frozen=True, eq=False)
class Collocation:
    """What control points predict, averaged over all parts."""

    points: Points  # scaled
    exponents: Exponents  # affine ones first
    turn: FloatArray  # (f, 2): affine coefficients that bring ground positions into the image
    knots: FloatArray  # (k, 2): places in the image
    parts: tuple[FieldPart, ...]  # those without a field first
    few: float  # how far a spline is a course: from 0, many points or heights, to 1

    @cached_property
    def shares(self) -> FloatArray:
        """Probability of each part."""
        return shares(np.array([part.log for part in self.parts]))[0]

    @property
    def probability(self) -> float:
        """Probability of a field."""
        return float(sum(share for share, part in zip(self.shares, self.parts, strict=True)
                         if part.lengths is not None))

    @property
    def effective(self) -> float:
        """Effective parameters of line and sample together."""
        return float(sum(share * part.posterior.mean(axis)[1]
                         for share, part in self._likely for axis in (0, 1)))

    @cached_property
    def errors(self) -> FloatArray:
        """Measured minus predicted of each point by the others, shape (n, 2).

        In closed form: without a point the solutions change, and so do their probabilities.
        """
        return self.left_out.errors / weights_of(self.points)

    @cached_property
    def _likely(self) -> list[tuple[float, FieldPart]]:
        """Parts that matter, with their probabilities."""
        highest = max(part.log for part in self.parts)
        return [(share, part) for share, part in zip(self.shares, self.parts, strict=True)
                if part.log > highest - NEVER]

    @cached_property
    def left_out(self) -> Prediction:
        """What all points but one predict for it, for each point, under all parts."""
        parts = [part for _, part in self._likely]
        each = [part.posterior.left_out for part in parts]
        # What is known of a part beforehand is its logarithm without that of its points.
        logs = np.array([part.log - part.posterior.cells.log + one.log
                         for part, one in zip(parts, each, strict=True)])
        likely = shares(logs)[0]                                                      # (p, n)

        def mean(name: str) -> FloatArray:
            values = np.array([getattr(one, name) for one in each])
            return np.asarray(np.einsum("pn,pn...->n...", likely, values))

        return Prediction(mean("errors"), mean("chance"), mean("statistic"), mean("spread"),
                          np.logaddexp.reduce(logs))

    def blunder_odds(self, points: IntArray) -> FloatArray:
        """Return how much likelier points are as blunders (see `blunder_odds`)."""
        return blunder_odds([(share, part.posterior, part.lengths is not None)
                             for share, part in self._likely], points)

    def predict(self, ground: FloatArray) -> FloatArray:
        """Return line and sample of places, shape (m, 2)."""
        polynomial, fields = self._coefficients
        columns = monomials(ground, self.exponents)
        image = columns @ polynomial
        places = columns[:, :len(self.turn)] @ self.turn
        for start in range(0, len(ground), AT_ONCE):
            some = slice(start, start + AT_ONCE)
            for lengths, weights in fields:
                image[some] += _covariances(places[some], self.knots, lengths)[0] @ weights
        return np.asarray(image)

    def spread(self, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the variance of the prediction, shape (m, 2), and that of the noise, (2,)."""
        lead = len(self.turn)
        columns = monomials(ground, self.exponents)
        places = columns[:, :lead] @ self.turn
        likely = [(share, part) for share, part in zip(self.shares, self.parts, strict=True)
                  if share > NEGLIGIBLE]
        each = []
        for _, part in likely:
            spanned = _with_field(columns, places, self.knots, part.lengths, part.inverse)
            field = spanned[:, columns.shape[1]:]
            # Away from the knots the field has a variance that their covariances do not span.
            missing = None if part.lengths is None else np.square(part.posterior.scales[:, -1:]) \
                * np.maximum(_covariances(places, self.knots, part.lengths)[1]
                             - (field**2).sum(axis=1), 0.0)
            each.append(foresee(part.posterior, columns[:, :lead], spanned[:, lead:], missing))
        some = [share for share, _ in likely]
        mean = sum(share * one.image for share, one in zip(some, each, strict=True))
        variance = sum((share * (one.variance + (one.image - mean) ** 2)
                        for share, one in zip(some, each, strict=True)),
                       np.zeros((len(ground), 2)))
        return variance, np.full(2, float(np.dot(some, [one.noise for one in each])))

    @cached_property
    def _coefficients(self) -> tuple[FloatArray, list[tuple[tuple[float, float], FloatArray]]]:
        """Averaged coefficients of the monomials, and those of the knots of each field by lengths.
        """
        lead = len(self.turn)
        terms = len(self.exponents)
        weights = weights_of(self.points)
        total = np.zeros((terms, 2))
        rest = np.zeros_like(self.points.image)
        fields = []
        columns = monomials(self.points.ground, self.exponents)
        places = columns[:, :lead] @ self.turn
        for share, part in self._likely:
            shrunk = np.stack([part.posterior.mean(axis)[0] for axis in (0, 1)], axis=1)
            spanned = _with_field(columns, places, self.knots, part.lengths, part.inverse)
            rest += share * (self.points.image - spanned[:, lead:] @ shrunk)
            total[lead:] += share * shrunk[:terms - lead]
            if part.lengths and share > NEGLIGIBLE:
                fields.append((part.lengths, share * part.inverse.T @ shrunk[terms - lead:]))
        # Those of each part fit what its other terms leave: their mean fits the mean of that.
        affine = columns[:, :lead]
        for axis, w in enumerate(weights.T):
            total[:lead, axis] = np.linalg.lstsq(affine * w[:, None], rest[:, axis] * w)[0]
        return total, fields


def collocate(points: Points, variables: int) -> Collocation | None:
    """Return what control points, scaled, predict by a polynomial with a random field.

    The polynomial is in 2 variables, X and Y, or 3, with Z. None if all points but any one do not
    determine an affine model with redundancy.
    """
    if len(points) < variables + 3:
        return None
    image, ground, sigma = (None if one is None else np.ascontiguousarray(one).tobytes()
                            for one in (points.image, points.ground, points.sigma))
    return _collocated(image, ground, sigma, variables)


@lru_cache(maxsize=1)  # of many points one takes a great part of the memory
def _collocated(image: bytes, ground: bytes, sigma: bytes | None,
                variables: int) -> Collocation | None:
    """Return the collocation of points; a fit asks for the same one many times."""
    places = np.frombuffer(image).reshape(-1, 2)
    points = Points(tuple(map(str, range(len(places)))), places,
                    np.frombuffer(ground).reshape(-1, 3),
                    None if sigma is None else np.frombuffer(sigma).reshape(-1, 2))
    exponents = graded_exponents(DEGREE, variables)
    order = np.array(exponents).sum(axis=1)
    shrunk = np.array(exponents)[order > 1]
    columns = monomials(points.ground, exponents)
    turn = _turn(points, exponents[:variables + 1])
    there = columns[:, :variables + 1] @ turn
    knots = spread_out(there, KNOTS)
    rules = [fall ** (order[order > 1] - 2.0) * RELIEF ** shrunk[:, 2] for fall in FALLS]
    # Every fall with every ratio; the columns of the field share one scale.
    mixed = np.array([[*rule, *np.full(len(knots), ratio)] for rule in rules for ratio in RATIOS])
    parts = []
    weights = None if sigma is None else weights_of(points)
    few = float(np.clip((FEW - len(points)) / (FEW - SURE), 0.0, 1.0)) if variables == 2 else 0.0
    for lengths in (None, *LENGTHS, *[SPLINE] * (few > 0.0)):
        inverse = _inverse(knots, lengths)
        bare = _with_field(columns, there, knots, lengths, inverse)
        orders = np.concatenate([order, np.full(len(inverse), DEGREE)])
        scales = mixed if lengths in LENGTHS else np.repeat(
            [[0.0, 1.0]], [len(shrunk), len(inverse)], axis=1)
        solutions = polynomial_posterior(points.ground, points.image, exponents, weights) \
            if lengths is None else posterior(bare, points.image, orders, weights, scales,
                                              len(points), len(shrunk))
        if solutions is None:
            return None
        parts.append(FieldPart(
            solutions, solutions.cells.log + np.log(
                _belief(lengths) * (few if lengths == SPLINE else 1.0) / len(solutions.scales)),
            lengths, inverse))
    if few > 0.0:
        plain = posterior(columns, points.image, order, weights, np.zeros((1, len(shrunk))),
                          len(points))
        assert plain is not None
        parts.insert(1, FieldPart(plain, plain.cells.log + np.log(_belief(None) * few), None,
                                  parts[0].inverse))
    return Collocation(points, exponents, turn, knots, tuple(parts), few)


def _turn(points: Points, linear: Exponents) -> FloatArray:
    """Return the affine transformation that brings places into the image, shape (f, 2).

    Distances between places are taken in the image: there sheets shrink and scanners shake, and
    line and sample have one unit. The exponents (f) are those of an affine function.
    """
    return np.asarray(np.linalg.lstsq(monomials(points.ground, linear), points.image)[0])


def _belief(lengths: tuple[float, float] | None) -> float:
    """Return the probability of a part before the points are looked at, up to a factor."""
    if lengths in (None, SPLINE):
        return 1.0 - FIELD
    alike = sum(line == sample for line, sample in LENGTHS)
    return FIELD * (ALIKE / alike if lengths[0] == lengths[1]
                    else (1.0 - ALIKE) / (len(LENGTHS) - alike))


def _with_field(columns: FloatArray, places: FloatArray, knots: FloatArray,
                lengths: tuple[float, float] | None, inverse: FloatArray) -> FloatArray:
    """Return the monomials, and the columns that span the field of a part."""
    if lengths is None:
        return columns
    return np.concatenate([columns, _covariances(places, knots, lengths)[0] @ inverse.T], axis=1)


def _inverse(knots: FloatArray, lengths: tuple[float, float] | None) -> FloatArray:
    """Return what makes coefficients of a field uncorrelated, of one variance, shape (c, k)."""
    if lengths is None:
        return np.empty((0, 0))
    among = _covariances(knots, knots, lengths)[0]
    if lengths != SPLINE:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(
            among + JITTER * np.eye(len(knots))).T).T)
    values, vectors = np.linalg.eigh(among)  # what affine functions fit has no variance
    some = values > JITTER * values.max()
    return np.asarray((vectors[:, some] / np.sqrt(values[some])).T)


def _covariances(places: FloatArray, knots: FloatArray,
                 lengths: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Return covariances of places with knots, shape (m, k), and variances of places, (m,).

    Those of a spline are of what the affine function that fits the knots leaves; their mean is 1.
    """
    if lengths != SPLINE:
        return _matern(places, knots, lengths), np.ones(len(places))
    here = np.column_stack([np.ones(len(knots)), knots])
    rest = np.eye(len(knots)) - here @ np.linalg.pinv(here)
    unit = np.trace(rest @ kernel(knots, knots)) / len(knots)
    return left_by_affine(places, knots) @ rest / unit, own_variance(places, knots) / unit


def _matern(a: FloatArray, b: FloatArray, lengths: tuple[float, float]) -> FloatArray:
    """Return the correlations between places, shape (len(a), len(b))."""
    r = squared_distances(a * np.sqrt(3.0) / lengths, b * np.sqrt(3.0) / lengths)
    np.sqrt(r, out=r)
    correlation: FloatArray = np.exp(-r)
    r += 1.0  # in place, as these are the largest arrays
    correlation *= r
    return correlation
