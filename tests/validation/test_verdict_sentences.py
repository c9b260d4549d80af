"""The judgement: each of its sentences, when it appears and when not, word by word."""

from __future__ import annotations

import pytest

import termsel
from termsel.auto.methods import named
from termsel.core.errors import count_in_words
from termsel.data.record.figures import Rmse
from termsel.fitting.figures import Baseline
from termsel.fitting.method import Method
from termsel.runs.judgement import judge, judge_choice, name_conventional

DLT = "a direct linear transformation (DLT)"
RFM = "rational function model"
LEFT_OUT = "In leave-one-out, in which each is predicted by a fit without it,"


def rmse(independent: float | None, n: int = 20) -> dict[str, Rmse | None]:
    """RMSE by role, of which a judgement looks at the independent one alone."""
    return {"control": Rmse(9.0, 9.0, 9.0, 30), "check": Rmse(8.0, 8.0, 8.0, 10),
            "independent": None if independent is None else Rmse(0.0, 0.0, independent, n)}


def baseline(name: str, independent: float | None, *, determined: bool = True,
             predicted: float | None = None) -> Baseline:
    return Baseline(name, 8, ("control", "check"), determined, rmse(independent), predicted)


def judged(mine: float | None, theirs: float = 1.0, *, determined: bool = True, n: int = 20,
           reference: str = "", others: tuple[Baseline, ...] = (), feasible: bool = True,
           noise: float | None = None) -> str:
    conventional = baseline("all-terms", theirs, determined=determined)
    return judge("all lines", "press", rmse(mine, n), (conventional, *others), reference, feasible,
                 noise)


NONE = " Control and selection points together determine no polynomial."


def test_an_infeasible_selection_gets_one_verdict_and_no_figure() -> None:
    assert judged(1.0, feasible=False, reference="affine", noise=0.5) == (
        "This selection does not satisfy all conditions, and no better one was found. It has "
        "undetermined or too many terms, an axis without terms, or a pole in the scene. Do not "
        "use it: measure more control points or choose a smaller model.")


def test_a_search_too_short_to_find_a_selection_says_so_and_blames_no_model() -> None:
    def verdict(evaluations: int | None) -> str:
        return judge("all lines", "press", rmse(1.0), (), "affine", False, None,
                     evaluations=evaluations)

    assert verdict(20) == (
        "This selection does not satisfy all conditions, and no better one was found with 20 "
        "evaluations, which is too few. Do not use it: search with 1,000 evaluations or more.")
    assert verdict(None) == verdict(1000)
    assert "smaller model" in verdict(1000)


def test_without_independent_points_nothing_is_compared() -> None:
    assert judged(None, reference="affine", noise=0.5) == (
        "There are no independent check points, so the accuracy of this selection is not known. "
        "The search minimised press.")


@pytest.mark.parametrize(("mine", "theirs", "sentence"), [
    (1.0, 2.0, "2.0 times better than all lines (1.00 px against 2.00 px)"),
    (1.0, 1.051, "1.1 times better than all lines (1.00 px against 1.05 px)"),
    (1.0, 1.049, "no better than all lines (1.00 px against 1.05 px)"),
    (1.0, 1.0, "no better than all lines (1.00 px against 1.00 px)"),
    (1.049, 1.0, "no better than all lines (1.05 px against 1.00 px)"),
    (1.051, 1.0, "1.1 times worse than all lines (1.05 px against 1.00 px)"),
    (3.0, 1.0, "3.0 times worse than all lines (3.00 px against 1.00 px)"),
    (0.1, 0.99, "9.9 times better than all lines (0.10 px against 0.99 px)"),
    (0.1, 1.0, "10 times better than all lines (0.10 px against 1.00 px)"),
    (1.0, 12345.0, "12,345 times better than all lines (1.00 px against 12,345 px)"),
    (0.099, 0.099, "no better than all lines (0.099 px against 0.099 px)"),
    (0.00123, 0.00246, "2.0 times better than all lines (0.0012 px against 0.0025 px)"),
    (0.0, 0.0, "no better than all lines (0 px against 0 px)")])
def test_the_selection_against_all_of_it(mine: float, theirs: float, sentence: str) -> None:
    assert judged(mine, theirs) == (
        f"The selection is {sentence} at 20 independent check points.{NONE}")


def test_better_than_a_failure_is_no_praise() -> None:
    others = (baseline("affine", 254.0),)
    assert judged(764.0, 369_000.0, others=others, reference="affine") == (
        "The RMSE of the selection is 764 px at 20 independent check points. A simpler "
        "model, an affine polynomial fitted to control and selection points, is 3.0 times better "
        "(254 px).")
    assert judged(762.0, 369_000.0, others=others, reference="affine").startswith(
        "The selection is 484 times better than all lines")


def test_one_independent_point_is_a_point() -> None:
    assert judged(1.0, n=1) == ("The selection is no better than all lines (1.00 px against 1.00 "
                                f"px) at 1 independent check point.{NONE}")
    assert judge_choice(candidate("dlt"), None, rmse(1.0, 1), (), None) == (
        f"The automatic choice is {DLT}. The RMSE at 1 independent check point, "
        "which took no part, is 1.00 px.")


def test_a_conventional_fit_that_is_not_determined_is_said_to_be() -> None:
    assert judged(1.0, 2.0, determined=False) == (
        "The selection is 2.0 times better than all lines (1.00 px against 2.00 px, which "
        f"is rank-deficient) at 20 independent check points.{NONE}")


@pytest.mark.parametrize(("name", "mine", "theirs", "sentence"), [
    ("affine", 1.051, 1.0, "A simpler model, an affine polynomial fitted to control and "
     "selection points, is 1.1 times better (1.00 px)."),
    ("affine", 1.049, 1.0, "It is no better than the automatic choice, an affine polynomial fitted "
     "to control and selection points (1.00 px)."),
    ("affine", 1.0, 1.049, "It is no better than the automatic choice, an affine polynomial fitted "
     "to control and selection points (1.05 px)."),
    ("affine", 1.0, 1.051, "It is 1.1 times better than the automatic choice, an affine polynomial "
     "fitted to control and selection points (1.05 px)."),
    ("regularised-cubic", 4.0, 2.0, "The automatic choice, a regularised cubic polynomial fitted "
     "to control and selection points, is 2.0 times better (2.00 px): omit --problem, "
     "--solver and --model."),
    ("rfm-3", 4.0, 2.0, f"The automatic choice, a third-order {RFM} fitted to control and "
     "selection points, is 2.0 times better (2.00 px): omit --problem, --solver and --model."),
    ("rfm-2", 4.0, 2.0, f"A simpler model, a second-order {RFM} fitted to control and "
     "selection points, is 2.0 times better (2.00 px).")])
def test_the_selection_against_the_choice_of_auto(
        name: str, mine: float, theirs: float, sentence: str) -> None:
    others = (baseline("cubic", 0.001), baseline(name, theirs))
    text = judged(mine, mine, others=others, reference=name)
    start = f"The selection is no better than all lines ({mine:.2f} px against {mine:.2f} px)"
    assert text == f"{start} at 20 independent check points. {sentence}"


@pytest.mark.parametrize("reference", ["", "quadratic", "all-terms"])
def test_without_a_baseline_by_that_name_none_is_determined(reference: str) -> None:
    assert judged(1.0, others=(baseline("affine", 0.1),), reference=reference).endswith(NONE)


def test_noise_is_that_of_both_coordinates_and_stands_at_the_end() -> None:
    assert judged(1.0, noise=0.5).endswith(f"{NONE} Measurement noise alone gives 0.71 px.")
    text = judged(1.0, others=(baseline("dlt", 1.0),), reference="dlt", noise=0.01)
    assert text.endswith("(1.00 px). Measurement noise alone gives 0.014 px.")
    assert "noise" not in judged(1.0)


def candidate(name: str) -> Method:
    found = named(name)
    assert found is not None
    return found


def test_a_choice_states_its_prediction_if_there_is_one() -> None:
    none = rmse(None)
    assert judge_choice(candidate("regularised-cubic"), 0.8765, none, (), 0.5) == (
        "The automatic choice is a regularised cubic polynomial, with a "
        "predicted RMSE of 0.88 px. It is not verified: there are no independent check points.")
    assert judge_choice(candidate("affine"), None, none, (), 0.5) == (
        "The automatic choice is an affine polynomial. It is not verified: there are no "
        "independent check points.")


CHOSEN = ("The automatic choice is a quadratic polynomial. The RMSE at 20 independent check "
          "points, which took no part, is 1.00 px; predicted there: 2.00 px.")


@pytest.mark.parametrize(("others", "sentence"), [
    ((), ""),
    ((baseline("dlt", 2.0, predicted=3.0),), f" There {DLT}, the best conventional model in "
     "cross-validation, has 2.00 px: 2.0 times as large."),
    # The best by leave-one-out, not by independent points; of the plain ones; not the choice.
    ((baseline("affine", 0.5, predicted=4.0), baseline("dlt", 2.0, predicted=3.0)),
     f" There {DLT}, the best conventional model in cross-validation, has 2.00 px: 2.0 times as "
     "large. At these points an affine polynomial is 2.0 "
     "times better (0.50 px), which only these points show."),
    ((baseline("dlt", 1.02, predicted=3.0), baseline("rfm-3", 0.1, predicted=0.1),
      baseline("selected", 0.1, predicted=0.1), baseline("quadratic", 0.1, predicted=0.1)),
     f" There {DLT}, the best conventional model in cross-validation, has 1.02 px: no practical "
     "difference."),
    ((baseline("rfm-2", 0.25, predicted=3.0),), f" There a second-order {RFM}, the best "
     "conventional model in cross-validation, has 0.25 px: 75 % smaller."),
    ((baseline("dlt", 2.0),), ""),
    ((baseline("quadratic", 2.0, predicted=1.0),), ""),
    ((baseline("all-terms", 2.0, predicted=1.0),), "")])
def test_a_choice_against_the_next_plain_structure(others: tuple[Baseline, ...],
                                                   sentence: str) -> None:
    chosen = candidate("quadratic")
    assert judge_choice(chosen, 2.0, rmse(1.0), others, None) == f"{CHOSEN}{sentence}"
    assert judge_choice(chosen, 2.0, rmse(1.0), others, 0.5) == (
        f"{CHOSEN}{sentence} Measurement noise alone gives 0.71 px.")


@pytest.mark.parametrize(("problem", "options", "name"), [
    ("rfm-terms", {}, "all terms"),
    ("owdis-points", {}, "all control points"),
    ("owdis-lines", {}, "all lines"),
    ("owdis-lines", {"mixed": True}, "all points and lines"),
    ("owdis-points-terms", {}, "all control points with all terms"),
    ("owdis-lines-terms", {}, "all lines with all terms"),
    ("owdis-lines-terms", {"mixed": True}, "all points and lines with all terms")])
def test_the_conventional_fit_is_named_by_what_could_be_selected(
        problem: str, options: dict[str, object], name: str) -> None:
    task = termsel.prepare(problem, dataset="ikonos-hamedan", options=options)
    assert name_conventional(task.problem.genome, task.observations) == name


@pytest.mark.parametrize(("number", "text"), [(0, "0 lines"), (1, "1 line"), (2, "2 lines")])
def test_a_number_and_its_noun(number: int, text: str) -> None:
    assert count_in_words(number, "line") == text


def test_without_many_check_points_both_models_are_compared_in_leave_one_out() -> None:
    """Not the prediction of the whole choice with the leave-one-out RMSE of one model."""
    rival = baseline("dlt", None, predicted=2.0)
    text = judge_choice(candidate("quadratic"), 2.5, rmse(None), (rival,), None, held_out=2.1,
                        gains=dict.fromkeys(("quadratic", "dlt"), 0.0))
    assert text.endswith(f" {LEFT_OUT} its model has 2.10 px, and {DLT}, the best "
                         "conventional model, 2.00 px: no practical difference.")
    assert "2.50 px against" not in text
