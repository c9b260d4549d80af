"""Longitudes and latitudes that a CRS counts in other units than degrees, such as grads."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from termsel.data.coordinates.crs import axes_of_degrees, is_geographic, normalise, short_crs_name
from termsel.data.features import FeatureSet

log = logging.getLogger(__name__)


def with_degrees(features: FeatureSet) -> FeatureSet:
    """Return features in degrees, of such whose CRS counts longitude and latitude in another unit.

    The CRS is the same but for its unit: datum and prime meridian stay. Columns whose names state
    their unit are in degrees already.
    """
    if not is_geographic(features.crs):
        return features
    per_unit, crs = axes_of_degrees(normalise(features.crs))
    if per_unit == 1.0:
        return features
    factors = np.array([1.0 if axis in features.named_units else per_unit for axis in "xy"] + [1.0])
    log.info("Note: %s does not count in degrees: %sall results are in degrees of its datum.",
             short_crs_name(features.crs),
             "" if features.named_units else f"x and y are multiplied by {per_unit:g}, and ")
    return replace(
        features, crs=crs,
        points=replace(features.points, ground=features.points.ground * factors),
        lines=replace(features.lines, ground=features.lines.ground * factors))
