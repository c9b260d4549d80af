"""Several objectives at once, with the algorithms of pymoo."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
from pymoo.algorithms.moo.age2 import AGEMOEA2, AGEMOEA2Survival
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.algorithms.moo.nsga3 import HyperplaneNormalization
from pymoo.algorithms.moo.rvea import APDSurvival
from pymoo.algorithms.moo.sms import SMSEMOA
from pymoo.algorithms.moo.spea2 import SPEA2, SPEA2Survival
from pymoo.core.algorithm import Algorithm
from pymoo.core.crossover import Crossover
from pymoo.core.mutation import Mutation
from pymoo.core.problem import Problem as PymooProblem
from pymoo.core.repair import Repair
from pymoo.core.sampling import Sampling
from pymoo.operators.crossover.ux import UX
from pymoo.operators.mutation.bitflip import BitflipMutation

from termsel.measurements.features import FloatArray
from termsel.options import Option
from termsel.problems.base import Problem
from termsel.problems.genome import Genome
from termsel.problems.segments import SEGMENTS, AnySegment, Genes
from termsel.solvers.base import Generation, Solver
from termsel.solvers.bridges.pymoo_problem import steps
from termsel.solvers.genetic.operators import crossover, mutation


class _Keep(Repair):
    """Forced genes and cardinality, after every operator."""

    def __init__(self, genome: Genome, rng: np.random.Generator) -> None:
        super().__init__()
        self.genome, self.rng = genome, rng

    def _do(self, problem: PymooProblem, X: Genes, **_: Any) -> Genes:
        return self.genome.repair(X.astype(self.genome.dtype), self.rng)


class _Start(Sampling):
    """The random population that all solvers start from."""

    def __init__(self, genome: Genome, rng: np.random.Generator) -> None:
        super().__init__()
        self.genome, self.rng = genome, rng

    def _do(self, problem: PymooProblem, n_samples: int, **_: Any) -> Genes:
        return self.genome.random(self.rng, n_samples)


class _Mate(Crossover):
    """Crossover of a genome that has other genes than bits."""

    def __init__(self, genome: Genome) -> None:
        super().__init__(2, 2)
        self.genome = genome

    def _do(self, problem: PymooProblem, X: Genes, *_: Any, random_state: np.random.Generator,
            **__: Any) -> Genes:
        # pymoo has (parent, mating, gene); `crossover` takes parents in turn.
        pairs = X.swapaxes(0, 1).reshape(-1, self.genome.size)
        children = crossover(pairs, self.genome, 1.0, random_state)
        return children.reshape(-1, 2, self.genome.size).swapaxes(0, 1)


class _Mutate(Mutation):
    """Mutation of a genome that has other genes than bits."""

    def __init__(self, genome: Genome, rate: float) -> None:
        super().__init__()
        self.genome, self.rate = genome, rate

    def _do(self, problem: PymooProblem, X: Genes, *_: Any, random_state: np.random.Generator,
            **__: Any) -> Genes:
        return mutation(X, self.genome, self.rate, random_state)


def operators(genome: Genome, rate: float | None, rng: np.random.Generator) -> dict[str, Any]:
    """Return the start, crossover, mutation and repair that all algorithms have.

    The rate, the chance that a gene changes, is by default 1 over the number of genes.
    """
    rate = 1.0 / genome.size if rate is None else rate
    bits = genome.dtype == np.bool_
    return {"sampling": _Start(genome, rng), "crossover": UX() if bits else _Mate(genome),
            "mutation": (BitflipMutation(prob=1.0, prob_var=rate) if bits
                         else _Mutate(genome, rate)),
            "repair": _Keep(genome, rng)}


OPTIONS = (
    # pymoo compares all pairs of twice as many.
    Option("population", 100, "Number of selections.", int, 4, 5000),
    Option("mutation", None, "Chance that a gene changes; by default 1 over the number of genes.",
           float, 0.0, 1.0))
"""Options of all algorithms of pymoo."""


class PymooSolver(Solver):
    """Base of the solvers that use pymoo: they differ in the survival.

    Start, uniform crossover, bit flips and repair are the same for all; genes that are not bits
    have operators of their own (`termsel.solvers.genetic.operators`). The violation is a
    constraint, so that feasible selections come first.
    """

    min_objectives: ClassVar[int] = 2
    max_objectives: ClassVar[int] = 8
    segments: ClassVar[tuple[type[AnySegment], ...]] = SEGMENTS
    declared_options = OPTIONS
    made_of: ClassVar[type[Algorithm]]
    """The pymoo algorithm."""

    def generations(self, problem: Problem, rng: np.random.Generator) -> Iterator[Generation]:
        """Yield generations without end (see `Solver.generations`)."""
        yield from steps(made(self.made_of, pop_size=self.options["population"], **operators(
            problem.genome, self.options["mutation"], rng)), problem, rng)


class Nsga2(PymooSolver):
    """NSGA-II: non-dominated sorting and crowding distance (Deb et al. 2002)."""

    name = "nsga2"
    made_of = NSGA2


class _AgeSurvival(AGEMOEA2Survival):
    """pymoo's, which divides by zero if a member is best in every objective."""

    @staticmethod
    def pairwise_distances(front: FloatArray, p: float) -> FloatArray:
        """Return distances along the estimated front, shape (m, m)."""
        on_front = _project(front, p)
        if 0.95 < p < 1.05:
            return np.asarray(np.linalg.norm(on_front[:, None] - on_front, axis=-1))
        middle = _project((on_front[:, None] + on_front) / 2, p)
        half = np.linalg.norm(on_front[:, None] - middle, axis=-1)
        return np.asarray(half + half.T)


def _project(points: FloatArray, p: float) -> FloatArray:
    """Return points scaled to a p-norm of 1; the origin stays."""
    length = np.maximum(points, 0.0)
    length = (length**p).sum(axis=-1, keepdims=True) ** (1 / p)
    return np.asarray(points / np.where(length > 0, length, 1.0))


class _Spea2Survival(SPEA2Survival):
    """pymoo's, which divides by zero if all members are equal in an objective."""

    norm: Any

    def __init__(self) -> None:
        super().__init__(normalize=True)

    def _do(self, problem: PymooProblem, *args: Any, **given: Any) -> Any:
        self.norm = self.norm or _Ranges(problem.n_obj)
        return super()._do(problem, *args, **given)


class _Ranges(HyperplaneNormalization):
    """Ranges of the objectives, 1 where there is none."""

    nadir_point: Any

    def update(self, F: FloatArray, nds: Any = None) -> None:
        """Update the ranges by a population's objectives, shape (p, m)."""
        super().update(F, nds)
        self.nadir_point = np.where(self.nadir_point > self.ideal_point, self.nadir_point,
                                    self.ideal_point + 1.0)


class RveaSurvival(APDSurvival):
    """pymoo's, whose angles are undefined by rounding, and if all are equal in an objective."""

    V: FloatArray
    nadir: Any

    def __init__(self, directions: FloatArray) -> None:
        super().__init__(directions)
        self.V = self.V * _SHORTER

    def adapt(self) -> None:
        """Scale the directions by the ranges of the objectives, 1 where there is none."""
        if self.nadir is not None:
            self.nadir = np.where(self.nadir > self.ideal, self.nadir, self.ideal + 1.0)
        super().adapt()
        self.V = self.V * _SHORTER


_SHORTER = 1 - 1e-14
"""Length of a direction with which no cosine is above 1."""

_SURVIVALS = {AGEMOEA2: _AgeSurvival, SPEA2: _Spea2Survival}


def made(of: type[Algorithm], **arguments: Any) -> Algorithm:
    """Return a pymoo algorithm, its survival replaced by one that does not divide by zero."""
    algorithm = of(**arguments)
    if of in _SURVIVALS:
        algorithm.survival = _SURVIVALS[of]()
    return algorithm


class AgeMoea2(PymooSolver):
    """AGE-MOEA-II: survival by proximity and diversity on an estimated front (Panichella 2022)."""

    name = "age-moea2"
    made_of = AGEMOEA2


class SmsEmoa(PymooSolver):
    """SMS-EMOA: survival by contribution to the dominated hypervolume (Beume et al. 2007)."""

    name = "sms-emoa"
    made_of = SMSEMOA


class Spea2(PymooSolver):
    """SPEA2: survival by strength and nearest neighbours (Zitzler et al. 2001).

    It replaces MOEA/D, whose pymoo version evaluates one selection at a time and has no
    constraints: that would mean no batches and no feasibility.
    """

    name = "spea2"
    made_of = SPEA2
