"""Scenes of `benchmarks.uncertainty` that were drawn when all rules of the uncertainty were fixed.

They share no code with the scenes of termsel, nor with the other kinds of that page. Each kind is
drawn from a generator of random numbers, for a number of places: ground and image of all, without
noise, the noise of a measurement and the CRS.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from scipy.spatial.transform import Rotation

from termsel.data.features import FeatureSet, FloatArray, Points

PLACES = 250
METRES = "EPSG:32633"
ORIGIN = np.array([5e5, 5e6])
"""Of x and y, in metres of that CRS."""

Heights = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Seen:
    """Places (n, 3), where they are seen (n, 2), and the noise of measurements [px]."""

    ground: FloatArray
    image: FloatArray
    noise: float
    crs: str = METRES

    def divided(self, count: int, rng: Generator) -> tuple[FeatureSet, FloatArray, FloatArray]:
        """Return the first places as measured control, and the others with their true image."""
        measured = self.image[:count] + rng.normal(0.0, self.noise, (count, 2))
        points = Points(tuple(map(str, range(count))), measured, self.ground[:count])
        return FeatureSet(points, crs=self.crs), self.ground[count:], self.image[count:]


def on_sheet(share: FloatArray, size: tuple[float, float], metres: float) -> FloatArray:
    """Return the ground, without heights, of places in shares of a sheet's height and width."""
    plan = metres * np.column_stack([size[1] * share[:, 1], -size[0] * share[:, 0]])
    return np.column_stack([ORIGIN + plan, np.full(len(share), np.nan)])


def hills(rng: Generator, relief: float, length: float) -> Heights:
    """Return heights of twelve waves of about a length, with a standard deviation [m]."""
    directions = rng.normal(0.0, 1.0 / length, (12, 2))
    phases = rng.uniform(0.0, 2 * np.pi, 12)
    sizes = rng.exponential(1.0, 12)
    sizes *= relief / np.sqrt((sizes**2).sum() / 2.0)
    return lambda plan: np.asarray(np.cos(plan @ directions.T + phases) @ sizes)


def with_humps(rng: Generator, n: int) -> Seen:
    """Return a sheet with some humps and dents of different widths."""
    share = rng.uniform(0.0, 1.0, (n, 2))
    humps = int(rng.integers(3, 8))
    centres = rng.uniform(-0.1, 1.1, (humps, 2))
    widths = rng.uniform(0.15, 0.5, humps)
    squares = ((share[:, None] - centres)**2).sum(axis=2)
    shift = np.exp(-squares / (2.0 * widths**2)) @ rng.normal(0.0, 3.0, (humps, 2))
    size = (4500.0, 6000.0)
    return Seen(on_sheet(share, size, 2.0), share * size + shift, 0.6)


def shrunken(rng: Generator, n: int) -> Seen:
    """Return a sheet that shrank unevenly, most at two sides, scanned by an uneven feed."""
    share = rng.uniform(0.0, 1.0, (n, 2))
    line, sample = (2.0 * share - 1.0).T
    cubic, mixed, cubic_sample, at_sides = rng.normal(0.0, (4.0, 3.0, 4.0, 3.0))
    feed = 1.2 * np.sin(rng.uniform(3.0, 9.0) * line + rng.uniform(0.0, 2 * np.pi))
    near_side = np.exp(-4.0 * (1.0 - np.abs(sample))) * np.sign(sample)
    shift = np.column_stack([cubic * line**3 + mixed * line * sample**2 + feed,
                             cubic_sample * sample**3 + at_sides * near_side])
    size = (7000.0, 5000.0)
    return Seen(on_sheet(share, size, 1.5), share * size + shift, 0.4)


def redrawn(rng: Generator, n: int) -> Seen:
    """Return a map that was drawn again by hand: its errors have a slope, and no curvature."""
    share = rng.uniform(0.0, 1.0, (n, 2))
    distances = np.linalg.norm(share[:, None] - share, axis=2) / rng.uniform(0.15, 0.6)
    r = np.sqrt(3.0) * distances
    lower = np.linalg.cholesky((1.0 + r) * np.exp(-r) + 1e-10 * np.eye(n))
    size = (3200.0, 4000.0)
    shift = 6.0 * lower @ rng.standard_normal((n, 2))
    return Seen(on_sheet(share, size, 0.25), share * size + shift, 1.0)


def in_four_pieces(rng: Generator, n: int) -> Seen:
    """Return a mosaic of four sheets, each placed by an affine map of its own."""
    share = rng.uniform(0.0, 1.0, (n, 2))
    right = share > rng.uniform(0.35, 0.65, 2)
    columns = np.column_stack([np.ones(n), 2.0 * share - 1.0])
    maps = rng.normal(0.0, 1.5, (4, 3, 2))
    shift = np.einsum("nk,nkd->nd", columns, maps[2 * right[:, 0] + right[:, 1]])
    size = (8000.0, 8000.0)
    return Seen(on_sheet(share, size, 2.0), share * size + shift, 0.5)


def map_on_a_table(rng: Generator, n: int) -> Seen:
    """Return a map that curls a little on a table, photographed aslant by a lens that distorts."""
    share = rng.uniform(0.0, 1.0, (n, 2))
    plan = 2.0 * share - 1.0
    curl = rng.uniform(0.0, 0.03) * np.cos(rng.uniform(1.0, 3.0) * plan[:, 1]
                                           + rng.uniform(0.0, 2 * np.pi))
    place = np.column_stack([plan, curl + rng.uniform(0.0, 0.02) * plan[:, 0]**2])
    turned = Rotation.from_rotvec(rng.normal(0.0, 0.15, 3)).apply(place)
    flat = turned[:, :2] / (3.0 + turned[:, 2:])
    flat *= 1.0 + rng.normal(0.0, 0.05) * (flat**2).sum(axis=1, keepdims=True)
    return Seen(on_sheet(share, (9000.0, 9000.0), 1.0), 4200.0 * flat + 2000.0, 0.8)


def pushbroom(jitter: float, relief: float, noise: float) -> Callable[[Generator, int], Seen]:
    """Return what draws scanners 600 km high that drift, and shake by so many px."""
    def draw(rng: Generator, n: int) -> Seen:
        height, pixel, side = 600e3, 2.0, 12000.0
        image = rng.uniform(0.0, side, (n, 2))
        surface = hills(rng, relief, 6000.0)
        time = 2.0 * image[:, 0] / side - 1.0
        shift = np.column_stack([time, time**2, time**3]) @ (
            rng.standard_normal((3, 2)) * [[20.0], [6.0], [2.0]])
        for _ in range(2):
            phases = rng.uniform(0.0, 2 * np.pi, 2)
            waves = np.cos(np.pi * rng.uniform(2.0, 9.0) * time[:, None] + phases)
            shift += jitter * rng.uniform(0.5, 1.0, 2) * waves
        pitch, roll = rng.normal(0.0, 0.15, 2)
        ahead = np.tan(pitch) + pixel * shift[:, 0] / height
        aside = np.tan(roll) + pixel * (image[:, 1] - side / 2.0 + shift[:, 1]) / height
        turn = rng.uniform(-0.3, 0.3)
        z = np.zeros(n)
        for _ in range(60):  # until the ray meets the ground
            along = pixel * (image[:, 0] - side / 2.0) + (height - z) * ahead
            across = (height - z) * aside
            plan = np.column_stack([np.sin(turn) * along + np.cos(turn) * across,
                                    np.sin(turn) * across - np.cos(turn) * along])
            z = surface(plan)
        return Seen(np.column_stack([ORIGIN + plan, z]), image, noise)
    return draw


def first_ground(rays: FloatArray, height: float, surface: Heights, relief: float) -> FloatArray:
    """Return the first ground (n, 3) that rays down from (0, 0, height) meet."""
    longest = (height + 4.0 * relief) / -rays[:, 2]
    steps = np.linspace(0.0, 1.0, 401)[:, None] * longest                            # (s, n)
    places = steps[..., None] * rays
    under = height + places[..., 2] <= surface(places[..., :2])
    first = np.maximum(under.argmax(axis=0), 1)
    number = np.arange(len(rays))
    low, high = steps[first - 1, number], steps[first, number]
    for _ in range(50):
        middle = (low + high) / 2.0
        place = middle[:, None] * rays
        is_under = height + place[:, 2] <= surface(place[:, :2])
        low, high = np.where(is_under, low, middle), np.where(is_under, middle, high)
    return np.asarray(high[:, None] * rays + [0.0, 0.0, height])


def photo(tilt: tuple[float, float], relief: float, distortion: float, *, heights: bool = True,
          fisheye: bool = False) -> Callable[[Generator, int], Seen]:
    """Return what draws photos 2.5 km high, tilted by degrees, whose lens distorts by a share."""
    def draw(rng: Generator, n: int) -> Seen:
        size = np.array([4000.0, 6000.0])
        image = rng.uniform(0.0, 1.0, (3 * n, 2)) * size
        surface = hills(rng, relief, 900.0)
        centred = image - size / 2.0 - rng.normal(0.0, 20.0, 2)
        radius = np.linalg.norm(centred, axis=1, keepdims=True)
        if fisheye:
            angle = radius / 1800.0
            local = np.column_stack([centred * np.sin(angle) / radius, np.cos(angle)])
        else:
            share = 1.0 + rng.normal(0.0, distortion) * (radius / 5000.0)**2
            local = np.column_stack([centred / 5000.0 * share, np.ones(len(image))])
        turn = Rotation.from_euler("xz", [rng.uniform(*tilt), rng.uniform(0.0, 360.0)],
                                   degrees=True)
        rays = turn.apply(np.column_stack([local[:, 1], -local[:, 0], -local[:, 2]]))
        # What is seen less than some ten degrees below the horizon is too far away.
        shown = np.flatnonzero(rays[:, 2] < -0.15 * np.linalg.norm(rays, axis=1))[:n]
        ground = first_ground(rays[shown], 2500.0, surface, relief)
        ground[:, :2] += ORIGIN
        if not heights:
            ground[:, 2] = np.nan
        return Seen(ground, image[shown], 0.5)
    return draw


def two_hills(rng: Generator, n: int) -> Seen:
    """Return a photo without distortion of a plain with two hills."""
    plan = rng.uniform(-1500.0, 1500.0, (n, 2))
    squares = ((plan[:, None] - rng.uniform(-1000.0, 1000.0, (2, 2)))**2).sum(axis=2)
    z = np.exp(-squares / (2.0 * rng.uniform(250.0, 500.0, 2)**2)) @ rng.uniform(80.0, 300.0, 2)
    turned = Rotation.from_euler("xy", rng.normal(0.0, 0.05, 2)).apply(
        np.column_stack([plan, z - 3000.0]))
    image = 2500.0 + 5000.0 * turned[:, [1, 0]] / turned[:, 2:] * [1.0, -1.0]
    return Seen(np.column_stack([ORIGIN + plan, z]), image, 0.5)


def scanning_camera(rng: Generator, n: int) -> Seen:
    """Return an image of a camera that looks from side to side while it flies, over hills."""
    height, focal, size = 4000.0, 4300.0, np.array([6000.0, 9000.0])
    image = rng.uniform(0.0, 1.0, (n, 2)) * size
    surface = hills(rng, 120.0, 1500.0)
    ahead, angle = ((image - size / 2.0) / focal).T
    start = rng.uniform(100.0, 300.0) * (image[:, 1] / size[1] - 0.5)
    z = np.zeros(n)
    for _ in range(200):
        reach = (height - z) / np.cos(angle)
        plan = np.column_stack([reach * np.sin(angle), -start - reach * ahead])
        z = (z + surface(plan)) / 2.0
    return Seen(np.column_stack([ORIGIN + plan, z]), image, 0.5)


FRESH_KINDS: dict[str, Callable[[Generator, int], Seen]] = {
    "sheet with humps": with_humps,
    "sheet that shrank": shrunken,
    "map drawn again": redrawn,
    "map on a table": map_on_a_table,
    "mosaic of four pieces": in_four_pieces,
    "scanner that drifts": pushbroom(0.0, 300.0, 0.4),
    "scanner that shakes": pushbroom(1.0, 300.0, 0.4),
    "scanner that shakes a little": pushbroom(0.3, 80.0, 0.25),
    "photo by a lens that distorts": photo((0.0, 8.0), 150.0, 0.02),
    "photo of hills, without heights": photo((0.0, 8.0), 15.0, 0.02, heights=False),
    "photo of a drone, aslant": photo((35.0, 55.0), 40.0, 0.01),
    "photo of a plain with two hills": two_hills,
    "fisheye": photo((0.0, 15.0), 60.0, 0.0, fisheye=True),
    "camera that scans": scanning_camera,
}


def fresh(kind: str, count: int, seed: int) -> tuple[FeatureSet, FloatArray, FloatArray]:
    """Return the control of a kind, and other places with where they are seen."""
    number = list(FRESH_KINDS).index(kind)
    rng = np.random.default_rng([58, number, count, seed])
    return FRESH_KINDS[kind](rng, count + PLACES).divided(count, rng)
