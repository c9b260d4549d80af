"""Ground that repeats itself: where it does, a match may be right by its looks, and elsewhere."""

from __future__ import annotations

from itertools import product
from typing import Any

import cv2
import numpy as np
from scipy.ndimage import maximum_filter

from termsel_match.images.rasters import FloatArray, GreyRaster

_SIDE = 512  # px of the reference that are compared with themselves
_COARSE = 8.0  # px of the standard deviation of what is taken for brightness, and not for texture
_LEAST = 20  # px: nearer places look alike anyway
_OVERLAP = 0.2  # part of the window that a displaced copy must share with it
_ENOUGH = 128**2  # px that it must share at least: parts of small chips are alike by chance
_AS_MUCH = 0.9  # of the largest correlation
ALIKE = 0.5
"""Correlation of the ground with its displaced copy from which on it repeats itself."""


def repetition(picture: GreyRaster, places: FloatArray) -> tuple[float, float]:
    """Return at which distance a picture is like itself, and how much.

    Up to five windows, in the middle of the places and towards their corners, are compared with
    their displaced copies: by the normalised correlation of what is known of both (Padfield 2012,
    "Masked object registration in the Fourier domain", IEEE TIP 21(5), 2706-2718).

    Parameters
    ----------
    picture : GreyRaster
    places : ndarray, shape (n, 2)
        Line and sample of what matters of it [px]; NaN for none.

    Returns
    -------
    distance : float
        The least at which it is about as much so as anywhere [px of the picture]; 0 where
        nothing can be compared.
    correlation : float
        At most 1.
    """
    best = (0.0, 0.0)
    known_places = places[np.isfinite(places).all(axis=1)]
    if not len(known_places):
        return best
    low = np.clip(known_places.min(axis=0), 0, picture.size)
    extents = np.ceil(np.clip(known_places.max(axis=0) + 1, low, picture.size) - low).astype(int)
    room = [max(0, extent - _SIDE) for extent in extents.tolist()]
    corners = {(0.5, 0.5), *(product((0.2, 0.8), repeat=2) if min(room) else ())}
    for share in sorted(corners):
        top, left = (int(first + free * part)
                     for first, free, part in zip(low, room, share, strict=True))
        pixels, known = picture.read(top, left,
                                     *(min(_SIDE, extent) for extent in extents.tolist()))
        if pixels.size == 0:
            continue
        found = _alike(pixels.astype(np.float64), known.astype(np.float64))
        best = max(best, found, key=lambda one: one[1])
    return best


def _alike(pixels: FloatArray, known: FloatArray) -> tuple[float, float]:
    """Return the distance [px] and the correlation of `repetition`, of one window."""
    weight = cv2.GaussianBlur(known, (0, 0), _COARSE)
    coarse = cv2.GaussianBlur(pixels * known, (0, 0), _COARSE) / np.maximum(weight, 1e-6)
    fine = (pixels - coarse) * known
    shape = [2 * extent for extent in fine.shape]
    of_fine, of_known, of_squares = (np.fft.rfft2(one, shape) for one in (fine, known, fine**2))

    def correlated(a: Any, b: Any) -> FloatArray:
        return np.asarray(np.fft.irfft2(a * np.conj(b), shape))

    overlap = correlated(of_known, of_known)
    here, there = correlated(of_squares, of_known), correlated(of_known, of_squares)
    power = np.sqrt(np.maximum(here, 0) * np.maximum(there, 0))
    away = np.hypot(*np.meshgrid(*(np.fft.fftfreq(extent, 1 / extent) for extent in shape),
                                 indexing="ij"))
    used = (away >= _LEAST) & (power > 1e-9 * power.max()) & (
        overlap >= max(_OVERLAP * known.size, _ENOUGH))
    if not used.any():
        return 0.0, 0.0
    like = np.where(used, correlated(of_fine, of_fine) / np.where(used, power, 1), -1)
    peaks = like == maximum_filter(like, 5, mode="wrap")
    return float(away[peaks & (like >= _AS_MUCH * like.max())].min()), float(like.max())
