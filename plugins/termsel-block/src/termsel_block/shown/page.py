"""The report of a block as one page without any other file."""

from __future__ import annotations

import html
import logging
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from termsel import TermselError
from termsel.toolkit import picture, require_altair
from termsel_block.geometry.frame import FloatArray, IntArray
from termsel_block.joint import BlockResult
from termsel_block.shown.record import BlockRecord, WrongControl, WrongTie, times_seen
from termsel_block.shown.summary import opening, reason_of

log = logging.getLogger("termsel.block")

_STYLE = """
:root { color-scheme: light dark; --text: #1c2024; --page: #fff; --rule: #c9ced4; }
@media (prefers-color-scheme: dark) { :root { --text: #e6e8ea; --page: #16191c; --rule: #454b52; } }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--text); background: var(--page);
       max-width: 62rem; margin: 0 auto; padding: 1rem; }
.wide { overflow-x: auto; } pre { white-space: pre-wrap; }
table { border-collapse: collapse; } th, td { padding: .25rem .75rem; text-align: right;
        border-bottom: 1px solid var(--rule); } th:first-child, td:first-child { text-align: left; }
        .remark { text-align: left; }
figure { margin: 1.5rem 0; } figure div { background: #fff; overflow-x: auto; padding: .5rem; }
svg { max-width: 100%; height: auto; }
"""

# Ties in a picture.
_DRAWN_TIES = 3000
# Images in the picture of their RMSE.
_IMAGES = 40
# Images whose outlines have colours of their own.
_TOLD_APART = 20
# Px of a map: its longer side, and the least of the other.
_SIDE, _NARROW = 560.0, 220.0
# Measurements left out that the page names.
_LISTED = 50


def page_of(result: BlockResult, record: BlockRecord) -> str:
    """Return the page: summary, images, footprints with ties, residuals, and uncertainty.

    A picture that cannot be drawn is left out, which the page and a warning say.
    """
    pictures: list[tuple[str, str, Callable[[], str]]] = [
        ("Footprints, ties and control", "Each dot is a tie; its colour is the standard deviation "
         f"of its height{_some(result)}. Triangles are control. Outlines are drawn around the ties "
         "of each image.", partial(_map, result)),
        ("Residuals and uncertainty by image", "The RMSE of the ties in each image, and the RMSE "
         "that is predicted for points measured as the control is, over the area of these ties. "
         f"The least certain image comes first{_first(record)}.", partial(_bars, record)),
        ("Residuals by tie", "Number of measurements by their distance from the model. Those more "
         "than four standard deviations off in line or in sample are left out.",
         partial(_residuals, result))]
    figures = "".join(_figure(*picture) for picture in pictures)
    rows = "".join(
        f"<tr><th scope=row>{html.escape(image.name)}</th><td>{image.model}</td>"
        f"<td>{image.control}</td><td>{image.ties}</td><td>{image.rmse_ties:.2f}</td>"
        f"<td>{image.predicted:.2f}</td><td>{image.low:.2f} to {image.high:.2f}</td>"
        f"<td>{'' if image.independent is None else f'{image.independent:.2f}'}</td></tr>"
        for image in record.images)
    heads = "".join(f"<th scope=col>{name}</th>" for name in (
        "image", "model", "control", "ties", "ties [px]", "predicted [px]", "90 % interval",
        "independent [px]"))
    return (f"<!doctype html><html lang=en><head><meta charset=utf-8><meta name=viewport "
            f"content='width=device-width'><title>Block of {len(record.images)} images</title>"
            f"<style>{_STYLE}</style></head><body><main><h1>Block of {len(record.images)} images"
            f"</h1><pre>{html.escape(opening(record))}</pre><section><h2>Images</h2>"
            f"<div class=wide tabindex=0><table><thead><tr>{heads}</tr></thead><tbody>{rows}"
            "</tbody></table></div><p>Predicted is the RMSE of points measured as the control is, "
            "at the places of the independent check points, or of the ties where there are "
            f"none.</p></section>{figures}{_left_out(record)}</main></body></html>\n")


def _figure(title: str, text: str, draw: Callable[[], str]) -> str:
    """Return a picture with its title and what it shows, or why it could not be drawn."""
    try:
        require_altair()
        figure = f"<div>{draw()}</div><figcaption>{text}</figcaption>"
    except TermselError as error:
        log.warning("Warning: the page lacks the picture %r: %s.", title, error.what.rstrip("."))
        figure = f"<figcaption>This picture is missing: {html.escape(error.what)}.</figcaption>"
    return f"<section><h2>{title}</h2><figure>{figure}</figure></section>"


def _first(record: BlockRecord) -> str:
    """Return how many images of all are shown, as part of a sentence; empty if all are."""
    has_more = len(record.images) > _IMAGES
    return f"; {_IMAGES} of {len(record.images)} are shown" if has_more else ""


def _some(result: BlockResult) -> str:
    """Return how many ties of all are shown, as part of a sentence; empty if all are."""
    count = len(_placed(result))
    return f"; {_DRAWN_TIES:,} of {count:,} are shown" if count > _DRAWN_TIES else ""


def _placed(result: BlockResult) -> IntArray:
    """Return the ties that have a place, which two images or more see."""
    return np.flatnonzero(times_seen(result) > 1)


def _left_out(record: BlockRecord) -> str:
    """Return a table of what was left out: control, then ties, of each the worst first."""
    blunders: list[tuple[str, WrongTie | WrongControl]] = [
        ("control", wrong) for wrong in record.wrong_control]
    blunders += [("tie", wrong) for wrong in record.wrong_ties]
    if not blunders:
        return ""
    rows = "".join(
        f"<tr><th scope=row>{html.escape(wrong.id)}</th><td>{html.escape(wrong.image)}</td>"
        f"<td>{kind}</td><td>{wrong.error:.1f}</td>"
        f"<td class=remark>{reason_of(wrong, record)}</td></tr>"
        for kind, wrong in blunders[:_LISTED])
    further = ""
    if len(blunders) > _LISTED:
        further = f"<p>{len(blunders) - _LISTED} more are in block.json.</p>"
    heads = "".join(f"<th scope=col>{name}</th>" for name in (
        "id", "image", "kind", "distance [px]", "remark"))
    return ("<section><h2>Left out as blunders</h2><div class=wide tabindex=0><table><thead>"
            f"<tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div>{further}</section>")


def _svg(chart: Any) -> str:
    """Return a chart as SVG."""
    # A browser's letters may be wider than those that the picture leaves room for at its side.
    return picture(chart.configure_legend(orient="bottom"), ".svg").decode()


def _map(result: BlockResult) -> str:
    """Return the ground with ties, control and the hulls of images, at one scale."""
    import altair as alt
    from scipy.spatial import ConvexHull, QhullError

    ties = result.block.ties
    state = result.adjusted.state
    placed = _placed(result)
    # Evenly over the list, as many as a browser draws in good time.
    drawn = placed[np.linspace(0, len(placed) - 1, min(_DRAWN_TIES, len(placed))).astype(int)]
    dots = [{"east": float(e), "north": float(n), "sigma": float(s)} for e, n, s in zip(
        state.ties[drawn, 0] / 1000, state.ties[drawn, 1] / 1000, result.sigma_ties[drawn, 2],
        strict=True)]
    # Images may share control: each position is drawn once.
    control = np.unique(np.concatenate([
        control_of_image.local[used, :2] for control_of_image, used in zip(
            result.control, state.control_in_use, strict=True)]) / 1000, axis=0)
    marks = [{"east": float(e), "north": float(n)} for e, n in control]
    outlines = []
    for i, image in enumerate(result.block.images):
        of_image = ties.tie[ties.image == i]
        outline = state.ties[of_image[np.isin(of_image, placed)], :2] / 1000
        try:
            hull = ConvexHull(outline).vertices
        except (QhullError, ValueError):
            # Fewer than three, or on a line.
            continue
        # The outline is closed: the first vertex comes again at the end.
        outlines += [{"east": float(outline[k, 0]), "north": float(outline[k, 1]), "order": order,
                      "image": image.name} for order, k in enumerate([*hull, hull[0]])]
    all_ground = [state.ties[placed, :2] / 1000, control]
    (x_of, width), (y_of, height) = _one_scale(np.concatenate(all_ground))
    x = alt.X("east:Q", title="east [km]", scale=alt.Scale(domain=x_of, nice=False),
              axis=alt.Axis(tickCount=width / 60))
    y = alt.Y("north:Q", title="north [km]", scale=alt.Scale(domain=y_of, nice=False),
              axis=alt.Axis(tickCount=height / 60))
    names = list(dict.fromkeys(row["image"] for row in outlines))
    # More colours than these nobody tells apart.
    colour = alt.value("#888") if len(names) > _TOLD_APART else alt.Color(
        "image:N", title="image", sort=names, legend=alt.Legend(columns=6),
        scale=alt.Scale(scheme="tableau10" if len(names) <= 10 else "tableau20"))
    hulls = alt.Chart(alt.Data(values=outlines)).mark_line(strokeWidth=1.5).encode(
        x=x, y=y, order="order:Q", detail="image:N", color=colour)
    points = alt.Chart(alt.Data(values=dots)).mark_circle(size=30, opacity=1.0).encode(
        x=x, y=y, fill=alt.Fill("sigma:Q", title="sigma of height [m]",
                                scale=alt.Scale(scheme="viridis")))
    triangles = alt.Chart(alt.Data(values=marks)).mark_point(
        shape="triangle-up", size=90, filled=False, color="black", strokeWidth=1.5).encode(x=x, y=y)
    return _svg(alt.layer(hulls, points, triangles).resolve_scale(color="independent").properties(
        width=width, height=height))


def _one_scale(ground: FloatArray) -> list[tuple[list[float], float]]:
    """Return domain [km] and size [px] of either axis, with as many px a kilometre in both."""
    low = ground.min(axis=0)
    high = ground.max(axis=0)
    # A margin of 2 % on each side.
    extent = np.maximum(1.04 * (high - low), 1e-3)
    scale = _SIDE / extent.max()
    # A narrow block still gets a map that can be read: the short side is made longer.
    extent = np.maximum(extent, _NARROW / scale)
    return [([float(middle - half), float(middle + half)], float(2 * half * scale))
            for middle, half in zip((low + high) / 2, extent / 2, strict=True)]


def _bars(record: BlockRecord) -> str:
    """Return RMSE of ties and predicted RMSE of images, the least certain first."""
    import altair as alt

    images = sorted(record.images, key=lambda image: -image.uncertainty)[:_IMAGES]
    rows = []
    for image in images:
        rows.append({"image": image.name, "what": "ties", "px": image.rmse_ties})
        rows.append({"image": image.name, "what": "predicted", "px": image.uncertainty})
    return _svg(alt.Chart(alt.Data(values=rows)).mark_bar().encode(
        x=alt.X("px:Q", title="RMSE [px]", axis=alt.Axis(tickCount=8)), yOffset="what:N",
        y=alt.Y("image:N", title="image", sort=[image.name for image in images]),
        color=alt.Color("what:N", title="")).properties(width=560))


def _residuals(result: BlockResult) -> str:
    """Return how many measurements are how far from the model."""
    import altair as alt

    far = np.concatenate([np.hypot(*residuals.T) for residuals in result.adjusted.residuals])
    # All beyond six standard deviations are one bar, so that the others can be seen.
    limit = 6 * result.adjusted.state.sigma_ties
    count, edges = np.histogram(np.minimum(far, limit), bins=24, range=(0, limit))
    rows = [{"from": float(a), "to": float(b), "count": int(n)}
            for a, b, n in zip(edges[:-1], edges[1:], count, strict=True)]
    return _svg(alt.Chart(alt.Data(values=rows)).mark_rect().encode(
        x=alt.X("from:Q", title=f"distance [px]; the last bar is all beyond {edges[-2]:.1f} px"),
        x2="to:Q", y=alt.Y("count:Q", title="measurements"),
        y2=alt.value(240)).properties(width=560, height=240))
