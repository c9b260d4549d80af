"""Points on lines and columns of an image: what was computed is held out by whole lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import termsel
from termsel import FeatureSet, Points
from termsel.data.coordinates.places import lattice_of

LINES, COLUMNS = 9, 11


def lattice(noise: float = 0.0, jump: float = 0.0, seed: int = 0) -> FeatureSet:
    """Return a lattice of a side-looking view over relief, and what a line may jump [px]."""
    rng = np.random.default_rng(seed)
    line, sample = (part.ravel().astype(np.float64) for part in np.meshgrid(
        np.linspace(0, 8000, LINES).round(), np.linspace(0, 10000, COLUMNS).round(),
        indexing="ij"))
    height = rng.uniform(0.0, 2000.0, line.size)
    jumps = rng.normal(0.0, 1.0, LINES)[np.repeat(np.arange(LINES), COLUMNS)]
    # A height moves a place towards the radar, less so far from it.
    seen = sample + jump * jumps + height / (10.0 + sample / 2000.0) + 3e-6 * sample**2
    x = 300000.0 + 10.0 * seen + 0.5 * line
    y = 5e6 - 10.0 * line - 1.5 * sample + 2e-5 * line**2
    ground = np.column_stack([x, y, height])
    ground[:, :2] += rng.normal(0.0, 10.0 * noise, (len(x), 2))
    names = tuple(f"L{a:g}S{b:g}" for a, b in zip(line, sample, strict=True))
    return FeatureSet(Points(names, np.column_stack([line, sample]), ground), crs="EPSG:32633",
                      image_size=(8001, 10001))


def test_a_lattice_is_told_and_no_point_of_it_is_called_a_blunder() -> None:
    result = termsel.run(features=lattice())
    assert result.outliers == ()
    text = " ".join(result.summary().split())
    assert "a lattice of 9 lines and 11 columns" in text
    assert "the points were computed" in text
    assert any("annotation of a radar image" in note for note in result.notes)
    assert "blunders were looked for" not in text
    # All are control; lines and columns are held out in turn.
    assert len(result.fit.control) == LINES * COLUMNS


def test_a_lattice_in_numbers_of_32_bits_is_one() -> None:
    """Products store longitudes and latitudes so: their rounding is no noise of measurements."""
    line, sample = map(np.ravel, np.meshgrid(np.arange(0, 420, 13), np.arange(0, 420, 13),
                                             indexing="ij"))
    degrees = np.column_stack([14.2 + 1.3e-5 * sample + 1e-6 * line,
                               47.2 - 9e-6 * line + 1e-9 * sample**2])
    ground = np.column_stack([degrees, np.full(len(line), 500.0)])
    points = Points(tuple(map(str, range(len(line)))), np.column_stack([line, sample]) * 1.0,
                    ground.astype(np.float32).astype(np.float64))
    features = FeatureSet(points, crs="EPSG:4979")
    assert lattice_of(features) is not None
    rng = np.random.default_rng(0)
    measured = ground + rng.normal(0.0, 1.3e-6, ground.shape)
    assert lattice_of(features.with_(points=replace(points, ground=measured))) is None


@pytest.mark.parametrize("middle", [14.0, 179.9, -180.0])
def test_a_lattice_is_told_wherever_its_longitudes_are(middle: float) -> None:
    """At 180 degrees they jump by a full turn."""
    features = lattice()
    x, y, height = features.points.ground.T
    longitude = middle + (x - x.mean()) / 75000.0
    ground = np.column_stack([(longitude + 180.0) % 360.0 - 180.0, 47.0 + (y - 5e6) / 111000.0,
                              height])
    result = termsel.run(features=FeatureSet(replace(features.points, ground=ground),
                                             crs="EPSG:4979", image_size=(8001, 10001)))
    text = " ".join(result.summary().split())
    assert "a lattice of 9 lines and 11 columns" in text
    assert "the points were computed" in text
    assert "no independent check points" in text
    assert len(result.fit.control) == LINES * COLUMNS


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_interval_holds_the_error_between_lines_that_jump(seed: int) -> None:
    """Neighbours on a line tell each other's jump, so that points at random promise too much."""
    features = lattice(jump=2.0, seed=seed)
    result = termsel.run(features=features)
    finer = lattice(jump=0.0, seed=seed + 100)
    # Between the lines nothing is known of jumps of 2 px.
    error = result.fit.project(finer.points.ground) - finer.points.image
    true = float(np.sqrt((error**2).sum(axis=1).mean()))
    assert result.predicted is not None
    assert result.predicted.low <= true <= result.predicted.high


def test_measured_points_at_regular_places_are_no_lattice() -> None:
    """Matching takes regular places of an image, and has errors, and blunders."""
    features = lattice(noise=0.3)
    moved = features.points.ground.copy()
    moved[40, 0] += 300.0
    features = features.with_(points=replace(features.points, ground=moved))
    result = termsel.run(features=features)
    assert "lattice" not in result.summary()
    assert [one.id for one in result.outliers] == [features.points.ids[40]]


@pytest.mark.parametrize("change", [
    lambda points: replace(points, sigma=np.full((len(points), 2), 0.3)),
    lambda points: points.take(np.arange(len(points)) % 3 == 0),
    lambda points: replace(points, image=points.image + np.random.default_rng(0).uniform(
        -50, 50, points.image.shape))], ids=["stated errors", "a third of it", "scattered"])
def test_what_is_no_lattice(change: object) -> None:
    features = lattice(noise=0.2)
    result = termsel.run(features=features.with_(points=change(features.points)))  # type: ignore[operator]
    assert "lattice of" not in result.summary()


def test_holes_do_not_hide_a_lattice() -> None:
    """As over the sea, where a product has no points."""
    features = lattice()
    kept = np.ones(len(features), dtype=bool)
    kept[np.random.default_rng(4).choice(len(features), 12, replace=False)] = False
    assert "a lattice of 9 lines" in " ".join(
        termsel.run(features=features.take(kept)).summary().split())


def test_roles_of_a_search_follow_whole_lines() -> None:
    result = termsel.run("poly-terms", features=lattice(), model="poly3d", solver="all-terms")
    points = result.features.points
    for line in np.unique(points.image[:, 0]):
        assert len({role for role, at in zip(points.roles, points.image[:, 0], strict=True)
                    if at == line}) == 1


def test_points_that_copy_each_other_have_no_accuracy() -> None:
    """A table whose lines are a copy of its y."""
    rng = np.random.default_rng(0)
    ground = rng.uniform(0.0, [5000.0, 5000.0, 90.0], (80, 3)) + np.array([500000.0, 5e6, 0.0])
    features = FeatureSet(Points(tuple(f"P{i}" for i in range(80)), ground[:, [1, 0]], ground),
                          crs="EPSG:32633")
    text = " ".join(termsel.run(features=features).summary().split())
    assert "one column is a copy of another: the accuracy cannot be estimated" in text
    assert "on the ground (RMSE of" not in text


def test_axes_of_a_lattice_are_not_doubted(caplog: pytest.LogCaptureFixture,
                                           tmp_path: object) -> None:
    """A radar that looks to the west has samples that grow to the west."""
    features = lattice()
    mirrored = features.points.ground * [-1.0, 1.0, 1.0] + [900000.0, 0.0, 0.0]
    result = termsel.run(features=features.with_(
        points=replace(features.points, ground=mirrored)))
    assert "grow to the west" not in result.summary()
