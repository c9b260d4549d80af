"""The half of many points that agrees best, where more than a third are blunders.

Setting aside a third of all points fails where more than a third are wrong: what remains still
holds blunders, which spoil the noise that the others are judged by. Least trimmed squares stand up
to blunders among half of all points (Rousseeuw 1984): the polynomial whose closest half has the
smallest squares. It is sought from random samples and improved by concentration, each time refitted
to its closest half (Rousseeuw and Van Driessen 2006, FAST-LTS). A sample of as many points as a
cubic polynomial has terms always holds blunders; but the halves of quadratic ones hold few, so that
concentration goes on from them with the cubic terms of the plane, which cameras that turn and
aircraft need. Their noise shows which points disagree; those that agree are the majority.

An image that bends more, such as an aircraft's, leaves such noise to these polynomials that no
point is gross next to it: `termsel.auto.likeliest_majority` goes on from the best halves.

A bend of the image that a polynomial does not follow makes points disagree as well. So a majority
is one only if the others are gross, and disagree with each other, or have one error and lie among
it: where the image bends, the errors of neighbours are alike and those of all vary.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Self

import numpy as np

from termsel.adjustment.subset_fits import squared_distances_from_fits
from termsel.auto.contradictions import Test, polynomial_of
from termsel.data.features import BoolArray, FloatArray, Points
from termsel.data.fit_data import FitData
from termsel.data.monomials import evaluate_monomials
from termsel.data.record.chances import t_quantile

MIN_POINTS = 40
"""Points below which no half decides which of all are wrong: it may agree by chance."""

MIN_SEEN_POINTS = 20
"""Points below which it cannot be seen whether half of them agree."""

MAX_BLUNDER_SHARE = 1 / 3
"""Largest share of blunders that the usual search finds: more of them hide each other."""

SAMPLES = 2000
"""Random samples of each degree: of ten points, half of them wrong, two samples have none."""

POINTS_BY_TERM = 3
"""Points for each term of a quadratic polynomial, below which an affine one is taken."""

MIN_CUBIC_POINTS = 40
"""Points from which on the cubic terms of the plane are added: their half outnumbers the terms."""

CUBIC_OF_PLANE = ((3, 0, 0), (2, 1, 0), (1, 2, 0), (0, 3, 0))
"""Exponents of the cubic terms without heights."""

CONCENTRATED = 20
"""Samples that are improved."""

STEPS = 30
"""Most concentration steps; squares fall with each of them, and five are usual."""

MAX_SAMPLED_POINTS = 300
"""Points that samples are judged by, where there are more."""

ADDED_PART = 40
"""One of so many points is added at a time to those that agree."""

NOISE_JUMP = 2.0
"""Noise by that of the half, beyond which no further point agrees."""

AGREEING_STRAIN = 4.0
"""Standard deviations within which a point agrees with the majority."""

UNLIKE = 0.3
"""Squared difference of the errors of neighbours, by that of independent errors, from which on they
are no bend. Of bends it is at most 0.2."""

MAX_DEVIATION = 0.25
"""Deviation of errors from their mean, by the mean, up to which they are one error."""

GROSS_STRAIN = 6.0
"""Standard deviations that the others disagree by, in the median."""


@dataclass(frozen=True, eq=False)
class Halves:
    """The halves of points that agree best with polynomials."""

    designs: list[FloatArray]  # (n, k): the terms of each polynomial
    of_designs: list[list[BoolArray]]  # (n,): those with the least trimmed squares first

    @classmethod
    def of(cls, control: FitData) -> Self | None:
        """Return those of points; None of fewer than MIN_SEEN_POINTS, and of lines.

        Halves of a sample of points rank as those of all do, and cost less. The random numbers
        begin with a fixed seed: the same points have the same blunders.
        """
        n = len(control)
        if n < MIN_SEEN_POINTS or len(control.features.lines):
            return None
        scaled = control.scaled.points
        designs, is_affine = polynomial_designs(scaled.ground, heights=control.heights)
        rng = np.random.default_rng(0)  # the same points have the same blunders
        # Squares of a sample of the points rank halves as well as those of all do, and cost less.
        sampled = rng.permutation(n)[:MAX_SAMPLED_POINTS]
        of_sampled = closest_halves([columns[sampled] for columns in designs],
                                    scaled.image[sampled], is_affine, rng)

        def among_all(closest: BoolArray) -> BoolArray:
            half = np.zeros(n, dtype=bool)
            half[sampled] = closest
            return half

        return cls(designs, [list(map(among_all, halves)) for halves in of_sampled])


def find_majority(control: FitData, halves: Halves | None = None) -> BoolArray | None:
    """Return which points (n,) agree with one polynomial; None where no majority is clear.

    It is clear if more than a third of the points disagree with the others, and grossly. There is
    none for fewer than MIN_SEEN_POINTS points, and none for lines. `halves` are those of the
    points, if they are known.
    """
    halves = halves or Halves.of(control)
    if halves is None:
        return None
    # The fewer terms, the clearer is who disagrees.
    for columns, closest in zip(halves.designs, halves.of_designs, strict=True):
        agreeing = _majority_over_blunders(columns, control.scaled.points, closest[0])
        if agreeing is not None:
            return agreeing
    return None


def polynomial_designs(ground: FloatArray, *, heights: bool) -> tuple[list[FloatArray], BoolArray]:
    """Return the design matrices (n, k) of the polynomials that points are enough for.

    The first is quadratic, or affine for few points; of many points a second adds the cubic terms
    of the plane. The mask (k,) says which columns of the first are affine.
    """
    n = len(ground)
    exponents = polynomial_of(heights, 2).exponents
    design = evaluate_monomials(ground, exponents)
    is_affine = np.array(exponents).sum(axis=1) <= 1
    if n < POINTS_BY_TERM * len(exponents):
        design = design[:, is_affine]
        is_affine = is_affine[is_affine]
    designs = [design]
    if n >= MIN_CUBIC_POINTS:
        designs.append(np.hstack([design, evaluate_monomials(ground, CUBIC_OF_PLANE)]))
    return designs, is_affine


def _majority_over_blunders(design: FloatArray, scaled: Points,
                            half: BoolArray) -> BoolArray | None:
    """Return which points (n,) agree with a half if over a third are gross blunders; else None."""
    n = len(half)
    agreeing, strains = _points_agreeing_with(design, scaled.image, half)
    minority = ~agreeing
    if minority.mean() <= MAX_BLUNDER_SHARE or agreeing.sum() < n // 2 - 1:
        return None
    if np.median(strains[minority]) < GROSS_STRAIN / AGREEING_STRAIN:
        return None
    # Gross they are: but are they blunders, or a part of the image that bends away?
    errors = _residuals(design, scaled.image, agreeing)[minority]
    return None if may_be_bend(scaled.ground, agreeing, errors) else agreeing


def is_outvoted(data: FitData, minority: BoolArray, test: Test) -> bool:
    """Return whether points (n,) are gross blunders under a test by all others, and no bend."""
    if np.median(test.strain[minority]) < GROSS_STRAIN:
        return False
    points = data.scaled.points
    design = evaluate_monomials(points.ground, polynomial_of(data.heights, 2).exponents)
    errors = _residuals(design, points.image, ~minority)[minority]
    return not may_be_bend(points.ground, ~minority, errors)


def closest_halves(designs: Sequence[FloatArray], image: FloatArray, is_affine: BoolArray,
                    rng: np.random.Generator) -> list[list[BoolArray]]:
    """Return for each design the halves (n,) that are found, those of least trimmed squares first.

    Samples are of the first design (n, k). Halves of each design go on from those of the one
    before it.
    """
    first = designs[0]
    # Affine samples need few points, so that more of them have no blunder; others bend as well.
    samples_of = [first[:, is_affine]]
    if not is_affine.all():
        samples_of.append(first)
    halves = np.concatenate([_best_random_halves(columns, image, rng) for columns in samples_of])
    of_designs = []
    for design in designs:
        squares, halves = _concentrate_halves(design, image, halves)
        # Many samples lead to the same half.
        smallest_of_half: dict[bytes, tuple[float, BoolArray]] = {}
        for of_half, half in zip(squares.tolist(), halves, strict=True):
            smallest_of_half.setdefault(half.tobytes(), (of_half, half))
        of_designs.append([half for _, half in sorted(smallest_of_half.values(),
                                                      key=lambda each: each[0])])
    return of_designs


def _best_random_halves(design: FloatArray, image: FloatArray,
                        rng: np.random.Generator) -> BoolArray:
    """Return the closest halves (CONCENTRATED, n) of the best random samples.

    A sample of k points determines the k coefficients; its half are the n // 2 points next to that
    polynomial. The best samples have the least trimmed squares: the sum of those of their half.
    """
    n, k = design.shape
    # The k lowest of n random numbers are a sample without repetition.
    samples = np.argpartition(rng.random((SAMPLES, n)), k, axis=1)[:, :k]
    normal = design[samples]
    # Samples of points in line have no solution: a little is added to what is inverted.
    gram = normal.transpose(0, 2, 1) @ normal
    gram += 1e-12 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(k)
    coefficients = np.linalg.solve(gram, normal.transpose(0, 2, 1) @ image[samples])
    # One product of matrices for all samples, not one for each.
    line, sample = (image[:, axis] - coefficients[:, :, axis] @ design.T
                    for axis in (0, 1))                                            # (samples, n)
    squares = line**2 + sample**2
    trimmed = np.partition(squares, n // 2 - 1, axis=1)[:, :n // 2].sum(axis=1)
    best = np.argsort(trimmed, kind="stable")[:CONCENTRATED]
    return _closest(squares[best], n // 2)


def _closest(squares: FloatArray, count: int) -> BoolArray:
    """Return the points of the `count` least squares of each row, (m, n)."""
    sets = np.zeros(squares.shape, dtype=bool)
    np.put_along_axis(sets, np.argsort(squares, axis=1, kind="stable")[:, :count], True, axis=1)
    return sets


def _concentrate_halves(design: FloatArray, image: FloatArray,
                        halves: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Return the least sums of trimmed squares that refitting halves leads to, and these, (m, n).

    A step fits each half, and takes the points closest to that fit as its next half.
    """
    count = (len(design) + 1) // 2
    halves = halves.copy()
    least = np.full(len(halves), np.inf)
    falling = np.arange(len(halves))  # those whose squares still fall
    for _ in range(STEPS):
        # No step raises the sum: the fit is the best for the half, the next half the best for it.
        squares = squared_distances_from_fits(design, image, halves[falling])
        closest = _closest(squares, count)
        trimmed = np.where(closest, squares, 0.0).sum(axis=1)
        falls = trimmed < least[falling]
        # What is its own closest half is refitted to itself.
        is_settled = (closest == halves[falling]).all(axis=1)
        least[falling[falls]] = trimmed[falls]
        halves[falling[falls]] = closest[falls]
        falling = falling[falls & ~is_settled]
        if not len(falling):
            break
    return least, halves


def _points_agreeing_with(design: FloatArray, image: FloatArray,
                          half: BoolArray) -> tuple[BoolArray, FloatArray]:
    """Return which points agree with a half, and the strain of each (n,) against these.

    The closest of the others are added bit by bit, as a blunder among many new ones would bend the
    fit towards further ones (forward search, Atkinson and Riani 2000). It ends before the noise
    jumps: few points allow the next one so much that a blunder may be among what they allow.
    """
    n = len(half)
    agreeing = half
    at_once = max(1, n // ADDED_PART)
    first_noise, strains = _noise_and_strains(design, image, half)
    while not agreeing.all():
        order = np.argsort(np.where(agreeing, np.inf, strains), kind="stable")[:at_once]
        closest = order[(strains[order] <= 1.0) & ~agreeing[order]]
        if not len(closest):
            break
        extended = agreeing.copy()
        extended[closest] = True
        noise, new_strains = _noise_and_strains(design, image, extended)
        if noise > NOISE_JUMP * first_noise:
            break
        agreeing = extended
        strains = new_strains
    # A blunder that got into the half is one of those that disagree, too.
    return agreeing & (strains <= 1.0), strains


def _noise_and_strains(
    design: FloatArray, image: FloatArray, used: BoolArray
) -> tuple[float, FloatArray]:
    """Return the noise of the points in use, and the strain of each point (n,).

    A strain is a point's distance from the fit by the largest that an agreeing point may have.
    Few points leave the noise uncertain, so that this limit is a quantile of Student's
    distribution: as improbable as AGREEING_STRAIN standard deviations of a normal error.
    """
    errors = distances_from_fit(design, image, used)
    freedom = 2 * max(int(used.sum()) - design.shape[1], 1)
    # The closest points understate the noise: of normal vectors of the plane the shortest share g
    # has the part 1 + (1 - g) ln(1 - g) / g of the mean square.
    part = float(used.mean())
    share = 1.0 if part == 1.0 else 1.0 + (1.0 - part) * np.log(1.0 - part) / part
    noise = float(np.sqrt((errors[used] ** 2).sum() / freedom / share))
    # A point in use has the residual variance 1 - h, another the variance of prediction 1 + h, with
    # the leverage h = a' (A'A)^-1 a = |R'^-1 a|^2.
    triangle = np.linalg.qr(design[used])[1]
    leverage = (np.linalg.solve(triangle.T, design.T) ** 2).sum(axis=0)
    variance = np.where(used, 1.0 - leverage, 1.0 + leverage).clip(1e-6)
    limit = t_quantile(NormalDist().cdf(AGREEING_STRAIN), freedom)
    return noise, errors / (limit * np.maximum(noise, 1e-12) * np.sqrt(variance))


def distances_from_fit(design: FloatArray, image: FloatArray, used: BoolArray) -> FloatArray:
    """Return the distances (n,) of all points from the polynomial fitted to those `used`."""
    return np.asarray(np.linalg.norm(_residuals(design, image, used), axis=1))


def _residuals(design: FloatArray, image: FloatArray, used: BoolArray) -> FloatArray:
    """Return the residuals (n, 2) of all points, y - A x, with x fitted to those `used`."""
    coefficients = np.linalg.lstsq(design[used], image[used])[0]
    return np.asarray(image - design @ coefficients)


def may_be_bend(ground: FloatArray, agreeing: BoolArray, errors: FloatArray,
                max_unlikeness: float = UNLIKE) -> bool:
    """Return whether the errors of points that disagree may be a bend of the image.

    The errors of a bend are alike in neighbours, and vary over the image. Those of blunders differ
    from neighbour to neighbour, or are one and the same among points that have none, as of points
    copied from another map.

    Parameters
    ----------
    ground : ndarray, shape (n, 2 or 3)
        Of all points.
    agreeing : ndarray of bool, shape (n,)
    errors : ndarray, shape (m, 2)
        Of the m points that do not agree, in their order.
    max_unlikeness : float
        How much errors of a bend may differ from those of their neighbours: 0 for not at all, 1
        for as much as independent ones.
    """
    if _unlikeness(ground[~agreeing], errors) > max_unlikeness:
        return False
    shift = errors.mean(axis=0)
    deviation = np.sqrt(((errors - shift) ** 2).sum(axis=1).mean())
    is_one_error = deviation < MAX_DEVIATION * np.linalg.norm(shift)
    return not (is_one_error and _are_interleaved(ground, agreeing))


def _are_interleaved(ground: FloatArray, agreeing: BoolArray) -> bool:
    """Return whether points that disagree lie among those that agree, and not beside them.

    Most of them must have agreeing points in at least three of the four quadrants about them.
    """
    contradicting = _rows_spread_over_table(ground[~agreeing, None, :2])
    is_beyond = _rows_spread_over_table(ground[agreeing, :2]) > contradicting
    is_right, is_above = np.moveaxis(is_beyond, 2, 0)
    quadrants = np.stack([(is_right == right) & (is_above == above)
                          for right in (False, True) for above in (False, True)])
    surrounded = quadrants.any(axis=2).sum(axis=0) >= 3
    return bool(len(contradicting)) and bool(surrounded.mean() > 0.5)


def _rows_spread_over_table(rows: FloatArray) -> FloatArray:
    """Return at most MAX_SAMPLED_POINTS of n rows, at equal steps from the first to the last."""
    return rows[np.linspace(0, len(rows) - 1, min(len(rows), MAX_SAMPLED_POINTS)).astype(np.intp)]


def _unlikeness(ground: FloatArray, errors: FloatArray) -> float:
    """Return how much errors (n, 2) of points differ from those of their nearest neighbours.

    It is sum |e_i - e_j|^2 / (2 sum |e_i|^2), j being the nearest point to i: 1 for independent
    errors, and 0 if neighbours have the same. Gross errors must not decide alone, so that each
    counts by its direction and the root of its size: e / sqrt(|e|).
    """
    ground = _rows_spread_over_table(ground[:, :2])
    errors = _rows_spread_over_table(errors)
    tempered = errors / np.sqrt(np.maximum(np.linalg.norm(errors, axis=1), 1e-12))[:, None]
    distances = np.linalg.norm(ground[:, None] - ground, axis=2)
    np.fill_diagonal(distances, np.inf)
    differences = tempered - tempered[distances.argmin(axis=1)]
    return float((differences**2).sum() / np.maximum(2 * (tempered**2).sum(), 1e-300))
