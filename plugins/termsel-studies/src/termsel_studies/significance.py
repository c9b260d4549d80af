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
    # The p of Wilcoxon's signed-rank test, two-sided.
    p: float
    # The same p, corrected by Holm for the number of pairs.
    corrected: float
    # On how many instances the first method is lower.
    wins: int
    # On how many instances the first method is higher.
    losses: int
    # Whether the first method is lower by the ranks that the test sums. It may still be higher on
    # more instances, by smaller amounts.
    lower: bool


@dataclass(frozen=True)
class Comparison:
    """Tests of methods over the instances that all methods were run on."""

    methods: tuple[str, ...]
    instances: int
    # Mean rank of each method; 1 is best.
    ranks: tuple[float, ...]
    # Statistic and p of Friedman's test; None for two methods.
    statistic: float | None
    p: float | None
    # Nemenyi's critical difference of mean ranks; None for two methods.
    difference: float | None
    pairs: tuple[Pair, ...]


def medians_of(groups: Groups) -> FloatArray:
    """Return medians (instances, methods) on every instance that all methods were run on."""
    medians = np.empty((len(groups.common), len(groups.methods)))
    for i, name in enumerate(groups.common):
        for j, method in enumerate(groups.methods):
            values = groups.instances[name][method].values
            medians[i, j] = quantiles_with_infinity(values, (0.5,))[0]
    return medians


def compare_methods(methods: Sequence[str], values: FloatArray) -> Comparison | None:
    """Return the tests of methods over instances: of all methods together, and of each pair.

    `values` have the shape (instances, methods); lower is better, and infinite is a method without
    a result. Friedman's test and Nemenyi's critical difference need three methods or more; pairs
    are tested by Wilcoxon's test with Holm's correction. None for a single method, or for fewer
    than `MIN_INSTANCES` instances.
    """
    from scipy.stats import friedmanchisquare, rankdata

    instances, n_methods = values.shape
    if n_methods < 2 or instances < MIN_INSTANCES:
        return None
    # Demšar 2006, J. Mach. Learn. Res. 7, sections 3.1.3 and 3.2.
    ranks = rankdata(values, axis=1).mean(axis=0)
    statistic = p = difference = None
    if n_methods > 2:
        # If all methods are equal on every instance, Friedman's test would divide by zero.
        all_equal = bool((values == values[:, :1]).all())
        statistic, p = (0.0, 1.0) if all_equal else map(float, friedmanchisquare(
            *rankdata(values, axis=1).T))
        difference = critical_difference(n_methods, instances)
    tested = [(i, j, *signed_rank_test(values[:, i], values[:, j]))
              for i, j in combinations(range(n_methods), 2)]
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
    """Return the two-sided p of Wilcoxon's signed-rank test, and whether `first` is lower.

    `first` and `second` (n,) are paired by instance. An infinite value, of a method without a
    result, is worse than any finite one; two infinite ones are equal. If no pair differs, p is 1
    and `first` is not lower.
    """
    from scipy.stats import rankdata, wilcoxon

    # The test takes no infinite differences: they become finite ones, larger than all others.
    with np.errstate(invalid="ignore"):
        difference = np.where(first == second, 0.0, first - second)
    finite = np.abs(difference[np.isfinite(difference)])
    largest = 2 * (finite.max() if len(finite) else 0.0) + 1.0
    difference = np.clip(difference, -largest, largest)
    if not difference.any():
        return 1.0, False
    differences = difference[difference != 0]
    lower = bool((rankdata(np.abs(differences)) * np.sign(differences)).sum() < 0)
    return float(wilcoxon(difference).pvalue), lower


def holm_correction(p_values: Sequence[float]) -> list[float]:
    """Return p-values corrected for their number, in the order given; [] of none.

    Holm 1979, Scand. J. Stat. 6(2).
    """
    order = np.argsort(p_values, kind="stable")
    # The smallest p counts n times, the next n - 1 times and so on; none is below the one before.
    scaled = np.asarray(p_values)[order] * np.arange(len(p_values), 0, -1)
    corrected = np.empty(len(p_values))
    corrected[order] = np.minimum(np.maximum.accumulate(scaled), 1.0) if len(scaled) else scaled
    return [float(value) for value in corrected]


def critical_difference(methods: int, instances: int, level: float = SIGNIFICANCE) -> float:
    """Return the difference of two mean ranks from which on Nemenyi's test finds it significant.

    `methods` and `instances` are how many there are. Demšar 2006, section 3.2.2.
    """
    from scipy.stats import studentized_range

    quantile = float(studentized_range.ppf(1 - level, methods, np.inf)) / math.sqrt(2)
    return quantile * math.sqrt(methods * (methods + 1) / (6 * instances))


def effect_size(first: Sequence[float], second: Sequence[float]) -> float:
    """Return the share of pairs in which a value of `first` is below one of `second`, A12.

    Ties count half, so that it is 0.5 for equal methods; above 0.5, `first` is better, where lower
    values are. Vargha and Delaney 2000, J. Educ. Behav. Stat. 25(2), equation 2.
    """
    a = np.asarray(first)[:, None]
    b = np.asarray(second)[None]
    return float((a < b).mean() + (a == b).mean() / 2)


def effect_size_interval(size: float, n_first: int, n_second: int) -> tuple[float, float]:
    """Return the lower and upper end of the 95 % confidence interval of an effect size.

    `n_first` and `n_second` are the numbers of runs. Within the interval are the sizes that the
    observed one does not contradict, by method 5 of Newcombe 2006, Stat. Med. 25(4), which holds
    for few runs and for sizes of 0 and 1 too.
    """
    mean_runs = (n_first + n_second) / 2 - 1

    def is_contradicted(true_size: float) -> bool:
        """Return whether the observed size is too far from a true one, by that one's variance."""
        variance = true_size * (1 - true_size) / (n_first * n_second) * (
            1 + mean_runs * ((1 - true_size) / (2 - true_size) + true_size / (1 + true_size)))
        return bool((size - true_size) ** 2 > _NORMAL_95**2 * variance)

    sizes = np.linspace(0, 1, 2001)
    accepted = sizes[[not is_contradicted(float(value)) for value in sizes]]
    # The observed size is within, though the grid of 2001 sizes may have none near enough.
    return float(accepted.min(initial=size)), float(accepted.max(initial=size))


def may_be_chance(first: Sequence[float], second: Sequence[float]) -> bool:
    """Return whether the runs of two methods may differ by chance alone.

    They may if the two-sided test of Mann and Whitney does not find a difference at the level
    `SIGNIFICANCE`.
    """
    from scipy.stats import mannwhitneyu

    return bool(mannwhitneyu(first, second).pvalue > SIGNIFICANCE)


def performance_profile(values: FloatArray, ratios: Sequence[float]) -> FloatArray:
    """Return the share of instances on which each method is within a ratio of the best one.

    `values` (instances, methods) are 0 or more, infinite for a method without a result, which is
    within no ratio; `ratios` are 1 or more. The shares have the shape (ratios, methods).
    """
    # Dolan and Moré 2002, Math. Program. 91, section 2.
    best = values.min(axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = np.where(np.isfinite(values), values / best, np.inf)
    # The best method has the ratio 1, also where its value is 0 and 0 / 0 is not a number.
    relative[(values == best) & np.isfinite(values)] = 1.0
    # The factor lets a ratio count that is beyond the limit by rounding alone.
    return np.asarray((relative[None] <= np.asarray(ratios)[:, None, None] * (1 + 1e-12)
                       ).mean(axis=1))
