"""Whether the stated RMSE holds between the control points, too.

Points held out show errors where points are. Where points lie in clusters, or in pairs, each that
is held out has neighbours in the fit, and its error says little of the places between. What the
model says of its own uncertainty there is then above the interval of the RMSE.

Independent check points show errors where they are: next to control the model follows the control.
Of check points anywhere in the area half are as far from control as half of the area is.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from termsel.core.errors import rounded_size_text
from termsel.data.coordinates.clusters import cluster_labels
from termsel.data.coordinates.metres import plan_of
from termsel.data.coordinates.nearest import nearest_points
from termsel.data.coordinates.places import convex_hull, distance_beyond_hull
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.data.record.cautions import BESIDE_CONTROL, BETWEEN_POINTS
from termsel.data.record.figures import Predicted
from termsel.fitting.fit import Fit
from termsel.fitting.local_courses import LOCAL_MIN_POINTS

CLEAR_GAP = 2.0
"""Least ratio of the distance between clusters to that within them."""

PLACES_ALONG_A_SIDE = 8
"""Places along a side of the box of the control, of which those in its hull are looked at."""

NEXT_TO_CONTROL = 0.25
"""Distance from control, by that of half of the area, up to which a check point is next to it: so
near are 4 % of places at random."""

MIN_CHECK_POINTS = 3
"""Independent check points below which chance may put most of them next to control."""

FARTHER = 1.25
"""Mean distance of places from control, by that of control points from each other, up to which
errors held out are those of places. It is 1.1 at most of 20 points or more at random, 0.4 of those
of a grid; in no scene with the caution was it below 1.6 (87 of 503, simulated)."""

LOOKED_AT = 200
"""Points whose distances from the others are looked at, where there are more."""

MIN_POINTS = 5
"""Points below which the interval of the RMSE and the uncertainty are little more than beliefs."""

NEGLIGIBLE = 0.01
"""Uncertainty [px] that nobody measures."""


def uncertain_between_points(fitted: Fit, predicted: Predicted) -> Iterator[str]:
    """Yield a sentence if the model is less certain within the hull of its points than its RMSE.

    The root mean square of the standard deviations over the hull is held against the upper end of
    the interval of the RMSE. There is no sentence with lines, with few points, and with many that
    cover their hull evenly.
    """
    points = fitted.control.take(fitted.used).points
    if len(points) < MIN_POINTS or len(fitted.control.lines):
        return
    places = places_within_hull(points.ground)
    if not len(places):
        return
    # Of fewer points the uncertainty is large for want of any, and soon known.
    if len(points) >= LOCAL_MIN_POINTS and is_even(points.ground, places):
        return
    with np.errstate(all="ignore"):
        sigma = np.hypot(*fitted.sigma(places).T)
    sigma = sigma[np.isfinite(sigma)]
    if not len(sigma):
        return
    uncertainty = float(np.sqrt((sigma**2).mean()))
    if uncertainty <= max(predicted.high, NEGLIGIBLE):
        return
    plan = plan_of(fitted.control.crs, points.ground)
    clusters = None if plan is None else cluster_labels(plan, CLEAR_GAP)
    where = "the points" if clusters is None else f"the {clusters.max() + 1} clusters of points"
    yield (f"{BETWEEN_POINTS}{where} the map may be off by {rounded_size_text(uncertainty)} px: "
           "the RMSE holds near them only. Measure points between them, or see termsel sigma.")


def checked_next_to_control(control: FeatureSet, independent: Points) -> Iterator[str]:
    """Yield a sentence if most independent check points lie next to control points.

    There is none with lines, and with few points of either kind.
    """
    count = len(independent)
    if count < MIN_CHECK_POINTS or len(control.points) < MIN_POINTS or len(control.lines):
        return
    ground = control.points.ground
    plan = plan_of(control.crs, np.vstack([ground, places_within_hull(ground), independent.ground]))
    if plan is None or len(plan) == len(ground) + count:
        return
    of_control, of_area, of_check = np.split(plan, [len(ground), len(plan) - count])
    # How far a place within the hull usually is from the nearest control point.
    usual = float(np.median(nearest_points(of_control, of_area)[0]))
    distances = nearest_points(of_control, of_check)[0]
    near = int((distances <= NEXT_TO_CONTROL * usual).sum())
    if 2 * near <= count:
        return
    verb = "lie" if near > 1 else "lies"
    yield (f"{near} of {count} independent check points {verb}{BESIDE_CONTROL}: their errors are "
           "those next to control, and farther away errors may be several times as large. Check at "
           "places away from control.")


def is_even(ground: FloatArray, places: FloatArray) -> bool:
    """Return whether points (n, 3) are as far from each other as places (m, 3) are from them.

    A point that is held out is then as far from the others as a place between is from control, and
    its error shows that of the place. Distances are by the extent of the points.
    """
    extent = np.ptp(ground[:, :2], axis=0)
    plan = ground[:, :2] / extent
    some = plan[::-(-len(plan) // LOOKED_AT)]
    to_others = nearest_points(plan, some, 2)[0][:, 1]
    to_control = nearest_points(plan, places[:, :2] / extent)[0]
    return bool(to_control.mean() <= FARTHER * to_others.mean())


def places_within_hull(ground: FloatArray) -> FloatArray:
    """Return places (m, 3) over the convex hull of points on the ground (n, 3).

    Each place has the height of the nearest point. There is no place, m is 0, where the points lie
    on one line.
    """
    plan = ground[:, :2]
    if not convex_hull(plan):
        return np.empty((0, 3))
    # In the middle of as many cells along each side, so that none is on the hull itself.
    steps = (np.arange(PLACES_ALONG_A_SIDE) + 0.5) / PLACES_ALONG_A_SIDE
    low = plan.min(axis=0)
    extent = np.ptp(plan, axis=0)
    grid = low + extent * np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    grid = grid[distance_beyond_hull(plan, grid) == 0.0]
    distances = np.linalg.norm((grid[:, None] - plan) / extent, axis=2)
    return np.column_stack([grid, ground[distances.argmin(axis=1), 2]])
