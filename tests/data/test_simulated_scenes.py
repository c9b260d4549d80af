"""Simulated scenes: the scanner's geometry, and what the scenes promise."""

import subprocess
import sys

import numpy as np
import pytest

from termsel.core.errors import TermselError
from termsel.simulate import (
    DATASETS,
    SCENES,
    Angle,
    Pushbroom,
    pushbroom_at,
    scene_truth,
    scenes,
    simulate_scene,
)
from termsel.simulate.geometry_files import geometry_from, geometry_text
from termsel.simulate.render import checkerboard_pattern

NAMES = tuple(SCENES)
PLACE = {"lon": 48.5, "lat": 34.8, "height": 1850.0, "gsd": 1.0, "image_size": (7000, 8000),
         "altitude": 681e3, "inclination": 98.1}


def places(sensor, heights, count=500):
    """Image points in and a little beyond the image, and heights."""
    rng = np.random.default_rng(5)
    size = np.array([sensor.n_lines, sensor.n_samples])
    return size * rng.uniform(-0.05, 1.05, (count, 2)), rng.uniform(*heights, count)


def earth_fixed(lon, lat, height):
    pyproj = pytest.importorskip("pyproj")
    change = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    return np.column_stack(change.transform(lon, lat, height))


def about(axis, angle, vectors):
    """Turn vectors about a unit axis by Rodrigues' formula."""
    angle = np.reshape(angle, (-1, 1))
    return (vectors * np.cos(angle) + np.cross(axis, vectors) * np.sin(angle)
            + axis * (vectors * axis).sum(-1, keepdims=True) * (1 - np.cos(angle)))


@pytest.mark.parametrize("name", NAMES)
def test_project_undoes_locate(name):
    sensor = scene_truth(name).sensor
    image, height = places(sensor, SCENES[name].heights)
    ground = np.column_stack([sensor.locate(image, height), height])
    assert np.abs(sensor.project(ground) - image).max() < 1e-6


@pytest.mark.parametrize("name", NAMES)
def test_collinearity_computed_in_inertial_axes(name):
    # The same ray built another way: the ground turns with the Earth, the orbit is a circle in
    # a plane that stands still, and attitude turns vectors one axis after the other.
    sensor = scene_truth(name).sensor
    sensor = Pushbroom(**{**vars(sensor), "refraction": False})
    image, height = places(sensor, SCENES[name].heights)
    lonlat = sensor.locate(image, height)
    image = sensor.project(np.column_stack([lonlat, height]))
    t = (image[:, 0] - (sensor.n_lines - 1) / 2) * sensor.line_period
    pole = np.array([0.0, 0.0, 1.0])
    ground = about(pole, 7.292115e-5 * t, earth_fixed(*lonlat.T, height))
    i, node = np.radians([sensor.inclination, sensor.node])
    ascending = np.array([np.cos(node), np.sin(node), 0.0])
    orbit_normal = about(ascending, i, pole[None])[0]
    radius = 6378137.0 + sensor.altitude
    u = np.radians(sensor.argument) + np.sqrt(3.986004418e14 / radius**3) * t
    outward = about(orbit_normal, u, np.tile(ascending, (len(t), 1)))
    axes = [np.cross(orbit_normal, outward), np.tile(-orbit_normal, (len(t), 1)), -outward]
    for axis, angle in ((0, sensor.roll), (1, sensor.pitch), (2, sensor.yaw)):
        turning = axes[axis]
        axes = [about(turning, angle(t), vector) for vector in axes]
    ray = ground - radius * outward
    along, across, depth = ((ray * axis).sum(-1) for axis in axes)
    assert np.abs(along / depth / sensor.ifov).max() < 1e-6
    sample = (sensor.n_samples - 1) / 2 - across / depth / sensor.ifov
    assert np.abs(sample - image[:, 1]).max() < 1e-6


def test_located_points_have_the_height_asked_for():
    # A ray to two heights is straight: a third height on it lies between, in Earth-fixed axes.
    sensor = pushbroom_at(**PLACE, off_nadir=30, refraction=False)
    image = np.array([[100.0, 200.0]])
    low, mid, high = (earth_fixed(*sensor.locate(image, h).T, h) for h in (0.0, 700.0, 1500.0))
    assert np.linalg.norm(np.cross(high - low, mid - low)) / np.linalg.norm(high - low) < 1e-6


@pytest.mark.parametrize(("off_nadir", "azimuth"), [(0, 90), (20, 90), (20, 30), (30, -120)])
def test_pushbroom_at_looks_where_it_should(off_nadir, azimuth):
    sensor = pushbroom_at(**PLACE, off_nadir=off_nadir, look_azimuth=azimuth)
    line, sample = sensor.centre
    assert (line, sample) == (3499.5, 3999.5)
    seen = sensor.locate([[line, sample], [line + 1, sample], [line, sample + 1]], 1850)
    assert seen[0] == pytest.approx([48.5, 34.8], abs=1e-9)
    xyz = earth_fixed(*seen.T, np.full(3, 1850.0))
    assert np.linalg.norm(xyz[1:] - xyz[0], axis=1) == pytest.approx(1, abs=1e-4)
    assert sensor.off_nadir() == pytest.approx(off_nadir, abs=1e-6)
    # Descending and not mirrored: lines go south, samples go east.
    assert seen[1, 1] < seen[0, 1]
    assert seen[2, 0] > seen[0, 0]


@pytest.mark.parametrize(("azimuth", "axis", "sign"), [(90, 0, -1), (-90, 0, 1), (0, 1, -1)])
def test_a_ray_goes_on_in_the_direction_of_the_look(azimuth, axis, sign):
    """The satellite flies south: starboard is west, ahead is south."""
    sensor = pushbroom_at(**PLACE, off_nadir=20, look_azimuth=azimuth)
    high, low = sensor.locate([sensor.centre, sensor.centre], [1950.0, 1850.0])
    assert np.sign(low - high)[axis] == sign
    assert abs(low - high)[axis] > 3 * abs(low - high)[1 - axis]


def test_angle_at_the_ground_follows_the_sine_rule():
    sensor = pushbroom_at(**PLACE, off_nadir=20.4, refraction=False)
    low, high = sensor.locate([sensor.centre, sensor.centre], [1850.0, 1950.0])
    ground = earth_fixed(*np.column_stack([low, high]), np.array([1850.0, 1850.0]))
    slope = np.degrees(np.arctan(np.linalg.norm(ground[1] - ground[0]) / 100))
    radius = np.linalg.norm(earth_fixed(48.5, 34.8, 1850.0))
    orbit = 6378137.0 + sensor.altitude
    # The vertical of the ellipsoid and the direction to the centre differ by up to 0.2 deg.
    assert slope == pytest.approx(
        np.degrees(np.arcsin(orbit / radius * np.sin(np.radians(20.4)))), abs=0.25)


def test_refraction_draws_rays_towards_the_nadir():
    bent = pushbroom_at(**PLACE, off_nadir=30)
    straight = Pushbroom(**{**vars(bent), "refraction": False})
    centre = np.array([bent.centre])
    station, _ = bent.exposure(np.zeros(1))
    ground = [earth_fixed(*s.locate(centre, 0.0).T, 0.0)[0] for s in (bent, straight)]
    ray = station[0] - ground[1]
    up = earth_fixed(*straight.locate(centre, 0.0).T, 1000.0)[0] - ground[1]
    z = np.arccos(ray @ up / np.linalg.norm(ray) / np.linalg.norm(up))
    shift = np.linalg.norm(ground[0] - ground[1])
    # Integral of n sin(z) = constant through layers of 10 m of the standard atmosphere.
    h = np.arange(5.0, 11000.0, 10.0)
    air = 2.778e-4 * (1 - 2.25577e-5 * h) ** 4.25588
    troposphere = 10 * (np.tan(z) - np.tan(np.arcsin(np.sin(z) / (1 + air)))).sum()
    above = 2.778e-4 * 0.2234 * 8434.0 * np.tan(z) / np.cos(z) ** 2  # 0.2234: pressure at 11 km
    assert shift == pytest.approx(troposphere + above, rel=0.02)
    assert (ground[0] - ground[1]) @ ray > 0


def test_drift_and_jitter_move_the_image_by_what_they_say():
    still = pushbroom_at(**PLACE, off_nadir=0)
    roll = Angle((0.0, 1e-6), ((2e-6, 0.5, 0.1),))
    ground = np.column_stack([still.locate([[500.0, 3999.5]], 1850.0), [1850.0]])
    t = float(still.time(np.array(500.0)))
    moved = Pushbroom(**{**vars(still), "roll": roll}).project(ground) - still.project(ground)
    expected = (1e-6 * t + 2e-6 * np.sin(2 * np.pi * 0.5 * t + 0.1)) / still.ifov
    assert abs(moved[0, 1]) == pytest.approx(abs(expected), rel=1e-3)


def test_errors_say_what_to_do():
    sensor = pushbroom_at(**PLACE)
    with pytest.raises(TermselError, match=r"expected \(n, 3\)"):
        sensor.project([[48.5, 34.8]])
    with pytest.raises(TermselError, match="out of the scanner's view"):
        sensor.project([[48.5 - 180, -34.8, 0.0]])
    with pytest.raises(TermselError, match="out of the scanner's view"):
        sensor.project([[34.8, 48.5, np.nan]])
    with pytest.raises(TermselError, match="miss the Earth"):
        Pushbroom(**{**vars(sensor), "roll": Angle((1.5,))}).locate([[0, 0]], 0.0)
    with pytest.raises(TermselError, match="does not reach latitude"):
        pushbroom_at(**{**PLACE, "lat": 85.0})
    with pytest.raises(TermselError, match="which is not positive"):
        Pushbroom(**{**vars(sensor), "ifov": 0.0})
    with pytest.raises(TermselError, match="Did you mean 'ikonos-hamedan'"):
        simulate_scene("ikonos-hamadan")
    with pytest.raises(TermselError, match="more mismatched lines than lines"):
        simulate_scene("ikonos-hamedan", n_lines=3, wrong_lines=4)
    with pytest.raises(TermselError, match="at least 0"):
        simulate_scene("ikonos-hamedan", noise=-1.0)
    with pytest.raises(TermselError, match="seed is -1"):
        scene_truth("ikonos-hamedan", seed=-1)


@pytest.mark.parametrize(("name", "off_nadir", "roles", "lines"), [
    ("ikonos-hamedan", 20.4, (24, 24, 26), 120),
    ("spot-isfahan", 20.8, (12, 11, 12), 0),
    ("irs1c-mashad", 15.0, (20, 20, 22), 0),
])
def test_scenes_are_as_published(name, off_nadir, roles, lines):
    scene, truth = SCENES[name], scene_truth(name)
    features = simulate_scene(name)
    assert truth.sensor.off_nadir() == pytest.approx(off_nadir, abs=1e-3)
    assert features.crs == "EPSG:4979"
    assert features.image_size == scene.image_size
    assert features.noise == 0.5
    assert len(features.lines) == lines
    counted = tuple(features.points.roles.count(r) for r in ("control", "check", "independent"))
    assert counted == roles
    height = features.points.ground[:, 2]
    assert (height.min(), height.max()) == pytest.approx(scene.heights, abs=1)
    assert np.abs(truth.terrain(features.points.ground[:, :2]) - height).max() < 1e-3
    size = np.array(scene.image_size)
    share = np.stack(np.meshgrid(*2 * [np.linspace(0.015, 0.985, 60)]), axis=-1).reshape(-1, 2)
    terrain = truth.terrain(truth.sensor.locate(share * size, sum(scene.heights) / 2))
    assert (terrain.min(), terrain.max()) == pytest.approx(scene.heights, abs=2)
    vertices = features.image_vertices()
    assert ((vertices > 0) & (vertices < size - 1)).all()


def test_noise_is_the_noise():
    sensor = scene_truth("ikonos-hamedan").sensor
    features = simulate_scene("ikonos-hamedan", n_points=400)
    error = features.points.image - sensor.project(features.points.ground)
    assert error.std(axis=0) == pytest.approx([0.5, 0.5], abs=0.06)
    exact = simulate_scene("ikonos-hamedan", n_points=400, noise=0.0)
    assert np.abs(exact.points.image - sensor.project(exact.points.ground)).max() < 1e-9
    assert np.array_equal(exact.points.ground, features.points.ground)


def test_each_role_is_in_every_quadrant():
    for seed in range(5):
        points = simulate_scene("ikonos-hamedan", seed=seed).points
        quadrant = (points.image > np.array(SCENES["ikonos-hamedan"].image_size) / 2) @ [2, 1]
        for role in ("control", "check", "independent"):
            assert set(quadrant[np.array(points.roles) == role]) == {0, 1, 2, 3}


@pytest.mark.parametrize("count", [0, 1, 12, 20, 40, 150])
def test_numbers_of_points(count):
    points = simulate_scene("irs1c-mashad", n_points=count).points
    assert len(points) == count
    shares = [points.roles.count(r) for r in ("control", "check", "independent")]
    assert max(shares) - min(shares) <= 1


def off_line(image, through):
    """Distances (n, 2) of image points from the straight lines through two others [px]."""
    run = through[:, 1] - through[:, 0]
    sideways = np.column_stack([-run[:, 1], run[:, 0]]) / np.linalg.norm(run, axis=1)[:, None]
    return np.abs(np.einsum("nej,nj->ne", image - through[:, :1], sideways))


def test_lines_match_except_the_mismatched_ones():
    lines = simulate_scene("ikonos-hamedan", noise=0.0).lines
    truth = scene_truth("ikonos-hamedan")
    projected = truth.sensor.project(lines.ground.reshape(-1, 3)).reshape(-1, 2, 2)
    distance = off_line(lines.image, projected)
    wrong = np.isin(lines.ids, truth.wrong_lines)
    assert wrong.sum() == len(truth.wrong_lines) == 8
    assert distance[~wrong].max() < 0.05
    assert distance[wrong].min() > 3.95
    assert distance[wrong].max() < 15.05
    length = np.linalg.norm(projected[:, 1] - projected[:, 0], axis=1)
    assert length.min() > 30
    assert length.max() < 460
    # Ends are not conjugate, in either order.
    ends = np.linalg.norm(lines.image[:, :, None] - projected[:, None], axis=3)
    assert np.median(ends.min(axis=2) / length[:, None]) > 0.05


def test_lines_are_crowded_and_lie_every_way():
    lines = simulate_scene("ikonos-hamedan", wrong_lines=0).lines
    assert scene_truth("ikonos-hamedan", wrong_lines=0).wrong_lines == ()
    cell = (lines.image.mean(axis=1) // [1750, 2000]).astype(int) @ [4, 1]
    counts = np.bincount(cell, minlength=16)
    assert counts.max() > 20
    assert (counts <= 2).sum() >= 4
    run = lines.image[:, 1] - lines.image[:, 0]
    way = np.degrees(np.arctan2(run[:, 0], run[:, 1])) % 180
    assert np.histogram(way, 6, (0, 180))[0].min() > 5


def test_fewer_lines_keep_the_share_of_mismatched_ones():
    lines = simulate_scene("ikonos-hamedan", n_lines=30, noise=0.0).lines
    assert len(lines) == 30
    assert len(scene_truth("ikonos-hamedan", n_lines=30).wrong_lines) == 2
    assert len(simulate_scene("spot-isfahan", n_lines=10).lines) == 10


@pytest.mark.parametrize("name", NAMES)
def test_the_same_call_gives_the_same_data(name):
    first, again = simulate_scene(name), simulate_scene(name, seed=0)
    other = simulate_scene(name, seed=1)
    for a, b in zip((first.points.ground, first.points.image, first.lines.image),
                    (again.points.ground, again.points.image, again.lines.image), strict=True):
        assert np.array_equal(a, b)
    assert not np.array_equal(first.points.ground, other.points.ground)
    assert scene_truth(name, seed=1).sensor == scene_truth(name).sensor
    assert scene_truth(name, seed=1).terrain == scene_truth(name).terrain


def test_what_is_kept_of_a_call_is_free_of_noise_and_cannot_be_changed():
    exact = simulate_scene("ikonos-hamedan", seed=7, noise=0.0, wrong_lines=0)
    noisy = simulate_scene("ikonos-hamedan", seed=7, noise=9.0, wrong_lines=5)
    again = simulate_scene("ikonos-hamedan", seed=7, noise=0.0, wrong_lines=0)
    assert not np.array_equal(noisy.points.image, exact.points.image)
    for part in ("points", "lines"):
        first, second = getattr(exact, part), getattr(again, part)
        np.testing.assert_array_equal(second.image, first.image)
        with pytest.raises(ValueError, match="read-only"):
            second.ground[0] = 0.0


def design(ground, degree, dimensions):
    """Columns of the full polynomial of scaled coordinates."""
    unit = (ground - ground.mean(axis=0)) / np.ptp(ground, axis=0)
    powers = np.array(list(np.ndindex(*(degree + 1,) * dimensions)))
    powers = powers[powers.sum(axis=1) <= degree]
    return (unit[:, None, :dimensions] ** powers).prod(axis=2)


@pytest.mark.parametrize(("name", "low", "high"), [
    ("ikonos-hamedan", 2.0, 3.0), ("spot-isfahan", 2.5, 4.0), ("irs1c-mashad", 2.0, 3.0)])
def test_which_models_fit(name, low, high):
    points = simulate_scene(name, n_points=400, noise=0.0).points

    def misfit(degree, dimensions):
        a = design(points.ground, degree, dimensions)
        rest = points.image - a @ np.linalg.lstsq(a, points.image, rcond=None)[0]
        return np.sqrt((rest**2).sum(axis=1).mean())

    noise = 0.5 * np.sqrt(2)
    assert misfit(1, 3) > 1.5 * noise
    assert misfit(2, 3) < 0.4 * noise
    assert low < misfit(3, 2) < high
    assert low < misfit(4, 2) < high


def test_datasets_are_declared_simulated():
    assert tuple(spec.name for spec in DATASETS) == NAMES
    for spec in DATASETS:
        assert spec.simulated
        assert "simulated" in spec.summary
        assert len(spec.load().points) == sum(SCENES[spec.name].roles)


def test_sensor_and_terrain_of_a_scene_are_computed_once():
    for name in NAMES:
        simulate_scene(name)
    scenes._noise_free_features.cache_clear()
    before = scenes._scene_geometry.cache_info()
    for name in NAMES:
        simulate_scene(name, seed=1)
    after = scenes._scene_geometry.cache_info()
    assert after.misses == before.misses
    assert after.hits >= before.hits + len(NAMES)


def test_a_geometry_is_read_as_it_was_written():
    for name in NAMES:
        sensor = scene_truth(name).sensor
        assert geometry_from(geometry_text(sensor)) == sensor


def test_a_checkerboard_begins_dark_at_its_origin():
    pattern = checkerboard_pattern((10.0, 20.0), (5.0, 2.0))
    places = np.array([[11.0, 21.0], [16.0, 21.0], [16.0, 23.0], [9.0, 21.0]])
    assert pattern(places).tolist() == [60.0, 190.0, 60.0, 190.0]


def test_loading_needs_numpy_alone():
    code = ("import sys, termsel.simulate; "
            "assert not {'numba', 'scipy', 'deap', 'pymoo'} & set(sys.modules)")
    subprocess.run([sys.executable, "-c", code], check=True)


def test_many_points_are_as_far_apart_as_could_be(monkeypatch):
    """A tree of all but the latest points answers as the distances to each would."""
    def drawn():
        scenes._noise_free_features.cache_clear()
        return simulate_scene("ikonos-hamedan", roles=(90, 60, 50), n_lines=0).points.ground

    each = drawn()
    monkeypatch.setattr(scenes, "_LATEST", 7)
    np.testing.assert_array_equal(drawn(), each)
