"""The guard of calls into plugins: the same search with it and without it.

Times are processor seconds of a search of 40 generations of 100 individuals on the embedded scene
`ikonos-hamedan`. Each part is termsel's own under another name, in a class that is defined here and
therefore guarded as those of plugins are. The alternative is the same search unguarded, in turn
with it. Its ratio is below 1 by what the guard costs. The disagreement is that of the best
objective.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.bench_kernels import Row, best_of
from termsel import prepare, search
from termsel.core.isolation.calls import without_guards
from termsel.data.features import FloatArray
from termsel.selection.criteria import CheckRmse, Fits
from termsel.selection.problems.base import Evaluation, Problem
from termsel.selection.problems.segments import Genes
from termsel.selection.problems.selection import SelectionProblem
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.genetic.ga import GeneticAlgorithm


class PluginCriterion(CheckRmse):
    """A criterion of a plugin."""

    def score(self, fits: Fits) -> FloatArray:
        """Return what the criterion of termsel returns."""
        return super().score(fits)


class PluginProblem(SelectionProblem):
    """A problem of a plugin."""

    def evaluate(self, genes: Genes) -> Evaluation:
        """Return what the problem of termsel returns."""
        return super().evaluate(genes)


class PluginSolver(GeneticAlgorithm):
    """A solver of a plugin."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield what the solver of termsel yields."""
        yield from super().generations(problem, rng)


def rows() -> Iterator[Row]:
    """Yield a search whose criterion, problem or solver is of a plugin, and all of them."""
    for what, criterion, problem, solver in (
            ("criterion of a plugin", PluginCriterion, SelectionProblem, GeneticAlgorithm),
            ("problem of a plugin", CheckRmse, PluginProblem, GeneticAlgorithm),
            ("solver of a plugin", CheckRmse, SelectionProblem, PluginSolver),
            ("all three", PluginCriterion, PluginProblem, PluginSolver)):
        task = prepare("rfm-terms", criterion=criterion, options={"max_share": 1.0})
        assert isinstance(task.problem, SelectionProblem)
        posed = problem(task.problem.inputs, terms=True, features=False)
        made = solver(population=100)

        def run(posed: Problem = posed, made: Solver = made) -> float:
            return float(search(posed, made, generations=40).objectives[0])

        def bare() -> float:
            with without_guards():
                return run()

        guarded, free = best_of([run, bare], seconds=5.0)
        yield what, guarded, "the same unguarded", free, free / guarded, abs(run() - bare())
