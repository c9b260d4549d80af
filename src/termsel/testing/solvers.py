"""What every solver must do."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Any

import numpy as np

from termsel.core.errors import TermselError
from termsel.selection.problems.base import Evaluation, Problem
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.ledger import Progress
from termsel.testing import problems
from termsel.testing.cases import Case, Suite, check_declaration, label_with_options, require
from termsel.testing.problems import Watched, require_genes
from termsel.testing.trial import Trial, global_states, global_states_kept

GENEROUS = 10_000
"""Evaluations within which a feasible selection must be found."""

SEEDS = (1, 2, 3, 4)
"""Searches that must all find the optimum; few random searches do."""

SEARCH_EVALUATIONS = 5000
"""Evaluations of each of these searches, for 4096 selections."""


class _Stop(Exception):
    """Exception of an evaluation, which a solver must let pass."""


class _Runaway(BaseException):
    """Ends a solver that continued after an evaluation failed."""


def declaration(trial: Trial) -> None:
    """It has a name and a docstring; its options are documented and accept their defaults."""
    check_declaration("solvers", type(trial.solver))
    require(isinstance(trial.solver.max_objectives, int) and trial.solver.max_objectives >= 1,
            "max_objectives must be a whole number of at least 1")


def generations_hold(trial: Trial) -> None:
    """Generations are numbered from 0, and each carries its genes and their evaluation.

    Yielded generations do not change when the solver continues.
    """
    problem = trial.posed(trial.problem())
    yielded: list[tuple[Generation, Any, Evaluation]] = []
    for expected, generation in enumerate(trial.few(problem)):
        require(isinstance(generation, Generation),
                f"generations() must yield Generation, not {type(generation).__name__}")
        require(generation.index == expected,
                f"generations must be numbered 0, 1, 2 ...; number {expected} has the index "
                f"{generation.index}")
        genes = generation.genes
        evaluation = generation.evaluation
        require_genes(problem.genome, genes, f"generation {expected} has")
        require(len(genes) > 0, f"generation {expected} has no individuals")
        # Evaluated again: a solver may hand on what it was told of other genes.
        true = problem.evaluate(genes)
        require(evaluation.objectives.shape == true.objectives.shape
                and evaluation.violation.shape == true.violation.shape
                and np.allclose(evaluation.objectives, true.objectives)
                and np.allclose(evaluation.violation, true.violation),
                f"the evaluation of generation {expected} is not that of its genes")
        yielded.append((generation, genes.copy(),
                        Evaluation(evaluation.objectives.copy(), evaluation.violation.copy())))
    require(yielded, "generations() must yield at least one generation")
    for generation, genes, evaluation in yielded:
        require(np.array_equal(generation.genes, genes)
                and np.array_equal(generation.evaluation.objectives, evaluation.objectives)
                and np.array_equal(generation.evaluation.violation, evaluation.violation),
                f"the arrays of generation {generation.index} are changed after it was yielded; "
                "yield new ones")


def chance_from_rng_alone(trial: Trial) -> None:
    """The same seed gives the same search; global random states are neither used nor changed."""
    with global_states_kept():
        runs = []
        # Global states differ between the two runs: a solver that draws from them searches
        # otherwise in the second.
        for seed in (1, 2):
            random.seed(seed)
            np.random.seed(seed)
            before = global_states()
            runs.append([g.genes.copy() for g in trial.few(trial.problem())])
            require(global_states() == before,
                    "it draws from the global random state of `random` or `numpy.random`; draw "
                    "from the generator it is given")
        require(len(runs[0]) == len(runs[1])
                and all(np.array_equal(a, b) for a, b in zip(*runs, strict=True)),
                "two searches with the same seed differ; its only source of chance must be the "
                "generator it is given")
        twin = replace(trial, solver=type(trial.solver)(**trial.solver.options))
        repeated = [g.genes for g in twin.few(trial.problem())]
        require(len(repeated) == len(runs[0])
                and all(np.array_equal(a, b) for a, b in zip(runs[0], repeated, strict=True)),
                "another object with the same options and seed searches otherwise; what a search "
                "remembers belongs in generations(), not in the object")


def any_problem(trial: Trial) -> None:
    """It accepts problems that have only a genome and an evaluation.

    A solver that needs more refuses with a TermselError, and has this check among its expected
    failures; the others then omit such problems.
    """
    for problem in (problems.bounded_problem(), problems.narrow_problem(1),
                    problems.trap_problem(), problems.hopeless_problem()):
        try:
            next(trial.few(problem), None)
        except TermselError as error:
            raise AssertionError(f"it refuses a problem: {error}") from error


def genome_kept(trial: Trial) -> None:
    """It sends and yields only bool genes that keep forced genes and cardinality."""
    bounded = problems.bounded_problem()
    problem = Watched(bounded if trial.takes(bounded) else trial.problem())
    for generation in trial.few(problem, 20):
        require_genes(problem.genome, generation.genes, f"generation {generation.index} has")
    require(problem.calls, "it evaluated nothing")


def typed_genomes(trial: Trial) -> None:
    """It keeps genes of every type it declares valid, one by one and mixed in one genome."""
    declared = trial.solver.segments
    # Each type alone first, as a mixture may hide which one is at fault.
    for types in (*([kind] for kind in declared), declared):
        if trial.takes(problems.typed_problem(types)):
            problem = Watched(problems.typed_problem(types))
            for generation in trial.few(problem, 4):
                require_genes(problem.genome, generation.genes,
                              f"generation {generation.index} has")


def narrow_genomes(trial: Trial) -> None:
    """It handles a single gene, and genes that are all forced."""
    for problem in (problems.narrow_problem(1), problems.narrow_problem(2, on=("g1",)),
                    problems.narrow_problem(2, on=("g1", "g2"))):
        if not trial.takes(problem):
            continue
        result = trial.search(problem, evaluations=200)
        require(result.genes.all(),
                f"with {problem.genome.size} genes, {problem.genome.on.sum()} of them forced on, "
                "it does not find that all on is best")


def evaluation_budget(trial: Trial) -> None:
    """It evaluates through the problem it is given, and ends when the budget is spent."""
    # Odd numbers, which no population divides.
    for budget in (1, 7, 123):
        problem = Watched(trial.problem())
        result = trial.search(problem, evaluations=budget)
        require(problem.evaluated <= budget and result.evaluations <= budget,
                f"given {budget} evaluations it takes {max(problem.evaluated, result.evaluations)}")
        require(result.evaluations == budget or not trial.goes_on,
                f"given {budget} evaluations it ends by itself after {result.evaluations}; declare "
                "ends_by_itself = True where that is meant")


def generation_budget(trial: Trial) -> None:
    """It ends after the last generation of the budget."""
    for budget in (1, 3):
        generations: list[int] = []
        trial.search(trial.problem(), generations=budget,
                     observers=[partial(_note_index, generations, budget)])
        require(generations == list(range(budget + 1)) or not trial.goes_on,
                f"given {budget} generations it yields those with the index "
                f"{', '.join(map(str, generations))}")


def errors_pass(trial: Trial) -> None:
    """An exception of an evaluation leaves the solver at once, as the budget requires.

    That is how a spent budget ends a search: nothing may be evaluated after it.
    """
    was_raised = False

    def stop_second_call(call: int) -> None:
        nonlocal was_raised
        if was_raised:
            raise _Runaway
        if call == 2:
            was_raised = True
            raise _Stop

    hides = "which hides the end of the budget; let it pass"
    try:
        for _ in trial.few(Watched(trial.problem(), stop_second_call), 20):
            require(not was_raised, f"an exception of evaluate() is caught, {hides}")
        require(not was_raised, f"an exception of evaluate() is caught, {hides}")
    except _Stop:
        pass
    except _Runaway:
        raise AssertionError(f"it goes on evaluating after an exception of evaluate(), {hides}"
                             ) from None


def closes(trial: Trial) -> None:
    """Its iterator can be closed before, between and after generations, and then stops."""
    for count in (0, 1, 3):
        problem = Watched(trial.problem())
        running = trial.solver.generations(trial.posed(problem), np.random.default_rng(1))
        close = getattr(running, "close", None)
        if close is None:
            raise AssertionError("generations() must be a generator, a method with `yield`, whose "
                                 "iterator can be closed")
        for _ in islice(running, count):
            pass
        calls = problem.calls
        try:
            close()
        except RuntimeError as error:
            raise AssertionError(f"after {count} generations it cannot be closed: {error}"
                                 ) from error
        require(problem.calls == calls, "it evaluates while it is being closed")
        require(next(running, None) is None, "it goes on after it was closed")


def interruptible(trial: Trial) -> None:
    """Ctrl-C ends the search with the best found so far."""
    was_raised = False

    def interrupt(call: int) -> None:
        nonlocal was_raised
        # The third call, so that there are two evaluations whose best is to be kept. A solver that
        # ends before it passes.
        if call == 3:
            was_raised = True
            raise KeyboardInterrupt

    problem = Watched(trial.problem(), interrupt)
    result = trial.search(problem, generations=20)
    require(result.interrupted == was_raised,
            "it catches KeyboardInterrupt, so that the run does not know it was interrupted")
    require((result.violation, float(result.objectives[0])) == problem.best,
            "after Ctrl-C the result is not the best found until then")


def best_never_worse(trial: Trial) -> None:
    """The best so far only improves, and is what the search returns."""
    for problem in map(Watched, filter(trial.takes, (trial.problem(), problems.trap_problem()))):
        recorded: list[tuple[float, float]] = []
        result = trial.search(problem, generations=10, observers=[
            lambda progress, recorded=recorded: recorded.append(
                (progress.violation, progress.best))])
        require(recorded == sorted(recorded, reverse=True), "the best so far becomes worse")
        require((result.violation, float(result.objectives[0])) == problem.best,
                "the search does not return the best it evaluated")
        true = problem.inner.evaluate(result.genes[None])
        require(np.allclose(true.objectives[0, 0], result.objectives[0])
                and np.allclose(true.violation[0], result.violation),
                "the result's objectives are not those of its genes")


def feasible_first(trial: Trial) -> None:
    """It seeks feasible individuals, even where infeasible ones have better objectives."""
    if not trial.takes(problems.trap_problem()):
        return
    result = trial.search_until(lambda progress: progress.violation == 0, problems.trap_problem(),
                                evaluations=GENEROUS)
    require(result.violation == 0,
            f"with {result.evaluations} evaluations it finds no feasible selection where the "
            "objective leads away from them; rank by violation before objectives, as "
            "Evaluation.order() does. A solver that does not search lists this among its expected "
            "failures")


def hopeless_survived(trial: Trial) -> None:
    """If nothing is feasible and all costs are equal, it still returns a finite result."""
    if not trial.takes(problems.hopeless_problem()):
        return
    result = trial.search(problems.hopeless_problem(), generations=10)
    require(result.violation >= 1.0 and np.isfinite(result.objectives).all(),
            "a problem without feasible individuals gives no finite result")


def optimum_found(trial: Trial) -> None:
    """From any seed it finds the best of all selections, 4096 by default, in 5000 evaluations."""
    best = problems.least_objective(trial.problem())
    for seed in SEEDS:
        result = trial.search_until(
            lambda progress: progress.violation == 0 and bool(np.isclose(progress.best, best)),
            trial.problem(), seed=seed, evaluations=SEARCH_EVALUATIONS)
        require(np.isclose(result.objectives[0], best),
                f"with seed {seed} and {result.evaluations} evaluations it finds "
                f"{result.objectives[0]:.3f}, and the best is {best:.3f}; a solver that does not "
                "search lists this among its expected failures")


def objectives_respected(trial: Trial) -> None:
    """The run refuses more objectives than it declares; it handles two if it declares them."""
    if trial.solver.max_objectives < 2:
        # The run refuses what the solver cannot handle, before the solver gets it.
        try:
            trial.search(problems.problem_of_two_aims(), evaluations=50)
        except TermselError:
            return
        raise AssertionError("two objectives are not refused, although max_objectives is 1")
    problem = problems.problem_of_two_aims()
    last = None
    for last in trial.few(problem, 20):
        require(last.evaluation.objectives.shape == (len(last.genes), 2),
                "objectives of the generations must have shape (individuals, 2)")
    require(last is not None and len(np.unique(last.evaluation.objectives, axis=0)) > 1,
            "with two objectives that conflict, the last generation has only one compromise")


def cases(solver: type[Solver] | Solver, *, options: Iterable[Mapping[str, Any]] | None = None,
          problem: Callable[[], Problem] = problems.problem_of_twelve_terms) -> list[Case]:
    """Return a solver with each of its options, and the problem of most checks."""
    cls, own_options = (solver, {}) if isinstance(solver, type) else (type(solver), solver.options)
    return [Case(label_with_options(cls, o), partial(Trial, cls(**o), problem))
            for o in ([own_options] if options is None else options)]


SUITE = Suite((
    declaration, generations_hold, chance_from_rng_alone, any_problem, genome_kept,
    typed_genomes, narrow_genomes, evaluation_budget, generation_budget, errors_pass, closes,
    interruptible, best_never_worse, feasible_first, hopeless_survived, optimum_found,
    objectives_respected), cases)


def _note_index(indices: list[int], budget: int, progress: Progress) -> None:
    """Take note of a generation's number; raise AssertionError if there are too many."""
    indices.append(progress.generation.index)
    require(len(indices) <= budget + 1, f"given {budget} generations it yields more: the index of "
            f"generations must rise, and was {', '.join(map(str, indices))}")
