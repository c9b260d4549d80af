"""DEAP and pymoo as their users know them: scripts and algorithms of theirs, as they stand."""

# mypy: disable-error-code="arg-type,func-returns-value"
# ruff: noqa: ARG001, ARG005
from __future__ import annotations

import json
import pkgutil
import random
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pymoo.algorithms.moo
import pymoo.algorithms.soo.nonconvex
import pytest
from deap import algorithms, base, tools
from pymoo.algorithms.moo.moead import MOEAD
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.algorithms.moo.rnsga2 import RNSGA2
from pymoo.algorithms.soo.nonconvex.ga import GA
from pymoo.algorithms.soo.nonconvex.pso import PSO
from pymoo.algorithms.soo.nonconvex.random_search import RandomSearch
from pymoo.operators.crossover.pntx import TwoPointCrossover
from pymoo.operators.crossover.ux import UX
from pymoo.operators.mutation.bitflip import BitflipMutation
from pymoo.operators.sampling.rnd import BinaryRandomSampling
from pymoo.optimize import minimize

import termsel
from termsel import GeneticAlgorithm, TermselError, search
from termsel.testing import Check, checks, global_states, invoke, problems
from termsel.testing.problems import Counted, Watched
from termsel.toolkit import Progress
from termsel_optimisers import from_deap, from_pymoo, to_deap
from termsel_optimisers.deap_algorithms import Deap
from termsel_optimisers.pymoo_algorithms import PYMOO_ALGORITHMS, SINGLE, UNFIT, Pymoo


class Free(termsel.Problem):
    """All genes of a genome are equally good."""

    objectives = ("cost",)

    def __init__(self, genome: termsel.Genome) -> None:
        self.genome = genome

    def evaluate(self, genes: np.ndarray) -> termsel.Evaluation:
        return termsel.Evaluation(np.ones((len(genes), 1)), np.zeros(len(genes)))

    def decode(self, genes: np.ndarray) -> termsel.Selection:
        return termsel.Selection((), ())


def small(**options: Any) -> termsel.Task:
    return termsel.prepare("poly-terms", options={"degree": 2, **options})


def test_a_deap_script_runs_as_it_stands() -> None:
    task = termsel.prepare("poly-terms", options={"degree": 3})
    watched = Watched(task.problem)
    random.seed(1)
    box = to_deap(watched)
    last, log = algorithms.eaSimple(box.population(n=60), box, 0.9, 0.2, 15, verbose=False)
    assert len(last) == 60
    assert watched.calls == 16  # a batch a generation
    assert watched.evaluated == sum(log.select("nevals"))
    best = tools.selBest(last, 1)[0]
    true = task.problem.evaluate(np.array([best]))
    assert best.fitness.values == pytest.approx(tuple(true.objectives[0]), rel=1e-9)
    assert true.violation[0] == 0
    first = termsel.search(task.problem, GeneticAlgorithm(population=60), generations=1)
    assert best.fitness.values[0] < first.objectives[0] * 1.2
    random.seed(1)
    again, _ = algorithms.eaSimple(box.population(n=60), box, 0.9, 0.2, 15, verbose=False)
    assert again == last


def test_infeasible_individuals_are_penalised_by_their_violation() -> None:
    class Broken(termsel.Problem):
        objectives = ("cost",)
        genome = termsel.Genome([termsel.Bits("g", ("a", "b", "c"))])

        def evaluate(self, genes: np.ndarray) -> termsel.Evaluation:
            return termsel.Evaluation(np.full((len(genes), 1), 5.0),
                                      genes.sum(axis=1).astype(float))

        def decode(self, genes: np.ndarray) -> termsel.Selection:
            return termsel.Selection((), ())

    box = to_deap(Broken())
    people = [box.individual() for _ in range(3)]
    people[0][:], people[1][:], people[2][:] = [0, 0, 0], [1, 0, 0], [1, 1, 1]
    fitness = list(box.map(box.evaluate, people))
    assert fitness[0] == (5.0,)
    assert fitness[0] < fitness[1] < fitness[2]
    assert fitness[2][0] - fitness[1][0] == 2.0
    assert box.evaluate(people[1]) == fitness[1]


def test_individuals_keep_forced_genes_whatever_the_operators_do() -> None:
    problem = problems.bounded_problem()
    box = to_deap(problem)
    box.register("mutate", tools.mutFlipBit, indpb=0.5)
    random.seed(2)
    last, _ = algorithms.eaSimple(box.population(n=20), box, 0.5, 1.0, 5, verbose=False)
    genes = np.array(last)
    assert problem.genome.keeps(genes).all()


def test_a_replaced_evaluation_is_called_for_each_individual() -> None:
    box = to_deap(small().problem)
    calls = []
    plain = box.evaluate
    box.register("evaluate", lambda one: calls.append(1) or plain(one))
    random.seed(3)
    algorithms.eaSimple(box.population(n=7), box, 0.5, 0.2, 0, verbose=False)
    assert len(calls) == 7


@pytest.mark.parametrize("options", [
    {}, {"algorithm": "eaMuPlusLambda"}, {"algorithm": "eaMuCommaLambda", "children": 40},
    {"select": "selRoulette", "mate": "cxOnePoint", "mutate": "mutShuffleIndexes:indpb=0.1"},
    {"select": "selDoubleTournament:fitness_size=3,parsimony_size=1.4,fitness_first=True"}])
def test_algorithms_and_operators_by_name(options: dict[str, Any]) -> None:
    before = global_states()
    details = []
    found = search(problems.problem_of_twelve_terms(), Deap(population=20, **options), seed=3,
                   generations=5,
                   observers=[lambda progress: details.append(progress.generation.details)])
    assert global_states() == before
    assert found.generations == 5
    assert len(found.history) == 6
    assert len(details[-1]["logbook"]) == 6
    assert details[-1]["logbook"].select("gen") == [0, 1, 2, 3, 4, 5]
    # The toolbox has figures of nine digits.
    best = details[-1]["halloffame"][0].fitness.values[0]
    assert best == pytest.approx(found.objectives[0], rel=1e-8)
    again = search(problems.problem_of_twelve_terms(), Deap(population=20, **options), seed=3,
                   generations=5)
    assert np.array_equal(found.genes, again.genes)


@pytest.mark.parametrize(("options", "said"), [
    ({"algorithm": "eaSimpel"}, "no algorithm 'eaSimpel'"),
    ({"algorithm": "nowhere:loop"}, "cannot be imported"),
    ({"select": "selTornament"}, "selTornament"),
    ({"select": "selTournament"}, "requires tournsize"),
    ({"select": "selTournament:size=3"}, "no argument 'size'"),
    ({"select": "selTournament:tournsize"}, "is no argument"),
    ({"mate": "mutFlipBit"}, "mutFlipBit"),
    ({"algorithm": "eaMuPlusLambda", "cxpb": 0.9, "mutpb": 0.9}, "add up to 1.8"),
    ({"algorithm": "os.path:join"}, "has no argument 'ngen'")])
def test_what_deap_does_not_have_is_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(TermselError, match=said):
        search(problems.problem_of_twelve_terms(), Deap(**options), generations=1)


def own_box(problem: termsel.Problem) -> base.Toolbox:
    """Two-point crossover."""
    box = to_deap(problem)
    box.register("mate", tools.cxTwoPoint)
    return box


def own_loop(population: list[Any], toolbox: base.Toolbox) -> Iterator[list[Any]]:
    """Keep the better half."""
    while True:
        yield population
        best = toolbox.select(population, len(population) // 2)
        population = best + algorithms.varAnd(best, toolbox, 0.5, 0.5)


@pytest.mark.parametrize("loop", [algorithms.eaSimple, own_loop])
def test_a_toolbox_of_ones_own_is_a_solver(loop: Any) -> None:
    solver = from_deap(own_box, loop)
    assert solver.name == "own-box"
    before = global_states()
    result = termsel.run("poly-terms", solver=solver, evaluations=600,
                         options={"degree": 2, "population": 30})
    assert global_states() == before
    assert result.solver == "own-box"
    assert result.evaluations == 600
    assert result.feasible


def test_a_pymoo_script_runs_as_it_stands() -> None:
    task = termsel.prepare("poly-terms", options={"degree": 3})
    watched = Watched(task.problem)
    found = minimize(termsel.to_pymoo(watched), GA(
        pop_size=60, sampling=BinaryRandomSampling(), crossover=UX(),
        mutation=BitflipMutation()), ("n_gen", 15), seed=1)
    assert watched.calls == 15
    true = task.problem.evaluate(found.X[None])
    assert found.F[0] == pytest.approx(true.objectives[0, 0], rel=1e-9)
    assert found.G[0] == true.violation[0] == 0


def test_broken_rules_of_the_genome_are_a_constraint() -> None:
    genome = termsel.Genome([termsel.Bits("g", ("a", "b", "c", "d"), 1, 2)], on=("a",))

    X = np.array([[1, 0, 0, 0], [0, 0, 0, 0], [1, 1, 1, 1], [0, 1, 1, 1]], dtype=bool)
    G = termsel.to_pymoo(Free(genome)).evaluate(X, return_values_of=["G"])
    assert G[:, 0].tolist() == [0.0, 2.0, 2.0, 2.0]


def test_variables_have_the_ranges_of_their_genes() -> None:
    posed = termsel.to_pymoo(Free(termsel.Genome([
        termsel.Bits("b", ("a",)), termsel.Integers("i", ("j", "k"), 2, (3, 9000)),
        termsel.Reals("r", ("x",), -1.5, 1), termsel.Categories("c", ("y",), ("u", "v", "w")),
        termsel.Permutation("p", ("1", "2")), termsel.Subset("s", tuple("qrstu"), 2)])))
    assert posed.xl.tolist() == [0, 2, 2, -1.5, 0, 0, 0, 0, 0]
    assert posed.xu.tolist() == [1, 3, 9000, 1, 2, 1, 1, 4, 4]


@pytest.mark.parametrize("algorithm", PYMOO_ALGORITHMS)
def test_each_algorithm_of_pymoo_runs_and_repeats(algorithm: str) -> None:
    task = termsel.prepare("poly-terms", solver="pymoo", options={
        "degree": 2, "algorithm": algorithm, "population": 20})
    before = global_states()
    one, two = (search(task.problem, task.solver, generations=4) for _ in range(2))
    assert np.array_equal(one.genes, two.genes)
    assert np.array_equal(one.front, two.front)
    assert global_states() == before
    assert one.violation == two.violation == 0
    assert len(one.objectives) == (1 if algorithm in SINGLE else 2)
    assert bool(one.front) == (algorithm not in SINGLE)


@pytest.mark.parametrize("algorithm", ["nsga3", "unsga3", "ga_niching"])
def test_generators_that_pymoo_makes_without_a_seed_have_one(algorithm: str) -> None:
    """It draws from them where two are equally infeasible."""
    solver = Pymoo(algorithm=algorithm, population=20)
    problem = problems.trap_problem() if algorithm in SINGLE else Counted(problems.trap_problem())
    seen: list[bytes] = []
    for _ in range(2):
        search(problem, solver, generations=6, observers=[
            lambda progress: seen.append(progress.generation.genes.tobytes())])
    assert seen[:7] == seen[7:]


@pytest.mark.slow
@pytest.mark.parametrize("check", [
    check for algorithm in PYMOO_ALGORITHMS for check in checks(
        Pymoo, options=[{"algorithm": algorithm}], expected_failures={
            "feasible_first": "C-TAEA weighs the violation against the objectives"}
        if algorithm == "ctaea" else {})], ids=lambda check: check.name)
def test_each_algorithm_of_pymoo_conforms(check: Check) -> None:
    check.run()


@pytest.mark.parametrize(("options", "said"), [
    ({"algorithm": "moead"}, "'moead' refuses constraints"),
    ({"algorithm": "rnsga3"}, "'rnsga3' requires reference points; make .*from_pymoo"),
    ({"algorithm": "de"}, "'de' moves real numbers"),
    ({"algorithm": ["nsga2", "de"]}, "does not accept"),
    ({"algorithm": "nsga2", "horizon": 5}, "'horizon' is for algorithm=rvea")])
def test_what_pymoo_cannot_do_here_is_refused_with_the_reason(options: dict[str, Any],
                                                              said: str) -> None:
    with pytest.raises(TermselError, match=said):
        Pymoo(**options)


@pytest.mark.parametrize("algorithm", ["nsga3", "ctaea"])
def test_a_population_smaller_than_the_directions_is_refused(algorithm: str) -> None:
    problem = Counted(Counted(Counted(problems.problem_of_two_aims())))
    solver = Pymoo(algorithm=algorithm, population=4)
    with pytest.raises(TermselError, match="each of 5 objectives, but a population of 4"):
        search(problem, solver, generations=1)


def test_every_algorithm_of_pymoo_is_offered_or_has_a_reason() -> None:
    known = {one.name for where in (pymoo.algorithms.moo, pymoo.algorithms.soo.nonconvex)
             for one in pkgutil.iter_modules(where.__path__)}
    assert known == set(PYMOO_ALGORITHMS) | set(UNFIT)


@pytest.mark.parametrize(("algorithm", "said"), [
    (MOEAD(np.eye(2), sampling=BinaryRandomSampling(), crossover=UX(),
           mutation=BitflipMutation()), "MOEAD refuses constraints"),
    (PSO(pop_size=20), "PSO moves real numbers"), (GA, "is no algorithm of pymoo"),
    ("GA", "'GA' is no algorithm of pymoo")])
def test_an_algorithm_that_cannot_do_makes_no_solver(algorithm: Any, said: str) -> None:
    with pytest.raises(TermselError, match=said):
        from_pymoo(algorithm)


@pytest.mark.parametrize(("given", "said"), [
    ([None], "toolbox_factory is None"), ([to_deap, 7], "algorithm is 7"),
    ([lambda problem: None], "'<lambda>' returned no DEAP toolbox")])
def test_what_gives_no_toolbox_makes_no_solver(given: list[Any], said: str) -> None:
    with pytest.raises(TermselError, match=said):
        search(problems.problem_of_twelve_terms(), from_deap(*given)(), generations=1)


def test_a_partial_function_gives_a_toolbox() -> None:
    assert from_deap(partial(to_deap)).name == "from-deap"


def test_rvea_runs_beyond_its_horizon() -> None:
    shifted, usual = (search(problems.problem_of_two_aims(), Pymoo(algorithm="rvea", population=12,
                                                                   horizon=horizon), generations=6)
                      for horizon in (2, None))
    assert shifted.generations == usual.generations == 6


def test_an_algorithm_for_another_number_of_objectives_is_told_its_options() -> None:
    with pytest.raises(TermselError, match=r"Or set its options otherwise \(termsel describe") \
            as said:
        termsel.run("poly-terms", solver="pymoo", options={"algorithm": "ga",
                                                           "objectives": "n_terms"})
    assert "pymoo," not in str(said.value)


def test_c_taea_has_as_many_directions_as_its_population_allows() -> None:
    sizes = []
    search(problems.problem_of_two_aims(), Pymoo(algorithm="ctaea", population=15), generations=2,
           observers=[lambda progress: sizes.append(len(progress.generation.genes))])
    assert sizes[0] == 15


@pytest.mark.parametrize(("algorithm", "objectives"), [
    (GA(pop_size=20, sampling=BinaryRandomSampling(), crossover=TwoPointCrossover(),
        mutation=BitflipMutation()), 1),
    (NSGA2(pop_size=20, sampling=BinaryRandomSampling(), crossover=UX(),
           mutation=BitflipMutation()), 2),
    (RNSGA2(np.array([[3.0, 9.0]]), pop_size=20, sampling=BinaryRandomSampling(), crossover=UX(),
            mutation=BitflipMutation()), 2)])
def test_an_algorithm_of_ones_own_is_a_solver(algorithm: Any, objectives: int) -> None:
    solver = from_pymoo(algorithm)
    runs = [termsel.run("poly-terms", solver=solver, evaluations=200, seed=4,
                        options={"degree": 2}) for _ in range(2)]
    assert runs[0].selection == runs[1].selection
    assert len(runs[0].objectives) == objectives
    assert runs[0].evaluations == 200
    assert not algorithm.is_initialized


def test_an_algorithm_without_a_population_is_a_solver() -> None:
    mine = from_pymoo(RandomSearch(10, sampling=BinaryRandomSampling()))
    assert search(problems.problem_of_twelve_terms(), mine(), evaluations=35).evaluations == 35


def test_forced_genes_are_kept_by_algorithms_of_ones_own() -> None:
    mine = from_pymoo(GA(pop_size=20, sampling=BinaryRandomSampling(), crossover=UX(),
                         mutation=BitflipMutation()))
    problem = problems.bounded_problem()
    found = search(problem, mine(), generations=5)
    assert problem.genome.keeps(found.genes[None]).all()


@pytest.mark.parametrize(("options", "said"), [
    ({"mate": "cxESBlend:alpha=0.5"}, "eaSimple .* failed .* 'strategy'"),
    ({"select": "selTournament:tournsize=0"}, "failed in eaSimple"),
    ({"mate": "cxMessyOnePoint"}, "failed in eaSimple"),
    ({"algorithm": "eaMuCommaLambda", "children": 10}, "keeps 20 of 10 children"),
    ({"cxpb": 0, "mutpb": 0}, "no individual would ever change"),
    ({"algorithm": "math:pi"}, "'math:pi' cannot be imported"),
    ({"algorithm": "..:loop"}, "cannot be imported"),
    ({"algorithm": "loops_with_a_slip:loop"}, "cannot be imported: invalid syntax"),
    ({"algorithm": "loops_of_mine:nothing"}, "'nothing' returned no population"),
    ({"algorithm": "loops_of_mine:fails"}, "KeyError: 'of mine'"),
])
def test_what_deap_cannot_do_is_no_bug_of_termsel(options: dict[str, Any], said: str,
                                                  tmp_path: Path,
                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "loops_with_a_slip.py").write_text("def (")
    (tmp_path / "loops_of_mine.py").write_text(
        "def nothing(population, toolbox, ngen):\n    return [], None\n"
        "def fails(population, toolbox, ngen):\n    raise KeyError('of mine')\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(TermselError, match=said):
        search(problems.problem_of_twelve_terms(), Deap(population=20, **options), generations=3)


def test_a_loop_is_found_where_the_command_runs(tmp_path: Path,
                                                monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a_loop_here.py").write_text(
        "from deap.algorithms import varAnd\n"
        "def loop(population, toolbox):\n"
        "    while True:\n"
        "        print('talkative')\n"
        "        yield population\n"
        "        chosen = toolbox.select(population, len(population))\n"
        "        population = varAnd(chosen, toolbox, 0.9, 0.2)\n")
    monkeypatch.chdir(tmp_path)
    before = list(sys.path)
    shown = invoke("run", "--problem", "poly-terms", "--solver", "deap",
                   "--set", "algorithm=a_loop_here:loop", "--evaluations", "100",
                   "--set", "solver.population=20", "--json")
    assert sys.path == before
    assert shown.exit_code == 0, shown.output
    assert json.loads(shown.stdout)["solver"] == "deap"


def still(population: list[Any], toolbox: base.Toolbox) -> Iterator[list[Any]]:
    """Breed nothing."""
    while True:
        yield population


NAMED = Event()


def stuck(population: list[Any], toolbox: base.Toolbox) -> Iterator[list[Any]]:
    """Do nothing until the progress names the solver, and a user ends it."""
    yield population
    assert NAMED.wait(60)
    raise KeyboardInterrupt


def test_a_loop_that_breeds_nothing_comes_to_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("termsel.selection.solvers.search.IDLE", 20)
    for budget in ({"generations": 50}, {"evaluations": 500}, {}):
        found = search(problems.problem_of_twelve_terms(), from_deap(own_box, still)(), **budget)
        assert (found.evaluations, found.generations) == (200, 20)
        assert found.notes == (
            "The search ended after 20 generations in which solver 'own-box' evaluated nothing.",)
    assert search(problems.problem_of_twelve_terms(), from_deap(own_box, still)(),
                  generations=5).generations == 5


def test_a_loop_that_does_nothing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("termsel.selection.solvers.bridges.silence.SILENT_SECONDS", 0.1)
    monkeypatch.setattr("termsel.selection.solvers.bridges.silence._LOOK_SECONDS", 0.05)

    def observe(progress: Progress) -> None:
        if "has yielded nothing" in progress.what:
            NAMED.set()

    found = search(problems.problem_of_twelve_terms(), from_deap(own_box, stuck)(population=10),
                   observers=[observe])
    assert (found.evaluations, found.interrupted) == (10, True)


def test_reals_for_bits_are_on_above_one_half() -> None:
    # Algorithms of reals, as pymoo's PSO, DE and CMA-ES, or GA with its own sampling; as bool,
    # every number but 0 would be on, and all individuals would be the same.
    problem = small().problem
    reals = np.random.default_rng(1).uniform(size=(30, problem.genome.size))
    expected = problem.evaluate(reals > 0.5)

    F, G = termsel.to_pymoo(problem).evaluate(reals)
    box = to_deap(problem)
    costs = [box.evaluate(row)[0] for row in reals.tolist()]

    assert len(np.unique(F)) > 10
    np.testing.assert_array_equal(F, expected.objectives)
    np.testing.assert_array_equal(G[:, 0], expected.violation)
    feasible = expected.violation == 0
    np.testing.assert_allclose(np.array(costs)[feasible], expected.objectives[feasible, 0])
