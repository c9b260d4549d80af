"""The proven optimum of a selection of control features."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import termsel
from termsel.data.features import FeatureSet
from termsel.data.record.figures import as_plain_data
from termsel.selection.best_subsets.features.walk import Branch, RowSystem, Selections
from termsel.selection.solvers.proofs.exact_features import (
    duration_in_words,
    prove_features,
    selections_of,
)


def random_systems(rng: np.random.Generator, n: int, *, ill: bool) -> tuple[RowSystem, ...]:
    """Return one or two systems; features have up to three rows, of which some may be dependent."""
    found = []
    for _ in range(rng.integers(1, 3)):
        k = int(rng.integers(1, 5))
        each = rng.integers(1, 4, n) if rng.random() < 0.5 else np.ones(n, dtype=int)
        feature = np.repeat(np.arange(n), each)
        if rng.random() < 0.3:  # pseudo-observations
            feature = np.concatenate([feature, [-1] * k])
        A, C = rng.normal(size=(len(feature), k)), rng.normal(size=(k + 4, k))
        x = rng.normal(size=k)
        if ill:
            twins = rng.integers(0, len(A), (3, 2))
            A[twins[:, 0]] = A[twins[:, 1]] * (1 + 10.0 ** rng.integers(-12, -1, (3, 1)))
            scale = 10.0 ** rng.integers(-2, 3, k)
            A, C, x = A * scale, C * scale, x / scale
        found.append(RowSystem(A, A @ x + rng.normal(scale=0.1, size=len(A)), feature, C,
                               C @ x + rng.normal(scale=0.1, size=len(C)),
                               k if feature[-1] < 0 else 0))
    return tuple(found)


def squares(systems: tuple[RowSystem, ...], mask: np.ndarray) -> float:
    """Return the squared errors of the check points by LAPACK; infinite if not determined."""
    total = 0.0
    for one in systems:
        rows = (one.feature < 0) | mask[one.feature]
        A = one.design[rows] / np.linalg.norm(one.design, axis=0)
        if (rows & (one.feature >= 0)).sum() < A.shape[1] \
                or np.linalg.matrix_rank(A, tol=1e-11) < A.shape[1]:
            return np.inf
        x = np.linalg.lstsq(one.design[rows], one.target[rows], rcond=None)[0]
        total += ((one.check_target - one.check_design @ x)**2).sum()
    return total


@pytest.mark.parametrize("ill", [False, True])
def test_every_selection_is_walked_once_and_scored_as_lapack_does(ill: bool) -> None:
    rng = np.random.default_rng(19)
    scored = 0
    for _ in range(160):
        n = int(rng.integers(4, 8))
        systems = random_systems(rng, n, ill=ill)
        on = rng.random(n) < 0.15
        off = ~on & (rng.random(n) < 0.15)
        least = int(rng.integers(0, 4))
        most = int(rng.integers(max(least, on.sum()), n + 1))
        space = Selections(n, least, most, on, off, systems)
        found: dict[tuple[bool, ...], float] = {}
        for branch in (space.halves(space.root) if len(space.free) else [space.root]):
            chosen, scores = space.walk(branch, np.full(n + 1, np.inf))
            rows = list(map(tuple, chosen.tolist()))
            assert not found.keys() & set(rows)
            found.update(zip(rows, scores.tolist(), strict=True))
        wanted = [bits for bits in itertools.product([False, True], repeat=n)
                  if least <= sum(bits) <= most and not (np.array(bits) & off).any()
                  and not (on & ~np.array(bits)).any()]
        assert space.count(space.root) == len(wanted)
        for bits in wanted:
            expected = squares(systems, np.array(bits))
            if bits not in found:
                assert expected == np.inf
            elif np.isfinite(found[bits]):
                scored += 1
                # 1e-4 is the margin by which the search keeps more than the best.
                assert found[bits] == pytest.approx(expected, rel=1e-5, abs=1e-9)
        assert found.keys() <= set(wanted)
    assert scored > 1800


def test_selections_above_their_limit_are_ruled_out_and_no_others() -> None:
    rng = np.random.default_rng(3)
    systems = random_systems(rng, 9, ill=False)
    space = Selections(9, 0, 9, np.zeros(9, dtype=bool), np.zeros(9, dtype=bool), systems)
    everything, scores = space.walk(space.root, np.full(10, np.inf))
    limits = np.full(10, np.median(scores))
    limits[6] = 0.0
    kept, _ = space.walk(space.root, limits)
    within = scores <= limits[everything.sum(axis=1)]
    assert {tuple(row) for row in everything[within].tolist()} == set(map(tuple, kept.tolist()))
    assert space.count(Branch((0, 3), 5)) == len(space.walk(
        Branch((0, 3), 5), np.full(10, np.inf))[0]) == 16


def rmse_of_affine(scene: FeatureSet, chosen: tuple[int, ...]) -> float:
    """Return the selection RMSE of the affine model of some control points, by LAPACK."""
    points, roles = scene.points, np.array(scene.points.roles)
    middle = points.ground.mean(axis=0)
    A = np.column_stack([np.ones(len(points)), (points.ground - middle) / 1000])
    control, check = A[roles == "control"][list(chosen)], A[roles == "check"]
    if np.linalg.matrix_rank(control) < 4:
        return np.inf
    x = np.linalg.lstsq(control, points.image[roles == "control"][list(chosen)], rcond=None)[0]
    return float(np.sqrt(((check @ x - points.image[roles == "check"])**2).sum(axis=1).mean()))


@pytest.fixture(scope="module")
def scene() -> FeatureSet:
    """Return 12 control points, 12 check points and 11 lines."""
    features = termsel.simulate_scene("ikonos-hamedan", n_points=36, n_lines=11)
    roles = tuple(("control", "check", "independent")[i % 3] for i in range(36))
    return replace(features, points=replace(features.points, roles=roles))


def test_m_of_n_points_are_those_of_brute_force(scene: FeatureSet) -> None:
    result = termsel.run("owdis-points", features=scene, model="affine", solver="exact",
                         options={"min_features": 6, "max_features": 6, "blunders": "keep"})
    each = {chosen: rmse_of_affine(scene, chosen)
            for chosen in itertools.combinations(range(12), 6)}
    best = min(each, key=each.__getitem__)
    ids = [one for one, role in zip(scene.points.ids, scene.points.roles, strict=True)
           if role == "control"]
    assert result.selection.features == tuple(ids[i] for i in best)
    assert result.objectives["check-rmse"] == pytest.approx(each[best], rel=1e-7)
    assert as_plain_data(result.certificate) == {
        "optimal": True, "subsets": 924, "bounded": 0, "of": 924, "gap": 0.0,
        "space": "all selections of 6 of 12 features", "bound": result.objectives["check-rmse"]}
    assert "Proven: no selection of 6 of 12 features has a better criterion (924 subsets " \
        "enumerated)" in result.summary(verbose=True)


CASES = {
    "points": ("owdis-points", {"degree": 1}),
    "quadratic, few points": ("owdis-points", {"degree": 2, "max_features": 11}),
    "lines": ("owdis-lines", {"degree": 1}),
    "spread": ("owdis-points", {"degree": 1, "max_uncovered": 0.5, "max_features": 7}),
    "forced": ("owdis-points", {"degree": 1, "force_on": "FIRST", "force_off": "LAST"}),
    "terms": ("owdis-lines", {"degree": 2, "min_features": 4, "max_features": 9,
                              "terms": "line:1,line:X,line:Y,sample:1,sample:X,sample:Y"}),
}


@pytest.mark.parametrize("case", CASES)
def test_the_best_of_every_size_is_that_of_brute_force(case: str, scene: FeatureSet) -> None:
    name, options = CASES[case]
    problem = prepared(name, options, scene)
    systems = problem.row_systems()
    assert systems
    space = selections_of(problem, systems)
    *_, proof = prove_features(problem, space, workers=2)
    masks = np.array(list(itertools.product([False, True], repeat=problem.genome.size)))
    judged = problem.evaluate(problem.genome.repair(masks, np.random.default_rng(0)))
    own = (problem.genome.repair(masks, np.random.default_rng(0)) == masks).all(axis=1)
    objectives = np.where(own & (judged.violation == 0), judged.objectives[:, 0], np.inf)
    assert (proof.decided, proof.total) == (own.sum(), own.sum())
    for size in range(problem.genome.size + 1):
        least = objectives[masks.sum(axis=1) == size].min(initial=np.inf)
        assert proof.best[size] == pytest.approx(least, rel=1e-11)
    assert 0 < proof.floor <= objectives.min()
    assert np.isfinite(objectives.min())


@pytest.mark.slow_cases("press-False")
@pytest.mark.parametrize(("criterion", "has_bound"), [("check-rmse", True), ("press", False)])
def test_before_its_end_a_proof_bounds_no_size_but_by_what_it_knows_of_all(
        criterion: str, has_bound: bool, scene: FeatureSet) -> None:
    problem = prepared("owdis-points", {"degree": 1, "max_features": 7}, scene, criterion=criterion)
    first, *_, last = prove_features(problem, selections_of(problem, problem.row_systems()))
    of_sizes = first.by_size(problem)
    assert of_sizes
    assert not any(size.optimal for size in of_sizes)
    assert {size.bound for size in of_sizes} == {first.floor if has_bound else None}
    assert all(size.optimal and size.bound == size.objective for size in last.by_size(problem))


def prepared(name: str, options: dict, scene: FeatureSet, **given: object) -> termsel.Problem:
    kind = scene.lines.ids if "lines" in name else tuple(
        one for one, role in zip(scene.points.ids, scene.points.roles, strict=True)
        if role == "control")
    named = {key: {"FIRST": kind[0], "LAST": kind[-1]}.get(value, value) if isinstance(value, str)
             else value for key, value in options.items()}
    if "terms" in named:
        named["terms"] = named["terms"].replace("line:", "line.num:").replace(
            "sample:", "sample.num:")
    return termsel.prepare(name, features=scene, solver="exact", options=named, **given).problem


@pytest.mark.parametrize(("criterion", "model"), [("press", "poly3d"), ("check-rmse", "rfm")])
def test_what_has_no_score_is_evaluated(criterion: str, model: str, scene: FeatureSet) -> None:
    options = {"degree": 1} if model == "poly3d" else {"order": 1}
    task = termsel.prepare("owdis-lines", features=scene, solver="exact", criterion=criterion,
                           model=model, options={**options, "blunders": "keep"})
    assert task.problem.row_systems() == ()
    result = termsel.run(task)
    masks = np.array(list(itertools.product([False, True], repeat=task.problem.genome.size)))
    judged = task.problem.evaluate(masks)
    least = judged.objectives[judged.violation == 0, 0].min()
    assert result.objectives[criterion] == pytest.approx(least, rel=1e-11)
    assert result.certificate.optimal
    assert result.certificate.subsets == len(masks)


def test_an_objective_of_a_plugin_is_evaluated(scene: FeatureSet) -> None:
    class Few(termsel.SelectionProblem):
        """Prefers the first features, whatever their RMSE."""

        def evaluate(self, genes: np.ndarray) -> termsel.Evaluation:
            found = super().evaluate(genes)
            worth = 2.0 ** np.arange(genes.shape[1])
            return replace(found, objectives=1.0 + genes @ worth[:, None])

    task = termsel.prepare("owdis-points", features=scene, model="affine", solver="exact")
    problem = Few(task.problem.inputs, terms=False, features=True)
    found = termsel.search(problem, task.solver)
    assert found.certificate["optimal"]
    assert found.genes[:5].all()  # 5 points leave redundancy
    assert not found.genes[5:].any()


def test_at_any_time_there_is_a_bound(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", logger="termsel")
    task = termsel.prepare("owdis-points", solver="exact", options={"max_features": 12,
                                                                    "degree": 1})
    seen: list[dict] = []

    def stop(progress: termsel.Progress) -> None:
        seen.append(dict(progress.generation.details["certificate"]))
        if len(seen) == 4:
            raise KeyboardInterrupt

    found = termsel.search(task.problem, task.solver, observers=[stop])
    assert ("exact: 9,740,686 subsets to enumerate or exclude by bounds "
            "(all selections of up to 12 of 24 features)") \
        in caplog.text
    assert found.interrupted
    assert found.certificate == seen[3]
    decided = [one["subsets"] for one in seen]
    assert decided == sorted(decided)
    assert 0 < decided[-1] < seen[0]["of"] == 9_740_686
    for one in seen:
        assert not one["optimal"]
        assert 0 < one["bound"] <= found.objectives[0]
    assert found.objectives[0] == pytest.approx(seen[3]["bound"] * (1 + seen[3]["gap"]))


def test_a_heuristic_is_told_how_far_from_the_optimum_it_ended(scene: FeatureSet) -> None:
    given = {"features": scene, "model": "affine", "options": {"blunders": "keep"}}
    optimum = termsel.run("owdis-points", solver="exact", **given).objectives["check-rmse"]
    poor = termsel.run("owdis-points", solver="random", evaluations=3, **given)
    assert poor.certificate.optimum == optimum
    assert poor.certificate.gap == pytest.approx(poor.objectives["check-rmse"] / optimum - 1)
    good = termsel.run("owdis-points", solver="swap", evaluations=3000, **given)
    assert good.certificate.optimal


def test_that_nothing_is_feasible_is_proven(scene: FeatureSet) -> None:
    result = termsel.run("owdis-points", features=scene, model="affine", solver="exact",
                         options={"max_uncovered": 0.0, "max_features": 5, "blunders": "keep"})
    assert not result.feasible
    assert as_plain_data(result.certificate) == {
        "optimal": False, "feasible": False, "subsets": 1586, "bounded": 0, "of": 1586,
        "space": "all selections of up to 5 of 12 features"}


@pytest.mark.parametrize(("seconds", "words"), [
    (0.01, "0.1 s"), (90, "90.0 s"), (120, "2 min"), (7200, "2 h"), (1e9, "32 years"),
    (1e33, "more than a million years")])
def test_a_time_in_words(seconds: float, words: str) -> None:
    assert duration_in_words(seconds) == words


def test_the_number_of_workers_changes_nothing(scene: FeatureSet) -> None:
    runs = [termsel.run("owdis-points", features=scene, model="affine", solver="exact",
                        options={"workers": workers}) for workers in (1, 3)]
    one, three = ({**run.to_dict(), "seconds": 0, "options": 0} for run in runs)
    assert one["selection"] == three["selection"]
    assert (one["evaluations"], one["certificate"]) == (three["evaluations"], three["certificate"])


@pytest.mark.parametrize(("options", "message"), [
    ({"max_terms": 3}, "max_terms limits terms, and this problem selects features"),
    ({"workers": 0}, "workers"),
    ({"min_features": 30}, "there are 24 control features")])
def test_what_cannot_be_asked_for_is_refused(options: dict, message: str) -> None:
    with pytest.raises(termsel.TermselError, match=message):
        termsel.run("owdis-points", solver="exact", options=options)


def test_too_many_features_are_refused() -> None:
    with pytest.raises(termsel.TermselError, match="selections of 150 features cannot be"):
        termsel.run("owdis-lines", solver="exact", features=termsel.simulate_scene(
            "ikonos-hamedan", n_lines=150), options={"blunders": "keep"})


def test_the_command_line_proves_m_of_n(call: Callable[..., SimpleNamespace]) -> None:
    done = call("run", "--problem", "owdis-points", "--model", "affine", "--solver",
                "exact", "--set", "min_features=5", "--set", "max_features=5", "--json")
    assert done.exit_code == 0
    certificate = json.loads(done.stdout)["certificate"]
    assert certificate["optimal"]
    assert certificate["of"] == 42504
    assert certificate["space"] == "all selections of 5 of 24 features"
