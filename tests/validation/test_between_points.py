"""Points in clusters and pairs: the RMSE holds near them, and the caution says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import termsel
from termsel.auto.rule import fold_of_each, folds_of
from termsel.data.coordinates.clusters import cluster_labels
from termsel.data.coordinates.places import ground_centres, spatial_order
from termsel.data.features import FeatureSet, Points
from termsel.data.record.cautions import limits_of_accuracy
from termsel.io.accuracy_tags import accuracy_tags
from termsel.runs.between_points import is_even, places_within_hull
from termsel.studies.cells.verdicts import DOUBTFUL, Accept, verdicts_of
from tests.studies.test_verdicts import row


def deformed_scan(plan: np.ndarray, noise: float, seed: int) -> FeatureSet:
    """Return points of a scan [px] that is bent by 4 px over some 800 px, at plan (n, 2)."""
    rng = np.random.default_rng(seed)
    x, y = plan.T
    image = np.column_stack([y + 4.0 * np.sin(x / 120.0) * np.cos(y / 150.0),
                             x + 4.0 * np.cos(x / 140.0 + y / 180.0)])
    ids = tuple(f"P{i}" for i in range(len(plan)))
    ground = np.column_stack([plan, np.full(len(plan), np.nan)])
    return FeatureSet(Points(ids, image + rng.normal(0.0, noise, image.shape), ground), crs="local")


def clustered(seed: int, clusters: int = 6, each: int = 5) -> np.ndarray:
    """Return plan positions [px] in clusters of some 10 px, (clusters * each, 2)."""
    rng = np.random.default_rng(seed)
    # One in each cell of a 3 x 2 pattern, so that none meets another by chance.
    columns = 3
    cells = np.array([(i % columns, i // columns) for i in range(clusters)], dtype=float)
    centres = (cells + rng.uniform(0.3, 0.7, cells.shape)) * 300.0
    return np.repeat(centres, each, axis=0) + rng.normal(0.0, 10.0, (clusters * each, 2))


@pytest.fixture(scope="module")
def clusters() -> termsel.Result:
    return termsel.run(features=deformed_scan(clustered(11), 0.2, 11))


def test_clusters_are_cautioned_of_with_the_figure(clusters: termsel.Result) -> None:
    [note] = [note for note in clusters.notes if note.startswith("Between ")]
    assert note.startswith("Between the 6 clusters of points the map may be off by ")


def test_the_caution_reaches_the_tags_of_a_map(clusters: termsel.Result) -> None:
    assert "6 clusters" in accuracy_tags(clusters)["ACCURACY_CAUTION"]


def test_evenly_spread_points_have_no_such_caution() -> None:
    plan = np.random.default_rng(3).uniform(0.0, 900.0, (30, 2))
    result = termsel.run(features=deformed_scan(plan, 0.2, 3))
    assert not any(note.startswith("Between ") for note in result.notes)


def test_points_in_threes_are_cautioned_of() -> None:
    rng = np.random.default_rng(3)
    centres = rng.uniform(0.0, 900.0, (8, 2))
    plan = np.repeat(centres, 3, axis=0) + rng.normal(0.0, 4.0, (24, 2))
    result = termsel.run(features=deformed_scan(plan, 0.2, 3))
    assert any(note.startswith("Between ") for note in result.notes)


def evenness(plan: np.ndarray) -> bool:
    """Return whether held-out errors at plan positions (n, 2) are taken for those between them."""
    ground = np.column_stack([plan * [1.0, 40.0], np.zeros(len(plan))])
    return is_even(ground, places_within_hull(ground))


@pytest.mark.parametrize("count", [20, 40, 100, 1500])
@pytest.mark.parametrize("seed", range(5))
def test_points_at_random_or_in_a_grid_are_even(count: int, seed: int) -> None:
    rng = np.random.default_rng([seed, count])
    side = int(np.ceil(count**0.5))
    grid = np.stack(np.divmod(np.arange(side**2), side), axis=1).astype(float)
    for plan in (rng.uniform(0.0, 9.0, (count, 2)), grid,
                 grid + rng.uniform(-0.4, 0.4, grid.shape)):
        assert evenness(plan)


@pytest.mark.parametrize("count", [20, 40, 100, 1500])
@pytest.mark.parametrize("seed", range(5))
def test_points_that_leave_gaps_are_not_even(count: int, seed: int) -> None:
    rng = np.random.default_rng([seed, count])
    numbers = np.arange(count)
    noise = rng.normal(0.0, 1.0, (count, 2))
    corners = np.array([(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)])
    along = rng.uniform(0.0, 1.0, count)
    for plan in (rng.uniform(0.0, 1.0, (count, 2))[numbers // 2] + 0.05 * noise / count**0.5,
                 corners[numbers % 4] + 0.04 * noise,
                 rng.uniform(0.0, 1.0, (5, 2))[numbers % 5] + 0.02 * noise,
                 np.column_stack([along, np.abs(along - 0.5)]) + 0.005 * noise):
        assert not evenness(plan)


def checked(where: str, seed: int, count: int) -> termsel.Result:
    """Return a run with 30 control points and so many independent ones: "beside" control, or
    "anywhere"."""
    rng = np.random.default_rng(seed)
    control = rng.uniform(0.0, 900.0, (30, 2))
    check = control[:count] + rng.uniform(2.0, 6.0, (count, 2)) if where == "beside" \
        else rng.uniform(100.0, 800.0, (count, 2))
    features = deformed_scan(np.concatenate([control, check]), 0.2, seed)
    roles = ("control",) * 30 + ("independent",) * count
    return termsel.run(features=features.with_(points=replace(features.points, roles=roles)))


@pytest.mark.parametrize(("seed", "count"), [(1, 3), (2, 8), (3, 20)])
def test_check_points_beside_control_are_cautioned_of(seed: int, count: int) -> None:
    result = checked("beside", seed, count)
    [note] = [note for note in result.notes if " close beside control points" in note]
    assert note.startswith(f"{count} of {count} independent check points lie ")
    assert note in limits_of_accuracy(result.notes)
    assert "close beside control" in accuracy_tags(result)["ACCURACY_CAUTION"]


@pytest.mark.slow_cases("4-3", "5-3", "6-5")
@pytest.mark.parametrize(("seed", "count"), [(1, 3), (2, 8), (3, 20), (4, 3), (5, 3), (6, 5)])
def test_check_points_anywhere_have_no_such_caution(seed: int, count: int) -> None:
    assert not any("beside" in note for note in checked("anywhere", seed, count).notes)


def test_check_points_in_clusters_of_control_are_cautioned_of() -> None:
    features = deformed_scan(clustered(5), 0.2, 5)
    roles = tuple("independent" if i % 5 == 0 else "control" for i in range(30))
    result = termsel.run(features=features.with_(points=replace(features.points, roles=roles)))
    assert any(note.startswith("6 of 6 independent check points lie close beside control points: ")
               for note in result.notes)


@pytest.mark.parametrize("note", [
    "Between the 6 clusters of points the map may be off by 2.1 px: the RMSE holds near them only.",
    "All points lie close to one straight line in the image. Nothing shows what is away from it.",
    "Extrapolation: 3 of 4 corners of the image lie far outside the control in use. The RMSE does "
    "not apply there."])
def test_what_the_accuracy_does_not_vouch_for_makes_an_image_doubtful(note: str) -> None:
    assert limits_of_accuracy([note]) == [note]
    for accept in (None, Accept.of("2px")):
        [(verdict, why)] = verdicts_of([row(notes=[note])], accept)
        assert verdict == DOUBTFUL
        first = note.partition(". ")[0].removesuffix(".")
        assert first[1:] in why


@pytest.mark.parametrize("seed", range(5))
def test_clusters_are_told_by_the_gap_between_them(seed: int) -> None:
    labels = cluster_labels(clustered(seed), 2.0)
    assert labels is not None
    assert labels.reshape(6, 5).tolist() == [[label] * 5 for label in labels[::5]]
    assert sorted(labels[::5]) == list(range(6))


@pytest.mark.parametrize("seed", range(5))
def test_places_at_random_are_no_clusters(seed: int) -> None:
    plan = np.random.default_rng(seed).uniform(0.0, 900.0, (25, 2))
    assert cluster_labels(plan, 2.0) is None


def test_rows_of_a_lattice_are_no_clusters() -> None:
    rows, columns = np.divmod(np.arange(96), 8)
    assert cluster_labels(np.column_stack([columns, 4.0 * rows]), 2.0) is None


def test_places_that_were_measured_twice_are_held_out_together() -> None:
    places = np.random.default_rng(1).uniform(0.0, 900.0, (14, 2))
    features = deformed_scan(np.concatenate([places, places + 1.5]), 0.2, 1)
    folds = folds_of(features)
    fold = fold_of_each(features, folds)
    assert folds == 14
    assert fold[:14].tolist() == fold[14:].tolist()
    assert sorted(fold[:14].tolist()) == list(range(14))


def test_folds_of_places_without_clusters_are_along_a_curve() -> None:
    features = deformed_scan(np.random.default_rng(2).uniform(0.0, 900.0, (45, 2)), 0.2, 1)
    order = spatial_order(ground_centres(features))
    fold = fold_of_each(features, 10)
    for i in range(10):
        assert sorted(order[i::10].tolist()) == np.flatnonzero(fold == i).tolist()


def test_places_lie_within_the_hull_at_the_height_of_the_nearest_point() -> None:
    ground = np.array([[0.0, 0.0, 1.0], [10.0, 0.0, 2.0], [0.0, 10.0, 3.0]])
    places = places_within_hull(ground)
    assert (places[:, 0] + places[:, 1] <= 10.0 + 1e-9).all()
    assert set(places[:, 2]) == {1.0, 2.0, 3.0}
    assert not len(places_within_hull(ground * [1.0, 0.0, 1.0]))
