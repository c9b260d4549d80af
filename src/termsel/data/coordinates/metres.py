"""Small distances on the ground in metres, whatever the CRS."""

from __future__ import annotations

from functools import lru_cache
from math import ceil
from typing import Any

import numpy as np

from termsel.core.errors import GIS, TermselError, require_import
from termsel.data.coordinates.crs import (
    EARTH,
    UTM,
    body_of,
    ellipsoid_of,
    geodetic_of,
    horizontal_crs,
    is_geocentric,
    is_geographic,
    longitudes_and_latitudes_of,
    metres_per_height,
    metres_per_unit,
    transformation_between,
)
from termsel.data.features import FloatArray

TRUE_SCALE = 0.01
"""How far the scale of a projection is from 1 at most where lengths are taken as they stand."""
_LATTICE = 1e4  # metres

COMPASS_TOLERANCE = 10.0
"""How far axes may point off east and north to be called so [deg]; a wind rose has 22.5."""
_STEP_IN_METRES = 10.0  # metres


def offsets_in_metres(crs: str, positions: FloatArray, offsets: FloatArray) -> FloatArray | None:
    """Return offsets (n, 2) to east and north of positions in metres; None if the unit is unknown.

    If a projection shows distances far too long or too short, as Web Mercator does, they are metres
    on the ground. Else they are metres of the projection's plane, as surveyors state them.
    """
    plane_offsets = _offsets_on_plane(crs, positions, offsets)
    if plane_offsets is None or _kind_and_units(crs)[0] or scales_at(crs, positions) is None:
        return plane_offsets
    return plane_offsets / _scales_along_axes(crs, positions)


def scales_at(crs: str, positions: FloatArray) -> tuple[float, float] | None:
    """Return the scales of a projection along x and y in the middle of positions (n, 2 or more).

    None is returned if both are within `TRUE_SCALE` of 1, as those of UTM and of national grids
    are; if the CRS is not projected or unknown; and without positions.
    """
    if not crs or UTM.fullmatch(crs) or not len(positions):
        return None
    unit = _kind_and_units(crs)[2]
    middle = np.nanmedian(positions[:, :2], axis=0)
    if unit is None or not np.isfinite(middle).all():
        return None
    # The middle is rounded to tens of kilometres, so that pyproj is asked once for a scene.
    lattice = _LATTICE / unit
    x, y = (np.round(middle / lattice) * lattice).tolist()
    return _scales_of_place(crs, x, y)


@lru_cache  # a transformation by PROJ for each of a few places
def _scales_of_place(crs: str, x: float, y: float) -> tuple[float, float] | None:
    """Return the scales along x and y at a place; None where they are nearly 1 or not known."""
    along_x, along_y = _scales_along_axes(crs, np.array([[x, y]]))[0].tolist()
    distortion = max(abs(along_x - 1.0), abs(along_y - 1.0))
    return (along_x, along_y) if TRUE_SCALE < distortion < np.inf else None


def _scales_along_axes(crs: str, positions: FloatArray) -> FloatArray:
    """Return how long a projection shows a metre along x and along y at positions, (n, 2).

    The scale is 2 m over the distance in space between the places 1 m of the plane to either side,
    as points of the ellipsoid. So it differs along x and y if the projection is not conformal, and
    holds at the poles, too. It is 1 if the projection is unknown, and NaN at positions that the
    projection does not show.
    """
    angles_of = longitudes_and_latitudes_of(crs)
    unit = _kind_and_units(crs)[2]
    if angles_of is None or unit is None:
        return np.ones((len(positions), 2))
    major, eccentricity = ellipsoid_of(crs)
    scales = []
    for step in (np.array([1.0, 0.0]), np.array([0.0, 1.0])):
        ends = []
        for sign in (-1.0, 1.0):
            angles = angles_of(positions[:, :2] + sign * step / unit)
            # PROJ gives infinite angles outside of what the projection shows.
            lon, lat = np.where(np.isfinite(angles), angles, np.nan).T
            normal_radius = major / np.sqrt(1.0 - eccentricity * np.sin(lat) ** 2)
            ends.append(np.stack([normal_radius * np.cos(lat) * np.cos(lon),
                                  normal_radius * np.cos(lat) * np.sin(lon),
                                  normal_radius * (1.0 - eccentricity) * np.sin(lat)], axis=1))
        # Two metres of the plane lie between the ends.
        scales.append(2.0 / np.linalg.norm(ends[1] - ends[0], axis=1))
    return np.stack(scales, axis=1)


def has_compass_axes(crs: str, positions: FloatArray) -> bool:
    """Return whether x points nearly to the east and y to the north amid positions (n, 2 or more).

    Around a pole a projected y points to the south along one meridian. False is returned without
    positions, and for coordinates without a known CRS, whose axes may point anywhere.
    """
    if not crs or not len(positions):
        return False
    if _kind_and_units(crs)[0] or UTM.fullmatch(crs):
        return True
    angles_of = longitudes_and_latitudes_of(crs)
    unit = _kind_and_units(crs)[2]
    middle = np.nanmedian(positions[:, :2], axis=0)
    if angles_of is None or unit is None or not np.isfinite(middle).all():
        return False
    # The middle, a step from it along x, and one along y.
    steps = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) * _STEP_IN_METRES / unit
    lon, lat = (angles_of(middle + steps)).T
    east = np.cos(lat[0]) * ((lon[1:] - lon[0] + np.pi) % (2.0 * np.pi) - np.pi)
    north = lat[1:] - lat[0]
    deviations = np.abs(np.arctan2([north[0], east[1]], [east[0], north[1]]))
    return bool((deviations <= np.radians(COMPASS_TOLERANCE)).all())


def _offsets_on_plane(crs: str, positions: FloatArray, offsets: FloatArray) -> FloatArray | None:
    """Return offsets (n, 2) of x and y at positions in metres; None if their unit is unknown.

    Those of a projection are metres of its plane. Those in degrees become metres to the east and to
    the north on the ellipsoid.
    """
    if _kind_and_units(crs)[0]:
        # The radii of curvature are N = a / W across the meridian and M = a (1 - e^2) / W^3 along
        # it, with W^2 = 1 - e^2 sin^2 (latitude).
        major, eccentricity = ellipsoid_of(crs)
        latitude = np.radians(positions[:, 1])
        w_squared = 1.0 - eccentricity * np.sin(latitude) ** 2
        normal_radius = major / np.sqrt(w_squared)
        meridian_radius = normal_radius * (1.0 - eccentricity) / w_squared
        # Longitudes of neighbours may differ by a whole turn.
        lon_offsets = (offsets[:, 0] + 180.0) % 360.0 - 180.0
        return np.column_stack([np.radians(lon_offsets) * normal_radius * np.cos(latitude),
                                np.radians(offsets[:, 1]) * meridian_radius])
    unit = _kind_and_units(crs)[2]
    return None if unit is None else offsets * unit


def is_in_degrees(crs: str) -> bool:
    """Return whether x and y are longitude and latitude."""
    return _kind_and_units(crs)[0]


def plan_of(crs: str, ground: FloatArray) -> FloatArray | None:
    """Return x and y of positions (n, 3) from their mean, shape (n, 2), in metres.

    Degrees become metres to the east and to the north. If the unit of x and y is unknown, it stays.
    None is returned for geocentric coordinates, whose x and y are no plan of a scene.
    """
    if crs and _kind_and_units(crs)[1]:
        return None
    plan = ground[:, :2] - ground[:, :2].mean(axis=0)
    # Metres of a projection stay as they are, whatever its scale: models are fitted to its plane.
    metres = _offsets_on_plane(crs, ground, plan) if crs else None
    return plan if metres is None else metres


def height_unit(crs: str) -> float:
    """Return the unit of heights [m]; 1 where nobody knows it."""
    return _kind_and_units(crs)[3] if crs else 1.0


@lru_cache  # PROJ takes milliseconds, and each step of a run asks
def _kind_and_units(crs: str) -> tuple[bool, bool, float | None, float]:
    """Return whether a CRS is geographic, whether geocentric, and its units in metres.

    The units are those of the plane, None if not known, and of heights. It is cached, as it is
    asked at every fit, and pyproj takes its time.
    """
    return is_geographic(crs), is_geocentric(crs), metres_per_unit(crs), metres_per_height(crs)


# Coordinates in metres for a place: zones of UTM, and their like on other bodies.

SOUTH_POLAR, NORTH_POLAR = "EPSG:3031", "EPSG:3413"
"""Polar stereographic projections in metres of the Antarctic and the Arctic."""

POLAR_LATITUDE, TURNING = 60.0, 10.0
"""Latitude beyond which, and difference of longitudes [deg] from which on, a scene is polar."""


def metric_crs(crs: str, lon: float, lat: float) -> str:
    """Return a CRS in metres around a place [deg], whose longitude may go on beyond 180 degrees.

    On the Earth it is the zone of UTM in WGS84. On another body, which `crs` says, it is a
    transverse Mercator projection about the whole degrees next to the place.

    Raises TermselError for a place on the Earth north of 84 N or south of 80 S, where UTM ends.
    """
    lon = (lon + 180) % 360 - 180
    if body_of(crs) != EARTH:
        return _transverse_mercator(crs, round(lon), round(lat))
    if not -80 <= lat <= 84:
        raise TermselError(f"no UTM zone contains longitude {lon:.6g}, latitude {lat:.6g}",
                           hint="UTM goes from 80 S to 84 N: name a projected CRS, --fit-crs "
                                "EPSG:n, such as EPSG:3031 or EPSG:3413.")
    # A border belongs to the zone in the west, as in PROJ's list of zones; asking PROJ takes 0.1 s.
    return f"EPSG:{(32600 if lat >= 0 else 32700) + max(ceil((lon + 180) / 6), 1)}"


@lru_cache  # a projection is asked for with each set of points near a place
def _transverse_mercator(crs: str, lon: int, lat: int) -> str:
    """Return a transverse Mercator projection about a place as WKT."""
    from pyproj import CRS
    from pyproj.crs import ProjectedCRS
    from pyproj.crs.coordinate_operation import TransverseMercatorConversion

    return str(ProjectedCRS(
        TransverseMercatorConversion(lat, lon), name=f"Transverse Mercator about {lat}, {lon}",
        geodetic_crs=CRS(geodetic_of(crs)).to_2d()).to_wkt())


def polar_crs(crs: str, lat: float) -> str:
    """Return a polar stereographic CRS in metres for the pole next to a place [deg].

    On the Earth it is the usual one of the Antarctic or the Arctic. On another body, which `crs`
    says, it is one of its geographic CRS, with true scale at the pole.
    """
    if body_of(crs) == EARTH:
        return SOUTH_POLAR if lat < 0 else NORTH_POLAR
    return _polar_stereographic(crs, 90 if lat >= 0 else -90)


@lru_cache  # a projection is asked for with each set of points near a pole
def _polar_stereographic(crs: str, latitude: int) -> str:
    """Return a stereographic projection about a pole as WKT."""
    from pyproj import CRS
    from pyproj.crs import ProjectedCRS
    from pyproj.crs.coordinate_operation import PolarStereographicAConversion

    return str(ProjectedCRS(
        PolarStereographicAConversion(latitude, 0.0), name=f"Polar stereographic at {latitude}",
        geodetic_crs=CRS(geodetic_of(crs)).to_2d()).to_wkt())


@lru_cache  # a projection is asked for with each set of points of a place
def azimuthal_crs(crs: str, lon: int, lat: int) -> str:
    """Return Lambert's azimuthal equal-area projection about a place [deg] as WKT.

    Its datum is that of `crs`, so that no shift between datums comes in. Raises TermselError if
    pyproj is not installed.
    """
    conversion = _conversions().LambertAzimuthalEqualAreaConversion(lat, lon)
    return _projection_on_datum_of(crs, conversion,
                                   f"Lambert azimuthal about {_in_words(lat, 'NS')}, "
                                   f"{_in_words(lon, 'EW')}")


@lru_cache  # a projection is asked for with each set of points of a place
def mercator_crs(crs: str, lon: int) -> str:
    """Return Mercator's projection with a central meridian [deg], on the datum of `crs`, as WKT."""
    conversion = _conversions().MercatorAConversion(longitude_natural_origin=lon)
    return _projection_on_datum_of(
        crs, conversion, f"Mercator about {_in_words(lon, 'EW')}")


@lru_cache  # projections are asked for with each set of points of a place
def crss_of_the_world(crs: str, lon: int) -> tuple[str, ...]:
    """Return projections that show the whole Earth in an oval, on the datum of `crs`, as WKT.

    They have a central meridian [deg]. Raises TermselError if pyproj is not installed.
    """
    _conversions()
    from pyproj import CRS

    return tuple(_projection_on_datum_of(
        crs, CRS(f"+proj={method} +lon_0={lon} +type=crs").coordinate_operation,
        f"{name} about {_in_words(lon, 'EW')}")
        for name, method in (("Robinson", "robin"), ("Winkel tripel", "wintri"),
                             ("Mollweide", "moll")))


def _conversions() -> Any:
    """Return pyproj's module of conversions; raises TermselError if pyproj is not installed."""
    with require_import("a projection requires", "pyproj", GIS):
        from pyproj.crs import coordinate_operation
    return coordinate_operation


def _in_words(degrees: int, letters: str) -> str:
    """Return whole degrees as 31 N or 102 W; the letters are for those above and below zero."""
    return f"{abs(degrees)} {letters[degrees < 0]}"


def _projection_on_datum_of(crs: str, conversion: Any, name: str) -> str:
    """Return a projection on the datum of a CRS as WKT; the conversion is one of pyproj."""
    from pyproj import CRS
    from pyproj.crs import ProjectedCRS

    return str(ProjectedCRS(conversion, name=name,
                            geodetic_crs=CRS(crs).to_2d().geodetic_crs).to_wkt())


def is_polar(positions: FloatArray) -> bool:
    """Return whether positions lie around a pole; their first columns are longitude and latitude.

    The positions (n, 2 or more) are in degrees. They lie around a pole if all are beyond
    `POLAR_LATITUDE` and their longitudes span more than `TURNING`, so that degrees are no plane
    coordinates; or if some are beyond the zones of UTM, which end at 84 N and 80 S. Positions on
    both sides of the equator do not.
    """
    lon = positions[:, 0]
    lat = positions[:, 1]
    # Latitudes of both signs, or 0: a scene on both sides of the equator.
    if not len(lat) or lat.min() * lat.max() <= 0:
        return False
    lowest_latitude = np.abs(lat).min()
    are_turning = np.ptp(lon) > TURNING
    is_beyond_utm = lat.max() > 84.0 or lat.min() < -80.0
    return bool(lowest_latitude > POLAR_LATITUDE and are_turning) or bool(is_beyond_utm)


def ground_for_warping(ground: FloatArray, crs: str) -> tuple[FloatArray, str]:
    """Return ground coordinates (..., 3) and their CRS without heights, as GDAL's warper needs.

    The warper does not find places whose longitudes go on beyond 180 degrees. Coordinates of such
    are returned in a CRS in metres, with the heights as they were.
    """
    if not is_geographic(crs) or not (np.abs(ground[..., 0]) > 180.0).any():
        return ground, horizontal_crs(crs)
    lon, lat = (float(np.nanmin(ground[..., i]) + np.nanmax(ground[..., i])) / 2 for i in (0, 1))
    zone = metric_crs(crs, lon, lat)
    # GDAL takes heights as they are, and NaN for pixels without a place.
    in_metres = transformation_between(horizontal_crs(crs), zone)(ground.reshape(-1, 3))
    in_metres[:, 2] = ground[..., 2].ravel()
    in_metres[np.isnan(ground[..., 0]).ravel()] = np.nan
    return in_metres.reshape(ground.shape), zone
