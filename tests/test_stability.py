"""Frequencies of terms over points assigned again."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import termsel
from termsel.cli.main import cli
from termsel.formats.readers.csv_tables import write_points_csv
from termsel.measurements.features import FeatureSet, Points
from termsel.models.polynomial import Polynomial3D
from termsel.runs.stability import stability

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
    found = stability("rfm-terms", features=features, **QUICK)
    always = {name for name, share in zip(found.terms, found.frequency, strict=True) if share == 1}
    assert wanted <= always
    assert found.frequency.mean() < 1
    assert wanted <= set(found.stable)
    assert found.determined
    assert found.rmse["independent"].total < 0.2


def test_repetitions_differ_and_repeat_themselves() -> None:
    features, _ = few_terms()
    first, second = (stability("rfm-terms", features=features, seed=3, **QUICK) for _ in range(2))
    np.testing.assert_array_equal(first.selections, second.selections)
    assert len(np.unique(first.selections, axis=0)) > 1


def test_independent_points_take_no_part() -> None:
    features, _ = few_terms()
    independent = np.array(features.points.roles) == "independent"
    moved = replace(features.points, image=features.points.image + 9.0 * independent[:, None])
    one, other = (stability("rfm-terms", features=each, **QUICK)
                  for each in (features, FeatureSet(moved)))
    np.testing.assert_array_equal(one.selections, other.selections)
    assert one.rmse["check"] == other.rmse["check"]


@pytest.mark.parametrize(("problem", "more", "message"), [
    ("owdis-points", {}, "selects features"), ("owdis-lines-terms", {}, "selects features"),
    ("poly-terms", {"repeats": 1}, "say nothing"), ("poly-terms", {"threshold": 0}, "say nothing")])
def test_what_it_is_not_for(problem: str, more: dict, message: str) -> None:
    with pytest.raises(termsel.TermselError, match=message):
        stability(problem, evaluations=50, **more)


def test_a_term_is_stable_from_the_threshold_on() -> None:
    features, _ = few_terms()
    shares = stability("rfm-terms", features=features, seed=3, **QUICK).frequency
    some = float(shares[(shares > 0) & (shares < 1)][0])
    found = stability("rfm-terms", features=features, seed=3, threshold=some, **QUICK)
    np.testing.assert_array_equal(found.frequency, shares)
    assert found.stable == tuple(name for name, share in zip(found.terms, shares, strict=True)
                                 if share >= some)
    assert len(found.stable) > (shares > some).sum()


def test_stable_terms_that_are_no_model_are_said_to_be() -> None:
    words = ["stability", "--problem", "poly-terms", "--repeats", "2", "--evaluations", "50",
             "--threshold", "1", "--set", "force_on=", "--set", "degree=8"]
    done = CliRunner().invoke(cli, words)
    record = json.loads(CliRunner().invoke(cli, [*words, "--json"]).stdout)
    last = done.output.splitlines()[-1]
    assert (last == "The stable terms alone are no model. Lower --threshold.") == (
        not record["determined"])


def test_command() -> None:
    words = ["stability", "--problem", "rfm-terms", "--model", "poly3d", "--set", "degree=2",
             "--repeats", "3", "--evaluations", "200"]
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0, done.output
    assert "line.num:X" in done.output
    record = json.loads(CliRunner().invoke(cli, [*words, "--json"]).stdout)
    assert record["repeats"] == 3
    assert set(record["frequency"]) == set(Polynomial3D(degree=2).terms)
    assert record["determined"]
    sizes, independent = record["n_terms"], record["rmse"]["independent"]
    assert done.output.splitlines()[-4:-2] == [
        f"3 selections of {min(sizes)} to {max(sizes)} terms; {len(record['stable'])} terms in at "
        "least 60% of them.",
        f"Fitted to control and check together: {independent['total']:.3f} px on "
        f"{independent['n']} independent points."]
    command = done.output.strip().splitlines()[-1].split()[1:]
    again = CliRunner().invoke(cli, [*command, "--json"])
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
             "--generations", "50", "--seconds", "100", "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0, done.output
    record = json.loads((tmp_path / "out/stability.json").read_text())
    printed = shlex.split(done.stdout.splitlines()[-1])
    assert printed.count("--points") == 1
    for name, value in (("--points", str(points)), ("--crs", "local"), ("--model", "poly3d"),
                        ("--format", "points-csv"), ("--set", "columns=x:x,y:y"),
                        ("--set", "degree=2"), ("--set", f"off={features.points.ids[0]}"),
                        ("--set", f"role={features.points.ids[1]}=control")):
        assert (name, value) in pairwise(printed)
    again = CliRunner().invoke(cli, [*printed[1:], "--json"])
    assert again.exit_code == 0, again.output
    result = json.loads(again.stdout)
    assert result["selection"]["terms"] == record["stable"]
    assert str(points) in result["data"]["source"]
    assert "line.num:XY" not in record["stable"]


def test_the_command_leaves_out_options_of_the_searches() -> None:
    done = CliRunner().invoke(cli, [
        "stability", "--problem", "rfm-terms", "--dataset", "irs1c-mashad", "--model", "poly3d",
        "--solver", "ga", "--set", "population=20", "--fit-crs", "geocentric", "--repeats", "2",
        "--evaluations", "100"])
    assert done.exit_code == 0, done.output
    printed = done.stdout.splitlines()[-1]
    assert "--dataset irs1c-mashad" in printed
    assert "--set fit_crs=geocentric" in printed
    assert "population" not in printed
