"""One outlier test, the same for every problem and in all roles; none where none is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import termsel
from termsel.auto.auto import Auto
from termsel.data.features import FeatureSet, empty_lines
from termsel.data.roles import observations_by_role
from termsel.results.repeat import repeating_command
from termsel.runs.verdict import judge_features, judge_independent

ROLES = ("control", "check", "independent")
QUICK = {"population": 30, "polish": False}
PROBLEMS = {"rfm-terms": {"strategy": "auto"}, "poly-terms": {"solver": "all-terms"},
            "owdis-points": {"generations": 2, "options": QUICK},
            "owdis-points-terms": {"generations": 40, "options": QUICK}}


def scene(moved: dict[str, float], n: int = 60, seed: int = 3) -> FeatureSet:
    """Return points in all roles; the first of some roles are moved along the line [px]."""
    found = termsel.simulate_scene("spot-isfahan", seed=seed, n_points=n, n_lines=0)
    points = replace(found.points, roles=ROLES * (n // 3))
    image = points.image.copy()
    for role, by in moved.items():
        image[ROLES.index(role), 0] += by
    return found.with_(points=replace(points, image=image))


@pytest.mark.slow_cases(
    "owdis-points-check", "owdis-points-independent", "poly-terms-check",
    "rfm-terms-check", "rfm-terms-control", "rfm-terms-independent")
@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("problem", PROBLEMS)
def test_every_problem_names_the_blunder_and_no_other(problem: str, role: str) -> None:
    features = scene({role: 60.0})
    name = features.points.ids[ROLES.index(role)]
    result = termsel.run(problem, features=features, **PROBLEMS[problem])
    [found] = result.outliers
    assert (found.id, found.role, found.certainty) == (name, role, "certain")
    assert found.error == pytest.approx(60, abs=3)
    searched = "owdis" in problem or "strategy" in PROBLEMS[problem]
    assert found.excluded == (role != "independent" and searched)
    said = result.summary().partition("Outliers ")[2]
    assert name in said
    assert (f"options={{'off': '{name}'}}" in result.next_step("r")) != found.excluded
    assert (result.accuracy_without is not None) == (role == "independent")
    assert {r.id for r in result.residuals if r.blunder == "certain"} == {name}
    assert not any("fitted to the selection points" in note for note in result.notes) \
        or problem == "poly-terms"
    if role == "independent":
        assert result.accuracy_without.image.total < 0.7 * result.accuracy.image.total


@pytest.mark.slow
def test_a_blunder_of_each_role_is_named_next_to_the_others(tmp_path: Path) -> None:
    features = scene({"control": 40.0, "check": -25.0, "independent": 30.0})
    result = termsel.run("owdis-points", features=features, generations=2, options=QUICK,
                         out=tmp_path)
    assert {one.role for one in result.outliers} == set(ROLES)
    again = termsel.read_result(tmp_path)
    assert (again.outliers, again.accuracy_without) == (result.outliers, result.accuracy_without)
    assert again.residuals == result.residuals
    kept = termsel.run("owdis-points", features=features, generations=2,
                       options={**QUICK, "blunders": "keep"})
    assert [one.id for one in kept.outliers] == [one.id for one in result.outliers]


@pytest.mark.slow_cases("owdis-points")
@pytest.mark.parametrize("problem", ["rfm-terms", "owdis-points"])
def test_what_was_tested_before_is_not_tested_again(problem: str) -> None:
    """But for independent points, which whoever tested control and check has not seen."""
    how = {**PROBLEMS[problem]}
    how["options"] = {**how.get("options", {}), "tested": True}
    features = scene({"control": 40.0, "independent": 30.0})
    result = termsel.run(problem, features=features, **how)
    assert {one.role for one in result.outliers} == {"independent"}
    assert features.points.ids[0] in {one.id for one in result.residuals}
    assert "--set tested=true" in repeating_command(result)
    clean = termsel.run(problem, features=scene({}), **how)
    assert "Outliers  tested in an earlier run, not in this one" in clean.summary()
    assert "Outliers were tested in an earlier run, not here." in clean.summary(verbose=True)


def test_six_control_points_and_others_tell_an_independent_blunder() -> None:
    points = scene({"independent": 60.0}).points
    roles = tuple("control" if i % 10 == 0 else "independent" for i in range(60))
    features = FeatureSet(replace(points, roles=roles), empty_lines(), "EPSG:4979")
    result = termsel.run("rfm-terms", features=features, strategy="auto")
    assert [(one.id, one.role) for one in result.outliers] == [(points.ids[2], "independent")]


def test_six_points_name_nothing() -> None:
    points = scene({}).points.take(np.arange(6) * 9)
    few = FeatureSet(replace(points, roles=("control",) * 6), empty_lines(), "EPSG:4979")
    assert termsel.run("rfm-terms", features=few).outliers == ()


@pytest.mark.slow
def test_clean_scenes_have_no_blunders() -> None:
    named = 0
    for seed in range(10):
        observations = observations_by_role(scene({}, 27, seed))
        verdict = judge_features(observations, Auto())
        mine, _ = judge_independent(observations, Auto().choose(observations.pool))
        named += bool(verdict.blunders or mine.outliers)
    assert named <= 1
