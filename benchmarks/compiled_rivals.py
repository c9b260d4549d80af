"""The default optimisers of optuna and nevergrad for genes, by the same draws in less time.

Theirs take a hundredth of a second for each evaluation and, of optuna, ever more: ten searches of
16,000 on twelve scenes would take weeks. These ask for the same selections. Where a genome has to
repair a selection, as one with too many terms, all are told what was evaluated: without that, both
did worse.

``python -m benchmarks.compiled_rivals optuna`` (or nevergrad), by the Python of an environment with
that package, holds them against the package itself and ends with an error where they differ.
"""

from __future__ import annotations

import argparse
import bisect
import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np

import termsel
from termsel import Problem
from termsel.data.features import FloatArray

PENALTY = 1e6
"""Cost of an infeasible selection, for optimisers that know no constraints."""


def costs(evaluation: termsel.Evaluation) -> list[float]:
    """Return the cost of each selection; infeasible ones cost more than any feasible one."""
    penalty = np.where(evaluation.violation > 0, PENALTY * (1 + evaluation.violation), 0)
    cost: list[float] = (evaluation.objectives[:, 0] + penalty).tolist()
    return cost


class Optuna:
    """The default sampler of optuna, TPE, as it is."""

    sampler = "TPESampler"

    def __init__(self, problem: Problem, rng: np.random.Generator) -> None:
        import optuna

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        self.labels = problem.genome.labels
        sampler = getattr(optuna.samplers, self.sampler)(seed=int(rng.integers(2**32)))
        self.study = optuna.create_study(sampler=sampler)

    def ask(self) -> list[bool]:
        """Return the genes of one trial."""
        self.trial = self.study.ask()
        return [self.trial.suggest_categorical(label, [False, True]) for label in self.labels]

    def tell(self, genes: Any, evaluation: termsel.Evaluation) -> None:
        """Tell the cost of the trial, or of the selection that was made of it."""
        import optuna

        params = dict(zip(self.labels, genes[0].astype(bool).tolist(), strict=True))
        if params == self.trial.params:
            self.study.tell(self.trial, costs(evaluation)[0])
            return
        self.study.tell(self.trial, state=optuna.trial.TrialState.FAIL)
        self.study.add_trial(optuna.trial.create_trial(
            params=params, distributions=self.trial.distributions, value=costs(evaluation)[0]))


class TreeParzen:
    """The trials of optuna's default sampler.

    Its two densities are mixtures over the best trials, a tenth of all and 25 at most, and over the
    others. Each trial has a kernel of all genes together, and a gene on its own has (1 + d) /
    (1 + 2 d) for the trial's value and d / (1 + 2 d) for the other, where d is 1 over the number of
    kernels. Of 24 candidates drawn from the first mixture the one with the largest ratio is next.
    """

    startup_trials = 10
    candidates = 24

    def __init__(self, problem: Problem, rng: np.random.Generator) -> None:
        seed = int(rng.integers(2**32))
        self.rng = np.random.RandomState(seed)
        self.start_rng = np.random.RandomState(seed)  # of its RandomSampler
        self.size = problem.genome.size
        # Draws are in the order of the labels' names.
        self.by_name = np.argsort(np.array(problem.genome.labels), kind="stable")
        self.trials = np.zeros((problem.budget, self.size), dtype=bool)
        self.words = np.zeros((problem.budget, -(-self.size // 64)), dtype=np.uint64)
        self.ranked: list[tuple[float, int]] = []  # cost and number of each trial

    def ask(self) -> Any:
        """Return the genes of one trial."""
        n = len(self.ranked)
        if n < self.startup_trials:
            # Of each gene one number for either value; the larger wins.
            return self.start_rng.uniform(size=(self.size, 2)).argmax(axis=1).astype(bool)
        below = np.sort([number for _, number in self.ranked[:min(math.ceil(0.1 * n), 25)]])
        is_below = np.zeros(n, dtype=bool)
        is_below[below] = True
        candidates = self._drawn(self.trials[below])
        words = words_of(candidates)
        others = self.words[:n]
        ratio = (log_densities(words, others[below], ~is_below[below], self.size)
                 - log_densities(words, others, is_below, self.size))
        return candidates[int(np.argmax(ratio))]

    def _drawn(self, below: Any) -> Any:
        """Return candidates drawn from the mixture of the best trials, (24, genes)."""
        weights = kernel_weights(len(below))
        active = self.rng.choice(len(weights), p=weights, size=self.candidates)
        quantiles = np.empty((self.candidates, self.size))
        quantiles[:, self.by_name] = self.rng.rand(self.size, self.candidates).T
        d = 1.0 / len(weights)
        false = np.where(below, d, 1.0 + d) / (1.0 + 2.0 * d)
        return np.vstack([false, np.full(self.size, 0.5)])[active] < quantiles

    def tell(self, genes: Any, evaluation: termsel.Evaluation) -> None:
        """Keep the trial."""
        number = len(self.ranked)
        self.trials[number] = genes[0]
        self.words[number] = words_of(self.trials[number:number + 1])[0]
        bisect.insort(self.ranked, (costs(evaluation)[0], number))


def kernel_weights(n: int) -> FloatArray:
    """Return the weights of n trials and of the prior, (n + 1,): the oldest of many count less."""
    weights = np.ones(n + 1)
    if n >= 25:
        weights[:n - 25] = np.linspace(1.0 / n, 1.0, num=n - 25)
    return weights / weights.sum()


def words_of(genes: Any) -> Any:
    """Return genes (n, size) as bits of words (n, size / 64)."""
    packed = np.packbits(genes, axis=1)
    padded = np.zeros((len(genes), -(-genes.shape[1] // 64) * 8), dtype=np.uint8)
    padded[:, :packed.shape[1]] = packed
    return padded.view(np.uint64)


def log_densities(candidates: Any, trials: Any, left_out: Any, size: int) -> FloatArray:
    """Return the logarithm of the mixture of the trials that are not left out, of each candidate.
    """
    weights = kernel_weights(len(trials) - int(left_out.sum()))
    d = 1.0 / len(weights)
    different = np.arange(size + 1)
    kernel = np.exp(different * np.log(d / (1.0 + 2.0 * d))
                    + (size - different) * np.log((1.0 + d) / (1.0 + 2.0 * d)))
    return np.log(_mixture(candidates, trials, left_out, weights, kernel)
                  + weights[-1] * 0.5**size)


@numba.njit(cache=False)
def _mixture(candidates: Any, trials: Any, left_out: Any, weights: FloatArray,
             kernel: FloatArray) -> Any:
    """Return the sum of the weighted kernels of all trials but some, of each candidate."""
    sums = np.zeros(len(candidates))
    column = 0
    for i in range(len(trials)):
        if left_out[i]:
            continue
        for j in range(len(candidates)):
            different = 0
            for k in range(trials.shape[1]):
                bits = trials[i, k] ^ candidates[j, k]
                # The number of ones: sums of pairs, of fours, of bytes, and of all bytes.
                bits -= (bits >> np.uint64(1)) & np.uint64(0x5555555555555555)
                bits = ((bits & np.uint64(0x3333333333333333))
                        + ((bits >> np.uint64(2)) & np.uint64(0x3333333333333333)))
                bits = (bits + (bits >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
                different += int((bits * np.uint64(0x0101010101010101)) >> np.uint64(56))
            sums[j] += weights[column] * kernel[different]
        column += 1
    return sums


class Nevergrad:
    """The optimizer that nevergrad chooses by budget and space, as it is."""

    def __init__(self, problem: Problem, rng: np.random.Generator) -> None:
        import nevergrad

        # A choice with weights takes 0.1 s for each candidate, and (1 + 1) is stuck in it.
        space = nevergrad.p.TransitionChoice([False, True], repetitions=problem.genome.size)
        space.random_state.seed(int(rng.integers(2**32)))
        self.optimizer = nevergrad.optimizers.NGOpt(space, budget=problem.budget)

    def ask(self) -> Any:
        """Return the genes of one candidate."""
        self.candidate = self.optimizer.ask()
        return self.candidate.value

    def tell(self, genes: Any, evaluation: termsel.Evaluation) -> None:
        """Tell the cost of the candidate, or of the selection that was made of it."""
        value = tuple(genes[0].astype(bool).tolist())
        told = self.candidate
        if tuple(told.value) != value:
            told = told.spawn_child(new_value=value)
        self.optimizer.tell(told, costs(evaluation)[0])


@dataclass(eq=False)
class Estimate:
    """What nevergrad knows of the cost of a selection, which it takes for noisy."""

    genes: Any
    count: int
    mean: float
    square: float  # mean of the squares
    variance: float = 1e6  # of one value

    def add(self, cost: float) -> None:
        """Take one more value."""
        self.mean = self.count / (self.count + 1) * self.mean + cost / (self.count + 1)
        self.square = (self.count * self.square + cost * cost) / (self.count + 1)
        self.count += 1
        self.square = max(self.square, self.mean**2)
        self.variance = math.sqrt(self.count / (self.count - 1)) * (self.square - self.mean**2)

    def bound(self, sign: int) -> float:
        """Return the mean, or a lower or upper limit of it, by a sign of 0, -1 or 1."""
        return self.mean + sign * 0.1 * math.sqrt(self.variance / (1 + self.count))


class Lengler:
    """The selections of NGOpt for genes: (1 + 1), with ever fewer genes flipped.

    It starts with no gene on. The next is made of the selection whose upper limit is the lowest.
    """

    kept_least, kept_most = 100, 1000

    def __init__(self, problem: Problem, rng: np.random.Generator) -> None:
        self.rng = np.random.RandomState()
        self.rng.seed(int(rng.integers(2**32)))
        self.size = problem.genome.size
        self.archive: dict[bytes, Estimate] = {}
        self.asked = 0
        self.best: Estimate | None = None

    def ask(self) -> Any:
        """Return the genes of one candidate."""
        self.asked += 1
        if self.best is None:
            self.genes = np.zeros(self.size, dtype=bool)
            return self.genes
        before = self.asked - 1
        flips = int(max(1, self.size * (1.54468 * np.log(before) / before)))
        kept = np.ones(self.size, dtype=bool)
        while kept.all():
            kept = self.rng.rand(self.size) > flips / self.size
        self.genes = self.best.genes.copy()
        for i in np.flatnonzero(~kept):
            # Numbers are drawn until one has the other sign.
            while (self.rng.normal(0.0, 1.0) > 0) == self.best.genes[i]:
                pass
            self.genes[i] ^= True
        return self.genes

    def tell(self, genes: Any, evaluation: termsel.Evaluation) -> None:
        """Keep the cost, and the best selection."""
        told = genes[0].astype(bool)
        cost = costs(evaluation)[0]
        # The very first is in the middle of its bins, which no other is.
        is_start = self.best is None and (told == self.genes).all()
        key = b"start" if is_start else told.tobytes()
        estimate = self.archive.get(key)
        if estimate is None:
            estimate = self.archive[key] = Estimate(told, 1, cost, cost * cost)
        else:
            estimate.add(cost)
            if estimate is self.best:
                self.best = min(self.archive.values(), key=lambda value: value.bound(1))
        if self.best is None or estimate.bound(1) <= self.best.bound(1):
            self.best = estimate
        if len(self.archive) >= self.kept_most:
            self._prune()

    def _prune(self) -> None:
        """Keep the selections that are among the best by any of the three figures."""
        share = (self.kept_least + 1) / len(self.archive)
        limits = {sign: np.quantile([value.bound(sign) for value in self.archive.values()], share,
                                    method="lower") for sign in (-1, 1, 0)}
        self.archive = {key: value for key, value in self.archive.items()
                        if any(value.bound(sign) < limits[sign] for sign in limits)}


PAIRS: dict[str, tuple[Callable[..., Any], Callable[..., Any]]] = {
    "optuna": (Optuna, TreeParzen), "nevergrad": (Nevergrad, Lengler)}
"""Of each package its own optimiser and the one that takes less time."""


def different_trials(package: str, problem: Problem, trials: int, seed: int) -> list[int]:
    """Return the numbers of the trials that differ between a package and what stands for it."""
    sequences = []
    for optimiser_class in PAIRS[package]:
        optimiser = optimiser_class(_Budgeted(problem, trials), np.random.default_rng(seed))
        repairs = np.random.default_rng(seed)
        asked = []
        for _ in range(trials):
            genes = np.array(optimiser.ask(), dtype=bool)[None]
            asked.append(genes[0])
            genes = problem.genome.repair(genes, repairs)
            optimiser.tell(genes, problem.evaluate(genes))
        sequences.append(np.array(asked))
    return np.flatnonzero((sequences[0] != sequences[1]).any(axis=1)).tolist()


class _Budgeted:
    """A problem with a budget, as a search has it."""

    def __init__(self, problem: Problem, budget: int) -> None:
        self.genome = problem.genome
        self.budget = budget


def main() -> None:
    """Hold the trials of a package against those made here."""
    from benchmarks.short_budgets import problems

    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("package", choices=list(PAIRS))
    parser.add_argument("--trials", type=int, default=300)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--scenes", type=int, default=3)
    asked = parser.parse_args()
    for scene, problem in list(problems().items())[:asked.scenes]:
        for seed in range(1, asked.seeds + 1):
            different = different_trials(asked.package, problem, asked.trials, seed)
            if different:
                sys.exit(f"{scene}, seed {seed}: trial {different[0]} is the first of "
                         f"{len(different)} that differ")
            print(f"{scene}, seed {seed}: the same {asked.trials} trials")


if __name__ == "__main__":
    main()
