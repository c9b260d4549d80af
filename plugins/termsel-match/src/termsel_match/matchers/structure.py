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

from termsel_match.images.rasters import FloatArray, Grey, stretch_to_bytes
from termsel_match.matchers import Matcher, Matches, Window
from termsel_match.matchers.dense import (
    HALF_WINDOW,
    SHIFT_REACH,
    are_surroundings_known,
    common_shift,
    distinct_places,
    find_peak,
)
from termsel_match.matchers.refinement import Layers, refine_matches

# Number of directions of edges, over half a turn.
_EDGE_DIRECTIONS = 6
# Blurs [px]: of the grey values before their gradient, and of each layer after.
_GREY_BLUR, _LAYER_BLUR = 1.0, 1.5
# Px from unknown pixels, whose edges are none of the ground.
_UNKNOWN_EDGE = 5
# Correlation of layers.
_MIN_CORRELATION = 0.35
# Times the median strength, below which an edge counts less.
_WEAK_EDGE = 0.5


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
        """Return distinct places and where they are in the second (see `Matcher.match`).

        The clearest come first. There are none where a window has too few known pixels, where both
        have no shift in common, or where no place has known surroundings in both.
        """
        none = np.empty((0, 2))
        nothing = Matches(none, none, np.empty(0), none)
        image_layers = edge_layers(first)
        reference_layers = edge_layers(second)
        if image_layers is None or reference_layers is None:
            return nothing
        # One shift for the whole window first: each place then searches a few px only.
        shift = common_shift(image_layers.values, reference_layers.values,
                             np.subtract(first.origin, second.origin),
                             search, whitened=False)
        if shift is None:
            return nothing
        positions = distinct_places(Window(first.pixels, image_layers.known))
        positions = positions[are_surroundings_known(
            positions + shift, reference_layers.known, HALF_WINDOW + SHIFT_REACH)]
        if not len(positions):
            return nothing
        offsets, ambiguity = _offsets_from_shift(
            image_layers.values, reference_layers.values, positions, shift)
        order = np.argsort(ambiguity, kind="stable")
        return refine_matches(image_layers, reference_layers, positions[order],
                              (positions + shift + offsets)[order], _MIN_CORRELATION)


def edge_layers(window: Window) -> Layers | None:
    """Return the strength of edges of each direction (k, lines, samples), with a mean of zero.

    None if the window has no texture or too few known pixels.
    """
    picture = stretch_to_bytes(window.pixels, window.known)
    if picture is None:
        return None
    smooth = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), _GREY_BLUR)
    right, down = (cv2.Sobel(smooth, cv2.CV_32F, *axis, ksize=3) for axis in ((1, 0), (0, 1)))
    width = 2 * _UNKNOWN_EDGE + 1
    is_known = cv2.erode(window.known.astype(np.uint8), np.ones((width, width), dtype=np.uint8),
                         borderValue=0) > 0
    if not is_known.any():
        return None
    turns = np.arange(_EDGE_DIRECTIONS) * np.pi / _EDGE_DIRECTIONS
    # |gx cos t + gy sin t|: the strength of edges of each direction, whichever side is bright.
    values = np.stack([cv2.GaussianBlur(np.abs(right * np.cos(turn) + down * np.sin(turn)), (0, 0),
                                        _LAYER_BLUR) for turn in turns])
    strength = np.sqrt((values**2).sum(axis=0))
    # Relative to the strength of all directions, so that contrast does not count.
    values /= strength + max(_WEAK_EDGE * float(np.median(strength[is_known])), 1e-6)
    values -= values[:, is_known].mean(axis=1)[:, None, None]
    return Layers(np.where(is_known, values, 0).astype(np.float32), is_known)


def _offsets_from_shift(image_layers: Grey, reference_layers: Grey, positions: FloatArray,
                        shift: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return by how much places are off the common shift (n, 2) [px], and how unclear that is (n,).

    Unclear is the second peak over the first: 0 is clear, 1 means two alike.
    """
    # Squares of the second under each window, by which the correlation is normalised.
    energy = cv2.boxFilter((reference_layers**2).sum(axis=0), -1, (2 * HALF_WINDOW + 1,) * 2,
                           normalize=False)
    moved = np.empty_like(positions)
    clear = np.empty(len(positions))
    for i, position in enumerate(positions.astype(int)):
        at = position + shift.astype(int)
        template = image_layers[:, position[0] - HALF_WINDOW:position[0] + HALF_WINDOW + 1,
                                position[1] - HALF_WINDOW:position[1] + HALF_WINDOW + 1]
        reach = HALF_WINDOW + SHIFT_REACH
        rows, columns = (slice(middle - reach, middle + reach + 1) for middle in at)
        correlation = sum(cv2.matchTemplate(layer[rows, columns], window, cv2.TM_CCORR)
                          for layer, window in zip(reference_layers, np.ascontiguousarray(template),
                                                   strict=True))
        around = energy[at[0] - SHIFT_REACH:at[0] + SHIFT_REACH + 1,
                        at[1] - SHIFT_REACH:at[1] + SHIFT_REACH + 1]
        likeness = correlation / np.sqrt(np.maximum(around * (template**2).sum(), 1e-12))
        moved[i], best, next_best = find_peak(np.asarray(likeness, dtype=np.float64))
        clear[i] = max(next_best, 0.0) / best if best > 0 else 1.0
    return moved, clear
