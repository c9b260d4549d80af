"""The search: its front, the members of that, and how it converged."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from termsel.data.record.search import HistoryRow
from termsel.results.charts.maps import image_map
from termsel.results.sizes import noun_of_members, recommended_member, size_of
from termsel.results.theme import (
    CHECK,
    CONTROL,
    EDGE,
    FAINT,
    GROUND,
    INDEPENDENT,
    INK,
    WIDTH,
    chart_rows,
    require_altair,
    role_legend,
    spread_scale,
)
from termsel.results.verdict import CRITERIA_IN_WORDS, criterion_in_words
from termsel.results.view import Row, View

MAX_GENERATIONS_SHOWN = 400
"""Generations that a chart shows: of a longer search, those evenly spaced."""
AREAS = 4000
"""Most corners of the areas of empires."""


def front_chart(view: View) -> Any:
    """Return a chart of the front: RMSE at selection and independent check points against size.

    The size is the number of terms or features. Each member of the front is one selection, its size
    along x. The recommended one has a ring. A click on a member shows its selection in the other
    charts of the page.
    """
    alt = require_altair()
    rows = front_rows(view)
    # The axis of sizes has whole numbers only.
    size = noun_of_members(view.record.front)
    member = member_choice(view)
    scale, kind = spread_scale([row["rmse"] for row in rows], zero=False)
    base = alt.Chart(chart_rows(rows)).encode(
        x=alt.X("size:Q", title=size, scale=alt.Scale(zero=False, padding=14),
                axis=alt.Axis(tickMinStep=1, format="d")),
        y=alt.Y("rmse:Q", title=f"RMSE [px]{kind}", scale=scale))
    kinds = ["check", "independent"]
    colour = alt.Color("points:N", scale=alt.Scale(domain=kinds, range=[CHECK, INDEPENDENT]),
                       legend=role_legend())
    shape = alt.Shape("points:N", scale=alt.Scale(domain=kinds, range=["square", "triangle-up"]),
                      legend=role_legend())
    return alt.layer(
        base.mark_line(strokeWidth=1.4, opacity=0.7).encode(color=colour),
        base.transform_filter("datum.recommended").mark_point(
            size=260, stroke=CONTROL, strokeWidth=2, filled=False, opacity=1, aria=False),
        base.mark_point(filled=True, size=75, opacity=1, cursor="pointer").encode(
            color=colour, shape=shape,
            stroke=alt.condition(member, alt.value(INK), alt.value(None)),
            strokeWidth=alt.condition(member, alt.value(3), alt.value(0)),
            tooltip=[alt.Tooltip("size:Q", title=size), alt.Tooltip("points:N"),
                     alt.Tooltip("rmse:Q", title="RMSE [px]", format=".3f")],
        ).add_params(member),
    ).properties(width=WIDTH, height=0.5 * WIDTH)


def member_residuals(view: View, image: str = "") -> Any:
    """Return the residuals of the member of the front that is chosen."""
    return image_map(view, image, view.members, member_choice(view))


def front_rows(view: View) -> list[Row]:
    """Return the RMSE of selection and independent check points of each member of the front.

    There is a row for each member and role of which the RMSE is known.
    """
    recommended = _recommended_row(view)
    rows: list[Row] = []
    for i, member in enumerate(view.record.front):
        for role in ("check", "independent"):
            rmse = member.rmse.by_role[role].total
            if rmse:
                rows.append({"member": i, "size": member.objectives[size_of(member)],
                             "points": role, "rmse": rmse, "recommended": i == recommended})
    return rows


def member_choice(view: View) -> Any:
    """Return the choice of a member, at first the recommended one."""
    # There is always one member chosen, so that the map below is never empty.
    return require_altair().selection_point(
        name="member", fields=["member"], value=[{"member": _recommended_row(view)}], clear=False,
        toggle=False, empty=False)


def _recommended_row(view: View) -> int:
    """Return the number of the recommended member of the front; 0 without one."""
    return recommended_member(view.record.front, view.record.selection) or 0


def convergence_chart(view: View) -> Any:
    """Return a chart of the population's best and median, and of its infeasible share.

    Values have a logarithmic scale where they span powers of ten. The grey area is the share of the
    population that breaks a condition, on a scale of its own. It is drawn in steps, as nothing is
    known between generations.
    """
    alt = require_altair()
    history = evenly_spaced(view.record.history, MAX_GENERATIONS_SHOWN)
    criterion = view.record.criterion
    lines: list[Row] = []
    for generation in history:
        for statistic, value in (("best", generation.best), ("median", generation.median)):
            if value is not None:
                lines.append({"evaluations": generation.evaluations, "what": statistic,
                              "value": value})
    share = [{"evaluations": generation.evaluations, "infeasible": 1.0 - generation.feasible}
             for generation in history]
    # Criteria differ by powers of ten in the course of a search.
    scale, kind = spread_scale([row["value"] for row in lines], zero=False)
    x = alt.X("evaluations:Q", axis=alt.Axis(format=",d", tickCount=6))
    colour = alt.Color("what:N", scale=alt.Scale(domain=["best", "median"],
                                                 range=[CONTROL, CHECK]))
    area = alt.Chart(chart_rows(share)).mark_area(
        color=EDGE, opacity=0.45, interpolate="step-after").encode(
        x=x, y=alt.Y("infeasible:Q", title="infeasible share of the population",
                     scale=alt.Scale(domain=[0, 1]),
                     axis=alt.Axis(format="%", orient="right", grid=False, titleColor=FAINT)))
    curves = alt.Chart(chart_rows(lines)).mark_line(
        strokeWidth=2, interpolate="step-after").encode(
        x=x, color=colour, strokeDash=alt.StrokeDash("what:N", scale=alt.Scale(
            domain=["best", "median"], range=[[1, 0], [5, 3]])),
        y=alt.Y("value:Q", title=f"{with_unit(criterion)}{kind}", scale=scale),
        tooltip=[alt.Tooltip("evaluations:Q", format=",d"),
                 alt.Tooltip("what:N", title="of the population"),
                 alt.Tooltip("value:Q", title=with_unit(criterion), format=".4g")])
    # Both axes have scales of their own, as a share and an RMSE have nothing in common.
    return alt.layer(area, curves).resolve_scale(y="independent").properties(
        width=WIDTH, height=0.45 * WIDTH)


def refinement_remark(view: View) -> str:
    """Return a sentence on the evaluations that follow a search in its local refinement.

    Returns "" if the search had no refinement.
    """
    refinement = view.record.polish
    if refinement is None or not refinement.evaluations:
        return ""
    searched = view.record.evaluations - refinement.evaluations
    return (f"The search ended after {searched:,} evaluations; the local refinement used "
            f"{refinement.evaluations:,} more, which are not drawn.")


def empires_chart(view: View) -> Any:
    """Return how many countries each empire of the ICA has, as bands of the population.

    An empire of the imperialist competition loses its weakest country to another one, so that bands
    get thinner until one is left. Generations are thinned out, as a browser draws few thousand
    areas at once.
    """
    alt = require_altair()
    counted = [generation for generation in view.record.history if generation.empires]
    generations = max(AREAS // max(len(generation.empires) for generation in counted), 2)
    rows: list[Row] = []
    for generation in evenly_spaced(counted, generations):
        remaining = sum(map(bool, generation.empires))
        for i, countries in enumerate(generation.empires):
            rows.append({"evaluations": generation.evaluations, "empire": i + 1,
                         "countries": countries, "left": remaining})
    return alt.Chart(chart_rows(rows)).mark_area(stroke=GROUND, strokeWidth=1, opacity=1).encode(
        x=alt.X("evaluations:Q", axis=alt.Axis(format=",d", tickCount=6)),
        y=alt.Y("countries:Q", stack="zero", title="countries in the population"),
        order="empire:O",
        color=alt.Color("empire:Q", scale=alt.Scale(scheme="viridis", reverse=True),
                        legend=alt.Legend(title="empire, by its strength at first", tickMinStep=1,
                                          format="d", gradientLength=220)),
        detail="empire:O",
        tooltip=[alt.Tooltip("empire:Q"), alt.Tooltip("countries:Q"),
                 alt.Tooltip("left:Q", title="empires left"),
                 alt.Tooltip("evaluations:Q", format=",d")],
    ).properties(width=WIDTH, height=0.35 * WIDTH)


def with_unit(criterion: str) -> str:
    """Return what a criterion is called on the axis of a chart, with its unit where it has one."""
    words = criterion_in_words(criterion)
    return f"{words} [px]" if criterion in CRITERIA_IN_WORDS else words


def evenly_spaced(history: Sequence[HistoryRow], limit: int) -> list[HistoryRow]:
    """Return evenly spaced generations, the first and the last among them.

    Parameters
    ----------
    history : sequence of HistoryRow
        A row for each generation.
    limit : int
        How many, at least 2.
    """
    if len(history) <= limit:
        return list(history)
    # i (n - 1) / (m - 1) for i from 0 to m - 1, which holds 0 and n - 1.
    return [history[round(i * (len(history) - 1) / (limit - 1))] for i in range(limit)]
