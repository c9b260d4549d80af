"""A problem as a problem of pymoo, and pymoo's algorithms generation by generation."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from copy import deepcopy
from typing import Any

import numpy as np
from pymoo.core.algorithm import Algorithm
from pymoo.core.problem import Problem as PymooProblem
from pymoo.termination.max_gen import MaximumGenerationTermination

from termsel.measurements.features import FloatArray
from termsel.problems.base import Evaluation, Problem
from termsel.problems.segments import Bits, Genes
from termsel.solvers.base import Generation
from termsel.solvers.bridges.chance import OwnChance
from termsel.solvers.budget import EVALUATIONS


class _Posed(PymooProblem):
    """The genes are the variables, the violation is the only constraint."""

    def __init__(self, problem: Problem) -> None:
        genome = problem.genome
        bits = genome.dtype == np.bool_
        low, high = (0, 1) if bits else _bounds(problem)
        super().__init__(n_var=genome.size, n_obj=len(problem.objectives), n_ieq_constr=1,
                         xl=low, xu=high, vtype=bool if bits else None)
        self.problem = problem

    def _evaluate(self, X: Genes, out: dict[str, Any], *_: Any, **__: Any) -> None:
        genome = self.problem.genome
        broken = np.zeros(len(X))
        if genome.dtype == np.bool_:
            genes: Genes = np.asarray(X, dtype=bool)
            # pymoo's own operators know of no forced genes and counts.
            broken = _broken(self.problem, genes)
        else:  # numbers are rounded to what their genes allow
            genes = genome.repair(np.asarray(X, dtype=float), np.random.default_rng(0))
        evaluation = self.problem.evaluate(genes)
        out["F"] = evaluation.objectives
        out["G"] = (evaluation.violation + broken)[:, None]


def _broken(problem: Problem, genes: Genes) -> FloatArray:
    """Return how many genes break what is forced, and counts of segments, shape (p,)."""
    genome = problem.genome
    count: FloatArray = ((genes & genome.off) | (~genes & genome.on)).sum(axis=1).astype(float)
    for segment, where in zip(genome.segments, genome.slices().values(), strict=True):
        assert isinstance(segment, Bits)  # of which this genome is
        on = genes[:, where].sum(axis=1)
        count += np.maximum(on - segment.most, 0) + np.maximum(segment.minimum - on, 0)
    return count


def _bounds(problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Return the range of each gene, shape (g,) each."""
    sides = [[np.broadcast_to(np.array(one, dtype=float), segment.size) for one in segment.limits]
             for segment in problem.genome.segments]
    low, high = map(np.concatenate, zip(*sides, strict=True))
    return low, high


def to_pymoo(problem: Problem) -> PymooProblem:
    """Return a pymoo problem, for scripts of one's own.

    It evaluates a whole population at once (``elementwise=False``). The objectives are F. The
    violation is the constraint G, at most 0 where feasible; forced genes that are not kept and
    counts of genes that are out of range add to it. Variables are of the type bool where all genes
    are bits; others are numbers, rounded where they are evaluated to what their genes allow.

    Parameters
    ----------
    problem : Problem
        Such as that of a task that `termsel.prepare` returns.

    Examples
    --------
    >>> import termsel
    >>> from pymoo.algorithms.soo.nonconvex.ga import GA
    >>> from pymoo.operators.crossover.ux import UX
    >>> from pymoo.operators.mutation.bitflip import BitflipMutation
    >>> from pymoo.operators.sampling.rnd import BinaryRandomSampling
    >>> from pymoo.optimize import minimize
    >>> task = termsel.prepare("poly-terms", options={"degree": 2})
    >>> found = minimize(termsel.to_pymoo(task.problem), GA(
    ...     pop_size=20, sampling=BinaryRandomSampling(), crossover=UX(),
    ...     mutation=BitflipMutation()), ("n_gen", 5), seed=1)
    >>> found.X.shape, bool(found.G[0] <= 0)
    ((12,), True)
    """
    return _Posed(problem)


class _Horizon(MaximumGenerationTermination):
    """The expected length of a run, which it does not end."""

    def _update(self, algorithm: Algorithm) -> float:
        return 0.0


def steps(algorithm: Algorithm, problem: Problem, rng: np.random.Generator,
          horizon: int | None = None) -> Iterator[Generation]:
    """Yield the generations of a pymoo algorithm that is not yet set up; it is changed.

    What draws from the global random state or from a generator without a seed, as some of pymoo's
    operators do, gets one of its own. The horizon is the number of generations that RVEA, which
    adapts to how far a run is, takes for the length of it; by default those of the usual budget.
    """
    genome = problem.genome
    chance = OwnChance(rng)
    # By default pymoo gives all algorithms of a class one survival, with what an earlier run left.
    if survival := getattr(algorithm, "survival", None):
        algorithm.survival = deepcopy(survival)
    # RVEA alone asks how long a run will be.
    expected = horizon or max(EVALUATIONS // (getattr(algorithm, "pop_size", None) or 1), 1)
    with chance:
        algorithm.setup(_Posed(problem), termination=_Horizon(expected))
    algorithm.random_state = rng
    for index in itertools.count():
        with chance:
            offspring = algorithm.ask()
        if offspring is None or not len(offspring):
            return  # every offspring is a duplicate: there is nothing left to try
        kept = offspring.get("X")
        genes = genome.repair(kept.astype(bool if genome.dtype == np.bool_ else float), rng)
        offspring.set("X", genes)
        evaluation = problem.evaluate(genes)
        offspring.set("F", evaluation.objectives)
        offspring.set("G", evaluation.violation[:, None])
        for one in offspring:  # else pymoo would evaluate them again
            one.evaluated.update({"F", "G"})
        with chance:
            # The repaired genes are those that survive or not.
            algorithm.tell(infills=offspring)
        people = algorithm.pop
        yield Generation(index, people.get("X").astype(genome.dtype),
                         Evaluation(people.get("F"), np.maximum(people.get("G")[:, 0], 0.0)))
