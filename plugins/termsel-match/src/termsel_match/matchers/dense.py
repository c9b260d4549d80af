"""The shift of a whole window, by Fourier transforms, and then that of each part of it.

One shift for a window is found far more surely than one for a part of it, as all of its structure
takes part. Parts are then only looked for near it.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2

from termsel_match.images.rasters import FloatArray, Grey, Mask, stretch_to_bytes
from termsel_match.matchers import Window

HALF_WINDOW = 20
"""Px: parts have 41 px along either side."""
SHIFT_REACH = 6
"""Px by which the shift of a part may differ from that of the window."""
# Px between places that are tried.
_PLACE_DISTANCE = 9
# Px for each place, the most distinct.
_PLACE_AREA = 900
# Standard deviations of all shifts by which the best must exceed their mean.
_DISTINCT = 5.0
# Px around the best shift that are not another one.
_ALIKE_SHIFT = 3


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
    # Padded to the sum of both sizes, so that no shift comes round; sizes that are fast to
    # transform.
    shape = [next_fast_len(a + b, real=True)
             for a, b in zip(first.shape[1:], second.shape[1:], strict=True)]
    product = np.zeros((shape[0], shape[1] // 2 + 1), dtype=np.complex64)
    for layer, layer_second in zip(first, second, strict=True):
        product += np.conj(rfft2(layer, shape)) * rfft2(layer_second, shape)
    # Phase correlation: the amplitude of each frequency is divided out.
    if whitened:
        product /= np.maximum(np.abs(product), 1e-6 * max(float(np.abs(product).max()), 1e-30))
    surface = irfft2(product, shape)
    reach = int(np.ceil(search))
    middle = np.round(expected).astype(int)
    steps = np.arange(-reach, reach + 1)
    # Shifts within the search around the expected one, of a surface that is periodic.
    values = surface[np.ix_((middle[0] + steps) % shape[0], (middle[1] + steps) % shape[1])]
    values = np.where(np.hypot(steps[:, None], steps) <= search, values, -np.inf)
    top = np.unravel_index(int(values.argmax()), values.shape)
    finite = values[np.isfinite(values)]
    if not values[top] > finite.mean() + _DISTINCT * finite.std():
        return None
    return np.asarray(middle + steps[np.array(top)], dtype=np.float64)


def distinct_places(window: Window) -> FloatArray:
    """Return positions of a window that a matcher can locate in both directions, as corners are.

    They are whole lines and samples (n, 2) [px], the most distinct first; n is 0 if the window is
    too uniform. All pixels around each of them are known.
    """
    picture = stretch_to_bytes(window.pixels, window.known)
    width = 2 * (HALF_WINDOW + 1) + 1
    # Windows of places must be known as a whole.
    inner = cv2.erode(window.known.astype(np.uint8), np.ones((width, width), dtype=np.uint8),
                      borderValue=0)
    if picture is None or not inner.any():
        return np.empty((0, 2))
    corners = cv2.goodFeaturesToTrack(
        cv2.GaussianBlur(picture, (0, 0), 1.5), maxCorners=1 + window.pixels.size // _PLACE_AREA,
        qualityLevel=0.001, minDistance=_PLACE_DISTANCE, mask=inner, blockSize=9)
    if corners is None:
        return np.empty((0, 2))
    return np.asarray(np.round(corners[:, 0, ::-1]), dtype=np.float64)


def are_surroundings_known(positions: FloatArray, is_known: Mask, reach: int) -> Mask:
    """Return whether all pixels within `reach` px of positions (n, 2) [px] are known, (n,).

    `is_known` (lines, samples) says which pixels of the window are.
    """
    # Erosion leaves the pixels whose whole square is known; the border of the window is unknown.
    width = 2 * reach + 1
    surroundings_known = cv2.erode(is_known.astype(np.uint8),
                                   np.ones((width, width), dtype=np.uint8), borderValue=0)
    at = np.round(positions).astype(int)
    is_inside = np.asarray(((at >= 0) & (at < is_known.shape)).all(axis=1))
    is_inside[is_inside] = surroundings_known[tuple(at[is_inside].T)] > 0
    return is_inside


def find_peak(surface: FloatArray) -> tuple[FloatArray, float, float]:
    """Return where a correlation surface is largest, that value, and the height of the next peak.

    The first is line and sample (2,), from the middle of the surface [px]. The next peak is the
    largest value that is not within a few px of the first.
    """
    top = np.array(np.unravel_index(int(surface.argmax()), surface.shape))
    best = float(surface[tuple(top)])
    # Surroundings of the peak are nearly as high as it, and tell nothing of its uniqueness.
    low = np.maximum(top - _ALIKE_SHIFT, 0)
    rest_of_surface = surface.copy()
    rest_of_surface[low[0]:top[0] + _ALIKE_SHIFT + 1, low[1]:top[1] + _ALIKE_SHIFT + 1] = -np.inf
    return top - (np.array(surface.shape) - 1) / 2, best, float(rest_of_surface.max())
