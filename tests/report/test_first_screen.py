"""The first screen: at most twelve lines on data, model, accuracy, outliers and what is next."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from msgspec import convert

from termsel.data.record.cautions import MIRRORED
from termsel.data.record.figures import is_determined_exactly
from termsel.data.record.record import Record
from termsel.results.first_screen import SCREEN_LINES
from tests.records import (
    baseline,
    counts,
    data,
    first_screen,
    next_step,
    outlier,
    record,
    roles,
    text,
)
from tests.snapshots import require_same

SCREENS = Path(__file__).parent / "screens"

READ = {"points": 60, "lines": 0, "without_height": 0, "place": "47.4 N, 11.0 E", "doubt": "",
        "left_out": {}}
IMAGE = {"n": 9, "line": 3.0, "sample": 4.0, "total": 5.0, "maximum": 9.0, "ce90": 8.0}
ACCURACY = {"image": IMAGE, "ground": None, **{
    name: {"value": None, "reason": "too few"} for name in ("nssda", "asprs")}}
PREDICTED = {"rmse": 4.5, "low": 3.1, "high": 6.2}


def accuracy(total: float, n: int, **changed: Any) -> dict[str, Any]:
    """The accuracy at n independent check points."""
    return {**ACCURACY, "image": {**IMAGE, "total": total, "n": n}, **changed}


def outlier_test(limit: float | None, features: int = 36, extent: float = 4000.0) -> dict[str, Any]:
    return {"features": features, "limit": limit, "extent": extent}


def choice(*names: str, predicted: float | None = 0.5) -> dict[str, Any]:
    """A choice by auto: the first model, each later one worse in cross-validation."""
    return {"name": "auto", "chosen": names[0], "reason": "", "predicted": predicted, "folds": 20,
            "fitted_to": ["control", "check"],
            "candidates": [{"name": name, "model": "poly3d", "n_terms": 20, "effective": 8.25,
                            "predicted": 0.5 + 0.1 * i} for i, name in enumerate(names)]}


def compared(name: str, total: float, predicted: float | None = None) -> dict[str, Any]:
    return {**baseline(name, 20, roles(1.0, 1.0, total)), "predicted": predicted}


def front(objective: str, sizes: Iterable[int]) -> list[dict[str, Any]]:
    """A Pareto front of a number to be small, and of the criterion."""
    return [{"objectives": {objective: size, "check-rmse": 9.0 / size},
             "selection": record()["selection"], "rmse": record()["rmse"]} for size in sizes]


SEARCHED = {"accuracy": accuracy(3.0, 26), "reference": "quadratic",
            "baselines": [baseline("all-terms", 20, roles(0.5, 5.0, 6.0), fitted_to=("control",)),
                          compared("quadratic", 2.4)]}
CHOSEN = {"strategy": choice("regularised-cubic", "affine", "quadratic"), "reference": "affine",
          "baselines": [compared("affine", 3.2, 0.6), compared("quadratic", 2.9, 0.7)]}
MANY = [outlier(f"{i}" * 200, 1e6 / (i + 1), i % 2 == 0) for i in range(9)]

CASES: dict[str, dict[str, Any]] = {
    "search": {**SEARCHED, "blunder_test": outlier_test(9.0)},
    "auto": {**CHOSEN, "accuracy": accuracy(2.5, 32, ground={**{
        key: value for key, value in IMAGE.items() if key not in ("line", "sample")},
        "x": 1.0, "y": 1.0, "total": 2.49}), "predicted": {"rmse": 2.44, "low": 2.1, "high": 2.8},
        "blunder_test": outlier_test(9.0)},
    "auto-few-check-points": {**CHOSEN, "accuracy": accuracy(5.0, 9), "predicted": PREDICTED,
                              "blunder_test": outlier_test(60.0)},
    "auto-without-check-points": {
        **CHOSEN, "predicted": PREDICTED, "data": counts(independent=0, check=0, control=9),
        "blunder_test": outlier_test(None, 9)},
    "no-redundancy": {"strategy": choice("affine", predicted=None),
                      "data": counts(independent=0, check=0, control=4),
                      "blunder_test": outlier_test(None, 4),
                      "notes": ["4 points determine the model exactly, so nothing is left over."]},
    "outliers": {**SEARCHED, "outliers": [
        outlier("L027", 14.31, True), outlier("L006", 12.6, True), outlier("P1", 4.0, False),
        outlier("P9", 3.0, False, "probable", "check"),
        outlier("P7", 80.0, False, role="independent")],
        "accuracy_without": accuracy(0.5, 25)},
    "reused-check-points": {"accuracy": accuracy(5.0, 25, spent_by=["r15"],
                                                 spent=[f"P{i}" for i in range(25)])},
    "lines": {**SEARCHED, "data": counts(control=0, lines=40),
              "options": {**record()["options"], "model": {"degree": 2}},
              "offered": {"n_terms": 20, "n_features": 40}, "blunder_test": outlier_test(9.0)},
    "swapped-axes": {"data": data(read={**READ, "doubt": "x and y look swapped: they do"})},
    "no-model-fits": {**CHOSEN, "baselines": [],
                      "predicted": {"rmse": 153.0, "low": 43.0, "high": 335.0},
                      "blunder_test": outlier_test(20.0, 12)},
    "predicted-in-metres": {
        **CHOSEN, "predicted": {**PREDICTED, "pixel": 0.5},
        "data": counts(independent=0, check=0, control=40), "blunder_test": outlier_test(9.0, 40)},
    "worse-than-conventional": {
        **CHOSEN, "baselines": [compared("affine", 3.2, 0.4)], "predicted": PREDICTED,
        "data": counts(independent=0, check=0, control=40), "blunder_test": outlier_test(9.0, 40)},
    "exact": {**SEARCHED, "solver": "exact", "certificate": {
        "optimal": True, "subsets": 256, "of": 256, "space": "all selections"},
        "front": front("n_terms", range(2, 14)), "blunder_test": outlier_test(9.0)},
    "exact-unproven": {**SEARCHED, "solver": "exact", "certificate": {
        "optimal": False, "subsets": 1_250_000, "of": 2**40, "space": "all selections",
        "gap": 0.031, "bound": 2.91}, "blunder_test": outlier_test(9.0)},
    "exact-stopped": {**SEARCHED, "solver": "exact", "certificate": {
        "optimal": False, "subsets": 0, "of": 2**40, "space": "all selections", "bound": 0.0},
        "blunder_test": outlier_test(9.0)},
    "several-objectives": {**SEARCHED, "solver": "nsga2", "front": front("n_features", (8, 12, 30)),
                           "blunder_test": outlier_test(9.0)},
    "infeasible": {"feasible": False},
    "long-names": {"outliers": MANY, "data": data(
        source="/very/long/" + "name" * 70, crs="EPSG:25832+7837",
        read={**READ, "lines": 120, "without_height": 12,
              "left_out": {"without a height": ["A"] * 12, "marked off": ["B"]}})},
}


@pytest.mark.parametrize("name", CASES)
def test_a_first_screen_reads_as_it_was_looked_at(name: str) -> None:
    lines = first_screen(**CASES[name])
    require_same(SCREENS / f"{name}.txt", "\n".join([*lines, next_step("result", **CASES[name])])
                 + "\n")


@pytest.mark.parametrize("name", CASES)
def test_a_first_screen_is_short(name: str) -> None:
    lines = first_screen(**CASES[name])
    assert len(lines) + 1 <= SCREEN_LINES == 12
    assert max(map(len, lines)) <= 88


@pytest.mark.parametrize("limit", [None, 5000.0])
def test_none_is_never_said_of_outliers_that_cannot_be_found(limit: float | None) -> None:
    [line] = [line for line in first_screen(blunder_test=outlier_test(limit, 6))
              if line.startswith("Outliers")]
    assert "none" not in line
    assert "6 points are too few" in line


@pytest.mark.parametrize(("limit", "said"), [
    (11.5, "none found among 8 points; below 11.5 px most cannot be detected"),
    (8.0, "none among 8 points")])
def test_errors_that_a_test_of_few_points_misses_are_stated(limit: float, said: str) -> None:
    """The least error that is found is stated where it is more than four times the RMSE."""
    lines = first_screen(accuracy=accuracy(2.5, 12), blunder_test=outlier_test(limit, 8))
    assert f"Outliers  {said}" in lines


def test_each_figure_of_the_accuracy_stands_once() -> None:
    lines = " ".join(first_screen(**CASES["auto"]))
    assert lines.count("2.50 px") == lines.count("2.49 m") == lines.count("2.44 px") == 1


def test_the_figure_of_a_rival_stands_next_to_another_of_the_model() -> None:
    # The rival's figure is that predicted for the model; left out, it would be taken for the ratio.
    screen = CASES["auto-without-check-points"]
    predicted = {**screen, "predicted": {**PREDICTED, "rmse": 0.6}}
    [line] = [line for line in first_screen(**predicted) if line.startswith("Compared")]
    assert "affine 0.60 px in leave-one-out, this model 0.50" in line


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("words", [12, 20, 55])
def test_the_first_caution_is_never_cut_within_a_sentence(name: str, words: int) -> None:
    sentence = " ".join(f"word{i}" for i in range(words))
    case = {**CASES[name], "feasible": True}
    lines = first_screen(**{**case, "notes": [f"{sentence}. It is so for a reason.", "Another."]})
    # A sentence of three lines and more may make the screen longer.
    assert len(lines) + 1 <= SCREEN_LINES or words == 55
    start = next((i for i, line in enumerate(lines) if line.startswith("Caution")), len(lines))
    caution = " ".join(" ".join(lines[start:]).split())
    # Another warning may be more urgent than the note.
    assert sentence in caution or "word0" not in caution
    assert "..." not in caution


def test_where_nothing_fits_no_check_point_is_blamed() -> None:
    """One of many check points is far off by chance where the errors of all are large."""
    scattered = {"accuracy": accuracy(160.0, 24), "blunder_test": outlier_test(900.0),
                 "outliers": [outlier("C96", 519.0, False, role="independent")]}
    lines = first_screen(**scattered)
    assert "not detectable: no model fits these points; check the columns" in " ".join(lines)
    assert "C96" not in " ".join(lines)
    assert next_step("r", **scattered).startswith(
        "Next: correct the columns, the units, the CRS or the rows")


def test_notes_that_do_not_fit_are_counted() -> None:
    notes = [f"Note {i} is long enough to be a line of its own. More of it." for i in range(9)]
    lines = first_screen(**CASES["outliers"], notes=notes)
    assert len(lines) + 1 <= SCREEN_LINES
    shown = sum("is long enough" in line for line in lines)
    assert f"{9 - shown} more notes: --verbose" in lines[-1]


def test_the_next_command_leaves_out_what_this_one_left_out_too() -> None:
    """The option of the next run replaces that of this one."""
    options = {**record()["options"], "data": {"off": "P7, P8"}}
    found = [outlier("P2", 9.0, False), outlier("P8", 9.0, True)]
    assert next_step("r", options=options, outliers=found) == "Next: run again with --off P7,P8,P2"


@pytest.mark.parametrize(("changed", "folder", "step"), [
    ({}, "", "Not saved: add --out DIR, then termsel report DIR"),
    ({}, "result", "Next: termsel report result"),
    ({}, "my results", "Next: termsel report 'my results'"),
    ({"data": counts(independent=0)}, "r",
     "Next: termsel plan r   (best positions for further points)"),
    ({"data": counts(independent=0), "adjustment": {**record()["adjustment"], "redundancy": 0}},
     "r", "Next: measure at least one more point, then run again with it"),
    ({"outliers": [outlier("P 2", 9.0, False)]}, "r", "Next: run again with --off 'P 2'"),
    ({"outliers": [outlier("P1", 9.0, True), outlier("P2", 8.0, False)]}, "r",
     "Next: run again with --off P1,P2"),
    ({"outliers": [outlier("P1", 9.0, True)]}, "r", "Next: termsel report r"),
    ({"outliers": [outlier("P2", 9.0, False, "possible")]}, "r", "Next: termsel report r")])
def test_one_command_comes_next(changed: dict[str, Any], folder: str, step: str) -> None:
    assert next_step(folder, **changed) == step


@pytest.mark.parametrize(("changed", "line"), [
    (counts(control=0, lines=40),
     "40 control lines, 12 selection points, 9 independent check points"),
    (counts(lines=40), "24 control points, 40 control lines, 12 selection points, 9 independent "
                       "check points"),
    (counts(control=1, lines=1, check=1, independent=0),
     "1 control point, 1 control line, 1 selection point, no independent check points")])
def test_roles_are_named_in_the_words_of_the_field(changed: dict[str, Any], line: str) -> None:
    assert line in first_screen(data=changed)


@pytest.mark.parametrize(("number", "said"), [
    (1, "1 point determines the model exactly"), (4, "4 points determine the model exactly")])
def test_that_a_model_is_determined_exactly_is_said_once(number: int, said: str) -> None:
    adjustment = {**record()["adjustment"], "redundancy": 0}
    lines = first_screen(
        strategy=choice("affine", predicted=None), adjustment=adjustment,
        data=counts(independent=0, check=0, control=number),
        notes=[f"{is_determined_exactly(number, 'point')}, so its accuracy is not known."])
    assert " ".join(lines).count("the model exactly") == 1
    assert any(line.endswith(f"not known: {said}; measure at least one more") for line in lines)


def test_points_that_choose_and_fit_are_counted_together_in_a_choice() -> None:
    lines = first_screen(strategy=choice("affine"))
    assert "36 points to choose and fit the model, 9 independent check points" in lines


def test_all_outliers_are_in_the_table_of_the_whole_text() -> None:
    given = {"outliers": MANY}
    assert "Outliers and their prediction errors" in text(**given)
    assert "Outliers and their prediction errors" not in text()


def test_accuracy_is_given_with_and_without_an_independent_blunder() -> None:
    given = {"accuracy": ACCURACY, "accuracy_without": accuracy(0.5, 8),
             "outliers": [outlier("P7", 80.0, False, role="independent")]}
    assert "          0.50 px without P7" in first_screen(**given)
    assert "Without P7: RMSE 0.50 px at 8 independent check points" in " ".join(
        text(**given).split())


def test_a_vendor_rpc_is_shown_with_its_shift() -> None:
    rpc = {**{f"{kind}_{part}": [1.0] * n for kind, n in (("image", 2), ("ground", 3))
              for part in ("offset", "scale")},
           **{f"{axis}_{part}": [1.0] * 20 for axis in ("line", "sample")
              for part in ("numerator", "denominator")}}
    changed = record(strategy=choice("rpc", "affine"), data=data(rpc=rpc),
                     coefficients={"line.bias:1": -0.5, "sample.bias:1": 0.25})
    changed["scaling"] = {**changed["scaling"], "line_scale": 28.0, "sample_scale": 36.0}
    assert convert(changed, Record).data.rpc
    assert any(line.startswith("Model     vendor RPC shifted by -14.00 px in line and +9.00 px "
                               "in sample") for line in first_screen(**changed))


def test_a_local_correction_of_an_rpc_has_no_shift_of_zero() -> None:
    rpc = {**{f"{kind}_{part}": [1.0] * n for kind, n in (("image", 2), ("ground", 3))
              for part in ("offset", "scale")},
           **{f"{axis}_{part}": [1.0] * 20 for axis in ("line", "sample")
              for part in ("numerator", "denominator")}}
    screen = first_screen(strategy=choice("rpc-field", "affine"), data=data(rpc=rpc),
                          coefficients={"line.bias:1": 0.0, "sample.bias:1": 0.0})
    assert not any("shifted by" in line for line in screen)


@pytest.mark.parametrize(("steps", "solvers"), [
    ("features-first", "genetic search and particle swarm"), ("joint", "genetic search")])
def test_the_solver_of_a_second_step_is_told(steps: str, solvers: str) -> None:
    options = {**record()["options"], "problem": {"steps": steps, "then": "pso"}}
    screen = "\n".join(first_screen(**SEARCHED, options=options,
                                    offered={"n_terms": 20, "n_features": 40}))
    assert f", by {solvers}\n" in screen


def test_that_points_contradict_one_another_comes_before_what_follows_from_it() -> None:
    notes = ["Extrapolation: the standard deviation of the model is up to 272 px at the corners.",
             "The errors of the points are too large to show what a height does.",
             "The points contradict one another: 14 of 24 agree, and all are too few to show "
             "which are wrong. Look at P001 in the image."]
    screen = "\n".join(first_screen(**CASES["no-model-fits"], notes=notes))
    assert "Caution   The points contradict one another: 14 of 24 agree" in screen


@pytest.mark.parametrize(("blunders", "says"), [
    ("leave-out", "rejected"), ("keep", "not selected by the search")])
@pytest.mark.parametrize("case", [{}, CASES["long-names"]], ids=["named", "counted"])
def test_outliers_that_a_search_could_select_were_not_rejected(
        blunders: str, says: str, case: dict[str, Any]) -> None:
    options = {**record()["options"], "problem": {"blunders": blunders}}
    screen = "\n".join(first_screen(**{"outliers": [outlier("P2", 9.0, True)], **case,
                                       "options": options}))
    [line] = [line for line in screen.splitlines() if line.startswith("Outliers")]
    assert says in line


def test_many_outliers_are_no_slips_to_leave_out() -> None:
    few, many = ([outlier(f"X{i}", 90.0, i % 2 == 0) for i in range(n)] for n in (4, 9))
    assert next_step("r", outliers=few).startswith("Next: run again with --off")
    assert "--off" not in next_step("r", outliers=many)
    lines = "\n".join(first_screen(outliers=many))
    assert "are rows shifted, or matches wrong? 9 of " in lines
    assert "--verbose shows the option" not in lines


@pytest.mark.parametrize(("distortion", "free", "says"), [
    ("0.0,0.0", 0.3, "does the lens distort? State it with --set camera_distortion=K1,K2"),
    ("-0.1,0.0", 0.3, "check the focal length and the distortion that are stated"),
    ("0.0,0.0", 0.45, ""), ("0.0,0.0", 0.9, "")])
def test_a_camera_as_stated_that_free_ones_fit_better_than_is_doubted(
        distortion: str, free: float, says: str) -> None:
    chosen = choice("known-camera", "affine", "pinhole")
    chosen["candidates"][-1]["predicted"] = free
    options = {**record()["options"], "model": {"distortion": distortion}}
    screen = " ".join(" ".join(first_screen(strategy=chosen, options=options)).split())
    if says:
        assert ("a pinhole camera, of which nothing is stated, has 0.30 px in leave-one-out, the "
                "camera as stated 0.50 px") in screen
    assert ("as stated" in screen) == bool(says)
    assert says in screen


def test_outliers_among_points_that_nothing_fits_do_not_hide_it() -> None:
    scattered = {"accuracy": accuracy(160.0, 24), "blunder_test": outlier_test(900.0),
                 "outliers": [outlier("C12", 519.0, True), outlier("C40", 400.0, False)]}
    screen = " ".join(" ".join(first_screen(**scattered)).split())
    assert "Outliers no model fits these points; check the columns, the units, the CRS" in screen
    assert "all points are of this image, one in each row" in screen
    assert "C12" in screen


@pytest.mark.parametrize("direction", ["Line numbers grow to the north",
                                       "Sample numbers grow to the west"])
def test_an_image_that_mirrors_the_map_is_mended_before_it_is_reported(direction: str) -> None:
    notes = [f"{direction}{MIRRORED}does x have the wrong sign?"]
    assert next_step("r", notes=notes).startswith("Next: correct the axis that mirrors the map")
