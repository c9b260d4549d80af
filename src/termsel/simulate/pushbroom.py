"""Rigorous geometry of a pushbroom scanner on a circular orbit.

Every scan line has an exposure station and an attitude of its own, and each detector of the
linear array looks along one fixed direction in the camera. Not modelled: lens distortion,
aberration of light, light travel time and the motion of the pole.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from termsel.core.errors import TermselError
from termsel.data.coordinates.wgs84 import (
    EARTH_ROTATION,
    GRAVITY_CONSTANT,
    SEMI_MAJOR,
    SEMI_MINOR,
    from_ecef,
    to_ecef,
    vertical_directions,
)
from termsel.data.features import FloatArray

# Refractivity of air (n - 1) at sea level in the standard atmosphere, visible light, times the
# height p0 / (rho0 g) = 8434 m of the equivalent homogeneous atmosphere: metres.
_REFRACTIVITY_COLUMN = 2.778e-4 * 8434.0

Heights = Callable[[FloatArray], FloatArray]
"""Ellipsoidal heights [m], shape (n,), of longitude and latitude [deg], shape (n, 2)."""

_CONVERGED = 1e-8  # px
ITERATIONS = 40


@dataclass(frozen=True)
class Angle:
    """An attitude angle over time: slow drift and small jitter.

    Parameters
    ----------
    drift : tuple of float
        Coefficients of the polynomial in time, constant first [rad, rad/s, rad/s^2 ...].
    jitter : tuple of (float, float, float)
        Amplitude [rad], frequency [Hz] and phase [rad] of each sine.
    """

    drift: tuple[float, ...] = ()
    jitter: tuple[tuple[float, float, float], ...] = ()

    def __call__(self, time: FloatArray) -> FloatArray:
        """Return angles [rad] at times [s] from the centre of the scene, in the same shape."""
        angle = np.zeros_like(time)
        # Horner's rule, from the highest power down.
        for coefficient in reversed(self.drift):
            angle = angle * time + coefficient
        for amplitude, frequency, phase in self.jitter:
            angle = angle + amplitude * np.sin(2 * np.pi * frequency * time + phase)
        return angle


@dataclass(frozen=True)
class Pushbroom:
    """Rigorous model of a pushbroom scanner: collinearity for every scan line.

    The satellite moves on a circle about the Earth's centre in inertial space; the Earth turns
    below it. At time 0, the middle of the image, inertial and Earth-fixed axes coincide. The
    orbital frame has x along the velocity, y to starboard and z towards the Earth's centre;
    the attitude turns the camera by yaw about z, then pitch about y, then roll about x. The
    array lies across the flight direction; samples run to port, so that an image shown with
    line 0 on top is not mirrored. The centre of the upper-left pixel is (0, 0).

    Parameters
    ----------
    altitude : float
        Radius of the orbit above the WGS84 semi-major axis [m].
    inclination, node, argument : float
        Inclination, longitude of the ascending node and argument of latitude at time 0 [deg].
    n_lines, n_samples : int
        Size of the image [px].
    ifov : float
        Instantaneous field of view: detector pitch over focal length [rad].
    line_period : float
        Time from one line to the next [s].
    roll, pitch, yaw : Angle
        Attitude over time.
    refraction : bool
        Whether rays are bent by the atmosphere.
    offset : array_like, shape (3,), or (n, 3) for one at each of n times
        Offset of the satellite from that circle: ahead, to starboard and down [m].

    Raises
    ------
    TermselError
        If the image is empty, or a length, angle or period is not positive.

    Notes
    -----
    Circular orbit and orbital frame as in V. Kratky, "Rigorous photogrammetric processing of
    SPOT images at CCM Canada", ISPRS J. Photogramm. Remote Sens. 44 (1989) 53-71, and
    P.V. Radhadevi, R. Ramachandran and A.S.R.K.V. Murali Mohan, "Restitution of IRS-1C PAN data
    using an orbit attitude model and minimum control", ISPRS J. 53 (1998) 262-271.

    A ray through plane layers of air keeps n sin(z), so it meets the ground nearer to the
    nadir than the straight one by tan(z) / cos(z)^2 times the integral of (n - 1) over height.
    By Gladstone-Dale that integral is proportional to the pressure on the ground, here of the
    standard atmosphere. P. D. Noerdlinger, "Atmospheric refraction effects in Earth remote
    sensing", ISPRS J. 54 (1999) 360-373, gives the curved layers; for z below 40 deg the
    difference is centimetres.
    """

    altitude: float
    inclination: float
    node: float
    argument: float
    n_lines: int
    n_samples: int
    ifov: float
    line_period: float
    roll: Angle = Angle()
    pitch: Angle = Angle()
    yaw: Angle = Angle()
    refraction: bool = True
    offset: tuple[float, float, float] | FloatArray = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Raise TermselError for a length, number or period that is not positive."""
        for name in ("altitude", "n_lines", "n_samples", "ifov", "line_period"):
            if not getattr(self, name) > 0:
                raise TermselError(f"{name} of a pushbroom is {getattr(self, name)}, which is not "
                                   "positive",
                                   hint="Give a positive number.")

    @property
    def centre(self) -> tuple[float, float]:
        """Line and sample of the middle of the image [px]."""
        return (self.n_lines - 1) / 2, (self.n_samples - 1) / 2

    def time(self, line: FloatArray) -> FloatArray:
        """Return the time of exposure [s] of lines [px], (n,); 0 in the middle of the image."""
        return (line - self.centre[0]) * self.line_period

    def exposure(self, time: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the positions of the scanner, and its rotations from camera to Earth-fixed axes.

        Parameters
        ----------
        time : array_like, shape (n,)
            Time from the middle of the image [s].

        Returns
        -------
        station : ndarray, shape (n, 3)
            Earth-fixed position [m].
        rotation : ndarray, shape (n, 3, 3)
            Columns are the camera's axes.
        """
        time = np.asarray(time, dtype=np.float64)
        radius = SEMI_MAJOR + self.altitude
        # The node moves back as the Earth turns below the orbit; u grows by Kepler's third law.
        i = np.radians(self.inclination)
        node = np.radians(self.node) - EARTH_ROTATION * time
        u = np.radians(self.argument) + np.sqrt(GRAVITY_CONSTANT / radius**3) * time
        cn = np.cos(node)
        sn = np.sin(node)
        cu = np.cos(u)
        su = np.sin(u)
        ci = np.cos(i)
        si = np.sin(i)
        # Rz(node) Rx(inclination) Rz(u): its columns are outward, forward and the orbit's normal.
        outward = np.stack([cn * cu - sn * su * ci, sn * cu + cn * su * ci, su * si], axis=-1)
        forward = np.stack([-cn * su - sn * cu * ci, -sn * su + cn * cu * ci, cu * si], axis=-1)
        normal = np.stack([sn * si, -cn * si, np.full_like(cn, ci)], axis=-1)
        orbital = np.stack([forward, -normal, -outward], axis=-1)
        attitude = _attitude(self.roll(time), self.pitch(time), self.yaw(time))
        displacement = (orbital @ np.asarray(self.offset)[..., None])[..., 0]
        return radius * outward + displacement, orbital @ attitude

    def project(self, ground: ArrayLike) -> FloatArray:
        """Return the image positions of ground points.

        Parameters
        ----------
        ground : array_like, shape (n, 3)
            WGS84 longitude, latitude [deg] and ellipsoidal height [m].

        Returns
        -------
        ndarray, shape (n, 2)
            Line and sample [px], also beyond the edges of the image.

        Raises
        ------
        TermselError
            For an array of another shape, or points that the scanner never passes.

        Notes
        -----
        The line is the root of the along-track camera coordinate over time, found by the
        secant method for all points at once, to 1e-8 px.
        """
        ground = _as_columns(ground, 3, "ground")
        target = to_ecef(ground)
        up = vertical_directions(ground)
        line = np.full(len(target), self.centre[0])
        along_track, sample = self._view_coordinates(target, up, ground[:, 2], line)
        step = along_track  # one pixel of the along-track coordinate is about one line
        slope = np.full_like(line, -1.0)
        for _ in range(ITERATIONS):
            active = np.abs(along_track) > _CONVERGED
            if not active.any():
                break
            line = line + step
            before = along_track
            along_track, sample = self._view_coordinates(target, up, ground[:, 2], line)
            # Steps below 1e-4 px do not determine the slope, so the last slope is kept.
            np.divide(along_track - before, step, out=slope, where=np.abs(step) > 1e-4)
            step = -along_track / slope
        # A root beyond the horizon is a view through the Earth.
        station, _ = self.exposure(self.time(line))
        hidden = active | ~(np.einsum("ni,ni->n", station - target, up) > 0)
        if hidden.any():
            raise TermselError(f"{int(hidden.sum())} ground points are out of the scanner's view",
                               hint="Give longitude, latitude and height of points near the scene.")
        return np.stack([line, sample], axis=-1)

    def locate(self, image: ArrayLike, height: ArrayLike) -> FloatArray:
        """Return the ground positions of image points at the given heights.

        Parameters
        ----------
        image : array_like, shape (n, 2)
            Line and sample [px].
        height : array_like, shape (n,) or a number
            Ellipsoidal heights [m].

        Returns
        -------
        ndarray, shape (n, 2)
            WGS84 longitude and latitude [deg].

        Raises
        ------
        TermselError
            For an array of another shape, or rays that miss the Earth.
        """
        image = _as_columns(image, 2, "image")
        height = np.broadcast_to(np.asarray(height, dtype=np.float64), len(image))
        station, rotation = self.exposure(self.time(image[:, 0]))
        across = -(image[:, 1] - self.centre[1]) * self.ifov
        # The ray of a detector in camera axes; samples run to port, hence the sign.
        look = np.stack([np.zeros_like(across), across, np.ones_like(across)], axis=-1)
        look /= np.linalg.norm(look, axis=1, keepdims=True)
        straight = _meet_heights(station, np.einsum("nij,nj->ni", rotation, look), height)
        position = from_ecef(straight)
        if self.refraction:
            # The shift is about a metre and changes by less than a micrometre over that distance.
            for _ in range(2):
                bent = straight - _refraction(to_ecef(position), vertical_directions(position),
                                              height,
                                              station)
                position = from_ecef(bent)
        return position[:, :2]

    def on_terrain(self, terrain: Heights, image: FloatArray, start: float, rounds: int = 12,
                   ) -> FloatArray:
        """Return the points where rays of image points meet the terrain, shape (n, 3).

        These are longitude, latitude [deg] and ellipsoidal height [m]. `image` (n, 2) are line and
        sample [px], `start` is the first approximation of the height [m]. In each of the `rounds`
        the ray is met at the height of the terrain below the last position.
        """
        height = np.full(len(image), start)
        for _ in range(rounds):
            position = self.locate(image, height)
            height = terrain(position)
        return np.column_stack([position, height])

    def off_nadir(self, line: float | None = None) -> float:
        """Return the angle between the ray of the middle detector and the Earth's centre [deg].

        Parameters
        ----------
        line : float, optional
            Line [px]; by default the middle of the image.
        """
        lines = np.array([self.centre[0] if line is None else line])
        station, rotation = self.exposure(self.time(lines))
        nadir = -station[0] / np.linalg.norm(station[0])
        ray = rotation[0, :, 2]
        return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(nadir, ray)), nadir @ ray)))

    def _view_coordinates(self, target: FloatArray, up: FloatArray, height: FloatArray,
                          line: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the along-track camera coordinate of targets and their sample [px], (n,) each.

        Both are those while `line` (n,) is exposed. Targets (n, 3) are Earth-fixed [m], `up` (n, 3)
        the unit verticals and `height` (n,) the heights [m] there.
        """
        station, rotation = self.exposure(self.time(line))
        if self.refraction:
            target = target + _refraction(target, up, height, station)
        # Camera coordinates R'(P - S): all of a line lie at x = 0 when it is exposed.
        x, y, z = np.einsum("nij,ni->jn", rotation, target - station)
        return x / z / self.ifov, self.centre[1] - y / z / self.ifov


def _attitude(roll: FloatArray, pitch: FloatArray, yaw: FloatArray) -> FloatArray:
    """Return the rotation Rx(roll) Ry(pitch) Rz(yaw) of a camera at n times, shape (n, 3, 3).

    The angles (n,) are in radians.
    """
    # c and s are cosine and sine, followed by the initial of the angle.
    cr = np.cos(roll)
    sr = np.sin(roll)
    cp = np.cos(pitch)
    sp = np.sin(pitch)
    cy = np.cos(yaw)
    sy = np.sin(yaw)
    return np.stack([
        np.stack([cp * cy, -cp * sy, sp], axis=-1),
        np.stack([cr * sy + sr * sp * cy, cr * cy - sr * sp * sy, -sr * cp], axis=-1),
        np.stack([sr * sy - cr * sp * cy, sr * cy + cr * sp * sy, cr * cp], axis=-1),
    ], axis=-2)


def _refraction(target: FloatArray, up: FloatArray, height: FloatArray, station: FloatArray,
                ) -> FloatArray:
    """Return the shift from targets to their positions on straight rays [m], (n, 3).

    `target` and `station` (n, 3) are Earth-fixed [m], `up` (n, 3) are unit vectors at the targets,
    and `height` (n,) is that of the targets [m].
    """
    pressure = (1 - 2.25577e-5 * height) ** 5.25588  # standard atmosphere, over sea level's
    ray = station - target
    ray = ray / np.linalg.norm(ray, axis=1, keepdims=True)
    cosine = np.einsum("ni,ni->n", ray, up)[:, None]
    # tan(z) / cos(z)^2 times the integral of n - 1, towards the nadir (see the class).
    shift: FloatArray = (_REFRACTIVITY_COLUMN * pressure)[:, None] * (cosine * up - ray) / cosine**3
    return shift


def _meet_heights(station: FloatArray, ray: FloatArray, height: FloatArray) -> FloatArray:
    """Return the points where rays reach ellipsoidal heights, Earth-fixed [m], shape (n, 3).

    Station and ray are Earth-fixed (n, 3), heights (n,) [m]. Raises TermselError for rays that miss
    the Earth.
    """
    # Starts on the ellipsoid with both axes longer by the height, which is nearly the surface of
    # that height, and continues with Newton's method along the ray.
    axes = np.stack([SEMI_MAJOR + height, SEMI_MAJOR + height, SEMI_MINOR + height], axis=-1)
    s = station / axes
    d = ray / axes
    a = (d * d).sum(axis=1)
    b = (s * d).sum(axis=1)
    c = (s * s).sum(axis=1) - 1
    # |s + t d|^2 = 1 in units of the axes: a t^2 + 2 b t + c = 0, the nearer root.
    root = b * b - a * c
    if (root <= 0).any():
        raise TermselError(f"the rays of {int((root <= 0).sum())} image points miss the Earth",
                           hint="Choose a smaller off-nadir angle, or points in the image.")
    distance = (-b - np.sqrt(root)) / a
    for _ in range(2):
        position = from_ecef(station + distance[:, None] * ray)
        # Height gained per metre of the ray.
        climb = np.einsum("ni,ni->n", ray, vertical_directions(position))
        distance = distance + (height - position[:, 2]) / climb
    to_ground: FloatArray = distance[:, None] * ray
    return station + to_ground


def _as_columns(values: ArrayLike, width: int, kind: str) -> FloatArray:
    """Return coordinates as an array (n, width); raises TermselError for another shape."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != width:
        raise TermselError(f"{kind} coordinates have shape {array.shape}, expected (n, {width})")
    return array
