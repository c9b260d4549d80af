"""The half of many points that agrees best, where more than a third are blunders.

Setting aside a third of all points fails where more than a third are wrong: what remains still
holds blunders, which spoil the noise that the others are judged by. Least trimmed squares stand up
to blunders among half of all points (Rousseeuw 1984): the polynomial whose closest half has the
smallest squares. It is sought from random samples and improved by concentration, each time refitted
to its closest half (Rousseeuw and Van Driessen 2006, FAST-LTS). Its noise tells which points
disagree; those that agree are the majority.

A bend of the image that a polynomial does not follow makes points disagree as well. So a majority
is one only if the others are gross, and lie among it: not where a part of the image is bent.
"""

from __future__ import annotations

import numpy as np

from termsel.auto.contradictions import polynomial_of
from termsel.data.features import BoolArray, FloatArray, IntArray
from termsel.data.fit_data import FitData
from termsel.data.monomials import monomials

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

CONCENTRATED = 20
"""Samples that are improved."""

STEPS = 30
"""Most concentration steps; squares fall with each of them, and five are usual."""

MAX_SAMPLED_POINTS = 300
"""Points that samples are judged by, where there are more."""

AGREEING_STRAIN = 4.0
"""Standard deviations within which a point agrees with the majority."""

GROSS_STRAIN = 6.0
"""Standard deviations that the others disagree by, in the median."""


def majority(control: FitData) -> BoolArray | None:
    """Return which points (n,) agree; None where a third or fewer disagree, or not grossly.

    None, too, for fewer than MIN_SEEN_POINTS, and for lines.
    """
    n = len(control)
    if n < MIN_SEEN_POINTS or len(control.features.lines):
        return None
    scaled = control.scaled.points
    exponents = polynomial_of(control.heights, 2).exponents
    design = monomials(scaled.ground, exponents)
    is_affine = np.array(exponents).sum(axis=1) <= 1
    if n < POINTS_BY_TERM * len(exponents):
        design = design[:, is_affine]
        is_affine = is_affine[is_affine]
    rng = np.random.default_rng(0)  # the same points have the same blunders
    sampled = rng.permutation(n)[:MAX_SAMPLED_POINTS]
    half = np.zeros(n, dtype=bool)
    half[sampled] = _closest_half(design[sampled], scaled.image[sampled], is_affine, rng)
    agreeing, noise = _agreeing(design, scaled.image, half)
    minority = ~agreeing
    if minority.mean() <= MAX_BLUNDER_SHARE or agreeing.sum() < n // 2:
        return None
    strains = _errors(design, scaled.image, agreeing)[minority] / noise
    if np.median(strains) < GROSS_STRAIN or not _interleaved(scaled.ground[sampled],
                                                             agreeing[sampled]):
        return None
    return agreeing


def _closest_half(design: FloatArray, image: FloatArray, is_affine: BoolArray,
                  rng: np.random.Generator) -> BoolArray:
    """Return the half of the points (n,) with the least trimmed squares that is found."""
    n = len(design)
    least = np.inf
    best = np.ones(n, dtype=bool)
    # Affine samples need few points, so that more of them have no blunder; others bend as well.
    samples_of = [design[:, is_affine]]
    if not is_affine.all():
        samples_of.append(design)
    for columns in samples_of:
        for closest in _starts(columns, image, rng):
            half = np.zeros(n, dtype=bool)
            half[closest] = True
            squares, half = _concentrated(design, image, half)
            if squares < least:
                least = squares
                best = half
    return best


def _starts(design: FloatArray, image: FloatArray, rng: np.random.Generator) -> IntArray:
    """Return the closest halves (CONCENTRATED, n // 2) of the best random samples."""
    n, k = design.shape
    # The k lowest of n random numbers are a sample without repetition.
    samples = np.argpartition(rng.random((SAMPLES, n)), k, axis=1)[:, :k]
    normal = design[samples]
    # Samples of points in line have no solution: a little is added to what is inverted.
    gram = normal.transpose(0, 2, 1) @ normal
    gram += 1e-12 * np.trace(gram, axis1=1, axis2=2)[:, None, None] * np.eye(k)
    coefficients = np.linalg.solve(gram, normal.transpose(0, 2, 1) @ image[samples])
    squares = ((image - design @ coefficients) ** 2).sum(axis=2)
    trimmed = np.partition(squares, n // 2 - 1, axis=1)[:, :n // 2].sum(axis=1)
    best = np.argsort(trimmed, kind="stable")[:CONCENTRATED]
    return np.argsort(squares[best], axis=1, kind="stable")[:, :n // 2]


def _concentrated(design: FloatArray, image: FloatArray,
                  half: BoolArray) -> tuple[float, BoolArray]:
    """Return the trimmed squares, and their half, that refitting leads to."""
    n = len(design)
    least = np.inf
    for _ in range(STEPS):
        squares = _errors(design, image, half) ** 2
        closest = np.argsort(squares, kind="stable")[:(n + 1) // 2]
        trimmed = float(squares[closest].sum())
        if trimmed >= least:
            break
        least = trimmed
        half = np.zeros(n, dtype=bool)
        half[closest] = True
    return least, half


def _agreeing(design: FloatArray, image: FloatArray, half: BoolArray) -> tuple[BoolArray, float]:
    """Return which points agree with a half, and the noise of one coordinate."""
    agreeing = half
    for _ in range(STEPS):
        errors = _errors(design, image, agreeing)
        freedom = 2 * (int(agreeing.sum()) - design.shape[1])
        if freedom <= 0:
            break
        noise = float(np.sqrt((errors[agreeing] ** 2).sum() / freedom))
        further = errors <= AGREEING_STRAIN * noise
        further |= half
        if (further == agreeing).all():
            break
        agreeing = further
    return agreeing, noise


def _errors(design: FloatArray, image: FloatArray, used: BoolArray) -> FloatArray:
    """Return the distance of each point (n,) from the polynomial of some."""
    coefficients = np.linalg.lstsq(design[used], image[used])[0]
    return np.asarray(np.linalg.norm(image - design @ coefficients, axis=1))


def _interleaved(ground: FloatArray, agreeing: BoolArray) -> bool:
    """Return whether most points that disagree have some that agree in three quadrants."""
    others = ground[~agreeing, None, :2]
    is_right, is_above = np.moveaxis(ground[agreeing, :2] > others, 2, 0)
    quadrants = np.stack([(is_right == right) & (is_above == above)
                          for right in (False, True) for above in (False, True)])
    return bool((quadrants.any(axis=2).sum(axis=0) >= 3).mean() > 0.5) if len(others) else False
