"""Points that lie far from all others on the ground, but among them or next to them in the image.

What predicts such a point from the others extrapolates, so that the test of `termsel.auto.blunders`
says little of it: a polynomial may bend back. An image does not fold, though. The ground that is
seen between the others lies between them, but for far ground that an oblique view shows over near
summits. A degree or a digit that is wrong in a coordinate makes such a point.

Towards the horizon ground becomes far within few pixels, and no model of the nearer points knows
how far. The nearer points show how much the scale changes, though: by how much each of them lies
off an affine map of all others. A point is out of place only if it lies off that map by many times
as much, which the scale of a map or of a vertical view makes clear, and that of an oblique view or
a panorama never.
"""

from __future__ import annotations

import numpy as np

from termsel.data.coordinates.places import distance_beyond_hull
from termsel.data.features import BoolArray, FloatArray, Points
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

LEAST_REDUNDANCY = 1e-9
"""1 - h of a point that the others do not check, as rounding leaves it."""

MAX_AFFINE_STRAIN = 60.0
"""Distance from the affine map of the others, by the RMS of theirs, that foreshortening explains.
Ground near the horizon of oblique views and panoramas has at most 41 in 207 simulated cases, a
degree that is wrong on satellite images and old maps 150 or more."""


def misplaced_points(points: Points) -> tuple[BoolArray, BoolArray]:
    """Return which points are far from the others on the ground, but not in the image.

    The first mask, (n,), is of those that no view shows there, the second, (n,), of those that a
    view with such foreshortening as the others show might. No point is named where fewer than
    `MIN_CORE` points, or fewer than two thirds of all, lie together.

    Examples
    --------
    >>> import numpy as np
    >>> import termsel
    >>> x = np.array([0.0, 0.0, 1.0, 1.0, 0.5, 20.5])
    >>> y = np.array([0.0, 1.0, 0.0, 1.0, 0.6, 0.4])
    >>> image = np.column_stack([y, np.append(x[:5], 0.5)])
    >>> ground = np.column_stack([x, y, np.zeros(6)])
    >>> misplaced_points(termsel.Points(tuple("abcdef"), image, ground))[0]
    array([False, False, False, False, False,  True])
    """
    no_point = np.zeros(len(points), dtype=bool)
    if len(points) <= MIN_CORE:
        return no_point, no_point
    plan = points.ground[:, :2]
    distances = np.abs(plan - np.median(plan, axis=0))
    # Quantiles, which a few points far away do not move.
    usual_distances = np.array([quantile_of(along_axis, TYPICAL_SHARE)
                                for along_axis in distances.T])
    is_far: BoolArray = np.any(distances > FAR * usual_distances, axis=1)
    in_core = ~is_far
    if not is_far.any() or in_core.sum() < max(MIN_CORE, 2 * len(points) / 3):
        return no_point, no_point
    beyond_on_ground = distance_beyond_hull(plan[in_core], plan)
    beyond_in_image = distance_beyond_hull(points.image[in_core], points.image)
    is_folded = is_far & (beyond_on_ground > FAR_BEYOND + FORESHORTENING * beyond_in_image)
    may_be_seen = _explained_by_foreshortening(plan, points.image, in_core)
    return is_folded & ~may_be_seen, is_folded & may_be_seen


def _explained_by_foreshortening(plan: FloatArray, image: FloatArray,
                                 in_core: BoolArray) -> BoolArray:
    """Return a mask (n,) of the points that a change of scale as within the core may put there.

    `plan` and `image` (n, 2) are places and positions, `in_core` (n,) is the mask of the core.
    Points of the core are held against the affine map of its others: with the leverage h and the
    residual r their error is r / (1 - h). Other points are predicted with the variance 1 + h.
    """
    design = np.column_stack([np.ones(len(image)), _by_box_of(image, in_core)])
    ground = _by_box_of(plan, in_core)
    coefficients = np.linalg.lstsq(design[in_core], ground[in_core])[0]
    errors = np.linalg.norm(ground - design @ coefficients, axis=1)
    # The leverage of any place a is that of its weights for the core, a' (A'A)^-1 A'.
    leverage = ((design @ np.linalg.pinv(design[in_core]))**2).sum(axis=1)
    redundancy = np.maximum(1.0 - leverage[in_core], LEAST_REDUNDANCY)
    rms = np.sqrt(((errors[in_core] / redundancy)**2).mean())
    return np.asarray(errors <= MAX_AFFINE_STRAIN * rms * np.sqrt(1.0 + leverage))


def _by_box_of(positions: FloatArray, in_core: BoolArray) -> FloatArray:
    """Return positions (n, 2) about the middle of the core, by the sides of its box."""
    sides = np.ptp(positions[in_core], axis=0)
    return np.asarray((positions - positions[in_core].mean(axis=0))
                      / np.where(sides > 0.0, sides, 1.0))
