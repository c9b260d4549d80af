"""The summary: each line that appears only under a condition, from records made by hand."""

from __future__ import annotations

from typing import Any

import pytest

import termsel
from termsel.results.charts.search import with_unit
from termsel.results.verdict import criterion_in_words
from tests.records import (
    added,
    baseline,
    data,
    outlier,
    page,
    record,
    rmse,
    roles,
    share,
)


@pytest.mark.parametrize(("changed", "lines"), [
    ({"evaluations": 1, "lookups": 0, "generations": 1}, [
        "Search: 1 evaluation (0 from the cache), 1 generation, 1.2 s"]),
    ({"criterion": "check-rmse", "objectives": {"check-rmse": 1.0}}, [
        "The search minimised the RMSE at selection points, so it is optimistic; the accuracy is",
        "the RMSE at independent check points.",
        "Problem rfm-terms. Model poly3d, solver ga, criterion check-rmse, seed 4; termsel 9.9"]),
    (share(1.0), []),
    (share(0.67), [
        "Limit: 0.67 terms per equation; --set max_share=1 removes it"]),
    ({"polish": {"found": 1.23456, "polished": 1.1, "evaluations": 1500, "lookups": 0}}, [
        "Local refinement: leave-one-out RMSE 1.235 as ga found it, 1.1 after it (1,500",
        "evaluations)"]),
    ({"polish": {"found": 2.0, "polished": 2.0, "evaluations": 1, "lookups": 0}}, [
        "Local refinement: leave-one-out RMSE 2 as ga found it, 2 after it (1 evaluation)"]),
    ({"notes": ["One note.", "Another."]}, ["Note: One note.", "Note: Another."])])
def test_lines_about_the_search(changed: dict[str, Any], lines: list[str]) -> None:
    assert added(**changed) == lines


@pytest.mark.parametrize(("n_features", "n_terms", "lines", "fit"), [
    (3, 2, ["Selected: 2 of 3 control features, all 2 terms; redundancy 46", "Features: A B"],
     "all points"),
    (2, 3, ["Selected: all 2 control features, 2 of 3 terms; redundancy 46",
            "Terms: line:1 line:X"], "all terms"),
    (3, 3, ["Selected: 2 of 3 control features, 2 of 3 terms; redundancy 46", "Features: A B",
            "Terms: line:1 line:X"], "all points and terms")])
def test_what_is_selected_is_listed_where_it_is_not_all(n_features: int, n_terms: int,
                                                        lines: list[str], fit: str) -> None:
    offered = {"n_terms": n_terms, "n_features": n_features}
    assert added(offered=offered)[-len(lines):] == lines
    # The fit without a selection is named by what it has more than this one.
    assert [line.split("  ")[0] for line in page(offered=offered) if line.startswith("all ")] == [
        fit]


PROVEN = {"subsets": 12345, "of": 99999, "space": "all sizes", "optimal": False}
GAP = "Optimality gap: 2.50 % above the proven optimum 0.9 (12,345 subsets enumerated, all sizes); "
BELOW = "The proven optimum is 0, below this (12,345 subsets enumerated, all sizes); "


@pytest.mark.parametrize(("more", "solver", "share", "line"), [
    ({"optimal": True}, "exact", 1.0,
     "Proven: no selection has a better criterion (12,345 subsets enumerated, all sizes)"),
    ({"gap": 0.025, "optimum": 0.9}, "ga", 0.67, GAP + "--solver exact finds it"),
    ({"gap": 0.025, "optimum": 0.9}, "ga", 1.0, GAP + "--solver exact --set max_share=1 finds it"),
    ({"gap": 0.025, "optimum": 0.9}, "exact", 1.0, GAP + "a larger budget finds it"),
    ({"gap": 0.0, "optimum": 0.9}, "ga", 0.67, GAP.replace("2.50", "0")
     + "--solver exact finds it"),
    ({"gap": None, "optimum": 0.0}, "ga", 0.67, BELOW + "--solver exact finds it"),
    ({"optimal": True, "bounded": 345, "space": "all selections of up to 16 terms per coordinate"},
     "exact", 1.0, "Proven: no selection of up to 16 terms per coordinate has a better criterion "
                   "(12,345 subsets enumerated, 345 of them fathomed by bounds)"),
    ({"bound": 0.8, "gap": 0.125}, "exact", 1.0,
     "Not proven: at most 12.50 % above the optimum, which is 0.8 or more (12,345 of 99,999 "
     "subsets enumerated)"),
    ({"bound": 0.8, "gap": 0.125, "space": "selections of up to 16 terms per coordinate"},
     "exact", 1.0,
     "Not proven: at most 12.50 % above the optimum of up to 16 terms per coordinate, which is 0.8 "
     "or more (12,345 of 99,999 subsets enumerated)"),
    ({"bound": 0.0}, "exact", 1.0,
     "Not proven: 12,345 of 99,999 subsets enumerated; no lower bound is known yet"),
    ({"bound": 0.8, "gap": 2.5e-6}, "exact", 1.0,
     "Not proven: at most 0.00025 % above the optimum, which is 0.8 or more (12,345 of 99,999 "
     "subsets enumerated)"),
    ({"optimal": True, "subsets": 1, "of": 1}, "exact", 1.0,
     "Proven: no selection has a better criterion (1 subset enumerated, all sizes)"),
    ({"feasible": False}, "exact", 1.0,
     "Proven: no selection is feasible (12,345 subsets enumerated, all sizes)"),
    ({"feasible": False, "space": "all selections of up to 5 of 24 features"}, "exact", 1.0,
     "Proven: no selection of up to 5 of 24 features is feasible (12,345 subsets enumerated)"),
    ({}, "ga", 1.0, "Not proven: 12,345 of 99,999 subsets enumerated"),
    ({"subsets": 10**15 - 1, "of": 12 * 10**36}, "exact", 1.0,
     "Not proven: 999,999,999,999,999 of 1.2e37 subsets enumerated")])
def test_what_is_proven(more: dict[str, Any], solver: str, share: float, line: str) -> None:
    options = {**record()["options"], "problem": {"max_share": share}}
    text = page(certificate={**PROVEN, **more}, solver=solver, options=options)
    plain = page(solver=solver, options=options)
    assert " ".join(one for one in text if one not in plain) == line


@pytest.mark.parametrize(("figure", "shown"), [
    (None, "-"), (0.01, "0.010"), (0.00999, "0.010"), (99999.0, "99,999"),
    (100000.0, "1.00e+05")])
def test_figures_fit_their_columns(figure: float | None, shown: str) -> None:
    [line] = [line for line in page(rmse=roles(figure, 2.0, None)) if line.startswith("this")]
    assert line.split() == ["this", "result", "2", shown, "2.00", "-", "-"]


def test_fits_to_control_and_check_have_a_star() -> None:
    assert added(baselines=[baseline("dlt", 11, roles(1.0, 1.5, 2.5))]) == [
        "DLT *           11     1.00       1.50               2.50  1.99 to 3.39",
        "* also fitted to the selection points, so their RMSE is a fit"]


def test_an_rpc_as_delivered_has_no_star_as_it_is_fitted_to_nothing() -> None:
    text = page(baselines=[baseline("rpc-as-delivered", 6, roles(1.0, 1.5, 2.5))])
    assert "RPC as delivered      6     1.00       1.50               2.50  1.99 to 3.39" in text
    assert not any("*" in line for line in text)


def test_a_baseline_without_any_figure_is_said_to_be_not_determined() -> None:
    nothing = roles(None, None, None)
    alone = {"fitted_to": ("control",)}
    text = "- no redundancy"
    assert added(baselines=[baseline("rfm-3", 78, nothing, **alone)]) == [
        "full RFM        78        -          -                  -             -", text]
    # Without independent points it may be determined all the same.
    assert text not in added(baselines=[baseline("rfm-3", 78, roles(1.0, None, None), **alone)])


def test_a_model_that_corrects_by_its_control_shows_its_leave_one_out() -> None:
    text = page(rmse={**roles(1.0, 2.0, 3.0), "leave-one-out": rmse(1.75)})
    assert "  leave-one-out            1.75" in text
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
    text = page(strategy=strategy("regularised-cubic", 0.6, "dlt", "regularised-cubic"))
    assert text[-1] == "Model poly3d, strategy auto, seed 4; termsel 9.9"
    assert "Cross-validation repeated the whole choice in 20 folds." in text
    assert text[-12:-3] == [
        "Which terms and features were selected, and why?",
        "Chosen: regularised cubic, fitted to control and selection points; 1.2 s",
        "It is good. good. good. good. good. good. good. good. good. good. good. good. good.",
        "good. good. good.",
        "",
        "Models",
        "   model              terms  effective  leave-one-out RMSE [px]",
        "   DLT                   20        8.2                     0.50",
        "-> regularised cubic     20        8.2                     0.50"]
    assert "Accuracy: the RMSE at independent check points." in text
    assert any(line.startswith("this result * ") for line in text)
    assert not any(line.startswith(("Selected:", "Search:")) for line in text)


def test_a_choice_without_a_prediction() -> None:
    text = page(strategy=strategy("affine", None, "affine", "dlt"))
    assert "Chosen: affine, fitted to control and selection points; 1.2 s" in text
    assert not any("Cross-validation repeated" in line for line in text)


def member(terms: list[str], press: float, size: int, independent: float | None) -> dict[str, Any]:
    return {"objectives": {"n_terms": size, "press": press}, "rmse": roles(1, 2, independent),
            "selection": {"terms": terms, "features": ["A", "B"], "n_terms": 1, "n_features": 2,
                          "parameters": {}}}


FRONT = [member(["line:1"], 2.5, 1, None), member(["line:1", "line:X"], 1.5, 2, 1.25)]


def test_a_front_marks_the_selection() -> None:
    assert added(front=FRONT) == [
        "Pareto front",
        "   terms  leave-one-out RMSE  independent check [px]",
        "       1                 2.5                       -",
        "->     2                 1.5                    1.25"]


def test_a_front_says_what_is_proven_of_each_size() -> None:
    def sized(n: int, press: float, *proven: object) -> dict[str, object]:
        of = dict(zip(("better", "optimal", "bound", "gap"), proven, strict=True))
        return {**member([f"t{n}"], press, n, None), **of}

    assert added(by_size=[
        sized(1, 2.5, True, True, 2.5, 0.0), sized(2, 1.5, True, False, 1.2, 0.25),
        sized(3, 1.7, False, True, 1.7, 0.0), sized(4, 1.8, False, False, 1.5, 0.2),
        sized(5, 1.8, False, False, 1.4, 0.3), sized(6, 1.4, True, False, 0.4, 2.5),
        sized(7, 1.9, False, False, 1.4, 0.3), sized(8, 1.3, True, False, None, None)]) == [
        "Pareto front",
        "terms  leave-one-out RMSE  independent check [px]  best of its size",
        "    1                 2.5                       -  proven",
        "    2                 1.5                       -  gap at most 25.00 %",
        "    6                 1.4                       -  at most 3.5 times the optimum",
        "    8                 1.3                       -  not proven",
        "Proven: the best selection of 3, 4 and 7 terms is no better than that of fewer.",
        "Not proven: a selection of 5 terms may still be better than that of fewer."]


RULE = "The arrow marks the selection by the rule {}; --set recommend=RULE changes it."


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



def test_certain_and_probable_blunders_are_told_apart() -> None:
    found = page(outliers=[outlier("P2", 9.0, True),
                           outlier("P1", 4.0, False, "probable", "check"),
                           outlier("P3", 3.0, False, "possible")])
    at = next(i for i, line in enumerate(found) if "outlier test" in line)
    assert [line.split() for line in found[at + 1:at + 4]] == [
        ["P2", "point", "control", "9.00", "blunder", "rejected"],
        ["P1", "point", "selection", "4.00", "probable", "blunder", "in", "use"],
        ["P3", "point", "control", "3.00", "possible", "blunder", "in", "use"]]
    assert any(line.startswith("A probable blunder is more likely wrong than") for line in found)
    assert any(line.startswith("For a possible blunder the other features") for line in found)


def test_features_that_were_not_needed_are_counted() -> None:
    assert added(data=data(roles={**record()["data"]["roles"], "control": ["A", "B", "C", "D"]})) \
        == ["2 more points fit but were not selected."]


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
    ("all-terms", "check-rmse", "Accuracy: the RMSE at independent check points."),
    ("ridge", "check-rmse", "Accuracy: the RMSE at independent check points."),
    ("random", "press",
     "The search minimised the leave-one-out RMSE. Accuracy: the RMSE at independent check"),
    ("random", "check-rmse", "The search minimised the RMSE at selection points, so it is "
                             "optimistic; the accuracy is")])
def test_check_is_called_the_fitness_where_it_was_minimised(solver: str, criterion: str,
                                                            says: str) -> None:
    result = termsel.run("rfm-terms", strategy="as-asked", solver=solver, criterion=criterion,
                         evaluations=60)
    assert says in result.summary(verbose=True).splitlines()


@pytest.mark.parametrize(("criterion", "words", "axis"), [
    ("check-rmse", "selection RMSE", "selection RMSE [px]"),
    ("press", "leave-one-out RMSE", "leave-one-out RMSE [px]"),
    ("ebic", "ebic", "ebic"), ("largest-error", "largest-error", "largest-error")])
def test_a_criterion_has_the_words_of_the_field(criterion: str, words: str, axis: str) -> None:
    assert criterion_in_words(criterion) == words
    assert with_unit(criterion) == axis
