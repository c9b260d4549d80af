"""The report of a block as one page without any other file."""

from __future__ import annotations

import html
from typing import Any

import numpy as np

from termsel.toolkit import picture
from termsel_block.joint import BlockResult
from termsel_block.shown.record import BlockRecord, times_seen
from termsel_block.shown.summary import opening

_STYLE = """
:root { color-scheme: light dark; --text: #1c2024; --page: #fff; --rule: #c9ced4; }
@media (prefers-color-scheme: dark) { :root { --text: #e6e8ea; --page: #16191c; --rule: #454b52; } }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--text); background: var(--page);
       max-width: 62rem; margin: 0 auto; padding: 1rem; }
.wide { overflow-x: auto; } pre { white-space: pre-wrap; }
table { border-collapse: collapse; } th, td { padding: .25rem .75rem; text-align: right;
        border-bottom: 1px solid var(--rule); } th:first-child, td:first-child { text-align: left; }
figure { margin: 1.5rem 0; } figure div { background: #fff; overflow-x: auto; padding: .5rem; }
svg { max-width: 100%; height: auto; }
"""

_MOST = 3000  # ties in a picture
_IMAGES = 40  # images in a picture


def page_of(result: BlockResult, record: BlockRecord) -> str:
    """Return the page: summary, images, footprints with ties, residuals, and uncertainty."""
    pictures = [
        ("Footprints and ties", "Each dot is a tie; the colour is the standard deviation of its "
         "height [m]. The outlines are the hulls of what each image sees.", _map(result)),
        ("Residuals by image", "RMSE of the ties in each image [px]; predicted is what points "
         "measured as the control will have over the area of the ties.", _bars(record)),
        ("Residuals by tie", "Number of measurements by their distance from the model [px]; those "
         "left out are beyond four standard deviations.", _residuals(result))]
    figures = "".join(
        f"<section><h2>{title}</h2><figure><div>{svg}</div><figcaption>{text}</figcaption>"
        "</figure></section>" for title, text, svg in pictures)
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
            "</tbody></table></div>"
            f"</section>{figures}</main></body></html>\n")


def _svg(chart: Any) -> str:
    """Return a chart as SVG."""
    # A browser's letters may be wider than those that the picture leaves room for at its side.
    return picture(chart.configure_legend(orient="bottom"), ".svg").decode()


def _map(result: BlockResult) -> str:
    """Return the ground with ties and the hulls of images."""
    import altair as alt
    from scipy.spatial import ConvexHull, QhullError

    ties, state = result.block.ties, result.adjusted.state
    placed = np.flatnonzero(times_seen(result) > 1)
    some = placed[np.linspace(0, len(placed) - 1, min(_MOST, len(placed))).astype(int)]
    dots = [{"east": float(e), "north": float(n), "sigma": float(s)} for e, n, s in zip(
        state.ties[some, 0] / 1000, state.ties[some, 1] / 1000, result.sigma_ties[some, 2],
        strict=True)]
    outlines = []
    for i, image in list(enumerate(result.block.images))[:_IMAGES]:
        places = state.ties[ties.tie[ties.image == i], :2] / 1000
        try:
            hull = ConvexHull(places).vertices
        except (QhullError, ValueError):  # fewer than three, or on a line
            continue
        outlines += [{"east": float(places[k, 0]), "north": float(places[k, 1]), "order": order,
                      "image": image.name} for order, k in enumerate([*hull, hull[0]])]
    x = alt.X("east:Q", title="east [km]", scale=alt.Scale(zero=False))
    y = alt.Y("north:Q", title="north [km]", scale=alt.Scale(zero=False))
    hulls = alt.Chart(alt.Data(values=outlines)).mark_line(strokeWidth=1).encode(
        x=x, y=y, order="order:Q", color=alt.Color("image:N", title="image"))
    points = alt.Chart(alt.Data(values=dots)).mark_circle(size=14).encode(
        x=x, y=y, fill=alt.Fill("sigma:Q", title="sigma up [m]",
                               scale=alt.Scale(scheme="viridis")))
    return _svg(alt.layer(points, hulls).resolve_scale(color="independent").properties(
        width=560, height=420))


def _bars(record: BlockRecord) -> str:
    """Return RMSE of ties and predicted RMSE of images, the least certain first."""
    import altair as alt

    images = sorted(record.images, key=lambda image: -image.uncertainty)[:_IMAGES]
    rows = [{"image": image.name, "what": what, "px": value} for image in images
            for what, value in (("ties", image.rmse_ties), ("predicted", image.uncertainty))]
    return _svg(alt.Chart(alt.Data(values=rows)).mark_bar().encode(
        x=alt.X("px:Q", title="RMSE [px]", axis=alt.Axis(tickCount=8)), yOffset="what:N",
        y=alt.Y("image:N", title="image", sort=[image.name for image in images]),
        color=alt.Color("what:N", title="")).properties(width=560))


def _residuals(result: BlockResult) -> str:
    """Return how many measurements are how far from the model."""
    import altair as alt

    far = np.concatenate([np.hypot(*part.T) for part in result.adjusted.residuals])
    limit = 6 * result.adjusted.state.sigma_ties
    count, edges = np.histogram(np.minimum(far, limit), bins=24, range=(0, limit))
    rows = [{"from": float(a), "to": float(b), "count": int(n)}
            for a, b, n in zip(edges[:-1], edges[1:], count, strict=True)]
    return _svg(alt.Chart(alt.Data(values=rows)).mark_rect().encode(
        x=alt.X("from:Q", title=f"distance [px]; the last bar is all beyond {edges[-2]:.1f} px"),
        x2="to:Q", y=alt.Y("count:Q", title="measurements"),
        y2=alt.value(240)).properties(width=560, height=240))
