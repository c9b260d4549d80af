"""By default all solvers run alike: one cap, one budget, a refinement where it is declared."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import termsel
from termsel import Evaluation, Generation, Problem, Solver, TermselError, search
from termsel.cli.main import cli
from termsel.plugins.registry import Entry, registry
from termsel.selection.solvers.budget import EVALUATIONS, SEARCH_OPTIONS
from termsel.selection.solvers.genetic.ga import GeneticAlgorithm
from termsel.selection.solvers.heuristics.yardsticks import RandomSearch
from termsel.testing import problems


class Third(RandomSearch):
    """A third party's solver."""

    name = "third"


class Still(Solver):
    """Yields the same selections for ever, then a better one."""

    name = "still"

    def __init__(self, gains: dict[int, float] | None = None) -> None:
        super().__init__()
        self.gains = gains or {}

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        index = 0
        while True:
            genes = np.zeros((3, problem.genome.size), dtype=bool)
            genes[0, :1 + sum(at <= index for at in self.gains)] = True
            yield Generation(index, genes, problem.evaluate(genes))
            index += 1


class Falling(Problem):
    """The objective falls by the gains of `Still`, one gene after the other."""

    objectives = ("cost",)

    def __init__(self, values: list[float]) -> None:
        self.genome = termsel.Genome([termsel.Segment("g", tuple("abcdef"))])
        self.values = np.array([50.0, *values])

    def evaluate(self, genes: np.ndarray) -> Evaluation:
        on = genes.sum(axis=1)
        return Evaluation(self.values[np.minimum(on, len(self.values) - 1)][:, None],
                          np.where(on == 0, 1.0, 0.0))

    def decode(self, genes: np.ndarray) -> termsel.Selection:
        return termsel.Selection((), ())


@pytest.fixture
def third(monkeypatch: pytest.MonkeyPatch) -> None:
    names = registry()
    known = names.get
    monkeypatch.setattr(type(names), "get", lambda self, kind, name:
                        Third if (kind, name) == ("solvers", "third") else known(kind, name))


@pytest.mark.slow_cases("ica", "nsga2", "random", "third")
@pytest.mark.usefixtures("third")
@pytest.mark.parametrize("solver", ["ga", "ica", "random", "third", "swap", "nsga2"])
def test_a_solver_asked_for_by_name_has_the_budget_the_cap_and_no_refinement(solver: str) -> None:
    result = termsel.run("poly-terms", solver=solver, options={"degree": 3})
    assert result.evaluations == EVALUATIONS
    assert result.options.problem["max_share"] == pytest.approx(2 / 3)
    assert result.options.search["polish"] is False
    assert result.polish is None


@pytest.mark.usefixtures("third")
@pytest.mark.parametrize("solver", ["ga", "third", "nsga2"])
def test_a_refinement_is_part_of_the_budget_of_any_solver(solver: str) -> None:
    result = termsel.run("poly-terms", solver=solver, evaluations=2000,
                         options={"polish": True, "degree": 3})
    assert result.polish is not None
    assert result.evaluations <= 2000
    assert result.evaluations - result.polish.evaluations == 500
    assert result.polish.polished <= result.polish.found
    assert "Local refinement: selection RMSE" in result.summary(verbose=True)


def test_the_own_run_of_a_problem_refines_and_says_so() -> None:
    result = termsel.run("owdis-points", generations=2)
    assert result.options.search == {
        "polish": True, "tolerance": next(o.default for o in SEARCH_OPTIONS
                                          if o.name == "tolerance")}
    assert result.to_dict()["polish"]["evaluations"] > 0
    assert "Local refinement: selection RMSE" in result.summary(verbose=True)
    without = termsel.run("owdis-points", generations=2, options={"polish": False})
    assert without.polish is None
    assert "Local refinement" not in without.summary(verbose=True)


def test_rates_of_a_paper_are_those_of_its_set_up_alone() -> None:
    for named in (None, "ga"):
        assert termsel.prepare("poly-terms", solver=named).solver.options["mutation"] is None
    own = termsel.prepare("poly-terms", solver="ga", options={"mutation": 0.02})
    assert own.solver.options["mutation"] == 0.02
    shown = CliRunner().invoke(cli, ["describe", "ga"]).output
    assert "By name" not in shown
    assert "Differences from the paper:\n- The best 2 chrom" in shown
    assert "polish" in shown


@pytest.mark.parametrize(("evaluations", "population"), [
    (500, 20), (4000, 60), (16040, 200), (100_000, 200), (None, 200)])
def test_the_population_follows_the_budget(evaluations: int | None, population: int) -> None:
    problem = problems.problem_of_twelve_terms()
    problem.budget = evaluations
    assert GeneticAlgorithm().population_size(problem) == population
    assert GeneticAlgorithm(population=33).population_size(problem) == 33


@pytest.mark.parametrize("entry", registry().entries("solvers"), ids=lambda one: one.name)
def test_departures_of_a_solver_are_sentences(entry: Entry) -> None:
    assert all(one.endswith(".") for one in entry.object.departures)


@pytest.mark.parametrize(("gains", "values", "patience", "ends"), [
    ({}, [9.0], 3, 3),                            # nothing is gained after the first generation
    ({2: 1, 4: 1}, [9.0, 8.0, 7.0], 3, 7),        # a gain begins the waiting anew
    ({2: 1}, [9.0, 9.0 - 1e-5], 3, 3),            # below the tolerance
    ({2: 1}, [9.0, 9.0 - 1e-2], 3, 5)])
def test_patience_waits_for_gains_above_the_tolerance(
        gains: dict[int, float], values: list[float], patience: int, ends: int) -> None:
    found = search(Falling(values), Still(gains), patience=patience, tolerance=1e-4)
    assert found.generations == ends
    tolerant = search(Falling(values), Still(gains), patience=patience, tolerance=0.5)
    assert tolerant.generations == patience


def test_patience_waits_for_what_is_feasible() -> None:
    class Nearer(Falling):
        def evaluate(self, genes: np.ndarray) -> Evaluation:
            inner = super().evaluate(genes)
            return Evaluation(inner.objectives, np.maximum(3.0 - genes.sum(axis=1), 0.0))

    found = search(Nearer([9.0, 9.0, 9.0, 9.0]), Still({2: 1, 4: 1}), patience=3)
    assert found.generations == 7
    assert found.violation == 0


def test_history_holds_each_generation() -> None:
    problem = problems.problem_of_twelve_terms()
    seen = []
    found = search(problem, GeneticAlgorithm(population=20), generations=6,
                   observers=[lambda progress: seen.append(progress.generation)])
    assert len(found.history) == len(seen) == 7
    assert [one.evaluations for one in found.history] == [20 + 18 * i for i in range(7)]
    bests = [one.best for one in found.history]
    assert bests == sorted(bests, reverse=True)
    assert bests[-1] == found.objectives[0]
    for one, generation in zip(found.history, seen, strict=True):
        feasible = generation.evaluation.violation == 0
        assert one.feasible == feasible.mean()
        assert one.median == np.median(generation.evaluation.objectives[feasible, 0])
    hopeless = search(problems.hopeless_problem(), GeneticAlgorithm(population=5), generations=1)
    assert {(one.best, one.median, one.feasible) for one in hopeless.history} == {(None, None, 0.0)}


@pytest.mark.slow
def test_histories_of_repeated_searches_follow_each_other() -> None:
    result = termsel.run("owdis-lines-terms", generations=4,
                         options={"steps": "terms-first", "population": 20, "polish": False,
                                  "blunders": "keep"})
    counts = [one.evaluations for one in result.history]
    assert counts == sorted(counts)
    assert len(counts) == 6
    assert counts[-1] == result.evaluations


def test_patience_and_tolerance_on_the_command_line() -> None:
    done = CliRunner().invoke(cli, [
        "run", "--problem", "poly-terms", "--solver", "ga", "--patience", "2", "--set",
        "tolerance=0.9", "--set", "degree=3", "--json", "--quiet"])
    record = json.loads(done.stdout)
    assert record["generations"] < 10
    assert len(record["history"]) == record["generations"] + 1
    assert record["options"]["search"] == {"polish": False, "tolerance": 0.9}


def test_what_found_coefficients_cannot_be_refined() -> None:
    with pytest.raises(TermselError, match="coefficients for its own"):
        termsel.run("poly-terms", solver="ridge", options={"polish": True})


def test_one_search_after_another_adds_up() -> None:
    problem = problems.problem_of_twelve_terms()
    found = search(problem, GeneticAlgorithm(population=10), generations=1)
    both = replace(found, notes=("one",)).after(found, "two")
    assert both.evaluations == 2 * found.evaluations
    assert [one.evaluations for one in both.history] == [10, 18, 28, 36]
    assert both.notes == ("one", "two")


def test_a_gain_is_told_with_the_evaluation_that_found_it() -> None:
    problem = problems.problem_of_twelve_terms()
    found = search(problem, GeneticAlgorithm(population=20), evaluations=200)
    genes = []
    seen = search(problem, GeneticAlgorithm(population=20), evaluations=200,
                  observers=[lambda progress: genes.append(progress.generation.genes)])
    assert seen.gains == found.gains
    best = np.inf
    for _evaluation, value in found.gains:
        assert value < best
        best = value
    assert best == found.objectives[0]
    # Those of the first population, in the order of its individuals.
    first = problems.problem_of_twelve_terms().evaluate(genes[0])
    values = np.where(first.violation == 0, first.objectives[:, 0], np.inf)
    of_first = [gain for gain in found.gains if gain[0] <= 20]
    assert [values[evaluation - 1] for evaluation, _value in of_first] == [
        value for _evaluation, value in of_first]
    assert of_first[-1][1] == values.min()
