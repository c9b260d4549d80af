"""Colours, symbols and type of all charts and pages, and the library that draws them.

The colours of the roles are distinguished with any kind of colour blindness, and by lightness in
print; each role has a shape too.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from termsel.core.errors import require_import

CONTROL, CHECK, INDEPENDENT = "#0072b2", "#e08a00", "#1b1f24"
UNUSED, BLUNDER = "#9aa1ab", "#c8003c"
INK, FAINT, EDGE, GRID, GROUND = "#1b1f24", "#5b636e", "#c6cbd2", "#eceef1", "#ffffff"

METHODS = (CONTROL, CHECK, INDEPENDENT, "#009e73", BLUNDER, "#56b4e9", "#7b4ea3", "#8c6d31")
"""Colours of what is compared in a study."""

DARK = {INK: "#e4e8ee", FAINT: "#a9b1bc", EDGE: "#505864", GRID: "#2a3038", GROUND: "#14171b",
        CONTROL: "#3f9fe0", BLUNDER: "#ff6f91", "#56b4e9": "#a9dcff", "#7b4ea3": "#b790e6",
        "#8c6d31": "#c9a866"}
"""What colours are on a dark page; the others are seen on both."""

ROLE_COLOURS = {"control": CONTROL, "check": CHECK, "independent": INDEPENDENT,
                "rejected": BLUNDER, "left out": UNUSED}
ROLE_SHAPES = {"control": "circle", "check": "square", "independent": "triangle-up",
               "rejected": "cross", "left out": "cross"}

ROLE_LABELS = ("datum.label == 'check' ? 'selection' : "
               "datum.label == 'independent' ? 'independent check' : "
               "datum.label == 'rejected' ? 'rejected outlier' : "
               "datum.label == 'left out' ? 'not used' : datum.label")
"""What a legend calls the roles of files and options, as an expression of Vega."""

WIDTH = 560
"""Of a chart [px of the screen]."""


def require_altair() -> Any:
    """Return the package altair.

    Raises
    ------
    TermselError
        If it is not installed, with the command that installs it.
    """
    with require_import("charts require", "altair and vl-convert-python", '"termsel[report]"'):
        import altair
    return altair


def with_theme(chart: Any, title: str = "", look: str = "") -> Any:
    """Return a chart of Altair in the common style.

    `title` is above it, and under the title `look`, a sentence on how to read the chart. Without a
    title there is neither.
    """
    alt = require_altair()
    if title:
        chart = chart.properties(title=alt.Title(title, subtitle=_wrap_text(look, chart)))
    return chart.configure(
        background=GROUND, font="Helvetica Neue, Helvetica, Arial, sans-serif", padding=10,
    ).configure_view(stroke=None).configure_title(
        anchor="start", frame="group", fontSize=15, fontWeight=600, color=INK, offset=12,
        subtitleColor=FAINT, subtitleFontSize=11.5, subtitlePadding=4,
    ).configure_axis(
        labelColor=INK, titleColor=FAINT, titleFontWeight="normal", titleFontSize=11.5,
        labelFontSize=11, domainColor=EDGE, tickColor=EDGE, gridColor=GRID, labelLimit=150,
        labelSeparation=5, titlePadding=9,
    ).configure_legend(
        orient="top", direction="horizontal", title=None, labelFontSize=11.5, labelColor=INK,
        titleColor=INK, titleFontSize=11.5, titleFontWeight="normal", symbolSize=70,
        offset=6, columnPadding=24, labelLimit=200,
    ).configure_header(labelColor=INK, labelFontSize=12, labelFontWeight=600)


def dark_style() -> str:
    """Return the rules of style by which charts of a page have dark colours on a dark screen."""
    rules = []
    for light, dark in DARK.items():
        for attribute in ("fill", "stroke"):
            rules.append(f'  svg [{attribute}="{light}"] {{ {attribute}: {dark}; }}')
    block = "\n".join(rules)
    return f"@media screen and (prefers-color-scheme: dark) {{\n{block}\n}}\n"


_MOST_CHARACTERS = 84
"""Of a line of a caption; those of WIDTH px."""


def _wrap_text(text: str, chart: Any) -> list[str]:
    """Return the lines of a caption, none of which is wider than a panel of the chart."""
    import textwrap

    panel = getattr(chart, "spec", chart)  # one of several side by side
    width = getattr(panel, "width", WIDTH)
    known = isinstance(width, (int, float))
    share = min(width / WIDTH, 1.0) if known else 1.0
    return textwrap.wrap(text, round(_MOST_CHARACTERS * share))


def chart_rows(rows: list[dict[str, Any]]) -> Any:
    """Return rows as data of a chart, without False values, which a missing one equals."""
    values = []
    for row in rows:
        values.append({key: value for key, value in row.items() if value is not False})
    return _shared_data_class()(values=values)


@cache  # a class is made once, when Altair is imported
def _shared_data_class() -> Any:
    """Return the class of data that copies of a chart share: copies of all rows take seconds."""

    class Shared(require_altair().InlineData):  # type: ignore[misc]
        _class_is_valid_at_instantiation = False  # rows are plain numbers and text

        def __deepcopy__(self, _memo: Any) -> Any:
            return self

    return Shared


def legend_of(kinds: dict[str, str], present: set[str]) -> Any:
    """Return the colours of those kinds that are present, in the order of the kinds."""
    names = [name for name in kinds if name in present]
    return require_altair().Scale(domain=names, range=[kinds[name] for name in names])


def role_legend() -> Any:
    """Return a legend that shows roles by the words of the field, such as "selection"."""
    # A faint interval or line of the same colour must not make the symbol faint.
    return require_altair().Legend(labelExpr=ROLE_LABELS, symbolOpacity=1)


def spread_scale(values: list[float], *, zero: bool) -> tuple[Any, str]:
    """Return the scale of values, and the end of the title of its axis, which names it.

    It is logarithmic, and the title ends in ", logarithmic", where all values are positive and the
    largest is more than 12 times the least; else it is linear, and the end is "".

    Parameters
    ----------
    values : list of float
        What is drawn along the axis.
    zero : bool
        Whether a linear scale begins at 0.
    """
    alt = require_altair()
    if len(values) and min(values) > 0 and max(values) > 12 * min(values):
        return alt.Scale(type="log", nice=False, padding=10), ", logarithmic"
    return alt.Scale(zero=zero), ""
