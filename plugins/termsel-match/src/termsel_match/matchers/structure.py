"""Matching by the directions of edges, whichever side of them is bright.

References
----------
Ye, Bruzzone, Shan, Bovolo, Zhu 2019: Fast and robust matching for multimodal remote sensing image
registration. IEEE Transactions on Geoscience and Remote Sensing 57(11), 9059-9070: channel features
of orientated gradients, compared by Fourier transforms. The paper finds the best position in a
window around each place; here the shift of the whole window comes first.
"""

from __future__ import annotations

import cv2
import numpy as np

from termsel_match.images.rasters import FloatArray, Grey, stretched
from termsel_match.matchers import Matcher, Matches, Window
from termsel_match.matchers.dense import (
    HALF,
    REACH,
    common_shift,
    distinct_places,
    inside,
    peak,
)
from termsel_match.matchers.refinement import Layers, refined

_DIRECTIONS = 6  # of edges, over half a turn
_FINE, _WIDE = 1.0, 1.5  # px: grey is smoothed before its gradient, and each layer after
_EDGE = 5  # px from unknown pixels, whose edges are none of the ground
_LEAST = 0.35  # correlation of layers
_WEAK = 0.5  # times the median strength, below which an edge counts less


class Structure(Matcher):
    """Directions of edges: for other contrast, such as near infrared against visible, or radar.

    Which side of an edge is bright does not count. Layers of the edges of six directions are
    compared: first of the whole window, then of 41 x 41 px around distinct places, then by least
    squares to sub-pixel.

    References
    ----------
    Ye et al. 2019, IEEE Transactions on Geoscience and Remote Sensing 57(11), 9059-9070.
    """

    name = "structure"
    places_exactly = True

    def match(self, first: Window, second: Window, search: float) -> Matches:
        """Return distinct places and where they are in the second (see `Matcher.match`)."""
        none = np.empty((0, 2))
        nothing = Matches(none, none, np.empty(0), none)
        own = layers(first)
        other = layers(second)
        if own is None or other is None:
            return nothing
        shift = common_shift(own.values, other.values, np.subtract(first.origin, second.origin),
                             search, whitened=False)
        if shift is None:
            return nothing
        places = distinct_places(Window(first.pixels, own.known))
        places = places[inside(places + shift, other.known, HALF + REACH)]
        if not len(places):
            return nothing
        moved, clear = _near(own.values, other.values, places, shift)
        order = np.argsort(clear, kind="stable")
        return refined(own, other, places[order], (places + shift + moved)[order], _LEAST)


def layers(window: Window) -> Layers | None:
    """Return how strong edges of each direction are, with a mean of zero; None for no texture."""
    picture = stretched(window.pixels, window.known)
    if picture is None:
        return None
    smooth = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), _FINE)
    right, down = (cv2.Sobel(smooth, cv2.CV_32F, *axis, ksize=3) for axis in ((1, 0), (0, 1)))
    side = 2 * _EDGE + 1
    known = cv2.erode(window.known.astype(np.uint8), np.ones((side, side), dtype=np.uint8),
                      borderValue=0) > 0
    if not known.any():
        return None
    turns = np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS
    values = np.stack([cv2.GaussianBlur(np.abs(right * np.cos(turn) + down * np.sin(turn)), (0, 0),
                                        _WIDE) for turn in turns])
    strength = np.sqrt((values**2).sum(axis=0))
    values /= strength + max(_WEAK * float(np.median(strength[known])), 1e-6)
    values -= values[:, known].mean(axis=1)[:, None, None]
    return Layers(np.where(known, values, 0).astype(np.float32), known)


def _near(own: Grey, other: Grey, places: FloatArray, shift: FloatArray,
          ) -> tuple[FloatArray, FloatArray]:
    """Return by how much places are off the shift, (n, 2) [px], and how unclear that is, (n,)."""
    energy = cv2.boxFilter((other**2).sum(axis=0), -1, (2 * HALF + 1,) * 2, normalize=False)
    moved = np.empty_like(places)
    clear = np.empty(len(places))
    for i, place in enumerate(places.astype(int)):
        at = place + shift.astype(int)
        template = own[:, place[0] - HALF:place[0] + HALF + 1, place[1] - HALF:place[1] + HALF + 1]
        rows, columns = (slice(middle - HALF - REACH, middle + HALF + REACH + 1) for middle in at)
        found = sum(cv2.matchTemplate(layer[rows, columns], part, cv2.TM_CCORR)
                    for layer, part in zip(other, np.ascontiguousarray(template), strict=True))
        around = energy[at[0] - REACH:at[0] + REACH + 1, at[1] - REACH:at[1] + REACH + 1]
        likeness = found / np.sqrt(np.maximum(around * (template**2).sum(), 1e-12))
        moved[i], best, next_best = peak(np.asarray(likeness, dtype=np.float64))
        clear[i] = max(next_best, 0.0) / best if best > 0 else 1.0
    return moved, clear
