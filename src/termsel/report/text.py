"""A record as a page of text."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from termsel.candidates.compare import WITHOUT_BLUNDERS
from termsel.candidates.portfolio import EXACT
from termsel.candidates.structures import named
from termsel.errors import amount, counted, percent, printable
from termsel.fits.diagnosis import BEYOND, CORRELATED
from termsel.fits.figures import LEAVE_ONE_OUT, ROLES
from termsel.report import sizes

_WIDTH = 88
_LONGEST_FRONT = 40

Record = Mapping[str, Any]


def summary(record: Record) -> str:
    """Return a page that a person reads: what was selected, how good it is, what it is worth.

    Parameters
    ----------
    record : mapping
        The content of result.json.
    """
    # File names may have what a terminal would obey.
    return printable("\n".join([*_head(record), "", *_table(record), "", *_front(record),
                                *_accuracy(record), *_foot(record)])) + "\n"


def _offered(record: Record) -> tuple[int, int]:
    """Return how many terms and control features there were to select from."""
    offered = record.get("offered")
    if offered is None:  # a record of version 0.1
        counts, selection = record["data"]["counts"], record["selection"]
        return (max(b["n_terms"] for b in (selection, *record["baselines"])
                    if b is selection or b["name"] == "all-terms"),
                counts["control"] + counts["lines"])
    return offered["n_terms"], offered["n_features"]


def _head(record: Record) -> Iterator[str]:
    data, strategy, selection = record["data"], record["strategy"], record["selection"]
    counts = data["counts"]
    yield (f"{record['problem']}: model {record['model']}, "
           + (f"strategy {strategy['name']}" if strategy else
              f"solver {record['solver']}, criterion {record['criterion']}, "
              f"seed {record['seed']}"))
    yield f"Data: {data['source']}"
    if data["fit_crs"] != data["crs"]:
        yield (f"Fitted in {data['fit_crs']}; coordinates are given in {data['crs']}, heights "
               f"{data['heights']}")
    control = [counted(counts[key], word) for key, word in (("control", "point"), ("lines", "line"))
               if counts[key]]
    yield (f"Control: {' and '.join(control)}; {counted(counts['check'], 'check point')}; "
           f"{counted(counts['independent'], 'independent point')}")
    if strategy:
        yield from _strategy(strategy, record["seconds"])
        return
    terms, features = _offered(record)
    yield (f"Selected: {_share(selection['n_features'], features)} control features, "
           f"{_share(selection['n_terms'], terms)} terms; "
           f"redundancy {record['adjustment']['redundancy']}")
    if parameters := selection.get("parameters"):  # not in older records
        yield from textwrap.wrap("Parameters: " + ", ".join(
            f"{name} {value:.6g}" if isinstance(value, float) else f"{name} {value}"
            for name, value in parameters.items()), _WIDTH, subsequent_indent="  ")
    share = record["options"]["problem"].get("max_share", 1.0)
    if share < 1:
        yield (f"Terms are {100 * share:.0f} % of their equations at most; --set max_share=1 lifts "
               "this")
    yield (f"Search: {counted(record['evaluations'], 'evaluation')} ({record['lookups']} looked "
           f"up), {counted(record['generations'], 'generation')}, {record['seconds']:.1f} s")
    if refined := record["polish"]:
        yield (f"Local refinement: {record['criterion']} {refined['found']:.4g} as "
               f"{record['solver']} found it, {refined['polished']:.4g} after it "
               f"({counted(refined['evaluations'], 'evaluation')})")
    if record["certificate"]:
        exact = "--solver exact" + " --set max_share=1" * (share == 1.0)
        if record["solver"] == "exact":  # it has a front once it has decided all
            exact = "--set recommend=best" if record["front"] else "a larger budget"
        yield _certificate(record["certificate"], exact)


def _strategy(strategy: Mapping[str, Any], seconds: float) -> Iterator[str]:
    """Yield the candidates with their leave-one-out RMSE, the chosen one marked."""
    chosen = strategy["chosen"]
    predicted = strategy["predicted"]
    yield (f"Chosen: {_title(chosen)}, fitted to control and check together; "
           + (f"predicted RMSE {predicted:.3f} px; " if predicted is not None else "")
           + f"{seconds:.1f} s")
    yield ""
    yield f"{'candidate':<24}{'terms':>6}{'effective':>16}{'leave-one-out':>16}"
    for one in strategy["candidates"]:
        mark = " <-" if one["name"] == chosen else ""
        yield (f"{_title(one['name']):<24}{one['n_terms']:>6}"
               f"{one['effective']:>16.1f}{_loo(one['predicted']):>16}{mark}")
    if "reason" in strategy:  # records of version 0.1 do not say it
        yield from textwrap.wrap(f"<- {strategy['reason']}", _WIDTH, subsequent_indent="   ")
    if predicted is not None:
        yield (f"The predicted RMSE is that of the whole choice, repeated in {strategy['folds']} "
               "folds." if strategy["folds"] > EXACT + 1 else
               "The predicted RMSE is that of this candidate without each point.")


def _loo(predicted: float | None) -> str:
    return "-" if predicted is None else f"{predicted:.3f}"


def _title(name: str) -> str:
    """Return the title of a baseline in tables."""
    candidate = named(name)
    if candidate is None:
        return {"all-terms": "conventional (all)", WITHOUT_BLUNDERS: "without blunders"}.get(
            name, name)
    return candidate.label


def _certificate(certificate: Mapping[str, Any], exact: str) -> str:
    decided = f"{amount(certificate['subsets'], 'subset')} decided"
    proven = f"{decided}, {certificate['space']}"
    _, _, limit = certificate["space"].partition("selections of ")
    capped = f" of {limit}" if limit else ""
    if "claimed_by" in certificate and certificate["optimal"]:
        return (f"{certificate['claimed_by']} claims that no selection has a better criterion "
                f"({proven}); termsel has not proven it")
    if certificate["optimal"]:
        how = [decided]
        if certificate.get("bounded"):
            how.append(f"{amount(certificate['bounded'])} of them by bounds")
        return (f"Proven: no selection{capped} has a better criterion "
                f"({', '.join(how if limit else [*how, certificate['space']])})")
    if "optimum" in certificate:
        if certificate.get("gap") is None:
            return (f"The proven optimum is {certificate['optimum']:.4g}, below this ({proven}); "
                    f"{exact} finds it")
        return (f"Gap: {percent(certificate['gap'])} above the proven optimum "
                f"{certificate['optimum']:.4g} ({proven}); {exact} finds it")
    if not certificate.get("feasible", True):
        return f"Proven: no selection{capped} is feasible ({decided if limit else proven})"
    done = f"{amount(certificate['subsets'])} of {amount(certificate['of'], 'subset')} decided"
    if certificate.get("gap") is not None:
        return (f"Not proven: at most {percent(certificate['gap'])} above the optimum{capped}, "
                f"which is {certificate['bound']:.4g} or more ({done})")
    return f"Not proven: {done}" + (
        "; no lower bound is known yet" if certificate.get("bound") == 0 else "")


def _share(chosen: int, offered: int) -> str:
    return f"all {offered}" if chosen == offered else f"{chosen} of {offered}"


def _table(record: Record) -> Iterator[str]:
    yield f"{'RMSE [px]':<24}{'terms':>6}{'control':>12}{'check':>12}{'independent':>14}"
    strategy, baselines = record["strategy"], record["baselines"]
    rows = [("selection" + " *" * bool(strategy), record["selection"]["n_terms"], record["rmse"])]
    rows += [(_title(b["name"]) + " *" * ("check" in b["fitted_to"]), b["n_terms"],
              b["rmse"]) for b in baselines]
    for name, n_terms, rmse in rows:
        control, check, independent = (_figure(rmse[role]) for role in ROLES)
        yield f"{name:<24}{n_terms:>6}{control:>12}{check:>12}{independent:>14}"
        if LEAVE_ONE_OUT in rmse:
            yield f"{'  ' + LEAVE_ONE_OUT:<30}{_figure(rmse[LEAVE_ONE_OUT]):>12}"
    if LEAVE_ONE_OUT in record["rmse"]:
        yield (f"{LEAVE_ONE_OUT}: each control feature by the fit without it, as "
               f"{record['model']} corrects by control")
    if any("check" in b["fitted_to"] for b in baselines):
        yield "* fitted to control and check together; its check figure is a fit"
    if any(not any(one["n"] for one in b["rmse"].values()) for b in baselines):
        yield "- not determined with redundancy"
    if strategy:
        yield "independent = the accuracy"
    elif record["criterion"] == "check-rmse":
        yield "check = the fitness, which the search minimised; independent = the accuracy"
    else:
        yield f"the search minimised {record['criterion']}; independent = the accuracy"


def _front(record: Record) -> Iterator[str]:
    """Yield the front, or the best so far of each size, the recommended member marked."""
    by_size, selection = record.get("by_size", ()), record["selection"]  # not in older records
    front = [one for one in by_size if one["better"]] or record["front"]
    if not front:
        return
    names = list(front[0]["objectives"])
    yield ("Front: " + "".join(f"{name:>16}" for name in names) + f"{'independent':>14}"
           + f"   {sizes.TITLE}" * bool(by_size))
    if len(front) > _LONGEST_FRONT:
        yield f"       {len(front)} members; result.json lists all of them"
    for member in front if len(front) <= _LONGEST_FRONT else ():
        total = member["rmse"]["independent"]["total"]
        chosen = all(member["selection"][key] == selection[key] for key in ("terms", "features"))
        yield ("    -> " if chosen else " " * 7) + "".join(
            f"{member['objectives'][name]:>16.5g}" for name in names
        ) + f"{'-' if total is None else f'{total:.3f}':>14}" + (
            f"   {sizes.proven(member)}" if by_size else "")
    rule = record["options"]["problem"].get("recommend")
    if rule and (len(record["objectives"]) > 1 or rule != "best"):
        yield f"-> the selection, recommended by the rule {rule} (--set recommend=...)"
    if by_size:
        for line in sizes.others(by_size, names[1]):
            yield from textwrap.wrap(line, _WIDTH)
    yield ""


def _accuracy(record: Record) -> Iterator[str]:
    """Yield the accuracy on independent points, by standards, and as it was predicted."""
    accuracy, predicted = record.get("accuracy"), record.get("predicted")  # not in older records
    if accuracy:
        image, ground = accuracy["image"], accuracy["ground"]
        yield f"{'Independent points':<24}{'RMSE':>10}{'maximum':>10}{'CE90':>10}"
        yield _distances("in the image", image, "px", "line", "sample")
        if ground:
            yield _distances("on the ground", ground, "m", "x", "y")
        for key, title, meaning in (
                ("nssda", "NSSDA", "at 95 % confidence"),
                ("asprs", "ASPRS 2024", "RMSE, without the error of the survey itself")):
            one = accuracy[key]
            yield (f"{title}: {one['value']:.3g} m {meaning}" if one["value"] is not None else
                   f"{title}: no figure ({one['reason']})")
    if predicted:
        of = (f"of {counted(predicted['points'], 'independent point')}" if predicted["points"]
              else "of any further points")
        yield (f"Predicted RMSE {of}: {predicted['rmse']:.3g} px; "
               f"{100 * predicted['level']:.0f} % interval {predicted['low']:.3g} to "
               f"{predicted['high']:.3g} px")
    if record.get("final"):
        what = "features" if record["data"]["counts"]["lines"] else "points"
        yield (f"Exported: the same structure fitted to all {len(record['final']['features'])} "
               f"{what}; --no-final exports this fit")
    if accuracy or predicted:
        yield ""


def _distances(title: str, one: Record, unit: str, *axes: str) -> str:
    cells = "".join(f"{one[key]:>10.3g}" for key in ("total", "maximum", "ce90"))
    parts = ", ".join(f"{axis} {one[axis]:.3g}" for axis in axes)
    return f"{f'  {title} [{unit}]':<24}{cells}   {parts}"


def _figure(rmse: Record) -> str:
    total = rmse["total"]
    if total is None:
        return "-"
    return f"{total:.3f}" if 0.01 <= total < 1e5 else f"{total:.2e}"


def _foot(record: Record) -> Iterator[str]:
    yield from textwrap.wrap(record["judgement"], _WIDTH)
    for note in record["notes"]:
        yield from textwrap.wrap(note, _WIDTH, initial_indent="Note: ", subsequent_indent="      ")
    yield from _doubts(record["doubts"])
    yield from _coefficients(record)
    terms, features = _offered(record)
    selection = record["selection"]
    if selection["n_features"] < features and not record["strategy"]:
        yield from _names("Features", selection["features"])
    if selection["n_terms"] < terms:
        yield from _names("Terms", selection["terms"])


def _doubts(doubts: Record | None) -> Iterator[str]:
    """Yield which features are probable blunders."""
    if doubts is None:
        return
    wrong, in_use, spare = doubts["wrong"], doubts["in_use"], doubts["spare"]
    if wrong:
        title = f"Probable blunders (beyond {BEYOND:g} sigma, {BEYOND * doubts['sigma']:.2g} px)"
        yield from _names(title, (
            f"{name} ({wrong[name]:.1f} px{', in use' * (name in in_use)})"
            for name in sorted(wrong, key=lambda name: -wrong[name])))
    if in_use:
        yield f"  leave out those in use by --off {','.join(in_use)} and run again"
    if spare:
        yield f"Left out though they fit: {len(spare)}; they were not needed"


def _coefficients(record: Record) -> Iterator[str]:
    """Yield which terms are not significant, and how coefficients correlate."""
    weak = [name for name, one in record["significance"].items() if one["p"] > 0.05]
    if weak:
        yield from _names("Not significant (5 %)", weak)
    pairs = record["correlations"]
    if pairs:
        one, other = pairs[0]["terms"]
        yield (f"Correlations of coefficients of {CORRELATED} or more: {len(pairs)}, highest "
               f"{pairs[0]['correlation']:.4f} ({one}, {other})")


def _names(title: str, names: Iterable[str]) -> Iterator[str]:
    yield from textwrap.wrap(f"{title}: {' '.join(names)}", _WIDTH, subsequent_indent="  ",
                             break_on_hyphens=False)
