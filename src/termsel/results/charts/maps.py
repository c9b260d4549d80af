"""Maps: residuals in the image and on the ground, and where the model is uncertain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from termsel.data.coordinates.crs import is_geographic, short_crs_name
from termsel.results.theme import (
    BLUNDER,
    EDGE,
    GROUND,
    INK,
    ROLE_COLOURS,
    ROLE_LABELS,
    ROLE_SHAPES,
    WIDTH,
    chart_rows,
    legend_of,
    require_altair,
    role_legend,
)
from termsel.results.view import Row, View, nice_number

LENGTH = 0.06
"""Of the median vector, in widths of the map, at most."""
SPACING = 0.6
"""Of the median vector, in mean distances of neighbours, at most: more arrows are shorter ones."""
MAP_MARGIN = 0.04
"""Drawn around the image, in widths of it."""
WIDEST = 3.0
"""Width of a map in heights, at most."""
VECTOR_ROUNDING = 1e-9
"""Median vector, in widths of the map, up to which residuals are rounding and not exaggerated."""
ORDINARY = 3.0
"""Median vectors; a map has room for arrows up to this length, and cuts longer ones at its rim."""
SIGMA_SPREAD = 2.0
"""Largest colour of the map of uncertainty, in times the smallest, at least."""


@dataclass(frozen=True)
class Extent:
    """What a map shows, in its own coordinates.

    Parameters
    ----------
    x, y : tuple of float
        Least and greatest x (samples) and y (lines).
    scale : float
        How many times its true length a residual is drawn.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    scale: float

    def cuts(self, rows: list[Row], at: tuple[str, str], vector: tuple[str, str]) -> bool:
        """Return whether the arrow of any row would leave the map."""
        for row in rows:
            for (low, high), position, component in zip((self.x, self.y), at, vector, strict=True):
                if not low <= row[position] + self.scale * row[component] <= high:
                    return True
        return False


def image_extent(view: View) -> Extent:
    """Return the extent of the map of the image, with room for arrows of ordinary length."""
    top, left_sample, bottom, right_sample = view.image_box
    wide = max(right_sample - left_sample, 1.0)
    tall = max(bottom - top, 1.0)
    margin = MAP_MARGIN * max(wide, tall)
    # Points in a row leave no room for arrows across it; room is added up to the widest map.
    above = max(margin, (wide / WIDEST - tall) / 2)
    # Of all residuals, not of a chosen member, so that members can be compared by their arrows.
    lengths = [float(np.hypot(row["dl"], row["ds"])) for row in view.in_image]
    scale = _choose_exaggeration(lengths, wide, wide * tall)
    longest = _longest_ordinary(lengths)
    ends = [(row["sample"] + scale * row["ds"], row["line"] + scale * row["dl"])
            for row, length in zip(view.in_image, lengths, strict=True)
            if length <= longest]
    return Extent(
        _value_range([left_sample - margin, right_sample + margin], [sample for sample, _ in ends]),
        _value_range([top - above, bottom + above], [line for _, line in ends]), scale)


def ground_extent(view: View) -> Extent:
    """Return the extent of the map of the ground, with room for arrows of ordinary length."""
    west, south, east, north = view.ground_box
    wide = max(east - west, 1e-9)
    tall = max(north - south, 1e-9)
    # A degree of longitude is shorter than one of latitude: lengths on the map are in units of y.
    margin = MAP_MARGIN * max(wide * view.flattening, tall)
    across = margin / view.flattening
    lengths = [float(np.hypot(row["dx"] * view.flattening, row["dy"])) for row in view.on_ground]
    scale = _choose_exaggeration(lengths, tall, wide * view.flattening * tall)
    longest = _longest_ordinary(lengths)
    ends = [(row["x"] + scale * row["dx"], row["y"] + scale * row["dy"])
            for row, length in zip(view.on_ground, lengths, strict=True)
            if length <= longest]
    low, high = _value_range([south, north + margin], [y for _, y in ends])
    # The bar of the scale lies below all of them.
    return Extent(_value_range([west - across, east + across], [x for x, _ in ends]),
                  (low - 2 * margin, high), scale)


def _longest_ordinary(lengths: list[float]) -> float:
    """Return the length up to which an arrow is ordinary, 0 of none."""
    return ORDINARY * float(np.median(lengths)) if lengths else 0.0


def _value_range(values: list[float], more: list[float]) -> tuple[float, float]:
    """Return the least and the greatest of all values."""
    return min(*values, *more), max(*values, *more)


def cut_in_image(view: View) -> str:
    """Return a caption on arrows over the image that leave the map; "" if none do."""
    cuts = image_extent(view).cuts(view.in_image, ("sample", "line"), ("ds", "dl"))
    return _remark_on_map(view, cuts)


def cut_on_ground(view: View) -> str:
    """Return a caption on arrows on the ground that leave the map; "" if none do."""
    cuts = ground_extent(view).cuts(view.on_ground, ("x", "y"), ("dx", "dy"))
    return _remark_on_map(view, cuts)


def _remark_on_map(view: View, cuts: bool) -> str:
    """Return the note under a map: on arrows that are cut, and on what it leaves out."""
    dashed = "Dashed arrows are longer than drawn: they would leave the chart." if cuts else ""
    return f"{dashed} {view.partly}".strip()


def image_map(view: View, image: str = "", rows: list[Row] | None = None,
              member: Any = None) -> Any:
    """Return residuals as arrows over the image.

    Parameters
    ----------
    view : View
    image : str
        A picture of the image as a data URL.
    rows : list of dict, optional
        Residuals in the image by members of a front; by default those of the view.
    member : altair.Parameter, optional
        The choice of the member whose residuals are drawn.
    """
    alt = require_altair()
    top, left_sample, bottom, right_sample = view.image_box
    extent = image_extent(view)
    rows = view.in_image if rows is None else rows
    x = alt.X("sample:Q", title="sample [px]", axis=alt.Axis(grid=False, tickCount=6),
              scale=alt.Scale(domain=list(extent.x), nice=False, zero=False))
    y = alt.Y("line:Q", title="line [px]", axis=alt.Axis(grid=False, tickCount=6),
              # Lines are counted downwards.
              scale=alt.Scale(domain=list(extent.y)[::-1], nice=False, zero=False))
    frame = alt.Chart(chart_rows([{"line": top, "sample": left_sample, "line2": bottom,
                                   "sample2": right_sample, "url": image}]))
    ends = {"x": x, "y": y, "x2": "sample2:Q", "y2": "line2:Q"}
    layers = [frame.mark_image(aspect=False).encode(url="url:N", **ends)] if image else []
    layers.append(frame.mark_rect(fill=None, stroke=EDGE, strokeWidth=1.2).encode(**ends))
    if view.lines:
        layers.append(alt.Chart(chart_rows(view.lines)).mark_rule(
            strokeWidth=1.8, strokeCap="round", opacity=0.55).encode(
                color=_role_colour(view, rows),
                strokeDash=alt.condition("datum.blunder", alt.value([4, 3]),
                                         alt.value([1, 0])),
                tooltip=[alt.Tooltip("id:N", title="line")], **ends))
    layers += _residual_layers(view, rows, x, y, ("ds", "dl"), extent, downwards=True,
                               member=member)
    wide = max(right_sample - left_sample, 1.0)
    # A fifth of the map's width, but a pixel, the plainest measure, where that is long enough to be
    # seen.
    length = nice_number(0.2 * wide / extent.scale)
    if length > 1.0 and extent.scale > 0.02 * wide:
        length = 1.0
    below = extent.y[1] - 0.02 * (extent.y[1] - extent.y[0])
    layers.append(_scale_bar(left_sample, below, length, f"{length:g} px", "sample", "line", x, y))
    return _map_chart(layers, (extent.x[1] - extent.x[0]) / (extent.y[1] - extent.y[0]))


def ground_map(view: View) -> Any:
    """Return residuals as arrows on the ground, in the CRS of the control.

    A bar gives the scale of the arrows where metres are known. Degrees are stretched so that the
    map has the shape of the ground.
    """
    alt = require_altair()
    rows = view.on_ground
    west, _, east, _ = view.ground_box
    extent = ground_extent(view)
    of_x, of_y = _axis_titles(view)
    x = alt.X("x:Q", title=of_x, axis=alt.Axis(grid=False, tickCount=5),
              scale=alt.Scale(domain=list(extent.x), nice=False, zero=False))
    y = alt.Y("y:Q", title=of_y, axis=alt.Axis(grid=False, tickCount=6),
              scale=alt.Scale(domain=list(extent.y), nice=False, zero=False))
    layers = _residual_layers(view, rows, x, y, ("dx", "dy"), extent, downwards=False,
                              # Without metres the length of the arrows has no scale.
                              metres=view.units_per_metre is not None, flattening=view.flattening)
    if view.units_per_metre is not None:
        metre = view.units_per_metre / view.flattening
        length = nice_number(0.2 * max(east - west, 1e-9) / (extent.scale * metre))
        below = extent.y[0] + 0.025 * (extent.y[1] - extent.y[0])
        layers.append(_scale_bar(west, below, length * metre, f"{length:g} m", "x", "y", x, y))
    across = (extent.x[1] - extent.x[0]) * view.flattening
    return _map_chart(layers, across / (extent.y[1] - extent.y[0]))


def sigma_map(view: View) -> Any:
    """Return the predicted standard deviation over the image, with the hull of the control.

    Beyond the dashed hull the model extrapolates. The scale spans a factor of SIGMA_SPREAD at
    least, so that a map that is equally sure everywhere does not look as if it had dark corners.
    Line numbers grow downwards, as in the image.
    """
    alt = require_altair()
    top, left_sample, bottom, right_sample = view.image_box
    cells = view.sigma
    axis = alt.Axis(grid=False, tickCount=6)
    x = alt.X("sample:Q", title="sample [px]", axis=axis,
              scale=alt.Scale(domain=[left_sample, right_sample], nice=False, zero=False))
    y = alt.Y("line:Q", title="line [px]", axis=axis,
              scale=alt.Scale(domain=[bottom, top], nice=False, zero=False))
    least = min(cell["sigma"] for cell in cells)
    most = max(SIGMA_SPREAD * least, *(cell["sigma"] for cell in cells))
    colour = alt.Color("sigma:Q", scale=alt.Scale(scheme="viridis", reverse=True,
                                                  domain=[least, most]),
                       legend=alt.Legend(title="standard deviation [px]", gradientLength=220))
    layers = [
        alt.Chart(chart_rows(cells)).mark_rect(strokeWidth=0, clip=True, aria=False).encode(
            x=x, y=y, x2="sample2:Q", y2="line2:Q", color=colour,
            tooltip=[alt.Tooltip("sigma:Q", title="standard deviation [px]", format=".3g")]),
        alt.Chart(chart_rows(view.hull)).mark_line(
            color="black", strokeWidth=1.4, strokeDash=[5, 3]).encode(x=x, y=y, order="i:O"),
        alt.Chart(chart_rows(view.control)).mark_point(
            filled=True, size=26, color="white", stroke="black", strokeWidth=0.9,
            opacity=1).encode(x=x, y=y)]  # the colours below are the same on dark pages
    return _map_chart(layers, max(right_sample - left_sample, 1.0) / max(bottom - top, 1.0))


def _map_chart(layers: list[Any], aspect: float) -> Any:
    """Return layers as one chart of an aspect, width by height, at most WIDEST."""
    # A strip of one orbit may be a hundred times as long as wide; on the map it is cut to three.
    aspect = min(max(aspect, 0.4), WIDEST)
    wide = WIDTH if aspect >= 0.9 else WIDTH * aspect / 0.9
    return require_altair().layer(*layers).properties(width=round(wide),
                                                      height=round(wide / aspect))


def _residual_layers(view: View, rows: list[Row], x: Any, y: Any, vector: tuple[str, str],
                     extent: Extent, *, downwards: bool, metres: bool = False,
                     flattening: float = 1.0, member: Any = None) -> list[Any]:
    """Return the layers of residuals: their arrows, symbols of points and lines, and rings.

    Parameters
    ----------
    view : View
    rows : list of dict
        The residuals, each with its position and vector.
    x, y : altair.X, altair.Y
        The axes, whose fields are the positions.
    vector : tuple of str
        The fields of a residual along x and along y.
    extent : Extent
        What the map shows, and how many times their true length arrows are drawn at first.
    downwards : bool
        Whether y grows downwards, as lines do.
    metres : bool
        Whether rows have a field with the residual on the ground [m].
    flattening : float
        Length of a unit of x by that of y (`View.flattening`).
    member : altair.Parameter, optional
        The choice of the member of a front whose residuals are drawn.
    """
    alt = require_altair()
    horizontal, vertical = vector
    # Channels are written "field:type".
    at_x, at_y = (channel.shorthand.partition(":")[0] for channel in (x, y))
    scale = extent.scale
    drag = alt.param(name="exaggeration", value=scale, bind=alt.binding_range(
        min=0, max=3 * scale, step=scale / 50, name="Length of arrows [times true length] "))
    picked = alt.selection_point(name="picked", fields=["id"], empty=False)
    base = alt.Chart(chart_rows(rows))
    if member is not None:
        base = _with_residuals_of_member(base, view)
    base = base.transform_calculate(
        # The share of an arrow that lies within the map.
        drawn=f"max(0, min(1, {_share_to_rim(at_x, horizontal, extent.x)}, "
              f"{_share_to_rim(at_y, vertical, extent.y)}))",
    ).transform_calculate(
        end_x=f"datum.{at_x} + datum.drawn * exaggeration * datum.{horizontal}",
        end_y=f"datum.{at_y} + datum.drawn * exaggeration * datum.{vertical}",
        # The angle of the wedge, clockwise from upwards, as Vega measures it.
        turn=f"atan2({flattening:.6g} * datum.{horizontal}, "
             f"{'-' if downwards else ''}datum.{vertical}) * 180 / PI")
    colour = _role_colour(view, rows)
    tooltip = [alt.Tooltip("id:N"), alt.Tooltip("role:N"),
               alt.Tooltip("distance:Q", title="residual [px]", format=".3g")]
    if metres:
        tooltip.append(alt.Tooltip("metres:Q", title="on the ground [m]", format=".3g"))
    shape = alt.Shape("role:N", scale=legend_of(ROLE_SHAPES, _shown_roles(view, rows)),
                      legend=role_legend())
    shafts = base.mark_rule(strokeWidth=1.5, clip=True, aria=False).encode(
        x=x, y=y, x2="end_x:Q", y2="end_y:Q", color=colour,
        strokeDash=alt.condition("datum.drawn < 1", alt.value([5, 3]), alt.value([])))
    heads = base.mark_point(shape="wedge", filled=True, size=110, opacity=1, aria=False).encode(
        x=_with_field(x, "end_x"), y=_with_field(y, "end_y"), color=colour,
        angle=alt.Angle("turn:Q", scale=None))
    blunder_rings = base.transform_filter("datum.blunder").mark_point(
        size=230, filled=False, stroke=BLUNDER, strokeWidth=1.8, opacity=1,
        aria=False).encode(x=x, y=y)
    picked_ring = base.transform_filter(picked).mark_point(
        size=420, filled=False, stroke=INK, strokeWidth=2.6, opacity=1, aria=False).encode(x=x, y=y)
    symbols = [base.transform_filter("datum.kind == 'point'").mark_point(
        filled=True, size=44, opacity=1, stroke=GROUND, strokeWidth=0.6, cursor="pointer",
        ).encode(x=x, y=y, color=colour, shape=shape, tooltip=tooltip)]
    if view.lines:
        symbols.append(base.transform_filter("datum.kind == 'line'").mark_point(
            filled=True, size=14, opacity=1, cursor="pointer").encode(
                x=x, y=y, color=colour, tooltip=tooltip))
    # Parameters belong to one layer each; those of clicks to the uppermost, which is hit.
    symbols[-1] = symbols[-1].add_params(picked)
    if member is not None:
        symbols[-1] = symbols[-1].add_params(member)
    # From below to above.
    return [shafts.add_params(drag), heads, blunder_rings, picked_ring, *symbols]


def _with_residuals_of_member(base: Any, view: View) -> Any:
    """Return a chart whose rows have the residuals and roles of the member that is chosen."""
    # The data of the page hold the residuals of all members, and the browser takes those of the
    # choice.
    number = "(member.member ? member.member[0] : 0)"
    return base.transform_calculate(
        dl=f"{view.unit:g} * datum.dls[{number}]", ds=f"{view.unit:g} * datum.dss[{number}]",
    ).transform_calculate(
        distance="sqrt(datum.dl * datum.dl + datum.ds * datum.ds)",
        role=f"datum.role != 'control' && datum.role != 'left out' ? datum.role : "
             f"datum.uses[{number}] ? 'control' : 'left out'")


def _share_to_rim(position: str, component: str, domain: tuple[float, float]) -> str:
    """Return Vega's expression for the way from a point to the rim by the length of its arrow.

    `position` and `component` are the fields of the point and of the residual along one axis, whose
    least and greatest values are `domain`. It is 1 for an arrow that has no length there.
    """
    length = f"(exaggeration * datum.{component})"
    low, high = domain
    return (f"({length} > 0 ? ({high:.12g} - datum.{position}) / {length} : "
            f"{length} < 0 ? ({low:.12g} - datum.{position}) / {length} : 1)")


def _scale_bar(x0: float, y0: float, length: float, text: str, at_x: str, at_y: str, x: Any, y: Any,
               ) -> Any:
    """Return the bar that says how long a residual is drawn.

    It begins at `x0` and `y0` and stands for a residual of `length`, in units of the axes `x` and
    `y`, whose fields are `at_x` and `at_y`; `text` is the length in words.
    """
    alt = require_altair()
    base = alt.Chart(chart_rows([{at_x: x0, at_y: y0, "length": length, "text": text}])
                     ).transform_calculate(end=f"datum.{at_x} + exaggeration * datum.length")
    return alt.layer(
        base.mark_rule(strokeWidth=2.4, color=INK, aria=False).encode(x=x, y=y, x2="end:Q"),
        # The rim keeps the text apart from arrows below it.
        *(base.mark_text(align="left", dx=8, fontSize=11, aria=False, **look).encode(
            x=_with_field(x, "end"), y=y, text="text:N")
          for look in ({"color": GROUND, "stroke": GROUND, "strokeWidth": 4}, {"color": INK})))


def _axis_titles(view: View) -> tuple[str, str]:
    """Return the titles of the horizontal and vertical axis of the ground, x and y.

    The unit is in them if it is known; the horizontal axis names the CRS, too.
    """
    crs = view.record.data.crs
    unit = view.units_per_metre
    if is_geographic(crs):
        return f"longitude [°], {short_crs_name(crs)}", "latitude [°]"
    if unit is None:
        unit_text = "unit not known"
    elif unit == 1:
        unit_text = "m"
    else:
        unit_text = f"{1 / unit:.4g} m"
    return f"x [{unit_text}], {short_crs_name(crs)}", f"y [{unit_text}]"


def _with_field(channel: Any, field: str) -> Any:
    """Return a copy of an axis that shows another field."""
    channel_of_field = channel.copy()
    channel_of_field.shorthand = f"{field}:Q"
    return channel_of_field


def _shown_roles(view: View, rows: list[Row]) -> set[str]:
    """Return the roles that a map shows, "left out" among them if members of a front differ."""
    present = {row["role"] for row in (*rows, *view.lines)}
    # Of members of a front, control points in use by some are left out by others.
    if any(0 in row.get("uses", ()) and row["role"] == "control" for row in rows):
        present.add("left out")
    return present


def _role_colour(view: View, rows: list[Row]) -> Any:
    """Return the colour of a role as a channel of Vega-Lite, with its legend."""
    alt = require_altair()
    return alt.Color("role:N", scale=legend_of(ROLE_COLOURS, _shown_roles(view, rows)),
                     legend=alt.Legend(symbolStrokeWidth=0, symbolOpacity=1, labelExpr=ROLE_LABELS))


def _choose_exaggeration(lengths: list[float], wide: float, area: float) -> float:
    """Return by how much residuals are drawn longer over a map of an area.

    The median vector has the length `LENGTH`, or `SPACING` where vectors are so many that arrows
    of that length would lie over each other.
    """
    # The median, as a blunder would make all others invisible.
    median = float(np.median(lengths)) if lengths else 0.0
    if median <= VECTOR_ROUNDING * wide:
        return 1.0
    # Mean distance of neighbours: n positions share the area.
    length = min(LENGTH * wide, SPACING * (area / len(lengths)) ** 0.5)
    return nice_number(length / median)
