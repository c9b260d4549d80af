"""A line scanner on a circular orbit over the turning Earth, for many cameras at once.

Axes are east, north and up at a place on the ground. At the time 0 the ray to that place leaves it
at an angle to the vertical; where it meets the orbit is the satellite.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from termsel.toolkit.models import rotate

FloatArray = NDArray[np.float64]

MAJOR, ECCENTRICITY = 6378137.0, 0.00669437999014
GRAVITY, TURNING = 3.986004418e14, 7.292115e-5

SECANT_STEPS, FIRST_STEP, ZERO_SLOPE, MAX_TIME = 12, 1e-3, 1e-10, 200.0
"""Steps of the secant method to the time at which a place is seen, the first one's length, the
share of the camera's slope that counts as none, and the longest time [s]."""


@dataclass(frozen=True, eq=False)
class Cameras:
    """Constants of p cameras, (p,) or (p, 3) each."""

    heading: FloatArray  # of the satellite over the ground, clockwise from north [rad]
    side: FloatArray  # slopes of the ray on the ground to the right of the track, and ahead
    ahead: FloatArray
    altitude: FloatArray  # above the major axis [m]
    yaw: FloatArray  # [rad]
    rates: FloatArray  # of roll, pitch and yaw [rad/s]
    changes: FloatArray  # of these [rad/s^2]

    def first(self) -> Cameras:
        """Return the first one alone."""
        return Cameras(*(getattr(self, field.name)[:1] for field in fields(self)))


def to_geocentric(ground: FloatArray) -> FloatArray:
    """Return Earth-fixed positions [m] of longitude, latitude [deg] and height [m], (n, 3)."""
    lon = np.radians(ground[:, 0])
    lat = np.radians(ground[:, 1])
    height = ground[:, 2]
    across = MAJOR / np.sqrt(1.0 - ECCENTRICITY * np.sin(lat) ** 2)
    return np.stack([(across + height) * np.cos(lat) * np.cos(lon),
                     (across + height) * np.cos(lat) * np.sin(lon),
                     (across * (1.0 - ECCENTRICITY) + height) * np.sin(lat)], axis=1)


def axes_at(lon: float, lat: float) -> FloatArray:
    """Return east, north and up at a longitude and latitude [deg], as rows of (3, 3), Earth-fixed.
    """
    a, b = np.radians([lon, lat])
    east = np.array([-np.sin(a), np.cos(a), 0.0])
    up = np.array([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)])
    return np.stack([east, np.cross(up, east), up])


def heading_of(inclination: float, latitude: float, *, ascending: bool) -> float:
    """Return the heading of an orbit at a latitude, clockwise from north [rad].

    `inclination` and `latitude` are in degrees. The axes do not turn with the Earth. Beyond the
    largest latitude of the orbit the heading is that there, east or west.
    """
    # sin(heading) = cos(inclination) / cos(latitude).
    sine = np.clip(np.cos(np.radians(inclination)) / np.cos(np.radians(latitude)), -1.0, 1.0)
    east = float(np.arcsin(sine))
    return east if ascending else np.pi - east


def observe_targets(
        cameras: Cameras, target: FloatArray, origin: FloatArray, axes: FloatArray) -> FloatArray:
    """Return when p cameras see n targets [s], and the slopes to port at which they do, (p, n, 2).

    `target` (n, 3) are Earth-fixed positions [m]. `origin` (3,) is the position that all cameras
    see at the time 0, and `axes` (3, 3) has east, north and up there as rows. NaN where no time
    within `MAX_TIME` is found.
    """
    # All vectors are in the axes east, north and up, counted from the centre of the Earth.
    centre = axes @ origin
    ground = target @ axes.T
    sine = np.sin(cameras.heading)
    cosine = np.cos(cameras.heading)
    zeros = np.zeros_like(sine)
    course = np.stack([sine, cosine, zeros], axis=1)
    right = np.stack([cosine, -sine, zeros], axis=1)
    # The satellite is where the ray from the origin meets the sphere of the orbit:
    # |centre + d ray| = radius is solved for the distance d.
    ray = course * cameras.ahead[:, None] + right * cameras.side[:, None] + [0.0, 0.0, 1.0]
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    radius = MAJOR + cameras.altitude
    ray_up = ray @ centre
    station = centre + ray * (np.sqrt(np.maximum(
        ray_up**2 - centre @ centre + radius**2, 0.0)) - ray_up)[:, None]
    outward = station / radius[:, None]
    forward = course - outward * (course * outward).sum(axis=1, keepdims=True)
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    orbit = np.cross(outward, forward)
    motion = np.sqrt(GRAVITY / radius**3)
    pole = np.broadcast_to(axes[:, 2], orbit.shape)
    # The camera looks back along the ray; its first axis is along the track, turned by the yaw.
    x = course * np.cos(cameras.yaw)[:, None] + right * np.sin(cameras.yaw)[:, None]
    x = x - ray * (x * ray).sum(axis=1, keepdims=True)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    frame = np.stack([x, np.cross(ray, x), -ray], axis=2)

    def view(time: FloatArray) -> FloatArray:
        """Return the slopes of targets ahead and to port in the camera at given times, (p, n, 2).

        A target is seen when the first one is 0. `time` is (p, n) [s].
        """
        # The satellite moves along its orbit, and the Earth turns below: both are undone.
        from_camera = rotate(rotate(ground[None], pole, TURNING * time), orbit,
                             -motion[:, None] * time) - station[:, None]
        in_camera = from_camera @ frame
        slopes = in_camera[..., :2] / in_camera[..., 2:]
        # Attitude is a polynomial of time, in small angles.
        roll, pitch, yaw = (cameras.rates[:, i, None] * time
                            + cameras.changes[:, i, None] * time**2 / 2 for i in range(3))
        return np.stack([slopes[..., 0] - pitch - yaw * slopes[..., 1],
                         slopes[..., 1] - roll + yaw * slopes[..., 0]], axis=-1)

    time = np.zeros((len(radius), len(ground)))
    if len(radius) > 1:
        # Cameras are given for derivatives, and see a target at nearly the same time.
        first = observe_targets(cameras.first(), target, origin, axes)[0, :, 0]
        time += np.where(np.isfinite(first), first, 0.0)
    step = np.full_like(time, FIRST_STEP)
    # The secant method finds the time at which the slope ahead is 0.
    with np.errstate(all="ignore"):
        slopes = view(time)
        for _ in range(SECANT_STEPS):
            time = np.clip(time + step, -MAX_TIME, MAX_TIME)
            last_ahead = slopes[..., 0]
            slopes = view(time)
            ahead = slopes[..., 0]
            change = ahead - last_ahead
            step = np.where(np.abs(change) > 1e-13, -ahead * step / change, 0.0)
            if np.abs(ahead).max(initial=0.0) < ZERO_SLOPE:
                break
        image = np.stack([time, slopes[..., 1]], axis=2)
        # A slope that is NaN is none of a target that is seen, either.
        is_seen = np.abs(ahead) < 1e-6
        image[~is_seen] = np.nan
    return image
