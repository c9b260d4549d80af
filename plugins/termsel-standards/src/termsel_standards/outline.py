"""Where an image lies on the Earth."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull

from termsel import Fit, Result
from termsel.toolkit import FloatArray
from termsel.toolkit.coordinates import to_wgs84
from termsel.toolkit.models import ground_where_held, image_places

# Places along either side of the image.
_SIDE = 9


def outline_of(result: Result) -> FloatArray:
    """Return longitude and latitude of the image's outline, closed, counter-clockwise (n, 2).

    At the middle height of the control; without a size of the image of the rectangle around them.
    Of an oblique view it goes around what lies below the horizon, as far as the model holds.
    """
    features = result.features
    fitted = result.exported
    measured = features.image_vertices()
    low = measured.min(axis=0)
    high = measured.max(axis=0)
    if features.image_size is not None:
        low = np.zeros(2)
        high = np.array(features.image_size) - 1.0
    # Around the four edges of the image, some places along each.
    share = np.linspace(0.0, 1.0, _SIDE)[:-1]
    zero = np.zeros(_SIDE - 1)
    end = np.ones(_SIDE - 1)
    around = np.concatenate([np.column_stack(pair) for pair in (
        (zero, share), (share, end), (end, 1 - share), (1 - share, zero))])
    height = float(fitted.ground_box()[0][2])
    ground = fitted.locate(low + around * (high - low), np.full(len(around), height))
    if fitted.view is not None and not fitted.holds(ground).all():
        ground = _hull_of_valid_ground(fitted, height)
    lonlat = to_wgs84(features.crs)(ground)[:, :2]
    # Beyond the horizon there is no ground: then the rectangle around the features.
    if not np.isfinite(lonlat).all():
        control_lonlat = to_wgs84(features.crs)(np.nan_to_num(result.residuals.ground))[:, :2]
        low_corner = control_lonlat.min(axis=0)
        high_corner = control_lonlat.max(axis=0)
        lonlat = np.array([low_corner, [high_corner[0], low_corner[1]], high_corner,
                           [low_corner[0], high_corner[1]]])
    x, y = lonlat.T
    # The shoelace formula: a negative area runs clockwise.
    if x @ np.roll(y, -1) - y @ np.roll(x, -1) < 0:
        lonlat = lonlat[::-1]
    return np.asarray(np.round(np.concatenate([lonlat, lonlat[:1]]), 9))


def _hull_of_valid_ground(fitted: Fit, height: float) -> FloatArray:
    """Return the hull (n, 3) of the ground on which a model is valid, at a height [m]."""
    ground = ground_where_held(fitted, image_places(fitted), height)
    # Places beyond the horizon have no ground; the hull goes around the others.
    ground = ground[np.isfinite(ground).all(axis=1)]
    return np.asarray(ground[ConvexHull(ground[:, :2]).vertices])
