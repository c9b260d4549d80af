"""Simulated scenes named after the published test areas they imitate.

Place, extent, heights, off-nadir angle and numbers of points are those of the papers named
at each scene; orbit, attitude, terrain and every measurement are computed. The geometry of a
scene is fixed by its name. A seed draws points, lines and noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
from numpy.random import Generator

from termsel.core.arguments import explains_arguments
from termsel.core.errors import TermselError, unknown_name_error
from termsel.data.coordinates.wgs84 import SEMI_MAJOR
from termsel.data.datasets import DatasetSpec
from termsel.data.features import (
    FeatureSet,
    FloatArray,
    IntArray,
    Lines,
    Points,
    empty_lines,
    empty_points,
)
from termsel.data.roles import ASSIGNABLE
from termsel.simulate.catalogue import OTHERS, SCENES, Scene
from termsel.simulate.kept import kept_features
from termsel.simulate.orbit import pushbroom_at
from termsel.simulate.pushbroom import Angle, Pushbroom
from termsel.simulate.terrain import Terrain, hilly_terrain

_EDGE = 0.015  # fraction of the image at each edge without measurements
_CANDIDATES = 24  # places tried for each point
_LATEST = 500  # places to which distances are computed one by one
_SMALLEST_MISMATCH, _LARGEST_MISMATCH = 4.0, 15.0  # sideways displacement of a mismatched line [px]


@dataclass(frozen=True)
class SceneTruth:
    """Sensor, terrain and blunders of a simulated scene.

    Parameters
    ----------
    sensor : Pushbroom
        The scanner, free of noise.
    terrain : callable
        Ellipsoidal heights [m], shape (n,), of longitude and latitude [deg], shape (n, 2).
    wrong_lines : tuple of str
        Ids of the mismatched lines.
    """

    sensor: Pushbroom
    terrain: Callable[[FloatArray], FloatArray]
    wrong_lines: tuple[str, ...]


@explains_arguments()
def simulate_scene(
    name: str,
    *,
    seed: int | None = None,
    noise: float | None = None,
    n_points: int | None = None,
    n_lines: int | None = None,
    wrong_lines: int | None = None,
    roles: tuple[int, int, int] | None = None,
) -> FeatureSet:
    """Return the measured features of a simulated scene.

    Parameters
    ----------
    name : str
        "ikonos-hamedan", "spot-isfahan", "irs1c-mashad", "geoeye-tehran" or
        "cartosat-hyderabad".
    seed : int, optional
        Draws points, lines and noise; by default 0. Sensor and terrain do not depend on it.
    noise : float, optional
        Standard deviation of line and sample [px]; by default that of the scene, 0.5.
    n_points, n_lines : int, optional
        Numbers of points and lines; by default those of the scene.
    wrong_lines : int, optional
        Number of mismatched lines; by default the scene's fraction of `n_lines`.
    roles : tuple of int, optional
        Numbers of control, selection and independent check points, instead of `n_points`.

    Returns
    -------
    FeatureSet
        Longitude, latitude [deg] and ellipsoidal height [m] on WGS84; without `roles` a third of
        the points has each role. Two points, both control, lie at the lowest and the highest place.

    Raises
    ------
    TermselError
        For an unknown name, a negative number, noise or seed, infinite noise, more mismatched lines
        than lines, or `roles` that are not three or stand beside `n_points`.

    Examples
    --------
    >>> import termsel
    >>> features = termsel.simulate_scene("ikonos-hamedan", n_points=12, n_lines=5)
    >>> len(features.points), len(features.lines)
    (12, 5)
    """
    scene = _scene_of_name(name)
    n_lines, wrong = _line_counts(scene, n_lines, wrong_lines)
    if roles is not None and (n_points is not None or len(roles) != 3 or min(roles) < 0):
        raise TermselError(f"roles={roles} cannot be simulated",
                           hint="Give three numbers of points of at least 0, and no n_points.")
    if roles is None:
        roles = _role_counts(scene, sum(scene.roles) if n_points is None else n_points)
    noise = scene.noise if noise is None else noise
    if min(roles) < 0 or not 0 <= noise < float("inf"):
        raise TermselError(f"{sum(roles)} points with a noise of {noise} px cannot be simulated",
                           hint="Give a number of points and a noise of at least 0.")
    # Streams of their own: with other noise the places stay, and with other lines the points.
    wrong_rng, noise_rng = _random_streams(scene, seed)[2:]
    points, lines = _noise_free_features(name, seed, tuple(roles), n_lines)
    image = _displace_lines(lines.image, wrong_rng, wrong)
    point_noise, line_noise = noise_rng.spawn(2)
    points = replace(points, image=points.image
                     + noise * point_noise.standard_normal(points.image.shape))
    lines = replace(lines, image=image + noise * line_noise.standard_normal(image.shape))
    return FeatureSet(points, lines, "EPSG:4979", scene.image_size, noise)


def scene_truth(
    name: str,
    *,
    seed: int | None = None,
    n_lines: int | None = None,
    wrong_lines: int | None = None,
) -> SceneTruth:
    """Return sensor, terrain and mismatched lines of a scene from `simulate_scene`.

    Parameters
    ----------
    name, seed, n_lines, wrong_lines
        The values that `simulate_scene` was given.

    Returns
    -------
    SceneTruth
        The scanner without noise, the terrain, and which lines are mismatched.

    Raises
    ------
    TermselError
        For an unknown name, a negative number or seed, or more mismatched lines than lines.

    Examples
    --------
    >>> import termsel
    >>> from termsel.simulate import scene_truth
    >>> truth = scene_truth("ikonos-hamedan", wrong_lines=8)
    >>> len(truth.wrong_lines)
    8
    """
    scene = _scene_of_name(name)
    n_lines, wrong = _line_counts(scene, n_lines, wrong_lines)
    sensor, terrain, _ = _scene_geometry(name)
    ids = _numbered_ids("L", n_lines)
    picked = _pick_mismatched(_random_streams(scene, seed)[2], n_lines, wrong)
    return SceneTruth(sensor, terrain, tuple(ids[i] for i in picked))


def _scene_of_name(name: str) -> Scene:
    """Return the scene of a name; raises TermselError if it does not exist."""
    scenes = {**SCENES, **OTHERS}
    if name not in scenes:
        raise unknown_name_error("simulated scene", name, scenes)
    return scenes[name]


def _line_counts(scene: Scene, n_lines: int | None, wrong: int | None) -> tuple[int, int]:
    """Return the numbers of lines and of mismatched lines, by default those of the scene.

    Raises TermselError for a negative number, and for more mismatched lines than lines.
    """
    n_lines = scene.lines if n_lines is None else n_lines
    if wrong is None:
        wrong = round(n_lines * scene.wrong_lines / scene.lines) if scene.lines else 0
    if not 0 <= wrong <= n_lines:
        raise TermselError(f"{wrong} mismatched lines among {n_lines} cannot be simulated",
                           hint="Give numbers of at least 0, and not more mismatched lines than "
                                "lines.")
    return n_lines, wrong


def _random_streams(scene: Scene, seed: int | None) -> list[Generator]:
    """Return generators of points, lines, mismatches and noise, each a separate stream.

    Raises TermselError for a negative seed.
    """
    if seed is not None and seed < 0:
        raise TermselError(f"the seed is {seed}", hint="Give a whole number of at least 0.")
    return np.random.default_rng([scene.number, seed or 0]).spawn(4)


def _numbered_ids(letter: str, count: int) -> tuple[str, ...]:
    """Return ids such as P001, from 1 on."""
    return tuple(f"{letter}{i + 1:03d}" for i in range(count))


@lru_cache  # a scene by its name is the same for all its seeds
def _scene_geometry(name: str) -> tuple[Pushbroom, Terrain, FloatArray]:
    """Return sensor, terrain, and the image places (2, 2) of lowest and highest terrain."""
    scene = _scene_of_name(name)
    middle = sum(scene.heights) / 2
    sensor = _with_attitude_errors(scene, pushbroom_at(
        scene.lon, scene.lat, height=middle, off_nadir=scene.off_nadir,
        look_azimuth=scene.look_azimuth, gsd=scene.gsd, image_size=scene.image_size,
        altitude=scene.altitude, inclination=scene.inclination))
    width = scene.gsd * scene.image_size[1], scene.gsd * scene.image_size[0]
    terrain = hilly_terrain(scene.number, scene.lon, scene.lat, width, scene.relief)
    # Heights are those of what the image shows, but for its edges.
    share = np.linspace(_EDGE, 1 - _EDGE, 81)
    image = np.stack(np.meshgrid(share, share, indexing="ij"), axis=-1).reshape(-1, 2)
    image *= np.array(scene.image_size) - 1
    terrain, low, high = terrain.between(sensor.locate(image, middle), *scene.heights)
    return sensor, terrain, image[[low, high]]


def _with_attitude_errors(scene: Scene, sensor: Pushbroom) -> Pushbroom:
    """Return the sensor with drift and jitter of its attitude, as the scene states them in px."""
    end = sensor.centre[0] * sensor.line_period
    per_pixel = (sensor.ifov, sensor.ifov, 1 / sensor.centre[1])
    jitter = (*scene.jitter, 0.0)
    cycles = (2.3, 1.7, 1.0)
    phases = (0.4, 2.0, 0.0)
    angles = []
    for steady, drift, unit, amplitude, count, phase in zip(
            (sensor.roll, sensor.pitch, sensor.yaw), scene.drift, per_pixel, jitter, cycles,
            phases, strict=True):
        # The constant part stays; each power of time moves the image by so many px at the end.
        coefficients = [shift * unit / end ** (power + 1) for power, shift in enumerate(drift)]
        # Jitter is a sine of so many cycles over the image: amplitude [rad], frequency [Hz], phase.
        sines = ((amplitude * unit, count / (2 * end), phase),) if amplitude else ()
        angles.append(Angle((*(steady.drift or (0.0,)), *coefficients), sines))
    return replace(sensor, roll=angles[0], pitch=angles[1], yaw=angles[2])


def _ground_positions(name: str, image: FloatArray) -> FloatArray:
    """Return lon, lat, height, shape (n, 3), of image points on the terrain."""
    sensor, terrain, _ = _scene_geometry(name)
    # Slopes are gentle, so each round leaves about a twentieth of the error.
    return sensor.on_terrain(terrain, image, sum(_scene_of_name(name).heights) / 2, rounds=8)


def _role_counts(scene: Scene, count: int) -> tuple[int, int, int]:
    """Return how many points are control, selection and independent, a third each by default."""
    if count == sum(scene.roles):
        return scene.roles
    third, remainder = divmod(count, 3)
    return third + (remainder == 2), third, third + (remainder > 0)


@lru_cache(maxsize=16)  # studies and tests ask for a scene again and again
def _noise_free_features(name: str, seed: int | None, roles: tuple[int, int, int],
                         n_lines: int) -> tuple[Points, Lines]:
    """Return points and lines free of noise.

    `roles` are the numbers of control, selection and independent check points.
    """
    scene = _scene_of_name(name)
    point_rng, line_rng = _random_streams(scene, seed)[:2]
    return _noise_free_points(scene, point_rng, roles), _noise_free_lines(scene, line_rng, n_lines)


def _noise_free_points(scene: Scene, rng: Generator, numbers: tuple[int, int, int]) -> Points:
    """Return points free of noise, spread over the image as a whole and role by role.

    `numbers` are those of control, selection and independent check points. Each point is the one of
    many candidates that is farthest from the others (Mitchell 1991), over all points and over those
    of its role, as surveyors spread them. The first two control points are at the lowest and the
    highest place, so that the control spans the relief.
    """
    count = sum(numbers)
    if count == 0:
        return empty_points()
    sensor, _, extremes = _scene_geometry(scene.name)
    # Each role's points are evenly spread over the order in which points are drawn.
    role_order: list[tuple[float, int]] = []
    for role, number in enumerate(numbers):
        role_order += [((k + 0.5) / number, role) for k in range(number)]
    roles = np.array([role for _, role in sorted(role_order)])
    extent = np.array(scene.image_size) - 1.0
    image = np.empty((count, 2))
    at_extremes = np.flatnonzero(roles == 0)[:2]
    image[at_extremes] = extremes[:len(at_extremes)]
    placed, *of_role = (_Placed(np.empty((number, 2))) for number in (count, *numbers))
    for i in sorted(range(count), key=lambda i: (i not in at_extremes, i)):
        of_same = of_role[roles[i]]
        if i not in at_extremes:
            candidates = extent * rng.uniform(_EDGE, 1 - _EDGE, (_CANDIDATES, 2))
            # Points of one role are three times as sparse: their distances are sqrt(3) times those
            # of all.
            clearance = np.minimum(placed.away(candidates), of_same.away(candidates) / np.sqrt(3))
            image[i] = candidates[clearance.argmax()]
        placed.add(image[i])
        of_same.add(image[i])
    ground = _ground_positions(scene.name, image)
    return Points(_numbered_ids("P", count), sensor.project(ground), ground, None,
                  tuple(ASSIGNABLE[role] for role in roles))


class _Placed:
    """Places in the image, of which a tree holds all but the latest."""

    def __init__(self, space: FloatArray) -> None:
        self._places = space
        self._count = 0
        self._in_tree = 0

    def add(self, position: FloatArray) -> None:
        """Add a place (2,)."""
        self._places[self._count] = position
        self._count += 1
        # The tree is made anew for every `_LATEST` places; later ones are searched one by one.
        if self._count - self._in_tree == _LATEST:
            from scipy.spatial import cKDTree

            self._in_tree = self._count
            self._tree = cKDTree(self._places[:self._count])

    def away(self, candidates: FloatArray) -> FloatArray:
        """Return how far candidates (n, 2) are from the nearest place, (n,); infinite without."""
        x, y = self._places[self._in_tree:self._count].T
        distance: FloatArray = np.sqrt(((candidates[:, :1] - x) ** 2
                                        + (candidates[:, 1:] - y) ** 2).min(axis=1, initial=np.inf))
        return np.minimum(distance, self._tree.query(candidates)[0]) if self._in_tree else distance


def _noise_free_lines(scene: Scene, rng: Generator, count: int) -> Lines:
    """Return lines free of noise, dense like the streets of towns, sparse elsewhere.

    The image line is measured at two places of the ground line other than its vertices, as an
    operator does: line and vertices have no point in common, and only the distance across the line
    is an observation.
    """
    if count == 0:
        return empty_lines()
    sensor, terrain, _ = _scene_geometry(scene.name)
    # A town with 55 % of the lines, two villages with 15 % each, the rest anywhere.
    settlement = rng.choice(4, count, p=(0.55, 0.15, 0.15, 0.15))
    centre = np.array([[0.42, 0.38], [0.75, 0.70], [0.22, 0.74], [0.5, 0.5]])[settlement]
    radius = np.array([0.20, 0.10, 0.08, 0.0])[settlement]
    # The root of a uniform number, times the radius, makes places uniform over a disc.
    bearing = rng.uniform(0, 2 * np.pi, count)
    reach = radius * np.sqrt(rng.random(count))
    share = centre + reach[:, None] * np.column_stack([np.sin(bearing), np.cos(bearing)])
    anywhere = rng.uniform(0.06, 0.94, (count, 2))
    share[settlement == 3] = anywhere[settlement == 3]
    middle = _ground_positions(scene.name, share * (np.array(scene.image_size) - 1))[:, :2]
    azimuth = rng.uniform(0, 2 * np.pi, count)
    length = scene.gsd * np.exp(rng.uniform(np.log(40), np.log(400), count))
    # Half of the length, as an angle at the centre of the Earth; a degree of longitude is shorter.
    half_length = np.degrees(length / 2 / SEMI_MAJOR)
    step = np.column_stack([half_length * np.sin(azimuth) / np.cos(np.radians(scene.lat)),
                            half_length * np.cos(azimuth)])
    ends = np.stack([middle - step, middle + step], axis=1)
    ground = np.dstack([ends, terrain(ends.reshape(-1, 2)).reshape(-1, 2)])
    # Where the image line is measured, by the length of the ground line, in either order.
    fractions = np.column_stack([rng.uniform(-0.2, 0.3, count), rng.uniform(0.7, 1.2, count)])
    swap = rng.random(count) < 0.5
    fractions[swap] = fractions[swap, ::-1]
    measured = ground[:, :1] + fractions[..., None] * (ground[:, 1:] - ground[:, :1])
    image = sensor.project(measured.reshape(-1, 3)).reshape(-1, 2, 2)
    return Lines(_numbered_ids("L", count), image, ground)


def _pick_mismatched(rng: Generator, n_lines: int, wrong: int) -> IntArray:
    """Return the indices (wrong,) of mismatched lines, in order; the first numbers of `rng`."""
    return np.sort(rng.choice(n_lines, wrong, replace=False))


def _displace_lines(image: FloatArray, rng: Generator, wrong: int) -> FloatArray:
    """Return image lines (n, 2, 2) of which `wrong` are moved across themselves by some pixels.

    So they are as if a neighbouring street had been taken for each.
    """
    picked = _pick_mismatched(rng, len(image), wrong)
    direction = image[picked, 1] - image[picked, 0]
    sideways = np.column_stack([-direction[:, 1], direction[:, 0]])
    sideways /= np.linalg.norm(direction, axis=1, keepdims=True)
    size = rng.uniform(_SMALLEST_MISMATCH, _LARGEST_MISMATCH, wrong)
    offset = size * rng.choice([-1.0, 1.0], wrong)
    moved = image.copy()
    moved[picked] += (offset[:, None] * sideways)[:, None]
    return moved


def _read_datasets(scenes: Mapping[str, Scene]) -> tuple[DatasetSpec, ...]:
    """Return the data sets of scenes, which are read from the files that hold them."""
    return tuple(DatasetSpec(scene.name, scene.summary,
                             partial(kept_features, "termsel.simulate", scene.name), simulated=True)
                 for scene in scenes.values())


DATASETS = _read_datasets(SCENES)
FURTHER = _read_datasets(OTHERS)
