"""The posterior of a shrunken polynomial: all solutions on a grid of scales, and their weights.

`termsel.candidates.shrunken` says what the prior is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from termsel.adjustment.left_out import Prediction, chance_of, leave_each_out
from termsel.adjustment.monomials import Exponents, monomials
from termsel.adjustment.solve import TOLERANCE
from termsel.measurements.features import BoolArray, FloatArray, IntArray

SIZES = 10.0 ** np.arange(-0.5, 5.5, 0.5)
"""Standard deviations of quadratic coefficients by that of the noise. From where they cannot be
told from 0 to where they are as good as free."""

TYPICAL = 10.0
"""Size beyond which larger ones are ever less likely, in proportion: the tail of a half-Cauchy
prior. Where few points leave hardly any redundancy, the data do not exclude that there is no noise
and all sizes are huge; this does."""

FALLS = (0.01, 0.03, 0.1, 0.3)
"""Cubic coefficients by quadratic ones."""

RELIEFS = (0.03, 0.1, 0.3, 1.0)
"""Coefficients of one power of Z more, by those without."""

DRAWS, SPREAD = 64, 1.0
"""How often factors of single terms are drawn, apart from 1 for all, divided among all pairs of a
fall and a relief; and their standard deviation in natural logarithms."""

NO_NOISE = 1e-11
"""Noise that counts as none, as a part of the image's half-range."""

NEVER = 30.0
"""Solutions less likely than the likeliest by this, in natural logarithms, are left out."""

TINY = 1e-14
"""What is left of 1 by rounding error."""


@dataclass(frozen=True, eq=False)
class Odds:
    """How likely all solutions of one axis are, groups of scales by sizes, shape (g s,).

    Both make up prior and marginal likelihood, square^-nu/2 exp(evidence). `along`, shape (g, m),
    is the target along the singular vectors of each group.
    """

    evidence: FloatArray
    square: FloatArray
    along: FloatArray


@dataclass(frozen=True, eq=False)
class Side:
    """The solutions of one axis that matter.

    `which`, shape (u,), are their places on the grid, and `cell`, shape (c,), is that of each cell
    among them. `left` is 1 minus the leverage of each point, `errors` are what the fit leaves,
    shape (n, u); `coefficients` are the shrunken ones, shape (u, k).
    """

    which: IntArray
    cell: IntArray
    left: FloatArray
    errors: FloatArray
    coefficients: FloatArray
    free: FloatArray


def scales_of(exponents: FloatArray, draws: int | None = None) -> FloatArray:
    """Return standard deviations of the shrunken coefficients for size 1, shape (g, k)."""
    draws = DRAWS if draws is None else draws
    order, height = exponents.sum(axis=1), exponents[:, 2]
    reliefs, falls = RELIEFS if height.any() else (1.0,), FALLS if order.max() > 2 else (1.0,)
    rule = np.array([fall ** (order - 2.0) * relief ** height
                     for fall in falls for relief in reliefs])
    rng = np.random.default_rng(0)
    own = np.exp(SPREAD * rng.standard_normal((draws // len(rule), *rule.shape)))
    return np.concatenate([rule, (rule * own).reshape(-1, rule.shape[1])])


@dataclass(frozen=True, eq=False)
class Design:
    """Decompositions of the shrunken columns without the free ones, one for each group.

    Parameters
    ----------
    basis : ndarray, shape (n, m)
        What some column, and no affine function, explains.
    explained : ndarray, shape (n, l)
        What the columns explain, affine ones with them; the rest is left by every solution.
    u : ndarray, shape (g, m, m)
    values : ndarray, shape (g, m)
    vt : ndarray, shape (g, m, k)
    lead : ndarray, shape (f, f)
        Triangle of the free columns.
    cross : ndarray, shape (f, k)
        What the shrunken columns have in common with them.
    """

    basis: FloatArray
    explained: FloatArray
    u: FloatArray
    values: FloatArray
    vt: FloatArray
    lead: FloatArray
    cross: FloatArray


def _design(columns: FloatArray, free: BoolArray, scales: FloatArray) -> Design | None:
    """Return the decompositions; None if the free columns lack a point's redundancy."""
    return _decomposed(columns.tobytes(), free.tobytes(), scales.tobytes(), *columns.shape)


@lru_cache(maxsize=4)
def _decomposed(columns_of: bytes, free_of: bytes, scales_of_free: bytes, n: int,
                k: int) -> Design | None:
    """Return the decompositions; line and sample, and a field of no size, ask for the same ones."""
    columns = np.frombuffer(columns_of).reshape(n, k)
    free = np.frombuffer(free_of, dtype=bool)
    scales = np.frombuffer(scales_of_free).reshape(-1, int((~free).sum()))
    lead = columns[:, free]
    count = lead.shape[1]
    if len(lead) <= count:
        return None
    q, r = np.linalg.qr(np.concatenate([lead, columns[:, ~free]], axis=1))
    if (np.abs(np.diag(r))[:count] <= TOLERANCE * np.linalg.norm(lead, axis=0)).any() \
            or (1.0 - (q[:, :count]**2).sum(axis=1)).min() < TOLERANCE:
        return None
    rest = r[count:, count:]
    return Design(q[:, count:], q, *np.linalg.svd(rest * scales[:, None, :], full_matrices=False),
                  r[:count, :count], r[:count, count:])


def _odds(design: Design, target: FloatArray) -> Odds:
    """Return how likely the solutions of one axis are, for all scales and sizes."""
    along = (design.basis.T @ target) @ design.u
    beyond = _beyond(design, target)
    keep = 1.0 / (1.0 + (SIZES[:, None] * design.values[:, None, :]) ** 2)    # (g, s, m)
    return Odds(
        (0.5 * np.log(keep).sum(axis=2) - 0.5 * np.log1p((SIZES / TYPICAL) ** 2)).ravel(),
        (beyond @ beyond + (keep * along[:, None, :] ** 2).sum(axis=2)).ravel(), along)


def _beyond(design: Design, target: FloatArray) -> FloatArray:
    """Return what no column explains, apart: nothing cancels where noise tends to 0."""
    if design.explained.shape[1] == len(target):
        return np.zeros(len(target))
    return np.asarray(target - design.explained @ (design.explained.T @ target))


def _solutions(design: Design, target: FloatArray, scales: FloatArray, odds: Odds,
               cells: IntArray) -> Side:
    """Return the solutions of one axis that some cell is of."""
    which, cell = np.unique(cells, return_inverse=True)
    group, size = np.divmod(which, len(SIZES))
    n = len(target)
    room = np.zeros(n)
    if design.explained.shape[1] < n:
        room = np.maximum(1.0 - (design.explained**2).sum(axis=1), 0.0)
    ratio = SIZES[size, None] * design.values[group]                              # (u, m)
    keep = 1.0 / (1.0 + ratio**2)
    part = keep * odds.along[group]
    grown = SIZES[size, None] * ratio * part
    left, turned = np.empty((len(which), n)), np.empty_like(part)
    coefficients = np.empty((len(which), scales.shape[1]))
    places = np.ascontiguousarray(design.basis.T)
    starts = np.flatnonzero(np.diff(group, prepend=-1))
    for start, end in zip(starts, [*starts[1:], len(which)], strict=True):
        g, some = group[start], slice(start, end)
        along = design.u[g].T @ places
        along *= along
        np.matmul(keep[some], along, out=left[some])
        np.matmul(part[some], design.u[g].T, out=turned[some])
        coefficients[some] = grown[some] @ design.vt[g] * scales[g]
    left += room
    errors = design.basis @ turned.T
    errors += _beyond(design, target)[:, None]
    return Side(which, cell, np.maximum(left.T, TINY, order="C"), errors, coefficients,
                design.explained[:, :len(design.lead)].T @ target)


@dataclass(frozen=True, eq=False)
class Cells:
    """The points of the grid that matter: which solutions of line and of sample, and how likely.

    `log` is the logarithm of the evidence of all together, up to what the measurements alone say.
    """

    which: tuple[IntArray, IntArray]
    share: FloatArray
    log: float


def _cells(odds: Sequence[Odds], freedom: int, noise: float) -> Cells:
    """Return what is on the grid of group, size of line and size of sample, and not NEVER."""
    line, sample = (np.arange(len(one.square)).reshape(-1, len(SIZES)) for one in odds)
    shape = (*line.shape, len(SIZES))
    first = np.broadcast_to(line[:, :, None], shape).ravel()
    second = np.broadcast_to(sample[:, None, :], shape).ravel()
    logarithm = (odds[0].evidence[first] + odds[1].evidence[second] - freedom / 2 * np.log(
        odds[0].square[first] + odds[1].square[second] + noise))
    kept = logarithm > logarithm.max() - NEVER
    share, log = shares(logarithm[kept])
    return Cells((first[kept], second[kept]), share, float(log))


def shares(logarithm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return probabilities, which add up to 1 along the first axis, and the logarithm of what they
    had added up to."""
    highest = logarithm.max(axis=0)
    share = np.exp(logarithm - highest)
    total = share.sum(axis=0)
    share /= total
    return share, highest + np.log(total)


@dataclass(frozen=True, eq=False)
class Posterior:
    """All solutions for both axes.

    Parameters
    ----------
    odds : tuple of Odds
        Of line and of sample.
    cells : Cells
        Which solutions matter, and their probabilities.
    freedom : int
        Equations in use less the terms that are not shrunk.
    noise : float
        Sum of squares that counts as none.
    designs : tuple of Design
        Of line and of sample.
    scales : ndarray, shape (g, k)
        Of the shrunken coefficients for size 1.
    targets : ndarray, shape (n, 2)
        Weighted measurements.
    """

    odds: tuple[Odds, Odds]
    cells: Cells
    freedom: int
    noise: float
    designs: tuple[Design, Design]
    scales: FloatArray
    targets: FloatArray

    @cached_property
    def sides(self) -> tuple[Side, Side]:
        """Solutions of line and of sample: of many points few matter, and of a model that is not
        chosen none is asked for."""
        line, sample = (_solutions(design, target, self.scales, odds, which)
                        for design, target, odds, which in zip(
                            self.designs, self.targets.T, self.odds, self.cells.which, strict=True))
        return line, sample

    @property
    def square(self) -> FloatArray:
        """Sum of squares of each cell, shape (c,)."""
        line, sample = (odds.square[which]
                        for odds, which in zip(self.odds, self.cells.which, strict=True))
        return np.asarray(line + sample + self.noise)

    def mean(self, axis: int) -> tuple[FloatArray, float]:
        """Return the shrunken coefficients of an axis, averaged, and its effective parameters."""
        side = self.sides[axis]
        share = np.bincount(side.cell, self.cells.share)
        return share @ side.coefficients, float((1.0 - side.left).sum(axis=0) @ share)

    @cached_property
    def left_out(self) -> Prediction:
        """What all points but one predict for it, for each point."""
        line, sample = self.sides
        square = self.square
        return leave_each_out((line.left, sample.left), (line.errors, sample.errors),
                              (line.cell, sample.cell), square, self.noise + TINY * square,
                              self.cells.share, self.cells.log, self.freedom // 2 - 1)

    def beyond(self, points: IntArray, weight: float) -> Prediction:
        """Return what the points in use predict for others.

        Parameters
        ----------
        points : ndarray of int, shape (m,)
            Points that stand in the equations with a weight too small to matter.
        weight : float
            That weight.
        """
        errors, spread = [], []
        for side in self.sides:
            one = side.left[points].take(side.cell, axis=1)                           # (m, c)
            errors.append(side.errors[points].take(side.cell, axis=1) / one / weight)
            spread.append(1.0 + (1.0 - one) / weight**2)
        share, variance = self.cells.share, self.square / self.freedom
        statistic = sum(e**2 / s for e, s in zip(errors, spread, strict=True)) / 2 / variance
        return Prediction(np.stack([e @ share for e in errors], axis=1),
                          chance_of(statistic, self.freedom) @ share, statistic @ share,
                          np.stack([s @ share for s in spread], axis=1),
                          np.full(len(points), self.cells.log))


def posterior(columns: FloatArray, image: FloatArray, order: IntArray, weights: FloatArray | None,
              scales: FloatArray, in_use: int) -> Posterior | None:
    """Return all solutions for points.

    Parameters
    ----------
    columns : ndarray, shape (n, k)
        Monomials of the scaled ground positions.
    image : ndarray, shape (n, 2)
    order : ndarray of int, shape (k,)
        Orders of the monomials; affine ones first.
    weights : ndarray, shape (n, 2) or None
        By which equations are multiplied.
    scales : ndarray, shape (g, j)
        As `scales_of` gives them.
    in_use : int
        Number of points whose weight matters.

    Returns
    -------
    Posterior or None
        None if all points but any one do not determine the affine terms.
    """
    freedom = 2 * (in_use - int((order < 2).sum()))
    noise = 2 * in_use * (NO_NOISE * float(np.ptp(image, axis=0).max()) / 2) ** 2
    weights = np.ones_like(image) if weights is None else weights
    of_line, of_sample = (_design(columns * w[:, None], order < 2, scales) for w in weights.T)
    if of_line is None or of_sample is None or freedom < 4:
        return None
    targets = image * weights
    line, sample = (_odds(design, target)
                    for design, target in zip((of_line, of_sample), targets.T, strict=True))
    return Posterior((line, sample), _cells([line, sample], freedom, noise), freedom, noise,
                     (of_line, of_sample), scales, targets)


def polynomial_posterior(ground: FloatArray, image: FloatArray, exponents: Exponents,
                         weights: FloatArray | None) -> Posterior | None:
    """Return all solutions of a polynomial for points that are all in use.

    Parameters
    ----------
    ground : ndarray, shape (n, 3)
        Scaled to [-1, 1].
    image : ndarray, shape (n, 2)
    exponents : k exponents of X, Y, Z
        Affine ones first.
    weights : ndarray, shape (n, 2) or None
        By which equations are multiplied.

    Returns
    -------
    Posterior or None
        As `posterior`.
    """
    return _of_polynomial(ground.tobytes(), image.tobytes(), exponents,
                          None if weights is None else weights.tobytes())


@lru_cache(maxsize=2)
def _of_polynomial(ground: bytes, image: bytes, exponents: Exponents,
                   weights: bytes | None) -> Posterior | None:
    """Return the same; a shrunken polynomial, and a field that may be none, ask for one."""
    powers = np.array(exponents)
    order = powers.sum(axis=1)
    places = np.frombuffer(image).reshape(-1, 2)
    return posterior(monomials(np.frombuffer(ground).reshape(-1, 3), exponents), places, order,
                     None if weights is None else np.frombuffer(weights).reshape(-1, 2),
                     scales_of(powers[order > 1]), len(places))
