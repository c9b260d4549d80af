"""Tests over many problems, and effect sizes: what of a comparison is more than chance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from termsel.toolkit import FloatArray
from termsel_studies.groups import Groups
from termsel_studies.summaries import quantiles_with_infinity

SIGNIFICANCE = 0.05
"""Significance level of all tests."""

_NORMAL_95 = 1.959964

MIN_INSTANCES = 5
"""Instances below which no test over instances is made: Wilcoxon's test of 5 pairs ends at 0.06."""


@dataclass(frozen=True)
class Pair:
    """Two methods compared over all instances by medians."""

    first: str
    second: str
    # Of Wilcoxon's signed-rank test, two-sided.
    p: float
    # By Holm, for all pairs.
    corrected: float
    # Instances on which the one is lower.
    wins: int
    # Or higher.
    losses: int
    # By the ranks that the test sums, the one is lower: it may still lose on more instances, by
    # less.
    lower: bool


@dataclass(frozen=True)
class Comparison:
    """Tests of methods over the instances that all methods were run on."""

    methods: tuple[str, ...]
    instances: int
    # Mean rank of each; 1 is best.
    ranks: tuple[float, ...]
    # Of Friedman's test, for three methods or more.
    statistic: float | None
    p: float | None
    # Nemenyi's critical one of mean ranks, likewise.
    difference: float | None
    pairs: tuple[Pair, ...]


def medians_of(groups: Groups) -> FloatArray:
    """Return medians (instances, methods) on every instance that all methods were run on."""
    medians = np.empty((len(groups.common), len(groups.methods)))
    for i, name in enumerate(groups.common):
        for j, method in enumerate(groups.methods):
            medians[
                i, j] = quantiles_with_infinity(groups.instances[name][method].values, (0.5,))[0]
    return medians


def compare_methods(methods: Sequence[str], values: FloatArray) -> Comparison | None:
    """Return Friedman's test, Wilcoxon's with Holm's correction, and the critical difference.

    Values have the shape (instances, methods); lower is better, infinite is a method without a
    result. None for a single method, or fewer than `MIN_INSTANCES` instances.
    """
    from scipy.stats import friedmanchisquare, rankdata

    instances, number = values.shape
    if number < 2 or instances < MIN_INSTANCES:
        return None
    # Demšar 2006, J. Mach. Learn. Res. 7, sections 3.1.3 and 3.2.
    ranks = rankdata(values, axis=1).mean(axis=0)
    statistic = p = difference = None
    if number > 2:
        # All alike on every instance: there is nothing to tell apart, and the test divides by zero.
        all_equal = bool((values == values[:, :1]).all())
        statistic, p = (0.0, 1.0) if all_equal else map(float, friedmanchisquare(
            *rankdata(values, axis=1).T))
        difference = critical_difference(number, instances)
    # Every pair of methods, by Wilcoxon's test over the instances.
    tested = [(i, j, *signed_rank_test(values[:, i], values[:, j]))
              for i, j in combinations(range(number), 2)]
    corrected = holm_correction([p_value for _, _, p_value, _ in tested])
    pairs = []
    for (i, j, p_value, lower), after in zip(tested, corrected, strict=True):
        wins = int((values[:, i] < values[:, j]).sum())
        losses = int((values[:, i] > values[:, j]).sum())
        pairs.append(Pair(methods[i], methods[j], p=p_value, corrected=after, wins=wins,
                          losses=losses, lower=lower))
    return Comparison(
        methods=tuple(methods), instances=instances, ranks=tuple(map(float, ranks)),
        statistic=statistic, p=p, difference=difference, pairs=tuple(pairs))


def signed_rank_test(first: FloatArray, second: FloatArray) -> tuple[float, bool]:
    """Return the two-sided p of Wilcoxon's test of pairs (n,), and whether `first` is lower.

    A method without a result is infinite, and worse than any; p is 1 if no pair differs.
    """
    from scipy.stats import rankdata, wilcoxon

    # Differences of a method without a result count as larger than all others; two of them as none.
    with np.errstate(invalid="ignore"):
        difference = np.where(first == second, 0.0, first - second)
    finite = np.abs(difference[np.isfinite(difference)])
    largest = 2 * (finite.max() if len(finite) else 0.0) + 1.0
    difference = np.clip(difference, -largest, largest)
    if not difference.any():
        return 1.0, False
    differences = difference[difference != 0]
    # The sum of signed ranks, as the test has it.
    lower = bool((rankdata(np.abs(differences)) * np.sign(differences)).sum() < 0)
    return float(wilcoxon(difference).pvalue), lower


def holm_correction(p_values: Sequence[float]) -> list[float]:
    """Return p-values corrected for their number, in their order (Holm 1979, Scand. J. Stat. 6(2)).
    """
    order = np.argsort(p_values, kind="stable")
    # Holm: the smallest p times n, the next times n - 1, ..., never falling again.
    scaled = np.asarray(p_values)[order] * np.arange(len(p_values), 0, -1)
    corrected = np.empty(len(p_values))
    corrected[order] = np.minimum(np.maximum.accumulate(scaled), 1.0) if len(scaled) else scaled
    return [float(value) for value in corrected]


def critical_difference(methods: int, instances: int, level: float = SIGNIFICANCE) -> float:
    """Return the least significant difference of mean ranks by Nemenyi's test.

    Demšar 2006, section 3.2.2.
    """
    from scipy.stats import studentized_range

    quantile = float(studentized_range.ppf(1 - level, methods, np.inf)) / math.sqrt(2)
    return quantile * math.sqrt(methods * (methods + 1) / (6 * instances))


def effect_size(first: Sequence[float], second: Sequence[float]) -> float:
    """Return the probability that a value of `first` is below one of `second`, ties counted half.

    0.5 if both are alike; above it, `first` is the better one where lower is better.
    """
    # Ties count half: Vargha and Delaney 2000, J. Educ. Behav. Stat. 25(2), equation 2, for values
    # of which lower ones are better.
    a = np.asarray(first)[:, None]
    b = np.asarray(second)[None]
    return float((a < b).mean() + (a == b).mean() / 2)


def effect_size_interval(size: float, n_first: int, n_second: int) -> tuple[float, float]:
    """Return the 95 % confidence interval of an effect size of so many runs.

    By method 5 of Newcombe 2006, Stat. Med. 25(4), which holds for a few runs and for sizes of 0
    and 1: the sizes that the observed one does not contradict.
    """
    mean_runs = (n_first + n_second) / 2 - 1

    def contradicted(true_size: float) -> bool:
        variance = true_size * (1 - true_size) / (n_first * n_second) * (
            1 + mean_runs * ((1 - true_size) / (2 - true_size) + true_size / (1 + true_size)))
        return bool((size - true_size) ** 2 > _NORMAL_95**2 * variance)

    sizes = np.linspace(0, 1, 2001)
    accepted = sizes[[not contradicted(float(value)) for value in sizes]]
    # The size itself is within, though the grid may miss it.
    return float(accepted.min(initial=size)), float(accepted.max(initial=size))


def may_be_chance(first: Sequence[float], second: Sequence[float]) -> bool:
    """Return whether runs of one method may be lower than those of the other by chance alone.

    By the test of Mann and Whitney, two-sided; exact for few runs without ties.
    """
    from scipy.stats import mannwhitneyu

    return bool(mannwhitneyu(first, second).pvalue > SIGNIFICANCE)


def performance_profile(values: FloatArray, ratios: Sequence[float]) -> FloatArray:
    """Return on which share of instances each method is within a ratio of the best one.

    Values, shape (instances, methods), are positive; ratios are from 1 on; shape (ratios, methods).
    """
    # Dolan and Moré 2002, Math. Program. 91, section 2.
    best = values.min(axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = np.where(np.isfinite(values), values / best, np.inf)
    # Also where the best is 0.
    relative[(values == best) & np.isfinite(values)] = 1.0
    # A ratio at the limit counts, whatever rounding says.
    return np.asarray((relative[None] <= np.asarray(ratios)[:, None, None] * (1 + 1e-12)
                       ).mean(axis=1))
