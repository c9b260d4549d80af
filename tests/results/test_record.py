"""A result that is read again behaves as the one that the run returned: every fit in it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import termsel
from termsel.auto.methods import METHODS, named
from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet, empty_lines, empty_points
from termsel.data.record.figures import AdjustmentFigures, StandardFigure, as_plain_data
from termsel.data.record.record import FitRecord
from termsel.fitting.fit import Fit
from termsel.io.result_folder import read_result, write_result
from termsel.plugins.registry import registry
from termsel.results.result import Result
from termsel.results.same_fit import adjustment_figures, fit_of_record, fit_record
from termsel.simulate import simulate_scene
from termsel_cameras import simulate_map

QUICK = {"population": 20, "polish": False}


def _without_one(fitted: Fit) -> Any:
    """Return the errors of leave-one-out, or why there are none."""
    try:
        return repr(list(fitted.leave_one_out))  # as text, since unknown heights are NaN
    except TermselError as error:
        return str(error)


def _require_same(one: Fit, other: Fit) -> None:
    """Require that two fits are the same in all they can be asked."""
    assert one.coefficients == other.coefficients
    assert one.estimator.name == other.estimator.name
    assert one.estimator.options == other.estimator.options
    np.testing.assert_equal(one.standard_deviations, other.standard_deviations)
    np.testing.assert_equal(one.effective, other.effective)
    assert one.determined == other.determined
    ground = one.control.ground_vertices()
    beyond = ground + 0.3 * (ground - ground.mean(axis=0))
    for places in (ground, beyond):
        np.testing.assert_array_equal(one.project(places), other.project(places))
        for measured in (False, True):
            np.testing.assert_allclose(one.sigma(places, measured=measured),
                                       other.sigma(places, measured=measured), rtol=1e-12)
    assert repr(list(one.residuals)) == repr(list(other.residuals))
    assert _without_one(one) == _without_one(other)
    if one.estimator.repeatable:
        assert one.leave_one_out_rmse() == other.leave_one_out_rmse()
    assert (one.adjustment.correlations is None) == (other.adjustment.correlations is None)
    if one.adjustment.correlations is not None and other.adjustment.correlations is not None:
        np.testing.assert_allclose(one.adjustment.correlations, other.adjustment.correlations,
                                   rtol=1e-12)
    assert (one.original is None) == (other.original is None)
    if one.original is not None and other.original is not None:
        assert one.original.control.ids == other.original.control.ids
        _require_same(one.original, other.original)


def _again(result: Result, folder: Path) -> Result:
    write_result(result, folder)
    again = read_result(folder)
    assert again.to_json() == result.to_json()
    assert again.to_dict() == result.to_dict()
    return again


RUNS: dict[str, tuple[str, dict[str, Any]]] = {
    **{f"solver {name}": ("poly-terms", {"solver": name, "evaluations": 60,
                                         "options": {"degree": 2}})
       for name in ("deap", "pymoo", "ga", "ga-correlation", "ica",
                    "pso", "exact", "swap", "random", "all-terms", "ridge")},
    **{f"front by {name}": ("poly-terms", {"solver": name, "evaluations": 200,
                                           "options": {"degree": 2, "polish": False}})
       for name in ("nsga2", "age-moea2", "sms-emoa", "spea2")},
    "shrunken selection": ("rfm-terms", {"solver": "random", "evaluations": 40,
                                         "options": {"shrink": True}}),
    "lines": ("owdis-lines", {"generations": 1, "options": QUICK}),
    "lines under separate denominators": (
        "owdis-lines", {"model": "rfm", "generations": 1, "options": {**QUICK, "order": 1}}),
    "lines and terms": ("owdis-lines-terms", {"generations": 1, "options": QUICK}),
    "lines and points": ("rfm-terms-lines", {"generations": 1,
                                             "options": {**QUICK, "mixed": True}}),
    "points": ("owdis-points", {"generations": 1, "options": QUICK}),
    "points and terms": ("owdis-points-terms", {"generations": 1, "options": QUICK}),
    "number of points": ("owdis-points", {
        "solver": "ga-steady", "generations": 1,
        "options": {"population": 20, "min_features": 12, "max_features": 12}}),
    "degree among the genes": ("poly-degree", {"evaluations": 60}),
    "auto": ("rfm-terms", {"strategy": "auto"}),
    "auto without heights": ("poly-terms", {"strategy": "auto"}),
    "auto of few points": ("poly-terms", {"strategy": "auto", "dataset": "irs1c-mashad"}),
    "auto of lines": ("owdis-lines", {"strategy": "auto"}),
}


@pytest.mark.slow_cases(
    "auto of few points", "auto of lines", "auto without heights", "front by age-moea2",
    "front by nsga2", "front by sms-emoa", "front by spea2", "lines and points", "lines and terms",
    "lines under separate denominators", "shrunken selection", "solver exact", "solver pymoo")
@pytest.mark.parametrize(("problem", "how"), RUNS.values(), ids=RUNS)
def test_what_is_read_again_is_what_the_run_returned(problem: str, how: dict[str, Any],
                                                     tmp_path: Path) -> None:
    # Few points make a run quicker; where features are selected, they are those of the example.
    features = FEW if problem in ("rfm-terms", "poly-terms") and "dataset" not in how else None
    result = termsel.run(problem, seed=1, features=features, **how)
    again = _again(result, tmp_path)
    assert repr(list(again.residuals)) == repr(list(result.residuals))
    _require_same(again.fit, result.fit)
    assert (again.final is None) == (result.final is None)
    if again.final is not None and result.final is not None:
        _require_same(again.final, result.final)
    for member, other in zip((*result.front, *result.by_size), (*again.front, *again.by_size),
                             strict=True):
        _require_same(result.fit_of(member), again.fit_of(other))
        rmse = result.fit_of(member).control_rmse()
        assert rmse is not None
        assert rmse.total == member.rmse.control.total


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["contradicting", "twins", "field", "plane lines"])
def test_auto_on_odd_data_is_read_again(kind: str, tmp_path: Path) -> None:
    if kind == "field":
        points = simulate_map(seed=0, n_points=40).points
        roles = ("control",) * 22 + ("check",) * 8 + ("independent",) * 10
        features = FeatureSet(replace(points, roles=roles))
    else:
        features = simulate_scene("ikonos-hamedan", seed=3)
        points, image, ground = features.points, features.points.image.copy(), \
            features.points.ground.copy()
        if kind == "contradicting":
            image[[3, 40]] += 60.0
        elif kind == "twins":
            image[5], ground[5] = image[4] + 0.2, ground[4] + 1e-9
        features = features.with_(points=replace(points, image=image, ground=ground),
                                  lines=features.lines if kind == "plane lines" else empty_lines())
    options = {"roles": "stratified"} if kind != "field" else {}
    result = termsel.run("owdis-lines" if kind == "plane lines" else "poly-terms",
                         strategy="auto", features=features, options=options)
    assert result.strategy is not None
    assert (result.strategy.chosen == "field") == (kind == "field")
    again = _again(result, tmp_path)
    _require_same(again.fit, result.fit)
    assert result.final is not None
    assert again.final is not None
    _require_same(again.final, result.final)


def _recorded(fitted: Fit) -> Fit:
    """Return a fit after its way through JSON."""
    how = msgspec.json.decode(msgspec.json.encode(as_plain_data(fit_record(fitted))),
                              type=FitRecord)
    figures = msgspec.convert(as_plain_data(adjustment_figures(fitted)), AdjustmentFigures)
    numbers = json.loads(json.dumps(fitted.coefficients))
    deviations = {name: value if np.isfinite(value) else None
                  for name, value in fitted.standard_deviations.items()}
    model: Any = fitted.model
    return fit_of_record(type(model)(**model.options), fitted.control, fitted.scaling, fitted.used,
                         numbers, deviations, figures, how)


SCENE = simulate_scene("ikonos-hamedan", seed=2, roles=(24, 8, 8), n_lines=60)
FEW = simulate_scene("ikonos-hamedan", roles=(16, 12, 10), n_lines=0)
PLANE = simulate_map(seed=0, n_points=30)
MODELS = ("rfm", "poly2d", "poly3d", "affine", "projective2d", "dlt2d", "dlt3d", "helmert2d", "tps",
          "field", "field3d", "poly2d-by-axis", "poly3d-by-axis", "radial2d", "radial3d",
          "multiquadric", "pointwise", "piecewise", "hybrid-1", "hybrid-3")


@pytest.mark.parametrize("name", MODELS)
def test_every_model_is_the_same_again(name: str) -> None:
    if name not in registry().names("models"):
        pytest.skip(f"no package with {name} is installed")
    options = {"order": 1} if name == "rfm" else {}
    fitted = termsel.fit(SCENE.with_(lines=empty_lines()), name, **options)
    _require_same(_recorded(fitted), fitted)


@pytest.mark.slow_cases("huber-lines", "ridge-lines", "tukey-lines")
@pytest.mark.parametrize("features", [
    SCENE.with_(lines=empty_lines()), SCENE.with_(points=empty_points()), PLANE],
    ids=["points", "lines", "map"])
@pytest.mark.parametrize("name", [one.name for one in METHODS])
def test_every_candidate_is_the_same_again(name: str, features: FeatureSet) -> None:
    candidate = named(name)
    assert candidate is not None
    try:
        fitted = termsel.fit(features, candidate)
    except TermselError:  # not for these features
        pytest.skip("the features do not determine the candidate")
    _require_same(_recorded(fitted), fitted)


def test_text_that_is_not_utf_8_and_numbers_that_are_none_are_json() -> None:
    part = StandardFigure(float("nan"), "p\udcff.csv")
    assert json.loads(json.dumps(as_plain_data(part), allow_nan=False)) == {
        "value": None, "reason": "p\udcff.csv"}
