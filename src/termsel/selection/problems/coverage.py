"""How much of the image the selected features cover."""

from __future__ import annotations

import numpy as np

from termsel.adjustment.compiled import compile_lazily
from termsel.core.arguments import explains_arguments
from termsel.data.features import BoolArray, FloatArray


@compile_lazily
def _fill_hull_areas(x: FloatArray, y: FloatArray, masks: BoolArray, areas: FloatArray) -> None:
    """Write the area of the hull of each selection of points in ascending order of x, then y.

    `x` and `y` are (n,), `masks` (p, n) the selections, and `areas` (p,) receives the areas, 0 of
    fewer than three points. In ascending order the points need no sorting for each selection.
    """
    hull = np.empty(2 * len(x) + 1, dtype=np.intp)
    for individual in range(len(masks)):
        size = 0
        # Andrew's monotone chain: the lower side forward, the upper side backward.
        for direction in range(2):
            base = size
            for step in range(len(x)):
                i = step if direction == 0 else len(x) - 1 - step
                if not masks[individual, i]:
                    continue
                while size - base >= 2:
                    # A point that makes no turn to the left is inside, or on an edge.
                    a = hull[size - 2]
                    b = hull[size - 1]
                    if (x[b] - x[a]) * (y[i] - y[a]) > (y[b] - y[a]) * (x[i] - x[a]):
                        break
                    size -= 1
                hull[size] = i
                size += 1
            if size > base:
                size -= 1  # the other side begins with this point
        # Gauss's formula: twice the area is the sum of x_i y_j - x_j y_i along the hull.
        area = 0.0
        for k in range(size):
            i = hull[k]
            j = hull[(k + 1) % size]
            area += x[i] * y[j] - x[j] * y[i]
        areas[individual] = 0.5 * abs(area)


def hull_areas(points: FloatArray, masks: BoolArray) -> FloatArray:
    """Return the area of the convex hull of points (n, 2) under each mask (p, n), shape (p,).

    It is 0 for fewer than three points, and for points on a straight line.
    """
    order = np.lexsort((points[:, 1], points[:, 0]))
    # Products of coordinates far from the origin would lose digits.
    centred = np.ascontiguousarray((points - points.mean(axis=0))[order].T)
    areas = np.zeros(len(masks))
    _fill_hull_areas(centred[0], centred[1], np.ascontiguousarray(masks[:, order]), areas)
    return areas


@explains_arguments()
def uncovered_share(points: FloatArray, masks: BoolArray) -> FloatArray:
    """Return the share of the image outside the hull of each selection, shape (p,).

    The image is the smallest rectangle around all candidate points (n, 2), where the features lie
    in it. (Covered area as an objective: Konugurthi et al. 2016; their formula could not be
    consulted.)

    Returns
    -------
    ndarray, shape (p,)
        From 0, all covered, to 1.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> corners = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
    >>> masks = np.array([[True, True, True, True], [True, True, True, False]])
    >>> termsel.uncovered_share(corners, masks).tolist()
    [0.0, 0.5]
    """
    area = float(np.prod(np.ptp(points, axis=0)))
    if area <= 0:
        return np.ones(len(masks))
    return np.asarray(1.0 - np.minimum(hull_areas(points, masks) / area, 1.0))
