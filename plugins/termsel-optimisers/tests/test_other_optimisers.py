"""DEAP and pymoo in other processes, with genes of all types, and optimisers that ask and tell."""

# mypy: disable-error-code="arg-type,func-returns-value"
# ruff: noqa: ARG005
from __future__ import annotations

import copy
import json
import multiprocessing
import pickle
import random
import runpy
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from deap import algorithms, base, tools
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.algorithms.soo.nonconvex.ga import GA
from pymoo.core.mixed import MixedVariableGA
from pymoo.operators.crossover.ux import UX
from pymoo.operators.mutation.bitflip import BitflipMutation
from pymoo.operators.sampling.rnd import BinaryRandomSampling
from pymoo.optimize import minimize
from pymoo.parallelization.starmap import StarmapParallelization

import termsel
from termsel import TermselError, search
from termsel.testing import problems
from termsel.testing.problems import Counted
from termsel.toolkit.searches import SEGMENTS, Ledger
from termsel_optimisers import from_ask_tell, from_deap, from_pymoo, to_deap

HOW_TO = Path(__file__).parents[3] / "docs" / "how-to"


def small(solver: Any = None, **options: Any) -> termsel.Task:
    return termsel.prepare("poly-terms", solver=solver, options={"degree": 2, **options})


def islands(box: base.Toolbox) -> list[Any]:
    """Evolve two populations that exchange their best; operators break forced genes."""
    random.seed(5)
    box.register("mutate", tools.mutFlipBit, indpb=0.4)
    islands = [box.population(n=8) for _ in range(2)]
    for _ in range(2):
        islands = [algorithms.eaSimple(one, box, 0.6, 0.5, 1, verbose=False)[0] for one in islands]
        tools.migRing(islands, 2, tools.selBest)
    return [one for island in islands for one in island]


def _map_of_processes(start: str) -> Any:
    return multiprocessing.get_context(start).Pool(1)


@contextmanager
def _map_of_dask(_start: str) -> Iterator[Any]:
    distributed = pytest.importorskip("distributed")
    with distributed.Client(n_workers=1, threads_per_worker=1, dashboard_address=None) as client:
        yield SimpleNamespace(map=lambda function, *each: client.gather(
            client.map(function, *each, pure=False)))


@pytest.mark.slow_cases("_map_of_dask-", "_map_of_processes-spawn")
@pytest.mark.parametrize(("pool", "start"), [
    pytest.param(_map_of_processes, "fork", marks=pytest.mark.skipif(
        "fork" not in multiprocessing.get_all_start_methods(), reason="no fork here")),
    (_map_of_processes, "spawn"), (_map_of_dask, "")])
def test_other_processes_evaluate_the_same(pool: Any, start: str) -> None:
    problem = small(max_share=0.4, force_on="line.num:X").problem
    alone = islands(to_deap(problem))
    with pool(start) as several:
        box = to_deap(problem)
        box.register("map", several.map)
        found = islands(box)
    assert problem.genome.keeps(np.array(found)).all()
    assert [one.fitness.values[0] for one in found] == pytest.approx(
        problem.evaluate(np.array(found)).objectives[:, 0])
    assert [tuple(one.objectives) for one in found] == [one.fitness.values for one in found]
    if start:  # dask itself draws from the global random state
        assert found == alone


def test_toolboxes_and_individuals_survive_pickling() -> None:
    box = to_deap(Counted(small().problem))
    one = box.individual()
    one.fitness.values = box.evaluate(one)
    again = pickle.loads(pickle.dumps(one))
    assert again == one
    assert again.fitness == one.fitness
    assert (again.objectives == one.objectives).all()
    assert copy.deepcopy(again).fitness.values == one.fitness.values
    loaded = pickle.loads(pickle.dumps(box))
    several = [again, copy.deepcopy(one)]
    for values in loaded.map(loaded.evaluate, several):
        assert values == pytest.approx(one.fitness.values)


def test_a_search_tells_who_evaluates_elsewhere() -> None:
    task = small()
    solver = from_deap(lambda problem: to_deap(task.problem), name="elsewhere")
    with pytest.raises(TermselError, match=r"'elsewhere' .* evaluated nothing with the problem"):
        search(task.problem, solver(population=10), generations=3)
    with pytest.raises(TermselError, match="counts evaluations in its own process"):
        pickle.dumps(Ledger(task.problem))


def test_a_solver_finds_what_the_same_script_finds() -> None:
    """With the same seed, where no forced gene or count calls for a repair."""
    mine = NSGA2(pop_size=20, sampling=BinaryRandomSampling(), crossover=UX(),
                 mutation=BitflipMutation())
    task = small(objectives="n_terms", solver=from_pymoo(mine))
    def keep(people: list[np.ndarray]) -> Callable[[Any], None]:
        return lambda progress: people.append(progress.generation.genes)

    for seed in range(3):
        script = minimize(termsel.to_pymoo(task.problem), mine, ("n_gen", 8), seed=seed)
        people: list[np.ndarray] = []
        search(task.problem, from_pymoo(mine)(), seed=seed, generations=7, observers=[
            keep(people)])
        assert np.array_equal(people[-1], script.pop.get("X"))


def test_variables_of_all_types_evolve_by_their_types() -> None:
    problem = problems.typed_problem(SEGMENTS)
    mine = from_pymoo(MixedVariableGA(pop_size=20))
    assert (mine.min_objectives, mine.max_objectives) == (1, 1)
    first, found, again = (search(problem, mine(), seed=1, generations=n) for n in (1, 25, 25))
    assert np.array_equal(found.genes, again.genes)
    assert found.objectives[0] < first.objectives[0]
    assert problem.genome.keeps(found.genes[None]).all()
    script = minimize(termsel.to_pymoo(problem), MixedVariableGA(pop_size=20), ("n_gen", 10),
                      seed=1)
    assert script.X["integers.0"] == int(script.X["integers.0"])
    genes = np.array([[script.X[name] for name in termsel.to_pymoo(problem).vars]], dtype=float)
    valid = problem.genome.repair(genes, np.random.default_rng(0))
    assert script.F[0] == pytest.approx(problem.evaluate(valid).objectives[0, 0])
    bits = search(problems.problem_of_twelve_terms(), mine(), evaluations=200)
    assert bits.genes.dtype == bool


class Failing(BitflipMutation):  # type: ignore[misc]
    """Fail in the second generation."""

    def _do(self, *_args: Any, **_given: Any) -> Any:
        raise KeyError("of mine")


def test_a_crash_within_pymoo_names_the_algorithm() -> None:
    mine = from_pymoo(GA(pop_size=10, sampling=BinaryRandomSampling(), crossover=UX(),
                         mutation=Failing()))
    with pytest.raises(TermselError, match=r"GA of pymoo .* failed in ask.*KeyError: 'of mine'"):
        search(problems.problem_of_twelve_terms(), mine(), generations=3)


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork here")
def test_runners_of_pymoo_evaluate_in_other_processes() -> None:
    task = small()
    X = task.problem.genome.random(np.random.default_rng(1), 5)
    with multiprocessing.get_context("fork").Pool(1) as pool:
        spread = termsel.to_pymoo(task.problem,
                                  elementwise_runner=StarmapParallelization(pool.starmap))
        found = spread.evaluate(X, return_values_of=["F", "G"])
    for one, same in zip(found, termsel.to_pymoo(task.problem).evaluate(
            X, return_values_of=["F", "G"]), strict=True):
        assert one == pytest.approx(same)


class Walk:
    """Ask for a few random neighbours of the best."""

    def __init__(self, problem: termsel.Problem, rng: np.random.Generator) -> None:
        self.rng, self.best = rng, problem.genome.random(rng, 1)[0]
        self.cost, self.told = np.inf, 0

    def ask(self) -> Any:
        if self.told == 40:
            return None
        genes = np.repeat(self.best[None], 3, axis=0)
        genes[np.arange(3), self.rng.integers(len(self.best), size=3)] ^= True
        return genes

    def tell(self, genes: np.ndarray, evaluation: termsel.Evaluation) -> None:
        self.told += 1
        costs = evaluation.objectives[:, 0] + 1e6 * evaluation.violation
        if costs.min() < self.cost:
            self.best, self.cost = genes[costs.argmin()], costs.min()


def test_an_optimiser_that_asks_and_tells_is_a_solver() -> None:
    mine = from_ask_tell(Walk)
    assert (mine.name, mine.__doc__) == ("walk", "Ask for a few random neighbours of the best.")
    problem = problems.bounded_problem()
    one, two = (search(problem, mine(), seed=3) for _ in range(2))
    assert (one.evaluations, one.generations) == (120, 39)  # it ended by itself
    assert np.array_equal(one.genes, two.genes)
    assert problem.genome.keeps(one.genes[None]).all()
    first, *_, last = [step.best for step in one.history if step.best is not None]
    assert last < first
    assert termsel.run("poly-terms", solver=mine, evaluations=60, options={"degree": 2}).feasible


@pytest.mark.parametrize(("asked", "said"), [
    ([1, 0], r"returned an array of shape \(1, 2\); expected .* \(n, 18\)"),
    ([np.nan] * 18, "18 numbers that are not finite"), ("abc", "failed in ask.*ValueError"),
    ([[1], [1, 2]], "failed in ask.*ValueError")])
def test_what_no_optimiser_asks_is_named(asked: Any, said: str) -> None:
    class Odd(Walk):
        def ask(self) -> Any:
            return asked

    with pytest.raises(TermselError, match=f"Odd .*{said}"):
        search(problems.bounded_problem(), from_ask_tell(Odd)(), generations=3)


def test_what_makes_no_optimiser_is_refused() -> None:
    with pytest.raises(TermselError, match="7 is no function or class"):
        from_ask_tell(7)
    def failing(*_: object) -> Any:
        return 1 // 0

    with pytest.raises(TermselError, match=r"failing .* failed in failing\(\): ZeroDivision"):
        search(problems.bounded_problem(), from_ask_tell(failing)())


@pytest.mark.parametrize(("library", "optimiser"), [
    ("optuna", "Parzen"), ("nevergrad", "OnePlusOne")])
def test_optimisers_of_other_libraries_are_solvers(library: str, optimiser: str) -> None:
    pytest.importorskip(library)
    page = runpy.run_path(str(HOW_TO / f"with_{library}.py"))
    mine = from_ask_tell(page[optimiser])
    one, two = (search(problems.problem_of_twelve_terms(), mine(), seed=5, evaluations=60)
                for _ in range(2))
    assert np.array_equal(one.genes, two.genes)
    assert one.evaluations == 60
    first, *_, last = [step.best for step in one.history if step.best is not None]
    assert last < first


def test_the_problem_of_the_how_to_is_logged_by_ioh(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ioh")
    monkeypatch.chdir(tmp_path)
    text = (HOW_TO / "deap-and-pymoo.md").read_text(encoding="utf-8")
    script = next(block for block in text.split("```python\n") if block.startswith("import ioh"))
    exec(script.partition("```")[0], {})
    [described] = tmp_path.rglob("IOHprofiler*.json")
    [scenario] = json.loads(described.read_text())["scenarios"]
    assert scenario["dimension"] == 20
    assert scenario["runs"][0]["evals"] == 200
