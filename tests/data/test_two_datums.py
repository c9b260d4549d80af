"""Points in two datums: named as such, and never where they are not."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

import termsel
from termsel.data.features import FeatureSet, Points
from termsel.runs.data_notes import datum_of, find_two_groups
from termsel.simulate import simulate_scene
from termsel.simulate.catalogue import SCENES

PLACE = (-112.0, 33.4)
METRE = np.array([1 / 93_000, 1 / 111_000])  # in degrees, about


def points(count: int = 30, *, noise: float = 0.5, relief: float = 0.0, height: bool = True,
           seed: int = 0) -> FeatureSet:
    """Points of an image with pixels of 3 m, turned by a few degrees, with some relief [m]."""
    rng = np.random.default_rng(seed)
    east, north = rng.uniform(-5000, 5000, (2, count))
    z = relief * rng.standard_normal(count)
    image = np.column_stack([-north + 0.1 * east, east + 0.1 * north + 0.4 * z]) / 3 + 2000
    image += rng.normal(0.0, noise, (count, 2))
    lonlat = PLACE + np.column_stack([east, north]) * METRE
    ground = np.column_stack([lonlat, z if height else np.full(count, np.nan)])
    return FeatureSet(Points(tuple(f"q{i}" for i in range(count)), image, ground), crs="EPSG:4326")


def moved(features: FeatureSet, metres: tuple[float, float], which: slice) -> FeatureSet:
    ground = features.points.ground.copy()
    ground[which, :2] += np.array(metres) * METRE
    return replace(features, points=replace(features.points, ground=ground))


@pytest.mark.parametrize("shift", [(63.0, -2.0), (-90.0, -200.0), (30.0, 30.0)])
@pytest.mark.parametrize("which", [slice(0, 5), slice(0, 15), slice(4, 30, 3)])
def test_a_constant_shift_of_some_points_is_found(shift: tuple[float, float],
                                                  which: slice) -> None:
    features = moved(points(), shift, which)
    found = find_two_groups(features)
    assert found is not None
    expected = features.points.ids[which]
    if len(expected) == 15:  # nothing tells which half is wrong
        assert set(expected) in (set(found.first), set(found.second))
        assert np.abs(found.shift) == pytest.approx(np.abs(shift), abs=3.0)
    else:
        assert set(found.second) == set(expected)
        assert found.shift == pytest.approx(shift, abs=3.0)


@pytest.mark.parametrize(("crs", "lon", "lat", "words"), [
    ("EPSG:3413", -45.0, 75.0, " lie 40 m east and 70 m south of the positions"),  # y is north
    ("EPSG:3413", 45.0, 75.0, " lie 40 m along +x and 70 m along -y from the positions"),
    ("EPSG:3031", 170.0, -80.0, " lie 40 m along +x and 70 m along -y from the positions"),
    ("EPSG:32633", 15.5, 48.0, " lie 40 m east and 70 m south of the positions"),
    ("EPSG:2193", 172.0, -41.0, " lie 40 m east and 70 m south of the positions"),
    ("EPSG:31287", 15.0, 47.5, " lie 40 m east and 70 m south of the positions")])
def test_directions_are_of_the_compass_only_where_the_axes_are(crs: str, lon: float, lat: float,
                                                               words: str) -> None:
    from pyproj import Transformer

    east, north = np.random.default_rng(4).uniform(-5000, 5000, (2, 30))
    middle = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(lon, lat)
    image = np.column_stack([-north, east]) / 3 + 2000
    ground = np.column_stack([middle[0] + east, middle[1] + north, np.full(30, np.nan)])
    ground[:8, :2] += (40.0, -70.0)
    features = FeatureSet(Points(tuple(f"q{i}" for i in range(30)), image, ground), crs=crs)
    found = find_two_groups(features)
    assert found is not None
    assert words in found.sentence()


@pytest.mark.parametrize("seed", range(20))
def test_errors_and_relief_are_no_two_groups(seed: int) -> None:
    for features in (points(seed=seed), points(seed=seed, noise=20.0), points(12, seed=seed),
                     points(seed=seed, relief=200.0),
                     points(seed=seed, relief=200.0, height=False),
                     moved(points(seed=seed), (400.0, 0.0), slice(0, 3))):
        assert find_two_groups(features) is None


def test_a_wide_area_around_a_pole_is_no_two_groups() -> None:
    """Degrees are no plane there: an affine transformation leaves kilometres."""
    from pyproj import Transformer

    generator = np.random.default_rng(1)
    image = np.column_stack([generator.uniform(20, 680, 12), generator.uniform(20, 880, 12)])
    x, y = -1.2e6 + (image[:, 1] - 450) * 900, 6e5 + (350 - image[:, 0]) * 900
    lon, lat = Transformer.from_crs(3031, 4326, always_xy=True).transform(x, y)
    ground = np.column_stack([lon, lat, np.full(12, np.nan)])
    features = FeatureSet(Points(tuple(f"q{i}" for i in range(12)), image, ground),
                          crs="EPSG:4326")
    assert find_two_groups(features) is None


@pytest.mark.parametrize("name", SCENES)
def test_scenes_are_no_two_groups(name: str) -> None:
    assert find_two_groups(simulate_scene(name)) is None


def test_two_levels_are_told_by_their_heights() -> None:
    features = points()
    ground, image = features.points.ground.copy(), features.points.image.copy()
    ground[::2, 2] += 500.0
    image[::2, 1] += 0.4 * 500.0 / 3
    levels = replace(features, points=replace(features.points, ground=ground, image=image))
    assert find_two_groups(levels) is None
    ground[:, 2] = np.nan
    blank = find_two_groups(replace(levels, points=replace(levels.points, ground=ground)))
    assert blank is not None
    assert "two levels whose heights are not known" in blank.sentence()


def test_points_on_one_line_have_no_two_groups() -> None:
    along = np.linspace(0.0, 5000.0, 20)
    zero = np.zeros(20)
    image = np.column_stack([along / 5, along / 5])
    image[::2, 0] += 40.0
    for ground in (np.column_stack([along, zero, zero]), np.column_stack([zero, along, zero])):
        on_line = Points(tuple(f"q{i}" for i in range(20)), image, ground)
        assert find_two_groups(FeatureSet(on_line, crs="EPSG:32633")) is None


def test_the_other_datum_is_named() -> None:
    pytest.importorskip("pyproj")
    features = moved(points(height=False), (63.0, -2.0), slice(0, 12))
    found = find_two_groups(features)
    assert found is not None
    assert datum_of(found, features.crs, PLACE) == "NAD27"
    far = find_two_groups(moved(points(height=False), (630.0, 900.0), slice(0, 12)))
    assert far is not None
    assert datum_of(far, features.crs, PLACE) == ""


def test_without_pyproj_no_datum_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyproj", None)
    found = find_two_groups(moved(points(height=False), (63.0, -2.0), slice(0, 12)))
    assert found is not None
    assert datum_of(found, "EPSG:4326", PLACE) == ""


def test_a_run_says_so_first() -> None:
    features = moved(points(24, height=False), (63.0, -2.0), slice(0, 24, 3))
    result = termsel.run(features=features)
    said = " ".join(result.summary().split())
    assert "Caution check the datum of the points: 8 of 24 points lie 6" in said
    assert any("Coordinates in NAD27 are as far off there." in note for note in result.notes)
