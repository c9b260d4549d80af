"""Places of features in the image and on the ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from termsel.measurements.features import FeatureSet, FloatArray, IntArray


def spatial_order(xy: ArrayLike) -> IntArray:
    """Return an order (n,) of points (n, 2): neighbours in it are neighbours in the plane."""
    xy = np.asarray(xy, dtype=np.float64)
    order, starts = np.arange(len(xy)), np.zeros(1, dtype=np.intp)
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
    from scipy.spatial import ConvexHull, QhullError

    try:
        sides = ConvexHull(control).equations
    except (QhullError, ValueError):  # fewer than three, or on one line
        return np.full(len(places), np.inf)
    with np.errstate(over="ignore"):  # places near the largest number are infinitely far
        outside = (places @ sides[:, :2].T + sides[:, 2]).max(axis=1)
        return np.asarray(np.maximum(outside, 0.0) / np.ptp(control, axis=0).max())
