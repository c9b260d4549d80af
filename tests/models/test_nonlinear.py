"""Models that are not linear in their terms, by the fisheye camera of the page about them."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import termsel
from termsel.adjustment.equations import Equations
from termsel.auto.rule import validated
from termsel.core.isolation.faults import PluginFault
from termsel.data.features import FloatArray
from termsel.testing import check

PAGE = Path(__file__).parents[2] / "docs/how-to/kinds/nonlinear.md"


@pytest.fixture(scope="module")
def page() -> Iterator[dict[str, Any]]:
    """What the page's module and its test define."""
    module = sys.modules["termsel_fisheye"] = ModuleType("termsel_fisheye")
    for code in re.findall(r"^```python\n(.*?)^```", PAGE.read_text("utf-8"), re.M | re.S):
        exec(code, vars(module))
    yield vars(module)
    del sys.modules["termsel_fisheye"]


@pytest.fixture(scope="module")
def scene() -> termsel.FeatureSet:
    """60 points as a fisheye camera at a height of 900 m sees them, with noise of 0.3 px."""
    rng = np.random.default_rng(0)
    ground = np.column_stack([rng.uniform(-1000, 1000, (60, 2)), rng.uniform(0, 200, 60)])
    east, north, down = (ground - [50, -30, 900]).T * [[1], [1], [-1]]
    side = np.hypot(east, north)
    away = 1800 * np.arctan2(side, down) / side
    image = 2000 + np.column_stack([-north * away, east * away]) + rng.normal(0, 0.3, (60, 2))
    roles = ("control",) * 25 + ("check",) * 15 + ("independent",) * 20
    return termsel.FeatureSet(termsel.Points([f"P{i}" for i in range(60)], image, ground,
                                             roles=roles), crs="local", image_size=(4000, 4000))


@pytest.fixture(scope="module")
def astray(page: dict[str, Any]) -> type[termsel.SensorModel]:
    """The camera with a start from which no steps lead to a minimum."""
    class Astray(page["Fisheye"]):
        """Begins with a camera that looks up."""

        name = "astray"

        def start(self, features: termsel.FeatureSet) -> FloatArray:
            return np.asarray(super().start(features) + 3.0 * np.eye(10)[3])

    return Astray


def test_the_model_of_the_page_conforms(page: dict[str, Any]) -> None:
    page["test_model"]()


@pytest.mark.slow
def test_a_fit_converges_and_the_record_says_so(page: dict[str, Any], scene: termsel.FeatureSet,
                                                tmp_path: Path) -> None:
    result = termsel.run("rfm-terms", features=scene, model=page["Fisheye"], solver="all-terms",
                         out=tmp_path / "r")
    assert result.rmse["independent"].total < 1.0
    steps = result.fit.adjustment.steps
    assert 1 < steps < 15
    found = result.adjustment
    assert (found.steps, found.converged) == (steps, True)
    assert any(f"the selection itself took {steps} steps" in note for note in result.notes)
    said = f"the fit converged after {steps} steps"
    assert said in " ".join(result.summary(verbose=True).split())
    result.report(tmp_path / "r.html")
    assert said in (tmp_path / "r.html").read_text("utf-8")
    written = json.loads((tmp_path / "r/result.json").read_text("utf-8"))["adjustment"]
    assert (written["steps"], written["converged"]) == (steps, True)


def test_a_search_judges_about_the_fit_of_all_terms(page: dict[str, Any],
                                                    scene: termsel.FeatureSet) -> None:
    calls = []

    class Counted(page["Fisheye"]):
        """Counts the equations that are asked for."""

        def linearised(self, features: termsel.FeatureSet, coefficients: FloatArray) -> Equations:
            calls.append(len(features))
            found: Equations = super().linearised(features, coefficients)
            return found

    task = termsel.prepare("rfm-terms", features=scene, model=Counted, solver="random")
    before = len(calls)
    genes = task.problem.genome.random(np.random.default_rng(1), 200)
    genes[0] = True
    whole = task.problem.evaluate(genes).objectives[0, 0]
    assert len(calls) == before
    control, check_points = scene.take(np.arange(60) < 25), scene.points.take(
        np.array(scene.points.roles) == "check")
    assert whole == pytest.approx(termsel.fit(control, Counted).rmse(check_points).total, rel=1e-3)


def test_what_has_not_converged_is_not_praised(astray: type[termsel.SensorModel],
                                               scene: termsel.FeatureSet) -> None:
    with pytest.raises(termsel.TermselError, match=r"'astray' did not converge \(it ended after"):
        termsel.fit(scene, astray)
    result = termsel.run("rfm-terms", features=scene, model=astray, solver="all-terms")
    assert not result.feasible
    assert result.adjustment.converged is False
    assert result.judgement.startswith("The fit of this selection did not converge")
    assert "better" not in result.judgement
    assert "do not use this fit: it did not converge" in result.summary()


def test_a_selection_is_not_compared_with_what_has_not_converged(
        page: dict[str, Any], scene: termsel.FeatureSet) -> None:
    class Full(page["Fisheye"]):
        """Finds its start for less than all 25 control points alone."""

        name = "full"

        def start(self, features: termsel.FeatureSet) -> FloatArray:
            turned = 3.0 * np.eye(10)[3] * (len(features) == 25)
            return np.asarray(super().start(features) + turned)

    result = termsel.run("owdis-points", features=scene, model=Full, solver="random",
                         generations=2)
    assert result.selection.features
    assert len(result.selection.features) < 25
    assert "(the fit of all control points did not converge) at 20 independent" in result.judgement
    assert "times better than all" not in result.judgement


def test_steps_do_not_go_where_the_model_has_no_image(page: dict[str, Any],
                                                      scene: termsel.FeatureSet) -> None:
    far = []

    class Narrow(page["Fisheye"]):
        """Has no image where the first step away from the start goes to."""

        def linearised(self, features: termsel.FeatureSet, coefficients: FloatArray) -> Equations:
            found: Equations = super().linearised(features, coefficients)
            beyond = not far and not np.allclose(coefficients, self.start(features))
            far.extend([True] * beyond)
            return Equations(found.A * (np.nan if beyond else 1.0), found.b, found.feature)

    fitted = termsel.fit(scene, Narrow)
    assert far
    assert fitted.adjustment.converged
    assert fitted.control_rmse().total < 1.0


def test_a_candidate_of_auto_is_judged_about_its_fit(page: dict[str, Any],
                                                     scene: termsel.FeatureSet) -> None:
    control = scene.take(np.arange(60) < 25)
    candidate = termsel.Structure("fish", "a fisheye camera", page["Fisheye"](), termsel.Affine())
    judged = validated(candidate, termsel.FitData.of(control))
    repeated = termsel.fit(control, page["Fisheye"]).leave_one_out_rmse().total
    assert np.sqrt(judged.held_out().squares.mean()) == pytest.approx(repeated, rel=1e-3)


@pytest.mark.parametrize(("method", "value", "said"), [
    ("start", np.zeros(3), r"start\(\) returned an array of shape \(3,\); expected"),
    ("start", np.full(10, np.nan), r"start\(\) returned 10 numbers that are not finite"),
    ("linearised", None, r"linearised\(\) returned nothing; expected Equations")])
def test_a_faulty_start_is_the_plugins(page: dict[str, Any], scene: termsel.FeatureSet,
                                       method: str, value: Any, said: str) -> None:
    faulty = type("Faulty", (page["Fisheye"],), {
        "__doc__": "Faulty.", method: lambda _self, *_args: value})
    with pytest.raises(PluginFault, match=said):
        termsel.fit(scene, faulty)


@pytest.mark.slow
def test_derivatives_that_are_wrong_fail_the_check(page: dict[str, Any]) -> None:
    class Wrong(page["Fisheye"]):
        """Has derivatives twice as large."""

        def linearised(self, features: termsel.FeatureSet, coefficients: FloatArray) -> Equations:
            found: Equations = super().linearised(features, coefficients)
            return Equations(2 * found.A, found.b + found.A @ coefficients, found.feature)

    with pytest.raises(AssertionError, match=r"linearisation: .* the derivatives of project"):
        check(Wrong, place=page["PLACE"])


def test_coefficients_that_cannot_be_shrunk_are_not(page: dict[str, Any],
                                                    scene: termsel.FeatureSet) -> None:
    with pytest.raises(termsel.TermselError, match="'fisheye-demo' is not linear"):
        termsel.run("rfm-terms", features=scene, model=page["Fisheye"], solver="all-terms",
                    options={"shrink": True})
