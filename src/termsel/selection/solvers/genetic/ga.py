"""Genetic algorithm on DEAP's toolbox."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import ClassVar

import numpy as np
from deap import base

from termsel.core.options import COUNT, Option
from termsel.data.features import BoolArray, IntArray
from termsel.selection.problems.base import Evaluation, Problem
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.segments import SEGMENTS, AnySegment, Genes
from termsel.selection.solvers.base import Generation, Solver
from termsel.selection.solvers.genetic.operators import cross_pairs, draw_evenly, mutate_genes

SMALLEST_POPULATION, LARGEST_POPULATION = 20, 200
"""Fewest and most chromosomes that a budget of evaluations leads to."""

SHORT_SEARCH = 10 * SMALLEST_POPULATION
"""Evaluations up to which a search has no time to leave conditions that half of the genes break:
of 78 terms and 24 points no selection of half of the terms is determined."""

MUTATIONS_OF_COPIES = 5
"""Mutations of a child that repeats another chromosome, at most: small spaces have no more."""

GENERATIONS = 66
"""Generations that the evaluations of a short search are enough for: 60 chromosomes at 4,000
evaluations did better than 100 and 200 on twelve scenes, and 20 at 500 better than 60."""

LONG_SEARCH = GENERATIONS * LARGEST_POPULATION
"""Evaluations from which on the best of parents and children survive: on twelve scenes it made no
difference to shorter searches."""


def select_by_tournament(order: IntArray, n: int, size: int, rng: np.random.Generator) -> IntArray:
    """Return n winners of tournaments, for each of which `size` individuals are drawn.

    The order (p,) is of individuals from best to worst.
    """
    # Ranks are drawn, with replacement: the least of those of a tournament is the winner.
    drawn: IntArray = rng.integers(0, len(order), (n, size)).min(axis=1)
    return order[drawn]


def repeat_two_best(order: IntArray, n: int) -> IntArray:
    """Return the two best in turn, as the parents of n children (Valadan Zoej et al. 2002, 3.2).

    The order (p,) is of individuals from best to worst.
    """
    return np.resize(order[:2], n)


def are_repeated(genes: Genes, others: Genes) -> BoolArray:
    """Return which chromosomes (n, size) are among others, or come before in their own order."""
    everyone = np.ascontiguousarray(np.concatenate([others, genes]))
    # A row as one value of so many bytes, as those of numbers are equal where their bytes are.
    rows = everyone.view(np.dtype((np.void, everyone.itemsize * everyone.shape[1]))).ravel()
    is_first = np.zeros(len(rows), dtype=bool)
    is_first[np.unique(rows, return_index=True)[1]] = True
    return ~is_first[len(others):]


class GeneticAlgorithm(Solver):
    """Genetic algorithm by generations: tournament, uniform crossover, bit flips, elitism.

    Chromosome, selection and crossover are those of Akhoundi Khezrabad et al. 2020, table 2. Size
    and start of the population are those that did best on twelve scenes
    (docs/evidence/short-budgets.md). Genes that are not bits have operators of their own
    (`termsel.selection.solvers.genetic.operators`). The operators act on the whole population at
    once and are registered in a DEAP toolbox, where they can be replaced. DEAP's own operators are
    not used, as they draw one individual at a time from the global random state. Infeasible
    individuals rank behind all feasible ones.

    Examples
    --------
    >>> import termsel
    >>> result = termsel.run("poly-terms", solver="ga", seed=1, generations=2)
    >>> result.solver
    'ga'
    """

    name = "ga"
    departures: ClassVar[tuple[str, ...]] = (
        "The best 2 chromosomes survive unchanged; the paper states no elitism (--set elite=0).",
        "The paper states neither the size of a tournament nor the chance of a crossover: 3, 0.9.",
        "With a budget of 13,200 evaluations or more the best of parents and children survive, "
        "without copies, and tournaments are of 2 (--set survival=children --set tournament=3).",
        "It ends with its budget; the papers count generations until convergence (--patience).",
        "A gene changes with a chance of 1 over the number of genes; the paper has 0.001 "
        "(--set mutation=0.001).",
        "The first chromosomes of a large population, and of a search of at most 200 "
        "evaluations, have random shares of genes on, not half "
        "(--set first=half).")
    segments: ClassVar[tuple[type[AnySegment], ...]] = SEGMENTS
    declared_options: ClassVar[tuple[Option, ...]] = (
        Option("population", None, "Number of chromosomes; by default a 66th of the budget of "
               "evaluations, 20 at least and 200 at most.", int, 2, 100_000),
        Option("first", None, "First chromosomes: bits on with a chance drawn for each "
               "chromosome, or with 1/2 for all, as in the standard GA of Akhoundi Khezrabad et "
               "al. 2020. By default shares with 200 chromosomes and more or at most 200 "
               "evaluations, else half.",
               choices=("shares", "half")),
        Option("parents", "tournament", "Who are crossed: winners of tournaments, or always the "
               "two best, as in Valadan Zoej et al. 2002.", choices=("tournament", "two-best")),
        Option("survival", None, "Who survives: the children and the elite, or the best of parents "
               "and children, of which none repeats another. By default the best, with a budget of "
               "13,200 evaluations or more, else the children.", choices=("children", "best")),
        Option("tournament", None, "Chromosomes drawn for each tournament; by default 2 where the "
               "best survive, else 3.", int, 1, 1000),
        Option("points", "uniform", "Crossover of bits: each is swapped with chance 1/2, or those "
               "between two places are.", choices=("uniform", "two")),
        Option("crossover", 0.9, "Chance that a pair of parents mates.", float, 0.0, 1.0),
        Option("mutation", None, "Chance that a gene changes; by default 1 over the number of "
               "genes; 0.001 in Akhoundi Khezrabad et al. 2020.", float, 0.0, 1.0),
        Option("elite", 2, "Best chromosomes that survive unchanged.", int, 0, COUNT),
    )

    def population_size(self, problem: Problem) -> int:
        """Return the number of chromosomes, which depends on the budget where it is not given."""
        given: int | None = self.options["population"]
        if given is not None:
            return given
        if problem.budget is None:
            return LARGEST_POPULATION
        return min(max(problem.budget // GENERATIONS, SMALLEST_POPULATION), LARGEST_POPULATION)

    def keeps_best(self, problem: Problem) -> bool:
        """Return whether the best of parents and children survive."""
        survival = self.options.get("survival", "children")
        return survival == "best" or (survival is None and (problem.budget or 0) >= LONG_SEARCH)

    def toolbox(self, problem: Problem, rng: np.random.Generator) -> base.Toolbox:
        """Return the DEAP toolbox, in which any operator may be replaced.

        It has population, evaluate, select, mate and mutate, with the options of this solver. Where
        options are left open, the first population is drawn by shares in a large or short search,
        and the tournament is of two where the best are kept.
        """
        o = self.options
        box = base.Toolbox()
        # DEAP's toolbox is a register of functions with their arguments, any of which may be
        # replaced. A GA with a first population of its own has no such option.
        size = self.population_size(problem)
        is_short = problem.budget is not None and problem.budget <= SHORT_SEARCH
        first = o.get("first") or ("shares" if size >= LARGEST_POPULATION or is_short else "half")
        draw = draw_evenly if first == "half" else Genome.random
        box.register("population", draw, problem.genome, rng, size)
        box.register("evaluate", problem.evaluate)
        if o["parents"] == "two-best":
            box.register("select", repeat_two_best)
        else:
            size_of_tournament = o["tournament"] or (2 if self.keeps_best(problem) else 3)
            box.register("select", select_by_tournament, size=size_of_tournament, rng=rng)
        box.register("mate", cross_pairs, genome=problem.genome, probability=o["crossover"],
                     rng=rng,
                     points=2 if o.get("points") == "two" else 0)
        rate = 1.0 / problem.genome.size if o["mutation"] is None else o["mutation"]
        box.register("mutate", mutate_genes, genome=problem.genome, probability=rate, rng=rng)
        return box

    def survivors(self, genes: Genes, evaluation: Evaluation) -> IntArray:
        """Return the indices of the chromosomes that survive unchanged, the best, but never all."""
        return evaluation.order()[:min(self.options["elite"], len(genes) - 1)]

    def children(self, box: base.Toolbox, genes: Genes, evaluation: Evaluation, n: int) -> Genes:
        """Return n new chromosomes of a population and its evaluation, before their repair."""
        children: Genes = box.mutate(box.mate(genes[box.select(evaluation.order(), n)]))
        return children

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield generations without end (see `Solver.generations`)."""
        box = self.toolbox(problem, rng)
        genes = box.population()
        evaluation = box.evaluate(genes)
        yield Generation(0, genes, evaluation)
        size = len(genes)
        keeps_best = self.keeps_best(problem)
        for index in itertools.count(1):
            survivors = np.arange(size) if keeps_best else self.survivors(genes, evaluation)
            count = size if keeps_best else size - len(survivors)
            children = self.children(box, genes, evaluation, count)
            # Operators may break forced genes and counts: nothing else is ever evaluated.
            children = problem.genome.repair(children, rng)
            if keeps_best:
                children = self._mutate_repeated(children, genes, box, problem, rng)
            offspring = box.evaluate(children)
            genes = np.concatenate([genes[survivors], children])
            evaluation = Evaluation(
                np.concatenate([evaluation.objectives[survivors], offspring.objectives]),
                np.concatenate([evaluation.violation[survivors], offspring.violation]))
            if keeps_best:
                best = evaluation.order()[:size]
                genes = genes[best]
                evaluation = evaluation.take(best)
            yield Generation(index, genes, evaluation)

    @staticmethod
    def _mutate_repeated(children: Genes, parents: Genes, box: base.Toolbox, problem: Problem,
                         rng: np.random.Generator) -> Genes:
        """Return children of which those that repeat a chromosome are mutated, again if need be."""
        for _ in range(MUTATIONS_OF_COPIES):
            copies = are_repeated(children, parents)
            if not copies.any():
                break
            children[copies] = problem.genome.repair(box.mutate(children[copies]), rng)
        return children
