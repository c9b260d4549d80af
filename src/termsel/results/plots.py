"""The kinds of charts: what each is called, what to look for, and when there is none."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from termsel.core.arguments import Explained, explains_arguments
from termsel.core.errors import TermselError, unknown_name_error
from termsel.core.files.atomic import write_bytes
from termsel.results.blocks import Figure
from termsel.results.charts import bars, maps, search, terms
from termsel.results.notebook import offline_chart
from termsel.results.pictures import draw_picture
from termsel.results.theme import require_altair, with_theme
from termsel.results.view import View


@dataclass(frozen=True)
class ChartKind:
    """A kind of chart.

    Parameters
    ----------
    name : str
    title : str
    look : str
        What to look for.
    draw : callable
        Returns the chart of a view, without title and style.
    missing : callable
        Returns why a view has no such chart; "" where it has one.
    keeps_ratio : bool
        Whether height follows width, as that of a map.
    remark : callable
        Returns what else is said of the chart of a view; "" where nothing is.
    """

    name: str
    title: str
    look: str
    draw: Callable[[View], Any]
    missing: Callable[[View], str] = lambda _: ""
    keeps_ratio: bool = False
    remark: Callable[[View], str] = lambda _: ""

    def caption(self, view: View) -> str:
        """Return the caption of the chart of a view: how to read it, and remarks."""
        return f"{self.look} {self.remark(view)}".strip()


def _worst_next_to_map(view: View) -> Any:
    """Return the worst residuals next to the map that shows where they are."""
    # Side by side, and linked: what is clicked in one is marked in the other.
    return _side_by_side(bars.bars_of_worst(view).properties(width=260), maps.image_map(view))


def _front_and_member(view: View) -> Any:
    """Return the front next to the residuals of the member that is chosen."""
    return _side_by_side(
        search.front_chart(view).properties(width=380, height=380), search.member_residuals(view))


def _side_by_side(first: Any, second: Any) -> Any:
    """Return two charts side by side, without the warning that links them."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Automatically deduplicated")  # which links the two
        return require_altair().hconcat(first, second).resolve_scale(
            color="independent", shape="independent")


KINDS = {kind.name: kind for kind in (
    ChartKind(
        "residuals", "Residuals in the image",
        "Arrows should point in all directions. If neighbours agree, the model lacks a term; a "
        "single long arrow is a blunder.", maps.image_map, keeps_ratio=True,
        remark=maps.cut_in_image),
    ChartKind(
        "ground", "Residuals on the ground",
        "A common direction over a slope or a district points to wrong heights or a wrong datum.",
        maps.ground_map, keeps_ratio=True, remark=maps.cut_on_ground),
    ChartKind(
        "worst", "The largest residuals",
        "The list should fall off smoothly. A step after the first few bars separates blunders "
        "from noise.", _worst_next_to_map, remark=bars.caption_on_breaks),
    ChartKind(
        "baselines", "Compared with fits without a search",
        "This result should lie left of the conventional models at independent check points. If "
        "intervals overlap, the difference may be noise.", bars.baseline_bars,
        lambda view: "" if bars.fit_rows(view) else
        "it has neither selection points nor independent check points",
        remark=bars.caption_on_others),
    ChartKind(
        "candidates", "Models that the automatic choice compared",
        "Prefer the simpler of two models that are equally good.",
        bars.candidate_bars,
        lambda view: "" if view.record.strategy else
        "it was not chosen automatically (strategy auto)"),
    ChartKind(
        "front", "Pareto front: accuracy against size",
        "If the error rises at independent check points and still falls at selection points, "
        "further terms fit noise.",
        _front_and_member,
        lambda view: "" if view.record.front else "its model was chosen without a search"
        if view.record.strategy else "its search had one objective"),
    ChartKind(
        "convergence", "Convergence of the search",
        "The best value should be level at the end. If it still falls, give the search more "
        "evaluations. Grey is the share of selections that break a condition.",
        search.convergence_chart,
        lambda view: "" if len(view.record.history) > 1 else
        "it has no history of a search", remark=search.refinement_remark),
    ChartKind(
        "empires", "Empires of the search",
        "The imperialist competitive algorithm ends when one band remains. Many bands at the end "
        "mean that the budget stopped it.", search.empires_chart,
        lambda view: "" if any(generation.empires for generation in view.record.history)
        else "its solver was not the ICA"),
    ChartKind(
        "frequency", "How often terms are selected",
        "Terms in nearly all selections are reliable. Terms in few selections fit noise, or "
        "replace each other.", terms.frequency_bars, terms.why_no_frequencies),
    ChartKind(
        "terms", "Terms and their significance",
        "Terms in orange could be zero. Many of them mean that fewer terms would do.",
        terms.term_bars, lambda view: "" if view.record.significance else
        "its terms are not those of a least-squares fit with redundancy"),
    ChartKind(
        "correlations", "Correlation of coefficients",
        "Dark cells are pairs of terms that the control points cannot separate: one of each pair "
        "may be omitted.",
        terms.correlation_map, lambda view: "" if view.correlations else
        "its coefficients are not those of a least-squares fit with redundancy", True),
    ChartKind(
        "sigma", "Uncertainty of the model",
        "Dark areas, mostly outside the control points, need further points.",
        maps.sigma_map, lambda view: "" if view.sigma else
        "its control has no redundancy to estimate it from", True),
)}
"""All kinds of charts by name, in the order of a report."""

LINKED = ("worst", "front")
"""Those with a map of the image beside them, which a page shows by itself."""


def kind_of(name: str) -> ChartKind:
    """Return a kind of chart by its name.

    Raises
    ------
    TermselError
        If no kind has this name.
    """
    if name not in KINDS:
        raise unknown_name_error("kind of chart", name, KINDS)
    return KINDS[name]


def why_chart_missing(view: View, name: str) -> str:
    """Return why a view has no chart of this kind; "" where it has one."""
    return KINDS[name].missing(view)


def chart_block(view: View | None, name: str, drawn: Any = None) -> Iterator[Figure]:
    """Yield a chart as a block; nothing if the view has none, or is None.

    Parameters
    ----------
    view : View or None
    name : str
        One of `KINDS`.
    drawn : altair.Chart, optional
        The chart; by default the kind draws it.
    """
    if view is not None and not why_chart_missing(view, name):
        kind = KINDS[name]
        yield Figure(name, kind.title, kind.caption(view),
                     kind.draw(view) if drawn is None else drawn, kind.keeps_ratio)


def require_chart(view: View, name: str) -> None:
    """Raise TermselError, which names the charts that there are, where a view lacks one."""
    # A report leaves a gap, but here the user asked for the chart by its name.
    if why := kind_of(name).missing(view):
        names = ", ".join(kind.name for kind in KINDS.values() if not kind.missing(view))
        raise TermselError(f"this result has no chart {name}: {why}",
                           hint=f"Charts that it has: {names}.")


def styled_chart(view: View, name: str) -> Any:
    """Return a chart in the common style, with its title and how to read it.

    Parameters
    ----------
    view : View
    name : str
        One of `KINDS`.

    Raises
    ------
    TermselError
        If altair is not installed, there is no such kind, or the result has no such chart.
    """
    require_altair()
    require_chart(view, name)
    kind = kind_of(name)
    caption = kind.caption(view)
    if name in LINKED:
        caption = f"{caption} {maps.cut_in_image(view)}".strip()
    return offline_chart(with_theme(kind.draw(view), kind.title, caption))


class Plots(Explained):
    """Charts of a result, each as an Altair chart that can be changed further.

    There is a method for each of `KINDS`.
    """

    if TYPE_CHECKING:
        def __getattr__(self, name: str) -> Callable[[], Any]: ...

    def __init__(self, view: View) -> None:
        self._view = view

    def __call__(self, *_args: object) -> NoReturn:
        """Raise TypeError with the names of the charts, as each of them is a function."""
        raise TypeError(f"plot is no function, but has one for each chart: "
                        f"{', '.join(f'plot.{name}()' for name in KINDS)}.")

    def __repr__(self) -> str:
        return f"<Plots: {', '.join(KINDS)}>"


def _saved_by_altair(_values: tuple[object, ...]) -> str:
    """Return how a chart is written, for those who give the name of a file to its method."""
    return "It returns a chart of Altair, which its own save(PATH) writes."


def _method_of_kind(kind: ChartKind) -> Callable[[Plots], Any]:
    """Return the method of `Plots` that draws a kind of chart."""
    def draw(self: Plots) -> Any:
        return styled_chart(self._view, kind.name)

    # As if it were written out, for help() and tracebacks.
    draw.__name__ = kind.name
    draw.__qualname__ = f"Plots.{kind.name}"
    draw.__doc__ = f"Return the chart \"{kind.title}\".\n\n{kind.look}"
    return explains_arguments(places=_saved_by_altair)(draw)


# Methods by the names of the charts, so that a notebook completes them.
for _kind in KINDS.values():
    setattr(Plots, _kind.name, _method_of_kind(_kind))


FORMATS = (".svg", ".png", ".pdf")


def require_picture(path: Path) -> None:
    """Refuse a name that does not say which kind of picture it is.

    Raises
    ------
    TermselError
        If the suffix is not one of `FORMATS`, such as .svg.
    """
    if path.suffix.lower() not in FORMATS:
        kind = path.suffix or "a file without a suffix"
        raise TermselError(f"charts are not written as {kind}",
                           file=path, hint=f"Give a name that ends in {', '.join(FORMATS[:-1])} or "
                                           f"{FORMATS[-1]}.")


def save(drawn: Any, path: Path) -> None:
    """Write a chart as SVG, PNG or PDF, whole or not at all.

    Parameters
    ----------
    drawn : altair.Chart
    path : pathlib.Path
        Its suffix says which of these it is.

    Raises
    ------
    TermselError
        If the suffix is another, the chart cannot be drawn, or the file cannot be written.
    """
    require_picture(path)
    write_bytes(path, draw_picture(drawn, path.suffix.lower()))
