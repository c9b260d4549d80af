"""Selection of features in full: doubts, forced features, given terms, steps, directions."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import termsel
from termsel.adjustment.equations import line_normals
from termsel.data.features import Lines
from termsel.data.rpc import Rpc
from termsel.fitting.figures import correlated_terms, orientation_spread, term_significance
from termsel.runs import steps
from termsel.runs.steps import search_in_steps
from termsel.simulate import simulate_scene

QUICK = {"population": 40, "polish": False}


def run(problem: str = "owdis-lines", **options: object) -> termsel.Result:
    return termsel.run(problem, generations=8, options={**QUICK, **options})


def test_blunders_are_told_from_lines_not_needed() -> None:
    result = run(population=100)
    # Eight lines of the scene are matched wrongly, by several pixels.
    wrong = {"L005", "L006", "L027", "L049", "L050", "L086", "L098", "L099"}
    assert {one.id for one in result.outliers} == wrong
    spare = set(result.fit.control.ids) - set(result.selection.features) - wrong
    assert f"{len(spare)} more lines fit but were not selected." in result.summary(verbose=True)
    assert all(one["certainty"] == "certain" for one in result.to_dict()["outliers"])


@pytest.mark.slow
def test_forced_features_and_given_terms() -> None:
    names = ("line.num:1", "line.num:X", "line.num:Y", "sample.num:1", "sample.num:X",
             "sample.num:Y", "line.num:Z", "sample.num:Z")
    result = run(force_on="L006,L001", force_off="L002", terms=",".join(names))
    assert {"L001", "L006"} <= set(result.selection.features)
    assert "L002" not in result.selection.features
    assert set(result.selection.terms) == set(names)
    both = run("owdis-lines-terms", force_on="L006,line.den:X", force_off="L002,XY")
    assert "L006" in both.selection.features
    assert "L002" not in both.selection.features
    assert "line.den:X" in both.selection.terms
    assert not [term for term in both.selection.terms if term.endswith(":XY")]


@pytest.mark.parametrize(("options", "message"), [
    ({"force_on": "L9999"}, "unknown feature 'L9999'"), ({"terms": "num"}, "unknown term 'num'"),
    ({"force_on": "L001", "force_off": "L001"}, "forced both on and off")])
def test_names_that_are_not_there(options: dict[str, str], message: str) -> None:
    with pytest.raises(termsel.TermselError, match=message):
        run(**options)


def test_terms_first_then_features() -> None:
    result = run("owdis-lines-terms", steps="terms-first", blunders="keep")
    assert result.notes[0].startswith("In two steps: terms first, check-rmse ")
    assert result.generations == 8
    # The first step by itself, of the same seed, finds the same terms.
    task = termsel.prepare("owdis-lines-terms", options={**QUICK, "steps": "terms-first"})
    genome = task.problem.genome
    is_feature = np.arange(genome.size) >= genome.slices()["features"].start
    alone = termsel.search(task.problem.frozen(np.ones(genome.size, dtype=bool), is_feature),
                           task.solver, generations=4)
    assert task.problem.decode(alone.genes).terms == result.selection.terms
    assert task.problem.decode(alone.genes).features == task.observations.control.ids


def test_features_first_then_terms() -> None:
    result = termsel.run("owdis-lines-terms", model="poly3d", generations=8,
                         options={**QUICK, "steps": "features-first"})
    assert result.notes[0].startswith("In two steps: features first")
    assert len(result.selection.features) < 120
    assert len(result.selection.terms) < 20


def test_each_step_has_a_solver_and_options_of_its_own() -> None:
    options = {"steps": "features-first", "solver.population": 30, "then.population": 7,
               "blunders": "keep"}
    result = termsel.run("owdis-lines-terms", model="poly3d", solver="ga", generations=8,
                         options={**options, "then": "pso"})
    assert result.notes[0].startswith("In two steps: features first by ga, check-rmse ")
    assert "; then the rest by pso, " in result.notes[0]
    record = result.to_dict()["options"]
    assert (record["problem"]["then"], record["then"]["population"]) == ("pso", 7)
    # The first step is that of a run without the option; the particles search from there on.
    task = termsel.prepare("owdis-lines-terms", model="poly3d", solver="pso", options={
        "population": 7, "polish": False, "steps": "features-first"})
    chosen = result.selection.features
    is_feature = np.arange(task.problem.genome.size) >= task.problem.genome.slices()[
        "features"].start
    genes = is_feature & np.isin(task.problem.genome.labels, chosen)
    alone = termsel.search(task.problem.frozen(genes, is_feature), task.solver, generations=4)
    assert task.problem.decode(alone.genes).terms == result.selection.terms


def test_two_steps_share_a_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    task = termsel.prepare("owdis-lines-terms", model="poly3d", options={
        "steps": "terms-first", "then": "random", "degree": 1, "polish": False,
        "solver.population": 10})
    seen: list[int] = []
    found = search_in_steps(task, evaluations=400, observers=[
        lambda progress: seen.append(progress.evaluations)])
    assert found.evaluations == 400
    assert max(seen) == 200  # of one step
    monkeypatch.setattr(steps, "EVALUATIONS", 300)
    assert search_in_steps(task).evaluations == 300
    # The second step has all that the first did not spend.
    assert search_in_steps(task, evaluations=401).evaluations == 401
    # Both steps share a small budget, too.
    assert search_in_steps(task, evaluations=5).evaluations == 5
    assert "then the rest by random" in search_in_steps(task, seconds=1e-6).notes[0]


@pytest.mark.parametrize(("then", "options", "said"), [
    ("exact", {}, "'exact' cannot do the second step: .* such as then='ga'"),
    ("ridge", {}, "'ridge' cannot do the second step"),
    ("ga-correlation", {}, "'ga-correlation' cannot .* such as then='ga'"),
    ("deap", {"then.select": "selMagic"}, "selMagic")])
def test_a_solver_that_cannot_do_the_second_step_is_refused_before_the_first(
        then: str, options: dict[str, str], said: str) -> None:
    seen: list[object] = []
    with pytest.raises(termsel.TermselError, match=said) as error:
        termsel.run("owdis-lines-terms", generations=2, observers=[seen.append], options={
            "polish": False, "steps": "features-first", "then": then, **options})
    assert not seen
    assert "--solver" not in str(error.value)


@pytest.mark.parametrize(("given", "message"), [
    ({"then": "pso"}, "steps=joint has one. Add steps='features-first'"),
    ({"then.population": 9}, "then.population is for .* steps=joint has one"),
    ({"then.population": 9, "steps": "terms-first"}, "and then names none"),
    ({"then": "swarm", "steps": "terms-first"}, "unknown solver 'swarm'"),
    ({"then": "nsga2", "steps": "terms-first"}, "'nsga2' cannot handle 1 objective.*Choose one"),
    ({"then": "pso", "steps": "terms-first", "population": 9}, "write|Write solver.population")])
def test_a_second_solver_that_cannot_be(given: dict[str, object], message: str) -> None:
    with pytest.raises(termsel.TermselError, match=message):
        termsel.prepare("owdis-lines-terms", options=given)


@pytest.mark.parametrize("key", ["then", "problem.then", "then.population"])
def test_a_problem_without_steps_says_so(key: str) -> None:
    with pytest.raises(termsel.TermselError, match="problem 'poly-terms' has no steps"):
        termsel.prepare("poly-terms", options={key: "pso"})


@pytest.mark.slow
def test_terms_alone_with_lines_as_control() -> None:
    result = run("rfm-terms-lines", order=2)
    assert len(result.selection.features) == 120
    assert len(result.selection.terms) < 38
    assert result.fit.control.lines.ids == result.selection.features


def test_two_steps_are_for_one_objective() -> None:
    with pytest.raises(termsel.TermselError, match="is for one objective, and there are 2"):
        termsel.run("owdis-lines-terms", solver="nsga2", options={"steps": "terms-first"})


def test_orientation_spread_by_hand() -> None:
    def spread(*degrees: float) -> float:
        angle = np.radians(degrees)
        ends = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        n = len(degrees)
        ground = np.arange(6.0 * n).reshape(n, 2, 3)
        return orientation_spread(Lines(tuple("abcd"[:n]), np.stack([0 * ends, ends], axis=1),
                                        ground))

    assert spread(20, 20, 200) == pytest.approx(0, abs=1e-12)
    assert spread(0, 90) == pytest.approx(1)
    assert spread(0, 60, 120) == pytest.approx(1)
    assert spread(0, 45) == pytest.approx(1 - np.sqrt(0.5))


@pytest.mark.slow
def test_parallel_lines_are_refused(tmp_path: Path) -> None:
    rows = ["id,line1,sample1,line2,sample2,x1,y1,z1,x2,y2,z2"]
    rng = np.random.default_rng(0)
    for i, (x, y) in enumerate(rng.uniform(0, 1000, (40, 2))):
        rows.append(f"L{i},{y},{x},{y + 50},{x},{x},{y},0,{x},{y + 50},0")
    points = ["id,role,line,sample,x,y,z"] + [
        f"P{i},{role},{y},{x},{x},{y},0" for i, (role, (x, y)) in enumerate(zip(
            ["check", "independent"] * 10, rng.uniform(0, 1000, (20, 2)), strict=True))]
    (tmp_path / "l.csv").write_text("\n".join(rows))
    (tmp_path / "p.csv").write_text("\n".join(points))
    done = subprocess.run(
        [sys.executable, "-m", "termsel", "run", "--problem", "owdis-lines", "--model", "affine",
         "--lines", str(tmp_path / "l.csv"), "--points", str(tmp_path / "p.csv"), "--crs",
         "local"], capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert done.stderr == (
        "Error: all control lines are parallel in the image, so nothing is measured along them. "
        "Add lines of another direction, or control points with --set mixed=true.\n")


def test_significance_is_that_of_a_textbook_regression() -> None:
    result = termsel.run("poly-terms", generations=2, options={**QUICK, "degree": 2})
    fit = result.fit
    equations = fit.model.equations(fit.scaling.features(fit.control))
    line = np.flatnonzero(fit.terms & (fit.model.axis == 0))
    rows = (equations.A[:, line] != 0).any(axis=1)
    A, b = equations.A[np.ix_(rows, line)], equations.b[rows]
    inverse = np.linalg.inv(A.T @ A)
    x = inverse @ A.T @ b
    # The adjustment has one sigma for both axes.
    t = np.abs(x) / np.sqrt(np.diag(inverse)) / fit.adjustment.sigma0
    expected = 2 * stats.t.sf(t, fit.adjustment.redundancy)
    found = term_significance(fit)
    for i, value, p in zip(line, t, expected, strict=True):
        one = found[fit.model.terms[i]]
        assert one.t == pytest.approx(value, rel=1e-6)
        assert one.p == pytest.approx(p, rel=1e-6, abs=1e-300)
    deviation = np.sqrt(np.diag(inverse))
    matrix = inverse / np.outer(deviation, deviation)
    assert fit.adjustment.correlations is not None
    place = {int(j): i for i, j in enumerate(np.flatnonzero(fit.terms))}
    index = [place[int(j)] for j in line]
    assert fit.adjustment.correlations[np.ix_(index, index)] == pytest.approx(matrix, abs=1e-6)
    assert all(abs(value) >= 0.95 for *_, value in correlated_terms(fit))


@pytest.mark.slow
@pytest.mark.parametrize(("scene", "name"), [("ventoux_lines", "pleiades_ventoux_left"),
                                             ("ikonos_lines", "ikonos_montevideo")])
def test_blunders_of_real_geometry_are_found(data_folder: Path, scene: str,
                                                name: str) -> None:
    records = json.loads((data_folder / "rpc" / "all_rpc.json").read_text())
    values = next(one["rpc"] for one in records if one["name"] == name)
    rpc = Rpc((values["LINE_OFF"], values["SAMP_OFF"]),
              (values["LINE_SCALE"], values["SAMP_SCALE"]),
              (values["LONG_OFF"], values["LAT_OFF"], values["HEIGHT_OFF"]),
              (values["LONG_SCALE"], values["LAT_SCALE"], values["HEIGHT_SCALE"]),
              *(tuple(values[key]) for key in ("LINE_NUM", "LINE_DEN", "SAMP_NUM", "SAMP_DEN")))
    features = termsel.read(points=data_folder / scene / "points.csv",
                            lines=data_folder / scene / "lines.csv", crs="EPSG:4979")
    normal, rho = line_normals(features.lines)
    image = rpc.project(features.lines.ground.reshape(-1, 3)).reshape(-1, 2, 2)
    error = np.abs(np.einsum("ia,iva->iv", normal, image) - rho[:, None]).max(axis=1)
    ids = np.array(features.lines.ids)
    displaced, gross = set(ids[error > 3]), set(ids[error > 5.5])
    result = termsel.run("owdis-lines-terms", features=features)
    found = {one.id for one in result.outliers}
    assert gross <= found
    assert len(gross) >= 10
    assert len(displaced & found) >= 0.7 * len(displaced)
    assert len(found - displaced) <= 3
    assert result.rmse["independent"].total < 1.1 * {"ventoux_lines": 1.33,
                                                     "ikonos_lines": 0.96}[scene]


@pytest.mark.slow
def test_lines_are_selected_under_all_terms_of_an_rfm() -> None:
    """Denominators held near zero have no poles; without that there is next to no way."""
    held, free = (termsel.run("owdis-lines", model="rfm", generations=8,
                              options={**QUICK, "order": 2, "ridge": ridge})
                  for ridge in (None, 0.0))
    assert held.feasible
    assert not free.feasible
    assert any("of weight 0.01 hold coefficients" in note for note in held.notes)
    assert not any("Pseudo-observations" in note for note in free.notes)
    assert len(held.selection.terms) == 38
    below = np.array([".den" in term for term in held.fit.model.terms])
    assert np.abs(held.fit.adjustment.coefficients[below]).max() < 0.1
    everything = held.baselines[0].rmse["independent"]
    assert held.rmse["independent"].total < everything.total / 2


@pytest.mark.slow
def test_all_terms_of_an_rfm_do_by_the_defaults() -> None:
    found = [termsel.run("owdis-lines-terms", options={"order": 3}, features=simulate_scene(
        "ikonos-hamedan", seed=seed)).rmse["independent"].total for seed in range(1, 21)]
    assert np.median(found) <= 1.1, sorted(found)


def test_what_is_not_so_of_pseudo_observations_is_not_said() -> None:
    """All 78 terms of 48 equations are determined with them, and yet infeasible."""
    options = {"ridge": 0.01}
    every = termsel.run("rfm-terms", solver="all-terms", options=options)
    assert not every.feasible
    assert "too many terms" in every.judgement
    assert any("of weight 0.01" in note for note in every.notes)
    assert not any("minimised an RMSE" in note for note in every.notes)
    shrunk = termsel.run("rfm-terms", solver="ga", generations=2,
                         options={**QUICK, **options, "shrink": True})
    assert not any("Pseudo-observations" in note for note in shrunk.notes)
