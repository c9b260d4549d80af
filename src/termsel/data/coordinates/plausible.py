"""Ground coordinates that cannot be in their coordinate reference system."""

from __future__ import annotations

from collections.abc import Callable
from shlex import quote

import numpy as np

from termsel.core.errors import TermselError, count_in_words, first_names_in_words
from termsel.core.remedies import ReadRemedy, Remedy
from termsel.data.coordinates.crs import (
    EARTH,
    UTM,
    area_of_use,
    body_of,
    ellipsoid_of,
    height_axis_unit,
    kind_of,
    normalise,
    short_crs_name,
    transformation_between,
)
from termsel.data.coordinates.earth import (
    AREA_MARGIN,
    degrees_of,
    is_inside,
    position_in_words,
)
from termsel.data.coordinates.height_units import FOOT, UNITS, US_FOOT, is_unit_open
from termsel.data.coordinates.metres import is_in_degrees
from termsel.data.features import BoolArray, FeatureSet, FloatArray, IntArray, Points
from termsel.data.slips import slip_among

_NEAR_ORIGIN = 1000.0  # metres from the origin of a CRS
_FAR_SPREADS = 10.0  # from the origin, as many times the spread of a scene do not reach it
_DEGREE_RANGE = ((-180.0, -90.0), (360.0, 90.0))
_WITH_ZONE = {31: "EPSG:5649", 32: "EPSG:4647", 33: "EPSG:5650"}  # zE-N
_FOOT = 0.3048  # m
_FROM_SURFACE = 0.05  # share of the radius by which no ground is from the surface
# Generous: scenes reach into the next zone, and some producers keep northern zones with
# negative northings south of the equator.
_UTM_RANGE = {"6": ((0.0, -9.4e6), (1e6, 9.4e6)), "7": ((0.0, 0.0), (1e6, 10.5e6))}


def check_ground(features: FeatureSet, z_unit: str | None = None) -> None:
    """Raise TermselError for ground coordinates that cannot be in the CRS; "local" takes any.

    In a geographic CRS these are longitudes outside -180 to 360 or latitudes outside -90 to 90
    degrees; in a projected CRS coordinates that look like degrees, and in one of UTM eastings or
    northings that no zone has; in both, heights beyond any ground, in the unit `z_unit` if the user
    states one; in a geocentric CRS positions far from the surface of the body.
    """
    crs = normalise(features.crs)
    kind = kind_of(crs)
    ground = features.ground_vertices()
    xy = ground[:, :2]
    if not len(xy):
        return
    if kind == "geographic":
        _refuse_outside_range(xy, features, *_DEGREE_RANGE,
                              f"cannot be longitude and latitude in {crs}",
                              lambda: _hint_of_degrees(xy, features))
    elif kind == "geocentric":
        _refuse_far_from_surface(ground, features, crs)
    elif kind == "projected":
        _refuse_degrees(xy, features, crs)
        utm = UTM.fullmatch(crs)
        if utm:
            _refuse_outside_range(xy, features, *_UTM_RANGE[utm[1]],
                                  f"cannot be easting and northing in {crs} (UTM)",
                                  lambda: _hint_of_utm(xy, features, int(crs[-2:]),
                                                       *_UTM_RANGE[utm[1]]))
    # Heights come last, as a fault of x and y explains more.
    if kind in ("geographic", "projected"):
        _refuse_impossible_heights(ground[:, 2], features, z_unit)


_HIGHEST = 12_000.0
"""Metres that no ground of the Earth is above or below the ellipsoid, with a margin."""
_HIGHEST_OF_BODIES = 40_000.0
"""The same of other bodies: on Mars 21,900 m."""
_LOWEST_LAND = -600.0
"""Metres that no land is below the ellipsoid: the shore of the Dead Sea is at -415."""
_HIGHEST_LAND = 9_000.0
_LIKELY_UNITS = (
    ("feet", _FOOT, "state it: --set z_unit=ft"),
    ("centimetres", 0.01, "divide them by 100, or name their column 'z [cm]'"),
    ("millimetres", 0.001, "divide them by 1,000, or name their column 'z [mm]'"))
"""Units in which heights are written, the largest first, with what to do about them."""


def _unit_of_heights(features: FeatureSet, stated: str | None) -> float:
    """Return the size [m] of the unit of heights: the stated one, else that of the CRS.

    If there is neither, it is a foot where heights may be in feet, so that none in feet is refused,
    and else a metre.
    """
    declared = height_axis_unit(features.crs)
    if stated in UNITS:
        return UNITS[stated]
    if declared is not None:
        return declared
    # Names of columns, or the unit of x and y, show that feet are possible.
    in_feet = features.named_units.get("z") in (FOOT, US_FOOT) or is_unit_open(features.crs)
    return _FOOT if in_feet else 1.0


def _refuse_impossible_heights(heights: FloatArray, features: FeatureSet,
                               stated_unit: str | None) -> None:
    """Raise TermselError for heights (m,) of vertices beyond any ground; blank ones are NaN.

    On the Earth these are heights beyond `_HIGHEST`, and else beyond `_HIGHEST_OF_BODIES`.
    `stated_unit` is that of the heights, None if the user states none.
    """
    metres = heights * _unit_of_heights(features, stated_unit)
    on_earth = body_of(features.crs) == EARTH
    beyond = np.flatnonzero(np.abs(metres) > (_HIGHEST if on_earth else _HIGHEST_OF_BODIES))
    if not beyond.size:
        return
    names = list(dict.fromkeys(_name_vertex(features, i, 2)[0] for i in beyond.tolist()))
    name, column = _name_vertex(features, int(beyond[0]), 2)
    reach = ": that of the Earth reaches 8,849 m" if on_earth else ""
    raise TermselError(
        f"the height {heights[beyond[0]]:,.10g} of {name} is beyond any ground{reach}",
        ids=[name], column=column, hint=_hint_of_heights(metres, beyond, column, names))


def _hint_of_heights(metres: FloatArray, beyond: IntArray, column: str, names: list[str]) -> str:
    """Return a sentence on the likely reason why some heights are beyond any ground.

    `metres` are all heights (n,), NaN where blank; `beyond` are the indices of the heights at
    fault, `column` is the name of their column, and `names` are the features that have them.
    """
    known_heights = metres[np.isfinite(metres)]
    # A few are slips of the pen; if many are, the unit or the column is wrong.
    if len(beyond) <= _FEW_OUTSIDE * len(known_heights):
        possible_heights = np.delete(metres, beyond)
        low, high = np.nanmin(possible_heights), np.nanmax(possible_heights)
        at_fault, them = ("it", "it") if len(beyond) == 1 else (f"these {len(beyond)}", "them")
        return (f"The other {len(known_heights) - len(beyond)} are between {low:,.0f} and "
                f"{high:,.0f} m: correct {at_fault}, or leave {them} out: --off {','.join(names)}.")
    declare_column = f"another column has the heights: --columns {column}=NAME."
    low, high = known_heights.min(), known_heights.max()
    for unit, size, remedy in _LIKELY_UNITS:
        if np.abs(known_heights).max() * size <= _HIGHEST_LAND:
            return (f"They look like {unit}, {low * size:,.0f} to {high * size:,.0f} m: {remedy}. "
                    f"Or {declare_column}")
    return f"Give heights in metres; or {declare_column}"


def _note_on_depths(features: FeatureSet) -> str:
    """Return a note on heights that are below any land; "" if none are.

    It is "" as well without a CRS, in a geocentric or local one, and on other bodies than the
    Earth.
    """
    if (not features.crs or kind_of(normalise(features.crs)) not in ("geographic", "projected")
            or body_of(features.crs) != EARTH):
        return ""
    heights = features.ground_vertices()[:, 2] * _unit_of_heights(features, None)
    low = np.flatnonzero(heights < _LOWEST_LAND)
    if not low.size:
        return ""
    name, _ = _name_vertex(features, int(low[0]), 2)
    verb = "is" if len(low) == 1 else "are"
    return (f"{count_in_words(len(low), 'height')} {verb} below any land, such as "
            f"{heights[low[0]]:,.0f} m at {name}. If they are depths, or their sign is turned, "
            "write heights upwards.")


def _refuse_far_from_surface(ground: FloatArray, features: FeatureSet, crs: str) -> None:
    """Raise TermselError for positions in a geocentric CRS that are far below or above the surface.

    The positions (m, 3) are those of the vertices of the features, in metres from the centre of the
    body.
    """
    distance = np.linalg.norm(ground, axis=1)
    radius = ellipsoid_of(crs)[0]
    # An unknown height makes the distance NaN, which is not far here; it is refused elsewhere.
    is_far = np.abs(distance / radius - 1.0) > _FROM_SURFACE
    if not is_far.any():
        return
    first = int(np.argmax(is_far))
    name, column = _name_vertex(features, first, 0)
    look_like_degrees = bool((np.abs(ground[:, :2]) <= (360, 90)).all())
    if look_like_degrees:
        hint = "These look like longitude, latitude and height: state --crs EPSG:4979."
    else:
        hint = "x, y and z must be metres from the centre."
    raise TermselError(
        f"{_feature_in_words(ground, name, first)}, z = {ground[first, 2]:.10g} is "
        f"{distance[first]:.5g} m "
        f"from the centre of {body_of(crs)}, from which {short_crs_name(crs)} counts; its surface "
        f"is {radius:.5g} m away", ids=[name], column=column, hint=hint)


def _hint_of_degrees(xy: FloatArray, features: FeatureSet) -> str:
    """Return a sentence on the likely reason why coordinates (n, 2) cannot be degrees."""
    for joined, unit, form in ((100.0, "degrees and minutes", "DDMM.mm"),
                               (10_000.0, "degrees, minutes and seconds", "DDMMSS.ss")):
        if _are_joined(xy, joined):
            return (f"These look like {unit} in one number, {form}: write them with their signs, "
                    "or with spaces between.")
    # No angle is beyond a full turn, and few projected coordinates are within it.
    are_metres = (np.abs(xy) > 360).any(axis=1)
    if are_metres.mean() > 0.5:
        seconds = xy / 3600.0
        x, y = seconds[0]
        of_arc = (f" If they are seconds of arc, divide by 3600: the first are then {x:.6g} and "
                  f"{y:.6g}." if (np.abs(seconds) <= (180, 90)).all() else "")
        return f"These look like metres: state the projected CRS with --crs.{of_arc}"
    hint = "x must be longitude and y latitude, in degrees."
    in_metres = len(np.unique(features.vertex_feature[are_metres]))
    if in_metres > 1:
        hint = (f"{hint} {in_metres} of {count_in_words(len(features), 'row')} look like metres, "
                "as of UTM: transform them to degrees.")
    return hint


def _are_joined(xy: FloatArray, joined: float) -> bool:
    """Return whether numbers (n, 2) may be degrees and minutes, or seconds too, in one number.

    `joined` is what degrees are multiplied by: 100 in DDMM.mm, 10,000 in DDMMSS.ss.
    """
    size = np.abs(xy)
    degrees = np.floor(size / joined)
    below_a_degree = size - degrees * joined
    if joined == 100.0:
        minutes = below_a_degree
        seconds = np.zeros(1)
    else:
        minutes = np.floor(below_a_degree / 100.0)
        seconds = below_a_degree % 100.0
    # Latitudes below one degree are no sign: small coordinates of a plane would be taken for such.
    return bool((degrees <= (180, 90)).all() and (minutes < 60).all() and (seconds < 60).all()
                and (degrees[:, 1] > 0).all())


_FEW_OUTSIDE = 0.2
"""Share of the coordinates up to which those outside a range are slips, as the others fit."""


def _hint_of_utm(xy: FloatArray, features: FeatureSet, zone: int, low: tuple[float, float],
                 high: tuple[float, float]) -> str:
    """Return a sentence on the likely reason why coordinates (n, 2) are outside a zone of UTM.

    `low` and `high` are the least and largest easting and northing of the zone [m].
    """
    is_outside = ((xy < low) | (xy > high)).any(axis=1)
    # A few outside are slips of the pen; if many are, the CRS or the unit is wrong.
    if is_outside.mean() <= _FEW_OUTSIDE:
        outside = len(np.unique(features.vertex_feature[is_outside]))
        rows = "this row" if outside == 1 else f"these {outside} rows"
        inside = len(features) - outside
        return (f"The other {count_in_words(inside, 'row')} {'is' if inside == 1 else 'are'} "
                f"within the zone: is there a digit too many? Correct {rows}.")
    # Eastings have six digits; some countries write the number of the zone before them.
    if (xy[:, 0] // 1e6 == zone).all():
        crs = _WITH_ZONE.get(zone)
        stated = f", or state the CRS that has them, --crs {crs} (ETRS89)" if crs else ""
        return f"x begins with the zone, {zone}: take these digits off{stated}."
    feet = xy * _FOOT
    if ((feet >= low) & (feet <= high)).all():
        return (f"In feet they would be within the zone: state --crs '+proj=utm +zone={zone} "
                "+datum=WGS84 +units=us-ft', or convert them to metres.")
    return "x must be easting and y northing, in metres; check the CRS of the file."


def _refuse_degrees(xy: FloatArray, features: FeatureSet, crs: str) -> None:
    """Refuse features in degrees under a projected CRS: all of them, or some far from the rest.

    Metres near the origin of a CRS are as small as degrees. So where only some coordinates (n, 2)
    could be degrees, the others must be far from the origin. Raises TermselError with the first
    feature at fault.
    """
    # Metres of a projected CRS are almost never so small.
    could_be_degrees: BoolArray = np.all(np.abs(xy) <= (180, 90), axis=1)
    if not could_be_degrees.any():
        return
    in_metres = xy[~could_be_degrees]
    if len(in_metres):
        # Medians, as a few wrong coordinates must not decide how far the others spread.
        middle = np.median(in_metres, axis=0)
        spread = np.median(np.abs(in_metres - middle), axis=0).max()
        if np.hypot(*middle) <= max(_NEAR_ORIGIN, _FAR_SPREADS * spread):
            return
        n = len(np.unique(features.vertex_feature[could_be_degrees]))
        verb = "looks" if n == 1 else "look"
        problem = f"{n} of {len(features)} {features.word} {verb} like degrees"
        hint = "Transform them to the CRS of the others, or remove them."
    else:
        problem = "the ground coordinates look like degrees"
        hint = (f"In place of {short_crs_name(crs)} state {Remedy('crs', 'EPSG:4979')} (longitude, "
                f"latitude, ellipsoidal height), or {Remedy('crs', 'local')} for plane coordinates "
                "without a CRS.")
    first = int(np.argmax(could_be_degrees))
    name, column = _name_vertex(features, first, 0)
    raise TermselError(
        f"{problem}, but {short_crs_name(crs)} is a projected CRS: "
        f"{_feature_in_words(xy, name, first)}", ids=[name],
        column=column, hint=hint)


def _refuse_outside_range(xy: FloatArray, features: FeatureSet, low: tuple[float, float],
                          high: tuple[float, float], problem: str,
                          hint_of: Callable[[], str]) -> None:
    """Refuse coordinates (n, 2) outside a range; say so if exchanged columns would be inside.

    `problem` ends the sentence on the first feature at fault. `hint_of` returns what is likely
    wrong; it is called only where something is.
    """
    beyond: BoolArray = np.asarray((xy < low) | (xy > high))
    is_outside = beyond.any(axis=1)
    if not is_outside.any():
        return
    # The range of x differs from that of y, so that exchanged columns often show.
    exchanged = xy[:, ::-1]
    is_outside_exchanged: BoolArray = np.asarray(
        ((exchanged < low) | (exchanged > high)).any(axis=1))
    if not is_outside_exchanged.any():
        hint = f"x and y look swapped: {ReadRemedy('swapped', 'xy')} exchanges them."
    elif not is_outside_exchanged[is_outside].any():
        hint = f"Perhaps x and y are swapped there. {hint_of()}"
    else:
        hint = hint_of()
    first = int(np.argmax(is_outside))
    axis = int(np.argmax(beyond[first]))
    name, column = _name_vertex(features, first, axis)
    if is_outside.mean() <= _FEW_OUTSIDE:
        slip = _hint_of_slip(xy[first], xy[~is_outside], axis, column, name)
        hint = slip or hint
    raise TermselError(f"{_feature_in_words(xy, name, first)} {problem}", hint=hint, ids=[name],
                       column=column)


def _hint_of_slip(xy: FloatArray, others: FloatArray, axis: int, column: str, name: str) -> str:
    """Return a sentence on the slip by which coordinates (2,) are outside those of others (n, 2).

    `axis` is the one at fault, `column` its name and `name` the feature. Returns "" where no single
    slip explains it.
    """
    low, high = others.min(axis=0), others.max(axis=0)
    remedy = f"Correct it, or leave it out: --off {quote(name)}."
    if ((xy[::-1] >= low) & (xy[::-1] <= high)).all():
        return f"x and y look exchanged in this row: those of the others are not. {remedy}"
    slip = slip_among(float(xy[axis]), others[:, axis])
    if slip is None:
        return ""
    likely, reason = slip
    return (f"The others are between {low[axis]:.10g} and {high[axis]:.10g}: is it {column} = "
            f"{likely:.10g}, with {reason}? {remedy}")


def _name_vertex(features: FeatureSet, i: int, axis: int) -> tuple[str, str]:
    """Return the id of the feature of the i-th ground vertex, and its coordinate, such as "x2"."""
    # Vertices are those of points, then two of each line.
    of_line = i - len(features.points)
    end = "" if of_line < 0 else str(of_line % 2 + 1)
    return features.ids[int(features.vertex_feature[i])], f"{'xyz'[axis]}{end}"


def _feature_in_words(xy: FloatArray, name: str, i: int) -> str:
    """Return the i-th feature with its coordinates, for a message."""
    return f"{name!r} with x = {xy[i, 0]:.10g}, y = {xy[i, 1]:.10g}"


# Ground coordinates that are not all of one kind: zones of UTM, and minutes typed as decimals.
#
# The image shows it: read the other way, the points are nearly an affine image of it, and as they
# stand they are not.

MIN_AFFINE_POINTS = 6
"""Points from which on an affine image shows."""

BETTER = 0.1
"""Share of the errors as the coordinates stand, which those of another reading must stay below."""

APART = 100_000.0
"""Gap between eastings [m] from which on two groups of them may be of two zones."""

MINUTES = 0.6
"""Decimals of a degree below which minutes typed as decimals stay."""

MAX_POINTS_NAMED = 5
"""Points that a note names."""


SAME = 10.0
"""Median distance of line from y and of sample from x, below which both are places on a map."""

NO_PIXEL = 100_000.0
"""Line or sample beyond which next to no image has pixels."""

NO_IMAGE = 1e8
"""Line or sample beyond the end of any image."""


_MOST_KILOMETRES = 21_000.0
"""Largest easting or northing in kilometres; those with a zone in front are beyond it."""
_AROUND = 3.0
"""Degrees by which a scene may be outside the area of its CRS."""
_SMALLEST_PIXEL = 0.003
"""Size of a pixel on the ground [m] below which no image of a landscape is."""
_HIGHEST_KILOMETRES = 9.0
_DEGREE = 111_320.0  # metres
_NO_TANGENT = 30.0
"""Tangent of the angle of view from the vertical beyond which no affine image is: 88 degrees."""
_CERTAIN = 6.0
"""Slope by its standard deviation from which on it is no chance."""


def note_on_wrong_coordinates(features: FeatureSet) -> str:
    """Return a note on the first fault that the coordinates of points show, or "" for none.

    The faults are looked for in this order: zeros that stand for unknown places; map coordinates in
    place of pixels, or lines and samples beyond any image; depths in place of heights; in degrees,
    minutes typed as decimals; in metres, kilometres, two zones of UTM, or a place far outside the
    area of the CRS; last heights in kilometres.

    Minutes, zones and heights in kilometres show by the image: the ground, read rightly, is nearly
    an affine image of it. They are not looked for in fewer than `MIN_AFFINE_POINTS` points, nor
    without a CRS. Points that are off take no part.
    """
    is_off = [role == "off" for role in features.points.roles]
    if any(is_off):
        features = features.with_(points=features.points.take(~np.array(is_off)))
    points = features.points
    # The first fault found is told alone, as it may be why the later ones appear.
    before_the_crs = (_note_on_zeros(points) or _note_on_pixels(points)
                      or _note_on_depths(features))
    if before_the_crs or len(points) < MIN_AFFINE_POINTS or not features.crs:
        return before_the_crs
    if is_in_degrees(features.crs):
        in_plan = _note_on_minutes(features)
    else:
        in_plan = (_note_on_kilometres(features) or _note_on_two_zones(features)
                   or _note_on_area(features))
    return in_plan or _note_on_heights_in_kilometres(features)


def _note_on_pixels(points: Points) -> str:
    """Return a note on lines and samples that are map coordinates or beyond any image; or ""."""
    image = points.image
    if not len(image) or np.median(np.abs(image).max(axis=1)) < NO_PIXEL:
        return ""
    # Lines may be y of the map, samples x.
    distance = float(np.median(np.abs(image - points.ground[:, [1, 0]]).max(axis=1)))
    if distance <= SAME:
        return (f"Line and sample are y and x themselves, to {distance:.2g}: they look like "
                "map coordinates of a georeferenced image, not pixels. What is stated in px is "
                "in units of the map then; for pixels, measure in the image without its "
                "georeferencing.")
    largest = float(np.abs(image).max())
    if largest > NO_IMAGE:
        return f"Line and sample are up to {largest:.2g}, and no image is so large. Give pixels."
    return ""


def _note_on_zeros(points: Points) -> str:
    """Return a note on several points at x = 0 and y = 0, or at line = 0 and sample = 0; or "".

    Programs write zeros for places that they do not know. A single point may lie there.
    """
    for positions, origin in ((points.ground[:, :2], "x = 0 and y = 0"),
                              (points.image, "line = 0 and sample = 0")):
        at_zero = np.flatnonzero((positions == 0.0).all(axis=1))
        if at_zero.size > 1:
            ids = first_names_in_words([points.ids[i] for i in at_zero], MAX_POINTS_NAMED)
            return (f"{at_zero.size} points lie at {origin}, which stands for places that are not "
                    f"known: {ids}. Leave their rows out, or give their coordinates.")
    return ""


def _note_on_kilometres(features: FeatureSet) -> str:
    """Return a note that eastings and northings look like kilometres; "" if they do not.

    They do if a thousand times of them are in the area of their CRS, and they themselves are
    outside that area, or would give the image pixels of less than `_SMALLEST_PIXEL`.
    """
    crs = normalise(features.crs)
    points = features.points
    plan = points.ground[:, :2]
    if kind_of(crs) != "projected" or np.abs(plan).max() > _MOST_KILOMETRES:
        return ""
    area = area_of_use(crs)
    if area is None or not _is_in_area(1000.0 * points.ground, crs, area, _AROUND):
        return ""
    extent = np.linalg.norm(np.ptp(plan, axis=0))
    extent_in_image = np.linalg.norm(np.ptp(points.image, axis=0))
    # As metres they make sense if they are in the area and no pixel is microscopic.
    if _is_in_area(points.ground, crs, area, 0.0) and extent > _SMALLEST_PIXEL * extent_in_image:
        return ""
    return ("x and y look like kilometres: times 1,000 they are in the area of "
            f"{short_crs_name(crs)}. "
            "Write them in metres, or end the names of their columns in km, such as x_km and "
            "y_km.")


def _note_on_area(features: FeatureSet) -> str:
    """Return a note that the points are far outside the area of their projected CRS; "" if not.

    That happens to the coordinates of another grid, or of a local one, under the CRS of a project:
    they are read as a wrong place on the Earth, and lengths in them may be of another unit.
    """
    crs = normalise(features.crs)
    area = area_of_use(crs) if kind_of(crs) == "projected" else None
    if area is None or _is_in_area(features.points.ground, crs, area, AREA_MARGIN):
        return ""
    middle = degrees_of(crs, features.points.ground)
    place = "nowhere on the Earth" if middle is None else f"at {position_in_words(middle)}"
    west, south, east, north = area
    where = (f"By their CRS these points are {place}, but {short_crs_name(crs)} is for the area "
             f"from {position_in_words((west, south))} to {position_in_words((east, north))}: ")
    # Many countries call the northing X.
    if _is_in_area(features.points.ground[:, [1, 0, 2]], crs, area, AREA_MARGIN):
        return f"{where}x and y look swapped. {ReadRemedy('swapped', 'xy')} exchanges them."
    return (f"{where}the coordinates are of another grid, and what is stated in metres may be of "
            "another unit. State their own CRS with --crs, or --crs local for a grid without one.")


def _is_in_area(ground: FloatArray, crs: str, area: tuple[float, float, float, float],
                margin: float) -> bool:
    """Return whether the middle of positions (n, 3) is in an area or a margin around it [deg]."""
    # Positions that are read in a wrong unit may be where the projection has no ground.
    middle = degrees_of(crs, ground)
    return middle is not None and is_inside(middle, area, margin)


def _note_on_heights_in_kilometres(features: FeatureSet) -> str:
    """Return a note that heights look like kilometres, by what the image shows of them; or "".

    In an affine image of the ground, a metre of height moves a point by as much as tan(angle of
    view) metres in plan. If heights are in kilometres, this tangent appears a thousand times as
    large. The image is fitted by an affine function of plan and height, and by squares of the plan,
    so that a bent image is not taken for an effect of the heights. "" is returned, too, for few
    points and for points that do not determine this fit.
    """
    is_known = np.isfinite(features.points.ground[:, 2])
    ground = features.points.ground[is_known]
    image = features.points.image[is_known]
    heights = ground[:, 2]
    if len(heights) < 2 * MIN_AFFINE_POINTS or np.abs(heights).max() > _HIGHEST_KILOMETRES:
        return ""
    plan = ground[:, :2] - ground[:, :2].mean(axis=0)
    if is_in_degrees(features.crs):
        plan = plan * _DEGREE * [np.cos(np.radians(np.median(ground[:, 1]))), 1.0]
    # The plan is scaled to at most 1, so that its squares are of the same size.
    extent = max(float(np.abs(plan).max()), np.finfo(float).tiny)
    u, v = plan.T / extent
    design = np.column_stack([np.ones(len(u)), u, v, heights - heights.mean(),
                              u * u, u * v, v * v])
    slopes, _, rank, _ = np.linalg.lstsq(design, image, rcond=None)
    # The determinant is the area in the image of a square metre of plan; its root is a scale.
    determinant = abs(np.linalg.det(slopes[1:3])) / extent**2
    if rank < design.shape[1] or not determinant > 0.0:
        return ""
    residuals = image - design @ slopes
    sigma = np.sqrt((residuals**2).sum() / (residuals.size - slopes.size))
    height_slope = float(np.linalg.norm(slopes[3]))  # px a unit of height
    # This row of the pseudoinverse gives the slope of the heights from the image.
    deviation = sigma * float(np.linalg.norm(np.linalg.pinv(design)[3]))
    tangent = height_slope / np.sqrt(determinant)
    if tangent < _NO_TANGENT or height_slope < _CERTAIN * deviation:
        return ""
    return (f"The heights, from {heights.min():.3g} to {heights.max():.3g}, look like kilometres: "
            "as metres they would move the image far more than any view does. Write them in "
            "metres, or end the name of their column in km, such as z_km.")


def _note_on_two_zones(features: FeatureSet) -> str:
    """Return a note on points that look as if they were in the next zone of UTM; "" if none do.

    Such points have eastings far from those of the others. With them read in the zone to the west
    or east, all points together must be a far better affine image than as they stand.
    """
    crs = normalise(features.crs)
    if UTM.fullmatch(crs) is None:
        return ""
    ground = features.points.ground
    is_far = _far_group(ground[:, 0])
    if is_far is None:
        return ""
    rms_as_it_stands = _rms_of_affine_fit(features.points.image, ground)
    zone = int(crs[-2:])
    for neighbour in (zone - 1, zone + 1):
        if not 1 <= neighbour <= 60:
            continue
        corrected = ground.copy()
        try:
            # The far group is read as coordinates of the next zone, and brought into this one.
            to_this_zone = transformation_between(f"{crs[:-2]}{neighbour:02}", crs)
            from_neighbour = to_this_zone(ground[is_far])
        except TermselError:  # these coordinates are nowhere in that zone
            continue
        corrected[is_far, :2] = from_neighbour[:, :2]
        if _rms_of_affine_fit(features.points.image, corrected) < BETTER * rms_as_it_stands:
            ids = [features.points.ids[i] for i in np.flatnonzero(is_far)]
            # Coordinates do not show which group is in the zone of the CRS, only which is west.
            direction = "west" if neighbour < zone else "east"
            return (f"{len(ids)} of {len(features.points)} points look as if they were in the zone "
                    f"of UTM {direction} of that of the others: "
                    f"{first_names_in_words(ids, MAX_POINTS_NAMED)}. "
                    "Transform them into one zone, and state its CRS.")
    return ""


def _far_group(eastings: FloatArray) -> BoolArray | None:
    """Return a mask (n,) of the smaller of two groups of eastings (n,) with a wide gap between.

    None is returned if no gap is as wide as `APART`.
    """
    in_order = np.sort(eastings)
    gaps = np.diff(in_order)
    widest = int(np.argmax(gaps))
    if gaps[widest] < APART:
        return None
    # The smaller group is the one to doubt.
    is_east = np.asarray(eastings > in_order[widest])
    return np.asarray(is_east if is_east.sum() <= len(is_east) / 2 else ~is_east)


def _note_on_minutes(features: FeatureSet) -> str:
    """Return a note that degrees and minutes, or seconds too, look typed as decimals; or "".

    The features are in degrees. 34.4730 may stand for 34 deg 47.30', or for 34 deg 47' 30". The
    first reading stretches what lies within a degree, the second what lies within a minute: where
    the points span more than one, at most one of the readings makes them an affine image.
    """
    ground = features.points.ground
    image = features.points.image
    size = np.abs(ground[:, :2])
    sign = np.sign(ground[:, :2])
    # The margins are for decimals such as 35.0 that are stored as 34.999...
    degrees = np.floor(size + 1e-9)
    decimals = size - degrees
    if (decimals >= MINUTES).any():
        return ""
    minutes = np.floor(decimals * 100 + 1e-6)
    seconds = (decimals * 100 - minutes) * 100
    # Within one degree, or one minute, both fit alike: the reading is an affine function of the
    # numbers.
    readings = {}
    if (np.ptp(degrees * sign, axis=0) > 0).any():
        readings["degrees and minutes"] = degrees + decimals * 100 / 60
    if (seconds < 60).all() and (np.ptp(minutes, axis=0) > 0).any():
        readings["degrees, minutes and seconds"] = degrees + minutes / 60 + seconds / 3600
    if not readings:
        return ""
    errors = {name: _rms_of_affine_fit(image, sign * size_as_read)
              for name, size_as_read in readings.items()}
    best_reading = min(errors, key=errors.__getitem__)
    if errors[best_reading] >= BETTER * _rms_of_affine_fit(image, ground):
        return ""
    meant = f"{degrees[0, 0]:.0f}\N{DEGREE SIGN}"
    if best_reading == "degrees and minutes":
        meant += f"{decimals[0, 0] * 100:.6g}'"
    else:
        meant += f"{minutes[0, 0]:.0f}'{seconds[0, 0]:.6g}\""
    return (f"Coordinates look like {best_reading} typed as decimals: {ground[0, 0]:.10g} for "
            f"{meant}. Write decimal degrees, or degrees and minutes with their signs.")


def _rms_of_affine_fit(image: FloatArray, ground: FloatArray) -> float:
    """Return the root mean square [px] of the residuals of an affine image of the ground."""
    # x and y are centred and scaled, so that the system is well conditioned.
    plan = ground[:, :2] - ground[:, :2].mean(axis=0)
    plan = plan / np.maximum(np.abs(plan).max(axis=0), np.finfo(float).tiny)
    design = np.column_stack([np.ones(len(plan)), plan])
    residuals = image - design @ np.linalg.lstsq(design, image)[0]
    return float(np.sqrt((residuals**2).sum(axis=1).mean()))
