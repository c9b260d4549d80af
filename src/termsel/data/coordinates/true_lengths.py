"""Coordinates that are no degrees or metres of the ground: grads, and stretched projections."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from termsel.data.coordinates.crs import axes_of_degrees, is_geographic, normalise, short_crs_name
from termsel.data.coordinates.metres import TRUE_SCALE, scales_at
from termsel.data.features import FeatureSet

log = logging.getLogger(__name__)


def with_degrees(features: FeatureSet) -> FeatureSet:
    """Return features in degrees if their CRS counts longitude and latitude in another unit.

    Their CRS then is the same but for its unit: datum and prime meridian stay. A note says so.
    Columns whose names state their unit are in degrees already, and stay. All other features come
    back unchanged.
    """
    if not is_geographic(features.crs):
        return features
    per_unit, crs = axes_of_degrees(normalise(features.crs))
    if per_unit == 1.0:
        return features
    # Factors of x, y and z; heights stay.
    factors = np.array([1.0 if axis in features.named_units else per_unit for axis in "xy"] + [1.0])
    converted = "" if (factors == 1.0).all() else f"x and y are multiplied by {per_unit:g}, and "
    log.info("Note: %s does not count in degrees: %sall results are in degrees of its datum.",
             short_crs_name(features.crs), converted)
    return replace(
        features, crs=crs,
        points=replace(features.points, ground=features.points.ground * factors),
        lines=replace(features.lines, ground=features.lines.ground * factors))


def note_on_scale(features: FeatureSet) -> None:
    """Log a note if a projection shows lengths much longer or shorter than on the ground.

    Nothing is logged if the scale is nearly 1 or unknown.
    """
    scales = scales_at(features.crs, features.ground_vertices())
    if scales is None:
        return
    along_x, along_y = scales
    # Both differ a little in Web Mercator, whose formulas are of a sphere: one number is enough.
    if abs(along_x / along_y - 1.0) < TRUE_SCALE:
        words = f"{along_x:.3g} times"
    else:
        words = f"{along_x:.3g} times along x and {along_y:.3g} times along y"
    log.info("Note: %s shows lengths here %s as long as they are on the ground. Accuracies in "
             "metres are those on the ground; coordinates and pixels of maps are not.",
             short_crs_name(features.crs), words)
