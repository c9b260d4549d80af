"""Points that lie far from all others on the ground, but among them or next to them in the image.

What predicts such a point from the others extrapolates, so that the test of `termsel.auto.blunders`
says little of it: a polynomial may bend back. An image does not fold, though. The ground that is
seen between the others lies between them, but for far ground that an oblique view shows over near
summits. A degree or a digit that is wrong in a coordinate makes such a point.
"""

from __future__ import annotations

import numpy as np

from termsel.data.coordinates.places import distance_beyond_hull
from termsel.data.features import BoolArray, Points
from termsel.data.record.chances import quantile_of

MIN_CORE = 5
"""Points that must lie together for another one to be far from them."""

TYPICAL_SHARE = 0.75
"""Share of the points whose distance from the median is the usual one."""

FAR = 3.0
"""Distance from the median on the ground, by the usual one along that axis, beyond which a point is
far: of points spread evenly none is beyond 1.4."""

FAR_BEYOND = 0.5
"""Distance from the hull of the other points on the ground, by the side of their box, that is
beyond dispute for a point among them in the image."""

FORESHORTENING = 4.0
"""What is added to it by the distance from their hull in the image."""


def misplaced_points(points: Points) -> BoolArray:
    """Return which points, (n,), are far from the others on the ground, but not in the image.

    No point is where fewer than `MIN_CORE` points, or fewer than two thirds of all, lie together.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> x = np.array([0.0, 0.0, 1.0, 1.0, 0.5, 20.5])
    >>> y = np.array([0.0, 1.0, 0.0, 1.0, 0.6, 0.4])
    >>> image = np.column_stack([y, np.append(x[:5], 0.5)])
    >>> ground = np.column_stack([x, y, np.zeros(6)])
    >>> misplaced_points(termsel.Points(tuple("abcdef"), image, ground))
    array([False, False, False, False, False,  True])
    """
    no_point = np.zeros(len(points), dtype=bool)
    if len(points) <= MIN_CORE:
        return no_point
    plan = points.ground[:, :2]
    distances = np.abs(plan - np.median(plan, axis=0))
    usual_distances = np.array([quantile_of(along_axis, TYPICAL_SHARE)
                                for along_axis in distances.T])
    is_far = (distances > FAR * usual_distances).any(axis=1)
    in_core = ~is_far
    if not is_far.any() or in_core.sum() < max(MIN_CORE, 2 * len(points) / 3):
        return no_point
    beyond_on_ground = distance_beyond_hull(plan[in_core], plan)
    beyond_in_image = distance_beyond_hull(points.image[in_core], points.image)
    return np.asarray(is_far & (beyond_on_ground > FAR_BEYOND + FORESHORTENING * beyond_in_image))
