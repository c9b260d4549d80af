"""The kinds of charts: what each is called, what to look for, and when there is none."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from termsel.errors import TermselError, unknown_name
from termsel.files.atomic import write_bytes
from termsel.report.charts import bars, maps, search, terms
from termsel.report.notebook import offline
from termsel.report.theme import require_altair, styled
from termsel.report.view import View

SCALE = 2.0
"""Pixels of a PNG for each pixel of the screen."""


@dataclass(frozen=True)
class Kind:
    """A kind of chart.

    Parameters
    ----------
    name : str
    title : str
    look : str
        What to look for, in one sentence.
    draw : callable
        Returns the chart of a view, without title and style.
    missing : callable
        Returns why a view has no such chart; "" where it has one.
    """

    name: str
    title: str
    look: str
    draw: Callable[[View], Any]
    missing: Callable[[View], str] = lambda _: ""


def _linked(view: View) -> Any:
    """Return the worst residuals next to the map that shows where they are."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Automatically deduplicated")  # which links the two
        return require_altair().hconcat(
            bars.worst_bars(view).properties(width=260),
            maps.image_map(view)).resolve_scale(color="independent", shape="independent")


def _front(view: View) -> Any:
    """Return the front next to the residuals of the member that is chosen."""
    shown = search.front(view).properties(width=380, height=380)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Automatically deduplicated")
        return require_altair().hconcat(shown, search.members(view)).resolve_scale(
            color="independent", shape="independent")


KINDS = {kind.name: kind for kind in (
    Kind("residuals", "Residuals in the image",
         "Arrows should point every way. Where neighbours agree, the model lacks a term there; a "
         "single long arrow is a blunder.", maps.image_map),
    Kind("ground", "Residuals on the ground",
         "A common direction over a slope or a district points to wrong heights or a wrong datum.",
         maps.ground_map),
    Kind("worst", "The largest residuals",
         "The list should fall off smoothly. A step after the first few bars separates blunders "
         "from noise.", _linked),
    Kind("baselines", "Compared with fits without a search",
         "This result should be left of the plain structures on independent points, by more than "
         "the intervals overlap.", bars.baseline_bars,
         lambda view: "" if bars.fit_rows(view) else "it has no check or independent points"),
    Kind("candidates", "Candidates of the strategy auto",
         "A plain candidate next to the chosen one is nearly as good, and easier to defend.",
         bars.candidate_bars,
         lambda view: "" if view.record["strategy"] else "it was not made by the strategy auto"),
    Kind("front", "Front of accuracy against size",
         "Where independent points turn upwards while check points still fall, terms fit noise.",
         _front, lambda view: "" if view.record["front"] else "its search had one objective"),
    Kind("convergence", "Convergence of the search",
         "The best should be level at the end. If it still falls, give the search more "
         "evaluations.", search.convergence,
         lambda view: "" if len(view.record.get("history", ())) > 1 else
         "it has no history of a search"),
    Kind("empires", "Empires of the search",
         "The imperialist competitive algorithm ends where one band is left. Many bands at the end "
         "mean that the budget ended it.", search.empires,
         lambda view: "" if any("empires" in one for one in view.record.get("history", ()))
         else "its solver was not the ICA"),
    Kind("frequency", "How often terms are selected",
         "Terms that nearly all selections have can be relied on. Those that few have fit noise, "
         "or stand for each other.", terms.frequency_bars, terms.no_frequencies),
    Kind("terms", "Terms and their significance",
         "Terms in orange could be zero. Many of them mean that fewer terms would do.",
         terms.term_bars, lambda view: "" if view.record["significance"] else
         "its terms are not those of a least-squares fit with redundancy"),
    Kind("correlations", "Correlation of coefficients",
         "Dark cells are pairs that the control cannot tell apart; one term of each pair may go.",
         terms.correlation_map, lambda view: "" if view.correlations is not None else
         "its coefficients are not those of a least-squares fit with redundancy"),
    Kind("sigma", "Where the model is uncertain",
         "Dark areas, mostly outside the hull of the control, need further points.",
         maps.sigma_map, lambda view: "" if view.sigma else
         "its control has no redundancy to estimate it from"),
)}
"""All kinds of charts by name, in the order of a report."""


def kind_of(name: str) -> Kind:
    """Return a kind of chart.

    Raises
    ------
    TermselError
        If there is none of that name.
    """
    if name not in KINDS:
        raise unknown_name("kind of chart", name, KINDS)
    return KINDS[name]


def chart(view: View, name: str) -> Any:
    """Return a chart in the common style, with its title and what to look for.

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
    kind = kind_of(name)
    if why := kind.missing(view):
        there = ", ".join(one.name for one in KINDS.values() if not one.missing(view))
        raise TermselError(f"this result has no chart {name}: {why}",
                           hint=f"Charts that it has: {there}.")
    return offline(styled(kind.draw(view), kind.title, kind.look))


class Plots:
    """Charts of a result, each as an Altair chart that can be changed further.

    Parameters
    ----------
    view : View
    """

    def __init__(self, view: View) -> None:
        self._view = view

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *KINDS]

    def __repr__(self) -> str:
        return f"<Plots: {', '.join(KINDS)}>"

    def residuals(self) -> Any:
        """Return residuals as arrows over the image."""
        return chart(self._view, "residuals")

    def ground(self) -> Any:
        """Return residuals as arrows on the ground."""
        return chart(self._view, "ground")

    def worst(self) -> Any:
        """Return the largest residuals, linked to the map."""
        return chart(self._view, "worst")

    def baselines(self) -> Any:
        """Return the RMSE next to those of fits without a search."""
        return chart(self._view, "baselines")

    def candidates(self) -> Any:
        """Return the candidates of the strategy "auto"."""
        return chart(self._view, "candidates")

    def front(self) -> Any:
        """Return the front, linked to the residuals of its members."""
        return chart(self._view, "front")

    def convergence(self) -> Any:
        """Return how the search converged."""
        return chart(self._view, "convergence")

    def empires(self) -> Any:
        """Return how many countries each empire of the ICA has."""
        return chart(self._view, "empires")

    def frequency(self) -> Any:
        """Return how often terms are selected."""
        return chart(self._view, "frequency")

    def terms(self) -> Any:
        """Return the significance of terms."""
        return chart(self._view, "terms")

    def correlations(self) -> Any:
        """Return the correlations of coefficients."""
        return chart(self._view, "correlations")

    def sigma(self) -> Any:
        """Return the standard deviation over the image."""
        return chart(self._view, "sigma")


FORMATS = (".svg", ".png", ".pdf")


def require_picture(path: Path) -> None:
    """Refuse a name that does not say which kind of picture it is.

    Raises
    ------
    TermselError
    """
    if path.suffix.lower() not in FORMATS:
        raise TermselError(f"a picture cannot be a file {path.suffix or 'without a suffix'}",
                           file=path, hint=f"Give a name that ends in {', '.join(FORMATS)}.")


def save(drawn: Any, path: Path) -> None:
    """Write a chart as SVG, PNG or PDF, whole or not at all.

    Parameters
    ----------
    drawn : altair.Chart
    path : pathlib.Path
        Its suffix says which.

    Raises
    ------
    TermselError
        If the suffix is another, vl-convert-python is missing, or the file cannot be written.
    """
    require_picture(path)
    try:
        import vl_convert
    except ImportError:
        raise TermselError("pictures require vl-convert-python, which is not installed",
                           hint='Install it: pip install "termsel[report]".') from None
    spec = drawn.to_json(indent=None)
    suffix = path.suffix.lower()
    content = (vl_convert.vegalite_to_svg(spec).encode() if suffix == ".svg" else
               vl_convert.vegalite_to_png(spec, scale=SCALE) if suffix == ".png" else
               vl_convert.vegalite_to_pdf(spec))
    write_bytes(path, content)
