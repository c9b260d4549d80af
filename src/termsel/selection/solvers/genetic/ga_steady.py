"""Steady-state genetic algorithm that chooses m features of n."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from deap import base

from termsel.core.errors import TermselError
from termsel.core.options import Option
from termsel.core.remedies import Remedy
from termsel.data.features import BoolArray, IntArray
from termsel.selection.problems.base import Evaluation, Problem
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.segments import AnySegment, Bits, Genes, Subset, random_subsets
from termsel.selection.solvers.genetic.ga import GeneticAlgorithm, select_by_tournament
from termsel.selection.solvers.genetic.operators import replace_one, set_crossover


@dataclass(frozen=True, eq=False)
class Coding:
    """Selections as tuples of the numbers of free genes.

    If a selection may have fewer than m, blank numbers fill its tuple.
    """

    # (n,): which label each of the first n numbers stands for; forced ones have none.
    free: IntArray
    m: int  # how many of them are on at most
    blanks: int  # how many fewer there may be: the number of blank numbers, which start at n
    forced: BoolArray  # (n of all,): labels that are always on
    segment: Bits | Subset

    @property
    def numbers(self) -> int:
        """How many numbers there are to draw from."""
        return len(self.free) + self.blanks

    def tuples(self, genes: Genes) -> IntArray:
        """Return chromosomes, shape (p, m), each row ascending, from genes (p, size)."""
        on = self.segment.mask(genes)[:, self.free]
        # As many blanks as there are fewer than m, the first ones: each set has one tuple.
        blank = np.arange(self.blanks) < self.m - on.sum(axis=1, keepdims=True)
        return np.nonzero(np.concatenate([on, blank], axis=1))[1].reshape(len(genes), self.m)

    def genes(self, tuples: IntArray) -> Genes:
        """Return genes, shape (p, size), from chromosomes (p, m)."""
        size = len(self.forced)
        mask = np.zeros((len(tuples), size + 1), dtype=bool)  # blanks write to the last place
        # Numbers from n on are blanks, which all stand for the place behind the last label.
        label = np.concatenate([self.free, np.full(self.blanks, size)])
        np.put_along_axis(mask, label[tuples], True, axis=1)
        mask = mask[:, :size] | self.forced
        return self.segment.members(mask)


def coding_of_genome(genome: Genome) -> Coding:
    """Return how a genome is coded as tuples; refuse one of several segments."""
    if len(genome.segments) > 1:
        names = ", ".join(segment.name for segment in genome.segments)
        raise TermselError(
            f"solver 'ga-steady' chooses m features of n, but this problem chooses {names}",
            hint=f"Choose only features, as with {Remedy('problem', 'owdis-points')} and "
                 f"{Remedy('set', 'min_features=12')} {Remedy('set', 'max_features=12')}, or use "
                 f"{Remedy('solver', 'ga')}.")
    segment = genome.segments[0]
    assert isinstance(segment, Bits | Subset)  # what the solver declares
    free = np.flatnonzero(genome.free)
    forced = int(genome.on.sum())
    # Forced genes are in no tuple: m and the blanks are of the free ones alone.
    m = min(segment.most - forced, len(free))
    return Coding(free, m, m - max(segment.minimum - forced, 0), genome.on, segment)


class SteadyStateGA(GeneticAlgorithm):
    """Steady-state GA that chooses m features of n, with m fixed or in a range.

    Konugurthi et al. 2016. Page 380: a chromosome is a tuple of m feature numbers out of n, and
    about half of the population, the best, survives. Page 381: random chromosomes join every
    generation, since a small population lacks most features. The objective is the problem's. The
    paper's, A/E50, is the criterion `e50-area` of termsel-rpc: A is the covered area, E50 the
    median error. It is named on pages 381 and 383; page 382, with its formula, could not be
    consulted.

    Operators are on none of these pages and are termsel's own: tournaments; a crossover of
    sets, which keeps what both parents have and fills up from what one of them has, so that no
    feature occurs twice; and a mutation that replaces one feature by one the chromosome lacks.
    Of equal chromosomes only one survives, as copies would otherwise fill the population and
    stop the search. If m is a range, tuples have its upper end as length, and some of their
    numbers are blank. The paper uses 10 chromosomes and 20 generations, with models that take
    seconds to evaluate; here an evaluation takes microseconds, so the defaults are ten times
    that.
    """

    name = "ga-steady"
    departures: ClassVar[tuple[str, ...]] = (
        "100 chromosomes instead of 10, and as many evaluations as every solver instead of 20 "
        "generations (--set population=10 --generations 20).",
        "Tournaments, crossover and mutation are termsel's own: no page of Konugurthi et al. 2016 "
        "that could be consulted states them.",
        "Of equal chromosomes only one survives.")
    segments: ClassVar[tuple[type[AnySegment], ...]] = (Bits, Subset)
    declared_options: ClassVar[tuple[Option, ...]] = (
        Option("population", 100, "Number of chromosomes; 10 in Konugurthi et al. 2016.", int, 2,
               100_000),
        Option("overlap", 0.5, "Share of the population that survives, the best; about 0.5 in "
                               "Konugurthi et al. 2016.", float, 0.0, 1.0),
        Option("immigrants", 0.2, "Share of the new chromosomes that are drawn at random.",
               float, 0.0, 1.0),
        Option("tournament", 2, "Chromosomes drawn for each tournament.", int, 1, 1000),
        Option("crossover", 0.9, "Chance that a pair of parents mates.", float, 0.0, 1.0),
        Option("mutation", 0.5, "Chance that a child has one feature replaced.", float, 0.0, 1.0),
    )

    def toolbox(self, problem: Problem, rng: np.random.Generator) -> base.Toolbox:
        """Return the DEAP toolbox: that of the GA with operators on tuples, and immigrants."""
        o = self.options
        code = coding_of_genome(problem.genome)
        n = code.numbers
        box = base.Toolbox()
        box.register("tuples", code.tuples)
        box.register("genes", code.genes)
        box.register("immigrants", random_subsets, n=n, m=code.m, rng=rng)
        box.register("population", lambda: code.genes(box.immigrants(o["population"])))
        box.register("evaluate", problem.evaluate)
        box.register("select", select_by_tournament, size=o["tournament"], rng=rng)
        box.register("mate", set_crossover, probability=o["crossover"], rng=rng)
        box.register("mutate", replace_one, n=n, probability=o["mutation"], rng=rng)
        return box

    def survivors(self, genes: Genes, evaluation: Evaluation) -> IntArray:
        """Return the indices of the chromosomes that survive: the best that differ from each other.
        """
        order = evaluation.order()
        # Twins are those of equal genes: the first of each stays, in order.
        first = np.sort(np.unique(genes[order], axis=0, return_index=True)[1])
        return order[first][:min(round(self.options["overlap"] * len(genes)), len(genes) - 1)]

    def children(self, box: base.Toolbox, genes: Genes, evaluation: Evaluation, n: int) -> Genes:
        """Return n new chromosomes: bred ones, then immigrants."""
        n_immigrants = round(self.options["immigrants"] * n)
        parents = box.tuples(genes[box.select(evaluation.order(), n - n_immigrants)])
        bred = box.mutate(box.mate(parents))
        children: Genes = box.genes(np.concatenate([bred, box.immigrants(n_immigrants)]))
        return children
