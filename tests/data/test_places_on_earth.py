"""Where on Earth features are, and which axes look swapped."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.data.coordinates.earth import place_of, say_turned
from termsel.data.features import FeatureSet, FloatArray, Lines, Points, empty_lines, empty_points
from termsel.formats.image_origin import require_inside

SEEN = np.random.default_rng(5).uniform(0, 5000, (12, 2))
NORTH_UP = np.array([[0.0, 1.0], [-1.0, 0.0]])
"""From line and sample to east and north."""


def scene(crs: str, origin: tuple[float, float], unit: float, turn: float = 0.0,
          axes: FloatArray = NORTH_UP, seen: FloatArray = SEEN) -> FeatureSet:
    """Return points of an image that is turned by some degrees against north."""
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    ground = (seen - 2500) @ (np.array([[c, -s], [s, c]]) @ axes).T * unit + origin
    return FeatureSet(Points([f"P{i}" for i in range(len(seen))], seen, np.column_stack(
        [ground, np.full(len(seen), np.nan)])), empty_lines(), crs)


def exchanged(features: FeatureSet, what: str) -> FeatureSet:
    points = features.points
    return features.with_(points=replace(points, ground=points.ground[:, [1, 0, 2]]) if what == "xy"
                          else replace(points, image=points.image[:, ::-1]))


def said(features: FeatureSet, caplog: pytest.LogCaptureFixture) -> str:
    caplog.clear()
    say_turned(features)
    return caplog.text


@pytest.mark.parametrize("turn", [0, 12, -35, 40])
def test_swapped_axes_of_an_image_seen_from_above_are_told(
        turn: float, caplog: pytest.LogCaptureFixture) -> None:
    image = scene("EPSG:4326", (11.0, 47.4), 1e-5, turn)
    assert said(image, caplog) == ""
    assert "Warning: x and y look swapped" in said(exchanged(image, "xy"), caplog)
    assert "If 11.0 N, 47.4 E is the place, line and sample are swapped" in caplog.text
    assert "Warning: line and sample look swapped" in said(exchanged(image, "image"), caplog)


@pytest.mark.parametrize("turn", [0, 40, 100])
@pytest.mark.parametrize("axes", [NORTH_UP, NORTH_UP * [[1.0], [-1.0]]], ids=["seen", "mirrored"])
def test_axes_are_told_alike_where_longitudes_jump(
        turn: float, axes: FloatArray, caplog: pytest.LogCaptureFixture) -> None:
    image = scene("EPSG:4326", (0.0, 30.0), 1e-4, turn, axes)
    ground = image.points.ground.copy()
    ground[:, 0] = (ground[:, 0] + 360.0) % 360.0 - 180.0
    jumping = image.with_(points=replace(image.points, ground=ground))
    assert ("look swapped" in said(jumping, caplog)) == ("look swapped" in said(image, caplog))


@pytest.mark.parametrize("turn", [80, 100, 260])
def test_axes_that_an_annotation_states_are_not_doubted(
        turn: float, caplog: pytest.LogCaptureFixture) -> None:
    """Near a pole a radar flies to the west or to the east, and looks to its right all the same."""
    image = scene("EPSG:4326", (-60.0, 85.0), 1e-5, turn, -NORTH_UP * [-1.0, 1.0])
    assert "look swapped" in said(image, caplog)
    names = np.array(["annotation.xml"] * len(image.points), dtype=object)
    stated = image.with_(points=replace(image.points, attributes={"sensor": names}))
    assert said(stated, caplog) == ""


@pytest.mark.parametrize("turn", [80, 100, 260])
@pytest.mark.parametrize(("latitude", "doubted"), [(85.0, False), (-76.0, False), (50.0, True)])
def test_axes_of_a_lattice_are_doubted_where_no_satellite_turns(
        turn: float, latitude: float, doubted: bool, caplog: pytest.LogCaptureFixture) -> None:
    """The image of a radar product alone, without its annotation, has a lattice of places."""
    lattice = np.array(list(product(range(0, 5000, 1000), range(0, 6000, 1000))), dtype=float)
    image = scene("EPSG:4326", (-60.0, latitude), 1e-5, turn, -NORTH_UP * [-1.0, 1.0], lattice)
    assert ("look swapped" in said(image, caplog)) == doubted


@pytest.mark.parametrize("turn", [0, 12, -35, 180, 192])
def test_a_map_that_counts_to_the_north_and_a_radar_image_are_not_swapped(
        turn: float, caplog: pytest.LogCaptureFixture) -> None:
    image = scene("EPSG:2100", (268900, 4488300), 0.5, turn, np.array([[0.0, 1.0], [1.0, 0.0]]))
    assert "Note: " + ("line numbers grow to the north" if turn < 90
                       else "sample numbers grow to the west") in said(image, caplog)
    # What is to be done stands in the first sentence, which a screen shows.
    first = said(image, caplog).partition(". ")[0]
    assert "a map would be mirrored" in first
    assert ("--set image_origin=bottom-left --image FILE" in first) == (turn < 90)
    # Swapped, it is turned and no mirror image; the area of the CRS tells.
    assert "x and y look swapped: exchanged, they lie in the area of EPSG:2100" in said(
        exchanged(image, "xy"), caplog)


def test_lines_alone_tell(caplog: pytest.LogCaptureFixture) -> None:
    points = scene("EPSG:32632", (690000, 5335000), 0.5).points
    # The ends on the ground are not those in the image.
    ends = [points.ground[::2] * 0.7 + points.ground[1::2] * 0.3, points.ground[1::2]]
    image = np.stack([points.image[::2], points.image[1::2]], axis=1)
    ground = np.stack(ends, axis=1)
    for shown, word in ((image, ""), (image[..., ::-1], "line and sample look swapped")):
        lines = Lines(tuple("ABCDEF"), shown, ground)
        text = said(FeatureSet(empty_points(), lines, "EPSG:32632"), caplog)
        assert word in text
        assert bool(text) == bool(word)


@pytest.mark.parametrize(("crs", "place"), [
    ("EPSG:4326", (11.0, 47.4)), ("EPSG:25832", (690000, 5335000)), ("local", (100, 100))])
def test_few_points_and_points_on_one_line_are_not_doubted(
        crs: str, place: tuple[float, float], caplog: pytest.LogCaptureFixture) -> None:
    image = exchanged(scene(crs, place, 1e-5), "image")
    assert said(image.take(np.arange(12) < 2), caplog) == ""
    flat = replace(image.points, image=np.column_stack([SEEN[:, 0], SEEN[:, 0]]))
    assert said(image.with_(points=flat), caplog) == ""


@pytest.mark.parametrize(("crs", "place", "pixel"), [
    ("EPSG:4326", (11.0, 47.4), 1e-5), ("EPSG:25832", (690000, 5335000), 2.0),
    ("local", (100, 100), 0.3), ("local", (-4e5, 7e6), 25.0)])
def test_three_points_show_a_mirror_image(crs: str, place: tuple[float, float], pixel: float,
                                          caplog: pytest.LogCaptureFixture) -> None:
    seen = scene(crs, place, pixel)
    for rows in (np.arange(12) < 3, np.arange(12) % 5 == 1):
        assert said(seen.take(rows), caplog) == ""
        for pair in ("image", "xy"):
            text = said(exchanged(seen.take(rows), pair), caplog)
            assert "exchanges them" in text


@pytest.mark.parametrize(("crs", "place", "text"), [
    ("EPSG:4326", (-56.1, -34.9), "34.9 S, 56.1 W"), ("EPSG:4979", (190.0, 0.0), "0.0 N, 170.0 W"),
    ("EPSG:32632", (500000, 5200000), "47.0 N, 9.0 E"),
    ("EPSG:4547", (500000, 3400000), "30.7 N, 114.0 E"), ("local", (5.0, 5.0), "")])
def test_the_place_is_named(crs: str, place: tuple[float, float], text: str) -> None:
    assert place_of(scene(crs, place, 1e-6)) == text
    assert place_of(termsel.FeatureSet(empty_points(), empty_lines(), crs)) == ""


@pytest.mark.parametrize(("upright", "reason"), [
    (True, "the points fit an image of 5001 lines and 4001 samples"),
    (False, "line and sample look swapped: they extend")])
def test_an_image_that_a_viewer_has_turned_is_told_from_swapped_axes(
        upright: bool, reason: str) -> None:
    """A turned image shows the ground as it is, swapped axes its mirror image."""
    features = scene("EPSG:32632", (690000, 5335000), 0.5)
    image = features.points.image * [1.0, 0.7] if upright else \
        (features.points.image * [0.7, 1.0])[:, ::-1]
    features = features.with_(points=replace(features.points, image=image))
    with pytest.raises(TermselError, match=reason) as refused:
        require_inside(features, (4001, 5001), "photo.jpg")
    assert ("turned by 90 degrees" in str(refused.value.hint)) == upright
