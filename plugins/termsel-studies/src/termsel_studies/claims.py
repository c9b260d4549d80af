"""What the tests of a study allow to claim, in plain words."""

from __future__ import annotations

from collections.abc import Sequence

from termsel.toolkit import count_in_words
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

_MOST_NAMED = 6
"""Methods without runs on an instance that are named one by one."""
A12_IN_WORDS = ("A12 is the share of pairs of runs in which one method is better, 0.5 for equal "
                "ones, with its 95 % interval.")
"""What the effect size of Vargha and Delaney says."""
_SIZES = ((0.71, "large"), (0.64, "medium"), (0.56, "small"))


def valid_claims(groups: Groups, comparison: Comparison | None, rows: list[Row]) -> list[str]:
    """Return sentences on what may be claimed, and what not; with few instances no comparison.

    `groups` are runs by instance and method, `comparison` tests over instances, None where these
    are too few, and `rows` the table of the study. Each sentence is one that a paper could have as
    it stands: by what was compared, what a test allows to say, and what is missing from the
    comparison.
    """
    measure = groups.measure
    if groups.measure == "fitness":
        names = " or ".join(groups.objectives)
        measure = f"the fitness ({names})" if names else "the fitness"
    elif groups.measure in MEASURES:
        measure = f"the RMSE on {groups.measure} points"
    sentences = [f"Compared by {measure}; lower is better."]
    if len(groups.methods) < 2:
        sentences.append("There is one method, so nothing is compared." if groups.methods else
                         "No run is finished, so nothing is compared.")
    elif comparison is None:
        sentences += _claim_of_single(groups)
    else:
        sentences += _claims_over_instances(comparison)
        # Tests take instances for independent of each other, which splits of the same data are not.
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


def _claim_of_single(groups: Groups) -> list[str]:
    """Return sentences on single instances, where they are too few for a test over them.

    Runs of one instance differ by their seeds alone, so that Vargha and Delaney's A12 with its
    interval compares methods on this instance, and says nothing of others.
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
        # A single run, such as one of a solver without chance, says nothing of the next one.
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
    """Return whether two figures are the same in the digits that a table shows."""
    return first == second or f"{first:.4g}" == f"{second:.4g}"


def _advantage_in_words(values: Sequence[float], rival: str, of_rival: Sequence[float]) -> str:
    """Return in words how probably a method beats another, and whether that may be chance."""
    size = effect_size(values, of_rival)
    low, high = effect_size_interval(size, len(values), len(of_rival))
    counts = dict.fromkeys((len(values), len(of_rival)))
    runs = " and ".join(map(str, counts))
    doubt = ", may be chance" if may_be_chance(values, of_rival) else ""
    return (f"{size_in_words(size)} over {rival} ({size:.2f} [{low:.2f}-{high:.2f}] of {runs} runs"
            f"{doubt})")


def _missing_runs_sentence(groups: Groups) -> str:
    """Return a sentence on which methods have no runs on which instances."""
    missing = []
    for name, by_method in groups.instances.items():
        missing += [f"{method} on {name}" for method in groups.methods if method not in by_method]
    n_further = len(missing) - _MOST_NAMED
    return "There are no runs of " + ", ".join(missing[:_MOST_NAMED]) + (
        f", and {n_further} more of this kind." if n_further > 0 else ".")


def size_in_words(value: float) -> str:
    """Return an effect size (0 to 1) in the words of Vargha and Delaney 2000: negligible to large.
    """
    return next((size for limit, size in _SIZES if max(value, 1 - value) >= limit), "negligible")


def _claims_over_instances(comparison: Comparison) -> list[str]:
    """Return sentences on what may be claimed over all instances, by corrected tests.

    Friedman's test over all methods comes first; only if that finds a difference do pairs count, by
    Wilcoxon's test with Holm's correction. What is not proven is said, too, with the reminder that
    it is no proof of the opposite.
    """
    sentences = []
    if comparison.p is not None:
        verdict = "differ" if comparison.p < SIGNIFICANCE else "cannot be distinguished"
        sentences.append(f"Over {comparison.instances} instances the methods {verdict} (Friedman, "
                         f"p = {comparison.p:.2g}).")
    # Pairs are only looked at where the methods as a whole differ: Friedman's test comes first.
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
