"""Simulated images of six kinds of cameras, with points on hills.

A steady satellite, an agile one that turns while it scans, a small one with an attitude of poor
quality, an airborne line scanner, a scanned frame photo and a panoramic camera; and a radar. All
sizes are drawn; two sets of them, CHOSEN and FRESH, have other ranges: constants of the program
were chosen on scenes of the first, and figures are of scenes of the second.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from termsel import FeatureSet, Points, TermselError
from termsel.simulate import Angle, Pushbroom, pushbroom_at
from termsel.toolkit import FloatArray
from termsel.toolkit.coordinates import from_ecef, to_ecef, vertical_directions

KINDS = ("steady", "agile", "cubesat", "airborne", "frame", "panoramic")
ALL_KINDS = (*KINDS, "radar")

SCENE_CRS = "EPSG:4979"


@dataclass(frozen=True)
class Ranges:
    """Ranges that sizes are drawn from."""

    # Part of the seeds, so that both ranges draw other scenes.
    number: int
    # Altitude of orbits [m].
    altitude: tuple[float, float]
    # Inclination of the orbit [deg].
    incline: tuple[float, float]
    # Angle of the view off nadir [deg].
    tilt: tuple[float, float]
    # Size of a pixel on the ground, from orbit [m].
    pixel: tuple[float, float]
    # Lines and samples [px].
    size: tuple[int, int]
    # Relief, as a share of the scene's width.
    relief: tuple[float, float]
    # Noise of measurements [px].
    noise: tuple[float, float]
    latitude: tuple[float, float]
    # Number of waves of the terrain.
    waves: int


CHOSEN = Ranges(
    number=1, altitude=(480e3, 830e3), incline=(97.0, 99.0), tilt=(0.0, 28.0), pixel=(2.0, 20.0),
    size=(4000, 9000), relief=(0.002, 0.03), noise=(0.3, 0.7), latitude=(5.0, 60.0), waves=6)
FRESH = Ranges(
    number=2, altitude=(440e3, 915e3), incline=(80.0, 100.0), tilt=(0.0, 33.0), pixel=(0.7, 30.0),
    size=(3000, 12000), relief=(0.001, 0.05), noise=(0.2, 1.0), latitude=(-55.0, 55.0), waves=10)


@dataclass(frozen=True)
class Turning(Pushbroom):
    """A satellite that turns so that its view moves over the ground in any direction."""

    # Earth-fixed [m], in the middle of the scene.
    aim: tuple[float, float, float] = (0.0, 0.0, 0.0)
    # Earth-fixed, of length 1.
    course: tuple[float, float, float] = (1.0, 0.0, 0.0)
    # Speed of the view on the ground [m/s].
    speed: float = 7000.0

    def exposure(self, time: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return exposure stations and rotations (see `Pushbroom.exposure`)."""
        time = np.asarray(time, dtype=np.float64)
        station = super().exposure(time)[0]
        return station, self._rotations_of_view(station, time)

    def _rotations_of_view(self, station: FloatArray, time: FloatArray) -> FloatArray:
        """Return the rotations (n, 3, 3) of a camera that follows a moving target on the ground.

        `station` (n, 3) are its Earth-fixed positions [m] at the times `time` (n,) [s]. The columns
        are the axes of the camera, Earth-fixed.
        """
        aim = np.array(self.aim)
        course = np.array(self.course)
        # The view moves along a great circle, by this angle at the Earth's centre.
        angle = (self.speed * time / np.linalg.norm(aim))[:, None]
        up = aim / np.linalg.norm(aim)
        target = np.linalg.norm(aim) * (np.cos(angle) * up + np.sin(angle) * course)
        # The axes of the camera: towards the target, along the course, and across both.
        z = _unit_vectors(target - station)
        ahead = np.cos(angle) * course - np.sin(angle) * up
        x = _unit_vectors(ahead - z * (ahead * z).sum(axis=1, keepdims=True))
        return np.stack([x, np.cross(z, x), z], axis=2) @ _rotation_matrices(
            self.roll(time), self.pitch(time), self.yaw(time))


@dataclass(frozen=True)
class Flying(Turning):
    """An aircraft that flies straight on, but for turbulence, and looks down."""

    # Off the course [m].
    sway: tuple[Angle, ...] = (Angle(), Angle(), Angle())

    def exposure(self, time: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return exposure stations (n, 3) [m] and rotations (n, 3, 3) at times (n,) [s].

        See `Pushbroom.exposure`.
        """
        time = np.asarray(time, dtype=np.float64)
        aim = np.array(self.aim)
        course = np.array(self.course)
        up = vertical_directions(from_ecef(aim[None]))[0]
        # The sway along the course, across it and up [m].
        sway = np.stack([shift(time) for shift in self.sway], axis=1)
        station = (aim + up * self.altitude + course * (self.speed * time)[:, None]
                   + sway @ np.stack([course, np.cross(up, course), up]))
        axes = np.stack([course, np.cross(-up, course), -up], axis=1)
        return station, axes @ _rotation_matrices(self.roll(time), self.pitch(time), self.yaw(time))


def image_of(kind: str, seed: int, ranges: Ranges, count: int,
             measured: int | None = None, level: float = -1.0) -> FeatureSet:
    """Return `count` points of a simulated image of a kind of camera.

    The first `measured` of them have noise, all if it is None; the others are exact. Ground below
    `level`, from -1 to 1 of the hills' heights, is a plain at the height 0. The same arguments give
    the same points. Raises RuntimeError if twenty random cameras do not see enough points.
    """
    for attempt in range(20):
        # A new attempt draws all again, from a generator of its own.
        rng = np.random.default_rng([ranges.number, ALL_KINDS.index(kind), seed, attempt])
        try:
            return _image_of(kind, rng, ranges, count, measured, level)
        except TermselError:
            # The camera that was drawn does not see the scene.
            continue
    raise RuntimeError(f"no image of the kind {kind} was found")


def _image_of(kind: str, rng: Generator, ranges: Ranges, count: int,
              measured: int | None, level: float) -> FeatureSet:
    """Return points of one image of a random camera, over random ground (see `image_of`).

    Ground below `level`, from -1 to 1 of the hills' heights, is a plain; -1 is without one.
    `measured` is how many points have errors of measurement, None for all. Raises TermselError if
    too few points are in view.
    """
    lines, samples = (int(n) for n in rng.integers(*ranges.size, 2))
    lon = rng.uniform(-170, 170)
    lat = rng.uniform(*ranges.latitude)
    # Sizes of pixels are log-uniform, and those of aircraft smaller by a factor.
    pixel = float(np.exp(rng.uniform(*np.log(ranges.pixel))))
    pixel *= {"airborne": 0.05, "frame": 0.06, "panoramic": 0.15}.get(kind, 1.0)
    width = pixel * max(lines, samples)
    relief = width * float(np.exp(rng.uniform(*np.log(ranges.relief))))
    middle = to_ecef(np.array([[lon, lat, 0.0]]))[0]
    axes = _axes_at(lon, lat)
    # More ground points are drawn than are needed, as some are not in view.
    n_candidates = (40 if measured is None else 16) * count
    plan = rng.uniform(-0.8, 0.8, (n_candidates, 2)) * width
    ground = from_ecef(middle + np.pad(plan, ((0, 0), (0, 1))) @ axes)
    height = _wave_heights(rng, plan / width, ranges.waves)
    ground[:, 2] = (1.0 + height) * relief if level == -1.0 else (
        2.0 * np.maximum(height - level, 0.0) * relief)
    scene = (lon, lat, relief)
    if kind in ("frame", "panoramic"):
        local = (to_ecef(ground) - middle) @ axes.T
        image = _photo_positions(kind, rng, (lines, samples), pixel, local)
    elif kind == "radar":
        image = _radar_positions(rng, ranges, (lines, samples), pixel, scene, ground)
    else:
        sensor = _random_scanner(kind, rng, ranges, (lines, samples), pixel, scene)
        image = sensor.project(ground)
    inside = ((image > 0.02 * np.array([lines, samples]))
              & (image < 0.98 * np.array([lines, samples]))).all(axis=1)
    if inside.sum() < count:
        raise TermselError("too few points are in view")
    image = image[inside][:count]
    ground = ground[inside][:count]
    noise = rng.uniform(*ranges.noise)
    errors = noise * rng.standard_normal(image.shape)
    if measured is not None:
        errors[measured:] = 0.0
    image = image + errors
    return FeatureSet(Points(tuple(map(str, range(count))), image, ground), crs=SCENE_CRS,
                      image_size=(lines, samples), noise=noise)


def _random_scanner(kind: str, rng: Generator, ranges: Ranges, size: tuple[int, int],
                    pixel: float, scene: tuple[float, float, float]) -> Pushbroom:
    """Return a random line scanner that sees a scene.

    `kind` is steady, agile, cubesat or airborne. Angles of attitude are drawn by how far they move
    the image, so that kinds differ by that and not by their altitude. `size` is lines and samples,
    `pixel` the size of a pixel on the ground [m], and `scene` longitude, latitude [deg] and height
    [m].
    """
    lon, lat, height = scene
    tilt = rng.uniform(*ranges.tilt)
    turn = rng.choice([90.0, 270.0]) + rng.normal(0.0, 3.0)
    if kind == "agile":
        turn = rng.uniform(0.0, 360.0)
    altitude = rng.uniform(*ranges.altitude)
    incline = rng.uniform(*ranges.incline)
    if kind == "cubesat":
        altitude = rng.uniform(400e3, 600e3)
    sensor = pushbroom_at(lon, lat, height=height, off_nadir=tilt, look_azimuth=turn, gsd=pixel,
                          image_size=size, altitude=altitude, inclination=incline)
    # Half the duration of the scene [s].
    half = size[0] * sensor.line_period / 2
    if kind in ("steady", "cubesat"):
        # Movements of the image at its end [px], by powers of time.
        drift = (2.0, 1.0, 0.3) if kind == "steady" else (40.0, 12.0, 4.0)
        jitter = (half / 2, 0.15 if kind == "steady" else 1.0)
        angles = [_random_angle(rng, sensor.ifov, half, drift, jitter, lever)
                  for lever in (1.0, 1.0, 2.0 / size[1])]
        return _sensor_with_angles(sensor, angles)
    course = rng.uniform(0.0, 2 * np.pi) if kind == "airborne" or rng.random() < 0.6 else np.pi
    middle = to_ecef(np.array([[lon, lat, height]]))[0]
    axes = _axes_at(lon, lat)
    ahead = np.sin(course) * axes[0] + np.cos(course) * axes[1]
    speed = 70.0 if kind == "airborne" else 7000.0 * rng.uniform(0.3, 1.1)
    period = pixel / speed
    half = size[0] * period / 2
    common: dict[str, Any] = {
        "inclination": sensor.inclination, "node": sensor.node, "argument": sensor.argument,
        "n_lines": size[0], "n_samples": size[1], "line_period": period, "aim": tuple(middle),
        "course": tuple(ahead), "speed": speed, "refraction": False}
    if kind == "airborne":
        flying_height = size[1] * pixel / 2 / np.tan(rng.uniform(0.25, 0.5))
        # Shifts along the course, across it and up are polynomials and sines as angles are [m].
        sway = tuple(_random_angle(rng, 1.0, half, (0.0, 3.0, 1.0), (6.0, 1.0), 1.0)
                     for _ in range(3))
        ifov = pixel / flying_height
        angles = [_random_angle(rng, ifov, half, (20.0, 10.0, 5.0), (5.0, 4.0), lever)
                  for lever in (1.0, 1.0, 2.0 / size[1])]
        return Flying(altitude=flying_height, ifov=ifov, roll=angles[0], pitch=angles[1],
                      yaw=angles[2], sway=sway, **common)
    station = sensor.exposure(np.zeros(1))[0][0]
    ray = station - middle
    distance = float(np.linalg.norm(ray))
    angles = [_random_angle(rng, pixel / distance, half, (2.0, 1.0, 0.3), (half / 2, 0.15), lever)
              for lever in (1.0, 1.0, 2.0 / size[1])]
    return Turning(altitude=altitude, ifov=pixel / distance, roll=angles[0], pitch=angles[1],
                   yaw=angles[2], **common)


def _radar_positions(rng: Generator, ranges: Ranges, size: tuple[int, int], pixel: float,
                     scene: tuple[float, float, float], ground: FloatArray) -> FloatArray:
    """Return line and sample (n, 2) [px] of ground points by a random radar, in slant range.

    `ground` (n, 3) are longitudes, latitudes [deg] and heights [m]. The line is the time at which
    the velocity is perpendicular to the ray (zero Doppler), the sample the length of the ray.
    """
    lon, lat, height = scene
    tilt = rng.uniform(20.0, 42.0)
    orbit = pushbroom_at(lon, lat, height=height, off_nadir=tilt,
                         look_azimuth=rng.choice([90.0, 270.0]), gsd=pixel, image_size=size,
                         altitude=rng.uniform(*ranges.altitude),
                         inclination=rng.uniform(*ranges.incline), refraction=False)
    target = to_ecef(ground)
    time = np.zeros(len(ground))
    # Newton's steps leave out that the velocity changes with time, so that about a tenth of the
    # error remains after each.
    for _ in range(12):
        before, station, after = (orbit.exposure(time + step)[0] for step in (-1e-2, 0.0, 1e-2))
        velocity = (after - before) / 2e-2
        time += ((target - station) * velocity).sum(axis=1) / (velocity**2).sum(axis=1)
    distance = np.linalg.norm(target - orbit.exposure(time)[0], axis=1)
    middle = np.linalg.norm(to_ecef(np.array([scene]))[0] - orbit.exposure(np.zeros(1))[0][0])
    # A pixel on the ground is sin(tilt) of it in slant range.
    positions = np.column_stack([time / orbit.line_period,
                                 (distance - middle) / (pixel * np.sin(np.radians(tilt)))])
    return np.asarray(positions + np.array(size) / 2)


def _photo_positions(kind: str, rng: Generator, size: tuple[int, int], pixel: float,
                     local: FloatArray) -> FloatArray:
    """Return line and sample (n, 2) of points by a random frame or panoramic camera.

    `local` (n, 3) are east, north and up from the middle of the scene [m], and `pixel` is the size
    of a pixel on the ground there [m]; `size` is lines and samples. The film deforms, and its
    middle is some 20 px off that of the scan.
    """
    extent = pixel * max(size)
    flying_height = extent / (2 * np.tan(rng.uniform(0.2, 0.7)))
    # The focal length in px, for the pixel that the middle of the image has.
    focal = flying_height / pixel
    roll, pitch = rng.normal(0.0, 0.03, (2, 1))
    rotation = _rotation_matrices(roll, pitch, np.array([rng.uniform(-np.pi, np.pi)]))[0]
    # In the camera's axes z points up, so that it is negative below the camera.
    x, y, z = ((local - [0.0, 0.0, flying_height]) @ rotation).T
    if kind == "frame":
        image = focal * np.column_stack([y / z, -x / z])
        # Film and lens deform by a few px towards the corners.
        radius = np.linalg.norm(image, axis=1, keepdims=True) / (max(size) / 2)
        image *= 1.0 + rng.normal(0.0, 3.0 / max(size)) * radius**2
    else:
        # The lens sweeps across, and the film is a cylinder.
        angle = np.arctan2(x, -z)
        image = focal * np.column_stack([y / np.hypot(x, z), angle])
        # The camera moves on during the sweep, by about a hundredth of the focal length.
        image[:, 0] += rng.normal(0.0, 0.01) * focal * np.sin(angle)
    return np.asarray(image + np.array(size) / 2 + rng.normal(0.0, 20.0, 2))


def _random_angle(rng: Generator, unit: float, half: float, drift: tuple[float, ...],
                  jitter: tuple[float, float], lever: float) -> Angle:
    """Return a random angle of attitude: a polynomial in time, 0 at the middle, and one sine.

    Parameters
    ----------
    rng : Generator
    unit : float
        What moves the image by 1 px: an angle [rad]; 1 for sizes in its own unit.
    half : float
        Half the duration of the scene [s]: time counts from its middle.
    drift : tuple of float
        Standard deviations of the terms t, t^2, ... at the end of the scene, in units.
    jitter : tuple of 2 float
        Period [s] of the sine, and its amplitude in units.
    lever : float
        Factor of all sizes: 1 for roll and pitch, 2 / width for yaw.
    """
    polynomial = [0.0]
    for power, deviation in enumerate(drift, 1):
        # Divided by half**power, so that the term is `deviation` at t = half.
        polynomial.append(unit * lever * rng.normal(0.0, deviation) / half**power)
    period, amplitude = jitter
    sine = (unit * lever * amplitude, 1.0 / period, rng.uniform(0, 2 * np.pi))
    return Angle(tuple(polynomial), (sine,))


def _sensor_with_angles(sensor: Pushbroom, angles: list[Angle]) -> Pushbroom:
    """Return a sensor of `pushbroom_at` with `angles` (roll, pitch, yaw) added to its attitude.

    Each is added to the angle of its name, term by term, and not as a rotation before or after.
    """
    def sum_of_angles(steady: Angle, motion: Angle) -> Angle:
        """Return the sum of two polynomials in time, with the jitter of the second angle."""
        drift = np.zeros(max(len(steady.drift), len(motion.drift)))
        drift[:len(steady.drift)] += steady.drift
        drift[:len(motion.drift)] += motion.drift
        # `pushbroom_at` makes sensors without jitter, so that none is lost.
        return Angle(tuple(drift), motion.jitter)

    roll, pitch, yaw = angles
    return replace(sensor, roll=sum_of_angles(sensor.roll, roll),
                   pitch=sum_of_angles(sensor.pitch, pitch), yaw=sum_of_angles(sensor.yaw, yaw))


def _wave_heights(rng: Generator, plan: FloatArray, waves: int) -> FloatArray:
    """Return smooth heights (n,) from -1 to 1 at relative positions (n, 2), a sum of random waves.
    """
    total = np.zeros(len(plan))
    for _ in range(waves):
        wave_vector = rng.normal(0.0, 4.0, 2)
        total += np.sin(plan @ wave_vector + rng.uniform(0, 2 * np.pi)) * rng.uniform(0.3, 1.0)
    return np.asarray(total / np.abs(total).max())


def _rotation_matrices(roll: FloatArray, pitch: FloatArray, yaw: FloatArray) -> FloatArray:
    """Return rotations (n, 3, 3) by roll, pitch and yaw, (n,) each [rad].

    They are about the x, the y and the z axis.
    """
    (sr, cr), (sp, cp), (sy, cy) = ((np.sin(a), np.cos(a)) for a in (roll, pitch, yaw))
    zeros = np.zeros_like(sr)
    ones = np.ones_like(sr)

    def matrix(*rows: list[FloatArray]) -> FloatArray:
        """Return matrices (n, 3, 3) of rows of three arrays (n,)."""
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    # R = R_x(roll) R_y(pitch) R_z(yaw).
    return (matrix([ones, zeros, zeros], [zeros, cr, -sr], [zeros, sr, cr])
            @ matrix([cp, zeros, sp], [zeros, ones, zeros], [-sp, zeros, cp])
            @ matrix([cy, -sy, zeros], [sy, cy, zeros], [zeros, zeros, ones]))


def _axes_at(lon: float, lat: float) -> FloatArray:
    """Return east, north and up at a longitude and latitude [deg], as rows of (3, 3), Earth-fixed.
    """
    middle = to_ecef(np.array([[lon, lat, 0.0]]))[0]
    up = vertical_directions(np.array([[lon, lat, 0.0]]))[0]
    east = _unit_vectors(np.array([-middle[1], middle[0], 0.0]))
    return np.stack([east, np.cross(up, east), up])


def _unit_vectors(vectors: FloatArray) -> FloatArray:
    """Return vectors (..., d) divided by their length."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
