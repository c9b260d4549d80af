"""Steady-state genetic algorithm that chooses m features of n."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from deap import base

from termsel.errors import TermselError
from termsel.measurements.features import BoolArray, IntArray
from termsel.options import Option
from termsel.problems.base import Evaluation, Genome, Problem
from termsel.solvers.base import POLISH
from termsel.solvers.ga import GeneticAlgorithm, tournament


def random_tuples(count: int, n: int, m: int, rng: np.random.Generator) -> IntArray:
    """Return chromosomes of m different numbers below n, each row ascending.

    Parameters
    ----------
    count : int
        Number of chromosomes.
    n, m : int
    rng : numpy.random.Generator

    Returns
    -------
    ndarray of int, shape (count, m)
    """
    return np.sort(rng.random((count, n)).argsort(axis=1)[:, :m], axis=1)


def set_crossover(tuples: IntArray, probability: float, rng: np.random.Generator) -> IntArray:
    """Return children that keep what both parents have and draw the rest from what one has.

    Parameters
    ----------
    tuples : ndarray of int, shape (p, m)
        Parents, each row ascending; rows 0 and 1 are a pair, 2 and 3, and so on.
    probability : float
        Chance that a pair mates.
    rng : numpy.random.Generator

    Returns
    -------
    ndarray of int, shape (p, m)
        Each row ascending, without repetition; two children per pair.
    """
    pairs, m = len(tuples) // 2, tuples.shape[1]
    both = np.sort(tuples[:2 * pairs].reshape(pairs, 2 * m), axis=1)
    twin = np.zeros(both.shape, dtype=bool)
    twin[:, 1:] = both[:, 1:] == both[:, :-1]
    mates = rng.random(pairs) < probability
    children = tuples.copy()
    for child in (0, 1):
        # Shared numbers come first, once; then numbers of one parent, shuffled.
        key = rng.random(both.shape)
        key[twin] = -1.0
        key[:, :-1][twin[:, 1:]] = 2.0
        chosen = np.take_along_axis(both, key.argsort(axis=1)[:, :m], axis=1)
        children[child:2 * pairs:2][mates] = np.sort(chosen[mates], axis=1)
    return children


def replace_one(tuples: IntArray, n: int, probability: float,
                rng: np.random.Generator) -> IntArray:
    """Return chromosomes, some with one number replaced by one they did not have.

    Parameters
    ----------
    tuples : ndarray of int, shape (p, m)
        Each row ascending.
    n : int
        Numbers are below it.
    probability : float
        Chance that a chromosome mutates.
    rng : numpy.random.Generator
    """
    p, m = tuples.shape
    mutants = np.flatnonzero(rng.random(p) < probability)
    if not m or m == n:
        return tuples
    gone = rng.integers(0, m, len(mutants))
    # The r-th number that is not in a row: r moves up by one for each member before it.
    rank = rng.integers(0, n - m, len(mutants))
    before = tuples[mutants] - np.arange(m) <= rank[:, None]
    changed = tuples.copy()
    changed[mutants, gone] = rank + before.sum(axis=1)
    return np.sort(changed, axis=1)


@dataclass(frozen=True, eq=False)
class Coding:
    """Selections as tuples of the numbers of free genes.

    If a selection may have fewer than m, blank numbers fill its tuple.

    Parameters
    ----------
    free : ndarray of int, shape (n,)
        Which gene each of the first n numbers stands for; forced genes have none.
    m : int
        How many of them are on at most.
    blanks : int
        How many fewer there may be: the number of blank numbers, which start at n.
    forced : ndarray of bool, shape (size,)
        Genes that are always on.
    """

    free: IntArray
    m: int
    blanks: int
    forced: BoolArray

    @property
    def numbers(self) -> int:
        """How many numbers there are to draw from."""
        return len(self.free) + self.blanks

    def tuples(self, genes: BoolArray) -> IntArray:
        """Return chromosomes, shape (p, m), each row ascending, from genes (p, size)."""
        on = genes[:, self.free]
        blank = np.arange(self.blanks) < self.m - on.sum(axis=1, keepdims=True)
        return np.nonzero(np.concatenate([on, blank], axis=1))[1].reshape(len(genes), self.m)

    def genes(self, tuples: IntArray) -> BoolArray:
        """Return genes, shape (p, size), from chromosomes (p, m)."""
        size = len(self.forced)
        genes = np.zeros((len(tuples), size + 1), dtype=bool)
        gene = np.concatenate([self.free, np.full(self.blanks, size)])
        np.put_along_axis(genes, gene[tuples], True, axis=1)
        return np.asarray(genes[:, :size] | self.forced)


def coding(genome: Genome) -> Coding:
    """Return how a genome is coded as tuples.

    Raises
    ------
    TermselError
        If its genes are not one segment.
    """
    if len(genome.segments) > 1:
        names = ", ".join(segment.name for segment in genome.segments)
        raise TermselError(
            f"solver 'ga-steady' chooses m features of n, but this problem chooses {names}",
            hint="Choose only features, as with --problem owdis-points --set min_features=12 --set "
                 "max_features=12, or use --solver ga.")
    segment = genome.segments[0]
    free, forced = np.flatnonzero(genome.free), int(genome.on.sum())
    most = len(free) if segment.maximum is None else min(segment.maximum - forced, len(free))
    return Coding(free, most, most - max(segment.minimum - forced, 0), genome.on)


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
    default_generations = 200
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
        POLISH,
    )

    def toolbox(self, problem: Problem, rng: np.random.Generator) -> base.Toolbox:
        """Return the DEAP toolbox: that of the GA with operators on tuples, and immigrants."""
        o = self.options
        code = coding(problem.genome)
        n = code.numbers
        box = base.Toolbox()
        box.register("tuples", code.tuples)
        box.register("genes", code.genes)
        box.register("immigrants", random_tuples, n=n, m=code.m, rng=rng)
        box.register("population", lambda: code.genes(box.immigrants(o["population"])))
        box.register("evaluate", problem.evaluate)
        box.register("select", tournament, size=o["tournament"], rng=rng)
        box.register("mate", set_crossover, probability=o["crossover"], rng=rng)
        box.register("mutate", replace_one, n=n, probability=o["mutation"], rng=rng)
        return box

    def survivors(self, genes: BoolArray, evaluation: Evaluation) -> IntArray:
        """Return which chromosomes survive: the best that differ from each other."""
        order = evaluation.order()
        first = np.sort(np.unique(genes[order], axis=0, return_index=True)[1])
        return order[first][:min(round(self.options["overlap"] * len(genes)), len(genes) - 1)]

    def children(self, box: base.Toolbox, genes: BoolArray, evaluation: Evaluation,
                 n: int) -> BoolArray:
        """Return n new chromosomes: bred ones, then immigrants."""
        fresh = round(self.options["immigrants"] * n)
        parents = box.tuples(genes[box.select(evaluation.order(), n - fresh)])
        bred = box.mutate(box.mate(parents))
        children: BoolArray = box.genes(np.concatenate([bred, box.immigrants(fresh)]))
        return children
