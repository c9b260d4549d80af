"""What the tests of a study allow to claim, in plain words."""

from __future__ import annotations

from collections.abc import Sequence

from termsel.toolkit import count_in_words
from termsel.toolkit.charts import criterion_in_words
from termsel.toolkit.studies import MEASURES, Row
from termsel_studies.groups import Groups
from termsel_studies.significance import (
    MIN_INSTANCES,
    SIGNIFICANCE,
    Comparison,
    effect_size,
    effect_size_interval,
    may_be_chance,
)
from termsel_studies.summaries import quantiles_with_infinity

_MAX_NAMED = 6
"""Methods without runs on an instance that are named one by one."""
A12_IN_WORDS = ("A12 is the share of pairs of runs in which one method is better, 0.5 for equal "
                "ones, with its 95 % interval.")
"""What the effect size of Vargha and Delaney says."""
_POINTS_IN_WORDS = {"check": "selection points", "independent": "independent check points (ICP)"}
_SIZES = ((0.71, "large"), (0.64, "medium"), (0.56, "small"))


def valid_claims(groups: Groups, comparison: Comparison | None, rows: list[Row]) -> list[str]:
    """Return sentences on what may be claimed of a study, and what not, as a paper could have them.

    The sentences say by what was compared, what the tests allow to claim, and what is missing from
    the comparison. `groups` are the runs by instance and method, `rows` the table of the study.
    `comparison` has the tests over instances; where it is None, as for too few instances, the
    sentences are on single instances.
    """
    measure = groups.measure
    if groups.measure == "fitness":
        names = " or ".join(map(criterion_in_words, groups.objectives))
        measure = f"the fitness ({names})" if names else "the fitness"
    elif groups.measure in MEASURES:
        measure = f"the RMSE at {_POINTS_IN_WORDS[groups.measure]}"
    sentences = [f"Compared by {measure}; lower is better."]
    if len(groups.methods) < 2:
        sentences.append("There is one method, so nothing is compared." if groups.methods else
                         "No run is finished, so nothing is compared.")
    elif comparison is None:
        sentences += _claims_on_single_instances(groups)
    else:
        sentences += _claims_over_instances(comparison)
        # The tests assume that instances are independent, which splits of the same data are not.
        if len({row["split"] for row in rows}) > 1:
            sentences.append("Splits of the same data are not independent of each other, so p is "
                             "too small: trust what holds over many data sets.")
    failed = sum(row["state"] not in ("done", "waiting") for row in rows)
    if failed:
        sentences.append(f"Without a result, and counted as worst: {failed} of "
                         f"{count_in_words(len(rows), 'run')}.")
    n_unproven = sum(
        (row.get("solver") or "").split(",")[0] == "exact" and row["state"] == "done"
        and not row.get("proven") and row.get("optimum") is None for row in rows)
    if n_unproven:
        sentences.append(f"Not proven: {count_in_words(n_unproven, 'run')} of exact ended before "
                         "the optimum was proven, so a better selection may exist.")
    if groups.measure == "fitness":
        sentences.append("The fitness chose the selections, so it is not the accuracy: compare the "
                         "RMSE at independent check points (ICP).")
    return sentences


def _claims_on_single_instances(groups: Groups) -> list[str]:
    """Return sentences on each instance by itself, where they are too few for a test over them.

    Runs of one instance differ by their seeds alone. So the effect size A12 of Vargha and Delaney
    compares methods on this instance, and says nothing of others. Instances with fewer than two
    methods of several runs each have no sentence.
    """
    number = len(groups.common)
    total = len(groups.instances)
    if number:
        of_all = "" if number == total else f"{number} of "
        sentences = [f"All methods ran on {of_all}{count_in_words(total, 'instance')}; a test over "
                     f"instances needs at least {MIN_INSTANCES}. What follows is valid for "
                     f"{'this one' if number == 1 else 'these'} alone."]
    else:
        sentences = ["No instance was run with all methods, so nothing is compared."]
    if number < total:
        sentences.append(_missing_runs_sentence(groups))
    for name in groups.common:
        by_method = groups.instances[name]
        # A single run, such as that of a solver without chance, does not show how far runs scatter.
        repeated = [method for method in groups.methods if len(by_method[method].values) > 1]
        if len(repeated) < 2:
            continue
        # The best is compared with each of the others, run by run.
        medians = {method: quantiles_with_infinity(by_method[method].values, (0.5,))[0]
                   for method in repeated}
        least = min(medians.values())
        best = [method for method in repeated if alike(medians[method], least)]
        words = [_advantage_in_words(by_method[best[0]].values, rival, by_method[rival].values)
                 for rival in repeated if rival != best[0]]
        if len(best) == 1:
            lowest = f"{best[0]} has the lowest median"
        else:
            lowest = f"{' and '.join(best)} have the same lowest median"
        sentences.append(f"On {name}, {lowest} of the methods with several runs. {A12_IN_WORDS} "
                         f"The advantage of {best[0]} is {', '.join(words)}.")
    return sentences


def alike(first: float, second: float) -> bool:
    """Return whether two figures are equal, or the same in the four digits that a table shows."""
    return first == second or f"{first:.4g}" == f"{second:.4g}"


def _advantage_in_words(values: Sequence[float], rival: str, of_rival: Sequence[float]) -> str:
    """Return in words by how much a method is better than `rival` on one instance.

    `values` are the results of its runs, `of_rival` those of the rival; lower is better. The words
    have the effect size with its interval, both numbers of runs, and whether it may be chance.
    """
    size = effect_size(values, of_rival)
    low, high = effect_size_interval(size, len(values), len(of_rival))
    # One number where both methods have as many runs.
    different_counts = dict.fromkeys((len(values), len(of_rival)))
    runs = " and ".join(map(str, different_counts))
    doubt = ", may be chance" if may_be_chance(values, of_rival) else ""
    return (f"{size_in_words(size)} over {rival} ({size:.2f} [{low:.2f}-{high:.2f}] of {runs} runs"
            f"{doubt})")


def _missing_runs_sentence(groups: Groups) -> str:
    """Return a sentence that names up to six methods with the instances they have no runs on."""
    missing = []
    for name, by_method in groups.instances.items():
        missing += [f"{method} on {name}" for method in groups.methods if method not in by_method]
    n_further = len(missing) - _MAX_NAMED
    return "There are no runs of " + ", ".join(missing[:_MAX_NAMED]) + (
        f", and {n_further} more of this kind." if n_further > 0 else ".")


def size_in_words(value: float) -> str:
    """Return "negligible", "small", "medium" or "large" for an effect size (0 to 1).

    The words and their limits are those of Vargha and Delaney 2000. The size counts in both
    directions: 0.2 is as large as 0.8.
    """
    return next((size for limit, size in _SIZES if max(value, 1 - value) >= limit), "negligible")


def _claims_over_instances(comparison: Comparison) -> list[str]:
    """Return sentences on what may be claimed over all instances, by corrected tests.

    With three or more methods, Friedman's test over all of them comes first, and pairs count only
    if it finds a difference. Pairs count by Wilcoxon's test with Holm's correction. One sentence
    says for how many pairs no difference is proven, and that this is no proof of the opposite.
    """
    sentences = []
    if comparison.p is not None:
        verdict = "differ" if comparison.p < SIGNIFICANCE else "cannot be distinguished"
        sentences.append(f"Over {comparison.instances} instances the methods {verdict} (Friedman, "
                         f"p = {comparison.p:.2g}).")
    # Two methods have no Friedman's test: p is None, and their one pair is tested.
    if comparison.p is None or comparison.p < SIGNIFICANCE:
        proven = [pair for pair in comparison.pairs if pair.corrected < SIGNIFICANCE]
    else:
        proven = []
    for pair in proven:
        better = pair.first if pair.lower else pair.second
        worse = pair.second if pair.lower else pair.first
        won = pair.wins if pair.lower else pair.losses
        sentences.append(f"It may be claimed that {better} is better than {worse}: on {won} of "
                         f"{comparison.instances} instances (Wilcoxon with Holm's correction, "
                         f"p = {pair.corrected:.2g}).")
    n_unproven = len(comparison.pairs) - len(proven)
    if n_unproven:
        sentences.append(f"Of {count_in_words(n_unproven, 'pair')} no difference may be claimed. "
                         "That does not show that they are equally good.")
    sentences.append("This is valid for instances like these, with these options and budgets.")
    return sentences
