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

    They are metres on the ground where a projection shows distances far too long or too short, as
    Web Mercator does; else those of the plane, as surveyors state them.
    """
    plane = _offsets_on_plane(crs, positions, offsets)
    if plane is None or _kind_and_units(crs)[0] or scales_at(crs, positions) is None:
        return plane
    return plane / _scales_along_axes(crs, positions)


def scales_at(crs: str, positions: FloatArray) -> tuple[float, float] | None:
    """Return the scales of a projection along x and y in the middle of positions (n, 2 or more).

    None where both are within `TRUE_SCALE` of 1, as that of UTM and of national grids is, and where
    there is none.
    """
    if not crs or UTM.fullmatch(crs) or not len(positions):
        return None
    unit = _kind_and_units(crs)[2]
    middle = np.nanmedian(positions[:, :2], axis=0)
    if unit is None or not np.isfinite(middle).all():
        return None
    # By whole tens of kilometres, so that pyproj is asked once for a scene.
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

    That is found from places a metre to either side, as points of the ellipsoid in space: a
    projection need not be conformal, and a pole is then a place like any other. A scale is 1 where
    the projection is not known, and NaN where it shows nothing.
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
            # Outside of what the projection shows there is no scale.
            lon, lat = np.where(np.isfinite(angles), angles, np.nan).T
            normal_radius = major / np.sqrt(1.0 - eccentricity * np.sin(lat) ** 2)
            ends.append(np.stack([normal_radius * np.cos(lat) * np.cos(lon),
                                  normal_radius * np.cos(lat) * np.sin(lon),
                                  normal_radius * (1.0 - eccentricity) * np.sin(lat)], axis=1))
        # Two metres of the plane lie between the ends.
        scales.append(2.0 / np.linalg.norm(ends[1] - ends[0], axis=1))
    return np.stack(scales, axis=1)


def has_compass_axes(crs: str, positions: FloatArray) -> bool:
    """Return whether x points to the east and y to the north, nearly, at positions (n, 2 or more).

    They need not: around a pole a projected y is south along one meridian. False comes back without
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
    # Where a step along x and one along y lead, as steps to the east and to the north.
    steps = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) * _STEP_IN_METRES / unit
    lon, lat = (angles_of(middle + steps)).T
    east = np.cos(lat[0]) * ((lon[1:] - lon[0] + np.pi) % (2.0 * np.pi) - np.pi)
    north = lat[1:] - lat[0]
    deviations = np.abs(np.arctan2([north[0], east[1]], [east[0], north[1]]))
    return bool((deviations <= np.radians(COMPASS_TOLERANCE)).all())


def _offsets_on_plane(crs: str, positions: FloatArray, offsets: FloatArray) -> FloatArray | None:
    """Return offsets (n, 2) in metres of the plane of a CRS, or to east and north of degrees."""
    if _kind_and_units(crs)[0]:
        # Radii of curvature: N = a / W along the parallel, M = a (1 - e^2) / W^3 along the
        # meridian, with W^2 = 1 - e^2 sin^2 (latitude).
        major, eccentricity = ellipsoid_of(crs)
        latitude = np.radians(positions[:, 1])
        w_squared = 1.0 - eccentricity * np.sin(latitude) ** 2
        normal_radius = major / np.sqrt(w_squared)
        meridian_radius = normal_radius * (1.0 - eccentricity) / w_squared
        # Longitudes may differ by a turn.
        x = (offsets[:, 0] + 180.0) % 360.0 - 180.0
        return np.column_stack([np.radians(x) * normal_radius * np.cos(latitude),
                                np.radians(offsets[:, 1]) * meridian_radius])
    unit = _kind_and_units(crs)[2]
    return None if unit is None else offsets * unit


def is_in_degrees(crs: str) -> bool:
    """Return whether x and y are longitude and latitude."""
    return _kind_and_units(crs)[0]


def plan_of(crs: str, ground: FloatArray) -> FloatArray | None:
    """Return positions (n, 3) from their middle, to the east and to the north (n, 2), in metres.

    In the units of x and y where nobody knows these. None for geocentric coordinates, in which a
    scene may be seen from its side.
    """
    if crs and _kind_and_units(crs)[1]:
        return None
    plan = ground[:, :2] - ground[:, :2].mean(axis=0)
    # Models of the plane take it as it is, whatever the scale of its projection.
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

    The zone of UTM; on another body than the Earth, that of `crs`, a transverse Mercator projection
    about the whole degrees next to the place.

    Raises TermselError for a place on the Earth north of 84 N or south of 80 S, where UTM ends.
    """
    lon = (lon + 180) % 360 - 180
    if body_of(crs) != EARTH:
        return _transverse_mercator(crs, round(lon), round(lat))
    if not -80 <= lat <= 84:
        raise TermselError(f"no UTM zone contains longitude {lon:.6g}, latitude {lat:.6g}",
                           hint="UTM goes from 80 S to 84 N: name a projected CRS, --fit-crs "
                                "EPSG:n, such as EPSG:3031 or EPSG:3413.")
    # On a border the zone to the west, as PROJ's list of zones says; asking it takes 0.1 s.
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

    On the Earth those of the Antarctic and the Arctic; on another body one with true scale at the
    pole, of its geographic CRS.
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
    """Return whether positions, as longitudes and latitudes [deg], lie around a pole.

    There meridians turn by much within a scene, so that degrees are no plane coordinates: by more
    than `TURNING` from one end to the other, next to a pole (beyond `POLAR_LATITUDE`); or UTM has
    no zone.
    """
    lon = positions[:, 0]
    lat = positions[:, 1]
    if not len(lat) or lat.min() * lat.max() <= 0:
        return False
    nearest = np.abs(lat).min()
    turning = np.ptp(lon) > TURNING
    return bool(nearest > POLAR_LATITUDE and turning) or bool(lat.max() > 84.0 or lat.min() < -80.0)


def ground_for_warping(ground: FloatArray, crs: str) -> tuple[FloatArray, str]:
    """Return ground coordinates (..., 3), and the CRS without heights, for GDAL's warper."""
    # It does not find places whose longitudes go on beyond 180 degrees: these come in UTM.
    if not is_geographic(crs) or not (np.abs(ground[..., 0]) > 180.0).any():
        return ground, horizontal_crs(crs)
    lon, lat = (float(np.nanmin(ground[..., i]) + np.nanmax(ground[..., i])) / 2 for i in (0, 1))
    zone = metric_crs(crs, lon, lat)
    # GDAL takes heights as they are, and blank places as no places.
    turned = transformation_between(horizontal_crs(crs), zone)(ground.reshape(-1, 3))
    turned[:, 2] = ground[..., 2].ravel()
    turned[np.isnan(ground[..., 0]).ravel()] = np.nan
    return turned.reshape(ground.shape), zone
