"""Frequencies of terms over points assigned again."""

# mypy: disable-error-code="arg-type,union-attr"
from __future__ import annotations

import json
import re
import shlex
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import termsel
from termsel import (
    FeatureSet,
    Lines,
    Points,
    Polynomial3D,
    search,
    write_lines_csv,
    write_points_csv,
)
from termsel.testing import invoke
from termsel.toolkit.runs import Request, task_of
from termsel_studies import frequencies as module
from termsel_studies import selection_frequencies

QUICK = {"model": "poly3d", "solver": "exact", "criterion": "press", "repeats": 4,
         "options": {"degree": 2}}


def few_terms(n: int = 90) -> tuple[FeatureSet, set[str]]:
    """Points of a model with one quadratic term an axis."""
    rng = np.random.default_rng(0)
    ground = rng.uniform(-1, 1, (n, 3))
    model = Polynomial3D(degree=2)
    affine = {name for name in model.terms if name.split(":")[1] in {"1", "X", "Y", "Z"}}
    wanted = affine | {"line.num:XY", "sample.num:Z2"}
    truth = np.array([rng.uniform(20, 50) if name in wanted else 0.0 for name in model.terms])
    image = model.project(truth, ground) + rng.normal(0, 0.1, (n, 2))
    roles = ("control", "check", "independent") * (n // 3)
    return FeatureSet(Points(tuple(f"P{i}" for i in range(n)), image, ground, None, roles)), wanted


def test_terms_that_are_there_are_always_selected() -> None:
    features, wanted = few_terms()
    found = selection_frequencies("rfm-terms", features=features, **QUICK)
    always = {name for name, share in zip(found.terms, found.frequency, strict=True) if share == 1}
    assert wanted <= always
    assert found.frequency.mean() < 1
    assert wanted <= set(found.stable)
    assert found.determined
    assert found.rmse["independent"].total < 0.2


def test_repetitions_differ_and_repeat_themselves() -> None:
    features, _ = few_terms()
    first, second = (
        selection_frequencies("rfm-terms", features=features, seed=3, **QUICK) for _ in range(2))
    np.testing.assert_array_equal(first.selections, second.selections)
    assert len(np.unique(first.selections, axis=0)) > 1


def test_independent_points_take_no_part() -> None:
    features, _ = few_terms()
    independent = np.array(features.points.roles) == "independent"
    moved = replace(features.points, image=features.points.image + 9.0 * independent[:, None])
    one, other = (selection_frequencies("rfm-terms", features=each, **QUICK)
                  for each in (features, FeatureSet(moved)))
    np.testing.assert_array_equal(one.selections, other.selections)
    assert one.rmse["check"] == other.rmse["check"]


@pytest.mark.parametrize(("problem", "more", "message"), [
    ("owdis-points", {}, "selects features"), ("owdis-lines-terms", {}, "selects features"),
    ("poly-degree", {}, "selects other values than terms"),
    ("poly-terms", {"repeats": 1}, "say nothing"), ("poly-terms", {"threshold": 0}, "say nothing")])
def test_what_it_is_not_for(problem: str, more: dict[str, Any], message: str) -> None:
    with pytest.raises(termsel.TermselError, match=message):
        selection_frequencies(problem, evaluations=50, **more)


def test_a_term_is_stable_from_the_threshold_on() -> None:
    features, _ = few_terms()
    shares = selection_frequencies("rfm-terms", features=features, seed=3, **QUICK).frequency
    some = float(shares[(shares > 0) & (shares < 1)][0])
    found = selection_frequencies("rfm-terms", features=features, seed=3, threshold=some, **QUICK)
    np.testing.assert_array_equal(found.frequency, shares)
    assert found.stable == tuple(name for name, share in zip(found.terms, shares, strict=True)
                                 if share >= some)
    assert len(found.stable) > (shares > some).sum()


def test_stable_terms_that_are_no_model_are_said_to_be() -> None:
    words = ["stability", "--problem", "poly-terms", "--repeats", "2", "--evaluations", "50",
             "--threshold", "1", "--set", "force_on=", "--set", "degree=8"]
    done = invoke(*words)
    record = json.loads(invoke(*words, "--json").stdout)
    last = done.output.splitlines()[-1]
    assert (last == "The stable terms alone are no model. Lower --threshold.") == (
        not record["determined"])


def test_command() -> None:
    words = ["stability", "--problem", "rfm-terms", "--model", "poly3d", "--set", "degree=2",
             "--repeats", "3", "--evaluations", "200"]
    done = invoke(*words)
    assert done.exit_code == 0, done.output
    assert "line.num:X" in done.output
    record = json.loads(invoke(*words, "--json").stdout)
    assert record["repeats"] == 3
    assert set(record["frequency"]) == set(Polynomial3D(degree=2).terms)
    assert record["determined"]
    sizes, independent = record["n_terms"], record["rmse"]["independent"]
    assert done.output.splitlines()[-4:-2] == [
        f"3 selections of {min(sizes)} to {max(sizes)} terms; {len(record['stable'])} terms in at "
        "least 60% of them.",
        f"Fitted to control and selection points together: {independent['total']:.3f} px on "
        f"{independent['n']} independent check points."]
    command = done.output.strip().splitlines()[-1].split()[1:]
    again = invoke(*command, "--json")
    assert again.exit_code == 0, again.output
    result = json.loads(again.stdout)
    assert result["selection"]["terms"] == record["stable"]
    assert result["rmse"]["independent"] == pytest.approx(record["rmse"]["independent"])


def test_the_command_it_prints_repeats_the_data_of_its_own(tmp_path: Path) -> None:
    features, _ = few_terms()
    points = tmp_path / "my points; of 2026.txt"
    write_points_csv(features.points, points, "")
    words = ["stability", "--problem", "rfm-terms", "--model", "poly3d", "--solver", "exact",
             "--criterion", "press", "--points", str(points), "--crs", "local",
             "--format", "points-csv", "--set", "columns=x:x,y:y", "--set", "degree=2",
             "--set", "loss=squares", "--set", "force_off=line.num:XY", "--repeats", "3",
             "--off", features.points.ids[0], "--role", f"{features.points.ids[1]}=control",
             "--seconds", "100", "--out", str(tmp_path / "out")]
    done = invoke(*words)
    assert done.exit_code == 0, done.output
    record = json.loads((tmp_path / "out/stability.json").read_text())
    printed = shlex.split(done.stdout.splitlines()[-1])
    assert printed.count("--points") == 1
    for name, value in (("--points", str(points)), ("--crs", "local"), ("--model", "poly3d"),
                        ("--format", "points-csv"), ("--set", "columns=x:x,y:y"),
                        ("--set", "degree=2"), ("--set", f"off={features.points.ids[0]}"),
                        ("--set", f"role={features.points.ids[1]}=control")):
        assert (name, value) in pairwise(printed)
    again = invoke(*printed[1:], "--json")
    assert again.exit_code == 0, again.output
    result = json.loads(again.stdout)
    assert result["selection"]["terms"] == record["stable"]
    assert str(points) in result["data"]["source"]
    assert "line.num:XY" not in record["stable"]


def test_the_command_leaves_out_options_of_the_searches() -> None:
    done = invoke("stability", "--problem", "rfm-terms", "--dataset", "irs1c-mashad",
                  "--model", "poly3d", "--solver", "ga", "--set", "population=20",
                  "--fit-crs", "geocentric", "--repeats", "2", "--evaluations", "100")
    assert done.exit_code == 0, done.output
    printed = done.stdout.splitlines()[-1]
    assert "--dataset irs1c-mashad" in printed
    assert "--set fit_crs=geocentric" in printed
    assert "population" not in printed


def test_it_takes_whatever_run_takes() -> None:
    names = [set(re.findall(r"^ +(?:-\w, )?(--[a-z-]+)", invoke(*words).stdout, re.M))
             for words in (("run", "--help-all"), ("stability", "--help"))]
    assert names[0] - names[1] == {"--verbose", "--help-all", "--checkpoint"}
    assert names[1] - names[0] == {"--repeats", "--threshold"}


def with_lines() -> FeatureSet:
    """Points of each role and 40 lines, of an affine model."""
    features, _ = few_terms()
    rng = np.random.default_rng(5)
    ground = rng.uniform(-1, 1, (40, 2, 3))
    image = 30.0 * ground[..., :2] + ground[..., 2:] + rng.normal(0, 0.1, (40, 2, 2))
    points = replace(features.points, image=30.0 * features.points.ground[:, :2]
                     + features.points.ground[:, 2:] + rng.normal(0, 0.1, (90, 2)))
    return FeatureSet(points, Lines(tuple(f"L{i}" for i in range(40)), image, ground), "local")


@pytest.mark.slow
def test_lines_go_with_points_and_are_in_the_command(tmp_path: Path) -> None:
    features = with_lines()
    write_points_csv(features.points, tmp_path / "p.csv")
    write_lines_csv(features.lines, tmp_path / "my lines.csv")
    words = ["--points", str(tmp_path / "p.csv"), "--lines", str(tmp_path / "my lines.csv"),
             "--crs", "local", "--set", "mixed=true", "--model", "poly3d", "--set", "degree=2"]
    done = invoke("stability", "--problem", "rfm-terms", *words, "--repeats", "2",
                  "--evaluations", "60", "--strategy", "auto", "--quiet",
                  "--export", "points-csv", "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "Note: the strategy auto searches for no terms." in done.stderr
    printed = shlex.split(done.stdout.splitlines()[-1])
    assert set(zip(words[:6:2], words[1:6:2], strict=True)) <= set(pairwise(printed))
    again = invoke(*printed[1:], "--json", "--out", tmp_path / "again",
                   "--export", "points-csv")
    assert again.exit_code == 0, again.output
    record = json.loads((tmp_path / "out/stability.json").read_text())
    assert json.loads(again.stdout)["selection"]["terms"] == record["stable"]
    exported = "result_points.csv"
    assert (tmp_path / "out" / exported).read_text() == (tmp_path / "again" / exported).read_text()


def test_what_cannot_be_exported_is_said(tmp_path: Path) -> None:
    done = invoke("stability", "--problem", "poly-terms", "--repeats", "12", "--evaluations", "5",
        "--threshold", "1", "--set", "force_on=", "--set", "degree=8", "--solver", "random",
                  "--export", "points-csv", "--out", tmp_path)
    assert done.exit_code == 2
    assert "are no model, so nothing is exported" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["stability.json"]


def test_twins_share_a_role_in_every_repetition(monkeypatch: pytest.MonkeyPatch) -> None:
    features, _ = few_terms()
    # Every other point has a twin, so that pairs lie across the number of control points, too.
    points = features.points
    some = points.take(np.arange(0, len(points), 2))
    twins = Points(tuple(f"T{name}" for name in some.ids), some.image,
                   some.ground + 1e-6, None, some.roles)
    drawn = []

    def recorded(request: Request) -> Any:
        drawn.append(dict(zip(request.features.ids, request.features.points.roles, strict=True)))
        return task_of(request)

    monkeypatch.setattr(module, "task_of", recorded)
    selection_frequencies("rfm-terms", features=FeatureSet(points.join(twins)), **QUICK)
    assert len(drawn) == 5
    for roles in drawn:
        assert all(roles[name] == roles[f"T{name}"] for name in some.ids)
    assert drawn[1] != drawn[2]


@pytest.mark.parametrize(("after", "complete"), [(3, 2), (2, None)])
def test_ctrl_c_ends_it_and_keeps_what_is_complete(
        after: int, complete: int | None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    calls = []

    def interrupted(*words: Any, **how: Any) -> Any:
        calls.append(how["seed"])
        found = search(*words, **how)
        return replace(found, interrupted=len(calls) == after)

    monkeypatch.setattr(module, "search", interrupted)
    done = invoke("stability", "--problem", "poly-terms", "--repeats", "5", "--evaluations", "50",
                  "--out", tmp_path)
    assert done.exit_code == 130
    assert len(calls) == after
    if complete:
        assert f"Interrupted after {complete} of 5 selections." in done.stderr
        assert json.loads((tmp_path / "stability.json").read_text())["repeats"] == complete
    else:
        assert "Interrupted." in done.stderr


def test_data_that_cannot_be_read_leave_no_folder(tmp_path: Path) -> None:
    (tmp_path / "bad.csv").write_text("id,line,sample,x,y\na,1,2,three,4\n")
    done = invoke("stability", "--points", tmp_path / "bad.csv", "--crs", "local",
                  "--out", tmp_path / "out")
    assert done.exit_code == 2
    assert "bad.csv, line 2, column 'x'" in done.output
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("criterion", [None, "press"])
def test_too_few_points_are_said_to_be_too_few_for_stability(criterion: str | None) -> None:
    features, _ = few_terms(6)
    few = features.with_(points=replace(features.points.take(np.arange(4)), roles=("",) * 4))
    with pytest.raises(termsel.TermselError, match="4 points are too few") as refused:
        selection_frequencies("poly-terms", features=few, criterion=criterion, repeats=2)
    assert "press" not in str(refused.value)
