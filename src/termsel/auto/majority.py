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

from termsel.adjustment.solve import upper_triangle
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

RIDGE_SHARE = 1e-12
"""Share of its trace that is added to the diagonal of a matrix before it is inverted."""

STEPS = 30
"""Most concentration steps; squares fall with each of them, and five are usual."""

MAX_SAMPLED_POINTS = 300
"""Points that samples are judged by, where there are more."""

MANY_POINTS = 1000
"""Points from which on a part of them shows what all do: parts agree closely."""

ENOUGH_AGREEING = 0.75
"""Share of many points from which on the others, even if all are wrong, are too few to matter."""

ADDED_PART = 40
"""One of so many points is added at a time to those that agree."""

LEAST_NOISE = 1e-12
LEAST_VARIANCE = 1e-6
"""Noise in scaled units, and variance by that of the noise, that take the place of rounding."""

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
    # For each design its halves, masks (n,), those with the least trimmed squares first.
    of_designs: list[list[BoolArray]]

    @classmethod
    def of(cls, control: FitData) -> Self | None:
        """Return the halves of control points; None for fewer than MIN_SEEN_POINTS, and with lines.

        Of many points the halves are those of a random sample.
        """
        n = len(control)
        if n < MIN_SEEN_POINTS or len(control.features.lines):
            return None
        scaled = control.scaled.points
        designs, is_affine = polynomial_designs(scaled.ground, heights=control.heights)
        # A fixed seed: the same points have the same blunders.
        rng = np.random.default_rng(0)
        # Squares of a sample of the points rank halves as well as those of all do, and cost less.
        sample = rng.permutation(n)[:MAX_SAMPLED_POINTS]
        halves_of_sample = closest_halves([design[sample] for design in designs],
                                          scaled.image[sample], is_affine, rng)

        def among_all(half_of_sample: BoolArray) -> BoolArray:
            half = np.zeros(n, dtype=bool)
            half[sample] = half_of_sample
            return half

        return cls(designs, [list(map(among_all, halves)) for halves in halves_of_sample])


def find_majority(control: FitData, halves: Halves | None = None) -> BoolArray | None:
    """Return a mask (n,) of the points that agree with one polynomial; None if none is clear.

    A majority is clear if more than a third of the points disagree with it, and grossly. Returns
    None for fewer than MIN_SEEN_POINTS points, and with lines. `halves` are the halves of these
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
    # Too few points for all terms would let a quadratic polynomial follow blunders.
    if n < POINTS_BY_TERM * len(exponents):
        design = design[:, is_affine]
        is_affine = is_affine[is_affine]
    designs = [design]
    if n >= MIN_CUBIC_POINTS:
        designs.append(np.hstack([design, evaluate_monomials(ground, CUBIC_OF_PLANE)]))
    return designs, is_affine


def _majority_over_blunders(design: FloatArray, scaled: Points,
                            half: BoolArray) -> BoolArray | None:
    """Return a mask (n,) of the points that agree with a half, if the others are gross blunders.

    These have to be more than a third, and no part of the image that bends away; else None is
    returned. `design` (n, k) are the terms of the polynomial, `half` is a mask (n,).
    """
    n = len(half)
    agreeing, strains = _points_agreeing_with(design, scaled.image, half)
    minority = ~agreeing
    if minority.mean() <= MAX_BLUNDER_SHARE or agreeing.sum() < n // 2 - 1:
        return None
    if np.median(strains[minority]) < GROSS_STRAIN / AGREEING_STRAIN:
        return None
    # Gross errors may be blunders, or a part of the image that bends away.
    errors = _residuals(design, scaled.image, agreeing)[minority]
    return None if may_be_bend(scaled.ground, agreeing, errors) else agreeing


def is_outvoted(data: FitData, minority: BoolArray, test: Test) -> bool:
    """Return whether a minority of points, a mask (n,), are gross blunders and no bend.

    `test` is the test of all points by the majority.
    """
    if np.median(test.strain[minority]) < GROSS_STRAIN:
        return False
    points = data.scaled.points
    design = evaluate_monomials(points.ground, polynomial_of(data.heights, 2).exponents)
    errors = _residuals(design, points.image, ~minority)[minority]
    return not may_be_bend(points.ground, ~minority, errors)


def closest_halves(designs: Sequence[FloatArray], image: FloatArray, is_affine: BoolArray,
                   rng: np.random.Generator) -> list[list[BoolArray]]:
    """Return the closest halves, masks (n,), of each design, the least trimmed squares first.

    Random samples are of the first design (n, k), whose columns `is_affine` (k,) are affine. The
    halves of each further design are sought from those of the design before it. `image` (n, 2) are
    the positions that are fitted.
    """
    # Affine samples need few points, so that more of them have no blunder; others bend as well.
    sampled_designs = [designs[0][:, is_affine]]
    if not is_affine.all():
        sampled_designs.append(designs[0])
    halves = np.concatenate([_best_random_halves(design, image, rng)
                             for design in sampled_designs])
    halves_of_designs = []
    for design in designs:
        trimmed_squares, halves = _concentrate_halves(design, image, halves)
        # Many samples lead to the same half.
        distinct: dict[bytes, tuple[float, BoolArray]] = {}
        for squares, half in zip(trimmed_squares.tolist(), halves, strict=True):
            distinct.setdefault(half.tobytes(), (squares, half))
        in_order = sorted(distinct.values(), key=lambda squares_and_half: squares_and_half[0])
        halves_of_designs.append([half for _, half in in_order])
    return halves_of_designs


def _best_random_halves(design: FloatArray, image: FloatArray,
                        rng: np.random.Generator) -> BoolArray:
    """Return the closest halves (CONCENTRATED, n) of the best random samples, as masks.

    A sample of k points determines the k coefficients of a polynomial; the half of the sample are
    the n // 2 points closest to it. Samples are the better, the smaller the sum of squares of their
    half is. `design` (n, k) are the terms of the polynomial, `image` (n, 2) the positions.
    """
    n, k = design.shape
    # The k lowest of n random numbers are a sample without repetition.
    samples = np.argpartition(rng.random((SAMPLES, n)), k, axis=1)[:, :k]
    sample_designs = design[samples]
    # Samples of points in line have no solution: a little is added to what is inverted.
    gram = sample_designs.transpose(0, 2, 1) @ sample_designs
    gram += RIDGE_SHARE * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(k)
    coefficients = np.linalg.solve(gram, sample_designs.transpose(0, 2, 1) @ image[samples])
    # One product of matrices for all samples, not one for each.
    line_errors, sample_errors = (image[:, axis] - coefficients[:, :, axis] @ design.T
                                  for axis in (0, 1))                              # (samples, n)
    squares = line_errors**2 + sample_errors**2
    trimmed = np.partition(squares, n // 2 - 1, axis=1)[:, :n // 2].sum(axis=1)
    best = np.argsort(trimmed, kind="stable")[:CONCENTRATED]
    return _closest(squares[best], n // 2)


def _closest(squares: FloatArray, count: int) -> BoolArray:
    """Return masks (m, n) of the `count` smallest of the n squares in each row."""
    is_closest = np.zeros(squares.shape, dtype=bool)
    smallest = np.argsort(squares, axis=1, kind="stable")[:, :count]
    np.put_along_axis(is_closest, smallest, True, axis=1)
    return is_closest


def _concentrate_halves(design: FloatArray, image: FloatArray,
                        halves: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Return the least trimmed squares (m,) to which refitting m halves leads, and these, (m, n).

    Trimmed squares are the sum of squares over a half. A step fits the polynomial to each half, and
    takes the points closest to that fit as its next half. `halves` (m, n) are masks, `design` (n,
    k) the terms of the polynomial and `image` (n, 2) the positions.
    """
    count = (len(design) + 1) // 2
    halves = halves.copy()
    least_squares = np.full(len(halves), np.inf)
    improving = np.arange(len(halves))  # numbers of the halves whose squares still fall
    for _ in range(STEPS):
        # No step raises the sum: the fit is the best for the half, the next half the best for it.
        squares = squared_distances_from_fits(design, image, halves[improving])
        closest = _closest(squares, count)
        trimmed = np.where(closest, squares, 0.0).sum(axis=1)
        falls = trimmed < least_squares[improving]
        # A half that is its own closest half would be refitted to itself.
        is_settled = (closest == halves[improving]).all(axis=1)
        least_squares[improving[falls]] = trimmed[falls]
        halves[improving[falls]] = closest[falls]
        improving = improving[falls & ~is_settled]
        if not len(improving):
            break
    return least_squares, halves


def _points_agreeing_with(design: FloatArray, image: FloatArray,
                          half: BoolArray) -> tuple[BoolArray, FloatArray]:
    """Return a mask of the points that agree with a half, and the strain of each, (n,) both.

    `design` (n, k) are the terms of the polynomial, `image` (n, 2) the positions, `half` is a mask.
    The strain is against the points that agree, 1 being the limit. Starting from the half, the
    closest of the others are added a few at a time, as a blunder among many new points would bend
    the fit towards further ones (forward search, Atkinson and Riani 2000). The search ends before
    the noise jumps: few points leave so wide a limit that a blunder may lie within it. Of many
    points it ends where ENOUGH_AGREEING of them agree, too.
    """
    n = len(half)
    agreeing = half
    added_at_once = max(1, n // ADDED_PART)
    noise_of_half, strains = _noise_and_strains(design, image, half)
    while not agreeing.all():
        # The rest cannot be a majority of blunders, and each step fits all points once more.
        if n >= MANY_POINTS and (agreeing & (strains <= 1.0)).mean() >= ENOUGH_AGREEING:
            break
        order = np.argsort(np.where(agreeing, np.inf, strains), kind="stable")[:added_at_once]
        closest = order[(strains[order] <= 1.0) & ~agreeing[order]]
        if not len(closest):
            break
        extended = agreeing.copy()
        extended[closest] = True
        noise, new_strains = _noise_and_strains(design, image, extended)
        if noise > NOISE_JUMP * noise_of_half:
            break
        agreeing = extended
        strains = new_strains
    # A blunder that got into the half is one of those that disagree, too.
    return agreeing & (strains <= 1.0), strains


def _noise_and_strains(
    design: FloatArray, image: FloatArray, used: BoolArray
) -> tuple[float, FloatArray]:
    """Return the noise of the points in use, by the mask `used`, and the strain of each point (n,).

    `design` (n, k) are the terms of the polynomial, `image` (n, 2) the positions.
    The strain is a point's distance from the fit divided by the largest that an agreeing point may
    have. As few points leave the noise uncertain, this limit is a quantile of Student's
    distribution: as improbable as AGREEING_STRAIN standard deviations of a normal error.
    """
    distances = distances_from_fit(design, image, used)
    freedom = 2 * max(int(used.sum()) - design.shape[1], 1)
    # The closest points understate the noise: of normal vectors in the plane, the shortest share g
    # has a mean square that is 1 + (1 - g) ln(1 - g) / g of the mean square of all.
    g = float(used.mean())
    understatement = 1.0 if g == 1.0 else 1.0 + (1.0 - g) * np.log(1.0 - g) / g
    noise = float(np.sqrt((distances[used] ** 2).sum() / freedom / understatement))
    # A point in use has the residual variance 1 - h, another the variance of prediction 1 + h, with
    # the leverage h = a' (A'A)^-1 a = |R'^-1 a|^2.
    inverse = np.linalg.inv(upper_triangle(design[used]))
    leverage = np.square(design @ inverse).sum(axis=1)
    variance = np.where(used, 1.0 - leverage, 1.0 + leverage).clip(LEAST_VARIANCE)
    limit = t_quantile(NormalDist().cdf(AGREEING_STRAIN), freedom)
    return noise, distances / (limit * np.maximum(noise, LEAST_NOISE) * np.sqrt(variance))


def distances_from_fit(design: FloatArray, image: FloatArray, used: BoolArray) -> FloatArray:
    """Return the distances (n,) of all points from the polynomial fitted to those `used`, (n,)."""
    return np.asarray(np.linalg.norm(_residuals(design, image, used), axis=1))


def _residuals(design: FloatArray, image: FloatArray, used: BoolArray) -> FloatArray:
    """Return the residuals (n, 2) of all points, y - A x, with x fitted to those `used`, (n,)."""
    x = np.linalg.lstsq(design[used], image[used])[0]
    return np.asarray(image - design @ x)


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
        The points that agree with the majority.
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
    `ground` (n, 3) are the places of all points, `agreeing` (n,) marks those that agree. Returns
    False where no point disagrees.
    """
    contradicting = _rows_spread_over_table(ground[~agreeing, None, :2])
    if not len(contradicting):
        return False
    # Each point that disagrees (rows) against each that agrees (columns), in x and y.
    is_beyond = _rows_spread_over_table(ground[agreeing, :2]) > contradicting
    is_right, is_above = np.moveaxis(is_beyond, 2, 0)
    quadrants = np.stack([is_right & is_above, is_right & ~is_above,
                          ~is_right & is_above, ~is_right & ~is_above])
    is_surrounded = quadrants.any(axis=2).sum(axis=0) >= 3
    return bool(is_surrounded.mean() > 0.5)


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
    sizes = np.maximum(np.linalg.norm(errors, axis=1), LEAST_NOISE)
    tempered = errors / np.sqrt(sizes)[:, None]
    distances = np.linalg.norm(ground[:, None] - ground, axis=2)
    np.fill_diagonal(distances, np.inf)
    differences = tempered - tempered[distances.argmin(axis=1)]
    # Where all errors are 0 there is nothing to divide by.
    return float((differences**2).sum() / np.maximum(2 * (tempered**2).sum(), 1e-300))
