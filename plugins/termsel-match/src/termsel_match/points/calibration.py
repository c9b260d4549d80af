"""Standard deviations that are true: matches compared with their neighbours.

What least squares of grey values says is the effect of noise alone. Relief, houses, aliasing and
another light move matches, too, and by more.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.optimize import brentq
from scipy.spatial import cKDTree

from termsel_match.images.rasters import FloatArray, Mask

# Px of displacement within which matches are taken for the same at first.
_REACH = 6.0
# Matches that agree; of fewer nothing is said.
_MIN_MATCHES = 12
# Matches for each term of the surface.
_PER_TERM = 6
_POLYNOMIAL_DEGREES = ((1, 1), (2, 2), (3, 3), (3, 6))
"""Of the surface, and along the lines, where attitude moves an image faster."""
_SURFACE_ROUNDS = 12
_SIGMAS = 3.5
# Of the distance in two dimensions, in standard deviations of one.
_RAYLEIGH_MEDIAN = 1.1774
# In px.
_MIN_LIMIT = 0.3


def smooth_part(positions: FloatArray, moved: FloatArray) -> tuple[FloatArray, Mask, int] | None:
    """Return the smooth part of displacements, which of them agree with it, and its terms.

    The most common displacement comes first; then a plane, and curved surfaces as far as there are
    enough matches, the last of them for jitter, each fitted to those that agree with the one
    before.

    Parameters
    ----------
    positions, moved : ndarray, shape (n, 2)
        Positions in the image, and displacements there [px].

    Returns
    -------
    ndarray of float, shape (n, 2); ndarray of bool, shape (n,); int
        None where fewer than 12 agree.
    """
    if len(positions) < _MIN_MATCHES:
        return None
    tree = cKDTree(moved)
    # The displacement that most others have within the reach.
    groups = tree.query_ball_point(moved, _REACH)
    largest = groups[int(np.argmax([len(group) for group in groups]))]
    away = np.linalg.norm(moved - np.median(moved[largest], axis=0), axis=1)
    agree = away <= _REACH
    surface = np.zeros_like(moved)
    low = positions.min(axis=0)
    high = positions.max(axis=0)
    # From -1 to 1, so that powers stay of the size of one.
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
    """Return standard deviations with which matches that agree have a chi-square of 1, (n, 2).

    In each axis they are larger by a constant variance, or smaller by a factor. Where too few
    matches agree they stay.

    Parameters
    ----------
    positions, moved : ndarray, shape (n, 2)
        As for `smooth_part`.
    sigma : ndarray, shape (n, 2)
        Of line and sample, by the noise of grey values [px].
    """
    smooth = smooth_part(positions, moved)
    if smooth is None:
        return sigma
    surface, agree, terms = smooth
    squares = ((moved - surface)[agree]) ** 2
    # The share of the redundancy that the terms of the surface leave to each match.
    free = 1 - terms / agree.sum()
    calibrated_sigma = sigma.copy()
    for axis in range(2):
        variance = sigma[agree, axis] ** 2

        def excess(further: float, noise: FloatArray = variance, axis: int = axis) -> float:
            return float((squares[:, axis] / (noise + further)).mean() - free)

        ratio = excess(0.0) + free
        if ratio <= free:
            calibrated_sigma[:, axis] *= (ratio / free) ** 0.5
        else:
            # Chi-square of 1: mean(r^2 / (s^2 + v)) = free, solved for the variance v.
            excess_variance = brentq(excess, 0.0, 10 * float(squares[:, axis].max()) / free)
            calibrated_sigma[:, axis] = np.sqrt(calibrated_sigma[:, axis] ** 2 + excess_variance)
    return calibrated_sigma
