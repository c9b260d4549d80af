"""Distinct places of two pictures that look alike, to sub-pixel.

References
----------
Lowe 2004: Distinctive image features from scale-invariant keypoints. IJCV 60, 91-110: detector,
descriptor and the ratio of the nearest to the second nearest.
Arandjelovic, Zisserman 2012: Three things everyone should know to improve object retrieval. CVPR:
RootSIFT, the square root of the descriptor divided by its sum.
Gruen 1985: Adaptive least squares correlation. South African Journal of Photogrammetry, Remote
Sensing and Cartography 14, 175-187: the position by least squares of grey values.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

from termsel_match.images.rasters import FloatArray, Grey, Mask, stretched

RATIO = 0.9  # of the distances to the nearest and the second nearest descriptor
_AREA = 60  # px for each keypoint, the strongest
_CONTRAST = 0.015
_HALF = 10  # px: windows that are compared have 21 px along either side
_ROUNDS = 15
_SETTLED = 1e-3  # px
_FARTHEST = 2.5  # px between the keypoints and the refined place
LEAST_SCORE = 0.5  # correlation
_LEAST_SIGMA = 0.05  # px; models of noise are no better


@dataclass(frozen=True, eq=False)
class Pairs:
    """Places of two pictures that look alike.

    Parameters
    ----------
    first, second : ndarray, shape (n, 2)
        Line and sample in either picture [px].
    sigma : ndarray, shape (n, 2)
        Standard deviations of line and sample of their difference [px].
    score : ndarray, shape (n,)
        Correlation of the windows, at most 1.
    """

    first: FloatArray
    second: FloatArray
    sigma: FloatArray
    score: FloatArray


def described(pixels: Grey, known: Mask) -> tuple[FloatArray, Grey]:
    """Return keypoints, line and sample, shape (n, 2), and RootSIFT descriptors, (n, 128)."""
    picture = stretched(pixels, known)
    if picture is None:
        return np.empty((0, 2)), np.empty((0, 128), dtype=np.float32)
    # Edges of the data are no texture.
    inner = cv2.erode(known.astype(np.uint8), np.ones((9, 9), dtype=np.uint8), borderValue=0)
    detector = cv2.SIFT_create(nfeatures=1 + pixels.size // _AREA, contrastThreshold=_CONTRAST)
    keypoints, vectors = detector.detectAndCompute(picture, inner)
    if not keypoints:
        return np.empty((0, 2)), np.empty((0, 128), dtype=np.float32)
    vectors = np.sqrt(vectors / np.maximum(vectors.sum(axis=1, keepdims=True), 1e-9))
    return np.array([keypoint.pt[::-1] for keypoint in keypoints]), vectors


def alike(first: Grey, second: Grey, ratio: float = RATIO,
          ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the pairs of descriptors that are each other's nearest, the clearest first.

    Parameters
    ----------
    first, second : ndarray, shape (n, 128) and (m, 128)
    ratio : float
        Largest distance to the nearest, as part of that to the second nearest.
    """
    if len(first) < 2 or len(second) < 2:
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    likeness = first @ second.T  # of unit vectors: distance^2 = 2 - 2 likeness
    at, n = likeness.argmax(axis=1), np.arange(len(first))
    best = likeness[n, at]
    likeness[n, at] = -1.0
    second_best = likeness.max(axis=1)
    likeness[n, at] = best
    near, next_near = (np.sqrt(np.maximum(2 - 2 * value, 0)) for value in (best, second_best))
    relative = near / np.maximum(next_near, 1e-9)
    order = np.argsort(relative, kind="stable")
    order = order[(relative[order] < ratio) & (likeness.argmax(axis=0)[at[order]] == order)]
    return order, at[order]


def refined(first: tuple[Grey, Mask], second: tuple[Grey, Mask], at_first: FloatArray,
            at_second: FloatArray) -> Pairs:
    """Return pairs at whole pixels of the first picture, their places in the second refined.

    The window of the first is compared with that of the second, shifted, by least squares for
    shift, contrast and brightness. Residuals of neighbouring pixels are alike; the standard
    deviations account for it as for a process of first order in either direction.

    Parameters
    ----------
    first, second : tuple of ndarray
        Grey and where they are known; the pictures have the same scale and direction.
    at_first, at_second : ndarray, shape (n, 2)
        Line and sample of the keypoints [px].

    Returns
    -------
    Pairs
        Without those that leave their window or do not look alike.
    """
    whole = np.round(at_first)
    inside = _inside(first[1], whole) & _inside(second[1], np.round(at_second), 3)
    kept = np.flatnonzero(inside)
    if not len(kept):
        none = np.empty((0, 2))
        return Pairs(none, none, none, np.empty(0))
    whole = whole[kept]
    begin = at_second[kept] + whole - at_first[kept]
    offset = np.arange(-_HALF, _HALF + 1.0)
    window = np.stack(np.meshgrid(offset, offset, indexing="ij"), axis=-1).reshape(-1, 2)
    template = first[0][tuple((whole[:, None] + window).astype(np.intp).reshape(-1, 2).T)]
    template = template.reshape(len(kept), -1).astype(np.float64)
    smooth = spline_filter(second[0].astype(np.float64))
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
            & (score >= LEAST_SCORE) & np.isfinite(sigma).all(axis=1))
    return Pairs(whole[good], place[good], np.maximum(sigma[good], _LEAST_SIGMA), score[good])


def _inside(known: Mask, at: FloatArray, more: int = 0) -> Mask:
    """Return whether all pixels of windows are known."""
    reach = _HALF + 1 + more
    low, high = at.astype(np.intp) - reach, at.astype(np.intp) + reach
    fits = ((low >= 0) & (high < known.shape)).all(axis=1)
    total = np.pad(np.cumsum(np.cumsum(~known, axis=0), axis=1), ((1, 0), (1, 0)))
    (top, left), (bottom, right) = low[fits].T, high[fits].T + 1
    holes = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]
    inside = np.zeros(len(at), dtype=bool)
    inside[np.flatnonzero(fits)[holes == 0]] = True
    return inside


def _solved(smooth: FloatArray, template: FloatArray, place: FloatArray, window: FloatArray,
            ) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return steps (n, 2), standard deviations (n, 2) and correlations (n,) at places."""
    count, size = template.shape
    side = round(size ** 0.5)

    def at(shift: tuple[float, float]) -> FloatArray:
        where = (place[:, None] + window + shift).reshape(-1, 2).T
        return np.asarray(map_coordinates(smooth, where, order=3, prefilter=False)
                          ).reshape(count, size)

    seen = at((0, 0))
    down, right = (at((0.5, 0)) - at((-0.5, 0))), (at((0, 0.5)) - at((0, -0.5)))
    flat_seen, flat = seen - seen.mean(axis=1, keepdims=True), \
        template - template.mean(axis=1, keepdims=True)
    power = np.sqrt((flat_seen ** 2).sum(axis=1) * (flat ** 2).sum(axis=1))
    score = (flat_seen * flat).sum(axis=1) / np.maximum(power, 1e-12)
    # template = c0 + c1 (seen + down dl + right ds): linear in c0, c1, c1 dl and c1 ds.
    columns = np.stack([np.ones_like(seen), seen, down, right], axis=-1)
    normal = np.einsum("npi,npj->nij", columns, columns)
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(4)
    inverse = np.linalg.inv(normal)
    solution = np.einsum("nij,npj,np->ni", inverse, columns, template)
    residuals = template - np.einsum("npi,ni->np", columns, solution)
    contrast = np.where(np.abs(solution[:, 1]) < 1e-6, 1e-6, solution[:, 1])
    step = solution[:, 2:] / contrast[:, None]
    grid = residuals.reshape(count, side, side)
    spread = np.maximum((grid ** 2).sum(axis=(1, 2)), 1e-12)
    alike = np.clip(((grid[:, 1:] * grid[:, :-1]).sum(axis=(1, 2))
                     + (grid[:, :, 1:] * grid[:, :, :-1]).sum(axis=(1, 2))) / (2 * spread), 0, 0.9)
    variance = spread / (size - 4) * ((1 + alike) / (1 - alike)) ** 2
    sigma = np.sqrt(variance[:, None] * np.diagonal(inverse, axis1=1, axis2=2)[:, 2:])
    return step, sigma / np.abs(contrast)[:, None], score
