"""Distinct places by SIFT.

References
----------
Lowe 2004: Distinctive image features from scale-invariant keypoints. IJCV 60, 91-110: detector,
descriptor and the ratio of the nearest to the second nearest.
Arandjelovic, Zisserman 2012: Three things everyone should know to improve object retrieval. CVPR:
RootSIFT, the square root of the descriptor divided by its sum.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from termsel_match.images.rasters import FloatArray, Grey, Mask, stretch_to_bytes
from termsel_match.matchers import Matcher, Matches, Window

# Largest ratio of the distances to the nearest and the second nearest descriptor.
RATIO = 0.9
# Px for each keypoint, the strongest.
_KEYPOINT_AREA = 60
_CONTRAST = 0.015


class Sift(Matcher):
    """Keypoints whose descriptors are each other's nearest: for images of the same contrast.

    It finds no places where one image is bright and the other dark.

    References
    ----------
    Lowe 2004, International Journal of Computer Vision 60, 91-110.
    """

    name = "sift"

    def match(self, first: Window, second: Window, search: float) -> Matches:
        """Return keypoints that are each other's nearest (see `Matcher.match`)."""
        keypoints, vectors = describe_keypoints(first.pixels, first.known)
        keypoints_second, vectors_second = describe_keypoints(second.pixels, second.known)
        number, other_number = mutual_nearest(vectors, vectors_second)
        likeness = np.einsum("ij,ij->i", vectors[number], vectors_second[other_number])
        return Matches(keypoints[number], keypoints_second[other_number],
                       likeness.astype(np.float64))


def describe_keypoints(pixels: Grey, is_known: Mask) -> tuple[FloatArray, Grey]:
    """Return the keypoints of a window, and a RootSIFT descriptor of each.

    Parameters
    ----------
    pixels, is_known : ndarray, shape (lines, samples)
        Brightness, and which pixels are known.

    Returns
    -------
    keypoints : ndarray, shape (n, 2)
        Line and sample in the window [px].
    vectors : ndarray of float32, shape (n, 128)
        Descriptors of unit length.

    References
    ----------
    Arandjelovic and Zisserman 2012: Three things everyone should know to improve object retrieval.
    CVPR, 2911-2918.
    """
    picture = stretch_to_bytes(pixels, is_known)
    if picture is None:
        return np.empty((0, 2)), np.empty((0, 128), dtype=np.float32)
    # Edges of the data are no texture.
    inner = cv2.erode(is_known.astype(np.uint8), np.ones((9, 9), dtype=np.uint8), borderValue=0)
    detector = cv2.SIFT_create(nfeatures=1 + pixels.size // _KEYPOINT_AREA,
                               contrastThreshold=_CONTRAST)
    keypoints, vectors = detector.detectAndCompute(picture, inner)
    if not keypoints:
        return np.empty((0, 2)), np.empty((0, 128), dtype=np.float32)
    # RootSIFT: square roots of the entries divided by their sum, so that Euclidean distances of
    # the descriptors are Hellinger distances of the histograms.
    vectors = np.sqrt(vectors / np.maximum(vectors.sum(axis=1, keepdims=True), 1e-9))
    return np.array([keypoint.pt[::-1] for keypoint in keypoints]), vectors


def mutual_nearest(first: Grey, second: Grey, ratio: float = RATIO,
                   ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the pairs of descriptors that are each other's nearest, the clearest first.

    Parameters
    ----------
    first, second : ndarray, shape (n, 128) and (m, 128)
        Descriptors of unit length.
    ratio : float
        Largest distance to the nearest, as part of that to the second nearest.

    Returns
    -------
    number, other_number : ndarray of int, shape (k,)
        Rows of `first` and of `second` that are a pair.
    """
    if len(first) < 2 or len(second) < 2:
        return np.zeros(0, dtype=np.intp), np.zeros(0, dtype=np.intp)
    # For unit vectors, distance^2 = 2 - 2 likeness.
    likeness = first @ second.T
    at = likeness.argmax(axis=1)
    n = np.arange(len(first))
    best = likeness[n, at]
    likeness[n, at] = -1.0
    second_best = likeness.max(axis=1)
    likeness[n, at] = best
    # Lowe's ratio: clear is what is much nearer than the second nearest.
    near, next_near = (np.sqrt(np.maximum(2 - 2 * value, 0)) for value in (best, second_best))
    relative = near / np.maximum(next_near, 1e-9)
    order = np.argsort(relative, kind="stable")
    # Each must be the nearest of the other, too.
    order = order[(relative[order] < ratio) & (likeness.argmax(axis=0)[at[order]] == order)]
    return order, at[order]
