"""Whole searches: termsel's GA compared with a plain script with DEAP and LAPACK.

Both select among the 78 terms of the RFM on the embedded scene `ikonos-hamedan`, with 200
chromosomes and 80 generations. Times are seconds per evaluation, everything included: the
script evaluates only changed chromosomes, and termsel looks up known ones, so whole runs
differ a little in their evaluations. The disagreement is that of the selection RMSE
of the script's best chromosome.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from time import perf_counter

import numpy as np
from deap import algorithms, base, tools

from benchmarks.bench_kernels import Row
from termsel import prepare, search
from termsel.data.features import FeatureSet
from termsel.selection.problems.selection import SelectionProblem
from termsel_optimisers.deap_algorithms import Deap

POPULATION, GENERATIONS, MUTATION = 200, 80, 1 / 78


class Fitness(base.Fitness):
    """RMSE to be minimised."""

    weights = (-1.0,)


class Chromosome(list):  # type: ignore[type-arg]
    """A list of bits, as in DEAP's tutorial."""

    def __init__(self, bits: list[int]) -> None:
        super().__init__(bits)
        self.fitness = Fitness()


def script(problem: SelectionProblem) -> tuple[float, int, Chromosome]:
    """Run the plain script; return seconds, evaluations and the best chromosome."""
    inputs = problem.inputs
    A, b = problem.equations.A, problem.equations.b
    check = inputs.model.equations(FeatureSet(inputs.check))
    below = inputs.model.denominators(np.eye(A.shape[1]), inputs.check.ground)
    assert below is not None
    D = below.transpose(1, 2, 0).reshape(-1, A.shape[1]) - 1.0

    def rmse(individual: Chromosome) -> tuple[float]:
        on = np.flatnonzero(individual)
        if not len(on):
            return (1e9,)
        x = np.linalg.lstsq(A[:, on], b, rcond=None)[0]
        error = (check.b - check.A[:, on] @ x) / (1.0 + D[:, on] @ x)
        return (float(np.sqrt(2 * np.mean(error**2))) * inputs.pixels,)

    random.seed(1)
    box = base.Toolbox()
    box.register("bit", random.randint, 0, 1)
    box.register("individual", lambda: Chromosome([box.bit() for _ in range(A.shape[1])]))
    box.register("population", tools.initRepeat, list, box.individual)
    box.register("evaluate", rmse)
    box.register("mate", tools.cxUniform, indpb=0.5)
    box.register("mutate", tools.mutFlipBit, indpb=MUTATION)
    box.register("select", tools.selTournament, tournsize=3)
    start = perf_counter()
    best = tools.HallOfFame(1)
    _, book = algorithms.eaSimple(box.population(n=POPULATION), box, 0.9, 1.0, GENERATIONS,
                                  halloffame=best, verbose=False)
    return perf_counter() - start, sum(book.select("nevals")), best[0]


def rows() -> Iterator[Row]:
    """Yield whole runs: `ga`, the same with local refinement, and `deap`, whose twin it is."""
    task = prepare("rfm-terms", options={"population": POPULATION, "mutation": MUTATION})
    plain = Deap(population=POPULATION, mutate=f"mutFlipBit:indpb={MUTATION}")
    search(task.problem, task.solver, generations=2)  # compile
    theirs, evaluations, best = script(task.problem)
    # Genes per axis are in the order of the terms: line's, then sample's.
    mine = float(task.problem.evaluate(np.array([best], dtype=bool)).objectives[0, 0])
    for solver, polish, what in (
            (task.solver, False, "ga, 200 x 80, 78 terms"),
            (task.solver, True, "the same with local refinement"),
            (plain, False, "deap, 200 x 80, 78 terms")):
        found = min((search(task.problem, solver, generations=GENERATIONS, polish=polish)
                     for _ in range(3)), key=lambda search_: search_.seconds)
        ours = found.seconds / found.evaluations
        yield (what, ours, "DEAP with lists and lstsq", theirs / evaluations,
               theirs / evaluations / ours, abs(mine / best.fitness.values[0] - 1))
