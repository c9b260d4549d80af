"""Scenes of `benchmarks.uncertainty` that were drawn when fields had become of any size.

They were drawn after `benchmarks.fresh_kinds`, of which some had been looked at by then. They share
no code with other scenes but for what a scene is.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator
from scipy.spatial.transform import Rotation

from benchmarks.fresh_kinds import PLACES, Seen
from termsel.data.features import FeatureSet, FloatArray

CORNER = np.array([4e5, 5.2e6])
"""Of x and y [m]."""

FLIGHT = 1500.0
"""Height of a camera [m]."""

Radius = Callable[[FloatArray], FloatArray]
"""Distance from the middle of an image, by the focal length, of a ray that is off the axis [rad].
"""


def terrain(rng: Generator, relief: float, length: float) -> Callable[[FloatArray], FloatArray]:
    """Return heights of eight waves of about a length, with a standard deviation [m]."""
    directions = rng.normal(0.0, 1.0 / length, (8, 2))
    phases = rng.uniform(0.0, 2 * np.pi, 8)
    sizes = rng.exponential(1.0, 8)
    sizes *= relief / np.sqrt((sizes**2).sum() / 2.0)
    return lambda plan: np.asarray(np.cos(plan @ directions.T + phases) @ sizes)


def without_heights(plan: FloatArray) -> FloatArray:
    """Return ground places (n, 3) of which no height is known."""
    return np.column_stack([plan, np.full(len(plan), np.nan)])


def camera(tilt: tuple[float, float], relief: float, noise: float, *, radial: float = 0.0,
           tangential: float = 0.0,
           radius: Radius = np.tan) -> Callable[[Generator, int], Seen]:
    """Return what draws places that a camera sees, which is tilted by some degrees.

    The distortions of its lens are normal, with such standard deviations, by the squared tangent.
    """
    def draw(rng: Generator, n: int) -> Seen:
        degrees = rng.uniform(*tilt)
        surface = terrain(rng, relief, 600.0)
        radial_share, tangential_share = rng.normal(0.0, (radial, tangential))
        ahead = [FLIGHT * np.tan(np.radians(degrees)), 0.0]
        plan = ahead + rng.uniform(-1100.0, 1100.0, (20 * n, 2))
        z = surface(plan)
        rays = Rotation.from_euler("y", degrees, degrees=True).apply(
            np.column_stack([plan, z - FLIGHT]))
        off_axis = np.arccos(-rays[:, 2] / np.linalg.norm(rays, axis=1))
        across = np.linalg.norm(rays[:, :2], axis=1, keepdims=True)
        local = rays[:, :2] / across * radius(off_axis)[:, None]
        square = (local**2).sum(axis=1)
        local *= 1.0 + radial_share * square[:, None]
        local[:, 0] += tangential_share * (square + 2.0 * local[:, 0]**2)
        image = np.array([2000.0, 3000.0]) + 4000.0 * local * [-1.0, 1.0]
        shown = np.flatnonzero(((image > 0.0) & (image < [4000.0, 6000.0])).all(axis=1))[:n]
        return Seen(np.column_stack([CORNER + plan, z])[shown], image[shown], noise)
    return draw


def plan_by_a_phone(rng: Generator, n: int) -> Seen:
    """Return a printed plan that curls a little, photographed aslant by a phone."""
    share = rng.uniform(-1.0, 1.0, (n, 2))
    curl = rng.uniform(0.0, 0.01) * share[:, 0]**2
    turned = Rotation.from_rotvec(rng.normal(0.0, 0.25, 3)).apply(np.column_stack([share, curl]))
    flat = turned[:, :2] / (3.2 + turned[:, 2:])
    flat *= 1.0 + rng.normal(0.0, 0.01) * (flat**2).sum(axis=1, keepdims=True)
    return Seen(without_heights(CORNER + share * [300.0, -300.0]), 2000.0 + 3800.0 * flat[:, ::-1],
                0.7)


def in_another_projection(rng: Generator, n: int) -> Seen:
    """Return a map of a continent in an azimuthal projection, whose control is in degrees."""
    x, y = rng.uniform(-25.0, 25.0, n), rng.uniform(30.0, 65.0, n)
    longitude, latitude = np.radians(x), np.radians(y)
    middle = 0.8
    # Stereographic, of a sphere: Snyder 1987, eqs. 21-2 to 21-4.
    scale = 2.0 / (1.0 + np.sin(middle) * np.sin(latitude)
                   + np.cos(middle) * np.cos(latitude) * np.cos(longitude))
    east = scale * np.cos(latitude) * np.sin(longitude)
    north = scale * (np.cos(middle) * np.sin(latitude)
                     - np.sin(middle) * np.cos(latitude) * np.cos(longitude))
    pixels = rng.uniform(3000.0, 9000.0)
    return Seen(without_heights(np.column_stack([x, y])),
                2500.0 + pixels * np.column_stack([-north, east]), 1.0, "EPSG:4326")


def line_camera_of_a_drone(rng: Generator, n: int) -> Seen:
    """Return an image of a line camera 400 m up that rolls and pitches by slow waves."""
    image = rng.uniform(0.0, 1.0, (n, 2)) * [5000.0, 2000.0]
    time = image[:, 0] / 2500.0 - 1.0
    surface = terrain(rng, 25.0, 300.0)
    turns = np.zeros((n, 2))  # roll and pitch [rad]
    for _ in range(3):
        phases = rng.uniform(0.0, 2 * np.pi, 2)
        waves = np.cos(np.pi * rng.uniform(0.5, 4.0) * time[:, None] + phases)
        turns += rng.normal(0.0, (0.004, 0.003)) * waves
    z = np.zeros(n)
    for _ in range(80):  # until the ray meets the ground
        x = (400.0 - z) * np.tan((image[:, 1] - 1000.0) / 2500.0 + turns[:, 0])
        plan = np.column_stack([x, (400.0 - z) * turns[:, 1] - 0.2 * image[:, 0]])
        z = (z + surface(plan)) / 2.0
    return Seen(np.column_stack([CORNER + plan, z]), image, 0.5)


def of_twice_the_half(angle: FloatArray) -> FloatArray:
    """Return the radius of a ray in a stereographic image: 2 tan(angle / 2)."""
    return np.asarray(2.0 * np.tan(angle / 2.0))


LATER_KINDS: dict[str, Callable[[Generator, int], Seen]] = {
    "photo aslant by a lens": camera((5.0, 40.0), 60.0, 0.4, radial=0.03, tangential=0.002),
    "photo without distortion": camera((0.0, 45.0), 90.0, 0.6),
    "wide lens, stereographic": camera((0.0, 10.0), 40.0, 0.5, radius=of_twice_the_half),
    "plan by a phone": plan_by_a_phone,
    "map in another projection": in_another_projection,
    "line camera of a drone": line_camera_of_a_drone,
}


def later(kind: str, count: int, seed: int) -> tuple[FeatureSet, FloatArray, FloatArray]:
    """Return the control of a kind, and other places with where they are seen."""
    number = list(LATER_KINDS).index(kind)
    rng = np.random.default_rng([59, number, count, seed])
    return LATER_KINDS[kind](rng, count + PLACES).divided(count, rng)
