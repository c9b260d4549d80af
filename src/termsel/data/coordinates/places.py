"""Places of features in the image and on the ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from termsel.data.features import FeatureSet, FloatArray, IntArray

AREA_ROUNDING = 1e-14
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
        group = np.repeat(np.arange(len(starts)), sizes)
        ordered = xy[order]
        longer_axis = np.argmax(np.maximum.reduceat(ordered, starts)
                                - np.minimum.reduceat(ordered, starts), axis=1)
        # Parts of one or two points are ready.
        coordinate = np.where(sizes[group] > 2,
                              ordered[np.arange(len(xy)), longer_axis[group]], 0.0)
        order = order[np.lexsort((coordinate, group))]
        # New parts begin in the middle of each part that was halved.
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


def beyond(control: FloatArray, positions: FloatArray) -> FloatArray:
    """Return how far positions (m, 2) are outside the convex hull of the control (n, 2), (m,).

    The largest distance from a side of the hull, divided by the longer side of the control's box; 0
    inside, infinite if the control has no hull.
    """
    corners = control[hull(control)]
    if not len(corners):
        return np.full(len(positions), np.inf)
    sides = np.roll(corners, -1, axis=0) - corners
    # Outward unit normals: corners run against the clock, so to the right of each side.
    normals = np.column_stack([sides[:, 1], -sides[:, 0]]) / np.linalg.norm(sides, axis=1)[:, None]
    with np.errstate(over="ignore"):  # places near the largest number are infinitely far
        outside = (positions @ normals.T - (corners * normals).sum(axis=1)).max(axis=1)
        return np.asarray(np.maximum(outside, 0.0) / np.ptp(control, axis=0).max())


def hull(positions: FloatArray) -> list[int]:
    """Return the corners of the convex hull of positions (n, 2), against the clock.

    None where all lie on one line.

    By A.M. Andrew, Information Processing Letters 9 (1979) 216-219; to import SciPy's takes long.
    """
    size = np.ptp(positions, axis=0).max(initial=0.0) if len(positions) > 2 else 0.0
    if not 0.0 < size < np.inf:
        return []
    scaled = (positions - positions.mean(axis=0)) / size
    # Below this double area three corners count as one line: rounding of coordinates far from 0 is
    # larger, in units of the box.
    rounding = max(AREA_ROUNDING, 8 * np.finfo(float).eps * float(np.abs(positions).max()) / size)
    order = np.lexsort(scaled.T[::-1]).tolist()
    (x, y) = scaled.T.tolist()
    corners: list[int] = []
    # The lower chain from left to right, then the upper one back.
    for half in (order, order[::-1]):
        chain: list[int] = []
        for i in half:
            while len(chain) > 1:
                a, b = chain[-2:]
                if (x[b] - x[a]) * (y[i] - y[a]) - (y[b] - y[a]) * (x[i] - x[a]) > rounding:
                    break
                chain.pop()
            chain.append(i)
        corners += chain[:-1]
    return corners if len(corners) > 2 else []
