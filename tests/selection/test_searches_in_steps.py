"""Notes of searches in steps, and of rules without a front."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import termsel
from termsel.runs import steps
from termsel.runs.recommend import with_recommended_member
from termsel.selection.solvers.search import SearchResult


def found(value: float = 1.0, **more: object) -> SearchResult:
    """A search that ended with a value of its objective."""
    return SearchResult(**{  # type: ignore[arg-type]  # values of several kinds
        "genes": np.ones(8, dtype=bool), "objectives": np.array([value]), "violation": 0.0,
        "seed": 1, "evaluations": 10, "generations": 1, "lookups": 0, "seconds": 0.1,
        "interrupted": False, **more})


@pytest.fixture(scope="module")
def task() -> termsel.Task:
    return termsel.prepare("poly-terms", solver="all-terms", options={"recommend": "knee"})


NO_FRONT = "This search has no front from which to recommend by the rule {}."


@pytest.mark.parametrize("rule", ["one-standard-error", "knee", "ebic", "best"])
def test_a_rule_without_a_front_is_a_note(task: termsel.Task, rule: str) -> None:
    options = {**task.request.options, "problem": {
        **task.request.options["problem"], "recommend": rule}}
    ruled = replace(task, request=replace(task.request, options=options))
    search = found(genes=task.problem.genome.on, notes=("One.",))
    expected = ("One.",) if rule == "best" else ("One.", NO_FRONT.format(rule))
    assert with_recommended_member(ruled, search).notes == expected
    assert with_recommended_member(ruled, replace(search, front=(search.genes,))).notes == ("One.",)


@pytest.mark.parametrize(("order", "word", "counts"), [
    ("terms-first", "terms", "7 of 14"), ("features-first", "features", "11 of 120")])
def test_a_search_in_steps_tells_of_both(order: str, word: str, counts: str,
                                         monkeypatch: pytest.MonkeyPatch) -> None:
    small = termsel.prepare("owdis-lines-terms", options={
        "steps": order, "order": 1, "max_share": 1})
    slices, size = small.problem.genome.slices(), small.problem.genome.size
    n = {"terms": 7, "features": 11}[word]
    genes = np.ones(size, dtype=bool)
    feature = np.zeros(size, dtype=bool)
    feature[slices["features"]] = True
    mine = np.flatnonzero(feature if word == "features" else ~feature)
    genes[mine[n:]] = False
    assert counts == f"{n} of {len(mine)}"
    both = iter([found(2.34567, genes=genes, evaluations=100, generations=4, lookups=7,
                       seconds=1.0),
                 found(1.98765, genes=genes, evaluations=20, generations=3, lookups=5,
                       seconds=0.5)])
    monkeypatch.setattr(steps, "search", lambda *_, **__: next(both))
    result = steps.search_in_steps(small)
    assert result.notes == (
        f"In two steps: {word} first, check-rmse 2.346 with {counts} and everything else in use; "
        "then the rest, 1.988.",)
    assert (result.evaluations, result.generations, result.lookups, result.seconds) == (
        120, 7, 12, 1.5)


def once(search: SearchResult) -> Callable[..., SearchResult]:
    """A search that may be called once."""
    left = [search]
    return lambda *_, **__: left.pop()


def test_a_first_step_that_is_interrupted_is_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    small = termsel.prepare("owdis-lines-terms", options={"steps": "terms-first", "order": 1})
    first = found(interrupted=True)
    monkeypatch.setattr(steps, "search", once(first))
    assert steps.search_in_steps(small) is first


def test_a_first_step_that_finds_nothing_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    for order, word in (("terms-first", "terms"), ("features-first", "features")):
        small = termsel.prepare("owdis-lines-terms", options={"steps": order, "order": 1})
        monkeypatch.setattr(steps, "search", once(found(violation=0.1)))
        with pytest.raises(termsel.TermselError) as refused:
            steps.search_in_steps(small)
        assert str(refused.value) == (
            f"no selection of {word} with everything else in use satisfies all conditions. Choose "
            "--set steps=joint or the other order, or lower the order or degree of the model.")


def test_steps_are_for_one_objective() -> None:
    small = termsel.prepare("owdis-lines-terms", solver="nsga2", options={"steps": "terms-first"})
    with pytest.raises(termsel.TermselError) as refused:
        steps.search_in_steps(small)
    assert str(refused.value) == (
        f"steps=terms-first is for one objective, and there are "
        f"{len(small.problem.objectives)}: {', '.join(small.problem.objectives)}. Choose --set "
        "steps=joint, or a solver for one objective.")
