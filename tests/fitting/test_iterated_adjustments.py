"""Adjustments that are iterated for each selection, compared with the optimiser of scipy."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

import termsel
from termsel.adjustment.leave_out import solve_parts
from termsel.testing import invoke


def prepared(**options: object) -> termsel.Task:
    return termsel.prepare("rfm-terms", options={"order": 1, "weighted": True, **options})


def by_scipy(task: termsel.Task, terms: np.ndarray, start: np.ndarray,
             used: np.ndarray | None = None) -> np.ndarray:
    """Return the least squares of distances in the image, by another program."""
    model, points = task.problem.inputs.model, task.problem.inputs.control.points

    def distances(chosen: np.ndarray) -> np.ndarray:
        x = np.zeros(len(terms))
        x[terms] = chosen
        left = (model.project(x, points.ground) - points.image)[slice(None) if used is None
                                                                else used]
        sigma = points.sigma if points.sigma is not None else np.ones_like(points.image)
        return (left / (sigma if used is None else sigma[used])).ravel()

    return least_squares(distances, start[terms], x_scale="jac", xtol=1e-15, ftol=1e-15,
                         gtol=1e-15).x


@pytest.mark.parametrize("denominators", ["separate", "shared"])
def test_each_selection_has_the_least_distances_of_its_own(denominators: str) -> None:
    task = prepared(denominators=denominators)
    problem, rng = task.problem, np.random.default_rng(0)
    genes = problem.genome.random(rng, 40)
    terms, _ = problem.masks(genes[problem.evaluate(genes).violation == 0])
    assert len(terms) > 5
    start, _ = solve_parts(problem._parts, terms, None)
    model, points = problem.inputs.model, problem.inputs.control.points
    found = model.least_distances(points, problem._parts, terms, None)
    moved = np.abs(found - start).max(axis=1)
    assert (moved > 1e-6).any()
    for mask, x in zip(terms, found, strict=True):
        best = by_scipy(task, mask, x)
        assert x[mask] == pytest.approx(best, rel=1e-3, abs=1e-5)


def test_points_that_are_not_selected_and_standard_deviations_count() -> None:
    task = prepared()
    problem, rng = task.problem, np.random.default_rng(1)
    points = problem.inputs.control.points
    sigma = rng.uniform(0.5, 2.0, points.image.shape)
    control = replace(problem.inputs.control, points=replace(points, sigma=sigma))
    problem.inputs = replace(problem.inputs, control=control)
    model, terms = problem.inputs.model, np.ones((1, len(problem.inputs.model.terms)), dtype=bool)
    used = np.arange(len(points))[None] % 4 > 0
    start = by_scipy(task, terms[0], np.zeros(terms.shape[1]))[None]
    found = model.least_distances(control.points, problem._parts, terms, used)
    assert found[0] == pytest.approx(by_scipy(task, terms[0], start[0], used[0]), abs=1e-6)
    assert np.abs(found - start).max() > 1e-4


@pytest.mark.slow
def test_the_fit_is_the_one_that_the_search_judged_and_is_repeated(tmp_path: Path) -> None:
    done = invoke("run", "--problem", "rfm-terms", "--set", "order=2", "--set", "weighted=true",
                  "--solver", "ga", "--seed", 1, "--evaluations", 600, "--json",
                  "--out", tmp_path / "result")
    assert done.exit_code == 0
    record = json.loads(done.stdout)
    assert record["options"]["model"]["weighted"] is True
    assert record["rmse"]["check"]["total"] == pytest.approx(record["history"][-1]["best"],
                                                             rel=1e-4)
    again = termsel.read_result(tmp_path / "result")
    chosen = again.fit
    assert chosen.model.weighted
    for role in ("control", "check", "independent"):
        points = again.features.points
        points = points.take([one == role for one in points.roles])
        errors = chosen.project(points.ground) - points.image
        assert np.sqrt((errors**2).sum(axis=1).mean()) == pytest.approx(
            record["rmse"][role]["total"])
    # The linear fit of the same terms is another one, with greater distances at the control.
    names = ",".join(name for name in chosen.model.terms if name not in again.selection.terms)
    plain = termsel.run("rfm-terms", solver="all-terms",
                        options={"order": 2, "force_off": names})
    assert plain.rmse["control"].total > record["rmse"]["control"]["total"] * (1 + 1e-6)


def test_the_optimum_with_a_hierarchy_does_not_depend_on_the_origin() -> None:
    def best(shift: float, weighted: bool) -> tuple[float, bytes]:
        task = prepared(order=1, hierarchy=True, weighted=weighted, max_share=1.0)
        inputs = task.problem.inputs
        points = inputs.control.points
        inputs = replace(
            inputs, check=replace(inputs.check, ground=inputs.check.ground + shift),
            control=replace(inputs.control, points=replace(points, ground=points.ground + shift)))
        problem = type(task.problem)(inputs, terms=True, features=False)
        size = problem.genome.size
        genes = (np.arange(2**size)[:, None] >> np.arange(size)).astype(bool)
        judged = problem.evaluate(genes)
        order = judged.order()
        assert judged.violation[order[0]] == 0
        return float(judged.objectives[order[0], 0]), genes[order[0]].tobytes()

    (here, terms), (there, moved) = best(0.0, True), best(0.7, True)
    assert there == pytest.approx(here, rel=1e-6)
    assert moved == terms
    assert best(0.7, False)[0] != pytest.approx(best(0.0, False)[0], rel=1e-5)


@pytest.mark.parametrize(("options", "says"), [
    ({"criterion": "press"}, "by selection points"), ({"solver": "exact"}, "equations of its own")])
def test_what_needs_one_linear_system_is_refused(options: dict[str, str], says: str) -> None:
    with pytest.raises(termsel.TermselError, match=says):
        termsel.run("rfm-terms", options={"order": 1, "weighted": True}, evaluations=50,
                    **options)
