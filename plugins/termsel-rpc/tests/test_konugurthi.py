"""The set-up of Konugurthi et al. 2016."""

from __future__ import annotations

import numpy as np
import pytest

import termsel
from termsel_rpc import simulate_matches


def test_matches_are_wrong_in_the_share_asked_for() -> None:
    exact, found = simulate_matches(0.0), simulate_matches(0.4)
    control = np.array(exact.points.roles) == "control"
    far = np.linalg.norm(found.points.image - exact.points.image, axis=1) > 4.0
    assert control.sum() == 100
    assert far[control].sum() == 40
    assert not far[~control].any()


def test_the_fitness_is_the_median_error_by_the_covered_area() -> None:
    task = termsel.prepare("konugurthi-2016")
    genes = np.array([[3, 17, 25, 40, 52, 61, 70, 88, 99], [0, 9, 19, 33, 47, 58, 66, 77, 91]])
    points = task.observations.control.points
    for numbers, score in zip(genes, task.problem.evaluate(genes).objectives[:, 0], strict=True):
        chosen = np.isin(np.arange(100), numbers)
        rows = np.repeat(chosen, 2)
        equations = task.model.equations(task.scaling.features(task.observations.control))
        solution = np.linalg.lstsq(equations.A[rows], equations.b[rows], rcond=None)[0].astype(
            np.float64)
        placed = task.model.project(solution, task.scaling.points(points).ground)
        errors = np.linalg.norm(placed - task.scaling.points(points).image, axis=1)
        corners = points.image[chosen] - points.image.min(axis=0)
        covered = _hull_area(corners) / np.prod(np.ptp(points.image, axis=0))
        assert score == pytest.approx(
            np.median(errors) * task.scaling.image_scale / covered, rel=1e-6)


def _hull_area(points: np.ndarray) -> float:
    from scipy.spatial import ConvexHull

    return float(ConvexHull(points).volume)


def test_the_paper_just_runs() -> None:
    result = termsel.run("konugurthi-2016")
    assert result.generations == 20
    assert result.evaluations == 10 + 20 * 5
    assert len(result.selection.features) == 9
    assert result.polish is None
    # Three in ten points are wrong, by up to 40 px; all together are far worse.
    independent = result.rmse["independent"]
    assert independent is not None
    assert independent.total < 2.5
    assert set(result.objectives) == {"e50-area"}


def test_the_fitness_requires_points_that_judge() -> None:
    with pytest.raises(termsel.TermselError, match="requires selection points"):
        termsel.run("konugurthi-2016", options={"judged_by": "check"})
