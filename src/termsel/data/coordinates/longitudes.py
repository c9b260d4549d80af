"""Longitudes without a jump at the 180 degree meridian."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import lru_cache

import numpy as np

from termsel.core.errors import TermselError
from termsel.data.coordinates.crs import (
    geodetic_of,
    horizontal_crs,
    is_geocentric,
    is_geographic,
    normalise,
    projection_method,
    transformation_between,
)
from termsel.data.features import BoolArray, FeatureSet, FloatArray, Points

TURN = 360.0
"""A full turn [deg]."""

SAME_PLACE = 1e-9
"""Part of a turn within which longitudes are the same."""

_CYLINDRICAL = re.compile("(?!.*(Transverse|Oblique)).*(Mercator|Cylindrical|Miller|Gall)")
"""Methods of projections in which x may be proportional to the longitude."""


def unwrap_longitudes(lon: FloatArray, turn: float = TURN) -> FloatArray:
    """Return longitudes [deg] (n,) that go on beyond 180 degrees where they would jump.

    They come back unchanged if they span half a turn or less, or cannot be brought within half a
    turn. With the turn of `turn_of`, x of a projection is unwrapped in the same way.
    """
    if np.ptp(lon) <= turn / 2:
        return lon
    # On the circle the scene is all but the widest gap, if that is more than half of the circle.
    wrapped = np.sort(lon % turn)
    gaps = np.diff(wrapped, append=wrapped[0] + turn)
    widest = int(np.argmax(gaps))
    if gaps[widest] < turn / 2:
        return lon
    # The scene begins after the gap. Its middle is half of the remaining circle further on.
    first = wrapped[(widest + 1) % len(wrapped)]
    return nearest_longitudes(lon, first + (turn - gaps[widest]) / 2, turn)


def nearest_longitudes(lon: FloatArray, middle: float, turn: float = TURN) -> FloatArray:
    """Return longitudes [deg], (n,), each turned by whole turns to be the nearest to a middle.

    They stay as they are where the turn is 0, as `turn_of` has it for x that does not repeat.
    """
    return np.asarray(lon - turn * np.round((lon - middle) / turn)) if turn else lon


def within_turn(lon: FloatArray, start: float, turn: float) -> FloatArray:
    """Return longitudes [deg], (...), each moved by whole turns to lie within a turn of a start.

    Both ends belong to that turn; rounding moves none. Infinite ones stay.
    """
    turns = (lon - start) / turn
    is_outside = ((turns < -SAME_PLACE) | (turns > 1.0 + SAME_PLACE)) & np.isfinite(turns)
    return np.asarray(lon - turn * np.floor(np.where(is_outside, turns, 0.0)))


def from_start(lon: FloatArray, start: FloatArray, turn: float) -> FloatArray:
    """Return longitudes [deg], each moved by whole turns to lie at a start or within a turn of it.

    Both are arrays of shapes that fit. What is before the start by rounding alone stays there.
    """
    return np.asarray(lon - turn * np.floor((lon - start) / turn + SAME_PLACE))


@lru_cache  # PROJ takes milliseconds, and each scaling asks
def turn_of(crs: str) -> float:
    """Return what a full turn around the Earth adds to x in a CRS, in the units of x.

    It is 360 for longitudes in degrees, and the circumference for cylindrical projections such as
    Web Mercator, where x is proportional to the longitude. For all others it is 0: even with whole
    turns added, their x does not go on across the meridian at which the CRS begins. It is 0, too,
    for "local", and for projections without pyproj.

    Examples
    --------
    >>> turn_of("EPSG:4326"), round(turn_of("EPSG:3857")), turn_of("EPSG:32633")
    (360.0, 40075017, 0.0)
    """
    try:
        if is_geographic(crs):
            return TURN
        if not _CYLINDRICAL.match(projection_method(crs)):
            return 0.0
        to_x = transformation_between(horizontal_crs(geodetic_of(crs)), horizontal_crs(crs),
                                      strict=False)
    except TermselError:  # local coordinates, or without pyproj
        return 0.0
    lon = np.arange(-179.5, 180.0, 1.0)
    rows = [to_x(np.column_stack([lon, np.full_like(lon, lat), np.zeros_like(lon)]))[:, 0]
            for lat in (0.0, 30.0)]
    if not np.isfinite(rows).all():
        return 0.0
    degree = float(np.median(np.diff(rows[0])))
    # x is proportional to the longitude if all steps are alike, but for one jump at the meridian
    # where the CRS begins, and if it is the same at both latitudes.
    is_like_degree = np.abs(np.diff(rows) - degree) < 1e-6 * abs(degree)
    is_cylindrical = (degree > 0 and (is_like_degree.sum(axis=1) >= len(lon) - 2).all()
                      and np.abs(rows[1] - rows[0]).max() < 1e-6 * degree)
    return TURN * degree if is_cylindrical else 0.0


def has_longitude_jump(features: FeatureSet) -> bool:
    """Return whether x jumps by a full turn between control and check features."""
    decides = _deciding_vertices(features) if _may_jump(features) else np.zeros(0, dtype=bool)
    if not decides.any():
        return False
    lon = features.ground_vertices()[decides, 0]
    return bool((_continuous_longitudes(features) != lon).any())


def without_jump(features: FeatureSet) -> FeatureSet:
    """Return features whose longitudes, or x, go on where they would jump by a full turn.

    Control and check points decide where the scene is, and the others follow by whole turns. Where
    they span more than half a turn, `x_start` is set. The same object comes back if they span less
    and nothing jumps, if no vertex decides, and if the deciding ones span more than a turn.
    """
    if not _may_jump(features):
        return features
    points = features.points
    lines = features.lines
    all_longitudes = features.ground_vertices()[:, 0]
    turn = turn_of(features.crs)
    decides = _deciding_vertices(features)
    if not decides.any():
        return features
    lon = _continuous_longitudes(features)
    if np.ptp(lon) > turn:
        return features
    start = _start_of_map(lon, turn, as_written=bool((lon == all_longitudes[decides]).all()))
    if np.ptp(lon) > turn / 2:
        features = replace(features, x_start=start)
    unwrapped = within_turn(all_longitudes, start, turn)
    if (unwrapped == all_longitudes).all():
        return features
    ground_of_points = points.ground.copy()
    ground_of_lines = lines.ground.copy()
    ground_of_points[:, 0] = unwrapped[:len(points)]
    ground_of_lines[..., 0] = unwrapped[len(points):].reshape(-1, 2)
    return features.with_(points=replace(points, ground=ground_of_points),
                          lines=replace(lines, ground=ground_of_lines))


def beside_control(x: FloatArray, control: FeatureSet) -> FloatArray:
    """Return longitudes, or x, (n,), by whole turns next to the control.

    Of a map of more than half of the world they are those between its edges.
    """
    turn = turn_of(control.crs)
    if not turn:
        return x
    of_control = control.ground_vertices()[:, 0]
    middle = float(of_control.min() + of_control.max()) / 2
    return (nearest_longitudes(x, middle, turn) if control.x_start is None
            else within_turn(x, control.x_start, turn))


def _start_of_map(lon: FloatArray, turn: float, *, as_written: bool) -> float:
    """Return the longitude, or x, at which the turn begins in which all places are meant.

    It lies half a turn before the middle of the scene. A map of more than half of the world hardly
    begins there, though: where its longitudes go on `as_written`, it begins where these count from,
    at -180 or 0 degrees.
    """
    low, high = float(lon.min()), float(lon.max())
    if as_written and high - low > turn / 2:
        for start in (-turn / 2, 0.0):
            if low >= start and high <= start + turn:
                return start
    return (low + high) / 2 - turn / 2


def _may_jump(features: FeatureSet) -> bool:
    """Return whether x goes round the Earth, and features span more than half of a turn.

    Nothing jumps in features that span less, as nearly all scenes do.
    """
    turn = turn_of(features.crs)
    if not turn or not len(features):
        return False
    return bool(np.ptp(features.ground_vertices()[:, 0]) > turn / 2)


def _continuous_longitudes(features: FeatureSet) -> FloatArray:
    """Return the longitudes, or x, (v,) of the deciding vertices without a jump, in their order.

    If they span more than half a turn, the image of enough points may show where the map begins.
    """
    turn = turn_of(features.crs)
    written = features.ground_vertices()[_deciding_vertices(features), 0]
    lon = unwrap_longitudes(written, turn)
    points = features.points
    decides = ~_is_set_aside(points)
    count = int(decides.sum())
    ground, image = points.ground[decides, :2], points.image[decides]
    # Few places of a map of the world may leave half of it empty: nothing jumps then.
    if count >= LEAST_TO_DOUBT and (lon != written).any():
        of_points = np.stack([lon[:count], written[:count]])
        continuous_misfit, written_misfit = _misfits_of_affine(of_points, ground[:, 1], image)
        if written_misfit < CLEARER_SEAM * continuous_misfit:
            lon = written
    # Of longitudes within half a turn there is only one order.
    if np.ptp(lon) <= turn / 2 or count < LEAST_FOR_SEAM:
        return lon
    start = _seam_by_image(ground, image, turn)
    return lon if start is None else from_start(lon, np.array(start), turn)


LEAST_FOR_SEAM, LEAST_TO_DOUBT = 8, 4
"""Points from which an image shows where a map of the world begins, and from which on it shows
that longitudes do not jump, though they leave half of the Earth empty."""

CLEARER_SEAM = 0.4
"""Part of the misfit as the longitudes are written to which another seam must bring it."""


def _seam_by_image(ground: FloatArray, image: FloatArray, turn: float) -> float | None:
    """Return the longitude, or x, at which a map of more than half the world begins.

    A map whose edge is in the Pacific may be as wide as the globe, so that no gap between the
    longitudes shows where it begins. Its image shows it: neighbours on either side of the edge lie
    at opposite ends of the image. An affine transformation of (longitude, latitude) is fitted with
    each point in turn as the first one east of the edge. Maps around a pole fit badly with every
    edge.

    Parameters
    ----------
    ground : (n, 2) longitude and latitude [deg], or x and y
    image : (n, 2) line and sample [px]
    turn : what a full turn adds to x

    Returns
    -------
    start : float or None
        None if no edge makes the fit clearly better than the longitudes as they are.
    """
    lon = ground[:, 0]
    starts = np.unique((lon + turn / 2) % turn - turn / 2)
    # Row 0 has the longitudes as they are, each further row those of a map that begins at a start.
    from_starts = from_start(lon, starts[:, None], turn)
    candidates = np.concatenate([lon[None], from_starts])
    misfits = _misfits_of_affine(candidates, ground[:, 1], image)
    best = int(np.argmin(misfits[1:]))
    return float(starts[best]) if misfits[1 + best] < CLEARER_SEAM * misfits[0] else None


def _misfits_of_affine(lon: FloatArray, lat: FloatArray, image: FloatArray) -> FloatArray:
    """Return the roots of the summed squared residuals [px] of affine transformations, (c,).

    They take longitudes (c, n), of c candidates, and latitudes (n,) to lines and samples (n, 2).
    """
    # The columns of the affine transformation are 1, longitude and latitude.
    columns = np.stack(np.broadcast_arrays(1.0, lon, lat), axis=-1)
    basis = np.linalg.qr(columns)[0]
    residuals = image - basis @ (basis.transpose(0, 2, 1) @ image)
    return np.asarray(np.sqrt((residuals**2).sum(axis=(1, 2))))


def _is_set_aside(points: Points) -> BoolArray:
    """Return which points are independent or switched off, (n,)."""
    return np.isin(np.array(points.roles, dtype=object), ("independent", "off"))


def _deciding_vertices(features: FeatureSet) -> BoolArray:
    """Return the ground vertices whose longitudes decide, (v,): independent points do not."""
    of_lines = np.ones(2 * len(features.lines), dtype=bool)
    return np.concatenate([~_is_set_aside(features.points), of_lines])


# Horizontal places of points that are the same in every CRS.

FINEST = 1e-5
"""Part of their extent to which places are rounded: coordinates are written with few digits, and
places on one meridian must stay on one."""


def to_globe(ground: FloatArray, crs: str) -> FloatArray:
    """Return places (n, 3) with longitude and latitude in place of x and y; the rest stays.

    They are in degrees, or in gon if the CRS is. The third column is a height or, in a geocentric
    CRS, Z. The first two are rounded to a small part of their extent; a single place has none, and
    is not rounded. If the CRS does not give longitudes, as "local" or most without pyproj, x and y
    are rounded instead.
    """
    if not len(ground):
        return ground
    geodetic = _with_longitudes(ground, normalise(crs))
    extent = np.ptp(geodetic[:, :2], axis=0).max(initial=0.0)
    if not 0.0 < extent < np.inf:
        return geodetic
    # Rounding to decimal digits hardly depends on the extent, which may itself differ by rounding.
    digits = -int(np.floor(np.log10(FINEST * extent)))
    geodetic[:, :2] = np.round(geodetic[:, :2], digits)
    return geodetic


def _with_longitudes(ground: FloatArray, crs: str) -> FloatArray:
    """Return positions (n, 3) with longitude and latitude in place of x and y; the rest stays.

    They are in the angular unit of the CRS, and go on beyond 180 degrees rather than jump. If x and
    y of any position cannot be transformed, as in "local", all stay. A copy is returned.
    """
    positions = ground.copy()
    try:
        if is_geocentric(crs):
            positions[:, :2] = transformation_between(crs, geodetic_of(crs))(ground)[:, :2]
        elif not is_geographic(crs):
            geodetic = horizontal_crs(geodetic_of(crs))
            transform = transformation_between(horizontal_crs(crs), geodetic, strict=False)
            # Heights are of no account in the plane, and may be unknown.
            positions[:, :2] = transform(np.nan_to_num(ground))[:, :2]
    except TermselError:  # no CRS, or one that needs pyproj: x and y have to do
        return ground.copy()
    if not np.isfinite(positions[:, :2]).all():
        return ground.copy()
    positions[:, 0] = unwrap_longitudes(positions[:, 0])
    return positions
