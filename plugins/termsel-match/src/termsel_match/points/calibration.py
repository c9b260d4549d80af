"""Standard deviations of matches, calibrated by comparing matches with their neighbours.

The deviations by least squares of grey values have the effect of noise alone. Relief, houses,
aliasing and different light displace matches as well, and by more.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.optimize import brentq
from scipy.spatial import cKDTree

from termsel_match.images.rasters import FloatArray, Mask

_REACH = 6.0
"""Distance of displacements within which they count as the same at first [px]."""

_MIN_MATCHES = 12
"""Fewest matches that must agree with the surface."""

_PER_TERM = 6
"""Fewest matches for each term of the surface."""

_POLYNOMIAL_DEGREES = ((1, 1), (2, 2), (3, 3), (3, 6))
"""Degrees of the surfaces that are tried in turn: of the surface, and of its terms in the line
alone, as the attitude changes fast along the lines."""

_SURFACE_ROUNDS = 12
"""Most rounds of fitting a surface to the matches that agree with it."""

_SIGMAS = 3.5
"""Distance from the surface, in standard deviations of one axis, up to which a match agrees."""

_RAYLEIGH_MEDIAN = 1.1774
"""Median of a distance in the plane, in standard deviations of one axis: sqrt(2 ln 2)."""

_MIN_LIMIT = 0.3
"""Least distance from the surface up to which a match agrees [px]."""


def smooth_part(positions: FloatArray, moved: FloatArray) -> tuple[FloatArray, Mask, int] | None:
    """Return the smooth part of displacements, which of them agree with it, and its terms.

    First the most common displacement is found; then a plane is fitted to those near it, and curved
    surfaces as far as there are enough matches, each to those that agree with the one before. The
    last surface bends faster along the lines, as jitter does.

    Parameters
    ----------
    positions, moved : ndarray, shape (n, 2)
        Positions in the image, and displacements there [px].

    Returns
    -------
    tuple or None
        The smooth part at each position, (n, 2) [px]; which displacements agree with it, (n,); and
        the number of terms. None if fewer than 12 agree, or fewer than three for each term.
    """
    if len(positions) < _MIN_MATCHES:
        return None
    tree = cKDTree(moved)
    # The largest group: displacements within the reach of one of them.
    groups = tree.query_ball_point(moved, _REACH)
    largest = groups[int(np.argmax([len(group) for group in groups]))]
    away = np.linalg.norm(moved - np.median(moved[largest], axis=0), axis=1)
    agree = away <= _REACH
    surface = np.zeros_like(moved)
    low = positions.min(axis=0)
    high = positions.max(axis=0)
    # Positions from -1 to 1, so that their powers are not larger.
    unit = 2 * (positions - low) / np.maximum(high - low, 1e-9) - 1
    terms = 1
    for degree, degree_of_lines in _POLYNOMIAL_DEGREES:
        columns = np.stack([unit[:, 0]**i * unit[:, 1]**j
                            for i, j in product(range(degree_of_lines + 1), range(degree + 1))
                            if i + j <= degree or not j], axis=1)
        if agree.sum() < max(_MIN_MATCHES, _PER_TERM * columns.shape[1]):
            break
        terms = columns.shape[1]
        for _ in range(_SURFACE_ROUNDS):
            before = agree
            surface = columns @ np.linalg.lstsq(columns[agree], moved[agree], rcond=None)[0]
            away = np.linalg.norm(moved - surface, axis=1)
            spread = float(np.median(away[agree])) / _RAYLEIGH_MEDIAN
            agree = away <= max(_SIGMAS * spread, _MIN_LIMIT)
            if agree.sum() < max(_MIN_MATCHES, terms) or np.array_equal(agree, before):
                break
    if terms == 1 or agree.sum() < max(_MIN_MATCHES, _PER_TERM // 2 * terms):
        return None
    return surface, np.asarray(agree), terms


def calibrate_deviations(positions: FloatArray, moved: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return standard deviations with which agreeing matches have a reduced chi-square of 1, (n,
    2).

    In each axis a constant variance is added to those given, or, if they are too large, they are
    divided by a factor. If too few matches agree with a smooth surface, they come back unchanged.

    Parameters
    ----------
    positions, moved : ndarray, shape (n, 2)
        As for `smooth_part`.
    sigma : ndarray, shape (n, 2)
        Standard deviations of line and sample by the noise of grey values [px].
    """
    smooth = smooth_part(positions, moved)
    if smooth is None:
        return sigma
    surface, agree, terms = smooth
    squares = ((moved - surface)[agree]) ** 2
    # Mean redundancy of a match: the surface takes a share for each of its terms.
    free = 1 - terms / agree.sum()
    calibrated_sigma = sigma.copy()
    for axis in range(2):
        variance = sigma[agree, axis] ** 2

        def excess(further: float, noise: FloatArray = variance, axis: int = axis) -> float:
            """Return by how much the mean of r^2 / (s^2 + v) is above its expectation `free`."""
            return float((squares[:, axis] / (noise + further)).mean() - free)

        ratio = excess(0.0) + free
        if ratio <= free:
            calibrated_sigma[:, axis] *= (ratio / free) ** 0.5
        else:
            # mean(r^2 / (s^2 + v)) = free is solved for the variance v.
            excess_variance = brentq(excess, 0.0, 10 * float(squares[:, axis].max()) / free)
            calibrated_sigma[:, axis] = np.sqrt(calibrated_sigma[:, axis] ** 2 + excess_variance)
    return calibrated_sigma
