"""Where features are, and whether their axes look swapped or turned round."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from termsel.core.errors import DOUBT, PENDING, TermselError
from termsel.core.remedies import ReadRemedy, Remedy
from termsel.data.coordinates.crs import (
    EARTH,
    EXAMPLES,
    LOCAL,
    UTM,
    area_of_use,
    body_of,
    geodetic_of,
    horizontal_crs,
    is_geocentric,
    is_geographic,
    kind_of,
    normalise,
    prime_meridian_of,
    short_crs_name,
    transformation_between,
    transformation_to_own_degrees,
)
from termsel.data.coordinates.crs_columns import crs_of_columns
from termsel.data.coordinates.longitudes import unwrap_longitudes, without_jump
from termsel.data.coordinates.metres import has_compass_axes, metric_crs, offsets_in_metres
from termsel.data.coordinates.places import lattice_of
from termsel.data.features import FeatureSet, FloatArray
from termsel.data.record.cautions import MIRRORED, SWAPPED_GROUND, SWAPPED_IMAGE
from termsel.data.record.chances import median_of

log = logging.getLogger(__name__)

_TELLING = 3  # points from which on a mirror image shows, or half as many again lines
_UNLIKE = 0.2  # share of the image coordinates' variance that relief and distortion may leave
_FLAT = 0.05  # ratio of the axes of what a matrix makes of a circle, below which nothing shows
_NO_DEGREES = 360.0  # beyond which no longitude is
_WIDE = 20.0  # degrees that a scene may be wide
_OF_A_COUNTRY = 3.0  # degrees from which on the projection of a map shows
_SENSOR = "sensor"  # column that names what took the image
_TURNING_LATITUDE = 70.0  # degrees from which on satellites fly more to the east or west
AREA_MARGIN = 5.0  # degrees outside the area of a CRS at which features may still be


def place_of(features: FeatureSet) -> str:
    """Return where the middle of features is, such as "34.8 N, 48.5 E", or "" if nobody knows.

    Nobody knows without features, and where the CRS does not give longitudes and latitudes.
    """
    ground = features.ground_vertices()
    middle = degrees_of(features.crs, ground) if len(ground) else None
    if middle is None:
        return ""
    degrees = position_in_words(middle)
    body = body_of(features.crs)
    return degrees if body == EARTH else f"{degrees} on {body}"


def position_in_words(position: tuple[float, float]) -> str:
    """Return longitude and latitude [deg] as words, such as "34.8 N, 48.5 E"."""
    lon, lat = (round(degrees, 1) for degrees in position)
    return f"{abs(lat):.1f} {'N' if lat >= 0 else 'S'}, {abs(lon):.1f} {'E' if lon >= 0 else 'W'}"


def say_turned(features: FeatureSet) -> None:
    """Say so where axes look swapped, or where lines or samples are counted the other way."""
    if note := note_on_turned(features):
        log.warning("%s: %s", "Warning" if find_swapped_axes(features) else "Note", note,
                    extra={PENDING: DOUBT})


def note_on_turned(features: FeatureSet) -> str:
    """Return a note where axes look swapped or are counted the other way; "" where they are not.

    An image taken from above shows the ground turned by any angle but not mirrored. So a negative
    determinant of the affine fit tells that lines or samples are counted the other way. The note
    says which option would exchange or count the axes otherwise.
    """
    if doubt := find_swapped_axes(features):
        exchanging, exchanging_others = _exchange_option(doubt)
        location = place_of(features)
        are_ground = exchanging == "swapped=xy"
        other = "line and sample" if are_ground else "x and y"
        if location:
            condition = f"If {location} is {'' if are_ground else 'not '}the place"
        else:
            condition = "Or else"
        return (f"{doubt}. {_as_option(exchanging)} exchanges them. {condition}, {other} are "
                f"swapped: {_as_option(exchanging_others)}.")
    # Lattices that a processor computed, and points that name a sensor, say how it saw the ground.
    is_declared = lattice_of(features) is not None or _SENSOR in features.points.attributes
    rotation = None if is_declared else _rotation_to_east_north_up(features)
    # A mirror image: one coordinate is counted other than from the upper left.
    if rotation is not None and np.linalg.det(rotation) < 0:
        is_upwards = rotation[0, 0] > rotation[1, 1]
        if has_compass_axes(features.crs, features.ground_vertices()):
            if is_upwards:
                direction = "line numbers grow to the north"
            else:
                direction = "sample numbers grow to the west"
        else:
            direction = "line numbers grow with y" if is_upwards else "sample numbers fall with x"
        if is_upwards:
            remedy = ("if lines count from the lower edge of the image, add --set "
                      "image_origin=bottom-left --image FILE. Else x and y may be swapped, or one "
                      "of them have the wrong sign.")
        else:
            remedy = "does x have the wrong sign, or are x and y swapped?"
        return (f"{direction}{MIRRORED}{remedy} Only a radar image, or a "
                "scan of the back of a film, is so.")
    if not is_declared and _is_mirrored_plane(features):
        return ("the image mirrors the plane of x and y, as where y points down in both. If it "
                "points up in the plane, line and sample may be swapped: "
                f"{ReadRemedy('swapped', 'line-sample')} exchanges them, and "
                f"{ReadRemedy('swapped', 'xy')} x and y.")
    return ""


def _as_option(setting: str) -> ReadRemedy:
    """Return what exchanges axes, such as swapped=xy, as an option of reading."""
    name, value = setting.split("=")
    return ReadRemedy(name, value)


def _is_mirrored_plane(features: FeatureSet) -> bool:
    """Return whether the image mirrors plane coordinates without a CRS, whose y may point down."""
    if normalise(features.crs) != LOCAL:
        return False
    turn = _rotation_matrix(features)
    return turn is not None and bool(np.linalg.det(turn) < 0)


def unknown_crs_error(features: FeatureSet, may_turn: bool) -> TermselError:
    """Return the error for features without a CRS.

    If a column or the coordinates show what --crs could say, the hint and `options` of the error
    say it. If axes look swapped and `may_turn`, they say which option exchanges them, too.
    """
    error = TermselError("the CRS of the ground coordinates is unknown", code="crs-unknown",
                         hint=f"State it with {Remedy('crs')}: {EXAMPLES}.")
    ground = features.ground_vertices()
    plane = ground[:, :2]
    column, said = crs_of_columns(features)
    if said:
        error.options["--crs"] = said
        datum = " in WGS 84" if UTM.fullmatch(said) and not column.lower().startswith(
            ("crs", "epsg", "sr")) else ""
        error.hint = f"Its column {column!r} says {said}{datum}: --crs {said}."
        return error
    if len(ground) and np.abs(plane).max() > _NO_DEGREES:
        error.hint = f"{error.hint} x and y are no degrees: name the CRS of the map they are from."
    if not len(ground) or np.abs(plane).max() > 180:
        return error
    has_heights = np.isfinite(ground[:, 2]).any()
    crs = "EPSG:4979" if has_heights else "EPSG:4326"
    # A map of some degrees was drawn in a projection, which degrees do not follow.
    extent = float(np.ptp(plane, axis=0).max())
    if has_heights or extent < _OF_A_COUNTRY:
        projection = ""
    else:
        projection = "; on a map, --crs auto finds its projection"
    # Degrees of one scene are close to each other. Small numbers near 0, 0 are rather metres of a
    # plane of the user's own.
    if extent > _WIDE or np.hypot(*plane.mean(axis=0)) < _WIDE:
        if extent > _OF_A_COUNTRY and not has_heights:
            error.hint = (f"{error.hint} If they are longitudes and latitudes: --crs {crs}"
                          f"{projection}.")
        return error
    error.options["--crs"] = crs
    error.hint = f"{error.hint} They look like degrees: --crs {crs}{projection}."
    impossible = (f"{SWAPPED_GROUND}: no latitude is beyond 90"
                  if np.abs(plane[:, 1]).max() > 90 else "")
    if may_turn and (doubt := impossible or find_swapped_axes(replace(features, crs=crs))):
        error.options["--set"] = _exchange_option(doubt)[0]
        error.hint = f"{error.hint} {doubt[0].upper()}{doubt[1:]}."
    return error


def _exchange_option(doubt: str) -> tuple[str, ...]:
    """Return the --set option that exchanges what `find_swapped_axes` names, then the other."""
    options = ("swapped=xy", "swapped=line-sample")
    return options[::-1] if doubt.startswith(SWAPPED_IMAGE) else options


def find_swapped_axes(features: FeatureSet) -> str:
    """Return which axes look swapped, and why; "" if none do.

    x and y look swapped if only exchanged they lie in the area of the CRS, any two axes if the
    image mirrors the ground about a diagonal. An image that mirrors it about an axis is no sign:
    maps may count lines upwards, and radar images show what lies to their right.
    """
    ground = features.ground_vertices()
    area = area_of_use(features.crs) if len(ground) else None
    exchanged = None
    if area is not None and not is_geocentric(features.crs):
        as_they_stand = degrees_of(features.crs, ground)
        exchanged = degrees_of(features.crs, ground[:, [1, 0, 2]])
    # Scenes may reach beyond the area, so one that is near it is not outside.
    if (area is not None and exchanged is not None and is_inside(exchanged, area, 0.0)
            and (as_they_stand is None or not is_inside(as_they_stand, area, AREA_MARGIN))):
        return (f"{SWAPPED_GROUND}: exchanged, they lie in the area of "
                f"{short_crs_name(features.crs)}, and not as they stand")
    if _has_turning_radar(features):
        return ""
    # Exchanging two axes turns a mirror image about a diagonal into the view from above.
    rotation = _rotation_to_east_north_up(features)
    if rotation is None or np.linalg.det(rotation) >= 0 or not _is_diagonal(rotation):
        return ""
    swapped = SWAPPED_GROUND if rotation[0, 1] + rotation[1, 0] > 0 else SWAPPED_IMAGE
    return f"{swapped}: the image mirrors the ground"


def _has_turning_radar(features: FeatureSet) -> bool:
    """Return whether an image may mirror the ground about a diagonal, and no axes are exchanged.

    A radar looks to its right, and flies along a parallel where its orbit is next to a pole.
    """
    # An annotation that points name states which axis is which.
    if _SENSOR in features.points.attributes:
        return True
    # Nobody types a lattice: a processor computes it for each product, as those of radars have.
    if lattice_of(features) is None:
        return False
    position = degrees_of(features.crs, features.ground_vertices())
    return position is not None and abs(position[1]) > _TURNING_LATITUDE


def is_mirrored(features: FeatureSet) -> bool | None:
    """Return whether the image is a mirror image of the ground; None if too few features show it.

    The sign of the determinant of the matrix from ground to image says so; three points that are
    not on one line suffice. Images of some kinds are rightly mirrored: callers compare with others
    of the same kind.
    """
    rotation = _rotation_matrix(features)
    return None if rotation is None else bool(np.linalg.det(rotation) < 0)


def _is_diagonal(turn: FloatArray) -> bool:
    """Return whether a reflection exchanges both axes, and does not turn one of them round."""
    # The reflection next to the matrix has cos 2t and sin 2t proportional to these.
    return bool(abs(turn[0, 1] + turn[1, 0]) > abs(turn[0, 0] - turn[1, 1]))


def _rotation_to_east_north_up(features: FeatureSet) -> FloatArray | None:
    """Return the matrix (2, 2) from metres (east, north) to the image (sample, up), up to a factor.

    None is returned for "local" and geocentric CRSs, whose axes may point anywhere; for too few
    features; and if the matrix explains too little of the image.
    """
    if kind_of(normalise(features.crs)) not in ("geographic", "projected"):
        return None
    return _rotation_matrix(features)


def _rotation_matrix(features: FeatureSet) -> FloatArray | None:
    """Return the matrix of `_rotation_to_east_north_up` in any CRS, (2, 2).

    It is fitted to points, and to lines in that each vertex on the ground lies on the line in the
    image. Three points give it exactly. None is returned for fewer, where three lines count as two
    points, for features at one place of the image, and if the matrix explains too little.
    """
    points = features.points
    lines = features.lines
    if len(points) + len(lines) // 1.5 < _TELLING:
        return None
    ground = without_jump(features).ground_vertices()[:, :2]
    from_middle = ground - ground.mean(axis=0)
    metres = offsets_in_metres(features.crs, ground, from_middle)
    design = np.column_stack([from_middle if metres is None else metres, np.ones(len(ground))])
    # Both sides are scaled to about one: metres of a scene and a column of ones differ by 1e4.
    design[:, :2] /= max(float(np.abs(design[:, :2]).max()), np.finfo(float).tiny)
    image_vertices = features.image_vertices()
    middle = image_vertices.mean(axis=0)
    # The unknowns are the rows a and b of [sample; up] = [a; b] (east, north, 1).
    zero = np.zeros((len(points), 3))
    size = float(np.abs(image_vertices - middle).max())
    if size == 0.0:
        return None
    of_points = design[:len(points)]
    sample, up = ((points.image - middle) / size).T[::-1] * [[1.0], [-1.0]]
    first, second = ((end - middle) / size for end in (lines.image[:, 0], lines.image[:, 1]))
    directions = second - first
    length = np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), np.finfo(float).tiny)
    # Each line in the image has a normal in (sample, up), and a distance from the middle.
    normal = directions / length
    rho = normal[:, 0] * first[:, 1] - normal[:, 1] * first[:, 0]
    normals = np.repeat(normal, 2, axis=0)
    of_lines = design[len(points):]
    # A point gives one equation for sample and one for up; a vertex of a line one, as it lies on
    # the line: n_sample sample + n_up up = rho.
    matrix = np.vstack([np.hstack([of_points, zero]), np.hstack([zero, of_points]),
                        np.hstack([normals[:, :1] * of_lines, normals[:, 1:] * of_lines])])
    image = np.concatenate([sample, up, np.repeat(rho, 2)])
    coefficients = np.linalg.lstsq(matrix, image)[0]
    # The mean square that the matrix leaves is compared with the variance of the image.
    unexplained = float(((image - matrix @ coefficients)**2).mean())
    if unexplained > _UNLIKE * float(((image_vertices - middle)**2).mean()) / size**2:
        return None
    rotation = np.array([coefficients[:2], coefficients[3:5]])
    # A circle becomes an ellipse with these axes. A flat one has no sure orientation.
    long_axis, short_axis = np.linalg.svd(rotation, compute_uv=False)
    return rotation if short_axis > _FLAT * long_axis else None


def note_on_utm_zone(crs: str, features: FeatureSet) -> str:
    """Return a note that features are far outside the area of a projected CRS; "" if they are not.

    The note names the zone of UTM in which their middle lies. It is "" as well beyond the zones,
    which end at 80 S and 84 N, and if the area of the CRS or the place of the features is unknown.
    """
    area = area_of_use(crs)
    middle = degrees_of(features.crs, features.ground_vertices())
    if (area is None or middle is None or is_inside(middle, area, AREA_MARGIN)
            or not -80 <= middle[1] <= 84):
        return ""
    west, south, east, north = area
    return (f"{short_crs_name(crs)} is for the area from {position_in_words((west, south))} to "
            f"{position_in_words((east, north))}, but the map is at {position_in_words(middle)}: "
            f"--crs {metric_crs(features.crs, *middle)} is the zone of UTM there")


def is_inside(position: tuple[float, float], area: tuple[float, float, float, float],
              margin: float) -> bool:
    """Return whether a position is within an area and a margin around it [deg].

    The position is longitude and latitude; the area has the bounds west, south, east and north.
    """
    lon, lat = position
    west, south, east, north = area
    # Areas may lie across the 180 degree meridian, with west larger than east.
    width = (east - west) % 360 or 360.0
    return (south - margin <= lat <= north + margin
            and ((lon - west + margin) % 360 <= width + 2 * margin or width + 2 * margin >= 360))


def _degrees_of_plan(crs: str, geodetic: str, middle: FloatArray) -> tuple[float, float]:
    """Return longitude and latitude [deg] of a place (1, 3) in a CRS without heights.

    They are on the datum of `geodetic` or, where PROJ knows no transformation to that, as from the
    datum of China, on that of the CRS itself: the two are some hundred metres apart at most. Raises
    TermselError for "local", and without pyproj for most CRSs.
    """
    try:
        lon, lat = transformation_between(crs, geodetic, strict=False)(middle)[0, :2].tolist()
    except TermselError:
        lon, lat = transformation_to_own_degrees(crs)(middle)[0, :2].tolist()
    return lon, lat


def degrees_of(crs: str, ground: FloatArray) -> tuple[float, float] | None:
    """Return longitude and latitude [deg] of the median of places (n, 3).

    None is returned if they are unknown: for "local", for places far outside the CRS, and without
    pyproj for most CRSs.
    """
    try:
        if is_geographic(crs):
            lon = float(median_of(unwrap_longitudes(ground[:, 0])))
            lon += prime_meridian_of(normalise(crs))
            lat = float(median_of(ground[:, 1]))
        else:
            # Medians, as one wild coordinate must not move the scene.
            middle = median_of(np.nan_to_num(ground).T)[None]
            geodetic = geodetic_of(crs)
            if is_geocentric(crs):
                lon, lat = transformation_between(crs, geodetic)(middle)[0, :2].tolist()
            else:
                lon, lat = _degrees_of_plan(horizontal_crs(crs), horizontal_crs(geodetic), middle)
    except TermselError:  # the CRS is not known, or pyproj is needed for it
        return None
    if np.isfinite([lon, lat]).all() and abs(lat) <= 90:
        return ((lon + 180.0) % 360.0 - 180.0, lat)
    return None

