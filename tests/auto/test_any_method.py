"""One road: any method is fitted, held against its features and assessed alike."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet
from termsel.data.fit_data import FitData
from termsel.testing import checks

AFFINE = termsel.Structure("affine", "an affine polynomial", termsel.Affine(), None)


@pytest.fixture(scope="module")
def scene() -> FeatureSet:
    scene = termsel.simulate_scene("ikonos-hamedan", n_points=24, n_lines=0)
    return FeatureSet(replace(scene.points, roles=()), crs=scene.crs)


def test_a_method_by_its_name_takes_the_place_of_auto(scene: FeatureSet) -> None:
    result = termsel.run(features=scene, method="affine")
    assert result.strategy is not None
    assert result.strategy.chosen == "affine"
    assert [row.name for row in result.strategy.candidates] == ["affine"]
    assert result.predicted is not None
    assert result.strategy.reason == "You named this method. All of its terms are in use."
    assert result.judgement.startswith("The method that was asked for is an affine polynomial")
    assert "quadratic" in [row.name for row in result.baselines]  # it is held against others
    assert "automatic choice" not in result.summary(verbose=True)
    assert result.fit.coefficients == pytest.approx(
        termsel.run(features=scene, method=termsel.Structure(
            "affine", "an affine polynomial", termsel.Affine(), None)).fit.coefficients)


@pytest.mark.parametrize("is_masked", [False, True])
def test_a_function_without_a_position_outside_its_points_is_refused_by_name(
        scene: FeatureSet, is_masked: bool) -> None:
    """As what interpolates in triangles has none: of those held out at the rim nothing is known."""
    def interpolation(features: FeatureSet) -> object:
        west = features.points.ground[:, 0].min()
        affine = AFFINE.fit(FitData.of(features))

        def project(ground: np.ndarray) -> np.ndarray:
            image = affine.project(ground)
            is_outside = np.tile(ground[:, :1] < west, 2)
            if is_masked:
                return np.ma.masked_array(image, is_outside)
            return np.where(is_outside, np.nan, image)
        return project

    westernmost = scene.ids[int(scene.points.ground[:, 0].argmin())]
    method = termsel.FunctionMethod("mine", "a script", function=interpolation)
    assert np.isfinite(method.fit(FitData.of(scene)).project(scene.points.ground)).all()
    with pytest.raises(TermselError, match=r"no finite position for 1 of 24 features that it was "
                                           rf"not fitted to \({westernmost}\)"):
        termsel.run(features=scene, method=method)


def test_a_method_next_to_a_solver_is_refused(scene: FeatureSet) -> None:
    with pytest.raises(TermselError, match="a method is fitted without a search, and solver"):
        termsel.run("rfm-terms", features=scene, method="affine", solver="ga")


@pytest.mark.parametrize(("asked", "words"), [
    ({"method": "nonsense"}, "unknown method"), ({"method": 3}, "method is 3, expected a name"),
    ({"method": "affine", "strategy": "auto"}, "and a strategy")])
def test_what_is_no_method_is_refused(scene: FeatureSet, asked: dict[str, object],
                                      words: str) -> None:
    with pytest.raises(TermselError, match=words):
        termsel.run(features=scene, **asked)  # type: ignore[arg-type]


def test_a_search_is_a_method_with_the_result_of_a_run() -> None:
    task = termsel.prepare("poly-terms", solver="exact", options={"degree": 2})
    limits = {"generations": task.recipe.generations, "patience": task.recipe.patience, "seed": 1}
    result = termsel.assess(termsel.Search(limits=limits), task)
    run = termsel.run("poly-terms", solver="exact", options={"degree": 2})
    assert result.selection == run.selection
    assert result.fit.coefficients == run.fit.coefficients


def test_a_search_of_another_problem_keeps_the_features_and_roles_of_the_task() -> None:
    task = termsel.prepare("rfm-terms")
    result = termsel.assess(
        termsel.Search("poly-terms", {"solver": "exact", "options": {"degree": 1}}), task)
    assert (result.problem, result.model, result.solver) == ("poly-terms", "poly2d", "exact")
    assert result.data.roles == termsel.assess(AFFINE, task).data.roles


def test_a_search_is_fitted_and_held_out_as_any_method(scene: FeatureSet) -> None:
    points = scene.points.take(np.arange(24) < 14)
    data = FitData.of(FeatureSet(points, crs=scene.crs))
    search = termsel.Search("poly-terms", {"solver": "exact", "criterion": "press",
                                           "options": {"degree": 1, "polish": False}})
    fitted = search.fit(data)
    assert len(fitted.control) == 14  # none is set aside as independent
    held_out = search.held_out(fitted)
    assert held_out.squares.shape == (14,)
    assert held_out.squares.sum() > (fitted.errors(points)**2).sum()
    compared = termsel.Auto(methods=(search, AFFINE)).choose(data)
    assert compared is not None
    assert {fit.method.name for fit in compared.compared} == {"search", "affine"}


def test_auto_is_a_method_whose_errors_are_of_the_repeated_choice(scene: FeatureSet) -> None:
    data = FitData.of(scene.with_(points=scene.points.take(np.arange(24) < 12)))
    auto = termsel.Auto()
    fitted = auto.fit(data)
    errors = auto.repeated(data)
    assert errors is not None
    np.testing.assert_allclose(auto.held_out(fitted).squares, (errors**2).sum(axis=1))


@pytest.mark.parametrize("name", ["affine", "quadratic", "regularised-quadratic"])
def test_errors_held_out_are_those_of_fits_without_each_point(
        scene: FeatureSet, name: str) -> None:
    fitted = termsel.fit(scene.with_(points=scene.points.take(np.arange(24) < 20)), name)
    squares = fitted.held_out().squares
    for out in (0, 7):
        kept = fitted.control.take(np.arange(len(fitted.control)) != out)
        point = fitted.control.points.take(np.arange(len(fitted.control)) == out)
        error = termsel.fit(kept, name).errors(point)[0]
        assert np.sqrt(squares[out]) == pytest.approx(np.hypot(*error), rel=0.05)


def middle(features: FeatureSet) -> object:
    """Project every place into the middle of the control, a metre moving nothing."""
    return lambda ground: np.tile(features.points.image.mean(axis=0), (len(ground), 1))


def linear(features: FeatureSet) -> object:
    points = features.points
    design = np.column_stack([np.ones(len(points)), points.ground])
    solution = np.linalg.lstsq(design, points.image, rcond=None)[0]
    return lambda ground: np.column_stack([np.ones(len(ground)), ground]) @ solution


def test_a_plain_function_is_assessed_as_the_model_that_it_is(
        scene: FeatureSet, tmp_path: Path) -> None:
    theirs = termsel.run(features=scene, method=linear, out=tmp_path / "result")
    ours = termsel.run(features=scene, method="affine")
    assert theirs.strategy is not None
    assert theirs.strategy.chosen == "linear"
    assert theirs.predicted is not None
    assert ours.predicted is not None
    assert theirs.predicted.rmse == pytest.approx(ours.predicted.rmse, rel=1e-6)
    assert theirs.fit.effective == pytest.approx(8.0, abs=2.0)
    with pytest.raises(TermselError, match="a function in Python, which no file holds"):
        termsel.read_result(tmp_path / "result")


def test_a_function_that_returns_no_projection_is_named(scene: FeatureSet) -> None:
    with pytest.raises(TermselError, match="returned tuple, which projects nothing"):
        termsel.fit(scene, termsel.FunctionMethod(
            "mine", "a function", function=lambda features: features.ids))


def test_a_function_does_what_every_method_does() -> None:
    few = FeatureSet(replace(termsel.simulate_scene(
        "ikonos-hamedan", n_points=8, n_lines=0).points, roles=()))
    for check in checks(termsel.FunctionMethod("middle", "a middle", function=middle),
                        features=[few]):
        check.run()


@pytest.mark.parametrize("name", ["huber", "similarity"])
def test_methods_that_auto_does_not_choose_are_fitted_where_they_are_asked_for(
        scene: FeatureSet, name: str) -> None:
    result = termsel.run(features=scene, method=name)
    assert result.strategy is not None
    assert result.strategy.chosen == name


def test_a_method_that_cannot_be_held_against_features_says_why(scene: FeatureSet) -> None:
    with pytest.raises(TermselError,
                       match="points do not determine a third-order rational function model by "
                             "ridge"):
        termsel.run(features=scene, method="ridge")


def test_a_search_of_its_own_is_run_as_a_method(scene: FeatureSet) -> None:
    search = termsel.Search("poly-terms", {"solver": "exact", "options": {"degree": 1}})
    assert termsel.run(features=scene, method=search).solver == "exact"
