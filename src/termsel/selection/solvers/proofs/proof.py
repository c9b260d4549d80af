"""The state of a proof: what is known of all selections, and of those of each size."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from termsel.data.features import BoolArray, FloatArray, IntArray
from termsel.selection.best_subsets import subsets
from termsel.selection.best_subsets.columns.system import count_subsets
from termsel.selection.best_subsets.subsets import SubsetResult
from termsel.selection.problems.base import EnumerablePart, Problem
from termsel.selection.problems.segments import Bits, Genes
from termsel.selection.solvers.base import Generation

ALL = "all selections"
"""Space of a certificate that leaves no selection out."""

TIE = 1e-9
"""Objectives that differ relatively by less than this are equal: rounding differs."""


@dataclass(frozen=True, eq=False)
class SizeProof:
    """The best selection of one number of genes, and what is proven of it."""

    genes: Genes  # (size,)
    objective: float  # its first objective
    # No selection with as many genes has a smaller one; None if nothing is known.
    bound: float | None
    optimal: bool  # whether it is proven that none is better
    better: bool  # whether it is better than all selections with fewer genes

    @property
    def gap(self) -> float | None:
        """How far the objective is above its lower bound, as a share of that; None without a bound.
        """
        if self.optimal:
            return 0.0
        return self.objective / self.bound - 1 if self.bound and self.bound > 0 else None


@dataclass(frozen=True, eq=False)
class Proof:
    """State of an enumeration of all parts."""

    parts: tuple[EnumerablePart, ...]
    results: tuple[SubsetResult, ...]  # one per part
    minimum: tuple[int, ...]  # fewest genes of each part
    size: int  # number of genes of the problem

    @property
    def decided(self) -> int:
        """Subsets enumerated."""
        return sum(result.subsets for result in self.results)

    @property
    def total(self) -> int:
        """Subsets to be decided."""
        return sum(result.total for result in self.results)

    @property
    def pruned(self) -> int:
        """Those among them that a bound ruled out."""
        return sum(result.pruned for result in self.results)

    @property
    def complete(self) -> bool:
        """True if the optimum is proven."""
        return all(result.complete for result in self.results)

    def _costs_by_size(self, floor: bool = False) -> list[FloatArray]:
        """Return the cost of the best subset of each size, (k + 1,), of each part.

        With `floor` they are the least costs that the proof leaves possible.
        """
        costs = []
        for subproblem, result, fewest in zip(self.parts, self.results, self.minimum, strict=True):
            scores = result.floor if floor else result.best
            costs.append(_cost_by_size(scores, subproblem, fewest))
        return costs

    def _objective_of_costs(self, best: float) -> Callable[[float], float] | None:
        """Return a function from a sum of costs to the objective, by that of the best selection.

        Returns None if the objective is neither the sum itself nor an RMSE [px].
        """
        subproblem = self.parts[0]
        # The rows whose errors the score adds up.
        if subproblem.score == "kfold":
            rows = sum(map(len, subproblem.folds))
        elif subproblem.score == "check" and subproblem.system.check_target is not None:
            rows = len(subproblem.system.check_target)
        else:
            rows = len(subproblem.system.design)

        def rmse(cost: float) -> float:
            return float(subproblem.pixels * np.sqrt(max(cost, 0.0) / rows))

        # Which it is the objective of the best selection shows.
        total = sum(float(cost.min()) for cost in self._costs_by_size())
        for objective in (float, rmse):
            if abs(objective(total) - best) <= 1e-6 * abs(best):
                return objective
        return None

    def bound(self, best: float) -> float | None:
        """Return a lower bound of the objective of all selections, given that of the best so far.

        Returns None if the objective is neither the sum of the parts' costs nor their RMSE [px].
        """
        if self.complete:
            return best
        objective = self._objective_of_costs(best)
        if objective is None:
            return None
        return min(best,
                   objective(sum(float(cost.min()) for cost in self._costs_by_size(floor=True))))

    def front(self) -> list[BoolArray]:
        """Return the best selection (size,) of every total size that beats all smaller ones.

        They are in the order of their numbers of genes, so that the last is the best of all. There
        are none where nothing is feasible.
        """
        total, sizes = _least_joint_cost(self._costs_by_size())
        return [self._genes_of_sizes(sizes[i].tolist())
                for i in np.flatnonzero(_beats_smaller_sizes(total))]

    def by_size(self, problem: Problem) -> list[SizeProof]:
        """Return the best selection of every total size, each with its own proof.

        There is none for sizes, by number of genes, of which no feasible selection is known. Where
        the parts are line and sample, the best of n genes are the best i of one and n - i of the
        other for some i. Its bound is the least sum of the bounds over all such i. The problem
        evaluates the selections.
        """
        total, sizes = _least_joint_cost(self._costs_by_size())
        feasible_sizes = np.flatnonzero(np.isfinite(total))
        if not len(feasible_sizes):
            return []
        genes = np.array([self._genes_of_sizes(sizes[i].tolist()) for i in feasible_sizes])
        values, feasible = evaluate_each(problem, genes)
        objective = self._objective_of_costs(float(values[total[feasible_sizes].argmin()]))
        floor = _least_joint_cost(self._costs_by_size(floor=True))[0]
        better = _beats_smaller_sizes(total)
        proofs = []
        # Enumeration and evaluation may differ at a tolerance: what is infeasible is left out.
        for i, selection, value in zip(feasible_sizes[feasible], genes[feasible],
                                       values[feasible].tolist(), strict=True):
            bound = None
            if self.complete and floor[i] == total[i]:
                bound = value
            elif objective is not None and floor[i] > -np.inf:
                bound = min(value, objective(float(floor[i])))
            optimal = bound is not None and value - bound <= TIE * abs(value)
            proofs.append(SizeProof(selection, value, bound, optimal, bool(better[i])))
        return proofs

    def _genes_of_sizes(self, sizes: list[int]) -> BoolArray:
        """Return the genes (size,) of the best subsets of some sizes, one for each part."""
        genes = np.zeros(self.size, dtype=bool)
        for subproblem, result, size in zip(self.parts, self.results, sizes, strict=True):
            genes[subproblem.genes] = result.columns(size)
        return genes


@dataclass(frozen=True, eq=False)
class FeatureProof:
    """State of a proof."""

    # (n + 1,): least objective of the selections of each size so far; infinite without any.
    best: FloatArray
    genes: dict[int, Genes]  # the selection itself, by its size
    decided: int  # selections decided
    total: int  # selections to be decided
    floor: float  # a lower bound of the objective of all selections; 0 if none is known
    pruned = 0  # no bound rules selections out

    @property
    def complete(self) -> bool:
        """True if every selection is decided."""
        return self.decided == self.total

    def bound(self, best: float) -> float | None:
        """Return a lower bound of the objective, given that of the best so far; None if unknown."""
        if self.complete:
            return best
        return min(best, self.floor) if self.floor > 0 else None

    def front(self) -> list[Genes]:
        """Return the best selection of every size that beats all smaller ones."""
        sizes = np.flatnonzero(_beats_smaller_sizes(self.best))
        return [self.genes[size] for size in sizes.tolist()]

    def by_size(self, problem: Problem) -> list[SizeProof]:
        """Return the best selection known of each number of genes, and what is proven of it.

        By number of genes, without those of which no feasible selection is known. Once every
        selection is decided each is optimal; before, only `floor`, a bound of all selections, is
        known. The problem evaluates the selections.
        """
        sizes = sorted(self.genes)
        if not sizes:
            return []
        values, _ = evaluate_each(problem, np.array([self.genes[size] for size in sizes]))
        better = _beats_smaller_sizes(values)
        proofs = []
        for i, size in enumerate(sizes):
            value = float(values[i])
            # An unfinished search has no bound of a single size, only that of all selections.
            bound = self.bound(value)
            optimal = bound is not None and value <= bound
            proofs.append(SizeProof(self.genes[size], value, bound, optimal, bool(better[i])))
        return proofs


def generation_of(problem: Problem, proof: Proof | FeatureProof, index: int, space: str,
                  placeholder: Genes) -> Generation:
    """Return a generation with the best selections that a proof knows so far.

    These are the best ones of every size once all is proven, the best of all until then, and
    `placeholder` (1, size) as long as no feasible selection is known. The details have the share
    that is decided, the proof, the front once all is proven, and the certificate, which calls the
    space of selections by `space`.
    """
    front = proof.front()
    if not front:
        genes = placeholder
    elif proof.complete:
        genes = np.array(front)
    else:
        genes = np.array(front[-1:])
    evaluation = problem.evaluate(genes)
    best = float(evaluation.objectives[-1, 0])
    feasible = bool(front) and evaluation.violation[-1] == 0
    bound = proof.bound(best) if feasible else None
    # How far the best so far is above the bound, as a share of the bound.
    gap = max(0.0, best / bound - 1) if bound is not None and bound > 0 else None
    proven = proof.complete or (gap is not None and gap <= TIE)
    certificate = {"optimal": bool(feasible and proven), "subsets": proof.decided,
                   "bounded": proof.pruned, "of": proof.total, "space": space,
                   "bound": bound, "gap": gap,
                   "feasible": False if proof.complete and not front else None}
    return Generation(index, genes, evaluation, {
        "share": proof.decided / proof.total, "proof": proof,
        "front": genes if front and proof.complete else (),
        "certificate": {name: value for name, value in certificate.items() if value is not None}})


def evaluate_each(problem: Problem, genes: Genes) -> tuple[FloatArray, BoolArray]:
    """Return the first objectives of individuals, (p,), and whether they are feasible, (p,).

    One by one, as sums over a population round otherwise, and a bound is to equal what it proves.
    """
    evaluations = [problem.evaluate(individual[None]) for individual in genes]
    return (np.array([evaluation.objectives[0, 0] for evaluation in evaluations]),
            np.array([evaluation.violation[0] == 0 for evaluation in evaluations]))


def _cost_by_size(scores: FloatArray, subproblem: EnumerablePart, fewest: int) -> FloatArray:
    """Return the cost (k + 1,) of the scores (k + 1,) of 0 to k genes.

    It is infinite for fewer than `fewest` genes, and where a score is not finite.
    """
    cost = np.where(np.isfinite(scores), subproblem.cost(scores), np.inf)
    cost[:fewest] = np.inf
    return cost


def _least_joint_cost(costs: Sequence[FloatArray]) -> tuple[FloatArray, IntArray]:
    """Return the least sum of costs of every total size, (n,), and the parts' sizes, (n, parts).

    The parts are joined one after another: the least cost of n genes is the least sum of the costs
    of i genes in the parts before and n - i genes in this one, over all i.
    """
    total = np.zeros(1)
    sizes = np.zeros((1, 0), dtype=np.intp)
    for cost in costs:
        # joint[n] = minimum over i of total[n - i] + cost[i]
        joint = np.full(len(total) + len(cost) - 1, np.inf)
        split = np.zeros((len(joint), sizes.shape[1] + 1), dtype=np.intp)
        # In a tie the split of fewer genes in this part stays.
        for size in np.flatnonzero(cost < np.inf):
            reached = total + cost[size]
            improved = np.flatnonzero(reached < joint[size:size + len(total)])
            joint[size + improved] = reached[improved]
            split[size + improved] = np.column_stack([sizes[improved],
                                                      np.full(len(improved), size)])
        total = joint
        sizes = split
    return total, sizes


def _beats_smaller_sizes(total: FloatArray) -> BoolArray:
    """Return which sizes, (n,), have a lower cost than all smaller ones."""
    return total < np.minimum.accumulate(np.append(np.inf, total))[:-1]


def prove(problem: Problem, max_terms: int | None = None,
          workers: int | None = None) -> Iterator[Proof]:
    """Decide every selection of a problem, yielding intermediate states; the last one is complete.

    Each part has at most `max_terms` genes. Workers are threads, by default all cores; the result
    does not depend on them. Raises TermselError if the problem's space cannot be enumerated.
    """
    subproblems = problem.parts()
    limits = [limits_of(problem, subproblem, max_terms) for subproblem in subproblems]
    # "rss" need not prove sizes that cost more than smaller ones: `_cost_by_size` shows it which.
    walks = [subsets.search(subproblem.system, subproblem.score, folds=subproblem.folds,
                            max_terms=largest, workers=workers or os.cpu_count() or 1,
                            cost=partial(_cost_by_size, subproblem=subproblem, fewest=fewest))
             for subproblem, (fewest, largest) in zip(subproblems, limits, strict=True)]
    minimum = tuple(fewest for fewest, _ in limits)
    # Every part makes its first steps before any is finished, so that there is a result for each
    # whenever the user stops.
    results = [next(walk) for walk in walks]
    yield Proof(subproblems, tuple(results), minimum, problem.genome.size)
    while any(result.subsets == 0 for result in results):  # what comes before the proof of all
        for i, walk in enumerate(walks):
            if results[i].subsets == 0:
                results[i] = next(walk)
                yield Proof(subproblems, tuple(results), minimum, problem.genome.size)
    for i, walk in enumerate(walks):
        for results[i] in walk:
            yield Proof(subproblems, tuple(results), minimum, problem.genome.size)


def limits_of(problem: Problem, subproblem: EnumerablePart,
              max_terms: int | None) -> tuple[int, int]:
    """Return the fewest and the most genes of a part that leave a degree of freedom."""
    segment = segment_of(problem, subproblem)
    # One row more than terms: without redundancy residuals say nothing.
    upper_limits = (segment.maximum, max_terms, len(subproblem.genes),
                    len(subproblem.system.design) - 1)
    return segment.minimum, min(limit for limit in upper_limits if limit is not None)


def segment_of(problem: Problem, subproblem: EnumerablePart) -> Bits:
    """Return the segment that has the genes of a part."""
    segment = next(s for s, columns in zip(
        problem.genome.segments, problem.genome.slices().values(), strict=True)
        if columns.start <= subproblem.genes[0] < columns.stop)
    assert isinstance(segment, Bits)  # what the solvers declare
    return segment


def count(problem: Problem, max_terms: int | None = None) -> int:
    """Return the number of subsets of all parts together (raises as `prove`)."""
    return sum(
        count_subsets(int(problem.genome.free[subproblem.genes].sum()),
                      limits_of(problem, subproblem, max_terms)[1])
        for subproblem in problem.parts())


def space_of(problem: Problem, subproblems: tuple[EnumerablePart, ...],
             max_terms: int | None) -> str:
    """Return the selections that a proof is of, in words.

    They are such as "selections of up to 12 terms per coordinate", where line and sample are
    `subproblems` of their own, or `ALL`. `max_terms` is the option of the solver, None without it.
    """
    limits = {limits_of(problem, subproblem, max_terms)[1] for subproblem in subproblems}
    most_free = max(int(problem.genome.free[subproblem.genes].sum()) for subproblem in subproblems)
    if min(limits) >= most_free:
        return ALL
    sizes = " and ".join(map(str, sorted(limits))) + (" term" if limits == {1} else " terms")
    unlimited = all(limits_of(problem, subproblem, max_terms)
                    == limits_of(problem, subproblem, None) for subproblem in subproblems)
    return (f"{ALL if unlimited else 'selections'} of up to {sizes}"
            + (" per coordinate" if len(subproblems) > 1 else ""))
