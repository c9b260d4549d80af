"""Matches placed to sub-pixel by least squares.

References
----------
Gruen 1985: Adaptive least squares correlation. South African Journal of Photogrammetry, Remote
Sensing and Cartography 14, 175-187: the position by least squares of grey values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates, spline_filter

from termsel_match.images.rasters import FloatArray, Grey, Mask
from termsel_match.matchers import Matches

# Half the side of the windows that are compared [px]: 21 px with the middle.
_HALF = 10
# Steps of least squares for one match; those that take more have no clear optimum.
_MAX_ITERATIONS = 15
# Step below which a position has settled [px].
_SETTLED_STEP = 1e-3
# Px between the keypoints and the refined place.
_MAX_REFINEMENT = 2.5
# Correlation.
LEAST_SCORE = 0.5
# Least standard deviation of a match [px]; models of noise are no better.
_MIN_MATCH_SIGMA = 0.05
HELD = _HALF + 4
"""Px around a keypoint that must be known."""


@dataclass(frozen=True, eq=False)
class Layers:
    """What is compared of a window: one layer of grey, or several of structure.

    Parameters
    ----------
    values : ndarray of float32, shape (c, lines, samples)
    known : ndarray of bool, shape (lines, samples)
    """

    values: Grey
    known: Mask


def refine_matches(first: Layers, second: Layers, at_first: FloatArray, at_second: FloatArray,
                   min_score: float = LEAST_SCORE) -> Matches:
    """Return matches at whole pixels of the first picture, their places in the second refined.

    The window of the first is compared with that of the second, shifted, by least squares for
    shift, contrast and brightness. Residuals of neighbouring pixels are alike; the standard
    deviations account for it as for a process of first order in either direction.

    Parameters
    ----------
    first, second : Layers
        Layers of both windows, in the same scale and direction.
    at_first, at_second : ndarray, shape (n, 2)
        Line and sample of the keypoints [px].
    min_score : float
        Least correlation.

    Returns
    -------
    Matches
        With standard deviations, without those that leave their window or do not look alike.
    """
    pixels = np.round(at_first)
    inside = _is_known(first.known, pixels) & _is_known(second.known, np.round(at_second), 3)
    usable = np.flatnonzero(inside)
    if not len(usable):
        none = np.empty((0, 2))
        return Matches(none, none, np.empty(0), none)
    pixels = pixels[usable]
    # Whole pixels in the first need no interpolation; the second follows by as much.
    begin = at_second[usable] + pixels - at_first[usable]
    offset = np.arange(-_HALF, _HALF + 1.0)
    window = np.stack(np.meshgrid(offset, offset, indexing="ij"), axis=-1).reshape(-1, 2)
    rows_and_columns = tuple((pixels[:, None] + window).astype(np.intp).reshape(-1, 2).T)
    template = np.stack([layer[rows_and_columns].reshape(len(usable), -1)
                         for layer in first.values],
                        axis=1).astype(np.float64)
    smooth = [spline_filter(layer.astype(np.float64)) for layer in second.values]
    position = begin.copy()
    active = np.arange(len(usable))
    # Steps of at most a pixel, until none moves by more than a thousandth.
    for _ in range(_MAX_ITERATIONS):
        step = _solve_steps(smooth, template[active], position[active], window)[0]
        position[active] += np.clip(step, -1, 1)
        has_left = np.linalg.norm(position - begin, axis=1) > _MAX_REFINEMENT
        active = active[(np.abs(step).max(axis=1) > _SETTLED_STEP) & ~has_left[active]]
        if not len(active):
            break
    _, sigma, score = _solve_steps(smooth, template, position, window)
    settled = np.ones(len(usable), dtype=bool)
    settled[active] = False
    is_good = (settled & (np.linalg.norm(position - begin, axis=1) <= _MAX_REFINEMENT)
               & (score >= min_score) & np.isfinite(sigma).all(axis=1))
    return Matches(pixels[is_good], position[is_good], score[is_good],
                   np.maximum(sigma[is_good], _MIN_MATCH_SIGMA))


def _is_known(is_known: Mask, at: FloatArray, margin: int = 0) -> Mask:
    """Return whether all pixels of the window of each place (n, 2) are known, (n,).

    `margin` [px] widens the windows.
    """
    reach = _HALF + 1 + margin
    low = at.astype(np.intp) - reach
    high = at.astype(np.intp) + reach
    fits = ((low >= 0) & (high < is_known.shape)).all(axis=1)
    # Sums of unknown pixels over rectangles from a corner: any window is four of them.
    total = np.pad(np.cumsum(np.cumsum(~is_known, axis=0), axis=1), ((1, 0), (1, 0)))
    (top_edge, left_edge) = low[fits].T
    (bottom_edge, right_edge) = high[fits].T + 1
    holes = total[bottom_edge, right_edge] - total[top_edge, right_edge] - total[bottom_edge,
        left_edge] + total[top_edge, left_edge]
    inside = np.zeros(len(at), dtype=bool)
    inside[np.flatnonzero(fits)[holes == 0]] = True
    return inside


def _solve_steps(smooth: list[FloatArray], template: FloatArray, position: FloatArray,
                 window: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a step of least squares for each of n matches, and how well both windows agree there.

    Parameters
    ----------
    smooth : list of ndarray, shape (lines, samples)
        The c layers of the second window, as coefficients of cubic splines.
    template : ndarray, shape (n, c, p)
        The p pixels around each keypoint in the layers of the first window: a square, row by row.
    position : ndarray, shape (n, 2)
        Line and sample in the second window at which the steps begin [px].
    window : ndarray, shape (p, 2)
        Offsets of the p pixels from the middle of a template [px].

    Returns
    -------
    steps, deviations : ndarray, shape (n, 2)
        Steps of line and sample, and standard deviations of the position [px].
    correlations : ndarray, shape (n,)
        Correlation of each template with the second window at its position.
    """
    count, layers, size = template.shape
    width = round(size ** 0.5)

    def at(shift: tuple[float, float]) -> FloatArray:
        samples_at = (position[:, None] + window + shift).reshape(-1, 2).T
        return np.stack([map_coordinates(layer, samples_at, order=3, prefilter=False
                                         ).reshape(count, size) for layer in smooth], axis=1)

    grey = at((0, 0))
    # Derivatives over half a pixel to either side.
    down = at((0.5, 0)) - at((-0.5, 0))
    right = at((0, 0.5)) - at((0, -0.5))
    # The constant of each layer, c0, is eliminated by subtracting the means.
    flat_seen, flat = (values - values.mean(axis=2, keepdims=True) for values in (grey, template))
    power = np.sqrt((flat_seen ** 2).sum(axis=(1, 2)) * (flat ** 2).sum(axis=(1, 2)))
    score = (flat_seen * flat).sum(axis=(1, 2)) / np.maximum(power, 1e-12)
    # template = c0 + c1 (seen + down dl + right ds): linear in c1, c1 dl and c1 ds, and c0 of each
    # layer is what makes its mean zero.
    columns = np.stack([flat_seen, *(values - values.mean(axis=2, keepdims=True)
                                     for values in (down, right))], axis=-1)
    normal = np.einsum("ncpi,ncpj->nij", columns, columns)
    # Windows without texture leave it singular; so small a ridge changes no other step.
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    inverse = np.linalg.inv(normal)
    solution = np.einsum("nij,ncpj,ncp->ni", inverse, columns, flat)
    residuals = flat - np.einsum("ncpi,ni->ncp", columns, solution)
    # Where windows are unlike, c1 is about 0, and steps become too long to be taken.
    contrast = np.where(np.abs(solution[:, 0]) < 1e-6, 1e-6, solution[:, 0])
    step = solution[:, 1:] / contrast[:, None]
    grid = residuals.reshape(count, layers, width, width)
    square = np.maximum((grid ** 2).sum(axis=(1, 2, 3)), 1e-12)
    # Neighbouring residuals have the correlation a. Of n residuals of a process of first order in
    # both directions only n (1 - a)^2 / (1 + a)^2 count as independent; a near 1 leaves none.
    autocorrelation = np.clip(((grid[..., 1:, :] * grid[..., :-1, :]).sum(axis=(1, 2, 3))
                               + (grid[..., 1:] * grid[..., :-1]).sum(axis=(1, 2, 3)))
                              / (2 * square), 0, 0.9)
    # Each layer has lost its constant, and all of them the three coefficients.
    variance = (square / (layers * (size - 1) - 3)
                * ((1 + autocorrelation) / (1 - autocorrelation)) ** 2)
    sigma = np.sqrt(variance[:, None] * np.diagonal(inverse, axis1=1, axis2=2)[:, 1:])
    return step, sigma / np.abs(contrast)[:, None], score
