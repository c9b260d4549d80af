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

_HALF = 10  # px: windows that are compared have 21 px along either side
_ROUNDS = 15
_SETTLED = 1e-3  # px
_FARTHEST = 2.5  # px between the keypoints and the refined place
LEAST_SCORE = 0.5  # correlation
_LEAST_SIGMA = 0.05  # px; models of noise are no better
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


def refined(first: Layers, second: Layers, at_first: FloatArray, at_second: FloatArray,
            least: float = LEAST_SCORE) -> Matches:
    """Return matches at whole pixels of the first picture, their places in the second refined.

    The window of the first is compared with that of the second, shifted, by least squares for
    shift, contrast and brightness. Residuals of neighbouring pixels are alike; the standard
    deviations account for it as for a process of first order in either direction.

    Parameters
    ----------
    first, second : Layers
        Of the same scale and direction.
    at_first, at_second : ndarray, shape (n, 2)
        Line and sample of the keypoints [px].
    least : float
        Least correlation.

    Returns
    -------
    Matches
        With standard deviations, without those that leave their window or do not look alike.
    """
    whole = np.round(at_first)
    inside = _inside(first.known, whole) & _inside(second.known, np.round(at_second), 3)
    kept = np.flatnonzero(inside)
    if not len(kept):
        none = np.empty((0, 2))
        return Matches(none, none, np.empty(0), none)
    whole = whole[kept]
    begin = at_second[kept] + whole - at_first[kept]
    offset = np.arange(-_HALF, _HALF + 1.0)
    window = np.stack(np.meshgrid(offset, offset, indexing="ij"), axis=-1).reshape(-1, 2)
    there = tuple((whole[:, None] + window).astype(np.intp).reshape(-1, 2).T)
    template = np.stack([layer[there].reshape(len(kept), -1) for layer in first.values],
                        axis=1).astype(np.float64)
    smooth = [spline_filter(layer.astype(np.float64)) for layer in second.values]
    place = begin.copy()
    active = np.arange(len(kept))
    for _ in range(_ROUNDS):
        step = _solved(smooth, template[active], place[active], window)[0]
        place[active] += np.clip(step, -1, 1)
        gone = np.linalg.norm(place - begin, axis=1) > _FARTHEST
        active = active[(np.abs(step).max(axis=1) > _SETTLED) & ~gone[active]]
        if not len(active):
            break
    _, sigma, score = _solved(smooth, template, place, window)
    settled = np.ones(len(kept), dtype=bool)
    settled[active] = False
    good = (settled & (np.linalg.norm(place - begin, axis=1) <= _FARTHEST)
            & (score >= least) & np.isfinite(sigma).all(axis=1))
    return Matches(whole[good], place[good], score[good], np.maximum(sigma[good], _LEAST_SIGMA))


def _inside(known: Mask, at: FloatArray, more: int = 0) -> Mask:
    """Return whether all pixels of windows are known."""
    reach = _HALF + 1 + more
    low = at.astype(np.intp) - reach
    high = at.astype(np.intp) + reach
    fits = ((low >= 0) & (high < known.shape)).all(axis=1)
    total = np.pad(np.cumsum(np.cumsum(~known, axis=0), axis=1), ((1, 0), (1, 0)))
    (top, left) = low[fits].T
    (bottom, right) = high[fits].T + 1
    holes = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]
    inside = np.zeros(len(at), dtype=bool)
    inside[np.flatnonzero(fits)[holes == 0]] = True
    return inside


def _solved(smooth: list[FloatArray], template: FloatArray, place: FloatArray,
            window: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return steps (n, 2), standard deviations (n, 2) and correlations (n,) at places.

    Templates have the shape (n, c, p): p pixels of c layers.
    """
    count, layers, size = template.shape
    side = round(size ** 0.5)

    def at(shift: tuple[float, float]) -> FloatArray:
        where = (place[:, None] + window + shift).reshape(-1, 2).T
        return np.stack([map_coordinates(layer, where, order=3, prefilter=False
                                         ).reshape(count, size) for layer in smooth], axis=1)

    seen = at((0, 0))
    down, right = (at((0.5, 0)) - at((-0.5, 0))), (at((0, 0.5)) - at((0, -0.5)))
    flat_seen, flat = (values - values.mean(axis=2, keepdims=True) for values in (seen, template))
    power = np.sqrt((flat_seen ** 2).sum(axis=(1, 2)) * (flat ** 2).sum(axis=(1, 2)))
    score = (flat_seen * flat).sum(axis=(1, 2)) / np.maximum(power, 1e-12)
    # template = c0 + c1 (seen + down dl + right ds): linear in c1, c1 dl and c1 ds, and c0 of each
    # layer is what makes its mean zero.
    columns = np.stack([flat_seen, *(values - values.mean(axis=2, keepdims=True)
                                     for values in (down, right))], axis=-1)
    normal = np.einsum("ncpi,ncpj->nij", columns, columns)
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    inverse = np.linalg.inv(normal)
    solution = np.einsum("nij,ncpj,ncp->ni", inverse, columns, flat)
    residuals = flat - np.einsum("ncpi,ni->ncp", columns, solution)
    contrast = np.where(np.abs(solution[:, 0]) < 1e-6, 1e-6, solution[:, 0])
    step = solution[:, 1:] / contrast[:, None]
    grid = residuals.reshape(count, layers, side, side)
    spread = np.maximum((grid ** 2).sum(axis=(1, 2, 3)), 1e-12)
    alike = np.clip(((grid[..., 1:, :] * grid[..., :-1, :]).sum(axis=(1, 2, 3))
                     + (grid[..., 1:] * grid[..., :-1]).sum(axis=(1, 2, 3))) / (2 * spread), 0, 0.9)
    variance = spread / (layers * (size - 1) - 3) * ((1 + alike) / (1 - alike)) ** 2
    sigma = np.sqrt(variance[:, None] * np.diagonal(inverse, axis1=1, axis2=2)[:, 1:])
    return step, sigma / np.abs(contrast)[:, None], score
