"""Roles cost no accuracy, depend on no CRS, and the prediction is of the fit that is exported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import termsel
from termsel.cli.main import cli
from termsel.core.errors import rounded_size_text
from termsel.data.coordinates.crs import transformation_between
from termsel.data.features import FeatureSet, FloatArray, Points
from termsel.data.roles import observe
from termsel.formats.heights import HeightCaution
from termsel.formats.readers.csv_tables import write_points_csv
from termsel.io.accuracy_tags import accuracy_tags
from termsel.results.verdict import verdict_on_choice

NOISE = 0.6
EXTENT = np.array([15_000.0, 12_000.0])


def warped(share: FloatArray) -> FloatArray:
    """Return line and sample of places on a sheet (n, 2), in shares of its extent."""
    x, y = 2 * share.T - 1
    line = 2000 - 1900 * y + 4 * x * y + 2 * np.sin(3 * x) * np.cos(2 * y)
    return np.column_stack([line, 2500 + 2400 * x + 5 * x**2 - 3 * y**2 + 1.5 * np.sin(4 * y)])


def sheet(n: int, seed: int = 0, crs: str = "EPSG:25832") -> FeatureSet:
    """Return points of a deformed sheet, without roles."""
    rng = np.random.default_rng([seed, n])
    share = rng.uniform(0.02, 0.98, (400, 2))
    picked = [0]
    while len(picked) < n:  # the farthest of all from those before it
        apart = np.linalg.norm(share[:, None] - share[picked], axis=2).min(axis=1)
        picked.append(int(np.argmax(apart * rng.uniform(0.7, 1.0, len(share)))))
    share = share[picked]
    place = [650_000.0, 5_200_000.0] + (share - 0.5) * EXTENT
    ground = np.column_stack([place, np.full(n, np.nan)])
    if crs != "EPSG:25832":
        ground[:, :2] = transformation_between("EPSG:25832", crs)(ground)[:, :2]
        ground = np.round(ground, 8)
    image = warped(share) + rng.normal(0.0, NOISE, (n, 2))
    return FeatureSet(Points(tuple(f"P{i}" for i in range(n)), image, ground), crs=crs,
                      image_size=(4000, 5000))


def true_error(result: termsel.Result) -> float:
    """Return the RMSE of further measurements over the sheet by the exported fit [px]."""
    share = np.stack(np.meshgrid(*[np.linspace(0.06, 0.94, 15)] * 2), -1).reshape(-1, 2)
    place = [650_000.0, 5_200_000.0] + (share - 0.5) * EXTENT
    errors = result.project(np.column_stack([place, np.full(len(place), np.nan)])) - warped(share)
    return float(np.hypot(np.sqrt((errors**2).sum(axis=1).mean()), NOISE * np.sqrt(2)))


@pytest.mark.slow_cases("11", "13")
@pytest.mark.parametrize("n", [11, 12, 13, 30, 59])
def test_auto_gives_no_point_away_where_few_are_there(n: int) -> None:
    result = termsel.run(features=sheet(n))
    counts = result.data.counts
    assert (counts.control, counts.check, counts.independent) == (n, 0, 0)
    assert result.final is None
    assert result.predicted is not None
    assert result.predicted.points is None


def test_the_twelfth_point_raises_no_prediction() -> None:
    rises, truths = [], []
    for seed in range(5):
        features = sheet(12, seed)
        with_twelve = termsel.run(features=features)
        with_eleven = termsel.run(features=features.with_(points=features.points.take(range(11))))
        assert with_twelve.predicted is not None
        assert with_eleven.predicted is not None
        rises.append(with_twelve.predicted.rmse / with_eleven.predicted.rmse)
        truths.append(with_twelve.predicted.rmse / true_error(with_twelve))
    assert np.median(rises) < 1.1  # it was 1.4 to 3.4
    assert 0.7 < np.median(truths) < 2.2  # held out are points at the rim, too


def test_many_points_spare_a_quarter() -> None:
    counts = termsel.run(features=sheet(60)).data.counts
    assert (counts.control + counts.check, counts.independent) == (45, 15)


@pytest.mark.parametrize(("options", "independent"), [
    ({"fractions": "1:1:1"}, 4), ({"fractions": "2:1:1"}, 3), ({"roles": "stratified"}, 4),
    ({"role": "P3=independent,P7=independent"}, 2), ({"role": "P3=check"}, 0)])
def test_independent_points_are_set_aside_on_demand(options: dict[str, str],
                                                    independent: int) -> None:
    result = termsel.run(features=sheet(12), options=options)
    assert result.data.counts.independent == independent
    assert (result.final is None) == (not independent)


def test_roles_of_the_file_stay() -> None:
    features = sheet(14)
    roles = ("control", "", "independent", *[""] * 11)
    result = termsel.run(features=features.with_(points=replace(features.points, roles=roles)))
    assert result.data.roles.independent == ("P2",)
    assert result.data.counts.control == 13


def test_many_points_with_independent_ones_in_the_file_give_no_more_away() -> None:
    features = sheet(64)
    roles = ("independent", "independent", *[""] * 62)
    result = termsel.run(features=features.with_(points=replace(features.points, roles=roles)))
    assert result.data.roles.independent == ("P0", "P1")


def test_a_search_keeps_check_and_independent_points() -> None:
    task = termsel.prepare("poly-terms", features=sheet(14), criterion="check-rmse")
    sizes = [len(points) for points in (task.observations.control.points,
                                        task.observations.check, task.observations.independent)]
    assert sum(sizes) == 14
    assert min(sizes) >= 4
    assert task.options["data"]["fractions"] == "1:1:1"


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:32632", "EPSG:3857", "EPSG:31468"])
@pytest.mark.parametrize("n", [12, 25, 80])
def test_roles_do_not_depend_on_the_crs(crs: str, n: int) -> None:
    roles = {}
    for name in ("EPSG:25832", crs):
        features = sheet(n, crs=name)
        roles[name] = observe(features, rng=np.random.default_rng(3)).features.points.roles
    assert roles[crs] == roles["EPSG:25832"]
    assert set(roles[crs]) == {"control", "check", "independent"}


def test_corners_of_a_graticule_have_the_same_roles_in_every_crs() -> None:
    lon, lat = np.meshgrid(11 + np.arange(8) / 12, 46 + np.arange(6) / 12)
    degrees = np.column_stack([lon.ravel(), lat.ravel(), np.zeros(48)])
    ids = tuple(f"K{i}" for i in range(48))
    roles = []
    for crs in ("EPSG:4326", "EPSG:25832"):
        ground = degrees if crs == "EPSG:4326" else transformation_between(
            "EPSG:4326", crs)(degrees)
        points = Points(ids, degrees[:, 1::-1] * 1000, np.round(ground, 3) if crs != "EPSG:4326"
                        else ground)
        features = FeatureSet(points, crs=crs)
        roles.append(observe(features, rng=np.random.default_rng(0)).features.points.roles)
    assert roles[0] == roles[1]


def test_the_prediction_on_demand_is_of_the_fit_to_all_points() -> None:
    """It sees the places of independent points, and not how they were measured."""
    features = sheet(30, 4)
    given: dict[str, Any] = {"options": {"fractions": "1:1:1"}}
    result = termsel.run(features=features, **given)
    assert result.predicted is not None
    of_all = result.final_fit.predicted
    assert of_all is not None
    assert 0.6 * result.predicted.rmse < of_all.rmse < 0.99 * result.predicted.rmse
    moved = features.points.image.copy()
    moved[np.isin(features.points.ids, result.data.roles.independent)] += 0.7
    other = termsel.run(features=features.with_(points=replace(features.points, image=moved)),
                        **given)
    assert other.final_fit.predicted == of_all
    assert result.as_exported(False).final_fit is None


def test_few_independent_points_come_after_the_prediction(tmp_path: Path) -> None:
    features = sheet(30)
    result = termsel.run(features=features, options={"fractions": "2:1:1"}, out=tmp_path / "r")
    expected, accuracy = result.final_fit.predicted, result.accuracy
    assert expected is not None
    assert accuracy is not None
    shown = " ".join(result.summary().split())
    assert expected.pixel is not None
    metres = rounded_size_text(expected.rmse * expected.pixel)
    first = f"{rounded_size_text(expected.rmse)} px / {metres} m RMSE predicted by cross-validation"
    then = f"at {accuracy.image.n} independent check points"
    assert f"Accuracy {first}" in shown
    assert shown.index(first) < shown.index(then, shown.index(first))
    assert " ".join(repr(result).split()).count(first) == 1
    tags = accuracy_tags(result)
    assert tags["ACCURACY_STATED"].startswith(f"predicted RMSE {expected.rmse:.3g} px")
    assert tags["ACCURACY_PREDICTED_RMSE_PX"] == f"{expected.rmse:.4g}"
    assert "by cross-validation" in tags["ACCURACY_PREDICTED_BY"]
    assert termsel.read_result(tmp_path / "r").summary() == result.summary()


def test_many_independent_points_come_first() -> None:
    result = termsel.run(features=sheet(84), options={"fractions": "2:1:1"})
    assert result.accuracy is not None
    assert f"Accuracy  {rounded_size_text(result.accuracy.image.total)} px / " in result.summary()
    assert accuracy_tags(result)["ACCURACY_STATED"].startswith("by independent check points")


def test_no_figure_is_stated_of_a_map_whose_heights_are_wrong() -> None:
    result = termsel.run(features=sheet(84), options={"fractions": "2:1:1"})
    figures = {name for name in accuracy_tags(result) if name.startswith("ACCURACY_RMSE")}
    wrong = accuracy_tags(result, HeightCaution("The DEM is 47 m below the control", 12.4))
    assert figures
    assert wrong["ACCURACY_STATED"].startswith("no: ")
    assert "47 m below" in wrong["ACCURACY_CAUTION"]
    assert not any("RMSE" in name or "CE90" in name for name in wrong)
    # What no place is moved by is said, and leaves the figures as they are.
    harmless = accuracy_tags(result, HeightCaution("The DEM is 47 m below the control", 0.0))
    assert figures < set(harmless)
    assert "ACCURACY_CAUTION" in harmless


Call = Callable[..., SimpleNamespace]


def spent_note(result: termsel.Result) -> str:
    return next((note for note in result.notes if "no longer independent" in note), "")


def test_a_sibling_that_used_few_of_the_points_is_not_held_against_them(tmp_path: Path) -> None:
    features = sheet(40)
    points = features.points
    roles = np.array(["control"] * 40, dtype=object)
    roles[:10] = "independent"
    mine = features.with_(points=replace(points, roles=tuple(roles)))
    roles[1:10] = "control"
    other = features.with_(points=replace(points, roles=tuple(roles)))
    termsel.run("poly-terms", features=other, solver="all-terms", criterion="press",
                options={"degree": 2}, out=tmp_path / "other")
    result = termsel.run(features=mine, out=tmp_path / "mine")
    assert result.accuracy is not None
    assert result.accuracy.spent == ("P0",)
    assert spent_note(result).startswith("1 of 10 independent check points is no longer "
                                         "independent: it already assessed another fit, in other")
    assert "at 10 independent check points" in " ".join(result.summary().split())
    assert "these points already assessed" not in result.summary()
    whole = " ".join(result.summary(verbose=True).split())
    assert "1 of them already assessed the fit in other" in whole
    assert "an earlier result showed 1 of them" in accuracy_tags(result)["ACCURACY_STATED"]
    assert termsel.read_result(tmp_path / "mine").accuracy == result.accuracy


def test_a_run_with_a_corrected_point_spends_nothing(tmp_path: Path) -> None:
    """Auto has chosen by no independent point, before and after."""
    features = sheet(24)
    points = features.points
    roles = tuple("independent" if i < 6 else "control" for i in range(24))
    image = points.image.copy()
    image[20] += 0.3
    first = features.with_(points=replace(points, roles=roles))
    second = features.with_(points=replace(points, roles=roles, image=image))
    kind = termsel.run(features=first, out=tmp_path / "r").strategy
    again = termsel.run(features=second, out=tmp_path / "r", overwrite=True)
    assert kind is not None
    assert again.strategy is not None
    assert kind.chosen == again.strategy.chosen
    assert not spent_note(again)
    left_out = termsel.run(features=second, options={"off": "P21"}, out=tmp_path / "off")
    assert left_out.strategy is not None
    assert bool(spent_note(left_out)) == (left_out.strategy.chosen != kind.chosen)


def test_a_conventional_model_is_compared_at_the_same_points() -> None:
    verdicts = set()
    for seed in range(3):
        result = termsel.run(features=sheet(60, seed), options={"fractions": "1:1:1"})
        mine = result.rmse["independent"]
        assert mine is not None
        cubic = next(row.rmse["independent"] for row in result.baselines if row.name == "cubic")
        assert result.strategy is not None
        gains = {row.name: row.gain for row in result.strategy.candidates}
        verdict = verdict_on_choice(mine.total, cubic.total, "cubic", gains, at_points=True)
        assert f"a cubic polynomial, the best conventional model in cross-validation, has " \
            f"{cubic.total:.2f} px: {verdict}." in result.judgement
        verdicts.add(verdict)
    assert len(verdicts) == 3  # as large, larger, and smaller by chance


def test_few_independent_points_compare_by_leave_one_out() -> None:
    few = termsel.run(features=sheet(30, 2), options={"fractions": "2:1:1"})
    none = termsel.run(features=sheet(30, 2))
    for result in (few, none):
        assert result.predicted is not None
        assert "without it, its model has" in result.judgement
    assert f"; predicted there: {few.predicted.rmse:.2f} px." in few.judgement
    assert "It is not verified" in none.judgement


def test_the_command_line_says_the_same(tmp_path: Path) -> None:
    features = sheet(12)
    write_points_csv(features.points, tmp_path / "p.csv", crs=features.crs)
    done = CliRunner().invoke(cli, ["run", "--points", str(tmp_path / "p.csv"), "--quiet"])
    assert done.exit_code == 0
    assert "12 points to choose and fit the model, no independent check points" in done.output
    done = CliRunner().invoke(cli, ["run", "--points", str(tmp_path / "p.csv"), "--quiet",
                                    "--set", "fractions=1:1:1"])
    assert ("8 points to choose and fit the model, 4 set aside as independent check points"
            in done.output)


@pytest.mark.slow_cases(
    "['--role', 'P3=check,P1=control']-False", "['--role', 'P3=check,P1=independent']-False")
@pytest.mark.parametrize(("words", "is_noted"), [
    (["--role", "P3=check,P1=check"], True),
    (["--role", "P3=check", "--role", "P1=check"], True),
    (["--role", "P3=check", "--off", "P7"], True),
    (["--role", "P3=check,P1=independent"], False),  # whoever writes independent knows it
    (["--role", "P3=check,P1=control"], False),
    (["--role", "P3=check", "--set", "fractions=1:1:1"], False),  # others test the result
    (["--off", "P3"], False),
    ([], False)], ids=str)
def test_a_role_of_check_alone_is_said_to_be_no_test(words: list[str], is_noted: bool,
                                                     tmp_path: Path) -> None:
    features = sheet(12)
    points = replace(features.points, ids=tuple(f"P{i}" for i in range(12)))
    write_points_csv(points, tmp_path / "p.csv", crs=features.crs)
    done = CliRunner().invoke(cli, ["run", "--points", str(tmp_path / "p.csv"), *words])
    assert done.exit_code == 0
    text = " ".join(done.output.split())
    note = ("Note: --role ID=check makes a selection point, which takes part in the choice. For a "
            "point that tests the result write --role P3=independent.")
    assert (note in text) is is_noted
    assert text.count("--role ID=check") == is_noted


@pytest.mark.parametrize(("gain", "at_points", "words"), [
    (0.2, False, "40 % smaller, within chance; --method cubic takes it"),
    (4.0, False, "40 % smaller, more than chance; --method cubic takes it"),
    (0.2, True, "40 % smaller, within chance in cross-validation; --method cubic takes it"),
    (-0.2, True, "40 % smaller, not in cross-validation; --method cubic takes it")])
def test_a_smaller_figure_of_another_model_has_a_reason_and_a_command(
        gain: float, at_points: bool, words: str) -> None:
    gains = {"field": 0.0, "cubic": gain}
    assert verdict_on_choice(1.0, 0.6, "cubic", gains, at_points=at_points) == words
    # One that was asked for was not chosen, and a small difference is not worth a command.
    assert verdict_on_choice(1.0, 0.6, "cubic", {"field": 0.0}) == (
        "40 % smaller; take --method cubic in its place")
    assert verdict_on_choice(1.0, 0.9, "cubic", {"field": 0.0}) == "10 % smaller"
    assert "--method" not in verdict_on_choice(1.0, 0.9, "cubic", gains, at_points=at_points)
