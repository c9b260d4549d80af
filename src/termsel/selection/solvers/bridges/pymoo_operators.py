"""Start, crossover, mutation and repair of a genome, as operators of pymoo."""

from __future__ import annotations

from typing import Any

import numpy as np
from pymoo.core.crossover import Crossover
from pymoo.core.mutation import Mutation
from pymoo.core.problem import Problem as PymooProblem
from pymoo.core.sampling import Sampling
from pymoo.operators.mutation.bitflip import BitflipMutation

from termsel.selection.problems.genome import Genome
from termsel.selection.problems.segments import Genes
from termsel.selection.solvers.bridges.pymoo_problem import Keep
from termsel.selection.solvers.genetic.operators import cross_pairs, draw_evenly, mutate_genes


class _Start(Sampling):
    """A random population, half of whose bits are on."""

    def __init__(self, genome: Genome, rng: np.random.Generator) -> None:
        super().__init__()
        self.genome = genome
        self.rng = rng

    def _do(self, problem: PymooProblem, n_samples: int, **_: Any) -> Genes:
        return draw_evenly(self.genome, self.rng, n_samples)


class _Mate(Crossover):
    """Crossover of any genome; bits between two places."""

    def __init__(self, genome: Genome) -> None:
        super().__init__(2, 2)
        self.genome = genome

    def _do(self, problem: PymooProblem, X: Genes, *_: Any, random_state: np.random.Generator,
            **__: Any) -> Genes:
        # pymoo has (parent, mating, gene); `crossover` takes parents in turn.
        pairs = X.swapaxes(0, 1).reshape(-1, self.genome.size)
        children = cross_pairs(pairs, self.genome, 1.0, random_state, points=2)
        return children.reshape(-1, 2, self.genome.size).swapaxes(0, 1)


class _Mutate(Mutation):
    """Mutation of a genome that has other genes than bits."""

    def __init__(self, genome: Genome, rate: float) -> None:
        super().__init__()
        self.genome = genome
        self.rate = rate

    def _do(self, problem: PymooProblem, X: Genes, *_: Any, random_state: np.random.Generator,
            **__: Any) -> Genes:
        return mutate_genes(X, self.genome, self.rate, random_state)


def common_operators(
        genome: Genome, rate: float | None, rng: np.random.Generator) -> dict[str, Any]:
    """Return the start, crossover, mutation and repair that all algorithms have.

    The rate, the chance that a gene changes, is by default 1 over the number of genes. On fronts of
    RMSE and terms, two-point crossover and a start with half of the bits on did better than uniform
    crossover and a share drawn for each individual, or as well, on each scene that was tried.
    """
    # On average one gene of an individual changes.
    rate = 1.0 / genome.size if rate is None else rate
    bits = genome.dtype == np.bool_
    return {"sampling": _Start(genome, rng), "crossover": _Mate(genome),
            "mutation": (BitflipMutation(prob=1.0, prob_var=rate) if bits
                         else _Mutate(genome, rate)),
            "repair": Keep(genome, rng)}
