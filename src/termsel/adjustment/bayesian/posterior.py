"""The posterior of a regularised polynomial: all solutions on a grid of scales, and their weights.

`termsel.auto.shrunken` says what the prior is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from termsel.adjustment.bayesian.held_out import (
    OfAxis,
    Prediction,
    leave_each_out,
    mean_chance,
    together,
)
from termsel.adjustment.bayesian.shrinkage import (
    CANCELLED,
    TINY,
    Design,
    Side,
    Some,
    design_of,
    shrinkage_of,
)
from termsel.data.features import FloatArray, IntArray
from termsel.data.monomials import Exponents, monomials

SIZES = np.append(0.0, 10.0 ** np.arange(-0.5, 5.5, 0.5))
"""Standard deviations of quadratic coefficients by that of the noise: 0, which is the affine model,
and from where they cannot be told from 0 to where they are as good as free."""

AFFINE = 0.25
"""Probability of an affine image before the points are looked at."""

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

AT_ONCE = 1 << 13
"""Points that are left out in one go."""

NEVER = 30.0
"""Solutions less likely than the likeliest by this, in natural logarithms, are left out."""


@dataclass(frozen=True, eq=False)
class Odds:
    """How likely all solutions of one axis are, groups of scales by sizes.

    Both make up prior and marginal likelihood, square^-nu/2 exp(evidence).
    """

    evidence: FloatArray  # (g s,)
    square: FloatArray  # (g s,)


def scales_of(exponents: FloatArray, draws: int | None = None) -> FloatArray:
    """Return standard deviations of the shrunken coefficients for size 1, shape (g, k)."""
    draws = DRAWS if draws is None else draws
    order = exponents.sum(axis=1)
    height = exponents[:, 2]
    reliefs = RELIEFS if height.any() else (1.0,)
    falls = FALLS if order.max() > 2 else (1.0,)
    rule = np.array([fall ** (order - 2.0) * relief ** height
                     for fall in falls for relief in reliefs])
    rng = np.random.default_rng(0)  # a prior is the same for all data
    own = np.exp(SPREAD * rng.standard_normal((draws // len(rule), *rule.shape)))
    return np.concatenate([rule, (rule * own).reshape(-1, rule.shape[1])])


def believed_sizes() -> FloatArray:
    """Return the logarithm of how likely each size is before the points are looked at.

    That of 0 is half of that of an affine image, as line and sample are affine together.
    """
    logs = -0.5 * np.log1p((SIZES / TYPICAL) ** 2)
    some = SIZES > 0.0
    logs[~some] = np.log(np.exp(logs[some]).sum()) + 0.5 * np.log(AFFINE / (1.0 - AFFINE))
    return np.asarray(logs)


def _odds(design: Design, targets: FloatArray) -> list[Odds]:
    """Return how likely the solutions of each axis are, for all scales and sizes."""
    along = design.basis.T @ targets
    evidence, squares = _mixed(design, along) or _decomposed(design, along)
    evidence = (evidence + believed_sizes()).ravel()
    beyond = (design.beyond(targets) ** 2).sum(axis=0)
    return [Odds(evidence, rest + square.ravel())
            for rest, square in zip(beyond, squares, strict=True)]


def _decomposed(design: Design, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return evidence, shape (g, s), and sums of squares, shape (a, g, s), in the basis."""
    u, values, _ = design.decomposed(np.arange(len(design.scales)))
    keep = 1.0 / (1.0 + (SIZES[:, None] * values[:, None, :]) ** 2)           # (g, s, m)
    squares = keep @ (u.swapaxes(1, 2) @ along) ** 2
    return 0.5 * np.log(keep).sum(axis=2), np.moveaxis(squares, 2, 0)


def _mixed(design: Design, along: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return the same by one decomposition for all groups, that of the columns of one scale.

    With W what a size leaves along it, and the few other columns C by their scales, a sum of
    squares is y'W y - y'W C (I + C'W C)^-1 C'W y. None without such columns, and where rounding
    errors matter: where hardly anything remains of a difference.
    """
    few = design.few
    if few == design.rest.shape[1]:
        return None
    ratios, group = np.unique(design.scales[:, few], return_inverse=True)
    u, values, _ = design.many
    turned = u.T @ np.concatenate([design.rest[:, :few], along], axis=1)
    keep = 1.0 / (1.0 + ((SIZES * ratios[:, None])[:, :, None] * values) ** 2)    # (r, s, m)
    gram = (turned.T @ (keep[..., None] * turned))[group]
    scale = np.ones((len(group), len(SIZES), turned.shape[1]))
    scale[..., :few] = SIZES[:, None] * design.scales[:, None, :few]
    # The last rows are L^-1 C'W y; of the ones that are added, those of the targets are not used.
    root = np.linalg.cholesky(np.eye(turned.shape[1]) + gram * scale[..., None]
                              * scale[..., None, :])
    whole = np.diagonal(gram, axis1=2, axis2=3)[..., few:]
    squares = whole - (root[..., few:, :few] ** 2).sum(axis=3)
    if (squares <= CANCELLED * whole).any():
        return None
    logs = np.log(np.diagonal(root, axis1=2, axis2=3)[..., :few]).sum(axis=2)
    return 0.5 * np.log(keep).sum(axis=2)[group] - logs, np.moveaxis(squares, 2, 0)


@dataclass(frozen=True, eq=False)
class GridCells:
    """The points of the grid that matter."""

    which: tuple[IntArray, IntArray]  # (c,) each: which solution of line and which of sample
    share: FloatArray  # (c,): how likely
    log: float  # evidence of all, as a logarithm, up to what the measurements alone say


def _cells(odds: Sequence[Odds], freedom: int, noise: float, *, affine: bool) -> GridCells:
    """Return what is on the grid of group, size of line and size of sample, and not NEVER.

    An image is affine in line and sample, or in none; `affine` is whether it may be.
    """
    # Scales are those of both axes; sizes are each axis' own.
    count = len(SIZES)
    evidence, square = (
        getattr(odds[0], name).reshape(-1, count, 1) + getattr(odds[1], name).reshape(-1, 1, count)
        for name in ("evidence", "square"))
    logarithm = evidence - freedom / 2 * np.log(square + noise)                # (g, s, s)
    # Without quadratic terms all groups are one.
    plain = logarithm[0, 0, 0] + np.log(len(logarithm)) if affine and SIZES[0] == 0.0 else -np.inf
    logarithm[:, SIZES == 0.0] = logarithm[:, :, SIZES == 0.0] = -np.inf
    logarithm[0, 0, 0] = max(logarithm[0, 0, 0], plain)
    group, line, sample = np.nonzero(logarithm > logarithm.max() - NEVER)
    share, log = shares(logarithm[group, line, sample])
    return GridCells((group * count + line, group * count + sample), share, float(log))


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
    """All solutions for both axes."""

    odds: tuple[Odds, Odds]  # of line and of sample
    cells: GridCells  # which solutions matter, and their probabilities
    freedom: int  # equations in use less the terms that are not shrunk
    noise: float  # sum of squares that counts as none
    designs: tuple[Design, Design]  # of line and of sample
    scales: FloatArray  # (g, k): of the shrunken coefficients for size 1
    targets: FloatArray  # (n, 2): weighted measurements
    in_use: int  # points whose weight matters; they come first

    @cached_property
    def sides(self) -> tuple[Side, Side]:
        """Solutions of line and of sample: of many points few matter, and of a model that is not
        chosen none is asked for."""
        cells = np.stack(self.cells.which)
        seen = np.bincount(cells.ravel()) > 0  # as np.unique, without sorting
        cell = (np.cumsum(seen) - 1)[cells]
        group, size = np.divmod(np.flatnonzero(seen), len(SIZES))
        line, sample = self.designs
        of_line = shrinkage_of(line, group, size, SIZES)
        of_sample = of_line if sample is line else shrinkage_of(sample, group, size, SIZES)
        return (of_line.side(self.targets[:, 0], cell[0]),
                of_sample.side(self.targets[:, 1], cell[1]))

    @property
    def square(self) -> FloatArray:
        """Sum of squares of each cell, shape (c,)."""
        line, sample = (odds.square[which]
                        for odds, which in zip(self.odds, self.cells.which, strict=True))
        return np.asarray(line + sample + self.noise)

    def mean(self, axis: int) -> tuple[FloatArray, float]:
        """Return the shrunken coefficients of an axis, averaged, and its effective parameters."""
        side = self.sides[axis]
        share = np.bincount(side.cell, self.cells.share, len(side.effective))
        return share @ side.coefficients, float(side.effective @ share)

    def at(self, points: Some) -> tuple[OfAxis, OfAxis]:
        """Return what the solutions of line and of sample leave of some points."""
        line, sample = self.sides
        left = line.left(points)
        return (OfAxis(left, line.errors(points), line.cell),
                OfAxis(left if self.designs[0] is self.designs[1] else sample.left(points),
                       sample.errors(points), sample.cell))

    @property
    def pieces(self) -> list[slice]:
        """The points in use, so many at once that the memory holds all solutions of them."""
        return [slice(start, min(start + AT_ONCE, self.in_use))
                for start in range(0, self.in_use, AT_ONCE)]

    @cached_property
    def left_out(self) -> Prediction:
        """What all points but one predict for it, for each point in use."""
        return together([self.without(some) for some in self.pieces])

    def without(self, some: slice) -> Prediction:
        """Return what all points but one predict for it, for some of the points in use."""
        square = self.square
        half = self.freedom // 2 - 1
        return leave_each_out(*self.at(some), square, self.noise + TINY * square,
                              self.cells.share, self.cells.log, half)

    def beyond(self, weight: float) -> Prediction:
        """Return what the points in use predict for the others, which weigh too little to matter.
        """
        share = self.cells.share
        strains = []
        errors, spread, mean = (np.zeros((len(self.targets) - self.in_use, 2)) for _ in range(3))
        at = self.at(slice(self.in_use, None))
        for axis, side in enumerate(at):
            left = side.left                                                          # (u, m)
            error = side.errors / left / weight
            own = 1.0 + (1.0 - left) / weight**2
            strains.append(error**2 / own / 2)
            each, sure = (np.bincount(side.cell, one, len(left))
                          for one in (share, share * self.freedom / self.square))
            errors[:, axis] = each @ error
            spread[:, axis] = each @ own
            mean[:, axis] = sure @ strains[axis]
        return Prediction(errors, mean_chance((strains[0], strains[1]), (at[0].cell, at[1].cell),
                                              2.0 / self.square, share, self.freedom // 2),
                          mean.sum(axis=1), spread, np.full(len(errors), self.cells.log))


def posterior(columns: FloatArray, image: FloatArray, order: IntArray, weights: FloatArray | None,
              scales: FloatArray, in_use: int, few: int | None = None, *,
              affine: bool = False) -> Posterior | None:
    """Return all solutions for points; None if all but any one do not determine the affine terms.

    The columns (n, k) are monomials of the scaled ground positions, affine ones first, of some
    order (k,). The image is (n, 2); the equations are multiplied by the weights (n, 2), if any. The
    scales (g, j) are as `scales_of` gives them. The first `in_use` points are those whose weight
    matters. After the first few shrunken columns all have one scale in each group; by default none
    have. `affine` is whether the image may be affine, which a test for blunders must not rely on.
    """
    freedom = 2 * (in_use - int((order < 2).sum()))
    noise = 2 * in_use * (NO_NOISE * float(np.ptp(image, axis=0).max()) / 2) ** 2
    few = scales.shape[1] if few is None else few
    # Line and sample have one design unless their weights differ.
    alike = weights is None or (weights[:, 0] == weights[:, 1]).all()
    of_line = design_of(columns if weights is None else columns * weights[:, :1], order < 2, scales,
                        few)
    of_sample = of_line if weights is None or alike else design_of(
        columns * weights[:, 1:], order < 2, scales, few)
    if of_line is None or of_sample is None or freedom < 4:
        return None
    targets = image if weights is None else image * weights
    line, sample = _odds(of_line, targets) if of_line is of_sample else (
        _odds(of_line, targets[:, :1]) + _odds(of_sample, targets[:, 1:]))
    return Posterior((line, sample), _cells([line, sample], freedom, noise, affine=affine), freedom,
                     noise, (of_line, of_sample), scales, targets, in_use)


def polynomial_posterior(ground: FloatArray, image: FloatArray, exponents: Exponents,
                         weights: FloatArray | None) -> Posterior | None:
    """Return all solutions of a polynomial for points that are all in use (see `posterior`).

    The ground (n, 3) is scaled to [-1, 1], the image is (n, 2), of the k exponents affine ones come
    first; the equations are multiplied by the weights (n, 2), if any.
    """
    return _of_polynomial(ground.tobytes(), image.tobytes(), exponents,
                          None if weights is None else weights.tobytes())


@lru_cache(maxsize=2)
def _of_polynomial(ground: bytes, image: bytes, exponents: Exponents,
                   weights: bytes | None) -> Posterior | None:
    """Return the same; a regularised polynomial, and a field that may be none, ask for one."""
    powers = np.array(exponents)
    order = powers.sum(axis=1)
    places = np.frombuffer(image).reshape(-1, 2)
    return posterior(monomials(np.frombuffer(ground).reshape(-1, 3), exponents), places, order,
                     None if weights is None else np.frombuffer(weights).reshape(-1, 2),
                     scales_of(powers[order > 1]), len(places), affine=True)
