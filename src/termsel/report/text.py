"""A result as a page of text."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

from termsel.diagnosis import BEYOND, CORRELATED, correlations, doubts, significance
from termsel.fitting import Fit, Rmse
from termsel.result import LEAVE_ONE_OUT, ROLES, Result, Rmses

_WIDTH = 88
_LONGEST_FRONT = 40
_TITLES = {"all-terms": "conventional (all)", "dlt": "DLT", "rfm-2": "second-order RFM",
           "rfm-3": "full RFM", "ridge": "full RFM, ridge", "selected": "selected cubic",
           "shrunken-quadratic": "shrunken quadratic", "shrunken-cubic": "shrunken cubic"}


def summary(result: Result) -> str:
    """Return a page that a person reads: what was selected, how good it is, what it is worth.

    Parameters
    ----------
    result : Result
    """
    return "\n".join([*_head(result), "", *_table(result), "", *_front(result), *_foot(result)]
                     ) + "\n"


def _head(result: Result) -> Iterator[str]:
    counts = result.data["counts"]
    yield (f"{result.problem}: model {result.model}, "
           + (f"strategy {result.strategy['name']}" if result.strategy else
              f"solver {result.solver}, criterion {result.criterion}, seed {result.seed}"))
    yield f"Data: {result.data['source']}"
    if result.features.fit_crs:
        yield (f"Fitted in {result.features.fit_crs}; coordinates are given in "
               f"{result.features.crs}, heights {result.data['heights']}")
    control = [f"{counts[key]} {word}" for key, word in (("control", "points"), ("lines", "lines"))
               if counts[key]]
    yield (f"Control: {' and '.join(control)}; {counts['check']} check points; "
           f"{counts['independent']} independent points")
    if result.strategy:
        yield from _strategy(result.strategy, result.seconds)
        return
    yield (f"Selected: {_share(len(result.selection.features), len(result.fit.control))} control "
           f"features, {_share(len(result.selection.terms), len(result.fit.model.terms))} terms; "
           f"redundancy {result.fit.adjustment.redundancy}")
    share = result.options["problem"].get("max_share", 1.0)
    if share < 1:
        yield (f"Terms are {100 * share:.0f} % of their equations at most; --set max_share=1 lifts "
               "this")
    yield (f"Search: {result.evaluations} evaluations ({result.lookups} looked up), "
           f"{result.generations} generations, {result.seconds:.1f} s")
    if result.polish:
        yield (f"Polish: {result.criterion} {result.polish['found']:.4g} as {result.solver} found "
               f"it, {result.polish['polished']:.4g} after {result.polish['evaluations']} "
               "evaluations more")
    if result.certificate:
        exact = "--set recommend=best" if result.solver == "exact" else \
            "--solver exact" + " --set max_share=1" * (share == 1.0)
        yield _certificate(result.certificate, exact)


def _strategy(strategy: Mapping[str, Any], seconds: float) -> Iterator[str]:
    """Yield the candidates with their predicted accuracy, the chosen one marked."""
    chosen = strategy["chosen"]
    predicted = strategy["predicted"]
    yield (f"Chosen: {_TITLES.get(chosen, chosen)}, fitted to control and check together; "
           + (f"predicted accuracy {predicted:.3f} pixel; " if predicted is not None else "")
           + f"{seconds:.1f} s")
    yield ""
    yield f"{'candidate':<24}{'terms':>6}{'free in effect':>16}{'leave-one-out':>16}"
    for one in strategy["candidates"]:
        mark = " <-" if one["name"] == chosen else ""
        yield (f"{_TITLES.get(one['name'], one['name']):<24}{one['n_terms']:>6}"
               f"{one['effective']:>16.1f}{one['predicted']:>16.3f}{mark}")
    yield (f"the predicted accuracy is that of the whole choice, repeated in {strategy['folds']} "
           "folds")


def _certificate(certificate: Mapping[str, Any], exact: str) -> str:
    proven = f"{certificate['subsets']:,} subsets decided, {certificate['space']}"
    if certificate["optimal"]:
        return f"Proven: no selection has a better criterion ({proven})"
    if certificate.get("gap") is not None:
        return (f"Gap: {100 * certificate['gap']:.2f} % above the proven optimum "
                f"{certificate['optimum']:.4g} ({proven}); {exact} finds it")
    if "optimum" in certificate:
        return (f"The proven optimum is {certificate['optimum']:.4g}, below this ({proven}); "
                f"{exact} finds it")
    return f"Not proven: {certificate['subsets']:,} of {certificate['of']:,} subsets decided"


def _share(chosen: int, offered: int) -> str:
    return f"all {offered}" if chosen == offered else f"{chosen} of {offered}"


def _table(result: Result) -> Iterator[str]:
    yield f"{'RMSE [pixel]':<24}{'terms':>6}{'control':>12}{'check':>12}{'independent':>14}"
    rows: list[tuple[str, int, Rmses]] = [
        ("selection" + " *" * bool(result.strategy), len(result.selection.terms), result.rmse)]
    rows += [(_TITLES.get(b.name, b.name) + " *" * ("check" in b.fitted_to), b.n_terms, b.rmse)
             for b in result.baselines]
    for name, n_terms, rmse in rows:
        control, check, independent = (_figure(rmse.get(role)) for role in ROLES)
        yield f"{name:<24}{n_terms:>6}{control:>12}{check:>12}{independent:>14}"
        if LEAVE_ONE_OUT in rmse:
            yield f"{'  ' + LEAVE_ONE_OUT:<30}{_figure(rmse[LEAVE_ONE_OUT]):>12}"
    if LEAVE_ONE_OUT in result.rmse:
        yield (f"{LEAVE_ONE_OUT}: each control feature by the fit without it, as {result.model} "
               "corrects by control")
    if any("check" in b.fitted_to for b in result.baselines):
        yield "* fitted to control and check together; its check figure is a fit"
    if any(not any(b.rmse.values()) for b in result.baselines):
        yield "- not determined with redundancy"
    if result.strategy:
        yield "independent = the accuracy"
    elif result.criterion == "check-rmse":
        yield "check = the fitness the search drove down; independent = the accuracy"
    else:
        yield f"the search drove down {result.criterion}; independent = the accuracy"


def _front(result: Result) -> Iterator[str]:
    """Yield the front, the recommended member marked."""
    if not result.front:
        return
    names = list(result.front[0]["objectives"])
    yield "Front: " + "".join(f"{name:>16}" for name in names) + f"{'independent':>14}"
    if len(result.front) > _LONGEST_FRONT:
        yield f"       {len(result.front)} members; all of them stand in result.json"
        return
    for member in result.front:
        total = member["rmse"]["independent"]["total"]
        chosen = (tuple(member["selection"]["terms"]) == result.selection.terms
                  and tuple(member["selection"]["features"]) == result.selection.features)
        yield ("    -> " if chosen else " " * 7) + "".join(
            f"{member['objectives'][name]:>16.5g}" for name in names
        ) + f"{'-' if total is None else f'{total:.3f}':>14}"
    rule = result.options["problem"].get("recommend")
    if rule and (len(result.objectives) > 1 or rule != "best"):
        yield f"-> the selection, recommended by the rule {rule} (--set recommend=...)"
    yield ""


def _figure(rmse: Rmse | None) -> str:
    if rmse is None:
        return "-"
    return f"{rmse.total:.3f}" if 0.01 <= rmse.total < 1e5 else f"{rmse.total:.2e}"


def _foot(result: Result) -> Iterator[str]:
    yield from textwrap.wrap(result.judgement, _WIDTH)
    for note in result.notes:
        yield from textwrap.wrap(note, _WIDTH, initial_indent="Note: ", subsequent_indent="      ")
    yield from _doubts(result.fit)
    yield from _coefficients(result.fit)
    if len(result.selection.features) < len(result.fit.control):
        yield from _names("Features", result.selection.features)
    if len(result.selection.terms) < len(result.fit.model.terms):
        yield from _names("Terms", result.selection.terms)


def _doubts(fit: Fit) -> Iterator[str]:
    """Yield which features are probably wrong."""
    found = doubts(fit)
    if found is None:
        return
    if found.wrong:
        title = f"Probably wrong (beyond {BEYOND:g} sigma, {BEYOND * found.sigma:.2g} px)"
        yield from _names(title, tuple(
            f"{name} ({found.wrong[name]:.1f} px{', in use' * (name in found.in_use)})"
            for name in sorted(found.wrong, key=lambda name: -found.wrong[name])))
    if found.in_use:
        yield (f"  leave out those in use by --set force_off={','.join(found.in_use)} and run "
               "again")
    if found.spare:
        yield f"Left out though they fit: {len(found.spare)}; they were not needed"


def _coefficients(fit: Fit) -> Iterator[str]:
    """Yield which terms are not significant, and how coefficients correlate."""
    weak = tuple(name for name, one in significance(fit).items() if one.p > 0.05)
    if weak:
        yield from _names("Not significant (5 %)", weak)
    pairs = list(correlations(fit))
    if pairs:
        one, other, value = pairs[0]
        yield (f"Correlations of coefficients of {CORRELATED} or more: {len(pairs)}, highest "
               f"{value:.4f} ({one}, {other})")


def _names(title: str, names: tuple[str, ...]) -> Iterator[str]:
    yield from textwrap.wrap(f"{title}: {' '.join(names)}", _WIDTH, subsequent_indent="  ",
                             break_on_hyphens=False)
