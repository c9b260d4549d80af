"""Ground coordinates that are not all of one kind: zones of UTM, and minutes typed as decimals.

What the image shows tells: read the other way, the points are its affine image, and as they stand
they are not.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from termsel.core.errors import TermselError, first_of
from termsel.data.coordinates.crs import UTM, normalise, transformation
from termsel.data.coordinates.metres import is_in_degrees
from termsel.data.features import BoolArray, FeatureSet, FloatArray

MIN_AFFINE_POINTS = 6
"""Points from which on an affine image tells."""

BETTER = 0.1
"""Share of the errors as the coordinates stand, which those of another reading must stay below."""

APART = 100_000.0
"""Gap between eastings [m] from which on two groups of them may be of two zones."""

MINUTES = 0.6
"""Decimals of a degree below which minutes typed as decimals stay."""

MAX_POINTS_NAMED = 5
"""Points that a note names."""


def note_on_mixed(features: FeatureSet) -> str:
    """Return which coordinates look as if they were of another kind than the others; or ""."""
    points = features.points
    if len(points) < MIN_AFFINE_POINTS or not features.crs:
        return ""
    return _two_zones(features) or _minutes(features)


def _two_zones(features: FeatureSet) -> str:
    """Return which points look as if they were in the next zone of UTM."""
    crs = normalise(features.crs)
    match = UTM.fullmatch(crs)
    ground = features.points.ground
    far = _far_group(ground[:, 0])
    if match is None or far is None:
        return ""
    as_it_stands = _error(features.points.image, ground)
    zone = int(crs[-2:])
    for neighbour in (zone - 1, zone + 1):
        if not 1 <= neighbour <= 60:
            continue
        read = ground.copy()
        try:
            # The far group read as of the next zone, in the coordinates of this one.
            turned = transformation(f"{crs[:-2]}{neighbour:02}", crs)(ground[far])
        except TermselError:  # nothing can be where these coordinates are in that zone
            continue
        read[far, :2] = turned[:, :2]
        if _error(features.points.image, read) < BETTER * as_it_stands:
            ids = [features.points.ids[i] for i in np.flatnonzero(far)]
            # Which of the two is the zone of the CRS, the coordinates do not tell.
            direction = "west" if neighbour < zone else "east"
            return (f"{len(ids)} of {len(features.points)} points look as if they were in the zone "
                    f"of UTM {direction} of that of the others: {first_of(ids, MAX_POINTS_NAMED)}. "
                    "Transform them into one zone, and state its CRS.")
    return ""


def _far_group(eastings: FloatArray) -> BoolArray | None:
    """Return the smaller of two groups of eastings (n,) with a wide gap between them, if any."""
    order = np.sort(eastings)
    gaps = [second - first for first, second in pairwise(order.tolist())]
    widest = int(np.argmax(gaps))
    if gaps[widest] < APART:
        return None
    # The group of fewer points is the one to doubt.
    above = np.asarray(eastings > order[widest])
    return np.asarray(above if above.sum() <= len(above) / 2 else ~above)


def _minutes(features: FeatureSet) -> str:
    """Return that degrees and minutes, or seconds too, look as if they were typed as decimals."""
    if not is_in_degrees(features.crs):
        return ""
    ground = features.points.ground
    image = features.points.image
    size = np.abs(ground[:, :2])
    sign = np.sign(ground[:, :2])
    # With a margin for decimals such as 35.0 that are stored as 34.999...
    degrees = np.floor(size + 1e-9)
    decimals = size - np.floor(size + 1e-9)
    # Within one degree both readings are affine images of each other, and nothing tells.
    if not (np.ptp(degrees * sign, axis=0) > 0).any() or (decimals >= MINUTES).any():
        return ""
    # 34.4730 may stand for 34 deg 47.30', or for 34 deg 47' 30".
    minutes = np.floor(decimals * 100 + 1e-6)
    seconds = (decimals * 100 - minutes) * 100
    readings = {"degrees and minutes": degrees + decimals * 100 / 60,
                "degrees, minutes and seconds": degrees + minutes / 60 + seconds / 3600}
    if (seconds >= 60).any():
        del readings["degrees, minutes and seconds"]
    errors = {name: _error(image, sign * read) for name, read in readings.items()}
    name = min(errors, key=lambda reading: errors[reading])
    if errors[name] >= BETTER * _error(image, ground):
        return ""
    first = ground[0, 0]
    value = decimals[0, 0] * 100
    typed = f"{degrees[0, 0]:.0f}\N{DEGREE SIGN}"
    typed += f"{value:.6g}'" if name == "degrees and minutes" else \
        f"{minutes[0, 0]:.0f}'{seconds[0, 0]:.6g}\""
    return (f"Coordinates look like {name} typed as decimals: {first:.10g} for {typed}. Write "
            "decimal degrees, or degrees and minutes with their signs.")


def _error(image: FloatArray, ground: FloatArray) -> float:
    """Return the root mean square of what an affine image of the ground leaves [px]."""
    # About the middle and by the extent, so that the system is well conditioned.
    plan = ground[:, :2] - ground[:, :2].mean(axis=0)
    plan = plan / np.maximum(np.abs(plan).max(axis=0), np.finfo(float).tiny)
    design = np.column_stack([np.ones(len(plan)), plan])
    residuals = image - design @ np.linalg.lstsq(design, image)[0]
    return float(np.sqrt((residuals**2).sum(axis=1).mean()))
