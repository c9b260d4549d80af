"""The shift of a whole window, by Fourier transforms, and then that of each part of it.

One shift for a window is found far more surely than one for a part of it, as all of its structure
takes part. Parts are then only looked for near it.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2

from termsel_match.images.rasters import FloatArray, Grey, Mask, stretched
from termsel_match.matchers import Window

HALF = 20
"""Px: parts have 41 px along either side."""
REACH = 6
"""Px by which the shift of a part may differ from that of the window."""
_APART = 9  # px between places that are tried
_AREA = 900  # px for each place, the most distinct
_DISTINCT = 5.0  # standard deviations of all shifts by which the best must exceed their mean
_ALIKE = 3  # px around the best shift that are not another one


def common_shift(first: Grey, second: Grey, expected: FloatArray, search: float, *,
                 whitened: bool) -> FloatArray | None:
    """Return the shift at which two stacks of layers agree best [px]; None if none stands out.

    Parameters
    ----------
    first, second : ndarray, shapes (c, a, b) and (c, d, e)
        Zero where nothing is known.
    expected : ndarray, shape (2,)
        Position in the second, less that in the first [px].
    search : float
        Largest distance from it [px].
    whitened : bool
        Whether all frequencies count alike (phase correlation).
    """
    shape = [next_fast_len(a + b, real=True)
             for a, b in zip(first.shape[1:], second.shape[1:], strict=True)]
    product = np.zeros((shape[0], shape[1] // 2 + 1), dtype=np.complex64)
    for one, other in zip(first, second, strict=True):
        product += np.conj(rfft2(one, shape)) * rfft2(other, shape)
    if whitened:
        product /= np.maximum(np.abs(product), 1e-6 * max(float(np.abs(product).max()), 1e-30))
    surface = irfft2(product, shape)
    reach = int(np.ceil(search))
    middle = np.round(expected).astype(int)
    steps = np.arange(-reach, reach + 1)
    values = surface[np.ix_((middle[0] + steps) % shape[0], (middle[1] + steps) % shape[1])]
    values = np.where(np.hypot(steps[:, None], steps) <= search, values, -np.inf)
    top = np.unravel_index(int(values.argmax()), values.shape)
    finite = values[np.isfinite(values)]
    if not values[top] > finite.mean() + _DISTINCT * finite.std():
        return None
    return np.asarray(middle + steps[np.array(top)], dtype=np.float64)


def distinct_places(window: Window) -> FloatArray:
    """Return whole pixels with structure in both directions, (n, 2), the most distinct first."""
    picture = stretched(window.pixels, window.known)
    side = 2 * (HALF + 1) + 1
    inner = cv2.erode(window.known.astype(np.uint8), np.ones((side, side), dtype=np.uint8),
                      borderValue=0)
    if picture is None or not inner.any():
        return np.empty((0, 2))
    corners = cv2.goodFeaturesToTrack(
        cv2.GaussianBlur(picture, (0, 0), 1.5), maxCorners=1 + window.pixels.size // _AREA,
        qualityLevel=0.001, minDistance=_APART, mask=inner, blockSize=9)
    if corners is None:
        return np.empty((0, 2))
    return np.asarray(np.round(corners[:, 0, ::-1]), dtype=np.float64)


def inside(places: FloatArray, known: Mask, reach: int) -> Mask:
    """Return whether all pixels around places are known."""
    side = 2 * reach + 1
    there = cv2.erode(known.astype(np.uint8), np.ones((side, side), dtype=np.uint8), borderValue=0)
    at = np.round(places).astype(int)
    within = np.asarray(((at >= 0) & (at < known.shape)).all(axis=1))
    within[within] = there[tuple(at[within].T)] > 0
    return within


def peak(surface: FloatArray) -> tuple[FloatArray, float, float]:
    """Return the place of the largest value from the middle [px], it, and the next largest."""
    top = np.array(np.unravel_index(int(surface.argmax()), surface.shape))
    best = float(surface[tuple(top)])
    low = np.maximum(top - _ALIKE, 0)
    others = surface.copy()
    others[low[0]:top[0] + _ALIKE + 1, low[1]:top[1] + _ALIKE + 1] = -np.inf
    return top - (np.array(surface.shape) - 1) / 2, best, float(others.max())
