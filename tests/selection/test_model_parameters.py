"""Problems that find values of a model's options."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

import termsel
from termsel import FeatureSet, Option, Recipe, Selection, SelectionProblem, TermselError
from termsel.selection.problems.parameters import ParameterProblem, segment_of


@pytest.mark.slow
def test_the_degrees_found_are_those_of_an_exhaustive_search() -> None:
    scene = termsel.simulate_scene("ikonos-hamedan")
    flat = FeatureSet(scene.points, crs=scene.crs)
    task = termsel.prepare("poly-degree", features=flat, model="poly2d-by-axis",
                           options={"degree": 3})
    everything = np.array(list(product(range(6), repeat=4)))
    found = task.problem.evaluate(everything)
    best = int(found.order()[0])
    result = termsel.run(task, evaluations=4000)
    assert result.objectives["check-rmse"] == pytest.approx(found.objectives[best, 0])
    degrees = result.selection.parameters
    assert list(degrees) == ["line_x", "line_y", "sample_x", "sample_y"]
    # By hand: the model with these options, fitted to the control.
    control = [role == "control" for role in flat.points.roles]
    fitted = termsel.fit(FeatureSet(flat.points.take(control), crs=flat.crs), "poly2d-by-axis",
                         degree=3, **degrees)
    check = flat.points.take([role == "check" for role in flat.points.roles])
    assert fitted.rmse(check).total == pytest.approx(result.objectives["check-rmse"], rel=1e-6)
    assert result.selection.terms == fitted.model.terms


@pytest.mark.parametrize(("option", "said"), [
    (Option("text", "a", "Any text."), "has no bounds to search within"),
    (Option("count", 1, "A number.", int, 1), "has no bounds"),
])
def test_options_without_bounds_cannot_be_searched(option: Option, said: str) -> None:
    with pytest.raises(TermselError, match=said):
        segment_of(option)


def test_parameters_that_change_the_terms_cannot_be_searched_with_them() -> None:
    task = termsel.prepare("poly-terms", options={"degree": 2})
    problem = ParameterProblem(task.problem.inputs, ["degree"], terms=True)  # type: ignore[attr-defined]
    genes = problem.genome.random(np.random.default_rng(1), 5)
    with pytest.raises(TermselError, match="has other terms"):
        problem.evaluate(genes)


def test_a_problem_that_replaces_an_option_says_so() -> None:
    class Lower(SelectionProblem):
        """Takes a degree less than it is given."""

        def decode(self, genes: np.ndarray) -> Selection:
            model = self.inputs.model.with_parameters({"degree": 2})
            return Selection(model.terms, self.inputs.control.ids, {"degree": 2})

    recipe = Recipe("lower", "A lower degree.", lambda inputs: Lower(
        inputs, terms=True, features=False), model="poly2d", dataset="ikonos-hamedan")
    note = "Option degree of the model was 3; the problem chose 2 in its place."
    for degree, said in ((3, [note]), (2, [])):
        task = termsel.prepare(recipe, options={"degree": degree})
        genes = task.problem.genome.random(np.random.default_rng(1), 1)[0]
        notes = termsel.assess(termsel.GivenGenes(genes), task).notes
        assert [note for note in notes if note.startswith("Option")] == said


def test_a_model_without_the_option_is_refused() -> None:
    with pytest.raises(TermselError, match="unknown option 'line_x'") as error:
        termsel.prepare("poly-degree", model="rfm")
    assert "needs a model with this option" in str(error.value)


def test_an_option_that_is_searched_cannot_be_given() -> None:
    with pytest.raises(TermselError, match="problem 'poly-degree' searches the option 'line_x' of "
                                           "model 'poly3d-by-axis', so it cannot be given"):
        termsel.prepare("poly-degree", options={"line_x": 1})
