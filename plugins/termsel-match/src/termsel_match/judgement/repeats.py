"""Ground that repeats itself: where it does, a match may be right by its looks, and elsewhere."""

from __future__ import annotations

from itertools import product
from typing import Any

import cv2
import numpy as np
from scipy.ndimage import maximum_filter

from termsel_match.images.rasters import FloatArray, GreyRaster

_COMPARED_SIDE = 512
"""Side of a window of the reference that is compared with itself [px]."""

_COARSE = 8.0
"""Standard deviation of the blur that separates brightness from texture [px]."""

_MIN_DISTANCE = 20
"""Least displacement of a copy that is compared [px]: nearer positions look alike anyway."""

_OVERLAP = 0.2
"""Least share of the window that a displaced copy must share with it."""

_ENOUGH = 128**2
"""Fewest pixels that both must share: small parts are alike by chance."""

_AS_MUCH = 0.9
"""Correlation, divided by the largest, of the nearest displacement that is reported."""
ALIKE = 0.5
"""Correlation of the ground with its displaced copy from which on it repeats itself."""


def repetition_distance(picture: GreyRaster, positions: FloatArray) -> tuple[float, float]:
    """Return at which distance a picture repeats itself, and how well the repetition correlates.

    Up to five windows, in the middle of the positions and towards their corners, are compared with
    their displaced copies by the normalised correlation of what is known of both (Padfield 2012).

    Parameters
    ----------
    picture : GreyRaster
        The picture.
    positions : ndarray, shape (n, 2)
        Positions in the part of the picture that matters, line and sample [px]; NaN for a position
        outside it.

    Returns
    -------
    distance : float
        The least displacement with nearly the largest correlation [px of the picture]; 0 where
        nothing can be compared.
    correlation : float
        The largest correlation of all displacements, at most 1.

    References
    ----------
    Padfield 2012: Masked object registration in the Fourier domain. IEEE Transactions on Image
    Processing 21(5), 2706-2718.
    """
    best = (0.0, 0.0)
    known_places = positions[np.isfinite(positions).all(axis=1)]
    if not len(known_places):
        return best
    low = np.clip(known_places.min(axis=0), 0, picture.size)
    extents = np.ceil(np.clip(known_places.max(axis=0) + 1, low, picture.size) - low).astype(int)
    room = [max(0, extent - _COMPARED_SIDE) for extent in extents.tolist()]
    # One window in the middle; towards the corners only where the area is larger than a window.
    corners = {(0.5, 0.5), *(product((0.2, 0.8), repeat=2) if min(room) else ())}
    for share in sorted(corners):
        first_line, first_sample = (int(first + free * fraction)
                                    for first, free, fraction in zip(low, room, share, strict=True))
        pixels, is_known = picture.read(first_line, first_sample,
                                        *(min(_COMPARED_SIDE, extent)
                                          for extent in extents.tolist()))
        if pixels.size == 0:
            continue
        self_likeness = _window_repetition(pixels.astype(np.float64), is_known.astype(np.float64))
        best = max(best, self_likeness, key=lambda candidate: candidate[1])
    return best


def _window_repetition(pixels: FloatArray, is_known: FloatArray) -> tuple[float, float]:
    """Return the distance [px] at which a window repeats itself, and the correlation there.

    `pixels` (lines, samples) are its brightness, and `is_known` is 1 for the pixels that are known
    and 0 for others. Both are 0 if too little of the window is known.
    """
    # Brightness over tens of pixels is no texture. A blur of the known pixels, divided by the same
    # blur of their mask, is the brightness, and is subtracted.
    weight = cv2.GaussianBlur(is_known, (0, 0), _COARSE)
    coarse = cv2.GaussianBlur(pixels * is_known, (0, 0), _COARSE) / np.maximum(weight, 1e-6)
    fine = (pixels - coarse) * is_known
    # Padded to twice the size, so that displaced copies do not wrap around.
    shape = [2 * extent for extent in fine.shape]
    of_fine, of_known, of_squares = (np.fft.rfft2(layer, shape)
                                     for layer in (fine, is_known, fine**2))

    def correlated(a: Any, b: Any) -> FloatArray:
        """Return the correlation of two layers at each displacement, from their transforms."""
        return np.asarray(np.fft.irfft2(a * np.conj(b), shape))

    overlap = correlated(of_known, of_known)
    # Squares of each copy over what both know, at every displacement.
    power_here = correlated(of_squares, of_known)
    power_displaced = correlated(of_known, of_squares)
    power = np.sqrt(np.maximum(power_here, 0) * np.maximum(power_displaced, 0))
    distance = np.hypot(*np.meshgrid(*(np.fft.fftfreq(extent, 1 / extent) for extent in shape),
                                     indexing="ij"))
    # Near displacements are alike anyway, and small overlaps are alike by chance.
    used = (distance >= _MIN_DISTANCE) & (power > 1e-9 * power.max()) & (
        overlap >= max(_OVERLAP * is_known.size, _ENOUGH))
    if not used.any():
        return 0.0, 0.0
    correlation = np.where(used, correlated(of_fine, of_fine) / np.where(used, power, 1), -1)
    # Of the peaks (no larger value within 2 px) nearly as high as the highest, the nearest.
    largest = correlation.max()
    peaks = correlation == maximum_filter(correlation, 5, mode="wrap")
    nearly_largest = peaks & (correlation >= _AS_MUCH * largest)
    return float(distance[nearly_largest].min()), float(largest)
