"""The report of a block as one page without any other file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from termsel import TableBlock
from termsel.toolkit.charts import (
    CONTROL,
    FAINT,
    INK,
    METHODS,
    WIDTH,
    Document,
    Figure,
    Section,
    chart_rows,
    render_page,
    require_altair,
)
from termsel_block.geometry.frame import FloatArray, IntArray
from termsel_block.joint import BlockResult
from termsel_block.shown.record import BlockRecord, WrongControl, WrongTie, times_seen
from termsel_block.shown.summary import block_facts, read_in, reason_of

_SIGMA_COLOURS = ("#5aae3c", "#2f8fa0", "#8a5cc9")
"""Colours of dots from a small to a large uncertainty, seen on light and dark pages."""
# Most ties in a picture.
_MAX_TIES = 3000
# Most images in the picture of their RMSE.
_MAX_IMAGES = 40
# Most images whose outlines have colours of their own.
_MAX_COLOURS = 20
# Px of a map: its longer side, and the least of the other.
_MAP_SIDE, _MIN_MAP_SIDE = 560.0, 220.0
# Most rejected observations that the page names.
_MAX_LISTED = 50


def page_of(result: BlockResult, record: BlockRecord) -> str:
    """Return the page: first lines with a map, images, residuals and uncertainty, and outliers.

    Raises
    ------
    TermselError
        If the libraries for charts are not installed.
    """
    require_altair()
    # The map comes first, below the facts; other charts and tables are in sections.
    ground = Figure(
        "map", "Footprints, ties and control",
        "Each dot is a tie; its colour is the standard deviation of its height"
        f"{_ties_shown(result)}. Triangles are control. Outlines are drawn around the ties of "
        "each image.", _ground_chart(result), keeps_ratio=True)
    by_image = Figure(
        "images", "Residuals and uncertainty by image",
        "The RMSE of the ties in each image, and the predicted RMSE of the table of images. The "
        "image that is least certain over the area of its ties comes first"
        f"{_images_shown(record)}.", _tie_rmse_chart(record))
    by_tie = Figure(
        "ties", "Residuals by tie",
        "Number of observations by their distance from the model. Those more than four standard "
        "deviations off in line or in sample are rejected.", _residual_histogram(result))
    images = (
        "Predicted is the RMSE of points measured like the control, at the positions of the "
        "independent check points (ICPs), or of the ties if there are none.", _image_table(record))
    sections = (Section("Images", images), Section("Residuals", (by_image, by_tie)),
                Section("Rejected outliers", tuple(_rejected_table(record))))
    return render_page(Document(
        f"Block of {len(record.images)} images", read_in(record), (*block_facts(record), ground),
        tuple(section for section in sections if section.blocks)))


def _image_table(record: BlockRecord) -> TableBlock:
    """Return the table of all images."""
    return TableBlock("All images", (
        "image", "model", "control", "ties", "ties [px]", "predicted [px]", "90 % interval",
        "ICPs [px]"), [
            (image.name, image.model, str(image.control), str(image.ties),
             f"{image.rmse_ties:.2f}", f"{image.predicted:.2f}",
             f"{image.low:.2f} to {image.high:.2f}",
             "" if image.independent is None else f"{image.independent:.2f}")
            for image in record.images])


def _images_shown(record: BlockRecord) -> str:
    """Return how many images of all are shown, as part of a sentence; empty if all are."""
    has_more = len(record.images) > _MAX_IMAGES
    return f"; {_MAX_IMAGES} of {len(record.images)} are shown" if has_more else ""


def _ties_shown(result: BlockResult) -> str:
    """Return how many ties of all are shown, as part of a sentence; empty if all are."""
    count = len(_located_ties(result))
    return f"; {_MAX_TIES:,} of {count:,} are shown" if count > _MAX_TIES else ""


def _located_ties(result: BlockResult) -> IntArray:
    """Return the ties that have a place, which two images or more see."""
    return np.flatnonzero(times_seen(result) > 1)


def _rejected_table(record: BlockRecord) -> Iterator[TableBlock | str]:
    """Yield a table of rejected observations, and a line on how many are left out, if any.

    The table has control and then ties, the worst of each first. Nothing is yielded if no
    observation was rejected.
    """
    rejected: list[tuple[str, WrongTie | WrongControl]] = [
        ("control", wrong) for wrong in record.wrong_control]
    rejected += [("tie", wrong) for wrong in record.wrong_ties]
    if not rejected:
        return
    columns: tuple[str, ...] = ("id", "image", "kind", "distance [px]", "remark")
    rows: list[tuple[str, ...]] = [
        (wrong.id, wrong.image, kind, f"{wrong.error:.1f}", reason_of(wrong))
        for kind, wrong in rejected[:_MAX_LISTED]]
    # Without any remark their column would be blank.
    if not any(row[-1] for row in rows):
        columns, rows = columns[:-1], [row[:-1] for row in rows]
    yield TableBlock("Observations that were rejected, the worst first", columns, rows)
    if len(rejected) > _MAX_LISTED:
        yield f"{len(rejected) - _MAX_LISTED} more are in block.json."


def _ground_chart(result: BlockResult) -> Any:
    """Return a chart of the ground [km] with ties, control and the hulls of the images' ties.

    Both axes have one scale. An image of fewer than three ties, or of ties on a line, has no hull.
    """
    import altair as alt
    from scipy.spatial import ConvexHull, QhullError

    ties = result.block.ties
    state = result.adjusted.state
    located = _located_ties(result)
    # As many as a browser draws in good time, evenly over the list.
    shown = located[np.linspace(0, len(located) - 1, min(_MAX_TIES, len(located))).astype(int)]
    dots = [{"east": float(e), "north": float(n), "sigma": float(s)} for e, n, s in zip(
        state.ties[shown, 0] / 1000, state.ties[shown, 1] / 1000, result.sigma_ties[shown, 2],
        strict=True)]
    # Control that several images share is drawn once.
    control = np.unique(np.concatenate([
        control_of_image.local[used, :2] for control_of_image, used in zip(
            result.control, state.control_in_use, strict=True)]) / 1000, axis=0)
    marks = [{"east": float(e), "north": float(n)} for e, n in control]
    outlines = []
    for i, image in enumerate(result.block.images):
        image_ties = ties.tie[ties.image == i]
        ground = state.ties[image_ties[np.isin(image_ties, located)], :2] / 1000
        try:
            hull = ConvexHull(ground).vertices
        except (QhullError, ValueError):
            continue
        # The outline is closed: the first vertex comes again at the end.
        outlines += [{"east": float(ground[k, 0]), "north": float(ground[k, 1]), "order": order,
                      "image": image.name} for order, k in enumerate([*hull, hull[0]])]
    all_ground = [state.ties[located, :2] / 1000, control]
    (x_of, width), (y_of, height) = _equal_scales(np.concatenate(all_ground))
    x = alt.X("east:Q", title="east [km]", scale=alt.Scale(domain=x_of, nice=False),
              axis=alt.Axis(tickCount=width / 60))
    y = alt.Y("north:Q", title="north [km]", scale=alt.Scale(domain=y_of, nice=False),
              axis=alt.Axis(tickCount=height / 60))
    names = list(dict.fromkeys(row["image"] for row in outlines))
    # Nobody tells more than _MAX_COLOURS colours apart.
    palette = {"range": METHODS[:len(names)]} if len(names) <= len(METHODS) else {
        "scheme": "tableau20"}
    colour = alt.Color("image:N", title="image", sort=names, legend=alt.Legend(columns=6),
                       scale=alt.Scale(domain=names, **palette))
    if len(names) > _MAX_COLOURS:
        colour = alt.value("#888")
    hulls = alt.Chart(chart_rows(outlines)).mark_line(strokeWidth=1.5).encode(
        x=x, y=y, order="order:Q", detail="image:N", color=colour)
    points = alt.Chart(chart_rows(dots)).mark_circle(size=30, opacity=1.0).encode(
        x=x, y=y, fill=alt.Fill("sigma:Q", title="sigma of height [m]",
                                scale=alt.Scale(range=_SIGMA_COLOURS)))
    triangles = alt.Chart(chart_rows(marks)).mark_point(
        shape="triangle-up", size=90, filled=False, color=INK, strokeWidth=1.5).encode(x=x, y=y)
    return alt.layer(hulls, points, triangles).resolve_scale(color="independent").properties(
        width=width, height=height)


def _equal_scales(ground: FloatArray) -> list[tuple[list[float], float]]:
    """Return domain [km] and size [px] of each axis for points (n, 2), with one scale."""
    low = ground.min(axis=0)
    high = ground.max(axis=0)
    # A margin of 2 % on each side.
    extent = np.maximum(1.04 * (high - low), 1e-3)
    scale = _MAP_SIDE / extent.max()
    # The short side of a narrow block is made longer, so that its map can be read.
    extent = np.maximum(extent, _MIN_MAP_SIDE / scale)
    return [([float(middle - half), float(middle + half)], float(2 * half * scale))
            for middle, half in zip((low + high) / 2, extent / 2, strict=True)]


def _tie_rmse_chart(record: BlockRecord) -> Any:
    """Return a chart with two bars for each image: the RMSE of its ties, and the predicted one.

    The least certain images come first; of many the first `_MAX_IMAGES` are shown.
    """
    import altair as alt

    images = sorted(record.images, key=lambda image: -image.uncertainty)[:_MAX_IMAGES]
    rows = []
    for image in images:
        rows.append({"image": image.name, "what": "ties", "px": image.rmse_ties})
        rows.append({"image": image.name, "what": "predicted", "px": image.predicted})
    colours = alt.Scale(domain=["ties", "predicted"], range=[CONTROL, FAINT])
    return alt.Chart(chart_rows(rows)).mark_bar().encode(
        x=alt.X("px:Q", title="RMSE [px]", axis=alt.Axis(tickCount=8)), yOffset="what:N",
        y=alt.Y("image:N", title=None, sort=[image.name for image in images]),
        color=alt.Color("what:N", scale=colours)).properties(
            width=WIDTH, height=max(80, 36 * len(images)))


def _residual_histogram(result: BlockResult) -> Any:
    """Return a histogram of the distances [px] of ties from the model.

    The last bar has all distances of nearly six standard deviations and more.
    """
    import altair as alt
    distances = np.concatenate([np.hypot(*residuals.T) for residuals in result.adjusted.residuals])
    # Without a limit a few blunders would make all others one bar.
    limit = 6 * result.adjusted.state.sigma_ties
    count, edges = np.histogram(np.minimum(distances, limit), bins=24, range=(0, limit))
    rows = [{"from": float(a), "to": float(b), "count": int(n)}
            for a, b, n in zip(edges[:-1], edges[1:], count, strict=True)]
    return alt.Chart(chart_rows(rows)).mark_rect(color=CONTROL).encode(
        x=alt.X("from:Q", title=f"distance [px]; the last bar is all beyond {edges[-2]:.1f} px"),
        x2="to:Q", y=alt.Y("count:Q", title="observations"),
        y2=alt.value(240)).properties(width=WIDTH, height=240)
