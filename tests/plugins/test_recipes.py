"""Recipes of plugins: what they declare of their control."""

from __future__ import annotations

import pytest

import termsel
from termsel import Problem, ProblemData, Recipe, SelectionProblem, feature_options
from termsel.data.features import no_lines
from termsel.testing import check


def _features(inputs: ProblemData) -> Problem:
    return SelectionProblem(inputs, terms=False, features=True)


def _recipe(control: str) -> Recipe:
    return Recipe("both-demo", "Which points and lines to use.", _features, model="affine",
                  dataset="ikonos-hamedan", control=control, options=feature_options())


def test_points_and_lines_are_control_together() -> None:
    task = termsel.prepare(_recipe("both"))
    control = task.observations.control
    assert len(control.points) == len(task.observations.check) == 24
    assert len(control.lines) == 120
    assert task.problem.genome.labels == control.ids
    mixed = termsel.prepare("owdis-points", model="affine", options={"mixed": True})
    assert mixed.observations.control.ids == control.ids


def test_a_recipe_over_both_requires_lines_and_passes_the_suite() -> None:
    scene = termsel.simulate_scene("ikonos-hamedan")
    with pytest.raises(termsel.TermselError, match="needs control lines"):
        termsel.prepare(_recipe("both"), features=scene.with_(lines=no_lines()))
    check(_recipe("both"))


def test_a_control_that_there_is_not_is_refused() -> None:
    with pytest.raises(termsel.TermselError, match="has the control 'features'"):
        _recipe("features")
