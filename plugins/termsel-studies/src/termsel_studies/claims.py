"""What the tests of a study allow to claim, in plain words."""

from __future__ import annotations

from termsel.toolkit import MEASURES, Row, counted
from termsel_studies.groups import Groups
from termsel_studies.significance import FEWEST, SIGNIFICANCE, Comparison, effect_size
from termsel_studies.summaries import quantiles

_MOST_NAMED = 6
"""Methods without runs on an instance that are named one by one."""
_SIZES = ((0.71, "large"), (0.64, "medium"), (0.56, "small"))


def claims(groups: Groups, comparison: Comparison | None, rows: list[Row]) -> list[str]:
    """Return sentences on what may be claimed, and what not; with few instances no comparison."""
    measure = f"the RMSE on {groups.measure} points" if groups.measure in MEASURES \
        else groups.measure
    if groups.measure == "fitness":
        names = " or ".join(groups.objectives)
        measure = "the fitness" + f" ({names})" * bool(names)
    said = [f"Compared by {measure}; lower is better."]
    if len(groups.methods) < 2:
        said.append("There is one method, so nothing is compared." if groups.methods else
                    "No cell is finished, so nothing is compared.")
    elif comparison is None:
        said += _single(groups)
    else:
        said += _over_instances(comparison)
        if len({row["split"] for row in rows}) > 1:
            said.append("Splits of the same data are not independent of each other, so p is too "
                        "small: trust what holds over many data sets.")
    failed = sum(row["state"] not in ("done", "waiting") for row in rows)
    if failed:
        said.append(f"Without a result, and counted as worst: {failed} of "
                    f"{counted(len(rows), 'cell')}.")
    if groups.measure == "fitness":
        said.append("The fitness chose the selections, so it is not the accuracy: compare the "
                    "column independent.")
    return said


def _single(groups: Groups) -> list[str]:
    """Return what can be said without a test over instances."""
    number = len(groups.common)
    total = len(groups.instances)
    if number:
        of_all = "" if number == total else f"{number} of "
        said = [f"All methods ran on {of_all}{counted(total, 'instance')}; a test over instances "
                f"needs at least {FEWEST}. What follows holds for "
                f"{'this one' if number == 1 else 'these'} alone."]
    else:
        said = ["No instance was run with all methods, so nothing is compared."]
    if number < total:
        said.append(_not_run(groups))
    for name in groups.common:
        by_method = groups.instances[name]
        # A single run, such as one of a solver without chance, says nothing of the next one.
        repeated = [method for method in groups.methods if len(by_method[method].values) > 1]
        if len(repeated) < 2:
            continue
        best = min(repeated, key=lambda method: quantiles(by_method[method].values, (0.5,)))
        sizes = {other: effect_size(by_method[best].values, by_method[other].values)
                 for other in repeated if other != best}
        words = [f"{size_in_words(value)} difference from {other} ({value:.2f})"
                 for other, value in sizes.items()]
        said.append(f"On {name}, {best} has the lowest median of those with several runs: "
                    f"{'; '.join(words)}.")
    return said


def _not_run(groups: Groups) -> str:
    """Return which methods are missing on which instances."""
    missing = [f"{method} on {name}" for name, by_method in groups.instances.items()
               for method in groups.methods if method not in by_method]
    more = len(missing) - _MOST_NAMED
    return "There are no runs of " + ", ".join(missing[:_MOST_NAMED]) + (
        f", and {more} more of this kind." if more > 0 else ".")


def size_in_words(value: float) -> str:
    """Return an effect size in the words of Vargha and Delaney 2000."""
    return next((word for least, word in _SIZES if max(value, 1 - value) >= least), "negligible")


def _over_instances(found: Comparison) -> list[str]:
    said = []
    if found.p is not None:
        word = "differ" if found.p < SIGNIFICANCE else "cannot be told apart"
        said.append(f"Over {found.instances} instances the methods {word} (Friedman, "
                    f"p = {found.p:.2g}).")
    proven = [pair for pair in found.pairs if pair.corrected < SIGNIFICANCE] \
        if found.p is None or found.p < SIGNIFICANCE else []
    for pair in proven:
        better, worse, won = (pair.one, pair.other, pair.wins) if pair.lower \
            else (pair.other, pair.one, pair.losses)
        said.append(f"It may be claimed that {better} is better than {worse}: on {won} of "
                    f"{found.instances} instances (Wilcoxon with Holm's correction, "
                    f"p = {pair.corrected:.2g}).")
    others = len(found.pairs) - len(proven)
    if others:
        said.append(f"Of {counted(others, 'pair')} no difference may be claimed. That does not "
                    "show that they are equally good.")
    said.append("This holds for instances like these, with these options and budgets.")
    return said
