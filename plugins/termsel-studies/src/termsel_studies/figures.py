"""Charts of a study: running times, convergence, ranks and performance profiles."""

from __future__ import annotations

import math
from itertools import chain
from typing import Any

import numpy as np

from termsel import Study
from termsel.toolkit.charts import (
    CONTROL,
    FAINT,
    INK,
    METHODS,
    WIDTH,
    Figure,
    chart_rows,
    require_altair,
    spread_scale,
    with_unit,
)
from termsel_studies.groups import Groups, evaluations_of_run, group
from termsel_studies.significance import (
    Comparison,
    compare_methods,
    medians_of,
    performance_profile,
)
from termsel_studies.summaries import (
    effort_to_target,
    optimum_of,
    quartiles_by_budget,
    success_curve,
    targets_of,
)

CHARTS = ("ecdf-evaluations", "ecdf-cpu-seconds", "convergence", "performance-profile",
          "critical-difference")
"""Names of all charts that a study may have, as their files have them."""

_DASHES = ([1, 0], [6, 3], [2, 2])

_MOST_PANELS = 12
"""Instances whose convergence is drawn: more are too small to be read."""

_BUDGETS_DRAWN = 60
"""Budgets at which convergence is drawn."""


def figures_of(study: Study) -> list[Figure]:
    """Return the charts that the runs of a study allow; [] if it ran the strategy auto alone.

    Running times and convergence require traces, a performance profile at least two instances and
    two methods, and mean ranks a test that compares the methods.
    """
    # auto searches nothing, so that it has neither evaluations nor a convergence.
    if study.spec.strategies == ("auto",):
        return []
    groups = group(study.rows, study.records, study.spec.measure)
    # Without a trace nothing is known of the time that a run took to its best value.
    figures = []
    if any(record.trace for record in groups.records()):
        figures += [
            running_time_chart(groups, 0), running_time_chart(groups, 2), convergence_chart(groups)]
    values = medians_of(groups)
    # Ratios to the best one require that it has a result, and that nothing is below zero.
    if (len(values) > 1 and len(groups.methods) > 1 and np.isfinite(values).any(axis=1).all()
            and (values >= 0).all()):
        figures.append(performance_profile_chart(groups))
    comparison = compare_methods(groups.methods, values)
    if comparison is not None and comparison.difference is not None:
        figures.append(critical_differences(comparison))
    return figures


def running_time_chart(groups: Groups, column: int) -> Figure:
    """Return the ECDF of evaluations (column 0 of traces) or CPU seconds (column 2) to targets.

    A method's curve is the share of its pairs of a run and a target, over all instances, in which
    the target was reached within a budget. Targets lie from 100 % to 0.01 % above the optimum, or
    above the best value of any method where no optimum is proven.
    """
    rows: list[dict[str, Any]] = []
    largest_budget = 0.0
    for method in groups.methods:
        hits = []
        for by_method in groups.instances.values():
            if method not in by_method:
                continue
            optimum = optimum_of(by_method.values(), groups.measure)
            for target in targets_of(optimum, by_method.values()):
                hits += [effort_to_target(record.trace, target, column)
                         for record in by_method[method].records]
        budgets, shares = success_curve(hits)
        # A logarithmic axis has no zero.
        rows += [{"method": method, "budget": max(budget, 1e-4), "share": share}
                 for budget, share in zip(budgets, shares, strict=True)]
        largest_budget = max([largest_budget, *budgets])
    # All curves go on to the same end, so that they can be compared there.
    smallest_budget = min((row["budget"] for row in rows), default=1.0)
    last_share = {row["method"]: row["share"] for row in rows}
    rows += [{"method": method, "budget": largest_budget, "share": share}
             for method, share in last_share.items()]
    # A method that reaches no target has a curve, too, at zero.
    rows += [{"method": method, "budget": budget, "share": 0.0} for method in groups.methods
             if method not in last_share for budget in (smallest_budget, largest_budget)]
    unit = "CPU seconds" if column else "evaluations, with local refinement"
    chart = _share_chart(rows, groups.methods, "budget:Q", unit,
                         "share of runs and targets reached")
    return Figure(
        "ecdf-cpu-seconds" if column else "ecdf-evaluations",
        f"Running times in {'CPU seconds' if column else 'evaluations'}",
        "Higher and further to the left is better. Targets lie 100 % to 0.01 % above the optimum, "
        "or the best value found.", chart)


def _share_chart(rows: list[dict[str, Any]], methods: tuple[str, ...], x_field: str, x_title: str,
                 y_title: str) -> Any:
    """Return a chart of the shares that methods reach, as steps over a logarithmic axis.

    Each row has its `method`, its `share` (0 to 1) and the field that `x_field` encodes, such as
    "budget:Q".
    """
    alt = require_altair()
    return alt.Chart(chart_rows(rows)).mark_line(interpolate="step-after").encode(
        x=alt.X(x_field, title=f"{x_title}, logarithmic", scale=alt.Scale(type="log", nice=False)),
        y=alt.Y("share:Q", title=y_title, scale=alt.Scale(domain=[0, 1]),
                axis=alt.Axis(format="%")),
        **_styles_by_method(methods)).properties(width=WIDTH, height=0.55 * WIDTH)


def convergence_chart(groups: Groups) -> Figure:
    """Return the chart of the best value by evaluations, with a panel for each instance.

    Lines are medians over the runs of a method, bands their quartiles. Instances beyond the first
    `_MOST_PANELS` are left out, and so are budgets at which more than a quarter of the runs has no
    feasible value yet.
    """
    alt = require_altair()
    rows: list[dict[str, Any]] = []
    for instance in list(groups.instances)[:_MOST_PANELS]:
        runs_of = groups.instances[instance]
        records = chain.from_iterable(runs.records for runs in runs_of.values())
        longest = max(evaluations_of_run(record.figures) for record in records)
        for method, runs in runs_of.items():
            traces = [record.trace for record in runs.records]
            first = min((trace[0][0] for trace in traces if trace), default=longest)
            # Budgets evenly in the logarithm: most improvements come early.
            budgets = np.unique(np.geomspace(max(first, 1), max(longest, first, 1),
                                             _BUDGETS_DRAWN).round())
            rows += [{"instance": instance, "method": method, "evaluations": budget, "low": low,
                      "median": median, "high": high}
                     for budget, low, median, high in quartiles_by_budget(traces, budgets.tolist())
                     if math.isfinite(high)]
    by_method = _styles_by_method(groups.methods)
    ends_of_bands = [row["low"] for row in rows] + [row["high"] for row in rows]
    scale, kind = spread_scale(ends_of_bands, zero=False)
    base = alt.Chart(chart_rows(rows)).encode(color=by_method["color"], x=alt.X(
        "evaluations:Q", title="evaluations, logarithmic",
        scale=alt.Scale(type="log", nice=False)))
    band = base.mark_area(opacity=0.18, interpolate="step-after").encode(
        y=alt.Y("low:Q", title=f"best {' or '.join(map(with_unit, groups.objectives))}{kind}",
                scale=scale), y2="high:Q")
    line = base.mark_line(interpolate="step-after").encode(
        y="median:Q", strokeDash=by_method["strokeDash"], strokeWidth=by_method["strokeWidth"])
    chart = alt.layer(band, line).properties(width=WIDTH / 2, height=0.3 * WIDTH).facet(
        facet=alt.Facet("instance:N", title=None), columns=2).resolve_scale(
            x="independent", y="independent")
    return Figure("convergence", "Convergence", "Medians as lines, quartiles as bands. Lines that "
                  "still fall at their end were given too few evaluations.", chart)


def performance_profile_chart(groups: Groups) -> Figure:
    """Return the chart of the performance profiles of the methods over the instances.

    A curve is the share of instances in which a method's median is within a ratio of the best.
    """
    values = medians_of(groups)
    ratios = np.geomspace(1, 10, 100)
    shares = performance_profile(values, ratios.tolist())
    rows = []
    for ratio, method_shares in zip(ratios, shares, strict=True):
        rows += [{"method": method, "ratio": float(ratio), "share": float(share)}
                 for method, share in zip(groups.methods, method_shares, strict=True)]
    chart = _share_chart(rows, groups.methods, "ratio:Q",
                         "ratio to the best median of the instance", "share of instances")
    return Figure("performance-profile", "Performance profile", "At the left end: how often a "
                  "method is the best. Further right: how often it is within that ratio of the "
                  "best.", chart)


def critical_differences(comparison: Comparison) -> Figure:
    """Return the chart of mean ranks, with bars over methods that cannot be distinguished.

    It is figure 1 of Demšar (2006): methods on one axis of mean ranks, with bars over those whose
    ranks differ by less than Nemenyi's critical difference, which `comparison` must have.
    """
    alt = require_altair()
    assert comparison.difference is not None
    order = np.argsort(comparison.ranks, kind="stable")
    names = [comparison.methods[i] for i in order]
    ranks = [comparison.ranks[i] for i in order]
    ends = runs_of_alike_ranks(ranks, comparison.difference)
    # The first rows are methods, with a line from rank 1; the rows below are bars.
    axis = alt.X("rank:Q", title="mean rank; 1 is best", scale=alt.Scale(
        domain=[1, len(names)], nice=False))
    row = alt.Y("row:O", axis=None, sort=None)
    points = [{"row": i, "rank": rank, "name": f"{name} ({rank:.2f})"}
              for i, (name, rank) in enumerate(zip(names, ranks, strict=True))]
    bars = [{"row": f"bar {i}", "rank": low, "to": high} for i, (low, high) in enumerate(ends)]
    base = alt.Chart(chart_rows(points)).encode(x=axis, y=row)
    layers = [
        base.mark_rule(color=FAINT, strokeDash=[2, 2]).encode(x2=alt.datum(1)),
        base.mark_point(filled=True, size=90, color=INK, opacity=1),
        base.mark_text(align="left", dx=9, color=INK, fontSize=11.5).encode(text="name:N")]
    if bars:
        layers.append(alt.Chart(chart_rows(bars)).mark_rule(strokeWidth=5, color=CONTROL).encode(
            x=axis, x2="to:Q", y=row))
    chart = alt.layer(*layers).properties(width=WIDTH, height=24 * (len(points) + len(bars) + 1))
    return Figure("critical-difference", f"Mean ranks over {comparison.instances} instances",
                  "Blue bars join methods that Nemenyi's test cannot distinguish: their ranks "
                  f"differ by less than {comparison.difference:.2f}.", chart)


def runs_of_alike_ranks(ranks: list[float], difference: float) -> list[tuple[float, float]]:
    """Return the first and last rank of each run of ranks that are not distinguished.

    `ranks` are sorted. The first and last rank of a run differ by less than `difference`; a run
    has two ranks or more, and is part of no longer one.
    """
    runs: list[tuple[float, float]] = []
    for i, low in enumerate(ranks):
        high = max(rank for rank in ranks[i:] if rank - low < difference)
        # A run that ends where the one before ends is a part of that.
        if ranks.index(high) > i and not (runs and high <= runs[-1][1]):
            runs.append((low, high))
    return runs


def _styles_by_method(methods: tuple[str, ...]) -> dict[str, Any]:
    """Return the encodings `color`, `strokeDash` and `strokeWidth` of altair for methods.

    Dashes change once all colours are used up. Each line is narrower than the one before, so that
    it does not hide one that has the same values.
    """
    alt = require_altair()
    number = len(METHODS)
    columns = alt.ExprRef("(containerSize()[0] || 560) < 480 ? 2 : 4")
    # altair joins the legends of the three encodings if they are equal.
    legend = alt.Legend(columns=columns, symbolType="stroke", symbolOpacity=1)
    widths = np.linspace(5.0, 1.6, len(methods)) if len(methods) > 1 else [2.0]
    return {
        "strokeWidth": alt.StrokeWidth(
            "method:O", sort=list(methods), legend=legend, scale=alt.Scale(
                domain=list(methods), range=[round(float(width), 2) for width in widths])),
        "color": alt.Color("method:N", legend=legend, scale=alt.Scale(
            domain=list(methods), range=[METHODS[i % number] for i in range(len(methods))])),
        "strokeDash": alt.StrokeDash("method:N", legend=legend, scale=alt.Scale(
            domain=list(methods), range=[_DASHES[i // number % len(_DASHES)]
                                         for i in range(len(methods))]))}
