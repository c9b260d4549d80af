"""Draw the picture of the README from an actual run: python docs/picture.py

Left the control lines, the points and their residuals in the image, right the RMSE of the
selection next to fits without a search. Needs the extra `report`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import altair as alt
import numpy as np

from termsel.results.result import Result
from termsel.runs import run as running
from termsel.simulate import SCENES, scene_truth

SCENE = "ikonos-hamedan"
TARGET = Path(__file__).parent / "_static" / "owdis-lines.svg"
SIZE = SCENES[SCENE].image_size
WIDTH = 520
"""Of the image in the picture."""
EXAGGERATION = 250
"""Pixels of the image drawn for one pixel of residual."""
MARGIN = 350
"""Pixels drawn around the image, so that residuals at its edge have room."""

# An opaque pale ground, so that the picture reads alike on light and dark pages.
GROUND, INK, FAINT, EDGE = "#fcfcfa", "#24292f", "#6b7280", "#d0d4da"
USED, UNUSED, WRONG = "#0b7a75", "#b4b9c1", "#d1242f"
CHECK, INDEPENDENT = "#c77700", "#3b5bdb"

SELECTED, LEFT_OUT, WRONG_LINE = "selected", "left out", "wrong"
LINE_KINDS = {SELECTED: USED, LEFT_OUT: UNUSED, WRONG_LINE: WRONG}
POINT_KINDS = {"check": CHECK, "independent": INDEPENDENT}
SHAPE = alt.Shape("kind:N", legend=None,
                  scale=alt.Scale(domain=[*POINT_KINDS], range=["circle", "triangle-up"]))
RING = {"shape": "circle", "size": 200, "stroke": WRONG, "strokeWidth": 1.3, "opacity": 1,
        "filled": False}


def line_rows(result: Result, wrong: tuple[str, ...]) -> list[dict[str, Any]]:
    """Return the control lines with their fate."""
    lines = result.fit.control.lines
    rows = []
    for name, ((l1, s1), (l2, s2)) in zip(lines.ids, lines.image.tolist(), strict=True):
        kind = (WRONG_LINE if name in wrong else
                SELECTED if name in result.selection.features else LEFT_OUT)
        rows.append({"id": name, "kind": kind, "line": l1, "sample": s1, "line2": l2,
                     "sample2": s2})
    return rows


def point_rows(result: Result, task: running.Task) -> list[dict[str, Any]]:
    """Return check and independent points with their exaggerated residuals."""
    residual = {r.id: r for r in result.residuals if r.kind == "point"}
    rows = []
    for kind, points in (("check", task.observations.check),
                         ("independent", task.observations.independent)):
        for name, (line, sample) in zip(points.ids, points.image.tolist(), strict=True):
            r = residual[name]
            rows.append({"id": name, "kind": kind, "line": line, "sample": sample,
                         "line2": line + EXAGGERATION * r.line,
                         "sample2": sample + EXAGGERATION * r.sample})
    return rows


def bar_rows(result: Result) -> list[dict[str, Any]]:
    """Return the RMSE of independent points for each fit."""
    plain = {b.name: b.rmse["independent"].total for b in result.baselines
             if b.rmse["independent"]}
    bars = [
        (f"all {len(result.fit.control)} lines", plain["all-terms"], UNUSED),
        ("quadratic, plain", plain["quadratic"], UNUSED),
        (f"{len(result.selection.features)} selected lines", result.rmse["independent"].total,
         USED),
        ("noise of the points", float(result.data["noise"]) * float(np.sqrt(2)), "#e3e6ea")]
    return [{"fit": fit, "rmse": rmse, "colour": colour, "order": i}
            for i, (fit, rmse, colour) in enumerate(bars)]


def scene_chart(result: Result, task: running.Task, wrong: tuple[str, ...]) -> alt.LayerChart:
    """Return the image with lines, points and residuals."""
    n_lines, n_samples = SIZE
    x = alt.X("sample:Q", scale=alt.Scale(domain=[-MARGIN, n_samples + MARGIN], nice=False),
              axis=alt.Axis(title="sample [px]", values=[*range(0, n_samples + 1, 2000)],
                            grid=False))
    y = alt.Y("line:Q", scale=alt.Scale(domain=[n_lines + MARGIN, -MARGIN], nice=False),
              axis=alt.Axis(title="line [px]", values=[*range(0, n_lines + 1, 1000)],
                            grid=False))
    rows = line_rows(result, wrong)
    frame = alt.Chart(alt.Data(values=[
        {"line": 0, "sample": 0, "line2": n_lines, "sample2": n_samples}]))
    ends = {"x": x, "y": y, "x2": "sample2:Q", "y2": "line2:Q"}
    middle = [{"line": (row["line"] + row["line2"]) / 2,
               "sample": (row["sample"] + row["sample2"]) / 2}
              for row in rows if row["kind"] == WRONG_LINE]
    points = alt.Chart(alt.Data(values=point_rows(result, task)))
    return alt.layer(
        frame.mark_rect(fill=None, stroke=EDGE).encode(**ends),
        alt.Chart(alt.Data(values=rows)).mark_rule(strokeWidth=2.6, strokeCap="round").encode(
            color=_colour(LINE_KINDS), **ends),
        alt.Chart(alt.Data(values=middle)).mark_point(**RING).encode(x=x, y=y),
        points.mark_rule(strokeWidth=1.4).encode(color=_colour(POINT_KINDS), **ends),
        points.mark_point(filled=True, size=42, opacity=1).encode(
            x=x, y=y, color=_colour(POINT_KINDS), shape=SHAPE),
    ).resolve_scale(color="independent").properties(
        width=WIDTH, height=WIDTH * (n_lines + 2 * MARGIN) / (n_samples + 2 * MARGIN),
        title=alt.Title(f"Simulated IKONOS scene: {len(rows)} control lines, "
                        f"{len(wrong)} of them blunders",
                        subtitle="termsel run --problem owdis-lines"))


def key_chart(result: Result, wrong: tuple[str, ...]) -> alt.LayerChart:
    """Return the key: one row a symbol, with how many there are of it."""
    kinds = [row["kind"] for row in line_rows(result, wrong)]
    texts = {SELECTED: f"{kinds.count(SELECTED)} lines that the search selected",
             LEFT_OUT: f"{kinds.count(LEFT_OUT)} lines that it did not select",
             WRONG_LINE: f"{len(wrong)} blunders, "
                         + ("all dropped" if not set(wrong) & set(result.selection.features)
                            else "some selected"),
             "check": f"{result.rmse['check'].n} check points: they guide the search",
             "independent": f"{result.rmse['independent'].n} independent points: they judge it",
             "scale": "residual of 1 px"}
    rows = [{"kind": kind, "text": text, "row": i} for i, (kind, text) in enumerate(texts.items())]
    y = alt.Y("row:Q", axis=None, scale=alt.Scale(domain=[len(rows) - 0.5, -0.5], nice=False))

    def layer(*chosen: str) -> alt.Chart:
        return alt.Chart(alt.Data(values=[r for r in rows if r["kind"] in chosen]))

    # As long as EXAGGERATION pixels of the image are in the other chart.
    one_pixel = WIDTH * EXAGGERATION / (SIZE[1] + 2 * MARGIN)
    left = -112  # below the labels of the bars, not below the bars
    return alt.layer(
        layer(*LINE_KINDS).mark_rule(strokeWidth=3, strokeCap="round").encode(
            x=alt.value(left), x2=alt.value(left + 26), y=y, color=_colour(LINE_KINDS)),
        layer(WRONG_LINE).mark_point(**RING).encode(x=alt.value(left + 13), y=y),
        layer(*POINT_KINDS).mark_rule(strokeWidth=1.4).encode(
            x=alt.value(left + 4), x2=alt.value(left + 24), y=y, color=_colour(POINT_KINDS)),
        layer(*POINT_KINDS).mark_point(filled=True, size=42, opacity=1).encode(
            x=alt.value(left + 5), y=y, color=_colour(POINT_KINDS), shape=SHAPE),
        layer("scale").mark_rule(strokeWidth=1.4, color=FAINT).encode(
            x=alt.value(left + 4), x2=alt.value(left + 4 + one_pixel), y=y),
        alt.Chart(alt.Data(values=rows)).mark_text(align="left", fontSize=12, color=INK).encode(
            x=alt.value(left + 36), y=y, text="text:N"),
    ).resolve_scale(color="independent").properties(width=170, height=138)


def _colour(kinds: dict[str, str]) -> alt.Color:
    return alt.Color("kind:N", legend=None,
                     scale=alt.Scale(domain=[*kinds], range=[*kinds.values()]))


def bar_chart(result: Result) -> alt.LayerChart:
    """Return the RMSE of independent points as bars."""
    n = result.rmse["independent"].n
    base = alt.Chart(alt.Data(values=bar_rows(result))).encode(
        y=alt.Y("fit:N", sort=alt.EncodingSortField("order"), title=None,
                axis=alt.Axis(ticks=False, domain=False, labelPadding=6, labelLimit=200)),
        x=alt.X("rmse:Q", axis=None))
    return alt.layer(
        base.mark_bar(height=26).encode(color=alt.Color("colour:N", scale=None)),
        base.mark_text(align="left", dx=5, fontSize=13, color=INK).encode(
            text=alt.Text("rmse:Q", format=".2f"))
    ).properties(width=170, height=170,
                 title=alt.Title("Accuracy: RMSE [px]",
                                 subtitle=f"of {n} independent points that no choice saw"))


def draw() -> alt.HConcatChart:
    """Run `owdis-lines` on the embedded scene and return its picture."""
    task = running.prepare("owdis-lines", dataset=SCENE)
    result = running.run(task, seed=1)
    wrong = scene_truth(SCENE).wrong_lines
    beside = alt.vconcat(bar_chart(result), key_chart(result, wrong), spacing=48)
    return alt.hconcat(scene_chart(result, task, wrong), beside, spacing=30).configure(
        background=GROUND, padding=16, font="DejaVu Sans, Verdana, sans-serif",
    ).configure_view(stroke=None).configure_title(
        anchor="start", color=INK, fontSize=15, subtitleColor=FAINT, subtitleFontSize=12,
    ).configure_axis(
        labelColor=INK, titleColor=FAINT, labelFontSize=12, titleFontSize=12,
        titleFontWeight="normal", domain=False, tickColor=EDGE)


if __name__ == "__main__":
    draw().save(TARGET)
