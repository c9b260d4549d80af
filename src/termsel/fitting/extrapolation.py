"""How far the places a model is used at lie outside the control it was fitted to."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from termsel.core.errors import counted
from termsel.data.coordinates.places import beyond, centres
from termsel.data.features import BoolArray, FeatureSet, FloatArray, Points
from termsel.data.fit_data import FitData, off_plane
from termsel.data.scaling import Scaling
from termsel.fitting.uncertainty import sees_heights

FAR = 0.5
"""Distance from the hull of the control, by the hull's longer side, from which on a place counts
as far outside: a quadratic term is then 4 times what it is at the hull's edge."""


def outside(control: FloatArray, places: FloatArray) -> FloatArray:
    """Return how far places on the ground (m, 3) are outside the control (n, 3), shape (m,).

    Distance from the hull by its longer side, or above or below its heights by their range,
    whichever is larger; 0 inside. Infinite if the control has no hull, NaN for no place.
    """
    apart = beyond(control[:, :2], places[:, :2])
    low = control[:, 2].min()
    high = control[:, 2].max()
    if high > low:
        above = np.maximum(places[:, 2] - high, low - places[:, 2]) / (high - low)
        apart = np.maximum(apart, np.where(np.isnan(above), 0.0, above))
    return np.asarray(np.where(np.isnan(places[:, :2]).any(axis=1), np.nan, apart))


def by_heights(used: FeatureSet, scaling: Scaling, project: Callable[[FloatArray], FloatArray],
               ground: FloatArray) -> FloatArray:
    """Return the variance of what a height does at places (m, 3) where nothing tells, (m, 1) [px].

    0 where the control in use tells it, and where the model, which projects places, knows it.
    """
    effect = off_plane(FitData(used, scaling, False), ground)[1]
    if effect.any() and sees_heights(project, ground):
        effect *= 0.0
    return effect[:, None]**2 / 2  # the direction is not known


def warnings_of(control: FeatureSet, used: BoolArray, check: Points) -> Iterator[str]:
    """Yield what is to be said of check points and image corners far outside the control.

    Of the control, features in the adjustment count: `used`, shape (len(control),).
    """
    mine = centres(control)[used]
    found = []
    n = 0
    if len(check):
        far = beyond(mine, check.image) > FAR
        if far.any():
            n += int(far.sum())
            found.append(f"{far.sum()} of {counted(len(far), 'selection point')}")
    if control.image_size is not None:
        lines, samples = control.image_size
        corners = np.array([(i, j) for i in (0.0, lines - 1.0) for j in (0.0, samples - 1.0)])
        far = beyond(mine, corners) > FAR
        if far.any():
            n += int(far.sum())
            found.append(f"{far.sum()} of 4 corners of the image")
    if found:
        yield (f"Extrapolation: {' and '.join(found)} lie{'s' * (n == 1)} far outside the control "
               "in use. The RMSE does not apply there.")
    heights = control.ground_vertices()[:, 2]
    others = check.ground[:, 2]
    span = float(np.ptp(heights))
    if len(others) and span > 0:
        above = np.maximum(others - heights.max(), heights.min() - others)
        n = int((above > FAR * span).sum())
        if n:
            yield (f"Extrapolation: {counted(n, 'selection point')} lie{'s' * (n == 1)} far above "
                   "or below the control.")
