"""Where an image lies on the Earth."""

from __future__ import annotations

import numpy as np

from termsel import Result
from termsel.toolkit import FloatArray, to_wgs84

_SIDE = 9  # places along either side of the image


def outline_of(result: Result) -> FloatArray:
    """Return longitude and latitude of the image's outline, closed, counter-clockwise (n, 2).

    At the middle height of the control; without a size of the image of the rectangle around them.
    """
    features, fitted = result.features, result.exported
    seen = features.image_vertices()
    low, high = seen.min(axis=0), seen.max(axis=0)
    if features.image_size is not None:
        low, high = np.zeros(2), np.array(features.image_size) - 1.0
    share = np.linspace(0.0, 1.0, _SIDE)[:-1]
    zero, one = np.zeros(_SIDE - 1), np.ones(_SIDE - 1)
    around = np.concatenate([np.column_stack(pair) for pair in (
        (zero, share), (share, one), (one, 1 - share), (1 - share, zero))])
    height = float(fitted.ground_box()[0][2])
    ground = fitted.locate(low + around * (high - low), np.full(len(around), height))
    places = to_wgs84(features.crs)(ground)[:, :2]
    if not np.isfinite(places).all():
        known = to_wgs84(features.crs)(np.nan_to_num(result.residuals.ground))[:, :2]
        least, most = known.min(axis=0), known.max(axis=0)
        places = np.array([least, [most[0], least[1]], most, [least[0], most[1]]])
    x, y = places.T
    if x @ np.roll(y, -1) - y @ np.roll(x, -1) < 0:
        places = places[::-1]
    return np.asarray(np.round(np.concatenate([places, places[:1]]), 9))
