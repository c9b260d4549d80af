"""Features selected by OWDIS, taken by auto only where they help."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from termsel.auto.auto import Auto
from termsel.auto.rule import Choice
from termsel.data.features import FeatureSet
from termsel.data.fit_data import FitData
from termsel.fitting.fit import HeldOut
from termsel.runs import owdis
from termsel.simulate import simulate_scene


@pytest.fixture(scope="module")
def few_lines() -> tuple[FeatureSet, Choice]:
    scene = simulate_scene("ikonos-hamedan", n_points=24, n_lines=24, wrong_lines=0)
    control = scene.with_(points=replace(scene.points, roles=()))
    choice = Auto().choose_features(FitData.of(control, True))
    assert choice is not None
    return control, choice


@pytest.mark.slow
def test_owdis_is_searched_once_where_it_does_not_help(
        few_lines: tuple[FeatureSet, Choice], monkeypatch: pytest.MonkeyPatch) -> None:
    control, choice = few_lines
    monkeypatch.setattr(owdis, "_held_out_errors", None)
    found, errors = owdis.with_selected_lines(FitData.of(control, True), choice, Auto(), 1)
    assert (found.chosen, errors) == (choice.chosen, None)
    assert found.reason.startswith(choice.reason)
    assert re.search(r"OWDIS selects \d+ of 24 lines\. .*must be better by more than 3\.$",
                     found.reason)


def test_where_owdis_is_taken_all_structures_are_shown(
        few_lines: tuple[FeatureSet, Choice], monkeypatch: pytest.MonkeyPatch) -> None:
    control, choice = few_lines
    worse = replace(choice, chosen=replace(choice.chosen, stored_held_out=HeldOut(
        1e3 * choice.chosen.held_out().squares)))
    some = FitData.of(control.take(np.arange(len(control)) < 40), True)
    monkeypatch.setattr(owdis, "_select_features", lambda *given: some)
    monkeypatch.setattr(owdis, "_held_out_errors", lambda *given: np.full((24, 2), 1e-3))
    found, _ = owdis.with_selected_lines(FitData.of(control, True), worse, Auto(), 1)
    assert len(found.chosen.control.lines) == 16
    names = [[fitted.method.name for fitted in each.compared] for each in (found, choice)]
    assert names[0] == names[1]


@pytest.mark.slow
def test_owdis_is_taken_for_errors_of_points_that_it_did_not_select_by(
        few_lines: tuple[FeatureSet, Choice], monkeypatch: pytest.MonkeyPatch) -> None:
    control, choice = few_lines
    worse = replace(choice, chosen=replace(choice.chosen, stored_held_out=HeldOut(
        1e3 * choice.chosen.held_out().squares)))
    monkeypatch.setattr(owdis, "FOLDS_WITH_LINES", 2)
    found, errors = owdis.with_selected_lines(FitData.of(control, True), worse, Auto(), 1)
    assert found.reason.endswith("so these lines are used.")
    assert len(found.chosen.control.points) == 24
    assert 0 < len(found.chosen.control.lines) < 24
    image = control.points.image.copy()
    image[0] += 3.0, -4.0
    moved = control.with_(points=replace(control.points, image=image))
    _, again = owdis.with_selected_lines(FitData.of(moved, True), worse, Auto(), 1)
    assert errors is not None
    assert again is not None
    np.testing.assert_allclose(again[0] - errors[0], (3.0, -4.0), atol=1e-9)
