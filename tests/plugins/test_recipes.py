"""Recipes of plugins: what they declare of their control."""

from __future__ import annotations

from pathlib import Path

import pytest

import termsel
from termsel import Problem, ProblemData, Recipe, SelectionProblem, feature_options
from termsel.cli import describe
from termsel.data.features import empty_lines
from termsel.formats.readers.csv_tables import write_points_csv
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
        termsel.prepare(_recipe("both"), features=scene.with_(lines=empty_lines()))
    check(_recipe("both"))


def test_a_control_that_there_is_not_is_refused() -> None:
    with pytest.raises(termsel.TermselError, match="has the control 'features'"):
        _recipe("features")


def shared_mask(inputs: ProblemData) -> Problem:
    return SelectionProblem(inputs, terms=True, features=False, mask="shared")


# As docs/reference/plugins.md shows it.
UNDECLARED = Recipe("shared-demo", "Terms of a 3-D polynomial, one mask for both axes.",
                    shared_mask, model="poly3d", dataset="irs1c-mashad")


def test_a_selection_problem_has_its_options_in_any_recipe() -> None:
    task = termsel.prepare(UNDECLARED, options={"objectives": "log_condition", "force_on": "num:1"})
    assert task.problem.objectives == ("check-rmse", "log_condition")
    assert task.problem.genome.on.any()
    by_name = termsel.prepare(UNDECLARED, solver="nsga2")
    assert by_name.problem.objectives == ("check-rmse", "n_terms")


def test_options_of_other_problems_are_refused() -> None:
    for name in ("max_features", "steps", "mask"):
        with pytest.raises(termsel.TermselError, match=f"unknown option {name!r}"):
            termsel.prepare(UNDECLARED, options={name: "terms-first" if name == "steps" else 5})


def test_what_a_recipe_does_not_declare_is_described() -> None:
    names = [option.name for option in describe._options_of_prepared_problem(UNDECLARED)]
    assert {"objectives", "max_share", "force_on"} <= set(names)
    assert "max_features" not in names
    assert describe._options_of_prepared_problem(_recipe("both")) == []


@pytest.mark.parametrize("name", ["rfm-terms", "owdis-points", "yavari-2018"])
def test_several_objectives_need_no_solver(name: str) -> None:
    task = termsel.prepare(name, options={"objectives": "n_terms"})
    assert task.solver.name == "nsga2"
    assert task.problem.objectives == ("check-rmse", "n_terms")


def test_prepare_reads_files(tmp_path: Path) -> None:
    points = termsel.simulate_scene("ikonos-hamedan").points
    file = tmp_path / "points.csv"
    write_points_csv(points, file)
    task = termsel.prepare("poly-terms", features=file, crs="EPSG:4979")
    assert task.source == str(file)
    assert len(task.features.points) == len(points)
    with pytest.raises(termsel.TermselError, match="for features that are given"):
        termsel.prepare("poly-terms", crs="EPSG:4979")
