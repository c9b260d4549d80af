"""The report of a result: six questions in the order in which they are asked."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from termsel.errors import counted
from termsel.fits.accuracy import rmse_interval
from termsel.report import sizes
from termsel.report.charts import bars, maps, search
from termsel.report.page import Block, Code, Figure, Section, Statement, Table, page
from termsel.report.plots import KINDS
from termsel.report.repeat import command, not_by_command
from termsel.report.tables import (
    convergence_table,
    correlation_table,
    frequency_table,
    sigma_table,
    term_table,
)
from termsel.report.view import View

MAPS = ("residuals", "ground", "sigma", "correlations")


def report(view: View, picture: str = "") -> str:
    """Return the report of a result as a page.

    Parameters
    ----------
    view : View
    picture : str
        The image, smaller, as a data URL.
    """
    record = view.record
    strategy = record["strategy"]
    by = f"strategy {strategy['name']}" if strategy else \
        f"solver {record['solver']}, criterion {record['criterion']}"
    return page(f"{record['data']['source']}: {record['problem']}",
                f"Model {record['model']}, {by}, seed {record['seed']}; termsel "
                f"{record['versions']['termsel']}", (
                    Section("How accurate is it?", tuple(_accuracy(view))),
                    Section("Is it better than plain structures?", tuple(_compared(view))),
                    Section("Which points or lines are bad?", tuple(_bad(view, picture))),
                    Section("Where is the model weak?", tuple(_weak(view))),
                    Section("What was selected, and why?", tuple(_selected(view, picture))),
                    Section("How is it repeated?", tuple(_repeated(view)))))


def _accuracy(view: View) -> Iterator[Block]:
    record = view.record
    yield Statement(statement(record))
    accuracy = record.get("accuracy")
    if accuracy:
        rows = [("in the image", *_distances(accuracy["image"], "px", "line", "sample"))]
        if accuracy["ground"]:
            rows.append(("on the ground", *_distances(accuracy["ground"], "m", "x", "y")))
        count = counted(accuracy["image"]["n"], "independent point")
        yield Table(f"{count}, which took no part in any choice",
                    ("", "RMSE", "line or x", "sample or y", "maximum", "CE90"), rows)
        for key, title in (("nssda", "NSSDA, horizontal accuracy at 95 % confidence"),
                           ("asprs", "ASPRS 2024, RMSE without the error of the survey")):
            one = accuracy[key]
            yield (f"{title}: {one['value']:.3g} m." if one["value"] is not None else
                   f"{title}: no figure ({one['reason']}).")
    if record.get("final"):
        yield (f"What is exported is the same structure fitted to all "
               f"{len(record['final']['features'])} features; these figures are those of the fit "
               "without the independent points.")


def statement(record: Mapping[str, Any]) -> str:
    """Return the accuracy as a statement that can be pasted.

    Parameters
    ----------
    record : mapping
        The content of result.json.
    """
    accuracy, predicted = record.get("accuracy"), record.get("predicted")
    if accuracy:
        image, ground = accuracy["image"], accuracy["ground"]
        low, high = rmse_interval(image["total"], image["n"]) if image["total"] \
            else (0.0, 0.0)
        metres = f", {ground['total']:.3g} m on the ground" if ground else ""
        return (f"RMSE {image['total']:.3g} px{metres} on "
                f"{counted(image['n'], 'independent point')} (90 % interval {low:.3g} to "
                f"{high:.3g} px).")
    if predicted:
        return (f"Predicted RMSE {predicted['rmse']:.3g} px ({100 * predicted['level']:.0f} % "
                f"interval {predicted['low']:.3g} to {predicted['high']:.3g} px), by "
                "leave-one-out; there are no independent points.")
    return ("The accuracy is not known: there are no independent points. Give some points the role "
            "independent.")


def _distances(one: dict[str, Any], unit: str, *axes: str) -> tuple[str, ...]:
    return tuple(f"{one[key]:.3g} {unit}" for key in ("total", *axes, "maximum", "ce90"))


def _compared(view: View) -> Iterator[Block]:
    yield view.record["judgement"]
    rows = bars.fit_rows(view)
    if not rows:
        return
    yield _figure("baselines", bars.baseline_bars(view))
    fits = dict.fromkeys(row["fit"] for row in rows)
    found = {(row["fit"], row["role"]): row for row in rows}
    yield Table("RMSE [px] of all fits, with 90 % intervals", (
        "fit", "check", "interval", "independent", "interval"), [
            (name, *_interval(found.get((name, "check"))),
             *_interval(found.get((name, "independent")))) for name in fits],
        choice="fit", keys=list(fits))
    if any(row["note"] == "fitted" for row in rows):
        yield ("A hollow symbol is a fit to the check points themselves; it says little about its "
               "accuracy.")


def _interval(row: dict[str, Any] | None) -> tuple[str, str]:
    return ("-", "-") if row is None else (
        f"{row['rmse']:.3f}", f"{row['low']:.3f} to {row['high']:.3f}")


def _bad(view: View, picture: str) -> Iterator[Block]:
    outliers = view.record.get("outliers", ())
    if outliers:
        named = "; ".join(f"{one['kind']} {one['id']}, {one['error']:.3g} px, "
                          + ("left out" if one["excluded"] else "in use") for one in outliers)
        yield f"{counted(len(outliers), 'probable blunder')}: {named}."
    else:
        yield "No feature is a probable blunder."
    yield _figure("worst", bars.worst_bars(view))
    yield _figure("residuals", maps.image_map(view, picture))
    rows = view.worst
    on_ground: dict[str, float] = {}
    for row in view.on_ground:
        if row["metres"] is not None:
            on_ground[row["id"]] = max(row["metres"], on_ground.get(row["id"], 0.0))
    yield Table("Residuals of all features, the largest first", (
        "feature", "kind", "role", "residual [px]", "on the ground [m]", "blunder"), [
            (row["id"], row["kind"], row["role"], f"{row['distance']:.3g}",
             f"{on_ground[row['id']]:.3g}" if row["id"] in on_ground else "-",
             "probable" if row["blunder"] else "") for row in rows],
        choice="picked", keys=[row["id"] for row in rows], folded=True)


def _weak(view: View) -> Iterator[Block]:
    if why := KINDS["sigma"].missing(view):
        yield f"The standard deviation is not known: {why}."
    else:
        yield _figure("sigma", maps.sigma_map(view))
    yield _figure("ground", maps.ground_map(view))
    if not why:
        yield sigma_table(view)
    yield "termsel plan names the places where further points help most."


def _selected(view: View, picture: str) -> Iterator[Block]:
    record = view.record
    strategy, selection, offered = record["strategy"], record["selection"], record["offered"]
    if strategy:
        yield f"Chosen: {bars.label_of(strategy['chosen'])}. {strategy.get('reason', '')}"
        yield _figure("candidates", bars.candidate_bars(view))
        yield Table("Candidates", ("candidate", "terms", "effective", "leave-one-out RMSE [px]"), [
            (bars.label_of(one["name"]), str(one["n_terms"]), f"{one['effective']:.1f}",
             "-" if one["predicted"] is None else f"{one['predicted']:.3f}")
            for one in strategy["candidates"]], folded=True)
    elif found := record.get("stability"):
        yield (f"{selection['n_terms']} of {offered['n_terms']} terms are in at least "
               f"{found['threshold']:.0%} of {found['repeats']} selections, each with other "
               "control and check points.")
    else:
        yield (f"{selection['n_terms']} of {offered['n_terms']} terms and "
               f"{selection['n_features']} of {offered['n_features']} control features, by "
               f"{counted(record['evaluations'], 'evaluation')} in {record['seconds']:.1f} s.")
    yield from record["notes"]
    if record["front"]:
        yield from _front(view, picture)
    if by_size := record.get("by_size"):  # not in older records
        yield from _by_size(by_size, folded=bool(record["front"]))
    there = [name for name in _OF_TERMS if not KINDS[name].missing(view)]
    yield from (_figure(name, KINDS[name].draw(view)) for name in there)
    yield from (table(view) for name in there if (table := _OF_TERMS[name]) is not None)
    if not strategy:
        yield Table("Selected features", ("feature",),
                    [(name,) for name in selection["features"]], folded=True)


_OF_TERMS = {"convergence": convergence_table, "empires": None, "frequency": frequency_table,
             "terms": term_table, "correlations": correlation_table}
"""Charts of search and terms, with their tables."""


def _front(view: View, picture: str) -> Iterator[Block]:
    front = view.record["front"]
    size = sizes.counted_by(front)
    yield _figure("front", search.front(view))
    yield Figure("members", "Residuals of the chosen member",
                 "Choose a member in the chart above or in the table below.",
                 search.members(view, picture), keeps_ratio=True)
    yield Table("Members of the front", (size, "check [px]", "independent [px]", "terms"), [
        (f"{one['objectives'][view.front_size]:g}", *(
            "-" if one["rmse"][role]["total"] is None else f"{one['rmse'][role]['total']:.3f}"
            for role in ("check", "independent")), " ".join(one["selection"]["terms"]))
        for one in front], choice="member", keys=list(range(len(front))))


def _by_size(by_size: Sequence[Mapping[str, Any]], folded: bool) -> Iterator[Block]:
    """Yield what a proof says of the best selection of each size."""
    size, criterion = list(by_size[0]["objectives"])[:2]
    names = size.removeprefix("n_")
    yield from sizes.others(by_size, criterion)
    yield Table("Best selection of each size", (
        sizes.counted_by(by_size), criterion, "lower bound", sizes.TITLE, "independent [px]",
        names), [
        (f"{one['objectives'][size]}", f"{one['objectives'][criterion]:.4g}",
         "-" if one["bound"] is None else f"{one['bound']:.4g}", sizes.proven(one),
         "-" if (total := one["rmse"]["independent"]["total"]) is None else f"{total:.3f}",
         " ".join(one["selection"][names])) for one in by_size], folded=folded)


def _repeated(view: View) -> Iterator[Block]:
    record = view.record
    if why := not_by_command(record):
        yield why
    else:
        yield "In the folder of this result:"
        yield Code(command(record) + " --out again")
    if record["interrupted"]:
        yield "This run was interrupted, and the command runs to its end."
    elif "seconds" in record["budget"]:
        yield ("The run had a limit of time, so the result depends on the machine. It took "
               f"{counted(record['evaluations'], 'evaluation')}.")
    if record.get("stability"):
        yield ("The frequencies of terms are those of termsel stability. The command repeats the "
               "fit of the stable terms.")
    yield Table("Versions", ("package", "version"), [
        *record["versions"].items(),
        *((part["name"], part["version"]) for part in record["plugins"].values()),
        ("system of this report", platform.system())])
    sums = [("data as read", record["data"]["sha256"]), *record["checksums"].items()]
    yield Table("Checksums (SHA-256)", ("of", "checksum"), sums, folded=True)


def _figure(name: str, chart: Any) -> Figure:
    kind = KINDS[name]
    return Figure(name, kind.title, kind.look, chart, name in MAPS)
