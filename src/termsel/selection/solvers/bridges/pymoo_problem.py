"""A problem as a problem of pymoo, and pymoo's algorithms generation by generation."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from copy import copy, deepcopy
from typing import Any

import numpy as np
from pymoo.algorithms.moo.nsga3 import NSGA3
from pymoo.algorithms.soo.nonconvex.ga_niching import NicheGA
from pymoo.core.algorithm import Algorithm
from pymoo.core.population import Population
from pymoo.core.problem import Problem as PymooProblem
from pymoo.core.repair import NoRepair, Repair
from pymoo.core.variable import Binary, Integer, Real, Variable
from pymoo.termination.max_gen import MaximumGenerationTermination

from termsel.core.arguments import explains_arguments
from termsel.core.isolation.faults import attribute_errors_to
from termsel.data.features import FloatArray, IntArray
from termsel.selection.problems.base import Evaluation, Problem
from termsel.selection.problems.genome import Genome
from termsel.selection.problems.segments import Bits, Genes
from termsel.selection.solvers.base import Generation
from termsel.selection.solvers.bridges.chance import OwnChance
from termsel.selection.solvers.budget import EVALUATIONS

CHECK = "Check the algorithm and its operators."


class Variables:
    """The genes of a genome as variables of pymoo, in arrays or, of MixedVariableGA, in dicts."""

    def __init__(self, genome: Genome) -> None:
        """Name each gene by its segment and its number in that, and find its range."""
        self.genome = genome
        self.kinds: list[type] = []
        names = []
        for segment in genome.segments:
            self.kinds += [segment.dtype] * segment.size
            names += [f"{segment.name}.{i}" for i in range(segment.size)]
        low, high = _gene_ranges(genome)
        # In the order of the genes.
        self.named = {}
        for name, kind, lowest, highest in zip(names, self.kinds, low.tolist(), high.tolist(),
                                               strict=True):
            self.named[name] = _pymoo_variable(kind, lowest, highest)

    def genes(self, X: Any) -> Genes:
        """Return the genes (p, size) of variables; they may not be valid.

        Numbers above one half are bits that are on, as many of pymoo's algorithms have reals.
        """
        if len(X) and isinstance(X[0], dict):
            X = [list(map(variables.__getitem__, self.named)) for variables in X]
        values: Genes = np.asarray(X)
        is_bits = self.genome.dtype == np.bool_
        if is_bits and values.dtype == np.bool_:
            return values
        numbers = values.astype(float)
        return np.asarray(numbers > 0.5) if is_bits else numbers

    def like(self, X: Any, genes: Genes) -> Any:
        """Return genes in the form of variables."""
        if not (len(X) and isinstance(X[0], dict)):
            return genes
        # Each value by its own type: pymoo's operators for mixed variables distinguish them by it.
        individuals = []
        for row in genes.tolist():
            values = zip(self.named, self.kinds, row, strict=True)
            individuals.append({name: kind(value) for name, kind, value in values})
        return np.array(individuals)


def _pymoo_variable(kind: type, low: float, high: float) -> Variable:
    """Return pymoo's variable of a gene's type, with its range."""
    if kind is np.bool_:
        return Binary()
    return Real(bounds=(low, high)) if kind is np.float64 else Integer(bounds=(int(low), int(high)))


class Keep(Repair):
    """Types, bounds, forced genes and cardinality, after every operator."""

    def __init__(self, genome: Genome, rng: np.random.Generator) -> None:
        super().__init__()
        self.variables = Variables(genome)
        self.rng = rng

    def _do(self, problem: PymooProblem, X: Any, **_: Any) -> Any:
        genes = self.variables.genes(X)
        return self.variables.like(X, self.variables.genome.repair(genes, self.rng))


class _ProblemForPymoo(PymooProblem):
    """A problem for pymoo: genes are the variables, the violation is the only constraint."""

    def __init__(self, problem: Problem, **options: Any) -> None:
        """Declare variables, bounds, objectives and the constraint G <= 0.

        `options` are further ones of pymoo's class.
        """
        bits = problem.genome.dtype == np.bool_
        low, high = (0, 1) if bits else _gene_ranges(problem.genome)
        super().__init__(n_var=problem.genome.size, n_obj=len(problem.objectives), n_ieq_constr=1,
                         xl=low, xu=high, vtype=bool if bits else None, **options)
        self.problem = problem
        self.variables = Variables(problem.genome)
        # pymoo's own name for named variables. As an argument it would turn the bounds into dicts,
        # where `xl` and `xu` are arrays.
        self.vars = self.variables.named

    def _evaluate(self, X: Any, out: dict[str, Any], *_: Any, **__: Any) -> None:
        """Write objectives F and constraint G of individuals, as pymoo asks for them."""
        genome = self.problem.genome
        genes = self.variables.genes([X] if self.elementwise else X)
        # G is the only constraint: the violation, and for bits what of the genome is broken.
        broken = np.zeros(len(genes))
        if genome.dtype == np.bool_:
            # pymoo's own operators know of no forced genes and counts.
            broken = _count_broken_rules(self.problem, genes)
        else:  # numbers are rounded to what their genes allow
            genes = genome.repair(genes, np.random.default_rng(0))
        evaluation = self.problem.evaluate(genes)
        out["F"] = evaluation.objectives[0] if self.elementwise else evaluation.objectives
        out["G"] = (evaluation.violation + broken)[:, None]


def _count_broken_rules(problem: Problem, genes: Genes) -> FloatArray:
    """Return by how many of its `genes` (p, g) each individual is invalid, (p,); 0 for valid ones.

    Counted are genes that differ from their forced value, and in each segment genes that are on
    beyond its maximum or missing to its minimum. A gene may break both rules, and counts twice.
    """
    genome = problem.genome
    count: FloatArray = ((genes & genome.off) | (~genes & genome.on)).sum(axis=1).astype(float)
    for segment, columns in zip(genome.segments, genome.slices().values(), strict=True):
        assert isinstance(segment, Bits)  # genes of other types are repaired instead
        on = genes[:, columns].sum(axis=1)
        count += np.maximum(on - segment.most, 0) + np.maximum(segment.minimum - on, 0)
    return count


def _gene_ranges(genome: Genome) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest value of each gene of a genome, (size,) both."""
    low = []
    high = []
    for segment in genome.segments:
        # A segment has one limit for all of its genes, or one for each.
        lowest, highest = segment.limits
        low.append(np.broadcast_to(np.array(lowest, dtype=float), segment.size))
        high.append(np.broadcast_to(np.array(highest, dtype=float), segment.size))
    return np.concatenate(low), np.concatenate(high)


@explains_arguments()
def to_pymoo(problem: Problem, *, elementwise_runner: Callable[..., Any] | None = None
             ) -> PymooProblem:
    """Return a pymoo problem, for scripts of one's own.

    It evaluates a whole population at once (``elementwise=False``). The objectives are F. The
    violation is the constraint G, at most 0 where feasible; forced genes that are not kept and
    counts of genes that are out of range add to it. Variables are of the type bool where all genes
    are bits; others are numbers, rounded where they are evaluated to what their genes allow. So are
    the reals that an algorithm has for bits: those above one half are on.
    `MixedVariableGA` of pymoo gets each by its type, as ``segment.number``.

    Parameters
    ----------
    problem : Problem
        Such as that of a task that `termsel.prepare` returns.
    elementwise_runner : callable, optional
        Of `pymoo.parallelization`, such as ``StarmapParallelization(pool.starmap)``: each selection
        is evaluated by itself, in other processes.

    Returns
    -------
    pymoo.core.problem.Problem
        For `pymoo.optimize.minimize`.

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
    if elementwise_runner is None:
        return _ProblemForPymoo(problem)
    return _ProblemForPymoo(problem, elementwise=True, elementwise_runner=elementwise_runner)


class _Horizon(MaximumGenerationTermination):
    """The expected length of a run, which it does not end."""

    def _update(self, algorithm: Algorithm) -> float:
        return 0.0


class _Tournament:
    """A comparison for tournaments whose draws between equally infeasible ones have a seed."""

    def __init__(self, compare: Callable[..., Any], rng: np.random.Generator) -> None:
        self.compare = compare
        self.rng = rng

    def __call__(self, pop: Population, P: IntArray, **arguments: Any) -> Any:
        violation = pop.get("CV")[:, 0]
        P = P.copy()
        draws = (violation[P[:, 0]] > 0) & (violation[P] == violation[P[:, :1]]).all(axis=1)
        # Of an individual and itself only one can be drawn.
        P[draws] = self.rng.permuted(P[draws], axis=1)[:, :1]
        return self.compare(pop, P, **arguments)


def _begin_algorithm(algorithm: Algorithm, posed: _ProblemForPymoo, rng: np.random.Generator,
                     horizon: int) -> None:
    """Set an algorithm of pymoo up in place, so that its run depends on `rng` alone.

    Its operators repair genes as the genome does, unless they have a repair of their own. `horizon`
    is the number of generations that pymoo is told to plan for.
    """
    # By default pymoo gives all algorithms of a class one survival, with what an earlier run left.
    if survival := getattr(algorithm, "survival", None):
        algorithm.survival = deepcopy(survival)
    for operator in (getattr(algorithm, "initialization", None),
                     getattr(algorithm, "mating", None)):
        # Before duplicates are told: a selection may be repaired to another one's.
        if operator is not None and isinstance(operator.repair, NoRepair):
            operator.repair = Keep(posed.problem.genome, rng)
    if isinstance(algorithm, NSGA3 | NicheGA):  # whose tournaments have a generator without a seed
        algorithm.mating.selection = selection = copy(algorithm.mating.selection)
        selection.func_comp = _Tournament(selection.func_comp, rng)
    algorithm.setup(posed, termination=_Horizon(horizon))
    algorithm.random_state = rng


def step_algorithm(algorithm: Algorithm, problem: Problem, rng: np.random.Generator,
                   horizon: int | None = None,
                   chance: OwnChance | None = None) -> Iterator[Generation]:
    """Yield the generations of a pymoo algorithm that is not yet set up; the object is changed.

    They end when it has no offspring that is new. What draws from a global random state, as some of
    pymoo's operators do, gets one of its own. The horizon is the number of generations that RVEA,
    which adapts to how far a run is, takes for the length of it; by default those of the usual
    budget. The chance is what global states give.
    """
    genome = problem.genome
    pymoo_problem = _ProblemForPymoo(problem)
    chance = chance or OwnChance(rng)
    # RVEA alone asks how long a run will be.
    expected = horizon or max(EVALUATIONS // (getattr(algorithm, "pop_size", None) or 1), 1)
    with attribute_errors_to(algorithm, "setup", CHECK), chance:
        _begin_algorithm(algorithm, pymoo_problem, rng, expected)
    for index in itertools.count():
        with attribute_errors_to(algorithm, "ask", CHECK), chance:
            offspring = algorithm.ask()
        if offspring is None or not len(offspring):
            return  # every offspring is a duplicate: there is nothing left to try
        variables = offspring.get("X")
        genes = genome.repair(pymoo_problem.variables.genes(variables), rng)
        offspring.set("X", pymoo_problem.variables.like(variables, genes))
        evaluation = problem.evaluate(genes)
        offspring.set("F", evaluation.objectives)
        offspring.set("G", evaluation.violation[:, None])
        for individual in offspring:  # else pymoo would evaluate them again
            individual.evaluated.update({"F", "G"})
        with attribute_errors_to(algorithm, "tell", CHECK), chance:
            # The repaired genes are those that survive or not.
            algorithm.tell(infills=offspring)
        population = algorithm.pop
        survivors = pymoo_problem.variables.genes(population.get("X")).astype(genome.dtype)
        # A constraint of pymoo is kept where it is not positive; a violation is never negative.
        violation = np.maximum(population.get("G")[:, 0], 0.0)
        yield Generation(index, survivors, Evaluation(population.get("F"), violation))
