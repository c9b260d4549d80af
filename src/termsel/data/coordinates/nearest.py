"""The nearest of some points to each of some places."""

from __future__ import annotations

import numpy as np

from termsel.data.features import FloatArray, IntArray

MAX_PAIRS = 1_000_000
"""Pairs of places and points up to which all distances take less time than to import a tree."""


def nearest_points(points: FloatArray, places: FloatArray,
                   count: int = 1) -> tuple[FloatArray, IntArray]:
    """Return the distances to the nearest points of each place, and the numbers of these points.

    Both are (m, count) for places (m, d) and points (n, d), the nearest first. All coordinates are
    finite, and `count` is n at most.
    """
    if len(places) * len(points) > MAX_PAIRS:
        from scipy.spatial import cKDTree  # only here, as it takes 0.3 s to import

        distances, numbers = cKDTree(points).query(places, k=[*range(1, count + 1)])
        return distances, np.asarray(numbers, dtype=np.intp)
    squares = np.zeros((len(places), len(points)))
    for place, point in zip(places.T, points.T, strict=True):
        squares += np.subtract.outer(place, point) ** 2
    numbers = np.argpartition(squares, count - 1, axis=1)[:, :count]
    order = np.take_along_axis(squares, numbers, axis=1).argsort(axis=1, kind="stable")
    numbers = np.take_along_axis(numbers, order, axis=1)
    return np.sqrt(np.take_along_axis(squares, numbers, axis=1)), numbers
