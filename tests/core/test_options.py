"""Values of options."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import termsel
from termsel.core.errors import TermselError
from termsel.core.options import Option

WHOLE = Option("split", 0, "Seed.", int, 0)


@pytest.mark.parametrize("value", [9007199254740993, "9007199254740993", " 9007199254740993 ",
                                   np.int64(9007199254740993)])
def test_whole_numbers_keep_all_their_digits(value: object) -> None:
    assert WHOLE.parse(value) == 9007199254740993


@pytest.mark.parametrize(("value", "parsed"), [("1e3", 1000), (5.0, 5), ("7.0", 7), ("0", 0)])
def test_whole_numbers_in_other_forms(value: object, parsed: int) -> None:
    found = WHOLE.parse(value)
    assert found == parsed
    assert type(found) is int


@pytest.mark.parametrize("value", ["1.5", "inf", "nan", float("inf"), True, "", "x", -1, [1],
                                   "1" * 5000 + ".5"])
def test_what_is_no_whole_number(value: object) -> None:
    with pytest.raises(TermselError, match="does not accept"):
        WHOLE.parse(value)


@pytest.mark.parametrize("value", [10**400, "1e999", "nan", True, None])
def test_what_is_no_number(value: object) -> None:
    with pytest.raises(TermselError, match="does not accept"):
        Option("ridge", 0.5, "A number.", float).parse(value)


def test_a_list_of_names_is_their_text_with_commas() -> None:
    names = Option("names", None, "Names, separated by commas.")
    assert names.parse(["X", "Y"]) == names.parse(("X", "Y")) == "X,Y"
    assert names.parse([0.1, 2]) == "0.1,2"
    task = termsel.prepare("rfm-terms", options={"objectives": ["n_terms", "max_correlation"],
                                                 "force_on": ["line.num:X", "line.num:Y"]})
    assert task.problem.objectives == ("check-rmse", "n_terms", "max_correlation")
    assert task.problem.genome.on.sum() == 2
    with pytest.raises(TermselError, match="unknown objective 'none-such'"):
        termsel.prepare("rfm-terms", options={"objectives": ["none-such"]})


class FoldedSearch(termsel.GeneticAlgorithm):
    """A search that has an option of a criterion, too."""

    name = "folded"
    declared_options = (*termsel.GeneticAlgorithm.declared_options,
                        Option("folds", 5, "Folds.", int, 2))


def test_an_option_of_two_parts_is_addressed_by_one() -> None:
    asked: dict[str, Any] = {"solver": FoldedSearch, "criterion": "kfold"}
    with pytest.raises(TermselError,
                       match="criterion and solver each have an option 'folds'") as refused:
        termsel.prepare("poly-terms", **asked, options={"folds": 3})
    assert refused.value.hint == "Write criterion.folds or solver.folds."
    task = termsel.prepare("poly-terms", **asked, options={"solver.folds": 3})
    assert task.solver.options["folds"] == 3
    assert task.criterion.options["folds"] != 3
    for wrong, message in (({"model.folds": 3}, r"unknown option 'model\.folds'"),
                           ({"solver.loss": "huber"}, r"unknown option 'solver\.loss'"),
                           ({"loss": "huber", "criterion.loss": "squares"}, "given twice")):
        with pytest.raises(TermselError, match=message):
            termsel.prepare("poly-terms", **asked, options=wrong)
