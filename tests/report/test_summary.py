"""The summary: each line that appears only under a condition, from records made by hand."""

from __future__ import annotations

import re
from typing import Any

import pytest

import termsel
from tests.records import (
    added,
    baseline,
    counts,
    data,
    opening,
    outlier,
    page,
    record,
    rmse,
    roles,
    share,
    text,
)


def test_the_page_of_an_ordinary_search() -> None:
    assert opening() == [
        "Read: points.csv: 45 points; EPSG:4979.",
        "Control: 24 points; 12 check points; 9 independent points.",
        "Model: poly3d, all 2 terms, all 2 points.",
        "Accuracy: not known, as there are no independent points.",
        "Blunders: none found.",
        "Next: termsel report, export and rectify take the folder that --out DIR writes."]
    assert page() == [
        "How accurate is it?",
        "The accuracy is not known: there are no independent points. Give some points the role",
        "independent.",
        "",
        "Is it better than plain structures?",
        "It is good.",
        "",
        "RMSE [px], with 90 % intervals",
        "fit          terms  control  check  independent        interval",
        "this result      2    1.000  2.000        3.000  2.394 to 4.073",
        "all terms       20    0.500  5.000        6.000  4.788 to 8.146",
        "",
        "the search minimised press; independent = the accuracy",
        "",
        "Which points or lines are bad?",
        "No feature is a blunder, as far as the others tell.",
        "",
        "What was selected, and why?",
        "Selected: all 2 control features, all 2 terms; redundancy 46",
        "Search: 500 evaluations (30 looked up), 7 generations, 1.2 s",
        "",
        "How is it repeated?",
        "Problem rfm-terms. Model poly3d, solver ga, criterion press, seed 4; termsel 9.9"]
    assert text(False).partition("\n\n")[2].splitlines() == page()[:6]


READ = {"points": 60, "lines": 0, "without_height": 0, "place": "47.4 N, 11.0 E", "doubt": "",
        "left_out": {}}


@pytest.mark.parametrize(("read", "lines"), [
    ({}, ["Read: points.csv: 60 points; EPSG:4979 near 47.4 N, 11.0 E.",
          "Control: 24 points; 12 check points; 9 independent points."]),
    ({"lines": 1, "without_height": 61}, [
        "Read: points.csv: 60 points, 1 line without heights; EPSG:4979 near 47.4 N, 11.0 E."]),
    ({"without_height": 2, "left_out": {"without a height": ["P1", "P7"]}}, [
        "Read: points.csv: 60 points (2 without a height); EPSG:4979 near 47.4 N, 11.0 E.",
        "Control: 24 points; 12 check points; 9 independent points. Left out: 2 without a "
        "height."]),
    ({"points": 0, "lines": 40, "place": "", "left_out": {"marked off": ["L1"]}}, [
        "Read: points.csv: 40 lines; EPSG:4979.",
        "Control: 24 points; 12 check points; 9 independent points. Left out: 1 marked off."]),
    ({"doubt": "x and y look swapped: they do"}, [
        "Next: x and y look swapped: check them before anything else."])])
def test_what_was_read_comes_first(read: dict[str, Any], lines: list[str]) -> None:
    assert set(lines) <= set(opening(data=data(read={**READ, **read})))


@pytest.mark.parametrize(("changed", "line"), [
    ({"data": data(crs="local", source="a/b/gcps.csv, c/lines.csv")},
     "Read: gcps.csv, lines.csv: 45 points; coordinates without a CRS."),
    ({"data": data(source="n" * 300)}, f"Read: {'n' * 17} ... {'n' * 10}: 45 points; EPSG:4979."),
    ({"offered": {"n_terms": 20, "n_features": 3}},
     "Model: poly3d, 2 of 20 terms, 2 of 3 points; selected by ga (criterion press)."),
    ({"feasible": False}, "Next: measure more control, or choose a smaller model."),
    ({"interrupted": True}, "Next: the run was interrupted; run it again to its end."),
    ({"predicted": {"rmse": 1234.5, "low": 0.5, "high": 99999.0}},
     "Accuracy: 1,234 px predicted (0.5 to 99,999 px); no independent point confirms it."),
    ({"judgement": "Let auto choose instead: it is better."},
     "Next: name no problem and no method: then auto chooses, and predicts better."),
    ({"data": data(counts={**record()["data"]["counts"], "independent": 0})},
     "Next: measure further points, some of the role independent; termsel plan names places.")])
def test_the_answer_comes_first(changed: dict[str, Any], line: str) -> None:
    assert line in opening(**changed)


def test_the_opening_stays_short_whatever_names_there_are() -> None:
    many = {"outliers": [outlier(f"{i}" * 200, 1e6 / (i + 1), i % 2 == 0) for i in range(9)]}
    lines = opening(**many, data=data(
        source="/very/long/" + "name" * 70, crs="EPSG:25832+7837",
        read={**READ, "lines": 120, "without_height": 12,
              "left_out": {"without a height": ["A"] * 12, "marked off": ["B"]}}))
    assert len(lines) <= 8
    assert max(map(len, lines)) <= 88
    assert ("Blunders: 9 found, 4 of them in use: leave them out by the option --off below."
            in lines)


def test_a_short_opening_keeps_the_command_that_leaves_a_blunder_out() -> None:
    some = [*(outlier("L" * 30 + str(i), 80.0, True) for i in range(3)),
            *(outlier("M" * 30 + str(i), 70.0, True, "probable") for i in range(3)),
            outlier("C28", 60.0, False)]
    lines = opening(outliers=some, data=data(
        source="/very/long/" + "name" * 70, crs="EPSG:25832+7837",
        read={**READ, "lines": 120, "without_height": 12,
              "left_out": {"without a height": ["A"] * 12, "marked off": ["B"]}}))
    assert len(lines) <= 8
    assert "Blunders: 7 found, 1 of them in use: leave it out by --off C28." in lines


@pytest.mark.parametrize(("changed", "lines"), [
    ({"evaluations": 1, "lookups": 0, "generations": 1}, [
        "Search: 1 evaluation (0 looked up), 1 generation, 1.2 s"]),
    ({"criterion": "check-rmse", "objectives": {"check-rmse": 1.0}}, [
        "check = the fitness, which the search minimised; independent = the accuracy",
        "Problem rfm-terms. Model poly3d, solver ga, criterion check-rmse, seed 4; termsel 9.9"]),
    (share(1.0), []),
    (share(0.67), [
        "Terms are 67 % of their equations at most; --set max_share=1 lifts this"]),
    ({"polish": {"found": 1.23456, "polished": 1.1, "evaluations": 1500, "lookups": 0}}, [
        "Local refinement: press 1.235 as ga found it, 1.1 after it (1500 evaluations)"]),
    ({"polish": {"found": 2.0, "polished": 2.0, "evaluations": 1, "lookups": 0}}, [
        "Local refinement: press 2 as ga found it, 2 after it (1 evaluation)"]),
    ({"notes": ["One note.", "Another."]}, ["Note: One note.", "Note: Another."])])
def test_lines_about_the_search(changed: dict[str, Any], lines: list[str]) -> None:
    assert added(**changed) == lines


@pytest.mark.parametrize(("changed", "line"), [
    (counts(control=0, lines=40), "Control: 40 lines; 12 check points; 9 independent points."),
    (counts(lines=40), "Control: 24 points and 40 lines; 12 check points; 9 independent points."),
    (counts(control=1, lines=1, check=1, independent=0),
     "Control: 1 point and 1 line; 1 check point; no independent points."),
    (data(fit_crs="EPSG:32639"),
     "Fitted in EPSG:32639; coordinates are given in EPSG:4979, heights EGM96")])
def test_what_the_control_is(changed: dict[str, Any], line: str) -> None:
    assert line in text(data=changed).splitlines()


@pytest.mark.parametrize(("changed", "word"), [
    (counts(lines=0), "points"), (counts(control=0, lines=40), "lines"),
    (counts(lines=40), "features")])
def test_the_opening_calls_the_control_what_it_is(changed: dict[str, Any], word: str) -> None:
    assert any(re.search(rf"terms, (all )?\d+( of \d+)? {word}\b", line)
               for line in opening(data=changed))


@pytest.mark.parametrize(("n_features", "n_terms", "lines"), [
    (3, 2, ["Selected: 2 of 3 control features, all 2 terms; redundancy 46", "Features: A B"]),
    (2, 3, ["Selected: all 2 control features, 2 of 3 terms; redundancy 46",
            "Terms: line:1 line:X"]),
    (3, 3, ["Selected: 2 of 3 control features, 2 of 3 terms; redundancy 46", "Features: A B",
            "Terms: line:1 line:X"])])
def test_what_is_selected_is_listed_where_it_is_not_all(n_features: int, n_terms: int,
                                                        lines: list[str]) -> None:
    assert added(offered={"n_terms": n_terms, "n_features": n_features}) == lines


PROVEN = {"subsets": 12345, "of": 99999, "space": "all sizes", "optimal": False}
GAP = "Gap: 2.50 % above the proven optimum 0.9 (12,345 subsets decided, all sizes); "
BELOW = "The proven optimum is 0, below this (12,345 subsets decided, all sizes); "


@pytest.mark.parametrize(("more", "solver", "share", "line"), [
    ({"optimal": True}, "exact", 1.0,
     "Proven: no selection has a better criterion (12,345 subsets decided, all sizes)"),
    ({"gap": 0.025, "optimum": 0.9}, "ga", 0.67, GAP + "--solver exact finds it"),
    ({"gap": 0.025, "optimum": 0.9}, "ga", 1.0, GAP + "--solver exact --set max_share=1 finds it"),
    ({"gap": 0.025, "optimum": 0.9}, "exact", 1.0, GAP + "a larger budget finds it"),
    ({"gap": 0.0, "optimum": 0.9}, "ga", 0.67, GAP.replace("2.50", "0")
     + "--solver exact finds it"),
    ({"gap": None, "optimum": 0.0}, "ga", 0.67, BELOW + "--solver exact finds it"),
    ({"optimal": True, "bounded": 345, "space": "all selections of up to 16 terms an axis"},
     "exact", 1.0, "Proven: no selection of up to 16 terms an axis has a better criterion "
                   "(12,345 subsets decided, 345 of them by bounds)"),
    ({"bound": 0.8, "gap": 0.125}, "exact", 1.0,
     "Not proven: at most 12.50 % above the optimum, which is 0.8 or more (12,345 of 99,999 "
     "subsets decided)"),
    ({"bound": 0.8, "gap": 0.125, "space": "selections of up to 16 terms an axis"}, "exact", 1.0,
     "Not proven: at most 12.50 % above the optimum of up to 16 terms an axis, which is 0.8 or "
     "more (12,345 of 99,999 subsets decided)"),
    ({"bound": 0.0}, "exact", 1.0,
     "Not proven: 12,345 of 99,999 subsets decided; no lower bound is known yet"),
    ({"bound": 0.8, "gap": 2.5e-6}, "exact", 1.0,
     "Not proven: at most 0.00025 % above the optimum, which is 0.8 or more (12,345 of 99,999 "
     "subsets decided)"),
    ({"optimal": True, "subsets": 1, "of": 1}, "exact", 1.0,
     "Proven: no selection has a better criterion (1 subset decided, all sizes)"),
    ({"feasible": False}, "exact", 1.0,
     "Proven: no selection is feasible (12,345 subsets decided, all sizes)"),
    ({"feasible": False, "space": "all selections of up to 5 of 24 features"}, "exact", 1.0,
     "Proven: no selection of up to 5 of 24 features is feasible (12,345 subsets decided)"),
    ({}, "ga", 1.0, "Not proven: 12,345 of 99,999 subsets decided"),
    ({"subsets": 10**15 - 1, "of": 12 * 10**36}, "exact", 1.0,
     "Not proven: 999,999,999,999,999 of 1.2e37 subsets decided")])
def test_what_is_proven(more: dict[str, Any], solver: str, share: float, line: str) -> None:
    options = {**record()["options"], "problem": {"max_share": share}}
    text = page(certificate={**PROVEN, **more}, solver=solver, options=options)
    plain = page(solver=solver, options=options)
    assert " ".join(one for one in text if one not in plain) == line


@pytest.mark.parametrize(("figure", "shown"), [
    (None, "-"), (0.01, "0.010"), (0.00999, "9.99e-03"), (99999.0, "99999.000"),
    (100000.0, "1.00e+05")])
def test_figures_fit_their_columns(figure: float | None, shown: str) -> None:
    [line] = [line for line in page(rmse=roles(figure, 2.0, None)) if line.startswith("this")]
    assert line.split() == ["this", "result", "2", shown, "2.000", "-", "-"]


def test_fits_to_control_and_check_have_a_star() -> None:
    assert added(baselines=[baseline("dlt", 11, roles(1.0, 1.5, 2.5))]) == [
        "DLT *           11    1.000  1.500        2.500  1.995 to 3.394",
        "* fitted to control and check together; its check figure is a fit"]


def test_a_baseline_without_any_figure_is_said_to_be_not_determined() -> None:
    nothing = roles(None, None, None)
    alone = {"fitted_to": ("control",)}
    text = "- not determined with redundancy"
    assert added(baselines=[baseline("rfm-3", 78, nothing, **alone)]) == [
        "full RFM        78        -      -            -               -", text]
    # Without independent points it may be determined all the same.
    assert text not in added(baselines=[baseline("rfm-3", 78, roles(1.0, None, None), **alone)])


def test_a_model_that_corrects_by_its_control_shows_its_leave_one_out() -> None:
    text = page(rmse={**roles(1.0, 2.0, 3.0), "leave-one-out": rmse(1.75)})
    assert "  leave-one-out           1.750" in text
    assert ("leave-one-out: each control feature by the fit without it, as poly3d corrects by "
            "control") in text


def strategy(chosen: str, predicted: float | None, *names: str) -> dict[str, Any]:
    return {"name": "auto", "chosen": chosen, "reason": "It is " + "good. " * 16,
            "predicted": predicted, "folds": 20,
            "fitted_to": ["control", "check"],
            "candidates": [{"name": name, "model": "poly3d", "n_terms": 20, "effective": 8.25,
                            "predicted": 0.5}
                           for name in names]}


def test_the_page_of_a_choice() -> None:
    text = page(strategy=strategy("shrunken-cubic", 0.6, "dlt", "shrunken-cubic"))
    assert text[-1] == "Model poly3d, strategy auto, seed 4; termsel 9.9"
    assert "The predicted RMSE is that of the whole choice, repeated in 20 folds." in text
    assert text[-12:-3] == [
        "What was selected, and why?",
        "Chosen: shrunken cubic, fitted to control and check together; 1.2 s",
        "It is good. good. good. good. good. good. good. good. good. good. good. good. good.",
        "good. good. good.",
        "",
        "Candidates",
        "   candidate       terms  effective  leave-one-out RMSE [px]",
        "   DLT                20        8.2                    0.500",
        "-> shrunken cubic     20        8.2                    0.500"]
    assert "independent = the accuracy" in text
    assert any(line.startswith("this result * ") for line in text)
    assert not any(line.startswith(("Selected:", "Search:")) for line in text)


def test_a_choice_without_a_prediction() -> None:
    text = page(strategy=strategy("affine", None, "affine", "dlt"))
    assert "Chosen: affine, fitted to control and check together; 1.2 s" in text
    assert not any("The predicted RMSE" in line for line in text)


def member(terms: list[str], press: float, size: int, independent: float | None) -> dict[str, Any]:
    return {"objectives": {"n_terms": size, "press": press}, "rmse": roles(1, 2, independent),
            "selection": {"terms": terms, "features": ["A", "B"], "n_terms": 1, "n_features": 2}}


FRONT = [member(["line:1"], 2.5, 1, None), member(["line:1", "line:X"], 1.5, 2, 1.25)]


def test_a_front_marks_the_selection() -> None:
    assert added(front=FRONT) == [
        "Front",
        "   terms  press  independent [px]",
        "       1    2.5                 -",
        "->     2    1.5             1.250"]


def test_a_front_says_what_is_proven_of_each_size() -> None:
    def sized(n: int, press: float, *proven: object) -> dict[str, object]:
        of = dict(zip(("better", "optimal", "bound", "gap"), proven, strict=True))
        return {**member([f"t{n}"], press, n, None), **of}

    assert added(by_size=[
        sized(1, 2.5, True, True, 2.5, 0.0), sized(2, 1.5, True, False, 1.2, 0.25),
        sized(3, 1.7, False, True, 1.7, 0.0), sized(4, 1.8, False, False, 1.5, 0.2),
        sized(5, 1.8, False, False, 1.4, 0.3), sized(6, 1.4, True, False, 0.4, 2.5),
        sized(7, 1.9, False, False, 1.4, 0.3), sized(8, 1.3, True, False, None, None)]) == [
        "Front",
        "terms  press  independent [px]  best of its size",
        "    1    2.5                 -  proven",
        "    2    1.5                 -  at most 25.00 % above it",
        "    6    1.4                 -  at most 3.5 times as high",
        "    8    1.3                 -  not proven",
        "Proven: the best selection of 3, 4 and 7 terms is no better than that of fewer.",
        "Not proven: a selection of 5 terms may still be better than that of fewer."]


RULE = ("The marked one is the selection, recommended by the rule {} (--set recommend=...).")


@pytest.mark.parametrize(("rule", "objectives", "lines"), [
    ("best", 1, []), ("best", 2, [RULE.format("best")]), ("knee", 1, [RULE.format("knee")])])
def test_a_front_tells_of_the_rule_where_there_is_a_choice(rule: str, objectives: int,
                                                           lines: list[str]) -> None:
    given = {"front": FRONT, "options": {**record()["options"], "problem": {"recommend": rule}},
             "objectives": dict.fromkeys(("press", "n_terms")[:objectives], 1.0)}
    assert added(**given)[4:] == lines


@pytest.mark.parametrize("size", [40, 41])
def test_a_long_front_is_counted(size: int) -> None:
    lines = added(front=[member([f"t{i}"], 1.0, i, 1.0) for i in range(size)])
    assert (lines[1:] == ["41 rows; result.json has all of them"]) == (size > 40)
    assert len(lines) == (2 if size > 40 else 42)


IMAGE = {"n": 9, "line": 3.0, "sample": 4.0, "total": 5.0, "maximum": 9.0, "ce90": 8.0}

ACCURACY = {"image": IMAGE, "ground": None, **{
    name: {"value": None, "reason": "too few"} for name in ("nssda", "asprs")}}


@pytest.mark.parametrize(("outliers", "line"), [
    ([], "none found."),
    ([outlier("P2", 9.0, True), outlier("P1", 4.0, True)], "P2 (9 px), P1 (4 px) left out."),
    ([outlier("P2", 9.0, True), outlier("P1", 4.0, False)],
     "P2 (9 px) left out; P1 (4 px) in use: leave it out by --off P1."),
    ([outlier("P1", 4.0, False, "probable", "check"), outlier("P 2", 9.0, False)],
     "P 2 (9 px), P1 (4 px, probable) in use: leave them out by --off 'P1,P 2'."),
    ([outlier("P3", 3.0, False, "possible")], "P3 (3 px, possible) in use."),
    ([outlier(f"P{i}", 9.0 - i, True) for i in range(5)],
     "P0 (9 px), P1 (8 px), P2 (7 px) and 2 more left out."),
    ([outlier("P7", 80.0, False, role="independent")],
     "P7 (80 px) contradicts all others: leave it out by --off P7.")])
def test_the_opening_tells_the_verdict(outliers: list[dict[str, Any]], line: str) -> None:
    assert f"Blunders: {line}" in opening(outliers=outliers)
    # A short summary has the table where the opening has not all.
    assert ("Features that contradict" in text(False, outliers=outliers)) == ("more" in line)
    assert ("Features that contradict" in text(outliers=outliers)) == bool(outliers)


def test_the_accuracy_is_told_with_and_without_an_independent_blunder() -> None:
    less = {**ACCURACY, "image": {**IMAGE, "n": 8, "total": 0.5}}
    told = {"accuracy": ACCURACY, "accuracy_without": less,
            "outliers": [outlier("P7", 80.0, False, role="independent")]}
    assert "Accuracy: 5 px (RMSE of 9 independent points); 0.5 px without P7." in opening(**told)
    found = " ".join(page(**told))
    assert ("RMSE 5 px on 9 independent points (90 % interval 3.95 to 6.92 px). Without P7: RMSE "
            "0.5 px on 8 independent points (90 % interval") in found
    assert "8 independent points, without P7" in found


def test_certain_and_probable_blunders_are_told_apart() -> None:
    found = page(outliers=[outlier("P2", 9.0, True),
                           outlier("P1", 4.0, False, "probable", "check"),
                           outlier("P3", 3.0, False, "possible")])
    at = found.index("feature   kind     role  error [px]           verdict       use")
    assert [line.split() for line in found[at + 1:at + 4]] == [
        ["P2", "point", "control", "9", "blunder", "left", "out"],
        ["P1", "point", "check", "4", "probable", "blunder", "in", "use"],
        ["P3", "point", "control", "3", "possible", "blunder", "in", "use"]]
    assert any(line.startswith("A probable blunder is more likely wrong than") for line in found)
    assert any(line.startswith("A possible blunder lies where the others are") for line in found)


def test_features_that_were_not_needed_are_counted() -> None:
    assert added(data=data(roles={**record()["data"]["roles"], "control": ["A", "B", "C", "D"]})) \
        == ["Left out though they fit: 2; they were not needed."]


@pytest.mark.parametrize(("p", "lines"), [
    (0.05, []), (0.051, ["Not significant (5 %): line:X"])])
def test_terms_that_are_not_significant(p: float, lines: list[str]) -> None:
    assert added(significance={"line:1": {"t": 9.0, "p": 0.001},
                               "line:X": {"t": 2.0, "p": p}}) == lines


def test_coefficients_that_correlate() -> None:
    pairs = [{"terms": ["line:1", "line:X"], "correlation": -0.98764},
             {"terms": ["line:1", "line:Y"], "correlation": 0.96}]
    assert added(correlations=pairs) == [
        "Correlations of coefficients of 0.95 or more: 2, highest -0.9876 (line:1, line:X)"]


@pytest.mark.parametrize(("solver", "criterion", "says"), [
    ("all-terms", "check-rmse", "independent = the accuracy"),
    ("ridge", "check-rmse", "independent = the accuracy"),
    ("random", "press", "the search minimised press; independent = the accuracy"),
    ("random", "check-rmse", "check = the fitness, which the search minimised; independent = the "
                             "accuracy")])
def test_check_is_called_the_fitness_where_it_was_minimised(solver: str, criterion: str,
                                                            says: str) -> None:
    result = termsel.run("rfm-terms", strategy="as-asked", solver=solver, criterion=criterion,
                         evaluations=60)
    assert says in result.summary(verbose=True).splitlines()
