"""How far the places a model is used at lie outside the control it was fitted to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from termsel.core.errors import count_in_words, first_names_in_words
from termsel.data.coordinates.longitudes import beside_control
from termsel.data.coordinates.places import convex_hull, distance_beyond_hull, feature_centres
from termsel.data.features import BoolArray, FeatureSet, FloatArray, Points
from termsel.data.fit_data import FitData, distance_off_plane
from termsel.data.record.cautions import EXTRAPOLATION
from termsel.data.scaling import Scaling
from termsel.fitting.uncertainty import sees_heights

FAR_OUTSIDE = 0.5
"""Distance from the hull of the control, by the hull's longer side, from which on a place counts
as far outside: a quadratic term is then 4 times what it is at the hull's edge."""


def distance_outside_control(control: FloatArray, ground: FloatArray) -> FloatArray:
    """Return how far places on the ground (m, 3) are outside the control (n, 3), shape (m,).

    That is the distance from the hull, divided by its longer side, or the height above or below
    the control's heights, divided by their range, whichever is larger. It is 0 inside, infinite if
    the control has no hull, and NaN where x or y is.
    """
    distances = distance_beyond_hull(control[:, :2], ground[:, :2])
    low = control[:, 2].min()
    high = control[:, 2].max()
    if high > low:
        above = np.maximum(ground[:, 2] - high, low - ground[:, 2]) / (high - low)
        distances = np.maximum(distances, np.where(np.isnan(above), 0.0, above))
    return np.asarray(np.where(np.isnan(ground[:, :2]).any(axis=1), np.nan, distances))


def distance_beside_control(control: FloatArray, ground: FloatArray,
                            features: FeatureSet) -> FloatArray:
    """Return `distance_outside_control` of places by whole turns next to the control.

    The CRS is that of `features`, which have the control.
    """
    near_control = ground.copy()
    near_control[:, 0] = beside_control(ground[:, 0], features)
    return distance_outside_control(control, near_control)


def far_places_in_words(control: FloatArray, ground: FloatArray, names: Sequence[str],
                        noun: str = "point") -> str:
    """Return a clause on places (m, 3) far outside the control (n, 3), with what may be the reason.

    `names` are those of the places, which it calls by the `noun`; "" if there are no places.
    """
    if not len(ground):
        return ""
    clause = (f"{count_in_words(len(ground), noun)} {'is' if len(ground) == 1 else 'are'} far "
              f"outside the control, and the model is not valid there: "
              f"{first_names_in_words(names)}")
    exchanged = ground.copy()
    exchanged[:, :2] = ground[:, 1::-1]
    if (distance_outside_control(control, exchanged) > FAR_OUTSIDE).any():
        return clause
    x, y = control[:, :2].mean(axis=0)
    return (f"{clause}. Their x and y look exchanged, as the control is around x = {x:,.6g}, "
            f"y = {y:,.6g}: exchange the two columns")


def far_rows_in_words(control: FloatArray, ground: FloatArray, features: FeatureSet) -> str:
    """Return a clause on those rows of an array of places (m, 3) that are far outside, or ""."""
    # A control without an area says nothing of what is outside.
    if not convex_hull(control[:, :2]):
        return ""
    is_far = distance_beside_control(control, ground, features) > FAR_OUTSIDE
    rows = [str(row) for row in np.flatnonzero(is_far)]
    return far_places_in_words(control, ground[is_far], rows, "row")


def variance_by_heights(used: FeatureSet, scaling: Scaling,
                        project: Callable[[FloatArray], FloatArray],
                        ground: FloatArray) -> FloatArray:
    """Return the variance (m, 1) [px^2] of unknown effects of heights at places (m, 3).

    It is 0 where the control in use shows the effect of heights, and where the model knows it:
    `project` then puts places of unlike heights at unlike image positions.
    """
    effect = distance_off_plane(FitData(used, scaling, False), ground)[1]
    if effect.any() and sees_heights(project, ground):
        effect *= 0.0
    return effect[:, None]**2 / 2  # the direction is not known


def warnings_of(control: FeatureSet, used: BoolArray, check: Points) -> Iterator[str]:
    """Yield sentences on selection points and image corners far outside the control, if any.

    Selection points far above or below all control are named, too. The mask `used` (n,) marks the
    features of the control that are in the adjustment; others do not count.
    """
    control_centres = feature_centres(control)[used]
    groups = []
    n_outside = 0
    if len(check):
        far = distance_beyond_hull(control_centres, check.image) > FAR_OUTSIDE
        if far.any():
            n_outside += int(far.sum())
            groups.append(f"{far.sum()} of {count_in_words(len(far), 'selection point')}")
    if control.image_size is not None:
        far = distance_beyond_hull(control_centres, corners_of(control.image_size)) > FAR_OUTSIDE
        if far.any():
            n_outside += int(far.sum())
            groups.append(f"{far.sum()} of 4 corners of the image")
    if groups:
        yield (f"{EXTRAPOLATION}{' and '.join(groups)} {_lie_or_lies(n_outside)} far outside "
               "the control in use. The RMSE does not apply there.")
    # Heights by themselves: a point within the hull may be on a summit far above all control.
    heights = control.ground_vertices()[:, 2]
    check_heights = check.ground[:, 2]
    span = float(np.ptp(heights))
    if len(check_heights) and span > 0:
        above = np.maximum(check_heights - heights.max(), heights.min() - check_heights)
        n_above = int((above > FAR_OUTSIDE * span).sum())
        if n_above:
            yield (f"{EXTRAPOLATION}{count_in_words(n_above, 'selection point')} "
                   f"{_lie_or_lies(n_above)} far "
                   "above or below the control.")


def corners_of(image_size: tuple[int, int]) -> FloatArray:
    """Return line and sample (4, 2) of the corners of an image."""
    last_line, last_sample = np.array(image_size) - 1.0
    return np.array([(0.0, 0.0), (0.0, last_sample), (last_line, 0.0), (last_line, last_sample)])


def _lie_or_lies(count: int) -> str:
    """Return the verb of a sentence on so many points."""
    return "lies" if count == 1 else "lie"
