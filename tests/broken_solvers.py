"""Solvers that each break one rule, and the check that finds it."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

import numpy as np

from termsel.core.errors import TermselError
from termsel.core.options import Option
from termsel.data.features import BoolArray
from termsel.selection.problems import segments
from termsel.selection.problems.base import Evaluation, Problem
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.genetic.ga import GeneticAlgorithm
from termsel.selection.solvers.heuristics.yardsticks import RandomSearch
from termsel.selection.solvers.ledger import Ledger


class Drawn(Solver):
    """Draws populations with `draw`; the broken ones differ from it in one way."""

    name = "drawn"

    def draw(self, problem: Problem, rng: np.random.Generator) -> BoolArray:
        return problem.genome.random(rng, 20)

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        index = 0
        while True:
            genes = self.draw(problem, rng)
            yield Generation(index, genes, problem.evaluate(genes))
            index += 1


class WrongDefault(Drawn):
    """An option whose default it does not take."""

    declared_options = (Option("population", 0, "How many.", int, 1),)

    def __init__(self) -> None:
        super().__init__(population=1)


class GlobalNumpy(Drawn):
    """Draws from numpy's global state."""

    def draw(self, problem: Problem, rng: np.random.Generator) -> BoolArray:
        return problem.genome.repair(np.random.rand(20, problem.genome.size) < 0.5, rng)


class GlobalPython(Drawn):
    """Draws from Python's global state, and puts it back."""

    def draw(self, problem: Problem, rng: np.random.Generator) -> BoolArray:
        state = random.getstate()
        genes = np.array([[random.random() < 0.5] * problem.genome.size for _ in range(20)])
        random.setstate(state)
        return problem.genome.repair(genes, rng)


class Remembers(Drawn):
    """Goes on where the last search ended."""

    count = 0

    def draw(self, problem: Problem, rng: np.random.Generator) -> BoolArray:
        self.count += 1
        return super().draw(problem, np.random.default_rng(self.count))


class Choosy(Drawn):
    """Needs two segments."""

    def draw(self, problem: Problem, rng: np.random.Generator) -> BoolArray:
        if len(problem.genome.segments) != 2:
            raise TermselError("two segments are needed")
        return super().draw(problem, rng)


class Integers(Drawn):
    """Sends zeros and ones."""

    def draw(self, problem: Problem, rng: np.random.Generator) -> Any:
        return super().draw(problem, rng).astype(int)


class Overreaching(Drawn):
    """Says that it handles whole numbers, and does not keep to their bounds."""

    segments = (segments.Bits, segments.Integers)

    def draw(self, problem: Problem, rng: np.random.Generator) -> Any:
        genes = super().draw(problem, rng)
        return genes if genes.dtype == np.bool_ else genes + 1


class Unrepaired(Drawn):
    """Disregards forced genes and cardinality."""

    def draw(self, problem: Problem, rng: np.random.Generator) -> BoolArray:
        return rng.random((20, problem.genome.size)) < 0.5


class Cuts(Drawn):
    """Cuts chromosomes between the first gene and the last."""

    def draw(self, problem: Problem, rng: np.random.Generator) -> BoolArray:
        rng.integers(1, problem.genome.size)
        return super().draw(problem, rng)


class ZeroIndex(Drawn):
    """Does not count."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        for generation in super().generations(problem, rng):
            yield Generation(0, generation.genes, generation.evaluation)


class InPlace(Drawn):
    """Yields one array again and again."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        genes = problem.genome.random(rng, 20)
        for generation in super().generations(problem, rng):
            genes[:] = generation.genes
            yield Generation(generation.index, genes, generation.evaluation)


class Shuffled(Drawn):
    """Evaluations in another order than genes."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        for generation in super().generations(problem, rng):
            yield Generation(generation.index, generation.genes[::-1], generation.evaluation)


class Deserted(Drawn):
    """A generation of nobody after the first."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        first = next(super().generations(problem, rng))
        yield first
        yield Generation(1, first.genes[:0], first.evaluation.take(np.arange(0)))


class Bypass(Drawn):
    """Evaluates behind the run's back."""

    def draw(self, problem: Problem, rng: np.random.Generator) -> BoolArray:
        if isinstance(problem, Ledger):
            problem.inner.evaluate(problem.genome.random(rng, 500))
        return super().draw(problem, rng)


class GivesUp(Drawn):
    """Ends by itself after one generation and does not say so."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        yield next(super().generations(problem, rng))


class Swallows(Drawn):
    """Carries on whatever happens."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        index = 0
        while True:
            genes = self.draw(problem, rng)
            try:
                evaluation = problem.evaluate(genes)
            except Exception:  # noqa: BLE001 - the fault to be found
                continue
            yield Generation(index, genes, evaluation)
            index += 1


class Stops(Drawn):
    """Ends quietly whatever happens, Ctrl-C included."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        try:
            yield from super().generations(problem, rng)
        except (Exception, KeyboardInterrupt):  # noqa: BLE001 - the fault to be found
            return


class Listed(Drawn):
    """No generator."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        genes = self.draw(problem, rng)
        return iter([Generation(0, genes, problem.evaluate(genes))])


class Undying(Drawn):
    """Cannot be closed."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        for generation in super().generations(problem, rng):
            try:
                yield generation
            except GeneratorExit:
                yield generation


class Reckless(GeneticAlgorithm):
    """Ranks by objectives alone."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        class Blind(Problem):
            genome, objectives = problem.genome, problem.objectives

            def evaluate(self, genes: BoolArray) -> Evaluation:
                found = problem.evaluate(genes)
                return Evaluation(found.objectives, np.zeros_like(found.violation))

            decode = problem.decode

        yield from super().generations(Blind(), rng)


class Scales(Drawn):
    """Divides by the range of the objectives."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        for generation in super().generations(problem, rng):
            cost = generation.evaluation.objectives
            _ = cost / np.ptp(cost)
            yield generation


class Boasts(Drawn):
    """Declares two objectives and handles the first."""

    max_objectives = 2

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        for generation in super().generations(problem, rng):
            found = generation.evaluation
            yield Generation(generation.index, generation.genes,
                             Evaluation(found.objectives[:, :1], found.violation))


BROKEN_SOLVERS = [
    (WrongDefault, "declaration", "option 'population' has the default 0"),
    (ZeroIndex, "generations_hold", "number 1 has the index 0"),
    (InPlace, "generations_hold", "changed after it was yielded"),
    (Shuffled, "generations_hold", "not that of its genes"),
    (Deserted, "generations_hold", "generation 1 has no individuals"),
    (GlobalNumpy, "chance_from_rng_alone", "draws from the global random state"),
    (GlobalPython, "chance_from_rng_alone", "same seed differ"),
    (Remembers, "chance_from_rng_alone", "same seed differ"),
    (Choosy, "any_problem", "refuses a problem: two segments are needed"),
    (Overreaching, "typed_genomes", r"those of 'integers' have 4 for 'i1', which is from -2 to 3|"
                                    r"those of 'integers' have 101 for 'i2'"),
    (Integers, "genome_kept", r"evaluate\(\) got genes of the type int64 and the shape \(20, 18\)"),
    (Unrepaired, "genome_kept", "forced ones are switched"),
    (Cuts, "narrow_genomes", "ValueError was raised"),
    (Bypass, "evaluation_budget", "given 1 evaluations it takes 501"),
    (GivesUp, "evaluation_budget", "ends by itself after 20"),
    (ZeroIndex, "generation_budget", "the index of generations must rise, and was 0, 0, 0"),
    (Swallows, "errors_pass", "hides the end of the budget"),
    (Stops, "errors_pass", "hides the end of the budget"),
    (Listed, "closes", "must be a generator"),
    (Undying, "closes", "cannot be closed"),
    (Stops, "interruptible", "catches KeyboardInterrupt"),
    (Bypass, "best_never_worse", "does not return the best"),
    (Reckless, "feasible_first", "rank by violation before objectives"),
    (Scales, "hopeless_survived", "RuntimeWarning was raised"),
    (RandomSearch, "optimum_found", "a solver that does not search"),
    (Boasts, "objectives_respected", r"shape \(individuals, 2\)"),
]
