"""From names to a Result, through the public API."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import termsel
from termsel.core.errors import TermselError
from termsel.data.features import FeatureSet, Points
from termsel.data.record.figures import as_plain_data
from termsel.simulate import simulate_scene

PROBLEMS = ("rfm-terms", "rfm-terms-lines", "poly-terms", "owdis-points", "owdis-lines",
            "owdis-points-terms", "owdis-lines-terms")


def quick(problem: str, **more: object) -> termsel.Result:
    given = {"generations": 8, "options": {"population": 60}, **more}
    return termsel.run(problem, **given)


@pytest.mark.slow_cases("owdis-lines-terms", "rfm-terms-lines")
@pytest.mark.parametrize("problem", PROBLEMS)
def test_a_problem_runs_by_its_name_alone(problem: str) -> None:
    result = quick(problem)
    assert result.feasible
    assert result.problem == problem
    # The search sees lines under separate denominators to first order.
    allowed = 0.1 if problem in ("owdis-lines-terms", "rfm-terms-lines") else 1e-9
    assert result.rmse["check"].total == pytest.approx(result.objectives["check-rmse"],
                                                       rel=allowed)
    assert set(result.rmse) == {"control", "check", "independent"}
    assert result.baselines[0].name == "all-terms"
    assert "independent check points" in result.judgement


@pytest.mark.slow
def test_selected_lines_beat_all_lines_on_independent_points() -> None:
    result = termsel.run("owdis-lines", seed=1)
    everything = result.baselines[0].rmse["independent"].total
    assert result.rmse["independent"].total < 0.7 * everything
    assert as_plain_data(result.data.counts) == {"control": 0, "check": 24, "independent": 26,
                                                 "lines": 120, "off": 24}
    assert any("control points of the file are unused" in note for note in result.notes)


def test_independent_figures_are_recomputed_by_hand() -> None:
    result = quick("poly-terms")
    points = simulate_scene("ikonos-hamedan").points
    independent = points.take([role == "independent" for role in points.roles])
    s = result.to_dict()["scaling"]
    x = (independent.ground[:, 0] - s["x_offset"]) / s["x_scale"]
    y = (independent.ground[:, 1] - s["y_offset"]) / s["y_scale"]
    computed = np.zeros((len(x), 2))
    for term, coefficient in result.to_dict()["coefficients"].items():
        axis, monomial = term.split(".num:")
        column = np.ones_like(x)
        for letter, values in (("X", x), ("Y", y)):
            if letter in monomial:
                power = monomial.partition(letter)[2][:1]
                column = column * values ** (int(power) if power.isdigit() else 1)
        computed[:, ("line", "sample").index(axis)] += coefficient * column
    computed = computed * s["line_scale"] + [s["line_offset"], s["sample_offset"]]
    error = computed - independent.image
    assert result.rmse["independent"].total == pytest.approx(
        np.sqrt((error**2).sum(axis=1).mean()), rel=1e-9)


def but_independent(result: termsel.Result) -> dict:
    """Return a result without what independent points say."""
    record = result.to_dict()
    for figures in (record, *record["baselines"], *record["front"]):
        assert figures["rmse"].pop("independent")["n"] > 0
    for figures in record.get("by_size", ()):  # some are those of the front
        figures["rmse"].pop("independent", None)
    # The final fit is made after all figures, and takes independent points on purpose.
    for varying in ("judgement", "seconds", "accuracy", "final", "exported"):
        record.pop(varying)
    record.pop("accuracy_without", None)
    record["outliers"] = [one for one in record["outliers"] if one["role"] != "independent"]
    record["data"].pop("sha256")
    record["notes"] = [note for note in record["notes"] if "independent RMSE" not in note
                       and "independent check points contradict" not in note]
    return record


SMALL = {"population": 30, "polish": False}
PATHS = {
    "auto": ("rfm-terms", {}),
    "auto, plane": ("poly-terms", {}),
    "auto, blank roles": ("rfm-terms", {"options": {"split": 3}}),
    "auto, coordinates too": ("rfm-terms", {"options": {"fit_crs": "auto"}}),
    "auto, projected coordinates": ("rfm-terms", {"options": {"fit_crs": "projected"}}),
    "lines, projected coordinates": ("owdis-lines", {"options": {
        "population": 30, "polish": False, "fit_crs": "projected"}, "generations": 4}),
    "ga": ("rfm-terms", {"solver": "ga", "options": SMALL, "generations": 4}),
    "ga, assigned again": ("rfm-terms", {"solver": "ga", "generations": 4,
                                          "options": {**SMALL, "roles": "random"}}),
    "polish": ("poly-terms", {"generations": 2}),
    "press": ("poly-terms", {"criterion": "press", "options": SMALL, "generations": 3}),
    "nsga2": ("rfm-terms", {"solver": "nsga2", "options": SMALL, "generations": 4}),
    "knee": ("rfm-terms", {"solver": "nsga2", "options": {**SMALL, "recommend": "knee"},
                           "generations": 4}),
    "exact": ("poly-terms", {"solver": "exact", "options": {"degree": 3, "recommend": "ebic"}}),
    "ridge": ("rfm-terms", {"solver": "ridge"}),
    "shrink": ("poly-terms", {"solver": "ga", "options": {**SMALL, "shrink": True},
                              "generations": 3}),
    "points": ("owdis-points", {"options": SMALL, "generations": 4}),
    "lines": ("owdis-lines", {"options": SMALL, "generations": 4}),
    "steps": ("owdis-lines-terms", {"options": {**SMALL, "steps": "terms-first"},
                                    "generations": 4}),
}


def scene_of(path: str) -> FeatureSet:
    """Return a scene with a point that takes no part."""
    features = simulate_scene("ikonos-hamedan", roles=(24, 24, 20), n_lines=60)
    if "blank" in path:
        return features.with_(points=replace(features.points, roles=()))
    off = Points(("off",), [[0.0, 0.0]], [[48.5, 34.0, 9.0]], roles=("off",))
    return features.with_(points=features.points.join(off))


@pytest.mark.slow_cases(
    "auto, blank roles", "auto, coordinates too", "auto, plane", "auto, projected coordinates",
    "ga", "ga, assigned again", "lines", "lines, projected coordinates", "nsga2", "steps")
@pytest.mark.parametrize("path", PATHS)
def test_independent_points_change_nothing_but_their_own_rmse(path: str) -> None:
    """Nor does a point that takes no part; by none is anything chosen, scaled or projected."""
    problem, given = PATHS[path]
    features = scene_of(path)
    first = termsel.run(problem, features=features, **given)
    points = features.points
    independent = np.isin(points.ids, first.data.roles.independent)
    image, ground = points.image.copy(), points.ground.copy()
    image[independent] += [400.0, -70.0]
    if "blank" not in path and "again" not in path:  # their roles depend on places
        ground[independent] += [140.0, -60.0, 3000.0]
        ground[points.ids.index("off"), 0] = -140.0
    second = termsel.run(problem, features=features.with_(
        points=replace(points, image=image, ground=ground)), **given)
    assert first.rmse["independent"].total < 0.8 * second.rmse["independent"].total
    assert but_independent(first) == but_independent(second)
    of_others = [[r for r in result.residuals if r.role != "independent"]
                 for result in (first, second)]
    assert of_others[0] == of_others[1]


@pytest.mark.slow
def test_same_seed_same_selection_also_in_another_process() -> None:
    result = quick("rfm-terms", seed=5)
    assert quick("rfm-terms", seed=5).selection == result.selection
    assert quick("rfm-terms", seed=6).selection != result.selection
    code = ("import termsel; r = termsel.run('rfm-terms', seed=5, generations=8, "
            "options={'population': 60}); print(' '.join(r.selection.terms))")
    there = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True,
                           check=True)
    assert tuple(there.stdout.split()) == result.selection.terms


def test_mixed_control_uses_points_and_lines() -> None:
    result = quick("owdis-lines", options={"population": 60, "mixed": True, "polish": False})
    assert result.data.counts.control == 24
    assert len(result.fit.control) == 144


def test_shared_mask_selects_the_same_monomials_for_both_axes() -> None:
    result = quick("poly-terms", options={"population": 60, "mask": "shared"})
    line = {t.split(":")[1] for t in result.selection.terms if t.startswith("line")}
    sample = {t.split(":")[1] for t in result.selection.terms if t.startswith("sample")}
    assert line == sample


def test_without_independent_points_the_accuracy_is_said_to_be_unknown() -> None:
    features = simulate_scene("irs1c-mashad")
    roles = tuple("off" if role == "independent" else role for role in features.points.roles)
    points = replace(features.points, roles=roles)
    result = quick("poly-terms", features=features.with_(points=points))
    assert result.rmse["independent"] is None
    assert result.to_dict()["rmse"]["independent"] == {"line": None, "sample": None,
                                                       "total": None, "n": 0}
    assert "accuracy of this selection is not known" in result.judgement


@pytest.mark.slow
@pytest.mark.usefixtures("clock")
def test_budgets_are_honoured() -> None:
    assert termsel.run("poly-terms", evaluations=333).evaluations == 333
    assert termsel.run("poly-terms", generations=3).generations == 3
    assert 0.2 <= termsel.run("owdis-lines", seconds=0.2, options={"polish": False}).seconds < 0.3


@pytest.mark.slow
def test_out_holds_the_result_the_residuals_and_the_summary(tmp_path) -> None:
    result = quick("owdis-lines", out=tmp_path / "new" / "folder")
    folder = tmp_path / "new" / "folder"
    stored = json.loads((folder / "result.json").read_text())
    assert stored == json.loads(result.to_json())
    assert stored["schema"] == "termsel-result-1"
    assert stored["selection"]["n_features"] == len(result.selection.features)
    rows = (folder / "residuals.csv").read_text().splitlines()
    assert len(rows) == 1 + 2 * 120 + 24 + 26
    assert (folder / "summary.txt").read_text() == result.summary(verbose=True)
    assert sorted(p.name for p in folder.iterdir()) == [
        "lines.csv", "points.csv", "residuals.csv", "result.json", "summary.txt"]


@pytest.mark.slow
def test_residuals_agree_with_the_rmse() -> None:
    result = quick("owdis-lines")
    used = [r.distance for r in result.residuals if r.used]
    assert np.sqrt(np.mean(np.square(used))) == pytest.approx(result.rmse["control"].total)
    check = [r.distance for r in result.residuals if r.role == "check"]
    assert np.sqrt(np.mean(np.square(check))) == pytest.approx(result.rmse["check"].total)


def test_plain_fits_are_judged_next_to_the_selection() -> None:
    result = quick("rfm-terms")
    names = [b.name for b in result.baselines]
    assert names == ["all-terms", "affine", "dlt", "quadratic", "cubic", "rfm-2", "rfm-3", "ridge",
                     "selected", "regularised-quadratic", "regularised-cubic", "huber", "tukey"]
    assert not result.baselines[0].determined  # 39 terms an axis, 24 control points
    assert "rank-deficient" in result.judgement
    reference = next(b.rmse for b in result.baselines if b.name == "regularised-cubic")
    assert f"{reference['independent'].total:.2f} px" in result.judgement


@pytest.mark.parametrize(("problem", "more", "message"), [
    ("rfm-tems", {}, "Did you mean 'rfm-terms'"),
    ("rfm-terms", {"model": "rfn"}, "unknown model 'rfn'"),
    ("rfm-terms", {"options": {"populaton": 3}}, "unknown option 'populaton'"),
    ("rfm-terms", {"options": {"order": 4}}, "whole number from 1 to 3"),
    ("rfm-terms", {"options": {"population": "many"}}, "option 'population' does not accept"),
    ("rfm-terms", {"strategy": "as-asked", "options": {"fractions": "1:0:1"}},
     "check must be above 0"),
    ("owdis-lines", {"dataset": "spot-isfahan"}, "needs control lines"),
    ("owdis-points", {"model": "rfm"}, "39 terms to be determined together; the control"),
    ("rfm-terms", {"generations": 0}, "the budget of 0 generations is not positive"),
    ("rfm-terms", {"seconds": -1.0}, "the budget of -1.0 seconds is not positive"),
    ("rfm-terms", {"seconds": "5"}, "the budget of seconds is '5', not a number. Give a number"),
    ("rfm-terms", {"evaluations": True}, "the budget of evaluations is True, not a number"),
    ("rfm-terms", {"evaluations": 50.5}, "the budget of 50.5 evaluations is not a whole number"),
    ("owdis-points-terms", {"generations": np.inf, "options": {"steps": "terms-first"}},
     "the budget of inf generations is not a whole number"),
])
def test_what_the_user_can_correct_is_reported(problem: str, more: dict, message: str) -> None:
    with pytest.raises(termsel.TermselError, match=message):
        termsel.run(problem, **more)


def test_points_without_height_are_for_plane_models() -> None:
    ground = simulate_scene("irs1c-mashad").points
    flat = ground.ground.copy()
    flat[:, 2] = np.nan
    features = FeatureSet(Points(ground.ids, ground.image, flat, None, ground.roles),
                          crs="EPSG:4979")
    assert quick("poly-terms", features=features).feasible
    with pytest.raises(termsel.TermselError, match="heights; they are unknown for 62 of the"):
        termsel.run("rfm-terms", features=features)


def test_control_on_one_straight_line_is_refused() -> None:
    rng = np.random.default_rng(0)
    x = np.linspace(0, 1000, 30)
    points = Points(tuple(f"P{i}" for i in range(30)), rng.uniform(0, 500, (30, 2)),
                    np.stack([x, 2 * x + 5, rng.uniform(0, 50, 30)], axis=1))
    with pytest.raises(termsel.TermselError, match="one straight line"):
        termsel.run("rfm-terms", features=FeatureSet(points))


REAL = {
    "ventoux_lines": ("owdis-lines", {}), "ikonos_lines": ("owdis-lines", {}),
    "phr_grid_nice_a": ("rfm-terms", {}),
    "s1_grd_iw": ("rfm-terms", {"fractions": "3:3:2"}),  # a lattice has no independent points
    "rpcfit_s1_train": ("rfm-terms", {}), "kastoria_1925": ("poly-terms", {}),
    "maplat_fushimijo": ("poly-terms", {}),
}


@pytest.mark.slow_cases(
    "ikonos_lines", "maplat_fushimijo", "phr_grid_nice_a", "rpcfit_s1_train", "ventoux_lines")
@pytest.mark.parametrize("name", REAL)
def test_real_data_run_and_make_sense(name: str, data_folder) -> None:
    from termsel.io.read import read_features
    from termsel.plugins.registry import registry

    folder = data_folder / name
    problem, options = REAL[name]
    crs = json.loads((folder / "meta.json").read_text())["crs"].split()[0]
    lines = folder / "lines.csv" if problem == "owdis-lines" else None
    features = read_features(folder / "points.csv", lines, crs=crs,
                             readers=[e.object for e in registry().entries("readers")])
    n = len(features.points)
    points = features.points.take(np.arange(0, n, max(1, n // 60)))  # the largest has 1,106
    result = termsel.run(problem, features=features.with_(points=points), options=options)
    assert result.feasible
    affine = next(b for b in result.baselines if b.name == "affine")
    # One old map is as good as affine.
    assert result.rmse["independent"].total < 1.1 * affine.rmse["independent"].total


def test_libraries_imported_later_keep_to_one_thread() -> None:
    code = """
import sys, termsel.core.threads
from threadpoolctl import threadpool_info, threadpool_limits
termsel.core.threads.one_blas_thread(int)()
assert "numpy" not in sys.modules
import numpy
with threadpool_limits(2, user_api="blas"):
    found = termsel.core.threads.one_blas_thread(threadpool_info)()
    print({one["num_threads"] for one in found if one["user_api"] == "blas"})
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True,
                          check=False, timeout=60)
    assert done.stdout == "{1}\n", done.stdout + done.stderr


@pytest.mark.parametrize(("said", "threads"), [("", "1"), ("2", "2")])
def test_a_command_keeps_to_one_thread_unless_told(said: str, threads: str) -> None:
    code = """
import os, sys
from termsel.__main__ import main
sys.argv = ["termsel", "--version"]
try:
    main()
except SystemExit:
    print(os.environ["OPENBLAS_NUM_THREADS"], "numpy" in sys.modules)
"""
    others = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60,
        env={**others, **({"OPENBLAS_NUM_THREADS": said} if said else {})})
    assert done.stdout.endswith(f"\n{threads} False\n"), done.stdout + done.stderr


def test_linear_algebra_keeps_to_one_thread() -> None:
    def threads() -> set[int]:
        return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}

    seen = []
    with threadpool_limits(2, user_api="blas"):
        termsel.run("owdis-points", generations=1, options={"polish": False},
                    observers=[lambda _: seen.append(threads())])
        assert threads() == {2}
    assert seen
    assert all(one == {1} for one in seen)


@pytest.mark.slow
def test_one_run_at_a_time_works_in_a_folder(tmp_path: Path) -> None:
    """Another one is refused with the process that is at work there, whatever it may replace."""
    refused = []

    def again(_progress: object) -> None:
        for overwrite in (False, True)[len(refused):]:
            with pytest.raises(TermselError, match=rf"process {os.getpid()} on .* is at work in "
                                                   "this folder") as caught:
                quick("poly-terms", out=tmp_path, overwrite=overwrite)
            refused.append(caught.value)

    first = quick("poly-terms", out=tmp_path, observers=[again])
    assert len(refused) == 2
    assert termsel.read_result(tmp_path).evaluations == first.evaluations
    assert {path.name for path in tmp_path.iterdir()} == {
        "result.json", "residuals.csv", "summary.txt", "points.csv"}
    with pytest.raises(TermselError, match="there is a result in this folder already"):
        quick("poly-terms", out=tmp_path)


@pytest.mark.slow
def test_runs_that_begin_together_have_one_winner(tmp_path: Path) -> None:
    runs = [subprocess.Popen(
        [sys.executable, "-m", "termsel", "run", "--problem", "poly-terms", "--strategy",
         "as-asked", "--solver", "random", "--evaluations", "60", "--seed", str(seed), "--out",
         "out", "--json"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True) for seed in (1, 2, 3)]
    ended = [(one.communicate(timeout=120), one.returncode) for one in runs]
    assert sorted(code for _, code in ended) == [0, 2, 2], ended
    for (out, err), code in ended:
        if code:
            assert "is at work in this folder" in err or "a result in this folder already" in err
        else:
            assert json.loads(out)["seed"] == termsel.read_result(tmp_path / "out").seed


@pytest.mark.parametrize("first", ["gcps.csv", "no/such.points", Path("gcps"), [1, 2], {"x": [1]}])
def test_points_in_place_of_the_problem_are_told_from_it(first: object) -> None:
    with pytest.raises(TermselError, match=r"the first argument is a problem") as caught:
        termsel.run(first)  # type: ignore[arg-type]
    assert "termsel.run(features=" in str(caught.value)


def test_a_file_of_the_name_of_a_problem_does_not_matter(tmp_path: Path,
                                                         monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("poly-degree").touch()
    assert termsel.run("poly-degree", generations=1).record.problem == "poly-degree"
