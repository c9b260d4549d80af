"""What line scanners in orbit see of a place: cameras drawn from all that are plausible.

A satellite at a height of 450 to 850 km scans the place with a steady attitude: it turns with the
orbit, and with small rates of its own. The Earth turns below it. The direction in which lines
follow each other is that of the control, all else is drawn.
"""

from __future__ import annotations

import numpy as np

from termsel.measurements.coordinates.crs import EARTH, body_of, metres_per_unit
from termsel.measurements.coordinates.metres import is_in_degrees, plan_of
from termsel.measurements.coordinates.wgs84 import EARTH_ROTATION, GRAVITY_CONSTANT, to_ecef
from termsel.measurements.features import FloatArray
from termsel.measurements.scaling import Scaling

CAMERAS = 200

RADIUS = 6371e3
"""Mean radius of the Earth [m]."""

ALTITUDES = (450e3, 850e3)

INCIDENCE = np.radians(35.0)
"""Largest angle between ray and vertical on the ground: products beyond are rare."""

YAW, RATE, CHANGE = np.radians(3.0), 3e-5, 5e-7
"""Standard deviations of the angle between flight and scan, which compensates the rotation of the
Earth, of rates of attitude [rad/s], of which steady platforms state some 1e-5 to 5e-5, and of how
these change [rad/s^2], within about a minute."""

LATITUDE = 60.0
"""Largest latitude of places where it is not known."""

ROUNDS, STEP, CLOSE, FAR = 8, 1e-3, 1e-6, 500.0
"""Most steps to the time at which a place is seen, the first one's length, that of the last, and
the longest time [s]."""


def in_space(scaling: Scaling, crs: str, scaled: FloatArray) -> tuple[FloatArray, float] | None:
    """Return scaled places to the east, north and up of their middle [m], (m, 3), and its latitude.

    NaN where the latitude is not known. None on other bodies than the Earth, and for geocentric
    coordinates.
    """
    own, middle = scaling.fit_crs or crs, np.array(scaling.ground_offset)
    ground = scaled * scaling.ground_scale + middle
    if body_of(own) != EARTH or (own and plan_of(own, ground) is None):
        return None
    if own and is_in_degrees(own):
        lon, lat = np.radians(middle[:2])
        east, north = np.array([-np.sin(lon), np.cos(lon), 0.0]), np.array(
            [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)])
        away = to_ecef(ground) - to_ecef(middle[None])
        return away @ np.stack([east, north, np.cross(east, north)], axis=1), float(middle[1])
    away = ground - middle
    away[:, :2] *= metres_per_unit(own) or 1.0 if own else 1.0
    away[:, 2] -= (away[:, :2] ** 2).sum(axis=1) / (2 * RADIUS)
    return away, np.nan


def seen_by_scanners(places: FloatArray, azimuth: float, latitude: float) -> FloatArray:
    """Return time and slope across of places (m, 3) in images of so many cameras, (c, m, 2).

    The azimuth of the scan is clockwise from north [rad]; the latitude is in degrees, or NaN.
    Cameras that do not see all places are left out.
    """
    rng, n = np.random.default_rng(0), CAMERAS  # a prior is the same for all data
    altitude, tilt, toward = (rng.uniform(0.0, 1.0, n) for _ in range(3))
    altitude = ALTITUDES[0] + altitude * (ALTITUDES[1] - ALTITUDES[0])
    tilt, toward = tilt * INCIDENCE, toward * 2 * np.pi
    yaw, rate, change = (scale * rng.standard_normal((n, 3))
                         for scale in (YAW, RATE, CHANGE))
    lat = np.radians(np.where(np.isnan(latitude), rng.uniform(-LATITUDE, LATITUDE, n), latitude))
    # Axes are east, north and up at the middle of the places; the centre of the Earth is below.
    centre = np.array([0.0, 0.0, RADIUS])
    ray = np.stack([np.sin(tilt) * np.sin(toward), np.sin(tilt) * np.cos(toward), np.cos(tilt)], 1)
    radius, along = RADIUS + altitude, RADIUS * np.cos(tilt)
    station = centre + ray * (np.sqrt(along**2 - RADIUS**2 + radius**2) - along)[:, None]
    up, heading = station / radius[:, None], azimuth + yaw[:, 0]
    ahead = np.stack([np.sin(heading), np.cos(heading), np.zeros(n)], axis=1)
    ahead = _unit(ahead - up * (ahead * up).sum(axis=1, keepdims=True))
    orbit, motion = np.cross(up, ahead), np.sqrt(GRAVITY_CONSTANT / radius**3)
    pole = np.stack([np.zeros(n), np.cos(lat), np.sin(lat)], axis=1)
    x = np.broadcast_to([np.sin(azimuth), np.cos(azimuth), 0.0], (n, 3))
    x = _unit(x + ray * -(x * ray).sum(axis=1, keepdims=True))
    y = np.cross(-ray, x)
    target, axes = places + centre, np.stack([x, y, -ray], axis=2)

    def view(time: FloatArray) -> FloatArray:
        # In axes that turn with the orbit the satellite rests; the Earth turns in inertial space.
        there = turned(turned(target[None], pole, EARTH_ROTATION * time), orbit,
                       -motion[:, None] * time) - station[:, None]
        looked = there @ axes
        slopes = looked[..., :2] / looked[..., 2:]
        roll, pitch, spin = (rate[:, i, None] * time + change[:, i, None] * time**2 / 2
                             for i in range(3))
        return np.asarray(slopes - np.stack([pitch + spin * slopes[..., 1],
                                             roll - spin * slopes[..., 0]], axis=-1))

    time = np.zeros((n, len(places)))
    at, step = view(time)[..., 0], np.full_like(time, STEP)
    with np.errstate(all="ignore"):
        for _ in range(ROUNDS):  # the secant method
            if np.abs(step).max() < CLOSE:
                break
            time = np.clip(time + step, -FAR, FAR)
            before, at = at, view(time)[..., 0]
            change_of = at - before
            step = np.where(np.abs(change_of) > 1e-13, -at * step / change_of, 0.0)
        image = np.stack([time, view(time)[..., 1]], axis=2)
    good = np.isfinite(image).all(axis=(1, 2)) & (np.abs(step).max(axis=1) < CLOSE) & (
        np.abs(time).max(axis=1) < FAR)
    return np.asarray(image[good])


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
