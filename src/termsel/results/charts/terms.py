"""Terms: their significance, how often they are selected, how their coefficients correlate."""

from __future__ import annotations

from collections import Counter
from typing import Any

from termsel.data.record.figures import SIGNIFICANT
from termsel.results.theme import (
    CHECK,
    CONTROL,
    FAINT,
    GROUND,
    INK,
    UNUSED,
    WIDTH,
    chart_rows,
    require_altair,
)
from termsel.results.view import Row, View

ROW = 15


def term_bars(view: View) -> Any:
    """Return the significance of each term in use, and its share of the front's members.

    A term is significant where |t|, its coefficient by its standard deviation, is beyond the
    dashed line. Terms that all members of a front share are there for a reason other than chance,
    so the share stands at the right edge.
    """
    alt = require_altair()
    rows = term_rows(view)
    kinds = [f"significant ({100 * SIGNIFICANT:.0f} %)", "not significant"]
    order = [row["term"] for row in rows]
    # t above the limit and p below the level are the same test.
    states = [{**row, "state": kinds[row["p"] > SIGNIFICANT]} for row in rows]
    base = alt.Chart(chart_rows(states)).encode(
        y=alt.Y("term:N", sort=order, title=None,
                axis=alt.Axis(ticks=False, domain=False, grid=True, labelLimit=170)))
    front = []
    if view.record.front:
        front = [alt.Tooltip("share:Q", title="share of the front", format=".0%")]
    shape = alt.Shape("state:N", scale=alt.Scale(domain=kinds, range=["circle", "diamond"]))
    title = ["|coefficient| / standard deviation, logarithmic"]
    if front:
        # The share has no axis: it is written at the right edge.
        title.append("At the right: share of the front's members")
    x = alt.X("t:Q", title=title,
              scale=alt.Scale(type="log", nice=False, padding=14))
    layers = [
        alt.Chart(chart_rows([{"t": view.record.adjustment.least_t}])).mark_rule(
            strokeDash=[5, 3], color=INK, strokeWidth=1.2).encode(x="t:Q"),
        base.mark_point(filled=True, size=75, opacity=1).encode(
            x=x, shape=shape, color=alt.Color("state:N", scale=alt.Scale(
                domain=kinds, range=[CONTROL, CHECK])),
            tooltip=[alt.Tooltip("term:N"), alt.Tooltip("t:Q", format=".3g"),
                     alt.Tooltip("p:Q", title="chance if it were zero", format=".2g"), *front])]
    if front:
        layers.append(base.mark_text(align="left", dx=6, fontSize=10, color=FAINT).encode(
            x=alt.value("width"), text=alt.Text("share:Q", format=".0%")))
    return alt.layer(*layers).properties(width=WIDTH, height=ROW * len(rows))


def term_rows(view: View) -> list[Row]:
    """Return the terms in use with t, p and their share of the front's members."""
    front = view.record.front
    rows: list[Row] = []
    for name, term in view.record.significance.items():
        share = None
        if front:
            share = sum(name in member.selection.terms for member in front) / len(front)
        # A logarithmic axis has no place for 0.
        rows.append({"term": name, "t": max(term.t, 1e-3), "p": term.p, "share": share})
    return sorted(rows, key=lambda row: -row["t"])


def frequency_bars(view: View) -> Any:
    """Return a chart of the share of selections that each term is in.

    The selections are the repeated ones of a test of stability, else the members of the front; the
    axis says which.
    """
    alt = require_altair()
    rows = frequency_rows(view)
    kinds = ["in this result", "not in this result"]
    base = alt.Chart(chart_rows([{**row, "state": kinds[not row["used"]]} for row in rows])).encode(
        y=alt.Y("term:N", sort=[row["term"] for row in rows], title=None,
                axis=alt.Axis(ticks=False, domain=False, labelLimit=170)))
    stability = view.record.stability
    if stability:
        selections = f"{stability.repeats} selections"
    else:
        selections = f"{len(view.record.front)} members of the front"
    # Bars leave a gap between the terms.
    layers = [base.mark_bar(height={"band": 0.72}).encode(
        x=alt.X("share:Q", title=f"share of the {selections}", axis=alt.Axis(format="%"),
                scale=alt.Scale(domain=[0, 1])),
        color=alt.Color("state:N", scale=alt.Scale(domain=kinds, range=[CONTROL, UNUSED])),
        tooltip=[alt.Tooltip("term:N"), alt.Tooltip("share:Q", format=".0%"),
                 alt.Tooltip("state:N", title="it is")])]
    if stability:
        layers.append(alt.Chart(chart_rows([{"share": stability.threshold}])).mark_rule(
            strokeDash=[5, 3], color=INK, strokeWidth=1.2).encode(x="share:Q"))
    return alt.layer(*layers).properties(width=WIDTH, height=ROW * len(rows))


def frequency_rows(view: View) -> list[Row]:
    """Return the terms of the selections, with the share of selections that each is in.

    The most frequent terms come first. The selections are the repeated ones of a test of stability,
    else the members of the front.
    """
    record = view.record
    used = set(record.selection.terms)
    if record.stability:
        shares = dict(record.stability.frequency)
    else:
        counts = Counter(term for member in record.front for term in member.selection.terms)
        shares = {term: n / len(record.front) for term, n in counts.items()}
    return sorted(({"term": term, "share": round(share, 4), "used": term in used}
                   for term, share in shares.items() if share), key=lambda row: -row["share"])


def why_no_frequencies(view: View) -> str:
    """Return why a result does not show how often terms are selected; "" if it does."""
    if view.record.stability:
        return ""
    # The same terms in all members would be bars of full length that say nothing.
    members = {tuple(member.selection.terms) for member in view.record.front}
    if len(members) > 1:
        return ""
    if members:
        return "all members of its front have the same terms"
    return "it is one selection, without a front and not of termsel stability"


def correlation_map(view: View) -> Any:
    """Return a chart of the correlations of the coefficients of the terms in use, as a matrix.

    Orange and purple are strong correlations of either sign: the terms say nearly the same of the
    control, so that their coefficients are uncertain though their sum is not.
    """
    alt = require_altair()
    names = list(view.record.coefficients)
    rows = [{**row, "correlation": float(f"{row['correlation']:.3f}")}
            for row in view.correlations]
    # As many pixels as there are terms, within what a page is wide.
    width = min(max(13 * len(names), 200), WIDTH)
    labels = alt.Axis(labelFontSize=min(11, max(6, width / len(names) - 2)), ticks=False,
                      domain=False, grid=False, labelLimit=120)
    return (
        alt.Chart(chart_rows(rows))
        .mark_rect(stroke=GROUND, strokeWidth=0.4)
        .encode(
            x=alt.X(
                "other:N",
                sort=names,
                title=None,
                axis=alt.Axis(**{**labels.to_dict(), "labelAngle": -90}),
            ),
            y=alt.Y("one:N", sort=names, title=None, axis=labels),
            color=alt.Color(
                "correlation:Q",
                scale=alt.Scale(scheme="purpleorange", domain=[-1, 1], domainMid=0),
                legend=alt.Legend(gradientLength=180, title="correlation"),
            ),
            tooltip=[
                alt.Tooltip("one:N", title="term"),
                alt.Tooltip("other:N", title="and term"),
                alt.Tooltip("correlation:Q", format=".3f"),
            ],
        )
        .properties(width=width, height=width)
    )
