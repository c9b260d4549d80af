"""Ground coordinates that cannot be in their coordinate reference system."""

from __future__ import annotations

import numpy as np

from termsel.core.errors import TermselError, counted
from termsel.data.coordinates.crs import UTM, kind_of, normalise, short
from termsel.data.features import BoolArray, FeatureSet, FloatArray

_NEAR = 1000.0  # metres from the origin of a CRS
_DEGREE_RANGE = ((-180.0, -90.0), (360.0, 90.0))
_WITH_ZONE = {31: "EPSG:5649", 32: "EPSG:4647", 33: "EPSG:5650"}  # zE-N
_FOOT = 0.3048  # m
# Generous: scenes reach into the next zone, and some producers keep northern zones with
# negative northings south of the equator.
_UTM_RANGE = {"6": ((0.0, -9.4e6), (1e6, 9.4e6)), "7": ((0.0, 0.0), (1e6, 10.5e6))}


def check_ground(features: FeatureSet) -> None:
    """Refuse ground coordinates that cannot be in the CRS of the features; "local" takes any.

    Longitudes outside -180 to 360 or latitudes outside -90 to 90 degrees in a geographic CRS,
    coordinates that look like degrees in a projected one, and eastings or northings that no UTM
    zone has.
    """
    crs = normalise(features.crs)
    kind = kind_of(crs)
    xy = features.ground_vertices()[:, :2]
    if not len(xy):
        return
    if kind == "geographic":
        metres = (np.abs(xy) > 360).any(axis=1).mean() > 0.5
        hint = ("These look like metres: state the projected CRS with --crs." if metres else
                "x must be longitude and y latitude, in degrees.")
        _check_range(xy, features, *_DEGREE_RANGE,
                     f"cannot be longitude and latitude in {crs}", hint)
    elif kind == "projected":
        _check_metres(xy, features, crs)
        utm = UTM.fullmatch(crs)
        if utm:
            _check_range(xy, features, *_UTM_RANGE[utm[1]],
                         f"cannot be easting and northing in {crs} (UTM)",
                         _hint_of_utm(xy, int(crs[-2:]), *_UTM_RANGE[utm[1]]))


def _hint_of_utm(xy: FloatArray, zone: int, low: tuple[float, float],
                 high: tuple[float, float]) -> str:
    """Return what may be wrong with coordinates that are outside a zone of UTM."""
    if (xy[:, 0] // 1e6 == zone).all():
        crs = _WITH_ZONE.get(zone)
        stated = f", or state the CRS that has them, --crs {crs} (ETRS89)" if crs else ""
        return f"x begins with the zone, {zone}: take these digits off{stated}."
    feet = xy * _FOOT
    if ((feet >= low) & (feet <= high)).all():
        return (f"In feet they would be within the zone: state --crs '+proj=utm +zone={zone} "
                "+datum=WGS84 +units=us-ft', or convert them to metres.")
    return "x must be easting and y northing, in metres; check the CRS of the file."


def _check_metres(xy: FloatArray, features: FeatureSet, crs: str) -> None:
    """Refuse features in degrees under a projected CRS: all of them, or some far from the rest."""
    # Metres of a projected CRS are almost never so small.
    degrees: BoolArray = np.all(np.abs(xy) <= (180, 90), axis=1)
    if not degrees.any():
        return
    others = xy[~degrees]
    if len(others):
        # Metres next to the origin of a CRS are as small.
        middle = np.median(others, axis=0)
        spread = np.median(np.abs(others - middle), axis=0).max()
        if np.hypot(*middle) <= max(_NEAR, 10 * spread):
            return
        n = len(np.unique(features.vertex_feature[degrees]))
        verb = "looks" if n == 1 else "look"
        problem = f"{n} of {counted(len(features), 'feature')} {verb} like degrees"
        hint = "Transform these features to the CRS of the others, or remove them."
    else:
        problem = "the ground coordinates look like degrees"
        hint = ("State --crs EPSG:4979 for longitude, latitude and ellipsoidal height, or --crs "
                "local for plane coordinates without a CRS.")
    first = int(np.argmax(degrees))
    name, column = _vertex(features, first, 0)
    raise TermselError(
        f"{problem}, but {short(crs)} is a projected CRS: {_values(xy, name, first)}", ids=[name],
        column=column, hint=hint)


def _check_range(xy: FloatArray, features: FeatureSet, low: tuple[float, float],
                 high: tuple[float, float], problem: str, hint: str) -> None:
    """Refuse coordinates outside a range; say so if exchanged columns would be inside."""
    def beyond(values: FloatArray) -> BoolArray:
        return np.asarray((values < low) | (values > high))

    def outside(values: FloatArray) -> BoolArray:
        return np.asarray(beyond(values).any(axis=1))

    is_outside = outside(xy)
    if not is_outside.any():
        return
    first = int(np.argmax(is_outside))
    if not outside(xy[:, ::-1]).any():
        hint = f"x and y look swapped: --set swapped=xy exchanges them. {hint}"
    elif not outside(xy[is_outside][:, ::-1]).any():
        hint = f"Perhaps x and y are swapped there. {hint}"
    name, column = _vertex(features, first, int(np.argmax(beyond(xy)[first])))
    raise TermselError(f"{_values(xy, name, first)} {problem}", hint=hint, ids=[name],
                       column=column)


def _vertex(features: FeatureSet, i: int, axis: int) -> tuple[str, str]:
    """Return the feature of the i-th ground vertex, and what its coordinate is called."""
    # Vertices are those of points, then two of each line.
    of_line = i - len(features.points)
    end = "" if of_line < 0 else str(of_line % 2 + 1)
    return features.ids[int(features.vertex_feature[i])], f"{'xy'[axis]}{end}"


def _values(xy: FloatArray, name: str, i: int) -> str:
    return f"feature {name!r} with x = {xy[i, 0]:.10g}, y = {xy[i, 1]:.10g}"
