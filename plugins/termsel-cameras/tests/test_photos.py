"""Lens distortion: models, the search for its centre, the simulated photo."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import fsolve

pytest.importorskip("termsel_cameras", reason="termsel-cameras is not installed: "
                    "pip install -e plugins/termsel-cameras")

import termsel
from termsel import FeatureSet, Points, TermselError, read_result
from termsel.testing import Check, checks
from termsel_cameras import Radial2D, Radial3D, photo
from termsel_cameras.photo import CENTRE, project_into_scan
from termsel_cameras.problem import RECIPE
from termsel_cameras.radial import FloatArray

DISTORTED = {"control_kinds": "distortion bends lines", "axis": "distortion couples the axes",
             "translation": "the centre of distortion stays"}
FOLDED = {**DISTORTED, "fit": "drawn distortions fold"}


@pytest.mark.slow_cases("modest_import")
@pytest.mark.parametrize("check", [
    *checks(Radial2D, expected_failures=DISTORTED), *checks(Radial3D, expected_failures=FOLDED),
    *checks(RECIPE), *checks(photo.PHOTO), *checks("termsel-cameras")],
    ids=lambda check: check.name)
def test_conformance(check: Check) -> None:
    check.run()


@pytest.fixture(scope="module")
def distorted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photo")
    termsel.run("distortion", generations=12, out=folder / "out", options={"mask": "shared"})
    return folder / "out"


def test_centre_and_terms_of_a_photo_are_found(distorted: Path) -> None:
    result = read_result(distorted)
    scaling = result.fit.scaling
    centre = np.array([result.selection.parameters[f"centre_{axis}"]
                       for axis in ("line", "sample")])
    found = np.array(scaling.image_offset) + centre * scaling.image_scale
    assert np.linalg.norm(found - CENTRE) < 150
    assert "radial:2" in result.selection.terms
    rmse = result.rmse["independent"]
    assert rmse is not None
    assert rmse.total < 1.2  # of noise of 0.5 px an axis, 0.71 px remain
    plain = next(b for b in result.baselines if b.name == "quadratic").rmse["independent"]
    assert plain is not None
    assert plain.total > 3 * rmse.total


def test_terms_under_the_same_parameters_are_evaluated_each() -> None:
    problem = termsel.prepare("distortion").problem
    genes = problem.genome.random(np.random.default_rng(2), 12)
    genes[:, -2:] = genes[0, -2:]  # the centre
    each = [problem.evaluate(one[None]).objectives[0, 0] for one in genes]
    assert len(set(each)) > 3
    np.testing.assert_allclose(problem.evaluate(genes).objectives[:, 0], each)


def test_parameters_reach_record_report_and_exports(distorted: Path, tmp_path: Path) -> None:
    record = json.loads((distorted / "result.json").read_text())
    parameters = record["selection"]["parameters"]
    assert set(parameters) == {"centre_line", "centre_sample"}
    assert record["options"]["model"]["centre_line"] == 0.0  # as asked for
    result = read_result(distorted)
    assert result.fit.model.options["centre_line"] == parameters["centre_line"]
    shown = result.summary(verbose=True)
    assert f"Parameters: centre_line {parameters['centre_line']:.6g}" in shown
    termsel.export(result, "residuals-gpkg", tmp_path / "residuals.gpkg")
    ground = result.features.points.ground
    errors = result.project(ground) - result.features.points.image
    chosen = np.array(result.features.points.roles) == "control"
    control = result.rmse["control"]
    assert control is not None
    assert np.sqrt((errors[chosen]**2).sum(axis=1).mean()) == pytest.approx(control.total)


def test_a_front_has_the_parameters_of_each_member() -> None:
    result = termsel.run("distortion", solver="nsga2", generations=4,
                         options={"population": 20, "polish": False})
    assert all(set(one.selection.parameters or ()) == {"centre_line", "centre_sample"}
               for one in result.front)


def test_the_photo_is_distorted_as_stated() -> None:
    points = photo.read_photo_points().points
    assert len(points) == 120
    noise = points.image - project_into_scan(points.ground - [400000.0, 4000000.0, 0.0])
    assert noise.std() == pytest.approx(0.5, rel=0.15)


def test_the_photo_is_distorted_by_both_terms(monkeypatch: pytest.MonkeyPatch) -> None:
    ground = photo.read_photo_points().points.ground - [400000.0, 4000000.0, 0.0]
    away = project_into_scan(ground) - CENTRE
    monkeypatch.setattr(photo, "DISTORTION", (0.0, 0.0))
    ideal = project_into_scan(ground) - CENTRE
    r2 = (away**2).sum(axis=1, keepdims=True)
    np.testing.assert_allclose(away * (1 + 7.0e-9 * r2 - 6.0e-16 * r2**2), ideal, atol=1e-6)


def test_projection_inverts_the_distortion() -> None:
    model = Radial2D(degree=1, centre_line=0.2, centre_sample=-0.1)
    coefficients = np.array([0.1, 0.5, 0.0, -0.05, 0.0, 0.6, 0.08, -0.03, 0.01])
    ground = np.random.default_rng(0).uniform(-1, 1, (6, 3))
    centre, (k1, k2, k3) = np.array([0.2, -0.1]), coefficients[-3:]
    ideal = np.column_stack([0.1 + 0.5 * ground[:, 0], -0.05 + 0.6 * ground[:, 1]])

    def lacking(flat: FloatArray) -> FloatArray:
        away = flat.reshape(-1, 2) - centre
        r2 = (away**2).sum(axis=1, keepdims=True)
        measured = away * (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) + centre
        return np.asarray(measured - ideal).ravel()

    expected = fsolve(lacking, ideal.ravel(), xtol=1e-13).reshape(-1, 2)
    np.testing.assert_allclose(model.project(coefficients, ground), expected, atol=1e-10)
    # A correction that turns back on itself images nothing beyond.
    folded = np.array([0.0, 2.0, 0.0, 0.0, 0.0, 2.0, -1.0, 0.0, 0.0])
    assert np.isnan(model.project(folded, np.array([[1.0, 1.0, 0.0]]))).all()


def test_a_known_distortion_is_fitted_exactly() -> None:
    rng = np.random.default_rng(5)
    ground = np.column_stack([rng.uniform(-1, 1, (20, 2)), np.zeros(20)])
    model = Radial2D(degree=1, centre_line=0.3)
    truth = np.array([0.0, 0.7, 0.1, 0.0, -0.1, 0.7, 0.05, 0.02, 0.0])
    points = Points(tuple(map(str, range(20))), model.project(truth, ground), ground)
    equations = model.equations(FeatureSet(points))
    found = np.linalg.lstsq(equations.A, equations.b, rcond=None)[0]
    np.testing.assert_allclose(found, truth, atol=1e-8)


def test_lines_are_refused_by_a_model_with_distortion() -> None:
    scene = termsel.simulate_scene("ikonos-hamedan")
    with pytest.raises(TermselError, match="takes no lines: distortion bends them"):
        termsel.fit(scene, Radial3D)


def test_a_model_without_the_option_is_refused() -> None:
    with pytest.raises(TermselError, match="unknown option 'centre_line'"):
        termsel.prepare("distortion", model="poly3d")


@pytest.mark.parametrize("given", [
    {"model": "radial2d", "options": {"centre_line": 0.0}},
    {"model": Radial2D(centre_line=0.2)}])
def test_an_option_that_is_searched_cannot_be_given(given: dict[str, Any]) -> None:
    with pytest.raises(TermselError, match="problem 'distortion' searches the option 'centre_line'"
                                           " of model 'radial2d', so it cannot be given"):
        termsel.prepare("distortion", **given)
