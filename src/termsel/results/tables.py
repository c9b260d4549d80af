"""Tables of what charts show, for those who cannot see them or need the numbers."""

from __future__ import annotations

from collections.abc import Callable

from termsel.core.errors import rounded_size_text
from termsel.results.blocks import TableBlock
from termsel.results.charts.search import evenly_spaced
from termsel.results.charts.terms import frequency_rows, term_rows
from termsel.results.view import View

MAX_GENERATION_ROWS = 30
"""Rows of the search."""
PAIRS = 60
"""Pairs of correlated coefficients."""
STEP = 9
"""Every so many cells of the map of uncertainty there is a row."""


def convergence_table(view: View) -> TableBlock:
    """Return a table of the search, with a row for each of MAX_GENERATION_ROWS generations at most.

    For a solver with empires a column counts the empires that are left.
    """
    history = evenly_spaced(view.record.history, MAX_GENERATION_ROWS)
    has_empires = any(generation.empires for generation in history)
    rows = []
    for generation in history:
        best_and_median = ["-" if figure is None else f"{figure:.4g}"
                           for figure in (generation.best, generation.median)]
        row = [str(generation.evaluations), *best_and_median, f"{1 - generation.feasible:.0%}"]
        if has_empires:
            row.append(str(sum(map(bool, generation.empires))))
        rows.append(tuple(row))
    columns = ["evaluations", "best", "median", "infeasible"]
    if has_empires:
        columns.append("empires left")
    return TableBlock("The search, generation by generation", tuple(columns), rows, folded=True)


def frequency_table(view: View) -> TableBlock:
    """Return how often terms are selected."""
    return TableBlock(
        "How often terms are selected", ("term", "share of selections", "in this result"),
        [(row["term"], f"{row['share']:.0%}", "yes" if row["used"] else "no")
         for row in frequency_rows(view)], folded=True)


def term_table(view: View) -> TableBlock:
    """Return the terms with the significance of their coefficients."""
    return TableBlock("Terms and their significance", ("term", "t", "chance if zero"), [
        (row["term"], f"{row['t']:.3g}", f"{row['p']:.2g}") for row in term_rows(view)],
        folded=True)


def correlation_table(view: View) -> TableBlock:
    """Return the PAIRS pairs of coefficients that correlate most, whatever the sign."""
    pairs = sorted(view.correlations, key=lambda row: -abs(row["correlation"]))
    return TableBlock(
        "Pairs of coefficients that correlate most", ("term", "and term", "correlation"),
        [(row["other"], row["one"], f"{row['correlation']:.3f}") for row in pairs[:PAIRS]],
        folded=True)


def sigma_table(view: View) -> TableBlock:
    """Return the standard deviation [px] at places all over the image, at the middle of cells."""
    cells = view.sigma
    # Every STEP-th line and column of the map: a table of all would have hundreds of rows.
    rows = sorted({cell["line"] for cell in cells})[::STEP]
    columns = sorted({cell["sample"] for cell in cells})[::STEP]
    return TableBlock("Standard deviation across the image", (
        "line", "sample", "standard deviation [px]"), [
            (f"{(cell['line'] + cell['line2']) / 2:.0f}",
             f"{(cell['sample'] + cell['sample2']) / 2:.0f}", rounded_size_text(cell["sigma"]))
            for cell in cells if cell["line"] in rows and cell["sample"] in columns], folded=True)


OF_TERMS: dict[str, Callable[[View], TableBlock] | None] = {
    "convergence": convergence_table, "empires": None, "frequency": frequency_table,
    "terms": term_table, "correlations": correlation_table}
"""Charts of search and terms, with their tables."""
