"""Coordinates with too few decimals are named where they are why errors are large."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import termsel
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.results.first_screen import next_step_for_user

SAID = "as if rounded"


def map_of(ground: FloatArray, crs: str, pixel: float) -> FeatureSet:
    """Places on a map that is turned a little, `pixel` of ground each, measured to half a pixel."""
    rng = np.random.default_rng(3)
    x, y = (ground - ground.mean(axis=0)).T / pixel
    image = np.column_stack([900.0 - 0.99 * y - 0.1 * x, 900.0 + 0.99 * x - 0.1 * y])
    image += rng.normal(0, 0.5, image.shape)
    plan = np.column_stack([ground, np.full(len(ground), np.nan)])
    return FeatureSet(Points(tuple(f"P{i}" for i in range(len(ground))), image, plan), crs=crs)


def notes(features: FeatureSet) -> list[str]:
    """The notes of a run that are on rounding."""
    return [note for note in termsel.run(features=features).notes if SAID in note]


@pytest.mark.parametrize(("crs", "middle", "extent", "step"), [
    ("EPSG:4326", (8.0, 47.0), 0.2, 0.01), ("EPSG:32633", (430e3, 5.2e6), 9000.0, 100.0),
    ("local", (0.0, 0.0), 50.0, 1.0)])
def test_rounded_coordinates_are_named_with_their_step_and_what_it_does(
        crs: str, middle: tuple[float, float], extent: float, step: float) -> None:
    ground = np.random.default_rng(1).uniform(-1, 1, (30, 2)) * extent + middle
    exact = map_of(ground, crs, extent / 900.0)
    assert not notes(exact)
    points = exact.points
    rounded = points.ground.copy()
    rounded[:, :2] = step * np.round(rounded[:, :2] / step)
    note, = notes(exact.with_(points=replace(points, ground=rounded)))
    assert f"x and y are multiples of {step:g}" in note
    pixels = float(note.split("of some ")[1].split()[0])
    # Uniform errors of both coordinates; degrees of longitude are shorter.
    assert pixels == pytest.approx(step / (extent / 900.0) * np.sqrt(2 / 12), rel=0.35)


@pytest.mark.parametrize(("crs", "middle", "step"), [
    ("EPSG:4326", (8.0, 47.0), 0.1), ("EPSG:32633", (430e3, 5.2e6), 1000.0)])
def test_lines_of_a_graticule_are_round_and_no_fault(
        crs: str, middle: tuple[float, float], step: float) -> None:
    columns, rows = np.meshgrid(np.arange(6.0), np.arange(5.0))
    ground = np.column_stack([columns.ravel(), rows.ravel()]) * step + middle
    assert not notes(map_of(ground, crs, step / 300.0))


def test_lines_of_a_lattice_are_no_rounding_whatever_the_errors() -> None:
    """Steps of 8 thousandths are no chance: a wrong model is then not excused by few decimals."""
    columns, rows = np.meshgrid(np.arange(6.0), np.arange(5.0))
    ground = np.column_stack([columns.ravel(), rows.ravel()]) * 0.008 + (48.5, 34.8)
    features = map_of(ground, "EPSG:4326", 0.008 / 73.0)
    bent = features.points.image + np.sin(features.points.image[:, ::-1] / 40.0) * 4.0
    assert not notes(features.with_(points=replace(features.points, image=bent)))


def test_where_rounding_alone_ruins_a_map_decimals_come_next() -> None:
    ground = np.random.default_rng(1).uniform(-1, 1, (30, 2)) * 0.05 + (8.0, 47.0)
    points = map_of(ground, "EPSG:4326", 0.05 / 900.0).points
    coarse = points.ground.copy()
    coarse[:, 1] = np.round(coarse[:, 1], 2)
    result = termsel.run(features=FeatureSet(replace(points, ground=coarse), crs="EPSG:4326"))
    note, = [note for note in result.notes if SAID in note]
    # x has all its decimals: it is not to be corrected.
    assert note.startswith("y is a multiple of 0.01 degrees")
    assert "Take it from the source" in note
    assert "Next: take the coordinates with more decimals" in next_step_for_user(result.record)
