"""Comparisons: features by residual, fits by RMSE, candidates by predicted RMSE."""

from __future__ import annotations

from typing import Any

import numpy as np

from termsel.core.errors import rounded_size_text
from termsel.results.theme import (
    BLUNDER,
    CONTROL,
    FAINT,
    GROUND,
    INK,
    ROLE_COLOURS,
    ROLE_SHAPES,
    UNUSED,
    WIDTH,
    chart_rows,
    legend_of,
    require_altair,
    role_legend,
    spread_scale,
)
from termsel.results.verdict import CERTAINTY, THIS, fits_of, label_of
from termsel.results.view import Row, View

WORST = 25
"""Features that the chart of the worst residuals shows."""
ROW = 18
"""Height of a row [px of the screen]."""
HOPELESS_RATIO = 30.0
"""Times the median RMSE of all fits, beyond which one is left out of their chart."""
FLATTENED = 12.0
"""Times the median bar; a longer one would flatten the others, and is broken."""


def bars_of_worst(view: View) -> Any:
    """Return a chart of the largest residuals as bars, the largest first.

    Each has the colour of its role and the label of its blunder test. A bar longer than the axis,
    which ends where most residuals do, ends in two strokes with its length beside it, as one
    blunder would make all others invisible. A click marks the feature in the other charts, too.
    """
    alt = require_altair()
    end = axis_end(view)
    rows = []
    for row in view.worst[:WORST]:
        is_broken = row["distance"] > end
        words = [f"{rounded_size_text(row['distance'])} px"] if is_broken else []
        if row["blunder"]:
            words.append(CERTAINTY[row["blunder"]])
        rows.append({**row, "end": min(row["distance"], end), "broken": is_broken,
                     "label": ", ".join(words)})
    # One choice for all charts of a page: what is picked in one is marked in the others.
    picked = alt.selection_point(name="picked", fields=["id"], empty=False)
    base = alt.Chart(chart_rows(rows)).encode(
        y=alt.Y("id:N", sort=[row["id"] for row in rows], title=None, axis=alt.Axis(
            labelLimit=120, ticks=False, domain=False)))
    roles = {row["role"] for row in rows}
    x = alt.X("end:Q", title="residual [px]", scale=alt.Scale(
        # Without an end Vega chooses one.
        domain=[0, end], nice=False) if np.isfinite(end) else alt.Undefined)
    bars = base.mark_bar(cursor="pointer", height={"band": 0.72}).encode(
        x=x, color=alt.Color("role:N", scale=legend_of(ROLE_COLOURS, roles),
                             legend=role_legend()),
        stroke=alt.condition(picked, alt.value(INK), alt.value(None)),
        strokeWidth=alt.condition(picked, alt.value(2.5), alt.value(0)),
        tooltip=[alt.Tooltip("id:N"), alt.Tooltip("role:N"),
                 alt.Tooltip("distance:Q", title="residual [px]", format=".3g")],
    ).add_params(picked)
    layers = [bars]
    if any(row["broken"] for row in rows):
        layers.append(base.transform_filter("datum.broken").mark_text(
            text="//", fontSize=17, fontWeight="bold", color=GROUND, dx=-26, aria=False,
        ).encode(x=x))
    if any(row["label"] for row in rows):
        # The label of a blunder has its colour, as the bar has that of its role.
        layers.append(base.mark_text(
            align="left", dx=5, fontSize=10.5, fontWeight=600, aria=False).encode(
                x=x, text="label:N", color=alt.condition(
                    "datum.blunder", alt.value(BLUNDER), alt.value(INK))))
    return alt.layer(*layers).properties(width=WIDTH, height=ROW * len(rows))


def axis_end(view: View) -> float:
    """Return where bars of the worst residuals are broken [px]; infinite where none need be."""
    distances = [row["distance"] for row in view.worst[:WORST]]
    # A bar of more than FLATTENED medians would press the others flat.
    high = FLATTENED * float(np.median(distances)) if distances else 0.0
    longest_whole = max((distance for distance in distances if distance <= high), default=0.0)
    return 1.3 * longest_whole if distances and max(distances) > high > 0 else float("inf")


def caption_on_breaks(view: View) -> str:
    """Return a caption on bars with a break, and on those of rejected features; "" without either.
    """
    sentences = []
    if np.isfinite(axis_end(view)):
        sentences.append(
            "Bars with a break are longer than the axis; their length is written beside them.")
    # Two tests of the same points have two errors: without and with the point in the fit.
    if any(row["role"] == "rejected" for row in view.worst[:WORST]):
        sentences.append("Residuals of rejected outliers are from the final fit; the outlier test "
                         "compared them with predictions by the others, so its sizes differ.")
    return " ".join(sentences)


def baseline_bars(view: View) -> Any:
    """Return a chart of the RMSE [px] of this result and of the fits without a search.

    This result stands first, then the others by their RMSE, with a symbol for each role and its 90
    % interval. Hollow symbols are points that the fit was made with, which say nothing of its
    accuracy. Fits that failed are left out (see `rows_of_fits`). The chart is a LayerChart of
    altair. Raises TermselError if altair is not installed.
    """
    alt = require_altair()
    rows, _ = rows_of_fits(view)
    roles = {row["role"]: ROLE_COLOURS[row["role"]] for row in rows}
    order = [THIS, *sorted({row["fit"] for row in rows} - {THIS}, key=_rmse_of(rows).__getitem__)]
    scale, kind = spread_scale([row["rmse"] for row in rows], zero=True)
    x = alt.X("rmse:Q", title=f"RMSE [px], with 90 % interval{kind}", scale=scale)
    colours = alt.Scale(domain=list(roles), range=list(roles.values()))
    base = alt.Chart(chart_rows(rows)).encode(
        y=alt.Y("fit:N", sort=order, title=None, axis=alt.Axis(
            ticks=False, domain=False, grid=True, labelLimit=160, labelFontWeight=alt.condition(
                f"datum.value == '{THIS}'", alt.value("bold"), alt.value("normal")))),
        yOffset=alt.YOffset("role:N", sort=list(roles)),
        color=alt.Color("role:N", scale=colours, legend=role_legend()))
    selected_fit = alt.selection_point(name="fit", fields=["fit"], empty=False)
    tooltip = [alt.Tooltip("fit:N"), alt.Tooltip("role:N", title="points"),
               alt.Tooltip("rmse:Q", title="RMSE [px]", format=".3f"),
               alt.Tooltip("low:Q", format=".3f"), alt.Tooltip("high:Q", format=".3f"),
               alt.Tooltip("note:N", title="selection points")]
    shape = alt.Shape("role:N", scale=alt.Scale(
        domain=list(roles), range=[ROLE_SHAPES[role] for role in roles]), legend=role_legend())
    # The interval below the symbol, so that it can be picked.
    return alt.layer(
        base.mark_rule(strokeWidth=2.2, opacity=0.65).encode(x=x, x2="high:Q").transform_calculate(
            rmse="datum.low"),
        base.mark_point(opacity=1, strokeWidth=1.8, cursor="pointer").encode(
            x=x, shape=shape, tooltip=tooltip, fill=alt.condition(
                "datum.note == 'fitted'", alt.value(GROUND),
                alt.Fill("role:N", scale=colours, legend=role_legend())),
            size=alt.condition(selected_fit, alt.value(150), alt.value(62)),
        ).add_params(selected_fit),
    ).properties(width=WIDTH, height=1.55 * ROW * len(order))


def rows_of_fits(view: View) -> tuple[list[Row], dict[str, float]]:
    """Return the rows of the chart of all fits, and the RMSE [px] of fits that it leaves out.

    Left out are other fits than this result whose RMSE exceeds HOPELESS_RATIO times the median: one
    fit that failed would stretch the axis over many powers of ten.
    """
    rows = fit_rows(view)
    errors = _rmse_of(rows)
    highest = HOPELESS_RATIO * float(np.median(list(errors.values())))
    failed = {fit: error for fit, error in errors.items() if error > highest and fit != THIS}
    return [row for row in rows if row["fit"] not in failed], failed


def _rmse_of(rows: list[Row]) -> dict[str, float]:
    """Return the RMSE [px] of each fit: at independent check points if it has one there."""
    of_check = {row["fit"]: row["rmse"] for row in rows if row["role"] == "check"}
    # Independent points win where a fit has both.
    return of_check | {row["fit"]: row["rmse"] for row in rows if row["role"] == "independent"}


def caption_on_others(view: View) -> str:
    """Return a caption on hollow symbols in the chart of all fits, and on fits that it leaves out.

    Returns "" if the chart has neither.
    """
    rows, failed = rows_of_fits(view)
    sentences = []
    if any(row["note"] == "fitted" for row in rows):
        sentences.append("Hollow symbols: the fit used these selection points.")
    if failed:
        named = ", ".join(f"{fit} ({error:,.3g} px)" for fit, error in failed.items())
        sentences.append(f"Not shown, as the axis would be too long: {named}.")
    return " ".join(sentences)


def candidate_bars(view: View) -> Any:
    """Return a chart of the strategy auto's candidates, with their leave-one-out RMSE.

    The best is on top. Candidates without such an RMSE are left out. The record must have a
    strategy.
    """
    alt = require_altair()
    strategy = view.record.strategy
    assert strategy is not None
    rows: list[Row] = [
        {"fit": label_of(model.name), "rmse": model.predicted, "terms": model.n_terms,
         "effective": float(f"{model.effective:.4g}"),
         "state": "chosen" if model.name == strategy.chosen else "other model"}
        for model in strategy.candidates if model.predicted is not None]
    # Logarithmic where the worst is far off: the best ones would look alike.
    scale, kind = spread_scale([row["rmse"] for row in rows], zero=True)
    order = [row["fit"] for row in sorted(rows, key=lambda row: row["rmse"])]
    colour = alt.Color("state:N", scale=alt.Scale(domain=["chosen", "other model"],
                                                  range=[CONTROL, UNUSED]))
    base = alt.Chart(chart_rows(rows)).encode(
        y=alt.Y("fit:N", sort=order, title=None, axis=alt.Axis(
            ticks=False, domain=False, grid=True, labelLimit=160)),
        x=alt.X("rmse:Q", title=f"leave-one-out RMSE [px]{kind}", scale=scale))
    return alt.layer(
        base.mark_point(filled=True, size=90, opacity=1).encode(
            color=colour, tooltip=[
                alt.Tooltip("fit:N", title="model"), alt.Tooltip("terms:Q"),
                alt.Tooltip("effective:Q", title="effective parameters"),
                alt.Tooltip("rmse:Q", title="leave-one-out RMSE [px]", format=".3f")]),
        base.mark_text(align="left", dx=9, fontSize=10.5, color=FAINT).encode(
            text=alt.Text("rmse:Q", format=".3f")),
    ).properties(width=WIDTH, height=1.2 * ROW * len(rows))


def fit_rows(view: View) -> list[Row]:
    """Return the RMSE of selection and independent check points of this result and all other fits.

    There is a row, with its 90 % interval, for each fit and role of which an interval is known.
    """
    rows = []
    for name, fitted, _, rmse in fits_of(view.record):
        for role in ("check", "independent"):
            of_role = rmse.by_role[role]
            if of_role.interval:
                low, high = of_role.interval
                # A fit's own points say little; a hollow symbol shows them.
                note = "fitted" if role == "check" and fitted else "judged"
                rows.append({"fit": name, "role": role, "rmse": of_role.total, "low": low,
                             "high": high, "note": note})
    return rows
