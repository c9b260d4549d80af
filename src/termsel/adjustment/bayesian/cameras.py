"""What scanners, radars and frame cameras see of a place, drawn from all that are plausible.

A satellite is at a height of 450 to 850 km, and the Earth turns below it. A scanner has a steady
attitude: it turns with the orbit, and with small rates of its own. A radar looks sideways. A frame
camera in an aircraft looks down. The direction in which lines follow each other is that of the
control, all else is drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from termsel.data.coordinates.crs import EARTH, body_of, metres_per_unit
from termsel.data.coordinates.metres import is_in_degrees, plan_of
from termsel.data.coordinates.wgs84 import EARTH_ROTATION, GRAVITY_CONSTANT, to_ecef
from termsel.data.features import FloatArray
from termsel.data.scaling import Scaling

CAMERAS = 200

RADIUS = 6371e3
"""Mean radius of the Earth [m]."""

ALTITUDES = (450e3, 850e3)

INCIDENCE = np.radians(35.0)
"""Largest angle between ray and vertical on the ground: products beyond are rare."""

SIDEWAYS = tuple(np.radians([18.0, 52.0]))
"""Angles between ray and vertical at the middle of the image of a radar: others are rare."""

SIDE = tuple(np.sin(np.radians([15.0, 60.0])))
"""Sines of the smallest and the largest of its other places. No image crosses the track."""

CLIMB = 50.0
"""Standard deviation of how fast the height changes at which ranges are put on the ground [m/s]:
processors take that of the terrain along the flight."""

VIEW = (0.1, 1.0)
TILT = np.radians(3.0)
ASIDE = 0.25
"""Half the extent of the places by the height of a frame camera above them, from long lenses and
parts of a photo to wide angles; standard deviations of its tilt, which vertical photos have, and of
where it is aside of the middle, by the extent."""

YAW = np.radians(3.0)
RATE = 3e-5
CHANGE = 5e-7
"""Standard deviations of the angle between flight and scan, which compensates the rotation of the
Earth, of rates of attitude [rad/s], of which steady platforms state some 1e-5 to 5e-5, and of how
these change [rad/s^2], within about a minute."""

LATITUDE = 60.0
"""Largest latitude of places where it is not known."""

ROUNDS, STEP, CLOSE, FAR, SPEED = 8, 1e-3, 1e-6, 500.0, 7e3
"""Most steps to the time at which a place is seen, the least first one, the last, and the longest
time [s]; what of the ground a satellite passes in one [m/s]."""


def in_space(scaling: Scaling, crs: str, scaled: FloatArray) -> tuple[FloatArray, float] | None:
    """Return scaled places to the east, north and up of their middle [m], (m, 3), and its latitude.

    NaN where the latitude is not known. None on other bodies than the Earth, and for geocentric
    coordinates.
    """
    own = scaling.fit_crs or crs
    middle = np.array(scaling.ground_offset)
    ground = scaled * scaling.ground_scale + middle
    if body_of(own) != EARTH or (own and plan_of(own, ground) is None):
        return None
    if own and is_in_degrees(own):
        lon, lat = np.radians(middle[:2])
        east = np.array([-np.sin(lon), np.cos(lon), 0.0])
        north = np.array(
            [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)])
        away = to_ecef(ground) - to_ecef(middle[None])
        return away @ np.stack([east, north, np.cross(east, north)], axis=1), float(middle[1])
    away = ground - middle
    away[:, :2] *= metres_per_unit(own) or 1.0 if own else 1.0
    away[:, 2] -= (away[:, :2] ** 2).sum(axis=1) / (2 * RADIUS)
    return away, np.nan


@dataclass(frozen=True, eq=False)
class _Flights:
    """Circular orbits, in axes to the east, north and up whose origin is the centre of the Earth.
    """

    station: FloatArray  # (c, 3): where satellites are at the time 0 [m]
    ray: FloatArray      # (c, 3): from the middle of the places to the satellite
    orbit: FloatArray    # (c, 3): the axis about which satellites turn
    motion: FloatArray   # (c,): how fast [rad/s]
    pole: FloatArray     # (c, 3)

    def sight(self, places: FloatArray, time: FloatArray) -> FloatArray:
        """Return what leads from the satellites to places (m, 3) at times (c, m), (c, m, 3).

        In axes that turn with the orbit the satellite rests; the Earth turns in inertial space.
        """
        there = turned(places[None] + [0.0, 0.0, RADIUS], self.pole, EARTH_ROTATION * time)
        return np.asarray(turned(there, self.orbit, -self.motion[:, None] * time)
                          - self.station[:, None])


def _flights(rng: np.random.Generator, heading: FloatArray, latitude: float, tilt: FloatArray,
             toward: FloatArray, altitude: FloatArray) -> _Flights:
    """Return flights seen from the middle under angles from the vertical, in a direction [rad]."""
    lat = np.radians(np.where(np.isnan(latitude), rng.uniform(-LATITUDE, LATITUDE, len(tilt)),
                              latitude))
    ray = np.stack([np.sin(tilt) * np.sin(toward), np.sin(tilt) * np.cos(toward), np.cos(tilt)], 1)
    radius = RADIUS + altitude
    along = RADIUS * np.cos(tilt)
    station = [0.0, 0.0, RADIUS] + ray * (
        np.sqrt(along**2 - RADIUS**2 + radius**2) - along)[:, None]
    up = station / radius[:, None]
    ahead = np.stack([np.sin(heading), np.cos(heading), np.zeros(len(tilt))], axis=1)
    ahead = _unit(ahead - up * (ahead * up).sum(axis=1, keepdims=True))
    return _Flights(station, ray, np.cross(up, ahead), np.sqrt(GRAVITY_CONSTANT / radius**3),
                    np.stack([np.zeros(len(tilt)), np.cos(lat), np.sin(lat)], axis=1))


def seen_by_scanners(places: FloatArray, azimuth: float,
                     latitude: float) -> tuple[FloatArray, ...]:
    """Return time and slope across of places (m, 3) in images of so many cameras, once (c, m, 2).

    The azimuth of the scan is clockwise from north [rad]; the latitude is in degrees, or NaN.
    Cameras that do not see all places are left out.
    """
    rng = np.random.default_rng(0)
    n = CAMERAS  # a prior is the same for all data
    altitude, tilt, toward = (rng.uniform(0.0, 1.0, n) for _ in range(3))
    yaw, rate, change = (scale * rng.standard_normal((n, 3))
                         for scale in (YAW, RATE, CHANGE))
    flights = _flights(rng, azimuth + yaw[:, 0], latitude, tilt * INCIDENCE, toward * 2 * np.pi,
                       ALTITUDES[0] + altitude * (ALTITUDES[1] - ALTITUDES[0]))
    ray = flights.ray
    x = np.broadcast_to([np.sin(azimuth), np.cos(azimuth), 0.0], (n, 3))
    x = _unit(x + ray * -(x * ray).sum(axis=1, keepdims=True))
    axes = np.stack([x, np.cross(-ray, x), -ray], axis=2)

    def view(time: FloatArray) -> FloatArray:
        looked = flights.sight(places, time) @ axes
        slopes = looked[..., :2] / looked[..., 2:]
        roll, pitch, spin = (rate[:, i, None] * time + change[:, i, None] * time**2 / 2
                             for i in range(3))
        return np.asarray(slopes - np.stack([pitch + spin * slopes[..., 1],
                                             roll - spin * slopes[..., 0]], axis=-1))

    return (_seen(view, places, azimuth, n),)


def seen_by_radars(places: FloatArray, azimuth: float, latitude: float, *,
                   right: bool) -> tuple[FloatArray, ...]:
    """Return time and range of places in images of so many radars (see `seen_by_scanners`).

    A place is seen when it is nearest. Radars look to the right or to the left of the flight. The
    range is first that along the ray, then that on the ground, of a sphere at the height of the
    middle.
    """
    rng = np.random.default_rng(0)
    n = CAMERAS // 2
    altitude, tilt = (rng.uniform(0.0, 1.0, n) for _ in range(2))
    heading = azimuth + YAW * rng.standard_normal(n)
    flights = _flights(rng, heading, latitude, SIDEWAYS[0] + tilt * (SIDEWAYS[1] - SIDEWAYS[0]),
                       heading + (-0.5 if right else 0.5) * np.pi,
                       ALTITUDES[0] + altitude * (ALTITUDES[1] - ALTITUDES[0]))
    far = np.linalg.norm(flights.station, axis=1)[:, None]
    climb = CLIMB * rng.standard_normal((n, 1))

    def view(time: FloatArray) -> FloatArray:
        away, later = (np.linalg.norm(flights.sight(places, at), axis=2)
                       for at in (time, time + STEP))
        surface = RADIUS + climb * time
        cosine = np.clip((far**2 + surface**2 - away**2) / (2 * far * surface), -1.0, 1.0)
        sine = np.sqrt(1.0 - cosine**2) * far / away  # of ray and vertical
        there = np.where((sine > SIDE[0]) & (sine < SIDE[1]), away, np.nan)
        return np.stack([(later - away) / STEP / far, there, np.arccos(cosine)], axis=-1)

    seen = _seen(view, places, azimuth, n)
    return seen[..., [0, 1]], seen[..., [0, 2]]


def seen_by_frames(places: FloatArray, azimuth: float) -> tuple[FloatArray, ...]:
    """Return slopes of places in photos of so many frame cameras (see `seen_by_scanners`)."""
    rng = np.random.default_rng(0)
    n = CAMERAS
    extent = 2.0 * np.abs(places[:, :2]).max()
    above = extent / 2 / VIEW[0] * (VIEW[0] / VIEW[1]) ** rng.uniform(0.0, 1.0, n)
    aside = ASIDE * extent * rng.standard_normal((n, 2))
    tilt = TILT * rng.standard_normal((n, 2))
    east = np.sin(azimuth)
    north = np.cos(azimuth)
    x = places @ np.array([east, north, 0.0]) - aside[:, :1]
    y = places @ np.array([north, -east, 0.0]) - aside[:, 1:]
    down = above[:, None] - places[:, 2]
    depth = down + tilt[:, :1] * x + tilt[:, 1:] * y
    seen = np.stack([x - tilt[:, :1] * down, y - tilt[:, 1:] * down], axis=-1) / depth[..., None]
    return (np.asarray(seen[(depth > above[:, None] / 10).all(axis=1)]),)


def _seen(view: Callable[[FloatArray], FloatArray], places: FloatArray, azimuth: float,
          cameras: int) -> FloatArray:
    """Return times (c, m) at which the first of what a view has is 0, and then the others.

    Cameras that do not see all places are left out.
    """
    along = places @ np.array([np.sin(azimuth), np.cos(azimuth), 0.0]) / SPEED
    step = np.tile(np.where(np.abs(along) < STEP, STEP, along), (cameras, 1))
    time = np.zeros_like(step)
    seen = view(np.zeros_like(step))
    with np.errstate(all="ignore"):
        for _ in range(ROUNDS):  # the secant method
            if np.abs(step).max() < CLOSE:
                break
            time = np.clip(time + step, -FAR, FAR)
            before = seen
            seen = view(time)
            change = seen[..., 0] - before[..., 0]
            step = np.where(np.abs(change) > 1e-13, -seen[..., 0] * step / change, 0.0)
    seen[..., 0] = time
    good = np.isfinite(seen).all(axis=(1, 2)) & (np.abs(step).max(axis=1) < CLOSE) & (
        np.abs(time).max(axis=1) < FAR)
    return np.asarray(seen[good])


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def turned(vectors: FloatArray, axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Return vectors (., m, 3) turned about axes (c, 3) by angles (c, m) (Rodrigues' formula)."""
    # v + sin(angle) a x v + (1 - cos(angle)) a x (a x v); the products are those of matrices.
    x, y, z = axis.T
    none = np.zeros_like(x)
    cross = np.array([[none, z, -y], [-z, none, x], [y, -x, none]]).transpose(2, 0, 1)
    once = vectors @ cross
    return np.asarray(vectors + np.sin(angle)[..., None] * once
                      + (1.0 - np.cos(angle))[..., None] * (once @ cross))
