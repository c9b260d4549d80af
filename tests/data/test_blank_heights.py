"""Heights point by point: one that is blank takes nothing from the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet

SCENE = termsel.simulate_scene("ikonos-hamedan")
NOTE = "1 point without a height takes no part, as the model uses heights: "


def blanked(ids: list[str], features: FeatureSet = SCENE) -> FeatureSet:
    ground = features.points.ground.copy()
    ground[np.isin(features.points.ids, ids), 2] = np.nan
    return features.with_(points=replace(features.points, ground=ground))


def of_points(features: FeatureSet) -> FeatureSet:
    return features.with_(lines=features.lines.take([]))


def without(ids: list[str], features: FeatureSet = SCENE) -> FeatureSet:
    return features.take(~np.isin(features.ids, ids))


def first(role: str) -> str:
    points = SCENE.points
    return next(name for name, one in zip(points.ids, points.roles, strict=True) if one == role)


@pytest.mark.slow
@pytest.mark.parametrize("role", ["control", "check", "independent"])
def test_auto_gives_the_result_of_the_other_points(role: str) -> None:
    name = first(role)
    found = termsel.run(features=of_points(blanked([name])))
    expected = termsel.run(features=of_points(without([name])))
    assert found.rmse == expected.rmse
    assert found.predicted == expected.predicted
    assert [note for note in found.notes if note.startswith(NOTE + f"{name}.")]
    assert not [note for note in expected.notes if "without a height" in note]


def test_a_search_leaves_the_point_out_and_names_it() -> None:
    name = first("control")
    found = termsel.run("rfm-terms", features=of_points(blanked([name])), evaluations=40,
                        strategy="as-asked")
    assert name not in found.fit.control.ids
    assert found.notes[0].startswith(NOTE + name)


def test_a_plane_model_takes_all_points() -> None:
    name = first("control")
    features = of_points(blanked([name]))
    assert name in termsel.run("poly-terms", features=features, evaluations=40,
                               strategy="as-asked").fit.control.ids
    assert name in termsel.fit(features, "poly2d", degree=1).control.ids


@pytest.mark.slow
def test_where_most_heights_are_blank_the_model_is_plane() -> None:
    known = SCENE.points.ids[::3]
    features = of_points(blanked([name for name in SCENE.points.ids if name not in known]))
    found = termsel.run(features=features)
    assert not found.fit.model.uses_height
    assert not [note for note in found.notes if "without a height" in note]
    with pytest.raises(TermselError, match=r"needs heights; they are unknown for.*--dem FILE"):
        termsel.fit(features, "poly3d", degree=1)


@pytest.mark.slow
def test_heights_of_one_plane_leave_no_point_out() -> None:
    points = SCENE.points
    ground = points.ground.copy()
    ground[:, 2] = 100.0
    level = of_points(SCENE.with_(points=replace(points, ground=ground)))
    found = termsel.run(features=blanked([first("control")], level))
    assert first("control") in found.fit.control.ids


def test_fit_leaves_the_point_out_and_says_so(caplog: pytest.LogCaptureFixture) -> None:
    name = first("control")
    for model in ("affine", "quadratic", "dlt3d"):
        caplog.clear()
        fitted = termsel.fit(of_points(blanked([name])), model)
        assert name not in fitted.control.ids
        assert NOTE + name in caplog.text


@pytest.mark.slow
def test_a_line_without_a_height_is_left_out() -> None:
    lines = SCENE.lines
    ground = lines.ground.copy()
    ground[0, 0, 2] = np.nan
    features = SCENE.with_(lines=replace(lines, ground=ground))
    found = termsel.run("owdis-lines", features=features, evaluations=40, strategy="as-asked")
    assert lines.ids[0] not in found.fit.control.ids
    assert "as the model uses heights: " + lines.ids[0] in found.notes[0]
