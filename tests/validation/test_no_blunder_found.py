"""Where no blunder is named, the answer says whether one could have been found."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.auto.blunders import find_blunders
from termsel.data.features import FeatureSet, Points
from termsel.data.fit_data import FitData


def photograph(count: int, wrong: int = 0, noise: float = 0.5, roles: tuple[str, ...] = (),
               ) -> FeatureSet:
    """Points of a view from above; the first `wrong` ones are 40 to 200 px off."""
    rng = np.random.default_rng(count + wrong)
    unit = rng.uniform(-1, 1, (count, 2))
    ground = np.column_stack([11.3 + 0.01 * unit[:, 0], 46.5 + 0.01 * unit[:, 1],
                              rng.uniform(300, 400, count)])
    image = np.column_stack([1500 - 1400 * unit[:, 1], 2000 + 1800 * unit[:, 0]])
    image += rng.normal(0, noise, (count, 2))
    angle, size = rng.uniform(0, 2 * np.pi, wrong), rng.uniform(40, 200, wrong)
    image[:wrong] += np.column_stack([np.cos(angle), np.sin(angle)]) * size[:, None]
    return FeatureSet(Points(tuple(f"P{i}" for i in range(count)), image, ground, None, roles),
                      crs="EPSG:4979")


def line_on_blunders(result: termsel.Result) -> str:
    text = " ".join(result.summary().split())
    return text.partition("Outliers ")[2].partition(" Compared ")[0].partition(" Caution ")[0]


@pytest.mark.parametrize(("count", "said"), [
    (3, "not detectable: 3 points are too few"), (5, "not detectable: 5 points are too few"),
    (6, "not detectable: 6 points are too few")])
def test_too_few_points_find_none(count: int, said: str) -> None:
    assert line_on_blunders(termsel.run(features=photograph(count))) == said


def test_the_error_that_would_not_be_seen_is_said_where_it_is_large() -> None:
    result = termsel.run(features=photograph(8))
    assert result.blunder_test is not None
    assert result.blunder_test.features == 8
    said = line_on_blunders(result)
    assert said.startswith("none found among 8 points; below ")
    assert said.endswith(" px most cannot be detected")


def test_many_points_find_none_plainly() -> None:
    result = termsel.run(features=photograph(30))
    assert line_on_blunders(result) == "none among 30 points"
    assert result.blunder_test is not None
    assert result.blunder_test.limit is not None
    assert result.blunder_test.limit < 10


@pytest.mark.slow_cases(
    "11-4-not detectable: no model fits these points; check the columns, the units and the CRS")
@pytest.mark.parametrize(("count", "wrong", "said"), [
    (8, 3, "not detectable: 8 points are too few; with errors this large check each of them"),
    (11, 4, "not detectable: no model fits these points; check the columns, the units and the "
            "CRS")])
def test_points_of_which_a_third_is_wrong_are_not_called_free_of_blunders(
        count: int, wrong: int, said: str) -> None:
    assert line_on_blunders(termsel.run(features=photograph(count, wrong))) == said


@pytest.mark.parametrize(("count", "noise"), [(30, 90.0), (14, 900.0)])
def test_points_that_agree_with_no_model_are_not_called_free_of_blunders(
        count: int, noise: float) -> None:
    # Not "too few" either: where all errors are large, only one beyond the image would stand out.
    said = line_on_blunders(termsel.run(features=photograph(count, noise=noise)))
    assert said.startswith("not detectable: no model fits these points")


def test_an_independent_point_far_from_what_is_predicted_is_not_passed_over() -> None:
    features = photograph(9, roles=(*["control"] * 8, "independent"))
    wrong = features.points.image.copy()
    wrong[8, 0] += 900.0
    points = Points(features.points.ids, wrong, features.points.ground, None, features.points.roles)
    said = line_on_blunders(termsel.run(features=features.with_(points=points)))
    assert "P8" in said or "the 1 independent check point contradicts the prediction" in said


def test_a_point_whose_error_could_be_any_is_not_given_a_size_beyond_the_image() -> None:
    notes = [note for count in (7, 8, 9) for note in termsel.run(features=photograph(count)).notes
             if "must exceed" in note]
    assert notes
    for note in notes:
        sizes = [float(word.replace(",", "")) for word, unit in zip(
            note.split(), note.split()[1:], strict=False) if unit == "px"]
        assert max(sizes) < 4000, note


def test_a_result_that_is_read_again_says_the_same(tmp_path: object) -> None:
    result = termsel.run(features=photograph(8), out=f"{tmp_path}/out")
    again = termsel.read_result(f"{tmp_path}/out")
    assert again.blunder_test == result.blunder_test
    assert line_on_blunders(again) == line_on_blunders(result)


def test_points_without_errors_fit_exactly() -> None:
    """Four computed corners: 2.4e-13 px is rounding, and no accuracy."""
    image = np.array([[1.0, 2.0], [1.0, 900.0], [800.0, 2.0], [800.0, 900.0]])
    ground = np.column_stack([500000.0 + image[:, 1], 5e6 - image[:, 0], np.full(4, np.nan)])
    corners = FeatureSet(Points(tuple("abcd"), image, ground), crs="EPSG:32633")
    first = " ".join(termsel.run(features=corners).summary().split())
    assert "Accuracy the points fit exactly; not verified: no independent check points" in first


@pytest.mark.slow
def test_the_limit_of_points_that_bend_is_one_of_errors_that_are_found(
        example_files: Path) -> None:
    # Relief looks like local deformation: a field predicts little without each point.
    points = termsel.read(example_files / "scene.points").points
    features = FeatureSet(points.take(np.arange(60) < 30), crs="EPSG:32639")
    suspects = find_blunders(FitData.of(features, False))
    assert suspects is not None
    assert not suspects.blunders.any()
    # Of the relief a polynomial leaves 1 px; the field alone would name errors from 60 px on.
    assert np.median(suspects.limits) < 10
