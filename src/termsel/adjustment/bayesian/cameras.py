"""What scanners, radars and frame cameras see of a place, drawn from all that are plausible.

A satellite is at a height of 450 to 850 km, and the Earth turns below it. A scanner has a steady
attitude: it turns with the orbit, and with small rates of its own. A radar looks sideways. A frame
camera in an aircraft looks down. The direction in which lines follow each other is that of the
control, all else is drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from termsel.adjustment.compiled import compile_lazily
from termsel.adjustment.fused import fused
from termsel.data.coordinates.crs import EARTH, body_of, metres_per_unit
from termsel.data.coordinates.metres import is_in_degrees, plan_of
from termsel.data.coordinates.wgs84 import EARTH_ROTATION, GRAVITY_CONSTANT, to_ecef
from termsel.data.features import BoolArray, FloatArray
from termsel.data.scaling import Scaling

N_CAMERAS = 200
"""Scanners and frame cameras that are drawn; of radars half of it on either side."""

EARTH_RADIUS = 6371e3
"""Mean radius of the Earth [m]."""

ORBIT_ALTITUDES = (450e3, 850e3)
"""Least and greatest height of a satellite [m]."""

SCANNER_INCIDENCE = np.radians(35.0)
"""Largest angle between ray and vertical on the ground: products beyond are rare."""

RADAR_INCIDENCE = tuple(np.radians([18.0, 52.0]))
"""Angles between ray and vertical at the middle of the image of a radar: others are rare."""

RADAR_SINES = tuple(np.sin(np.radians([15.0, 60.0])))
"""Sines of the smallest and the largest of its other places. No image crosses the track."""

RADAR_CLIMB = 50.0
"""Standard deviation of how fast the height changes at which ranges are put on the ground [m/s]:
processors take that of the terrain along the flight."""

FRAME_EXTENT = (0.1, 1.0)
"""Half the extent of the places by the height of a frame camera above them: from long lenses and
parts of a photo to wide angles."""

FRAME_TILT = np.radians(3.0)
"""Standard deviation of its tilt: that of vertical photos."""

FRAME_OFFSET = 0.25
"""Standard deviation of its distance from the middle, by the extent."""

CAMERA_YAW = np.radians(3.0)
"""Standard deviation of the angle between flight and scan, which compensates the rotation of the
Earth."""

ATTITUDE_RATE = 3e-5
"""Standard deviation of rates of attitude [rad/s]: steady platforms state some 1e-5 to 5e-5."""

ATTITUDE_RATE_CHANGE = 5e-7
"""Standard deviation of how these rates change [rad/s^2], within about a minute."""

MAX_LATITUDE = 60.0
"""Largest latitude of places where it is not known."""

MAX_SECANT_STEPS = 8
"""Most steps to the time at which a place is seen."""

FIRST_STEP = 1e-3
"""Least first step [s]."""

TIME_TOLERANCE = 1e-6
"""Step at which the time is found [s]."""

MAX_TIME = 500.0
"""Longest time before or after that of the middle [s]."""

GROUND_SPEED = 7e3
"""How fast a satellite passes the ground [m/s]."""


def east_north_up(scaling: Scaling, crs: str,
                  scaled: FloatArray) -> tuple[FloatArray, float] | None:
    """Return scaled places to the east, north and up of their middle [m], (m, 3), and its latitude.

    The latitude is in degrees, NaN where it is not known. Returns None on other bodies than the
    Earth, and for geocentric coordinates.
    """
    ground_crs = scaling.fit_crs or crs
    middle = np.array(scaling.ground_offset)
    ground = scaled * scaling.ground_scale + middle
    # On other bodies, and in a plane of which nobody knows the map, satellites cannot be placed.
    if body_of(ground_crs) != EARTH or (ground_crs and plan_of(ground_crs, ground) is None):
        return None
    if ground_crs and is_in_degrees(ground_crs):
        # East and north at the middle, and up as their product.
        lon, lat = np.radians(middle[:2])
        east = np.array([-np.sin(lon), np.cos(lon), 0.0])
        north = np.array(
            [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)])
        offsets = to_ecef(ground) - to_ecef(middle[None])
        return offsets @ np.stack([east, north, np.cross(east, north)], axis=1), float(middle[1])
    offsets = ground - middle
    offsets[:, :2] *= metres_per_unit(ground_crs) or 1.0 if ground_crs else 1.0
    # The drop of a sphere below its tangential plane: d^2 / (2 R).
    offsets[:, 2] -= (offsets[:, :2] ** 2).sum(axis=1) / (2 * EARTH_RADIUS)
    return offsets, np.nan


_compiled = partial(compile_lazily, _nrt=False)
_inlined = partial(_compiled, forceinline=True)


class _Flights(NamedTuple):
    """Circular orbits, in axes to the east, north and up whose origin is the centre of the Earth.
    """

    station: FloatArray  # (c, 3): where satellites are at the time 0 [m]
    ray: FloatArray      # (c, 3): from the middle of the places to the satellite
    orbit: FloatArray    # (c, 3): the axis about which satellites turn
    motion: FloatArray   # (c,): how fast [rad/s]
    pole: FloatArray     # (c, 3)


def _simulate_flights(rng: np.random.Generator, heading: FloatArray, latitude: float,
                      tilt: FloatArray, toward: FloatArray, altitude: FloatArray) -> _Flights:
    """Return the stations of n satellites, seen from the middle of the image, and how they move.

    `heading` (n,) is the direction of flight and `toward` (n,) that to the satellite, clockwise
    from north; `tilt` (n,) is the angle of the ray from the vertical [rad]. The `latitude` of the
    middle is in degrees, NaN if it is not known; the `altitude` (n,) is in metres.
    """
    # Latitudes that are not known are drawn as all else is.
    drawn_latitude = rng.uniform(-MAX_LATITUDE, MAX_LATITUDE, len(tilt))
    lat = np.radians(np.where(np.isnan(latitude), drawn_latitude, latitude))
    # Axes are east, north and up at the middle of the image; the origin is the Earth's centre.
    ray = np.stack([np.sin(tilt) * np.sin(toward), np.sin(tilt) * np.cos(toward), np.cos(tilt)], 1)
    radius = EARTH_RADIUS + altitude
    # The law of cosines in the triangle of the Earth's centre, the place and the satellite.
    along_ray = EARTH_RADIUS * np.cos(tilt)
    station = [0.0, 0.0, EARTH_RADIUS] + ray * (
        np.sqrt(along_ray**2 - EARTH_RADIUS**2 + radius**2) - along_ray)[:, None]
    up = station / radius[:, None]
    ahead = np.stack([np.sin(heading), np.cos(heading), np.zeros(len(tilt))], axis=1)
    ahead = _unit_vectors(ahead - up * (ahead * up).sum(axis=1, keepdims=True))
    # Kepler: the square of the angular speed is G M / r^3.
    return _Flights(station, ray, np.cross(up, ahead), np.sqrt(GRAVITY_CONSTANT / radius**3),
                    np.stack([np.zeros(len(tilt)), np.cos(lat), np.sin(lat)], axis=1))


def scanner_views(positions: FloatArray, azimuth: float, latitude: float) -> tuple[FloatArray, ...]:
    """Return where c scanners see m places: time [s] and slope across the track, (c, m, 2).

    The array is the only one of the tuple. `positions` (m, 3) are the places to the east, north and
    up of their middle [m]. The azimuth of the scan is clockwise from north [rad]; the latitude is
    in degrees, NaN if it is not known. Of N_CAMERAS scanners those that do not see all places are
    left out.
    """
    rng = np.random.default_rng(0)
    n = N_CAMERAS  # a prior is the same for all data
    altitude, tilt, toward = (rng.uniform(0.0, 1.0, n) for _ in range(3))
    yaw, rate, change = (scale * rng.standard_normal((n, 3))
                         for scale in (CAMERA_YAW, ATTITUDE_RATE, ATTITUDE_RATE_CHANGE))
    flights = _simulate_flights(rng, azimuth + yaw[:, 0], latitude, tilt * SCANNER_INCIDENCE,
                                toward * 2 * np.pi, ORBIT_ALTITUDES[0] + altitude *
                                (ORBIT_ALTITUDES[1] - ORBIT_ALTITUDES[0]))
    ray = flights.ray
    x = np.broadcast_to([np.sin(azimuth), np.cos(azimuth), 0.0], (n, 3))
    # The line of the scan, at right angles to the ray.
    x = _unit_vectors(x + ray * -(x * ray).sum(axis=1, keepdims=True))
    axes = np.stack([x, np.cross(-ray, x), -ray], axis=2)
    places = _from_centre(positions)

    def view(time: FloatArray, views: FloatArray) -> None:
        """Fill in how far the view of places is off line and sample: 0 when they are seen."""
        _fill_scanner_views(flights, places, time, axes, rate, change, views)

    (time, sample), seen = _views_at_sight(view, positions, azimuth, n)
    return (np.stack([time, sample], axis=-1)[seen],)


def radar_views(positions: FloatArray, azimuth: float, latitude: float, *,
                right: bool) -> tuple[FloatArray, ...]:
    """Return where c radars see m places, in images in slant range and in ground range.

    Of the simulated radars those count that see all places, at sines of incidence that RADAR_SINES
    allows. Both arrays (c, m, 2) have first the time [s] at which a place is nearest. Second is, in
    slant range, the range along the ray [m] and, in ground range, the angle at the Earth's centre
    [rad] that a sphere at the height of the middle gives it. `positions` (m, 3) are as for
    `scanner_views`. Radars look to the right or to the left of the flight; the azimuth of lines is
    clockwise from north [rad]; the latitude is in degrees, NaN if it is not known.
    """
    rng = np.random.default_rng(0)
    n = N_CAMERAS // 2
    altitude_share, incidence_share = (rng.uniform(0.0, 1.0, n) for _ in range(2))
    lowest, highest = ORBIT_ALTITUDES
    altitude = lowest + altitude_share * (highest - lowest)
    steepest, flattest = RADAR_INCIDENCE
    incidence = steepest + incidence_share * (flattest - steepest)
    heading = azimuth + CAMERA_YAW * rng.standard_normal(n)
    toward = heading + (-0.5 if right else 0.5) * np.pi
    flights = _simulate_flights(rng, heading, latitude, incidence, toward, altitude)
    orbit_radius = np.linalg.norm(flights.station, axis=1)
    climb = RADAR_CLIMB * rng.standard_normal(n)
    places = _from_centre(positions)

    def view(time: FloatArray, views: FloatArray) -> None:
        """Fill in Doppler, which is 0 when places are seen, and range."""
        _fill_radar_views(flights, places, time, orbit_radius, views)

    (time, distance), seen = _views_at_sight(view, positions, azimuth, n)
    # What puts a range on the ground is a sphere whose radius drifts.
    surface = EARTH_RADIUS + climb[:, None] * time
    cosine = _cosine_at_centre(orbit_radius[:, None], surface, distance)
    # The law of sines, of ray and vertical: sin i / R = sin g / d.
    sine = np.sqrt(1.0 - cosine**2) * orbit_radius[:, None] / distance
    seen &= ((sine > RADAR_SINES[0]) & (sine < RADAR_SINES[1])).all(axis=1)
    return (np.stack([time, distance], axis=-1)[seen],
            np.stack([time, np.arccos(cosine)], axis=-1)[seen])


def _cosine_at_centre(orbit_radius: FloatArray, surface: FloatArray,
                      distance: FloatArray) -> FloatArray:
    """Return cosines of the angle g at the Earth's centre between satellites and places.

    The law of cosines of the radii R and r and the distance d: cos g = (R^2 + r^2 - d^2) / (2 R r).
    """
    cosine = (orbit_radius**2 + surface**2 - distance**2) / (2 * orbit_radius * surface)
    return np.asarray(np.clip(cosine, -1.0, 1.0))


def frame_views(positions: FloatArray, azimuth: float) -> tuple[FloatArray, ...]:
    """Return where c frame cameras see m places: the slopes of their rays, (c, m, 2).

    Arguments and result are as for `scanner_views`.
    """
    rng = np.random.default_rng(0)
    n = N_CAMERAS
    extent = 2.0 * np.abs(positions[:, :2]).max()
    # Heights are log-uniform between their ends, as they differ by a factor of ten.
    height = extent / 2 / FRAME_EXTENT[0] * (FRAME_EXTENT[0] / FRAME_EXTENT[1]) ** rng.uniform(
        0.0, 1.0, n)
    offset = FRAME_OFFSET * extent * rng.standard_normal((n, 2))
    tilt = FRAME_TILT * rng.standard_normal((n, 2))
    east = np.sin(azimuth)
    north = np.cos(azimuth)
    x = positions @ np.array([east, north, 0.0]) - offset[:, :1]
    y = positions @ np.array([north, -east, 0.0]) - offset[:, 1:]
    drop = height[:, None] - positions[:, 2]
    # The depth along the tilted view, to first order in the tilt.
    depth = drop + tilt[:, :1] * x + tilt[:, 1:] * y
    slopes = np.stack([x - tilt[:, :1] * drop, y - tilt[:, 1:] * drop], axis=-1) / depth[..., None]
    # A place at the height of the camera, or above it, is in no photo.
    return (np.asarray(slopes[(depth > height[:, None] / 10).all(axis=1)]),)


def _from_centre(positions: FloatArray) -> FloatArray:
    """Return places (m, 3) from the centre of the Earth, (3, m): those of `_Flights`."""
    return np.ascontiguousarray((positions + np.array([0.0, 0.0, EARTH_RADIUS])).T)


def _views_at_sight(fill_views: Callable[[FloatArray, FloatArray], None], positions: FloatArray,
                    azimuth: float, cameras: int) -> tuple[FloatArray, BoolArray]:
    """Return when c cameras see m places, with what they see then, and which cameras see all.

    A view has two numbers, which `fill_views` fills in, (2, c, m), at times (c, m) [s]. A place is
    seen when the first of them is 0. The first array (2, c, m) has these times [s] and the second
    number, the other one (c,) is True for cameras that see all places. The places `positions`
    (m, 3) [m] are passed in the direction `azimuth` [rad]; `cameras` is c.
    """
    # A satellite passes the ground at 7 km/s: the first guess of the time.
    guess = positions @ np.array([np.sin(azimuth), np.cos(azimuth), 0.0]) / GROUND_SPEED
    step = np.tile(np.where(np.abs(guess) < FIRST_STEP, FIRST_STEP, guess), (cameras, 1))
    time = np.zeros_like(step)
    views, previous = np.empty((2, 2, *step.shape))
    fill_views(time, views)
    largest = float(np.abs(step).max())
    for _ in range(MAX_SECANT_STEPS):  # the secant method
        if largest < TIME_TOLERANCE:
            break
        time += step
        np.clip(time, -MAX_TIME, MAX_TIME, out=time)
        views, previous = previous, views
        fill_views(time, views)
        largest = _take_secant_steps(views[0].ravel(), previous[0].ravel(), step.ravel())
    views[0] = time
    # Cameras for which some place is never seen are left out of the prior.
    seen = np.isfinite(views).all(axis=(0, 2)) & (np.abs(step).max(axis=1) < TIME_TOLERANCE) & (
        np.abs(time).max(axis=1) < MAX_TIME)
    return views, np.asarray(seen)


@_compiled
def _take_secant_steps(off: FloatArray, previous: FloatArray, step: FloatArray) -> float:
    """Replace `step` (l,) by the next steps of the secant method, and return the largest size.

    `off` (l,) is what should be 0, after the steps, and `previous` (l,) was the same before them.
    NaN is returned if one of the steps is NaN.
    """
    largest = 0.0
    for i in range(len(step)):
        change = off[i] - previous[i]
        step[i] = -off[i] * step[i] / change if not abs(change) <= 1e-13 else 0.0
        largest = largest if abs(step[i]) <= largest else abs(step[i])
    return largest


def _unit_vectors(vectors: FloatArray) -> FloatArray:
    """Return vectors (..., d) divided by their length."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def rotate(vectors: FloatArray, axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Return vectors (., m, 3) turned about axes (c, 3) by angles (c, m)."""
    turned = np.empty((3, *angle.shape))
    turned[:] = np.moveaxis(vectors, -1, 0)
    _turn(turned, axis, angle)
    return np.moveaxis(turned, 0, -1)


def _turn(vectors: FloatArray, axis: FloatArray, angle: FloatArray) -> None:
    """Turn vectors (3, c, m) about axes (c, 3) by angles (c, m), in place."""
    _add_rotation(vectors[0], vectors[1], vectors[2], axis, np.sin(angle), 1.0 - np.cos(angle))


@_compiled
def _add_rotation(x: FloatArray, y: FloatArray, z: FloatArray, axis: FloatArray, sine: FloatArray,
                  one_less_cosine: FloatArray) -> None:
    """Turn vectors v by Rodrigues' formula, v + sin(angle) a x v + (1 - cos(angle)) a x (a x v).

    Their components x, y and z (c, m) are changed in place. `axis` (c, 3) is the unit vector a of
    each camera; `sine` and `one_less_cosine` (c, m) are of its angles.
    """
    # Fused operations round alike on every machine: the rate of a range is a difference of two
    # nearly equal ones, in which rounding shows.
    for c in range(len(axis)):
        a = axis[c, 0]
        b = axis[c, 1]
        d = axis[c, 2]
        for m in range(x.shape[1]):
            u = fused(z[c, m], b, -(d * y[c, m]))
            v = fused(z[c, m], -a, d * x[c, m])
            w = fused(y[c, m], a, -(b * x[c, m]))
            x[c, m] = x[c, m] + sine[c, m] * u + one_less_cosine[c, m] * fused(w, b, -(d * v))
            y[c, m] = y[c, m] + sine[c, m] * v + one_less_cosine[c, m] * fused(w, -a, d * u)
            z[c, m] = z[c, m] + sine[c, m] * w + one_less_cosine[c, m] * fused(v, a, -(b * u))


# Views by kernels: what many cameras see of many places is far more than all else of a prior.


@_inlined
def _turned_vector(x: float, y: float, z: float, axis: FloatArray,
                   angle: float) -> tuple[float, float, float]:
    """Return a vector turned about an axis (3,) by an angle of at most a radian.

    By Rodrigues' formula (see `_add_rotation`), with the series of sine and cosine: a satellite
    turns by less than 0.6 within MAX_TIME.
    """
    a, b, d = axis[0], axis[1], axis[2]
    square = angle * angle
    # Horner's scheme of sin x = x - x^3 / 3! + ... and 1 - cos x = x^2 / 2! - x^4 / 4! + ...
    sine = angle * (1.0 - square / 6 * (1.0 - square / 20 * (1.0 - square / 42 * (
        1.0 - square / 72 * (1.0 - square / 110 * (1.0 - square / 156 * (1.0 - square / 210)))))))
    one_less_cosine = square / 2 * (1.0 - square / 12 * (1.0 - square / 30 * (
        1.0 - square / 56 * (1.0 - square / 90 * (1.0 - square / 132 * (
            1.0 - square / 182 * (1.0 - square / 240)))))))
    one_less_cosine = 1.0 - (1.0 - one_less_cosine)  # rounded as a cosine is
    # (u, v, w) is the cross product of the axis and the vector.
    u = fused(z, b, -(d * y))
    v = fused(z, -a, d * x)
    w = fused(y, a, -(b * x))
    return (x + sine * u + one_less_cosine * fused(w, b, -(d * v)),
            y + sine * v + one_less_cosine * fused(w, -a, d * u),
            z + sine * w + one_less_cosine * fused(v, a, -(b * u)))


@_inlined
def _line_of_sight(flights: _Flights, c: int, places: FloatArray, m: int,
                   time: float) -> tuple[float, float, float]:
    """Return the vector from the satellite of a camera to a place at a time.

    In axes that turn with the orbit the satellite rests; the Earth turns in inertial space.
    """
    x, y, z = _turned_vector(places[0, m], places[1, m], places[2, m], flights.pole[c],
                             EARTH_ROTATION * time)
    x, y, z = _turned_vector(x, y, z, flights.orbit[c], -flights.motion[c] * time)
    return (x - flights.station[c, 0], y - flights.station[c, 1], z - flights.station[c, 2])


@_compiled
def _fill_scanner_views(flights: _Flights, places: FloatArray, time: FloatArray, axes: FloatArray,
                        rate: FloatArray, change: FloatArray, views: FloatArray) -> None:
    """Fill `views` (2, c, m): how far places (3, m) are off the line at times (c, m), and sample.

    The columns of `axes` (c, 3, 3) are those along the line, across it and of the ray. Rates of
    attitude (c, 3) and their changes act over the time of the image, a + b t^2 / 2.
    """
    for c in range(len(time)):
        for m in range(time.shape[1]):
            t = time[c, m]
            x, y, z = _line_of_sight(flights, c, places, m, t)
            # Image coordinates are components across the ray, divided by the one along it.
            ahead = axes[c, 0, 2] * x + axes[c, 1, 2] * y + axes[c, 2, 2] * z
            line = (axes[c, 0, 0] * x + axes[c, 1, 0] * y + axes[c, 2, 0] * z) / ahead
            sample = (axes[c, 0, 1] * x + axes[c, 1, 1] * y + axes[c, 2, 1] * z) / ahead
            # Small turns, to second order.
            roll = rate[c, 0] * t + change[c, 0] * t * t / 2
            pitch = rate[c, 1] * t + change[c, 1] * t * t / 2
            spin = rate[c, 2] * t + change[c, 2] * t * t / 2
            views[0, c, m] = line - (pitch + spin * sample)
            views[1, c, m] = sample - (roll - spin * line)


@_compiled
def _fill_radar_views(flights: _Flights, places: FloatArray, time: FloatArray,
                      orbit_radius: FloatArray, views: FloatArray) -> None:
    """Fill `views` (2, c, m) with Doppler, by the radius of the orbit (c,), and range of places.

    Doppler is a difference of the ranges at a time and a moment later.
    """
    for c in range(len(time)):
        for m in range(time.shape[1]):
            x, y, z = _line_of_sight(flights, c, places, m, time[c, m])
            distance = np.sqrt(x * x + y * y + z * z)
            # Doppler is the derivative of the range by time, here by a forward difference.
            x, y, z = _line_of_sight(flights, c, places, m, time[c, m] + FIRST_STEP)
            later = np.sqrt(x * x + y * y + z * z)
            views[0, c, m] = (later - distance) / FIRST_STEP / orbit_radius[c]
            views[1, c, m] = distance
