"""Genetic algorithm with transgenic chromosomes."""

from __future__ import annotations

from statistics import NormalDist
from typing import ClassVar

import numpy as np
from deap import base

from termsel import Bits, Evaluation, GeneticAlgorithm, Option
from termsel_optimisers.arrays import BoolArray, FloatArray

_MIN_VARIANCE = 1e-9
"""Variance of a rank sum below which it is rounding."""


def gene_qualification(genes: BoolArray, evaluation: Evaluation) -> FloatArray:
    """Return how much better chromosomes (p, g) with a gene rank than the others, shape (g,).

    It is the statistic of Wilcoxon's rank sum test in units of its standard deviation, with the
    correction for ties; feasible chromosomes rank before all others. It is positive if good
    chromosomes have the gene, and 0 if all or none have it, or if all rank alike.
    """
    p = len(genes)
    criteria = np.column_stack([evaluation.violation, evaluation.objectives[:, 0]])
    _, group, count = np.unique(criteria, axis=0, return_inverse=True, return_counts=True)
    # Chromosomes of the same objective have the mean of their ranks.
    rank = (np.cumsum(count) - (count - 1) / 2.0)[group.ravel()]
    n_with_gene = genes.sum(axis=0)
    ties = float((count**3 - count).sum()) / (p * (p - 1)) if p > 1 else 0.0
    # The rank sum of n among p has the mean n (p + 1) / 2 and the variance
    # n (p - n) / 12 (p + 1 - ties).
    variance = n_with_gene * (p - n_with_gene) / 12.0 * (p + 1 - ties)
    surplus = n_with_gene * (p + 1) / 2.0 - rank @ genes
    is_tested = variance > _MIN_VARIANCE
    return np.where(is_tested, surplus, 0.0) / np.sqrt(np.where(is_tested, variance, 1.0))


class TransgenicGA(GeneticAlgorithm):
    """GA whose parents are joined by chromosomes made of qualified genes.

    Jannati and Valadan Zoej 2015 (GIScience & Remote Sensing 52(4)), genetic modification: a
    qualification coefficient tests single genes; in every iteration qualified genes build
    transgenic chromosomes, which join the parents. The paper's coefficient could not be
    consulted, so this is termsel's own formulation of the idea, and not the published one:

    - A gene is qualified if the chromosomes that have it and those that lack it rank
      differently in the current population, by a two-sided rank sum test at level `alpha`
      (`gene_qualification`).
    - A transgenic chromosome is a parent, drawn by tournament like all others, whose qualified
      genes are set as in the better chromosomes, on or off.
    - The share `transgenic` of the parents is transgenic, and each mates with an unchanged one.
      Their children are evaluated; they themselves are not.

    All else is as in `ga`.
    """

    name = "ga-transgenic"
    departures: ClassVar[tuple[str, ...]] = (
        "The test that qualifies a gene is termsel's own, and so are all rates: those of Jannati "
        "and Valadan Zoej 2015 could not be consulted.",)
    segments = (Bits,)
    declared_options: ClassVar[tuple[Option, ...]] = (
        *GeneticAlgorithm.declared_options,
        Option("alpha", 0.05, "Level of the test that qualifies a gene: share of genes without "
                              "effect that pass.", float, 1e-12, 1.0),
        Option("transgenic", 0.5, "Share of the parents that are transgenic.", float, 0.0, 0.5),
    )

    def children(self, box: base.Toolbox, genes: BoolArray, evaluation: Evaluation,
                 n: int) -> BoolArray:
        """Return n children, as genes (n, g), of parents that are selected from `genes` (p, g).

        A share of the parents is transgenic: they get the genes that distinguish good individuals
        in this population.
        """
        parents = genes[box.select(evaluation.order(), n)]
        coefficient = gene_qualification(genes, evaluation)
        limit = NormalDist().inv_cdf(1.0 - self.options["alpha"] / 2.0)
        # Rows 0 and 1 mate, 2 and 3, and so on: the first of a pair may be transgenic.
        transgenic = slice(0, 2 * round(self.options["transgenic"] * n), 2)
        # Genes that good chromosomes have are switched on, those that they lack off.
        switched_on = parents[transgenic] | (coefficient > limit)
        parents[transgenic] = switched_on & (coefficient >= -limit)
        children: BoolArray = box.mutate(box.mate(parents))
        return children
