"""Places of features in the image and on the ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from termsel.data.features import FeatureSet, FloatArray, IntArray

ROUNDING = 1e-14
"""Twice the area of a triangle in a box of side 1 whose corners lie on one line. Large coordinates
are rounded more."""


def spatial_order(xy: ArrayLike) -> IntArray:
    """Return an order (n,) of points (n, 2): neighbours in it are neighbours in the plane."""
    xy = np.asarray(xy, dtype=np.float64)
    order = np.arange(len(xy))
    starts = np.zeros(1, dtype=np.intp)
    # The points are halved repeatedly at the median of their longer side; the order is that of the
    # leaves.
    while (sizes := np.diff(starts, append=len(xy))).max(initial=0) > 2:
        part = np.repeat(np.arange(len(starts)), sizes)
        there = xy[order]
        side = np.argmax(np.maximum.reduceat(there, starts)
                         - np.minimum.reduceat(there, starts), axis=1)
        # Parts of one or two points are ready.
        along = np.where(sizes[part] > 2, there[np.arange(len(xy)), side[part]], 0.0)
        order = order[np.lexsort((along, part))]
        divided = sizes > 2
        starts = np.sort(np.concatenate([starts, (starts + sizes // 2)[divided]]))
    return order


def centres(control: FeatureSet) -> FloatArray:
    """Return the image position of each feature, the middle for lines, shape (f, 2)."""
    lines = control.lines
    return np.concatenate([control.points.image, lines.by_feature(lines.image.mean(axis=1))])


def ground_centres(control: FeatureSet) -> FloatArray:
    """Return the plane ground position of each feature, the middle for lines, shape (f, 2)."""
    lines = control.lines
    return np.concatenate([control.points.ground[:, :2],
                           lines.by_feature(lines.ground[..., :2].mean(axis=1))])


def beyond(control: FloatArray, places: FloatArray) -> FloatArray:
    """Return how far places (m, 2) are outside the convex hull of the control (n, 2), shape (m,).

    The largest distance from a side of the hull, divided by the longer side of the control's box; 0
    inside, infinite if the control has no hull.
    """
    corners = control[hull(control)]
    if not len(corners):
        return np.full(len(places), np.inf)
    along = np.roll(corners, -1, axis=0) - corners
    normals = np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    with np.errstate(over="ignore"):  # places near the largest number are infinitely far
        outside = (places @ normals.T - (corners * normals).sum(axis=1)).max(axis=1)
        return np.asarray(np.maximum(outside, 0.0) / np.ptp(control, axis=0).max())


def hull(places: FloatArray) -> list[int]:
    """Return the corners of the convex hull of places (n, 2), against the clock; none on one line.

    By A.M. Andrew, Information Processing Letters 9 (1979) 216-219; to import SciPy's takes long.
    """
    size = np.ptp(places, axis=0).max(initial=0.0) if len(places) > 2 else 0.0
    if not 0.0 < size < np.inf:
        return []
    scaled = (places - places.mean(axis=0)) / size
    least = max(ROUNDING, 8 * np.finfo(float).eps * float(np.abs(places).max()) / size)
    order = np.lexsort(scaled.T[::-1]).tolist()
    (x, y) = scaled.T.tolist()
    corners: list[int] = []
    for half in (order, order[::-1]):
        some: list[int] = []
        for i in half:
            while len(some) > 1:
                a, b = some[-2:]
                if (x[b] - x[a]) * (y[i] - y[a]) - (y[b] - y[a]) * (x[i] - x[a]) > least:
                    break
                some.pop()
            some.append(i)
        corners += some[:-1]
    return corners if len(corners) > 2 else []
